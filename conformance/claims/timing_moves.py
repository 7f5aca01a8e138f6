"""Whole moves: how long they take by the law, and when their end is told.

A dialect that tells no end (Modbus) has no such claims: to see it, a shaft would have to be asked every few milliseconds.

Rules kept here:
- A move takes what the law gives it, within 3 % and one step for each of its ramps.
- The end is told when the shaft stands, and within half a second of that.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect
from conformance.claim import Claim, Inconclusive, Theme
from conformance.claims.known_quirks import known
from conformance.claims.motion_claim import expect_speed, motion_claim, refute
from conformance.claims.timing_ramps import LATE, moment, too_late
from conformance.motion import motion, ramp
from conformance.motion import moves as journey
from conformance.motion.motion import MS, QUICK, SECOND_NS
from conformance.talk.probe import Probe, Until

#: What a move may take longer or less long than the law, beside its uncertainty.
_SHARE = 0.03
#: Moves by their form: turns, rpm, acceleration, and what they show.
_WAYS = (
    ("trapezoid", 1.0, 120, 200, "up, along and down"),
    ("triangle", -1.0, 300, 56, "up and down again, for the way is too short for its speed"),
    ("no-ramp", 0.5, 60, 0, "along at its speed, without ramps"),
)


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about whole moves, where their end is told."""
    if journey.tells(dialect):
        for command in journey.moves(dialect):
            yield from _about_duration(dialect, command)


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
            quirks=known(dialect, LATE) if not acceleration else (),
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
    exchange = journey.begin(probe, command, 0.25, acceleration=QUICK, quiet_ns=0)
    seen = motion.sampled(probe, 3 * SECOND_NS, 60 * MS)
    told = [a for a in journey.told(probe.traffic[since:], command) if a.values[command.replies.status] == 2]
    if not told:
        raise Inconclusive(f"{command.name} did not say that it was complete")
    end = seen[-1].value
    stood = next(s for s in seen if abs(s.value - end) <= motion.SAME)
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
    journey.begin(probe, move, 5.0, speed=rpm, acceleration=QUICK)
    probe.wait(500 * MS)
    turning = motion.speed(probe)
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
