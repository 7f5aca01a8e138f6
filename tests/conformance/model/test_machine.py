"""The state machine: what it draws, that it draws the same again, that failures are shortened and steps are data."""

from __future__ import annotations

import pytest
from hypothesis.stateful import RuleBasedStateMachine

from analyzer.catalogue import Risk
from conformance.claim import Claim, NotRun, Refuted, Theme
from conformance.drives import make
from conformance.gate.permissions import Allowance
from conformance.model import machine
from conformance.model.session import Session, Step, parse_steps, steps_text
from conformance.suite.rig_emulated import EmulatedRig

DRIVES = ("mks-rs485@1", "mks-modbus@1", "mks-can@1", "lk-rs485@1")


def probe_of(drive: str, *, seed: int = 0, allowance: Allowance | None = None):
    rig = EmulatedRig(make.parse(drive), seed=seed, allowance=allowance)
    name = rig.dialect.name
    return rig.probe(Claim(f"{name}/state/test", Theme.STATE, name, "s", "1", "r", lambda probe: None))


def noted(monkeypatch) -> list[Step]:
    """Return a list into which every step goes that is done from now on."""
    steps: list[Step] = []
    before = Session.do
    monkeypatch.setattr(Session, "do", lambda self, step: (steps.append(step), before(self, step))[1])
    return steps


def test_steps_are_data():
    steps = [Step("enable", {"enabled": 1}), Step("look"), Step("move_relative_axis", {"counts": -400, "speed": 60})]
    text = steps_text(steps)
    assert text == "enable enabled=1; look; move_relative_axis counts=-400 speed=60"
    assert parse_steps(text) == steps
    assert parse_steps("") == []


@pytest.mark.parametrize("drive", DRIVES)
def test_each_kind_of_step_is_drawn(drive, monkeypatch):
    steps = noted(monkeypatch)
    probe = probe_of(drive)
    for variant, names in machine.variants(probe.dialect).items():
        steps.clear()
        recorder = machine.run(probe_of(drive), variant)
        assert recorder.failure is None
        assert recorder.sequences == machine.EXAMPLES
        missing = set(names) - {s.name for s in steps}
        assert missing <= ({"user_id"} if drive != "mks-can@1" else set())


def test_a_run_is_the_same_again_and_another_with_another_seed(monkeypatch):
    steps = noted(monkeypatch)
    runs = []
    for seed in (0, 0, 1):
        steps.clear()
        machine.run(probe_of("mks-modbus@1", seed=seed), "settings")
        runs.append(list(steps))
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_only_allowed_risks_are_drawn(monkeypatch):
    steps = noted(monkeypatch)
    allowed = Allowance(frozenset({Risk.READ, Risk.SETTING, Risk.MOTION, Risk.TORQUE}))
    assert machine.run(probe_of("mks-rs485@1", allowance=allowed), "mixed").failure is None
    names = {s.name for s in steps}
    assert "move_relative_axis" in names
    assert not names & {"run_speed", "restart"}


def test_the_machine_is_hypothesis_own():
    made = machine.machine(probe_of("lk-rs485@1"), "motion", machine.Recorder())
    assert issubclass(made, RuleBasedStateMachine)


def test_a_failure_is_shortened_and_can_be_repeated():
    # What Hypothesis draws for a seed depends on the modules that are loaded: one of a few seeds finds the fault.
    found: list[Refuted] = []
    for number in range(20):
        try:
            machine.check(probe_of("mks-rs485@1,fault=speed-ignores-subdivision", seed=number), "mixed")
        except Refuted as error:
            found.append(error)
            break
    (refuted,) = found
    steps = list(refuted.steps)
    assert [s.name for s in steps] == ["telling", "run_speed"]
    assert steps[0].values["subdivision"] in (128, 0)
    again = machine.replay(probe_of("mks-rs485@1,fault=speed-ignores-subdivision"), steps)
    assert again is not None
    assert again.key == refuted.key
    assert machine.replay(probe_of("mks-rs485@1"), steps) is None


def test_a_sequence_that_does_not_fail_again_is_told_as_it_came():
    steps = [Step("enable", {"enabled": 1}), Step("look")]
    assert machine.shortened(probe_of("mks-can@1"), steps, "nothing") == (steps, None)


def test_where_nothing_may_be_sent_nothing_is_confirmed(monkeypatch):
    monkeypatch.setattr(machine, "run", lambda probe, variant: machine.Recorder(sequences=3))
    with pytest.raises(NotRun):
        machine.check(probe_of("mks-can@1"), "mixed")


def test_steps_that_a_sound_drive_takes_refute_one_that_moves_while_it_is_disabled():
    probe = probe_of("mks-rs485@1")
    steps = parse_steps("enable enabled=0; move_relative_axis counts=1000 speed=60 acceleration=200; enable enabled=1; look")
    assert machine.replay(probe, steps) is None
    disabled = probe_of("mks-rs485@1,fault=disabled-moves")
    error = machine.replay(disabled, steps)
    assert error is not None
    assert "answered" in error.text
