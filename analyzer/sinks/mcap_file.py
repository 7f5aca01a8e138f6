"""An MCAP file under way: records of the `mcap` library, chunks put together here.

The library's writer builds each message field by field (about 3 us); a log has two messages a frame, so that alone would
cost more than framing and decoding. Here a message is one packed header beside its data, an index is an array, and
chunks are compressed on a thread while the next one fills. Everything else is written by the library's own record classes.

Rules: nothing is written twice; a file is whole after `finish`; after `flush` everything so far can be recovered.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import IO

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
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

#: Uncompressed bytes of a chunk.
CHUNK_SIZE = 1 << 20
_MESSAGE = struct.Struct("<BQHIQQ")
_INDEX_HEAD = struct.Struct("<BQHI")
_LEVEL = 1
#: Chunks that may wait for the compressor.
_AHEAD = 2


class _Building:
    """A chunk under construction."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.size = 0
        self.first_ns = 0
        self.last_ns = 0
        self.messages = 0
        self.index: dict[int, array[int]] = {}


def _record_bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def _compress(data: bytes) -> tuple[bytes, int]:
    return zstandard.ZstdCompressor(level=_LEVEL).compress(data), zlib.crc32(data)


class McapFile:
    """Writes an MCAP file to a stream open for binary writing. Not safe to use from several threads."""

    def __init__(self, stream: IO[bytes], *, profile: str, library: str, chunk_size: int = CHUNK_SIZE) -> None:
        self._stream = stream
        self._chunk_size = chunk_size
        self._position = 0
        self._building = _Building()
        self._channels: list[Channel] = []
        self._schemas: list[Schema] = []
        self._counts: dict[int, int] = {}
        # As bytes: there is one for each MiB, and as objects they would be ten times as large.
        self._chunk_indexes: list[bytes] = []
        self._metadata_indexes: list[MetadataIndex] = []
        self._first_ns = 0
        self._last_ns = 0
        self._messages = 0
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="servotap-compress")
        self._waiting: list[tuple[_Building, int, Future[tuple[bytes, int]]]] = []
        self._put(MCAP0_MAGIC)
        self._record(Header(profile, library))

    @property
    def messages(self) -> int:
        """Messages added so far."""
        return self._messages

    def add_schema(self, name: str, data: bytes) -> int:
        """Register a JSON Schema and return its id."""
        schema = Schema(id=len(self._schemas) + 1, data=data, encoding="jsonschema", name=name)
        self._schemas.append(schema)
        self._in_chunk(schema)
        return schema.id

    def add_channel(self, topic: str, schema_id: int, metadata: Mapping[str, str]) -> int:
        """Register a channel of JSON messages and return its id."""
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding="json",
            metadata=dict(metadata),
            schema_id=schema_id,
        )
        self._channels.append(channel)
        self._counts[channel.id] = 0
        self._in_chunk(channel)
        return channel.id

    def _in_chunk(self, record: McapRecord) -> None:
        data = _record_bytes(record)
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

    def flush(self) -> None:
        """Write everything so far to the stream and flush it."""
        self._end_chunk()
        while self._waiting:
            self._write_oldest()
        self._stream.flush()

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record; everything before it is written first."""
        self.flush()
        start = self._position
        self._record(Metadata(name=name, metadata=dict(values)))
        self._metadata_indexes.append(MetadataIndex(offset=start, length=self._position - start, name=name))

    def finish(self) -> None:
        """Write what is left, the summary and the footer. The stream stays open."""
        self.flush()
        self._pool.shutdown()
        self._record(DataEnd(0))
        self._summary()
        self._stream.flush()

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
        for channel_id, index in building.index.items():
            self._counts[channel_id] += len(index) // 2
        data = b"".join(building.parts)
        building.parts = []
        self._waiting.append((building, len(data), self._pool.submit(_compress, data)))
        while len(self._waiting) > _AHEAD:
            self._write_oldest()

    def _write_oldest(self) -> None:
        building, size, future = self._waiting.pop(0)
        compressed, crc = future.result()
        start = self._position
        self._record(
            Chunk(
                compression="zstd",
                data=compressed,
                message_end_time=building.last_ns,
                message_start_time=building.first_ns,
                uncompressed_crc=crc,
                uncompressed_size=size,
            )
        )
        length = self._position - start
        offsets = {}
        index_start = self._position
        for channel_id, places in building.index.items():
            offsets[channel_id] = self._position
            entries = places.tobytes()
            self._put(_INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + len(entries), channel_id, len(entries)))
            self._put(entries)
        index = ChunkIndex(
            chunk_length=length,
            chunk_start_offset=start,
            compression="zstd",
            compressed_size=len(compressed),
            message_end_time=building.last_ns,
            message_index_length=self._position - index_start,
            message_index_offsets=offsets,
            message_start_time=building.first_ns,
            uncompressed_size=size,
        )
        self._chunk_indexes.append(_record_bytes(index))

    # --- the end --------------------------------------------------------------------------------------------------

    def _summary(self) -> None:
        start = self._position
        offsets = []
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunk_indexes),
            message_count=self._messages,
            message_end_time=self._last_ns,
            message_start_time=self._first_ns,
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self._schemas),
        )
        groups: tuple[tuple[Opcode, list[bytes]], ...] = (
            (Opcode.SCHEMA, [_record_bytes(r) for r in self._schemas]),
            (Opcode.CHANNEL, [_record_bytes(r) for r in self._channels]),
            (Opcode.STATISTICS, [_record_bytes(statistics)]),
            (Opcode.CHUNK_INDEX, self._chunk_indexes),
            (Opcode.METADATA_INDEX, [_record_bytes(r) for r in self._metadata_indexes]),
        )
        parts: list[bytes] = []
        size = 0
        for opcode, records in groups:
            length = sum(len(r) for r in records)
            if length:
                offsets.append(SummaryOffset(opcode, start + size, length))
            parts += records
            size += length
        offset_start = start + size
        data = b"".join(parts + [_record_bytes(offset) for offset in offsets])
        crc = zlib.crc32(struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start), zlib.crc32(data))
        self._put(data)
        self._record(Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=crc))
        self._put(MCAP0_MAGIC)

    def _record(self, record: McapRecord) -> None:
        self._put(_record_bytes(record))

    def _put(self, data: bytes) -> None:
        self._stream.write(data)
        self._position += len(data)
