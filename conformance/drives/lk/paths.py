r"""Paths of a shaft in closed form: angle, speed and acceleration at any time, without steps.

    speed ^    ____________            Ramps: stretches of constant acceleration, as a speed or position loop drives
          |   /            \
          |  /              \
          +--------------------> time
    speed ^      ___________  level    Lag: a constant torque against friction, as a torque or open loop drives
          |   .-'
          |  /
          +--------------------> time

Angles are degrees, speeds deg/s, accelerations deg/s2, times seconds since the path began; clockwise is positive.

Rules kept here:
- A path is a function of time alone. Times may be asked for in any order.
- `Ramps` ends exactly at its target; a reached position has no rounding error.
- A move is the fastest within its acceleration and top speed, also from a turning shaft. A shaft that turns the wrong way,
  or too fast to stop in time, brakes first and comes back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol


class Motion(NamedTuple):
    """Where a shaft is (deg), how fast it turns (deg/s) and how hard it accelerates (deg/s2)."""

    angle: float
    speed: float
    acceleration: float


class Stretch(NamedTuple):
    """A time (s) with one acceleration (deg/s2)."""

    seconds: float
    acceleration: float


class Path(Protocol):
    """A motion as a function of time."""

    @property
    def seconds(self) -> float:
        """The time after which speed and acceleration no longer change; infinite where they always do."""

    def at(self, seconds: float) -> Motion:
        """Return the motion `seconds` (>= 0) after the path began."""


@dataclass(frozen=True)
class Still:
    """A shaft that something holds."""

    angle: float
    seconds: float = 0.0

    def at(self, seconds: float) -> Motion:
        """Return the angle, without speed."""
        return Motion(self.angle, 0.0, 0.0)


@dataclass(frozen=True)
class Ramps:
    """Stretches of constant acceleration, then `final_speed` for ever; `rest`: the exact angle of their end."""

    angle: float
    speed: float
    stretches: tuple[Stretch, ...]
    final_speed: float = 0.0
    rest: float | None = None

    @cached_property
    def seconds(self) -> float:
        return sum(s.seconds for s in self.stretches)

    @cached_property
    def end(self) -> float:
        """The angle at the end of the stretches."""
        return self._walk(self.seconds).angle if self.rest is None else self.rest

    def at(self, seconds: float) -> Motion:
        over = seconds - self.seconds
        if over >= 0:
            return Motion(self.end + self.final_speed * over, self.final_speed, 0.0)
        return self._walk(seconds)

    def _walk(self, seconds: float) -> Motion:
        angle, speed, acceleration = self.angle, self.speed, 0.0
        for stretch in self.stretches:
            t = min(seconds, stretch.seconds)
            acceleration = stretch.acceleration
            angle += speed * t + acceleration * t * t / 2
            speed += acceleration * t
            seconds -= t
            if seconds <= 0 and t < stretch.seconds:
                break
        return Motion(angle, speed, acceleration)


@dataclass(frozen=True)
class Lag:
    """A shaft that runs after a level, the speed at which the torque given and friction balance.

    speed' = (level - speed) / lag. The level goes from `begin` to `end` (deg/s) by `slope` (deg/s per s, 0: at once),
    then stays; `lag` in seconds.
    """

    angle: float
    speed: float
    begin: float
    end: float
    slope: float
    lag: float
    seconds: float = math.inf

    def at(self, seconds: float) -> Motion:
        """Return the motion at a time."""
        rising = abs(self.end - self.begin) / self.slope if self.slope else 0.0
        slope = math.copysign(self.slope, self.end - self.begin)
        if seconds < rising:
            return self._follow(self.angle, self.speed, self.begin, slope, seconds)
        angle, speed = self.angle, self.speed
        if rising:
            angle, speed, _ = self._follow(angle, speed, self.begin, slope, rising)
        return self._follow(angle, speed, self.end, 0.0, seconds - rising)

    def _follow(self, angle: float, speed: float, level: float, slope: float, t: float) -> Motion:
        """Solve the equation for a level that rises by `slope` from `level`."""
        behind = slope * self.lag  # how far a shaft that has settled in stays behind a rising level
        decay = math.exp(-t / self.lag)
        gap = speed - level + behind
        return Motion(
            angle + (level - behind) * t + slope * t * t / 2 + gap * self.lag * (1.0 - decay),
            level + slope * t - behind + gap * decay,
            slope - gap * decay / self.lag,
        )


def speed_change(speed: float, target: float, acceleration: float) -> tuple[Stretch, ...]:
    """Return the stretches from one speed to another; `acceleration` > 0."""
    if speed == target:
        return ()
    return (Stretch(abs(target - speed) / acceleration, math.copysign(acceleration, target - speed)),)


def move(distance: float, speed: float, top: float, acceleration: float) -> tuple[Stretch, ...]:
    """Return the stretches of the fastest move by `distance` that ends at rest.

    `speed`: at the start; `top` > 0 bounds the speed on the way (a faster start brakes down to it first);
    `acceleration` > 0.
    """
    braking = speed * abs(speed) / (2 * acceleration)  # where the shaft comes to rest if it brakes now
    side = 1.0 if distance >= braking else -1.0
    distance, speed = distance * side, speed * side
    if speed > top:
        cruise = (distance - speed * speed / (2 * acceleration)) / top
        stretches = [
            Stretch((speed - top) / acceleration, -acceleration),
            Stretch(cruise, 0.0),
            Stretch(top / acceleration, -acceleration),
        ]
    else:
        peak = min(top, math.sqrt(max(0.0, acceleration * distance + speed * speed / 2)))
        ramps = (2 * peak * peak - speed * speed) / (2 * acceleration)
        stretches = [
            Stretch((peak - speed) / acceleration, acceleration),
            Stretch((distance - ramps) / peak if peak == top else 0.0, 0.0),
            Stretch(peak / acceleration, -acceleration),
        ]
    return tuple(Stretch(s.seconds, s.acceleration * side) for s in stretches if s.seconds > 0)
