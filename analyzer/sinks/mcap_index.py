"""The records for the summary of an MCAP file, collected while the file is written: schemas, channels, indexes.

They are kept in memory for a file that is written at once. A log that is flushed every second gets an index record of some
hundred bytes a second, for weeks. There they are kept in a file next to the log (`FileIndex`). A process that continues after
another was killed reads that file. Both hold MCAP records in their final form.
"""

from __future__ import annotations

import errno
import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Protocol

_HEAD = struct.Struct("<BQ")
_BLOCK = 1 << 16
#: What a medium without fsync says: some folders of networks and of other programs have none.
_NO_SYNC = {errno.EINVAL, errno.ENOSYS, errno.ENOTSUP}


class Index(Protocol):
    """Records of a summary to be."""

    def add(self, record: bytes) -> None:
        """Take a whole record, its opcode first."""

    def flush(self) -> None:
        """Store what was taken. Raises OSError with nothing lost; it may be tried again."""

    def records(self, opcode: int) -> Iterator[bytes]:
        """Yield the records of a kind, in order."""


class MemoryIndex:
    """In memory, as bytes: as objects they would be ten times as large."""

    def __init__(self) -> None:
        self._records: dict[int, list[bytes]] = {}

    def add(self, record: bytes) -> None:
        self._records.setdefault(record[0], []).append(record)

    def flush(self) -> None:
        """Do nothing: there is nowhere to store it."""

    def records(self, opcode: int) -> Iterator[bytes]:
        yield from self._records.get(opcode, ())


class FileIndex:
    """In a file. `length`: bytes of what is there already and counts; what stands behind them is cut off. `crc`: of these.

    Raises ValueError where they are not as they were.
    """

    def __init__(self, path: Path, length: int = 0, crc: int = 0) -> None:
        self.path = path
        self._stream = open(path, "r+b" if length else "w+b", buffering=0)  # noqa: SIM115
        self._stream.truncate(length)
        self._pending: list[bytes] = []
        self.length = length
        self.crc = 0
        for block in self._blocks():
            self.crc = zlib.crc32(block, self.crc)
        if self.crc != crc:
            self.close()
            raise ValueError(f"{path} is damaged, its check does not fit")

    def add(self, record: bytes) -> None:
        """Take a record; it is stored at the next `flush`."""
        self._pending.append(record)

    def flush(self) -> None:
        if not self._pending:
            return
        data = b"".join(self._pending)
        write_whole(self._stream, self.length, data)
        self._pending.clear()
        self.length += len(data)
        self.crc = zlib.crc32(data, self.crc)

    def records(self, opcode: int) -> Iterator[bytes]:
        """Yield the records of a kind; what was taken is stored first."""
        self.flush()
        data = b""
        for block in self._blocks():
            data += block
            at = 0
            while at + _HEAD.size <= len(data):
                kind, size = _HEAD.unpack_from(data, at)
                end = at + _HEAD.size + size
                if end > len(data):
                    break
                if kind == opcode:
                    yield data[at:end]
                at = end
            data = data[at:]

    def _blocks(self) -> Iterator[bytes]:
        """Yield what is stored; by its descriptor, for the file may have been deleted."""
        at = 0
        while at < self.length:
            self._stream.seek(at)
            block = self._stream.read(min(_BLOCK, self.length - at))
            if not block:
                return
            yield block
            at += len(block)

    def store_again(self) -> None:
        """Write the file anew, as it was deleted. Raises OSError."""
        data = b"".join(self._blocks())
        stream = open(self.path, "w+b", buffering=0)  # noqa: SIM115
        write_whole(stream, 0, data)
        self._stream.close()
        self._stream = stream

    def close(self) -> None:
        self._stream.close()


def write_whole(stream: IO[bytes], at: int, data: bytes) -> None:
    """Write to an unbuffered file all of it or nothing: half a record would hide what follows.

    Raises OSError with the file as it was up to `at`.
    """
    stream.seek(at)
    view = memoryview(data)
    try:
        while view:
            written = stream.write(view)
            if not written:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            view = view[written:]
    except OSError:
        stream.truncate(at)
        stream.seek(at)
        raise


def sync(stream: IO[bytes]) -> None:
    """Bring a file onto the disk, where its medium has such a step."""
    try:
        os.fsync(stream.fileno())
    except OSError as error:
        if error.errno not in _NO_SYNC:
            raise


class WholeWrites:
    """A file of which each write is there as a whole or not at all. `stream`: unbuffered, for reading and writing.

    `touched`: it was seen that something else may have written to it.
    """

    def __init__(self, stream: IO[bytes], position: int = 0) -> None:
        self._stream = stream
        self.position = position
        self.touched = False
        stream.truncate(position)
        self._seen = self._look()

    def _look(self) -> tuple[int, int]:
        found = os.fstat(self._stream.fileno())
        return found.st_mtime_ns, found.st_size

    def write(self, data: bytes) -> int:
        """Write all of it. Raises OSError with nothing written."""
        self.touched = self.touched or self._look() != self._seen
        try:
            write_whole(self._stream, self.position, data)
            self.position += len(data)
        finally:
            self._seen = self._look()
        return len(data)

    def flush(self) -> None:
        """Do nothing: nothing is held back."""

    def rewind(self, position: int) -> None:
        """Take back what stands behind a place."""
        self._stream.truncate(position)
        self.position = position
        self._seen = self._look()

    def go_over(self, stream: IO[bytes]) -> None:
        """Write a copy into another file and go on there. Raises OSError with nothing changed but that file."""
        at = 0
        while at < self.position:
            self._stream.seek(at)
            block = self._stream.read(min(_BLOCK, self.position - at))
            if not block:
                # It was cut: a hole stands for what is gone.
                break
            write_whole(stream, at, block)
            at += len(block)
        self._stream.close()
        self._stream = stream
        self._seen = self._look()

    def stat(self) -> os.stat_result:
        """Return what the system says of the file."""
        return os.fstat(self._stream.fileno())

    def sync(self) -> None:
        sync(self._stream)

    def close(self) -> None:
        self._stream.close()
