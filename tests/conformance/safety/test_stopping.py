"""Where a claim saw the shaft stand, one stop and one look are enough; a shaft that turns is stopped all the same."""

from __future__ import annotations

from fractions import Fraction

import pytest

from analyzer.catalogue import MotionKind, Risk
from conformance import claims as registry
from conformance.bus.emulated import EmulatedLine
from conformance.claim import NotStopped
from conformance.drives import make
from conformance.gate.permissions import Allowance
from conformance.motion import motion, resting
from conformance.safety import stopping
from conformance.suite import target
from conformance.suite.plan import Plan
from conformance.suite.rig_emulated import EmulatedRig
from conformance.suite.rig_stand_in import StandInRig
from conformance.talk.probe import Probe

_DRIVE = "mks-rs485@1,work_mode=sr_vfoc"
#: In rpm: below what three looks tell.
_CREEP = Fraction(1, 20)
_PORT = target.parse("mks-rs485@1", "serial:none,baud=38400")


def _turning(drive: str = _DRIVE) -> tuple[EmulatedRig, Probe, float]:
    """Return a drive that runs, and where it stood before."""
    rig = EmulatedRig(make.parse(drive))
    probe = rig.probe(next(c for c in registry.every(rig.dialect) if resting.can_turn(rig.dialect, c)))
    motion.ready_to_move(probe)
    stood = motion.position(probe).value
    motion.run_at(probe, 60)
    probe.wait(motion.SECOND_NS)
    return rig, probe, stood


def test_where_a_shaft_was_seen_standing_one_look_is_the_last_of_three():
    _, probe, _ = _turning()
    place = motion.stand_still(probe).value
    before = len(probe.traffic)
    assert stopping.prove_standing(probe, motion.SECOND_NS, place) == ""
    assert len(probe.traffic) == before + 2, "its speed and its position"


@pytest.mark.parametrize("faults", ["", ",fault=speed-stop-ignored,fault=move-stop-ignored"])
def test_a_shaft_that_turns_although_it_was_seen_standing_is_stopped(faults):
    rig, probe, stood = _turning(_DRIVE + faults)
    assert stopping.stop(probe.gate, rig.dialect, 1, stood).failure == ""
    assert motion.speed(probe).value == 0


@pytest.mark.parametrize(
    ("noise", "rpm", "at_once", "thoroughly"),
    [
        ("", 0, True, True),
        ("", 0.05, None, False),
        ("", 0.15, False, False),
        (",encoder-noise=2", 0, None, True),
        (",encoder-noise=2", 0.05, None, False),
    ],
)
def test_a_shaft_that_creeps_does_not_stand(noise, rpm, at_once, thoroughly):
    _, probe, _ = _turning(_DRIVE + noise)
    motion.stand_still(probe)
    assert probe.drive is not None
    probe.drive.motor.run(probe.gate.now_ns(), Fraction(rpm).limit_denominator(100), 0)
    assert motion.speed(probe).value == 0, "whole rpm do not tell it"
    seen = stopping.prove_standing(probe, 4 * motion.SECOND_NS, thoroughly=True)
    assert (seen == "") is thoroughly
    if at_once is not None:
        assert (stopping.prove_standing(probe, 4 * motion.SECOND_NS) == "") is at_once


def test_a_run_ends_as_not_stopped_where_the_shaft_creeps(monkeypatch):
    rig = StandInRig(Plan((_PORT,), Allowance(frozenset(Risk), alone=True)), _PORT, make.parse(_DRIVE))
    probe = rig.probe(next(c for c in registry.every(rig.dialect) if resting.can_turn(rig.dialect, c)))
    motion.ready_to_move(probe)
    motion.run_at(probe, 60)
    motion.stand_still(probe)
    assert rig.settle(probe) == ""
    line = rig.gate.line
    assert isinstance(line, EmulatedLine)
    motor = line.bus.drives[0].motor
    halted, run = motor.halt, motor.run
    # What a stop leaves is a creep, which no claim moved the shaft by.
    monkeypatch.setattr(motor, "run", lambda t, rpm, step_ns: run(t, rpm or _CREEP, step_ns))
    monkeypatch.setattr(motor, "halt", lambda t: (halted(t), run(t, _CREEP, 0)))
    run(rig.gate.now_ns(), _CREEP, 0)
    with pytest.raises(NotStopped, match="speed 0 rpm"):
        rig.close()


def test_a_proof_counts_until_something_is_sent_that_may_move_the_shaft():
    rig = StandInRig(Plan((_PORT,), Allowance(frozenset(Risk), alone=True)), _PORT, make.parse(_DRIVE))
    stops = {command.name for command in rig.dialect.motions(MotionKind.STOP)}
    sent: list[str] = []
    rig.gate.on_sent.append(lambda t_ns, item: sent.extend(r.command.name for r in rig.gate.interpret(item) if r.command))
    probe = rig.probe(next(c for c in registry.every(rig.dialect) if resting.can_turn(rig.dialect, c)))

    def stops_of_settling() -> int:
        sent.clear()
        assert rig.settle(probe) == ""
        return sum(name in stops for name in sent)

    motion.ready_to_move(probe)
    motion.run_at(probe, 60)
    motion.stand_still(probe)
    assert stops_of_settling() == 1
    motion.run_at(probe, 60)
    motion.stand_still(probe)
    motion.run_at(probe, 60)
    assert stops_of_settling() > 1
    assert motion.speed(probe).value == 0
    rig.close()
