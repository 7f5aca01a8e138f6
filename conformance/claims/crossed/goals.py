"""Motions without a law of ramps crossed: goals that a drive takes up from any state, each looked at from begin to end.

    command x way x speed, command x way x start, command x way x what comes on the way    all of them
    the length of a move                                                                   any two

Such a drive answers a motion with its state, ends a move without a word, and has one goal: what comes next takes its place.
The rows are a covering array (`model.covering`); what each shows is kept once and judged by `crossed.goal_claims`.

Rules kept here:
- A row takes two seconds at most; each way is gone as far as the other.
- The last look before a command and the first one behind it are of the read that its reply is held against.
- How fast a shaft speeds up is not known: a row ends when the shaft stands.
- A few rows come first, for runs that have time for them alone.
- A move to a place goes to positive places and to negative ones, each way and at each speed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from itertools import cycle, pairwise
from typing import NamedTuple

from analyzer.catalogue import Command, Dialect, MotionKind, Risk, Verb
from conformance.claims.crossed import looks
from conformance.claims.crossed.looks import Look, look, place
from conformance.claims.declare import Case
from conformance.gate.gate import Refused
from conformance.model import covering, lk_parameters
from conformance.motion import declared, motion
from conformance.motion.declared import CALM, MOVES
from conformance.motion.motion import Sample
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, SECOND_NS, Probe

#: Speeds in rpm, 0 for a move that is told none; the highest of a run, which the drive's own limit must allow too.
_SPEEDS, OWN, _RUN_MOST = (110, 20, 60, 240, 0), 0, 110
#: What a torque is in place of a speed, as sent.
FORCES = {20: 30, 60: 60, 110: 90}
#: Lengths of moves in turns: within one, nothing, half a degree, a whole one, several.
_TURNS = (0.21, 0.86, 0.0, 0.5 / 360, 1.0, 2.6)
#: A move that shows how the shaft turns.
_FAR = 0.2
#: A move that would take longer at its speed is left out; one on whose way something comes takes so long at least.
_LONGEST_S, _LEAST_S = 1.5, 0.4
#: Reckoned for a move that is told no speed.
_USUAL = 110
#: How long a run and a torque keep on, before and after what comes on their way; the run before a motion.
_RUN_NS, _AFTER_NS, _BEFORE_NS = 750 * MS, 150 * MS, 200 * MS
#: Where on its way a move meets what comes, and what a row takes beside its motion.
_MET_AT, _OVERHEAD_NS = 0.45, 400 * MS
#: Between two positions that tell a speed.
_APART_NS = 50 * MS
#: From one look to the next one; how long a shaft has to get going; how long it stays where it is when it stands.
_LOOK_NS, _SET_OFF_NS, _STANDS_NS = 12 * MS, 200 * MS, 60 * MS
#: How far the way of a move to a place stays away from zero, in degrees.
_BESIDE_ZERO = 180
#: How long a motion may take to come to rest.
_PATIENCE_NS = 4 * SECOND_NS
#: What comes on the way of a motion.
STOP, OFF, ON = Verb.STOP, Verb.MOTOR_OFF, Verb.MOTOR_ON
#: What is read on the way, but for the position.
_READS = (Verb.READ_STATE_2, Verb.READ_SINGLE_TURN, Verb.READ_ENCODER, Verb.READ_STATE_1, Verb.READ_STATE_3)


class Row(NamedTuple):
    """The conditions of one motion. `start`: what the shaft does before: 0 stands, 1 turns the same way, -1 the other way.

    `meets`: what comes on its way, None where it ends by itself.
    """

    command: str
    way: int
    rpm: int
    turns: float
    start: int
    meets: Verb | None

    def __str__(self) -> str:
        """Return it for people."""
        way = "a positive" if self.way > 0 else "a negative"
        start = {0: "from rest", 1: "from a run the same way", -1: "from a run the other way"}[self.start]
        by = f"by {self.turns:.3g} turns " if self.turns else ""
        at = f" at {self.rpm} rpm" if self.rpm else ""
        return f"{self.command} {by}{way} way{at}, {start}{f', with {self.meets.value} on the way' if self.meets else ''}"


def motions_of(dialect: Dialect) -> tuple[Command, ...]:
    """Return the motions that are crossed: those of drives that have no law of ramps, and answer with their state."""
    if dialect.ramp is not None or not declared.can_move(dialect) or Verb.READ_STATE_2 not in dialect.by_verb:
        return ()
    return dialect.motions(MotionKind.TORQUE, MotionKind.RUN, *MOVES)


def cases(dialect: Dialect) -> Iterator[Case]:
    """Yield a case for each motion that is crossed."""
    return (Case(dialect, command) for command in motions_of(dialect))


def reads_of(dialect: Dialect) -> list[Command]:
    """Return what is read on the way, but for the position."""
    found = (dialect.by_verb[verb] for verb in _READS if verb in dialect.by_verb) if motions_of(dialect) else ()
    return [read for read in found if dialect.model or not read.models]


def moves(command: Command) -> bool:
    """Say whether a motion ends by itself."""
    return declared.of(command).kind in MOVES


class _Kind(NamedTuple):
    """What a table knows of a motion: that it ends by itself, that it is told a speed, and that it ends within the turn."""

    command: str
    ends: bool
    speed: bool
    in_turn: bool


def table(dialect: Dialect) -> tuple[Row, ...]:
    """Return the rows of all motions that are crossed."""
    of = {c.name: declared.of(c) for c in motions_of(dialect)}
    kinds = (_Kind(n, m.kind in MOVES, bool(m.speed), m.kind is MotionKind.MOVE_IN_TURN) for n, m in of.items())
    return _table(tuple(kinds))


@cache
def _table(kinds: tuple[_Kind, ...]) -> tuple[Row, ...]:
    known = {kind.command: kind for kind in kinds}

    def tells_speed(command: str, rpm: int) -> bool:
        if not known[command].ends:
            return 0 < rpm <= _RUN_MOST
        return bool(rpm) == known[command].speed

    def ends(command: str, rpm: int, turns: float) -> bool:
        if not known[command].ends:
            return not turns
        # An angle that is rounded may be a turn away from where the shaft stands.
        within = 0 < turns < 1 or not known[command].in_turn
        return within and _seconds(rpm, turns) <= _LONGEST_S

    def meets_it(command: str, meets: Verb | None, rpm: int, turns: float) -> bool:
        return _seconds(rpm, turns) >= _LEAST_S or meets is None if known[command].ends else meets is not None

    factors = {
        "command": tuple(known),
        "way": (1, -1),
        "rpm": _SPEEDS,
        "turns": _TURNS,
        "start": (0, 1, -1),
        "meets": (None, STOP, OFF, ON),
    }
    found = covering.rows(
        factors,
        tells_speed,
        ends,
        meets_it,
        # A move by nothing shows that the shaft stays: from rest alone.
        lambda command, turns, start: turns or not start or not known[command].ends,
        together=[*(("command", "way", other) for other in ("rpm", "turns", "start", "meets")), ("command", "turns", "start")],
        cost=lambda command, way, rpm, turns, start, meets: _about_ns(
            Row(command, way, rpm, turns, start, meets), ends=known[command].ends
        ),
    )
    return tuple(Row(**row) for row in found)


def first_rows(dialect: Dialect) -> tuple[Row, ...]:
    """Return few rows of the table that turn, in which each condition comes once, and each end of a motion either way.

    Moves to a place are not among them: they need a position that can be put back.
    """
    chosen = [c for c in motions_of(dialect) if declared.of(c).kind is not MotionKind.MOVE_TO and _known(dialect, c)]
    ends = {c.name: moves(c) for c in chosen}
    return covering.few(
        [row for row in table(dialect) if row.command in ends and (row.turns >= _FAR or not ends[row.command])],
        lambda row: {*enumerate(row), (row.way, ends[row.command]), (row.way, row.meets)},
        lambda row: _about_ns(row, ends=ends[row.command]),
    )


def _known(dialect: Dialect, command: Command) -> bool:
    """Say whether the drive has a command: where its model is not known, one of some models alone does not count."""
    return bool(dialect.model) or not command.models


def _about_ns(row: Row, *, ends: bool) -> float:
    """Return how long a row takes about; a move as long as its whole way, since one that is stopped shows less."""
    going = _seconds(row.rpm, row.turns) * SECOND_NS if ends else _RUN_NS + (_AFTER_NS if row.meets is ON else 0)
    return _OVERHEAD_NS + (_BEFORE_NS if row.start else 0) + going + (_AFTER_NS if row.meets is OFF else 0)


def _seconds(rpm: int, turns: float) -> float:
    return turns * 60 / (rpm or _USUAL)


def met_after_s(row: Row) -> float:
    """Return after how many seconds a move meets what comes on its way."""
    return _seconds(row.rpm, row.turns) * _MET_AT


class Edge(NamedTuple):
    """A command on the line, between two looks at the position and two at the state that it answers with."""

    places: tuple[Look, Look]
    states: tuple[Look, Look]
    exchange: Exchange


@dataclass(frozen=True)
class Tried:
    """A row that was tried. `begun`: its command; `met`: what came on its way; `again`: a run or torque once more.

    `before`, `after`: looks at the shaft at rest; `during`: while the motion was under way, `ending`: after what came on its
    way; `off`: while the motor was off. `stood`: the shaft came to rest by itself, or by what came on the way. `damaged`: the
    line damaged what was said of the commands.
    """

    row: Row
    command: Command
    begun: Edge
    met: Edge | None
    again: Edge | None
    before: tuple[Look, ...]
    during: tuple[Look, ...]
    ending: tuple[Look, ...]
    off: tuple[Look, ...]
    after: tuple[Look, ...]
    stood: bool
    damaged: bool

    @property
    def edges(self) -> list[Edge]:
        """The commands of the motion, in order."""
        return [edge for edge in (self.begun, self.again, self.met) if edge is not None]

    def went(self, probe: Probe) -> float:
        """Return how far the shaft went from rest to rest, in degrees."""
        return samples(probe, self.after)[-1].value - samples(probe, self.before)[-1].value

    @property
    def target(self) -> float:
        """How far a move is asked to go, in degrees."""
        return self.row.way * self.row.turns * 360


def samples(probe: Probe, looks: tuple[Look, ...]) -> list[Sample]:
    """Return the positions among some looks, in degrees."""
    field = probe.command(Verb.READ_POSITION).reply_forms[0].layout.named["position"]
    step = abs(float(field.scale))
    return [
        Sample(sum(one.span) / 2, (one.span[1] - one.span[0]) / 2, place(one) * step, step, probe.noise.place)
        for one in looks
        if one.read.verb is Verb.READ_POSITION and one.values is not None
    ]


def crossed(probe: Probe, command: Command) -> tuple[Tried, ...]:
    """Carry out the rows of a command, those aside that were carried out already, and return what was seen."""
    own = (row for row in table(probe.dialect) if row.command == command.name)
    first, rows = looks.divided(lambda: first_of(probe, command), own)
    # Behind what does not stop no row can begin.
    stood = all(tried.stood for tried in first)
    return (*first, *_carried_out(probe, rows)) if rows and stood else first


def first_of(probe: Probe, command: Command) -> tuple[Tried, ...]:
    """Return what the first rows of a command showed."""
    return tuple(tried for tried in probe.recorded(crossed_first) if tried.command.name == command.name)


def crossed_first(probe: Probe) -> tuple[Tried, ...]:
    """Carry out the first rows and return what was seen."""
    return _carried_out(probe, first_rows(probe.dialect))


def _carried_out(probe: Probe, rows: Iterable[Row]) -> tuple[Tried, ...]:
    reads = cycle([read for other in reads_of(probe.dialect) for read in (other, probe.command(Verb.READ_POSITION))])
    found: list[Tried] = []
    refused: Refused | None = None
    lk_parameters.need_room(probe)
    motion.ready_to_move(probe)
    tried: Counter[tuple[int, int]] = Counter()
    for row in rows:
        command = probe.command(row.command)
        try:
            motion.stand_still(probe)
            # The position is put back, but a run that may change no setting leaves it.
            if declared.of(command).kind is MotionKind.MOVE_TO and Risk.SETTING in probe.rig.allowed:
                _name_place(probe, row, 1 if tried[row.way, row.rpm] % 2 else -1)
                tried[row.way, row.rpm] += 1
            tried_row = _try(probe, command, row, reads)
            if any(edge.exchange.unanswered for edge in tried_row.edges):
                # The line may have lost it; what is not answered twice is the drive's.
                motion.stand_still(probe)
                tried_row = _try(probe, command, row, reads)
            found.append(tried_row)
            if not found[-1].stood:
                # What does not stop is judged; no row can begin behind it.
                break
        except Refused as error:
            refused = error
            motion.stand_still(probe)
    if refused is not None and not found:
        raise refused
    return tuple(found)


def _name_place(probe: Probe, row: Row, side: int) -> None:
    """Give the shaft a position from which the whole way of a row is on one side of zero.

    So a move to a place goes each way, at each speed, to positive and to negative places.
    """
    position = declared.field_of(probe.command("set_position"), "position")
    degrees = side * (row.turns * 360 + _BESIDE_ZERO)
    probe.ask("set_position", {"position": round(degrees / float(position.scale))}, quiet_ns=0)


def _try(probe: Probe, command: Command, row: Row, reads: Iterator[Command]) -> Tried:
    since = len(probe.traffic)
    before = _rest(probe)
    start = motion.place(probe, command)
    if row.start:
        motion.ask(probe, probe.command(Verb.RUN_SPEED), rpm=row.start * row.way * CALM)
        probe.wait(_BEFORE_NS)

    def begin() -> Exchange:
        runs = declared.of(command).kind is MotionKind.RUN
        rpm = row.way * row.rpm if runs else row.rpm or CALM
        force = declared.of(command).kind is MotionKind.TORQUE
        more = dict.fromkeys(declared.values_of(probe.dialect, command), row.way * FORCES[row.rpm]) if force else {}
        return motion.ask(probe, command, row.way * row.turns * 360, rpm=rpm, start=start, more=more, quiet_ns=0)

    begun = _edge(probe, begin)
    during: list[Look] = []
    ending: list[Look] = []
    off: tuple[Look, ...] = ()
    again = met = None
    if not moves(command) or row.meets is not None:
        lasts_ns = _RUN_NS if not moves(command) else int(met_after_s(row) * SECOND_NS)
        during += _on_the_way(probe, reads, lasts_ns)
    # A move that comes once more is planned anew from where the shaft is.
    if not moves(command):
        again = _edge(probe, begin)
    if row.meets is not None:
        verb = row.meets
        met = _edge(probe, lambda: probe.ask(verb, quiet_ns=0))
    if row.meets is ON and not moves(command):
        ending += _on_the_way(probe, reads, _AFTER_NS)
        motion.stop(probe)
    rests = _until_standing(probe, reads)
    stood = rests[1]
    (during if met is None else ending).extend(rests[0])
    if row.meets is OFF:
        off = _rest(probe)
        probe.ask(ON, quiet_ns=0)
        probe.wait(_AFTER_NS)
    after = _rest(probe)
    damaged = looks.damaged(probe.traffic[since:])
    return Tried(row, command, begun, met, again, before, tuple(during), tuple(ending), off, after, stood, damaged)


def _edge(probe: Probe, send: Callable[[], Exchange]) -> Edge:
    position, state = probe.command(Verb.READ_POSITION), probe.command(Verb.READ_STATE_2)
    places, states = look(probe, position), look(probe, state)
    exchange = send()
    behind = look(probe, state)
    return Edge((places, look(probe, position)), (states, behind), exchange)


def _on_the_way(probe: Probe, reads: Iterator[Command], lasts_ns: int) -> Iterator[Look]:
    return looks.on_the_way(probe, reads, _LOOK_NS, probe.gate.now_ns() + lasts_ns)


def _until_standing(probe: Probe, reads: Iterator[Command]) -> tuple[list[Look], bool]:
    """Look at the shaft until it stands; return what was seen, and whether it does."""
    begun_ns = probe.gate.now_ns()
    found: list[Look] = []
    while probe.gate.now_ns() < begun_ns + _PATIENCE_NS:
        found += _on_the_way(probe, reads, _STANDS_NS // 2)
        places = samples(probe, tuple(found))
        last = [one.value for one in places if one.t_ns >= probe.gate.now_ns() - 2 * _STANDS_NS]
        if probe.gate.now_ns() - begun_ns >= _SET_OFF_NS and len(last) > 2 and max(last) - min(last) <= probe.within("degrees"):
            return found, True
    return found, False


def _rest(probe: Probe) -> tuple[Look, ...]:
    return looks.at_rest(probe, reads_of(probe.dialect))


def speeds(places: list[Sample]) -> Iterator[tuple[Sample, Sample, float, float]]:
    """Yield pairs of positions that are so far apart at least, with the speed between them (rpm) and its uncertainty."""
    first = 0
    for last in range(len(places)):
        while first < last and places[last].t_ns - places[first + 1].t_ns >= _APART_NS:
            first += 1
        if places[last].t_ns - places[first].t_ns >= _APART_NS:
            yield (places[first], places[last], *motion.speed_between(places[first], places[last]))


def apart(looks: tuple[Look, ...]) -> Iterator[tuple[Look, Look, Look]]:
    """Yield each look at another read with those at the position beside it."""
    told = [one for one in looks if one.values is not None or one.read.verb is not Verb.READ_POSITION]
    places = [number for number, one in enumerate(told) if one.read.verb is Verb.READ_POSITION]
    for first, last in pairwise(places):
        yield from ((told[first], one, told[last]) for one in told[first + 1 : last])
