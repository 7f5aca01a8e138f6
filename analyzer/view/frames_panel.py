"""The frames, one row each; with a filter, only the matching frames."""

from __future__ import annotations

from rich.text import Text

from analyzer.live.snapshot import FrameLine
from analyzer.view.kept import Lines, Wanted
from analyzer.view.lines import STEP, Columns
from analyzer.view.rows import Rows
from analyzer.view.source import ViewSource


class FramesPanel(Rows):
    """Rows of frames; it follows the newest."""

    follows = True

    def __init__(self, source: ViewSource) -> None:
        super().__init__(id="frames")
        self._source = source
        self.columns = Columns(source.times)
        self.wanted: Wanted | None = None
        # A capture is read from its beginning, a recording watched at its end.
        self.following = self.follows = source.growing

    @property
    def lines(self) -> Lines:
        return self._source.lines if self.wanted is None else self.wanted

    @property
    def line(self) -> FrameLine | None:
        lines = self.lines
        return lines.line(self.cursor) if lines.first <= self.cursor < lines.stop else None

    def bounds(self) -> tuple[int, int]:
        lines = self.lines
        return lines.first, lines.stop

    def heading(self, width: int) -> Text:
        buses = self._source.watch.buses
        self.columns.bus_width = min(10, max([3, *(len(name) for name in buses)]))
        self.columns.first_ns = self._source.watch.first_ns
        return self.columns.heading(width)

    def row(self, number: int, width: int) -> Text:
        lines = self.lines
        before_ns = None
        if self.columns.time == STEP and number > lines.first:
            before_ns = lines.line(number - 1).t_ns
        return self.columns.row(lines.line(number), width, before_ns)

    def look(self, wanted: Wanted | None) -> None:
        """Show what a filter lets through, or all; the cursor stays on its frame where that is among them."""
        line = self.line
        self.wanted = wanted
        number = self.lines.number_of(line.sequence) if line is not None and line.sequence and not self.following else None
        self.top = 0
        if number is not None:
            self.put(number)
        else:
            self.cursor = self.lines.first
            self.following = self.follows
            self.sync()
            self.post_message(self.Moved(self))
