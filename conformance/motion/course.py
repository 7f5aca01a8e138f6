"""The course of a shaft by the ramp law: how fast it turns and how far it has come, at times that are known within a span.

    course = run(0, -120, acceleration=200)      from rest to 120 rpm downwards, and on
    course = move(2.5, 300, 200)                 two and a half turns, at 300 rpm at most, to rest
    course.rpm(0, 40 * MS)                       the least and the greatest speed in the first 40 ms

Rules kept here:
- Speeds are rpm with the sign of the way, ways are turns, times ns from the begin of the motion.
- A time is a span: what is asked for is the range of a value in it. The law itself is exact; who asks knows the uncertainty.
- A way round goes through rest: the shaft slows down, then it speeds up.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise
from math import copysign, inf

from conformance.motion import ramp

Span = tuple[float, float]


class Trend(Enum):
    """What a shaft does."""

    RESTS = "rests"
    RISES = "speeds up"
    FALLS = "slows down"
    STEADY = "turns at full speed"


@dataclass(frozen=True)
class _Leg:
    """A straight part of a course. `turns`: where it begins."""

    begins_ns: float
    lasts_ns: float
    first: float
    last: float
    turns: float

    def rpm(self, at_ns: float) -> float:
        done = (at_ns - self.begins_ns) / self.lasts_ns if 0 < self.lasts_ns < inf else 0.0
        return self.first + (self.last - self.first) * min(1.0, max(0.0, done))

    def place(self, at_ns: float) -> float:
        passed_ns = min(max(0.0, at_ns - self.begins_ns), self.lasts_ns)
        return self.turns + (self.first + self.rpm(self.begins_ns + passed_ns)) / 2 * passed_ns / ramp.MINUTE_NS

    @property
    def trend(self) -> Trend:
        if self.first == self.last:
            return Trend.STEADY if self.first else Trend.RESTS
        return Trend.RISES if abs(self.last) > abs(self.first) else Trend.FALLS


@dataclass(frozen=True)
class Course:
    """Legs one behind the other; the last one lasts for ever."""

    legs: tuple[_Leg, ...]

    def rpm(self, first_ns: float, last_ns: float) -> Span:
        """Return the least and the greatest speed in a span of time."""
        found = [leg.rpm(at_ns) for leg, at_ns in self._ends(first_ns, last_ns)]
        return min(found), max(found)

    def turns(self, first_ns: float, last_ns: float) -> Span:
        """Return the lowest and the highest place in a span of time, from where the course began."""
        found = [leg.place(at_ns) for leg, at_ns in self._ends(first_ns, last_ns)]
        return min(found), max(found)

    def trends(self, first_ns: float, last_ns: float) -> frozenset[Trend]:
        """Return what the shaft does in a span of time."""
        return frozenset(leg.trend for leg, _ in self._ends(first_ns, last_ns))

    @property
    def steady_ns(self) -> float:
        """When the last leg begins: at its speed, or at rest."""
        return self.legs[-1].begins_ns

    @property
    def top(self) -> float:
        """The greatest speed, without its sign."""
        return max(max(abs(leg.first), abs(leg.last)) for leg in self.legs)

    def _ends(self, first_ns: float, last_ns: float) -> Iterator[tuple[_Leg, float]]:
        """Yield the legs of a span with the times at which each begins and ends in it."""
        first_ns = max(0.0, first_ns)
        last_ns = max(first_ns, last_ns)
        for leg in self.legs:
            ends_ns = leg.begins_ns + leg.lasts_ns
            if leg.begins_ns <= last_ns and ends_ns >= first_ns:
                yield leg, max(leg.begins_ns, first_ns)
                yield leg, min(ends_ns, last_ns)


def run(first: float, last: float, acceleration: int) -> Course:
    """Return the course from one speed to another; 0 is a stop."""
    speeds = (first, 0.0, last) if first * last < 0 else (first, last)
    return _course([(a, b, ramp.ramp_ns(a, b, acceleration)) for a, b in pairwise(speeds)])


def move(turns: float, speed: float, acceleration: int) -> Course:
    """Return the course of a move from rest to rest, `speed` > 0 rpm."""
    top = copysign(ramp.peak(turns, speed, acceleration), turns)
    lasts_ns = ramp.ramp_ns(0, top, acceleration)
    along_ns = (abs(turns) - 2 * abs(ramp.ramp_turns(0, top, acceleration))) / abs(top) * ramp.MINUTE_NS if top else 0.0
    return _course([(0.0, top, lasts_ns), (top, top, max(0.0, along_ns)), (top, 0.0, lasts_ns)])


def _course(parts: list[tuple[float, float, float]]) -> Course:
    legs: list[_Leg] = []
    at_ns = turns = 0.0
    for first, last, lasts_ns in (part for part in parts if part[2] or part[0] != part[1]):
        legs.append(_Leg(at_ns, lasts_ns, first, last, turns))
        at_ns, turns = at_ns + lasts_ns, legs[-1].place(at_ns + lasts_ns)
    last = parts[-1][1]
    return Course((*legs, _Leg(at_ns, inf, last, last, turns)))
