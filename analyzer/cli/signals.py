"""Signals that end a program: Ctrl-C (SIGINT), SIGTERM and SIGHUP, and how a command ends in order at one of them.

Signals reach the main thread alone. In another thread nothing is taken over, and nothing changes.

Whoever reads our output may stall (`| less`, a terminal that stands still). Python takes a write up again behind a signal, so
one that waits for such a reader would wait on for ever. A stream that takes nothing when a signal arrives is given up.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
from collections.abc import Callable, Iterable, Iterator
from types import FrameType
from typing import Any, TypeVar

T = TypeVar("T")

#: Number of each signal that ends a program -> its name for users. Not every system has all of them.
ENDING = {
    number: text
    for name, text in (("SIGINT", "Ctrl-C"), ("SIGTERM", "SIGTERM"), ("SIGHUP", "a terminal that closed (SIGHUP)"))
    if (number := getattr(signal, name, None)) is not None
}


#: The output and the errors, as descriptors, and milliseconds in which a reader that has not stalled takes something.
_STREAMS, _STALLED_MS = (1, 2), 500
#: The last of these signals that a handler took since a command began.
_last = signal.SIGINT


def begin() -> None:
    """Begin a command: no signal has arrived."""
    global _last
    _last = signal.SIGINT


def ended_status() -> int:
    """Return the exit status of a command that a signal has ended, as a shell tells it: 130 for Ctrl-C, 143 for SIGTERM."""
    return 128 + _last


def ended_by() -> str:
    """Return the name for users of the signal that has ended a command."""
    return ENDING[_last]


@contextlib.contextmanager
def handled(handler: Any) -> Iterator[None]:
    """Let `handler` take the signals that end a program, as `signal.signal` does; not a SIGHUP that `nohup` has it ignore."""

    def taken(number: int, frame: FrameType | None) -> None:
        global _last
        _last = signal.Signals(number)
        # Before: a handler says things, too.
        _leave_stalled()
        handler(number, frame)

    before: dict[int, Any] = {}
    with contextlib.suppress(ValueError):
        for number in ENDING:
            if signal.getsignal(number) is not signal.SIG_IGN or number != getattr(signal, "SIGHUP", None):
                before[number] = signal.signal(number, taken if callable(handler) else handler)
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


def _leave_stalled() -> None:
    """Send nowhere what is written to a stream whose reader has stalled, also what waits for it now."""
    for stream in _STREAMS if hasattr(select, "poll") else ():
        waiting = select.poll()
        waiting.register(stream, select.POLLOUT)
        if not waiting.poll(_STALLED_MS):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, stream)
            os.close(nowhere)


class _Stop(BaseException):
    """A signal arrived while the program waited for input. No reader takes it for damage of what it reads."""


class Interrupt:
    """While this is entered, a signal ends `items` instead of raising; `asked` is its name, `place` how far the work is.

    It acts between items: what was read is decoded to its end, and nothing is cut in two.
    """

    def __init__(self) -> None:
        self.asked = ""
        self.place = 0
        self._reading = False
        self._handled: contextlib.AbstractContextManager[None]

    def __enter__(self) -> Interrupt:
        self._handled = handled(self._arrived)
        self._handled.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        self._handled.__exit__(None, None, None)

    def _arrived(self, number: int, frame: FrameType | None) -> None:
        self.asked = ENDING[number]
        if self._reading:
            # A read that waits would go on waiting: only there the signal has to break in.
            raise _Stop

    def reached(self, place: int) -> None:
        """Note how far the work is. Raises KeyboardInterrupt if a signal has arrived."""
        self.place = place
        if self.asked:
            raise KeyboardInterrupt

    def opened(self, call: Callable[[], T]) -> T:
        """Return what a call gives that may wait for input. A signal ends it as Ctrl-C does."""
        self._reading = True
        try:
            if self.asked:
                raise _Stop
            return call()
        except _Stop:
            raise KeyboardInterrupt from None
        finally:
            self._reading = False

    def items(self, source: Iterable[T]) -> Iterator[T]:
        """Yield the items of a source until it ends or a signal arrives."""
        iterator = iter(source)
        try:
            while True:
                # Asked behind it: a signal comes before, or breaks in.
                self._reading = True
                if self.asked:
                    return
                item = next(iterator)
                self._reading = False
                yield item
        except (_Stop, StopIteration):
            return
        finally:
            self._reading = False
