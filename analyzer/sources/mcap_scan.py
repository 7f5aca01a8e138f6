"""The records of an MCAP file as bytes, within bounds: what the library trusts is checked here.

    record:  opcode u8 | length u64 | body        chunk:  start u64 | end u64 | size u64 | crc u32 | compression | data

Nothing is interpreted but heads, chunks and messages; for the rest the library's record classes read a body.
"""

from __future__ import annotations

import io
import struct
from array import array
from collections.abc import Callable, Iterator
from typing import IO, TYPE_CHECKING, Any, NamedTuple, TypeVar, cast

import msgspec
from fastcrc import crc32

from analyzer.sources import budget
from analyzer.system.decoding import UNDECODABLE
from analyzer.values import counted

if TYPE_CHECKING:
    from analyzer.columns.codec import Integers

HEAD = struct.Struct("<BQ")
#: Opcodes.
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = 1, 2, 3, 4, 5, 6, 7
METADATA, DATA_END = 12, 15
#: Bytes of one record, and of one chunk unpacked.
RECORD_LIMIT = budget.RECORD_LIMIT
UNPACKED_LIMIT = budget.CONTAINER_LIMIT
_MESSAGE = struct.Struct("<HIQQ")
#: Bytes of a message before its data.
MESSAGE_SIZE = _MESSAGE.size
_CHUNK = struct.Struct("<QQQII")
_LENGTH = struct.Struct("<Q")
_COMPRESSIONS = ("", "zstd", "lz4")
_LONGEST_NAME = 16
_STEP = 1 << 20

T = TypeVar("T")


class LogMessage(NamedTuple):
    """A message."""

    channel_id: int
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


def fields_of(data: bytes) -> dict[str, Any]:
    """Return the fields of a message, or what a schema says, from its JSON; nothing of one that is damaged."""
    try:
        return msgspec.json.decode(data, type=dict[str, Any])
    except UNDECODABLE:
        return {}


class Messages(NamedTuple):
    """Messages of a chunk that follow each other. `starts`, `stops`: of each body in the chunk's `data`."""

    data: bytes
    starts: Integers
    stops: Integers

    def single(self, number: int) -> LogMessage:
        """Return one message."""
        return message(self.data[self.starts[number] : self.stops[number]])


class Packed(NamedTuple):
    """A chunk as it lies in the file."""

    start_ns: int
    end_ns: int
    size: int
    crc: int
    compression: str
    data: bytes


def message(body: bytes) -> LogMessage:
    """Return the message of a record. Raises ValueError for one that is too short."""
    if len(body) < MESSAGE_SIZE:
        raise ValueError(f"a message of {len(body)} bytes, expected at least {MESSAGE_SIZE}")
    channel_id, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(body)
    return LogMessage(channel_id, sequence, log_ns, publish_ns, body[MESSAGE_SIZE:])


def packed(body: bytes) -> Packed:
    """Return the chunk of a record. Raises ValueError for one that is none."""
    if len(body) < _CHUNK.size:
        raise ValueError(f"a chunk of {len(body)} bytes, expected at least {_CHUNK.size}")
    start_ns, end_ns, size, crc, name_size = _CHUNK.unpack_from(body)
    if name_size > _LONGEST_NAME:
        raise ValueError(f"a chunk whose compression has a name of {name_size} bytes")
    at = _CHUNK.size + name_size
    name = body[_CHUNK.size : at]
    if name.decode("ascii", "replace") not in _COMPRESSIONS:
        raise ValueError(f"expected compression zstd or lz4, got {name[:40]!r}")
    if at + _LENGTH.size > len(body):
        raise ValueError("a chunk that breaks off")
    (length,) = _LENGTH.unpack_from(body, at)
    data = body[at + _LENGTH.size :]
    if length != len(data):
        raise ValueError(f"a chunk of {length} bytes, got {len(data)}")
    return Packed(start_ns, end_ns, size, crc, name.decode("ascii"), data)


def unpack(chunk: Packed) -> bytes:
    """Return a chunk's records.

    Raises ValueError for one that grows beyond bounds or whose check does not fit, and what the decompressors raise.
    """
    data = chunk.data
    if chunk.compression:
        opened: IO[bytes]
        if chunk.compression == "zstd":
            import zstandard

            opened = cast(IO[bytes], zstandard.ZstdDecompressor().stream_reader(io.BytesIO(data)))
        else:
            import lz4.frame  # type: ignore[import-untyped]

            opened = lz4.frame.open(io.BytesIO(data))
        # Step by step: a read of the most that may come would take that memory for each small chunk.
        parts: list[bytes] = []
        size = 0
        while part := opened.read(_STEP):
            parts.append(part)
            size += len(part)
            if size > UNPACKED_LIMIT:
                raise ValueError(f"{counted(len(chunk.data), 'byte')} unpacked to more than {UNPACKED_LIMIT >> 20} MiB")
        data = b"".join(parts)
    if chunk.crc and (got := crc32.iso_hdlc(data)) != chunk.crc:
        raise ValueError(f"the check of a chunk does not fit: expected {chunk.crc:08x}, got {got:08x}")
    return data


def walk(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, begin and end of the body of each record in a chunk's data. Raises ValueError where one breaks off."""
    at, end = 0, len(data)
    unpack_from, size = HEAD.unpack_from, HEAD.size
    while at < end:
        if at + size > end:
            raise ValueError(f"no record in the last {counted(end - at, 'byte')} of a chunk")
        opcode, length = unpack_from(data, at)
        at += size
        if length > end - at:
            raise ValueError(f"a record of {length} bytes in a chunk with {end - at} left")
        yield opcode, at, at + length
        at += length


def bodies(data: bytes) -> array[int]:
    """Return where the body of each record in a chunk's data begins, and where that of another would. Raises as `walk`."""
    starts, at, end = array("Q"), HEAD.size, len(data)
    length_of, before = _LENGTH.unpack_from, _LENGTH.size
    while at <= end:
        starts.append(at)
        at += length_of(data, at - before)[0] + HEAD.size
    if at != end + HEAD.size:
        # This says what is wrong.
        for _ in walk(data):
            pass
    starts.append(at)
    return starts


def parsed(body: bytes, read: Callable[[Any], T]) -> T:
    """Return a record by the library's reader of its kind, such as `Channel.read`. Raises what that raises."""
    from mcap.data_stream import ReadDataStream

    return read(ReadDataStream(io.BytesIO(body)))
