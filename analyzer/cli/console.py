"""Consoles of rich whose texts are cleaned: only the escapes that rich itself makes get to the terminal."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NoReturn

from rich.console import Console as RichConsole
from rich.console import ConsoleOptions, RenderableType
from rich.segment import Segment

from analyzer.values import printable


class Console(RichConsole):
    """A console that shows control characters of its texts instead of sending them."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render, with clean texts."""
        for segment in super().render(renderable, options):
            text, style, control = segment
            yield segment if control or text.isprintable() else Segment(printable(text, "\n"), style)

    def on_broken_pipe(self) -> NoReturn:
        """Leave it to the command's boundary."""
        raise BrokenPipeError
