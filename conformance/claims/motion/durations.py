"""Whole moves: how long they take by the law, and when their end is told.

A dialect that tells no end (Modbus) has no such claims: to see it, a shaft would have to be asked every few milliseconds.

Rules kept here:
- A move takes what the law gives it, within 3 % and one step for each of its ramps; its end may be told late.
- The end is told when the shaft stands, and within half a second of that.
"""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind
from conformance.claim import Inconclusive, Theme
from conformance.claims.declare import Case
from conformance.claims.known_quirks import LATE, known
from conformance.claims.motion.motion_claim import expect_speed, of_motion, that_tell_their_end
from conformance.claims.motion.ramps import time_of, too_late
from conformance.motion import arriving, motion, ramp
from conformance.motion.declared import QUICK
from conformance.talk.noise import TOLD_LATE_NS
from conformance.talk.probe import MS, SECOND_NS, Probe, Until

#: What a move may take longer or less long than the law, beside its uncertainty.
_SHARE = 0.03
#: When a reply about an end counts as late.
_HALF_SECOND_NS = 500 * MS
#: A move by its form: turns, rpm, acceleration, and what it shows.
_FORMS = (("trapezoid", 1.0, 120, 200, "up, along and down"),)


def _moves(dialect: Dialect) -> Iterator[Case]:
    if dialect.ramp is not None:
        for move in dialect.motions(MotionKind.MOVE_BY, MotionKind.MOVE_TO):
            yield Case(dialect, move)


def _forms(dialect: Dialect) -> Iterator[Case]:
    for case in _moves(dialect):
        for form, turns, rpm, acceleration, how in _FORMS:
            law_ms = ramp.move_ns(turns, rpm, acceleration) / 1e6
            given = {"form": form, "turns": turns, "rpm": rpm, "acceleration": acceleration, "how": how, "law_ms": law_ms}
            yield Case(dialect, case.command, given, {"parameters": {}})


@of_motion(
    each=that_tell_their_end(_forms),
    name="{command}/takes-{form}",
    refuted_by="another time from its begin to its end",
    theme=Theme.TIMING,
    quirks=lambda case: () if case["acceleration"] else known(case.dialect, LATE),
)
def _takes(probe: Probe, command: Command, turns: float, rpm: int, acceleration: int) -> None:
    """{command} by {turns:g} turns at {rpm} rpm and acceleration {acceleration} goes {how}: {law_ms:.0f} ms."""
    motion.prepare(probe, command)
    exchange = motion.ask(probe, command, turns * 360, rpm=rpm, acceleration=acceleration, until=Until.DONE)
    probe.reply(exchange)
    done = [a for a in exchange.answers if a.values.get(command.replies.status) == 2]
    if not done:
        raise Inconclusive(f"{command.name} did not say that it was complete")
    begun_ns, spread_ns = time_of(exchange)
    if too_late(probe, spread_ns):
        return
    took_ns, law_ns = done[-1].first_ns - begun_ns, ramp.move_ns(turns, rpm, acceleration)
    slack_ns = law_ns * _SHARE + spread_ns + ramp.slack_ns(acceleration, 2) + 10 * MS
    probe.measured |= {"move_ms": took_ns / 1e6, "law_ms": law_ns / 1e6}
    probe.expect(
        f"{took_ns / 1e6:.0f} ms ({(took_ns / law_ns - 1) * 100:+.1f} %)",
        holds=-slack_ns <= took_ns - law_ns <= slack_ns + TOLD_LATE_NS,
        expected=f"{law_ns / 1e6:.0f} ms",
        refutes=f"{command.name} takes another time than the law",
        exchange=exchange,
        key=f"{command.name} duration",
    )


@of_motion(
    each=that_tell_their_end(_moves), refuted_by="a completion that comes later", theme=Theme.TIMING, at_best=Certainty.LIKELY
)
def _told_in_time(probe: Probe, command: Command) -> None:
    """The end of {command} is told within half a second of the shaft's coming to rest."""
    motion.prepare(probe, command)
    since = len(probe.traffic)
    exchange = motion.begin(probe, command, 90, rpm=120, acceleration=QUICK, quiet_ns=0)
    # The move takes a sixth of a second.
    seen = motion.sampled(probe, 400 * MS, 40 * MS)
    if 2 not in arriving.statuses(probe.traffic[since:], command):
        probe.listen(3 * SECOND_NS, Until.REPLY)
    ends = [a for a in arriving.replies(probe.traffic[since:], command) if a.values[command.replies.status] == 2]
    if not ends:
        raise Inconclusive(f"{command.name} did not say that it was complete")
    place = seen[-1].value
    stood = next(s for s in seen if abs(s.value - place) <= motion.same(probe))
    late_ms = (ends[-1].first_ns - stood.t_ns) / 1e6
    text = f"the end of {command.name} is told late"
    at_most = _HALF_SECOND_NS / 1e6
    probe.expect(late_ms, at_most=at_most, unit="ms after the shaft came to rest", refutes=text, exchange=exchange)


def _stops(dialect: Dialect) -> Iterator[Case]:
    for case in _moves(dialect):
        assert case.command is not None
        yield Case(dialect, dialect.stops_of(case.command)[0], {"move": case.command})


@of_motion(
    each=that_tell_their_end(_stops),
    name="{command}/told-in-time",
    refuted_by="a completion that comes sooner or later",
    theme=Theme.TIMING,
    at_best=Certainty.LIKELY,
)
def _stop_told_in_time(probe: Probe, command: Command, move: Command) -> None:
    """The end of {command} is told when its ramp is over, give or take half a second."""
    acceleration, rpm = 56, 120
    motion.prepare(probe, move)
    motion.begin(probe, move, 5 * 360, rpm=rpm, acceleration=QUICK)
    probe.wait(250 * MS)
    turning = motion.speed(probe)
    expect_speed(turning, rpm, probe.traffic[-1], f"{move.name} does not turn at its speed before the stop")
    law_ns = ramp.ramp_ns(rpm, 0, acceleration)
    timeout_ns = int(law_ns) + 5 * SECOND_NS
    exchange = probe.ask(command, {"acceleration": acceleration}, until=Until.DONE, timeout_ns=timeout_ns)
    probe.reply(exchange)
    done = [a for a in exchange.answers if a.values.get(command.replies.status) in (2, 3)]
    if not done:
        raise Inconclusive(f"{command.name} did not say that it was complete")
    took_ms = (done[-1].first_ns - exchange.sent_ns) / 1e6
    text = f"the end of {command.name} is not told in time"
    within = _HALF_SECOND_NS / 1e6
    probe.expect(took_ms, near=law_ns / 1e6, within=within, unit="ms", refutes=text, exchange=exchange)
