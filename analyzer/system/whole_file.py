"""Files that are read whole: profiles, settings, journals, baselines. They are small, or they are something else."""

from __future__ import annotations

from pathlib import Path

from analyzer.errors import UnreadableError

_MOST = 64 << 20


def read_whole(path: Path) -> bytes:
    """Return the bytes of a file. Raises UnreadableError where it cannot be read or has no end in sight."""
    try:
        with path.open("rb") as stream:
            data = stream.read(_MOST + 1)
    except OSError as error:
        raise UnreadableError(f"{path}: {error.strerror or error}") from None
    if len(data) > _MOST:
        raise UnreadableError(f"{path}: expected a small file, got more than {_MOST >> 20} MiB")
    return data
