"""The serial bus in virtual time: when bytes are where, who hears what, what collides."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.encoder import build
from analyzer.records import Chunk, Comment
from conformance.drives.bus import Traffic
from conformance.drives.serial_bus import SerialBus
from conformance.drives.uart import byte_ns
from tests.conformance.drives.plain_drive import MOVE_NS, PlainDrive

MKS = dialects.get("mks-rs485")
STEP = byte_ns(38400)
SECOND = 1_000_000_000


def read(address: int) -> bytes:
    return build(MKS, "read_speed", address)


def reply(address: int) -> bytes:
    return build(MKS, "read_speed", address, {}, Role.REPLY)


def drive(address: int = 1, **options: int) -> PlainDrive:
    return PlainDrive("mks-rs485", address, **options)


def all_received(bus: SerialBus, timeout_ns: int = SECOND) -> bytes:
    bus.run_until(bus.now_ns + timeout_ns)
    return bus.received()


def test_bytes_take_their_time() -> None:
    one = drive(delay_ns=1_000_000)
    bus = SerialBus([one])
    gone_ns = bus.send(read(1))
    assert abs(gone_ns - 4 * STEP) < 4
    answer = bus.receive(SECOND)
    assert answer is not None
    assert answer.data == reply(1)
    assert one.taken == [(4 * STEP, "read_speed")]
    assert answer.t_ns == bus.now_ns
    assert abs(bus.now_ns - (4 * STEP + 1_000_000 + 6 * STEP)) < 10


def test_without_wire_time_only_the_drive_takes_time() -> None:
    bus = SerialBus([drive(delay_ns=1_000_000)], wire_time=False)
    bus.send(read(1))
    assert bus.receive(SECOND) == Chunk(1_000_000, "bus", reply(1), Role.REPLY)
    assert bus.now_ns == 1_000_000


def test_a_timeout_takes_its_time() -> None:
    bus = SerialBus([drive()])
    bus.send(read(9))
    assert bus.receive(10_000_000) is None
    assert bus.now_ns == 10_000_000
    with pytest.raises(ValueError, match="expected a time from"):
        bus.run_until(1)


def test_time_jumps_to_what_a_drive_does_by_itself() -> None:
    bus = SerialBus([drive()])
    bus.send(build(MKS, "move_relative_pulses", 1, {"speed": 100, "pulses": 1000}))
    first, second = bus.receive(SECOND), bus.receive(SECOND)
    assert first is not None
    assert second is not None
    assert (first.data[3], second.data[3]) == (1, 2)
    assert second.t_ns is not None
    assert abs(second.t_ns - (11 * STEP + MOVE_NS + 5 * STEP)) < 10
    assert bus.receive(SECOND) is None


def test_every_drive_hears_every_byte_but_its_own() -> None:
    drives = [drive(1), drive(2)]
    bus = SerialBus(drives)
    bus.send(read(2))
    assert all_received(bus) == reply(2)
    assert [f.data for f in drives[0].heard] == [read(2), reply(2)]
    assert [f.data for f in drives[1].heard] == [read(2)]


def test_a_frame_is_taken_while_the_host_still_sends() -> None:
    one = drive()
    bus = SerialBus([one])
    bus.send(read(1) + bytes(20))
    assert all_received(bus) == reply(1)
    assert one.taken == [(4 * STEP, "read_speed")]
    assert bus.collisions == 0


def test_what_the_host_sends_at_once_goes_one_after_another() -> None:
    bus = SerialBus([drive(1), drive(2), drive(3)])
    bus.send(read(1))
    bus.send(read(2))
    bus.send(read(3))
    assert all_received(bus) == reply(1) + reply(2) + reply(3)
    assert bus.collisions == 0


def test_replies_wait_for_the_wire_and_take_turns() -> None:
    seen: list[Traffic] = []
    bus = SerialBus([drive(1), drive(2, delay_ns=STEP)])
    bus.watch(seen.append)
    bus.send(read(1) + read(2))
    assert all_received(bus) == reply(1) + reply(2)
    assert [(t.data, t.direction) for t in seen if isinstance(t, Chunk)] == [
        (read(1) + read(2), Role.REQUEST),
        (reply(1), Role.REPLY),
        (reply(2), Role.REPLY),
    ]
    assert bus.collisions == 0


def test_two_drives_of_one_address_collide() -> None:
    seen: list[Traffic] = []
    one, two = drive(1), drive(1)
    two.hooks.reply.append(lambda drive, command, outgoing: [replace(outgoing, data=b"\xfb\x0f\x0f\x0f\xff\xff")])
    bus = SerialBus([one, two])
    bus.watch(seen.append)
    bus.send(read(1))
    heard = all_received(bus)
    assert heard == bytes(a & b for a, b in zip(reply(1), b"\xfb\x0f\x0f\x0f\xff\xff", strict=True))
    assert bus.collisions == 1
    assert any(isinstance(t, Comment) and "collision" in t.text for t in seen)
    assert one.heard[1:] == []


def test_a_host_that_does_not_wait_collides() -> None:
    one = drive(delay_ns=0)
    bus = SerialBus([one])
    bus.send(read(1))
    bus.run_until(5 * STEP)
    bus.send(read(1))
    heard = all_received(bus)
    assert bus.collisions == 1
    assert heard != reply(1)
    assert len(one.taken) == 1, "a drive is deaf while it sends"
    bus.send(read(1))
    assert all_received(bus) == reply(1)


def test_an_adapter_may_echo() -> None:
    bus = SerialBus([drive()], echo=True)
    bus.send(read(1))
    assert all_received(bus) == read(1) + reply(1)


def test_a_host_at_another_speed_gets_no_answer_and_a_listener_rubbish() -> None:
    one, two = drive(1), drive(2, baud_rate=1)
    seen: list[Traffic] = []
    bus = SerialBus([one, two], speed=38400)
    bus.watch(seen.append)
    bus.send(read(2))
    assert all_received(bus) == b""
    bus.speed = 9600
    bus.send(read(2))
    assert all_received(bus) == reply(2)
    assert [f.data for f in two.heard if f.checksum_ok] == [read(2)]
    bus.send(read(1))
    assert all_received(bus) == b""
    assert any(isinstance(t, Comment) and "the host is at 9600 baud" in t.text for t in seen)
    two.settings["baud_rate"] = 4
    bus.send(read(2))
    bus.run_until(bus.now_ns + SECOND)
    assert bus.received() == b""


@pytest.mark.parametrize("wire_time", [True, False])
def test_a_reply_to_a_change_of_speed_is_the_last_at_the_old_one(wire_time: bool) -> None:
    bus = SerialBus([drive(delay_ns=1000)], speed=38400, wire_time=wire_time)
    bus.send(build(MKS, "set_baud_rate", 1, {"baud_rate": 6}))
    assert all_received(bus) == build(MKS, "set_baud_rate", 1, {"status": 1}, Role.REPLY)
    bus.send(read(1))
    assert all_received(bus) == b""
    bus.speed = 115200
    bus.send(read(1))
    assert all_received(bus) == reply(1)


def test_a_host_without_a_speed_is_always_right() -> None:
    bus = SerialBus([drive(1, baud_rate=1), drive(2, baud_rate=7)])
    for address in (1, 2):
        bus.send(read(address))
        assert all_received(bus) == reply(address)


@pytest.mark.parametrize("settings", [{}, {"baud_rate": 9600}])
def test_a_speed_that_is_no_choice_of_a_setting(settings: dict[str, int]) -> None:
    bus = SerialBus([PlainDrive("lk-rs485", 1, **settings)], speed=settings.get("baud_rate", 115200))
    bus.send(bytes.fromhex("3E 93 01 00 D2"))
    assert all_received(bus) == bytes.fromhex("3E 93 01 00 D2")


def test_time_in_slices_changes_nothing() -> None:
    def run(slice_ns: int) -> list[Traffic]:
        seen: list[Traffic] = []
        bus = SerialBus([drive(1, delay_ns=300_000), drive(2, delay_ns=100_000)])
        bus.watch(seen.append)
        bus.send(build(MKS, "move_relative_pulses", 1, {"speed": 100, "pulses": 1000}) + read(2))
        while bus.now_ns < MOVE_NS * 2:
            bus.run_until(bus.now_ns + slice_ns)
        return seen

    assert run(MOVE_NS) == run(77_777) == run(5_000)


def test_a_drive_that_never_gets_on_is_told() -> None:
    one = drive()
    one.next_ns = lambda: 5  # type: ignore[method-assign]
    bus = SerialBus([one])
    with pytest.raises(RuntimeError, match=r"time stands still at 5 ns.*mks-rs485@1"):
        bus.run_until(SECOND)


def test_noise_between_requests_does_not_keep_a_drive_from_the_next() -> None:
    bus = SerialBus([drive()])
    for noise in (b"\xfa", b"\xfc", b"\xfa\x01", b"\x00" * 30, b"\xfb\x01\x31", b"\xfa\x01\xf6\x01\x40\x02\x33"):
        bus.send(noise + read(1))
        assert all_received(bus) == reply(1), noise.hex(" ")


def test_a_power_cycle_loses_what_was_on_its_way() -> None:
    one = drive(delay_ns=10_000_000)
    bus = SerialBus([one])
    bus.send(read(1))
    bus.run_until(5 * STEP)
    bus.power_cycle(0)
    assert all_received(bus) == b""
    bus.send(read(1)[:3])
    bus.run_until(bus.now_ns + 4 * STEP)
    bus.power_cycle(0)
    bus.send(read(1)[3:])
    assert all_received(bus) == b""
    bus.send(read(1))
    assert all_received(bus) == reply(1)


def test_a_host_that_changes_its_speed_before_the_reply_reads_rubbish() -> None:
    bus = SerialBus([drive(delay_ns=1_000_000)], speed=38400)
    bus.send(read(1))
    bus.run_until(5 * STEP)
    bus.speed = 115200
    heard = all_received(bus)
    assert len(heard) > 6
    assert reply(1) not in heard


def test_a_bus_goes_on_from_where_its_drives_are() -> None:
    one = drive()
    one.advance(SECOND)
    bus = SerialBus([one])
    assert bus.now_ns == SECOND
    bus.send(read(1))
    assert all_received(bus) == reply(1)
