"""Repairs an MCAP log: copies all readable chunks unchanged, and makes a new summary.

Works on logs of any program. A chunk that breaks off (a killed process, a full disk) is read up to the break. A chunk with
only its head damaged is read whole, if its check fits. A record is copied only if it is valid for its kind; else the search
goes on for the next valid record. A chunk that holds invalid records is packed anew without them. Each of these is reported
as a `Fault`. Topics whose declaration was lost with a chunk are declared from the old summary, if there is one. Otherwise
their messages go to a topic that says so.

Memory is bounded by one chunk and by the index of the new summary.
"""

from __future__ import annotations

import contextlib
import re
import time
from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from fastcrc import crc32
from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex, Channel, Chunk, ChunkIndex, Header, Metadata, Schema

from analyzer import __version__
from analyzer.errors import UnreadableError
from analyzer.sinks.mcap_chunk import INDEX_HEAD, compressed, record_bytes
from analyzer.sinks.mcap_file import McapFile, Writable
from analyzer.sinks.mcap_sound import (
    CHUNK_HEAD,
    LAST_OPCODE,
    PRIVATE,
    chunk_data,
    is_whole,
    record_at,
    sound_records,
    unpack_begin,
    unsound,
)
from analyzer.sources import magic
from analyzer.sources import mcap_scan as scan
from analyzer.sources.recording_parts import METADATA
from analyzer.values import counted


class _TakenFile(McapFile):
    """A file that takes over records of another unchanged: chunks (with new indexes) and attachments."""

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


#: Name of the metadata record that says what was done.
RECOVERED = "servotap.recovered"
#: Where a record may begin: kinds that stand before the summary, with a length below 4 GiB.
_MARK = re.compile(rb"(?=[\x03-\x07\x09\x0c\x0f].{4}\x00{4})", re.DOTALL)
_SEARCH = 1 << 20
_LOST = "/lost"


@dataclass(frozen=True)
class Fault:
    """A place that could not be read: `size` bytes at `offset`, and what about them."""

    offset: int
    size: int
    text: str

    def __str__(self) -> str:
        return f"byte {self.offset}: {self.text}"


@dataclass
class RepairResult:
    """The content of the new log, and the faults of the old one."""

    chunks: int = 0
    messages: int = 0
    first_ns: int = 0
    last_ns: int = 0
    faults: list[Fault] = field(default_factory=list)


def repair(path: Path, target: Writable, position: Callable[[int], None] = lambda at: None) -> RepairResult:
    """Copy the readable part of a log into a new log; `position` is called with the progress in bytes.

    Raises UnreadableError if the file is not an MCAP log, OSError if the target cannot be written.
    """
    with path.open("rb") as stream:
        return _Repair(path, stream, target, position).run()


class _Repair:
    """One log that is made whole."""

    def __init__(self, path: Path, stream: IO[bytes], target: Writable, position: Callable[[int], None]) -> None:
        self._path = path
        self._stream = stream
        self._size = path.stat().st_size
        self._target = target
        self._tell = position
        self._outcome = RepairResult()
        self._file: _TakenFile
        self._schemas: set[int] = set()
        self._channels: set[int] = set()
        #: What the old summary declares, for what stands nowhere else.
        self._old: dict[int, tuple[bytes, bytes | None]] = {}
        self._about: dict[str, dict[str, str]] = {}
        #: Top-level messages, which become a chunk of their own.
        self._loose: list[bytes] = []
        self._ended = False
        #: What stands before is a chunk or an index of one.
        self._indexing = False

    def run(self) -> RepairResult:
        header = Header("", "")
        at = len(magic.MCAP)
        self._stream.seek(0)
        if self._stream.read(at) != magic.MCAP:
            if self._search(0) is None:
                raise UnreadableError(
                    f"{self._path} is not an MCAP log, expected the beginning 89 4D 43 41 50 30 0D 0A, or any whole record"
                )
            self._outcome.faults.append(Fault(0, at, "the beginning of the file is damaged"))
        first = record_at(self._stream, at)
        if first is not None and first[0] == scan.HEADER and not unsound(*first):
            header = scan.parsed(first[1], Header.read)
            at += scan.HEAD.size + len(first[1])
        self._file = _TakenFile(self._target, header)
        self._old = self._declared()
        while at < self._size and not self._ended:
            self._tell(at)
            at = self._step(at)
        self._put_loose()
        outcome = self._outcome
        if not self._ended and not outcome.faults:
            outcome.faults.append(Fault(self._size, 0, "the log ends here, without its summary"))
        elif self._ended and self._begins and not is_whole(self._path):
            outcome.faults.append(Fault(at, 0, "the summary behind the messages is missing or damaged"))
        self._describe()
        self._file.finish()
        outcome.messages = self._file.messages
        outcome.first_ns, outcome.last_ns = self._file.times
        return outcome

    @property
    def _begins(self) -> bool:
        """The file begins as a log does."""
        self._stream.seek(0)
        return self._stream.read(len(magic.MCAP)) == magic.MCAP

    def _step(self, at: int) -> int:
        """Deal with the record at a place; return where the next one begins."""
        record = record_at(self._stream, at)
        if record is None:
            return self._fault(at, "")
        opcode, body = record
        problem = unsound(opcode, body)
        # An index of messages behind its chunk, the kind of which was damaged, looks like a message.
        if opcode == scan.MESSAGE and self._indexing and not unsound(scan.MESSAGE_INDEX, body):
            problem = "an index under another kind"
        if problem:
            return self._fault(at, problem)
        if opcode == scan.CHUNK:
            self._put_loose()
            chunk = scan.packed(body)
            data, count, size = sound_records(scan.unpack(chunk))
            if count:
                self._outcome.faults.append(Fault(at, size, f"left out of a chunk: {counted(count, 'damaged record')}"))
                self._repack(data)
            else:
                self._copy_chunk(body, chunk, data)
            self._outcome.chunks += 1
        else:
            self._other(opcode, body)
        self._indexing = opcode in (scan.CHUNK, scan.MESSAGE_INDEX)
        return at + scan.HEAD.size + len(body)

    def _other(self, opcode: int, body: bytes) -> None:
        if opcode == scan.DATA_END:
            self._ended = True
        elif opcode == scan.SCHEMA:
            self._declare_schema(body)
            self._file.put(opcode, body)
        elif opcode == scan.CHANNEL:
            self._declare_channel(body)
            self._file.put(opcode, body)
        elif opcode == scan.MESSAGE:
            scan.message(body)
            self._loose.append(scan.HEAD.pack(opcode, len(body)) + body)
            if sum(map(len, self._loose[-64:])) > scan.RECORD_LIMIT >> 6 or len(self._loose) >= 4096:
                self._put_loose()
        elif opcode == scan.METADATA:
            metadata = scan.parsed(body, Metadata.read)
            self._about[metadata.name] = dict(metadata.metadata)
            self._file.add_metadata(metadata.name, metadata.metadata)
        elif opcode == Opcode.ATTACHMENT:
            self._file.take_attachment(body)
        elif opcode >= PRIVATE:
            self._file.put(opcode, body)

    # --- faults ---------------------------------------------------------------------------------------------------

    def _fault(self, at: int, problem: str) -> int:
        """Deal with a place where no sound record begins: save what can be saved of it, look for what follows."""
        following = self._search(at + 1)
        end = self._size if following is None else following
        left_out = f"{counted(end - at, 'byte')} are no whole record"
        if problem:
            left_out = f"a record of {counted(end - at, 'byte')} is damaged ({problem}) and left out"
        text = self._saved(at, end) or left_out
        if following is None:
            text += "; nothing readable follows"
        self._outcome.faults.append(Fault(at, end - at, text))
        return end

    def _search(self, at: int) -> int | None:
        """Return where the next record begins that can be believed."""
        while at < self._size:
            self._tell(at)
            self._stream.seek(at)
            block = self._stream.read(_SEARCH + scan.HEAD.size)
            for found in _MARK.finditer(block):
                if self._believed(at + found.start()):
                    return at + found.start()
            at += _SEARCH
        return None

    def _believed(self, start: int) -> bool:
        self._stream.seek(start)
        head = self._stream.read(scan.HEAD.size)
        opcode, length = scan.HEAD.unpack(head)
        end = start + scan.HEAD.size + length
        if end > self._size or length > scan.RECORD_LIMIT:
            return False
        if opcode != scan.CHUNK and not self._head_at(end):
            return False
        record = record_at(self._stream, start)
        return record is not None and not unsound(*record)

    def _head_at(self, at: int) -> bool:
        """Say whether a record may begin at a place, or nothing any more."""
        self._stream.seek(at)
        head = self._stream.read(scan.HEAD.size)
        if len(head) < scan.HEAD.size:
            return not head
        opcode, length = scan.HEAD.unpack(head)
        return bool((0 < opcode <= LAST_OPCODE or opcode >= PRIVATE) and at + scan.HEAD.size + length <= self._size)

    def _saved(self, at: int, end: int) -> str:
        """Read a chunk whose head is damaged, or one that breaks off as far as it goes; return what was saved, or nothing."""
        self._stream.seek(at)
        head = self._stream.read(scan.HEAD.size)
        body = self._stream.read(min(max(0, end - at - scan.HEAD.size), scan.RECORD_LIMIT))
        if len(head) < scan.HEAD.size or len(body) < CHUNK_HEAD:
            return ""
        data = chunk_data(body)
        whole = data is not None
        opcode, length = scan.HEAD.unpack(head)
        if data is None:
            # Where nothing is missing something is wrong, and which of the messages cannot be told.
            if opcode != scan.CHUNK or at + scan.HEAD.size + length <= end or body[28:36] != b"\x04\x00\x00\x00zstd":
                return ""
            data = unpack_begin(body[44:])
        stop = 0
        with contextlib.suppress(ValueError):
            for _, _, stop in scan.walk(data):  # noqa: B007
                pass
        sound, count, _ = sound_records(data[:stop])
        messages = sum(kind == scan.MESSAGE for kind, _, _ in scan.walk(sound))
        if not messages and not whole:
            return ""
        self._put_loose()
        self._repack(sound)
        read = f"{counted(messages, 'message')} read"
        if count:
            read += f", left out: {counted(count, 'damaged record')}"
        return f"the head of a chunk is damaged: {read}" if whole else f"a truncated chunk: {read}"

    def _repack(self, data: bytes) -> None:
        """Copy records as a chunk of their own."""
        times = [scan.message(data[first:stop]).log_ns for kind, first, stop in scan.walk(data) if kind == scan.MESSAGE]
        start_ns, end_ns = min(times, default=0), max(times, default=0)
        packed = compressed(data)
        record = record_bytes(
            Chunk(
                compression="zstd", data=packed, message_start_time=start_ns, message_end_time=end_ns,
                uncompressed_crc=crc32.iso_hdlc(data), uncompressed_size=len(data),
            )
        )  # fmt: skip
        body = record[scan.HEAD.size :]
        self._copy_chunk(body, scan.packed(body), data)

    def _put_loose(self) -> None:
        if self._loose:
            data = b"".join(self._loose)
            self._loose.clear()
            self._repack(data)

    # --- chunks and declarations ----------------------------------------------------------------------------------

    def _copy_chunk(self, body: bytes, chunk: scan.Packed, data: bytes) -> None:
        places: dict[int, array[int]] = {}
        for opcode, first, stop in scan.walk(data):
            if opcode == scan.MESSAGE:
                channel = int.from_bytes(data[first : first + 2], "little")
                index = places.get(channel)
                if index is None:
                    index = places[channel] = array("Q")
                index.append(int.from_bytes(data[first + 6 : first + 14], "little"))
                index.append(first - scan.HEAD.size)
            elif opcode == scan.SCHEMA:
                self._declare_schema(data[first:stop])
            elif opcode == scan.CHANNEL:
                self._declare_channel(data[first:stop])
        for channel in places:
            if channel not in self._channels:
                self._declare_lost(channel)
        self._file.take_chunk(body, chunk, places)

    def _declare_schema(self, body: bytes) -> None:
        number = int.from_bytes(body[:2], "little")
        if number not in self._schemas:
            self._schemas.add(number)
            self._file.take_schema(body)

    def _declare_channel(self, body: bytes) -> None:
        number = int.from_bytes(body[:2], "little")
        if number not in self._channels:
            schema = int.from_bytes(body[2:4], "little")
            if schema and schema not in self._schemas:
                known = (each for _, each in self._old.values() if each is not None)
                same = (each for each in known if int.from_bytes(each[:2], "little") == schema)
                self._put_schema(next(same, None) or _any_schema(schema))
            self._channels.add(number)
            self._file.take_channel(body, number)

    def _put_schema(self, body: bytes) -> None:
        """Declare a schema whose declaration was lost: the new file needs it before its channels."""
        self._declare_schema(body)
        self._file.put(scan.SCHEMA, body)

    def _declare_lost(self, number: int) -> None:
        """Declare a channel whose declaration was lost; it stands outside of chunks."""
        channel, schema = self._old.get(number, (b"", None))
        if not channel:
            free = next(n for n in range(0xFFFF, 0, -1) if n not in self._schemas)
            schema = _any_schema(free)
            channel = record_bytes(
                Channel(id=number, topic=f"{_LOST}/{number}", message_encoding="json", metadata={}, schema_id=free)
            )[scan.HEAD.size :]
            text = f"the declaration of channel {number} is lost: its messages stand on {_LOST}/{number}"
            self._outcome.faults.append(Fault(0, 0, text))
        if schema is not None and int.from_bytes(schema[:2], "little") not in self._schemas:
            self._put_schema(schema)
        self._declare_channel(channel)
        self._file.put(scan.CHANNEL, channel)

    def _declared(self) -> dict[int, tuple[bytes, bytes | None]]:
        """Return what the old summary declares, as bodies of records by channel."""
        from mcap.reader import SeekingReader

        self._stream.seek(0)
        try:
            summary = SeekingReader(self._stream, record_size_limit=scan.RECORD_LIMIT).get_summary()
        # On damaged records the library raises exceptions of any kind.
        except Exception:
            return {}
        if summary is None:
            return {}
        schemas = {number: record_bytes(schema)[scan.HEAD.size :] for number, schema in summary.schemas.items()}
        return {
            number: (record_bytes(channel)[scan.HEAD.size :], schemas.get(channel.schema_id))
            for number, channel in summary.channels.items()
        }

    def _describe(self) -> None:
        """Say in the new log what was done, and what a recording that was killed could not say of itself any more."""
        outcome = self._outcome
        values = {
            "version": __version__,
            "at": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            "faults": "; ".join(str(fault) for fault in outcome.faults[:50]) or "none",
        }
        begun = self._about.get(METADATA)
        if begun is not None and "servotap" not in self._about:
            self._file.add_metadata("servotap", {**begun, "incomplete": "the recording was killed", "ended": "killed"})
        self._file.add_metadata(RECOVERED, values)


def _any_schema(number: int) -> bytes:
    """Return a schema that fits any message, as the body of a record."""
    schema = Schema(id=number, data=b'{"type":"object"}', encoding="jsonschema", name="servotap.lost")
    return record_bytes(schema)[scan.HEAD.size :]
