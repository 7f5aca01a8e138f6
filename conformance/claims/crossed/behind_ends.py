"""Moves behind motions that were ended before their end: they begin where the shaft stands, and nothing is left over.

    move x what ended the older motion      all of them
    older motion, its way                   any two, and each with any of those

Rules kept here:
- A row takes a third of a second: the older motion is far from its end when it is ended, and the move that follows is short.
- Which way a direction or a sign turns the shaft is not judged: a move goes as far as asked, to one side or the other.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Risk, Verb
from conformance.claim import Inconclusive
from conformance.claims.crossed.course import motions_of
from conformance.claims.declare import Case
from conformance.claims.motion.motion_claim import of_motion
from conformance.model import covering
from conformance.motion import arriving, declared, motion, ramp
from conformance.motion.attempts import undamaged
from conformance.motion.declared import CALM, MOVES, QUICK, SUBDIVISION
from conformance.motion.motion import Sample
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, SECOND_NS, Probe

#: The way of the older motion, which it does not get to, and that of the move (degrees), with its speed (rpm).
_FAR, _WAY, _RPM = 720, 45, 150
#: From the begin of the older motion to what ends it, and what a shaft may lag behind the end of a move.
_GOING_NS, _LATE_NS = 80 * MS, 60 * MS
_ITS_STOP = "its stop"
#: How long a shaft that nothing drives runs out at most.
_RUNS_OUT_NS = 3 * SECOND_NS // 2


class Row(NamedTuple):
    """A motion, what ended it (its stop by a ramp, or the name of a command), and the move that follows."""

    command: str
    ended: str
    older: str
    way: int

    def __str__(self) -> str:
        """Return it for people."""
        way = "a positive" if self.way > 0 else "a negative"
        return f"{self.command} behind {self.older} {way} way that {self.ended} ended"


@dataclass(frozen=True)
class Tried:
    """A row that was tried. `stood`: whether the shaft came to rest when the older motion was ended.

    `went`: how far that turned the shaft; `start`, `end`: of the move.
    """

    row: Row
    move: Exchange
    refused: bool
    stood: bool
    went: float
    start: Sample
    end: Sample


def _ends(dialect: Dialect) -> dict[str, Verb | None]:
    """Return what ends every motion: its stop, the emergency stop, and disabling the motor (None: its stop)."""
    return {_ITS_STOP: None} | {v.value: v for v in (Verb.EMERGENCY_STOP, Verb.ENABLE) if v in dialect.by_verb}


def _moves(dialect: Dialect) -> list[Command]:
    return [command for command in motions_of(dialect) if declared.of(command).kind in MOVES]


def table(dialect: Dialect) -> tuple[Row, ...]:
    """Return the rows of all moves."""
    factors = {
        "command": tuple(command.name for command in _moves(dialect)),
        "ended": tuple(_ends(dialect)),
        "older": tuple(command.name for command in motions_of(dialect)),
        "way": (1, -1),
    }
    return tuple(Row(**row) for row in covering.rows(factors))


def moved_on(probe: Probe) -> tuple[Tried, ...]:
    """Carry out all rows and return what was seen."""
    motion.ready_to_move(probe, declared.bus_modes(probe.dialect)[-1], subdivision=SUBDIVISION)
    rest = motion.stand_still(probe)
    found = []
    for row in table(probe.dialect):
        found.append(undamaged(probe, _try, row, rest=rest))
        rest = found[-1].end
    return tuple(found)


def _try(probe: Probe, row: Row, rest: Sample) -> Tried:
    older, move = probe.command(row.older), probe.command(row.command)
    rpm = row.way * CALM if declared.of(older).kind is MotionKind.RUN else CALM
    motion.begin(probe, older, row.way * _FAR, rpm=rpm, acceleration=QUICK, quiet_ns=0)
    probe.wait(_GOING_NS)
    verb = _ends(probe.dialect)[row.ended]
    if verb is None:
        probe.ask(probe.dialect.stops_of(older)[0], {"acceleration": QUICK})
    elif verb is Verb.ENABLE:
        motion.switch(probe, False)
        motion.switch(probe, True)
    else:
        probe.ask(verb)
    try:
        start, stood = motion.wait_standing(probe, limit_ns=_RUNS_OUT_NS), True
    except Inconclusive:
        start, stood = motion.stand_still(probe), False
    exchange = motion.ask(probe, move, _WAY, rpm=_RPM, acceleration=QUICK, quiet_ns=0)
    refused = motion.refused(probe, exchange)
    law_ns = int(ramp.move_ns(_WAY / 360, _RPM, QUICK))
    end = arriving.come_to_rest(probe, exchange, law_ns, law_ns + _LATE_NS)
    return Tried(row, exchange, refused, stood, start.value - rest.value, start, end)


def _cases(dialect: Dialect) -> Iterator[Case]:
    ends = [dialect.by_verb[verb] for verb in _ends(dialect).values() if verb is not None]
    risks = frozenset[Risk]().union(*(c.all_risks for c in (*motions_of(dialect), *ends))) - {Risk.UNKNOWN}
    for command in _moves(dialect):
        yield Case(dialect, command, facts={"risks": declared.risks(dialect, *risks, Risk.UNBOUNDED)})


@of_motion(
    each=_cases, name="{command}/behind-ended", refuted_by="a shaft that goes elsewhere, or a refusal", at_best=Certainty.LIKELY
)
def _behind_ended(probe: Probe, command: Command) -> None:
    """{command} behind a motion that was ended early goes as far as asked: behind a stop, an emergency stop, and disabling."""
    every = [tried for tried in probe.recorded(moved_on) if tried.row.command == command.name]
    if not any(abs(tried.went) > motion.same(probe) for tried in every):
        raise Inconclusive("no older motion turned the shaft")
    for tried in every:
        text = f"{command.name} does not go on from where an ended motion left the shaft"
        expected = f"{_WAY} degrees: {tried.row}"
        goes_on = "an ended motion goes on"
        probe.expect("a shaft that turns", holds=tried.stood, expected=f"one that stands: {tried.row}", refutes=goes_on)
        got = "a refusal or no answer"
        probe.expect(got, holds=not tried.refused, expected=expected, refutes=text, exchange=tried.move)
        probe.expect(
            abs(tried.end.value - tried.start.value),
            near=_WAY,
            within=motion.miss(probe) + motion.same(probe),
            unit="degrees",
            expected=expected,
            refutes=text,
            exchange=tried.move,
        )
