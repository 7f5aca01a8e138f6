"""Messages in a stream of bytes, between processes or in a file: each stands behind its size, four bytes, little endian."""

from __future__ import annotations

import io
import struct
from typing import IO

_SIZE = struct.Struct("<I")


def put(stream: IO[bytes] | io.RawIOBase, data: bytes | bytearray) -> None:
    """Write a message, and flush it. Raises OSError where the other side has gone."""
    view = memoryview(_SIZE.pack(len(data)) + data)
    while view:
        # A pipe may take a part alone.
        view = view[stream.write(view) :]
    stream.flush()


def take(stream: IO[bytes] | io.RawIOBase, most: int = (1 << 32) - 1) -> bytearray:
    """Return the next message; an empty one where the stream has ended or broken off, or more than `most` bytes are to come."""
    head = _read(stream, _SIZE.size)
    size = _SIZE.unpack(head)[0] if head else 0
    return _read(stream, size) if size <= most else bytearray()


def _read(stream: IO[bytes] | io.RawIOBase, size: int) -> bytearray:
    data = bytearray(size)
    view = memoryview(data)
    while view:
        count = stream.readinto(view)  # type: ignore[union-attr]  # all that is read from here has it
        if not count:
            return bytearray()
        view = view[count:]
    return data
