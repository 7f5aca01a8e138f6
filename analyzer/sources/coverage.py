"""Which bytes of a bus a log has given already: what stands there twice, decoded and raw, is given once."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

import msgspec

from analyzer.records import Chunk

#: Stretches of a bus that may be missing for a time: messages out of order.
GAP_LIMIT = 1000
#: Raw bytes wait so long, and so many of them, for the frames that are made of them.
_WAIT_NS = 3_000_000_000
_WAIT_BYTES = 1 << 20


class Coverage:
    """All below `_end` but the gaps; bytes before `start` are not missed."""

    def __init__(self, start: int = 0) -> None:
        self._end = start
        self._gaps: list[tuple[int, int]] = []
        self.late = 0

    def fresh(self, offset: int, size: int) -> tuple[int, int]:
        """Return the part of a message's bytes that was not given yet, as first and last+1 of its own bytes."""
        stop = offset + size
        if offset >= self._end:
            if offset > self._end and len(self._gaps) < GAP_LIMIT:
                self._gaps.append((self._end, offset))
            self._end = stop
            return 0, size
        for at, (low, high) in enumerate(self._gaps):
            if low <= offset < high:
                self.late += 1
                stop = min(stop, high)
                self._gaps[at : at + 1] = [gap for gap in ((low, offset), (stop, high)) if gap[0] < gap[1]]
                return 0, stop - offset
        if stop > self._end:
            first = self._end - offset
            self._end = stop
            return first, size
        return 0, 0

    def covers(self, offset: int, size: int) -> bool:
        """Say whether these bytes were all given."""
        stop = offset + size
        return stop <= self._end and not any(low < stop and offset < high for low, high in self._gaps)

    @property
    def head(self) -> int:
        """Bytes before the first that came."""
        return next((high for low, high in self._gaps if low == 0), 0)

    @property
    def missing(self) -> int:
        """Bytes that never came."""
        return sum(high - low for low, high in self._gaps)


class Raw(NamedTuple):
    """A stretch of raw bytes. `offset`: on its bus."""

    coverage: Coverage
    offset: int
    chunk: Chunk


class Waiting:
    """Raw bytes that wait for their frames, in the order of the log."""

    def __init__(self) -> None:
        self._pieces: deque[Raw] = deque()
        self._size = 0

    def add(self, raw: Raw) -> None:
        """Take a stretch."""
        self._pieces.append(raw)
        self._size += len(raw.chunk.data)

    def due(self, t_ns: int) -> Iterator[Chunk]:
        """Yield what no frame was made of by this time; drop what frames hold."""
        pieces = self._pieces
        while pieces:
            coverage, offset, chunk = pieces[0]
            data = chunk.data
            if not coverage.covers(offset, len(data)):
                since = 0 if chunk.t_ns is None else t_ns - chunk.t_ns
                if since <= _WAIT_NS and self._size <= _WAIT_BYTES:
                    return
                first, stop = coverage.fresh(offset, len(data))
                if stop > first:
                    yield msgspec.structs.replace(chunk, data=data[first:stop])
            pieces.popleft()
            self._size -= len(data)

    def rest(self) -> Iterator[Chunk]:
        """Yield what no frame was made of up to the end."""
        return self.due(1 << 63)
