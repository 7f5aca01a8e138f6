"""The CAN bus in virtual time: frame times, arbitration, who hears what."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.encoder import build
from analyzer.records import CanFrame, Comment, Frame
from conformance.drives.bus import Traffic
from conformance.drives.can_bits import frame_bits
from conformance.drives.can_bus import CanBus
from conformance.drives.drive import Outgoing
from tests.conformance.drives.plain_drive import MOVE_NS, PlainDrive

MKS = dialects.get("mks-can")
SECOND = 1_000_000_000


def read(address: int) -> bytes:
    return build(MKS, "read_speed", address)


def reply(address: int) -> bytes:
    return build(MKS, "read_speed", address, {}, Role.REPLY)


def drive(address: int, **options: int) -> PlainDrive:
    return PlainDrive("mks-can", address, **options)


def frames(bus: CanBus) -> list[tuple[int, bytes]]:
    bus.run_until(bus.now_ns + SECOND)
    return [(f.id, f.data) for f in bus.received()]


def test_frame_lengths_by_the_standard() -> None:
    assert frame_bits(0x123, b"", stuffed=False) == 47
    assert frame_bits(0x123, bytes(8), stuffed=False) == 111
    assert frame_bits(0x123, bytes(8), extended=True, stuffed=False) == 131
    assert frame_bits(0x555, b"\x55" * 4) - frame_bits(0x555, b"\x55" * 4, stuffed=False) <= 2
    # 34 + 8n bits are stuffed; at worst one bit is added for each four behind the first five.
    worst = max(frame_bits(i, bytes((b,)) * 8, stuffed=True) for i in (0, 0x7FF) for b in (0, 0xFF, 0x1F, 0xF0, 0x0F))
    assert 111 + 15 < worst <= 111 + (34 + 64 - 1) // 4


def test_a_request_and_its_reply_take_their_time() -> None:
    one = drive(1, delay_ns=100_000)
    bus = CanBus([one], speed=500_000)
    bus.send(1, read(1))
    answer = bus.receive(SECOND)
    request_ns = frame_bits(1, read(1)) * 2000
    assert answer == CanFrame(bus.now_ns, "bus", 1, reply(1), Role.REPLY)
    assert one.taken == [(request_ns, "read_speed")]
    assert bus.now_ns == request_ns + 100_000 + frame_bits(1, reply(1)) * 2000


def test_without_wire_time() -> None:
    bus = CanBus([drive(1, delay_ns=100_000)], wire_time=False)
    bus.send(1, read(1))
    assert bus.receive(SECOND) is not None
    assert bus.now_ns == 100_000


def test_a_drive_does_not_hear_itself_and_hears_the_others() -> None:
    drives = [drive(1), drive(2)]
    bus = CanBus(drives)
    bus.send(2, read(2))
    assert frames(bus) == [(2, reply(2))]
    assert [f.data for f in drives[0].heard] == [read(2), reply(2)]
    assert [f.data for f in drives[1].heard] == [read(2)]


class Eager(PlainDrive):
    """Sends its frame at 5 ms, when it hears identifier 9."""

    def receive(self, frame: Frame, t_ns: int) -> list[Outgoing]:
        assert frame.can is not None
        return [Outgoing(5_000_000, reply(self.address), self.address)] if frame.can.id == 9 else []


@pytest.mark.parametrize("arbitration", [True, False])
def test_the_lowest_identifier_goes_first(arbitration: bool) -> None:
    bus = CanBus([Eager("mks-can", i) for i in (3, 1, 2)], arbitration=arbitration)
    bus.send(9, read(9))
    assert [can_id for can_id, _ in frames(bus)] == ([1, 2, 3] if arbitration else [3, 1, 2])


def test_the_host_takes_part_in_arbitration() -> None:
    order: list[tuple[int, Role]] = []
    bus = CanBus([drive(i) for i in (1, 2, 3)])
    bus.watch(lambda t: order.append((t.id, t.direction)) if isinstance(t, CanFrame) else None)
    for address in (3, 2, 1):
        bus.send(address, read(address))
    bus.run_until(SECOND)
    asked = [(i, Role.REQUEST) for i in (3, 2, 1)]
    assert order == [*asked, *((i, Role.REPLY) for i in (1, 2, 3))]


def test_a_drive_at_another_rate_is_not_there() -> None:
    bus = CanBus([drive(1, bit_rate=1), drive(2, bit_rate=2)], speed=500_000)
    bus.send(1, read(1))
    bus.send(2, read(2))
    assert frames(bus) == [(2, reply(2))]
    assert bus.drives[0].heard == []  # type: ignore[attr-defined]
    bus.speed = 250_000
    bus.send(1, read(1))
    assert frames(bus) == [(1, reply(1))]


def test_a_bus_without_a_rate_is_right_for_all() -> None:
    bus = CanBus([drive(1, bit_rate=1), drive(2, bit_rate=2)])
    bus.send(1, read(1))
    bus.send(2, read(2))
    assert sorted(frames(bus)) == [(1, reply(1)), (2, reply(2))]


def test_two_drives_of_one_identifier_are_told() -> None:
    seen: list[Traffic] = []
    one, two = drive(1), drive(1)
    two.hooks.reply.append(lambda drive, command, outgoing: [replace(outgoing, data=b"\x32\x12\x34\x00")])
    bus = CanBus([one, two])
    bus.watch(seen.append)
    bus.send(1, read(1))
    assert {data for _, data in frames(bus)} >= {reply(1), b"\x32\x12\x34\x00"}
    assert bus.collisions >= 1
    assert any(isinstance(t, Comment) and "collision" in t.text for t in seen)


@pytest.mark.parametrize("kind", ["extended", "remote", "error", "fd"])
def test_other_frames_reach_no_drive(kind: str) -> None:
    one = drive(1)
    bus = CanBus([one])
    bus.put(CanFrame(None, "bus", 1, read(1), Role.REQUEST, **{kind: True}))
    assert frames(bus) == []
    assert one.heard == []


def test_a_damaged_frame_is_told_as_such() -> None:
    one = drive(1)
    bus = CanBus([one])
    bus.send(1, b"\x32\x00")
    bus.send(1, b"")
    bus.run_until(SECOND)
    assert [f.checksum_ok for f in one.heard] == [False, False]
    assert one.taken == []


def test_a_completion_comes_by_itself() -> None:
    bus = CanBus([drive(1)])
    bus.send(1, build(MKS, "move_relative_pulses", 1, {"speed": 100, "pulses": 1000}))
    first, second = bus.receive(SECOND), bus.receive(SECOND)
    assert first is not None
    assert second is not None
    assert first.t_ns is not None
    assert second.t_ns is not None
    assert second.t_ns - first.t_ns == pytest.approx(MOVE_NS, abs=200_000)


def test_what_comes_faster_than_the_bus_carries_is_lost_and_not_carried_later() -> None:
    one = drive(1)
    bus = CanBus([one], speed=500_000, room=10)
    for _ in range(1000):
        bus.send(1, read(1))
    assert len(frames(bus)) == 11, "one frame on the wire, and those that found room"
    assert bus.overrun == 989
    bus.send(1, read(1))
    assert len(frames(bus)) == 1
    assert bus.overrun == 989
