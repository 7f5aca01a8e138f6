"""Motion by the catalogue's word: what a dialect declares of it, and the values that ask for it.

    risks(dialect), settings(dialect)           what making a drive ready may send and change
    reading(dialect, "position")                the command that reads where the shaft is, and what its fields mean
    of(command), takes_pulses(command)          what a command does to the shaft, and in which unit it counts
    values_of(dialect, run, rpm=60)             a run at 60 rpm, in the dialect's own units

Rules kept here:
- What a command does is the catalogue's word (`Motion`), and so is what a read means (`StatePart`); nothing here knows a code.
- Distances are degrees, signed: positive raises the position. Speeds are rpm of the shaft.
- Nothing here sends or reads; that is `motion`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from analyzer.catalogue import Command, Dialect, Motion, MotionKind, Risk, Verb
from analyzer.layout import Effect, Field
from conformance.claim import Inconclusive
from conformance.talk.exchange import Exchange

#: Degrees in which two positions are one: two counts of the coarsest encoder.
SAME = 2 * 360 / 16384
#: The acceleration (as sent) of stops that safety sends, and of ramps that are looked at: 2.8 ms for one rpm.
GENTLE = 200
#: The acceleration of motion whose ramps do not matter: 0.4 ms for one rpm. Not 250: FA begins a frame, and a gate would
#: read one in the middle of a request.
QUICK = 248
#: The speed of motion whose speed does not matter, in rpm.
CALM = 60
#: The kinds of motion that end by themselves at a place.
MOVES = (MotionKind.MOVE_BY, MotionKind.MOVE_TO, MotionKind.MOVE_IN_TURN)
#: What any drive does at a speed that is asked for, but for moves within a turn.
RUNS_AND_MOVES = (MotionKind.RUN, MotionKind.MOVE_BY, MotionKind.MOVE_TO)
#: The subdivision at which the suite counts pulses.
SUBDIVISION = 16
#: A force that turns a free shaft, as sent.
FORCE = 60
#: Degrees by which an axis without a known encoder may miss its target.
_NEAR = 0.25
#: What reads a quantity, the first one that a dialect has.
_READS: Mapping[str, tuple[Verb, ...]] = {
    "position": (Verb.READ_POSITION, Verb.READ_ENCODER_CARRY),
    "speed": (Verb.READ_SPEED, Verb.READ_STATE_2),
}
_STATUS = (Verb.READ_STATUS, Verb.READ_STATE_1)
#: What tells whether a motor is on, in which field, and its values of a motor that is on and off.
ON_READ = ((Verb.READ_ENABLED, "enabled", 1, 0), (Verb.READ_STATE_1, "state", 0x00, 0x10))
_ENABLING = (Verb.ENABLE, Verb.MOTOR_ON)


def can_move(dialect: Dialect) -> bool:
    """Say whether a dialect has what the motion of a claim needs."""
    verbs = dialect.by_verb
    return any(v in verbs for v in _ENABLING) and Verb.RUN_SPEED in verbs and any(v in verbs for v in _READS["position"])


def bus_modes(dialect: Dialect) -> tuple[str, ...]:
    """Return the work modes in which the bus moves the motor, by name; the last one can do most."""
    return dialect.by_verb[Verb.RUN_SPEED].modes


def pulse_modes(dialect: Dialect) -> list[str]:
    """Return the work modes in which pulses move the motor, by name."""
    modes = field_of(dialect.by_verb[Verb.SET_WORK_MODE], "work_mode").choice_names.values()
    return [mode for mode in modes if mode not in bus_modes(dialect)]


def risks(dialect: Dialect, *more: Risk) -> frozenset[Risk]:
    """Return the risks of what `ready_to_move` and `stand_still` send, and more."""
    found: set[Risk] = {Risk.MOTION, *more}
    for verb in (Verb.SET_WORK_MODE, Verb.SET_SUBDIVISION):
        if verb in dialect.by_verb:
            found |= dialect.by_verb[verb].all_risks
    return frozenset(found)


def settings(dialect: Dialect, *more: str) -> tuple[str, ...]:
    """Return the settings that `ready_to_move` may change, and more."""
    verbs = ((Verb.SET_WORK_MODE, "work_mode"), (Verb.SET_SUBDIVISION, "subdivision"))
    return (*(name for verb, name in verbs if verb in dialect.by_verb), *more)


def ready_settings(dialect: Dialect) -> dict[str, dict[str, int]]:
    """Return what `ready_to_move` sets where it has to and nothing else is asked for, by command."""
    found = {}
    if Verb.SET_WORK_MODE in dialect.by_verb:
        command = dialect.by_verb[Verb.SET_WORK_MODE]
        found[command.name] = {"work_mode": choice(command, "work_mode", bus_modes(dialect)[-1])}
    if Verb.SET_SUBDIVISION in dialect.by_verb:
        found[dialect.by_verb[Verb.SET_SUBDIVISION].name] = {"subdivision": SUBDIVISION}
    return found


def choice(command: Command, field: str, name: str) -> int:
    """Return the integer as sent of a named choice of a request's field."""
    for form in command.request_forms:
        if field in form.layout.named:
            return next(value for value, known in form.layout.named[field].choice_names.items() if known == name)
    raise KeyError(f"{command.name} has no field {field}")


def switching(dialect: Dialect, on: bool) -> tuple[Command, dict[str, int]]:
    """Return what switches the motor on or off: a command and its values."""
    verbs = dialect.by_verb
    if not on and Verb.MOTOR_OFF in verbs:
        return verbs[Verb.MOTOR_OFF], {}
    command = verbs.get(Verb.ENABLE) or verbs[Verb.MOTOR_ON]
    return command, dict.fromkeys(command.request_forms[0].layout.named, int(on))


def tells_on(dialect: Dialect) -> bool:
    """Say whether a read tells that the motor is on."""
    return any(verb in dialect.by_verb for verb, *_ in ON_READ)


@dataclass(frozen=True)
class Reading:
    """A command whose reply holds a quantity, and the fields that add up to it."""

    command: Command
    quantity: str
    fields: tuple[Field, ...]

    def value(self, values: Mapping[str, int]) -> float:
        return sum(f.physical(values[f.name]) * f.state.factor for f in self.fields if f.state is not None)

    @property
    def step(self) -> float:
        return min(abs(float(f.scale) * f.state.factor) for f in self.fields if f.state is not None)


def reading(dialect: Dialect, quantity: str) -> Reading:
    """Return what reads the "position" or the "speed". Raises Inconclusive where there is none."""
    for verb in _READS[quantity]:
        command = dialect.by_verb.get(verb)
        if command is None or not command.reply_forms:
            continue
        named = command.reply_forms[0].layout.named.values()
        fields = tuple(f for f in named if f.state is not None and f.state.quantity == quantity)
        if fields:
            return Reading(command, quantity, fields)
    raise Inconclusive(f"{dialect.name} has no command that reads the {quantity}")


def reads_position(dialect: Dialect) -> Command:
    """Return the command that reads the position. Raises Inconclusive where there is none."""
    return reading(dialect, "position").command


def reads_speed(dialect: Dialect) -> Command:
    """Return the command that reads the speed. Raises Inconclusive where there is none."""
    return reading(dialect, "speed").command


def proving_reads(dialect: Dialect) -> frozenset[str]:
    """Return the names of the reads by which a shaft is proved to stand: its position, its speed, its status."""
    found = {
        reading(dialect, quantity).command.name
        for quantity, verbs in _READS.items()
        if any(v in dialect.by_verb for v in verbs)
    }
    return frozenset(found | {dialect.by_verb[v].name for v in _STATUS if v in dialect.by_verb})


def of(command: Command) -> Motion:
    """Return what a command that moves the shaft does, as the catalogue declares it."""
    if command.motion is None:
        raise ValueError(f"{command.name} is declared as no motion")
    return command.motion


def near(dialect: Dialect) -> float:
    """Return by how many degrees a move may miss its target."""
    return SAME if dialect.counts_per_turn else _NEAR


def field_of(command: Command, name: str) -> Field:
    """Return a field of a command's first request form."""
    return command.request_forms[0].layout.named[name]


def takes_pulses(command: Command) -> bool:
    """Say whether the distance of a move is in pulses, so that the subdivision decides how far it goes."""
    return bool(command.motion and command.motion.distance) and distance_of(command).unit == "pulses"


def distance_of(command: Command) -> Field:
    """Return the field of a move's distance."""
    return field_of(command, of(command).distance)


def units_per_turn(dialect: Dialect, command: Command, subdivision: int = SUBDIVISION) -> int:
    """Return how many units of a move's distance, as sent, make a turn."""
    field = distance_of(command)
    if field.unit == "pulses" and dialect.subdivision is not None:
        return dialect.subdivision.full_steps * subdivision
    return dialect.counts_per_turn if field.unit == "counts" else field.wire(360)


def counts_of(dialect: Dialect, command: Command, units: int, subdivision: int) -> int:
    """Return the encoder counts of a move's units at a subdivision as sent, which is 0 for the largest."""
    largest = dialect.subdivision.largest if dialect.subdivision is not None else 0
    return round(units * dialect.counts_per_turn / units_per_turn(dialect, command, subdivision or largest))


def speed_as_sent(dialect: Dialect, field: Field, rpm: float, subdivision: int = SUBDIVISION) -> int:
    """Return the speed to send so that the shaft turns at `rpm`."""
    law = dialect.subdivision
    if field.unit == "deg/s":
        return field.wire(rpm * 6)
    if law is not None and subdivision not in law.plain:
        return max(1, round(rpm * subdivision / law.counted_at))
    return field.wire(rpm)


def rpm_as_asked(exchange: Exchange) -> float:
    """Return the speed that a motion was asked for, in rpm, after rounding to the unit of its field; without a sign."""
    assert exchange.command is not None  # asked
    field = field_of(exchange.command, of(exchange.command).speed)
    return abs(field.physical(exchange.values[field.name])) / (6 if field.unit == "deg/s" else 1)


def any_move(dialect: Dialect, *, at_speed: bool = False) -> Command:
    """Return a move, by a distance where there is one. `at_speed`: one that is told its speed."""
    moves = (*dialect.motions(MotionKind.MOVE_BY), *dialect.motions(MotionKind.MOVE_TO))
    return next(command for command in moves if of(command).speed or not at_speed)


def finest(dialect: Dialect) -> int:
    """Return how the largest subdivision is sent: as itself where the field holds it, else as 0."""
    found = dialect.effect(Effect.SUBDIVISION)
    assert found is not None
    assert dialect.subdivision is not None
    largest = dialect.subdivision.largest
    return largest if largest <= found[1].wire_maximum else 0


def values_of(
    dialect: Dialect,
    command: Command,
    degrees: float = 0.0,
    *,
    rpm: float = CALM,
    acceleration: int = QUICK,
    subdivision: int = SUBDIVISION,
    start: int = 0,
) -> dict[str, int]:
    """Return the values of a run, move or torque, as sent.

    `degrees`: the length of a move. `rpm`: the speed; of a run and a torque its sign is the direction. `start`: where a move to
    a place begins, as `place` tells it.
    """
    motion = of(command)
    values = {}
    if motion.kind is MotionKind.TORQUE:
        force = FORCE if rpm > 0 else -FORCE
        values = {field.name: force for c, field in dialect.effects(Effect.CURRENT) if c.name == command.name}
    elif motion.kind is MotionKind.RUN and motion.direction:
        values = {motion.direction: int(rpm < 0)}
        rpm = abs(rpm)
    elif motion.distance:
        turn = units_per_turn(dialect, command, subdivision)
        amount = round(degrees * turn / 360)
        if motion.direction:
            values[motion.direction] = int(amount < 0)
        if motion.kind is MotionKind.MOVE_BY:
            values[motion.distance] = abs(amount) if motion.direction else amount
        else:
            values[motion.distance] = (start + amount) % turn if motion.kind is MotionKind.MOVE_IN_TURN else start + amount
    if motion.speed:
        values[motion.speed] = speed_as_sent(dialect, field_of(command, motion.speed), rpm, subdivision)
    if motion.acceleration:
        values[motion.acceleration] = acceleration
    return values
