"""The corners of motion, as the steps of short walks (`model.walk`): what a random route (`model.route`) seldom meets.

    speeds      slow and fast, in each mode of the bus, at other subdivisions, and with the direction turned
    ends        each move fast, at once, with a ramp behind that, and in place of another one
    numbers     each move by wide numbers, above the highest speed, and places behind many turns
    stops       each run and each move ended by each stop, and motion behind a stop that is not over yet
    switches    the motor switched on and off while the shaft turns, and on behind a stop at once
    damage      motions and stops with a wrong check or of another length, which do nothing

Rules kept here:
- A number that is far off is no way to go: the motion is looked at and replaced by the next one, in the end by a stop.
- Each number is too far off for the move to end meanwhile: where that would be depends on when each of them began.
- The values are those of the catalogue's fields.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import cycle

from analyzer.catalogue import Command, Dialect, MotionKind, Verb
from conformance.model.asides import Way, asides, lengths, ways
from conformance.model.steps import ASIDE, LEAVE, SPOILED, WAY, Step
from conformance.motion import declared
from conformance.motion.declared import MOVES, SUBDIVISION

#: Accelerations of ramps that are over at once, that can be looked at, and of none.
_STEEP, _SEEN, _NONE = 255, 236, 0
#: Speeds that are told in one digit, in two, and in a high byte.
_SPEEDS = (3, 12, 560)
#: Subdivisions below and above where speeds are as they are sent.
_SUBDIVISIONS = (32, 128, 25, 67)
#: One at which half of the fastest speed is sent for it.
_COARSE = 8
#: A moderate speed, one that needs no ramp, a fast one, and the fastest.
_RPM, _AT_ONCE_RPM, _FAST_RPM, _FASTEST_RPM = 100, 60, 1600, 3000
#: Degrees of moves: with a ramp, fast, to be replaced, without a ramp, and with pulses of more than 16 bits.
_RAMPED, _FAST, _LONG, _SHORT, _TURNS = 84, 1000, 3000, 45, 3700
_PLACES = (Verb.READ_ENCODER_CARRY, Verb.READ_POSITION, Verb.READ_PULSES, Verb.READ_ANGLE_ERROR)


class _Corners:
    """The steps of a dialect by their parts; each ends with a motor that is on and a shaft that stands."""

    def __init__(self, dialect: Dialect) -> None:
        self.dialect, self.verbs, self.ways = dialect, dialect.by_verb, ways(dialect)
        self.run = self.verbs[Verb.RUN_SPEED]
        self.moves = [c for c in dialect.motions(*MOVES) if declared.of(c).speed]
        self.stops = dialect.motions(MotionKind.STOP)

    # --- steps --------------------------------------------------------------------------------------------------------

    def _go(self, command: Command, amount: int, rpm: int = _RPM, acceleration: int = _STEEP, **how: int) -> Step:
        """Return a motion. `amount`: degrees of a move, 1 or -1 for a run that way."""
        amounts = {"rpm": amount * rpm} if command is self.run else {"degrees": amount, "rpm": rpm}
        return Step(command.name, {**amounts, "acceleration": acceleration, **how})

    def _stop(self, command: Command | None = None, acceleration: int = _STEEP, **how: int) -> Step:
        command = command or self.verbs[Verb.STOP_SPEED]
        takes = "acceleration" in command.request_forms[0].layout.named
        return Step(command.name, {"acceleration": acceleration, **how} if takes else how)

    def _switch(self, on: bool, **how: int) -> Step:
        command, values = declared.switching(self.dialect, on)
        return Step(command.name, {**values, **how})

    def _set(self, verb: Verb, **values: int) -> Iterator[Step]:
        if verb in self.verbs:
            yield Step(self.verbs[verb].name, values)

    def _mode(self, name: str) -> Iterator[Step]:
        command = self.verbs[Verb.SET_WORK_MODE]
        yield Step(command.name, {"work_mode": declared.choice(command, "work_mode", name)})
        yield self._switch(True)

    def _look(self, *verbs: Verb) -> Iterator[Step]:
        for verb in verbs or (Verb.READ_STATUS, Verb.READ_SPEED):
            yield from self._set(verb)

    # --- parts --------------------------------------------------------------------------------------------------------

    def speeds(self) -> Iterator[Step]:
        *others, last = declared.bus_modes(self.dialect)
        for name in others:
            # It is limited.
            yield from self._mode(name)
            yield self._go(self.run, 1, _FASTEST_RPM)
            yield from self._look()
            yield self._stop()
        yield from self._mode(last)
        for rpm in _SPEEDS:
            yield self._go(self.run, 1, rpm)
            yield from self._look()
        yield from self._look(*_PLACES[:3])
        yield self._stop()
        yield from self._set(Verb.SET_SUBDIVISION, subdivision=_COARSE)
        yield self._go(self.run, -1, _FASTEST_RPM)
        yield from self._look(Verb.READ_SPEED)
        yield self._stop()
        moves = cycle((self.moves[:2], self.moves[2:]))
        for subdivision in (*_SUBDIVISIONS, SUBDIVISION):
            yield from self._set(Verb.SET_SUBDIVISION, subdivision=subdivision)
            yield from self._each_way(next(moves), 1)
        yield from self._set(Verb.SET_DIRECTION, motor_direction=1)
        yield from self._each_way(self.moves, -1)
        yield from self._set(Verb.SET_DIRECTION, motor_direction=0)

    def _each_way(self, moves: Iterable[Command], turn: int) -> Iterator[Step]:
        yield self._go(self.run, turn)
        yield from self._look(Verb.READ_SPEED)
        yield self._stop()
        yield from (self._go(command, turn * _SHORT) for command in moves)

    def ends(self) -> Iterator[Step]:
        way, frame = cycle(self.ways[::-1]), cycle(asides(self.dialect))
        for command, turn in zip(self.moves, cycle((1, -1)), strict=False):
            yield self._go(command, turn * _FAST, _FAST_RPM)
            yield self._go(command, -turn * _RAMPED, acceleration=_SEEN, **{WAY: int(next(way)), ASIDE: int(next(frame))})
            yield self._go(command, _SHORT, _AT_ONCE_RPM, _NONE)
            yield from self._look(Verb.READ_POSITION)
            yield self._go(command, _LONG, acceleration=_SEEN, **{LEAVE: 1})
            yield from self._look()
            yield self._go(command, -_SHORT, acceleration=_SEEN, **{WAY: int(next(way)), ASIDE: int(next(frame))})
            yield self._go(command, 0)

    def numbers(self) -> Iterator[Step]:
        for command in self.moves:
            field, speed = declared.distance_of(command), declared.field_of(command, declared.of(command).speed)
            above = speed.wire_maximum // 2 + _SPEEDS[0]
            far = ({field.name: number, "rpm": 2 * _RPM} for number in _numbers(field.low, field.high))
            for values in (*far, *([{"degrees": _LONG, speed.name: above}] if above > speed.high else [])):
                yield Step(command.name, {**values, "acceleration": _STEEP, LEAVE: 1})
                yield from self._look(Verb.READ_STATUS, Verb.READ_POSITION)
        yield self._stop()
        for turn in (-1, 2):
            yield self._go(self.moves[0], turn * _TURNS, _FASTEST_RPM)
            yield from self._look(*_PLACES)
        yield from self._set(Verb.SET_ZERO)
        yield from self._look(*_PLACES)

    def stops_(self) -> Iterator[Step]:
        way = cycle(self.ways[::-1])
        for stop, command in zip(self.stops, cycle(self.moves), strict=False):
            yield self._go(self.run, 1)
            yield self._stop(stop)
            yield self._go(self.run, -1, 2 * _RPM, **{WAY: int(next(way))})
            yield from self._look(Verb.READ_SPEED)
            yield self._stop(stop, _SEEN, **{WAY: int(next(way))})
            yield self._go(command, _LONG, **{LEAVE: 1})
            yield self._stop(stop)
        for command in self.moves:
            yield self._go(self.run, 1, 2 * _RPM)
            yield self._stop(None, _SEEN, **{LEAVE: 1})
            yield self._go(command, _RAMPED)

    def switches(self) -> Iterator[Step]:
        emergency, going, way = self.verbs.get(Verb.EMERGENCY_STOP), (self.run, *self.moves), cycle(self.ways[::-1])
        for command in going:
            yield self._go(command, 1 if command is self.run else _LONG, **{LEAVE: 1})
            for on in (True, False, True):
                yield self._switch(on, **{LEAVE: 1, WAY: 0 if on else int(next(way))})
                yield from self._look()
        follow = cycle(self.dialect.motions(MotionKind.MOVE_BY))
        for command in going if emergency is not None else ():
            # Without the stop it would be over soon.
            yield self._go(command, 1 if command is self.run else _RAMPED, acceleration=_SEEN, **{LEAVE: 1})
            yield self._stop(emergency)
            yield self._switch(True)
            yield from self._look(Verb.READ_STATUS)
            yield self._go(next(follow), _SHORT)
            yield from self._look(Verb.READ_POSITION)
        yield self._switch(False)
        for verb in (Verb.SET_ZERO, Verb.RELEASE_PROTECTION):
            yield from self._set(verb)
        for command in going:
            for to in self.ways[:2]:
                yield self._go(command, -1 if command is self.run else _SHORT, **{WAY: int(to)})
                yield from self._look(Verb.READ_STATUS)
        yield from self._look(Verb.READ_ENABLED)
        yield self._switch(True)

    def damage(self) -> Iterator[Step]:
        going = (self.run, *self.moves)
        for command in going:
            for how in self._spoiled(command):
                yield self._go(command, 1 if command is self.run else _SHORT, **how)
            yield from self._look()
        yield self._go(self.run, 1)
        for stop in (*(self._stop(c) for c in self.stops), self._switch(False)):
            for how in self._spoiled(self.dialect.by_name[stop.name]):
                yield Step(stop.name, {**stop.values, **how})
            yield from self._look()
        yield self._stop()
        yield from self._look(Verb.READ_POSITION)

    def _spoiled(self, command: Command) -> Iterator[dict[str, int]]:
        yield from ({WAY: int(way), SPOILED: 1} for way in self.ways if way < Way.PACKAGE)
        yield from ({SPOILED: spoiled} for spoiled in lengths(self.dialect, command))


#: The parts by name: what their claims say, and the steps.
PARTS: Mapping[str, tuple[str, Callable[[_Corners], Iterator[Step]]]] = {
    "speeds": ("Slow and fast runs and moves go as fast and that way as told, in each mode and subdivision", _Corners.speeds),
    "ends": ("Moves that are fast, at once, with a ramp or in place of others end where they are told to", _Corners.ends),
    "numbers": ("Moves by wide numbers begin as they are told, and places behind many turns are told", _Corners.numbers),
    "stops": ("Each stop ends runs and moves, and a motion behind one that is not over yet begins", _Corners.stops_),
    "switches": (
        "Motion goes on when the motor is switched on, ends when off, and does not begin by itself",
        _Corners.switches,
    ),
    "damage": ("Motions and stops with a wrong check or of another length do nothing", _Corners.damage),
}


def steps(dialect: Dialect, part: str) -> Iterator[Step]:
    """Yield the steps of a part."""
    return PARTS[part][1](_Corners(dialect))


def _numbers(low: int, high: int) -> Sequence[int]:
    """Return the limits, a number that needs as many bits, and numbers of one bit."""
    inside = [n for bits in (16, 24, 31) for n in (1 << bits, -1 << bits) if low < n < high]
    return (low, high, low - low // 8, *inside) if low else (high, *inside)
