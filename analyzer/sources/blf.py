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

if TYPE_CHECKING:
    from can import Message

_MAGIC = b"LOGG"
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


class _Unpacked:
    """A file of unpacked containers for python-can to read from."""

    def __init__(self, header: bytes, containers: Iterator[bytes]) -> None:
        self._header = header
        self._containers = containers
        self._buffer = header
        self.given = 0

    def read(self, count: int) -> bytes:
        """Return `count` bytes, fewer at the end."""
        if count < 0:
            raise ValueError(f"an object of {count} bytes")
        while len(self._buffer) < count and (more := next(self._containers, b"")):
            self._buffer += more
            self.given += 1
        taken, self._buffer = self._buffer[:count], self._buffer[count:]
        return taken

    def restart(self) -> None:
        """Give the header again, then the next container."""
        self._buffer = self._header

    def close(self) -> None:
        """Do nothing: the source closes its file."""


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
            source.problem(f"container {file.given} of the BLF file is damaged: {describe(error)}")
            file.restart()


def _containers(source: Source, offset: int) -> Iterator[bytes]:
    """Yield each container as one that is not compressed, as python-can takes them."""
    stream = source.stream
    while True:
        head = stream.exactly(_OBJECT.size)
        if not head:
            return
        if len(head) < _OBJECT.size:
            source.problem(f"an object breaks off after {len(head)} bytes of its header", offset=offset)
            return
        signature, _, _, size, kind = _OBJECT.unpack(head)
        if signature != b"LOBJ" or not _OBJECT.size <= size <= _OBJECT_LIMIT:
            shown = head.hex(" ").upper()
            source.problem(f"expected an object (LOBJ and a size below 16 MiB), got {shown}", offset=offset)
            return
        body = stream.exactly(size - _OBJECT.size)
        whole = len(body) == size - _OBJECT.size
        padding = stream.exactly(size % 4)
        if not whole:
            source.problem(f"an object breaks off after {len(head) + len(body)} of {size} bytes", offset=offset)
        unpacked = _unpack(source, body, offset) if kind == _CONTAINER_TYPE else b""
        if kind in _CAN_TYPES and whole:
            unpacked = head + body + b"\0" * (-size % 4)
        if unpacked:
            total = _OBJECT.size + _CONTAINER.size + len(unpacked)
            yield b"".join(
                (
                    _OBJECT.pack(b"LOBJ", _OBJECT.size, 1, total, _CONTAINER_TYPE),
                    _CONTAINER.pack(_PLAIN, len(unpacked)),
                    unpacked,
                    b"\0" * (total % 4),
                )
            )
        offset += len(head) + len(body) + len(padding)


def _unpack(source: Source, body: bytes, offset: int) -> bytes:
    """Return what a container holds, as far as it goes."""
    if len(body) < _CONTAINER.size:
        return b""
    method, _ = _CONTAINER.unpack_from(body)
    data = body[_CONTAINER.size :]
    if method == _PLAIN:
        return data
    if method != _DEFLATE:
        source.problem(f"expected a container of compression 0 or 2, got {method}", offset=offset)
        return b""
    unpacker = zlib.decompressobj()
    try:
        unpacked = unpacker.decompress(data, _UNPACKED_LIMIT)
    except zlib.error as error:
        source.problem(f"a container cannot be unpacked: {error}", offset=offset)
        return b""
    if unpacker.unconsumed_tail:
        raise UnreadableError(
            f"{source.name}: a container of {len(data)} bytes unpacks to more than {_UNPACKED_LIMIT >> 20} MiB: "
            "taken for a decompression bomb"
        )
    return unpacked
