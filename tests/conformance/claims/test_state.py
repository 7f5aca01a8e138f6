"""Claims about state: sequences of requests on drives as the manual has them, and on drives that are wrong in their state."""

from __future__ import annotations

import pytest

from analyzer.catalogue import Risk
from conformance.claim import Outcome, Theme
from conformance.drives import make
from conformance.gate.permissions import Allowance
from conformance.suite import engine
from conformance.suite.rig_emulated import EmulatedRig
from tests.conformance import theme_runs

FAULTS = (
    ("mks-rs485", "disabled-moves", "mixed"),
    ("mks-modbus", "pulse-mode-moves", "mixed"),
    ("mks-rs485", "respond-ignored", "mixed"),
    ("mks-can", "stop-completion-missing", "motion"),
    ("mks-rs485", "speed-ignores-subdivision", "mixed"),
    ("mks-can", "parameter-bytes-shifted", "settings"),
    ("mks-can", "subdivision-lost", "settings"),
    ("mks-modbus", "move-ends-short", "motion"),
    ("lk-rs485", "lk-off-still-moves", "mixed"),
    ("lk-rs485", "lk-on-needed-twice", "mixed"),
    ("lk-rs485", "lk-multi-turn-relative", "motion"),
    ("lk-rs485", "lk-parameter-elsewhere", "settings"),
)


@pytest.mark.parametrize(("dialect", "fault", "variant"), FAULTS)
def test_a_fault_of_state_is_refuted_by_a_few_steps(dialect, fault, variant):
    # What Hypothesis draws depends on the modules that are loaded, too, so more than one seed may be needed.
    for number in range(8):
        rig = EmulatedRig(make.parse(f"{dialect}@1,fault={fault}"), seed=number)
        claim = next(c for c in theme_runs.claims_of(Theme.STATE, rig) if c.parameters["variant"] == variant)
        verdict = engine.run_claim(claim, rig)
        if verdict.outcome is Outcome.REFUTED:
            break
    assert (verdict.outcome, verdict.reason) == (Outcome.REFUTED, verdict.reason)
    assert 1 <= len(verdict.steps) <= 5
    assert str(verdict.steps[-1]) in verdict.got


@pytest.mark.parametrize("fault", ["lost-reply", "checksum-wrong", "half-frame", "late-reply"])
def test_what_other_claims_judge_is_not_refuted_here(fault):
    for dialect in ("mks-rs485", "lk-rs485"):
        assert theme_runs.refuted(Theme.STATE, f"{dialect}@1,fault={fault}", "mixed") == set()


@pytest.mark.parametrize("drive", ["mks-rs485@1", "lk-rs485@1,model=MF"])
def test_a_bounded_run_draws_within_its_bounds(drive):
    specification = make.parse(drive)
    bounds = {"speed": 300.0, "turns": 2.0, "acceleration": 250.0, "current": 1500.0, "subdivision": 16}
    rig = EmulatedRig(specification, allowance=Allowance(frozenset(Risk), alone=True, **bounds))
    for claim in theme_runs.claims_of(Theme.STATE, rig):
        verdict = engine.run_claim(claim, rig)
        assert (claim.id, verdict.outcome, verdict.reason) == (claim.id, Outcome.CONFIRMED, "")
        assert verdict.measured["steps"] > 80
