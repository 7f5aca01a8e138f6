"""Rows with a cursor: a widget that draws only the visible rows, so a list of millions costs as much as a list of twenty.

Rows have numbers, `first` to `stop` - 1; old numbers can vanish while the widget is shown. The widget follows the end until
the cursor leaves the last row, and again when it returns.
"""

from __future__ import annotations

from abc import ABCMeta, abstractmethod
from typing import ClassVar

from rich.segment import Segment
from rich.style import Style
from rich.text import Text
from textual import events
from textual.binding import Binding, BindingType
from textual.message import Message
from textual.strip import Strip
from textual.widget import Widget

#: The row under the cursor: its colours stay, the ground behind them is lifted.
_CURSOR = Style(bgcolor="#2d3f58", bold=True)


class _AbstractWidget(type(Widget), ABCMeta):  # type: ignore[misc]  # textual gives its widgets a metaclass of their own
    """What makes a widget class that cannot be made while a method is missing."""


class Rows(Widget, can_focus=True, metaclass=_AbstractWidget):  # type: ignore[metaclass]  # as above
    """A heading and rows; a subclass says what they are.

    The last column shows where in the whole the rows stand.
    """

    DEFAULT_CSS = "Rows { height: 1fr; }"
    #: Whether it begins by following the end.
    follows = False

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up,k", "move(-1)", "Up", show=False),
        Binding("down,j", "move(1)", "Down", show=False),
        Binding("pageup,ctrl+b", "page(-1)", "Page up", show=False),
        Binding("pagedown,ctrl+f", "page(1)", "Page down", show=False),
        Binding("home,g", "begin", "First", show=False),
        Binding("end,G", "end", "Last", show=False),
        Binding("enter", "choose", "Choose", show=False),
    ]

    class Moved(Message):
        """The cursor stands on another row."""

        def __init__(self, rows: Rows) -> None:
            super().__init__()
            self.rows = rows

        @property
        def control(self) -> Rows:
            """The widget it is about."""
            return self.rows

    class Chosen(Moved):
        """A row was chosen with Enter or a second click."""

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self.cursor = 0
        self.top = 0
        self.following = self.follows

    # --- what a subclass says -------------------------------------------------------------------------------------

    @abstractmethod
    def bounds(self) -> tuple[int, int]:
        """Return the number of the first row, and one more than that of the last."""

    @abstractmethod
    def heading(self, width: int) -> Text:
        """Return the line above the rows."""

    @abstractmethod
    def row(self, number: int, width: int) -> Text:
        """Return a row."""

    # --- moving ---------------------------------------------------------------------------------------------------

    @property
    def page(self) -> int:
        """Rows that are seen at once."""
        return max(1, self.size.height - 1)

    def sync(self) -> None:
        """Take over what has changed in the rows; cheap where nothing has."""
        self._settle()
        self.refresh()

    def _settle(self) -> None:
        first, stop = self.bounds()
        last = max(first, stop - 1)
        before = self.cursor
        self.cursor = last if self.following else min(max(self.cursor, first), last)
        if self.cursor < self.top:
            self.top = self.cursor
        elif self.cursor >= self.top + self.page:
            self.top = self.cursor - self.page + 1
        self.top = max(first, min(self.top, max(first, stop - self.page)))
        if self.cursor != before:
            self.post_message(self.Moved(self))

    def put(self, number: int) -> None:
        """Put the cursor on a row, in the middle of the page if it was not seen."""
        first, stop = self.bounds()
        self.following = self.follows and number >= stop - 1
        self.cursor = min(max(number, first), max(first, stop - 1))
        if not self.top <= self.cursor < self.top + self.page:
            self.top = self.cursor - self.page // 2
        self.post_message(self.Moved(self))
        self.sync()

    def action_move(self, step: int) -> None:
        first, stop = self.bounds()
        target = min(max(self.cursor + step, first), max(first, stop - 1))
        self.following = self.follows and step > 0 and target >= stop - 1
        if target != self.cursor:
            self.cursor = target
            self.post_message(self.Moved(self))
        self.sync()

    def action_page(self, pages: int) -> None:
        self.action_move(pages * max(1, self.page - 1))

    def action_begin(self) -> None:
        first, stop = self.bounds()
        self.action_move(first - self.cursor if stop > first else 0)

    def action_end(self) -> None:
        _, stop = self.bounds()
        self.action_move(max(1, stop - 1 - self.cursor))
        self.following = self.follows

    def action_choose(self) -> None:
        first, stop = self.bounds()
        if stop > first:
            self.post_message(self.Chosen(self))

    def on_mouse_scroll_up(self, event: events.MouseScrollUp) -> None:
        event.stop()
        self.action_move(-3)

    def on_mouse_scroll_down(self, event: events.MouseScrollDown) -> None:
        event.stop()
        self.action_move(3)

    def on_click(self, event: events.Click) -> None:
        """Put the cursor where the mouse is; a second click chooses."""
        number = self.top + event.y - 1
        first, stop = self.bounds()
        if event.y < 1 or not first <= number < stop:
            return
        if number == self.cursor:
            self.action_choose()
        else:
            self.put(number)

    def on_resize(self) -> None:
        self.sync()

    # --- drawing --------------------------------------------------------------------------------------------------

    def render_line(self, y: int) -> Strip:
        width, height = self.size
        style = self.rich_style
        if y == 0:
            return self._strip(self.heading(width - 1), width, style, " ")
        first, stop = self.bounds()
        number = self.top + y - 1
        mark = self._scroll_mark(y - 1, height - 1, first, stop)
        if not first <= number < stop:
            return self._strip(Text(""), width, style, mark)
        text = self.row(number, width - 1)
        if number == self.cursor:
            text = text.copy()
            text.truncate(width - 1, pad=True)
            text.stylize(_CURSOR)
        return self._strip(text, width, style, mark)

    def _strip(self, text: Text, width: int, style: Style, mark: str) -> Strip:
        text.truncate(width - 1, pad=True)
        segments = [*text.render(self.app.console), Segment(mark)]
        return Strip([s for s in segments if s.text != "\n" and s.text]).adjust_cell_length(width).apply_style(style)

    def _scroll_mark(self, y: int, height: int, first: int, stop: int) -> str:
        count = stop - first
        if count <= height or height <= 0:
            return " "
        size = max(1, height * height // count)
        start = (self.top - first) * (height - size) // max(1, count - height)
        return "█" if start <= y < start + size else "│"
