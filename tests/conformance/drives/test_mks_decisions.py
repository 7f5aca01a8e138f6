"""The decisions table of the design, row by row, and who is answered at all."""

from __future__ import annotations

from fractions import Fraction

import pytest

from analyzer import dialects
from analyzer.encoder import build
from tests.collect import crc
from tests.conformance.drives.test_mks_rig import MINUTE, MS, NAMES, SECOND, Rig, frame_of, make

NATIVE = dialects.get("mks-rs485")
MODBUS = dialects.get("mks-modbus")
SERIAL = ("mks-rs485", "mks-can")

MOVES = {
    "move_relative_pulses": {"speed": 300, "pulses": 3200},
    "move_absolute_pulses": {"speed": 300, "position": 3200},
    "move_relative_axis": {"speed": 300, "position": 16384},
    "move_absolute_axis": {"speed": 300, "position": 16384},
}
MOTIONS = {"run_speed": {"speed": 300}} | MOVES
STOPS = ("stop_speed", "stop_relative_pulses", "stop_absolute_pulses", "stop_relative_axis", "stop_absolute_axis")


def hexed(said):
    return [o.data.hex(" ").upper() for o in said]


# --- directions and speeds -------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize("name", NAMES)
def test_the_motor_direction_turns_bus_motion_on_can_alone(name):
    rig = Rig(name)
    rig.ask("set_direction", motor_direction=1)
    rig.ask("move_relative_pulses", direction=0, speed=600, pulses=3200)
    rig.wait(SECOND)
    assert rig.axis() == (-16384 if name == "mks-can" else 16384)
    assert rig.value("read_pulses") == 3200
    rig.ask("run_speed", direction=0, speed=60)
    assert rig.value("read_speed") == (-60 if name == "mks-can" else 60)
    rig.ask("move_absolute_axis", speed=600, position=0x4000)
    rig.wait(10 * SECOND)
    assert rig.axis() == 0x4000


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("subdivision", "sent", "real"),
    [(8, 1200, 2400), (16, 1200, 1200), (32, 1200, 1200), (64, 1200, 1200), (128, 1200, 150), (100, 100, 16),
     (0, 1600, 100), (2, 100, 800)],
)  # fmt: skip
def test_subdivision_and_speed(name, subdivision, sent, real):
    rig = Rig(name)
    rig.ask("set_subdivision", subdivision=subdivision)
    rig.ask("run_speed", speed=sent)
    assert rig.value("read_speed") == real
    rig.ask("stop_speed")
    rig.ask("set_zero")
    rig.ask("move_relative_pulses", speed=sent, pulses=200 * (subdivision or 256))
    rig.wait(10 * SECOND)
    assert rig.axis() == 16384


@pytest.mark.parametrize("name", NAMES)
def test_a_speed_above_the_maximum_runs_at_it_and_succeeds(name):
    limits = {5: 3000} if name == "mks-can" else {3: 400, 4: 1500, 5: 3000}
    for mode, limit in limits.items():
        for sent in (limit - 1, limit, limit + 1, 4095):
            rig = Rig(name, mode=mode)
            assert rig.status("run_speed", speed=sent) == 1
            assert rig.value("read_speed") == min(sent, limit)
            assert rig.status("move_absolute_axis", speed=sent, position=1_000_000) == 1
            assert rig.value("read_speed") == min(sent, limit)
    rig = Rig(name)
    assert rig.status("move_relative_axis", speed=0xFFFF, position=1_000_000) == 1
    assert rig.value("read_speed") == 3000


@pytest.mark.parametrize("name", NAMES)
def test_acceleration_0_is_at_once_and_255_is_50_us(name):
    rig = Rig(name)
    rig.ask("run_speed", speed=3000, acceleration=0)
    assert rig.value("read_speed") == 3000
    rig = Rig(name)
    rig.ask("run_speed", speed=3000, acceleration=255)  # 5 ms pass meanwhile
    assert rig.value("read_speed") == 100


# --- refusals --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("command", MOTIONS)
def test_motion_in_pulse_mode_disabled_or_protected_fails(name, command):
    for mode in (2, 3) if name == "mks-can" else (0, 1, 2):
        assert Rig(name, mode=mode).status(command, **MOTIONS[command]) == 0
    rig = Rig(name)
    rig.ask("enable", enabled=0)
    assert rig.status(command, **MOTIONS[command]) == 0
    rig.ask("enable", enabled=1)
    assert rig.status(command, **MOTIONS[command]) == 1
    rig.drive.protect()
    rig.wait(MS)
    assert rig.value("read_protection") == 1
    assert rig.status(command, **MOTIONS[command]) == 0
    assert rig.status("release_protection") == 1
    assert rig.value("read_protection") == 0
    assert rig.status(command, **MOTIONS[command]) == 1


def test_values_beyond_the_printed_range_of_a_motion_are_refused():
    rig = Rig("mks-can")
    assert rig.status("move_relative_axis", speed=600, position=-8388608) == 0
    assert rig.status("move_relative_axis", speed=600, position=-8388607) == 1
    rig = Rig("mks-modbus")
    assert rig.status("move_relative_axis", speed=600, position=100, acceleration=256) == 0
    assert rig.status("run_speed", direction=2, speed=600) == 0
    assert rig.status("run_speed", direction=1, speed=600, acceleration=255) == 1


def test_reserved_bits_of_a_motion_are_not_looked_at():
    rig = Rig("mks-rs485")
    assert hexed(rig.send(NATIVE.link.completed(bytes.fromhex("FA 01 F6 71 40 02")))) == ["FB 01 F6 01 F3"]


def test_refused_modbus_writes():
    rig = Rig("mks-modbus")
    assert hexed(rig.send(bytes.fromhex(crc("01 06 00 82 00 06")))) == [crc("01 06 00 82 FF FF").upper()]
    assert hexed(rig.send(bytes.fromhex(crc("01 06 00 82 01 05")))) == [crc("01 06 00 82 FF FF").upper()]
    assert rig.drive.settings["work_mode"] == 5
    home = crc("01 10 00 90 00 03 05 00 02 00 64 00")
    assert hexed(rig.send(bytes.fromhex(home))) == [crc("01 10 00 90 00 00").upper()]
    printed = crc("01 10 00 90 00 03 05 00 00 00 64 00")
    assert hexed(rig.send(bytes.fromhex(printed))) == ["01 10 00 90 00 03 80 25"]
    assert rig.drive.settings["home_speed"] == 100
    rig = Rig("mks-modbus", mode=2)
    assert hexed(rig.send(build(MODBUS, "run_speed", 1, {"speed": 60}))) == [crc("01 10 00 F6 00 00").upper()]


@pytest.mark.parametrize(
    ("frame", "reply"),
    [
        ("01 03 00 32 00 01", "01 83 01"),  # 03h is no function of the drive
        ("01 05 00 32 FF 00", "01 85 01"),
        ("01 2B 0E 01", "01 AB 01"),
        ("01 04 00 77 00 01", "01 84 02"),
        ("01 04 00 82 00 01", "01 84 02"),  # a register that can only be written
        ("01 06 00 32 00 01", "01 86 02"),  # a register that can only be read
        ("01 06 00 F6 00 01", "01 86 02"),
        ("01 10 00 82 00 01 02 00 05", "01 90 02"),
        ("01 04 00 32 00 02", "01 84 03"),
        ("01 04 00 30 00 01", "01 84 03"),
        ("01 04 00 32 00 00", "01 84 03"),
        ("01 04 00 32 00 7E", "01 84 03"),
        ("01 10 00 F6 00 02 06 00 00 00 00 00 00", "01 90 03"),
        ("01 10 00 F6 00 03 06 00 00 00 00 00 00", "01 90 03"),
        ("01 10 00 90 00 03 06 00 00 00 64 00 00", "01 90 03"),  # as the standard would have it
    ],
)
def test_exceptions(frame, reply):
    rig = Rig("mks-modbus")
    assert hexed(rig.send(bytes.fromhex(crc(frame)))) == [crc(reply).upper()]
    assert rig.send(bytes.fromhex(crc("00" + frame[2:]))) == []
    assert rig.send(bytes.fromhex(crc("02" + frame[2:]))) == []


def test_90h_has_five_bytes():
    request = build(MODBUS, "set_home", 1, {"home_speed": 100})
    assert request.hex(" ").upper().startswith("01 10 00 90 00 03 05 00 00 00 64 00")


def test_subdivision_256():
    for name, sent in (("mks-rs485", 0), ("mks-can", 0), ("mks-modbus", 256), ("mks-modbus", 0)):
        rig = Rig(name)
        assert rig.status("set_subdivision", subdivision=sent) == 1
        assert rig.drive.subdivision == 256
    rig = Rig("mks-modbus")
    assert rig.status("set_subdivision", subdivision=257) == 0


def test_stored_addresses():
    for name, highest in (("mks-rs485", 255), ("mks-modbus", 247), ("mks-can", 0x7FF)):
        rig = Rig(name)
        assert rig.status("set_address", new_address=0) == 0
        assert rig.drive.address == 1
        if name != "mks-rs485":
            assert rig.status("set_address", new_address=highest + 1) == 0
        assert len(rig.send(build(rig.drive.dialect, "set_address", 1, {"new_address": highest}))) == 1
        assert rig.drive.address == highest


# --- respond, active, completions ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SERIAL)
def test_respond_0_silences_motion_commands_only(name):
    rig = Rig(name)
    assert rig.status("set_respond", respond=0, active=1) == 1
    for command, values in MOTIONS.items():
        assert rig.ask(command, **values) == []
        assert rig.wait(MINUTE) == []
    for stop in STOPS:
        assert rig.ask(stop, acceleration=200) == []
    for other in ("read_status", "enable", "emergency_stop", "read_speed", "set_zero"):
        assert len(rig.ask(other, **({"enabled": 1} if other == "enable" else {}))) == 1
    rig.ask("set_home", home_speed=60)
    rig.drive.limit_switch("left")
    assert rig.axis() == 0
    rig.drive.limit_switch("left", False)
    rig.drive.place_switch("left", -1000)
    assert [v["status"] for v in rig.ask("home") + rig.wait_values(MINUTE)] == [1, 2]
    assert rig.judged().rules == []


@pytest.mark.parametrize("name", SERIAL)
def test_active_0_leaves_the_first_reply_alone(name):
    rig = Rig(name)
    rig.ask("set_respond", respond=1, active=0)
    for command, values in MOVES.items():
        assert rig.ask(command, **values) == [{"status": 1}]
        assert rig.wait(MINUTE) == []
    rig.ask("run_speed", speed=300)
    assert rig.ask("stop_speed", acceleration=200) == [{"status": 1}]
    assert rig.wait(MINUTE) == []
    assert rig.ask("calibrate") == [{"status": 0}]
    assert rig.wait(MINUTE) == []
    assert rig.judged().rules == []


@pytest.mark.parametrize("name", SERIAL)
def test_a_stop_in_speed_mode_is_answered_1_and_2(name):
    rig = Rig(name)
    rig.ask("run_speed", speed=300)
    assert rig.ask("stop_speed", acceleration=156) == [{"status": 1}]
    assert rig.value("read_status") == 3
    (done,) = rig.wait(10 * SECOND)
    assert rig.values(done)["status"] == 2
    assert rig.value("read_status") == 1
    rig.ask("run_speed", speed=300)
    assert rig.ask("stop_speed", acceleration=0) == [{"status": 1}, {"status": 2}]


@pytest.mark.parametrize("name", SERIAL)
def test_saving_is_answered_once_by_1(name):
    rig = Rig(name)
    rig.ask("run_speed", speed=300)
    assert rig.ask("save_speed", save_state=0xC8) == [{"status": 1}]
    assert rig.wait(MINUTE) == []


def test_modbus_sends_no_completions():
    rig = Rig("mks-modbus")
    for command, values in MOVES.items():
        assert rig.ask(command, **values) == [{"status": 1}]
        assert rig.wait(MINUTE) == []
    rig.drive.place_switch("left", -1000)
    for command in ("home", "calibrate"):
        assert rig.ask(command) == [{"status": 1}]
        assert rig.wait(MINUTE) == []


def test_a_change_of_dialect_on_the_way_leaves_the_end_untold():
    for first, second in ((NATIVE, MODBUS), (MODBUS, NATIVE)):
        for command in ("calibrate", "move_relative_axis"):
            rig = Rig(first.name)
            rig.ask(command, **({} if command == "calibrate" else {"speed": 60, "position": 50_000}))
            rig.send(build(first, "set_modbus", 1, {"modbus": int(second is MODBUS)}))
            assert rig.drive.dialect.name == second.name
            assert len(rig.wait(MINUTE)) == 0


# --- who is answered -------------------------------------------------------------------------------------------------


def every_request(name):
    """Yield (command, request values) of every command that can be sent alone."""
    from tests.conformance.drives.test_mks_commands import nominal

    for command in dialects.get(name).commands:
        if command.slots is None:
            yield command, nominal(command)


@pytest.mark.parametrize("name", NAMES)
def test_silence_for_others_and_for_damage(name):
    for command, values in every_request(name):
        rig = Rig(name)
        before = dict(rig.drive.settings)
        dialect = rig.drive.dialect
        good = build(dialect, command.name, 1, values)
        elsewhere = build(dialect, command.name, 2, values)
        assert rig.send(elsewhere, 2 if rig.can else None) == []
        for place in range(len(good)):
            damaged = bytearray(good)
            damaged[place] ^= 0x10
            assert rig.send(bytes(damaged)) == []
        assert rig.send(good[:-1] + bytes(((good[-1] + 1) & 0xFF,))) == []
        rig.wait(SECOND)
        assert rig.drive.settings == before
        assert rig.axis() == 0


@pytest.mark.parametrize("name", NAMES)
def test_broadcast_and_group_are_executed_and_never_answered(name):
    for command, values in every_request(name):
        for address in (0, 80):
            alone, several = Rig(name, group_address=80), Rig(name, group_address=80)
            for rig in (alone, several):
                rig.drive.place_switch("left", -1000)
            data = build(alone.drive.dialect, command.name, 1, values)
            alone.send(data)
            alone.wait(MINUTE)
            data = build(several.drive.dialect, command.name, address, values)
            assert several.send(data, address if several.can else None) == []
            assert several.wait(MINUTE) == []
            # What it did is what it does for itself.
            assert several.drive.settings == alone.drive.settings
            assert several.drive.memory == alone.drive.memory
            assert several.drive.axis == alone.drive.axis


def test_heads_other_than_fa_are_not_heard():
    for head in (0xFB, 0xF9, 0x00):
        rig = Rig("mks-rs485")
        assert rig.send(NATIVE.link.completed(bytes((head, 1, 0x31)))) == []


def test_unknown_codes_and_lengths_are_not_answered():
    rig = Rig("mks-rs485")
    for code in range(256):
        if code not in NATIVE.by_code:
            assert rig.send(NATIVE.link.completed(bytes((0xFA, 1, code)))) == []
            assert rig.send(NATIVE.link.completed(bytes((0xFA, 1, code, 1)))) == []
    assert rig.send(NATIVE.link.completed(bytes.fromhex("FA 01 82 05 05"))) == []
    assert rig.send(NATIVE.link.completed(bytes.fromhex("FA 01 31 00"))) == []
    can = Rig("mks-can")
    link = can.drive.dialect.link
    assert can.send(link.completed(bytes.fromhex("82 05 05"), 1)) == []
    assert can.send(b"") == []
    assert can.send(b"\x01") == []


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


# --- packages --------------------------------------------------------------------------------------------------------


def package(*slots):
    body = b"".join(bytes.fromhex(s).ljust(10, b"\0") for s in slots).ljust(50, b"\0")
    return NATIVE.link.completed(b"\xfc" + body)


TURN = "FD 02 58 00 00 00 0C 80"
HALF = "FD 02 58 00 00 00 06 40"


def run_package(data, address=1, **options):
    rig = Rig("mks-rs485", address=address, **options)
    assert rig.send(data) == []
    assert rig.wait(MINUTE) == []
    return rig


def test_a_slot_is_executed_by_its_own_address_and_never_answered():
    data = package("02 " + HALF, "01 " + TURN, "03 " + HALF)
    assert run_package(data).axis() == 16384
    assert run_package(data, 3).axis() == 8192
    assert run_package(data, 4).axis() == 0
    assert run_package(package("01 82 03")).drive.settings["work_mode"] == 3


def test_of_two_slots_for_one_address_the_first_is_executed():
    assert run_package(package("01 " + TURN, "01 " + HALF)).axis() == 16384
    assert run_package(package("01 31", "01 " + HALF)).axis() == 0
    assert run_package(package("", "", "01 " + HALF, "", "01 " + TURN)).axis() == 8192


def test_broadcast_and_group_do_not_reach_into_slots():
    assert run_package(package("00 " + TURN), group_address=80).axis() == 0
    assert run_package(package("50 " + TURN), group_address=80).axis() == 0


def test_a_package_has_exactly_52_bytes_and_a_good_sum():
    good = package("01 " + TURN)
    assert run_package(good).axis() == 16384
    assert run_package(good[:-1] + bytes((good[-1] ^ 1,))).axis() == 0
    for short in (good[:50] + good[-1:], good[:49] + good[-1:], good[:11] + good[-1:]):
        assert NATIVE.link.checks(short)[0].ok
        assert run_package(short).axis() == 0
    assert run_package(good[:-1] + b"\0" + good[-1:]).axis() == 0


def test_a_modbus_drive_knows_no_packages():
    rig = Rig("mks-modbus")
    assert rig.send(package("01 " + TURN), dialect=NATIVE) == []
    rig.wait(MINUTE)
    assert rig.axis() == 0


def test_fractions_of_a_pulse_do_not_add_up():
    rig = Rig("mks-rs485")
    for _ in range(100):
        rig.ask("move_relative_pulses", speed=3000, pulses=1)
    rig.wait(SECOND)
    assert rig.value("read_pulses") == 100
    assert rig.axis() == round(100 * Fraction(16384, 3200))
