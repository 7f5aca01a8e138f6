"""A run by the rules of a real drive, in virtual time: what a run over a line would do, and how long it would take."""

from __future__ import annotations

from analyzer.catalogue import Risk
from conformance.claim import Outcome, Verdict
from conformance.drives import make
from conformance.gate.permissions import Allowance
from conformance.suite import plan as suite
from conformance.suite import target
from conformance.suite.plan import Plan
from conformance.suite.rig_stand_in import StandInRig

_MOVES = frozenset({Risk.READ, Risk.SETTING, Risk.TORQUE, Risk.MOTION, Risk.UNBOUNDED})


def _run(claim: str, drive: str = "") -> tuple[StandInRig, list[Verdict]]:
    on_a_port = target.parse("mks-can@1", "can:virtual:none,bitrate=500000")
    plan = Plan((on_a_port,), Allowance(_MOVES, alone=True), (f"mks-can/{claim}",))
    rig = StandInRig(plan, on_a_port, make.parse(f"mks-can@1{drive}"))
    found = list(suite.verdicts(plan, on_a_port, plan.selected(on_a_port), rig))
    rig.close()
    return rig, found


def test_time_passes_as_on_a_line_and_settings_are_put_back() -> None:
    rig, [verdict] = _run("motion/run_speed/speed-60", ",work_mode=pulse_direction_closed")
    # It wants a mode in which the bus moves the motor, and that is another one than the drive has.
    assert verdict.outcome is Outcome.CONFIRMED
    assert rig.gate.now_ns() > verdict.last_ns + 500_000_000
    assert not rig.keeper.changed


def test_a_refutation_is_repeated_as_on_a_line() -> None:
    _, found = _run("shape/read_speed/checksum", ",fault=checksum-wrong")
    assert [v.outcome for v in found] == [Outcome.REFUTED]
    assert "2 of 2 times" in found[0].reason
