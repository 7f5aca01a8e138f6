"""The terminal under the view, and the end of the view when the terminal is gone (window closed, connection lost).

textual writes in its own thread. If a write fails there, that thread dies and the program waits for it for ever. So writes to
a lost terminal fail silently here, and the view checks the terminal before each drawing.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
import sys
from collections.abc import Callable, Iterator
from functools import partial
from typing import TextIO, cast

from analyzer.cli.boundary import Forgiving


@contextlib.contextmanager
def forgiving_terminal() -> Iterator[None]:
    """While this is entered, what textual writes to its terminal may fail without harm."""
    before = sys.__stderr__
    if before is None:
        yield
        return
    sys.__stderr__ = cast(TextIO, Forgiving(before))  # type: ignore[assignment,misc]
    try:
        yield
    finally:
        sys.__stderr__ = before  # type: ignore[misc]


_ENDING = frozenset(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))


class EndingSignals:
    """Signals to end, while it is entered. One that comes before `on` is kept: the screen must be left in order."""

    def __init__(self) -> None:
        self._came = False
        self._told: Callable[[], object] = lambda: None

    def __enter__(self) -> EndingSignals:
        self._before = {number: signal.signal(number, self._take) for number in _ENDING}
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _take(self, number: int, frame: object) -> None:
        self._came = True
        self._told()

    def on(self, end: Callable[[], None]) -> None:
        """Call `end` in the running loop at a signal; at once if one has come already."""
        self._told = partial(asyncio.get_running_loop().call_soon_threadsafe, end)
        if self._came:
            end()


def terminal_watch() -> Callable[[], bool]:
    """Return a function that says whether the terminal of standard error has gone; where there is none it never has."""
    try:
        import termios
    except ImportError:  # not a Unix
        return lambda: False
    stream = sys.__stderr__
    if stream is None or not stream.isatty():
        return lambda: False
    number = stream.fileno()

    def gone() -> bool:
        try:
            termios.tcgetattr(number)
        except termios.error:
            return True
        return False

    return gone
