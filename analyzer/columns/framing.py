"""The frames in blocks of bytes of a serial line, found by operations over arrays where they follow each other.

Theory of operation. A link finds all places of a block where a frame that checks begins (`Slicer.scan`). Where such frames
stand one right behind the other, they are what the framer would find: it stands at the first of them, and it believes a frame
that another one or a boundary follows. So wherever the framer comes to such a row, the row is given away whole, and the framer
goes on behind it. So are gaps between rows that hold plain damage (`analyzer.columns.gaps`). All else goes through the framer,
chunk by chunk: frames of two lengths, unknown codes, damage that can be read in several ways.

    bytes    FA 01 31 2C | FB 01 31 .. 2D | 7F | FA 01 .. | FA FA 01 31 .. | FA 01 ..
    by       a row of frames  - - - - - -   gap  a row ..   the framer       a row of frames

A place that is passed over costs time alone. A row never reaches beyond a silence within a frame.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Generator, Iterator
from functools import cached_property
from typing import NamedTuple

import numpy as np

from analyzer.columns.block import DIRECTIONS, ByteBlock, FrameBlock
from analyzer.columns.codec import Flags, Integers
from analyzer.columns.gaps import Gap, GapReader, Piece
from analyzer.framer import BURST_CHARACTERS, Framer, Mark, slowest_ns
from analyzer.junk import JUNK_PIECE
from analyzer.link.arrays import Found
from analyzer.link.interface import Slicer
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
                stop = yield from rows.told(*span)
                fed, events = rows.go_on(framer, stop)
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
        return None if found is None else _Rows(self.framer, slicer, block, found, timed=self._timed)


class _Rows:
    """Rows of frames in what a framer held before a block, and in the block. Places count from the first byte held."""

    def __init__(self, framer: Framer, slicer: Slicer, block: ByteBlock, found: Found, *, timed: bool) -> None:
        assert block.t_ns is not None
        self._port, self._dialect, self._block, self._timed = framer.port, framer.dialects[0], block, timed
        line = self._line = framer.line
        held = self._held = len(line.held)
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
        self._slicer, self._reader = slicer, GapReader(framer, slicer, self._whole)
        self._find(found)

    def _find(self, found: Found) -> None:
        """Tell where rows of frames begin and end."""
        starts, ends = found.starts, found.starts + found.sizes
        looks = None if found.looks is found.sizes else found.looks
        if len(self._silences):
            whole = self._silences.searchsorted(starts, side="right") >= self._silences.searchsorted(ends)
            starts, ends, looks = starts[whole], ends[whole], None if looks is None else looks[whole]
        # Bytes inside a frame that look like a frame part those that follow each other: they are left out.
        parted = np.flatnonzero(starts[1:] < ends[:-1])
        following = starts.searchsorted(ends[parted])
        inside = np.zeros(len(starts), dtype=np.bool_)
        ending = len(starts)
        for place, behind, end in zip(parted.tolist(), following.tolist(), ends[parted].tolist(), strict=True):
            if behind < ending and starts[behind] == end and not inside[place]:
                inside[place + 1 : behind] = True
        if inside.any():
            starts, ends, looks = starts[~inside], ends[~inside], None if looks is None else looks[~inside]
        #: Of each frame, how many bytes had to be looked at; None: its own.
        self._starts, self._ends, self._looks = starts, ends, looks
        lasts = np.append(np.flatnonzero(starts[1:] != ends[:-1]), len(starts) - 1) if len(starts) else starts
        firsts = np.append(0, lasts[:-1] + 1) if len(starts) else starts
        self._firsts, self._lasts = firsts, lasts
        # The last of a row is believed only where a boundary follows it.
        stops = lasts + (self._is_in(self._opened, ends[lasts]) | self._is_in(self._closed, ends[lasts]))
        self._stops_of_rows = stops
        self._long = np.flatnonzero(stops - firsts >= SHORTEST_ROW)
        self._gaps = self._plain_gaps(found)
        self._places = starts[firsts[self._long]].tolist()
        self._limits = ends[stops[self._long] - 1].tolist()

    def _plain_gaps(self, found: Found) -> dict[int, Gap]:
        """Return, by the row before, the gaps in which the framer weighs nothing, unless a frame begins where it is unsure."""
        slicer, lasts, firsts = self._slicer, self._lasts[:-1], self._firsts[1:]
        begins, starts, stops, ends = self._starts[lasts], self._ends[lasts], self._starts[firsts], self._ends[firsts]
        # With one byte more, a frame that ends with a sum may have had one inserted.
        nearest = starts if slicer.strong_check else starts + 1
        plain = (self._lasts[1:] > firsts) & (stops > nearest) & (stops - starts < JUNK_PIECE) & (starts > self._held)
        chunks = self._stops.searchsorted(starts)
        # The framer looks for frames up to where one would end that begins in the gap.
        plain &= ends + 2 * slicer.longest <= self._stops.take(chunks, mode="clip")
        plain &= found.starts.searchsorted(ends) - found.starts.searchsorted(begins) == 2
        rows = np.flatnonzero(plain)
        columns = [each[rows].tolist() for each in (chunks, starts, stops)]
        unsure = (found.unsure.searchsorted(each[rows]).tolist() for each in (begins, ends))
        places = [found.unsure[first:last].tolist() if first < last else [] for first, last in zip(*unsure, strict=True)]
        return dict(zip(rows.tolist(), map(Gap, *columns, places), strict=True))

    @staticmethod
    def _is_in(places: Integers, wanted: Integers) -> Flags:
        if not len(places):
            return np.zeros(len(wanted), dtype=np.bool_)
        result: Flags = np.isin(wanted, places)
        return result

    # --- where the framer stands --------------------------------------------------------------------------------------

    def at(self, offset: int) -> tuple[int, int] | None:
        """Return which row has enough frames from a place on the port on, and the first of them; None where none has."""
        place = offset - self._line.offset
        number = bisect_right(self._places, place) - 1
        if number < 0 or place >= self._limits[number]:
            return None
        row = int(self._long[number])
        first, stop = int(self._firsts[row]), int(self._stops_of_rows[row])
        if place != self._places[number]:
            first += int(self._starts[first:stop].searchsorted(place))
        return (row, first) if stop - first >= SHORTEST_ROW and self._starts[first] == place else None

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
            return np.repeat(np.arange(len(stops)), among(places))

        def among(places: Integers) -> Integers:
            # In order, all of one chunk stand together.
            return np.diff(places.searchsorted(stops), prepend=0)

        # Such long columns are reckoned in place: new ones would not stay in the cache of the processor.
        begun, lasts = among(self._starts), self._ends - 1
        ended = chunks_of(lasts)
        # Counted from the end of its chunk, a byte came so much earlier; but not before the chunk before.
        zero_ns = times - (stops - 1) * line.byte_ns
        first_ns = self._starts * line.byte_ns
        first_ns += np.repeat(zero_ns, begun)
        np.maximum(first_ns, np.repeat(before, begun), out=first_ns)
        last_ns = np.multiply(lasts, line.byte_ns, out=lasts)
        last_ns += zero_ns.take(ended)
        np.maximum(last_ns, before.take(ended), out=last_ns)
        # A frame is told once it and the one behind it were looked at, or a boundary came.
        looked = ended if self._looks is None else chunks_of(self._starts + self._looks - 1)
        decided = np.append(looked[1:], len(stops) - 1)[: len(ended)]
        # Few frames end at a boundary: only these are told anew.
        for places, later in ((self._opened, 1), (self._closed, 0)):
            rows = np.flatnonzero(self._is_in(places, self._ends))
            decided[rows] = np.minimum(decided[rows], ended[rows] + later)
        np.maximum(decided, looked, out=decided)
        rows = np.flatnonzero(self._is_in(self._silences, self._ends))
        decided[rows] = np.minimum(decided[rows], ended[rows] + 1)
        decided += 1 - len(held)
        np.maximum(decided, 0, out=decided)
        about = self._starts, self._ends - self._starts, first_ns, last_ns, np.repeat(marks, begun)
        return FrameBlock(self._port, self._whole, line.offset, *about, self._timed), decided

    def told(self, row: int, first: int) -> Generator[Frame | Junk | Row, None, int]:
        """Yield the frames of a row from one on, then gaps and rows up to a gap that is left. Return which frame is next."""
        block = self._block
        frames, decided = self._frames
        while True:
            gap = self._gaps.get(row)
            pieces = None if gap is None else self._reader.pieces(gap)
            stop = int(self._stops_of_rows[row] if pieces is None else self._lasts[row] + 1)
            told = np.maximum(decided[first:stop], block.taken)
            yield Row(frames, first, stop, told)
            block.taken = int(told[-1])
            if gap is None or pieces is None:
                return stop
            block.taken = max(block.taken, gap.chunk + 1)
            yield from self._pieces(gap.chunk, pieces)
            row += 1
            first = int(self._firsts[row])

    def _pieces(self, chunk: int, pieces: list[Piece]) -> Iterator[Frame | Junk]:
        """Yield what stands in a gap."""
        line, block = self._line, self._block
        assert block.t_ns is not None
        before_ns, t_ns = int(self._before_ns[chunk]), int(block.t_ns[chunk])
        end, direction = int(self._stops[chunk]), DIRECTIONS[block.directions[chunk]]
        for start, stop, reason in pieces:
            first_ns, last_ns = (max(before_ns, t_ns - (end - 1 - each) * line.byte_ns) for each in (start, stop - 1))
            place = self._port, first_ns, last_ns, line.offset + start, self._whole[start:stop]
            yield Frame(*place, self._dialect, direction, False) if reason is None else Junk(*place, reason)
