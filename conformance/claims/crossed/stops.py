"""Each stop in all conditions: what it ends, by which acceleration, which way the shaft turns, how fast, in which work mode.

    motion x way x ramp, work mode x way x ramp      all of them; a ramp is an acceleration, or the emergency stop
    motion x way x speed                             likewise
    each move                                        disabling too

Rules kept here:
- A row takes a third of a second: the motion is far from its end when it is stopped.
- A stop is held against the way of its ramp, from where the shaft was when it came; nothing is asked before its end is told.
- Nothing is stopped at once above 150 rpm.
- A row that the user's bounds do not allow is left out.
- A few rows come first, for runs that have time for them alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Risk, Verb
from conformance.claim import Inconclusive
from conformance.claims.crossed import looks
from conformance.claims.crossed.course import motions_of
from conformance.claims.declare import Case
from conformance.claims.motion.motion_claim import expect_between, expect_row_taken, of_motion
from conformance.gate.gate import Refused
from conformance.model import covering
from conformance.motion import arriving, declared, motion, ramp
from conformance.motion.attempts import undamaged
from conformance.motion.declared import SUBDIVISION
from conformance.motion.motion import Sample
from conformance.talk.exchange import Exchange
from conformance.talk.noise import CLOCK_SHARE, TOLD_LATE_NS
from conformance.talk.probe import MS, SECOND_NS, Probe, Until

#: What stops: disabling, the emergency stop, at once, from the top bit on, and the steepest ramp.
_OFF, _EMERGENCY, _STOPS = -2, -1, (-1, 0, 255, 200, 128)
_HOW = {_OFF: "disabling", _EMERGENCY: "the emergency stop"}
_SPEEDS, _AT_ONCE_MOST, _FAST = (60, 30, 150, 1200), 150, 1200
#: The steepest ramp begins each motion, which is to go on for so many turns more than the fastest one makes.
_STEEP, _TURNS, _FAST_TURNS = 255, 3, 10
#: The longest ramp; from the begin of a motion to its stop; what a shaft lags; how long it is looked at whether it stands.
_RAMP_NS, _GOING_NS, _LAG_NS, _LOOK_NS = 200 * MS, 80 * MS, 10 * MS, 60 * MS
#: The status of a motion that is complete.
_COMPLETE = 2
#: What a ramp may be off the law, and by how many degrees more a stop may end elsewhere.
_RAMP_SHARE, _BESIDE = 0.1, 1.0


class Row(NamedTuple):
    """A motion and its stop. `stop`: the acceleration as sent, -1 for the emergency stop, -2 for disabling the motor.

    `of`: the motion whose stop it is, where that is another one.
    """

    command: str
    way: int
    stop: int
    rpm: int
    mode: str
    of: str = ""

    def __str__(self) -> str:
        """Return it for people."""
        way = "a positive" if self.way > 0 else "a negative"
        how = _HOW.get(self.stop, f"acceleration {self.stop}") + (f" of {self.of}" if self.of else "")
        return f"{self.command} {way} way at {self.rpm} rpm in {self.mode}, stopped by {how}"


Rows = Callable[[Dialect], tuple[Row, ...]]


@dataclass(frozen=True)
class Tried:
    """A row that was tried. `before`: where the shaft was before the stop was sent; `sense`: which way it turned.

    `start`, `at`, `end`: where it was first, when the stop was to be over, and a while later. `told`: the statuses of the stop.
    `ends`: how often the end of the motion was told, less those of its stop by a ramp.
    `pulses`: the count of pulses at `start` and at `end`, where the dialect has one.
    """

    row: Row
    stop: Exchange
    refused: bool
    start: Sample
    before: Sample
    sense: int
    at: Sample
    end: Sample
    told: tuple[int, ...]
    ends: int
    pulses: tuple[int, ...]

    @property
    def between(self) -> tuple[float, float]:
        """How far the shaft goes from `before` on if the stop keeps to its ramp, least and most, in degrees."""
        reply = self.stop.reply
        assert reply is not None  # it was taken
        begun = (self.stop.sent_ns - self.before.t_ns - self.before.spread_ns) / SECOND_NS
        done = (reply.first_ns + _LAG_NS - self.before.t_ns + self.before.spread_ns) / SECOND_NS
        ramped = abs(ramp.ramp_turns(self.row.rpm, 0, max(self.row.stop, 0))) * 360
        slack = ramp.slack_ns(max(self.row.stop, 0)) / SECOND_NS * self.row.rpm * 6
        low = self.row.rpm * 6 * (1 - CLOCK_SHARE) * max(0.0, begun - _LAG_NS / SECOND_NS) + ramped * (1 - _RAMP_SHARE) - slack
        high = self.row.rpm * 6 * (1 + CLOCK_SHARE) * done + ramped * (1 + _RAMP_SHARE) + slack
        return low, high


def table(dialect: Dialect) -> tuple[Row, ...]:
    """Return the rows of all motions."""
    limits = {m: dialect.mode_speeds.get(m, _FAST) for m in reversed(declared.bus_modes(dialect))}
    factors = {
        "command": tuple(command.name for command in motions_of(dialect)),
        "way": (1, -1),
        "stop": _STOPS,
        "rpm": _SPEEDS,
        "mode": tuple(limits),
    }

    def rises(rpm: int, stop: int) -> bool:
        return rpm <= _AT_ONCE_MOST if stop <= 0 else ramp.ramp_ns(rpm, 0, stop) <= _RAMP_NS

    together = [("command", "way", "stop"), ("mode", "way", "stop"), ("command", "way", "rpm")]
    found = covering.rows(factors, rises, lambda mode, rpm: rpm <= limits[mode], together=together)
    rows = {Row(**row) for row in found}
    # The emergency stop of each mode and way is seen by two motions: what hurts is caught twice.
    twice = [command.name for command in motions_of(dialect)][:2]
    rows |= {Row(name, way, _EMERGENCY, 60, mode) for name in twice for way in (1, -1) for mode in limits}
    return tuple(sorted(rows, key=lambda row: (row.mode, row)))


def first_rows(dialect: Dialect) -> tuple[Row, ...]:
    """Return few rows of the table, in which each motion, mode and way meets a ramp and the emergency stop."""

    def shows(row: Row) -> set[Any]:
        at_once = row.stop == _EMERGENCY
        return {*enumerate(row), (row.command, at_once), (row.mode, row.way, at_once)}

    return covering.few(table(dialect), shows, lambda row: 1)


def disablings(dialect: Dialect) -> tuple[Row, ...]:
    """Return a row of each move that disabling ends, in one mode and way; a run has a claim of its own."""
    modes, moves = (
        declared.bus_modes(dialect),
        [c.name for c in motions_of(dialect) if declared.of(c).kind is not MotionKind.RUN],
    )
    rows = (Row(name, (-1) ** n, _OFF, 60, modes[n % len(modes)]) for n, name in enumerate(moves))
    return tuple(sorted(rows, key=lambda row: (row.mode, row)))


def strangers(dialect: Dialect) -> tuple[Row, ...]:
    """Return the rows of a run that the stops of moves end."""
    runs, mode = dialect.motions(MotionKind.RUN), declared.bus_modes(dialect)[-1]
    moves = enumerate(command.name for command in motions_of(dialect) if command not in runs)
    return tuple(Row(run.name, -((-1) ** n), 200 * (n % 2), 60, mode, name) for run in runs for n, name in moves)


def stopped(probe: Probe, rows_of: Rows) -> tuple[Tried, ...]:
    """Carry out rows, those of the table aside that were carried out first, and return what was seen."""
    rows = rows_of(probe.dialect)
    if rows_of is not table:
        return _carried_out(probe, rows)
    first, others = looks.divided(lambda: probe.recorded(stopped, first_rows), rows)
    return (*first, *_carried_out(probe, others))


def _carried_out(probe: Probe, rows: Iterable[Row]) -> tuple[Tried, ...]:
    found: list[Tried] = []
    ready = ""
    refused: Refused | None = None
    for row in rows:
        try:
            if ready != row.mode:
                motion.ready_to_move(probe, row.mode, subdivision=SUBDIVISION)
                ready = row.mode
                motion.stand_still(probe)
            found.append(undamaged(probe, _try, row))
        except Refused as error:
            refused = error
        if refused is not None or not found or not _stands(probe, found[-1]):
            try:
                _come_to_rest(probe)
            except Inconclusive:
                # What does not stop is judged; no row can begin behind it.
                break
    if refused is not None and not found:
        raise refused
    return tuple(found)


def _come_to_rest(probe: Probe) -> None:
    """Stop by a ramp, and where that does not stop the shaft by the emergency stop. Raises Inconclusive where none does."""
    try:
        motion.stand_still(probe, limit_ns=SECOND_NS)
    except Inconclusive:
        probe.ask(Verb.EMERGENCY_STOP)
        motion.wait_standing(probe)


def _stands(probe: Probe, tried: Tried) -> bool:
    return abs(tried.end.value - tried.at.value) <= motion.same(probe) + probe.noise.swing


def _try(probe: Probe, row: Row) -> Tried:
    command = probe.command(row.command)
    runs = declared.of(command).kind is MotionKind.RUN
    counted = Verb.READ_PULSES in probe.dialect.by_verb
    pulses = [probe.read(Verb.READ_PULSES)] if counted else []
    start, first = motion.position(probe), len(probe.traffic)
    degrees = row.way * 360 * (_FAST_TURNS if row.rpm == _FAST else _TURNS)
    motion.begin(probe, command, degrees, rpm=row.way * row.rpm if runs else row.rpm, acceleration=_STEEP, quiet_ns=0)
    probe.wait(_GOING_NS)
    before = motion.position(probe)
    stop, values = _ending(probe, probe.command(row.of) if row.of else command, row.stop)
    since = len(probe.traffic)
    exchange = probe.ask(stop, values, quiet_ns=0)
    refused = not exchange.is_read or probe.refused(exchange)
    over_ns = exchange.sent_ns + int(ramp.ramp_ns(row.rpm, 0, max(row.stop, 0)) * (1 + ramp.SLOW_QUIRK))
    if row.stop >= 0 and declared.of(stop).tells_end and not refused:
        left_ns = over_ns - probe.gate.now_ns()
        if 2 not in arriving.statuses(probe.traffic[since:], stop):
            probe.listen(max(0, left_ns) + TOLD_LATE_NS, Until.REPLY)
    probe.wait(over_ns + _LAG_NS - probe.gate.now_ns())
    # A shaft that settles swings behind a halt.
    probe.wait(_LOOK_NS if probe.noise.live else 0)
    at = motion.position(probe)
    probe.wait(_LOOK_NS)
    end = motion.position(probe)
    pulses += [probe.read(Verb.READ_PULSES)] if counted else []
    told = tuple(arriving.statuses(probe.traffic[since:], stop)) if stop.replies.status else ()
    if row.stop == _OFF:
        motion.switch(probe, True)
    # A stop by a ramp has the code of its motion.
    ends = 0 if runs else sum(status == _COMPLETE for status in arriving.statuses(probe.traffic[first:], command))
    ends -= row.stop >= 0 and not runs and declared.of(stop).tells_end
    went = before.value - start.value
    sense = 0 if abs(went) < 2 else 1 if went > 0 else -1
    return Tried(row, exchange, refused, start, before, sense, at, end, told, ends, tuple(pulses))


def _ending(probe: Probe, command: Command, stop: int) -> tuple[Command, dict[str, int]]:
    """Return what ends a motion, as sent, by the number of a row."""
    if stop == _OFF:
        return declared.switching(probe.dialect, False)
    if stop == _EMERGENCY:
        return probe.command(Verb.EMERGENCY_STOP), {}
    return probe.dialect.stops_of(command)[0], {"acceleration": stop}


# --- what is judged -----------------------------------------------------------------------------------------------------


def _every(dialect: Dialect) -> Iterator[tuple[Command, Command]]:
    """Yield each motion with its stop by a ramp."""
    for run in motions_of(dialect):
        stop = dialect.stops_of(run)[0]
        if declared.of(stop).acceleration:
            yield run, stop


def _facts(dialect: Dialect) -> dict[str, Any]:
    every = [c for pair in _every(dialect) for c in pair] + [dialect.by_verb[Verb.EMERGENCY_STOP]]
    return {"risks": declared.risks(dialect, *frozenset().union(*(c.all_risks for c in every))), "parameters": {}}


def _by_ramp(dialect: Dialect) -> Iterator[Case]:
    for run, stop in _every(dialect):
        yield Case(dialect, stop, {"run": run}, _facts(dialect))


def _in_an_emergency(dialect: Dialect) -> Iterator[Case]:
    for run, _ in _every(dialect):
        yield Case(dialect, dialect.by_verb[Verb.EMERGENCY_STOP], {"run": run}, _facts(dialect))


_of_stops = partial(of_motion, at_best=Certainty.LIKELY)


def _expect_stopped(probe: Probe, command: Command, wanted: Callable[[Row], bool], rows_of: Rows = table) -> None:
    tried = [each for each in probe.recorded(stopped, rows_of) if wanted(each.row)]
    if not any(each.sense for each in tried):
        raise Inconclusive("no row turned the shaft")
    for each in (each for each in tried if each.sense):
        text = f"{each.row.of or command.name} does not stop {each.row.command} as it should in one condition"
        expect_row_taken(probe, each.stop, each.row, text)
        if each.refused:
            continue
        probe.expect(
            f"{each.end.value - each.at.value:+.1f} degrees in {_LOOK_NS // MS} ms behind the stop",
            holds=_stands(probe, each),
            expected=f"a shaft that stands: {each.row}",
            refutes=text,
            exchange=each.stop,
        )
        if each.row.stop == _OFF:
            # Without torque the shaft runs out.
            continue
        within = _BESIDE + motion.miss(probe) + probe.noise.swing
        went = (each.end.value - each.before.value) * each.sense
        expect_between(probe, went, each.between, within, f"behind the stop, {each.row}", text, each.stop)


@_of_stops(each=_by_ramp, name="{command}/crossed-stops", refuted_by="a shaft that goes on, or stops by another ramp")
def _ramps(probe: Probe, command: Command, run: Command) -> None:
    """{command} slows {run} down by the ramp that it names, either way, at each speed, in each mode."""
    _expect_stopped(probe, command, lambda row: row.command == run.name and row.stop > 0)


@_of_stops(each=_by_ramp, name="{command}/when-fast", refuted_by="a shaft that goes on")
def _when_fast(probe: Probe, command: Command, run: Command) -> None:
    """{command} stops {run} at 1200 rpm, either way."""
    _expect_stopped(probe, command, lambda row: row.command == run.name and row.rpm == _FAST)


@_of_stops(each=_by_ramp, name="{command}/at-once", refuted_by="a shaft that goes on")
def _at_once(probe: Probe, command: Command, run: Command) -> None:
    """{command} with acceleration 0 stops the shaft at once, either way, in each mode."""
    _expect_stopped(probe, command, lambda row: row.command == run.name and row.stop == 0)


@_of_stops(each=_in_an_emergency, name="{command}/ends-{run}", refuted_by="a shaft that goes on, or slows down")
def _emergency(probe: Probe, command: Command, run: Command) -> None:
    """The emergency stop ends {run} at once, either way, in each mode; the shaft stays there, and no end of {run} is told."""
    _judge_emergency(probe, command, run, table)


def _judge_emergency(probe: Probe, command: Command, run: Command, rows_of: Rows) -> None:
    _expect_stopped(probe, command, lambda row: row.command == run.name and row.stop == _EMERGENCY, rows_of)
    # What was ended in one row would have come to its end in a later one.
    ends = sum(tried.ends for tried in probe.recorded(stopped, rows_of) if tried.row.command == run.name)
    text = f"the end of {run.name} is told although a stop ended it"
    probe.expect(f"{ends} more often", holds=ends <= 0, expected="as often as a stop by a ramp ended it", refutes=text)


def _disabled(dialect: Dialect) -> Iterator[Case]:
    if any(_every(dialect)) and Verb.ENABLE in dialect.by_verb:
        facts, off = _facts(dialect), dialect.by_verb[Verb.ENABLE]
        yield Case(
            dialect, off, facts=facts | {"risks": declared.risks(dialect, *off.all_risks - {Risk.UNKNOWN}, *facts["risks"])}
        )


@_of_stops(each=_disabled, name="{command}/off-ends-moves", refuted_by="a shaft that goes on")
def _off(probe: Probe, command: Command) -> None:
    """Disabling the motor ends a move of each kind."""
    _expect_stopped(probe, command, lambda row: True, disablings)


def _runs(dialect: Dialect) -> Iterator[Case]:
    for run, _ in _every(dialect):
        if declared.of(run).kind is MotionKind.RUN:
            yield Case(dialect, run, facts=_facts(dialect))


@_of_stops(each=_runs, name="{command}/ended-by-others", refuted_by="a shaft that goes on, or stops by another ramp")
def _ended_by_others(probe: Probe, command: Command) -> None:
    """The stop of each move ends {command}, too."""
    _expect_stopped(probe, command, lambda row: True, strangers)


def _counts_pulses(dialect: Dialect) -> Iterator[Case]:
    if any(_every(dialect)) and Verb.READ_PULSES in dialect.by_verb:
        yield Case(dialect, dialect.by_verb[Verb.READ_PULSES], facts=_facts(dialect))


@_of_stops(each=_counts_pulses, name="{command}/behind-stops", refuted_by="a count that is not where the shaft stands")
def _pulses_behind(probe: Probe, command: Command) -> None:
    """Behind every stop of every motion {command} has changed as far as the shaft has turned, and the same way."""
    _judge_pulses(probe, command, table)


def _judge_pulses(probe: Probe, command: Command, rows_of: Rows) -> None:
    turn = declared.units_per_turn(probe.dialect, probe.command(Verb.MOVE_RELATIVE_PULSES), SUBDIVISION)
    sense = 0.0
    for tried in probe.recorded(stopped, rows_of):
        if tried.refused or not tried.sense or not _stands(probe, tried):
            continue
        counted = (tried.pulses[1] - tried.pulses[0]) * 360 / turn
        went = tried.end.value - tried.start.value
        # The sense of pulses is not told: it is that of the first row.
        sense = sense or math.copysign(1, counted * went)
        text = f"{command.name} tells another way than the shaft has turned behind a stop"
        probe.expect(
            counted * sense,
            near=went,
            within=_BESIDE + motion.miss(probe) + probe.noise.swing,
            unit="degrees",
            expected=f"{went:.5g} degrees: {tried.row}",
            refutes=text,
        )


# --- the first rows -----------------------------------------------------------------------------------------------------


@_of_stops(each=_by_ramp, name="{command}/first-stops", refuted_by="a shaft that goes on, or stops by another ramp")
def _first_ramps(probe: Probe, command: Command, run: Command) -> None:
    """{command} slows {run} down by the ramp that it names, or stops it at once, in a few conditions."""
    _expect_stopped(probe, command, lambda row: row.command == run.name and row.stop >= 0, first_rows)


@_of_stops(each=_in_an_emergency, name="{command}/ends-{run}-first", refuted_by="a shaft that goes on, or slows down")
def _first_emergency(probe: Probe, command: Command, run: Command) -> None:
    """The emergency stop ends {run} at once in a few conditions; the shaft stays there, and no end of {run} is told."""
    _judge_emergency(probe, command, run, first_rows)


@_of_stops(each=_counts_pulses, name="{command}/behind-first-stops", refuted_by="a count that is not where the shaft stands")
def _first_pulses(probe: Probe, command: Command) -> None:
    """Behind stops in a few conditions {command} has changed as far as the shaft has turned, and the same way."""
    _judge_pulses(probe, command, first_rows)
