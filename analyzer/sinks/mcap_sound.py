"""Whether records of an MCAP log are what their kinds say, and whether the `mcap` library reads a log.

On damaged records the library raises exceptions of any kind, so all are caught here, and what they say is returned.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema

from analyzer.errors import UnreadableError
from analyzer.sources import magic
from analyzer.sources import mcap_scan as scan
from analyzer.sources.stream import ZSTD_MAGIC
from analyzer.values import counted

#: Bytes of a chunk before its data, and where its check stands.
CHUNK_HEAD, _CHUNK_CRC = 48, slice(24, 28)
_INDEX = struct.Struct("<HI")
#: The kinds of the library, and those of other programs.
LAST_OPCODE = 0x0F
PRIVATE = 0x80
#: Kinds that the library's reader checks, and the sizes of those that have one.
_PARSED: dict[int, Any] = {
    scan.HEADER: Header, scan.SCHEMA: Schema, scan.CHANNEL: Channel, scan.METADATA: Metadata, Opcode.ATTACHMENT: Attachment
}  # fmt: skip
_SIZES = {scan.DATA_END: 4, scan.FOOTER: 20}


def is_whole(path: Path) -> bool:
    """Say whether a log was finished: it has its summary. Raises UnreadableError if the file is not an MCAP log."""
    with path.open("rb") as stream:
        if stream.read(len(magic.MCAP)) != magic.MCAP:
            raise UnreadableError(f"{path} is not an MCAP log, expected the beginning 89 4D 43 41 50 30 0D 0A")
    from mcap.reader import SeekingReader

    try:
        with path.open("rb") as stream:
            return SeekingReader(stream, record_size_limit=scan.RECORD_LIMIT).get_summary() is not None
    # On damaged records the library raises exceptions of any kind.
    except Exception:
        return False


def unreadable(path: Path, position: Callable[[int], None] = lambda at: None) -> str:
    """Read a finished log to its end with the `mcap` library; return what is wrong with it, or nothing."""
    from mcap.reader import SeekingReader
    from mcap.stream_reader import StreamReader

    try:
        with path.open("rb") as stream:
            reader = SeekingReader(stream, validate_crcs=True, record_size_limit=scan.RECORD_LIMIT)
            summary = reader.get_summary()
            if summary is None or summary.statistics is None:
                return "it has no summary"
            count = 0
            if summary.chunk_indexes:
                for count, _ in enumerate(reader.iter_messages(log_time_order=False), 1):
                    if count % 4096 == 0:
                        position(stream.tell())
            stream.seek(0)
            records = StreamReader(
                stream, emit_chunks=bool(count), validate_crcs=True, record_size_limit=scan.RECORD_LIMIT
            ).records
            count += sum(isinstance(record, Message) for record in records)
            expected = summary.statistics.message_count
            return "" if count == expected else f"{counted(count, 'message')}, and its summary says {expected}"
    # As above.
    except Exception as error:
        return f"{type(error).__name__}: {error}"


def broken_before(path: Path, end: int | None = None, position: Callable[[int], None] = lambda at: None) -> str:
    """Say what is not sound in a log before a place, where a record ends; `None`: before its summary. Nothing if all is.

    Raises UnreadableError where the system does not read it.
    """
    with path.open("rb") as stream:
        try:
            return _broken_before(stream, end, position)
        except OSError as error:
            raise UnreadableError(f"{path}: reading failed: {error.strerror}") from None


def _broken_before(stream: IO[bytes], end: int | None, position: Callable[[int], None]) -> str:
    if stream.read(len(magic.MCAP)) != magic.MCAP:
        return "it does not begin as an MCAP log"
    at = len(magic.MCAP)
    while end is None or at < end:
        position(at)
        record = record_at(stream, at)
        problem = f"it ends at byte {at}" if record is None else unsound(*record)
        if record is None or problem:
            return f"byte {at}: {problem}"
        at += scan.HEAD.size + len(record[1])
        if end is None and record[0] == scan.DATA_END:
            return ""
    return "" if at == end else f"no record ends at byte {end}"


def record_at(stream: IO[bytes], at: int) -> tuple[int, bytes] | None:
    """Return the record at a place, None where there is none."""
    stream.seek(at)
    head = stream.read(scan.HEAD.size)
    if len(head) < scan.HEAD.size:
        return None
    opcode, length = scan.HEAD.unpack(head)
    if not (0 < opcode <= LAST_OPCODE or opcode >= PRIVATE) or length > scan.RECORD_LIMIT:
        return None
    body = stream.read(length)
    return (opcode, body) if len(body) == length else None


def unsound(opcode: int, body: bytes) -> str:
    """Say why a record is not what its kind says, or nothing."""
    try:
        if opcode == scan.CHUNK:
            _check_chunk(scan.packed(body))
        elif opcode in _PARSED:
            stream = _Exact(body)
            _PARSED[opcode].read(ReadDataStream(stream))
            if stream.tell() != len(body):
                return f"{len(body) - stream.tell()} bytes too many"
            crc = int.from_bytes(body[-4:], "little")
            if opcode == Opcode.ATTACHMENT and crc and crc != zlib.crc32(body[:-4]):
                return "the check of an attachment does not fit"
        elif opcode == scan.MESSAGE_INDEX:
            size = _INDEX.unpack_from(body)[1]
            if size != len(body) - _INDEX.size or size % 16:
                return f"an index of {size} bytes in a record of {len(body)}"
        elif opcode in _SIZES and len(body) != _SIZES[opcode]:
            return f"{len(body)} bytes, expected {_SIZES[opcode]}"
        elif opcode == scan.MESSAGE:
            scan.message(body)
        elif opcode >= PRIVATE and chunk_data(body) is not None:
            return "a chunk under another kind"
    # As above.
    except Exception as error:
        return str(error) or type(error).__name__
    return ""


class _Exact(io.BytesIO):
    """Bytes of which a reader gets all that it asks for."""

    def read(self, size: int | None = -1) -> bytes:
        """Return so many bytes. Raises ValueError where there are fewer."""
        data = super().read(size)
        if size is not None and len(data) < size:
            raise ValueError(f"{size} bytes expected, {len(data)} are left")
        return data


def _check_chunk(chunk: scan.Packed) -> bytes:
    """Return the data of a chunk. Raises ValueError where something of its head does not fit it, and as `scan.unpack`."""
    data = scan.unpack(chunk)
    if len(data) != chunk.size:
        raise ValueError(f"a chunk of {chunk.size} bytes, got {len(data)}")
    # A reader by steps gives all data of such a frame; the library refuses it.
    if chunk.compression == "zstd" and not _ends(chunk.data):
        raise ValueError("the zstd frame of a chunk does not end")
    times = [
        int.from_bytes(data[at + 6 : at + 14], "little")
        for opcode, at, stop in scan.walk(data)
        if opcode == scan.MESSAGE and stop - at >= scan.MESSAGE_SIZE
    ]
    if times and (min(times), max(times)) != (chunk.start_ns, chunk.end_ns):
        raise ValueError("the times of a chunk are not those of its messages")
    return data


def sound_records(data: bytes) -> tuple[bytes, int, int]:
    """Return the records of a chunk that the library reads, how many others there are, and their bytes."""
    spans = [
        (first - scan.HEAD.size, stop)
        for opcode, first, stop in scan.walk(data)
        if (stop - first < scan.MESSAGE_SIZE if opcode == scan.MESSAGE else _unsound_inside(opcode, data[first:stop]))
    ]
    if not spans:
        return data, 0, 0
    begins = [0, *(stop for _, stop in spans)]
    ends = [*(start for start, _ in spans), len(data)]
    kept = b"".join(data[begin:end] for begin, end in zip(begins, ends, strict=True))
    return kept, len(spans), len(data) - len(kept)


def _unsound_inside(opcode: int, body: bytes) -> str:
    """Say why a declaration in a chunk is none; all other kinds are passed over by the library."""
    return unsound(opcode, body) if opcode in (scan.SCHEMA, scan.CHANNEL) else ""


def chunk_data(body: bytes) -> bytes | None:
    """Return the data of a chunk with a damaged byte in its head; None if the rest is missing or does not fit."""
    place = body.find(ZSTD_MAGIC, 0, CHUNK_HEAD)
    if place < 0:
        return None
    data = unpack_begin(body[place:])
    check = zlib.crc32(data).to_bytes(4, "little")
    # That three bytes of the check fit by chance is as unlikely as that a damaged log looks sound.
    return data if sum(a != b for a, b in zip(check, body[_CHUNK_CRC], strict=False)) <= 1 else None


def _ends(data: bytes) -> bool:
    """Say whether a zstd frame, which can be unpacked, has its end."""
    unpacker = zstandard.ZstdDecompressor().decompressobj()
    for piece in _pieces(data):
        unpacker.decompress(piece)
        if unpacker.eof:
            return True
    return False


def unpack_begin(data: bytes) -> bytes:
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
