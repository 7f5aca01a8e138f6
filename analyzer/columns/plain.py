"""The frames of a block that are part of plain exchanges, as columns: `analyzer.columns.pairs` finds them, sinks take them."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np

from analyzer.catalogue import Dialect
from analyzer.columns.block import CanBlock, FrameBlock
from analyzer.columns.codec import Integers
from analyzer.records import Frame, Lane


class Plain(msgspec.Struct, frozen=True, eq=False):
    """The frames of a block that are part of plain exchanges.

    `lanes`: those that occur; `lane`: of each row, a place in `lanes`, -1 where a frame is not plain. `offsets`: bytes of the
    bus before each frame. `behind`: of a reply, how many rows it stands behind its request; `latencies`: the time
    between the two, not above 0 where it is not known.
    """

    dialect: Dialect
    block: CanBlock | FrameBlock
    lanes: tuple[Lane, ...]
    lane: Integers
    offsets: Integers
    behind: Integers
    latencies: Integers

    @property
    def joins(self) -> object:
        """What is the same of blocks that follow each other and can be joined: frames of a serial line are not."""
        block = self.block
        return (self.dialect.name, block.port) if isinstance(block, CanBlock) else id(block)

    @classmethod
    def joined(cls, plains: Sequence[Plain]) -> Plain:
        """Return what is plain in blocks that join; times may run backwards from one to the next."""
        if len(plains) == 1:
            return plains[0]
        lanes: dict[Lane, int] = {}
        for lane in (lane for plain in plains for lane in plain.lanes):
            lanes.setdefault(lane, len(lanes))
        numbers = [np.array([*(lanes[each] for each in plain.lanes), -1]).take(plain.lane, mode="wrap") for plain in plains]
        block = CanBlock.joined([plain.block for plain in plains if isinstance(plain.block, CanBlock)])
        columns = (np.concatenate([getattr(p, name) for p in plains]) for name in ("offsets", "behind", "latencies"))
        return cls(plains[0].dialect, block, tuple(lanes), np.concatenate(numbers), *columns)

    def frame(self, row: int) -> Frame:
        """Return one frame."""
        return self.block.frame_of(row, self.dialect, int(self.offsets[row]))

    def data(self, row: int) -> bytes:
        """Return the bytes of one frame."""
        return self.block.data[row, : self.block.sizes[row]].tobytes()

    def firsts(self, start: int, stop: int) -> Integers:
        """Return of each lane the first of some rows that has it, `stop` where none has."""
        first = np.full(len(self.lanes) + 1, stop, dtype=np.int64)
        # Of several rows of a lane, what is written last stays. Rows without one write behind all lanes.
        first[self.lane[start:stop][::-1]] = np.arange(stop - 1, start - 1, -1)
        return first[:-1]

    def part(self, first: int, runs: Sequence[tuple[int, int]]) -> tuple[Plain, Integers]:
        """Return what is plain in some runs, with no other lanes, and the places of its lanes here.

        `runs`: from which row to which, counted from the row `first`, which begins the part. They follow each other.
        """
        rows = slice(first, first + runs[-1][1])
        lane = np.full(runs[-1][1], -1, dtype=np.int64)
        for start, stop in runs:
            lane[start:stop] = self.lane[first + start : first + stop]
        used = np.flatnonzero(np.bincount(lane + 1)[1:])
        places = np.full(len(self.lanes) + 1, -1, dtype=np.int64)
        places[used] = np.arange(len(used))
        lanes = tuple(self.lanes[n] for n in used.tolist())
        offsets, behind, latencies = (column[rows] for column in (self.offsets, self.behind, self.latencies))
        return Plain(self.dialect, self.block.part(rows), lanes, places[lane], offsets, behind, latencies), used
