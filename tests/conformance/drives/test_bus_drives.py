"""Real drives on one wire in virtual time: what several of them, two dialects and noise make of each other."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.encoder import build
from analyzer.link import MORE
from conformance.drives.can_bus import CanBus
from conformance.drives.drive import Drive
from conformance.drives.make import make, parse
from conformance.drives.receiver import PAUSE_NS
from conformance.drives.serial_bus import SerialBus

NATIVE, MODBUS, LK, CAN = (dialects.get(n) for n in ("mks-rs485", "mks-modbus", "lk-rs485", "mks-can"))
SECOND = 1_000_000_000


def drives(*texts: str) -> list[Drive]:
    return [make(parse(text)) for text in texts]


def asked(bus: SerialBus, data: bytes, timeout_ns: int = SECOND) -> bytes:
    bus.send(data)
    bus.run_until(bus.now_ns + timeout_ns)
    return bus.received()


def test_the_package_reaches_five_drives_and_none_answers() -> None:
    bus = SerialBus(drives(*(f"mks-rs485@{i},work_mode=sr_vfoc" for i in range(1, 7))))
    runs = [{"address": i, "command": "run_speed", "speed": 100 * i, "acceleration": 0} for i in range(1, 6)]
    assert asked(bus, build(NATIVE, "long_package", 0, {"slots": runs})) == b""
    for address in range(1, 7):
        speed = 100 * address if address < 6 else 0
        answer = build(NATIVE, "read_speed", address, {"speed": speed}, Role.REPLY)
        assert asked(bus, build(NATIVE, "read_speed", address)) == answer
    assert bus.collisions == 0


def test_a_broadcast_reaches_all_and_none_answers() -> None:
    bus = SerialBus(drives("mks-rs485@1,work_mode=5", "mks-rs485@2,work_mode=5"))
    assert asked(bus, build(NATIVE, "run_speed", 0, {"speed": 300, "acceleration": 0})) == b""
    for address in (1, 2):
        answer = build(NATIVE, "read_speed", address, {"speed": 300}, Role.REPLY)
        assert asked(bus, build(NATIVE, "read_speed", address)) == answer


def test_a_drive_that_changes_its_dialect_hears_the_new_one_alone() -> None:
    bus = SerialBus(drives("mks-rs485@1", "mks-rs485@2"))
    native, modbus = build(NATIVE, "read_speed", 1), build(MODBUS, "read_speed", 1)
    assert asked(bus, modbus) == b""
    done = build(NATIVE, "set_modbus", 1, {"status": 1}, Role.REPLY)
    assert asked(bus, build(NATIVE, "set_modbus", 1, {"modbus": 1})) == done
    assert asked(bus, native) == b""
    assert asked(bus, modbus) == build(MODBUS, "read_speed", 1, {}, Role.REPLY)
    assert asked(bus, build(NATIVE, "read_speed", 2)) == build(NATIVE, "read_speed", 2, {}, Role.REPLY)
    asked(bus, build(MODBUS, "set_modbus", 1, {"modbus": 0}))
    assert asked(bus, native) == build(NATIVE, "read_speed", 1, {}, Role.REPLY)


def test_dialects_share_a_wire() -> None:
    bus = SerialBus(drives("mks-rs485@1", "mks-modbus@2", "lk-rs485@3,baud=38400"), speed=38400)
    for _ in range(3):
        assert asked(bus, build(NATIVE, "read_speed", 1)) == build(NATIVE, "read_speed", 1, {}, Role.REPLY)
        assert asked(bus, build(MODBUS, "read_speed", 2)) == build(MODBUS, "read_speed", 2, {}, Role.REPLY)
        assert asked(bus, build(LK, "clear_turns", 3)) == build(LK, "clear_turns", 3, {}, Role.REPLY)


def test_an_address_change_is_heard_by_the_next_frame() -> None:
    bus = SerialBus(drives("mks-rs485@1"))
    done = build(NATIVE, "set_address", 1, {"status": 1}, Role.REPLY)
    assert asked(bus, build(NATIVE, "set_address", 1, {"new_address": 9})) == done
    assert asked(bus, build(NATIVE, "read_speed", 1)) == b""
    assert asked(bus, build(NATIVE, "read_speed", 9)) == build(NATIVE, "read_speed", 9, {}, Role.REPLY)


def test_an_lk_drive_answers_a_quarter_of_a_millisecond_after_the_last_byte() -> None:
    bus = SerialBus(drives("lk-rs485@1"))
    gone_ns = bus.send(build(LK, "clear_turns", 1))
    answer = bus.receive(SECOND)
    assert answer is not None
    assert answer.t_ns is not None
    assert answer.t_ns - gone_ns == pytest.approx(250_000 + 5 * 10 * SECOND / 115200, abs=100)


def test_a_can_group_runs_and_stays_silent() -> None:
    bus = CanBus(drives("mks-can@1,work_mode=bus_closed,group_address=80", "mks-can@2,work_mode=bus_closed"))
    bus.send(80, build(CAN, "run_speed", 80, {"speed": 100, "acceleration": 0}))
    bus.run_until(SECOND)
    assert bus.received() == []
    for address, speed in ((1, 100), (2, 0)):
        bus.send(address, build(CAN, "read_speed", address))
        bus.run_until(bus.now_ns + SECOND)
        [frame] = bus.received()
        assert frame.data == build(CAN, "read_speed", address, {"speed": speed}, Role.REPLY)


READS = {
    "mks-rs485": (build(NATIVE, "read_speed", 1), build(NATIVE, "read_speed", 1, {}, Role.REPLY)),
    "mks-modbus": (build(MODBUS, "read_speed", 1), build(MODBUS, "read_speed", 1, {}, Role.REPLY)),
    "lk-rs485": (build(LK, "read_single_turn", 1), build(LK, "read_single_turn", 1, {}, Role.REPLY)),
}
HEADS = b"\xfa\xfb\xfc\x3e\x01\x04\x06\x10"
noise = st.lists(st.one_of(st.binary(max_size=12), st.lists(st.sampled_from(HEADS), max_size=6).map(bytes)), max_size=5)


@pytest.mark.parametrize("dialect", READS)
@given(bursts=noise, wait_ns=st.sampled_from([0, 100_000, 3_000_000, 60_000_000]))
@settings(max_examples=150, derandomize=True)
def test_after_any_noise_and_a_pause_the_next_request_is_answered(dialect: str, bursts: list[bytes], wait_ns: int) -> None:
    request, reply = READS[dialect]
    known = dialects.get(dialect)
    slicer = known.link.slicer(known.commands, lambda address, function: 0)
    whole = b"".join(bursts)
    frames = [i for i in range(len(whole)) if slicer.look(whole, i, len(whole), True) not in (0, MORE)]
    # Noise may be a frame by chance, and then the drive may do what it says.
    bus = SerialBus(drives(f"{dialect}@1"))
    for burst in bursts:
        bus.send(burst)
        bus.run_until(bus.now_ns + wait_ns)
    bus.run_until(bus.now_ns + 2 * PAUSE_NS + SECOND)
    bus.received()
    heard = asked(bus, request, 20 * SECOND)
    assert heard.startswith(reply) or frames
