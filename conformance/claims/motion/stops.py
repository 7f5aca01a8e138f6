"""Stops: by a ramp, at once, in an emergency, and that a stop leaves the motor on.

The stop of an MKS run or move is that motion with zeros everywhere but in the acceleration: with one the shaft slows down by
the ramp, with 0 it stands at once. It says 1 when it begins and 2 when the shaft stands; the move that it ends says no more.
LK motors have one stop, and how it brakes is not printed: that it does is observed.

Rules kept here:
- Ramps are so slow (1.2 s) that even a reply that is late while the motor turns comes before they end.
- How long a ramp takes to the per cent is judged by the theme timing; here a ramp is told from a halt.
- Nothing is stopped at once above 60 rpm, but for emulated drives.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Verb
from conformance.claim import Inconclusive
from conformance.claims.declare import Case, commands
from conformance.claims.known_quirks import SETTLING, may_meet
from conformance.claims.motion.motion_claim import (
    expect_rested,
    expect_stays,
    of_motion,
    risks_by,
    risks_of,
    that_tell_their_end,
)
from conformance.motion import arriving, declared, motion, ramp
from conformance.motion.declared import CALM, MOVES, QUICK, RUNS_AND_MOVES
from conformance.motion.motion import Sample
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, SECOND_NS, Probe, Until

#: 6 ms for each rpm: from 120 rpm the shaft needs 0.72 s.
_SLOW_RAMP, _RPM, _RAMP_NS = 136, 120, 720 * MS
#: How long the shaft is given to come to its speed, and how long it is looked at whether it stands.
_SET_OFF_NS, _LOOK_NS, _SOON_NS = 250 * MS, 150 * MS, 40 * MS
#: The turns of a motion that is stopped so, and how long they last at 120 rpm. A move at 60 rpm lasts a second for each
#: turn; how long it is listened for its end.
_RAMP_TURNS, _LEFT_NS, _HALF, _TOLD_NS = 3.5, 1750 * MS, 0.5, 300 * MS
#: The replies to a stop: when it begins, and when the shaft stands.
_BOTH = 2
_emergency = commands(Verb.EMERGENCY_STOP)
_lk_stop = commands(Verb.STOP)


def set_going(probe: Probe, run: Command, rpm: int = CALM, turns: float = 5) -> Exchange:
    """Begin a run, or a move that is too long to end by itself, and let the shaft come to its speed."""
    motion.prepare(probe, run)
    # By the slow ramp 3.5 turns: at 120 rpm 1.75 s, of which a late reply may take 0.7 and the ramp down as much.
    rpm = -rpm if turns < 0 and declared.of(run).kind is MotionKind.RUN else rpm
    exchange = motion.begin(probe, run, turns * 360, rpm=rpm, acceleration=QUICK)
    probe.wait(_SET_OFF_NS)
    return exchange


def expect_standing(probe: Probe, exchange: Exchange, refutes: str) -> None:
    """Refute unless the shaft stands now."""
    before = motion.position(probe)
    # Where a shaft stands for good its place stays: that is seen sooner.
    at_once = probe.dialect.ramp is not None and not probe.noise.settles
    look_ns, within = (_SOON_NS, motion.same(probe)) if at_once else (_LOOK_NS, motion.miss(probe))
    probe.wait(look_ns)
    now, seen = motion.position(probe).value, motion.speed(probe)
    moved = now - before.value
    if _stands(seen, moved, within):
        probe.rig.stands_at(now)
    else:
        motion.stop(probe, 0)
    _expect_stood(probe, seen, moved, exchange, refutes, within, look_ns)


def expect_ended(probe: Probe, ended: Exchange, refutes: str, limit_ns: int) -> Sample:
    """Refute a shaft that goes on behind what was to end its motion; return where it rests. It has so long for that."""
    try:
        return motion.wait_standing(probe, limit_ns=limit_ns)
    except Inconclusive:
        left = abs(motion.speed(probe).value)
        motion.stand_still(probe)
        probe.expect(left, at_most=CALM / 4, unit="rpm", refutes=refutes, exchange=ended)
        raise


def _stands(seen: Sample, moved: float, within: float) -> bool:
    return abs(seen.value) < 1 + seen.noise and abs(moved) <= within


def _expect_stood(
    probe: Probe, seen: Sample, moved: float, exchange: Exchange, refutes: str, within: float, look_ns: int = _LOOK_NS
) -> None:
    stands = _stands(seen, moved, within)
    got = f"{seen.value:g} rpm, and {moved:+.2f} degrees in {look_ns // MS} ms"
    probe.expect(got, holds=stands, expected="a shaft that stands", refutes=refutes, exchange=exchange)


def _expect_turning(seen: Sample, least: float) -> None:
    if abs(seen.value) < least:
        raise Inconclusive(f"the shaft does not turn before the stop ({seen.value:g} rpm)")


# --- the stop of a motion ---------------------------------------------------------------------------------------------


def _of_motions(dialect: Dialect) -> Iterator[Case]:
    """Yield the stops by a ramp, each with the motion that it ends."""
    for run in dialect.motions(MotionKind.RUN, *MOVES):
        stop = dialect.stops_of(run)[0]
        if declared.of(stop).acceleration:
            yield Case(dialect, stop, {"run": run})


@dataclass(frozen=True)
class StopOnRamp:
    """A motion that was stopped by the slow ramp.

    `before`, `midway`, `after`: speeds on the way, on the ramp, and behind it. `told`: what the stop had answered when its end
    was told, `at_once`: where the shaft was then. `turned`: by how many degrees it turned behind the ramp; `rests`: where it
    came to rest, None where it did not; `later`: where it was when the whole motion would have been over. `statuses`: all
    that the stop answered.
    """

    exchange: Exchange
    before: Sample
    midway: Sample
    told: tuple[int, ...]
    at_once: Sample
    after: Sample
    turned: float
    rests: Sample | None
    later: Sample
    statuses: tuple[int, ...]


def stopped_by_ramp(probe: Probe, run: Command, stop: Command) -> StopOnRamp:
    """Set the shaft going and stop it by the slow ramp; nothing is asked while the end of the stop may be told."""
    set_going(probe, run, _RPM, _RAMP_TURNS)
    before = motion.speed(probe)
    since = len(probe.traffic)
    exchange = probe.ask(stop, {"acceleration": _SLOW_RAMP}, quiet_ns=0)
    probe.wait(exchange.sent_ns + _RAMP_NS * 2 // 5 - probe.gate.now_ns())
    midway, at_once = motion.speed(probe), motion.position(probe)
    over_ns = exchange.sent_ns + _RAMP_NS + 200 * MS
    tells = arriving.tells_end(probe.dialect)
    if tells and len(_replies(probe, since, stop)) < _BOTH:
        probe.listen(over_ns - probe.gate.now_ns(), Until.REPLY)
        at_once = motion.position(probe)
    told = _replies(probe, since, stop)
    probe.wait(over_ns - probe.gate.now_ns())
    after, here = motion.speed(probe), motion.position(probe)
    probe.wait(_LOOK_NS)
    turned = motion.position(probe).value - here.value
    if tells and len(_replies(probe, since, stop)) < _BOTH:
        # Whether it comes in time is judged elsewhere.
        probe.listen(2 * _RAMP_NS, Until.REPLY)
        told, at_once = _replies(probe, since, stop), motion.position(probe)
    rests: Sample | None = None
    try:
        rests = motion.wait_standing(probe, limit_ns=_RAMP_NS)
    except Inconclusive:
        motion.stop(probe, 0)
    # What is left of such a move would take so long.
    probe.wait(exchange.sent_ns + _LEFT_NS - probe.gate.now_ns())
    later = motion.position(probe)
    statuses = _replies(probe, since, stop)
    return StopOnRamp(exchange, before, midway, told, at_once, after, turned, rests, later, statuses)


def _replies(probe: Probe, since: int, stop: Command) -> tuple[int, ...]:
    return tuple(arriving.statuses(probe.traffic[since:], stop))


def _at_rest(seen: StopOnRamp) -> Sample:
    if seen.rests is None:
        raise Inconclusive("the shaft does not come to rest")
    return seen.rests


@of_motion(
    each=_of_motions, refuted_by="a shaft that stands at once, slows down later, or does not stop", risks=risks_of("run")
)
def _by_ramp(probe: Probe, command: Command, run: Command) -> None:
    """{command} with an acceleration slows the shaft down by the ramp and lets it stand."""
    seen = probe.recorded(stopped_by_ramp, run, command)
    _expect_turning(seen.before, _RPM / 2)
    late = (seen.midway.t_ns - seen.exchange.sent_ns) / _RAMP_NS
    law = max(0.0, _RPM * (1 - late))
    probe.expect(
        abs(seen.midway.value),
        near=law,
        within=_RPM / 4 + _RPM * seen.midway.spread_ns / _RAMP_NS,
        unit="rpm",
        expected=f"about {law:.0f} rpm {late * _RAMP_NS / MS:.0f} ms after the request",
        refutes=f"{command.name} does not slow the shaft down by its ramp",
        exchange=seen.exchange,
        key=f"{command.name} ramp",
    )
    text = f"the shaft still turns after the ramp of {command.name}"
    _expect_stood(probe, seen.after, seen.turned, seen.exchange, text, motion.miss(probe))


@of_motion(each=_of_motions, refuted_by="a shaft that moves again", risks=risks_of("run"))
def _stays_stopped(probe: Probe, command: Command, run: Command) -> None:
    """After {command} the shaft stays where it stopped; the motion that it ended is not taken up again."""
    seen = probe.recorded(stopped_by_ramp, run, command)
    expect_stays(_at_rest(seen), seen.later, seen.exchange, f"the shaft moves again after {command.name}")


@of_motion(
    each=that_tell_their_end(_of_motions),
    refuted_by="other statuses, another order, more or fewer replies; or a reply of the motion that it ended",
    risks=risks_of("run"),
    at_best=Certainty.LIKELY,
    name="{command}/replies",
)
def _told(probe: Probe, command: Command, run: Command) -> None:
    """{command} is answered by 1 when it begins and by 2 when the shaft stands, away from any end limit."""
    seen = probe.recorded(stopped_by_ramp, run, command)
    told = list(seen.statuses)
    text = f"{command.name}: other replies than 1 and then 2"
    key = f"{command.name} {told}"
    probe.expect(told, equal=[1, 2], expected="1, 2", refutes=text, exchange=seen.exchange, key=key)


@of_motion(
    each=that_tell_their_end(_of_motions),
    refuted_by="a shaft that still turns when status 2 comes",
    risks=risks_of("run"),
    quirks=may_meet(SETTLING),
)
def _told_when_standing(probe: Probe, command: Command, run: Command) -> None:
    """When {command} says that it is complete, the shaft stands."""
    seen = probe.recorded(stopped_by_ramp, run, command)
    text = f"{command.name} is told as complete before the shaft stands"
    expect_rested(probe, command, seen.told[-1:], seen.at_once, _at_rest(seen), seen.exchange, text)


# --- the stop of every motion -----------------------------------------------------------------------------------------


def _emergencies(dialect: Dialect) -> Iterator[Case]:
    for case in _emergency(dialect):
        for run in dialect.motions(*RUNS_AND_MOVES):
            yield Case(dialect, case.command, {"run": run})


@of_motion(
    each=that_tell_their_end(_emergency),
    name="{command}/replies",
    refuted_by="another status, or a completion",
    at_best=Certainty.LIKELY,
)
def _emergency_replies(probe: Probe, command: Command) -> None:
    """The emergency stop is answered by status 1, and no move that it ends is told as complete."""
    for move in probe.dialect.motions(*MOVES):
        since = len(probe.traffic)
        begun = set_going(probe, move, turns=_HALF)
        exchange = probe.ask(command)
        status = probe.reply(exchange).values.get("status")
        probe.expect(status, equal=1, refutes="the emergency stop is not answered by 1", exchange=exchange)
        # Longer than the move would have gone on.
        probe.wait(begun.sent_ns + int(_HALF * SECOND_NS) + _TOLD_NS - probe.gate.now_ns())
        text = f"{move.name} that the emergency stop ended is told as complete"
        told = arriving.statuses(probe.traffic[since:], move)
        probe.expect(told, equal=[1], refutes=text, exchange=exchange, key="told as complete")


def _stops_and_emergency(dialect: Dialect) -> Iterator[Case]:
    """Yield the stops by a ramp, each with the motion that it ends, and the emergency stop with each of those."""
    if dialect.family == "mks":
        yield from _of_motions(dialect)
        yield from _emergencies(dialect)


def _name_of_stop(case: Case) -> str:
    return "{command}/{what}-{run}" if case.command and case.command.verb is Verb.EMERGENCY_STOP else "{command}/{what}"


def _fast_stops(dialect: Dialect) -> Iterator[Case]:
    """Yield the stops of a fast shaft; the manual warns of halting one at once, so that is for emulated drives."""
    for case in _stops_and_emergency(dialect):
        emergency = case.command is not None and case.command.verb is Verb.EMERGENCY_STOP
        what = "when-fast" if emergency else "at-once-when-fast"
        yield Case(dialect, case.command, {**case.given, "what": what}, {"emulated": True, "parameters": {}})


def _rising_stops(dialect: Dialect) -> Iterator[Case]:
    for case in _stops_and_emergency(dialect):
        yield Case(dialect, case.command, {**case.given, "what": "when-rising"}, {"parameters": {}})


def _expect_ended(probe: Probe, stop: Command, how: str, acceleration: int = QUICK) -> None:
    """Stop, by a ramp where the stop has one, and refute unless the shaft stands as soon as that is over."""
    ramped = bool(declared.of(stop).acceleration)
    rpm = abs(motion.speed(probe).value)
    exchange = probe.ask(stop, {"acceleration": acceleration} if ramped else None)
    probe.wait(_DOWN_NS + (int(ramp.ramp_ns(0, rpm, acceleration)) if ramped else 0))
    expect_standing(probe, exchange, f"{stop.name} does not stop a shaft that {how}")


@of_motion(each=_fast_stops, name=_name_of_stop, refuted_by="a shaft that goes on, or slows down", risks=risks_of("run"))
def _when_fast(probe: Probe, command: Command, run: Command) -> None:
    """{command} stops {run} at once at 1200 rpm, either way; an emergency stop leaves the end of {run} untold."""
    motion.prepare(probe, run)
    since = len(probe.traffic)
    for way in (-1, 1):
        rpm = way * _FAST_RPM if declared.of(run).kind is MotionKind.RUN else _FAST_RPM
        motion.begin(probe, run, way * _FAST_TURNS * 360, rpm=rpm, acceleration=QUICK)
        probe.wait(550 * MS)
        _expect_turning(motion.speed(probe), _FAST_RPM / 2)
        _expect_ended(probe, command, "is fast", acceleration=0)
        probe.wait(int(ramp.move_ns(_FAST_TURNS, _FAST_RPM, QUICK)))
    # A stop by a ramp has the code of its motion.
    tells = declared.of(run).tells_end and not declared.of(command).acceleration
    told = arriving.statuses(probe.traffic[since:], run) if tells else []
    text = f"{run.name} that the emergency stop ended is told as complete"
    probe.expect(told, holds=2 not in told, expected="no status 2", refutes=text, key="told as complete")


@of_motion(each=_rising_stops, name=_name_of_stop, refuted_by="a shaft that goes on, or a refusal", risks=risks_of("run"))
def _when_rising(probe: Probe, command: Command, run: Command) -> None:
    """{command} stops {run} while the shaft still speeds up, and again while it slows down; {run} is taken after it."""
    motion.prepare(probe, run)
    motion.begin(probe, run, 20 * 360, rpm=600, acceleration=_RISING)
    probe.wait(250 * MS)
    _expect_turning(motion.speed(probe), 5)
    _expect_ended(probe, command, "speeds up")
    exchange = motion.ask(probe, run, 5 * 360, rpm=_RPM, acceleration=QUICK)
    refused = motion.refused(probe, exchange)
    text = f"{run.name} after {command.name} is refused"
    probe.expect("a refusal", holds=not refused, expected="motion", refutes=text, exchange=exchange)
    probe.wait(100 * MS)
    _expect_turning(motion.speed(probe), 5)
    motion.stop(probe, _SLOW_RAMP)
    probe.wait(100 * MS)
    _expect_ended(probe, command, "slows down")


#: A fast move: its speed and turns, with a ramp of 5 ms for each rpm. The shaft stands so long after its ramp at most.
_FAST_RPM, _FAST_TURNS, _RISING, _DOWN_NS = 1200, 20, 156, 120 * MS


@of_motion(each=_lk_stop, refuted_by="a shaft that goes on", risks=risks_by(Verb.RUN_SPEED))
def _stops(probe: Probe, command: Command) -> None:
    """The stop brings a running shaft to rest."""
    set_going(probe, probe.command(Verb.RUN_SPEED))
    exchange = probe.do(command)
    probe.wait(SECOND_NS)
    expect_standing(probe, exchange, "the stop does not bring the shaft to rest")


@of_motion(each=_lk_stop, refuted_by="a shaft at its target")
def _ends_a_move(probe: Probe, command: Command) -> None:
    """The stop ends a move before its target."""
    motion.ready_to_move(probe)
    before = motion.position(probe)
    motion.begin(probe, declared.any_move(probe.dialect, at_speed=True), 360, rpm=30)
    probe.wait(500 * MS)
    exchange = probe.do(command)
    went = abs(motion.wait_standing(probe).value - before.value)
    text, expected = "the stop does not end a move on its way", "about 90 degrees of 360"
    probe.expect(went, at_least=20, at_most=300, unit="degrees", expected=expected, refutes=text, exchange=exchange)


def endless(probe: Probe, run: Command) -> Exchange:
    """Begin a motion that lasts for seconds, and let it get going: a run, a torque, or a long move."""
    motion.prepare(probe, run)
    lasts = bool(declared.of(run).speed) or declared.of(run).kind is MotionKind.TORQUE
    exchange = motion.begin(probe, run, _way(run), rpm=15)
    probe.wait(_SET_OFF_NS if lasts else 100 * MS)
    return exchange


def _way(run: Command) -> int:
    """Return how far an endless move goes (degrees): one without a speed is fast, and gets a long way unless within a turn."""
    return 300 if declared.of(run).speed or declared.of(run).kind is MotionKind.MOVE_IN_TURN else 5 * 360


@of_motion(
    each=_emergency,
    name="{command}/keeps-torque",
    statement="The emergency stop does not switch the motor off: the next motion command moves it.",
    refuted_by="a motor that is disabled, or a motion that is refused",
    risks=risks_by(Verb.RUN_SPEED),
    at_best=Certainty.LIKELY,
)
@of_motion(
    each=_lk_stop,
    statement="After the stop the motor is on, and the next command moves it.",
    refuted_by="state 10h, or no motion",
    risks=risks_by(Verb.RUN_SPEED),
    at_best=Certainty.LIKELY,
)
def _stays_on(probe: Probe, command: Command) -> None:
    set_going(probe, probe.command(Verb.RUN_SPEED))
    exchange = probe.do(command)
    probe.wait(500 * MS)
    text = f"{command.name} switches the motor off"
    probe.expect("off", holds=motion.is_on(probe) is not False, expected="on", refutes=text, exchange=exchange)
    before = motion.position(probe)
    exchange = motion.ask(probe, probe.command(Verb.RUN_SPEED), rpm=CALM, acceleration=QUICK)
    text = f"the next run after {command.name} is refused"
    refused = motion.refused(probe, exchange)
    probe.expect("a refusal", holds=not refused, expected="a run", refutes=text, exchange=exchange)
    probe.wait(_SET_OFF_NS)
    went = abs(motion.stand_still(probe).value - before.value)
    text = f"the next run after {command.name} does not move the shaft"
    probe.expect(went, at_least=10, unit="degrees", refutes=text, exchange=exchange)


def _way_to_rest(probe: Probe, stop: Command, values: dict[str, int]) -> float:
    """Run, stop by a command and return how far the shaft went after it, in degrees."""
    set_going(probe, probe.command(Verb.RUN_SPEED))
    probe.ask(stop, values, quiet_ns=0)
    begun = motion.position(probe)
    return abs(motion.wait_standing(probe).value - begun.value)


@of_motion(each=_lk_stop, refuted_by="a shaft that runs out", at_best=Certainty.OPEN, risks=risks_by(Verb.RUN_SPEED))
def _brakes(probe: Probe, command: Command) -> None:
    """The stop brakes the shaft as speed 0 does: it goes no farther."""
    braked = _way_to_rest(probe, probe.command(Verb.RUN_SPEED), {"speed": 0})
    stopped = _way_to_rest(probe, command, {})
    text = "the shaft goes farther after the stop than after speed 0"
    probe.expect(stopped, at_most=braked + 5, unit="degrees", refutes=text)
