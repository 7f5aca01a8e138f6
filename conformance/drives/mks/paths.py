"""Paths: the target position of a shaft at any time, exact, without simulation steps.

    speed  ^      ____                    the ramp law: one rpm more (or less) every `step_ns`; a ramp is a staircase
           |    _|    |_                  0, 1, 2, ... whose first step waits: speed 1 comes after one `step_ns`
           |  _|        |_
           |_|            |____> time

A path has a few segments: staircases and constant speeds; the last segment has no end. Position, speed and the time of a
position follow in closed form, for a move of any length.

Rules kept here:
- Times are ns, speeds rpm, positions parts of a turn (`TURN`): so small that rpm x ns is a whole number of them. All are
  integers or Fractions; nothing is rounded.
- A move ends exactly at its target. It climbs to the highest step that leaves room to slow down by one rpm per step. The
  rest of the distance passes at that top speed.
- A path that is too fast to stop at its target passes it, stops, and comes back.
- `step_ns` 0: speeds change at once.

Not emulated: inertia, resonance, overshoot of the control loop and settling. The shaft is always at its target position.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from fractions import Fraction
from math import ceil

from analyzer.protocols.mks_shared import RAMP

Number = int | Fraction

#: Parts of one turn in which positions are counted: 2**14 counts, and 8 parts for one rpm in one ns.
TURN = 480_000_000_000
#: Parts that one rpm covers in one ns.
RPM_NS = TURN // 60_000_000_000


class Phase(StrEnum):
    """What a shaft is doing on a stretch of its path."""

    STANDING = "standing"
    SPEEDING_UP = "speeding_up"
    FULL_SPEED = "full_speed"
    SLOWING_DOWN = "slowing_down"


def ramp_step_ns(acceleration: int) -> int:
    """Return the time of one rpm for an acceleration as sent: 0 is at once, else the less the higher it is."""
    return 0 if acceleration == 0 else (RAMP.steps - acceleration) * RAMP.unit_ns


def ramp_ns(start: Number, end: Number, step_ns: int) -> int:
    """Return how long a speed takes from one value to another; through zero it is two ramps."""
    if start * end < 0:
        return ramp_ns(start, 0, step_ns) + ramp_ns(0, end, step_ns)
    return ceil(size(end - start)) * step_ns


def ramp_distance(start: Number, end: Number, step_ns: int) -> Number:
    """Return the parts of a turn that a ramp between speeds of one sign covers."""
    steps = ceil(size(end - start))
    sign = 1 if end > start else -1
    return RPM_NS * step_ns * (steps * start + sign * (steps * (steps - 1) // 2))


def size(number: Number) -> Number:
    """Return a number without its sign."""
    return number if number >= 0 else -number


def divided(number: Number, divisor: Number) -> Number:
    """Return an exact quotient, as an integer where it is one."""
    if isinstance(number, int) and isinstance(divisor, int):
        whole, rest = divmod(number, divisor)
        if not rest:
            return whole
    quotient = Fraction(number) / divisor
    return quotient.numerator if quotient.denominator == 1 else quotient


@dataclass(frozen=True, slots=True)
class Segment:
    """A stretch of a path: from `start`, at `position`, with `speed` that changes by `step` every `step_ns`.

    `stop` None: without end.
    """

    start: Number
    position: Number
    speed: Number
    step: int
    step_ns: int
    stop: Number | None
    phase: Phase

    @property
    def way(self) -> int:
        """The sign of its motion, 0 where it stands."""
        fastest = self.speed or self.step
        return (fastest > 0) - (fastest < 0)

    def position_at(self, t: Number) -> Number:
        """Return the position at a time within the segment."""
        elapsed = t - self.start
        if not self.step:
            return self.position + RPM_NS * self.speed * elapsed
        done = elapsed // self.step_ns
        walked = (done * self.speed + self.step * (done * (done - 1) // 2)) * self.step_ns
        return self.position + RPM_NS * (walked + (self.speed + self.step * done) * (elapsed - done * self.step_ns))

    def speed_at(self, t: Number) -> Number:
        """Return the speed at a time within the segment."""
        return self.speed + self.step * ((t - self.start) // self.step_ns) if self.step else self.speed

    def when(self, position: Number) -> Number:
        """Return the time at which a position that the segment reaches is reached."""
        if not self.step:
            return self.start + divided(position - self.position, RPM_NS * self.speed)
        assert self.stop is not None  # only constant speeds are without end
        way = self.way
        low, high = 0, int((self.stop - self.start) // self.step_ns)
        while low < high:  # the last step that begins before the position
            middle = (low + high + 1) // 2
            before = (self.position_at(self.start + middle * self.step_ns) - position) * way < 0
            low, high = (middle, high) if before else (low, middle - 1)
        begin = self.start + low * self.step_ns
        left = position - self.position_at(begin)
        return begin + divided(left, RPM_NS * self.speed_at(begin)) if left else begin


class Path:
    """Where a shaft is meant to be, from the start of its first segment on without end."""

    __slots__ = ("segments",)

    def __init__(self, segments: Iterable[Segment]) -> None:
        self.segments = tuple(segments)

    def at(self, t: Number) -> Segment:
        """Return the segment that holds at a time; before the first, that one."""
        for segment in reversed(self.segments):
            if segment.start <= t:
                return segment
        return self.segments[0]

    def position(self, t: Number) -> Number:
        """Return the position at a time, in parts of a turn."""
        segment = self.at(t)
        return segment.position_at(max(t, segment.start))

    def speed(self, t: Number) -> Number:
        """Return the speed at a time, in rpm; positive is the way of growing positions."""
        segment = self.at(t)
        return segment.speed_at(max(t, segment.start))

    def phase(self, t: Number) -> Phase:
        """Return what the shaft is doing at a time."""
        return self.at(t).phase

    @property
    def settled(self) -> Number:
        """The time from which on the speed stays as it is: a move has arrived, a run has its speed."""
        return self.segments[-1].start

    def first_beyond(self, position: Number, way: int, after: Number) -> Number | None:
        """Return the first time, not before `after`, at which the path moves the given way at or beyond a position."""
        for segment in self.segments:
            if segment.stop is not None and segment.stop <= after:
                continue
            if segment.way != way:
                continue
            begin = max(segment.start, after)
            if (segment.position_at(begin) - position) * way >= 0:
                return begin
            if segment.stop is None or (segment.position_at(segment.stop) - position) * way >= 0:
                return segment.when(position)
        return None


class _Course:
    """Collects the segments of a path, from a time, a position and a speed on."""

    def __init__(self, t: Number, position: Number, speed: Number) -> None:
        self.t, self.position, self.speed = t, position, speed
        self.segments: list[Segment] = []

    def _add(self, step: int, step_ns: int, stop: Number | None, phase: Phase) -> None:
        self.segments.append(Segment(self.t, self.position, self.speed, step, step_ns, stop, phase))

    def ramp(self, speed: Number, step_ns: int) -> None:
        """Change the speed by the law, by way of zero if it changes its sign."""
        if speed * self.speed < 0:
            self.ramp(0, step_ns)
        if speed == self.speed:
            return
        if step_ns:
            up = speed > self.speed
            stop = self.t + ramp_ns(self.speed, speed, step_ns)
            phase = Phase.SPEEDING_UP if size(speed) > size(self.speed) else Phase.SLOWING_DOWN
            self._add(1 if up else -1, step_ns, stop, phase)
            self.position += ramp_distance(self.speed, speed, step_ns)
            self.t = stop
        self.speed = speed

    def keep(self, duration: Number, phase: Phase) -> None:
        """Go on at the speed for a time."""
        if duration:
            stop = self.t + duration
            self._add(0, 0, stop, phase)
            self.position += RPM_NS * self.speed * duration
            self.t = stop

    def path(self) -> Path:
        """Return the path, which goes on for good at the speed it has come to."""
        self._add(0, 0, None, Phase.FULL_SPEED if self.speed else Phase.STANDING)
        return Path(self.segments)

    def approach(self, target: Number, cruise: Number, step_ns: int) -> None:
        """Go to a position and stand there."""
        distance = target - self.position
        away = distance * self.speed <= 0
        if self.speed and (away or size(ramp_distance(self.speed, 0, step_ns)) > size(distance)):
            self.ramp(0, step_ns)
            distance = target - self.position
        if distance:
            self._reach(size(distance), 1 if distance > 0 else -1, cruise, step_ns)
        self.position, self.speed = target, 0

    def _reach(self, distance: Number, way: int, cruise: Number, step_ns: int) -> None:
        """Cover a distance from a speed of the same way, from which it is long enough to stop."""
        speed = size(self.speed)
        if speed > cruise:
            slowing = ramp_distance(speed, cruise, step_ns)
            if distance < slowing + ramp_distance(cruise, 0, step_ns):
                cruise = speed  # only just long enough to stop: there is no room for a slower stretch
            else:
                self.ramp(way * cruise, step_ns)
                distance, speed = distance - slowing, cruise
        peak = self._peak(speed, cruise, distance, step_ns)
        climb = ramp_distance(speed, peak, step_ns)
        # The way down begins with one step at the top: it belongs to the stay there, which takes what is left.
        below = max(peak - 1, 0)
        descent = ramp_distance(below, 0, step_ns)
        self.ramp(way * peak, step_ns)
        phase = Phase.FULL_SPEED if peak == cruise else Phase.SLOWING_DOWN
        self.keep(divided(distance - climb - descent, RPM_NS * peak), phase)
        if step_ns:
            self.speed = way * below
        self.ramp(0, step_ns)

    @staticmethod
    def _peak(speed: Number, cruise: Number, distance: Number, step_ns: int) -> Number:
        """Return the highest speed on the way up from which a distance still leaves room for the way down."""
        low, high = 0, ceil(cruise - speed)
        if not step_ns:
            return cruise
        while low < high:
            middle = (low + high + 1) // 2
            peak = min(speed + middle, cruise)
            fits = ramp_distance(speed, peak, step_ns) + ramp_distance(peak, 0, step_ns) <= distance
            low, high = (middle, high) if fits else (low, middle - 1)
        return min(speed + low, cruise) or min(1, cruise)


def rest_path(t: Number, position: Number) -> Path:
    """Return the path of a shaft that stands."""
    return _Course(t, position, 0).path()


def run_path(t: Number, position: Number, speed: Number, wanted: Number, step_ns: int) -> Path:
    """Return the path to a speed, and on at it; `wanted` 0 is a stop."""
    course = _Course(t, position, speed)
    course.ramp(wanted, step_ns)
    return course.path()


def move_path(t: Number, position: Number, speed: Number, target: Number, cruise: Number, step_ns: int) -> Path:
    """Return the path to a position, at most at `cruise` rpm (greater than 0), from a speed that may be any."""
    course = _Course(t, position, speed)
    course.approach(target, cruise, step_ns)
    return course.path()
