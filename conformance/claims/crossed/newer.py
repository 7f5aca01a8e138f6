"""Each motion over each other one and over itself: the same way and round, with one field changed alone and with several.

    older command x newer command x same way or round      all of them
    newer command x its acceleration x same way or round   all of them
    speed kept or changed, a target that is zero           with any of those; all where a command takes over from itself

Rules kept here:
- A row takes a third of a second: the newer motion comes while the older one is at its speed, far from its end.
- The shaft is looked at once on its ramp, too: that has the acceleration of the newer motion.
- The zero is set where the rows begin, and those whose target is 0 come first: it is near then.
- A move to a place is judged by its place, one by a distance by where the shaft surely was when it came.
- Which way a direction or a sign turns the shaft is the drive's own word: that of the older motions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Risk, Verb
from conformance.claim import Inconclusive
from conformance.claims.crossed.course import motions_of
from conformance.claims.declare import Case
from conformance.claims.motion.motion_claim import expect_between, expect_row_taken, expect_speed, of_motion
from conformance.claims.motion.told import expect_states, states
from conformance.model import covering
from conformance.motion import arriving, course, declared, motion, ramp
from conformance.motion.attempts import undamaged
from conformance.motion.declared import CALM, QUICK, SUBDIVISION
from conformance.motion.motion import Sample
from conformance.talk import settings
from conformance.talk.exchange import Exchange
from conformance.talk.noise import CLOCK_SHARE
from conformance.talk.probe import MS, SECOND_NS, Probe

#: Other speeds than that of the older motion; its way, which the rows do not come to, and that of the newer move (degrees),
#: with what it goes too far on the way round.
_OTHER, _LOWER, _FAR, _NEAR, _SPARE = 90, 40, 720, 30, 18
#: From the older command to the newer one; until a run has its speed, or a move has surely got going.
_GOING_NS, _RUNS_NS = 80 * MS, 110 * MS
#: What a shaft may lag behind a command.
_LAG_NS = 10 * MS
#: The accelerations of newer motions: a quick one as that of the older one, none, and a slow one, by which a move goes farther.
_AT_ONCE, _SLOW, _SLOWLY = 0, 206, 150
#: When a shaft is looked at on its ramp.
_ON_RAMP_NS = 60 * MS


class Row(NamedTuple):
    """A motion and the newer one. `way`: of the older one; `turn`: 1 the same way, -1 round; `zero`: the target is 0.

    `acceleration`: of the newer one, as sent.
    """

    older: str
    command: str
    way: int
    turn: int
    rpm: int
    zero: bool
    acceleration: int

    def __str__(self) -> str:
        """Return it for people."""
        way, same = "a positive" if self.way > 0 else "a negative", "the same way" if self.turn > 0 else "the other way"
        target = ", to 0" if self.zero else ""
        newer = f"{self.command} {same} at {self.rpm} rpm{target}, acceleration {self.acceleration}"
        return f"over {self.older} {way} way at {CALM} rpm: {newer}"


@dataclass(frozen=True)
class Tried:
    """A row that was tried. `start`, `before`, `on_ramp`, `end`: where the shaft was: first, at the newer command, then, last.

    `wanted`: by how many degrees from the zero, or from where it was, the newer move was to go. `seen`: the speed of a run.
    """

    row: Row
    newer: Exchange
    refused: bool
    zero: float
    start: Sample
    before: Sample
    on_ramp: Sample | None
    wanted: float
    seen: Sample | None
    end: Sample | None

    @property
    def sense(self) -> int:
        """Return 1 where the older motion of a positive way raised the position, -1 where it lowered it, 0 for no motion."""
        went = (self.before.value - self.start.value) * self.row.way
        return 0 if abs(went) < 1 + self.before.noise else 1 if went > 0 else -1


def table(dialect: Dialect) -> tuple[Row, ...]:
    """Return the rows of all motions."""
    known = {command.name: command for command in motions_of(dialect)}
    factors = {
        "older": tuple(known),
        "command": tuple(known),
        "way": (1, -1),
        "turn": (1, -1),
        "rpm": (CALM, _OTHER),
        "zero": (False, True),
        "acceleration": (QUICK, _SLOW, _AT_ONCE),
    }
    found = covering.rows(
        factors,
        # Behind a shaft that went away from it.
        lambda command, turn, zero: not zero or (turn < 0 and declared.of(known[command]).kind is MotionKind.MOVE_TO),
        lambda zero, acceleration: not zero or acceleration == QUICK,
        together=[
            ("older", "command", "turn"),
            ("older", "command", "zero"),
            ("older", "command", "rpm"),
            ("command", "turn", "acceleration"),
        ],
    )
    rows = {Row(**row) for row in found}
    # Over itself each field is changed alone, too, and the speed is lowered: a drive may take up higher ones alone.
    for rpm in (CALM, _LOWER):
        rows |= {Row(name, name, way, turn, rpm, False, QUICK) for name in known for way in (1, -1) for turn in (1, -1)}
    return tuple(sorted(rows, key=lambda row: (not row.zero, row)))


def taken_over(probe: Probe) -> tuple[Tried, ...]:
    """Carry out all rows and return what was seen."""
    motion.ready_to_move(probe, declared.bus_modes(probe.dialect)[-1], subdivision=SUBDIVISION)
    motion.stand_still(probe)
    # One that turns some motions round and not others would make other rows of the table.
    settings.to_defaults(probe, "motor_direction")
    probe.do(Verb.SET_ZERO)
    zero = rest = motion.position(probe)
    found = []
    for row in table(probe.dialect):
        found.append(undamaged(probe, _try, row, zero.value, rest=rest))
        rest = found[-1].end or motion.stand_still(probe)
    return tuple(found)


def _try(probe: Probe, row: Row, zero: float, start: Sample) -> Tried:
    commands = {command.name: command for command in motions_of(probe.dialect)}
    older, newer = commands[row.older], commands[row.command]
    begins = {command.name: motion.place(probe, command) for command in (older, newer)}
    _begin(probe, older, row.way * _FAR, row.way * CALM, begins[older.name])
    probe.wait(_GOING_NS)
    before = motion.position(probe)
    way = row.way * row.turn
    near = _SLOWLY if row.acceleration == _SLOW else _NEAR
    degrees = 0 if row.zero else way * near
    exchange = _begin(probe, newer, degrees, way * row.rpm, 0 if row.zero else begins[newer.name], row.acceleration)
    refused = not exchange.is_read or probe.refused(exchange)
    seen = end = on_ramp = None
    if not refused and not row.zero:
        probe.wait(exchange.sent_ns + _ON_RAMP_NS - probe.gate.now_ns())
        on_ramp = motion.position(probe)
    change_ns = ramp.ramp_ns(0, CALM + row.rpm, row.acceleration) if row.acceleration == _SLOW else 0
    if declared.of(newer).kind is MotionKind.RUN:
        probe.wait(exchange.sent_ns + _RUNS_NS + int(change_ns) - probe.gate.now_ns())
        seen = motion.speed(probe)
    elif not refused:
        # A reply that was lost or late let the older motion go on.
        since = max(0.0, (exchange.sent_ns - before.t_ns + before.spread_ns) / SECOND_NS * CALM * 6)
        # It may be beyond a place the same way already: a look whose reply the line damaged comes late.
        gone = abs(before.value - start.value)
        beyond = gone if row.turn < 0 else max(0.0, gone - 2 * near)
        far = since + (abs(before.value - zero) if row.zero else near + beyond)
        least_ns = far / 6 / row.rpm * SECOND_NS
        most_ns = (far + _SPARE) / 6 / row.rpm * (1 + CLOCK_SHARE) * SECOND_NS + 2 * change_ns
        end = arriving.come_to_rest(probe, exchange, int(least_ns), int(most_ns))
    return Tried(row, exchange, refused, zero, start, before, on_ramp, degrees, seen, end)


def _begin(probe: Probe, command: Command, degrees: float, rpm: int, start: int, acceleration: int = QUICK) -> Exchange:
    rpm = rpm if declared.of(command).kind is MotionKind.RUN else abs(rpm)
    return motion.ask(probe, command, degrees, rpm=rpm, acceleration=acceleration, start=start, quiet_ns=0)


def _cases(dialect: Dialect) -> Iterator[Case]:
    every = motions_of(dialect)
    if Verb.SET_ZERO not in dialect.by_verb:
        return
    risks = frozenset[Risk]().union(*(c.all_risks for c in every), dialect.by_verb[Verb.SET_ZERO].all_risks)
    for command in every:
        # What becomes of the rest of the older way no manual says.
        certainty = Certainty.OPEN if command.verb is Verb.MOVE_RELATIVE_AXIS else Certainty.LIKELY
        facts = {"risks": declared.risks(dialect, *risks, Risk.UNBOUNDED), "at_best": certainty}
        told = any(c.verb is Verb.SET_DIRECTION and c.readable for c in dialect.commands)
        facts |= {"settings": declared.settings(dialect, *(("motor_direction",) if told else ()))}
        yield Case(dialect, command, facts=facts)


@of_motion(each=_cases, name="{command}/takes-over", refuted_by="a shaft that goes on as before, or elsewhere, or a refusal")
def _takes_over(probe: Probe, command: Command) -> None:
    """{command} takes over from each motion, itself too: the same way and round, at the same speed and another one."""
    every = probe.recorded(taken_over)
    senses = {tried.row.older: tried.sense for tried in every if tried.sense}
    for tried in (tried for tried in every if tried.row.command == command.name and tried.sense):
        text = f"{command.name} does not take over from another motion"
        expect_row_taken(probe, tried.newer, tried.row, text)
        sense = senses.get(command.name, 0)
        if tried.refused or not sense:
            continue
        _expect_ramp(probe, tried, sense)
        if tried.seen is not None:
            wanted = float(sense * tried.row.way * tried.row.turn * tried.row.rpm)
            within = 2 + abs(wanted) * 2 * CLOCK_SHARE + tried.seen.noise
            expect_between(probe, tried.seen.value, (wanted, wanted), within, tried.row, text, tried.newer, "rpm")
        elif tried.end is not None:
            within = motion.miss(probe) + 1
            expect_between(probe, tried.end.value, _ends(tried, sense), within, tried.row, text, tried.newer)


def _expect_ramp(probe: Probe, tried: Tried, sense: int) -> None:
    """Refute where the shaft is not where the newer motion's own acceleration leads it, from the older one's speed."""
    reply, row, seen = tried.newer.reply, tried.row, tried.on_ramp
    assert reply is not None  # it was taken
    if seen is None:
        return
    first, last = tried.sense * row.way * CALM, sense * row.way * row.turn * row.rpm
    on, slack_ns = course.run(first, last, row.acceleration), ramp.slack_ns(row.acceleration)
    # Where it ends, from the look before it; a move by a distance from where the shaft was then.
    to_place = _kind(tried) is MotionKind.MOVE_TO
    goal = sense * tried.wanted + (tried.start.value - tried.before.value if to_place else 0.0)
    places, left = [], []
    # It is taken up at some time between the begin of the request and that of the reply, or a little later.
    for taken_ns in (tried.newer.sent_ns, reply.first_ns + _LAG_NS):
        before_ns = taken_ns - tried.before.t_ns
        until_ns = seen.t_ns - taken_ns
        for away_ns in (-tried.before.spread_ns, tried.before.spread_ns):
            span = ((until_ns - seen.spread_ns - slack_ns) / (1 + ramp.SLOW_QUIRK), (until_ns + seen.spread_ns + slack_ns))
            went = first * (before_ns + away_ns) / ramp.MINUTE_NS
            for turns in on.turns(span[0], span[1] / (1 - CLOCK_SHARE)):
                places.append((went + turns) * 360)
                left.append(math.copysign(1, last) * (goal - (places[-1] if to_place else turns * 360)))
    if _kind(tried) is not MotionKind.RUN and min(left) < _SPARE + 360 * abs(ramp.ramp_turns(0, last, row.acceleration)):
        # It slows down to its end already.
        return
    within = probe.noise.swing + probe.noise.place + 1
    text = f"{row.command} that takes over from another motion does not go by its own acceleration"
    span, shown = (min(places), max(places)), f"{_ON_RAMP_NS // MS} ms on, {row}"
    expect_between(probe, seen.value - tried.before.value, span, within, shown, text, tried.newer)


def _kind(tried: Tried) -> MotionKind:
    assert tried.newer.command is not None  # it was asked for
    return declared.of(tried.newer.command).kind


def _ends(tried: Tried, sense: int) -> tuple[float, float]:
    """Return between which places a newer move ends, in degrees."""
    if _kind(tried) is MotionKind.MOVE_TO:
        place = tried.zero if tried.row.zero else tried.start.value + sense * tried.wanted
        return place, place
    # By a distance, from where the shaft was when the newer one was taken.
    reply = tried.newer.reply
    assert reply is not None  # it was taken
    way = tried.sense * tried.row.way
    went = (
        way * CALM * 6 * (1 + CLOCK_SHARE) * (reply.first_ns + _LAG_NS - tried.before.t_ns + tried.before.spread_ns) / SECOND_NS
    )
    low, high = sorted((tried.before.value, tried.before.value + went))
    return low + sense * tried.wanted - 2, high + sense * tried.wanted + 2


@of_motion(
    each=_cases, name="{command}/again-and-again", refuted_by="a shaft that goes where an older one led it, or at its speed"
)
def _again_and_again(probe: Probe, command: Command) -> None:
    """Many {command} follow one another, each before the last is done: the newest holds, and one back turns by its ramp."""
    motion.ready_to_move(probe, declared.bus_modes(probe.dialect)[-1], subdivision=SUBDIVISION)
    start, begin, before = motion.wait_standing(probe), motion.place(probe, command), states(probe)
    for degrees, rpm in _UPDATES:
        exchange = _begin(probe, command, degrees, rpm, begin)
        probe.wait(_GOING_NS)
    text = f"the last of many {command.name} does not hold"
    last, speed = _UPDATES[-1]
    seen, at = motion.speed(probe), motion.position(probe)
    to_place = declared.of(command).kind is MotionKind.MOVE_TO
    back = _begin(probe, command, _BACK if to_place else -_BACK, -speed, begin, _SLOW)
    probe.wait(_ON_RAMP_NS)
    turning = motion.speed(probe)
    if to_place:
        lasts_ns = int((sum(abs(degrees) for degrees, _ in _UPDATES) + _SPARE) / 6 / speed * SECOND_NS)
        went, within = motion.wait_standing(probe, limit_ns=lasts_ns + SECOND_NS).value - start.value, motion.miss(probe) + 1
        probe.expect(abs(went), near=_BACK, within=within, unit="degrees", refutes=text, exchange=back)
    else:
        # Where a run or a move by a distance ends says nothing of the older ones.
        motion.stand_still(probe)
    expect_states(probe, before, f"behind many {command.name}")
    if to_place and last - abs(at.value - start.value) < _ENDS:
        raise Inconclusive("the drive answers so late that the shaft is at its end when its speed is looked at")
    expect_speed(seen, speed, exchange, f"{text}: its speed", share=2 * CLOCK_SHARE)
    gone = at.value - start.value
    until = abs(gone) + (turning.t_ns + turning.spread_ns - at.t_ns) / SECOND_NS * 6 * speed
    if abs(gone) > 1 and until < last - _ENDS:
        # A shaft that turns round at once has the speed of the newer one that way.
        least = speed - (turning.t_ns + turning.spread_ns - back.sent_ns) / ramp.step_ns(_SLOW) - _OFF_RAMP
        that_way = math.copysign(turning.value, turning.value * gone)
        round_at_once = f"{command.name} back does not turn the shaft round by its ramp"
        probe.expect(that_way, at_least=least, unit="rpm that way", refutes=round_at_once, exchange=back)


#: Where each of them leads (degrees from where the first one began), and how fast (rpm): a shaft that keeps the highest
#: speed is not at the end either when its speed is looked at.
_UPDATES = ((700, 60), (750, 110), (680, 70), (710, 40), (660, 90))
#: Where one back leads (degrees); by how much a speed on its ramp may be off the law (rpm).
_BACK, _OFF_RAMP = 30, 15
#: So far before its end a shaft may slow down, in degrees.
_ENDS = 15
