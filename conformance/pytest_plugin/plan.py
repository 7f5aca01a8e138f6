"""Between pytest and the suite: the plan from pytest's options, and the data in a test's report."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from typing import NoReturn

import msgspec
import pytest

from conformance.claim import NotStopped, RigFault, Verdict
from conformance.pytest_plugin.plugin import BUDGET, OPTIONS, RUN, end_with
from conformance.suite import target as targets
from conformance.suite.options import inconclusive, plan_from, seconds
from conformance.suite.plan import Plan
from conformance.suite.record import record
from conformance.suite.target import Target

#: What reads the options that the plugin takes as they are: it imports nothing of the suite.
_TAKEN: dict[str, Callable[[str], float]] = {"max_run": seconds, "max_inconclusive": inconclusive}


def plan_of(config: pytest.Config) -> Plan:
    """Return the plan of this run, made once. Raises ServotapError for options that do not fit together."""
    plan = config.stash.get(RUN, None)
    if plan is None:
        plan = config.stash[RUN] = _plan(config)
    return plan


def arguments_of(config: pytest.Config) -> argparse.Namespace:
    """Return the suite's options by their names. Raises pytest's UsageError for what `servotap test` does not take either."""
    values = {name.replace("-", "_"): config.getoption("servotap_" + name.replace("-", "_")) for name, _ in OPTIONS}
    for name, taken in _TAKEN.items():
        try:
            values[name] = taken(str(values[name]))
        except argparse.ArgumentTypeError as error:
            raise pytest.UsageError(f"servotap: --{name.replace('_', '-')}: {error}") from None
    return argparse.Namespace(**values)


def _plan(config: pytest.Config) -> Plan:
    arguments = arguments_of(config)
    found = targets.parse_all(arguments.drive, arguments.on)
    return plan_from(
        arguments,
        found,
        claims=arguments.claim,
        themes=arguments.theme,
        seed=arguments.seed,
        traffic=bool(arguments.log),
        short=arguments.short,
    )


def label(target: Target, among: Sequence[Target]) -> str:
    """Return what names a target in the ids of its tests: its text, with its place where another one has the same text."""
    alone = sum(each.text == target.text for each in among) == 1
    return target.text if alone else f"{target.text} on {target.on}"


def keep(item: pytest.Item, verdict: Verdict, target: Target, plan: Plan, firmware: str = "") -> str:
    """Give a test what its reports carry, and return what a person reads if it fails."""
    claim = verdict.claim
    kept = record(verdict, target.text, firmware=firmware, traffic=plan.traffic)
    item.servotap_verdict = msgspec.json.encode(kept).decode()  # type: ignore[attr-defined]
    properties = {
        "claim": claim.id,
        "drive": target.text,
        "on": target.on,
        "outcome": verdict.outcome.value,
        "certainty": claim.certainty.value,
        "section": claim.section,
        "seed": str(plan.seed),
    }
    if firmware:
        properties["firmware"] = firmware
    if plan.allowance is not None:
        properties["allowed"] = ",".join(sorted(risk.value for risk in plan.allowance.risks))
        properties |= {f"bound {name}": value for name, value in plan.allowance.described().items()}
    item.user_properties += list(properties.items())
    lines = [f"{claim.id}  ({target.text})", f"{claim.statement}  [manual {claim.section}, {claim.certainty}]", verdict.reason]
    lines += [f"expected  {verdict.expected}"] * bool(verdict.expected) + [f"got       {verdict.got}"] * bool(verdict.got)
    return "\n".join([*lines, *kept.lines])


def give_up(error: Exception, request: pytest.FixtureRequest) -> NoReturn:
    """End the whole run: the rig is at fault, or a motor does not stop."""
    told = f"servotap: {error}"
    status = note(error, request.config)
    if hasattr(request.config, "workerinput"):
        # A worker ends as its controller expects it to, with a test that failed; the controller then ends the others.
        request.node.servotap_gave_up = told
        request.session.shouldstop = told
        raise pytest.fail.Exception(told, pytrace=False) from None
    raise pytest.exit.Exception(told, returncode=status) from None


def note(error: Exception, config: pytest.Config) -> int:
    """End the run with the exit status of an error, also if all claims hold; return that status."""
    status = error.exit_status if isinstance(error, (NotStopped, RigFault)) else pytest.ExitCode.USAGE_ERROR.value
    end_with(config, status)
    return status


__all__ = ["BUDGET", "arguments_of", "give_up", "keep", "label", "note", "plan_of"]
