"""The motor status: what F1 says of a shaft that stands, runs or moves.

    1 stopped   2 speeding up   3 slowing down   4 full speed   5 homing   6 calibrating

Rule kept here: each state of the ramp lasts longer than a second, so that a late reply still tells of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Risk, Verb
from conformance.claim import Inconclusive
from conformance.claims.declare import Case, commands
from conformance.claims.known_quirks import may_meet
from conformance.claims.motion import homing
from conformance.claims.motion.motion_claim import of_motion, risks_by
from conformance.motion import declared, motion
from conformance.motion.declared import QUICK, SUBDIVISION
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, SECOND_NS, Probe

#: 90 rpm at 12 ms for each rpm: 1.08 s up and as long down.
_RPM, _RAMP, _RAMP_NS = 90, 16, 1080 * MS
_STOPPED, _UP, _DOWN, _FULL = 1, 2, 3, 4
#: How long F1 was seen to stay behind the shaft.
_STAYS_NS = 2 * SECOND_NS
_of_status = partial(of_motion, each=commands(Verb.READ_STATUS))
_of_a_run = partial(_of_status, refuted_by="another status", risks=risks_by(Verb.RUN_SPEED))


def _status(probe: Probe) -> int:
    return probe.read(Verb.READ_STATUS, "status")


def _expect(probe: Probe, seen: int, wanted: int, what: str) -> None:
    probe.expect(seen, equal=wanted, refutes=f"the motor {what}, and its status is {seen}")


def _expect_soon_stopped(probe: Probe, what: str) -> None:
    motion.wait_until(probe, lambda: _status(probe) == _STOPPED, every_ns=200 * MS, limit_ns=_STAYS_NS)
    _expect(probe, _status(probe), _STOPPED, what)


def _run(probe: Probe, way: int = 1) -> Exchange:
    """Begin a run by a slow ramp and return when it is on it."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    exchange = motion.run_at(probe, way * _RPM, _RAMP)
    _wait_until(probe, exchange, 400 * MS)
    return exchange


def _expect_slowing(probe: Probe) -> None:
    """Refute unless a shaft that still turns after its stop is told as slowing down, on all of its ramp."""
    for after_ns in (0, _RAMP_NS - 250 * MS):
        probe.wait(after_ns)
        before = motion.speed(probe)
        seen = _status(probe)
        turning = motion.speed(probe)
        if abs(turning.value) < 2:
            break
        # What still turns behind the reply turned before it.
        if seen == _STOPPED and "status-stops-early" in probe.claim.quirks:
            probe.meets("status-stops-early")
        else:
            _expect(probe, seen, _DOWN, f"slows down, at {abs(before.value):.0f} rpm")
    motion.wait_standing(probe)


def _wait_until(probe: Probe, exchange: Exchange, after_ns: int) -> None:
    probe.wait(exchange.sent_ns + after_ns - probe.gate.now_ns())


def _slow_runs(dialect: Dialect) -> Iterator[Case]:
    for case in commands(Verb.READ_STATUS)(dialect):
        for rpm in (3,):
            yield Case(dialect, case.command, {"rpm": rpm}, {"name": f"{{command}}/slow-{rpm}"})


@of_motion(each=_slow_runs, refuted_by="another status", risks=risks_by(Verb.RUN_SPEED))
def _slow(probe: Probe, rpm: int) -> None:
    """At {rpm} rpm too the status is 4, and 1 after the stop."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    motion.run_at(probe, rpm, QUICK)
    probe.wait(200 * MS)
    seen = _status(probe)
    motion.stand_still(probe)
    _expect(probe, seen, _FULL, f"turns at {rpm} rpm")
    _expect_soon_stopped(probe, "has stopped")


@_of_a_run(quirks=may_meet("status-stops-early"))
def _slowing_down(probe: Probe) -> None:
    """The status on the ramp down is 3, to the last few rpm."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    motion.run_at(probe, _RPM, QUICK)
    probe.wait(300 * MS)
    motion.stop(probe, _RAMP)
    if abs(motion.speed(probe).value) < 2:
        raise Inconclusive("the shaft stood too soon to see it slow down")
    _expect_slowing(probe)


@_of_status(refuted_by="another status", quirks=may_meet("status-stays-slowing"))
def _after_a_move(probe: Probe) -> None:
    """The status of a motor that has come to its target is 1."""
    move = probe.command(Verb.MOVE_RELATIVE_AXIS)
    motion.prepare(probe, move)
    motion.begin(probe, move, 90, rpm=_RPM, acceleration=QUICK)
    motion.wait_standing(probe)
    seen = _status(probe)
    if seen == _DOWN and "status-stays-slowing" in probe.claim.quirks:
        probe.wait(_STAYS_NS)
        seen = _status(probe)
        probe.meets("status-stays-slowing")
    _expect(probe, seen, _STOPPED, "has come to its target")


@_of_status(
    refuted_by="a status of the time before, or one that never changes",
    risks=risks_by(Verb.RUN_SPEED),
    quirks=may_meet("status-stops-early"),
)
def _follows(probe: Probe) -> None:
    """The status follows a motor that turns the other way: 1 before a run, then 2, 4, 3, and 1 long after the stop."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    _expect(probe, _status(probe), _STOPPED, "stands")
    exchange = _run(probe, -1)
    _expect(probe, _status(probe), _UP, "speeds up")
    _wait_until(probe, exchange, _RAMP_NS + 200 * MS)
    _expect(probe, _status(probe), _FULL, "turns at full speed")
    motion.stop(probe, _RAMP)
    _expect_slowing(probe)
    _expect_soon_stopped(probe, "has stopped")


def _ended_at_once(dialect: Dialect) -> Iterator[Case]:
    """Yield the status of drives that home, can be disabled, and have an emergency stop."""
    verbs = (Verb.EMERGENCY_STOP, Verb.ENABLE, Verb.HOME, Verb.SET_HOME, Verb.RUN_SPEED, Verb.MOVE_RELATIVE_AXIS)
    needed = [command for verb in verbs if (command := dialect.by_verb.get(verb)) is not None]
    if len(needed) == len(verbs):
        known = [c for v in homing.SETS_HOME if (c := dialect.by_verb.get(v)) is not None]
        risks = frozenset[Risk]().union(*(command.all_risks for command in (*needed, *known))) - {Risk.UNKNOWN}
        settings = declared.settings(dialect, *(name for c in known for name in c.request_forms[0].layout.named))
        facts = {"risks": declared.risks(dialect, *risks, Risk.UNBOUNDED, Risk.TORQUE), "settings": settings}
        for case in commands(Verb.READ_STATUS)(dialect):
            yield Case(dialect, case.command, facts=facts)


@of_motion(each=_ended_at_once, name="{command}/behind-emergency", refuted_by="another status", at_best=Certainty.LIKELY)
def _behind_emergency(probe: Probe) -> None:
    """The status is 1 behind an emergency stop in a ramp, at full speed, or homing, and behind disabling in a run or a move."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    homing.set_home(probe, home_speed=_RPM)
    move = probe.command(Verb.MOVE_RELATIVE_AXIS)
    off = declared.switching(probe.dialect, False)
    emergency: tuple[Command, dict[str, int]] = (probe.command(Verb.EMERGENCY_STOP), {})
    for what, begin, for_ns, (ends, values) in (
        ("speeds up in a run", lambda: motion.run_at(probe, _RPM, _RAMP), 150 * MS, emergency),
        ("speeds up in a move", lambda: motion.begin(probe, move, 720, rpm=_RPM, acceleration=_RAMP), 150 * MS, emergency),
        ("turns at full speed", lambda: motion.run_at(probe, -_RPM, QUICK), 80 * MS, emergency),
        ("slows down", lambda: _slow_down(probe), 100 * MS, emergency),
        ("homes", lambda: probe.ask(Verb.HOME, quiet_ns=0), 150 * MS, emergency),
        ("turns at full speed", lambda: motion.run_at(probe, _RPM, QUICK), 80 * MS, off),
        ("turns in a move", lambda: motion.begin(probe, move, 720, rpm=_RPM, acceleration=QUICK), 80 * MS, off),
    ):
        begin()
        probe.wait(for_ns)
        turned = abs(motion.speed(probe).value)
        exchange = probe.ask(ends, values)
        if values:
            # Without torque the shaft runs out.
            motion.wait_standing(probe)
        seen = _status(probe)
        motion.wait_standing(probe)
        if values:
            motion.switch(probe, True)
        if turned < 2:
            raise Inconclusive(f"the shaft does not turn before {ends.name}: it {what}")
        text = f"{ends.name} ends a shaft that {what}, and its status is {seen}"
        probe.expect(seen, equal=_STOPPED, refutes=text, exchange=exchange)


def _slow_down(probe: Probe) -> None:
    motion.run_at(probe, _RPM, QUICK)
    probe.wait(150 * MS)
    motion.stop(probe, _RAMP)
