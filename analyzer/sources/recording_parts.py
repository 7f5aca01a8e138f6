"""The parts of a recording in several files: their names, which of them exist, and the metadata of each.

    week.mcap                                    a recording in one file
    week-0001.mcap week-0002.mcap ...            one in parts, which goes by the name of week.mcap

Each part holds, right behind its header, a metadata record `servotap.recording` with the recording's id, its own number and
the names of its neighbours; that and not the name says what belongs together.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from analyzer.errors import UnreadableError
from analyzer.sources.times import Clock
from analyzer.values import counted

#: Name of the metadata record.
METADATA = "servotap.recording"
#: Name of the metadata record of a log whose times are not of the epoch: `clock` says what they are.
CLOCK_METADATA = "servotap.clock"
_NUMBERED = re.compile(r"(?P<stem>.+)-(?P<number>\d{4,})\.mcap")
#: Digits of the number of a part, fewer than these.
_DIGITS = 10
#: How many records may stand before the recording's own one.
_FIRST_FEW = 4


class Part(NamedTuple):
    """One log. `recording`: the id of what it is a part of, empty where it is none of this program's recordings."""

    path: Path
    recording: str = ""
    number: int = 0


def part_path(log: Path, number: int) -> Path:
    """Return what a part of a log is called; numbers count from 1."""
    stem = log.name[: -len(log.suffix)] if log.suffix else log.name
    return log.with_name(f"{stem}-{number:04d}{log.suffix or '.mcap'}")


def base_of(part: Path) -> Path:
    """Return the name by which the parts of a log go, from that of one part; other names as they are."""
    match = _NUMBERED.fullmatch(part.name)
    return part if match is None else part.with_name(match["stem"] + ".mcap")


def parts_named(log: Path) -> list[Path]:
    """Return the parts that a log has by their names, in order."""
    stem = log.name[: -len(log.suffix)] if log.suffix else log.name
    found = []
    for path in log.parent.glob("*.mcap"):
        match = _NUMBERED.fullmatch(path.name)
        if match is not None and match["stem"] == stem:
            found.append((int(match["number"]), path))
    return [path for _, path in sorted(found)]


def described(path: Path) -> dict[str, Mapping[str, str]]:
    """Return the metadata at the head of a log, by the name of its record; nothing of any other file."""
    from mcap.records import Metadata
    from mcap.stream_reader import StreamReader

    found: dict[str, Mapping[str, str]] = {}
    # A pipe would be waited for.
    if not path.is_file():
        return found
    try:
        with path.open("rb") as stream:
            for count, record in enumerate(StreamReader(stream, emit_chunks=True, record_size_limit=1 << 20).records):
                if isinstance(record, Metadata):
                    found[record.name] = record.metadata
                if count >= _FIRST_FEW:
                    break
    # The library raises many kinds of errors for a file that is not a log.
    except Exception:
        return found
    return found


def clock_of(log: Path) -> Clock:
    """Return what the times of a log are."""
    said = described(log).get(CLOCK_METADATA, {}).get("clock")
    return next((clock for clock in Clock if clock == said), Clock.UTC)


def look(path: Path) -> Part:
    """Return a log's metadata as a part; any other file is a part of no recording."""
    values = described(path).get(METADATA, {})
    number = values.get("part", "")
    return Part(path, values.get("recording", ""), int(number) if number.isdecimal() and len(number) < _DIGITS else 0)


def logs_in(folder: Path) -> Iterator[Path]:
    """Yield the logs that lie in a folder. A folder may be called as a log is, and is none."""
    return (path for path in folder.glob("*.mcap") if not path.is_dir())


def in_folder(folder: Path) -> tuple[list[Part], list[str]]:
    """Return the parts of the one recording in a folder, in order, and notes on what is missing or left out.

    Without any recording all logs are given, by name. Raises UnreadableError for a folder without logs, and for one with
    several recordings.
    """
    logs = [look(path) for path in sorted(logs_in(folder))]
    if not logs:
        raise UnreadableError(
            f"{folder} is a folder, expected a capture file, or a folder with the parts of a recording (*.mcap); "
            "servotap decode reads a folder of captures, and FOLDER/* names each file in it"
        )
    recordings: dict[str, list[Part]] = {}
    for part in logs:
        if part.recording:
            recordings.setdefault(part.recording, []).append(part)
    if len(recordings) > 1:
        each = "; ".join(f"{base_of(parts[0].path)} ({counted(len(parts), 'part')})" for parts in recordings.values())
        raise UnreadableError(f"{folder} holds {counted(len(recordings), 'recording')}, name one of them: {each}")
    if not recordings:
        # It may be a folder of captures, among them a log.
        files = sum(path.is_file() and path.suffix != ".mcap" for path in folder.iterdir())
        return logs, [f"only the logs (*.mcap) of {folder} are read, not {counted(files, 'other file')}"] if files else []
    (parts,) = recordings.values()
    notes = []
    if len(logs) > len(parts):
        others = ", ".join(p.path.name for p in logs if not p.recording)
        notes.append(f"left out, as they are not parts of the recording: {others}")
    return ordered(parts), notes


def ordered(parts: Sequence[Part]) -> list[Part]:
    """Return parts in order of their numbers."""
    return sorted(parts, key=lambda part: (part.number, part.path.name))


def gaps(parts: Sequence[Part]) -> list[str]:
    """Return notes on parts that are not there."""
    numbers = [part.number for part in parts if part.number]
    notes = []
    if numbers and numbers[0] > 1:
        notes.append(f"the first {counted(numbers[0] - 1, 'part')} of the recording are not there any more")
    for before, after in pairwise(numbers):
        if after > before + 1:
            notes.append(f"{counted(after - before - 1, 'part')} between part {before} and part {after} are missing")
    return notes
