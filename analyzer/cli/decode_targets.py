"""Which captures the words of `decode` stand for, and where the log of each goes: no two share one.

FILE...            each beside its capture, or into the folder of -o
FOLDER -o OUT      all captures of a folder and the folders in it; their logs lie in OUT as they lie in FOLDER
"""

from __future__ import annotations

import argparse
import os
import stat
import sys
from collections.abc import Iterator, Set
from pathlib import Path
from typing import NamedTuple

from analyzer.cli.output import Identity, free_target, identity, inputs, target_of
from analyzer.errors import UnreadableError, UsageError
from analyzer.live.spool import spool_folder
from analyzer.sources.logic.heads import saleae_channels
from analyzer.sources.recording_parts import logs_in
from analyzer.values import printable

#: Bytes of the name of a log: 255 without what its name has while it is under construction, and a number.
_LONGEST_NAME = 255 - len("..12345678.part") - len("-123456")
_SPOOL = spool_folder(Path("log")).suffix


class Capture(NamedTuple):
    """A capture, and the log that it becomes, or the folder of its tables.

    `size`: its bytes, 0 where they are not known. `mirrored`: the target's folder stands for one of the captures.
    """

    path: str
    target: Path
    size: int = 0
    mirrored: bool = False

    def make_folder(self) -> None:
        """Make the target's folder if that mirrors one of the captures. Raises UsageError where it cannot be made."""
        if self.mirrored:
            try:
                _make_folders(self.target.parent)
            except OSError as error:
                raise UsageError(f"cannot make the folder {self.target.parent}: {error.strerror}") from None


def _make_folders(folder: Path) -> None:
    """Make a folder and those that it lies in. Raises OSError. `Path.mkdir` calls itself once for each of them."""
    for each in (*reversed(folder.parents), folder):
        if not each.is_dir():
            each.mkdir(exist_ok=True)


def captures(arguments: argparse.Namespace) -> list[Capture]:
    """Return the captures with their targets. Raises UsageError where a target cannot be written."""
    given = [each for word in arguments.files for each in _found(word, arguments)]
    read = inputs((*(path for path, _ in given), *arguments.dbc, *arguments.modbus_map))
    taken: dict[Path, int] = {}
    found = []
    for path, below in given:
        target = _target(path, below, arguments, len(given), taken, read)
        found.append(Capture(path, target, _size(path), below is not None))
    return found


def _size(path: str) -> int:
    given = Path(path)
    try:
        files = [each for each in given.iterdir() if each.suffix == ".mcap"] if given.is_dir() else [given]
        return sum(each.stat().st_size for each in files if each.is_file())
    except OSError:
        return 0


def _found(word: str, arguments: argparse.Namespace) -> Iterator[tuple[str, Path | None]]:
    """Yield the captures that a word stands for, and where below the folder for logs each has its place: None: in it.

    The folder for their logs is made where it is missing.
    """
    folder = Path(word)
    if word in ("", "-") or not folder.is_dir() or any(logs_in(folder)) or saleae_channels(folder):
        yield word, None
        return
    if arguments.output is None:
        raise UsageError(f"{folder} is a folder of captures: name the folder for their logs with -o")
    target = target_of(Path(arguments.output))
    known = {identity(target)} if target.exists() else set()
    if identity(folder) in known:
        raise UsageError(f"-o {target} is the folder of the captures itself: name another one for their logs")
    found = list(_below(folder, known))
    if not found:
        raise UnreadableError(f"{folder} is a folder without files, expected captures, or the parts of a recording (*.mcap)")
    try:
        target.mkdir(exist_ok=True)
    except OSError as error:
        raise UsageError(f"-o {target}: expected a folder for the logs of {folder}: {error.strerror}") from None
    # Of several folders, each has one of its own.
    own = Path(folder.resolve().name) if sum(Path(each).is_dir() for each in arguments.files) > 1 else Path()
    for path in found:
        yield str(path), own / path.parent.relative_to(folder)


def _below(folder: Path, known: set[Identity]) -> Iterator[Path]:
    """Yield the files of a folder and those in it, and of a folder with logs the folder for them; no folder comes twice."""
    # By hand, not by recursion: folders may lie in one another deeper than Python calls.
    waiting = _entries(folder, known)
    while waiting:
        each = waiting.pop()
        mode = _mode(each)
        if not stat.S_ISDIR(mode):
            # What cannot be looked at, as a link that leads nowhere, is told when it is read. Sockets, pipes and devices are
            # passed over.
            if each.suffix != ".mcap" and (not mode or stat.S_ISREG(mode)):
                yield each
        elif saleae_channels(each):
            yield each
        elif any(logs_in(each)) and identity(each) not in known:
            yield each
            waiting += _entries(each, known)
        elif each.suffix not in (".parquet", _SPOOL):
            waiting += _entries(each, known)


def _mode(path: Path) -> int:
    """Return what kind of file a path leads to, as `stat` tells it; 0 where that cannot be told."""
    try:
        return path.stat().st_mode
    except OSError:
        return 0


def _entries(folder: Path, known: set[Identity]) -> list[Path]:
    """Return what stands in a folder, by name from the last to the first; nothing for a folder that is known."""
    try:
        own = identity(folder)
        if own in known:
            return []
        known.add(own)
        return sorted((each for each in folder.iterdir() if not each.name.startswith(".")), reverse=True)
    except OSError as error:
        print(f"note: {printable(str(folder))} is passed over: {error.strerror}", file=sys.stderr)
        return []


def _fitting(name: str, end: str) -> str:
    """Return a name that a file system takes, also of a log under construction. One that is too long lacks its last bytes."""
    encoded = os.fsencode(name)
    if len(encoded) <= _LONGEST_NAME:
        return name
    return encoded[: _LONGEST_NAME - len(end)].decode(errors="ignore") + end


def _target(
    path: str, below: Path | None, arguments: argparse.Namespace, count: int, taken: dict[Path, int], read: Set[Identity]
) -> Path:
    """Return the log of a capture, or the folder of its tables: another one than those that are taken, and take it.

    `taken`: each with the number that the last log of its name has; `read`: the files that are read.
    """
    end = "." + arguments.to
    if arguments.output is None:
        if path == "-":
            raise UsageError("standard input has no file name: name the log with -o")
        if Path(path).is_dir():
            # Next to the folder: inside it the log would be taken for one more part.
            folder = Path(path).resolve()
            target = folder.with_name(folder.name + ".decoded" + end)
        else:
            target = Path(path.removesuffix(end) + ".decoded" + end if path.endswith(end) else path + end)
    else:
        target = target_of(Path(arguments.output))
        # A folder of tables that was named so is replaced; in any other the tables of each capture have one.
        if below is not None or (target.is_dir() and target.suffix != ".parquet"):
            target = target / (below or Path()) / _fitting(Path("standard_input" if path == "-" else path).name + end, end)
        elif count > 1:
            raise UsageError(f"-o {arguments.output} is one file for {count} captures; give a folder")
    first, number = target, taken.get(target, 0)
    while target in taken:
        number += 1
        target = first.with_name(f"{first.stem}-{number}{end}")
    taken[target] = 1
    taken[first] = max(1, number)
    if target is not first:
        print(
            f"note: {printable(str(first))} is the log of another capture: {printable(path)} goes to {printable(target.name)}",
            file=sys.stderr,
        )
    if arguments.to == "mcap":
        return free_target(target, arguments.force, read)
    if target.exists() and not arguments.force:
        raise UsageError(f"{target} exists; --force replaces it")
    return target
