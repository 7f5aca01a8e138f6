"""Ramps: how long the shaft takes from one speed to another, measured from positions and held against the manual's law.

    time = 2 x (v2 x elapsed - way) / (v2 - v1)        from a position before the ramp and one behind it

Rules kept here:
- Positions are read at known moments, each with an uncertainty; what follows from it is part of the verdict. A ramp within
  1 % of the law and that uncertainty is confirmed; real drives were seen to be up to 4 % slow, which is observed.
- A law that is a straight line and a drive that goes by whole rpm differ by one step: that is uncertain too.
- Replies that come late while the motor turns (quirk slow-replies-in-motion) leave nothing to measure.
- Below the slowest ramps 300 rpm are enough; the two fastest need 3000 to be seen at all.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Verb
from conformance.claim import Claim, Inconclusive, Theme
from conformance.claims.known_quirks import known
from conformance.claims.motion_claim import motion_claim, refute
from conformance.motion import motion, ramp
from conformance.motion import moves as journey
from conformance.motion.motion import MS, QUICK, SECOND_NS, Sample
from conformance.motion.ramp import Fit, Judgement
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe

_SLOW_RAMP, LATE = "ramp-4-percent-slow", "slow-replies-in-motion"
#: A reply that leaves a moment uncertain by more than this is late.
_TOO_LATE_NS = 40 * MS
#: Accelerations as sent, and the speed to which each is tried.
_RAMPS = ((1, 60), (56, 120), (128, 200), (200, 300), (236, 300), (252, 3000), (255, 3000))
#: Between two looks at a steady speed.
_STEADY_NS = SECOND_NS
#: Degrees in a ns at one rpm.
_DEGREES = 6 / SECOND_NS


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about ramps."""
    run, stop = dialect.by_verb[Verb.RUN_SPEED], dialect.by_verb[Verb.STOP_SPEED]
    quirks = known(dialect, _SLOW_RAMP, LATE)
    for command, word in ((run, "up"), (stop, "down")):
        made = partial(motion_claim, dialect, command, theme=Theme.TIMING, risks=run.all_risks)
        for acceleration, rpm in _RAMPS:
            first, last = (0, rpm) if word == "up" else (rpm, 0)
            yield made(
                f"ramp-{acceleration}",
                f"At acceleration {acceleration} the way {word} between 0 and {rpm} rpm takes (256 - {acceleration}) x 50 us "
                f"for each rpm: {ramp.ramp_ns(first, last, acceleration) / 1e6:g} ms.",
                "another time, beyond 1 % and the uncertainty",
                partial(_takes, first, last, acceleration),
                quirks=quirks,
                parameters={"acceleration": acceleration, "rpm": rpm},
            )
        yield made(
            "ramp-0",
            f"At acceleration 0 the way {word} takes no time.",
            "a ramp",
            partial(_at_once, *((0, 60) if word == "up" else (60, 0))),
            quirks=known(dialect, LATE),
        )
    made = partial(motion_claim, dialect, run, theme=Theme.TIMING)
    for first, last in ((60, 240), (240, 60), (0, -200)):
        yield made(
            f"ramp-{first}-to-{last}",
            f"From {first} to {last} rpm (below 0 the other way) the shaft takes the time of {abs(last - first)} rpm.",
            "another time, beyond 1 % and the uncertainty",
            partial(_takes, first, last, 128),
            quirks=quirks,
        )
    for command in (run, *journey.moves(dialect)):
        yield motion_claim(
            dialect,
            command,
            "ramp-is-even",
            f"On the ramp of {command.name} the speed rises evenly: it is where the law says on the way.",
            "a speed that is elsewhere",
            _even,
            theme=Theme.TIMING,
            at_best=Certainty.LIKELY,
            quirks=known(dialect, LATE),
        )


# --- measuring a ramp -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Steady:
    """A steady speed (rpm, without its sign), its uncertainty, and a position at which the shaft had it."""

    rpm: float
    spread: float
    at: Sample


def too_late(probe: Probe, *spreads_ns: float) -> bool:
    """Say whether replies came so late that nothing can be measured, and that the claim knows this of real drives.

    Raises Inconclusive where it does not.
    """
    if max(spreads_ns) <= _TOO_LATE_NS:
        return False
    if LATE not in probe.claim.quirks:
        raise Inconclusive(f"a reply left a moment uncertain by {max(spreads_ns) / 1e6:.0f} ms")
    probe.meets(LATE)
    return True


def moment(exchange: Exchange) -> tuple[float, float]:
    """Return when the drive took a request, and how uncertain that is (ns): between its end and the reply."""
    reply = exchange.reply
    if reply is None:
        raise Inconclusive("the motion was not answered")
    half = max(0, reply.first_ns - exchange.sent_ns) / 2
    return exchange.sent_ns + half, half


def _steady(probe: Probe, rpm: float, *, last: bool = False) -> _Steady:
    """Measure a speed that does not change; of a shaft that is to stand, where it stands.

    The position is that at the beginning, or with `last` that at the end: the one that is nearer to the ramp.
    """
    first = motion.position(probe)
    if not rpm:
        return _Steady(0.0, 0.0, first)
    probe.wait(_STEADY_NS)
    second = motion.position(probe)
    speed, spread = motion.speed_between(first, second)
    return _Steady(abs(speed), spread, second if last else first)


def _change(probe: Probe, last: float, acceleration: int) -> Exchange:
    if last:  # its sign is the direction
        command = probe.command(Verb.RUN_SPEED)
        return probe.ask(command, motion.run_values(command, last, acceleration), quiet_ns=0)
    return probe.ask(Verb.STOP_SPEED, {"acceleration": acceleration}, quiet_ns=0)


def _ramp(probe: Probe, first: int, last: int, acceleration: int) -> tuple[float, float, Exchange] | None:
    """Measure the time of a ramp and its uncertainty (ns); None where a known quirk leaves nothing to measure."""
    mode = motion.bus_modes(probe.dialect)[-1] if max(first, abs(last)) > 400 else ""
    motion.ready_to_move(probe, mode, subdivision=journey.SUBDIVISION)
    if first:
        motion.run_at(probe, first, QUICK)
        probe.wait(int(ramp.ramp_ns(0, first, QUICK)) + 200 * MS)
    before = _steady(probe, first, last=True)
    exchange = _change(probe, last, acceleration)
    begun_ns, begun_spread = moment(exchange)
    law_ns = ramp.ramp_ns(first, last, acceleration)
    probe.wait(int(2.2 * law_ns) + 100 * MS)
    last = abs(last)
    after = _steady(probe, last)
    motion.stop(probe, QUICK)
    motion.wait_standing(probe)
    if too_late(probe, before.at.spread_ns, begun_spread, after.at.spread_ns):
        return None
    if abs(after.rpm - last) > 1 + last * 0.03 + after.spread:
        text = "the shaft does not have its new speed after more than twice the time of the ramp"
        raise refute(exchange, text, expected=f"{last} rpm", got=f"{after.rpm:.1f} rpm", key="ramp")
    change = after.rpm - before.rpm
    if abs(change) < abs(last - first) / 2:
        raise Inconclusive(f"the shaft went from {before.rpm:.1f} to {after.rpm:.1f} rpm, which is no ramp to measure")
    way = abs(after.at.value - before.at.value) / _DEGREES
    lead_ns, elapsed_ns = begun_ns - before.at.t_ns, after.at.t_ns - begun_ns
    took_ns = 2 * (after.rpm * elapsed_ns + before.rpm * lead_ns - way) / change
    unsure = after.rpm * after.at.spread_ns + abs(change) * begun_spread + before.rpm * before.at.spread_ns
    unsure += after.spread * elapsed_ns + before.spread * lead_ns + 2 * after.at.step / _DEGREES
    return took_ns, 2 * unsure / abs(change) + ramp.slack_ns(acceleration), exchange


def _takes(first: int, last: int, acceleration: int, probe: Probe, command: Command) -> None:
    found = _ramp(probe, first, last, acceleration)
    if found is None:
        return
    took_ns, spread_ns, exchange = found
    judged = Judgement(took_ns, ramp.ramp_ns(first, abs(last), acceleration), spread_ns)
    probe.measured |= {"ramp_ms": took_ns / 1e6, "law_ms": judged.law_ns / 1e6, "uncertain_ms": spread_ns / 1e6}
    fit = judged.fit
    if fit is Fit.BLIND:
        raise Inconclusive(f"the ramp cannot be measured here: {judged}")
    if fit is Fit.SLOW_AS_SEEN and _SLOW_RAMP in probe.claim.quirks:
        probe.meets(_SLOW_RAMP)
    elif fit is not Fit.GOOD:
        law = f"{judged.law_ns / 1e6:.1f} ms, by (256 - {acceleration}) x 50 us for each rpm"
        raise refute(exchange, f"the ramp is {fit.value}", expected=law, got=str(judged), key=f"ramp {fit.name}")


def _at_once(first: int, last: int, probe: Probe, command: Command) -> None:
    found = _ramp(probe, first, last, 0)
    if found is None:
        return
    took_ns, spread_ns, exchange = found
    probe.measured |= {"ramp_ms": took_ns / 1e6, "uncertain_ms": spread_ns / 1e6}
    if took_ns > 20 * MS + spread_ns:
        got = f"{took_ns / 1e6:.0f} ms +-{spread_ns / 1e6:.1f}"
        raise refute(exchange, "acceleration 0 changes the speed by a ramp", expected="0 ms", got=got)


# --- the shape --------------------------------------------------------------------------------------------------------


def _even(probe: Probe, command: Command) -> None:
    rpm, acceleration = 120, 56
    journey.prepare(probe, command)
    # What another command was given is not what counts here.
    journey.travel(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), 0.05, acceleration=QUICK)
    if command.verb is Verb.RUN_SPEED:
        exchange = probe.ask(command, motion.run_values(command, rpm, acceleration), quiet_ns=0)
    else:
        exchange = journey.ask(probe, command, 4.0, speed=rpm, acceleration=acceleration, quiet_ns=0)
    if journey.refused(probe, exchange):
        raise Inconclusive(f"{command.name} was refused")
    begun_ns, begun_spread = moment(exchange)
    step_ns = ramp.step_ns(acceleration)
    points: list[tuple[float, float]] = []
    spreads = [begun_spread]
    wrong = ""
    for eighth in range(1, 8):
        probe.wait(int(begun_ns + eighth * rpm * step_ns / 8 - probe.gate.now_ns()))
        seen = motion.speed(probe)
        spreads.append(seen.spread_ns)
        expected = min(rpm, (seen.t_ns - begun_ns) / step_ns)
        points.append(((seen.t_ns - begun_ns) / 1e9, abs(seen.value)))
        if abs(abs(seen.value) - expected) > 2 + 0.06 * rpm + (seen.spread_ns + begun_spread) / step_ns:
            wrong = wrong or f"{abs(seen.value):g} rpm after {points[-1][0] * 1000:.0f} ms, where the law has {expected:.0f}"
    probe.series["speed"] = points
    motion.stand_still(probe)
    if too_late(probe, *spreads):
        return
    if wrong:
        text = f"the ramp of {command.name} is not even"
        raise refute(exchange, text, expected="1 rpm more every 10 ms", got=wrong, key=f"{command.name} shape")
