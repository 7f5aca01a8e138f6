"""Motion of the MKS drives through their frames, against a closed form of the ramp law that is written here once more."""

from __future__ import annotations

import random
from fractions import Fraction
from math import ceil, isqrt

import pytest

from tests.conformance.drives.test_mks_rig import COUNTS, MINUTE, MS, NAMES, SECOND, Rig

SERIAL = ("mks-rs485", "mks-can")
#: Counts of one rpm in one ns.
RATE = Fraction(COUNTS, 60 * 10**9)


# --- the law, once more ----------------------------------------------------------------------------------------------


def step(acceleration):
    return (256 - acceleration) * 50_000


class Move:
    """A move from rest to rest over so many counts: duration (ns), position and speed at a time since it began."""

    def __init__(self, counts, cruise, acceleration):
        self.counts, self.cruise = counts, cruise
        self.dt = step(acceleration) if acceleration else 0
        area = Fraction(counts) / RATE
        if not self.dt:
            self.top, self.duration = cruise, area / cruise
        else:
            self.top = max(1, min(cruise, isqrt(int(area / self.dt))))
            at_top = (area - self.top * (self.top - 1) * self.dt) / self.top
            self.duration = (2 * self.top - 1) * self.dt + at_top

    def position(self, t):
        """Count from the beginning on the way up, and from the end on the way down."""
        if t >= self.duration:
            return Fraction(self.counts)
        if not self.dt:
            return t * self.cruise * RATE
        steps, left = t // self.dt, self.duration - t
        if steps < self.top:
            return (Fraction(steps * (steps - 1), 2) * self.dt + steps * (t - steps * self.dt)) * RATE
        below = ceil(left / self.dt)
        if below < self.top:
            rest = Fraction(below * (below - 1), 2) * self.dt + below * (left - (below - 1) * self.dt)
            return self.counts - rest * RATE
        up = Fraction(self.top * (self.top - 1), 2) * self.dt
        return (up + self.top * (t - self.top * self.dt)) * RATE

    def speed(self, t):
        if t >= self.duration:
            return 0
        if not self.dt:
            return self.cruise
        return min(t // self.dt, self.top, ceil((self.duration - t) / self.dt))


CASES = [
    (16384, 600, 2), (-16384, 600, 2), (16384 * 100, 3000, 255), (-5000, 60, 0), (123_456, 777, 200), (7, 3000, 128),
    (8_000_000, 3000, 1), (-8_388_607, 1500, 250), (1, 1, 1), (40_960, 3000, 236),
]  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("counts", "speed", "acceleration"), CASES)
def test_position_speed_and_time_of_a_move_are_those_of_the_ramp_law(name, counts, speed, acceleration):
    rig = Rig(name)
    law = Move(abs(counts), speed, acceleration)
    way = 1 if counts > 0 else -1
    begin = rig.now
    values = {"speed": speed, "acceleration": acceleration, "position": counts}
    assert rig.ask("move_relative_axis", **values)[0]["status"] == 1
    chance = random.Random(counts)
    polls = sorted(begin + 10 * MS + int(chance.random() * float(law.duration) * 1.05) for _ in range(40))
    completed = [o.at_ns for o in rig.heard[1:]]
    for t in polls:
        if t < rig.now:
            continue
        completed += [o.at_ns for o in rig.wait(t - rig.now)]
        since = rig.now - begin
        assert abs(rig.drive.axis - way * law.position(since)) <= 1
        assert abs(float(rig.drive.motor.speed(rig.now)) - way * law.speed(since)) <= 0.01 * law.speed(since)
    completed += [o.at_ns for o in rig.wait(10 * MINUTE)]
    assert rig.axis() == counts
    if name != "mks-modbus":
        expected = max(begin + ceil(law.duration), begin + rig.drive.reply_delay_ns)
        assert completed == [expected]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("acceleration", [0, 1, 128, 236, 255])
def test_the_ramp_of_a_run_and_of_its_stop(name, acceleration):
    rig = Rig(name)
    begin = rig.now
    rig.send_at("run_speed", speed=500, acceleration=acceleration, direction=1)
    dt = step(acceleration) if acceleration else 0
    for t in range(0, 500 * dt + 200 * MS, max(dt, 7 * MS)):
        rig.wait(begin + t - rig.now)
        reached = min(500, t // dt) if dt else 500
        (said,) = rig.send_at("read_speed")
        assert rig.values(said, command="read_speed")["speed"] == -reached
        (said,) = rig.send_at("read_status")
        assert rig.values(said, command="read_status")["status"] == (4 if reached == 500 else 2)
    at = rig.drive.axis
    rig.send_at("stop_speed", acceleration=acceleration)
    rig.wait(500 * dt)
    way = sum(rpm * dt for rpm in range(1, 501)) * RATE
    assert abs(at - rig.drive.axis - way) <= 1
    assert rig.value("read_speed") == 0
    assert rig.value("read_status") == 1


# --- kinds of moves --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_four_position_modes(name):
    rig = Rig(name)
    for command, values, axis, pulses in (
        ("move_relative_pulses", {"pulses": 3200, "direction": 0}, 16384, 3200),
        ("move_relative_pulses", {"pulses": 1600, "direction": 1}, 8192, 1600),
        ("move_absolute_pulses", {"position": -3200}, -16384, -3200),
        ("move_absolute_pulses", {"position": 0x4000}, 83886, 0x4000),
        ("move_relative_axis", {"position": -83886}, 0, 0),
        ("move_absolute_axis", {"position": -0x4000}, -0x4000, -3200),
        ("move_absolute_axis", {"position": -0x4000}, -0x4000, -3200),
        ("move_absolute_pulses", {"position": 0}, 0, 0),
    ):
        assert rig.ask(command, speed=600, acceleration=250, **values)[0]["status"] == 1
        later = [v["status"] for v in rig.wait_values(MINUTE)]
        assert later in ([], [2])
        assert rig.axis() == axis
        assert rig.value("read_pulses") == pulses
    assert rig.judged().rules == []


@pytest.mark.parametrize("name", NAMES)
def test_absolute_means_from_the_zero(name):
    rig = Rig(name)
    rig.ask("move_relative_axis", speed=3000, position=10_000)
    rig.wait(SECOND)
    rig.ask("set_zero")
    assert (rig.axis(), rig.value("read_pulses")) == (0, 0)
    rig.ask("move_absolute_axis", speed=3000, position=-500)
    rig.wait(SECOND)
    assert rig.axis() == -500
    rig.ask("move_absolute_pulses", speed=3000, position=0)
    rig.wait(SECOND)
    assert rig.axis() == 0


@pytest.mark.parametrize("name", SERIAL)
def test_a_newer_motion_takes_the_place_of_the_older(name):
    rig = Rig(name)
    assert rig.ask("move_relative_axis", speed=600, acceleration=250, position=100_000) == [{"status": 1}]
    rig.wait(200 * MS)
    assert rig.ask("move_relative_pulses", speed=600, acceleration=250, pulses=3200, direction=1) == [{"status": 1}]
    rig.wait(100 * MS)
    assert rig.ask("move_absolute_axis", speed=600, acceleration=250, position=5000) == [{"status": 1}]
    assert [v["status"] for v in rig.wait_values(MINUTE)] == [2]
    assert rig.axis() == 5000
    assert rig.ask("move_relative_axis", speed=600, acceleration=250, position=100_000) == [{"status": 1}]
    rig.ask("run_speed", speed=60)
    assert rig.wait(MINUTE) == []
    assert rig.judged().rules == []


@pytest.mark.parametrize("name", SERIAL)
def test_what_is_refused_leaves_the_older_motion_alone(name):
    rig = Rig(name)
    rig.ask("move_relative_axis", speed=600, acceleration=250, position=100_000)
    assert rig.status("set_work_mode", work_mode=9) == 0
    assert [v["status"] for v in rig.wait_values(MINUTE)] == [2]
    assert rig.axis() == 100_000


@pytest.mark.parametrize("name", NAMES)
def test_mode_4_takes_new_targets_and_speeds_on_the_way(name):
    rig = Rig(name)
    rig.ask("move_absolute_axis", speed=300, acceleration=254, position=100_000)
    rig.wait(400 * MS)
    assert rig.value("read_speed") == 300
    rig.ask("move_absolute_axis", speed=900, acceleration=254, position=400_000)
    slowest = min(rig.value("read_speed") for _ in range(20))
    assert slowest >= 300
    rig.wait(200 * MS)
    assert rig.value("read_speed") == 900
    rig.ask("move_absolute_axis", speed=900, acceleration=254, position=0)
    rig.wait(MINUTE)
    assert rig.axis() == 0
    assert rig.value("read_status") == 1


@pytest.mark.parametrize("name", SERIAL)
@pytest.mark.parametrize(
    ("move", "stop"),
    [
        ("move_relative_pulses", "stop_relative_pulses"), ("move_absolute_pulses", "stop_absolute_pulses"),
        ("move_relative_axis", "stop_relative_axis"), ("move_absolute_axis", "stop_absolute_axis"),
    ],
)  # fmt: skip
def test_stops_of_moves(name, move, stop):
    for acceleration in (0, 200):
        rig = Rig(name)
        distance = {"pulses": 320_000} if "relative_pulses" in move else {"position": 1_000_000}
        rig.ask(move, speed=600, acceleration=255, **distance)
        rig.wait(SECOND)
        begin = rig.now
        first = rig.send_at(stop, acceleration=acceleration)
        done = rig.wait(10 * SECOND)
        assert [rig.values(o, command=stop)["status"] for o in first + done] == [1, 2]
        expected = begin + 600 * step(200) if acceleration else begin + rig.drive.reply_delay_ns
        assert (first + done)[1].at_ns == expected
        assert rig.value("read_speed") == 0
        assert rig.wait(MINUTE) == []  # the move's own completion is not sent
        assert rig.judged().rules == []


@pytest.mark.parametrize("name", SERIAL)
def test_a_stop_of_a_shaft_that_stands_is_done_at_once(name):
    rig = Rig(name)
    assert rig.ask("stop_relative_axis", acceleration=5) == [{"status": 1}, {"status": 2}]
    assert rig.ask("move_relative_axis", speed=300, position=0) in ([{"status": 1}, {"status": 2}],)
    assert rig.ask("move_relative_axis", speed=0, position=500) == [{"status": 1}, {"status": 2}]
    assert rig.axis() == 0


@pytest.mark.parametrize("name", NAMES)
def test_emergency_stop_and_disabling_end_without_a_completion(name):
    for command, values in (("emergency_stop", {}), ("enable", {"enabled": 0})):
        rig = Rig(name)
        rig.ask("move_relative_axis", speed=600, position=100_000)
        assert rig.ask(command, **values) == [{"status": 1}]
        at = rig.axis()
        assert rig.value("read_speed") == 0
        assert rig.wait(MINUTE) == []
        assert rig.axis() == at
        assert rig.judged().rules == []


@pytest.mark.parametrize("name", NAMES)
def test_a_run_is_kept_for_power_on(name):
    rig = Rig(name)
    rig.ask("run_speed", speed=120, direction=1, acceleration=255)
    assert rig.status("save_speed", save_state=0xC8) == 1
    rig.ask("stop_speed")
    rig.drive.power_cycle(rig.now)
    rig.wait(SECOND)
    assert rig.value("read_speed") == -120
    assert rig.status("save_speed", save_state=0xCA) == 1
    assert rig.status("save_speed", save_state=0xC9) == 0
    rig.drive.power_cycle(rig.now)
    rig.wait(SECOND)
    assert rig.value("read_speed") == 0


# --- limits ----------------------------------------------------------------------------------------------------------


def homed(name, **options):
    rig = Rig(name, **options)
    rig.drive.place_switch("left", -20_000)
    rig.drive.place_switch("right", 30_000)
    rig.ask("set_home", home_speed=600, end_limit=1)
    rig.ask("set_limit_remap", limit_remap=1)
    rig.ask("home")
    rig.wait(MINUTE)
    rig.ask("enable", enabled=1)
    assert rig.axis() == 0
    return rig


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("side", "way"), [("left", -1), ("right", 1)])
def test_end_limits_stop_a_move_at_the_switch(name, side, way):
    rig = homed(name)
    place = 0 if side == "left" else 50_000
    if side == "left":
        rig.ask("move_absolute_axis", speed=600, position=20_000)
        rig.wait(MINUTE)
    first = rig.ask("move_relative_axis", speed=600, acceleration=250, position=way * 100_000)
    later = rig.wait_values(MINUTE)
    assert [v["status"] for v in first + later] == ([1] if name == "mks-modbus" else [1, 3])
    assert abs(rig.axis() - place) <= 1
    # No longer to that side, but to the other one.
    again = rig.ask("move_relative_axis", speed=600, position=way * 1000)
    assert [v["status"] for v in again] == ([1] if name == "mks-modbus" else [1, 3])
    assert abs(rig.axis() - place) <= 1
    assert rig.status("run_speed", speed=60, direction=0 if way > 0 else 1) == 0
    assert rig.status("run_speed", speed=60, direction=1 if way > 0 else 0) == 1
    rig.wait(SECOND)
    assert (rig.axis() - place) * way < -10_000
    assert rig.judged().rules in ([], ["failed_status"], ["refused_write"])


@pytest.mark.parametrize("name", NAMES)
def test_a_run_at_a_speed_stops_at_a_limit_without_a_word(name):
    rig = homed(name)
    assert rig.status("run_speed", speed=600, direction=0) == 1
    assert rig.wait(MINUTE) == []
    assert abs(rig.axis() - 50_000) <= 1
    assert rig.value("read_speed") == 0


@pytest.mark.parametrize("name", NAMES)
def test_a_limit_pressed_by_hand(name):
    rig = homed(name)
    rig.ask("move_relative_axis", speed=60, position=40_000)
    rig.wait(SECOND)
    rig.drive.limit_switch("right")
    rig.wait(MS)
    assert rig.value("read_speed") == 0
    assert 0 < rig.axis() < 20_000


@pytest.mark.parametrize("name", NAMES)
def test_limits_hold_only_after_homing_and_only_where_there_is_a_port(name):
    rig = Rig(name, end_limit=1)
    rig.drive.place_switch("right", 10_000)
    rig.ask("move_absolute_axis", speed=600, position=20_000)
    rig.wait(SECOND)
    assert rig.axis() == 20_000
    rig = homed(name)
    rig.ask("set_limit_remap", limit_remap=0)
    rig.drive.settings["limits_homed"] = 1
    rig.ask("move_absolute_axis", speed=600, position=60_000)
    rig.wait(MINUTE)
    assert rig.axis() == 60_000  # a 42 has no right limit without the remap
    rig = homed(name)
    rig.ask("set_home", home_speed=500, end_limit=1)
    rig.ask("move_absolute_axis", speed=600, position=60_000)
    rig.wait(MINUTE)
    assert rig.axis() == 60_000  # changed, and not homed since


# --- locked rotor ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_a_locked_rotor_lets_go_when_the_error_exceeds_the_tolerance(name):
    rig = Rig(name, protection=1)
    rig.ask("move_relative_axis", speed=60, position=100_000)
    rig.wait(500 * MS)
    rig.drive.block()
    at = rig.axis()
    rig.wait(400 * MS)
    assert rig.value("read_protection") == 0
    said = rig.wait_values(200 * MS)
    assert [v["status"] for v in said] == ([] if name == "mks-modbus" else [0])
    assert rig.value("read_protection") == 1
    assert rig.value("read_speed") == 0
    assert rig.value("read_angle_error") == 0
    rig.drive.block(False)
    rig.drive.turn_shaft(100)
    assert rig.axis() == at + 100  # the shaft is free
    assert rig.status("move_relative_axis", speed=60, position=100) == 0
    assert rig.status("release_protection") == 1
    assert rig.status("move_relative_axis", speed=60, position=100) == 1
    rig.wait(SECOND)
    assert rig.axis() == at + 200


def test_the_stall_tolerance_of_can():
    for tolerance, counts in ((0x64, 8192), (0xC8, 16384), (1, 82), (0, 0)):
        rig = Rig("mks-can", stall_tolerance=tolerance)
        rig.drive.block()
        rig.ask("run_speed", speed=1)
        rig.wait(int(counts / float(RATE)) - 60 * MS if counts else 0)
        assert rig.value("read_protection") == int(not counts)
        rig.wait(100 * MS)
        assert rig.value("read_protection") == 1


@pytest.mark.parametrize("name", NAMES)
def test_without_protection_a_blocked_shaft_falls_behind(name):
    rig = Rig(name, protection=0)
    rig.drive.block()
    first = rig.ask("move_relative_axis", speed=60, position=50_000)
    assert rig.wait(MINUTE) == []  # not there, so not complete
    assert first == [{"status": 1}]
    assert rig.value("read_angle_error") == round(50_000 * 51200 / 16384)
    rig.drive.block(False)
    said = rig.wait_values(MS)
    assert [v["status"] for v in said] == ([] if name == "mks-modbus" else [2])
    assert rig.axis() == 50_000


@pytest.mark.parametrize("name", NAMES)
def test_supply_and_encoder(name):
    for harm, mend in (
        (lambda d: d.supply(9.0), lambda d: d.supply(24.0)),
        (lambda d: d.encoder_error(), lambda d: d.encoder_error(False)),
    ):
        rig = Rig(name)
        rig.ask("run_speed", speed=60)
        harm(rig.drive)
        assert rig.value("read_speed") == 0
        assert rig.status("run_speed", speed=60) == 0
        if name == "mks-can":
            assert rig.ask("read_io")[0]["alm"] == 0
        mend(rig.drive)
        assert rig.status("run_speed", speed=60) == 1
    open_loop = Rig(name, mode=4 if name == "mks-can" else 3)
    open_loop.drive.encoder_error()
    assert open_loop.status("run_speed", speed=60) == 1
    rig = Rig(name)
    rig.drive.supply(0)
    assert rig.ask("read_speed") == []
    assert rig.drive.next_ns() is None
    rig.drive.supply(24)
    rig.wait(SECOND)
    assert rig.value("read_speed") == 0
    rig.drive.hot(90)
    assert rig.value("read_speed") == 0


@pytest.mark.parametrize("name", NAMES)
def test_how_time_is_told_changes_nothing(name):
    """One jump or many steps: the same replies at the same times."""

    def story(steps):
        rig = homed(name)
        rig.ask("move_relative_axis", speed=300, acceleration=200, position=30_000)
        for _ in range(steps):
            rig.drive.advance(rig.now)
            rig.wait(2 * SECOND // steps)
        rig.ask("run_speed", speed=100, direction=1)
        for _ in range(steps):
            rig.wait(4 * SECOND // steps)
        return [(o.at_ns, o.data) for o in rig.heard], rig.drive.axis

    assert story(1) == story(100)
