"""The course of a shaft by the law: it ends where it should, and the emulated drives, which reckon on their own, agree."""

from __future__ import annotations

import pytest

from conformance.drives.mks import paths
from conformance.motion import course, ramp
from conformance.motion.course import Trend

MS = 1_000_000
TRIES = [(2.5, 300, 200), (-0.3, 300, 56), (1.0, 60, 0), (-21.0, 3000, 255)]


@pytest.mark.parametrize(("turns", "rpm", "acceleration"), TRIES)
def test_a_move_ends_where_it_should(turns, rpm, acceleration):
    found = course.move(turns, rpm, acceleration)
    assert found.steady_ns == pytest.approx(ramp.move_ns(turns, rpm, acceleration))
    end = found.steady_ns
    assert found.turns(end, end + MS) == pytest.approx((turns, turns))
    assert found.top == pytest.approx(ramp.peak(turns, rpm, acceleration))
    assert found.trends(end + 1, end + MS) == {Trend.RESTS}


@pytest.mark.parametrize(("turns", "rpm", "acceleration"), TRIES)
def test_the_drives_are_on_that_course(turns, rpm, acceleration):
    found = course.move(turns, rpm, acceleration)
    path = paths.move_path(0, 0, 0, round(turns * paths.TURN), rpm, ramp.step_ns(acceleration))
    for tenth in range(1, 10):
        at_ns = found.steady_ns * tenth / 10
        low, high = found.turns(at_ns, at_ns)
        slack = found.top * ramp.slack_ns(acceleration) / ramp.MINUTE_NS + 0.001
        assert low - slack <= float(path.position(round(at_ns))) / paths.TURN <= high + slack


def test_a_way_round_goes_through_rest():
    found = course.run(60, -120, 200)
    ends = ramp.ramp_ns(60, -120, 200)
    assert found.steady_ns == ends
    assert found.rpm(0, ends) == (-120, 60)
    assert found.trends(0, ends / 4) == {Trend.FALLS}
    assert found.trends(ends / 2, ends * 0.9) == {Trend.RISES}
    assert found.trends(ends + 1, ends + MS) == {Trend.STEADY}


def test_without_a_ramp_the_speed_is_there_at_once():
    found = course.run(0, 60, 0)
    assert found.rpm(0, 1000 * MS) == (0, 60)  # what was before may still show
    assert found.rpm(1, 1000 * MS) == (60, 60)
    assert found.turns(1000 * MS, 1000 * MS) == pytest.approx((1, 1))
