"""BLF, the binary log of Vector's tools, through python-can.

    LOGG header | LOBJ container | LOBJ container | ...          a container holds compressed LOBJ objects

python-can unpacks a container whatever it grows to, and stops at the first damaged one. So the containers are taken
apart here, unpacked within bounds, and handed on uncompressed; a reader that stops is replaced by another one.

Times go through the library's float seconds and are good to 1 us. `Tx` says that the host sent a frame.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, cast

from analyzer.errors import ServotapError, UnreadableError
from analyzer.records import CanFrame
from analyzer.sources.can_library import float_ns, frame
from analyzer.sources.source import Source, describe
from analyzer.values import counted

if TYPE_CHECKING:
    from can import Message

_MAGIC = b"LOGG"
_SIGNATURE = b"LOBJ"
_OBJECT = struct.Struct("<4sHHLL")  # signature, header size, header version, object size, object type
_CONTAINER = struct.Struct("<H6xL4x")  # compression, size when unpacked
_HEADER_SIZE = struct.Struct("<L")
_HEADER_LIMITS = (72, 4096)
_CONTAINER_TYPE = 10
#: CAN objects that python-can reads; some writers put them into the file without a container.
_CAN_TYPES = frozenset({1, 73, 86, 100, 101})
_PLAIN, _DEFLATE = 0, 2
#: Bytes of one object in the file, and of one container unpacked; Vector's tools write 128 KiB.
_OBJECT_LIMIT = 16 << 20
_UNPACKED_LIMIT = 64 << 20


def score(head: bytes) -> float:
    """Say how sure it is that these bytes are BLF, 0..1."""
    return 1.0 if head.startswith(_MAGIC) else 0.0


def read(source: Source) -> Iterator[CanFrame]:
    """Read the frames."""
    source.time_source = "capture: the start of the measurement and float seconds, good to 1 us"
    return _records(source)


def _records(source: Source) -> Iterator[CanFrame]:
    stream = source.stream
    begin = stream.exactly(8)
    size = _HEADER_SIZE.unpack_from(begin, 4)[0] if len(begin) == 8 else 0
    least, most = _HEADER_LIMITS
    if not begin.startswith(_MAGIC) or not least <= size <= most:
        raise UnreadableError(
            f"{source.name}: expected a BLF header (LOGG and its size), got {begin.hex(' ').upper() or 'nothing'}"
        )
    header = begin + stream.exactly(size - len(begin))
    if len(header) < size:
        raise UnreadableError(f"{source.name}: the BLF header breaks off after {len(header)} of {size} bytes")
    file = _Unpacked(header, _containers(source, size))
    for message in _messages(source, file):
        # python-can counts channels from 0, the file from 1.
        name = f"can{message.channel + 1}" if isinstance(message.channel, int) and message.channel >= 0 else None
        yield frame(message, float_ns(message.timestamp), source.port(name))


class _Damaged(Exception):
    """A container cannot be unpacked."""


class _Unpacked:
    """A file of unpacked containers for python-can to read from. `given`: containers so far."""

    def __init__(self, header: bytes, containers: Iterator[bytes | str]) -> None:
        self._header = header
        self._containers = containers
        self._buffer = header
        self._cut = False
        self.given = 0

    def read(self, count: int) -> bytes:
        """Return `count` bytes, fewer at the end. Raises _Damaged once for each damaged container."""
        if count < 0:
            raise ValueError(f"an object of {count} bytes")
        while len(self._buffer) < count:
            container = next(self._containers, None)
            if container is None:
                break
            self.given += 1
            if isinstance(container, str):
                raise _Damaged(container)
            if self._cut:
                container = container[_first_object(container) :]
                self._cut = False
            self._buffer += _plain_container(container)
        taken, self._buffer = self._buffer[:count], self._buffer[count:]
        return taken

    def restart(self) -> None:
        """Give the header again, then the next container from its first whole object on."""
        self._buffer = self._header
        self._cut = True

    def close(self) -> None:
        """Do nothing: the source closes its file."""


def _plain_container(data: bytes) -> bytes:
    total = _OBJECT.size + _CONTAINER.size + len(data)
    head = _OBJECT.pack(_SIGNATURE, _OBJECT.size, 1, total, _CONTAINER_TYPE)
    return b"".join((head, _CONTAINER.pack(_PLAIN, len(data)), data, b"\0" * (total % 4)))


def _first_object(data: bytes) -> int:
    """Return where the first object begins: what stands before is the end of one in the container before."""
    at = data.find(_SIGNATURE)
    while 0 <= at <= len(data) - _OBJECT.size:
        _, header_size, version, size, _ = _OBJECT.unpack_from(data, at)
        if version in (1, 2) and _OBJECT.size <= header_size <= size <= _OBJECT_LIMIT:
            return at
        at = data.find(_SIGNATURE, at + 1)
    return len(data)


def _messages(source: Source, file: _Unpacked) -> Iterator[Message]:
    from can.io.blf import BLFReader

    make = cast(Callable[[_Unpacked], Any], BLFReader)
    given = -1
    while True:
        try:
            yield from make(file)
            return
        except ServotapError:
            raise
        # Its parser raises whatever a damaged object makes it stumble over.
        except Exception as error:
            if given == file.given:
                raise
            given = file.given
            what = str(error) if isinstance(error, _Damaged) else describe(error)
            source.problem(f"container {file.given} of the BLF file is damaged: {what}")
            file.restart()


def _containers(source: Source, offset: int) -> Iterator[bytes | str]:
    """Yield what each container holds, or in words why it cannot be unpacked."""
    stream = source.stream
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
            yield _unpack(source, body)
        elif kind in _CAN_TYPES and whole:
            yield head + body + b"\0" * (-size % 4)
        offset += len(head) + len(body) + len(padding)


def _unpack(source: Source, body: bytes) -> bytes | str:
    """Return what a container holds, as far as it goes, or why it cannot be unpacked."""
    method, _ = _CONTAINER.unpack_from(body)
    data = body[_CONTAINER.size :]
    if method == _PLAIN:
        return data
    if method != _DEFLATE:
        return f"expected compression 0 or 2, got {method}"
    unpacker = zlib.decompressobj()
    try:
        unpacked = unpacker.decompress(data, _UNPACKED_LIMIT)
    except zlib.error as error:
        return str(error)
    if unpacker.unconsumed_tail:
        raise UnreadableError(
            f"{source.name}: a container of {len(data)} bytes unpacks to more than {_UNPACKED_LIMIT >> 20} MiB: "
            "taken for a decompression bomb"
        )
    return unpacked
