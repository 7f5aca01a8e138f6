"""Homing, the way back at power-on and calibration where hands or harm come between; claims judge the rest."""

from __future__ import annotations

import pytest

from tests.conformance.drives.test_mks_rig import COUNTS, MINUTE, MS, NAMES, SECOND, Rig

#: Counts that one rpm covers in a second.
PER_SECOND = COUNTS / 60


def completions(name, *statuses):
    """Return the completion replies that a dialect has: none in Modbus."""
    return [] if name == "mks-modbus" else list(statuses)


def go_home(rig, wait_ns=MINUTE):
    first = rig.ask("home")
    return [v["status"] for v in first], [v["status"] for v in rig.wait_values(wait_ns)]


# --- with a switch ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_a_switch_pressed_and_let_go_by_hand(name):
    rig = Rig(name, home_speed=120)
    rig.drive.limit_switch("left")
    assert rig.ask("home")[0]["status"] == 1
    rig.wait(2 * SECOND)
    assert rig.value("read_speed") == (0 if name == "mks-can" else 120)
    rig = Rig(name, home_speed=120)
    rig.ask("home")
    rig.wait(SECOND)
    rig.drive.limit_switch("left")
    later = [v["status"] for v in rig.wait_values(MS)]
    assert later == completions(name, 2)
    assert rig.axis() == 0


@pytest.mark.parametrize("name", NAMES)
def test_the_trigger_level(name):
    rig = Rig(name, home_trigger=1)  # an open switch is effective
    rig.drive.place_switch("left", 0)
    assert not rig.drive.effective("left")
    rig.drive.place_switch("left", -100)
    assert rig.drive.effective("left")


@pytest.mark.parametrize("name", NAMES)
def test_homing_works_in_pulse_modes(name):
    rig = Rig(name, mode=2, home_speed=600)
    rig.drive.place_switch("left", -1000)
    assert go_home(rig)[0] == [1]
    assert rig.axis() == 0


@pytest.mark.parametrize("name", NAMES)
def test_a_locked_rotor_ends_homing_as_failed(name):
    rig = Rig(name, protection=1)
    rig.ask("home")
    rig.drive.block()
    later = [v["status"] for v in rig.wait_values(MINUTE)]
    assert later == completions(name, 0)
    assert rig.value("read_protection") == 1


# --- without a switch ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_homing_without_a_switch_against_a_hand(name):
    rig = Rig(name, home_mode=1, home_speed=60, return_angle=0x1000)
    rig.ask("home")
    rig.wait(SECOND)
    rig.drive.block()
    rig.wait(MS)
    rig.drive.block(False)
    rig.wait(MINUTE)
    assert rig.axis() == 0
    assert rig.drive.motor.position(rig.now) == pytest.approx(-COUNTS + 0x1000, abs=PER_SECOND)


# --- zero and power-on -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["mks-rs485", "mks-modbus"])
def test_no_way_back_without_a_zero_or_with_something_between(name):
    rig = Rig(name)
    assert rig.value("read_zero_status") == 1
    rig.ask("set_zero_mode", zero_mode=1, set_zero=0)
    rig.drive.power_cycle(rig.now)
    rig.wait(SECOND)
    assert rig.value("read_zero_status") == 2
    rig.ask("set_zero_mode", zero_mode=1, set_zero=1)
    rig.ask("move_relative_axis", speed=600, position=5000)
    rig.wait(SECOND)
    rig.drive.power_cycle(rig.now)
    rig.wait(rig.drive.start_ns + 20 * MS)
    rig.ask("emergency_stop")
    assert rig.value("read_zero_status") == 2
    rig.ask("set_zero_mode", zero_mode=0, set_zero=1)
    rig.drive.power_cycle(rig.now)
    rig.wait(SECOND)
    assert rig.value("read_zero_status") == 1


# --- calibration -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_calibration_that_fails(name):
    for harm in (lambda d: d.block(), lambda d: d.encoder_error()):
        rig = Rig(name)
        harm(rig.drive)
        rig.ask("calibrate")
        assert [v["status"] for v in rig.wait_values(MINUTE)] == completions(name, 2)
    rig = Rig(name)
    rig.drive.supply(8)
    assert rig.status("calibrate") == (0 if name == "mks-modbus" else 2)
    rig = Rig(name)
    rig.ask("calibrate")
    rig.ask("emergency_stop")
    assert rig.wait(MINUTE) == []
    assert rig.value("read_status") == 1
