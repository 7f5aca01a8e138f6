"""A refutation on a real port is repeated; a sequence of steps is shortened on an emulated drive that fails alike."""

from __future__ import annotations

import dataclasses

import pytest

from conformance.claim import Claim, Inconclusive, Outcome, Refuted, Theme, Verdict
from conformance.drives import make
from conformance.gate.permissions import Allowance
from conformance.model.steps import Step, parse_steps, steps_text
from conformance.suite import engine, plan
from conformance.suite.rig_emulated import EmulatedRig
from tests.conformance.safety.test_keeper import EVERYTHING, EmulatedPort

#: What a user would say of a drive that tells none of its settings.
KNOWN = {
    "work_mode": "cr_vfoc", "subdivision": "16", "motor_direction": "0", "current": "800", "holding_current": "4",
    "enable_level": "0", "screen_off": "0", "protection": "0", "interpolation": "1", "respond": "1", "active": "1",
    "key_lock": "0", "home_trigger": "0", "home_direction": "0", "home_speed": "60", "end_limit": "0", "limit_remap": "0",
    "return_angle": "8192", "home_mode": "0", "home_current": "400", "zero_mode": "0", "set_zero": "0", "zero_speed": "0",
    "zero_direction": "0",
}  # fmt: skip


def only(check, dialect="mks-rs485"):
    return Claim(f"{dialect}/state/x", Theme.STATE, dialect, "x", "", "x", check)


def test_what_fails_once_of_two_times_is_refuted_and_says_so(tmp_path):
    rig = EmulatedPort("mks-rs485@1", tmp_path)
    times = []

    def check(probe):
        times.append(probe.read("read_speed"))
        if len(times) == 1:
            raise Refuted("it was slow")

    verdict = engine.run_claim(only(check), rig)
    rig.close()
    assert verdict.outcome is Outcome.REFUTED
    assert "1 of 2 times" in verdict.reason
    assert len(times) == 2


def tried(drive, *, key="", of_line=False):
    """Return the outcome of a claim that refutes a drive when a reply to it was damaged, and how often it was tried."""
    times = []

    def check(probe):
        times.append(probe.ask("read_speed"))
        if times[-1].damaged:
            raise Refuted("a reply", key=key or f"time {len(times)}")

    claim = dataclasses.replace(only(check), of_line=of_line)
    verdict = engine.run_claim(claim, EmulatedRig(make.parse(drive), seed=DAMAGES_FIRST))
    assert verdict.measured.get("attempts", 1) == len(times)
    return verdict.outcome, len(times)


#: With this seed a line that damages a reply of three damages the first one and not that of the next drive.
DAMAGES_FIRST = 1


def test_what_is_refuted_while_the_line_damaged_a_reply_is_tried_again():
    drive = "mks-rs485@1,line-errors=30%"
    assert tried(drive) == (Outcome.CONFIRMED, 2)
    assert tried(drive, of_line=True) == (Outcome.REFUTED, 1)


def test_a_drive_that_damages_each_reply_is_refuted_and_one_that_is_refuted_otherwise_each_time_is_not():
    drive = "mks-rs485@1,fault=checksum-off-by-one"
    assert tried(drive, key="the same") == (Outcome.REFUTED, 3)
    assert tried(drive) == (Outcome.INCONCLUSIVE, 2)


@pytest.mark.parametrize(("failing", "outcome"), [(2, Outcome.CONFIRMED), (3, Outcome.REFUTED)])
def test_on_a_line_that_loses_requests_a_refutation_has_to_come_three_times(failing, outcome):
    """What all drives are told is not answered: nothing tells whether it came."""
    rig = EmulatedRig(make.parse("mks-rs485@1"))
    rig.loses = True
    times = []

    def check(probe):
        times.append(probe)
        if len(times) <= failing:
            raise Refuted("a setting that all drives were told does not hold")

    assert (engine.run_claim(only(check), rig).outcome, len(times)) == (outcome, 3)


def test_a_sequence_of_steps_is_shortened_where_an_emulated_drive_has_the_same_fault(tmp_path):
    """The real drive has a fault that the suite knows; a drive by the manual does not have it."""
    rig = EmulatedPort("mks-rs485@1,fault=set-zero-ignored", tmp_path, settings=KNOWN,
                       allowance=Allowance(EVERYTHING))  # fmt: skip
    from conformance.model import story

    steps = [
        Step("run_speed", {"rpm": 60, "acceleration": 248}), Step("stop_speed", {"acceleration": 248}),
        Step("look", {"first": 0, "count": 2}), Step("set_zero"), Step("look", {"first": 0, "count": 2}),
    ]  # fmt: skip
    assert parse_steps(steps_text(steps)) == steps

    def check(probe):
        error = story.replay(probe, steps)
        assert error is not None
        error.steps = tuple(steps)
        raise error

    verdict = engine.run_claim(only(check), rig)
    rig.close()
    assert verdict.outcome is Outcome.REFUTED, verdict.reason
    assert "2 of 2 times" in verdict.reason
    assert len(verdict.steps) < len(steps), verdict.reason
    assert f"{len(verdict.steps)} of {len(steps)} steps" in verdict.reason


def test_the_search_for_drives_that_fail_alike_has_one_budget_for_the_whole_run(monkeypatch):
    """No verdict of a run without time is searched for; a long story is given up when its time is over."""
    from conformance.model import story

    clock = iter(range(10_000))
    monkeypatch.setattr(story, "monotonic", lambda: next(clock))
    probe = EmulatedRig(make.parse("mks-rs485@1")).probe(only(lambda probe: None))
    with pytest.raises(Inconclusive, match="no time"):
        story.replay(probe, [Step("look", {"first": 0, "count": 1})] * 10, until=5)
    assert next(clock) == 7
    steps = [Step("look", {"first": 0, "count": 1})] * 3
    assert story.shortened(probe, steps, "any", until=5) == (steps, None)

    rig = EmulatedRig(make.parse("mks-rs485@1"))
    verdict = Verdict(only(lambda probe: None), Outcome.REFUTED, "", key="any", steps=tuple(steps))
    monkeypatch.setattr(engine.time, "monotonic", lambda: next(clock))
    monkeypatch.setattr(engine, "_SEARCH_SECONDS", 20.0)
    rig.searched = 19.0
    assert engine._shortened(verdict.claim, rig, verdict) is None
    assert rig.searched > 20
    before = next(clock)
    assert engine._shortened(verdict.claim, rig, verdict) is None
    assert next(clock) - before < 10


def test_a_walk_tells_the_steps_of_a_real_drive(tmp_path, monkeypatch):
    monkeypatch.setattr(engine, "_SEARCH_SECONDS", 0)
    rig = EmulatedPort("mks-rs485@1,fault=set-zero-ignored", tmp_path, settings=KNOWN,
                       allowance=Allowance(EVERYTHING))  # fmt: skip
    (state,) = [c for c in plan.every_claim(rig._target) if c.id == "mks-rs485/state/walk/1"]
    verdict = engine.run_claim(state, rig)
    rig.close()
    if verdict.outcome is Outcome.REFUTED:
        # The shaft has turned when noise was measured, so the first look may tell already.
        assert verdict.steps or "after 0 steps" in verdict.reason
    else:
        assert verdict.outcome is Outcome.CONFIRMED, verdict.reason
