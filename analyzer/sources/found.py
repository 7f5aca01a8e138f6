"""Frames that a reader found in many records at once, in columns, and the stretches that can be passed on as blocks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from analyzer.columns.block import CanBlock
from analyzer.columns.codec import Bytes, Integers

#: Fewer records than this in a row are read faster one by one.
SHORTEST = 64
#: By size: the bits of a word that are those of its first bytes.
_KEPT = np.array([(1 << 8 * size) - 1 for size in range(9)], dtype="<u8")


@dataclass
class Found:
    """What some records hold, one entry a record. `bus`: a place in `names`; -1: the record is left to be read singly."""

    t_ns: Integers
    ids: Integers
    sizes: Integers
    data: Bytes
    marks: Integers
    bus: Integers
    names: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, count: int) -> Found:
        """Return room for so many records, all of which are left."""
        t_ns, ids, sizes, marks = np.zeros((4, count), dtype=np.int64)
        return cls(t_ns, ids, sizes, np.zeros((count, 8), dtype=np.uint8), marks, np.full(count, -1, dtype=np.int64))

    def stretches(self) -> Iterator[tuple[int, int, str, CanBlock | None]]:
        """Yield the records in their order: from which to which, on which bus, and their frames; None: read them singly.

        The port of a block is empty. A stretch ends where the bus changes, where a record is left, and where times run
        backwards.
        """
        count = len(self.t_ns)
        breaks = np.flatnonzero((self.bus[1:] != self.bus[:-1]) | (self.t_ns[1:] < self.t_ns[:-1])) + 1
        ids, sizes, marks = self.ids.astype(np.int16), self.sizes.astype(np.int8), self.marks.astype(np.int8)
        single = 0
        for start, stop in pairwise([0, *breaks.tolist(), count]):
            bus = int(self.bus[start]) if count else -1
            if bus < 0 or stop - start < SHORTEST:
                continue
            if single < start:
                yield single, start, "", None
            own = slice(start, stop)
            block = CanBlock("", self.t_ns[own], ids[own], sizes[own], self.data[own], marks[own])
            yield start, stop, self.names[bus], block
            single = stop
        if single < count:
            yield single, count, "", None


def without_rest(data: Bytes, sizes: NDArray[np.integer]) -> Bytes:
    """Return data of 8 bytes a frame with zeros behind those that it has."""
    kept = data.view("<u8")[:, 0] & _KEPT.take(sizes, mode="clip")
    result: Bytes = kept[:, None].view(np.uint8)
    return result
