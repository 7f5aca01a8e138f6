"""Who works on a recording: locks on files in the folder of its spools, which end with the process that holds them.

    running.lock     shared by every process of a running recording: supervisor, readers, decoding
    decoding.lock    held by the one process that writes the log

Where the system (Windows) or the medium (some shares) has no such locks, nothing is held and nothing is refused.
"""

from __future__ import annotations

import contextlib
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

    `shared`: others may hold it so, too. `removed`: `close` removes the file; a process that is killed leaves it.
    Raises UsageError, with `taken` as its text, where it is held by others.
    """

    def __init__(self, folder: Path, name: str, *, shared: bool = False, removed: bool = False, taken: str = "") -> None:
        self._path = folder / name
        self._removed = removed
        while True:
            self._fd = os.open(self._path, os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0), 0o666)
            if fcntl is None:
                return
            try:
                fcntl.flock(self._fd, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
            except BlockingIOError:
                self._let_go()
                raise UsageError(taken or f"{self._path} is held by another process") from None
            except OSError:
                # A share or a stick without locks.
                return
            if not removed or self._stands():
                return
            # The one before removed it between opening and locking. The next one would lock another file.
            self._let_go()

    def _stands(self) -> bool:
        try:
            return os.path.samestat(os.fstat(self._fd), os.stat(self._path))
        except FileNotFoundError:
            return False

    def close(self) -> None:
        """Let go of it; it may be done twice."""
        if self._fd >= 0 and self._removed and fcntl is not None:
            with contextlib.suppress(OSError):
                os.unlink(self._path)
        self._let_go()

    def _let_go(self) -> None:
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
