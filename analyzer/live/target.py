"""The file that a recording is to be written to: what may stand in its way, and what is thrown away when that was asked for."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from analyzer.errors import UsageError
from analyzer.live.lock import running
from analyzer.live.spool import spool_folder
from analyzer.sources.log_files import parts_named


def check_target(log: Path, force: bool, *, parts: bool = False) -> None:
    """See that a log may be written. Raises UsageError where something is in the way; `force` removes it.

    What is in the way: the log itself, with `parts` those that go by its name, or spools of a recording that was not finished.
    """
    if log.exists() and not log.is_file():
        raise UsageError(f"{log} is no regular file, and a log cannot be written there")
    if not log.parent.is_dir():
        raise UsageError(f"{log.parent} is no folder")
    if not os.access(log.parent, os.W_OK):
        raise UsageError(f"{log.parent}: no permission to write there")
    folder = spool_folder(log)
    if folder.exists():
        if running(folder):
            raise UsageError(f"a recording to {log} is running")
        if not force:
            raise UsageError(
                f"{folder} exists: a recording to {log} was not finished; servotap recover {log} does that, --force throws it "
                "away"
            )
        shutil.rmtree(folder)
    for path in parts_named(log) if parts else [log]:
        if path.exists():
            if not force:
                raise UsageError(f"{path} exists; --force replaces it")
            path.unlink()
