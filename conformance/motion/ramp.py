"""The ramp law of the MKS drives, as the manual prints it: what a run, a stop or a move should take, and how sure that is.

    acceleration a, 1..255      the speed changes by 1 rpm every (256 - a) x 50 us
    acceleration 0              the speed changes at once

    speed |    ______          a trapezoid where the way is long enough, else a triangle
          |  _/      |_
          |_/          |___ time

Its two numbers are the catalogue's. What follows from them is worked out here and once more by the emulated drives: the claims
compare the two.

Rules kept here:
- Speeds are rpm of the shaft, distances turns, times ns. The law is taken as a straight line; the manual's staircase of
  1 rpm lies within one step of it, and `slack_ns` says how much that can matter.
- Nothing is rounded; a comparison (`Judgement`) is a ratio with an uncertainty, never a bare yes or no.

Not known here: inertia, load, and how long a control loop takes to settle.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from math import sqrt

from analyzer.protocols.mks_shared import RAMP
from conformance.talk.noise import CLOCK_SHARE

MINUTE_NS = 60_000_000_000
#: What real drives were seen to lag behind the law at most (quirk ramp-4-percent-slow).
SLOW_QUIRK = 0.05


def step_ns(acceleration: int) -> int:
    """Return the time of one rpm for an acceleration as sent (0..255); 0 where speeds change at once."""
    if not 0 <= acceleration < RAMP.steps:
        raise ValueError(f"acceleration {acceleration}, expected 0..{RAMP.steps - 1}")
    return (RAMP.steps - acceleration) * RAMP.unit_ns if acceleration else 0


def ramp_ns(begin: float, end: float, acceleration: int) -> float:
    """Return how long the shaft takes from one speed to another (rpm, signed)."""
    return abs(end - begin) * step_ns(acceleration)


def ramp_turns(begin: float, end: float, acceleration: int) -> float:
    """Return how far the shaft goes meanwhile, in turns, signed."""
    return (begin + end) / 2 * ramp_ns(begin, end, acceleration) / MINUTE_NS


def peak(turns: float, speed: float, acceleration: int) -> float:
    """Return the highest speed (rpm) that a move from rest to rest comes to."""
    step = step_ns(acceleration)
    if not step:
        return speed
    return min(speed, sqrt(abs(turns) * MINUTE_NS / step))


def move_ns(turns: float, speed: float, acceleration: int) -> float:
    """Return how long a move from rest to rest takes, `speed` > 0 rpm."""
    top = peak(turns, speed, acceleration)
    if not turns or not top:
        return 0.0
    ramps = 2 * ramp_turns(0, top, acceleration)
    return 2 * ramp_ns(0, top, acceleration) + max(0.0, abs(turns) - ramps) / top * MINUTE_NS


def slack_ns(acceleration: int, ramps: int = 1) -> float:
    """Return by how much a staircase of 1 rpm can differ from the straight line: one step for each ramp."""
    return float(ramps * step_ns(acceleration))


class Fit(Enum):
    """How a measured time compares with the law."""

    GOOD = "good"
    SLOW_AS_SEEN = "a little slower, as real drives were seen to be"
    FAST = "too fast"
    SLOW = "too slow"
    BLIND = "too uncertain to say"


@dataclass(frozen=True)
class Judgement:
    """A measured time beside that of the law. `spread_ns`: half of the span in which the true time lies."""

    measured_ns: float
    law_ns: float
    spread_ns: float
    #: Beyond this share of uncertainty nothing is said.
    blind: float = 0.2

    @property
    def ratio(self) -> float:
        """Measured over law."""
        return self.measured_ns / self.law_ns if self.law_ns else float("inf")

    @property
    def spread(self) -> float:
        """The uncertainty of the ratio."""
        return self.spread_ns / self.law_ns if self.law_ns else float("inf")

    @property
    def fit(self) -> Fit:
        """How the two compare: within what a clock may be off and the uncertainty they agree."""
        excess, spread = self.ratio - 1, self.spread
        if excess > SLOW_QUIRK + spread:
            return Fit.SLOW
        if excess < -CLOCK_SHARE - spread:
            return Fit.FAST
        if spread > self.blind:
            return Fit.BLIND
        return Fit.GOOD if excess <= CLOCK_SHARE + spread else Fit.SLOW_AS_SEEN

    def __str__(self) -> str:
        """Return both times for people."""
        return (
            f"{self.measured_ns / 1e6:.1f} ms +-{self.spread_ns / 1e6:.1f}, by the law {self.law_ns / 1e6:.1f} ms"
            f" ({(self.ratio - 1) * 100:+.1f} %)"
        )
