"""A plot of chosen fields: on the left the tree of buses, drives and fields, on the right a chart for each chosen field.

Each chart has its own scale with round ticks and a unit; all share the time. A cursor reads out their values. Reading needs
no colour.
"""

from __future__ import annotations

from typing import ClassVar, NamedTuple

from rich.text import Text
from textual import events
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal
from textual.widgets import Static

from analyzer.values import SECOND_NS, printable
from analyzer.view import tree
from analyzer.view.rows import Rows
from analyzer.view.scale import SCALE_WIDTH, number_text, scaled, time_axis
from analyzer.view.series import Point
from analyzer.view.source import Plot, ViewSource
from analyzer.view.watch import number_of

#: Charts that are shown at once.
CHARTS = 4
#: Stretches of time that can be chosen, in seconds; None: all of it.
WINDOWS = (None, 600, 60, 10, 1, 0.1)
_COLOURS = ("cyan", "green", "yellow", "magenta")
_PREFERRED = ("state.position", "state.speed")


class SeriesRows(Rows):
    """The series below their buses and drives, those that are plotted marked with their place."""

    DEFAULT_CSS = "SeriesRows { width: 40%; max-width: 40; }"
    BINDINGS: ClassVar[list[BindingType]] = [Binding("space", "choose", "Plot or not", show=False)]

    def __init__(self, source: ViewSource) -> None:
        super().__init__(id="series")
        self._source = source
        self.units: dict[str, str] = {}
        self._rows: list[tree.TreeRow[str]] = []
        #: Branches that are not as they were at first.
        self._turned: set[tree.Path] = set()
        self.plotted: list[str] = []

    def sync(self) -> None:
        units = self._source.series()
        if len(units) != len(self.units):
            self.units = units
            first = not self.plotted
            if first:
                self.plotted = [n for n in sorted(units, key=_order) if n.endswith(_PREFERRED)][:2]
            self._fill()
            if first and self.plotted:
                self.cursor = next(at for at, row in enumerate(self._rows) if row.leaf == self.plotted[0])
        super().sync()

    def _fill(self) -> None:
        """Make the rows; the cursor stays on its own."""
        under = self._rows[self.cursor].path if self.cursor < len(self._rows) else None
        leaf = self.chosen
        self._rows = tree.rows([(_path(name), name) for name in sorted(self.units, key=_order)], self._is_open)
        for at, row in enumerate(self._rows):
            if (row.path, row.leaf) == (under, leaf):
                self.cursor = at

    def _is_open(self, path: tree.Path) -> bool:
        """Say whether a branch is open: at first buses, drives and states are."""
        return (len(path) < 3 or path[-1] == "state") != (path in self._turned)

    @property
    def chosen(self) -> str | None:
        return self._rows[self.cursor].leaf if self.cursor < len(self._rows) else None

    def toggle(self) -> None:
        """Plot the series under the cursor, or plot it no more; of too many the oldest goes. Open or close a branch."""
        name = self.chosen
        if name is not None:
            if name in self.plotted:
                self.plotted.remove(name)
            else:
                self.plotted = [*self.plotted, name][-CHARTS:]
        elif self._rows:
            self._turned ^= {self._rows[self.cursor].path}
            self._fill()

    def bounds(self) -> tuple[int, int]:
        return 0, len(self._rows)

    def heading(self, width: int) -> Text:
        return Text("Enter plots; ← → read out; + - time", style="bold", no_wrap=True)

    def row(self, number: int, width: int) -> Text:
        row = self._rows[number]
        if row.leaf is None:
            named = f"drive {row.path[1]}" if len(row.path) == 2 and number_of(row.path[1]) >= 0 else ""
            return Text("    " + printable(row.label(named)), style="bold" if len(row.path) < 3 else "", no_wrap=True)
        at = self.plotted.index(row.leaf) + 1 if row.leaf in self.plotted else 0
        label = row.label(row.leaf.rsplit(".", 1)[-1].removeprefix("_"))
        text = Text(f"{f'[{at}]' if at else '   '} {printable(label)}", style=_COLOURS[at - 1] if at else "", no_wrap=True)
        return text.append(f" {self.units[row.leaf]}", "dim") if self.units[row.leaf] else text


class _Asked(NamedTuple):
    """Points that were asked for."""

    names: tuple[str, ...]
    span: tuple[int, int]
    plot: Plot
    view: tuple[int, int | None] = (0, None)


class PlotPanel(Horizontal):
    """The series and their charts. `moment_ns`: around which time a window lies; None: it ends now."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left", "cursor(-1)", "Read out", show=False),
        Binding("right", "cursor(1)", "Read out", show=False),
        Binding("shift+left", "cursor(-10)", "Read out", show=False),
        Binding("shift+right", "cursor(10)", "Read out", show=False),
    ]

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
        #: The time under the cursor, and the centre of a window that was moved to show it.
        self.cursor_ns: int | None = None
        self._centre_ns: int | None = None

    def compose(self) -> ComposeResult:
        yield self.rows
        yield self._chart

    # --- moving ---------------------------------------------------------------------------------------------------

    def zoom(self, step: int) -> str:
        """Show a shorter or a longer time, around the cursor if there is one; return it in words."""
        self._window = min(max(self._window + step, 0), len(WINDOWS) - 1)
        self._centre_ns = self.cursor_ns
        window = WINDOWS[self._window]
        return "all of the time" if window is None else f"{window:g} s"

    def span(self) -> tuple[int, int]:
        first, last = self._source.span()
        window = WINDOWS[self._window]
        if window is None:
            return first, last
        width = int(window * SECOND_NS)
        middle = self.moment_ns if self._centre_ns is None else self._centre_ns
        end = last if middle is None else min(max(middle + width // 2, first + width), last)
        return max(first, end - width), end

    def action_cursor(self, columns: int) -> None:
        """Move the time that is read out by some columns; at first it stands in the middle."""
        first, last = self.span()
        step = max(1, (last - first) // max(1, self._columns))
        place = (first + last) // 2 if self.cursor_ns is None else self.cursor_ns + columns * step
        self._read_out(place)

    def _read_out(self, t_ns: int) -> None:
        whole = self._source.span()
        self.cursor_ns = min(max(t_ns, whole[0]), whole[1])
        if not self.span()[0] <= self.cursor_ns <= self.span()[1]:
            self._centre_ns = self.cursor_ns
        self.sync()

    def no_cursor(self) -> bool:
        """Read out no more; say whether it did."""
        had = self.cursor_ns is not None
        self.cursor_ns = self._centre_ns = None
        return had

    def on_click(self, event: events.Click) -> None:
        """Read out the time that was clicked."""
        column = event.screen_x - self._chart.region.x - SCALE_WIDTH - 1
        if 0 <= column < self._columns:
            first, last = self.span()
            self._read_out(first + (last - first) * (2 * column + 1) // (2 * self._columns))

    @property
    def _columns(self) -> int:
        """How wide the charts are, without their scales."""
        return self._chart.size.width - SCALE_WIDTH - 1

    # --- drawing --------------------------------------------------------------------------------------------------

    def sync(self, seconds: float = 0.02) -> None:
        """Take over what has changed, looking for points for about this long."""
        self.rows.sync()
        names, span = tuple(self.rows.plotted), self.span()
        view = (self._window, self._centre_ns)
        known = self._next or self._drawn
        changed = known is None or (known.names, known.view) != (names, view)
        # While a capture is read its time grows; what is being looked for is finished before it is looked for again.
        grown = self._next is None and known is not None and (known.span != span or self._source.live)
        if changed or grown:
            self._next = _Asked(names, span, self._source.plot(names, *span), view)
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
        if width < 20 or height < 5:
            return Text("too small for a chart")
        each = max(3, (height - 2) // len(asked.names))
        text = Text(no_wrap=True)
        for number, name in enumerate(asked.names):
            text.append_text(self._one(number, name, asked.plot.points(name), asked.span, (width, each)))
        text.append(self._time_axis(asked.span, width, self._next is None), "dim")
        return text

    def _one(self, number: int, name: str, points: list[Point], span: tuple[int, int], size: tuple[int, int]) -> Text:
        colour = _COLOURS[number % len(_COLOURS)]
        width, height = size
        text = Text(no_wrap=True)
        if not points:
            text.append(f"[{number + 1}] {printable(_short(name))}: no points in this time".ljust(width)[:width] + "\n", colour)
            text.append("\n" * (height - 1))
            return text
        unit = self.rows.units.get(name, "")
        # The label of the axis stands above it.
        text.append(f"{unit[:SCALE_WIDTH]:>{SCALE_WIDTH}} ")
        room = width - SCALE_WIDTH - 1
        what, said = printable(_short(name)), self._said(points, span, unit)
        # Where room is short, the drive goes first, which the tree tells, and then the time.
        field = what.partition(" ")[2]
        titles = [
            f"[{number + 1}] {each}"
            for each in (f"{what}  {said}", f"{field}  {said}", f"{field}  {said.partition(' at ')[0]}")
        ]
        text.append(next((t for t in titles if len(t) <= room), titles[-1][:room]) + "\n", f"bold {colour}")
        cursor = self._column(span)
        for scale, row in scaled(points, span, room, height - 1):
            text.append(scale)
            if cursor is None:
                text.append(row + "\n", colour)
            else:
                text.append(row[:cursor], colour)
                text.append("│" if row[cursor] == " " else row[cursor], "bold" if row[cursor] == " " else f"bold {colour}")
                text.append(row[cursor + 1 :] + "\n", colour)
        return text

    def _column(self, span: tuple[int, int]) -> int | None:
        """Return the column of the cursor, None where it is not seen."""
        if self.cursor_ns is None or not span[0] <= self.cursor_ns <= span[1] or self._columns < 1:
            return None
        return min(self._columns - 1, (self.cursor_ns - span[0]) * self._columns // max(1, span[1] - span[0]))

    def _said(self, points: list[Point], span: tuple[int, int], unit: str) -> str:
        """Return what a series says at the cursor: the last value until then, and its time. Without a cursor the newest."""
        column = self._column(span)
        if column is None:
            return f"last {number_text(points[-1][1])} {unit}".rstrip()
        # A point in the column of the cursor is what one points at.
        end_ns = span[0] + (span[1] - span[0]) * (column + 1) // self._columns
        before = [point for point in points if point[0] <= end_ns]
        if not before:
            return "nothing yet at the cursor"
        t_ns, value = before[-1]
        return f"{number_text(value)} {unit}".rstrip() + f" at {self._source.times.text(t_ns)[:-3].strip()}"

    def _time_axis(self, span: tuple[int, int], width: int, done: bool) -> str:
        """Return the axis below the charts: round times, what they are, and how much time it is."""
        zone = self._source.times.zone or "s"
        length = f"{(span[1] - span[0]) / SECOND_NS:.4g} s"
        return time_axis(span, width - SCALE_WIDTH - 1, self._source.times, zone if done else "looking", length)


def _path(name: str) -> tree.Path:
    """Return the branches above a series: its bus, its drive, and its state or frame."""
    bus, who, rest = name.rsplit("/", 2)
    return bus, who, rest.rsplit(".", 1)[0].replace(".", " ")


def _short(name: str) -> str:
    """Return a series as its chart names it: a quantity of the state by its name alone."""
    bus, who, kind = _path(name)
    field = name.rsplit(".", 1)[-1].removeprefix("_")
    return f"{bus}/{who} {field if kind == 'state' else f'{kind} {field}'}"


def _order(name: str) -> tuple[str, tuple[int, str], int, str]:
    """Put together what is of one drive, what is plotted most first: states, replies, requests."""
    bus, who, kind = _path(name)
    rank = next((at for at, end in enumerate(("state", " reply", " request")) if kind.endswith(end)), 3)
    return bus, (number_of(who), who), rank, f"{kind}.{'~' * name.endswith('._latency')}{name}"
