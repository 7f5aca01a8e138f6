"""Motions crossed: short motions in which any two conditions meet, each looked at from its begin to its end.

    command x way x speed            all of them
    acceleration, length, start, work mode, subdivision      any two, and each with any of those

A bug of firmware often needs two conditions: a ramp that is wrong one way only, a read that is wrong of a slow shaft.
The rows are a covering array (`model.covering`); what each shows is kept once and judged by many claims.

Rules kept here:
- A row takes a second at most, and each length that is moved one way is moved the other way too.
- While the shaft turns one read follows another; each second one is that of the position, which the others are held against.
- Where the end is told unasked nothing is asked about that time: a request could collide with it.
- A row that the user's bounds do not allow is left out.
- A few rows come first, for runs that have time for them alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from itertools import chain, cycle
from typing import Any, NamedTuple

from analyzer.catalogue import Command, Dialect, MotionKind, Verb
from conformance.claim import Inconclusive
from conformance.claims.crossed import looks
from conformance.claims.crossed.looks import Look, place
from conformance.claims.declare import Case
from conformance.gate.gate import Refused
from conformance.model import covering
from conformance.motion import arriving, course, declared, motion, ramp
from conformance.motion.course import Course, Span
from conformance.motion.declared import CALM, MOVES, QUICK, SUBDIVISION
from conformance.talk.exchange import Exchange
from conformance.talk.noise import CLOCK_SHARE, TOLD_LATE_NS
from conformance.talk.probe import MS, Probe, Until

#: Very slow, slow, middle, above 1500 and the highest; a mode that has a lower limit takes the highest for its own.
_SPEEDS, _HIGHEST = (4, 20, 150, 900, 1700, 3000), 3000
#: As sent, from the steepest on; 0 is for slow shafts.
_ACCELERATIONS, _AT_ONCE_MOST = (255, 0, 56, 200, 248, 253), 150
#: Nothing, within a turn, whole turns.
_TURNS = (0.21, 0.0, 1.0, 6.0, 21.0)
#: Those at which a speed is what is sent, and others, the finest one last.
_SUBDIVISIONS = (SUBDIVISION, 32, 8, 256)
#: The longest ramp and the longest move, and for how long a run keeps its speed.
_RAMP_NS, _MOVE_NS, _STEADY_NS = 450 * MS, 900 * MS, 110 * MS
#: The shortest ramp on which a change of speed is seen.
_SEEN_NS = 100 * MS
#: A speed to which the ways of the table need not come, and the share of the others to which they do.
_TRIANGLE, _PEAK = 150, 0.95
#: From the begin of a run to the command that changes it; from one look to the next one; until a shaft has settled.
_GOING_NS, _LOOK_NS, _SETTLES_NS = 90 * MS, 5 * MS, 100 * MS
#: What a row takes beside its motion: the looks at rest, and what settles.
_OVERHEAD_NS = 220 * MS
#: What real shafts lag behind the law, and before its end nothing is asked.
_LAG_NS, _UNASKED_NS = 10 * MS, 15 * MS
#: What is read on the way, but for the position.
_READS = (
    Verb.READ_SPEED,
    Verb.READ_STATUS,
    Verb.READ_ENCODER_CARRY,
    Verb.READ_PULSES,
    Verb.READ_ANGLE_ERROR,
    Verb.READ_ENABLED,
    Verb.READ_PROTECTION,
    Verb.READ_ZERO_STATUS,
    Verb.READ_IO,
)


class Row(NamedTuple):
    """The conditions of one motion. `start`: what the shaft does before: 0 stands, 1 turns the same way, -1 the other way."""

    command: str
    way: int
    rpm: int
    acceleration: int
    turns: float
    start: int
    mode: str
    subdivision: int

    def __str__(self) -> str:
        """Return it for people."""
        way = "a positive" if self.way > 0 else "a negative"
        start = {0: "from rest", 1: "from a run the same way", -1: "from a run the other way"}[self.start]
        by = f"by {self.turns:g} turns " if self.turns else ""
        text = f"{self.command} {by}{way} way at {self.rpm} rpm, acceleration {self.acceleration}, {start}, in {self.mode}"
        return text if self.subdivision == SUBDIVISION else f"{text}, at {self.subdivision} subdivisions"


def motions_of(dialect: Dialect) -> tuple[Command, ...]:
    """Return the motions that are crossed: those of drives that have a law of ramps."""
    return dialect.motions(MotionKind.RUN, *MOVES) if dialect.ramp is not None and declared.can_move(dialect) else ()


def cases(dialect: Dialect) -> Iterator[Case]:
    """Yield a case for each motion that is crossed."""
    return (Case(dialect, command) for command in motions_of(dialect))


def reads_of(dialect: Dialect) -> list[Command]:
    """Return what is read on the way, but for the position."""
    return [dialect.by_verb[verb] for verb in _READS if verb in dialect.by_verb]


def table(dialect: Dialect) -> tuple[Row, ...]:
    """Return the rows of all motions that are crossed."""
    modes = tuple((m, dialect.mode_speeds.get(m, _HIGHEST)) for m in declared.bus_modes(dialect) if "no_encoder" not in m)
    return _table(modes, tuple((c.name, declared.of(c).kind is MotionKind.RUN) for c in motions_of(dialect)))


@cache
def _table(modes: tuple[tuple[str, int], ...], commands: tuple[tuple[str, bool], ...]) -> tuple[Row, ...]:
    """`modes`: each with its highest speed; `commands`: each with whether it is a run."""
    limits, is_run = dict(modes), dict(commands)
    runs = is_run.__getitem__

    def fits(mode: str, subdivision: int, rpm: int) -> bool:
        # Whether a limit is one of the speed that is sent or of that of the shaft no manual says.
        either = max(rpm, rpm * subdivision // SUBDIVISION)
        return either <= limits[mode] or (rpm == _HIGHEST and subdivision == SUBDIVISION)

    def rises(rpm: int, acceleration: int) -> bool:
        return rpm <= _AT_ONCE_MOST if not acceleration else ramp.ramp_ns(0, rpm, acceleration) <= _RAMP_NS

    def ends(command: str, rpm: int, acceleration: int, turns: float) -> bool:
        if runs(command) or not turns:
            # A move by nothing shows neither a way nor a speed: one of them is enough.
            return not turns and (runs(command) or rpm == _TRIANGLE)
        reaches = rpm == _TRIANGLE or ramp.peak(turns, rpm, acceleration) >= _PEAK * rpm
        return reaches and ramp.move_ns(turns, rpm, acceleration) <= _MOVE_NS

    factors = {
        "command": tuple(is_run),
        "way": (1, -1),
        "rpm": _SPEEDS,
        "acceleration": _ACCELERATIONS,
        "turns": _TURNS,
        "start": (0, 1, -1),
        "mode": tuple(reversed(limits)),
        "subdivision": _SUBDIVISIONS,
    }
    found = covering.rows(
        factors,
        fits,
        rises,
        ends,
        lambda command, start: runs(command) or not start,
        # A change from one speed to another is seen on its ramp.
        lambda start, rpm, acceleration: not start or ramp.ramp_ns(CALM, rpm, acceleration) >= _SEEN_NS,
        lambda command, turns, mode: bool(turns) or runs(command) or mode == next(reversed(limits)),
        together=[
            ("command", "way", "rpm"),
            ("command", "way", "mode"),
            ("command", "way", "acceleration"),
            ("command", "way", "turns"),
        ],
        cost=lambda command, way, rpm, acceleration, turns, start, mode, subdivision: _about_ns(
            Row(command, way, rpm, acceleration, turns, start, mode, subdivision), runs=runs(command)
        ),
    )
    return tuple(sorted((Row(**row) for row in found), key=lambda row: (row.mode, row.subdivision)))


def first_rows(dialect: Dialect) -> tuple[Row, ...]:
    """Return few rows of the table, and short ones that turn, in which each condition comes once and each speed either way."""
    runs = {command.name: declared.of(command).kind is MotionKind.RUN for command in motions_of(dialect)}
    every = [row for row in table(dialect) if row.turns or runs[row.command]]
    return covering.few(
        every,
        lambda row: {*enumerate(row), (row.way, row.rpm), (row.way, row.command)},
        lambda row: _about_ns(row, runs=runs[row.command]),
    )


def _about_ns(row: Row, *, runs: bool) -> float:
    """Return how long a row takes about."""
    if not runs:
        return _OVERHEAD_NS + ramp.move_ns(row.turns, row.rpm, row.acceleration)
    begins = row.start * row.way * CALM
    up, down = ramp.ramp_ns(begins, row.way * row.rpm, row.acceleration), ramp.ramp_ns(row.rpm, 0, row.acceleration)
    return _OVERHEAD_NS + (_GOING_NS if row.start else 0) + up + _STEADY_NS + down


@dataclass(frozen=True)
class Tried:
    """A row that was tried. `begun`, `stopped`: the commands; `told`, `told_of_stop`: their statuses, in order.

    `refused`: one of them was, or was not answered. `damaged`: the line damaged what was said of them.
    `before`, `after`: looks at the shaft at rest; `during`: while it turned.
    """

    row: Row
    command: Command
    begun: Exchange
    stopped: Exchange | None
    refused: bool
    damaged: bool
    told: tuple[int, ...]
    told_of_stop: tuple[int, ...]
    before: tuple[Look, ...]
    during: tuple[Look, ...]
    after: tuple[Look, ...]
    course: Course
    stopping: Course | None
    #: How far a time may be off the ramp's law in addition to the clock: a step of the ramp, another rounding of a speed.
    slack_ns: float

    @property
    def latest_ns(self) -> float:
        """How long the slowest reply took."""
        looked = [look.span[1] - look.span[0] for look in (*self.before, *self.during, *self.after)]
        asked = [float(e.answers[-1].last_ns - e.sent_ns) for e in (self.begun, self.stopped) if e is not None and e.answers]
        return max(looked + asked)

    def spans(self, look: Look) -> tuple[Course, Span]:
        """Return the course that the shaft was on at a look, and the times on it between which that was."""
        if self.stopped is not None and self.stopping is not None and look.span[0] >= self.stopped.sent_ns:
            return self.stopping, self._since(self.stopped, look.span)
        return self.course, self._since(self.begun, look.span)

    def turns(self, look: Look) -> Span:
        """Return between which places the shaft was at a look, in turns from where it began."""
        on, span = self.spans(look)
        low, high = on.turns(*span)
        if on is not self.course and self.stopped is not None:
            reply = self.stopped.reply
            assert reply is not None  # it was taken
            base = self.course.turns(*self._since(self.begun, (self.stopped.sent_ns, reply.first_ns)))
            low, high = low + base[0], high + base[1]
        return low, high

    def _since(self, exchange: Exchange, span: Span) -> Span:
        """Return a span on the clock of a course that began with a command: a drive may be slow, or a little fast."""
        reply = exchange.reply
        assert reply is not None  # it was taken
        first_ns = (span[0] - reply.first_ns - self.slack_ns - _LAG_NS) / (1 + ramp.SLOW_QUIRK)
        return first_ns, (span[1] - exchange.sent_ns + self.slack_ns) / (1 - CLOCK_SHARE)

    def places(self, looks: tuple[Look, ...]) -> list[Look]:
        """Return the looks at the position among some."""
        return [look for look in looks if look.read.verb is Verb.READ_POSITION and look.values is not None]

    @property
    def went(self) -> float:
        """How far the shaft went from rest to rest, in counts."""
        ends = [self.places(looks) for looks in (self.before, self.after)]
        if not all(ends):
            raise Inconclusive("the position cannot be read")
        before, after = (place(looks[-1]) for looks in ends)
        return after - before


def sense(command: Command, rows: tuple[Tried, ...]) -> int:
    """Return 1 where a positive way raises the position, else -1: by the first row where that is not the manual's word."""
    if declared.of(command).kind in MOVES and not declared.takes_pulses(command):
        return 1
    return next((1 if tried.went * tried.row.way > 0 else -1 for tried in rows if not tried.row.start and moved(tried)), 1)


def moved(tried: Tried) -> bool:
    """Say whether a row asks the shaft to go somewhere."""
    return bool(tried.course.top)


def sound(rows: tuple[Tried, ...]) -> list[Tried]:
    """Return the rows whose motion was taken, and of which the line damaged nothing. Raises Inconclusive where few are left."""
    found = [tried for tried in rows if not tried.refused and not tried.damaged]
    if 2 * sum(tried.damaged for tried in rows) > len(rows):
        raise Inconclusive("the line damaged something of most motions")
    return found


def crossed(probe: Probe, command: Command) -> tuple[Tried, ...]:
    """Carry out the rows of a command, those aside that were carried out already, and return what was seen."""
    own = (row for row in table(probe.dialect) if row.command == command.name)
    first, rows = looks.divided(lambda: first_of(probe, command), own)
    return (*first, *_carried_out(probe, rows)) if rows else first


def first_of(probe: Probe, command: Command) -> tuple[Tried, ...]:
    """Return what the first rows of a command showed."""
    return tuple(tried for tried in probe.recorded(crossed_first) if tried.command.name == command.name)


def crossed_first(probe: Probe) -> tuple[Tried, ...]:
    """Carry out the first rows and return what was seen."""
    return _carried_out(probe, first_rows(probe.dialect))


def _carried_out(probe: Probe, rows: Iterable[Row]) -> tuple[Tried, ...]:
    position = probe.command(Verb.READ_POSITION)
    reads = cycle([read for other in reads_of(probe.dialect) for read in (other, position)])
    found: list[Tried] = []
    ready: tuple[str, int] = ("", 0)
    rest: tuple[Look, ...] = ()
    refused: Refused | None = None
    for row in rows:
        try:
            if ready != (row.mode, row.subdivision):
                ready = (row.mode, row.subdivision)
                sent = declared.finest(probe.dialect) if row.subdivision == _SUBDIVISIONS[-1] else row.subdivision
                motion.ready_to_move(probe, row.mode, subdivision=sent)
                # A shaft that stood still stands; it is looked at anew.
                rest = looks.at_rest(probe, reads_of(probe.dialect)) if _stands(rest) else ()
            if not _stands(rest):
                motion.stand_still(probe)
                rest = looks.at_rest(probe, reads_of(probe.dialect))
            tried = _try(probe, probe.command(row.command), row, reads, rest)
            if any(e is not None and e.unanswered for e in (tried.begun, tried.stopped)):
                # The line may have lost it; what is not answered twice is the drive's.
                motion.stand_still(probe)
                rest = looks.at_rest(probe, reads_of(probe.dialect))
                tried = _try(probe, probe.command(row.command), row, reads, rest)
            found.append(tried)
            rest = tried.after
        except Refused as error:
            refused, rest = error, ()
            motion.stand_still(probe)
    if refused is not None and not found:
        raise refused
    return tuple(found)


def _try(probe: Probe, command: Command, row: Row, reads: Iterator[Command], before: tuple[Look, ...]) -> Tried:
    runs = declared.of(command).kind is MotionKind.RUN
    if row.start:
        run = probe.command(Verb.RUN_SPEED)
        motion.ask(probe, run, rpm=row.start * row.way * CALM, acceleration=QUICK, subdivision=row.subdivision)
        probe.wait(_GOING_NS)
        # The change of speed is short: what the drive says of it is asked first.
        reads = chain([probe.command(Verb.READ_STATUS), probe.command(Verb.READ_POSITION)] * 2, reads)
    since = len(probe.traffic)
    how: dict[str, Any] = {"acceleration": row.acceleration, "subdivision": row.subdivision}
    how["rpm"] = row.way * row.rpm if runs else row.rpm
    begun = last = motion.ask(probe, command, row.way * row.turns * 360, quiet_ns=0, **how)
    on, slack_ns = _course(probe.dialect, command, row, begun)
    lasts_ns, refused = on.steady_ns, _refused(probe, begun)
    during: list[Look] = []
    stopped = stopping = None
    if not refused:
        reads = _status_in_each_leg(probe, reads, begun, on, slack_ns)
    if runs and not refused:
        during += looks.on_the_way(probe, reads, _LOOK_NS, _ends(begun, lasts_ns, slack_ns) + _STEADY_NS)
        stopped = last = probe.ask(probe.dialect.stops_of(command)[0], {"acceleration": row.acceleration}, quiet_ns=0)
        stopping = course.run(on.legs[-1].last, 0, row.acceleration)
        lasts_ns, refused = stopping.steady_ns, _refused(probe, stopped)
    if not refused:
        asked = last.command
        assert asked is not None  # it was asked for
        if declared.of(asked).tells_end:
            until_ns = last.sent_ns + int(lasts_ns - slack_ns) - _UNASKED_NS - 2 * probe.noise.latency_ns
            during += looks.on_the_way(probe, reads, _LOOK_NS, until_ns)
            if 2 not in arriving.statuses(probe.traffic[since:], asked):
                left_ns = _ends(last, lasts_ns, slack_ns) - probe.gate.now_ns()
                probe.listen(max(0, left_ns) + TOLD_LATE_NS + _SETTLES_NS, Until.REPLY)
        else:
            during += looks.on_the_way(probe, reads, _LOOK_NS, _ends(last, lasts_ns, slack_ns))
        probe.wait(_SETTLES_NS)
    after = looks.at_rest(probe, reads_of(probe.dialect))
    told = tuple(arriving.statuses(probe.traffic[since:], command)) if command.replies.status else ()
    damaged = looks.damaged(probe.traffic[since:], told, ends=last.command is not None and declared.of(last.command).tells_end)
    told, of_stop = (told[:1], told[1:]) if stopped is not None else (told, ())
    return Tried(
        row, command, begun, stopped, refused, damaged, told, of_stop, before, tuple(during), after, on, stopping, slack_ns
    )


def _status_in_each_leg(
    probe: Probe, reads: Iterator[Command], begun: Exchange, on: Course, slack_ns: float
) -> Iterator[Command]:
    """Yield reads, and the status first when the shaft has surely begun to rise, to keep its speed, or to fall."""
    assert begun.reply is not None  # it was taken
    since_ns = begun.reply.first_ns + slack_ns + _LAG_NS
    begin = (leg.begins_ns for leg in on.legs[:-1] if leg.lasts_ns > TOLD_LATE_NS)
    due = [since_ns + (begins_ns + TOLD_LATE_NS) * (1 + ramp.SLOW_QUIRK) for begins_ns in begin]
    while True:
        passed = [due_ns for due_ns in due if due_ns <= probe.gate.now_ns()]
        if passed:
            due = due[len(passed) :]
            yield probe.command(Verb.READ_STATUS)
            yield probe.command(Verb.READ_POSITION)
        else:
            yield next(reads)


def _refused(probe: Probe, exchange: Exchange) -> bool:
    """Say whether a motion was refused, or not answered."""
    return not exchange.is_read or probe.refused(exchange)


def _ends(exchange: Exchange, lasts_ns: float, slack_ns: float) -> int:
    """Return when a course surely is over."""
    return exchange.sent_ns + int(lasts_ns * (1 + ramp.SLOW_QUIRK) + slack_ns)


def _course(dialect: Dialect, command: Command, row: Row, begun: Exchange) -> tuple[Course, float]:
    """Return the course that a row asks for, after rounding, and by how much its times may be off."""
    of, law = declared.of(command), dialect.subdivision
    sent = begun.values[of.speed]
    plain = law is None or row.subdivision in law.plain
    rpm = sent if plain or law is None else sent * law.counted_at / row.subdivision
    rpm = min(rpm, dialect.mode_speeds.get(row.mode, _HIGHEST))
    ramps = 1 if of.kind is MotionKind.RUN else 2
    # Whether a ramp goes by the speed of the shaft or by that which was sent no manual says.
    other_ns = 0.0 if plain else abs(ramp.ramp_ns(0, sent, row.acceleration) - ramp.ramp_ns(0, rpm, row.acceleration)) * ramps
    slack_ns = ramp.slack_ns(row.acceleration, ramps) + other_ns
    if of.kind is MotionKind.RUN:
        return course.run(row.start * row.way * CALM, row.way * rpm, row.acceleration), slack_ns
    turn = declared.units_per_turn(dialect, command, row.subdivision)
    return course.move(round(row.way * row.turns * turn) / turn, rpm, row.acceleration), slack_ns


def _stands(looks: tuple[Look, ...]) -> bool:
    places = [look.values["position"] for look in looks if look.values is not None and "position" in look.values]
    return len(places) > 1 and abs(places[-1] - places[0]) <= 1
