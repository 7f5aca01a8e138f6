"""Snapshots into a pipe, written without ever waiting.

A line is finished before the next one begins. A snapshot that comes while the pipe is full is dropped.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys

from analyzer.errors import UsageError
from analyzer.live.snapshot import Snapshot, encode

if sys.platform == "linux":
    from fcntl import F_SETPIPE_SZ, fcntl

#: Wished size of the pipe's buffer in the kernel: a few snapshots.
PIPE_BYTES = 1 << 20


class SnapshotWriter:
    """Writes snapshots into a pipe (or a file, a socket) that it owns. `dropped`: snapshots that found no room.

    `gone`: the pipe has no reader any more; from then on everything is dropped.
    """

    def __init__(self, fd: int) -> None:
        self._file = io.FileIO(fd, "wb")
        if not hasattr(os, "set_blocking"):
            raise UsageError("watching needs Python 3.12 on this system, for pipes that do not block")
        os.set_blocking(fd, False)
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
