"""Respond and active (8C): which replies to motion a drive gives.

    respond 0    no reply to F6, FD, FE, F4, F5 and their stops; everything else is answered as before
    active 0     the first reply to a motion comes, the one that tells its end does not

Rules kept here:
- A motion that is not answered is carried out all the same: the shaft is looked at.
- What is silent is listened to for as long as the motion takes, and a while longer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Verb
from conformance.claim import Inconclusive
from conformance.claims import bench
from conformance.claims.declare import Case, Cases, commands, needing
from conformance.claims.motion_claim import of_motion, risks_by, risks_of
from conformance.motion import motion
from conformance.motion.motion import MS, QUICK, SECOND_NS
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe, Until
from conformance.talk.restarts import restart

#: What is read and set to see that a drive is not silent altogether.
_ANSWERED = (Verb.READ_POSITION, Verb.READ_STATUS, Verb.READ_ENABLED, Verb.READ_SPEED)
_TURNS = 0.2
#: 60 rpm, and 0.15 s from it to a stop.
_RPM, _RAMP, _RAMP_NS = 60, 206, 150 * MS
#: How long is listened to what must not come: such a move takes 0.2 s, and a reply to it was seen to be 0.7 s late.
_LISTEN_NS = 750 * MS
_settings = commands(Verb.SET_RESPOND)


def _motions(*kinds: MotionKind) -> Cases:
    def cases(dialect: Dialect) -> Iterator[Case]:
        for case in _settings(dialect):
            for number, run in enumerate(dialect.motions(*kinds)):
                # `active` must not matter: each of its values is tried with some runs.
                yield Case(dialect, case.command, {"run": run, "stop": dialect.stops_of(run)[0], "active": number % 2})

    return cases


_moves = _motions(MotionKind.MOVE_BY, MotionKind.MOVE_TO)
_runs_and_moves = _motions(MotionKind.RUN, MotionKind.MOVE_BY, MotionKind.MOVE_TO)


def _of_respond(refuted_by: str, *, each: Cases, **facts: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    settings = ("respond", "active")
    return of_motion(each=each, refuted_by=refuted_by, settings=settings, at_best=Certainty.LIKELY, **facts)


# --- asking with other settings ---------------------------------------------------------------------------------------


def _set(probe: Probe, respond: int, active: int) -> None:
    probe.do(Verb.SET_RESPOND, {"respond": respond, "active": active})


def _is_run(command: Command) -> bool:
    return command.motion is not None and command.motion.kind is MotionKind.RUN


def _move(probe: Probe, command: Command, until: Until) -> tuple[Exchange, list[int], float]:
    """Ask for a motion and let it happen; return the exchange, the statuses of all replies, and how far the shaft went."""
    since, before = len(probe.traffic), motion.position(probe)
    if _is_run(command):
        exchange = motion.ask(probe, command, rpm=_RPM, acceleration=QUICK, until=until, timeout_ns=_LISTEN_NS)
    else:
        exchange = motion.ask(probe, command, _TURNS * 360, rpm=120, until=until)
    # A run was listened to for as long.
    probe.wait(0 if _is_run(command) else _LISTEN_NS)
    return exchange, _statuses(probe, since, command), motion.position(probe).value - before.value


def _statuses(probe: Probe, since: int, command: Command) -> list[int]:
    return motion.statuses(probe.traffic[since:], command)


def _set_going(probe: Probe, command: Command) -> None:
    motion.prepare(probe, command)
    motion.begin(probe, command, 8 * 360, rpm=_RPM, acceleration=QUICK)
    probe.wait(100 * MS)


def _stop(probe: Probe, stop: Command) -> tuple[Exchange, list[int]]:
    """Stop by a slow ramp; return what was asked and all statuses that came until the shaft stood."""
    since = len(probe.traffic)
    exchange = probe.ask(stop, {"acceleration": _RAMP}, until=Until.TIMEOUT, timeout_ns=_RAMP_NS + _LISTEN_NS)
    motion.wait_standing(probe)
    return exchange, _statuses(probe, since, stop)


# --- respond 0 --------------------------------------------------------------------------------------------------------


@_of_respond("an answer, or no motion", each=_runs_and_moves, name="{command}/0-silences-{run}", risks=risks_of("run"))
def _silent_motion(probe: Probe, run: Command, active: int) -> None:
    """With respond 0 {run} is carried out and not answered, neither at its begin nor at its end."""
    motion.prepare(probe, run)
    _set(probe, 0, active)
    exchange, statuses, degrees = _move(probe, run, Until.TIMEOUT)
    _set(probe, 1, 1)
    motion.stand_still(probe)
    text = f"{run.name} is answered with respond 0"
    probe.expect(statuses, equal=[], expected="silence", refutes=text, exchange=exchange)
    text = f"{run.name} is not carried out with respond 0"
    probe.expect(abs(degrees), at_least=_TURNS * 360 / 2, unit="degrees", refutes=text, exchange=exchange)


@_of_respond(
    "an answer, or a shaft that goes on", each=_runs_and_moves, name="{command}/0-silences-{stop}", risks=risks_of("run")
)
def _silent_stop(probe: Probe, run: Command, stop: Command, active: int) -> None:
    """With respond 0 {stop} is carried out and not answered."""
    _set_going(probe, run)
    _set(probe, 0, 1 - active)
    if abs(motion.speed(probe).value) < _RPM / 2:
        raise Inconclusive("the shaft does not turn before the stop")
    since = len(probe.traffic)
    exchange = probe.ask(stop, {"acceleration": _RAMP}, until=Until.TIMEOUT, timeout_ns=_RAMP_NS + _LISTEN_NS)
    left, statuses = abs(motion.speed(probe).value), _statuses(probe, since, stop)
    if left > _RPM / 2:
        _set(probe, 1, 1)
        motion.stop(probe, QUICK)
    text = f"{stop.name} is not carried out with respond 0"
    probe.expect(left, at_most=_RPM / 2, unit="rpm", refutes=text, exchange=exchange)
    motion.wait_standing(probe)
    _set(probe, 1, 1)
    text = f"{stop.name} is answered with respond 0"
    probe.expect(statuses, equal=[], expected="silence", refutes=text, exchange=exchange)


@_of_respond("silence", each=_settings, name="{command}/0-leaves-reads")
def _others_answered(probe: Probe) -> None:
    """With respond 0 reads, settings and enabling are answered as before."""
    motion.ready_to_move(probe, subdivision=motion.SUBDIVISION)
    if any(probe.ask(verb).silent for verb in _ANSWERED):
        raise Inconclusive("a read is not answered with respond 1 either")
    _set(probe, 0, 0)
    asked = [probe.ask(verb) for verb in _ANSWERED]
    asked.append(probe.ask(Verb.SET_SUBDIVISION, {"subdivision": motion.SUBDIVISION}))
    asked.append(probe.ask(Verb.ENABLE, {"enabled": 1}))
    asked.append(probe.ask(Verb.SET_RESPOND, {"respond": 1, "active": 1}))
    for exchange in asked:
        assert exchange.command is not None
        text = f"{exchange.command.name} is not answered with respond 0"
        probe.expect("silence", holds=not exchange.silent, expected="a reply", refutes=text, exchange=exchange)


@_of_respond("another status", each=_settings, name="{command}/0-status-follows", risks=risks_by(Verb.RUN_SPEED))
def _status_follows(probe: Probe) -> None:
    """With respond 0 the status still tells whether the motor turns or stands."""
    motion.ready_to_move(probe, subdivision=motion.SUBDIVISION)
    run = probe.command(Verb.RUN_SPEED)
    _set(probe, 0, 0)
    seen = []
    for rpm in (_RPM, 0):
        motion.ask(probe, run, rpm=rpm, acceleration=QUICK, until=Until.TIMEOUT, timeout_ns=_LISTEN_NS)
        # The status was seen to stay behind a shaft that stands.
        motion.wait_until(probe, lambda: probe.read(Verb.READ_STATUS, "status") == 1, limit_ns=0 if rpm else 2 * SECOND_NS)
        seen.append(probe.read(Verb.READ_STATUS, "status"))
    _set(probe, 1, 1)
    motion.stand_still(probe)
    text = "the status of a motor that does not answer is not what it does: first at full speed, then stopped"
    probe.expect(seen, equal=[4, 1], refutes=text)


@_of_respond(
    "an answer",
    each=needing(Verb.RESTART, _settings),
    name="{command}/0-after-restart",
    risks=risks_by(Verb.RUN_SPEED, Verb.RESTART),
)
def _silent_after_restart(probe: Probe) -> None:
    """A restart keeps respond 0: a run is carried out and not answered."""
    motion.ready_to_move(probe)
    _set(probe, 0, 1)
    restart(probe)
    motion.ready_to_move(probe)
    since, run = len(probe.traffic), probe.command(Verb.RUN_SPEED)
    exchange = motion.ask(probe, run, rpm=_RPM, acceleration=QUICK, until=Until.TIMEOUT, timeout_ns=SECOND_NS)
    statuses = _statuses(probe, since, run)
    _set(probe, 1, 1)
    motion.stand_still(probe)
    text = "a run is answered after a restart, and respond was 0"
    probe.expect(statuses, equal=[], expected="silence", refutes=text, exchange=exchange)


# --- active 0, and both again -----------------------------------------------------------------------------------------


@_of_respond("no first reply, or a completion", each=_moves, name="{command}/inactive-{run}")
def _inactive_move(probe: Probe, run: Command) -> None:
    """With active 0 {run} is answered when it begins and not when it is done."""
    motion.prepare(probe, run)
    _set(probe, 1, 0)
    exchange, statuses, _ = _move(probe, run, Until.REPLY)
    motion.wait_standing(probe)
    text = f"{run.name} with active 0 is not answered at its begin alone"
    probe.expect(statuses, equal=[1], refutes=text, exchange=exchange)


@_of_respond("no first reply, or a completion", each=_runs_and_moves, name="{command}/inactive-{stop}", risks=risks_of("run"))
def _inactive_stop(probe: Probe, run: Command, stop: Command) -> None:
    """With active 0 {stop} is answered when it begins and not when the shaft stands."""
    _set_going(probe, run)
    _set(probe, 1, 0)
    exchange, statuses = _stop(probe, stop)
    text = f"{stop.name} with active 0 is not answered at its begin alone"
    probe.expect(statuses, equal=[1], refutes=text, exchange=exchange)


@_of_respond(
    "a completion", each=needing(Verb.HOME, _settings), name="{command}/inactive-home", emulated=True, risks=risks_by(Verb.HOME)
)
def _inactive_home(probe: Probe) -> None:
    """With active 0 homing is answered when it begins and not when it is done."""
    motion.ready_to_move(probe, subdivision=motion.SUBDIVISION)
    home = probe.command(Verb.HOME)
    _set(probe, 1, 0)
    bench.left_switch(probe, -2000)
    since = len(probe.traffic)
    exchange = probe.ask(home, until=Until.TIMEOUT, timeout_ns=3 * SECOND_NS)
    motion.wait_standing(probe)
    text = "homing with active 0 is not answered at its begin alone"
    probe.expect(_statuses(probe, since, home), equal=[1], refutes=text, exchange=exchange)


@_of_respond("other replies", each=_settings, name="{command}/1-answers-again")
def _answered_again(probe: Probe) -> None:
    """With respond and active 1 again a move is answered 1 and then 2."""
    motion.ready_to_move(probe)
    for respond, active in ((0, 0), (1, 1)):
        _set(probe, respond, active)
    exchange, statuses, _ = _move(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), Until.DONE)
    text = "a move is not answered 1 and 2 after respond and active were set to 1 again"
    probe.expect(statuses, equal=[1, 2], refutes=text, exchange=exchange)
