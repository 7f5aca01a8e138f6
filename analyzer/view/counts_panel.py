"""Counts of every command of every address: requests, replies, rate, latency."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rich.text import Text

from analyzer.live.snapshot import FOREIGN
from analyzer.values import printable
from analyzer.view import tree
from analyzer.view.lines import cut
from analyzer.view.rows import Rows
from analyzer.view.watch import CommandRow, Watch, number_of

_NAME_WIDTH = 30
#: Orders of the rows, by name.
_ORDERS: dict[str, Callable[[CommandRow], Any]] = {
    "address": lambda r: (r.bus, number_of(r.who), r.command),
    "count": lambda r: -r.total,
    "rate": lambda r: -r.rate,
    "latency": lambda r: -(r.latencies or (0, 0, -1))[2],
}


class CountsPanel(Rows):
    """Rows of commands: by address below their buses and drives, or in another order one below the other."""

    def __init__(self, watch: Watch) -> None:
        super().__init__(id="counts")
        self._watch = watch
        self._rows: list[tree.TreeRow[CommandRow]] = []
        self._folded: set[tree.Path] = set()
        self.order = "address"

    def next_order(self) -> str:
        names = list(_ORDERS)
        self.order = names[(names.index(self.order) + 1) % len(names)]
        self.sync()
        return self.order

    @property
    def chosen(self) -> CommandRow | None:
        return self._rows[self.cursor].leaf if self.cursor < len(self._rows) else None

    def toggle(self) -> None:
        if self.cursor < len(self._rows):
            self._folded ^= {self._rows[self.cursor].path}
            self.sync()

    def sync(self) -> None:
        ordered = sorted(self._watch.rows.values(), key=_ORDERS[self.order])
        below = self.order == "address"
        self._rows = tree.rows([((r.bus, r.who) if below else (), r) for r in ordered], lambda path: path not in self._folded)
        super().sync()

    def bounds(self) -> tuple[int, int]:
        return 0, len(self._rows)

    def heading(self, width: int) -> Text:
        where = "bus, drive, command" if self.order == "address" else "bus, drive: command"
        text = f"{where:<{_NAME_WIDTH}}{'requests':>9}{'replies':>8}{'per s':>8}{'last ms':>8}{'mean':>8}{'max':>8}"
        return Text(text, style="bold", no_wrap=True)

    def row(self, number: int, width: int) -> Text:
        """Return a command as a row, or a branch with the sums of its commands."""
        row = self._rows[number]
        if row.leaf is None:
            below = [r for r in self._watch.rows.values() if (r.bus, r.who)[: len(row.path)] == row.path]
            what = "node" if all(r.command == FOREIGN for r in below) else "drive"
            label = row.label(f"{what} {row.path[1]}" if len(row.path) == 2 and number_of(row.path[1]) >= 0 else "")
            return self._counted(label, below, Text(no_wrap=True, style="bold"))
        label = row.label(row.leaf.command) if row.path else f"{row.leaf.bus} {row.leaf.who}: {row.leaf.command}"
        text = self._counted(label, [row.leaf], Text(no_wrap=True))
        times = ("", "", "") if row.leaf.latencies is None else (rate_text(ns / 1e6) for ns in row.leaf.latencies)
        text.append("".join(f"{each:>8}" for each in times))
        foreign = row.leaf.count(FOREIGN)
        if foreign:
            text.append(f"  {foreign} not of this dialect", "dim")
        unknown = row.leaf.count("unknown")
        return text.append(f"  {unknown} of unknown role", "yellow") if unknown else text

    @staticmethod
    def _counted(label: str, rows: Sequence[CommandRow], text: Text) -> Text:
        text.append(f"{cut(printable(label), _NAME_WIDTH - 1):<{_NAME_WIDTH}}", "cyan" if len(rows) == 1 else "")
        requests, replies = sum(r.count("request") for r in rows), sum(r.count("reply") for r in rows)
        return text.append(f"{requests:>9}{replies:>8}{rate_text(sum(r.rate for r in rows)):>8}")


def rate_text(rate: float) -> str:
    """Return a rate or milliseconds in about six characters."""
    return f"{rate:.2f}" if rate < 10 else f"{rate:.1f}" if rate < 1000 else f"{rate:.0f}"
