"""The bytes that a reader has taken from its port and not stored yet, in memory that outlives the reader.

    numbers, u64 each | counts of the kernel, i64 each | bytes as they were read | filling

The memory is the supervisor's; each reader of a port inherits it. The kernel itself puts the bytes of a read there. So the
next reader finds them, even if this one is killed at any instant. Before a read, the memory gets the number of waiting bytes
and random bytes in their place, the filling. If the filling is still there, the read did not happen. Real bytes can equal the
filling by chance: one byte does so once in 256 times.

The memory also has the kernel's counts of what it lost, as they were told last. So the next reader tells what the kernel lost
while there was no reader. If a reader is killed as it tells, the same is told twice.
"""

from __future__ import annotations

import mmap
import os
import time
from collections.abc import Sequence
from typing import NamedTuple

#: Bytes read in a row before they are stored; what a tty of Linux holds at most.
DRAIN_LIMIT = 1 << 17
READ_SIZE = 1 << 16
_ROOM = DRAIN_LIMIT + READ_SIZE
_NUMBERS = 8
#: How many counts there are, and the counts.
_COUNTS = 8
_HEAD = (_NUMBERS + _COUNTS) * 8
#: Places of the numbers: units stored, and taken at all; time of the last record. Units before the bytes in hand, how many
#: these are, how many with those of the read under way, and when that began.
_STORED, _TAKEN, _LAST_NS, _BEFORE, _SIZE, _WANTED, _READ_NS = range(7)


class Left(NamedTuple):
    """What a reader that died has left.

    `stored`: bytes or frames in its spool; `lost`: later ones that were taken and are gone. `data`: bytes in hand behind
    these; `t_ns`: the time by which they had come.
    """

    stored: int
    last_ns: int
    lost: int
    data: bytes
    t_ns: int


class Hand:
    """The memory behind a descriptor that `make` has returned."""

    def __init__(self, fd: int) -> None:
        memory = memoryview(mmap.mmap(fd, _HEAD + 2 * _ROOM))
        self._numbers = memory[: _NUMBERS * 8].cast("Q")
        self._counts = memory[_NUMBERS * 8 : _HEAD].cast("q")
        self._room = memory[_HEAD : _HEAD + _ROOM]
        self._filling = memory[_HEAD + _ROOM :]

    @staticmethod
    def make() -> int | None:
        """Return a descriptor of new memory; None on a system that has none of this kind."""
        if not hasattr(os, "memfd_create"):
            return None
        fd = os.memfd_create("servotap-hand")
        os.ftruncate(fd, _HEAD + 2 * _ROOM)
        with mmap.mmap(fd, 0) as memory:
            memory[-_ROOM:] = os.urandom(_ROOM)
        return fd

    def keep(self, taken: int, last_ns: int, *, stored: bool) -> None:
        """Note how much was taken, up to when, and whether all of it is stored."""
        numbers = self._numbers
        numbers[_TAKEN], numbers[_LAST_NS] = taken, last_ns
        if stored:
            numbers[_STORED] = taken

    @property
    def counts(self) -> tuple[int, ...]:
        """The kernel's counts as they were told last, by this reader or one before it; empty where none were."""
        return tuple(self._counts[1 : 1 + self._counts[0]])

    @counts.setter
    def counts(self, values: Sequence[int]) -> None:
        self._counts[0] = 0
        for place, value in enumerate(values, 1):
            self._counts[place] = value
        self._counts[0] = len(values)

    def begin(self, before: int) -> None:
        """Empty it. `before`: units that the port has brought before what is read now."""
        numbers = self._numbers
        numbers[_WANTED] = numbers[_SIZE] = 0
        numbers[_BEFORE] = before

    def read(self, fd: int, size: int) -> bytes:
        """Read as many bytes as are known to wait. Raises OSError."""
        numbers = self._numbers
        at = numbers[_SIZE]
        end = at + size
        room = self._room[at:end]
        room[:] = self._filling[at:end]
        numbers[_READ_NS], numbers[_WANTED] = time.monotonic_ns(), end
        try:
            done = os.readv(fd, [room])
        except OSError:
            numbers[_WANTED] = at
            raise
        numbers[_SIZE] = at + done
        return bytes(room[:done])

    def left(self, stored: int) -> Left | None:
        """Return what the reader before this one has left, None where there was none. `stored`: as its spool shows it."""
        numbers = self._numbers
        if not numbers[_LAST_NS]:
            return None
        size, wanted = numbers[_SIZE], numbers[_WANTED]
        if wanted > size and self._room[size:wanted] != self._filling[size:wanted]:
            size = wanted
        # The spool may be gone, or be a record ahead of what is noted.
        stored = max(stored, numbers[_STORED])
        before = numbers[_BEFORE]
        data = bytes(self._room[min(size, max(0, stored - before)) : size])
        lost = max(before + size, numbers[_TAKEN]) - stored - len(data)
        return Left(stored, numbers[_LAST_NS], max(0, lost), data, numbers[_READ_NS])
