"""What came on one bus as columns, in order of time: CAN frames, bytes of a serial line, and the frames found in those."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

from analyzer.catalogue import Dialect, Role
from analyzer.records import CanFrame, Chunk, Frame

if TYPE_CHECKING:
    # NumPy is there wherever a block is; what only asks for one does not bring it.
    from numpy.typing import NDArray

    from analyzer.columns.codec import Bytes, Flags, Integers

#: Who sent a frame, as the capture marks it, by its number in a block.
DIRECTIONS = (Role.UNKNOWN, Role.REQUEST, Role.REPLY)
_MARKS = {role: number for number, role in enumerate(DIRECTIONS)}
#: Identifiers of 11 bits, and the data bytes that a frame of CAN 2.0 has at most.
STANDARD_ID, WIDEST_DATA = 0x7FF, 8
#: What tells frames of different kinds apart: identifier, length and some bytes at the beginning.
Head = tuple[int, int, bytes]


def _heads(ids: Integers, sizes: Integers, data: Bytes, counts: Integers | int) -> list[Head]:
    whole, width = data.tobytes(), data.shape[1]
    stops = (counts + ids * 0).tolist()
    starts = range(0, len(whole), width)
    return [
        (number, size, whole[start : start + stop])
        for number, size, start, stop in zip(ids.tolist(), sizes.tolist(), starts, stops, strict=True)
    ]


@dataclass(frozen=True, slots=True)
class CanBlock:
    """CAN frames: data frames with identifiers of 11 bits. All arrays have one entry a frame.

    `t_ns`: times that never decrease. `data`: shape (frames, 8), zeros behind the `sizes` bytes that a frame has.
    `directions`: numbers in `DIRECTIONS`. Identifiers take 16 bits, sizes and directions 8; all are signed.
    """

    port: str
    t_ns: Integers
    ids: NDArray[Any]
    sizes: NDArray[Any]
    data: Bytes
    directions: NDArray[Any]
    #: Whether times say anything: frames without times do not come in blocks.
    timed: ClassVar[bool] = True

    @staticmethod
    def takes(frame: CanFrame) -> bool:
        """Say whether a frame can stand in a block."""
        odd = frame.extended or frame.remote or frame.error or frame.fd
        return not odd and frame.id <= STANDARD_ID and len(frame.data) <= WIDEST_DATA and frame.t_ns is not None

    @classmethod
    def of(cls, frames: Sequence[CanFrame]) -> CanBlock:
        """Return frames of one bus as a block, which takes each, in order of time."""
        import numpy as np

        count = len(frames)
        t_ns = np.fromiter((frame.t_ns for frame in frames), np.int64, count)
        ids = np.fromiter((frame.id for frame in frames), np.int16, count)
        sizes = np.fromiter((len(frame.data) for frame in frames), np.int8, count)
        marks = np.fromiter((_MARKS[frame.direction] for frame in frames), np.int8, count)
        data = np.frombuffer(b"".join([frame.data.ljust(WIDEST_DATA, b"\0") for frame in frames]), dtype=np.uint8)
        return cls(frames[0].port, t_ns, ids, sizes, data.reshape(count, WIDEST_DATA), marks)

    def leads_to(self, other: CanBlock) -> bool:
        """Say whether another block can stand behind this one, in one block."""
        return self.port == other.port and bool(self.t_ns[-1] <= other.t_ns[0])

    @classmethod
    def joined(cls, blocks: Sequence[CanBlock]) -> CanBlock:
        """Return blocks of which each leads to the next as one."""
        import numpy as np

        if len(blocks) == 1:
            return blocks[0]
        columns = ("t_ns", "ids", "sizes", "data", "directions")
        return cls(blocks[0].port, *(np.concatenate([getattr(block, name) for block in blocks]) for name in columns))

    def __len__(self) -> int:
        return len(self.t_ns)

    @property
    def bytes(self) -> int:
        """Data bytes of all frames."""
        return int(self.sizes.sum())

    @property
    def first_ns(self) -> Integers:
        """When each frame began: on CAN, as far as is known, when it ended."""
        return self.t_ns

    def part(self, rows: slice) -> CanBlock:
        """Return some frames as a block."""
        t_ns, ids, sizes, directions = (column[rows] for column in (self.t_ns, self.ids, self.sizes, self.directions))
        return CanBlock(self.port, t_ns, ids, sizes, self.data[rows], directions)

    def alike(self, count: int) -> Integers:
        """Return numbers that are the same where identifier, length and so many bytes at the beginning are."""
        from analyzer.columns.groups import numbered, ranks

        # The rank of an identifier instead of itself: so numbers are small, of which groups are found fast.
        return numbered(self.data[:, :count], ranks(self.ids)[1].astype("i8") << 4 | self.sizes)

    def heads(self, rows: Integers, counts: Integers | int) -> list[Head]:
        """Return identifier, length and so many bytes at the beginning of some frames."""
        return _heads(self.ids.take(rows), self.sizes.take(rows), self.data.take(rows, axis=0), counts)

    def frame_of(self, row: int, dialect: Dialect, offset: int) -> Frame:
        """Return one frame as one of a dialect. `offset`: bytes of the bus before it."""
        can, t_ns = self.frame(row), int(self.t_ns[row])
        return Frame(can.port, t_ns, t_ns, offset, can.data, dialect, can.direction, True, can)

    def frame(self, row: int) -> CanFrame:
        """Return one frame."""
        data = self.data[row, : self.sizes[row]].tobytes()
        return CanFrame(int(self.t_ns[row]), self.port, int(self.ids[row]), data, DIRECTIONS[self.directions[row]])

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[CanFrame]:
        """Yield frames from one row to another, usually all."""
        own = slice(start, stop)
        data, at = self.data[own].tobytes(), 0
        columns = (self.t_ns, self.ids, self.sizes, self.directions)
        for t_ns, number, size, direction in zip(*(column[own].tolist() for column in columns), strict=True):
            yield CanFrame(t_ns, self.port, number, data[at : at + size], DIRECTIONS[direction])
            at += self.data.shape[1]


@dataclass(slots=True)
class ByteBlock:
    """Chunks of one serial line, one behind the other.

    `stops`: where each chunk ends in `data`. `t_ns`: when each came, never decreasing; None: the capture has no times.
    `directions`: numbers in `DIRECTIONS`. `bursts`: whether the capture delimits it. `taken`: chunks that were needed to tell
    what has been told of the block so far.
    """

    port: str
    data: bytes
    stops: Integers
    t_ns: Integers | None
    directions: Integers
    bursts: Flags
    taken: int = 0

    @classmethod
    def of(cls, chunks: Sequence[Chunk]) -> ByteBlock:
        """Return some chunks of one line as a block; all have times, or none has."""
        import numpy as np

        count, first = len(chunks), chunks[0]
        times = None if first.t_ns is None else np.fromiter((chunk.t_ns for chunk in chunks), np.int64, count)
        marks = np.fromiter((_MARKS[chunk.direction] for chunk in chunks), np.int64, count)
        stops = np.cumsum(np.fromiter((len(chunk.data) for chunk in chunks), np.int64, count))
        bursts = np.fromiter((chunk.burst for chunk in chunks), np.bool_, count)
        return cls(first.port, b"".join(chunk.data for chunk in chunks), stops, times, marks, bursts)

    def __len__(self) -> int:
        return len(self.stops)

    def chunk(self, number: int) -> Chunk:
        """Return one chunk."""
        start = int(self.stops[number - 1]) if number else 0
        t_ns = None if self.t_ns is None else int(self.t_ns[number])
        own = self.data[start : int(self.stops[number])]
        return Chunk(t_ns, self.port, own, DIRECTIONS[self.directions[number]], bool(self.bursts[number]))

    def chunks(self, start: int = 0, stop: int | None = None) -> Iterator[Chunk]:
        """Yield chunks from one to another, usually all."""
        return map(self.chunk, range(start, len(self) if stop is None else stop))


#: Bytes of a frame that stand in columns at most, in whole words. A longer frame is none of a lane.
WIDEST_ROW = 40


@dataclass
class FrameBlock:
    """Frames of a serial line whose checks fit, in order; something else may stand between them. Arrays have one entry a frame.

    `whole`: the bytes that they stand in, and `starts` where each begins. `offset`: bytes of the line before `whole`. `t_ns`:
    when the last byte of each came. `timed`: whether times say anything.
    """

    port: str
    whole: bytes
    offset: int
    starts: Integers
    sizes: Integers
    first_ns: Integers
    t_ns: Integers
    directions: Integers
    timed: bool

    def __len__(self) -> int:
        return len(self.starts)

    def part(self, rows: slice) -> FrameBlock:
        """Return some frames as a block, with their bytes alone."""
        starts, sizes = self.starts[rows], self.sizes[rows]
        first, end = int(starts[0]), int(starts[-1] + sizes[-1])
        about = self.first_ns[rows], self.t_ns[rows], self.directions[rows]
        return FrameBlock(self.port, self.whole[first:end], self.offset + first, starts - first, sizes, *about, self.timed)

    @cached_property
    def data(self) -> Bytes:
        """The bytes of the frames, of shape (frames, whole words for the longest), zeros behind a frame's own."""
        import numpy as np

        width = min(-(-int(self.sizes.max(initial=1)) // 8) * 8, WIDEST_ROW)
        first, last = int(self.starts[0]), int(self.starts[-1])
        codes = np.frombuffer(self.whole[first : last + width] + bytes(width), dtype=np.uint8)
        rows = np.lib.stride_tricks.sliding_window_view(codes, width)[self.starts - first]
        result: Bytes = np.ascontiguousarray(rows * (np.arange(width) < self.sizes[:, None]))
        return result

    @cached_property
    def offsets(self) -> Integers:
        """Bytes of the line before each frame."""
        return self.offset + self.starts

    @property
    def bytes(self) -> int:
        """Bytes of all frames."""
        return int(self.sizes.sum())

    def alike(self, count: int) -> Integers:
        """Return numbers that are the same where length and so many bytes at the beginning are."""
        from analyzer.columns.groups import numbered

        return numbered(self.data[:, :count], self.sizes)

    def heads(self, rows: Integers, counts: Integers | int) -> list[Head]:
        """Return 0, length and so many bytes at the beginning of some frames."""
        return _heads(rows * 0, self.sizes.take(rows), self.data.take(rows, axis=0), counts)

    def frame_of(self, row: int, dialect: Dialect, offset: int = 0) -> Frame:
        """Return one frame as one of a dialect; where it stands tells its offset."""
        return next(self.frames(dialect, row, row + 1))

    def frames(self, dialect: Dialect, start: int, stop: int) -> Iterator[Frame]:
        """Yield frames from one row to another as those of a dialect."""
        columns = (self.starts, self.sizes, self.first_ns, self.t_ns, self.directions)
        for at, size, first_ns, t_ns, direction in zip(*(column[start:stop].tolist() for column in columns), strict=True):
            data = self.whole[at : at + size]
            yield Frame(self.port, first_ns, t_ns, self.offset + at, data, dialect, DIRECTIONS[direction], True)

    def __getstate__(self) -> dict[str, object]:
        # What passes to another process is the frames alone.
        return vars(self.part(slice(None)))
