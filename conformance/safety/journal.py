"""The journal: each change of a drive's settings is on the disk before it is sent.

One JSON object a line. `change`: a command, the values that its settings had, and those about to be sent; `back`: one change
was put back; `end`: all were. Other changes are open: `servotap restore` puts them back after a crash. Of a changed link,
the sent values say where the drive may be now.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Literal

import msgspec

from analyzer.catalogue import Command, all_fields
from analyzer.errors import UnreadableError, UsageError
from analyzer.sinks.mcap_index import write_whole
from analyzer.system.decoding import UNDECODABLE
from analyzer.system.whole_file import read_whole
from analyzer.values import value_text
from conformance.claim import RigFault

#: How each line begins.
_BEGIN = b'{"event":'


Event = Literal["change", "back", "end"]


class Entry(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    """One line. `values`: integers as sent, by field, as they were before; `sent`: those that were sent since.

    `end` without a target is of all of them.
    """

    event: Event
    at: str = ""
    target: str = ""
    on: str = ""
    command: str = ""
    address: int = 0
    values: dict[str, int] = {}
    sent: list[dict[str, int]] = []
    text: str = ""

    @property
    def key(self) -> tuple[str, int, str, int]:
        """Return the key of one setting of one drive; the number of a parameter stands among its values."""
        return self.target, self.address, self.command, self.values.get("parameter", 0)


class Journal:
    """Writes a journal. `again`: go on with one that is there, instead of a new one.

    Raises UsageError where the file cannot be made or is there already.
    """

    def __init__(self, path: Path, *, again: bool = False) -> None:
        self.path = path
        self._told = False
        try:
            self._file: IO[bytes] = path.open("r+b" if again else "xb", buffering=0)
            self._go_on()
        except FileExistsError:
            raise UsageError(
                f"{path} is there already, perhaps of a run that broke off: servotap restore {path} --on ... puts back "
                "what it changed; or give another name with --journal"
            ) from None
        except OSError as error:
            raise UsageError(f"cannot write the journal {path}: {error.strerror or error}") from None

    def _go_on(self) -> None:
        """End the file where its last whole line ends. Raises UnreadableError, OSError."""
        _, end = _parsed(self.path)
        # A torn line says nothing: what it was about to say was not done.
        self._file.truncate(end)
        if end and os.pread(self._file.fileno(), 1, end - 1) != b"\n":
            # An editor may have left it out.
            write_whole(self._file, end, b"\n")

    def write(self, entry: Entry) -> None:
        """Write a line; it is on the disk when this returns. Raises RigFault where it cannot be written; then none of it is."""
        stamped = msgspec.structs.replace(entry, at=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()))
        try:
            line = msgspec.json.encode(stamped) + b"\n"
            # Another process may have gone on with it.
            write_whole(self._file, self._size, line)
            os.fsync(self._file.fileno())
        except OSError as error:
            raise RigFault(f"cannot write the journal {self.path}: {error.strerror or error}; nothing was changed") from None

    def tell(self, entry: Entry) -> None:
        """Write a line about what is done: where it cannot be written that is said once, and the rest goes on."""
        try:
            self.write(entry)
        except RigFault:
            if not self._told:
                print(f"servotap: cannot write the journal {self.path}: it will not say what was put back", file=sys.stderr)
            self._told = True

    @property
    def empty(self) -> bool:
        """Whether nothing was written down: then nothing was changed."""
        return self._size == 0

    @property
    def _size(self) -> int:
        return os.fstat(self._file.fileno()).st_size

    def close(self, *, remove: bool) -> None:
        """Close the file; with `remove` (all is put back) it goes."""
        self._file.close()
        if remove:
            self.path.unlink(missing_ok=True)


def read(path: Path) -> list[Entry]:
    """Return the lines of a journal; a last line that was torn off is left out. Raises UnreadableError."""
    return _parsed(path)[0]


def _parsed(path: Path) -> tuple[list[Entry], int]:
    """Return the lines of a journal, and up to which byte they go: behind it is what was torn off. Raises UnreadableError."""
    data = read_whole(path)
    lines = data.split(b"\n")
    entries = []
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            entries.append(msgspec.json.decode(line, type=Entry))
        except UNDECODABLE as error:
            if number == len(lines) and _is_torn(line):
                return entries, len(data) - len(line)
            raise UnreadableError(f"{path}: line {number}: expected a line of a journal, got: {error}") from None
    return entries, len(data)


def _is_torn(line: bytes) -> bool:
    """Say whether a line is the beginning of one that was being written; a disk that lost its power leaves zeros after it.

    A whole line that is none of these is of another version, or of no run: it may say what is to be put back.
    """
    begun = line.rstrip(b"\0")
    with contextlib.suppress(*UNDECODABLE):
        msgspec.json.decode(begun)
        return False
    return begun.startswith(_BEGIN) or _BEGIN.startswith(begun)


def open_changes(entries: list[Entry]) -> list[Entry]:
    """Return the changes that were not put back, the last one first."""
    left: dict[tuple[str, int, str, int], Entry] = {}
    for entry in entries:
        key = entry.key
        if entry.event == "change":
            first = left.setdefault(key, msgspec.structs.replace(entry, sent=[]))
            left[key] = msgspec.structs.replace(first, sent=first.sent + entry.sent)
        elif entry.event == "back":
            left.pop(key, None)
        else:
            left = {k: change for k, change in left.items() if entry.target not in ("", change.target)}
    return list(reversed(left.values()))


def places(entries: list[Entry]) -> list[str]:
    """Return the ports of all changes."""
    return sorted({entry.on for entry in entries if entry.event == "change" and entry.on})


def values_text(command: Command, values: Mapping[str, int]) -> str:
    """Return what a command sets for people: in units, choices by number and name."""
    fields = all_fields(command.request_forms)
    return " ".join(f"{name}={value_text(fields[name], value) if name in fields else value}" for name, value in values.items())
