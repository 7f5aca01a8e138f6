"""Options of a run that its command lines and the pytest plugin share, and the plan that they ask for."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from analyzer.cli.option_types import number
from analyzer.live.profile import NamedDrive
from conformance.gate.permissions import allowance_from, narrow
from conformance.suite.plan import Plan
from conformance.suite.record import MOST_INCONCLUSIVE, most_inconclusive
from conformance.suite.target import Target

_LONGEST_RUN = 3600.0


def add_safety_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options by which a real drive is stopped and gets its settings back."""
    parser.add_argument("--settings", metavar="FILE", help="JSON: values to restore for settings that cannot be read")
    parser.add_argument("--journal", metavar="FILE", help="file for the original settings, written before each change")
    parser.add_argument("--cut-power", default="", metavar="COMMAND", help="runs when no stop can be verified")
    parser.add_argument(
        "--accept-quirk",
        action="append",
        default=[],
        metavar="NAME",
        help="a known quirk of real drives that refutes nothing, or all (servotap emulate --list-quirks)",
    )
    parser.add_argument(
        "--max-run", type=seconds, default=30.0, metavar="S", help="longest run without an end, in seconds (default 30)"
    )


def add_verdict_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that say what a run without a refutation is worth."""
    parser.add_argument(
        "--max-inconclusive",
        type=inconclusive,
        default=MOST_INCONCLUSIVE,
        metavar="LIMIT",
        help=f"inconclusive claims, of those that ran, above which the exit status is 10 (default {MOST_INCONCLUSIVE}%)",
    )


def inconclusive(text: str) -> float:
    """Return the limit that `--max-inconclusive` names."""
    try:
        return most_inconclusive(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected a number of claims, or a share as 10%, got {text}") from None


#: The time that `--max-run` names.
seconds = number(f"seconds above 0, up to {_LONGEST_RUN:g}", float, lambda value: 0 < value <= _LONGEST_RUN)


def plan_from(
    arguments: argparse.Namespace,
    targets: Sequence[Target],
    *,
    claims: Sequence[str],
    themes: Sequence[str] = (),
    seed: int = 0,
    dry_run: bool = False,
    traffic: bool = False,
    short: bool = False,
) -> Plan:
    """Return the plan that these options and those of the gate ask for. Raises UsageError where they do not fit together."""
    named = [target.named for target in targets if target.named is not None]
    narrow(arguments, named)
    given = allowance_from(arguments)
    # Nothing can break on an emulated drive, so all is allowed there where nothing was said.
    allowance = None if all(t.emulated for t in targets) and not arguments.allow else given
    plan = Plan(
        tuple(targets),
        allowance,
        tuple(claims),
        tuple(themes),
        seed,
        settings=_settings(arguments.settings, named),
        journal=arguments.journal or "",
        cut_power=arguments.cut_power,
        longest_run=arguments.max_run,
        dry_run=dry_run,
        traffic=traffic,
        short=short,
        accepted=tuple(arguments.accept_quirk),
    )
    plan.check()
    return plan


def _settings(path: str | None, named: Sequence[NamedDrive]) -> dict[str, dict[str, str]]:
    """Return what settings are put back to, by drive: as a file says, else as the profile does."""
    said = {
        f"{drive.dialect.name}@{drive.entry.address}": {name: str(value) for name, value in drive.entry.settings.items()}
        for drive in named
        if drive.entry.settings
    }
    if path is None:
        return said
    from conformance.safety.settings import load

    return said | load(Path(path))
