"""Files and folders that are of use for a while: scratch in the system's folder for it, and outputs under construction.

A run that is killed cannot remove its own. So a lock holds each of them, and ends with the process. Each new run first removes
those that no lock holds. Where the system has no such locks (Windows, some network drives), they stay.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

try:
    import fcntl
except ImportError:  # a system without them
    fcntl = None  # type: ignore[assignment]

#: No person names a folder so: what begins with it is ours to remove.
PREFIX = "servotap-scratch-"


@contextlib.contextmanager
def scratch_folder() -> Iterator[Path]:
    """Yield an empty folder, which is removed afterwards with all that is in it."""
    remove_left(path for path in Path(tempfile.gettempdir()).glob(f"{PREFIX}*") if path.is_dir())
    folder, lock = held(lambda: Path(tempfile.mkdtemp(prefix=PREFIX)))
    try:
        yield folder
    finally:
        # The lock is still held, so that no other run removes it at the same time.
        shutil.rmtree(folder, ignore_errors=True)
        let_go(lock)


def held(make: Callable[[], Path]) -> tuple[Path, int]:
    """Make a file or folder; return it and the descriptor that holds its lock, for `let_go`. Raises what `make` raises."""
    while True:
        path = make()
        if fcntl is None:
            return path, -1
        # Before it is held, another run may take it for one that was left, and remove it.
        try:
            lock = os.open(path, os.O_RDONLY)
        except FileNotFoundError:
            continue
        with contextlib.suppress(OSError):
            fcntl.flock(lock, fcntl.LOCK_EX)
        if path.exists():
            return path, lock
        os.close(lock)


def let_go(lock: int) -> int:
    """End a lock; return what stands for none, which may be let go, too."""
    if lock >= 0:
        os.close(lock)
    return -1


def remove_left(paths: Iterable[Path]) -> None:
    """Remove those files and folders whose makers are gone. Those of other users are theirs."""
    for path in paths if fcntl is not None else ():
        with contextlib.suppress(OSError):
            lock = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
            try:
                found = os.fstat(lock)
                if found.st_uid == os.getuid():
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    if stat.S_ISDIR(found.st_mode):
                        shutil.rmtree(path, ignore_errors=True)
                    elif stat.S_ISREG(found.st_mode):
                        path.unlink()
            finally:
                os.close(lock)
