"""Repairs an MCAP log: copies all readable chunks unchanged, and makes a new summary.

Works on logs of any program. A chunk that breaks off (a killed process, a full disk) is read up to the break. After unreadable
bytes, the search goes on for the next valid chunk. Each of these is reported as a `Fault`. Topics whose declaration was lost
with a chunk are declared from the old summary, if there is one. Otherwise their messages go to a topic that says so.

Memory is bounded by one chunk and by the index of the new summary.
"""

from __future__ import annotations

import re
import time
import zlib
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, Metadata, Schema

from analyzer import __version__
from analyzer.errors import UnreadableError
from analyzer.sinks.mcap_file import Writable, record_bytes
from analyzer.sinks.mcap_taken import TakenFile
from analyzer.sources import mcap_scan as scan
from analyzer.sources.recording_parts import METADATA
from analyzer.values import counted

#: Name of the metadata record that says what was done.
RECOVERED = "servotap.recovered"
#: Where a chunk may begin: its head stands before the name of its compression.
_CHUNK_MARK = re.compile(rb"\x04\x00\x00\x00zstd|\x03\x00\x00\x00lz4|\x0f\x04\x00\x00\x00\x00\x00\x00\x00", re.DOTALL)
_BEFORE_MARK = scan.HEAD.size + 28
_SEARCH = 1 << 20
_LAST_OPCODE = 0x0F
_PRIVATE = 0x80
_LEVEL = 1
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


def is_whole(path: Path) -> bool:
    """Say whether a log was finished. Raises UnreadableError if the file is not an MCAP log."""
    with path.open("rb") as stream:
        if stream.read(len(scan.MAGIC)) != scan.MAGIC:
            raise UnreadableError(f"{path} is not an MCAP log, expected the beginning 89 4D 43 41 50 30 0D 0A")
    from mcap.reader import SeekingReader

    try:
        with path.open("rb") as stream:
            return SeekingReader(stream, record_size_limit=scan.RECORD_LIMIT).get_summary() is not None
    # On damaged records the library raises exceptions of any kind.
    except Exception:
        return False


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
        self._file: TakenFile
        self._schemas: set[int] = set()
        self._channels: set[int] = set()
        #: What the old summary declares, for what stands nowhere else.
        self._old: dict[int, tuple[bytes, bytes | None]] = {}
        self._about: dict[str, dict[str, str]] = {}
        #: Top-level messages, which become a chunk of their own.
        self._loose: list[bytes] = []
        self._ended = False

    def run(self) -> RepairResult:
        header = Header("", "")
        at = len(scan.MAGIC)
        first = self._record(at)
        if first is not None and first[0] == scan.HEADER:
            header = scan.parsed(first[1], Header.read)
            at += scan.HEAD.size + len(first[1])
        self._file = TakenFile(self._target, header)
        self._old = self._declared()
        while at < self._size and not self._ended:
            self._tell(at)
            at = self._step(at)
        self._put_loose()
        outcome = self._outcome
        if not self._ended and not outcome.faults:
            outcome.faults.append(Fault(self._size, 0, "the log ends here, without its summary"))
        elif self._ended and not is_whole(self._path):
            outcome.faults.append(Fault(at, 0, "the summary behind the messages is missing or damaged"))
        self._describe()
        self._file.finish()
        outcome.messages = self._file.messages
        outcome.first_ns, outcome.last_ns = self._file.times
        return outcome

    def _record(self, at: int) -> tuple[int, bytes] | None:
        """Return the record at a place, None where there is none."""
        self._stream.seek(at)
        head = self._stream.read(scan.HEAD.size)
        if len(head) < scan.HEAD.size:
            return None
        opcode, length = scan.HEAD.unpack(head)
        if not (0 < opcode <= _LAST_OPCODE or opcode >= _PRIVATE) or length > scan.RECORD_LIMIT:
            return None
        body = self._stream.read(length)
        return (opcode, body) if len(body) == length else None

    def _step(self, at: int) -> int:
        """Deal with the record at a place; return where the next one begins."""
        record = self._record(at)
        if record is None:
            return self._fault(at)
        opcode, body = record
        end = at + scan.HEAD.size + len(body)
        try:
            if opcode == scan.CHUNK:
                self._put_loose()
                chunk = scan.packed(body)
                data = scan.unpack(chunk)
                self._copy_chunk(body, chunk, data)
                self._outcome.chunks += 1
            else:
                self._other(opcode, body)
        # zstandard, lz4 and the library each have errors of their own.
        except Exception as error:
            if isinstance(error, OSError):
                raise
            what = "a chunk" if opcode == scan.CHUNK else "a record"
            self._outcome.faults.append(Fault(at, end - at, f"{what} of {end - at} bytes is damaged ({error}) and left out"))
        return end

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
        elif opcode >= _PRIVATE:
            self._file.put(opcode, body)

    # --- faults ---------------------------------------------------------------------------------------------------

    def _fault(self, at: int) -> int:
        """Deal with a place where no record begins: salvage a chunk that breaks off, look for what follows."""
        following = self._search(at + 1)
        end = self._size if following is None else following
        saved = self._salvage(at, end)
        text = f"an incomplete record of {counted(end - at, 'byte')}"
        if saved:
            text = f"a truncated chunk: {counted(saved, 'message')} read"
        if following is None:
            text += "; nothing readable follows"
        self._outcome.faults.append(Fault(at, end - at, text))
        return end

    def _search(self, at: int) -> int | None:
        """Return where the next record begins that can be believed: a chunk that checks, or the end of the data."""
        overlap = _BEFORE_MARK + 16
        while at < self._size:
            self._tell(at)
            self._stream.seek(at)
            block = self._stream.read(_SEARCH + overlap)
            for found in _CHUNK_MARK.finditer(block):
                mark = at + found.start()
                if found[0][0] == scan.DATA_END:
                    if self._record(mark + scan.HEAD.size + 4) is not None:
                        return mark
                    continue
                start = mark - _BEFORE_MARK
                if start >= at and self._believed(start):
                    return start
            at += _SEARCH
        return None

    def _believed(self, start: int) -> bool:
        record = self._record(start)
        if record is None or record[0] != scan.CHUNK:
            return False
        try:
            scan.unpack(scan.packed(record[1]))
        # As above.
        except Exception:
            return False
        return True

    def _salvage(self, at: int, end: int) -> int:
        """Read a chunk that breaks off as far as it goes; return how many messages it gave."""
        self._stream.seek(at)
        body = self._stream.read(min(end - at, scan.RECORD_LIMIT))[scan.HEAD.size :]
        mark = body[28:36]
        if mark != b"\x04\x00\x00\x00zstd" or len(body) < 44:
            return 0
        data = _unpack_begin(body[44:])
        whole = 0
        records = []
        try:
            for opcode, first, stop in scan.walk(data):
                whole = stop
                if opcode == scan.MESSAGE:
                    records.append(scan.message(data[first:stop]))
        except ValueError:
            pass  # where it breaks off; what was whole before is kept
        if not records:
            return 0
        data = data[:whole]
        start_ns, end_ns = min(m.log_ns for m in records), max(m.log_ns for m in records)
        self._repack(data, start_ns, end_ns)
        return len(records)

    def _repack(self, data: bytes, start_ns: int, end_ns: int) -> None:
        packed = zstandard.ZstdCompressor(level=_LEVEL).compress(data)
        record = record_bytes(
            Chunk(
                compression="zstd", data=packed, message_start_time=start_ns, message_end_time=end_ns,
                uncompressed_crc=zlib.crc32(data), uncompressed_size=len(data),
            )
        )  # fmt: skip
        body = record[scan.HEAD.size :]
        self._copy_chunk(body, scan.packed(body), data)

    def _put_loose(self) -> None:
        if self._loose:
            data = b"".join(self._loose)
            self._loose.clear()
            times = [scan.message(data[first:stop]).log_ns for _, first, stop in scan.walk(data)]
            self._repack(data, min(times), max(times))

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
            self._channels.add(number)
            self._file.take_channel(body, number)

    def _declare_lost(self, number: int) -> None:
        """Declare a channel whose declaration was lost."""
        channel, schema = self._old.get(number, (b"", None))
        if not channel:
            free = max(self._schemas, default=0) + 1
            schema = record_bytes(Schema(id=free, data=b'{"type":"object"}', encoding="jsonschema", name="servotap.lost"))[9:]
            channel = record_bytes(
                Channel(id=number, topic=f"{_LOST}/{number}", message_encoding="json", metadata={}, schema_id=free)
            )[9:]
            text = f"the declaration of channel {number} is lost: its messages stand on {_LOST}/{number}"
            self._outcome.faults.append(Fault(0, 0, text))
        # The new file needs them before the messages; both stand outside of chunks.
        if schema is not None and int.from_bytes(schema[:2], "little") not in self._schemas:
            self._declare_schema(schema)
            self._file.put(scan.SCHEMA, schema)
        self._declare_channel(channel)
        self._file.put(scan.CHANNEL, channel)

    def _declared(self) -> dict[int, tuple[bytes, bytes | None]]:
        """Return what the old summary declares, as bodies of records by channel."""
        from mcap.reader import SeekingReader

        self._stream.seek(0)
        try:
            summary = SeekingReader(self._stream, record_size_limit=scan.RECORD_LIMIT).get_summary()
        # As above.
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


def _unpack_begin(data: bytes) -> bytes:
    """Return what of a zstd frame that breaks off can be unpacked."""
    unpacker = zstandard.ZstdDecompressor().decompressobj()
    parts: list[bytes] = []
    size = 0
    for piece in _pieces(data):
        try:
            part = unpacker.decompress(piece)
        except zstandard.ZstdError:
            break
        parts.append(part)
        size += len(part)
        if size > scan.UNPACKED_LIMIT:
            break
    return b"".join(parts)


def _pieces(data: bytes) -> Iterator[bytes]:
    # Small, so that what comes before a damaged place is given.
    for at in range(0, len(data), 1024):
        yield data[at : at + 1024]
