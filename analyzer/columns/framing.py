"""The frames in blocks of bytes of a serial line, found by operations over arrays where they follow each other.

Theory of operation. A link finds all places of a block where a frame that checks begins (`Slicer.scan`). Where such frames
stand one right behind the other, they are what the framer would find: it stands at the first of them, and it believes a frame
that another one or a boundary follows. So wherever the framer comes to such a row, the row is given away whole, and the framer
goes on behind it. All else goes through the framer, chunk by chunk: junk, damage, frames of two lengths, unknown codes.

    bytes    FA 01 31 2C | FB 01 31 .. 2D | 7F | FA 01 ..
    by       a row of frames  - - - - - -   the framer   a row of frames

A place that is passed over costs time alone. A row never reaches beyond a silence within a frame.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from functools import cached_property
from typing import NamedTuple

import numpy as np

from analyzer.columns.block import DIRECTIONS, ByteBlock, FrameBlock
from analyzer.columns.codec import Flags, Integers
from analyzer.framer import BURST_CHARACTERS, Framer, LineState, Mark, slowest_ns
from analyzer.link.arrays import Found
from analyzer.records import Frame, Junk

#: Fewer frames than this are found faster one by one.
SHORTEST_ROW = 8
#: Fewer frames than this are decoded faster one by one: columns cost about as much for few frames as for many.
SHORTEST_TOGETHER = 512


class Row(NamedTuple):
    """Frames that follow each other: those of a block from one to another. `decided`: of each, how many chunks tell it."""

    frames: FrameBlock
    start: int
    stop: int
    decided: Integers


class Framing:
    """Frames blocks of bytes for a framer, which then stands where it would without them. `timed`: times say something."""

    def __init__(self, framer: Framer, *, timed: bool = True) -> None:
        self.framer = framer
        self._timed = timed

    def feed(self, block: ByteBlock) -> Iterator[Frame | Junk | Row]:
        """Take a block, all of whose chunks have times; yield what is certain by now, in order. Use each up before the next.

        The rows of a block are all of one block of frames.
        """
        framer, rows = self.framer, self._rows(block)
        chunks = len(block)
        if rows is None:
            for number in range(chunks):
                block.taken = number + 1
                yield from framer.feed(block.chunk(number))
            return
        fed = 0
        events: Iterator[Frame | Junk] = iter(())
        span = rows.at(framer.standing)
        while True:
            if span is not None:
                row = rows.row(*span, block.taken)
                yield row
                block.taken = int(row.decided[-1])
                fed, events = rows.go_on(framer, span[1])
            for event in events:
                yield event
                span = rows.at(framer.standing)
                if span is not None:
                    break
            else:
                if fed == chunks:
                    return
                events, span = framer.feed(block.chunk(fed)), None
                fed += 1
                block.taken = max(block.taken, fed)

    def _rows(self, block: ByteBlock) -> _Rows | None:
        """Find the rows of frames in what the framer holds and a block; None where times run backwards or nothing is found."""
        assert block.t_ns is not None  # the caller has given times to all chunks
        line, slicer = self.framer.line, self.framer.slicer
        if slicer is None or block.t_ns[0] < line.last_ns:
            return None
        found = slicer.scan(np.frombuffer(line.held + block.data, dtype=np.uint8))
        return None if found is None else _Rows(self.framer.port, block, line, found, timed=self._timed)


class _Rows:
    """Rows of frames in what a framer held before a block, and in the block. Places count from the first byte held."""

    def __init__(self, port: str, block: ByteBlock, line: LineState, found: Found, *, timed: bool) -> None:
        assert block.t_ns is not None
        self._port, self._block, self._line, self._timed = port, block, line, timed
        held = len(line.held)
        self._whole = line.held + block.data if held else block.data
        sizes = np.diff(block.stops, prepend=0)
        self._begins = block.stops - sizes + held
        self._stops = block.stops + held
        self._before_ns = np.concatenate(([line.last_ns], block.t_ns[:-1]))
        slowest = slowest_ns(line.byte_ns)
        pauses = block.t_ns - self._before_ns - sizes * slowest
        if not line.timed:
            pauses[0] = 0
        turned = np.diff(block.directions, prepend=DIRECTIONS.index(line.direction)) != 0
        #: Where nothing that came before can go on, and where something may.
        silent = (pauses > line.silence_ns) | turned
        self._silences = self._begins[silent]
        opened = silent | block.bursts | (pauses >= BURST_CHARACTERS * slowest)
        known = np.array([each - line.offset for each in line.bursts], dtype=np.int64)
        self._opened = self._begins[opened]
        self._closed = np.concatenate((known, self._stops[block.bursts]))
        self._find(*found)

    def _find(self, starts: Integers, sizes: Integers, looks: Integers) -> None:
        """Tell where rows of frames begin and end."""
        ends = starts + sizes
        if len(self._silences):
            whole = self._silences.searchsorted(starts, side="right") >= self._silences.searchsorted(ends)
            starts, ends, looks = starts[whole], ends[whole], looks[whole]
        # Bytes inside a frame that look like a frame part those that follow each other: they are left out.
        parted = np.flatnonzero(starts[1:] < ends[:-1])
        following = starts.searchsorted(ends[parted])
        inside = np.zeros(len(starts), dtype=np.bool_)
        ending = len(starts)
        for place, behind, end in zip(parted.tolist(), following.tolist(), ends[parted].tolist(), strict=True):
            if behind < ending and starts[behind] == end and not inside[place]:
                inside[place + 1 : behind] = True
        if inside.any():
            starts, ends, looks = starts[~inside], ends[~inside], looks[~inside]
        self._starts, self._ends, self._looks = starts, ends, looks
        lasts = np.append(np.flatnonzero(starts[1:] != ends[:-1]), len(starts) - 1) if len(starts) else starts
        firsts = np.append(0, lasts[:-1] + 1) if len(starts) else starts
        # The last of a row is believed only where a boundary follows it.
        stops = lasts + (self._is_in(self._opened, ends[lasts]) | self._is_in(self._closed, ends[lasts]))
        long = stops - firsts >= SHORTEST_ROW
        self._firsts, self._stops_of_rows = firsts[long].tolist(), stops[long].tolist()
        self._places = starts[firsts[long]].tolist()
        self._limits = ends[stops[long] - 1].tolist()

    @staticmethod
    def _is_in(places: Integers, wanted: Integers) -> Flags:
        if not len(places):
            return np.zeros(len(wanted), dtype=np.bool_)
        result: Flags = np.isin(wanted, places)
        return result

    # --- where the framer stands --------------------------------------------------------------------------------------

    def at(self, offset: int) -> tuple[int, int] | None:
        """Return which frames follow each other from a place on the port on, enough of them; None where there are none."""
        place = offset - self._line.offset
        row = bisect_right(self._places, place) - 1
        if row < 0 or place >= self._limits[row]:
            return None
        first, stop = self._firsts[row], self._stops_of_rows[row]
        if place != self._places[row]:
            first += int(self._starts[first:stop].searchsorted(place))
        return (first, stop) if stop - first >= SHORTEST_ROW and self._starts[first] == place else None

    def go_on(self, framer: Framer, stop: int) -> tuple[int, Iterator[Frame | Junk]]:
        """Let the framer go on behind some frames. Return how many chunks it has then, and what it finds in them."""
        line, block = self._line, self._block
        assert block.t_ns is not None
        place = int(self._ends[stop - 1])
        here = framer.end - line.offset
        if place <= here:
            fed = int(self._stops.searchsorted(here, side="right"))
            last_ns = int(block.t_ns[fed - 1]) if fed else line.last_ns
            return fed, framer.go_on(line.offset + place, last_ns)
        number = int(self._stops.searchsorted(place))
        mark = Mark(line.offset + int(self._stops[number]), int(block.t_ns[number]), int(self._before_ns[number]))
        return number + 1, framer.go_on_in(block.chunk(number), mark, line.offset + place)

    # --- what is given away -------------------------------------------------------------------------------------------

    @cached_property
    def _frames(self) -> tuple[FrameBlock, Integers]:
        """All frames, and how many chunks tell each."""
        line, block = self._line, self._block
        assert block.t_ns is not None
        held = np.array([(m.stop - line.offset, m.t_ns, m.before_ns) for m in line.marks], dtype=np.int64).reshape(-1, 3)
        stops, times, before = (
            np.concatenate((held[:, n], own)) for n, own in enumerate((self._stops, block.t_ns, self._before_ns))
        )
        marks = np.concatenate((np.full(len(held), DIRECTIONS.index(line.direction)), block.directions))

        def chunks_of(places: Integers) -> Integers:
            if (places[1:] < places[:-1]).any():
                return stops.searchsorted(places, side="right")
            # In order, all of one chunk stand together.
            return np.repeat(np.arange(len(stops)), np.diff(places.searchsorted(stops), prepend=0))

        chunks, ended = chunks_of(self._starts), chunks_of(self._ends - 1)
        # Counted from the end of its chunk, a byte came so much earlier; but not before the chunk before.
        zero_ns = times - (stops - 1) * line.byte_ns
        first_ns = np.maximum(before[chunks], zero_ns[chunks] + self._starts * line.byte_ns)
        last_ns = np.maximum(before[ended], zero_ns[ended] + (self._ends - 1) * line.byte_ns)
        # A frame is told once it and the one behind it were looked at, or a boundary came.
        looked = chunks_of(self._starts + self._looks - 1)
        decided = np.append(looked[1:], len(stops) - 1)[: len(ended)]
        # Few frames end at a boundary: only these are told anew.
        for places, later in ((self._opened, 1), (self._closed, 0)):
            rows = np.flatnonzero(self._is_in(places, self._ends))
            decided[rows] = np.minimum(decided[rows], ended[rows] + later)
        decided = np.maximum(decided, looked)
        rows = np.flatnonzero(self._is_in(self._silences, self._ends))
        decided[rows] = np.minimum(decided[rows], ended[rows] + 1)
        sizes = self._ends - self._starts
        about = self._starts, sizes, first_ns, last_ns, marks[chunks]
        frames = FrameBlock(self._port, self._whole, line.offset, *about, self._timed)
        return frames, np.maximum(decided + 1 - len(held), 0)

    def row(self, first: int, stop: int, taken: int) -> Row:
        """Return some frames. `taken`: chunks that were needed to come to them."""
        frames, decided = self._frames
        return Row(frames, first, stop, np.maximum(decided[first:stop], taken))
