"""Counts of every command of every address: requests, replies, rate, latency."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rich.text import Text

from analyzer.values import printable
from analyzer.view.lines import cut
from analyzer.view.rows import Rows
from analyzer.view.watch import CommandRow, Watch

#: Orders of the rows, by name.
_ORDERS: dict[str, Callable[[CommandRow], Any]] = {
    "address": lambda r: (r.bus, int(r.who) if r.who.isdigit() else -1, r.command),
    "count": lambda r: -r.total,
    "rate": lambda r: -r.rate,
    "latency": lambda r: -(r.latencies or (0, 0, -1))[2],
}


class CountsPanel(Rows):
    """Rows of commands, in an order that can be changed."""

    def __init__(self, watch: Watch) -> None:
        super().__init__(id="counts")
        self._watch = watch
        self._rows: list[CommandRow] = []
        self.order = "address"
        self._bus_width = 3

    def next_order(self) -> str:
        """Take the next order; return its name."""
        names = list(_ORDERS)
        self.order = names[(names.index(self.order) + 1) % len(names)]
        self.sync()
        return self.order

    @property
    def chosen(self) -> CommandRow | None:
        """The row under the cursor."""
        return self._rows[self.cursor] if self.cursor < len(self._rows) else None

    def sync(self) -> None:
        """Take over what has changed."""
        self._rows = sorted(self._watch.rows.values(), key=_ORDERS[self.order])
        super().sync()

    def bounds(self) -> tuple[int, int]:
        """Return the numbers of the rows."""
        return 0, len(self._rows)

    def heading(self, width: int) -> Text:
        """Return the names of the columns."""
        self._bus_width = min(10, max([3, *(len(name) for name in self._watch.buses)]))
        text = f"{'bus':<{self._bus_width}} {'addr':>4} {'command':<20}{'requests':>9}{'replies':>8}{'per s':>8}"
        text += f"{'last ms':>8}{'mean':>7}{'max':>7}"
        return Text(text, style="bold", no_wrap=True)

    def row(self, number: int, width: int) -> Text:
        """Return a command as a row."""
        row = self._rows[number]
        text = Text(no_wrap=True)
        text.append(f"{printable(row.bus)[: self._bus_width]:<{self._bus_width}} {row.who:>4} ")
        text.append(f"{cut(printable(row.command), 20):<20}", "cyan")
        text.append(f"{row.count('request'):>9}{row.count('reply'):>8}{rate_text(row.rate):>8}")
        last, mean, most = ("", "", "") if row.latencies is None else (rate_text(ns / 1e6) for ns in row.latencies)
        text.append(f"{last:>8}{mean:>7}{most:>7}")
        unknown = row.count("unknown")
        if unknown:
            text.append(f"  {unknown} of unknown role", "yellow")
        return text


def rate_text(rate: float) -> str:
    """Return a rate or milliseconds in about six characters."""
    return f"{rate:.2f}" if rate < 10 else f"{rate:.1f}" if rate < 1000 else f"{rate:.0f}"
