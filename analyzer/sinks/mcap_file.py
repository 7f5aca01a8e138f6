"""An MCAP file being written: records of the `mcap` library, in chunks that are built here.

The library's writer builds each message field by field (about 3 us). A log has two messages per frame, so that would cost more
than framing and decoding. Here a message is one packed header plus its data, and an index is an array. A thread, or other
processes, pack each batch of chunks while the next one fills. The library's own record classes write everything else.

Rules: nothing is written twice; `finish` completes the file; after `flush` all messages can be recovered. A chunk and its
indexes go out in one write. If that raises (a full disk), nothing is lost, and `flush` or `finish` may be called again.
"""

from __future__ import annotations

import io
import struct
import zlib
from array import array
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from analyzer.sinks.mcap_chunk import CHUNK_SIZE, COMPRESSION, MESSAGE, Batch, Chunk, Packed, Part, Run, pack, record_bytes
from analyzer.sinks.mcap_index import Index, MemoryIndex
from analyzer.sources.magic import MCAP

if TYPE_CHECKING:
    from analyzer.columns.codec import Integers
    from analyzer.columns.plain import Plain

#: Rows of blocks that are packed together: fewer cost more for each kind of frame, more need more memory.
ROWS = 3 << 14
#: A chunk index: opcode and length, times of the messages, place and length of the chunk, bytes of offsets;
_CHUNK_INDEX = struct.Struct("<BQQQQQI")
#: channel and place of its message index, for each;
_OFFSET = "HQ"
#: bytes of the message indexes, compression, size with and without it.
_CHUNK_SIZES = struct.Struct("<QI4sQQ")
_CHUNK_INDEX_REST = _CHUNK_INDEX.size - 9 + _CHUNK_SIZES.size
#: Batches that may wait to be packed.
_AHEAD = 2
#: What of a file under way is kept besides its index, for a process that goes on with it.
_STATE = ("_position", "_counts", "_first_ns", "_last_ns", "_messages", "_chunks", "_metadata", "_schemas", "_channels")


class Writable(Protocol):
    """Where a file goes."""

    def write(self, data: bytes, /) -> int:
        """Write all of it."""

    def flush(self) -> None:
        """Hold nothing back."""


@runtime_checkable
class LogFile(Protocol):
    """What a log is written to: a file, or something that passes the same on to others beside one."""

    @property
    def messages(self) -> int:
        """Messages written so far."""

    def add_schema(self, name: str, data: bytes) -> int:
        """Register a JSON Schema and return its id."""

    def add_channel(self, topic: str, schema_id: int, metadata: Mapping[str, str]) -> int:
        """Register a channel of JSON messages and return its id."""

    def add_message(self, channel_id: int, sequence: int, log_ns: int, publish_ns: int, data: bytes) -> None:
        """Add a message; `log_ns` must not be smaller than the one before."""

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record."""

    def flush(self) -> None:
        """Write everything so far. Raises OSError with nothing lost."""

    def finish(self) -> None:
        """Write what is left, the summary and the footer. Raises OSError with nothing lost."""

    def abandon(self) -> None:
        """Give the file up."""


class Pending(Protocol):
    """Chunks that are being packed."""

    def done(self) -> bool:
        """Say whether they are packed."""

    def result(self) -> list[Packed]:
        """Return them, once they are."""


class Packer(Protocol):
    """What packs batches while the next one fills. `ahead`: how many may wait."""

    ahead: int

    def submit(self, batch: Batch) -> Pending:
        """Pack a batch, now or soon."""

    def shutdown(self, *, at_once: bool = False) -> None:
        """End. `at_once`: with nothing finished."""


class _Thread:
    """A packer of this process: a thread compresses, which needs no Python."""

    ahead = _AHEAD

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="servotap-compress")

    def submit(self, batch: Batch) -> Future[list[Packed]]:
        # Indexes are made of columns in many small steps, each of which would wait for the other thread.
        chunks = [(chunk, chunk.indexed()) for chunk in batch.chunks()]
        return self._pool.submit(lambda: [pack(*each) for each in chunks])

    def shutdown(self, *, at_once: bool = False) -> None:
        self._pool.shutdown(wait=not at_once, cancel_futures=at_once)


class McapFile:
    """Writes an MCAP file to a stream open for binary writing. Not safe to use from several threads.

    `index`: what the summary will hold, in memory unless said otherwise. `packer`: a thread unless said otherwise.
    `patient`: where a message fills a chunk that cannot be written, nothing is raised but `stalled` set; the next `flush`
    tries again.
    """

    def __init__(
        self,
        stream: Writable,
        *,
        profile: str,
        library: str,
        index: Index | None = None,
        patient: bool = False,
        packer: Packer | None = None,
    ) -> None:
        self._begin(stream, index or MemoryIndex(), patient, packer or _Thread())
        self._put(MCAP + record_bytes(Header(profile, library)))

    def _begin(self, stream: Writable, index: Index, patient: bool, packer: Packer) -> None:
        self._stream = stream
        self._patient = patient
        #: A chunk could not be written and waits.
        self.stalled = False
        self._index = index
        #: Messages behind the last rows; what stands before them in the batch; its parts, and how many rows they have.
        self._building = Chunk()
        self._pieces: list[Chunk | Run] = []
        self._parts: list[Part] = []
        self._rows = 0
        #: The block of the last rows, where they begin in it, and the runs of them with first number and times.
        self._plain: Plain | None = None
        self._first_row = 0
        self._runs: list[tuple[Run, int, Integers]] = []
        self._position = self._first_ns = self._last_ns = self._messages = 0
        self._chunks = self._metadata = self._schemas = self._channels = self._attachments = 0
        self._counts: dict[int, int] = {}
        self._packer = packer
        self._waiting: list[Pending] = []

    @classmethod
    def resume(cls, stream: Writable, state: Mapping[str, Any], index: Index, *, patient: bool = False) -> McapFile:
        """Go on with a file that another left after a `flush`.

        `state`: what it returned as such; `stream`: stands at that place; `index`: holds what it held.
        """
        file = cls.__new__(cls)
        file._begin(stream, index, patient, _Thread())
        for name in _STATE:
            setattr(file, name, state[name])
        return file

    def state(self) -> dict[str, Any]:
        """Return what `resume` needs, right after a `flush`."""
        return {name: getattr(self, name) for name in _STATE}

    @property
    def messages(self) -> int:
        return self._messages

    @property
    def position(self) -> int:
        """Bytes written so far."""
        return self._position

    def schemas(self) -> Iterator[Schema]:
        return self._indexed(Opcode.SCHEMA, Schema.read)

    def channels(self) -> Iterator[Channel]:
        return self._indexed(Opcode.CHANNEL, Channel.read)

    def _indexed(self, opcode: Opcode, read: Callable[[ReadDataStream], Any]) -> Iterator[Any]:
        for record in self._index.records(opcode):
            yield read(ReadDataStream(io.BytesIO(record[9:])))

    def add_schema(self, name: str, data: bytes) -> int:
        self._schemas += 1
        self._in_chunk(Schema(id=self._schemas, data=data, encoding="jsonschema", name=name))
        return self._schemas

    def add_channel(self, topic: str, schema_id: int, metadata: Mapping[str, str]) -> int:
        self._channels += 1
        channel = Channel(id=self._channels, topic=topic, message_encoding="json", metadata=dict(metadata), schema_id=schema_id)
        self._counts[channel.id] = 0
        self._in_chunk(channel)
        return channel.id

    def _in_chunk(self, record: McapRecord) -> None:
        data = record_bytes(record)
        self._index.add(data)
        self._building.parts.append(data)
        self._building.size += len(data)

    def add_message(self, channel_id: int, sequence: int, log_ns: int, publish_ns: int, data: bytes) -> None:
        building = self._building
        index = building.index.get(channel_id)
        if index is None:
            index = building.index[channel_id] = array("Q")
            if not building.messages:
                building.first_ns = log_ns
        index.append(log_ns)
        index.append(building.size)
        size = len(data)
        building.parts += (MESSAGE.pack(5, size + 22, channel_id, sequence & 0xFFFFFFFF, log_ns, publish_ns), data)
        building.size += size + 31
        building.last_ns = log_ns
        building.messages += 1
        if building.size >= CHUNK_SIZE:
            self._end_batch()

    def add_rows(self, plain: Plain, channels: Integers, start: int, stop: int, sequence: int, log_ns: Integers) -> None:
        """Add the messages of some rows of a block; `sequence` of the first, `log_ns` of each, as for single messages.

        `channels`: of each lane of the block, that of its topic and that of its state, 0 where it has none.
        """
        while start < stop:
            if self._plain is not plain:
                self._end_part()
                if self._rows + len(plain.lane) > ROWS:
                    # A block is packed whole, even if the chunk grows larger.
                    self._end_batch()
            left = ROWS - self._rows - (0 if self._plain is None else start - self._first_row)
            if left <= 0:
                self._end_batch()
                continue
            if self._plain is None:
                self._plain, self._row_channels, self._first_row = plain, channels, start
            end = min(stop, start + left)
            self._end_piece()
            count = end - start
            run = Run(len(self._parts), start - self._first_row, end - self._first_row)
            self._runs.append((run, sequence, log_ns[:count]))
            self._pieces.append(run)
            start, sequence, log_ns = end, sequence + count, log_ns[count:]

    def flush(self) -> None:
        self._end_batch()
        while self._waiting:
            self._write_oldest()
        self._index.flush()
        self._stream.flush()
        self.stalled = False

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record; everything before it is written first."""
        self.flush()
        start = self._position
        self._put(record_bytes(Metadata(name=name, metadata=dict(values))))
        self._metadata += 1
        self._index.add(record_bytes(MetadataIndex(offset=start, length=self._position - start, name=name)))

    def finish(self) -> None:
        """Write what is left, the summary and the footer. The stream stays open."""
        self.flush()
        start = self._position
        try:
            self._summary(record_bytes(DataEnd(0)))
            self._stream.flush()
        except OSError:
            self._position = start
            rewind = getattr(self._stream, "rewind", None)
            if rewind is not None:
                rewind(start)
            raise
        self._packer.shutdown()

    def abandon(self) -> None:
        """Give the file up: stop the packer and write nothing more."""
        self._packer.shutdown(at_once=True)
        self._waiting.clear()

    # --- chunks ---------------------------------------------------------------------------------------------------

    def _end_piece(self) -> None:
        building = self._building
        if building.parts:
            self._pieces.append(building)
            self._building = Chunk()

    def _end_part(self) -> None:
        """Keep of the last block what the batch needs."""
        if self._plain is not None:
            self._parts.append(Part.of(self._plain, self._row_channels, self._first_row, self._runs))
            self._rows += self._runs[-1][0].stop
            self._plain, self._runs = None, []

    def _end_batch(self) -> None:
        """Have packed what is there so far: its last chunk ends here."""
        self._end_piece()
        self._end_part()
        if not self._pieces:
            return
        batch = Batch(self._pieces, self._parts)
        self._pieces, self._parts, self._rows = [], [], 0
        self._waiting.append(self._packer.submit(batch))
        while self._waiting and (len(self._waiting) > self._packer.ahead or self._waiting[0].done()):
            try:
                self._write_oldest()
            except OSError:
                if not self._patient:
                    raise
                self.stalled = True
                return

    def _write_oldest(self) -> None:
        chunks = self._waiting[0].result()
        while chunks:
            packed = chunks[0]
            start, length, own = self._position, len(packed.head) + len(packed.data), packed.indexed
            # Packed here: a chunk has an entry for each channel, and the library writes them number by number.
            behind, offsets = start + length, [0] * (2 * len(own.channels))
            offsets[::2], offsets[1::2] = own.channels, [behind + begin for begin in own.begins]
            places = struct.pack(f"<{_OFFSET * len(own.channels)}", *offsets)
            fixed = packed.first_ns, packed.last_ns, start, length
            index = b"".join((
                _CHUNK_INDEX.pack(Opcode.CHUNK_INDEX, _CHUNK_INDEX_REST + len(places), *fixed, len(places)), places,
                _CHUNK_SIZES.pack(len(own.data), len(COMPRESSION), COMPRESSION, len(packed.data), packed.size),
            ))  # fmt: skip
            self._put(b"".join((packed.head, packed.data, own.data)))
            # Only now is it gone from memory: the write may have failed.
            del chunks[0]
            self._chunks += 1
            self._index.add(index)
            for channel, count in zip(own.channels, own.counts, strict=True):
                self._counts[channel] += count
            if packed.messages:
                self._first_ns = self._first_ns if self._messages else packed.first_ns
                self._last_ns = max(self._last_ns, packed.last_ns)
                self._messages += packed.messages
        del self._waiting[0]

    # --- the end --------------------------------------------------------------------------------------------------

    def _summary(self, before: bytes) -> None:
        """Write the summary, in few writes; `before` stands before it."""
        start = place = self._position + len(before)
        statistics = Statistics(
            attachment_count=self._attachments,
            channel_count=self._channels,
            channel_message_counts=self._counts,
            chunk_count=self._chunks,
            message_count=self._messages,
            message_end_time=self._last_ns,
            message_start_time=self._first_ns,
            metadata_count=self._metadata,
            schema_count=self._schemas,
        )
        groups: tuple[tuple[Opcode, Iterator[bytes]], ...] = (
            (Opcode.SCHEMA, self._index.records(Opcode.SCHEMA)),
            (Opcode.CHANNEL, self._index.records(Opcode.CHANNEL)),
            (Opcode.STATISTICS, iter((record_bytes(statistics),))),
            (Opcode.CHUNK_INDEX, self._index.records(Opcode.CHUNK_INDEX)),
            (Opcode.ATTACHMENT_INDEX, self._index.records(Opcode.ATTACHMENT_INDEX)),
            (Opcode.METADATA_INDEX, self._index.records(Opcode.METADATA_INDEX)),
        )
        offsets = []
        batch = [before]
        size = crc = 0
        for opcode, records in groups:
            first = place
            for record in records:
                batch.append(record)
                size += len(record)
                place += len(record)
                crc = zlib.crc32(record, crc)
                if size >= CHUNK_SIZE:
                    self._put(b"".join(batch))
                    batch.clear()
                    size = 0
            if place > first:
                offsets.append(record_bytes(SummaryOffset(opcode, first, place - first)))
        data = b"".join(offsets)
        crc = zlib.crc32(struct.pack("<BQQQ", Opcode.FOOTER, 20, start, place), zlib.crc32(data, crc))
        footer = Footer(summary_start=start, summary_offset_start=place, summary_crc=crc)
        self._put(b"".join((*batch, data, record_bytes(footer), MCAP)))

    def _put(self, data: bytes) -> None:
        self._stream.write(data)
        self._position += len(data)
