"""Stops: by a ramp, at once, in an emergency, and by switching the motor off.

A stop is its run with zeros everywhere but in the acceleration: with one the shaft slows down by the ramp, with 0 it stands
at once. The stop of a run or a move says 1 when it begins and 2 when the shaft stands; the move that it ends says no more.

Rules kept here:
- Ramps are so slow (1.2 s) that even a reply that is late while the motor turns comes before they end.
- How long a ramp takes to the per cent is judged by the theme timing; here a ramp is told from a halt.
- Nothing is stopped at once above 60 rpm.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Verb
from conformance.claim import Claim, Inconclusive
from conformance.claims.known_quirks import known
from conformance.claims.motion_claim import expect_stays, motion_claim, refute
from conformance.motion import motion, moves
from conformance.motion.motion import MS, QUICK, SAME, SECOND_NS, Sample
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe, Until

#: 10 ms for each rpm: from 120 rpm the shaft needs 1.2 s.
_SLOW_RAMP, _RPM, _RAMP_NS = 56, 120, 1200 * MS
_CALM = 60
#: How far a shaft that stops at once may still go, in degrees: the time of a request at 60 rpm, and a little.
_AT_ONCE = 6.0
_SETTLING = 32 * 360 / 16384
_GO_ON_NS = 500 * MS


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about stops."""
    for run_verb, stop_verb in moves.STOP_OF.items():
        yield from _about(dialect, dialect.by_verb[run_verb], dialect.by_verb[stop_verb])
    yield from _emergency(dialect)
    yield from _enabling(dialect)


def _about(dialect: Dialect, run: Command, stop: Command) -> Iterator[Claim]:
    made = partial(motion_claim, dialect, stop, risks=run.all_risks)
    yield made(
        "by-ramp",
        f"{stop.name} with an acceleration slows the shaft down by the ramp and lets it stand.",
        "a shaft that stands at once, slows down later, or does not stop",
        partial(_by_ramp, run.name),
    )
    yield made(
        "at-once",
        f"{stop.name} with acceleration 0 stops the shaft at once.",
        "a shaft that goes on",
        partial(_at_once, run.name),
    )
    yield made(
        "stays-stopped",
        f"After {stop.name} the shaft stays where it stopped; the motion that it ended is not taken up again.",
        "a shaft that moves again",
        partial(_stays_stopped, run.name),
    )
    if moves.tells(dialect):
        yield made(
            "replies",
            f"{stop.name} is answered by 1 when it begins and by 2 (or 3, at an end limit) when the shaft stands.",
            "other statuses, another order, more or fewer replies; or a reply of the motion that it ended",
            partial(_replies, run.name),
            at_best=Certainty.LIKELY,
        )
        yield made(
            "told-when-standing",
            f"When {stop.name} says that it is complete, the shaft stands.",
            "a shaft that still turns when status 2 comes",
            partial(_told_when_standing, run.name),
            quirks=known(dialect, "settling"),
        )


def set_going(probe: Probe, name: str, rpm: int = _RPM) -> Exchange:
    """Begin a run, or a move that is too long to end by itself, and let the shaft come to its speed."""
    command = probe.command(name)
    moves.prepare(probe, command)
    if command.verb is Verb.RUN_SPEED:
        exchange = motion.run_at(probe, rpm, QUICK)
    else:
        # Five turns: at 120 rpm 2.5 s, of which a late reply may take 0.7 and the ramp down 1.2.
        exchange = moves.begin(probe, command, 5.0, speed=rpm, acceleration=QUICK)
    probe.wait(_GO_ON_NS)
    return exchange


def _turning(probe: Probe, least: float) -> Sample:
    seen = motion.speed(probe)
    if abs(seen.value) < least:
        raise Inconclusive(f"the shaft does not turn before the stop ({seen.value:g} rpm)")
    return seen


def _ask_stop(probe: Probe, stop: Command, acceleration: int, until: Until = Until.REPLY, quiet_ns: int = 0) -> Exchange:
    timeout_ns = 2 * _RAMP_NS + 2 * SECOND_NS if until is Until.DONE else None
    return probe.ask(stop, {"acceleration": acceleration}, until=until, timeout_ns=timeout_ns, quiet_ns=quiet_ns)


def _by_ramp(run: str, probe: Probe, stop: Command) -> None:
    set_going(probe, run)
    _turning(probe, _RPM / 2)
    exchange = _ask_stop(probe, stop, _SLOW_RAMP)
    halfway = max(0, exchange.sent_ns + _RAMP_NS // 2 - probe.gate.now_ns())
    probe.wait(halfway)
    seen = motion.speed(probe)
    late = (seen.t_ns - exchange.sent_ns) / _RAMP_NS
    law = max(0.0, _RPM * (1 - late))
    if abs(abs(seen.value) - law) > _RPM / 4:
        raise refute(
            exchange,
            f"{stop.name} does not slow the shaft down by its ramp",
            expected=f"about {law:.0f} rpm {late * 1200:.0f} ms after the request",
            got=f"{abs(seen.value):g} rpm",
            key=f"{stop.name} ramp",
        )
    probe.wait(exchange.sent_ns + _RAMP_NS + 200 * MS - probe.gate.now_ns())
    _expect_standing(probe, exchange, f"the shaft still turns after the ramp of {stop.name}")


def _expect_standing(probe: Probe, exchange: Exchange, text: str) -> None:
    seen = motion.speed(probe)
    before = motion.position(probe)
    probe.wait(300 * MS)
    after = motion.position(probe)
    if abs(seen.value) >= 1 or abs(after.value - before.value) > SAME:
        got = f"{seen.value:g} rpm, and {after.value - before.value:+.2f} degrees in 300 ms"
        motion.stop(probe, 0)
        raise refute(exchange, text, expected="a shaft that stands", got=got)


def _at_once(run: str, probe: Probe, stop: Command) -> None:
    set_going(probe, run, _CALM)
    _turning(probe, _CALM / 2)
    exchange = _ask_stop(probe, stop, 0)
    at_once = motion.position(probe)
    probe.wait(500 * MS)
    _expect_soon(probe, exchange, at_once, f"{stop.name} with acceleration 0 does not stop the shaft at once")


def _expect_soon(probe: Probe, exchange: Exchange, at_once: Sample, text: str) -> None:
    """Refute where the shaft went on after it was to stand."""
    later = motion.position(probe)
    probe.wait(300 * MS)
    end = motion.position(probe)
    went = max(abs(later.value - at_once.value), abs(end.value - at_once.value))
    if went > SAME:
        motion.stop(probe)
        got = f"{went:.2f} degrees in {(end.t_ns - at_once.t_ns) / 1e6:.0f} ms"
        raise refute(exchange, text, expected="no motion after the reply", got=got)


def _stays_stopped(run: str, probe: Probe, stop: Command) -> None:
    set_going(probe, run)
    exchange = _ask_stop(probe, stop, QUICK)
    stopped = motion.wait_standing(probe)
    probe.wait(3 * SECOND_NS)
    expect_stays(stopped, motion.wait_standing(probe), exchange, f"the shaft moves again after {stop.name}")


def _replies(run: str, probe: Probe, stop: Command) -> None:
    set_going(probe, run)
    before = len(probe.traffic)
    exchange = _ask_stop(probe, stop, _SLOW_RAMP, Until.DONE)
    motion.wait_standing(probe)
    probe.wait(3 * SECOND_NS)
    answers = moves.told(probe.traffic[before:], stop)
    statuses = [a.values[stop.replies.status] for a in answers]
    if statuses not in ([1, 2], [1, 3]):
        got = ", ".join(map(str, statuses)) or "none"
        text = f"{stop.name}: other replies than 1 and then 2"
        raise refute(exchange, text, expected="1, 2", got=got, key=f"{stop.name} {got}")


def _told_when_standing(run: str, probe: Probe, stop: Command) -> None:
    set_going(probe, run)
    exchange = _ask_stop(probe, stop, _SLOW_RAMP, Until.DONE)
    probe.reply(exchange)
    if exchange.status(stop.replies.status)[-1:] not in ([2], [3]):
        raise Inconclusive(f"{stop.name} did not say that it was complete")
    at_once = motion.position(probe)
    off = abs(motion.wait_standing(probe).value - at_once.value)
    if SAME < off <= _SETTLING and "settling" in probe.claim.quirks:
        probe.meets("settling")
    elif off > SAME:
        text = f"{stop.name} is told as complete before the shaft stands"
        raise refute(exchange, text, expected="a shaft that stands", got=f"{off:.2f} degrees more")


# --- emergency --------------------------------------------------------------------------------------------------------


def _emergency(dialect: Dialect) -> Iterator[Claim]:
    stop = dialect.by_verb[Verb.EMERGENCY_STOP]
    for verb in (Verb.RUN_SPEED, Verb.MOVE_ABSOLUTE_AXIS):
        run = dialect.by_verb[verb]
        yield motion_claim(
            dialect,
            stop,
            f"ends-{run.name}",
            f"The emergency stop ends {run.name} at once, and the shaft stays where it is.",
            "a shaft that goes on, or moves again",
            partial(_emergency_ends, run.name),
            risks=run.all_risks,
        )
    yield motion_claim(
        dialect,
        stop,
        "keeps-torque",
        "The emergency stop does not switch the motor off: the next motion command moves it.",
        "a motor that is disabled, or a motion that is refused",
        _emergency_keeps_torque,
        risks=dialect.by_verb[Verb.RUN_SPEED].all_risks,
        at_best=Certainty.LIKELY,
    )
    if moves.tells(dialect):
        yield motion_claim(
            dialect,
            stop,
            "replies",
            "The emergency stop is answered by status 1, and a move that it ends is not told as complete.",
            "another status, or a completion",
            _emergency_replies,
            at_best=Certainty.LIKELY,
        )


def _emergency_ends(run: str, probe: Probe, stop: Command) -> None:
    set_going(probe, run, _CALM)
    _turning(probe, _CALM / 2)
    exchange = probe.ask(stop, quiet_ns=0)
    at_once = motion.position(probe)
    if probe.refused(exchange):
        motion.stop(probe)
        raise refute(exchange, "the emergency stop is refused", expected="status 1", got="a refusal")
    probe.wait(5 * SECOND_NS)
    _expect_soon(probe, exchange, at_once, "the emergency stop does not stop the shaft at once")


def _emergency_keeps_torque(probe: Probe, stop: Command) -> None:
    set_going(probe, probe.command(Verb.RUN_SPEED).name, _CALM)
    exchange = probe.do(stop)
    probe.wait(500 * MS)
    if Verb.READ_ENABLED in probe.dialect.by_verb and not probe.read(Verb.READ_ENABLED, "enabled"):
        raise refute(exchange, "the emergency stop disables the motor", expected="enabled", got="disabled")
    before = motion.position(probe)
    motion.run_at(probe, _CALM, QUICK)
    probe.wait(500 * MS)
    after = motion.stand_still(probe)
    if abs(after.value - before.value) < 10:
        text = "the next run after an emergency stop does not move the shaft"
        raise refute(probe.traffic[-1], text, expected="motion", got=f"{after.value - before.value:+.2f} degrees")


def _emergency_replies(probe: Probe, stop: Command) -> None:
    move = probe.command(Verb.MOVE_ABSOLUTE_AXIS)
    set_going(probe, move.name, _CALM)
    exchange = probe.ask(stop)
    answer = probe.reply(exchange)
    if answer.values.get("status") != 1:
        raise refute(exchange, "the emergency stop is not answered by 1", expected="1", got=str(answer.values.get("status")))
    probe.wait(5 * SECOND_NS)
    told = [a.values["status"] for a in moves.told(probe.traffic, move)]
    if told != [1]:
        text = "a move that the emergency stop ended is told as complete"
        raise refute(exchange, text, expected="1 alone", got=", ".join(map(str, told)))


# --- enabling ---------------------------------------------------------------------------------------------------------


def _enabling(dialect: Dialect) -> Iterator[Claim]:
    enable = dialect.by_verb[Verb.ENABLE]
    made = partial(motion_claim, dialect, enable)
    yield made(
        "is-read",
        "A motor that was enabled reads as enabled, and one that was disabled as disabled.",
        "the other state, or always the same",
        _enabled_is_read,
    )
    yield made(
        "off-ends-motion",
        "Disabling the motor ends a motion, and enabling it does not take the motion up again.",
        "a shaft that is still driven",
        _off_ends_motion,
        risks=dialect.by_verb[Verb.RUN_SPEED].all_risks,
        at_best=Certainty.LIKELY,
    )


def _enabled_is_read(probe: Probe, enable: Command) -> None:
    motion.ready_to_move(probe)
    for wanted in (0, 1, 0, 1):
        exchange = probe.do(enable, {"enabled": wanted})
        seen = probe.read(Verb.READ_ENABLED, "enabled")
        if seen != wanted:
            names = ("disabled", "enabled")
            text = f"a motor that was {names[wanted]} reads as {names[seen] if seen < 2 else seen}"
            raise refute(exchange, text, expected=str(wanted), got=str(seen))


def _off_ends_motion(probe: Probe, enable: Command) -> None:
    set_going(probe, probe.command(Verb.RUN_SPEED).name, _CALM)
    _turning(probe, _CALM / 2)
    exchange = probe.do(enable, {"enabled": 0})
    probe.wait(3 * SECOND_NS)
    _expect_standing(probe, exchange, "the shaft still turns after the motor was disabled")
    probe.do(enable, {"enabled": 1})
    probe.wait(SECOND_NS)
    _expect_standing(probe, exchange, "enabling the motor takes the motion up again")
