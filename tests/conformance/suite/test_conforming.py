"""Against drives as the manuals have them nothing is refuted, and nothing is left without a verdict."""

from __future__ import annotations

import pytest

from conformance.claim import Outcome
from conformance.suite import engine
from conformance.suite import plan as suite
from conformance.suite.target import every_emulated

TARGETS = every_emulated()
#: Parts of the claims, so that workers share them.
PARTS = 4


@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.parametrize("target", TARGETS, ids=lambda t: t.text)
def test_a_drive_as_the_manual_has_it_is_not_refuted(target, part):
    plan = suite.Plan((target,))
    rig = suite.open_rig(plan, target)
    # Claims that judge one recording are neighbours: a part is a run of them, so that it is made once.
    claims = plan.selected(target)
    begin, end = (len(claims) * each // PARTS for each in (part, part + 1))
    verdicts = [engine.run_claim(claim, rig) for claim in claims[begin:end]]
    assert verdicts
    bad = [v for v in verdicts if v.outcome not in (Outcome.CONFIRMED, Outcome.OBSERVED)]
    assert [(v.claim.id, v.outcome, v.reason) for v in bad] == []


def test_every_command_is_looked_at():
    for target in TARGETS:
        covered = {command for claim in suite.every_claim(target) for command, _ in claim.covers}
        have = {c.name for c in target.dialect.commands if not c.models or not target.model or target.model in c.models}
        assert have <= covered, target.text
