"""Chunks of an MCAP file: messages in, the bytes that stand in the file out. What is here knows nothing of the file.

    batch: messages | rows of a block | messages ...   ->   chunks   ->   packed: chunk record, message indexes

A batch is all that its chunks need. So any thread or process can make them, and all make the same.
"""

from __future__ import annotations

import struct
import threading
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import zstandard
from fastcrc import crc32
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import McapRecord

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from analyzer.columns.codec import Integers
    from analyzer.columns.plain import Plain
    from analyzer.columns.rows import Messages, Rows

#: Uncompressed bytes of a chunk. Each has an index of every channel, which smaller ones would repeat more often.
CHUNK_SIZE = 1 << 21
MESSAGE = struct.Struct("<BQHIQQ")
#: Of the index of a channel's messages in a chunk: opcode, length, channel, bytes of its entries.
INDEX_HEAD = struct.Struct("<BQHI")
#: The head of a chunk's record: opcode, length, times of the messages, size and CRC without compression, compression, size with
#: it. Packed here: the library would copy the data twice. Of the head, the bytes that its length does not count.
_CHUNK, _UNCOUNTED = struct.Struct("<BQQQQII4sQ"), 9
COMPRESSION = b"zstd"
#: How chunks are compressed: zstd's level, and how far back it looks, as a power of two. Looking back over the whole of a chunk
#: makes it no smaller and takes a tenth more time, since so much fits into no core's own cache.
_LEVEL, _WINDOW = 1, 18


def record_bytes(record: McapRecord) -> bytes:
    """Return a record as it stands in a file, its opcode first."""
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def _compressor(size: int) -> zstandard.ZstdCompressor:
    settings = zstandard.ZstdCompressionParameters.from_level(
        _LEVEL, source_size=size, window_log=_WINDOW, write_content_size=1
    )
    return zstandard.ZstdCompressor(compression_params=settings)


class _Kept(threading.local):
    """What compresses whole chunks, one for each thread: its memory is made once."""

    def __init__(self) -> None:
        self.compressor = _compressor(CHUNK_SIZE)


_kept = _Kept()


def compressed(data: bytes | memoryview) -> bytes:
    """Return the records of a chunk compressed."""
    return (_kept.compressor if len(data) >= CHUNK_SIZE else _compressor(len(data))).compress(data)


class Indexed(NamedTuple):
    """The index records of a chunk. `channels`: of each record; `begins`: where it begins; `counts`: its messages.

    Numbers stand in arrays: lists would pass to another process number by number.
    """

    data: bytes
    channels: array[int]
    begins: array[int]
    counts: array[int]


class Chunk:
    """A chunk under construction.

    `index`: channel -> time and place of each message that came alone; `many`: of those that came together the channels, and
    times and places of shape (messages, 2).
    """

    __slots__ = ("_last", "first_ns", "index", "last_ns", "many", "messages", "parts", "size")

    def __init__(self) -> None:
        self.parts: list[bytes | memoryview] = []
        self.size = 0
        self.first_ns = 0
        self.last_ns = 0
        self.messages = 0
        self.index: dict[int, array[int]] = {}
        self.many: list[tuple[NDArray[np.uint16], Integers]] = []
        #: What the last part stands in, from where to where, if it is an array.
        self._last: tuple[NDArray[np.uint8], int, int] | None = None

    def join(self, other: Chunk, there: tuple[NDArray[np.uint8], int] | None = None) -> None:
        """Take all of another chunk behind what is here. `there`: its bytes stand there, too, from this place on."""
        if not self.messages:
            self.first_ns = other.first_ns
        for channel, entries in other.index.items():
            places = array("Q", (place + self.size for place in entries[1::2]))
            entries[1::2] = places
            self.index.setdefault(channel, array("Q")).extend(entries)
        if there is None:
            self.parts += other.parts
            self._last = None
        else:
            self._add(*there, other.size)
        self.size += other.size
        self.messages += other.messages
        self.last_ns = other.last_ns if other.messages else self.last_ns

    def _add(self, codes: NDArray[np.uint8], begin: int, size: int) -> None:
        """Take bytes of an array. With those before them there they are one part, which need not be put together."""
        end = begin + size
        if self._last is not None and self._last[0] is codes and self._last[2] == begin:
            begin = self._last[1]
            self.parts.pop()
        self.parts.append(codes.data[begin:end])
        self._last = codes, begin, end

    def fill(self, added: Messages, at: int, most: int) -> int:
        """Take packed messages from one on until there are so many bytes; the message that fills the chunk is its last.

        Return where the next chunk goes on.
        """
        base = int(added.entries[at, 1])
        stop = min(len(added.ends), int(added.ends.searchsorted(base + most - self.size)) + 1)
        end, own = int(added.ends[stop - 1]), added.entries[at:stop]
        if not self.messages:
            self.first_ns = int(own[0, 0])
        # From here on they stand in this chunk, and nowhere else.
        own[:, 1] += self.size - base
        self.many.append((added.channels[at:stop], own))
        self._add(added.data, base, end - base)
        self.size += end - base
        self.last_ns = int(own[-1, 0])
        self.messages += stop - at
        return stop

    def indexed(self) -> Indexed:
        """Return the index records."""
        if self.many:
            return self._indexed_together()
        parts: list[bytes] = []
        begins = array("Q")
        place = 0
        for channel, logged in self.index.items():
            entries = logged.tobytes()
            parts += (INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + len(entries), channel, len(entries)), entries)
            begins.append(place)
            place += INDEX_HEAD.size + len(entries)
        counts = array("Q", (len(logged) // 2 for logged in self.index.values()))
        return Indexed(b"".join(parts), array("Q", self.index), begins, counts)

    def _indexed_together(self) -> Indexed:
        import numpy as np

        from analyzer.columns.index import index_records

        for channel, logged in self.index.items():
            entries = np.array(logged).astype(np.int64).reshape(-1, 2)
            self.many.append((np.full(len(entries), channel, dtype=np.uint16), entries))
        channels, entries = self.many[0] if len(self.many) == 1 else map(np.concatenate, zip(*self.many, strict=True))
        data, *numbers = index_records(channels, entries, self.index)
        return Indexed(data, *(array("Q", each) for each in numbers))


class Packed(NamedTuple):
    """A chunk as it stands in a file: head of its record, compressed data, index behind them. `size`: without compression."""

    head: bytes
    data: bytes
    indexed: Indexed
    messages: int
    first_ns: int
    last_ns: int
    size: int


def pack(chunk: Chunk, indexed: Indexed) -> Packed:
    """Compress a chunk that is complete. `indexed`: its index records."""
    data = chunk.parts[0] if len(chunk.parts) == 1 else b"".join(chunk.parts)
    chunk.parts = []
    packed, times = compressed(data), (chunk.first_ns, chunk.last_ns)
    length, crc = _CHUNK.size - _UNCOUNTED + len(packed), crc32.iso_hdlc(data)
    head = _CHUNK.pack(Opcode.CHUNK, length, *times, len(data), crc, len(COMPRESSION), COMPRESSION, len(packed))
    return Packed(head, packed, indexed, chunk.messages, *times, len(data))


class Run(NamedTuple):
    """Rows of a part that are messages. `part`: its number in the batch."""

    part: int
    start: int
    stop: int


class Part(NamedTuple):
    """What is needed of a block. `sequences`, `log_ns`: of each row of a run.

    `channels`: of each lane, that of its topic and that of its state, 0 where it has none.
    """

    plain: Plain
    channels: Integers
    sequences: Integers
    log_ns: Integers

    @classmethod
    def of(cls, plain: Plain, channels: Integers, first: int, runs: Sequence[tuple[Run, int, Integers]]) -> Part:
        """Return what some runs need of a block. `runs`: each with its first number and its times; rows count from `first`."""
        import numpy as np

        own, lanes = plain.part(first, [(run.start, run.stop) for run, _, _ in runs])
        sequences, log_ns = np.zeros(len(own.lane), dtype=np.int64), own.block.t_ns.copy()
        for run, sequence, times in runs:
            sequences[run.start : run.stop] = np.arange(sequence, sequence + len(times))
            log_ns[run.start : run.stop] = times
        # Most often no time was changed: then one array passes to another process, not two.
        return cls(own, channels[lanes], sequences, own.block.t_ns if (log_ns == own.block.t_ns).all() else log_ns)


@dataclass
class Batch:
    """Messages that follow each other: those that are made, and those that are still rows of blocks, part by part."""

    pieces: list[Chunk | Run] = field(default_factory=list)
    parts: list[Part] = field(default_factory=list)

    def chunks(self) -> list[Chunk]:
        """Return the chunks; the last may be short."""
        made, gaps = [Chunk()], self._gaps()
        rows: Rows | None = None
        for piece, behind in zip(self.pieces, [*self.pieces[1:], None], strict=True):
            if isinstance(piece, Chunk):
                if rows is not None and isinstance(behind, Run) and behind.start in gaps[behind.part]:
                    made[-1].join(piece, rows.fill(behind.start, b"".join(piece.parts)))
                elif made[-1].parts:
                    made[-1].join(piece)
                else:
                    made[-1] = piece
                if made[-1].size >= CHUNK_SIZE:
                    made.append(Chunk())
                continue
            part = self.parts[piece.part]
            if rows is None or rows.plain is not part.plain:
                rows = _rows(part, gaps[piece.part])
            added, at = rows.messages(piece.start, piece.stop), 0
            while at < len(added.ends):
                at = made[-1].fill(added, at, CHUNK_SIZE)
                if made[-1].size >= CHUNK_SIZE:
                    made.append(Chunk())
        return [chunk for chunk in made if chunk.parts]

    def _gaps(self) -> list[dict[int, int]]:
        """Return for each part the bytes of the messages that stand between two of its runs, by the row behind them."""
        gaps: list[dict[int, int]] = [{} for _ in self.parts]
        for before, piece, behind in zip(self.pieces, self.pieces[1:], self.pieces[2:], strict=False):
            if isinstance(before, Run) and isinstance(piece, Chunk) and isinstance(behind, Run) and before.part == behind.part:
                gaps[behind.part][behind.start] = piece.size
        return gaps

    def packed(self) -> list[Packed]:
        """Return the chunks as they stand in a file."""
        return [pack(chunk, chunk.indexed()) for chunk in self.chunks()]


def _rows(part: Part, gaps: Mapping[int, int]) -> Rows:
    from analyzer.columns.rows import Rows

    return Rows(*part, gaps)
