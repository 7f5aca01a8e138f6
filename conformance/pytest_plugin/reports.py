"""The end of a pytest run of the suite: the table of claims, and the requested reports."""

from __future__ import annotations

import io
import sys
import time
from collections.abc import Sequence
from typing import Any

import msgspec
import pytest

from conformance.claim import RigFault
from conformance.pytest_plugin.plan import arguments_of, plan_of
from conformance.pytest_plugin.plugin import end_with
from conformance.report import terminal, write_reports
from conformance.suite.record import RunRecord, VerdictRecord, doubt_about


def summarise(reporter: Any, config: pytest.Config, verdicts: Sequence[str]) -> None:
    """Print the claims by theme and write the reports."""
    from rich.console import Console

    records = [msgspec.json.decode(text, type=VerdictRecord) for text in verdicts]
    run = _run(config, reporter)
    text = io.StringIO()
    terminal.show_counts(records, Console(file=text, width=160))
    reporter.section("claims")
    reporter.write(text.getvalue())
    arguments = arguments_of(config)
    places = {name: getattr(arguments, name) for name in ("report", "log", "failures")}
    for reason in write_reports(records, run, places, force=None).values():
        reporter.write_line(reason, red=True)
        end_with(config, pytest.ExitCode.USAGE_ERROR.value)


def judge(config: pytest.Config, verdicts: Sequence[str]) -> None:
    """Have the run end with what its verdicts say: a refutation counts more than a fault of the rig."""
    records = [msgspec.json.decode(text, type=VerdictRecord) for text in verdicts]
    doubt = doubt_about(records, arguments_of(config).max_inconclusive)
    if doubt:
        print(f"servotap: {doubt}", file=sys.stderr)
        end_with(config, RigFault.exit_status)
    if any(r.refuted for r in records):
        end_with(config, pytest.ExitCode.TESTS_FAILED.value)


def _run(config: pytest.Config, reporter: Any) -> RunRecord:
    # pytest keeps the start under one of two names, by its version.
    start = getattr(reporter, "_session_start", None)
    began = float(getattr(start, "time", None) or getattr(reporter, "_sessionstarttime", None) or time.time())
    started_at = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(began))
    return plan_of(config).run_record(started_at, time.time() - began, ["pytest", *sys.argv[1:]])
