"""BLF, the binary log of Vector's tools.

    LOGG header | LOBJ container | LOBJ container | ...          a container holds compressed LOBJ objects
    object: LOBJ, header size, header version, size, type | flags, time | channel, flags, identifier, data

Rules: an object may begin in one container and end in the next. A damaged container costs what it holds, a damaged object
itself: reading goes on at the next object whose header can be true. Times are the start of the measurement, to 1 ms, and the
object's own, in steps of 10 us or 1 ns. `Tx` says that the host sent a frame. Objects of other types are passed over. A test
holds this reader and python-can's together.
"""

from __future__ import annotations

import dataclasses
import struct
import zlib
from collections.abc import Callable, Iterator
from datetime import UTC, datetime

from analyzer.catalogue import Role
from analyzer.columns.block import CanBlock
from analyzer.errors import UnreadableError
from analyzer.records import CanFrame
from analyzer.sources import magic
from analyzer.sources.budget import CONTAINER_LIMIT
from analyzer.sources.source import TOGETHER, Source
from analyzer.values import CAN_ID_MASK, SECOND_NS, counted

_SIGNATURE = b"LOBJ"
_OBJECT = struct.Struct("<4sHHLL")  # signature, header size, header version, object size, object type
_TIMES = {1: struct.Struct("<LHHQ"), 2: struct.Struct("<LBxHQ8x")}  # flags, ..., time; by header version
_CONTAINER = struct.Struct("<H6xL4x")  # compression, size when unpacked
_HEADER_SIZE = struct.Struct("<L")
_START = struct.Struct("<HH2xHHHHH")  # year, month, day, hour, minute, second, millisecond
_START_AT = 40
_HEADER_LIMITS = (72, 4096)
_CONTAINER_TYPE = 10
_PLAIN, _DEFLATE = 0, 2
_TEN_MICROSECONDS = 1
#: Bytes of one object; one of a CAN frame has a few hundred at most, so a greater size is damage.
_OBJECT_LIMIT = 16 << 20
_FRAME_LIMIT = 1024
#: Bytes of padding that may stand before an object, and with its signature.
_PADDING = 4
_NEXT = _PADDING + len(_SIGNATURE)
_CAN = struct.Struct("<HBBL8s")  # channel, flags, length, identifier, data
_ERROR = struct.Struct("<HHLBBBxLLH2x8s")  # channel, ..., length (5), ..., identifier (7), ..., data (9)
_FD = struct.Struct("<HBBLLBBB5x64s")  # channel, flags, length, identifier, ..., FD flags (6), data bytes (7), data
_FD64 = struct.Struct("<BBBBLLLLLLLHBBL")  # channel, length, data bytes, ..., identifier (4), flags (6), sent (12), ...
_EXTENDED = 0x8000_0000
_SENT, _REMOTE = 0x01, 0x80
_FD_BYTES = 64
#: Types of objects that are CAN messages of 8 bytes.
_MESSAGES = (1, 86)
_MESSAGE_SIZE = _OBJECT.size + _TIMES[1].size + _CAN.size


def read(source: Source) -> Iterator[CanFrame | CanBlock]:
    """Read the frames."""
    source.time_source = "capture: the start of the measurement, to 1 ms, and the time of each frame since then"
    return _records(source)


def _records(source: Source) -> Iterator[CanFrame | CanBlock]:
    stream = source.stream
    begin = stream.exactly(8)
    size = _HEADER_SIZE.unpack_from(begin, 4)[0] if len(begin) == 8 else 0
    least, most = _HEADER_LIMITS
    if not begin.startswith(magic.BLF) or not least <= size <= most:
        raise UnreadableError(
            f"{source.name}: expected a BLF header (LOGG and its size), got {begin.hex(' ').upper() or 'nothing'}"
        )
    header = begin + stream.exactly(size - len(begin))
    if len(header) < size:
        raise UnreadableError(f"{source.name}: the BLF header breaks off after {len(header)} of {size} bytes")
    start_ns = _start_ns(header)
    for kind, data in _more_together(_objects(source, _containers(source, size))):
        if _are_many(kind, data):
            yield from _together(source, kind, data, start_ns)
            continue
        taken = _frame(source, kind, data, start_ns)
        if taken is not None:
            yield taken


def _are_many(kind: int, data: bytes) -> bool:
    """Say whether data are several messages of one size."""
    return kind in _MESSAGES and len(data) >= 2 * _MESSAGE_SIZE and _OBJECT.unpack_from(data)[3] == _MESSAGE_SIZE


def _more_together(objects: Iterator[tuple[int, bytes]]) -> Iterator[tuple[int, bytes]]:
    """Yield objects; messages of several containers that follow each other as those of one, which costs less.

    Of what is held nothing is left to say: it would be told behind what the next containers are found to be.
    """
    held: list[bytes] = []
    held_kind = size = 0
    try:
        for kind, data in objects:
            many = _are_many(kind, data) and _holds_no_remote_frames(data)
            if held and (not many or kind != held_kind or size >= TOGETHER):
                yield held_kind, b"".join(held)
                held, size = [], 0
            if many:
                held.append(data)
                held_kind, size = kind, size + len(data)
            else:
                yield kind, data
    except Exception:
        # What came before the fault is given first.
        if held:
            yield held_kind, b"".join(held)
        raise
    if held:
        yield held_kind, b"".join(held)


def _holds_no_remote_frames(data: bytes) -> bool:
    """Say whether none of these messages is a remote frame, whose data are told."""
    from analyzer.sources.blf_blocks import remote

    return not remote(data).any()


def _together(source: Source, kind: int, data: bytes, start_ns: int) -> Iterator[CanFrame | CanBlock]:
    """Yield the frames of many objects of one size, as blocks where they are plain."""
    from analyzer.sources.blf_blocks import SIZE, pieces

    for start, stop, name, block in pieces(data, start_ns):
        if block is not None:
            yield dataclasses.replace(block, port=source.port(name or None))
            continue
        for at in range(start * SIZE, stop * SIZE, SIZE):
            taken = _frame(source, kind, data[at : at + SIZE], start_ns)
            if taken is not None:
                yield taken


def _start_ns(header: bytes) -> int:
    year, month, day, hour, minute, second, millisecond = _START.unpack_from(header, _START_AT)
    try:
        start = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return 0
    return int(start.timestamp()) * SECOND_NS + int(millisecond) * 1_000_000


# --- the file: containers -----------------------------------------------------------------------------------------------


def _containers(source: Source, offset: int) -> Iterator[bytes | None]:
    """Yield what each container holds; None for one that cannot be unpacked."""
    stream = source.stream
    number = 0
    while True:
        head = stream.exactly(_OBJECT.size)
        if not head:
            return
        if len(head) < _OBJECT.size:
            source.problem(f"an object breaks off after {counted(len(head), 'byte')} of its header", offset=offset)
            return
        signature, _, _, size, kind = _OBJECT.unpack(head)
        if signature != _SIGNATURE or not _OBJECT.size <= size <= _OBJECT_LIMIT:
            shown = head.hex(" ").upper()
            source.problem(f"expected an object (LOBJ and a size up to 16 MiB), got {shown}", offset=offset)
            return
        body = stream.exactly(size - _OBJECT.size)
        whole = len(body) == size - _OBJECT.size
        padding = stream.exactly(size % 4)
        if not whole:
            source.problem(f"an object breaks off after {len(head) + len(body)} of {size} bytes", offset=offset)
        if kind == _CONTAINER_TYPE and len(body) >= _CONTAINER.size:
            number += 1
            try:
                yield _unpack(source, body)
            except (ValueError, zlib.error) as error:
                source.problem(f"container {number} of the BLF file is damaged: {error}", offset=offset)
                yield None
        elif kind in _FRAMES and whole:
            # Some writers put them into the file without a container.
            yield head + body + b"\0" * (-size % 4)
        offset += len(head) + len(body) + len(padding)


def _unpack(source: Source, body: bytes) -> bytes:
    """Return what a container holds, as far as it goes. Raises ValueError and zlib.error where it cannot be unpacked."""
    method, _ = _CONTAINER.unpack_from(body)
    data = body[_CONTAINER.size :]
    if method == _PLAIN:
        return data
    if method != _DEFLATE:
        raise ValueError(f"expected compression 0 or 2, got {method}")
    unpacker = zlib.decompressobj()
    unpacked = unpacker.decompress(data, CONTAINER_LIMIT + 1)
    source.stream.budget.container(len(unpacked), len(data))
    return unpacked


# --- in the containers: objects -----------------------------------------------------------------------------------------


def _objects(source: Source, pieces: Iterator[bytes | None]) -> Iterator[tuple[int, bytes]]:
    """Yield type and bytes of each object, past damage; of many messages that follow each other, together."""
    buffer = bytearray()
    for piece in pieces:
        buffer += piece or b""
        yield from _whole(source, buffer, final=piece is None)
    yield from _whole(source, buffer, final=True)


def _whole(source: Source, buffer: bytearray, *, final: bool) -> Iterator[tuple[int, bytes]]:
    """Yield the objects that are whole and take them from the buffer. `final`: nothing follows, so a broken one is passed."""
    at = 0
    while (found := buffer.find(_SIGNATURE, at)) >= 0 and len(buffer) - found >= _OBJECT.size:
        _passed(source, found - at)
        at = found
        _, header_size, version, size, kind = _OBJECT.unpack_from(buffer, at)
        least = _OBJECT.size + (_TIMES[version].size if version in _TIMES else 0)
        limit = _FRAME_LIMIT if kind in _FRAMES else _OBJECT_LIMIT
        end = at + size
        if not least <= size <= limit or not _OBJECT.size <= header_size <= size:
            source.problem(f"an object of type {kind} claims {counted(size, 'byte')}, expected {least}..{limit}")
        elif end > len(buffer):
            if not final:
                break
            source.problem(f"an object of type {kind} claims {counted(size, 'byte')}, got {len(buffer) - at}")
        elif kind not in _FRAMES and len(buffer) - end >= _NEXT and buffer.find(_SIGNATURE, end, end + _NEXT) < 0:
            source.problem(f"an object of type {kind} claims {counted(size, 'byte')}, and no object follows it")
        else:
            count = 1
            if source.in_blocks and kind in _MESSAGES and (version, size) == (1, _MESSAGE_SIZE):
                from analyzer.sources.blf_blocks import alike

                count = alike(buffer, at)
            source.stream.budget.record(count)
            end = at + count * size
            yield kind, bytes(memoryview(buffer)[at:end])
            at = end
            continue
        at += len(_SIGNATURE)
    if final or found < 0:
        # What is left may end in the beginning of a signature.
        end = len(buffer) if final else max(at, len(buffer) - len(_SIGNATURE) + 1)
        _passed(source, end - at)
        at = end
    del buffer[:at]


def _passed(source: Source, count: int) -> None:
    if count >= _PADDING:
        source.problem(f"{counted(count, 'byte')} between objects are no object")


def _frame(source: Source, kind: int, data: bytes, start_ns: int) -> CanFrame | None:
    """Return the CAN frame of an object, None for another one and for one that is damaged."""
    take = _FRAMES.get(kind)
    if take is None:
        return None
    _, header_size, version, _, _ = _OBJECT.unpack_from(data)
    try:
        flags, *_, ticks = _TIMES[version].unpack_from(data, _OBJECT.size)
        channel, number, payload, sent, extended, remote, error, fd = take(
            data, _OBJECT.size + _TIMES[version].size, header_size
        )
    except (KeyError, struct.error):
        source.problem(f"an object of type {kind} is damaged: {len(data)} bytes, header version {version}")
        return None
    t_ns = start_ns + ticks * (10_000 if flags == _TEN_MICROSECONDS else 1)
    port = source.port(f"can{channel}" if channel else None)
    role = Role.REQUEST if sent else Role.UNKNOWN
    return source.carried(CanFrame(t_ns, port, number & CAN_ID_MASK, payload, role, extended and not error, remote, error, fd))


_Taken = tuple[int, int, bytes, bool, bool, bool, bool, bool]


def _can(data: bytes, at: int, header_size: int) -> _Taken:
    channel, flags, length, number, payload = _CAN.unpack_from(data, at)
    return channel, number, payload[:length], bool(flags & _SENT), bool(number & _EXTENDED), bool(flags & _REMOTE), False, False


def _error(data: bytes, at: int, header_size: int) -> _Taken:
    values = _ERROR.unpack_from(data, at)
    return values[0], values[7], values[9][: values[5]], False, False, False, True, False


def _fd(data: bytes, at: int, header_size: int) -> _Taken:
    channel, flags, _, number, _, _, fd, length, payload = _FD.unpack_from(data, at)
    extended, remote = bool(number & _EXTENDED), bool(flags & _REMOTE)
    return channel, number, payload[:length], bool(flags & _SENT), extended, remote, False, bool(fd & 1)


def _fd64(data: bytes, at: int, header_size: int) -> _Taken:
    values = _FD64.unpack_from(data, at)
    channel, length, number, flags, sent, ends = (
        values[0],
        min(values[2], _FD_BYTES),
        values[4],
        values[6],
        values[12],
        values[13],
    )
    begin = at + _FD64.size
    stored = max(0, (ends or len(data)) - header_size - _FD64.size)
    # A frame may claim more than is stored; the rest are zeros, as Vector's own tools have it.
    payload = data[begin : begin + min(length, stored)].ljust(length, b"\0")
    return channel, number, payload, bool(sent), bool(number & _EXTENDED), bool(flags & 0x10), False, bool(flags & 0x1000)


#: Types of objects that are CAN frames.
_FRAMES: dict[int, Callable[[bytes, int, int], _Taken]] = {
    **dict.fromkeys(_MESSAGES, _can), 73: _error, 100: _fd, 101: _fd64,
}  # fmt: skip
