"""An MCAP file that takes over records of another unchanged: chunks (with new indexes) and attachments.

`McapFile` makes the summary of these records.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping

from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex, ChunkIndex, Header

from analyzer import __version__
from analyzer.sinks.mcap_chunk import INDEX_HEAD, record_bytes
from analyzer.sinks.mcap_file import McapFile, Writable
from analyzer.sources import mcap_scan as scan


class TakenFile(McapFile):
    """A file that takes over records as they are."""

    def __init__(self, target: Writable, header: Header) -> None:
        library = f"{header.library} (repaired by servotap {__version__})".strip()
        super().__init__(target, profile=header.profile, library=library)

    def take_schema(self, body: bytes) -> None:
        self._schemas += 1
        self._index.add(scan.HEAD.pack(Opcode.SCHEMA, len(body)) + body)

    def take_channel(self, body: bytes, number: int) -> None:
        self._channels += 1
        self._counts.setdefault(number, 0)
        self._index.add(scan.HEAD.pack(Opcode.CHANNEL, len(body)) + body)

    def put(self, opcode: int, body: bytes) -> int:
        """Write a record; return where it begins."""
        start = self._position
        self._put(scan.HEAD.pack(opcode, len(body)) + body)
        return start

    def take_attachment(self, body: bytes) -> None:
        start = self.put(Opcode.ATTACHMENT, body)
        about = scan.parsed(body, Attachment.read)
        self._attachments += 1
        self._index.add(
            record_bytes(
                AttachmentIndex(
                    offset=start, length=self._position - start, create_time=about.create_time, log_time=about.log_time,
                    data_size=len(about.data), name=about.name, media_type=about.media_type,
                )
            )
        )  # fmt: skip

    def take_chunk(self, body: bytes, chunk: scan.Packed, places: Mapping[int, array[int]]) -> None:
        """Copy a chunk, its indexes made anew. `places`: channel -> time and place of each message."""
        start = self._position
        parts = [scan.HEAD.pack(Opcode.CHUNK, len(body)), body]
        length = scan.HEAD.size + len(body)
        offsets = {}
        place = start + length
        for channel, entries in places.items():
            offsets[channel] = place
            data = entries.tobytes()
            parts += (INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + len(data), channel, len(data)), data)
            place += INDEX_HEAD.size + len(data)
            self._counts[channel] = self._counts.get(channel, 0) + len(entries) // 2
        self._put(b"".join(parts))
        count = sum(len(entries) // 2 for entries in places.values())
        if count:
            first = min(min(entries[::2]) for entries in places.values())
            last = max(max(entries[::2]) for entries in places.values())
            self._first_ns = first if not self._messages else min(self._first_ns, first)
            self._last_ns = max(self._last_ns, last)
        self._messages += count
        self._chunks += 1
        self._index.add(
            record_bytes(
                ChunkIndex(
                    chunk_length=length, chunk_start_offset=start, compression=chunk.compression,
                    compressed_size=len(chunk.data), message_end_time=chunk.end_ns,
                    message_index_length=place - start - length, message_index_offsets=offsets,
                    message_start_time=chunk.start_ns, uncompressed_size=chunk.size,
                )
            )
        )  # fmt: skip

    @property
    def times(self) -> tuple[int, int]:
        """First and last time of all messages."""
        return self._first_ns, self._last_ns
