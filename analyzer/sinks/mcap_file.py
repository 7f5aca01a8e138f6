"""An MCAP file being written: records of the `mcap` library, in chunks that are built here.

The library's writer builds each message field by field (about 3 us). A log has two messages per frame, so that would cost more
than framing and decoding. Here a message is one packed header plus its data, and an index is an array. A thread compresses
each chunk while the next one fills. The library's own record classes write everything else.

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

import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
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
from mcap.writer import MCAP0_MAGIC

from analyzer.sinks.mcap_index import Index, MemoryIndex

if TYPE_CHECKING:
    from analyzer.columns.codec import Integers
    from analyzer.columns.rows import Messages

#: Uncompressed bytes of a chunk.
CHUNK_SIZE = 1 << 20
_MESSAGE = struct.Struct("<BQHIQQ")
#: A chunk index: opcode and length, times of the messages, place and length of the chunk, bytes of offsets;
_CHUNK_INDEX = struct.Struct("<BQQQQQI")
#: channel and place of its message index, for each;
_OFFSET = struct.Struct("<HQ")
#: bytes of the message indexes, compression, size with and without it.
_CHUNK_SIZES = struct.Struct("<QI4sQQ")
_CHUNK_INDEX_REST = _CHUNK_INDEX.size - 9 + _CHUNK_SIZES.size
#: Of the index of a channel's messages in a chunk: opcode, length, channel, bytes of its entries.
INDEX_HEAD = struct.Struct("<BQHI")
_LEVEL = 1
#: Chunks that may wait for the compressor.
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
        """Messages added so far."""

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


class _Building:
    """A chunk under construction."""

    def __init__(self) -> None:
        self.parts: list[bytes | memoryview] = []
        self.size = 0
        self.first_ns = 0
        self.last_ns = 0
        self.messages = 0
        #: By channel: time and place of each message that came alone;
        self.index: dict[int, array[int]] = {}
        #: channels, times and places of those that came together.
        self.many: list[tuple[Integers, Integers, Integers]] = []
        #: Once it has ended: its index records, and where each channel's begins in them.
        self.index_data = b""
        self.begins: dict[int, int] = {}

    def forget(self) -> None:
        """Let go of the messages, which stand elsewhere now."""
        self.parts, self.index, self.many = [], {}, []

    def indexed(self) -> tuple[bytes, dict[int, int], dict[int, int]]:
        """Return the index records, where each channel's begins in them, and how many messages it has."""
        if self.many:
            return self._indexed_together()
        parts: list[bytes] = []
        begins: dict[int, int] = {}
        counts: dict[int, int] = {}
        place = 0
        for channel, logged in self.index.items():
            entries = logged.tobytes()
            parts += (INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + len(entries), channel, len(entries)), entries)
            begins[channel], counts[channel] = place, len(logged) // 2
            place += INDEX_HEAD.size + len(entries)
        return b"".join(parts), begins, counts

    def _indexed_together(self) -> tuple[bytes, dict[int, int], dict[int, int]]:
        import numpy as np

        from analyzer.columns.index import index_records

        for channel, logged in self.index.items():
            entries = np.array(logged).astype(np.int64).reshape(-1, 2)
            self.many.append((np.full(len(entries), channel, dtype=np.int64), entries[:, 0], entries[:, 1]))
        channels, log_ns, places = map(np.concatenate, zip(*self.many, strict=True))
        order = places.argsort(kind="stable") if self.index else slice(None)
        return index_records(channels[order], log_ns[order], places[order])


def record_bytes(record: McapRecord) -> bytes:
    """Return a record as it stands in a file, its opcode first."""
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def _compress(data: bytes) -> tuple[bytes, int]:
    return zstandard.ZstdCompressor(level=_LEVEL).compress(data), zlib.crc32(data)


class McapFile:
    """Writes an MCAP file to a stream open for binary writing. Not safe to use from several threads.

    `index`: what the summary will hold, in memory unless said otherwise. `patient`: where a message fills a chunk that
    cannot be written, nothing is raised but `stalled` set; the next `flush` tries again.
    """

    def __init__(
        self,
        stream: Writable,
        *,
        profile: str,
        library: str,
        chunk_size: int = CHUNK_SIZE,
        index: Index | None = None,
        patient: bool = False,
    ) -> None:
        self._begin(stream, chunk_size, index or MemoryIndex(), patient)
        self._put(MCAP0_MAGIC + record_bytes(Header(profile, library)))

    def _begin(self, stream: Writable, chunk_size: int, index: Index, patient: bool) -> None:
        self._stream = stream
        self._patient = patient
        #: A chunk could not be written and waits.
        self.stalled = False
        self._chunk_size = chunk_size
        self._index = index
        self._building = _Building()
        self._position = self._first_ns = self._last_ns = self._messages = 0
        self._chunks = self._metadata = self._schemas = self._channels = self._attachments = 0
        self._counts: dict[int, int] = {}
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="servotap-compress")
        self._waiting: list[tuple[_Building, int, Future[tuple[bytes, int]]]] = []

    @classmethod
    def resume(
        cls, stream: Writable, state: Mapping[str, Any], index: Index, *, chunk_size: int = CHUNK_SIZE, patient: bool = False
    ) -> McapFile:
        """Go on with a file that another left after a `flush`.

        `state`: what it returned as such; `stream`: stands at that place; `index`: holds what it held.
        """
        file = cls.__new__(cls)
        file._begin(stream, chunk_size, index, patient)
        for name in _STATE:
            setattr(file, name, state[name])
        return file

    def state(self) -> dict[str, Any]:
        """Return what `resume` needs, right after a `flush`."""
        return {name: getattr(self, name) for name in _STATE}

    @property
    def messages(self) -> int:
        """Messages added so far."""
        return self._messages

    @property
    def position(self) -> int:
        """Bytes written so far."""
        return self._position

    def schemas(self) -> Iterator[Schema]:
        """Yield the schemas registered so far."""
        return self._indexed(Opcode.SCHEMA, Schema.read)

    def channels(self) -> Iterator[Channel]:
        """Yield the channels registered so far."""
        return self._indexed(Opcode.CHANNEL, Channel.read)

    def _indexed(self, opcode: Opcode, read: Callable[[ReadDataStream], Any]) -> Iterator[Any]:
        for record in self._index.records(opcode):
            yield read(ReadDataStream(io.BytesIO(record[9:])))

    def add_schema(self, name: str, data: bytes) -> int:
        """Register a JSON Schema and return its id."""
        self._schemas += 1
        self._in_chunk(Schema(id=self._schemas, data=data, encoding="jsonschema", name=name))
        return self._schemas

    def add_channel(self, topic: str, schema_id: int, metadata: Mapping[str, str]) -> int:
        """Register a channel of JSON messages and return its id."""
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
        """Add a message; `log_ns` must not be smaller than the one before."""
        building = self._building
        index = building.index.get(channel_id)
        if index is None:
            index = building.index[channel_id] = array("Q")
            if not building.messages:
                building.first_ns = log_ns
        index.append(log_ns)
        index.append(building.size)
        size = len(data)
        building.parts += (_MESSAGE.pack(5, size + 22, channel_id, sequence & 0xFFFFFFFF, log_ns, publish_ns), data)
        building.size += size + 31
        building.last_ns = log_ns
        building.messages += 1
        if building.size >= self._chunk_size:
            self._end_chunk()

    def add_messages(self, added: Messages) -> None:
        """Add messages that are packed already."""
        starts, ends, log_ns = added.starts, added.ends, added.log_ns
        data = added.data.data
        at, count = 0, len(ends)
        while at < count:
            building, base = self._building, int(starts[at])
            # As for single messages: the message that fills a chunk is its last.
            stop = min(count, int(ends.searchsorted(base + self._chunk_size - building.size)) + 1)
            end = int(ends[stop - 1])
            if not building.messages:
                building.first_ns = int(log_ns[at])
            building.many.append((added.channels[at:stop], log_ns[at:stop], starts[at:stop] + (building.size - base)))
            building.parts.append(data[base:end])
            building.size += end - base
            building.last_ns = int(log_ns[stop - 1])
            building.messages += stop - at
            at = stop
            if building.size >= self._chunk_size:
                self._end_chunk()

    def flush(self) -> None:
        """Write everything so far to the stream and flush it."""
        self._end_chunk()
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
        self._pool.shutdown()

    def abandon(self) -> None:
        """Give the file up: stop the compressor and write nothing more."""
        self._pool.shutdown(wait=False, cancel_futures=True)
        self._waiting.clear()

    # --- chunks ---------------------------------------------------------------------------------------------------

    def _end_chunk(self) -> None:
        building = self._building
        if not building.parts:
            return
        self._building = _Building()
        if not self._messages:
            self._first_ns = building.first_ns
        self._messages += building.messages
        if building.messages:
            self._last_ns = max(self._last_ns, building.last_ns)
        building.index_data, building.begins, counts = building.indexed()
        for channel_id, count in counts.items():
            self._counts[channel_id] += count
        data = b"".join(building.parts)
        building.forget()
        self._waiting.append((building, len(data), self._pool.submit(_compress, data)))
        while len(self._waiting) > _AHEAD:
            try:
                self._write_oldest()
            except OSError:
                if not self._patient:
                    raise
                self.stalled = True
                return

    def _write_oldest(self) -> None:
        building, size, future = self._waiting[0]
        compressed, crc = future.result()
        start = self._position
        chunk = record_bytes(
            Chunk(
                compression="zstd",
                data=compressed,
                message_end_time=building.last_ns,
                message_start_time=building.first_ns,
                uncompressed_crc=crc,
                uncompressed_size=size,
            )
        )
        index_start = start + len(chunk)
        # Packed here: a chunk has an entry for each channel, and the library writes them number by number.
        places = b"".join(_OFFSET.pack(channel, index_start + at) for channel, at in building.begins.items())
        fixed = building.first_ns, building.last_ns, start, len(chunk)
        index = b"".join((
            _CHUNK_INDEX.pack(Opcode.CHUNK_INDEX, _CHUNK_INDEX_REST + len(places), *fixed, len(places)), places,
            _CHUNK_SIZES.pack(len(building.index_data), 4, b"zstd", len(compressed), size),
        ))  # fmt: skip
        self._put(b"".join((chunk, building.index_data)))
        # Only now is it gone from memory: the write may have failed.
        del self._waiting[0]
        self._chunks += 1
        self._index.add(index)

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
        self._put(b"".join((*batch, data, record_bytes(footer), MCAP0_MAGIC)))

    def _put(self, data: bytes) -> None:
        self._stream.write(data)
        self._position += len(data)
