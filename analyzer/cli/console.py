"""Consoles of rich whose texts are cleaned: only the escapes that rich itself makes get to the terminal."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import IO, Any, NoReturn

from rich.console import Console as RichConsole
from rich.console import ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.table import Table

from analyzer.values import printable


class Console(RichConsole):
    """A console that shows control characters of its texts instead of sending them."""

    @property
    def file(self) -> IO[str]:
        """Where rich writes: behind its own wrapper, which stands around ours while a progress is shown, and behind ours."""
        file: Any = super().file
        while (inner := getattr(file, "rich_proxied_file", None)) is not None:
            file = inner
        stream: IO[str] = file
        return stream

    @file.setter
    def file(self, new_file: IO[str]) -> None:
        self._file = new_file

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        for segment in super().render(renderable, options):
            text, style, control = segment
            yield segment if control or text.isprintable() else Segment(printable(text, "\n"), style)

    def on_broken_pipe(self) -> NoReturn:
        """Leave it to the command's boundary."""
        raise BrokenPipeError


def table(*columns: str, numbers: Collection[str] = (), **more: Any) -> Table:
    """Return a table without rows. On a narrow terminal texts go over several lines, and `numbers` stay whole."""
    made = Table(box=None, pad_edge=False, header_style="bold", **more)
    for name in columns:
        if name in numbers:
            made.add_column(name, justify="right", no_wrap=True)
        else:
            made.add_column(name, overflow="fold")
    return made
