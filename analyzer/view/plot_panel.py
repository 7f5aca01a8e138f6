"""A plot of chosen fields: on the left the list of fields, on the right a chart for each chosen field.

Each chart has its own scale, with the least and the greatest value; all share the time. Reading needs no colour.
"""

from __future__ import annotations

from typing import NamedTuple

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import Horizontal
from textual.widgets import Static

from analyzer.values import printable
from analyzer.view.braille import chart
from analyzer.view.rows import Rows
from analyzer.view.source import Plot, ViewSource

#: Charts that are shown at once.
CHARTS = 4
#: Stretches of time that can be chosen, in seconds; None: all of it.
WINDOWS = (None, 600, 60, 10, 1, 0.1)
SECOND = 1_000_000_000
_COLOURS = ("cyan", "green", "yellow", "magenta")
_SCALE_WIDTH = 11
_PREFERRED = ("state.position", "state.speed")


class SeriesRows(Rows):
    """The series, those that are plotted marked with their place."""

    DEFAULT_CSS = "SeriesRows { width: 40%; max-width: 48; }"
    BINDINGS = [Binding("space", "choose", "Plot or not", show=False)]  # noqa: RUF012 (as textual has it)

    def __init__(self, source: ViewSource) -> None:
        super().__init__(id="series")
        self._source = source
        self._names: list[str] = []
        self.plotted: list[str] = []

    def sync(self) -> None:
        """Take over what has changed."""
        names = self._source.series()
        if len(names) != len(self._names):
            chosen = self.chosen
            self._names = sorted(names, key=_order)
            if chosen is not None:
                self.cursor = self._names.index(chosen)
            if not self.plotted:
                self.plotted = [n for n in self._names if n.endswith(_PREFERRED)][:2]
        super().sync()

    @property
    def chosen(self) -> str | None:
        """The series under the cursor."""
        return self._names[self.cursor] if self.cursor < len(self._names) else None

    def toggle(self) -> None:
        """Plot the series under the cursor, or plot it no more; of too many the oldest goes."""
        name = self.chosen
        if name is None:
            return
        if name in self.plotted:
            self.plotted.remove(name)
        else:
            self.plotted = [*self.plotted, name][-CHARTS:]

    def bounds(self) -> tuple[int, int]:
        """Return the numbers of the series."""
        return 0, len(self._names)

    def heading(self, width: int) -> Text:
        """Say what can be done."""
        return Text("Enter plots; + - time", style="bold", no_wrap=True)

    def row(self, number: int, width: int) -> Text:
        """Return a series as a row; of a long name the end is seen."""
        name = printable(self._names[number])
        at = self.plotted.index(self._names[number]) + 1 if self._names[number] in self.plotted else 0
        room = width - 4
        shown = name if len(name) <= room else "…" + name[len(name) - room + 1 :]
        return Text(f"{f'[{at}]' if at else '   '} {shown}", style=_COLOURS[at - 1] if at else "", no_wrap=True)


class _Asked(NamedTuple):
    """Points that were asked for."""

    names: tuple[str, ...]
    span: tuple[int, int]
    plot: Plot
    window: int = 0


class PlotPanel(Horizontal):
    """The series and their charts. `moment`: says around which time a window lies; None: it ends now."""

    def __init__(self, source: ViewSource) -> None:
        super().__init__(id="plot")
        self._source = source
        self.rows = SeriesRows(source)
        self._chart = Static(id="chart", markup=False)
        self._window = 0
        #: What is drawn, and what is being looked for to be drawn next; each with what it is of.
        self._drawn: _Asked | None = None
        self._next: _Asked | None = None
        self.moment_ns: int | None = None

    def compose(self) -> ComposeResult:
        """Put the series to the left of the charts."""
        yield self.rows
        yield self._chart

    def zoom(self, step: int) -> str:
        """Show a shorter or a longer time; return it in words."""
        self._window = min(max(self._window + step, 0), len(WINDOWS) - 1)
        window = WINDOWS[self._window]
        return "all of the time" if window is None else f"{window:g} s"

    def span(self) -> tuple[int, int]:
        """Return the time that is shown."""
        first, last = self._source.span()
        window = WINDOWS[self._window]
        if window is None:
            return first, last
        width = int(window * SECOND)
        end = last if self.moment_ns is None else min(max(self.moment_ns + width // 2, first + width), last)
        return max(first, end - width), end

    def sync(self, seconds: float = 0.02) -> None:
        """Take over what has changed, looking for points for about this long."""
        self.rows.sync()
        names, span = tuple(self.rows.plotted), self.span()
        known = self._next or self._drawn
        changed = known is None or (known.names, known.window) != (names, self._window)
        # While a capture is read its time grows; what is being looked for is finished before it is looked for again.
        grown = self._next is None and known is not None and (known.span != span or self._source.live)
        if changed or grown:
            self._next = _Asked(names, span, self._source.plot(names, *span), self._window)
        if self._next is not None:
            self._next.plot.look(seconds)
            # What was drawn stays until the next is whole, unless it is of other series.
            if self._next.plot.done:
                self._drawn, self._next = self._next, None
        shown = self._drawn if self._drawn is not None and self._drawn.names == names else self._next
        self._chart.update(self._charts(shown))

    def _charts(self, asked: _Asked | None) -> Text:
        width, height = self._chart.size
        if asked is None or not asked.names:
            return Text("no series is selected: arrow keys move, Enter adds or removes a series")
        if width < 20 or height < 4:
            return Text("too small for a chart")
        each = max(3, (height - 1) // len(asked.names))
        text = Text(no_wrap=True)
        for number, name in enumerate(asked.names):
            text.append_text(self._one(number, name, asked.plot, asked.span, (width, each)))
        text.append(self._time_axis(asked.span, width, self._next is None), "dim")
        return text

    def _one(self, number: int, name: str, plot: Plot, span: tuple[int, int], size: tuple[int, int]) -> Text:
        colour = _COLOURS[number % len(_COLOURS)]
        points = plot.points(name)
        width, height = size
        text = Text(no_wrap=True)
        if not points:
            text.append(f"[{number + 1}] {printable(name)}: no points in this time".ljust(width)[:width] + "\n", colour)
            text.append("\n" * (height - 1))
            return text
        least = min(v for _, v in points)
        greatest = max(v for _, v in points)
        title = f"[{number + 1}] {printable(name)}  last {_number(points[-1][1])}"
        text.append(title[:width] + "\n", f"bold {colour}")
        drawn = chart(points, span, (least, greatest), (width - _SCALE_WIDTH - 1, height - 1))
        for at, row in enumerate(drawn):
            label = _number(greatest) if at == 0 else _number(least) if at == len(drawn) - 1 and greatest > least else ""
            text.append(f"{label:>{_SCALE_WIDTH}}┤")
            text.append(row + "\n", colour)
        return text

    def _time_axis(self, span: tuple[int, int], width: int, done: bool) -> str:
        left, right = self._source.times.text(span[0]), self._source.times.text(span[1])
        middle = f" {(span[1] - span[0]) / SECOND:.6g} s " + ("" if done else "(looking ...) ")
        room = width - _SCALE_WIDTH - 1 - len(left)
        if room < len(right) + 1:
            right = ""
        room = max(0, room - len(right))
        return " " * (_SCALE_WIDTH + 1) + left + (middle if len(middle) <= room else "").center(room) + right


def _order(name: str) -> tuple[int, str]:
    """Put what is plotted most first: states, replies, requests, latencies."""
    kinds = ("/state." in name, ".reply." in name and not name.endswith("._latency"), ".request." in name)
    return next((at for at, kind in enumerate(kinds) if kind), len(kinds)), name


def _number(value: float) -> str:
    """Return a number in at most ten characters."""
    text = f"{value:.6g}"
    return text if len(text) <= 10 else f"{value:.3g}"
