"""The wall clock is watched and never followed, and times of a log never go back."""

from __future__ import annotations

import time

from analyzer.events import checked
from analyzer.live.clock import DRIFT_EVERY_NS, STEP_NS, LogClock, Now, WallClock, now

START = Now(1_000, 1_700_000_000_000_000_000, 5_000)
SECOND = 1_000_000_000


def at(seconds, *, wall=0, slept=0):
    """The clocks so much later; `wall`, `slept`: what was added to them, in nanoseconds."""
    passed = int(seconds * SECOND)
    return Now(START.monotonic_ns + passed, START.wall_ns + passed + wall + slept, START.boot_ns + passed + slept)


def test_a_moment_is_the_same_on_all_clocks():
    before = time.monotonic_ns(), time.time_ns()
    moment = now()
    after = time.monotonic_ns(), time.time_ns()
    assert before[0] <= moment.monotonic_ns <= after[0]
    assert before[1] <= moment.wall_ns <= after[1]
    assert moment.boot_ns >= moment.monotonic_ns - SECOND


def test_a_clock_that_runs_is_nothing_to_tell_but_its_drift_once_a_minute():
    clock = WallClock(START)
    told = [(second, change) for second in range(1, 131) for change in clock.look(at(second, wall=second * 1000))]
    assert [(second, c.event, c.about) for second, c in told] == [
        (60, "clock_drift", {"offset_ns": 60_000}),
        (120, "clock_drift", {"offset_ns": 120_000}),
    ]
    assert DRIFT_EVERY_NS == 60 * SECOND


def test_a_clock_that_is_set_is_told_with_how_far():
    clock = WallClock(START)
    clock.look(at(1))
    for step in (3600 * SECOND, -2 * SECOND, STEP_NS + 1):
        fresh = WallClock(START)
        assert [(c.event, c.about) for c in fresh.look(at(1, wall=step))] == [
            ("clock_step", {"step_ns": step, "cause": "the wall clock was set"})
        ]
        assert fresh.look(at(2, wall=step)) == [], "told once"
    assert WallClock(START).look(at(1, wall=STEP_NS)) == []


def test_how_far_a_clock_was_set_can_be_read_back_from_a_log():
    # A machine without a battery begins in 1970, and a log has times up to 2262.
    longest_ns = (2262 - 1970) * 365 * 86_400 * SECOND
    assert checked({"step": longest_ns / SECOND}) == ({"step": longest_ns / SECOND}, [])


def test_a_machine_that_slept_is_told_apart():
    (change,) = WallClock(START).look(at(1, slept=600 * SECOND))
    assert change.about == {"step_ns": 600 * SECOND, "cause": "the machine slept"}


def test_times_of_a_log_never_go_back_and_what_came_late_is_told():
    clock = LogClock(START.monotonic_ns, START.wall_ns)
    seen = [clock.at(START.monotonic_ns + each) for each in (5_000_000, 4_000_000, 6_000_000, 2_000_000, 7_000_000)]
    assert [each - START.wall_ns for each in seen] == [5_000_000, 5_000_000, 6_000_000, 6_000_000, 7_000_000]
    assert clock.monotonic_ns == START.monotonic_ns + 7_000_000
    # A millisecond is jitter.
    assert (clock.moved, clock.moved_ns) == (1, 4_000_000)
    assert clock.notes == ["1 record arrived up to 4 ms late; their times were moved forward"]


def test_a_log_in_order_has_no_note_and_goes_on_where_another_process_stood():
    clock = LogClock(START.monotonic_ns, START.wall_ns)
    assert clock.notes == []
    clock.restore(START.wall_ns + SECOND, (3, 8_000_000))
    assert clock.at(START.monotonic_ns + SECOND - 1) == START.wall_ns + SECOND
    assert clock.notes == ["3 records arrived up to 8 ms late; their times were moved forward"]
