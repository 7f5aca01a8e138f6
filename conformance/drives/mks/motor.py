"""The motor of an MKS drive: a shaft on its path, with obstacles, hands, switches, supply and heat. No bytes.

    path (where the shaft is meant to be) + lost steps  ->  obstacles  ->  shaft  ->  encoder, switches

Rules kept here:
- Positions are encoder counts, which rise counter-clockwise; speeds are rpm. Both are integers or Fractions, exact at any
  time. Only the start of a path is rounded, to a whole part of a turn (`TURN`, 1 / 29,296,875 count). The encoder of a drive
  shows the nearest whole count.
- An obstacle blocks the shaft; its path continues, and the difference is the position error. When the obstacle goes, a
  closed loop is at its target at once, while an open loop has lost the steps.
- A released shaft stands still and follows the hand. A held shaft springs back in a closed loop, but not in an open loop.
- A switch is closed while the shaft is at or beyond its place, or while a hand presses it.

Not emulated: torque, current and heat (no manual gives a law for them), and how a loop catches up.
"""

from __future__ import annotations

from dataclasses import dataclass

from conformance.drives.mks.paths import TURN, Number, Phase, divided, move_path, rest_path, run_path, size


@dataclass(slots=True)
class Switch:
    """An end stop: at `place` (counts) on the side of `way`, or pressed and let go by hand (`pressed`)."""

    way: int
    place: Number | None = None
    pressed: bool = False

    def closed(self, position: Number) -> bool:
        """Say whether the switch is closed while the shaft is at a position."""
        return self.pressed or (self.place is not None and (position - self.place) * self.way >= 0)


class Motor:
    """One shaft. `counts_per_turn`: what the encoder counts in a turn."""

    def __init__(self, counts_per_turn: int = 16384) -> None:
        self.counts_per_turn = counts_per_turn
        self.path = rest_path(0, 0)
        self.holding = True
        self.closed_loop = True
        self.volts = 24.0
        self.temperature = 25.0
        self.encoder_fails = False
        self._part = divided(TURN, counts_per_turn)
        self._lost: Number = 0
        self._low: Number | None = None
        self._high: Number | None = None

    # --- where it is ----------------------------------------------------------------------------------------------

    def position(self, t: Number) -> Number:
        """Return where the shaft is, in counts."""
        return divided(self._shaft(t), self._part)

    def wanted(self, t: Number) -> Number:
        """Return where the shaft is meant to be, in counts."""
        return divided(self.path.position(t), self._part)

    def error(self, t: Number) -> Number:
        """Return where the shaft is meant to be minus where it is, in counts."""
        return divided(self.path.position(t) - self._shaft(t), self._part)

    @property
    def lost(self) -> Number:
        """Where the shaft is minus where it is meant to be, without an obstacle: the steps of an open loop, in counts."""
        return divided(self._lost, self._part)

    def speed(self, t: Number) -> Number:
        """Return the speed of the shaft in rpm; 0 while an obstacle holds it."""
        free = self.path.position(t) + self._lost
        speed = self.path.speed(t)
        held = (self._high is not None and (free > self._high or (free == self._high and speed > 0))) or (
            self._low is not None and (free < self._low or (free == self._low and speed < 0))
        )
        return 0 if held else speed

    def phase(self, t: Number) -> Phase:
        """Return what the motor is doing."""
        return self.path.phase(t)

    @property
    def settled(self) -> Number:
        """The time from which on the speed stays as it is: a move has arrived, a run has its speed."""
        return self.path.settled

    def _shaft(self, t: Number) -> Number:
        free = self.path.position(t) + self._lost
        if self._high is not None:
            free = min(free, self._high)
        return free if self._low is None else max(free, self._low)

    def _here(self, t: Number) -> int:
        """Return where a new path begins: a whole part of a turn, so that fractions do not pile up from path to path."""
        return round(self.path.position(t))

    def _whole(self, counts: Number) -> Number:
        """Return a position as parts of a turn."""
        parts = counts * self._part
        return parts.numerator if parts.denominator == 1 else parts

    # --- what the drive does with it ------------------------------------------------------------------------------

    def run(self, t: Number, rpm: Number, step_ns: int) -> None:
        """Go to a speed by one rpm every `step_ns` (0: at once) and stay at it; 0 is a stop."""
        self.path = run_path(t, self._here(t), self.path.speed(t), rpm, step_ns)

    def move(self, t: Number, target: Number, rpm: Number, step_ns: int) -> None:
        """Go to a position (counts, as it is meant to be) at up to `rpm`, greater than 0."""
        self.path = move_path(t, self._here(t), self.path.speed(t), self._whole(target), rpm, step_ns)

    def jump(self, t: Number, counts: Number) -> None:
        """Be elsewhere at once, as after pulses from outside."""
        self.path = rest_path(t, self._here(t) + self._whole(counts))

    def halt(self, t: Number) -> None:
        self.path = rest_path(t, self._here(t))

    def settle(self, t: Number) -> None:
        """Stop at once, and take where the shaft is for where it is meant to be."""
        self.path = rest_path(t, round(self._shaft(t)))
        self._lost = 0

    def release(self, t: Number) -> None:
        """Let the shaft go: it stops where it is."""
        self.settle(t)
        self.holding = False

    def hold(self, t: Number) -> None:
        """Hold the shaft where it is."""
        if not self.holding:
            self.settle(t)
            self.holding = True

    # --- what acts on it from outside ------------------------------------------------------------------------------

    def block(self, t: Number, blocked: bool = True) -> None:
        """Hold the shaft from outside where it is, or let it go."""
        if blocked:
            self._low = self._high = self._shaft(t)
        else:
            self._unblock(t, None, None)

    def obstruct(self, t: Number, way: int, place: Number | None) -> None:
        """Put something the shaft cannot pass at a position, on the side of `way`; None takes it away."""
        at = None if place is None else self._whole(place)
        self._unblock(t, self._low if way > 0 else at, at if way > 0 else self._high)

    def _unblock(self, t: Number, low: Number | None, high: Number | None) -> None:
        shaft = self._shaft(t)
        self._low, self._high = low, high
        if not self.closed_loop:
            self._lost += shaft - (self.path.position(t) + self._lost)

    @property
    def blocked(self) -> bool:
        """Whether the shaft cannot turn either way."""
        return self._low is not None and self._low == self._high

    def turn(self, t: Number, counts: Number) -> None:
        """Turn the shaft by hand; a closed loop that holds it turns it back at once."""
        if not self.holding:
            self.path = rest_path(t, self._shaft(t) + self._whole(counts))
        elif not self.closed_loop:
            self._lost += self._whole(counts)

    # --- when something will happen -------------------------------------------------------------------------------

    def reaches(self, position: Number, way: int, after: Number) -> Number | None:
        """Return the first time, not before `after`, at which the shaft moves `way` at or beyond a position, or None."""
        at = self._whole(position)
        if (self._high is not None and at > self._high) or (self._low is not None and at < self._low):
            return None
        return self.path.first_beyond(at - self._lost, way, after)

    def moves(self, way: int, after: Number) -> Number | None:
        """Return the first time, not before `after`, at which the path moves a way, or None."""
        for segment in self.path.segments:
            if segment.way == way and (segment.stop is None or segment.stop > after):
                return max(after, segment.start)
        return None

    def touches(self, way: int, after: Number) -> Number | None:
        """Return the first time, not before `after`, at which the shaft presses against an obstacle, or None."""
        limit = self._high if way > 0 else self._low
        return None if limit is None else self.path.first_beyond(limit - self._lost, way, after)

    def strays(self, counts: Number, after: Number) -> Number | None:
        """Return the first time, not before `after`, at which the position error is greater than `counts`, or None."""
        if self._high is None and self._low is None and not self._lost:
            return None
        if size(self.error(after)) > counts:
            return after
        times = []
        for limit, way in ((self._high, 1), (self._low, -1)):
            if limit is not None:
                beyond = limit - self._lost + way * (self._whole(counts) + 1)
                times.append(self.path.first_beyond(beyond, way, after))
        return min((t for t in times if t is not None), default=None)

    def changes(self, switch: Switch, after: Number) -> Number | None:
        """Return the first time, not before `after`, at which a switch opens or closes by the shaft's turning, or None."""
        if switch.pressed or switch.place is None:
            return None
        if switch.closed(self.position(after)):
            return self.reaches(switch.place - switch.way * divided(1, self._part), -switch.way, after)
        return self.reaches(switch.place, switch.way, after)
