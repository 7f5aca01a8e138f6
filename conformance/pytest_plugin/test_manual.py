"""The tests that pytest collects: one for each claim about each drive under test."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest

from analyzer.errors import ServotapError
from conformance.claim import Claim, Outcome
from conformance.pytest_plugin import plan as pytest_plan
from conformance.pytest_plugin.plugin import end_with
from conformance.suite import engine
from conformance.suite import plan as suite
from conformance.suite.plan import Plan
from conformance.suite.rig import ClaimRig
from conformance.suite.target import Target


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Make a test of each claim about each drive that was named."""
    try:
        plan = pytest_plan.plan_of(metafunc.config)
        cases = [(target, claim) for target in plan.targets for claim in plan.selected(target)]
    except ServotapError as error:
        raise pytest.UsageError(f"servotap: {error}") from None
    parameters = [
        pytest.param(target, claim, id=f"{pytest_plan.label(target, plan.targets)}:{claim.id}") for target, claim in cases
    ]
    metafunc.parametrize(("target", "claim"), parameters)


Opened = dict[tuple[str, str], ClaimRig]


@pytest.fixture(scope="session")
def rigs(request: pytest.FixtureRequest) -> Iterator[Opened]:
    """Return the rigs by port and target. At the end of the session all drives are stopped and their settings restored."""
    opened: Opened = {}
    try:
        yield opened
    finally:
        for rig in opened.values():
            _close(rig, request.config)


def _close(rig: ClaimRig, config: pytest.Config) -> None:
    """Close a rig; what that tells becomes the exit status, for a failed teardown would only be one more error."""
    try:
        rig.close()
    except ServotapError as error:
        pytest_plan.note(error, config)
        print(f"servotap: {error}", file=sys.__stderr__)


def test_claim(target: Target, claim: Claim, rigs: Opened, request: pytest.FixtureRequest) -> None:
    """Hold a claim against the drive."""
    plan = pytest_plan.plan_of(request.config)
    rig = _rig_of(target, plan, rigs, request)
    try:
        verdict = engine.run_claim(claim, rig)
    except ServotapError as error:
        pytest_plan.give_up(error, request)
    told = pytest_plan.keep(request.node, verdict, target, plan, rig.firmware)
    if verdict.outcome is Outcome.REFUTED:
        pytest.fail(told, pytrace=False)
    if verdict.outcome in (Outcome.INCONCLUSIVE, Outcome.NOT_RUN):
        pytest.skip(f"{verdict.outcome}: {verdict.reason}")


def _rig_of(target: Target, plan: Plan, rigs: Opened, request: pytest.FixtureRequest) -> ClaimRig:
    """Return the rig of a target; a port has one owner, so another drive's rig on it is closed first."""
    key = (target.port, target.text)
    rig = rigs.get(key)
    if rig is not None:
        return rig
    for other in [k for k in rigs if k[0] == target.port and not target.emulated]:
        _close(rigs.pop(other), request.config)
    try:
        rig = rigs[key] = suite.open_rig(plan, target)
        for verdict in engine.prove_reads(suite.proving_claims(plan, target), rig):
            if verdict.outcome is Outcome.REFUTED:
                print(f"servotap: {verdict.claim.id} is refuted: {verdict.reason}", file=sys.__stderr__)
                end_with(request.config, pytest.ExitCode.TESTS_FAILED.value)
    except ServotapError as error:
        pytest_plan.give_up(error, request)
    return rig
