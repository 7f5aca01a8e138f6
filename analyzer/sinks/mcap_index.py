"""The records for the summary of an MCAP file, collected while the file is written: schemas, channels, indexes.

They are kept in memory for a file that is written at once. A log that is flushed every second gets an index record of some
hundred bytes a second, for weeks. There they are kept in a file next to the log (`FileIndex`). A process that continues after
another was killed reads that file. Both hold MCAP records in their final form.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Protocol

_HEAD = struct.Struct("<BQ")
_BLOCK = 1 << 16


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
        """Take a record."""
        self._records.setdefault(record[0], []).append(record)

    def flush(self) -> None:
        """Do nothing: there is nowhere to store it."""

    def records(self, opcode: int) -> Iterator[bytes]:
        """Yield the records of a kind."""
        yield from self._records.get(opcode, ())


class FileIndex:
    """In a file. `length`: bytes of what is there already and counts; what stands behind them is cut off."""

    def __init__(self, path: Path, length: int = 0) -> None:
        self.path = path
        self._stream = open(path, "r+b" if length else "w+b", buffering=0)  # noqa: SIM115
        self._stream.truncate(length)
        self._pending: list[bytes] = []
        self.length = length

    def add(self, record: bytes) -> None:
        """Take a record; it is stored at the next `flush`."""
        self._pending.append(record)

    def flush(self) -> None:
        """Store what was taken."""
        if not self._pending:
            return
        data = b"".join(self._pending)
        write_whole(self._stream, self.length, data)
        self._pending.clear()
        self.length += len(data)

    def records(self, opcode: int) -> Iterator[bytes]:
        """Yield the records of a kind; what was taken is stored first."""
        self.flush()
        place = 0
        with open(self.path, "rb", buffering=_BLOCK) as reader:
            while place < self.length:
                head = reader.read(_HEAD.size)
                kind, size = _HEAD.unpack(head)
                if kind == opcode:
                    yield head + reader.read(size)
                else:
                    reader.seek(size, io.SEEK_CUR)
                place += _HEAD.size + size

    def close(self) -> None:
        """Close the file."""
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
                raise OSError(28, "No space left on device")
            view = view[written:]
    except OSError:
        stream.truncate(at)
        stream.seek(at)
        raise


class WholeWrites:
    """A file of which each write is there as a whole or not at all. `stream`: unbuffered, for reading and writing."""

    def __init__(self, stream: IO[bytes], position: int = 0) -> None:
        self._stream = stream
        self.position = position
        stream.truncate(position)

    def write(self, data: bytes) -> int:
        """Write all of it. Raises OSError with nothing written."""
        write_whole(self._stream, self.position, data)
        self.position += len(data)
        return len(data)

    def flush(self) -> None:
        """Do nothing: nothing is held back."""

    def rewind(self, position: int) -> None:
        """Take back what stands behind a place."""
        self._stream.truncate(position)
        self.position = position

    def fileno(self) -> int:
        """Return the descriptor."""
        return self._stream.fileno()

    def close(self) -> None:
        """Close the file."""
        self._stream.close()
