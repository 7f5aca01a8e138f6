"""Respond and active (8C): which replies to motion a drive gives.

    respond 0    no reply to F6, FD, FE, F4, F5 and their stops; everything else is answered as before
    active 0     the first reply to a motion comes, the one that tells its end does not

Rules kept here:
- A motion that is not answered is carried out all the same: the shaft is looked at.
- What is silent is listened to for as long as the motion takes, and a while longer.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Verb
from conformance.claim import Claim, Inconclusive
from conformance.claims.motion_claim import motion_claim, refute
from conformance.motion import motion
from conformance.motion import moves as journey
from conformance.motion.motion import MS, QUICK, SECOND_NS
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe, Until

#: What is read and set to see that a drive is not silent altogether.
_ANSWERED = (Verb.READ_POSITION, Verb.READ_STATUS, Verb.READ_ENABLED, Verb.READ_SPEED)
_AMOUNT_TURNS = 0.2
#: 60 rpm, and 0.6 s from it to a stop.
_RPM, _RAMP = 60, 56


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about respond and active, where a dialect has them."""
    setting = dialect.by_verb.get(Verb.SET_RESPOND)
    if setting is None:
        return
    run = dialect.by_verb[Verb.RUN_SPEED]
    made = partial(motion_claim, dialect, setting, settings=("respond", "active"), at_best=Certainty.LIKELY)
    for command in (run, *journey.moves(dialect)):
        yield made(
            f"0-silences-{command.name}",
            f"With respond 0 {command.name} is carried out and not answered, neither at its begin nor at its end.",
            "an answer, or no motion",
            partial(_silent_motion, command.name),
            risks=command.all_risks,
        )
        stop = dialect.by_verb[journey.STOP_OF[command.verb]]
        yield made(
            f"0-silences-{stop.name}",
            f"With respond 0 {stop.name} is carried out and not answered.",
            "an answer, or a shaft that goes on",
            partial(_silent_stop, command.name, stop.name),
            risks=command.all_risks,
        )
        if command.verb is not Verb.RUN_SPEED:
            yield made(
                f"inactive-{command.name}",
                f"With active 0 {command.name} is answered when it begins and not when it is done.",
                "no first reply, or a completion",
                partial(_inactive_move, command.name),
            )
        yield made(
            f"inactive-{stop.name}",
            f"With active 0 {stop.name} is answered when it begins and not when the shaft stands.",
            "no first reply, or a completion",
            partial(_inactive_stop, command.name, stop.name),
            risks=command.all_risks,
        )
    yield made(
        "0-leaves-reads", "With respond 0 reads, settings and enabling are answered as before.", "silence", _reads_answered
    )
    yield made(
        "1-answers-again", "With respond and active 1 again a move is answered 1 and then 2.", "other replies", _answers_again
    )


def _set(probe: Probe, respond: int, active: int) -> None:
    probe.do(Verb.SET_RESPOND, {"respond": respond, "active": active})


def _motion(probe: Probe, name: str, until: Until) -> tuple[Command, Exchange, float]:
    """Ask for a motion and let it happen; return what came back meanwhile and how far the shaft went (degrees)."""
    command = probe.command(name)
    before = motion.position(probe)
    if command.verb is Verb.RUN_SPEED:
        values = motion.run_values(command, _RPM, QUICK)
        exchange = probe.ask(command, values, until=until, timeout_ns=SECOND_NS)
    else:
        exchange = journey.ask(probe, command, _AMOUNT_TURNS, until=until)
    probe.wait(2 * SECOND_NS)
    return command, exchange, motion.position(probe).value - before.value


def _statuses(probe: Probe, since: int, command: Command) -> list[int]:
    return [a.values[command.replies.status] for a in journey.told(probe.traffic[since:], command)]


def _silent_motion(name: str, probe: Probe, setting: Command) -> None:
    journey.prepare(probe, probe.command(name))
    _set(probe, 0, 1)
    since = len(probe.traffic)
    command, exchange, went = _motion(probe, name, Until.TIMEOUT)
    statuses = _statuses(probe, since, command)
    _set(probe, 1, 1)
    motion.stand_still(probe)
    if statuses:
        text = f"{name} is answered with respond 0"
        raise refute(exchange, text, expected="silence", got=", ".join(map(str, statuses)))
    if abs(went) < _AMOUNT_TURNS * 360 / 2:
        text = f"{name} is not carried out with respond 0"
        raise refute(exchange, text, expected="motion", got=f"{went:+.2f} degrees")


def _stop(probe: Probe, name: str) -> tuple[Exchange, list[int]]:
    """Stop by a slow ramp; return what was asked and all statuses that came until the shaft stood."""
    stop = probe.command(name)
    since = len(probe.traffic)
    exchange = probe.ask(stop, {"acceleration": _RAMP}, until=Until.TIMEOUT, timeout_ns=2 * SECOND_NS)
    motion.wait_standing(probe)
    return exchange, _statuses(probe, since, stop)


def _set_going(probe: Probe, name: str) -> None:
    command = probe.command(name)
    journey.prepare(probe, command)
    if command.verb is Verb.RUN_SPEED:
        motion.run_at(probe, _RPM, QUICK)
    else:
        journey.begin(probe, command, 8.0, speed=_RPM, acceleration=QUICK)
    probe.wait(300 * MS)


def _silent_stop(name: str, stop_name: str, probe: Probe, setting: Command) -> None:
    _set_going(probe, name)
    _set(probe, 0, 1)
    if abs(motion.speed(probe).value) < _RPM / 2:
        raise Inconclusive("the shaft does not turn before the stop")
    exchange, statuses = _stop(probe, stop_name)
    if statuses:
        text = f"{stop_name} is answered with respond 0"
        raise refute(exchange, text, expected="silence", got=", ".join(map(str, statuses)))


def _inactive_move(name: str, probe: Probe, setting: Command) -> None:
    journey.prepare(probe, probe.command(name))
    _set(probe, 1, 0)
    since = len(probe.traffic)
    command, exchange, _ = _motion(probe, name, Until.REPLY)
    motion.wait_standing(probe)
    statuses = _statuses(probe, since, command)
    if statuses != [1]:
        text = f"{name} with active 0 is not answered at its begin alone"
        raise refute(exchange, text, expected="1", got=", ".join(map(str, statuses)) or "silence")


def _inactive_stop(name: str, stop_name: str, probe: Probe, setting: Command) -> None:
    _set_going(probe, name)
    _set(probe, 1, 0)
    exchange, statuses = _stop(probe, stop_name)
    if statuses != [1]:
        text = f"{stop_name} with active 0 is not answered at its begin alone"
        raise refute(exchange, text, expected="1", got=", ".join(map(str, statuses)) or "silence")


def _reads_answered(probe: Probe, setting: Command) -> None:
    motion.ready_to_move(probe)
    for exchange in [probe.ask(verb) for verb in _ANSWERED]:
        if exchange.silent:
            raise Inconclusive("a read is not answered with respond 1 either")
    _set(probe, 0, 0)
    asked = [probe.ask(verb) for verb in _ANSWERED]
    asked.append(probe.ask(Verb.ENABLE, {"enabled": 1}))
    asked.append(probe.ask(Verb.SET_RESPOND, {"respond": 1, "active": 1}))
    for exchange in asked:
        if exchange.silent:
            name = exchange.command.name if exchange.command is not None else "a request"
            raise refute(exchange, f"{name} is not answered with respond 0", expected="a reply", got="silence")


def _answers_again(probe: Probe, setting: Command) -> None:
    motion.ready_to_move(probe)
    for respond, active in ((0, 0), (1, 1)):
        _set(probe, respond, active)
    since = len(probe.traffic)
    command, exchange, _ = _motion(probe, probe.command(Verb.MOVE_RELATIVE_AXIS).name, Until.DONE)
    statuses = _statuses(probe, since, command)
    if statuses != [1, 2]:
        text = "a move is not answered 1 and 2 after respond and active were set to 1 again"
        raise refute(exchange, text, expected="1, 2", got=", ".join(map(str, statuses)) or "silence")
