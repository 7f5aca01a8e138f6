"""Settings that drives keep between runs, as JSON.

    {"servotap": "drives", "version": 1, "drives": {"mks-rs485@1": {"settings": {"work_mode": 5, ...}}}}

A drive is identified by its name on the command line. The file is replaced as a whole, so it is never half written.

One run at a time keeps one file: of two with the same drive each would undo what the other keeps. The lock is on the folder's
file `.NAME.lock`, for the file itself is replaced; it goes with the run.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from analyzer.cli.output import write_whole
from analyzer.errors import UsageError
from analyzer.live.lock import Lock
from analyzer.system.whole_file import read_whole
from conformance.drives.drive import Drive

_KIND = "drives"
_VERSION = 1


#: Settings of one drive as sent, by name.
Settings = Mapping[str, int]


def load(path: str) -> dict[str, Settings]:
    """Return what a file keeps, by the drives' names; nothing where there is no file yet.

    Raises UsageError for a file that is not one of these.
    """
    try:
        return _drives(json.loads(read_whole(Path(path)))) if os.path.lexists(path) else {}
    except (ValueError, KeyError, TypeError, AttributeError, ArithmeticError, RecursionError) as error:
        what = str(error) if isinstance(error, ValueError) else "it is JSON of another kind"
        raise UsageError(f"{path} does not hold the state of drives: {what}") from None


def _drives(whole: Any) -> dict[str, Settings]:
    if whole["servotap"] != _KIND or whole["version"] != _VERSION:
        raise ValueError(f"expected servotap {_KIND!r} of version {_VERSION}")
    drives: dict[str, Settings] = {name: drive["settings"] for name, drive in whole["drives"].items()}
    # What another version keeps there, too, would go when the file is written.
    inside = {key for drive in whole["drives"].values() for key in drive}
    unknown = (whole.keys() - {"servotap", "version", "drives"}) | (inside - {"settings"})
    if unknown:
        raise ValueError(f"{', '.join(sorted(unknown))}: not known to this version of servotap")
    for name, settings in drives.items():
        for setting, value in settings.items():
            if type(value) is not int:
                raise ValueError(f"{name}: {setting}: expected a whole number, got {value!r}")
    return drives


def claimed(path: str) -> Lock:
    """Return the lock of a file, held until it is closed. Raises UsageError where another run keeps the file."""
    real = Path(os.path.realpath(path))
    try:
        taken = f"{path} is kept by another servotap emulate: end it, or name another"
        return Lock(real.parent, f".{real.name}.lock", removed=True, taken=taken)
    except OSError as error:
        raise UsageError(f"{path} cannot be kept: {error.strerror}") from None


class StateFile:
    """Keeps the state of drives in a file, whenever it has changed. `drives`: by their names."""

    def __init__(self, path: str, drives: Mapping[str, Drive]) -> None:
        self.path = Path(path)
        self._drives = dict(drives)
        self._written: dict[str, Settings] = {}

    def save(self) -> None:
        """Write the file if anything has changed.

        Drives that the file knows and this run does not have stay in it, also as another run changed them meanwhile.
        Raises UsageError where it cannot be written, or holds no state any more.
        """
        own = {name: dict(drive.settings) for name, drive in self._drives.items()}
        if own == self._written:
            return
        drives = {name: {"settings": settings} for name, settings in sorted({**load(str(self.path)), **own}.items())}
        text = json.dumps({"servotap": _KIND, "version": _VERSION, "drives": drives}, indent=2) + "\n"
        write_whole(self.path, text.encode())
        self._written = dict(own)
