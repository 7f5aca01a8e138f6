"""Motion of the MKS drives against a closed form of the ramp law, which is written here once more, and what hands do.

What ends, limits and replaces a motion the claims judge, of drives as the manual has them and of drives with faults.
"""

from __future__ import annotations

import random
from fractions import Fraction
from math import ceil, isqrt

import pytest

from tests.conformance.drives.test_mks_rig import COUNTS, MINUTE, MS, NAMES, SECOND, Rig

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
