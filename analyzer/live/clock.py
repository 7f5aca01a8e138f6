"""Clocks of a recording: one that all times are told on, and the others that are watched and never followed.

    monotonic   CLOCK_MONOTONIC: the one that counts; every process of this machine reads the same value
    wall        UTC as the machine believes it: anchors a recording once, at its start
    boot        CLOCK_BOOTTIME where there is one: goes on while the machine sleeps, so it tells a sleep from a set clock

Rules: the anchor is one moment on both clocks, taken as tightly as the machine allows. A wall clock that is set or slewed
afterwards changes no time in a log; it is reported (`WallClock`). Times of a log never go back (`LogClock`). No I/O, and no
clock is read but by `now`.
"""

from __future__ import annotations

import time
from typing import NamedTuple

from analyzer.errors import UsageError
from analyzer.values import counted

#: A wall clock that has moved by more than this within one look, against the monotonic one, was set.
STEP_NS = 10_000_000
#: How often drift is told.
DRIFT_EVERY_NS = 60_000_000_000
#: A record that comes this much later than its place is counted as late.
_LATE_NS = 1_000_000
#: Pairs read for an anchor; the fastest reading counts.
_TRIES = 16


class Now(NamedTuple):
    """One moment on each clock, in nanoseconds; `boot_ns` equals `monotonic_ns` where there is no such clock."""

    monotonic_ns: int
    wall_ns: int
    boot_ns: int


class Change(NamedTuple):
    """What the wall clock did: an event of the recording. `event`: `clock_step` or `clock_drift`."""

    event: str
    about: dict[str, int | str]


def now() -> Now:
    """Return this moment: the tightest of several readings, so that being interrupted between two clocks does not count."""
    best: tuple[int, Now] | None = None
    for _ in range(_TRIES):
        first = time.monotonic_ns()
        wall = time.time_ns()
        boot = _boot_ns()
        last = time.monotonic_ns()
        if best is None or last - first < best[0]:
            middle = first + (last - first) // 2
            best = (last - first, Now(middle, wall, middle if boot is None else boot))
    assert best is not None
    return best[1]


def _boot_ns() -> int | None:
    number = getattr(time, "CLOCK_BOOTTIME", None)
    return None if number is None else time.clock_gettime_ns(number)


def checked_utc(wall_ns: int) -> int:
    """Return a time of the wall clock. Raises UsageError for one of which no recording goes on: before 1970, or from 2116."""
    # The upper half of what a log can hold is left, as in a checkpoint: readers of logs take such times for damage.
    if not 0 <= wall_ns < 1 << 62:
        raise UsageError(f"this computer's clock is {wall_ns // 10**9} s from 1970: set it to a time before 2116")
    return wall_ns


class WallClock:
    """Watches the wall clock from `start` on. `look` says what it has done since the look before."""

    def __init__(self, start: Now) -> None:
        self._start = start
        self._last = start
        self._told_ns = start.monotonic_ns

    def look(self, at: Now) -> list[Change]:
        """Return the changes since the last look, which was about a second ago: steps, and the drift once a minute."""
        changes = []
        last, self._last = self._last, at
        span = at.monotonic_ns - last.monotonic_ns
        step = at.wall_ns - last.wall_ns - span
        if abs(step) > STEP_NS:
            slept = at.boot_ns - last.boot_ns - span
            cause = "the machine slept" if abs(step - slept) <= STEP_NS else "the wall clock was set"
            changes.append(Change("clock_step", {"step_ns": step, "cause": cause}))
        if at.monotonic_ns - self._told_ns >= DRIFT_EVERY_NS:
            self._told_ns = at.monotonic_ns
            offset = at.wall_ns - self._start.wall_ns - (at.monotonic_ns - self._start.monotonic_ns)
            changes.append(Change("clock_drift", {"offset_ns": offset}))
        return changes


class LogClock:
    """The log's time (UTC, ns) of records, which never goes back. The arguments are one moment on both clocks."""

    def __init__(self, monotonic_ns: int, utc_ns: int) -> None:
        self._shift_ns = utc_ns - monotonic_ns
        #: The time of the last record.
        self.now_ns = utc_ns
        #: Records that came too late for their place, and by how much at most.
        self.moved = self.moved_ns = 0

    @property
    def monotonic_ns(self) -> int:
        """The time of the last record on the monotonic clock."""
        return self.now_ns - self._shift_ns

    def at(self, t_ns: int) -> int:
        """Go on to a record of a monotonic time; return its time in the log."""
        utc_ns = t_ns + self._shift_ns
        if utc_ns < self.now_ns:
            if utc_ns < self.now_ns - _LATE_NS:
                self.moved += 1
                self.moved_ns = max(self.moved_ns, self.now_ns - utc_ns)
            return self.now_ns
        self.now_ns = utc_ns
        return utc_ns

    def restore(self, now_ns: int, moved: tuple[int, int]) -> None:
        """Go on where another process stood."""
        self.now_ns = now_ns
        self.moved, self.moved_ns = moved

    @property
    def notes(self) -> list[str]:
        """Notes about the times: how many records came late, and by how much."""
        if not self.moved:
            return []
        late = f"{counted(self.moved, 'record')} arrived up to {self.moved_ns / 1e6:.0f} ms late"
        return [f"{late}; their times were moved forward"]
