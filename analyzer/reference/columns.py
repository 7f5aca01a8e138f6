"""Plain columns for the terminal and for pipes: the same text in both, but for colours, which only a terminal gets."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Sequence
from textwrap import wrap

from analyzer.records import Severity

#: Reference pages keep to this width wherever they are shown, so that their output is stable.
WIDTH = 100
#: The style of each severity.
COLOURS = {Severity.ERROR: "red", Severity.WARNING: "yellow", Severity.INFO: "cyan"}
_GAP = "  "
_STYLES = {"bold": "1", "red": "31", "yellow": "33", "cyan": "36"}


def styled(text: str, style: str) -> str:
    """Return a text in a style if standard output is a terminal that wants colours, else the text."""
    if not sys.stdout.isatty() or os.environ.get("NO_COLOR"):
        return text
    return f"\x1b[{_STYLES[style]}m{text}\x1b[0m"


def columns(rows: Iterable[Sequence[str]], *, width: int = 0, indent: str = "") -> list[str]:
    """Return rows of texts as lines of aligned columns; the last column is wrapped to `width`, 0 for never."""
    table = [tuple(row) for row in rows]
    if not table:
        return []
    widths = [max((len(row[i]) for row in table), default=0) for i in range(len(table[0]))]
    lead = len(indent) + sum(w + len(_GAP) for w in widths[:-1])
    lines = []
    for row in table:
        cells = [cell.ljust(w) for cell, w in zip(row[:-1], widths[:-1], strict=True)]
        last = wrap(row[-1], max(20, width - lead)) if width else [row[-1]]
        for index, part in enumerate(last or [""]):
            start = indent + "".join(c + _GAP for c in cells) if index == 0 else " " * lead
            lines.append((start + part).rstrip())
    return lines


def paragraph(text: str, *, indent: str = "", hang: str = "") -> list[str]:
    """Return a text wrapped to the usual width; lines after the first begin with `indent` and `hang`."""
    return wrap(text, WIDTH, initial_indent=indent, subsequent_indent=indent + hang) or [indent.rstrip()]
