"""Who works on a recording: locks on files in the folder of its spools, which end with the process that holds them.

    running.lock     shared by every process of a running recording: supervisor, readers, decoding
    decoding.lock    held by the one process that writes the log

Where the system has no such locks (Windows) nothing is held and nothing is refused.
"""

from __future__ import annotations

import os
from pathlib import Path
from types import TracebackType

from analyzer.errors import UsageError
from analyzer.live.spool import spool_folder
from analyzer.sources.recording_parts import base_of

try:
    import fcntl
except ImportError:  # a system without them
    fcntl = None  # type: ignore[assignment]

RUNNING = "running.lock"
DECODING = "decoding.lock"


class Lock:
    """A lock on a file of a folder, held until `close` or the end of the process.

    `shared`: others may hold it so, too. Raises UsageError, with `taken` as its text, where it is held by others.
    """

    def __init__(self, folder: Path, name: str, *, shared: bool = False, taken: str = "") -> None:
        self._fd = os.open(folder / name, os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0), 0o666)
        if fcntl is None:
            return
        try:
            fcntl.flock(self._fd, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        except OSError:
            self.close()
            raise UsageError(taken or f"{folder / name} is held by another process") from None

    def close(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def __enter__(self) -> Lock:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def running(folder: Path) -> bool:
    """Say whether some process of the recording is alive."""
    try:
        Lock(folder, RUNNING).close()
    except UsageError:
        return True
    except OSError:
        return False
    return False


def recorded(log: Path) -> bool | None:
    """Say whether a log is being recorded; None where no folder of spools stands beside it."""
    folder = spool_folder(base_of(log))
    return running(folder) if folder.is_dir() else None
