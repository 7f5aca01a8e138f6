"""Calibration: what is answered, what the status says meanwhile, and what a held shaft makes of it.

A calibration turns the shaft without a bound and with torque, so these claims run on a real drive only when they are named.

Rules kept here:
- Here 0 says that it goes on, 1 that it is done and 2 that it failed.
- The manual gives no time; a minute is waited.
"""

from __future__ import annotations

from analyzer.catalogue import Certainty, Command, Verb
from conformance.claim import Inconclusive
from conformance.claims import bench
from conformance.claims.declare import commands
from conformance.claims.known_quirks import may_meet
from conformance.claims.motion.motion_claim import of_motion, that_tell_their_end
from conformance.claims.motion.stops import expect_standing
from conformance.motion import arriving, motion
from conformance.talk.probe import MS, SECOND_NS, Probe, Until

_LIMIT_NS = 60 * SECOND_NS
_CALIBRATING, _STOPPED = 6, 1
#: Degrees after which a shaft turns; how long one that was halted has to settle.
_BEGUN, _HALTS_NS = 5, 100 * MS
_AT_ONCE = "calibration-answers-1"
_calibrations = commands(Verb.CALIBRATE)


def _status_now(probe: Probe) -> int:
    return probe.read(Verb.READ_STATUS, "status")


def _wait(probe: Probe) -> None:
    """Wait until the status is no longer that of a calibration."""
    motion.wait_until(probe, lambda: _status_now(probe) != _CALIBRATING, every_ns=500 * MS, limit_ns=_LIMIT_NS)


@of_motion(each=_calibrations, refuted_by="another status", by_name=True)
def _status(probe: Probe, command: Command) -> None:
    """While calibrating F1 reads 6, and afterwards 1."""
    motion.ready_to_move(probe)
    exchange = probe.ask(command)
    probe.reply(exchange)
    probe.wait(SECOND_NS)
    during = _status_now(probe)
    _wait(probe)
    probe.wait(2 * SECOND_NS)
    text = "the status does not tell of a calibration and of its end"
    probe.expect((during, _status_now(probe)), equal=(_CALIBRATING, _STOPPED), refutes=text, exchange=exchange)


def _statuses(probe: Probe, since: int, command: Command) -> list[int]:
    return arriving.statuses(probe.traffic[since:], command)


def _calibrate(probe: Probe, command: Command) -> tuple[list[int], bool]:
    """Calibrate; return all statuses of the replies, and whether the first came while the calibration had just begun."""
    since = len(probe.traffic)
    exchange = probe.ask(command, until=Until.TIMEOUT, timeout_ns=3 * SECOND_NS)
    under_way = _status_now(probe) == _CALIBRATING
    if exchange.silent and not under_way:
        raise Inconclusive("the calibration is not answered and does not begin")
    until_ns = probe.gate.now_ns() + _LIMIT_NS
    # Nothing is asked while an end may still be told: a request could collide with it.
    while probe.gate.now_ns() < until_ns and not {1, 2} & set(_statuses(probe, since, command)):
        probe.wait(2 * SECOND_NS)
    _wait(probe)
    probe.wait(2 * SECOND_NS)
    return _statuses(probe, since, command), under_way and not exchange.silent


def _expect_replies(probe: Probe, command: Command, wanted: list[int]) -> None:
    motion.ready_to_move(probe)
    statuses, early = _calibrate(probe, command)
    if statuses == [1] and early and _AT_ONCE in probe.claim.quirks:
        probe.meets(_AT_ONCE)
    else:
        probe.expect(statuses, equal=wanted, refutes="a calibration is answered otherwise")


@of_motion(each=that_tell_their_end(_calibrations), refuted_by="others", by_name=True, quirks=may_meet(_AT_ONCE))
def _replies(probe: Probe, command: Command) -> None:
    """A calibration is answered by 0 when it begins and by 1 when it is done."""
    _expect_replies(probe, command, [0, 1])


@of_motion(each=that_tell_their_end(_calibrations), refuted_by="others", by_name=True, emulated=True, quirks=may_meet(_AT_ONCE))
def _held(probe: Probe, command: Command) -> None:
    """A calibration whose shaft is held is answered by 0 and then by 2."""
    bench.hold(probe)
    _expect_replies(probe, command, [0, 2])


@of_motion(
    each=_calibrations, refuted_by="a shaft that goes on", name="{command}/halted", by_name=True, at_best=Certainty.LIKELY
)
def _halted(probe: Probe, command: Command) -> None:
    """An emergency stop ends a calibration: the shaft stands."""
    motion.ready_to_move(probe)
    began = motion.position(probe)
    probe.ask(command)
    # No manual says when it begins to turn.
    motion.wait_until(probe, lambda: abs(motion.position(probe).value - began.value) > _BEGUN, limit_ns=10 * SECOND_NS)
    if abs(motion.position(probe).value - began.value) <= _BEGUN:
        raise Inconclusive("the calibration does not turn the shaft")
    exchange = probe.ask(Verb.EMERGENCY_STOP)
    probe.wait(_HALTS_NS)
    expect_standing(probe, exchange, "an emergency stop does not end a calibration")
