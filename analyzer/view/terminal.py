"""The terminal under the view, and the end of the view when the terminal is gone (window closed, connection lost).

textual writes in its own thread. If a write fails there, that thread dies and the program waits for it for ever. So writes to
a lost terminal fail silently here, and the view checks the terminal before each drawing.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any, TextIO, cast


class _Forgiving:
    """A stream to which writing never fails; all else is as with the stream itself."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write a text, if that can be."""
        with contextlib.suppress(OSError):
            return self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush, if that can be."""
        with contextlib.suppress(OSError):
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextlib.contextmanager
def forgiving_terminal() -> Iterator[None]:
    """While this is entered, what textual writes to its terminal may fail without harm."""
    before = sys.__stderr__
    if before is None:
        yield
        return
    sys.__stderr__ = cast(TextIO, _Forgiving(before))  # type: ignore[assignment,misc]
    try:
        yield
    finally:
        sys.__stderr__ = before  # type: ignore[misc]


_ENDING = frozenset(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))


#: Signals to end that came before the loop could take them.
_came: list[int] = []


@contextlib.contextmanager
def held_signals() -> Iterator[None]:
    """While this is entered, a signal to end waits for `end_on_signals`: before, it would leave the screen as it is."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, lambda number, _: _came.append(number)) for number in _ENDING}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def end_on_signals(end: Callable[[], None]) -> None:
    """Call `end` in the running loop at a signal to end, or when the terminal closes; at once if one has come already."""
    for number in _ENDING:
        # Elsewhere than in the main thread of a Unix a loop takes no signals.
        with contextlib.suppress(NotImplementedError, RuntimeError, ValueError):
            asyncio.get_running_loop().add_signal_handler(number, end)
    if _came:
        _came.clear()
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
