"""A run by the rules of a real drive, in virtual time: what a run over a line would do, and how long it would take."""

from __future__ import annotations

import pytest

from analyzer.catalogue import Risk, Verb
from analyzer.records import CanFrame
from conformance.claim import Outcome, RigFault, Verdict
from conformance.drives import make
from conformance.gate.permissions import Allowance
from conformance.motion import arriving, motion
from conformance.suite import engine, target
from conformance.suite import plan as suite
from conformance.suite.dry_run import StandInRig
from conformance.suite.plan import Plan
from conformance.talk.probe import plain_probe

_PORT = target.parse("mks-can@1", "can:virtual:none,bitrate=500000")
_MOVES = frozenset({Risk.READ, Risk.SETTING, Risk.TORQUE, Risk.MOTION, Risk.UNBOUNDED})


def _rig(drive: str = "") -> StandInRig:
    plan = Plan((_PORT,), Allowance(_MOVES, alone=True))
    return StandInRig(plan, _PORT, make.parse(f"mks-can@1{drive}"))


def _run(claim: str, drive: str = "") -> tuple[StandInRig, list[Verdict]]:
    plan = Plan((_PORT,), claims=(f"mks-can/{claim}",))
    rig = _rig(drive)
    found = list(suite.verdicts(plan, _PORT, plan.selected(_PORT), rig))
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


def _modes_sent(rig: StandInRig, names: list[str]) -> list[int]:
    """Run claims one after the other; return the work modes that were set meanwhile."""
    by_id = {claim.id: claim for claim in suite.every_claim(_PORT)}
    sent: list[int] = []

    def note(t_ns: int, item: object) -> None:
        assert isinstance(item, CanFrame)
        if item.data[0] == 0x82:
            sent.append(item.data[1])

    rig.gate.on_sent.append(note)
    for name in names:
        assert engine.run_claim(by_id[f"mks-can/{name}"], rig).outcome is Outcome.CONFIRMED
    return sent


def test_what_claims_of_a_group_need_is_set_once_and_put_back_once() -> None:
    rig = _rig(",work_mode=pulse_direction_closed")
    runs = ["motion/run_speed/speed-60", "motion/run_speed/opposite", "motion/run_speed/speed-1"]
    assert _modes_sent(rig, runs) == [0x05]
    assert rig.keeper.changed
    # The first claim that does not name the mode finds it as the user had it.
    assert _modes_sent(rig, ["shape/read_speed/checksum"]) == [0x03]
    assert not rig.keeper.changed
    rig.close()


def test_another_value_than_the_groups_is_put_back_behind_its_claim() -> None:
    rig = _rig(",subdivision=64")
    _modes_sent(rig, ["motion/run_speed/speed-60"])
    assert rig.keeper.left_at({"set_subdivision": {"subdivision": 16}})
    _modes_sent(rig, ["motion/set_subdivision/speed-at-8"])
    assert not rig.keeper.left_at({"set_subdivision": {"subdivision": 16}})
    rig.close()


def test_a_group_that_ends_the_run_is_put_back_by_its_end() -> None:
    rig = _rig(",work_mode=pulse_direction_closed")
    _modes_sent(rig, ["motion/run_speed/speed-60"])
    rig.close()
    assert not rig.keeper.changed


def test_a_short_run_on_a_slow_port_ends_in_time() -> None:
    plan = Plan((_PORT,), short=True)
    rig = StandInRig(plan, _PORT, make.parse("mks-can@1,latency=200..300ms"))
    found = list(suite.verdicts(plan, _PORT, plan.selected(_PORT), rig))
    assert 0 < len(found) < len(plan.selected(_PORT))
    assert rig.gate.now_ns() < 95e9
    rig.close()


def test_a_zero_that_a_restart_forgets_is_no_way_back_to_it() -> None:
    port = target.parse("mks-rs485@1", "serial:none,baud=38400")
    held = dict.fromkeys(("zero_mode", "set_zero", "zero_speed", "zero_direction"), "0") | {
        "work_mode": "5",
        "subdivision": "16",
    }
    plan = Plan((port,), Allowance(frozenset(Risk), alone=True), settings={"": held})
    rig = StandInRig(plan, port, make.parse("mks-rs485@1"))
    claim = next(c for c in suite.every_claim(port) if c.id.endswith("read-back/set_zero_mode/clean"))
    probe = rig.probe(claim)
    motion.ready_to_move(probe, subdivision=16)
    arriving.follow(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), 40)
    probe.do(Verb.SET_ZERO)
    rig.settle(probe)
    verdict = engine.run_claim(claim, rig)
    rig.close()
    assert (verdict.outcome, verdict.reason) == (Outcome.CONFIRMED, "")


def test_a_position_that_a_claim_set_far_away_is_none_for_the_next() -> None:
    port = target.parse("lk-rs485@1,model=MF", "serial:none,baud=115200")
    rig = StandInRig(Plan((port,), Allowance(frozenset(Risk), alone=True)), port, make.parse("lk-rs485@1,model=MF"))
    by_id = {claim.id: claim for claim in suite.every_claim(port)}
    for name in ("ranges/set_position/position/lowest", "motion/move_multi_turn/reaches"):
        assert engine.run_claim(by_id[f"lk-rs485/{name}"], rig).outcome is Outcome.CONFIRMED
    assert abs(motion.position(plain_probe(rig.dialect, 1, rig.gate)).value) < 3600
    rig.close()


def test_a_drive_that_refuses_every_setting_is_refuted_soon_and_not_set_going() -> None:
    port = target.parse("mks-rs485@1,model=42D", "serial:none,baud=38400")
    chosen = (
        "mks-rs485/ranges/set_current/*",
        "mks-rs485/examples/set_*",
        "mks-rs485/shape/home/*",
        "mks-rs485/read-back/set_*",
    )
    held = {"work_mode": "2", "subdivision": "16", "current": "1600", "holding_current": "4", "key_lock": "0"}
    plan = Plan((port,), Allowance(frozenset(Risk), alone=True), claims=chosen, settings={"": held})
    rig = StandInRig(plan, port, make.parse("mks-rs485@1,model=42D,fault=settings-refused"))
    before_ns = rig.gate.now_ns()
    found = {verdict.claim.id: verdict.outcome for verdict in suite.verdicts(plan, port, plan.selected(port), rig)}
    assert motion.speed(plain_probe(rig.dialect, 1, rig.gate)).value == 0
    with pytest.raises(RigFault, match="set_current current=1600 mA: refused"):
        rig.close()
    assert found["mks-rs485/ranges/set_current/current/highest"] is Outcome.REFUTED
    # Homing begins in a pulse mode too, and no stop is taken there.
    assert found["mks-rs485/shape/home/address"] is Outcome.INCONCLUSIVE
    assert rig.gate.now_ns() - before_ns < 20e9
