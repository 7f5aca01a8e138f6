"""Folders for files that are of use for a while, in the system's folder for such files.

A run that is killed cannot remove its own. So each folder is held by a lock, which ends with the process, and each new one
first removes those that nobody holds. Where the system has no such locks (Windows, some network drives), they stay.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
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
    if fcntl is None:
        with tempfile.TemporaryDirectory(prefix=PREFIX, ignore_cleanup_errors=True) as folder:
            yield Path(folder)
        return
    _remove_left()
    folder, lock = _locked()
    try:
        yield folder
    finally:
        # The lock is still held, so that no other run removes it at the same time.
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def _locked() -> tuple[Path, int]:
    """Return a new folder and the descriptor that holds its lock."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=PREFIX))
        lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        with contextlib.suppress(OSError):
            fcntl.flock(lock, fcntl.LOCK_EX)
        # Another run may have taken it for one that was left, before it was held.
        if folder.exists():
            return folder, lock
        os.close(lock)


def _remove_left() -> None:
    """Remove the folders of processes that are gone. Those of other users are theirs."""
    for folder in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):
            lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                if os.fstat(lock).st_uid == os.getuid():
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(lock)
