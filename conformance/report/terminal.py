"""The terminal's report: claims by theme and dialect, refuted claims with their exchange and the command that repeats them."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

from analyzer.values import printable
from conformance.claim import Outcome
from conformance.report.bus import line_causes
from conformance.suite.record import RunRecord, VerdictRecord, noise_of

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

#: Outcomes in the order in which they are counted, with what they look like.
COLUMNS = (
    (Outcome.CONFIRMED, "green"),
    (Outcome.REFUTED, "bold red"),
    (Outcome.OBSERVED, "cyan"),
    (Outcome.INCONCLUSIVE, "yellow"),
    (Outcome.NOT_RUN, "dim"),
)
#: Refuted claims that are shown whole; of the others the first line.
SHOWN = 20
#: Reasons of claims that did not run, listed with their counts.
REASONS = 12


def repeat_command(record: VerdictRecord, run: RunRecord) -> str:
    """Return the one command that repeats a claim."""
    words = ["servotap", "test", record.target]
    place = next((on for on in run.on if on != "emulated"), "")
    words += ["--on", place] if place else []
    words += ["--allow", ",".join(run.allowed)] if place and run.allowed else []
    words += ["--seed", str(run.seed)] if run.seed else []
    return shlex.join([*words, "--claim", record.id])


def show(records: Sequence[VerdictRecord], run: RunRecord, console: Console) -> None:
    """Print the whole report."""
    refuted = [r for r in records if r.refuted]
    for number, record in enumerate(refuted):
        if number < SHOWN:
            show_refuted(record, run, console)
    if len(refuted) > SHOWN:
        console.print(f"[bold red]and {len(refuted) - SHOWN} more failed claims:[/]")
        for record in refuted[SHOWN:]:
            console.print(f"  {record.id}: {record.reason}", markup=False, highlight=False)
    for text in line_causes(refuted):
        console.print(printable(text), markup=False, highlight=False, soft_wrap=True)
    show_counts(records, console)


def show_counts(records: Sequence[VerdictRecord], console: Console) -> None:
    """Print the table of outcomes by drive and theme, and why claims have no verdict."""
    console.print(_table(records))
    for target, noise in noise_of(records).items():
        console.print(f"{target}: noise measured: {noise}", markup=False, highlight=False)
    _reasons(records, console)


def show_refuted(record: VerdictRecord, run: RunRecord, console: Console) -> None:
    """Print one refuted claim: statement, section, expected and got, the exchange, how to repeat it."""

    def line(text: str, style: str = "") -> None:
        console.print(text, style=style or None, markup=False, highlight=False, soft_wrap=True)

    line(f"FAILED  {record.id}  ({record.target})", "bold red")
    line(f"  {record.statement}  [manual {record.section}, {record.certainty}]")
    line(f"  {record.reason}")
    if record.expected:
        line(f"  expected  {record.expected}")
    if record.got:
        line(f"  got       {record.got}")
    for text in record.lines:
        line("  " + text)
    line(f"  repeat    {repeat_command(record, run)}", "dim")
    line("")


def _table(records: Sequence[VerdictRecord]) -> Table:
    from rich.table import Table

    table = Table(title=None, box=None, pad_edge=False, header_style="bold")
    table.add_column("drive")
    table.add_column("theme")
    for outcome, style in COLUMNS:
        table.add_column(outcome.word, justify="right", style=style)
    counts: dict[tuple[str, str], Counter[str]] = {}
    for record in records:
        counts.setdefault((record.target, record.theme), Counter())[record.outcome] += 1
    last = ""
    for (target, theme), counted in counts.items():
        table.add_row(target if target != last else "", theme, *(str(counted[o] or "") for o, _ in COLUMNS))
        last = target
    total = Counter(record.outcome for record in records)
    table.add_row("all", "", *(str(total[o]) for o, _ in COLUMNS), style="bold")
    return table


def _reasons(records: Sequence[VerdictRecord], console: Console) -> None:
    for outcome in (Outcome.INCONCLUSIVE, Outcome.NOT_RUN):
        reasons = Counter(r.reason for r in records if r.outcome == outcome)
        if not reasons:
            continue
        console.print(f"{outcome.value}:")
        for reason, count in reasons.most_common(REASONS):
            console.print(f"  {count:5} x {reason}", markup=False, highlight=False)
        if len(reasons) > REASONS:
            console.print(f"        and {len(reasons) - REASONS} other reasons (--json lists all)")
