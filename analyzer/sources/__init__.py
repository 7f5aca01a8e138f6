"""Sources: captures of every format, read as chunks, CAN frames and comments.

    with open_source("capture.log") as source:
        for record in source: ...

A format is found by content, not by name. Each format is one module with `score` and `read` (see `source.py`), imported
only when it is asked; libraries that a format needs are imported only when it is read. Binary formats are known by their
beginnings (`magic.py`), so their modules have no `score`. Formats of levels need NumPy all over, so what scores them stands in
one module of its own.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from analyzer.errors import UnreadableError, UsageError
from analyzer.records import CanFrame, Chunk
from analyzer.sources import magic
from analyzer.sources.lines import head_lines, is_text
from analyzer.sources.logic.heads import SCORES, saleae_channels
from analyzer.sources.source import Problem, Record, Source, quote
from analyzer.sources.stream import BLOCK, ZSTD_MAGIC
from analyzer.system.scratch import scratch_folder
from analyzer.values import storable

__all__ = ["FORMATS", "Format", "Pasted", "Problem", "Record", "Source", "open_source", "read_text"]


class Format(NamedTuple):
    """A capture format. `levels`: what lies in it are the levels of channels, not bytes."""

    module: str
    title: str
    kind: str
    levels: bool = False


#: Every format by name; the first of two that fit equally wins.
FORMATS: dict[str, Format] = {
    "mcap": Format("mcap_log", "Servotap log", "log"),
    "pcapng": Format("pcapng", "pcapng", "serial"),
    "pcap": Format("pcap", "pcap", "serial"),
    "blf": Format("blf", "BLF", "can"),
    "mf4": Format("mf4", "MF4", "can"),
    # Of all texts it is told the fastest; what is certainly this is asked no further.
    "candump": Format("candump", "candump", "can"),
    "asc": Format("asc", "ASC", "can"),
    "trc": Format("trc", "TRC", "can"),
    "can-state": Format("can_state", "CAN state", "can"),
    "can-csv": Format("can_csv", "python-can CSV", "can"),
    # Its offsets could be identifiers, were they not those of the bytes before them.
    "hexdump": Format("hexdump", "hex dump", "serial"),
    "can-text": Format("can_text", "CAN text", "can"),
    "spy": Format("spy", "pyserial spy", "serial"),
    "sigrok-session": Format("logic.sigrok_session", "sigrok session", "serial", levels=True),
    "vcd": Format("logic.vcd", "VCD", "serial", levels=True),
    "saleae-binary": Format("logic.saleae_binary", "Saleae binary", "serial", levels=True),
    "saleae-levels": Format("logic.saleae_csv", "Saleae digital CSV", "serial", levels=True),
    "saleae": Format("saleae", "Saleae CSV", "serial"),
    "sigrok": Format("sigrok", "sigrok UART", "serial"),
    "columns": Format("columns", "table", "serial"),
    "hex": Format("hextext", "hex text", "serial"),
    "raw": Format("raw", "raw bytes", "serial"),
}

#: A format must be this sure to be chosen.
_LEAST_SCORE = 0.3
#: None is surer than this.
_CERTAIN_SCORE = 1.0
#: One that is this sure is chosen without waiting for more of a pipe.
_SURE_SCORE = 0.5

#: Files that people give by mistake, and what to do about it.
_OTHERS: tuple[tuple[bytes, str], ...] = (
    (b"22 serialization::archive", "a capture of Saleae Logic 1 (.logicdata): there choose Export Data, as CSV"),
    (b"\x1f\x8b\x08", "compressed twice: unpack it once"),
    (ZSTD_MAGIC, "compressed twice: unpack it once"),
    (b"BZh", "bzip2 data: unpack it first"),
    (b"\xfd7zXZ\x00", "xz data: unpack it first"),
    (b"7z\xbc\xaf\x27\x1c", "a 7z archive: unpack it first"),
    (b"SQLite format 3\x00", "an SQLite database: export it as candump, ASC or BLF"),
    (b"%PDF-", "a PDF document"),
    (b"\x89PNG\r\n", "a picture"),
    (b"\xff\xd8\xff\xe0", "a picture"),
    (b"\x7fELF", "a program"),
)


def open_source(
    path: str | Path,
    *,
    format: str | None = None,
    baud: int | None = None,
    bus: str | None = None,
    channels: Sequence[str] = (),
    inverted: bool = False,
    uart: str = "",
) -> Source:
    """Open a capture; `-` is standard input. A folder, or the name that has none but numbered parts, is a log in parts;
    a folder with Saleae's binary export, a file a channel, is one capture.

    `format`: a name in `FORMATS`, found by content if None. `baud`: the line speed, for formats that count samples.
    `bus`: the name of the capture's (first) line. `channels`: those of a logic analyzer that are read, found by themselves if
    none is given; `inverted`: they are low when idle; `uart`: their format, as `8E1`. Raises UsageError for wrong arguments
    and UnreadableError, which says why, for what cannot be read or understood.
    """
    if format is not None and format not in FORMATS:
        near = difflib.get_close_matches(format.lower(), FORMATS, 1, 0.5)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise UsageError(f"unknown format {format!r}, expected one of {', '.join(FORMATS)}{hint}")
    if baud is not None and baud <= 0:
        raise UsageError(f"baud: expected a number above 0, got {baud}")
    if not str(path):
        raise UnreadableError("the name of the capture is empty: expected a file, a folder, or - for standard input")
    files, notes = _files(str(path))
    source = Source(files[0], baud=baud, bus=bus, channels=channels, inverted=inverted, uart=uart)
    for note in notes:
        source.note(note)
    if len(files) > 1 or files[0] != str(path):
        source.name = storable(Path(path).name or str(path))
        source.continues_with([Path(file) for file in files[1:]])
    try:
        name = _find(source) if format is None else _forced(source, format)
        entry = FORMATS[name]
        source.format, source.title, source.kind = name, entry.title, entry.kind
        if (channels or inverted or uart) and not entry.levels:
            raise UsageError(
                f"{source.name} is {entry.title}, without levels: --channel, --inverted and --uart are for logic analyzers"
            )
        source.stream.unread(source.head)
        source.begin(_module(name).read(source))
    except BaseException:
        source.close()
        raise
    return source


def _files(path: str) -> tuple[list[str], list[str]]:
    """Return the files of a capture, most often itself, and notes on what is missing."""
    given = Path(path)
    try:
        is_folder, there = given.is_dir(), path == "-" or given.exists()
    except (OSError, ValueError):
        return [path], []
    if there and not is_folder:
        return [path], []
    if is_folder and (channels := saleae_channels(given)):
        return [str(path) for path in channels], []
    # Only now: it brings the library for logs with it.
    from analyzer.sources import recording_parts

    if is_folder:
        found, notes = recording_parts.in_folder(given)
    else:
        found, notes = recording_parts.ordered([recording_parts.look(each) for each in recording_parts.parts_named(given)]), []
    if not found:
        return [path], []
    return [str(part.path) for part in found], [*notes, *recording_parts.gaps(found)]


def _module(name: str) -> ModuleType:
    return import_module(f"{__name__}.{FORMATS[name].module}")


def _score(name: str, head: bytes) -> float:
    """Say how sure a format is of the first bytes of a capture, 0..1."""
    if (begins := magic.begins(name, head)) is not None:
        return float(begins)
    score: Callable[[bytes], float] = SCORES[name] if FORMATS[name].levels else _module(name).score
    return score(head)


def _more(source: Source) -> bool:
    """Let the head grow by what comes next; say whether anything came."""
    block = source.stream.block()
    source.head += block
    return bool(block)


def _not_empty(source: Source) -> None:
    if source.head:
        return
    packed = source.stream.compression
    if source.problems:
        raise UnreadableError(f"{source.name}: {source.problems[0]}")
    raise UnreadableError(f"{source.name} is empty{' once unpacked' if packed else ''}")


def _forced(source: Source, format: str) -> str:
    _fill(source)
    _not_empty(source)
    return format


def _fill(source: Source) -> None:
    """Take the beginning of a file; of a pipe only what it has by now."""
    while len(source.head) < BLOCK and _more(source):
        if source.size is None:
            break


def _find(source: Source) -> str:
    """Return the format that fits best."""
    while True:
        _fill(source)
        _not_empty(source)
        head = source.head
        other = next((what for magic, what in _OTHERS if head.startswith(magic)), None)
        if other is not None:
            raise UnreadableError(f"{source.name} is {other}")
        scores: dict[str, float] = {}
        for name in FORMATS:
            scores[name] = _score(name, head)
            # Nothing fits better, and the first of two wins: what comes behind it need not be loaded.
            if scores[name] >= _CERTAIN_SCORE:
                break
        best = max(scores, key=scores.__getitem__)
        # What a pipe gave so far may be too little to tell: a title line, half a magic number.
        if source.size is None and scores[best] < _SURE_SCORE and len(head) < BLOCK and _more(source):
            continue
        if scores[best] >= _LEAST_SCORE:
            return best
        raise UnreadableError(_unknown(source, scores))


#: Words of a text on CAN, and two bytes or more in a row.
_CAN_WORD = re.compile(r"\bcan(?: ?bus|[ _-]?(?:message|frame|id|rsp)s?)\b|\bCAN\b(?!')|\bCan\w*(?:RSP|ID)\b")
_FEW_BYTES = re.compile(r"\b0[xX][0-9A-Fa-f]{1,2}[ ,]+0[xX][0-9A-Fa-f]{1,2}\b")


def _unknown(source: Source, scores: dict[str, float]) -> str:
    """Return why nothing fits, with what came nearest."""
    best = max(scores, key=scores.__getitem__)
    lines = head_lines(source.head)
    seems = "text" if is_text(source.head) else "binary data"
    shown = f", beginning {quote(lines[0].strip())!r}" if lines else ""
    # Bytes of CAN without an identifier say neither whose they are nor what their sum is made of.
    text = source.head.decode("utf-8", "replace") if is_text(source.head) else ""
    lacks = (
        "The text speaks of CAN and its bytes stand without an identifier: put that of each frame before it (001#FFCACA). "
        if _CAN_WORD.search(text) and _FEW_BYTES.search(text)
        else ""
    )
    near = f"the nearest is {FORMATS[best].title} ({scores[best]:.0%})" if scores[best] > 0 else "no format comes close"
    return (
        f"{source.name} is not a recognised capture format ({seems}{shown}). Tried: {', '.join(scores)}; {near}. {lacks}"
        "In text, frames are expected as FA 01 30 2B, FA:01:30:2B, 0xFA, 0x01, [FA][01], \\xFA\\x01 or 250, 1, 48, 43, and "
        "on CAN as 001#3031. --format NAME reads it as that format anyway"
    )


class Pasted(NamedTuple):
    """What a text that is no file holds: its traffic in order, and what was concluded of how it is written."""

    traffic: list[Chunk | CanFrame]
    notes: list[str]


def read_text(text: str) -> Pasted:
    """Return the traffic of a text, as people paste it on a command line, in any form; none where it is of none."""
    with scratch_folder() as folder:
        path = folder / "text"
        path.write_text(text.rstrip("\n") + "\n", "utf-8", "replace")
        try:
            with open_source(path) as source:
                if source.format == "raw":
                    return Pasted([], [])
                return Pasted([record for record in source if isinstance(record, (Chunk, CanFrame))], source.notes)
        except UnreadableError:
            return Pasted([], [])
