"""What comes while a motion slows down: a newer motion, the same way or round, a stop, the emergency stop, and disabling.

    older motion x what comes x way        any two, and each older motion with each thing that comes

Rules kept here:
- A run slows down by a stop with a ramp, a move before its end; it has some degrees still to go when the newer command comes.
- A command that comes too late, behind the end, is carried out from rest: that is no other place.
- From where a move by a distance counts the rest of the older way no manual says: both are right.
- A few rows come first, for runs that have time for them alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Verb
from conformance.claim import Inconclusive
from conformance.claims.crossed import looks
from conformance.claims.crossed.course import motions_of
from conformance.claims.declare import Case
from conformance.claims.motion.motion_claim import expect_between, expect_row_taken, of_motion
from conformance.gate.gate import Refused
from conformance.model import covering
from conformance.motion import arriving, declared, motion, ramp
from conformance.motion.attempts import undamaged
from conformance.motion.declared import CALM, QUICK, SUBDIVISION
from conformance.motion.motion import Sample
from conformance.talk.exchange import Exchange
from conformance.talk.noise import CLOCK_SHARE
from conformance.talk.probe import MS, SECOND_NS, Probe

#: The ramp by which the older motion slows down, 1.8 ms for one rpm, and what of it is over when the newer command comes.
_RAMP, _DONE = 220, 0.3
#: The way of an older move, which keeps its speed for a moment, and that of the newer one (degrees).
_WAY, _NEWER = 48, 36
#: What comes: the same motion again, the same way or round; its stop at once; the emergency stop; and disabling.
_ON, _ROUND, _STOP, _EMERGENCY, _OFF = "on", "round", "stop", "emergency_stop", "off"
#: What the shaft may lag, how long it is looked at whether it stands, and by when a run has its speed.
_LAG_NS, _LOOK_NS, _RUNS_NS = 10 * MS, 60 * MS, 60 * MS


class Row(NamedTuple):
    """A motion and what comes while it slows down."""

    older: str
    comes: str
    way: int

    def __str__(self) -> str:
        """Return it for people."""
        what = {_ON: "the same command again", _ROUND: "the same command the other way"}.get(self.comes, self.comes)
        return f"{what} while {self.older} {'a positive' if self.way > 0 else 'a negative'} way slows down"


@dataclass(frozen=True)
class Tried:
    """A row that was tried. `start`, `before`, `soon`, `end`: where the shaft was at first, at the command, next, and at rest.

    `rpm`: of a newer run.
    """

    row: Row
    newer: Exchange
    refused: bool
    start: Sample
    before: Sample
    soon: Sample
    end: Sample
    rpm: Sample | None

    @property
    def sense(self) -> int:
        """Return 1 where the older motion raised the position, -1 where it lowered it, 0 where it did not turn the shaft."""
        went = self.before.value - self.start.value
        return 0 if abs(went) < 2 else 1 if went > 0 else -1


def _stops_at_once(dialect: Dialect) -> dict[str, Command]:
    return {_EMERGENCY: dialect.by_verb[Verb.EMERGENCY_STOP], _OFF: dialect.by_verb[Verb.ENABLE]}


def table(dialect: Dialect) -> tuple[Row, ...]:
    """Return the rows of all motions."""
    factors = {
        "older": tuple(command.name for command in motions_of(dialect)),
        "comes": (_ON, _ROUND, _STOP, _EMERGENCY, _OFF),
        "way": (1, -1),
    }
    return tuple(Row(**row) for row in covering.rows(factors))


def first_rows(dialect: Dialect) -> tuple[Row, ...]:
    """Return few rows of the table, in which each motion and each thing that comes is there once, and both ways."""
    return covering.few(table(dialect), lambda row: set(enumerate(row)), lambda row: 1)


def slowed(probe: Probe) -> tuple[Tried, ...]:
    """Carry out all rows, those aside that were carried out first, and return what was seen."""
    first, rows = looks.divided(lambda: probe.recorded(slowed_first), table(probe.dialect))
    return (*first, *_carried_out(probe, rows))


def slowed_first(probe: Probe) -> tuple[Tried, ...]:
    """Carry out the first rows and return what was seen."""
    return _carried_out(probe, first_rows(probe.dialect))


def _carried_out(probe: Probe, rows: Iterable[Row]) -> tuple[Tried, ...]:
    motion.ready_to_move(probe, declared.bus_modes(probe.dialect)[-1], subdivision=SUBDIVISION)
    rest = motion.stand_still(probe)
    found: list[Tried] = []
    refused: Refused | None = None
    for row in rows:
        try:
            found.append(undamaged(probe, _try, row, rest=rest))
            rest = found[-1].end
        except Refused as error:
            refused = error
            rest = motion.stand_still(probe)
    if refused is not None and not found:
        raise refused
    return tuple(found)


def _try(probe: Probe, row: Row, start: Sample) -> Tried:
    command = probe.command(row.older)
    runs = declared.of(command).kind is MotionKind.RUN
    place = motion.place(probe, command)
    if runs:
        begun = motion.begin(probe, command, rpm=row.way * CALM, acceleration=QUICK, quiet_ns=0)
        probe.wait(begun.sent_ns + 2 * int(ramp.ramp_ns(0, CALM, QUICK)) - probe.gate.now_ns())
        begun = probe.ask(probe.dialect.stops_of(command)[0], {"acceleration": _RAMP}, quiet_ns=0)
        falls_ns = 0.0
    else:
        begun = motion.begin(probe, command, row.way * _WAY, rpm=CALM, acceleration=_RAMP, start=place, quiet_ns=0)
        falls_ns = ramp.move_ns(_WAY / 360, CALM, _RAMP) - ramp.ramp_ns(0, CALM, _RAMP)
    comes_ns = begun.sent_ns + int(falls_ns + _DONE * ramp.ramp_ns(0, CALM, _RAMP))
    # The look before it takes its time too.
    probe.wait(comes_ns - probe.gate.now_ns() - 12 * probe.rig.byte_ns)
    before = motion.position(probe)
    newer, values = _comes(probe, command, row)
    if newer is command:
        way = row.way if row.comes == _ON else -row.way
        target = 0 if runs else _newer_way(command, row.comes) * row.way
        exchange = motion.ask(
            probe, command, target, rpm=way * CALM if runs else CALM, acceleration=QUICK, start=place, quiet_ns=0
        )
    else:
        exchange = probe.ask(newer, values, quiet_ns=0)
    refused = not exchange.is_read or probe.refused(exchange)
    rpm = None
    if newer is command and runs:
        probe.wait(exchange.sent_ns + _RUNS_NS - probe.gate.now_ns())
        rpm, soon = motion.speed(probe), before
        end = motion.stand_still(probe)
    else:
        probe.wait(exchange.sent_ns + 2 * _LAG_NS - probe.gate.now_ns())
        if newer is command:
            most_ns = (_WAY + _NEWER + 12) / 6 / CALM * (1 + CLOCK_SHARE) * SECOND_NS
            soon, end = before, arriving.come_to_rest(probe, exchange, int(_NEWER / 6 / CALM * SECOND_NS), int(most_ns))
        else:
            soon = motion.position(probe)
            probe.wait(_LOOK_NS)
            end = motion.wait_standing(probe)
    if row.comes == _OFF:
        motion.switch(probe, True)
    return Tried(row, exchange, refused, start, before, soon, end, rpm)


def _newer_way(command: Command, comes: str) -> int:
    """Return how far a newer move goes that way, in degrees: one to a place is told it from where the older one began."""
    if comes == _ROUND:
        return -_NEWER
    return _NEWER + (_WAY if declared.of(command).kind is MotionKind.MOVE_TO else 0)


def _comes(probe: Probe, command: Command, row: Row) -> tuple[Command, dict[str, int]]:
    if row.comes == _STOP:
        return probe.dialect.stops_of(command)[0], {"acceleration": 0}
    if row.comes == _OFF:
        return declared.switching(probe.dialect, False)
    return (probe.command(Verb.EMERGENCY_STOP), {}) if row.comes == _EMERGENCY else (command, {})


def _cases(dialect: Dialect) -> Iterator[Case]:
    """Yield each command that comes, with what tells its rows."""
    every = motions_of(dialect)
    if not every or Verb.EMERGENCY_STOP not in dialect.by_verb or Verb.ENABLE not in dialect.by_verb:
        return
    stops = [dialect.stops_of(command)[0] for command in every]
    at_once = _stops_at_once(dialect)
    risks = frozenset().union(*(c.all_risks for c in (*every, *stops, *at_once.values())))
    facts = {"risks": declared.risks(dialect, *risks), "parameters": {}, "at_best": Certainty.LIKELY}
    for command in every:
        yield Case(dialect, command, {"older": command.name, "comes": (_ON, _ROUND)}, facts)
        yield Case(dialect, dialect.stops_of(command)[0], {"older": command.name, "comes": (_STOP,)}, facts)
    for comes, command in at_once.items():
        yield Case(dialect, command, {"older": "", "comes": (comes,)}, facts)


@of_motion(each=_cases, name="{command}/while-slowing", refuted_by="a shaft that goes on as before, or elsewhere, or a refusal")
def _while_slowing(probe: Probe, command: Command, older: str, comes: tuple[str, ...]) -> None:
    """{command} is carried out while a motion slows down, as it is from rest."""
    _judge(probe, command, [tried for tried in probe.recorded(slowed) if _tells(tried.row, older, comes)])


def _first_cases(dialect: Dialect) -> Iterator[Case]:
    """Yield those of them that the first rows tell of."""
    for case in _cases(dialect):
        if any(_tells(row, case["older"], case["comes"]) for row in first_rows(dialect)):
            yield case


@of_motion(
    each=_first_cases,
    name="{command}/while-slowing-first",
    refuted_by="a shaft that goes on as before, or elsewhere, or a refusal",
)
def _first_while_slowing(probe: Probe, command: Command, older: str, comes: tuple[str, ...]) -> None:
    """{command} is carried out while a motion slows down, in one condition, as it is from rest."""
    _judge(probe, command, [tried for tried in probe.recorded(slowed_first) if _tells(tried.row, older, comes)])


def _tells(row: Row, older: str, comes: tuple[str, ...]) -> bool:
    return row.comes in comes and row.older == (older or row.older)


def _judge(probe: Probe, command: Command, every: Sequence[Tried]) -> None:
    if not any(tried.sense for tried in every):
        raise Inconclusive("no motion turned the shaft")
    text = f"{command.name} is not carried out while a motion slows down"
    for tried in (tried for tried in every if tried.sense):
        exchange = tried.newer
        expect_row_taken(probe, exchange, tried.row, text)
        if tried.refused:
            continue
        within = motion.miss(probe) + probe.noise.swing + 1
        if tried.rpm is not None:
            wanted = float(tried.sense * CALM * (1 if tried.row.comes == _ON else -1))
            within = 2 + CALM * 2 * CLOCK_SHARE + tried.rpm.noise
            expect_between(probe, tried.rpm.value, (wanted, wanted), within, tried.row, text, exchange, "rpm")
        elif tried.row.comes in (_ON, _ROUND):
            expect_between(probe, tried.end.value, _ends(probe, tried), within, tried.row, text, exchange)
        else:
            # What it would have gone on is more than a shaft settles.
            expect_between(probe, tried.end.value - tried.soon.value, (0.0, 0.0), within, tried.row, text, exchange)


def _ends(probe: Probe, tried: Tried) -> tuple[float, float]:
    """Return between which places a newer move ends, in degrees."""
    command = probe.command(tried.row.older)
    way = tried.sense * (1 if tried.row.comes == _ON else -1)
    if declared.of(command).kind is MotionKind.MOVE_TO:
        place = tried.start.value + tried.sense * _newer_way(command, tried.row.comes)
        return place, place
    low, high = sorted((tried.before.value, tried.start.value + tried.sense * _WAY))
    return low + way * _NEWER, high + way * _NEWER
