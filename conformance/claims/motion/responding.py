"""Respond and active (8C): which replies to motion a drive gives.

    respond 0    no reply to F6, FD, FE, F4, F5 and their stops; everything else is answered as before
    active 0     the first reply to a motion comes, the one that tells its end does not

Rules kept here:
- A motion that is not answered is carried out all the same: the shaft is looked at.
- What is silent is listened to for as long as the motion takes, and a while longer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Verb
from conformance.claim import Inconclusive
from conformance.claims.control_reads import plain_reads
from conformance.claims.declare import Case, Cases, commands, needing
from conformance.claims.motion import homing
from conformance.claims.motion.motion_claim import of_motion, risks_by, risks_of
from conformance.motion import arriving, motion, ramp
from conformance.motion.attempts import undamaged
from conformance.motion.declared import QUICK, RUNS_AND_MOVES, SUBDIVISION
from conformance.talk.exchange import Exchange
from conformance.talk.noise import TOLD_LATE_NS
from conformance.talk.probe import MS, SECOND_NS, Probe, Until
from conformance.talk.restarts import restart

#: The answered commands that are neither motions nor settings.
_LOUD = (Verb.RELEASE_PROTECTION, Verb.EMERGENCY_STOP)
_TURNS, _MOVE_RPM = 0.1, 120
#: 60 rpm, and 0.15 s from it to a stop.
_RPM, _RAMP, _RAMP_NS = 60, 206, 150 * MS
#: How long is listened to what must not come: such a move takes 0.1 s, and a reply to it was seen to be 0.7 s late.
_LISTEN_NS = 750 * MS
#: How long the shaft turns until it is asked.
_BEGINS_NS = 100 * MS
_settings = commands(Verb.SET_RESPOND)
#: What these claims set.
_OF_REPLIES = ("respond", "active")
_MOVES = (Verb.MOVE_RELATIVE_PULSES, Verb.MOVE_ABSOLUTE_PULSES, Verb.MOVE_RELATIVE_AXIS, Verb.MOVE_ABSOLUTE_AXIS)


def _motions(*kinds: MotionKind) -> Cases:
    def cases(dialect: Dialect) -> Iterator[Case]:
        for case in _settings(dialect):
            for run in dialect.motions(*kinds):
                yield Case(dialect, case.command, {"run": run, "stop": dialect.stops_of(run)[0]})

    return cases


_moves = _motions(MotionKind.MOVE_BY, MotionKind.MOVE_TO)
_runs_and_moves = _motions(*RUNS_AND_MOVES)


def _of_respond(refuted_by: str, *, each: Cases, **facts: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    facts = {"settings": _OF_REPLIES, **facts}
    return of_motion(each=each, refuted_by=refuted_by, at_best=Certainty.LIKELY, **facts)


# --- asking with other settings ---------------------------------------------------------------------------------------


def _set(probe: Probe, respond: int, active: int) -> None:
    probe.do(Verb.SET_RESPOND, {"respond": respond, "active": active})


def _is_run(command: Command) -> bool:
    return command.motion is not None and command.motion.kind is MotionKind.RUN


@dataclass(frozen=True)
class _Shown:
    """A motion or a stop that was sent. `statuses`: of all replies that came, late ones too.

    `before`, `after`: how far the shaft was (degrees) when a motion came and when it was over; how fast (rpm), for a stop.
    """

    exchange: Exchange
    statuses: tuple[int, ...]
    before: float
    after: float


class _Sent(NamedTuple):
    """A motion or a stop that was sent, by the number of its first exchange in the claim's traffic; else as `_Shown`."""

    command: Command
    exchange: Exchange
    since: int
    before: float
    after: float


def _ask(probe: Probe, command: Command, until: Until) -> Exchange:
    """Ask for a motion that is over, or a run that has its speed, when this ends."""
    law_ns = ramp.move_ns(_TURNS, _MOVE_RPM, QUICK)
    if _is_run(command):
        return motion.ask(probe, command, rpm=_RPM, acceleration=QUICK, until=until, timeout_ns=int(law_ns))
    exchange = motion.ask(probe, command, _TURNS * 360, rpm=_MOVE_RPM, until=until, timeout_ns=int(law_ns))
    # What tells its end comes first: a read would collide with it.
    probe.wait(exchange.sent_ns + int(law_ns) + TOLD_LATE_NS - probe.gate.now_ns())
    return exchange


def _together(dialect: Dialect, *, runs: bool) -> Iterator[Case]:
    """Return the runs, or the moves, which ask for less."""
    return (case for case in _runs_and_moves(dialect) if _is_run(case.given["run"]) is runs)


def _motions_answered(probe: Probe, respond: int, runs: bool) -> dict[str, _Shown]:
    """Send each motion of a kind by these settings and return what came of it, by its name.

    What comes late is told from the replies to the next motion by its command, and is listened to once.
    """
    return _listened(probe, [undamaged(probe, _sent, case, respond) for case in _together(probe.dialect, runs=runs)])


def _sent(probe: Probe, case: Case, respond: int) -> _Sent:
    run = case.given["run"]
    motion.prepare(probe, run)
    since = len(probe.traffic)
    # With respond 0 `active` must not matter; the end of a move, where there is one to tell, is told by 1 alone.
    for active in (0,) if respond or _is_run(run) else (0, 1):
        _set(probe, respond, active)
        before = motion.position(probe).value
        exchange = _ask(probe, run, Until.REPLY if respond else Until.TIMEOUT)
        after = motion.position(probe).value
    if _is_run(run):
        motion.stand_still(probe)
    return _Sent(run, exchange, since, before, after)


def _stops_answered(probe: Probe, respond: int, runs: bool) -> dict[str, _Shown]:
    """Stop each motion of a kind by a slow ramp by these settings and return what came of it, by the name of the stop."""
    return _listened(probe, [undamaged(probe, _stop_sent, case, respond) for case in _together(probe.dialect, runs=runs)])


def _stop_sent(probe: Probe, case: Case, respond: int) -> _Sent:
    run, stop = case.given["run"], case.given["stop"]
    motion.prepare(probe, run)
    motion.ask(probe, run, 8 * 360, rpm=_RPM, acceleration=QUICK)
    probe.wait(100 * MS)
    _set(probe, respond, 1 - respond)
    since, before = len(probe.traffic), abs(motion.speed(probe).value)
    until = Until.REPLY if respond else Until.TIMEOUT
    exchange = probe.ask(stop, {"acceleration": _RAMP}, until=until, timeout_ns=_RAMP_NS + TOLD_LATE_NS)
    probe.wait(exchange.sent_ns + _RAMP_NS + TOLD_LATE_NS - probe.gate.now_ns())
    after = abs(motion.speed(probe).value)
    _set(probe, 1, 1)
    if after > _RPM / 2:
        motion.stop(probe, QUICK)
    motion.wait_standing(probe)
    return _Sent(stop, exchange, since, before, after)


def _listened(probe: Probe, sent: Sequence[_Sent]) -> dict[str, _Shown]:
    probe.wait(_LISTEN_NS)
    found = {
        each.command.name: _Shown(
            each.exchange, tuple(arriving.statuses(probe.traffic[each.since :], each.command)), each.before, each.after
        )
        for each in sent
    }
    _set(probe, 1, 1)
    motion.stand_still(probe)
    return found


# --- respond 0 --------------------------------------------------------------------------------------------------------


@_of_respond("an answer, or no motion", each=_runs_and_moves, name="{command}/0-silences-{run}", risks=risks_of("run"))
def _silent_motion(probe: Probe, run: Command) -> None:
    """With respond 0 {run} is carried out and not answered, neither at its begin nor at its end."""
    shown = probe.recorded(_motions_answered, 0, _is_run(run))[run.name]
    text = f"{run.name} is answered with respond 0"
    probe.expect(list(shown.statuses), equal=[], expected="silence", refutes=text, exchange=shown.exchange)
    text, way = f"{run.name} is not carried out with respond 0", abs(shown.after - shown.before)
    probe.expect(way, at_least=_TURNS * 360 / 2, unit="degrees", refutes=text, exchange=shown.exchange)


@_of_respond(
    "an answer, or a shaft that goes on", each=_runs_and_moves, name="{command}/0-silences-{stop}", risks=risks_of("run")
)
def _silent_stop(probe: Probe, run: Command, stop: Command) -> None:
    """With respond 0 {stop} is carried out and not answered."""
    shown = _stopped(probe, 0, run, stop)
    text = f"{stop.name} is not carried out with respond 0"
    probe.expect(shown.after, at_most=_RPM / 2, unit="rpm", refutes=text, exchange=shown.exchange)
    text = f"{stop.name} is answered with respond 0"
    probe.expect(list(shown.statuses), equal=[], expected="silence", refutes=text, exchange=shown.exchange)


def _stopped(probe: Probe, respond: int, run: Command, stop: Command) -> _Shown:
    """Return what came of a stop. Raises Inconclusive where the shaft did not turn before it."""
    shown: _Shown = probe.recorded(_stops_answered, respond, _is_run(run))[stop.name]
    if shown.before < _RPM / 2:
        raise Inconclusive("the shaft does not turn before the stop")
    return shown


@_of_respond(
    "an answer", each=_settings, name="{command}/0-silences-refusals", risks=risks_by(Verb.RUN_SPEED, Verb.ENABLE, *_MOVES)
)
def _silent_refusals(probe: Probe) -> None:
    """A motion that is refused, since the motor is off, is answered with active 0, and not with respond 0."""
    motion.ready_to_move(probe)
    every = [*probe.dialect.motions(*RUNS_AND_MOVES)]
    begins = {command.name: motion.place(probe, command) for command in every}
    motion.switch(probe, False)
    found: list[list[Exchange]] = []
    for respond, active in ((1, 1), (1, 0), (0, 1)):
        _set(probe, respond, active)
        until = Until.REPLY if respond else Until.TIMEOUT
        timeout_ns = None if respond else probe.noise.silence_ns
        answers = [
            motion.ask(
                probe,
                command,
                _TURNS * 360,
                rpm=_RPM,
                start=begins[command.name],
                until=until,
                timeout_ns=timeout_ns,
                quiet_ns=0,
            )
            for command in every
        ]
        found.append(answers)
    _set(probe, 1, 1)
    motion.switch(probe, True)
    refused = [each for each in zip(*found, strict=True) if each[0].is_read and probe.refused(each[0])]
    if not refused:
        raise Inconclusive("no motion is refused while the motor is off")
    for _, inactive, silent in refused:
        assert silent.command is not None  # it was asked for
        text, aloud = f"{silent.command.name} is not refused aloud with active 0", inactive.is_read and probe.refused(inactive)
        probe.expect(
            "another answer", holds=aloud, expected="a refusal", refutes=text, exchange=inactive, key="not refused aloud"
        )
        text, told = f"{silent.command.name} is refused aloud with respond 0", arriving.statuses((silent,), silent.command)
        probe.expect(told, equal=[], expected="silence", refutes=text, exchange=silent, key="refused aloud")


@_of_respond("silence", each=_settings, name="{command}/0-leaves-reads", risks=risks_by(Verb.RUN_SPEED, *_LOUD))
def _others_answered(probe: Probe) -> None:
    """With respond 0 reads (of a shaft that turns, too), settings, enabling, release and emergency stop are answered."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    loud = [*plain_reads(probe.dialect), *map(probe.command, _LOUD)]
    if any(probe.ask(command).silent for command in loud):
        raise Inconclusive("not all of them are answered with respond 1 either")
    _set(probe, 0, 0)
    run = probe.command(Verb.RUN_SPEED)
    motion.ask(probe, run, rpm=_RPM, acceleration=QUICK, until=Until.TIMEOUT, timeout_ns=_BEGINS_NS)
    asked = [probe.ask(command, quiet_ns=0) for command in plain_reads(probe.dialect)]
    motion.ask(probe, run, rpm=0, acceleration=QUICK, until=Until.TIMEOUT, timeout_ns=_BEGINS_NS)
    asked += [probe.ask(command) for command in loud]
    asked.append(probe.ask(Verb.SET_SUBDIVISION, {"subdivision": SUBDIVISION}))
    asked.append(probe.ask(Verb.ENABLE, {"enabled": 1}))
    asked.append(probe.ask(Verb.SET_RESPOND, {"respond": 1, "active": 1}))
    for exchange in asked:
        assert exchange.command is not None
        text = f"{exchange.command.name} is not answered with respond 0"
        probe.expect("silence", holds=not exchange.silent, expected="a reply", refutes=text, exchange=exchange)


@_of_respond("another status", each=_settings, name="{command}/0-status-follows", risks=risks_by(Verb.RUN_SPEED))
def _status_follows(probe: Probe) -> None:
    """With respond 0 the status still tells whether the motor turns or stands."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    run = probe.command(Verb.RUN_SPEED)
    _set(probe, 0, 0)
    seen = []
    for rpm in (_RPM, 0):
        motion.ask(probe, run, rpm=rpm, acceleration=QUICK, until=Until.TIMEOUT, timeout_ns=150 * MS)
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
    exchange = motion.ask(probe, run, rpm=_RPM, acceleration=QUICK, until=Until.TIMEOUT, timeout_ns=_LISTEN_NS)
    statuses = arriving.statuses(probe.traffic[since:], run)
    _set(probe, 1, 1)
    motion.stand_still(probe)
    text = "a run is answered after a restart, and respond was 0"
    probe.expect(statuses, equal=[], expected="silence", refutes=text, exchange=exchange)


# --- active 0, and both again -----------------------------------------------------------------------------------------


@_of_respond("no first reply, or a completion", each=_moves, name="{command}/inactive-{run}", risks=risks_of("run"))
def _inactive_move(probe: Probe, run: Command) -> None:
    """With active 0 {run} is answered when it begins and not when it is done."""
    shown = probe.recorded(_motions_answered, 1, _is_run(run))[run.name]
    text = f"{run.name} with active 0 is not answered at its begin alone"
    probe.expect(list(shown.statuses), equal=[1], refutes=text, exchange=shown.exchange)


@_of_respond("no first reply, or a completion", each=_runs_and_moves, name="{command}/inactive-{stop}", risks=risks_of("run"))
def _inactive_stop(probe: Probe, run: Command, stop: Command) -> None:
    """With active 0 {stop} is answered when it begins and not when the shaft stands."""
    shown = _stopped(probe, 1, run, stop)
    text = f"{stop.name} with active 0 is not answered at its begin alone"
    probe.expect(list(shown.statuses), equal=[1], refutes=text, exchange=shown.exchange)


@_of_respond(
    "a completion",
    each=needing(Verb.HOME, _settings),
    name="{command}/inactive-home",
    emulated=True,
    risks=risks_by(Verb.HOME, *homing.SETS_HOME),
    settings=lambda case: (*_OF_REPLIES, *homing.fields(case.dialect)),
)
def _inactive_home(probe: Probe) -> None:
    """With active 0 homing is answered when it begins, and not when it is done, by a switch or a wall."""
    for row in homing.places(probe.dialect):
        told, exchange = _home_answered(probe, row, 1, 0)
        text = "homing with active 0 is not answered at its begin alone"
        probe.expect(told, equal=[1], refutes=text, exchange=exchange)


@_of_respond(
    "another answer",
    each=needing(Verb.HOME, _settings),
    name="{command}/0-leaves-home",
    emulated=True,
    risks=risks_by(Verb.HOME, *homing.SETS_HOME),
    settings=lambda case: (*_OF_REPLIES, *homing.fields(case.dialect)),
)
def _loud_home(probe: Probe) -> None:
    """With respond 0, which is about runs and moves, homing is answered when it begins and when it is done."""
    told, exchange = _home_answered(probe, next(iter(homing.places(probe.dialect))), 0, 1)
    probe.expect(told, equal=[1, 2], refutes="homing is not answered with respond 0", exchange=exchange)


def _home_answered(probe: Probe, row: dict[str, Any], respond: int, active: int) -> tuple[list[int], Exchange]:
    """Find home with these settings; return all that homing was answered, and its exchange."""
    home = probe.command(Verb.HOME)
    homing.mounted(probe, **row, home_speed=300)
    _set(probe, respond, active)
    since = len(probe.traffic)
    exchange = probe.ask(home, until=Until.TIMEOUT, timeout_ns=homing.FOUND_NS)
    motion.wait_standing(probe)
    _set(probe, 1, 1)
    return arriving.statuses(probe.traffic[since:], home), exchange


@_of_respond("other replies", each=_settings, name="{command}/1-answers-again")
def _answered_again(probe: Probe) -> None:
    """With respond and active 1 again a move is answered 1 and then 2."""
    motion.ready_to_move(probe)
    for respond, active in ((0, 0), (1, 1)):
        _set(probe, respond, active)
    since, move = len(probe.traffic), probe.command(Verb.MOVE_RELATIVE_AXIS)
    exchange = _ask(probe, move, Until.DONE)
    probe.wait(_LISTEN_NS)
    statuses = arriving.statuses(probe.traffic[since:], move)
    text = "a move is not answered 1 and 2 after respond and active were set to 1 again"
    probe.expect(statuses, equal=[1, 2], refutes=text, exchange=exchange)
