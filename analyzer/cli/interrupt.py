"""Ctrl-C and other ends from outside, between items: what has been read is decoded to its end, nothing is cut in two."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterable, Iterator
from types import FrameType
from typing import Any, TypeVar

T = TypeVar("T")


class _Stop(Exception):
    """Ctrl-C while waiting for input."""


#: What ends the work, in the words that are shown. Not every system has all of them.
_SIGNALS = {
    number: text
    for name, text in (("SIGINT", "Ctrl-C"), ("SIGTERM", "SIGTERM"), ("SIGHUP", "a terminal that closed (SIGHUP)"))
    if (number := getattr(signal, name, None)) is not None
}


class Interrupt:
    """While this is entered, Ctrl-C (and SIGTERM, SIGHUP) end `items` instead of raising; `asked` says which came.

    Works in the main thread; elsewhere signals do not arrive and nothing changes.
    """

    def __init__(self) -> None:
        self.asked = ""
        self._reading = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Interrupt:
        """Take the signals over."""
        # Elsewhere than in the main thread signals cannot be taken over, and do not arrive.
        with contextlib.suppress(ValueError):
            for number in _SIGNALS:
                self._before[number] = signal.signal(number, self._arrived)
        return self

    def __exit__(self, *exception: object) -> None:
        """Give the signals back."""
        for number, before in self._before.items():
            signal.signal(number, before)

    def _arrived(self, number: int, frame: FrameType | None) -> None:
        self.asked = _SIGNALS[number]
        if self._reading:
            # A read that waits would go on waiting: only there the signal has to break in.
            raise _Stop

    def items(self, source: Iterable[T]) -> Iterator[T]:
        """Yield the items of a source until it ends or Ctrl-C comes."""
        iterator = iter(source)
        try:
            while not self.asked:
                self._reading = True
                item = next(iterator)
                self._reading = False
                yield item
        except (_Stop, StopIteration):
            return
        finally:
            self._reading = False
