"""Bounds: how fast, how far and how hard one command may move a drive. They are judged here, and drawn values stay within.

    speed          fields in rpm: the rpm of the shaft, by the subdivision; in deg/s: a sixth of the number
    turns          a move by its length; a move to a place from where the shaft is; a move within one turn: 1
    acceleration   as sent, 1..255; 0 changes the speed at once, which is above every bound
    current        mA, A once the model is known

One rule for each bound says what a field's value amounts to (`Measure`). The gate compares that amount (`Knowledge.problems`);
who draws values asks which of them stay within (`span`). So what the gate refuses is never drawn.

Rules kept here:
- Motions, their fields and their units are those that the catalogue declares. A motion that it does not declare has an
  unknown length and speed: it is beyond every bound.
- What the frame does not say has to be known: `Knowledge` has what was noted, and what was sent since. Of several
  possibilities the worst counts. An unknown subdivision counts as 1: the shaft then turns 16 times as fast as is sent.
- What is unknown and bounded is refused, with the reason.
- A stop is never bounded. A run without an end has no length: it needs the risk `unbounded`.

Not known here: which risks are allowed (`conformance.gate.permissions`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cache
from math import ceil, floor

from analyzer.catalogue import Command, Dialect, Form, MotionKind, Risk, Subdivision, Verb
from analyzer.layout import Effect, Field
from conformance.gate.interpretations import Interpretation

DEGREES = 360
_ONE = Fraction(1)
_RPM_PER_DEGREE = Fraction(1, 6)
_MILLIAMPERES = {"mA": _ONE, "A": Fraction(1000)}
_MOVES = frozenset({MotionKind.MOVE_BY, MotionKind.MOVE_TO, MotionKind.MOVE_IN_TURN})
_MOVING_RISKS = frozenset({Risk.MOTION, Risk.UNBOUNDED})
#: Names that fields of moves have, for a field of which the command is not known.
_DISTANCES = ("pulses", "position")

#: First and last of a stretch of values, as sent; empty where the first is higher.
Span = tuple[int, int]
EMPTY: Span = (1, 0)


@dataclass(frozen=True)
class Bounds:
    """What one command may do at most. None: no bound. `speed` rpm, `acceleration` as sent (1..255), `current` mA."""

    speed: float | None = None
    turns: float | None = None
    acceleration: float | None = None
    current: float | None = None

    @property
    def given(self) -> bool:
        return any(b is not None for b in (self.speed, self.turns, self.acceleration, self.current))


@dataclass
class DriveState:
    """What is known of one drive: the values that a setting may have, and where the shaft may be, low and high."""

    subdivisions: set[int] = field(default_factory=lambda: {1})
    home_speeds: set[int] = field(default_factory=set)
    degrees: tuple[float, float] | None = None
    pulses: tuple[int, int] | None = None
    running_rpm: float = 0.0
    since_ns: int = 0


_UNKNOWN_STATE = DriveState()


# --- what a value amounts to: one rule for each bound -----------------------------------------------------------------


@dataclass(frozen=True)
class Measure:
    """What a value of a field amounts to: its distance from the farthest origin, times `factor`.

    `factor` None, no `origins`: that is unknown. `unlimited_zero`: 0 stands for more than any number.
    """

    factor: Fraction | None
    origins: tuple[Fraction | int, ...] = (0,)
    unlimited_zero: bool = False

    def of(self, value: int) -> float | None:
        """Return what a value amounts to, None where that is unknown."""
        if self.factor is None or not self.origins or (self.unlimited_zero and value == 0):
            return None
        distance = max(value - min(self.origins), max(self.origins) - value)
        # Much faster than a product of fractions, and as exact.
        return float(distance * self.factor.numerator / self.factor.denominator)

    def within(self, bound: float) -> Span:
        """Return the first and last value that amount to no more than a bound."""
        if self.factor is None or not self.origins:
            return EMPTY
        reach = Fraction(bound) / self.factor
        low, high = ceil(max(self.origins) - reach), floor(min(self.origins) + reach)
        return (1 if self.unlimited_zero else low), high


def _shaft_rpm(dialect: Dialect | None, drive: DriveState) -> Fraction:
    """Return the highest rpm of the shaft for 1 rpm as sent."""
    rule = None if dialect is None else dialect.subdivision
    return _ONE if rule is None else max([_rpm_at(rule, subdivision) for subdivision in drive.subdivisions])


@cache
def _rpm_at(rule: Subdivision, subdivision: int) -> Fraction:
    known = subdivision or rule.largest
    return _ONE if known in rule.plain else Fraction(rule.counted_at, known)


def _speed(dialect: Dialect | None, command: Command | None, declared: Field, drive: DriveState) -> Measure | None:
    if declared.fixed is not None or declared.unit not in ("rpm", "deg/s"):
        return None
    rpm = _shaft_rpm(dialect, drive) if declared.unit == "rpm" else _RPM_PER_DEGREE
    # A limit of 0 may mean that there is none.
    return Measure(_scaled(rpm, declared), unlimited_zero=declared.name == "max_speed")


def _turns(dialect: Dialect | None, command: Command | None, declared: Field, drive: DriveState) -> Measure | None:
    motion = None if command is None else command.motion
    kind = MotionKind.MOVE_BY if motion is None else motion.kind
    names = _DISTANCES if command is None else () if motion is None else (motion.distance,)
    if declared.name not in names or kind not in (MotionKind.MOVE_BY, MotionKind.MOVE_TO):
        return None
    turns = _turns_of_one(dialect, declared, drive)
    if kind is MotionKind.MOVE_BY or turns is None:
        return Measure(turns)
    if declared.unit == "pulses":
        return Measure(turns, tuple(Fraction(p) for p in drive.pulses or ()))
    return Measure(turns, tuple(Fraction(d) / DEGREES / turns for d in drive.degrees or ()))


def _turns_of_one(dialect: Dialect | None, declared: Field, drive: DriveState) -> Fraction | None:
    """Return the turns of the shaft for 1 as sent, at the most; None where that is unknown."""
    if declared.unit == "deg":
        return declared.scale / DEGREES
    if dialect is not None and declared.unit == "counts" and dialect.counts_per_turn:
        return declared.scale / dialect.counts_per_turn
    if dialect is not None and declared.unit == "pulses" and dialect.subdivision is not None:
        rule = dialect.subdivision
        return Fraction(1, rule.full_steps * min(s or rule.largest for s in drive.subdivisions))
    return None


def _acceleration(dialect: Dialect | None, command: Command | None, declared: Field, drive: DriveState) -> Measure | None:
    motion = None if command is None else command.motion
    named = declared.name == "acceleration" or (motion is not None and declared.name == motion.acceleration)
    return Measure(_ONE, unlimited_zero=True) if named else None


def _current(dialect: Dialect | None, command: Command | None, declared: Field, drive: DriveState) -> Measure | None:
    if declared.unit in _MILLIAMPERES:
        return Measure(_scaled(_MILLIAMPERES[declared.unit], declared))
    return Measure(None) if declared.effect is Effect.CURRENT else None


def _scaled(factor: Fraction, declared: Field) -> Fraction:
    return factor if declared.scale == 1 else factor * declared.scale


_Rule = Callable[[Dialect | None, Command | None, Field, DriveState], Measure | None]
_RULES: Mapping[str, _Rule] = {"speed": _speed, "turns": _turns, "acceleration": _acceleration, "current": _current}


# --- values that stay within ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Leeway:
    """What bounds leave: the bounds, and what is known of the drive that they are for.

    `subdivision`: what it is set to. `degrees`: where its shaft is over all turns; `pulses`: its count of them; None: unknown.
    """

    bounds: Bounds = field(default_factory=Bounds)
    subdivision: int | None = None
    degrees: float | None = None
    pulses: int | None = None
    dialect: Dialect | None = field(default=None, compare=False)

    @property
    def drive(self) -> DriveState:
        """What is known of the drive."""
        degrees = None if self.degrees is None else (self.degrees, self.degrees)
        pulses = None if self.pulses is None else (self.pulses, self.pulses)
        return DriveState({1 if self.subdivision is None else self.subdivision}, set(), degrees, pulses)


NO_BOUNDS = Leeway()


def span(declared: Field, leeway: Leeway = NO_BOUNDS, command: Command | None = None) -> Span:
    """Return the first and last value of a field, as sent, that manual and bounds allow. `command`: the field's command."""
    low, high = declared.low, declared.high
    for name, rule in _RULES.items():
        bound = getattr(leeway.bounds, name)
        measure = None if bound is None else rule(leeway.dialect, command, declared, leeway.drive)
        if measure is not None:
            first, last = measure.within(bound)
            low, high = max(low, first), min(high, last)
    return (low, high) if low <= high else EMPTY


def never_within(command: Command, form: Form, bounds: Bounds) -> bool:
    """Say whether no values of a request stay within the bounds: it moves by something that it does not say."""
    motion = command.motion
    if motion is None:
        return command.moves and bounds.given
    if motion.kind in (MotionKind.STOP, MotionKind.HOLD):
        return False
    if bounds.speed is not None and not any(_speed(None, command, f, _UNKNOWN_STATE) for f in form.layout.named.values()):
        return True
    return bounds.turns is not None and motion.kind is MotionKind.MOVE_IN_TURN and bounds.turns < 1


# --- what is known of the drives, and what a request would make them do -----------------------------------------------


class Knowledge:
    """What is known of the drives on a line. `subdivision`: what all of them are set to, None: unknown."""

    def __init__(self, subdivision: int | None = None) -> None:
        #: By address; None: any drive that nothing was sent to alone, so that broadcasts hold for it too.
        self._drives: dict[int | None, DriveState] = {None: DriveState({1 if subdivision is None else subdivision})}

    def _of(self, address: int | None) -> DriveState:
        found = self._drives.get(address)
        if found is None:
            # A homing speed counts as known where it was sent to the drive itself.
            common = self._drives[None]
            found = self._drives[address] = replace(common, subdivisions=set(common.subdivisions), home_speeds=set())
        return found

    def note_subdivision(self, value: int, address: int | None = None) -> None:
        """Take it that a drive (None: every drive) is set to a subdivision."""
        for drive in self._drives.values() if address is None else (self._of(address),):
            drive.subdivisions = {value}

    def note_position(self, degrees: float, address: int, pulses: int | None = None) -> None:
        """Take it that the shaft of a drive stands at `degrees` over all turns, and at a count of pulses where known."""
        drive = self._of(address)
        drive.degrees = (degrees, degrees)
        drive.pulses = None if pulses is None else (pulses, pulses)

    def problems(self, asked: Interpretation, bounds: Bounds) -> list[str]:
        """Return how a request is beyond the bounds, or that this is unknown; empty where it is within them."""
        if not bounds.given or asked.command is None or asked.reads_only or stops(asked):
            return []
        if asked.command.motion is None and moves(asked):
            return ["how it moves is not in the catalogue, so that no bound can be held"]
        told = [self._beyond_speed(asked, bounds.speed), self._beyond_turns(asked, bounds.turns)]
        told += [_beyond_acceleration(asked, bounds.acceleration), _beyond_current(asked, bounds.current)]
        return [text for text in told if text]

    def rpm(self, asked: Interpretation) -> float | None:
        """Return the highest rpm that a request may make the shaft turn at; None where that is unknown."""
        command, form, drive = asked.command, asked.form, self._of(asked.address)
        if command is None or form is None or (command.motion is None and moves(asked)):
            return None
        speeds = []
        for name, declared in form.layout.named.items():
            measure = _speed(asked.dialect, command, declared, drive)
            if measure is not None:
                value = asked.values.get(name)
                rpm = None if value is None else measure.of(value)
                if rpm is None:
                    return None
                speeds.append(rpm)
        if speeds:
            return max(speeds)
        if _kind(asked) is MotionKind.HOME and drive.home_speeds:
            return float(max(drive.home_speeds) * _shaft_rpm(asked.dialect, drive))
        return None if moves(asked) else 0.0

    def turns(self, asked: Interpretation) -> float | None:
        """Return how many turns a request makes the shaft turn at most; None where that is unknown."""
        command, form = asked.command, asked.form
        if command is None or form is None:
            return None
        motion = command.motion
        if motion is None or motion.kind not in _MOVES:
            return None if moves(asked) else 0.0
        if motion.kind is MotionKind.MOVE_IN_TURN:
            return 1.0
        value, declared = asked.values.get(motion.distance), form.layout.named.get(motion.distance)
        measure = None if declared is None else _turns(asked.dialect, command, declared, self._of(asked.address))
        return None if measure is None or value is None else measure.of(value)

    def _beyond_speed(self, asked: Interpretation, bound: float | None) -> str:
        if bound is None:
            return ""
        rpm = self.rpm(asked)
        if rpm is None:
            hint = " (set_home says it, if it is sent first)" if _kind(asked) is MotionKind.HOME else ""
            return f"its speed cannot be told from the frame{hint}, and --max-speed is {bound:g} rpm"
        if rpm <= bound:
            return ""
        if asked.dialect.subdivision is not None and 1 in self._of(asked.address).subdivisions:
            unknown = "while the subdivision is not known (tell it: --subdivision N)"
            return f"up to {rpm:g} rpm {unknown}, above --max-speed {bound:g}"
        return f"{rpm:g} rpm, above --max-speed {bound:g}"

    def _beyond_turns(self, asked: Interpretation, bound: float | None) -> str:
        if bound is None or not moves(asked) or Risk.UNBOUNDED in asked.risks:
            return ""
        turns = self.turns(asked)
        if turns is None:
            return f"how far it turns cannot be told without the drive's position, and --max-turns is {bound:g}"
        return f"{turns:.4g} turns, above --max-turns {bound:g}" if turns > bound else ""

    # --- what was sent --------------------------------------------------------------------------------------------

    def learn(self, asked: Interpretation, now_ns: int) -> None:
        """Take it that a request has left and that a drive may have obeyed."""
        if asked.command is None or asked.reads_only:
            return
        for drive in self._concerned(asked):
            if stops(asked) or moves(asked):
                drive.running_rpm, drive.since_ns = 0.0, now_ns
            if runs(asked):
                drive.running_rpm = self.rpm(asked) or 0.0
            self._learn_place(drive, asked)
            _learn_settings(drive, asked)

    def run_turns(self, asked: Interpretation, now_ns: int) -> float:
        """Return the turns that a drive has made in the run that this request ends, as far as any."""
        minutes = [d.running_rpm * (now_ns - d.since_ns) / 60e9 for d in self._concerned(asked)]
        return max(minutes, default=0.0)

    def _concerned(self, asked: Interpretation) -> list[DriveState]:
        if asked.slot or not asked.to_many:
            return [self._of(asked.address)]
        return list(self._drives.values())

    def _learn_place(self, drive: DriveState, asked: Interpretation) -> None:
        command, form, known = asked.command, asked.form, drive.degrees
        assert command is not None
        if stops(asked) or _leaves_the_shaft(command):
            return
        drive.degrees = drive.pulses = None
        motion = command.motion
        declared = form.layout.named.get(motion.distance) if form is not None and motion is not None else None
        value = None if motion is None else asked.values.get(motion.distance)
        if motion is None or declared is None or known is None or value is None or declared.unit == "pulses":
            return
        turns = _turns_of_one(asked.dialect, declared, drive)
        if turns is None or motion.kind not in (MotionKind.MOVE_BY, MotionKind.MOVE_TO):
            return
        # It may have been refused, or be under way.
        low, high = known
        degrees = float(value * turns * DEGREES)
        ends = (degrees,) if motion.kind is MotionKind.MOVE_TO else (low + degrees, high + degrees)
        drive.degrees = (min(low, *ends), max(high, *ends))


def _learn_settings(drive: DriveState, asked: Interpretation) -> None:
    command, rule = asked.command, asked.dialect.subdivision
    assert command is not None
    for form in command.request_forms if asked.form is None else (asked.form,):
        for name, declared in form.layout.named.items():
            value = asked.values.get(name)
            if declared.effect is Effect.SUBDIVISION:
                drive.subdivisions.add(1 if value is None else value)
            elif declared.effect is Effect.HOME_SPEED and value is not None:
                drive.home_speeds.add(value)
    if Risk.DESTRUCTIVE in command.all_risks:
        # The settings may be those of the factory again.
        drive.home_speeds.clear()
        if rule is not None:
            drive.subdivisions.add(rule.counted_at)


def _leaves_the_shaft(command: Command) -> bool:
    """Say whether a command surely leaves the shaft where it is, and counted as it was: it sets a value, or takes hold."""
    if command.motion is not None:
        # One that risks torque can let go too.
        return command.motion.kind is MotionKind.HOLD and Risk.TORQUE not in command.all_risks
    fields = [f for form in command.request_forms for f in form.layout.named.values()]
    chosen = any(f.fixed is None and f.low < f.high for f in fields)
    return Risk.SETTING in command.all_risks and chosen and command.verb is not Verb.OTHER


def _beyond_acceleration(asked: Interpretation, bound: float | None) -> str:
    if bound is None or asked.form is None:
        return "" if bound is None or not moves(asked) else "its acceleration has not come yet"
    for name, declared in asked.form.layout.named.items():
        measure = _acceleration(asked.dialect, asked.command, declared, _UNKNOWN_STATE)
        if measure is None:
            continue
        value = asked.values.get(name)
        if value is None:
            return "its acceleration has not come yet"
        amount = measure.of(value)
        if amount is None:
            return f"acceleration 0 is at once, above --max-acceleration {bound:g}"
        if amount > bound:
            return f"acceleration {value}, above --max-acceleration {bound:g}"
    return ""


def _beyond_current(asked: Interpretation, bound: float | None) -> str:
    if bound is None or asked.form is None:
        return ""
    for name, declared in asked.form.layout.named.items():
        measure = _current(asked.dialect, asked.command, declared, _UNKNOWN_STATE)
        if measure is None:
            continue
        value = asked.values.get(name)
        milliamperes = None if value is None else measure.of(value)
        if milliamperes is None:
            return f"{name} in mA is not known without the drive's model, and --max-current is {bound:g} mA"
        if milliamperes > bound:
            return f"{name} {milliamperes:g} mA, above --max-current {bound:g}"
    return ""


# --- kinds of motion --------------------------------------------------------------------------------------------------


def _kind(asked: Interpretation) -> MotionKind | None:
    return None if asked.command is None or asked.command.motion is None else asked.command.motion.kind


def stops(asked: Interpretation) -> bool:
    """Say whether a request does nothing but end motion."""
    return _kind(asked) is MotionKind.STOP


def runs(asked: Interpretation) -> bool:
    """Say whether a request makes the shaft turn at a speed without an end."""
    return _kind(asked) is MotionKind.RUN


def moves(asked: Interpretation) -> bool:
    """Say whether a request makes the shaft go somewhere, by a motion that is declared or not."""
    kind = _kind(asked)
    if kind is None:
        return asked.command is not None and bool(asked.risks & _MOVING_RISKS)
    return kind not in (MotionKind.STOP, MotionKind.HOLD)
