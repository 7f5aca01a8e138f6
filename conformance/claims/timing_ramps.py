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
from conformance import journey, moving, ramp
from conformance.claim import Claim, Inconclusive, Theme
from conformance.claims.known_quirks import known
from conformance.claims.motion_claim import expect_speed, motion_claim, refute
from conformance.exchange import Exchange
from conformance.moving import MS, SECOND_NS, Sample
from conformance.probe import Probe, Until
from conformance.ramp import Fit, Judgement

_SLOW_RAMP, _LATE = "ramp-4-percent-slow", "slow-replies-in-motion"
#: A reply that leaves a moment uncertain by more than this is late.
_TOO_LATE_NS = 40 * MS
#: Accelerations as sent, and the speed to which each is tried.
_RAMPS = ((1, 60), (56, 120), (128, 200), (200, 300), (236, 300), (250, 3000), (255, 3000))
#: Between two looks at a steady speed.
_STEADY_NS = SECOND_NS
#: What a move may take longer or less long than the law, beside its uncertainty.
_SHARE = 0.03
#: Degrees in a ns at one rpm.
_DEGREES = 6 / SECOND_NS


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about ramps."""
    run, stop = dialect.by_verb[Verb.RUN_SPEED], dialect.by_verb[Verb.STOP_SPEED]
    quirks = known(dialect, _SLOW_RAMP, _LATE)
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
            quirks=known(dialect, _LATE),
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
            f"On the ramp of {command.name} the speed rises evenly: it is where the law says at each quarter.",
            "a speed that is elsewhere",
            _even,
            theme=Theme.TIMING,
            at_best=Certainty.LIKELY,
            quirks=known(dialect, _LATE),
        )
    if journey.tells(dialect):
        for command in journey.moves(dialect):
            yield from _about_duration(dialect, command)


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
    if _LATE not in probe.claim.quirks:
        raise Inconclusive(f"a reply left a moment uncertain by {max(spreads_ns) / 1e6:.0f} ms")
    probe.meets(_LATE)
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
    first = moving.position(probe)
    if not rpm:
        return _Steady(0.0, 0.0, first)
    probe.wait(_STEADY_NS)
    second = moving.position(probe)
    speed, spread = moving.speed_between(first, second)
    return _Steady(abs(speed), spread, second if last else first)


def _change(probe: Probe, last: float, acceleration: int) -> Exchange:
    if last:  # its sign is the direction
        command = probe.command(Verb.RUN_SPEED)
        return probe.ask(command, moving.run_values(command, last, acceleration), quiet_ns=0)
    return probe.ask(Verb.STOP_SPEED, {"acceleration": acceleration}, quiet_ns=0)


def _ramp(probe: Probe, first: int, last: int, acceleration: int) -> tuple[float, float, Exchange] | None:
    """Measure the time of a ramp and its uncertainty (ns); None where a known quirk leaves nothing to measure."""
    mode = moving.bus_modes(probe.dialect)[-1] if max(first, abs(last)) > 400 else ""
    moving.ready_to_move(probe, mode, subdivision=journey.SUBDIVISION)
    if first:
        moving.run_at(probe, first, 250)
        probe.wait(int(ramp.ramp_ns(0, first, 250)) + 200 * MS)
    before = _steady(probe, first, last=True)
    exchange = _change(probe, last, acceleration)
    begun_ns, begun_spread = moment(exchange)
    law_ns = ramp.ramp_ns(first, last, acceleration)
    probe.wait(int(2.2 * law_ns) + 100 * MS)
    last = abs(last)
    after = _steady(probe, last)
    moving.stop(probe, 250)
    moving.wait_standing(probe)
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
    journey.travel(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), 0.05, acceleration=250)
    if command.verb is Verb.RUN_SPEED:
        exchange = probe.ask(command, moving.run_values(command, rpm, acceleration), quiet_ns=0)
    else:
        exchange = journey.ask(probe, command, 4.0, speed=rpm, acceleration=acceleration, quiet_ns=0)
    if journey.refused(probe, exchange):
        raise Inconclusive(f"{command.name} was refused")
    begun_ns, begun_spread = moment(exchange)
    step_ns = ramp.step_ns(acceleration)
    points: list[tuple[float, float]] = []
    spreads = [begun_spread]
    wrong = ""
    for quarter in (1, 2, 3):
        probe.wait(int(begun_ns + quarter * rpm * step_ns / 4 - probe.gate.now_ns()))
        seen = moving.speed(probe)
        spreads.append(seen.spread_ns)
        expected = min(rpm, (seen.t_ns - begun_ns) / step_ns)
        points.append(((seen.t_ns - begun_ns) / 1e9, abs(seen.value)))
        if abs(abs(seen.value) - expected) > 2 + 0.06 * rpm + (seen.spread_ns + begun_spread) / step_ns:
            wrong = wrong or f"{abs(seen.value):g} rpm after {points[-1][0] * 1000:.0f} ms, where the law has {expected:.0f}"
    probe.series["speed"] = points
    moving.stand_still(probe)
    if too_late(probe, *spreads):
        return
    if wrong:
        text = f"the ramp of {command.name} is not even"
        raise refute(exchange, text, expected="1 rpm more every 10 ms", got=wrong, key=f"{command.name} shape")


# --- whole moves ------------------------------------------------------------------------------------------------------

#: Moves by their form: turns, rpm, acceleration, and what they show.
_WAYS = (
    ("trapezoid", 1.0, 120, 200, "up, along and down"),
    ("triangle", -1.0, 300, 56, "up and down again, for the way is too short for its speed"),
    ("no-ramp", 0.5, 60, 0, "along at its speed, without ramps"),
)


def _about_duration(dialect: Dialect, command: Command) -> Iterator[Claim]:
    for name, turns, rpm, acceleration, how in _WAYS:
        law_ms = ramp.move_ns(turns, rpm, acceleration) / 1e6
        yield motion_claim(
            dialect,
            command,
            f"takes-{name}",
            f"{command.name} by {turns:g} turns at {rpm} rpm and acceleration {acceleration} goes {how}: {law_ms:.0f} ms.",
            "another time from its begin to its end",
            partial(_lasts, turns, rpm, acceleration),
            theme=Theme.TIMING,
            quirks=known(dialect, _LATE) if not acceleration else (),
        )
    yield motion_claim(
        dialect,
        command,
        "told-in-time",
        f"The end of {command.name} is told within half a second of the shaft's coming to rest.",
        "a completion that comes later",
        _told_in_time,
        theme=Theme.TIMING,
        at_best=Certainty.LIKELY,
    )
    stop = dialect.by_verb[journey.STOP_OF[command.verb]]
    yield motion_claim(
        dialect,
        stop,
        "told-in-time",
        f"The end of {stop.name} is told when its ramp is over, give or take half a second.",
        "a completion that comes sooner or later",
        partial(_stop_told_in_time, command.name),
        theme=Theme.TIMING,
        at_best=Certainty.LIKELY,
    )


def _lasts(turns: float, rpm: int, acceleration: int, probe: Probe, command: Command) -> None:
    journey.prepare(probe, command)
    exchange = journey.ask(probe, command, turns, speed=rpm, acceleration=acceleration, until=Until.DONE)
    probe.reply(exchange)
    done = [a for a in exchange.answers if a.values.get(command.replies.status) == 2]
    if not done:
        raise Inconclusive(f"{command.name} did not say that it was complete")
    begun_ns, spread_ns = moment(exchange)
    if too_late(probe, spread_ns):
        return
    took_ns, law_ns = done[-1].first_ns - begun_ns, ramp.move_ns(turns, rpm, acceleration)
    slack_ns = spread_ns + ramp.slack_ns(acceleration, 2) + 10 * MS
    probe.measured |= {"move_ms": took_ns / 1e6, "law_ms": law_ns / 1e6}
    if abs(took_ns - law_ns) > law_ns * _SHARE + slack_ns:
        raise refute(
            exchange,
            f"{command.name} takes another time than the law",
            expected=f"{law_ns / 1e6:.0f} ms",
            got=f"{took_ns / 1e6:.0f} ms ({(took_ns / law_ns - 1) * 100:+.1f} %)",
            key=f"{command.name} duration",
        )


#: When a reply about an end counts as late.
_HALF_SECOND_NS = 500 * MS


def _told_in_time(probe: Probe, command: Command) -> None:
    journey.prepare(probe, command)
    since = len(probe.traffic)
    exchange = journey.begin(probe, command, 0.25, acceleration=250, quiet_ns=0)
    seen = moving.sampled(probe, 4 * SECOND_NS, 40 * MS)
    told = [a for a in journey.told(probe.traffic[since:], command) if a.values[command.replies.status] == 2]
    if not told:
        raise Inconclusive(f"{command.name} did not say that it was complete")
    end = seen[-1].value
    stood = next(s for s in seen if abs(s.value - end) <= moving.SAME)
    late_ns = told[-1].first_ns - stood.t_ns
    if late_ns > _HALF_SECOND_NS:
        raise refute(
            exchange,
            f"the end of {command.name} is told late",
            expected="at most 500 ms after the shaft came to rest",
            got=f"{late_ns / 1e6:.0f} ms after",
        )


def _stop_told_in_time(name: str, probe: Probe, stop: Command) -> None:
    move, acceleration, rpm = probe.command(name), 56, 120
    journey.prepare(probe, move)
    journey.begin(probe, move, 5.0, speed=rpm, acceleration=250)
    probe.wait(500 * MS)
    turning = moving.speed(probe)
    expect_speed(turning, rpm, probe.traffic[-1], f"{name} does not turn at its speed before the stop")
    law_ns = ramp.ramp_ns(rpm, 0, acceleration)
    exchange = probe.ask(stop, {"acceleration": acceleration}, until=Until.DONE, timeout_ns=int(law_ns) + 5 * SECOND_NS)
    probe.reply(exchange)
    done = [a for a in exchange.answers if a.values.get(stop.replies.status) in (2, 3)]
    if not done:
        raise Inconclusive(f"{stop.name} did not say that it was complete")
    took_ns = done[-1].first_ns - exchange.sent_ns
    if abs(took_ns - law_ns) > _HALF_SECOND_NS:
        got = f"{took_ns / 1e6:.0f} ms"
        raise refute(exchange, f"the end of {stop.name} is not told in time", expected=f"{law_ns / 1e6:.0f} ms", got=got)
