"""What an MKS drive does where the manual is silent, as far as no claim judges it; the claims judge the rest."""

from __future__ import annotations

from fractions import Fraction

import pytest

from analyzer import dialects
from analyzer.encoder import build
from tests.conformance.drives.test_mks_commands import nominal
from tests.conformance.drives.test_mks_rig import MINUTE, MS, NAMES, SECOND, Rig, frame_of, make

NATIVE, MODBUS = dialects.get("mks-rs485"), dialects.get("mks-modbus")


@pytest.mark.parametrize("name", NAMES)
def test_direction_0_is_ccw_and_ccw_raises_the_encoder(name):
    for direction, way in ((0, 1), (1, -1)):
        rig = Rig(name)
        rig.ask("run_speed", direction=direction, speed=60)
        assert rig.value("read_speed") == 60 * way
        rig.wait(SECOND)
        assert rig.axis() * way > 16000
        rig = Rig(name)
        rig.ask("move_relative_pulses", direction=direction, speed=600, pulses=3200)
        rig.wait(SECOND)
        assert rig.axis() == 16384 * way
        assert rig.value("read_pulses") == 3200 * way


def test_reserved_bits_of_a_motion_are_not_looked_at():
    rig = Rig("mks-rs485")
    (said,) = rig.send(NATIVE.link.completed(bytes.fromhex("FA 01 F6 71 40 02")))
    assert said.data == bytes.fromhex("FB 01 F6 01 F3")


@pytest.mark.parametrize("name", ["mks-rs485", "mks-can"])
def test_saving_is_answered_once_by_1(name):
    rig = Rig(name)
    rig.ask("run_speed", speed=300)
    assert rig.ask("save_speed", save_state=0xC8) == [{"status": 1}]
    assert rig.wait(MINUTE) == []


def test_a_change_of_dialect_on_the_way_leaves_the_end_untold():
    for first, second in ((NATIVE, MODBUS), (MODBUS, NATIVE)):
        for command in ("calibrate", "move_relative_axis"):
            rig = Rig(first.name)
            rig.ask(command, **({} if command == "calibrate" else {"speed": 60, "position": 50_000}))
            rig.send(build(first, "set_modbus", 1, {"modbus": int(second is MODBUS)}))
            assert rig.drive.dialect.name == second.name
            assert len(rig.wait(MINUTE)) == 0


@pytest.mark.parametrize("name", NAMES)
def test_broadcast_and_group_are_executed_and_never_answered(name):
    for command in dialects.get(name).commands:
        for address in (0, 80) if command.slots is None else ():
            alone, several = Rig(name, group_address=80), Rig(name, group_address=80)
            for rig in (alone, several):
                rig.drive.place_switch("left", -1000)
            data = build(alone.drive.dialect, command.name, 1, nominal(command))
            alone.send(data)
            alone.wait(MINUTE)
            data = build(several.drive.dialect, command.name, address, nominal(command))
            assert several.send(data, address if several.can else None) == []
            assert several.wait(MINUTE) == []
            # What it did is what it does for itself.
            assert several.drive.settings == alone.drive.settings
            assert several.drive.memory == alone.drive.memory
            assert several.drive.axis == alone.drive.axis


def test_can_takes_standard_data_frames_only():
    from msgspec.structs import replace

    drive = make("mks-can")
    link = drive.dialect.link
    frame = frame_of(drive.dialect, link.completed(b"\x31", 1), 0, 1)
    assert len(drive.receive(frame, 0)) == 1
    for kind in ("extended", "remote", "error", "fd"):
        strange = replace(frame, can=replace(frame.can, **{kind: True}))
        assert drive.receive(strange, MS) == []


def test_the_can_checksum_takes_the_whole_id():
    rig = Rig("mks-can", address=0x7F3)
    (said,) = rig.send(bytes((0x31, (0xF3 + 0x31) & 0xFF)), 0x7F3)
    assert said.can_id == 0x7F3
    assert said.data[-1] == (0xF3 + 0x31) & 0xFF


def test_a_modbus_drive_knows_no_packages():
    rig = Rig("mks-modbus")
    slot = bytes.fromhex("01 FD 02 58 00 00 00 0C 80")
    assert rig.send(NATIVE.link.completed(b"\xfc" + slot.ljust(50, b"\0")), dialect=NATIVE) == []
    rig.wait(MINUTE)
    assert rig.axis() == 0


def test_fractions_of_a_pulse_do_not_add_up():
    rig = Rig("mks-rs485")
    for _ in range(100):
        rig.ask("move_relative_pulses", speed=3000, pulses=1)
    rig.wait(SECOND)
    assert rig.value("read_pulses") == 100
    assert rig.axis() == round(100 * Fraction(16384, 3200))
