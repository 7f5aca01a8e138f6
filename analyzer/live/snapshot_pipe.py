"""Snapshots through a pipe: written without ever waiting, read without ever blocking.

A line that has been begun is finished before the next one begins; a snapshot that comes while the pipe is full is dropped.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys

import msgspec

from analyzer.errors import UsageError
from analyzer.live.snapshot import Snapshot, decode, encode

if sys.platform == "linux":
    from fcntl import F_SETPIPE_SZ, fcntl

#: Wished size of the pipe's buffer in the kernel: a few snapshots.
PIPE_BYTES = 1 << 20
#: Longer lines are none of ours.
LINE_LIMIT = 8 << 20


def _never_wait(fd: int) -> None:
    if not hasattr(os, "set_blocking"):
        raise UsageError("watching needs Python 3.12 on this system, for pipes that do not block")
    os.set_blocking(fd, False)


class SnapshotWriter:
    """Writes snapshots into a pipe (or a file, a socket) that it owns. `dropped`: snapshots that found no room.

    `gone`: the pipe has no reader any more; from then on everything is dropped.
    """

    def __init__(self, fd: int) -> None:
        self._file = io.FileIO(fd, "wb")
        _never_wait(fd)
        # A larger buffer is a wish: a user may have used up his share, and files have none at all.
        if sys.platform == "linux":
            with contextlib.suppress(OSError):
                fcntl(fd, F_SETPIPE_SZ, PIPE_BYTES)
        self._rest = b""
        self.dropped = 0
        self.gone = False

    def offer(self, snapshot: Snapshot) -> bool:
        """Write a snapshot if there is room now; say whether it will arrive."""
        self._push()
        if self._rest or self.gone:
            self.dropped += 1
            return False
        self._rest = encode(snapshot)
        self._push()
        self.dropped += self.gone
        return not self.gone

    def _push(self) -> None:
        while self._rest and not self.gone:
            try:
                written = self._file.write(self._rest)
            except OSError:
                # The reader has ended: watching ends, recording goes on.
                self.gone, self._rest = True, b""
                return
            if written is None:
                return
            self._rest = self._rest[written:]

    def close(self) -> None:
        """Close the pipe; what did not fit is lost."""
        self._push()
        self._file.close()


class SnapshotReader:
    """Reads snapshots from a pipe that it owns. `ended`: the writer has closed it. `damaged`: lines that were none."""

    def __init__(self, fd: int) -> None:
        self._file = io.FileIO(fd, "rb")
        _never_wait(fd)
        self._parts: list[bytes] = []
        self._size = 0
        self.ended = False
        self.damaged = 0

    def fileno(self) -> int:
        """Return the descriptor, to be waited on."""
        return self._file.fileno()

    def read(self, most: int = 1 << 21) -> list[Snapshot]:
        """Return the whole snapshots that are there now, of about `most` bytes."""
        found: list[Snapshot] = []
        taken = 0
        while taken < most and not self.ended:
            data = self._file.read(1 << 18)
            if data is None:
                break
            if not data:
                self.ended = True
                break
            taken += len(data)
            *lines, rest = data.split(b"\n")
            for line in lines:
                self._take(b"".join([*self._parts, line]), found)
                self._parts, self._size = [], 0
            self._parts.append(rest)
            self._size += len(rest)
            if self._size > LINE_LIMIT:
                self.damaged += 1
                self._parts, self._size = [], 0
        return found

    def _take(self, line: bytes, found: list[Snapshot]) -> None:
        try:
            found.append(decode(line))
        except msgspec.MsgspecError:
            self.damaged += 1

    def close(self) -> None:
        """Close the pipe."""
        self._file.close()
