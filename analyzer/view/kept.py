"""Lists by number: the newest lines of an endless sequence, and those that a filter selects.

An item keeps its number while older items are dropped, so a cursor stays on its item.
"""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from analyzer.live.snapshot import FrameLine

T = TypeVar("T")


class Lines(Protocol):
    """Frames by number, `first` to `stop` - 1."""

    first: int

    @property
    def stop(self) -> int:
        """One more than the number of the newest."""

    def line(self, number: int) -> FrameLine:
        """Return one of them. Raises IndexError for a number that is not kept."""

    def number_of(self, sequence: int) -> int | None:
        """Return the number of the frame with a sequence, None where it is not among them."""


class Kept(Generic[T]):
    """The newest `limit` items (or somewhat more)."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._items: list[T] = []
        self.first = 0

    @property
    def stop(self) -> int:
        return self.first + len(self._items)

    def append(self, item: T) -> None:
        """Add an item; the oldest go where there are too many."""
        self._items.append(item)
        if len(self._items) > self._limit + self._limit // 8:
            excess = len(self._items) - self._limit
            del self._items[:excess]
            self.first += excess

    def item(self, number: int) -> T:
        """Return an item. Raises IndexError for a number that is not kept."""
        if not self.first <= number < self.stop:
            raise IndexError(number)
        return self._items[number - self.first]

    def put(self, number: int, item: T) -> None:
        """Put another item in the place of one. Raises IndexError for a number that is not kept."""
        if not self.first <= number < self.stop:
            raise IndexError(number)
        self._items[number - self.first] = item


class KeptLines(Kept[FrameLine]):
    """The newest frames, by sequence; events stand among them with the sequence 0."""

    def line(self, number: int) -> FrameLine:
        return self.item(number)

    def number_of(self, sequence: int) -> int | None:
        """Return the number of the frame with a sequence. Sequences grow, so the search halves."""
        low, high = self.first, self.stop
        while low < high:
            middle = (low + high) // 2
            if self._sequence_from(middle) < sequence:
                low = middle + 1
            else:
                high = middle
        while low < self.stop and self.item(low).sequence == 0:
            low += 1
        return low if low < self.stop and self.item(low).sequence == sequence else None

    def _sequence_from(self, number: int) -> int:
        """Return the sequence of an item, or of the next one that has one."""
        while number < self.stop:
            sequence = self.item(number).sequence
            if sequence:
                return sequence
            number += 1
        return 1 << 62


class Wanted(Lines):
    """Those lines for which a test holds, as far as they have been looked at; numbered among themselves."""

    def __init__(self, lines: Lines) -> None:
        self._lines = lines
        self.looked = lines.first

    @property
    def done(self) -> bool:
        """Whether all lines that are there have been looked at."""
        return self.looked >= self._lines.stop

    @abstractmethod
    def look(self, seconds: float) -> None:
        """Look at further lines for about this long, so that the caller stays responsive."""


class WantedKept(KeptLines, Wanted):
    """Of lines that come and go: what is wanted is kept on its own, longer than the others."""

    def __init__(self, lines: Lines, test: Callable[[FrameLine], bool], limit: int) -> None:
        KeptLines.__init__(self, limit)
        Wanted.__init__(self, lines)
        self._test = test

    def look(self, seconds: float) -> None:
        lines, test = self._lines, self._test
        until = time.perf_counter() + seconds
        number = max(self.looked, lines.first)
        while number < lines.stop:
            line = lines.line(number)
            if test(line):
                self.append(line)
            number += 1
            if number % 16 == 0 and time.perf_counter() >= until:
                break
        self.looked = number
