"""What pytest collects: one test for each claim about each drive under test."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from analyzer.errors import ServotapError
from conformance import engine, pytest_plan, suite
from conformance.claim import Claim, Outcome
from conformance.rig import Rig
from conformance.suite import Plan
from conformance.target import Target


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Make a test of each claim about each drive that was named."""
    try:
        plan = pytest_plan.plan_of(metafunc.config)
        cases = [(target, claim) for target in plan.targets for claim in plan.selected(target)]
    except ServotapError as error:
        raise pytest.UsageError(f"servotap: {error}") from None
    parameters = [
        pytest.param(
            target,
            claim,
            id=f"{target.text}:{claim.id}",
            marks=() if target.emulated else pytest.mark.xdist_group(target.port),
        )
        for target, claim in cases
    ]
    metafunc.parametrize(("target", "claim"), parameters)


@pytest.fixture(scope="session")
def rigs(request: pytest.FixtureRequest) -> Iterator[dict[str, Rig]]:
    """Return the rigs by target; whatever ends the session closes them: everything stopped and put back."""
    opened: dict[str, Rig] = {}
    try:
        yield opened
    finally:
        for rig in opened.values():
            rig.close()


def test_claim(
    target: Target,
    claim: Claim,
    rigs: dict[str, Rig],
    request: pytest.FixtureRequest,
) -> None:
    """Hold a claim against the drive."""
    plan = pytest_plan.plan_of(request.config)
    rig = _rig_of(target, plan, rigs)
    try:
        verdict = engine.run_claim(claim, rig)
    except ServotapError as error:
        pytest_plan.give_up(error)
    told = pytest_plan.keep(request.node, verdict, target, plan, rig.firmware)
    if verdict.outcome is Outcome.REFUTED:
        pytest.fail(told, pytrace=False)
    if verdict.outcome in (Outcome.INCONCLUSIVE, Outcome.NOT_RUN):
        pytest.skip(f"{verdict.outcome}: {verdict.reason}")


def _rig_of(target: Target, plan: Plan, rigs: dict[str, Rig]) -> Rig:
    """Return the rig of a target; a port has one owner, so another drive's rig on it is closed first."""
    rig = rigs.get(target.port + target.text)
    if rig is not None:
        return rig
    for name in [n for n in rigs if n.startswith(target.port) and not target.emulated]:
        rigs.pop(name).close()
    try:
        rig = rigs[target.port + target.text] = suite.open_rig(plan, target)
    except ServotapError as error:
        pytest_plan.give_up(error)
    return rig
