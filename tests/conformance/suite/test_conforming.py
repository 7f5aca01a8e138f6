"""Drives as the manuals have them confirm every claim but the few that are kept as observed (`golden/verdicts.jsonl`)."""

from __future__ import annotations

import pytest

from analyzer.catalogue import Risk
from conformance.claim import Outcome, Theme
from conformance.gate.budget import Budget
from conformance.gate.permissions import Allowance
from conformance.suite import engine
from conformance.suite import plan as suite
from conformance.suite.rig_emulated import UNLIMITED, EmulatedRig
from conformance.suite.target import every_emulated
from tests.conformance import golden, theme_runs

TARGETS = every_emulated()
#: Parts of the claims, so that workers share them.
PARTS = 8
OWN = frozenset({1})
#: Other models, and addresses at the edges.
OTHERS = ("mks-rs485@255,model=57D", "mks-modbus@247,model=28D", "mks-can@0x7ff,model=57E", "lk-rs485@32,model=MS")
#: Themes in which these matter, with what they leave unconfirmed: what no manual says, or what another dialect or model has.
ELSEWHERE = (
    *((theme, drive, "") for theme in (Theme.ADDRESSING, Theme.EXAMPLES) for drive in OTHERS),
    (Theme.FRAMING, OTHERS[0], "other_dialect/ignored other_dialect/next pieces/answered"),
    (Theme.FRAMING, OTHERS[1], "pieces/answered"),
    (Theme.FRAMING, OTHERS[2], ""),
    (Theme.FRAMING, OTHERS[3], "pieces/answered"),
    *((Theme.SHAPE, drive, "") for drive in (*OTHERS[:2], OTHERS[3])),
    (Theme.SHAPE, OTHERS[2], "read_parameter/of/group_address"),
    (Theme.MODBUS, "mks-modbus@247,model=57D", ""),
    (Theme.RANGES, OTHERS[0], "set_modbus/modbus/listed"),
    (Theme.RANGES, OTHERS[3], ""),
    (
        Theme.READ_BACK,
        OTHERS[0],
        "set_modbus/restart restore/limit-remap set_limit_remap/limit-remap-and-back "
        "set_limit_remap/restart-broadcast-limit-remap set_limit_remap/restart-group-limit-remap "
        "set_limit_remap/restart-package-limit-remap",
    ),
    (Theme.READ_BACK, "mks-rs485@3,baud=115200", "set_limit_remap/effect"),
)
#: Claims about motion in which models differ.
MODELS = (
    ("mks-rs485@1,model=57D", "set_limit_remap/"),
    ("mks-can@1,model=57E", "set_home/end-limit"),
    ("lk-rs485@1,model=MS", "run_"),
    ("lk-rs485@1,model=MG", "read_encoder/"),
    ("lk-rs485@1,model=MH", "run_torque/"),
)


@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.parametrize("target", TARGETS, ids=lambda t: t.text)
def test_every_claim_is_confirmed_with_no_more_than_the_risks_that_it_names(target, part):
    # Claims that judge one recording are neighbours, and have the same risks: a part is a run of them.
    claims = suite.Plan((target,)).selected(target)
    begin, end = (len(claims) * each // PARTS for each in (part, part + 1))
    rigs: dict[tuple[frozenset[Risk], bool], EmulatedRig] = {}
    kept, wrong = set(golden.kept("verdicts")), []
    for claim in claims[begin:end]:
        allowed = claim.risks | {Risk.READ}, claim.alone
        if allowed not in rigs:
            allowance = Allowance(allowed[0], addresses=OWN, alone=claim.alone, budget=Budget(wear=UNLIMITED))
            rigs[allowed] = EmulatedRig(target.specification, allowance=allowance)
        verdict = engine.run_claim(claim, rigs[allowed])
        line = golden.unconfirmed(target, verdict)
        if verdict.outcome is not Outcome.CONFIRMED and line not in kept:
            wrong.append(line)
    assert begin < end
    assert wrong == []


@pytest.mark.parametrize(("theme", "drive", "unconfirmed"), ELSEWHERE)
def test_other_models_and_addresses_confirm_what_is_about_them(theme, drive, unconfirmed):
    found = theme_runs.run(theme, drive)
    others = {name: v for name, v in found.items() if v.outcome is not Outcome.CONFIRMED}
    assert others.keys() == set(unconfirmed.split()), {name: v.reason for name, v in others.items()}
    assert {v.outcome for v in others.values()} <= {Outcome.NOT_RUN, Outcome.OBSERVED}
    assert found


@pytest.mark.parametrize(("drive", "wanted"), MODELS)
def test_other_models_confirm_what_is_about_their_motion(drive, wanted):
    verdicts = theme_runs.run(Theme.MOTION, drive, wanted)
    assert {v.outcome for v in verdicts.values()} == {Outcome.CONFIRMED}, verdicts


def test_every_command_is_looked_at():
    for target in TARGETS:
        covered = {command for claim in suite.every_claim(target) for command, _ in claim.covers}
        have = {c.name for c in target.dialect.commands if not c.models or not target.model or target.model in c.models}
        assert have <= covered, target.text
