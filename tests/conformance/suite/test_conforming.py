"""Drives as the manuals have them confirm every claim but the few that are kept as observed (`golden/verdicts.jsonl`)."""

from __future__ import annotations

import pytest

from analyzer.catalogue import Risk
from conformance.claim import Outcome
from conformance.gate.budget import Budget
from conformance.gate.permissions import Allowance
from conformance.suite import engine
from conformance.suite import plan as suite
from conformance.suite.rig_emulated import UNLIMITED, EmulatedRig
from conformance.suite.target import every_emulated
from tests.conformance import golden

TARGETS = every_emulated()
#: Parts of the claims, so that workers share them.
PARTS = 8
OWN = frozenset({1})


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


def test_every_command_is_looked_at():
    for target in TARGETS:
        covered = {command for claim in suite.every_claim(target) for command, _ in claim.covers}
        have = {c.name for c in target.dialect.commands if not c.models or not target.model or target.model in c.models}
        assert have <= covered, target.text
