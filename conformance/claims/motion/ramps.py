"""Ramps: how long the shaft takes from one speed to another, measured from positions and held against the manual's law.

    time = 2 x (v2 x elapsed - way) / (v2 - v1)        from a position before the ramp and one behind it

Rules kept here:
- Positions are read at known times, each with an uncertainty; what follows from it is part of the verdict. A ramp within
  what a clock may be off and that uncertainty is confirmed; real drives were seen to be up to 4 % slow: a known quirk.
- A law that is a straight line and a drive that goes by whole rpm differ by one step: that is uncertain too.
- Replies that come late while the motor turns (quirk slow-replies-in-motion) leave nothing to measure.
- Below the slowest ramps 300 rpm are enough; the two fastest need 3000 to be seen at all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Verb
from conformance.claim import Curve, Inconclusive, Theme
from conformance.claims.declare import Case, Cases, commands
from conformance.claims.known_quirks import LATE, may_meet
from conformance.claims.motion.motion_claim import of_motion
from conformance.motion import arriving, declared, motion, ramp
from conformance.motion.declared import QUICK, SUBDIVISION
from conformance.motion.motion import Sample
from conformance.motion.ramp import Fit, Judgement
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, SECOND_NS, Probe

_SLOW_RAMP = "ramp-4-percent-slow"
#: A reply that leaves a time uncertain by more than this is late.
TOO_LATE_NS = 40 * MS
#: Accelerations as sent, and the speed to which each is tried.
_RAMPS = ((1, 60), (56, 120), (200, 300), (236, 300), (252, 3000))
#: By then a ramp is over, in its own time: it is judged more closely than that.
_LONGER = 1.2
#: Between two looks at a steady speed.
_STEADY_NS = 500 * MS
#: Degrees in a ns at one rpm.
_DEGREES = 6 / SECOND_NS


def _up_and_down(dialect: Dialect) -> Iterator[tuple[Command, str]]:
    """Yield the run and its stop, with the word for their ramps, where the manual has a law of ramps."""
    if dialect.ramp is not None:
        for run in dialect.motions(MotionKind.RUN):
            yield run, "up"
            yield dialect.stops_of(run)[0], "down"


def _of_ramps(refuted_by: str, *, each: Cases, **facts: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    facts = {"risks": lambda case: case.dialect.by_verb[Verb.RUN_SPEED].all_risks, **facts}
    return of_motion(each=each, refuted_by=refuted_by, theme=Theme.TIMING, **facts)


# --- measuring a ramp -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Steady:
    """A steady speed (rpm, without its sign), its uncertainty, and the first and the last position at which it was seen."""

    rpm: float
    spread: float
    first: Sample
    last: Sample


@dataclass(frozen=True)
class _Ramp:
    """What was seen of a ramp: the steady speeds before and after it, and the command that began it.

    `rpm`: those that were asked for, first and last, signed.
    """

    rpm: tuple[int, int]
    acceleration: int
    before: _Steady
    exchange: Exchange
    after: _Steady


def too_late(probe: Probe, *spreads_ns: float) -> bool:
    """Say whether replies came so late that nothing can be measured, and that the claim knows this of real drives.

    Raises Inconclusive where it does not.
    """
    if max(spreads_ns) <= TOO_LATE_NS:
        return False
    if LATE not in probe.claim.quirks:
        raise Inconclusive(f"a late reply left a time uncertain by {max(spreads_ns) / 1e6:.0f} ms")
    probe.meets(LATE)
    return True


def time_of(exchange: Exchange) -> tuple[float, float]:
    """Return when the drive took a request, and how uncertain that is (ns): between its end and the reply."""
    reply = exchange.reply
    if reply is None:
        raise Inconclusive("the motion was not answered")
    half = max(0, reply.first_ns - exchange.sent_ns) / 2
    return exchange.sent_ns + half, half


def _steady(probe: Probe, rpm: float) -> _Steady:
    """Measure a speed that does not change; of a shaft that is to stand, where it stands."""
    first = motion.position(probe)
    if not rpm:
        return _Steady(0.0, 0.0, first, first)
    probe.wait(_STEADY_NS)
    last = motion.position(probe)
    speed, spread = motion.speed_between(first, last)
    return _Steady(abs(speed), spread, first, last)


def _change(probe: Probe, last: float, acceleration: int) -> Exchange:
    if last:  # its sign is the direction
        command = probe.command(Verb.RUN_SPEED)
        return probe.ask(command, declared.values_of(probe.dialect, command, rpm=last, acceleration=acceleration), quiet_ns=0)
    return probe.ask(Verb.STOP_SPEED, {"acceleration": acceleration}, quiet_ns=0)


def _ramps_through(probe: Probe, speeds: tuple[int, ...], acceleration: int) -> tuple[_Ramp, ...]:
    """Run through some speeds, one after the other, and return the ramp to each but the first."""
    mode = declared.bus_modes(probe.dialect)[-1] if max(map(abs, speeds)) > 400 else ""
    motion.ready_to_move(probe, mode, subdivision=SUBDIVISION)
    if first := speeds[0]:
        motion.run_at(probe, first, QUICK)
        probe.wait(int(ramp.ramp_ns(0, first, QUICK)) + 100 * MS)
    before = _steady(probe, first)
    found = []
    for rpm in pairwise(speeds):
        exchange = _change(probe, rpm[1], acceleration)
        probe.wait(int(_LONGER * ramp.ramp_ns(*rpm, acceleration)) + 50 * MS)
        after = _steady(probe, rpm[1])
        found.append(_Ramp(rpm, acceleration, before, exchange, after))
        before = after
    motion.stop(probe, QUICK)
    motion.wait_standing(probe)
    return tuple(found)


def _ramp(probe: Probe, command: Command, speeds: tuple[int, ...], acceleration: int) -> _Ramp:
    """Return the ramp of a command among those through some speeds: of a run the first one, of its stop the last one."""
    stops = declared.of(command).kind is MotionKind.STOP
    return probe.recorded(_ramps_through, speeds, acceleration)[-1 if stops else 0]


def _time_of_ramp(probe: Probe, seen: _Ramp) -> tuple[float, float] | None:
    """Return the time of a ramp and its uncertainty (ns); None where a known quirk leaves nothing to measure."""
    before, after, exchange = seen.before, seen.after, seen.exchange
    first, last = map(abs, seen.rpm)
    start, end = before.last, after.first
    begun_ns, begun_spread = time_of(exchange)
    if too_late(probe, start.spread_ns, begun_spread, end.spread_ns):
        return None
    text = f"the shaft does not have its new speed after {_LONGER} times the time of the ramp"
    within = 1 + last * 0.03 + after.spread
    probe.expect(after.rpm, near=last, within=within, unit="rpm", refutes=text, exchange=exchange, key="ramp")
    change = after.rpm - before.rpm
    if abs(change) < abs(last - first) / 2:
        raise Inconclusive(f"the shaft went from {before.rpm:.1f} to {after.rpm:.1f} rpm, which is no ramp to measure")
    way = abs(end.value - start.value) / _DEGREES
    lead_ns, elapsed_ns = begun_ns - start.t_ns, end.t_ns - begun_ns
    took_ns = 2 * (after.rpm * elapsed_ns + before.rpm * lead_ns - way) / change
    unsure = after.rpm * end.spread_ns + abs(change) * begun_spread + before.rpm * start.spread_ns
    # A speed stands in the divisor too.
    unsure += after.spread * abs(elapsed_ns - took_ns / 2) + before.spread * abs(lead_ns + took_ns / 2)
    unsure += (2 * end.step + end.noise) / _DEGREES
    return took_ns, 2 * unsure / abs(change) + ramp.slack_ns(seen.acceleration)


# --- its time ---------------------------------------------------------------------------------------------------------


def _ramps(dialect: Dialect) -> Iterator[Case]:
    for command, word in _up_and_down(dialect):
        for acceleration, rpm in _RAMPS:
            law_ms = ramp.ramp_ns(0, rpm, acceleration) / 1e6
            how = {"speeds": (0, rpm, 0), "acceleration": acceleration, "rpm": rpm, "word": word, "law_ms": law_ms}
            facts = {"parameters": {"acceleration": acceleration, "rpm": rpm}}
            yield Case(dialect, command, how, facts)
        if word == "up":
            for first, last in ((240, 60),):
                statement = f"From {first} to {last} rpm (below 0 the other way) the shaft takes the time of {{change}} rpm."
                how = {"speeds": (first, last), "acceleration": 128, "change": abs(last - first)}
                yield Case(dialect, command, how, {"name": f"{command.name}/ramp-{first}-to-{last}", "statement": statement})


@_of_ramps(
    "another time, beyond what a clock may be off and the uncertainty",
    each=_ramps,
    name="{command}/ramp-{acceleration}",
    quirks=may_meet(_SLOW_RAMP, LATE),
)
def _takes(probe: Probe, command: Command, speeds: tuple[int, ...], acceleration: int) -> None:
    """At acceleration {acceleration} the way {word} between 0 and {rpm} rpm takes (256 - {acceleration}) x 50 us for each rpm:
    {law_ms:g} ms.
    """
    seen = _ramp(probe, command, speeds, acceleration)
    found = _time_of_ramp(probe, seen)
    if found is None:
        return
    took_ns, spread_ns = found
    first, last = map(abs, seen.rpm)
    judged = Judgement(took_ns, ramp.ramp_ns(first, last, acceleration), spread_ns)
    probe.measured |= {"ramp_ms": took_ns / 1e6, "law_ms": judged.law_ns / 1e6, "uncertain_ms": spread_ns / 1e6}
    fit = judged.fit
    if fit is Fit.BLIND:
        raise Inconclusive(f"the ramp cannot be measured here: {judged}")
    if fit is Fit.SLOW_AS_SEEN and _SLOW_RAMP in probe.claim.quirks:
        probe.meets(_SLOW_RAMP)
        return
    probe.expect(
        str(judged),
        holds=fit is Fit.GOOD,
        expected=f"{judged.law_ns / 1e6:.1f} ms, by (256 - {acceleration}) x 50 us for each rpm",
        refutes=f"the ramp is {fit.value}",
        exchange=seen.exchange,
        key=f"ramp {fit.name}",
    )


def _without_ramp(dialect: Dialect) -> Iterator[Case]:
    for command, word in _up_and_down(dialect):
        yield Case(dialect, command, {"word": word}, {"parameters": {}})


@_of_ramps("a ramp", each=_without_ramp, name="{command}/ramp-0", quirks=may_meet(LATE))
def _at_once(probe: Probe, command: Command) -> None:
    """At acceleration 0 the way {word} takes no time."""
    seen = _ramp(probe, command, (0, 60, 0), 0)
    found = _time_of_ramp(probe, seen)
    if found is None:
        return
    took_ns, spread_ns = found
    probe.measured |= {"ramp_ms": took_ns / 1e6, "uncertain_ms": spread_ns / 1e6}
    got = f"{took_ns / 1e6:.0f} ms +-{spread_ns / 1e6:.1f}"
    text = "acceleration 0 changes the speed by a ramp"
    probe.expect(got, holds=took_ns <= 20 * MS + spread_ns, expected="0 ms", refutes=text, exchange=seen.exchange)


# --- its shape --------------------------------------------------------------------------------------------------------


def _runs(dialect: Dialect) -> Iterator[Case]:
    if dialect.ramp is not None:
        yield from commands(Verb.RUN_SPEED)(dialect)


@_of_ramps("a speed that is elsewhere", each=_runs, at_best=Certainty.LIKELY, quirks=may_meet(LATE), risks=())
def _ramp_is_even(probe: Probe, command: Command) -> None:
    """On the ramp of {command} the speed rises evenly: it is where the law says on the way."""
    rpm, acceleration = 120, 56
    motion.prepare(probe, command)
    # What another command was given is not what counts here.
    arriving.follow(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), 18, acceleration=QUICK)
    exchange = motion.ask(probe, command, 4 * 360, rpm=rpm, acceleration=acceleration, quiet_ns=0)
    if motion.refused(probe, exchange):
        raise Inconclusive(f"{command.name} was refused")
    begun_ns, begun_spread = time_of(exchange)
    step_ns = ramp.step_ns(acceleration)
    points: list[tuple[float, float]] = []
    law: list[tuple[float, float]] = [(0.0, 0.0)]
    spreads = [begun_spread]
    wrong = ""
    for eighth in range(1, 8):
        probe.wait(int(begun_ns + eighth * rpm * step_ns / 8 - probe.gate.now_ns()))
        seen = motion.speed(probe)
        spreads.append(seen.spread_ns)
        expected = min(rpm, (seen.t_ns - begun_ns) / step_ns)
        points.append(((seen.t_ns - begun_ns) / 1e9, abs(seen.value)))
        law.append((points[-1][0], expected))
        if abs(abs(seen.value) - expected) > 2 + 0.06 * rpm + (seen.spread_ns + begun_spread) / step_ns:
            wrong = wrong or f"{abs(seen.value):g} rpm after {points[-1][0] * 1000:.0f} ms, where the law has {expected:.0f}"
    probe.series["speed"] = Curve("rpm", tuple(points), tuple(law))
    motion.stand_still(probe)
    if not too_late(probe, *spreads):
        probe.expect(
            wrong,
            equal="",
            expected="1 rpm more every 10 ms",
            refutes=f"the ramp of {command.name} is not even",
            exchange=exchange,
            key=f"{command.name} shape",
        )
