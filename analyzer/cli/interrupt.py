"""Ctrl-C between items: whatever has been read is decoded to its end, and nothing is cut in the middle."""

from __future__ import annotations

import signal
from collections.abc import Iterable, Iterator
from types import FrameType
from typing import Any, TypeVar

T = TypeVar("T")


class _Stop(Exception):
    """Ctrl-C while waiting for input."""


class Interrupt:
    """While this is entered, Ctrl-C ends `items` instead of raising; `asked` says that it came.

    Works in the main thread; elsewhere signals do not arrive and nothing changes.
    """

    def __init__(self) -> None:
        self.asked = False
        self._reading = False
        self._before: Any = None
        self._set = False

    def __enter__(self) -> Interrupt:
        """Take Ctrl-C over."""
        try:
            self._before = signal.signal(signal.SIGINT, self._arrived)
            self._set = True
        except ValueError:  # not the main thread
            self._set = False
        return self

    def __exit__(self, *exception: object) -> None:
        """Give Ctrl-C back."""
        if self._set:
            signal.signal(signal.SIGINT, self._before)

    def _arrived(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
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
