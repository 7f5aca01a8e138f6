"""The summary that `decode` ends with, as tables for people."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from rich.cells import cell_len

from analyzer.cli.reading import OpenCapture
from analyzer.records import Finding
from analyzer.reference.columns import COLOURS
from analyzer.sinks.summary import Summary
from analyzer.values import counted, identifier, printable

if TYPE_CHECKING:
    from rich.table import Table

    from analyzer.cli.console import Console

#: Nodes that are named of those that are no drives.
_OTHERS_NAMED = 12
#: Columns of the commands: names, which stand at the left, and numbers.
_NAMES, _COUNTS = ("bus", "address", "command"), ("requests", "replies", "median ms", "p99 ms", "max ms")


def milliseconds(value_ns: float) -> str:
    """Return a time in ms with three digits that matter."""
    value = value_ns / 1e6
    return f"{value:.3f}" if value < 10 else f"{value:.1f}" if value < 1000 else f"{value:.0f}"


class _Paper:
    """What a summary is printed on: a terminal, with styles, or a file or a pipe."""

    def __init__(self) -> None:
        self._styled = sys.stdout.isatty()

    @cached_property
    def _console(self) -> Console:
        # It takes about as long to load as all that a small capture needs besides.
        from analyzer.cli.console import Console

        # Into a file or a pipe there is no width to keep to.
        return Console(highlight=False, soft_wrap=True, width=None if self._styled else 140)

    def line(self, text: str, style: str = "") -> None:
        if not self._styled:
            print(printable(text))
            return
        from rich.text import Text

        self._console.print(Text(printable(text), style=style))

    def table(self, table: Table) -> None:
        self._console.print(table)


def print_summary(reading: OpenCapture, summary: Summary, target: Path, stopped: str) -> None:
    """Print the summary of a decoded capture."""
    paper = _Paper()
    line, source = paper.line, reading.source
    line(f"{source.name}: {source.format}, {', '.join(d.title for d in reading.dialects)}")
    line(f"dialect {', '.join(d.name for d in reading.dialects)} ({reading.choice.reason})")
    line(f"times: {reading.time_source}")
    for place, text in enumerate(_commands(summary)):
        line(text, "" if place else "bold")
    junk = sum(summary.junk_bytes.values())
    reasons = ", ".join(f"{n} {reason}" for reason, n in sorted(summary.junk_bytes.items()))
    total = summary.frame_bytes + junk
    line(
        f"{counted(total, 'byte')}: {summary.frame_bytes} in {counted(summary.frames, 'frame')}, {junk} junk"
        + (f" ({reasons})" if junk else "")
    )
    if summary.others:
        paper.table(_others(summary))
    for bus, who, count in summary.doubtful():
        line(f"{bus} {who}: none of {count} frames has a fitting checksum: another node? --ids says who is a drive", "yellow")
    if summary.findings:
        paper.table(_findings(summary))
    else:
        line("no findings")
    for note in source.notes:
        line(f"note: {note}", "yellow")
    if stopped:
        line(f"{stopped}: the log holds what came before", "yellow")
    line(f"wrote {target}")


def _commands(summary: Summary) -> Iterator[str]:
    """Yield a heading, and a line for each command of each drive: of hundreds, a table of rich takes long."""
    told = any(row.messages for row in summary.rows.values())
    rows = [(*_NAMES, *(("messages",) if told else ()), *_COUNTS)]
    ordered = sorted(summary.rows.items(), key=lambda i: (i[0][0], i[0][1].zfill(5), i[0][2], i[0][3]))
    for (bus, address, _dialect, name), row in ordered:
        lat = row.latencies
        times = [milliseconds(lat.quantile(0.5)), milliseconds(lat.quantile(0.99)), milliseconds(lat.greatest)]
        counts = [str(row.messages)] * told + [str(row.requests + row.unknown), str(row.replies)]
        who = identifier(int(address)) if bus in summary.can and address.isdigit() else address
        rows.append((printable(bus), who, name, *counts, *(times if lat.count else ("", "", ""))))
    widths = [max(map(cell_len, column)) for column in zip(*rows, strict=True)]
    for cells in rows:
        blanks = [" " * (width - cell_len(cell)) for width, cell in zip(widths, cells, strict=True)]
        pairs = enumerate(zip(cells, blanks, strict=True))
        shown = [cell + blank if n < len(_NAMES) else blank + cell for n, (cell, blank) in pairs]
        yield "  ".join(shown)


def _others(summary: Summary) -> Table:
    from rich.text import Text

    from analyzer.cli.console import table

    numbers = ("frames", "share", "per s", "bytes")
    found = table("bus", "not of this dialect", *numbers, numbers=numbers)
    seconds = (summary.last_ns - (summary.first_ns or 0)) / 1e9
    listed = summary.by_frames()
    more = listed[_OTHERS_NAMED:]
    rows = [(bus, who, counts[0], counts[1]) for (bus, who), counts in listed[:_OTHERS_NAMED]]
    if more:
        rows.append(("", f"and {len(more)} more", sum(c[0] for _, c in more), sum(c[1] for _, c in more)))
    for bus, who, frames, size in rows:
        rate = f"{frames / seconds:.1f}" if seconds > 0 else ""
        share = f"{100 * frames / summary.frames:.1f} %"
        found.add_row(Text(printable(bus)), who, str(frames), share, rate, str(size))
    return found


def _place(found: Finding) -> str:
    """Return where a finding is; topics have addresses in decimal, so a CAN identifier is told besides."""
    of_can = f", {found.who}" if found.who.startswith("0x") else ""
    return f"{found.topic} #{found.sequence} byte {found.offset}{of_can}: "


def _findings(summary: Summary) -> Table:
    from rich.text import Text

    from analyzer.cli.console import table

    found = table("finding", "severity", "count", "the first few", numbers=("count",))
    for rule, count in summary.findings.most_common():
        severity = summary.worst[rule]
        first = "\n".join(_place(each) + printable(each.text) for each in summary.first[rule])
        found.add_row(rule, Text(severity.value, style=COLOURS[severity]), str(count), Text(first))
    return found
