"""A refutation on a real port is repeated; a sequence of steps is shortened on an emulated drive that fails alike."""

from __future__ import annotations

from dataclasses import replace

import pytest

from conformance.claim import Claim, Inconclusive, Outcome, Refuted, Theme, Verdict
from conformance.drives import make
from conformance.gate.permissions import Allowance
from conformance.model.walk import Step, parse_steps, steps_text
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


#: Of reads on a line that turns bits over so often, most come damaged; on one that does not, none.
NOISY, CLEAN = "mks-rs485@1,line-errors=80%", "mks-rs485@1"
READS = 40


@pytest.mark.parametrize(
    ("drive", "facts", "fails", "outcome", "attempts"),
    [
        (NOISY, {}, 1, Outcome.CONFIRMED, 2),
        (NOISY, {}, 2, Outcome.CONFIRMED, 3),
        (NOISY, {}, 9, Outcome.REFUTED, 3),
        (NOISY, {"of_line": True}, 1, Outcome.REFUTED, 1),
        (CLEAN, {}, 1, Outcome.REFUTED, 1),
    ],
)
def test_what_fails_while_the_line_damages_something_is_begun_anew(drive, facts, fails, outcome, attempts):
    rig = EmulatedRig(make.parse(drive))
    came = []

    def check(probe):
        came.append([probe.ask("read_speed").received for _ in range(READS)])
        if len(came) <= fails:
            raise Refuted("it was slow")

    verdict = engine.run_claim(replace(only(check), **facts), rig)
    assert verdict.outcome is outcome
    assert verdict.measured.get("attempts", 1) == len(came) == attempts
    # On another line the same drive is damaged elsewhere: each attempt has a chance of its own.
    assert len({tuple(each) for each in came}) == attempts


def test_a_motion_that_several_claims_judge_is_recorded_anew_for_one_that_is_begun_anew():
    rig = EmulatedRig(make.parse(NOISY))
    recorded = []

    def motion(probe):
        recorded.append([probe.ask("read_speed") for _ in range(READS)])
        return len(recorded)

    def check(probe):
        if probe.recorded(motion) == 1:
            raise Refuted("it was slow")

    assert engine.run_claim(only(check), rig).outcome is Outcome.CONFIRMED
    assert len(recorded) == 2
    assert engine.run_claim(only(check), rig).outcome is Outcome.CONFIRMED
    assert len(recorded) == 2
