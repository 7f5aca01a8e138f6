"""The route of a walk (`model.walk`): the steps of rows in which any two conditions meet (`model.conditions`).

    another state, as far as the row has one      a short motion after each setting
    a run or a move, left to itself               if something is done meanwhile
    the deed
    looks at some of the reads, others each time  before some of them a frame that is not for the drive
    a stop

Rows come in an order and with values drawn by the seed. While the next setting has to wait, a short motion shows what the last
one did: of those that are drawn the one in which most meets that has not met yet.
"""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping
from itertools import combinations
from typing import Any

from analyzer.catalogue import Command, Dialect, MotionKind, Risk, Verb
from conformance.gate.bounds import NO_BOUNDS, Leeway
from conformance.model.asides import Way, asides, slots, ways
from conformance.model.conditions import Deed, is_done, rows_of
from conformance.model.steps import ASIDE, LEAVE, LOOK, WAY, Step, selectors
from conformance.model.values import forms_of, parameter, setting_values
from conformance.motion import declared, ramp
from conformance.motion.declared import MOVES, SUBDIVISION
from conformance.talk import samples
from conformance.talk.probe import MS

#: How many parameters are written one after the other.
_WRITTEN = 5
#: How often values are drawn anew that are those of before.
_DRAWS = 6
#: What motions are drawn from: the speed, the way in turns, the acceleration; and for how long they go at most.
_RPM, _TURNS, _ACCELERATIONS = (
    (3, 25, 60, 140, 600, 1600, 3000),
    (0, 0.025, 0.11, 0.25, 0.6, 2, 7, 21),
    (0, 56, 200, 230, 248, 255),
)
#: Other speeds come from 1 to nearly 3000 rpm, small ones as often as large ones.
_DECADES = 3.47
_AT_ONCE_MOST, _LEAST_OVER, _RAMP_NS, _MOVE_NS = 140, 60, 160 * MS, 250 * MS
#: The same of drives without a law of ramps: a speed, and turns that take 0.6 s at most by it.
_FREE_PACES = [(r, t) for r in (15, 40, 90, 160) for t in (0.025, 0.11, 0.25, 0.6, 1.4) if t * 100 <= r]
#: A run beyond what 16 bits hold in tenths of a degree for each second.
_FREE_FAST = 600
#: How far a move goes that is not waited for, and how fast.
_LONG, _LONG_RPM = 300, 140
_GOING_LOOKS, _LOOKS = 2, 3
#: The share of moves among the motions that fill a wait; the others are runs.
_MOVES, _ALIKE = 0.7, 0.5
#: The share of short motions between settings that need not wait.
_FILLED = 0.3
#: How many motions are drawn, of which the one with most that is new comes.
_DRAWN = 6
#: The group that the drive is in at first.
_GROUP = 0x50
#: What changes between rows, and the share of rows that come in any case.
_SETTINGS, _LEAPS = ("mode", "on", "subdivision", "direction", "replies"), 0.05


def steps(
    dialect: Dialect, *, seed: int = 0, leeway: Leeway = NO_BOUNDS, leg: int = 1, legs: int = 1, waits: bool = True
) -> Iterator[Step]:
    """Yield the steps of a walk, or of one of its legs. `waits`: settings wait, and short motions meanwhile cost nothing."""
    return _Route(dialect, seed, leeway, 1.0 if waits else _FILLED).steps(leg, legs)


class _Route:
    def __init__(self, dialect: Dialect, seed: int, leeway: Leeway, filled: float) -> None:
        self.dialect, self.leeway, self.filled = dialect, leeway, filled
        self.chance = random.Random(f"{seed} {dialect.name} route")
        self.state: dict[str, Any] = {}
        self._next, self._written, self._rpm = 0, seed, float(_LONG_RPM)
        self._runs = {command.name for command in dialect.motions(MotionKind.RUN)}
        #: What has met in the motions that fill waits: three of their conditions each.
        self._met: set[tuple[Any, ...]] = set()
        self._selectors, self._ways, self._asides = selectors(dialect), ways(dialect), (0, *asides(dialect))
        #: What each setting was sent last: it is sent something else next, so that what is not stored shows.
        self._sent: dict[str, dict[str, int]] = {}

    def _look(self, count: int) -> Step:
        self._next += count
        return Step(LOOK, {"first": self._next - count, "count": count})

    def steps(self, leg: int, legs: int) -> Iterator[Step]:
        rows = list(rows_of(self.dialect.name, self.dialect.model))
        self.chance.shuffle(rows)
        group = self.dialect.by_verb.get(Verb.SET_GROUP_ADDRESS)
        if group is not None:
            yield Step(group.name, {"group_address": _GROUP})
        for row in self._ordered(rows[leg - 1 :: legs]):
            for step in _into(self.dialect, self.state, row):
                yield step
                yield from self._filler() if step.name != motion_on(self.dialect)[0] else ()
            yield from self._row(row)
        if Verb.WRITE_IO in self.dialect.by_verb:
            yield Step(self.dialect.by_verb[Verb.WRITE_IO].name, {"alm_mask": 0, "pend_mask": 0, "alm": 0, "pend": 0})

    def _ordered(self, rows: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
        """Yield rows so that mostly few settings change from one to the next one, and now and then many."""
        before: Mapping[str, Any] = {}
        while rows:
            changes = [sum(before.get(n) != row[n] for n in _SETTINGS if n in row) for row in rows]
            fewest = min(changes) if self.chance.random() > _LEAPS else changes[0]
            before = rows.pop(changes.index(fewest))
            yield dict(before)

    def _row(self, row: Mapping[str, Any]) -> Iterator[Step]:
        dialect, chance, going, deed = self.dialect, self.chance, row["going"], row["deed"]
        command = dialect.by_name[deed.name]
        frame = chance.choice(self._asides)
        if going:
            kind, way = going
            kinds = MOVES if kind == "move" else (MotionKind.RUN,)
            every = [c for c in dialect.motions(*kinds) if declared.of(c).speed]
            # Half of them are followed by another one of their kind.
            begun = command if command in every and chance.random() < _ALIKE else chance.choice(every)
            yield self._begun(begun, way, rising=kind == "rise")
            if kind != "rise":
                yield self._look(_GOING_LOOKS)
        if frame and command.motion is not None:
            yield Step(ASIDE, {ASIDE: frame})
        for step in self._deed(deed, leave=bool(going)):
            sent_so = self._by({WAY: row.get(WAY, Way.OWN)}) if step.name == deed.name else {}
            yield Step(step.name, {**step.values, **sent_so})
        if dialect.by_name[deed.name].motion is None and Risk.SETTING in command.all_risks and not going:
            yield from self._filler()
        yield self._look(_LOOKS)
        if self._selectors:
            own = [command.code] if command.code in self._selectors else []
            own = self._selectors if command.verb is Verb.WRITE_PARAMETER else own
            for selector in (*own, chance.choice(self._selectors), *self._unreadable()):
                yield Step(dialect.by_verb[Verb.READ_PARAMETER].name, {"parameter": selector})
        if going or (command.motion is not None and command.motion.kind in (MotionKind.RUN, MotionKind.HOME)):
            yield from self._stopped()
        _after(dialect, deed, self.state)
        if command.verb is Verb.RESTART:
            yield Step(*motion_on(dialect))
        if command.motion is None and (command.verb is Verb.RESTART or chance.random() < 0.2):
            # What the deed did to the motions that follow.
            yield from self._filler()
            yield from self._filler()

    def _unreadable(self) -> list[int]:
        """Return a code that cannot be read, of a command that does something: a read of it does not."""
        codes = [c.code for c in self.dialect.commands if is_done(c) and c.code not in self._selectors]
        return [] if Verb.WRITE_PARAMETER in self.dialect.by_verb else [self.chance.choice(codes)]

    def _stopped(self) -> Iterator[Step]:
        stop = self.chance.choice([c for c in self.dialect.motions(MotionKind.STOP) if is_done(c)])
        yield Step(stop.name, {**self._stop_values(stop), **self._by({WAY: self.chance.choice(self._ways)})})
        yield self._look(_LOOKS)

    def _by(self, how: Mapping[str, int]) -> dict[str, int]:
        """Return how a step is sent, as its values; a package has it in any of its slots."""
        found = {name: int(value) for name, value in how.items() if value}
        if found.get(WAY) == Way.PACKAGE:
            found[WAY] += self.chance.randrange(slots(self.dialect))
        return found

    def _filler(self) -> Iterator[Step]:
        """Yield a short motion, in any way and with any frame on its way, for the time that the next setting has to wait."""
        chance, dialect = self.chance, self.dialect
        if self.state.get("on") == 0 or (self.filled < 1 and chance.random() >= self.filled):
            return
        state = {name: str(self.state.get(name)) for name in _SETTINGS}
        drawn: list[tuple[int, int, Command, dict[str, int], set[Any]]] = []
        for _ in range(_DRAWN):
            moves = chance.random() < _MOVES
            command = chance.choice(dialect.motions(*MOVES) if moves else dialect.motions(MotionKind.RUN))
            how: dict[str, int] = {
                WAY: chance.choice(self._ways),
                ASIDE: chance.choice(self._asides),
                "turn": chance.choice((1, -1)),
            }
            met = set(combinations({"command": command.name, **how, **state}.items(), 3)) - self._met
            drawn.append((len(met), len(drawn), command, how, met))
        *_, command, how, met = max(drawn)
        self._met |= met
        turn = how.pop("turn")
        motion = self._motion(command, turn)
        yield Step(motion.name, {**motion.values, **self._by(how)})
        yield self._look(1)
        if command.name in self._runs:
            again = self._motion(command, turn, over=self.dialect.ramp is not None)
            yield Step(again.name, {**again.values})
            yield from self._stopped()

    def _begun(self, command: Command, way: int, *, rising: bool) -> Step:
        """Return a motion that goes on while the deed is done. `rising`: that comes before it has its speed."""
        if declared.of(command).kind is MotionKind.RUN:
            run = self._motion(command, way)
            return Step(run.name, {**run.values, LEAVE: 1}) if rising else run
        self._rpm = float(_LONG_RPM)
        values = {"degrees": way * _LONG, "rpm": _LONG_RPM, "acceleration": self.chance.choice(_ACCELERATIONS[2:]), LEAVE: 1}
        return Step(command.name, values)

    def _motion(self, command: Command, way: int, *, over: bool = False) -> Step:
        """Return a motion by amounts that do not take long. `over`: it begins while the shaft turns, and slows it down."""
        chance, runs = self.chance, declared.of(command).kind is MotionKind.RUN
        if self.dialect.ramp is None:
            rpm, turns = chance.choice(_FREE_PACES)
            rpm = chance.choice((rpm, rpm, _FREE_FAST)) if runs and not over else rpm
            degrees = round(360 * turns)
            return Step(command.name, {"rpm": way * rpm} if runs else {"degrees": way * degrees, "rpm": rpm})
        while True:
            rpm = chance.choice((chance.choice(_RPM), round(10 ** chance.uniform(0, _DECADES))))
            acceleration = chance.choice(_ACCELERATIONS)
            real = min(float(rpm), self._fastest)
            if (acceleration == 0 and rpm > _AT_ONCE_MOST) or (over and (rpm < _LEAST_OVER or not self._ends(acceleration))):
                continue
            if runs and ramp.ramp_ns(0, real, acceleration) <= _RAMP_NS:
                self._rpm = real
                return Step(command.name, {"rpm": way * rpm, "acceleration": acceleration})
            turns = chance.choice(_TURNS)
            if not runs and ramp.move_ns(turns, real, acceleration) <= _MOVE_NS:
                return Step(command.name, {"degrees": way * round(turns * 360), "rpm": rpm, "acceleration": acceleration})

    @property
    def _fastest(self) -> float:
        """The highest rpm of the shaft in this state."""
        law, limit = self.dialect.subdivision, self.dialect.mode_speeds.get(self.state.get("mode", ""), 3000)
        subdivision = self.state.get("subdivision", SUBDIVISION)
        if law is None or subdivision in law.plain:
            return float(limit)
        return limit * law.counted_at / (subdivision or law.largest)

    def _stop_values(self, command: Command) -> dict[str, int]:
        named = command.request_forms[0].layout.named
        if "acceleration" not in named:
            return {}
        return {"acceleration": self.chance.choice([a for a in _ACCELERATIONS if self._ends(a)])}

    def _ends(self, acceleration: int) -> bool:
        """Say whether the shaft comes soon to rest by an acceleration."""
        return ramp.ramp_ns(0, self._rpm, acceleration) <= _RAMP_NS if acceleration else self._rpm <= _AT_ONCE_MOST

    def _deed(self, deed: Deed, *, leave: bool) -> Iterator[Step]:
        dialect, chance = self.dialect, self.chance
        command = dialect.by_name[deed.name]
        kind = command.motion.kind if command.motion is not None else None
        if kind is MotionKind.RUN or kind in MOVES:
            yield self._motion(command, deed.way, over=leave)
        elif kind is MotionKind.STOP:
            yield Step(command.name, self._stop_values(command))
        elif kind is MotionKind.HOME:
            # By a switch that is open: it turns until it is stopped.
            sets = dialect.by_verb[Verb.SET_HOME]
            values = setting_values(dialect, sets, chance, self.leeway, stray=False)
            if not leave:
                yield Step(sets.name, values | {name: 0 for name in ("home_trigger", "home_mode") if name in values})
                yield Step(command.name, samples.sample(dialect, command) | {LEAVE: 1})
        elif command.verb is Verb.BRAKE:
            # What a held shaft does with a motion no manual says.
            for control in (0, 0x10, 0x10, 1, 0x10, 0x10):
                yield Step(command.name, {"brake_control": control})
                yield self._look(2)
        elif command.verb is Verb.WRITE_PARAMETER:
            # One after the other, so that all of them come: each may spoil another one.
            forms = forms_of(command)
            for _ in range(_WRITTEN):
                self._written += 1
                yield Step(command.name, parameter(forms[self._written % len(forms)], chance))
        else:
            for _ in range(_DRAWS):
                values = setting_values(dialect, command, chance, self.leeway, stray=deed.stray)
                if values != self._sent.get(command.name):
                    break
            if not deed.stray:
                self._sent[command.name] = values
            yield Step(command.name, values | ({LEAVE: 1} if leave else {}))


def motion_on(dialect: Dialect) -> tuple[str, dict[str, int]]:
    """Return what enables the motor."""
    command, values = declared.switching(dialect, True)
    return command.name, values


def _into(dialect: Dialect, state: dict[str, Any], row: Mapping[str, Any]) -> Iterator[Step]:
    """Yield the steps that bring a drive into the state of a row."""
    verbs = dialect.by_verb
    if "mode" in row and state.get("mode") != row["mode"]:
        command = verbs[Verb.SET_WORK_MODE]
        yield Step(command.name, {"work_mode": declared.choice(command, "work_mode", row["mode"])})
        state.pop("on", None)
    for name, verb, fields in (
        ("subdivision", Verb.SET_SUBDIVISION, ("subdivision",)),
        ("direction", Verb.SET_DIRECTION, ("motor_direction",)),
        ("replies", Verb.SET_RESPOND, ("respond", "active")),
    ):
        if name in row and state.get(name) != row[name]:
            value = row[name] if isinstance(row[name], tuple) else (row[name],)
            yield Step(verbs[verb].name, dict(zip(fields, value, strict=True)))
    if state.get("on") != row["on"]:
        command, values = declared.switching(dialect, bool(row["on"]))
        yield Step(command.name, values)
    state.update({name: row[name] for name in _SETTINGS if name in row})


def _after(dialect: Dialect, deed: Deed, state: dict[str, Any]) -> None:
    """Forget what a deed may have changed of the state."""
    verb = dialect.by_name[deed.name].verb
    changed = {
        Verb.SET_WORK_MODE: ("mode", "on"),
        Verb.SET_SUBDIVISION: ("subdivision",),
        Verb.SET_DIRECTION: ("direction",),
        Verb.SET_RESPOND: ("replies",),
        Verb.RESTART: ("on",),
        Verb.SET_AXIS_LOCK: ("on",),
        Verb.SET_ENABLE_LEVEL: ("on",),
    }
    for name in changed.get(verb, ("on",) if verb in (Verb.ENABLE, Verb.MOTOR_ON, Verb.MOTOR_OFF) else ()):
        state.pop(name, None)
