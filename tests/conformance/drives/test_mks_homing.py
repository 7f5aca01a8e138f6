"""Homing with and without a switch, the way back at power-on, calibration, and what comes between."""

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
@pytest.mark.parametrize(("direction", "way"), [(0, -1), (1, 1)])
def test_home_is_where_the_switch_closes(name, direction, way):
    rig = Rig(name)
    rig.ask("set_home", home_speed=120, home_direction=direction)
    rig.drive.place_switch("left", way * 10_000)
    assert rig.ask("home")[0]["status"] == 1
    assert rig.value("read_status") == 5
    assert rig.value("read_speed") == way * 120
    later = [v["status"] for v in rig.wait_values(MINUTE)]
    assert later == completions(name, 2)
    assert rig.value("read_status") == 1
    assert (rig.axis(), rig.value("read_pulses")) == (0, 0)
    rig.ask("move_absolute_axis", speed=600, position=-way * 10_000)
    rig.wait(MINUTE)
    assert rig.drive.motor.position(rig.now) == pytest.approx(0, abs=1)
    assert rig.judged().rules == []


@pytest.mark.parametrize("name", NAMES)
def test_the_time_of_homing_is_that_of_its_speed(name):
    rig = Rig(name, home_speed=100)
    rig.drive.place_switch("left", -10_000)
    begin = rig.now
    rig.send_at("home")
    due = rig.drive.next_ns()
    assert (due - begin) / 1e9 == pytest.approx(10_000 / (100 * PER_SECOND), rel=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_from_a_closed_switch_it_backs_off_first(name):
    rig = Rig(name, home_speed=120)
    rig.drive.place_switch("left", 5000)  # closed at once, on the side of lower counts
    rig.drive.place_switch("left", 5000)
    assert rig.drive.effective("left")
    rig.ask("home")
    assert rig.value("read_speed") == 120  # the other way
    rig.wait(MINUTE)
    assert rig.axis() == 0
    # RS485 backs off until the switch opens, CAN by the return angle; both end where it closes.
    assert rig.drive.motor.position(rig.now) == pytest.approx(5000, abs=1)


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
def test_with_the_end_limit_homing_lets_the_shaft_go_on_rs485(name):
    rig = Rig(name, home_speed=600, end_limit=1)
    rig.drive.place_switch("left", -1000)
    assert go_home(rig)[1] == completions(name, 2)
    assert rig.value("read_enabled") == int(name == "mks-can")
    rig = Rig(name, home_speed=600, end_limit=0)
    rig.drive.place_switch("left", -1000)
    go_home(rig)
    assert rig.value("read_enabled") == 1


@pytest.mark.parametrize("name", NAMES)
def test_homing_that_cannot_begin(name):
    assert go_home(Rig(name, home_speed=0))[0] == [0]
    rig = Rig(name)
    rig.ask("enable", enabled=0)
    assert go_home(rig)[0] == [0]
    rig = Rig(name)
    rig.drive.protect()
    rig.wait(MS)
    assert go_home(rig)[0] == [0]


@pytest.mark.parametrize("name", NAMES)
def test_homing_runs_at_the_real_speed_of_the_mode(name):
    rig = Rig(name, home_speed=1200, subdivision=8)
    rig.ask("home")
    assert rig.value("read_speed") == -2400
    if name != "mks-can":
        rig = Rig(name, mode=3, home_speed=1200)
        rig.ask("home")
        assert rig.value("read_speed") == -400


@pytest.mark.parametrize("name", NAMES)
def test_homing_works_in_pulse_modes(name):
    rig = Rig(name, mode=2, home_speed=600)
    rig.drive.place_switch("left", -1000)
    assert go_home(rig)[0] == [1]
    assert rig.axis() == 0


@pytest.mark.parametrize("name", NAMES)
def test_what_comes_during_homing(name):
    rig = Rig(name)
    rig.ask("home")
    assert rig.status("emergency_stop") == 1
    assert rig.value("read_status") == 1
    assert rig.wait(MINUTE) == []
    rig.ask("home")
    rig.ask("stop_speed")
    assert rig.value("read_status") == 1
    rig.ask("home")
    assert rig.status("set_current", current=800) == 1
    assert rig.value("read_status") == 5
    assert rig.status("move_relative_axis", speed=600, position=100) == 1
    rig.wait(SECOND)
    assert rig.value("read_status") == 1
    assert rig.judged().rules == []


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
@pytest.mark.parametrize("angle", [0x2000, 0x4000, 0])
def test_homing_without_a_switch_goes_back_from_the_obstacle(name, angle):
    rig = Rig(name, home_mode=1, home_speed=300, return_angle=angle)
    rig.drive.obstruct("left", -30_000)
    first, later = go_home(rig)
    assert first == [1]
    assert later == completions(name, 2)
    assert rig.axis() == 0
    assert rig.drive.motor.position(rig.now) == pytest.approx(-30_000 + angle, abs=1)
    assert rig.value("read_enabled") == 1


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
@pytest.mark.parametrize(
    ("mode", "direction", "place", "way"),
    [(1, 0, 4000, -1), (1, 1, 4000, 1), (2, 0, 4000, -1), (2, 1, 4000, -1), (2, 0, -4000, 1), (1, 0, 0, 0)],
)  # fmt: skip
def test_the_way_back_to_zero_at_power_on(name, mode, direction, place, way):
    rig = Rig(name)
    rig.drive.motor.jump(0, 3000)
    values = {"zero_mode": mode, "set_zero": 1, "zero_speed": 1, "zero_direction": direction}
    assert rig.status("set_zero_mode", **values) == 1
    rig.ask("move_relative_axis", speed=600, position=place)
    rig.wait(SECOND)
    rig.drive.power_cycle(rig.now)
    rig.wait(rig.drive.start_ns + 20 * MS)
    if way:
        assert rig.value("read_zero_status") == 0
        assert rig.value("read_speed") == way * 60
    rig.wait(MINUTE)
    assert rig.value("read_zero_status") == 1
    assert rig.axis() == 0
    assert rig.drive.motor.position(rig.now) % COUNTS == 3000


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


@pytest.mark.parametrize("name", NAMES)
def test_set_zero_does_not_disturb_a_move(name):
    rig = Rig(name)
    rig.ask("move_relative_axis", speed=600, position=100_000)
    rig.wait(SECOND)
    at = rig.axis()
    rig.ask("set_zero")
    rig.wait(MINUTE)
    assert rig.axis() == pytest.approx(100_000 - at, abs=2000)
    assert rig.value("read_status") == 1


# --- calibration -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_calibration_takes_time_and_ends_where_it_began(name):
    rig = Rig(name)
    begin = rig.now
    first = rig.ask("calibrate")
    assert first == ([{"status": 1}] if name == "mks-modbus" else [{"status": 0}])
    assert rig.value("read_status") == 6
    for command in ("run_speed", "move_relative_axis"):
        assert rig.status(command, speed=60, **({} if "run" in command else {"position": 5})) == 0
    assert rig.status("home") == 0
    assert rig.status("set_current", current=500) == 1
    said = rig.wait(MINUTE)
    assert [rig.values(o)["status"] for o in said] == completions(name, 1)
    assert all(o.at_ns == begin + rig.drive.calibration_ns for o in said)
    assert rig.value("read_status") == 1
    assert rig.axis() == 0


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
