"""The motion of an LK motor's shaft: physics only, without bytes, commands or a clock.

    goal (free, torque, speed, position) + limits + brake or hand -> path (`paths`) -> angle, speed, torque

Angles are degrees, speeds deg/s, accelerations deg/s2, torques LSB of the model's torque current (MS: of its power);
clockwise is positive. Times are integer nanoseconds and only go forward.

Three angles: `angle` is the shaft's own and never jumps; `position` is counted over all turns from `origin`, which may
be moved; the angle within a turn is counted from `zero`, the encoder's.

Rules kept here:
- Each new goal becomes a path. The path is made again after each change: of limits, of a brake, of a hand on the shaft.
  Between changes the motion is a formula in time.
- Speed and position loops are ideal: they follow ramps of constant acceleration exactly, and hold exactly.
- Their acceleration is the smaller of two: the ramp, and the acceleration by the torque limit of a shaft at rest. Friction
  does not reduce it, so the acceleration is constant. Friction shows in the reported torque.
- A limit of 0 allows nothing. Without torque a loop cannot act, and the shaft coasts to a stop. With a ramp of 0, only the
  torque limit counts.
- A torque rises by the torque ramp; the shaft settles at the speed where friction equals the torque.
- Off, or free: friction alone acts. A brake or a hand holds the shaft at once. The goal stays, and the motion continues when
  the shaft is released.

Not emulated: the tuning of the loops (the drive stores gains, without effect), cogging, backlash, load, heat.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

from conformance.drives.lk.paths import Lag, Motion, Path, Ramps, Still, Stretch, move, speed_change

TURN = 360.0
#: Angles nearer than this are one angle: what is left by the rounding of floats.
SAME = 1e-6
#: Seconds before the end of a path at which its direction is looked at.
_JUST_BEFORE = 1e-4
#: A speed or position loop that pushes against a held shaft for this long has stalled.
STALL_NS = 1_000_000_000


@dataclass(frozen=True, kw_only=True)
class Build:
    """What a motor is made of.

    `settled_speed`: deg/s for each LSB of torque once friction takes it up; `lag`: seconds of that approach;
    `top_speed`: the fastest it can turn (deg/s). `encoder_bits`: 14, 15, 16 or 18. `brake`: whether it has one.
    `ramp_error` (a factor) and `overshoot` (deg) are for faults.
    """

    settled_speed: float
    lag: float
    top_speed: float
    encoder_bits: int
    pole_pairs: int = 14
    brake: bool = True
    ramp_error: float = 1.0
    overshoot: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What the drive allows: torque (LSB), speed (deg/s), distance from the origin (deg), torque ramp (LSB/s), deg/s2.

    A ramp (the last two) of 0 is none.
    """

    torque: float
    speed: float
    angle: float
    torque_ramp: float
    acceleration: float


class Goal(Protocol):
    """What the motor is told to do."""

    def path(self, motor: LkMotor, now: Motion) -> Path:
        """Return how the shaft gets there from where it is."""

    def push(self, motor: LkMotor) -> float:
        """Return the torque on a shaft that is held."""

    @property
    def closed(self) -> bool:
        """Whether a loop watches that the goal is reached."""


@dataclass(frozen=True)
class Torque:
    """Give a torque (LSB)."""

    torque: float
    closed: bool = False

    def path(self, motor: LkMotor, now: Motion) -> Path:
        """Return the path under the torque, within the torque limit, by the torque ramp."""
        scale = motor.build.settled_speed
        begin, end = motor.torque_of(now) * scale, self.push(motor) * scale
        return Lag(now.angle, now.speed, begin, end, motor.limits.torque_ramp * scale, motor.build.lag)

    def push(self, motor: LkMotor) -> float:
        return _within(self.torque, motor.limits.torque)


@dataclass(frozen=True)
class Free:
    """Give no torque: the motor is off, or has no goal yet."""

    closed: bool = False

    def path(self, motor: LkMotor, now: Motion) -> Path:
        """Return how friction lets the shaft run out."""
        return Lag(now.angle, now.speed, 0.0, 0.0, 0.0, motor.build.lag)

    def push(self, motor: LkMotor) -> float:
        return 0.0


FREE = Free()


@dataclass(frozen=True)
class Speed:
    """Run at a speed (deg/s); 0 stops and holds."""

    speed: float
    closed: bool = True

    def path(self, motor: LkMotor, now: Motion) -> Path:
        """Return the ramp to the speed, within the speed limit."""
        speed = _within(self.speed, min(motor.limits.speed, motor.build.top_speed))
        acceleration = motor.acceleration
        if not acceleration:
            return FREE.path(motor, now)
        return Ramps(now.angle, now.speed, speed_change(now.speed, speed, acceleration), speed)

    def push(self, motor: LkMotor) -> float:
        """Return the torque limit, in the direction of the speed."""
        return math.copysign(motor.limits.torque, self.speed) if self.speed else 0.0


@dataclass(frozen=True)
class Position:
    """Go to an angle of the shaft and hold it; `top` (deg/s) in place of the speed limit where it is given."""

    angle: float
    top: float | None = None
    closed: bool = True

    def path(self, motor: LkMotor, now: Motion) -> Path:
        """Return the fastest move there."""
        top = min(motor.limits.speed if self.top is None else self.top, motor.build.top_speed)
        acceleration = motor.acceleration
        if not acceleration:
            return FREE.path(motor, now)
        if top <= 0:
            return Ramps(now.angle, now.speed, speed_change(now.speed, 0.0, acceleration))
        distance = self.angle - now.angle
        beyond = math.copysign(motor.build.overshoot, distance) if abs(distance) > SAME else 0.0
        stretches: tuple[Stretch, ...] = move(distance + beyond, now.speed, top, acceleration)
        if beyond:
            stretches += move(-beyond, 0.0, top, acceleration)
        return Ramps(now.angle, now.speed, stretches, rest=self.angle)

    def push(self, motor: LkMotor) -> float:
        """Return the torque limit, towards the angle."""
        left = self.angle - motor.motion.angle
        return math.copysign(motor.limits.torque, left) if abs(left) > SAME else 0.0


class LkMotor:
    """The shaft of one motor and what acts on it.

    `angle`: where the shaft stands when the power comes. `zero` is the angle of the shaft that the encoder calls 0.
    """

    def __init__(self, build: Build, limits: Limits, *, angle: float = 0.0) -> None:
        self.build = build
        self.limits = limits
        self.zero = 0.0
        self.origin = 0.0
        self.on = True
        self.braked = False
        self.blocked = False
        self.goal: Goal = FREE
        self.now_ns = 0
        self.stalls_ns: int | None = None
        self._path: Path = Still(angle)
        self._path_ns = 0
        self.power_up()

    # --- goals ---------------------------------------------------------------------------------------------------

    def go(self, goal: Goal) -> None:
        """Take a goal in place of the one before."""
        self.goal = goal
        self.stalls_ns = None
        self._plan(self.motion)

    def release(self) -> None:
        """Give no more torque; the goal is dropped."""
        self.go(FREE)

    def stop(self) -> None:
        """Brake by the ramp and hold."""
        self.go(Speed(0.0))

    def turn_on(self) -> None:
        """Obey again; nothing that was dropped is taken up."""
        self.on = True

    def turn_off(self) -> None:
        """Give no more torque and drop the goal."""
        self.on = False
        self.release()

    def move_to(self, position: float, top: float | None = None) -> None:
        """Move to a position counted over all turns, no farther than the angle limit."""
        self.go(Position(self.origin + _within(position, self.limits.angle), top))

    def move_by(self, distance: float, top: float | None = None) -> None:
        """Move by a distance from where the shaft is now."""
        self.go(Position(self.motion.angle + distance, top))

    def turn_to(self, angle: float, *, clockwise: bool, top: float | None = None) -> None:
        """Turn in one direction to an angle within the turn.

        A shaft that is there stays. One that turns already goes to the first such angle at which it can stop; one that
        turns the other way brakes first.
        """
        now = self.motion
        side = 1.0 if clockwise else -1.0
        braking = now.speed * abs(now.speed) / (2 * self.acceleration) * side if self.acceleration else 0.0
        distance = (angle - self.within_turn) * side % TURN
        if TURN - distance < SAME:
            distance = 0.0
        distance += TURN * math.ceil((braking - distance - SAME) / TURN)
        self.go(Position(now.angle + distance * side, top))

    def limit(self, limits: Limits) -> None:
        """Change the limits; what is under way goes on within the new ones."""
        self.limits = limits
        self._plan(self.motion)

    def set_position(self, position: float) -> None:
        """Call where the shaft is now a position; motion goes on undisturbed."""
        self.origin = self.motion.angle - position

    def clear_turns(self) -> None:
        """Drop the whole turns from the position; motion goes on undisturbed."""
        self.origin += TURN * math.floor(self.position / TURN + SAME)

    # --- what happens to it ---------------------------------------------------------------------------------------

    def power_up(self) -> None:
        """Begin anew where the shaft is: on, brake released, at rest, nothing to do, no turns counted."""
        self.on, self.braked, self.goal, self.stalls_ns = True, False, FREE, None
        self.origin = 0.0
        self.origin = self.motion.angle - self.within_turn
        self._plan(self.motion._replace(speed=0.0, acceleration=0.0))

    def hold(self, *, braked: bool | None = None, blocked: bool | None = None) -> None:
        """Let the brake or a hand hold the shaft, or let go; None: as before."""
        before = self.motion
        self.braked = self.braked if braked is None else braked
        self.blocked = self.blocked if blocked is None else blocked
        self._plan(before)

    def twist(self, degrees: float) -> None:
        """Turn the shaft by hand; a held one does not give way, and a position that is held is gone back to."""
        if not self.held:
            now = self.motion
            self._plan(now._replace(angle=now.angle + degrees))

    def shift(self, degrees: float) -> None:
        """Rest elsewhere, with what is held there."""
        if isinstance(self.goal, Position):
            self.goal = replace(self.goal, angle=self.goal.angle + degrees)
        now = self.motion
        self._plan(now._replace(angle=now.angle + degrees))

    def to(self, t_ns: int) -> None:
        self.now_ns = max(self.now_ns, t_ns)

    def _plan(self, now: Motion) -> None:
        self._path = Still(now.angle) if self.held else self.goal.path(self, now)
        self._path_ns = self.now_ns
        if not (self.held and self.goal.closed and self.goal.push(self)):
            self.stalls_ns = None
        elif self.stalls_ns is None:
            self.stalls_ns = self.now_ns + STALL_NS

    # --- what can be seen -----------------------------------------------------------------------------------------

    @property
    def held(self) -> bool:
        """Whether the brake or a hand holds the shaft."""
        return self.blocked or (self.braked and self.build.brake)

    @property
    def motion(self) -> Motion:
        """The shaft now."""
        return self._path.at((self.now_ns - self._path_ns) / 1e9)

    @property
    def rests(self) -> tuple[float, int]:
        """When the shaft comes to rest, later than now while it turns, and the sign of its turning until then."""
        speed, seconds = self.motion.speed, self._path.seconds
        if speed:
            return self.now_ns + 1, 1 if speed > 0 else -1
        if math.isinf(seconds):
            return self._path_ns, 0
        before = self._path.at(max(0.0, seconds - _JUST_BEFORE)).speed
        return self._path_ns + seconds * 1e9, (before > 0) - (before < 0)

    @property
    def settles_ns(self) -> int | None:
        """When the ramps under way end, or None if none are."""
        end = self._path.seconds
        if math.isinf(end):
            return None
        end_ns = self._path_ns + math.ceil(end * 1e9)
        return end_ns if end_ns > self.now_ns else None

    @property
    def acceleration(self) -> float:
        """The acceleration of the loops (deg/s2); 0 where they have no torque."""
        by_torque = self.limits.torque * self.build.settled_speed / self.build.lag
        return min(by_torque, self.limits.acceleration or by_torque) * self.build.ramp_error

    @property
    def position(self) -> float:
        """The angle over all turns (deg)."""
        return self.motion.angle - self.origin

    @property
    def within_turn(self) -> float:
        """The angle from the encoder's zero (deg), 0 <= angle < 360."""
        angle = (self.motion.angle - self.zero) % TURN
        return 0.0 if TURN - angle < SAME else angle

    @property
    def torque(self) -> float:
        """The torque that the motor gives (LSB)."""
        return self.goal.push(self) if self.held else self.torque_of(self.motion)

    def torque_of(self, motion: Motion) -> float:
        """Return the torque that a motion takes (LSB), friction included, within the torque limit."""
        needed = (motion.speed + motion.acceleration * self.build.lag) / self.build.settled_speed
        return _within(needed, self.limits.torque)

    # --- the encoder ----------------------------------------------------------------------------------------------

    @property
    def encoder_scale(self) -> int:
        """Counts of a turn as they are sent: an encoder wider than 16 bits sends its upper 16."""
        return 1 << min(self.build.encoder_bits, 16)

    @property
    def encoder_raw(self) -> int:
        """The encoder as it is (counts)."""
        full = 1 << self.build.encoder_bits
        return math.floor(self.motion.angle / TURN * full + SAME) % full * self.encoder_scale // full

    @property
    def encoder_zero(self) -> int:
        """Where the encoder's zero is (counts)."""
        return round(self.zero / TURN * self.encoder_scale) % self.encoder_scale

    @encoder_zero.setter
    def encoder_zero(self, counts: int) -> None:
        self.zero = counts * TURN / self.encoder_scale

    @property
    def encoder(self) -> int:
        """The encoder counted from its zero (counts)."""
        return (self.encoder_raw - self.encoder_zero) % self.encoder_scale

    def rebuilt(self, **changes: float) -> None:
        """Change what the motor is made of (fields of `Build`), as a fault does."""
        self.build = replace(self.build, **changes)  # type: ignore[arg-type]
        self._plan(self.motion)


def _within(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))


#: The models' motors. The manual gives none of these numbers; MS is near what an MS4015 was seen to do (about 100 LSB
#: at 700 deg/s, a 16-bit encoder), the others are like it, with an encoder width each and a gear in MG.
BUILDS = {
    "MF": Build(settled_speed=3.0, lag=0.15, top_speed=6000.0, encoder_bits=14),
    "MG": Build(settled_speed=0.6, lag=0.15, top_speed=1200.0, encoder_bits=18),
    "MH": Build(settled_speed=2.0, lag=0.15, top_speed=4000.0, encoder_bits=15),
    "MS": Build(settled_speed=7.0, lag=0.15, top_speed=6000.0, encoder_bits=16),
}
