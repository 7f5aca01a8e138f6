"""Claims about motion: nothing is refuted of drives as the manuals have them, and each fault by the claim that is about it."""

from __future__ import annotations

import pytest

from analyzer.catalogue import Risk
from conformance.claim import Claim, Outcome, Theme
from conformance.claims.settings.link_changes import SETTLE_NS, change_address
from conformance.drives import make
from conformance.drives.drive import Drive
from conformance.gate.gate import Allowance
from conformance.suite import engine
from conformance.suite.rig_emulated import EmulatedRig
from conformance.talk.acceptance import answers
from tests.conformance.theme_runs import claims_of, judge

DRIVES = ("mks-rs485@1", "mks-modbus@1", "mks-can@1,model=42E", "lk-rs485@1,model=MF")


def name(claim: Claim) -> str:
    """Return the id of a claim without its dialect and theme."""
    return claim.id.split("/", 2)[2]


@pytest.mark.parametrize("drive", DRIVES)
def test_every_claim_names_its_command_its_section_and_its_risks(drive):
    for claim in claims_of(Theme.MOTION, EmulatedRig(make.parse(drive))):
        assert claim.section, claim.id
        assert claim.id.endswith("other-models") or (claim.covers and claim.commands), claim.id


@pytest.mark.parametrize(
    ("fault", "claim"),
    [("lk-overshoot", "move_increment/within"), ("lk-stop-coasts", "stop/brakes"), ("lk-zero-at-once", "set_zero/not-at-once")],
)
def test_what_the_lk_manual_leaves_open_is_observed(fault, claim):
    verdict = judge(f"lk-rs485@1,fault={fault}", f"motion/{claim}")
    assert (verdict.outcome, verdict.expected != "") == (Outcome.OBSERVED, True)


@pytest.mark.parametrize(
    ("fault", "claim", "text"),
    [
        ("lk-speed-limit-ignored", "speed-limit-run_speed-each-way", "the speed limit does not hold for run_speed"),
        ("lk-angle-limit-ignored", "angle-limit-move_multi_turn-each-way", "the angle limit does not hold for move_multi_turn"),
        ("lk-torque-limit-ignored", "torque-limit-move_increment", "a run turns the shaft with a torque limit of 0"),
    ],
)
def test_a_limit_of_lk_that_never_holds_is_observed(fault, claim, text):
    verdict = judge(f"lk-rs485@1,fault={fault}", f"motion/write_parameter/{claim}")
    assert (verdict.outcome, verdict.reason) == (Outcome.OBSERVED, text)


def test_a_move_within_bounds_is_all_that_a_bounded_run_sends():
    """A claim that needs more than is allowed is not run, and says why."""
    allowed = frozenset({Risk.SETTING, Risk.MOTION, Risk.TORQUE})
    rig = EmulatedRig(make.parse("mks-rs485@1"), allowance=Allowance(allowed, speed=300, turns=2, subdivision=16))
    chosen = {name(c): c for c in claims_of(Theme.MOTION, rig)}
    assert engine.run_claim(chosen["move_relative_axis/distance"], rig).outcome is Outcome.CONFIRMED
    assert engine.run_claim(chosen["move_relative_axis/crossed-ends"], rig).outcome is Outcome.CONFIRMED
    beyond = engine.run_claim(chosen["move_relative_axis/told-when-there"], rig)
    assert beyond.outcome is Outcome.NOT_RUN
    assert "rpm" in beyond.reason
    unbounded = engine.run_claim(chosen["run_speed/speed-60"], rig)
    assert unbounded.outcome is Outcome.NOT_RUN
    assert "unbounded" in unbounded.reason


class TurnedBefore(EmulatedRig):
    """A rig whose drives have turned for long before a claim, as a real one has."""

    def make_drive(self) -> Drive:
        drive = super().make_drive()
        drive.turn_shaft(300 * 16384 + 5000)
        return drive


@pytest.mark.parametrize("fault", ["carry-half-width", "carry-without-sign"])
def test_a_carry_is_looked_at_about_zero_wherever_the_shaft_is(fault):
    rig = TurnedBefore(make.parse(f"mks-rs485@1,fault={fault}"))
    claim = next(c for c in claims_of(Theme.MOTION, rig) if name(c) == "read_encoder_carry/at-the-carry")
    assert engine.run_claim(claim, rig).outcome is Outcome.REFUTED


def test_a_change_of_the_link_is_waited_for_until_the_drive_answers():
    rig = EmulatedRig(make.parse("mks-rs485@1"))
    rig.quiet_ns = 0
    probe = rig.probe(claims_of(Theme.MOTION, rig)[0])
    begun_ns = probe.gate.now_ns()
    change_address(probe, probe.command("set_address"), 7)
    assert answers(probe, 7)
    assert probe.gate.now_ns() - begun_ns < SETTLE_NS
