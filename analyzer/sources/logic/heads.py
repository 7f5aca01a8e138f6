"""How captures of levels are told by their first bytes.

Every file that is opened is asked this, so it stands apart from the readers, which need NumPy.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from analyzer.sources.lines import head_lines

_SECTIONS = (b"$date", b"$version", b"$comment", b"$timescale", b"$scope", b"$var", b"$upscope", b"$enddefinitions")
_ZIP = (b"PK\x03\x04", b"PK\x05\x06")
#: Saleae's binary exports: how those of Logic 2 begin; the words of Logic 1 in bytes, with their codes for `struct`, the rows
#: by which it is told, and a number that its samples do not reach.
MAGIC = b"<SALEAE>"
_CHANNEL = re.compile(r"digital_(\d{1,4})\.bin")
_WORDS, _ROWS, SAMPLE_LIMIT = {1: "B", 2: "H", 4: "I", 8: "Q"}, 16, 1 << 48
#: Saleae's CSV: the names of its first column, lines before the heading, and rows that are looked at.
_TIMES, _SAMPLES = ("time [s]", "time[s]", "time(s)", "time (s)"), ("sample", "samples", "sample number", "sample #")
_BEFORE, _LOOKED = 8, 20
_RATE = re.compile(r"\bsample\s*rate\W*(\d+(?:\.\d+)?)\s*([kMG]?)(?:Hz|S/s|sps)?\b", re.IGNORECASE)
#: By the letter before the unit of a rate.
SCALES = {"": 1, "k": 1000, "m": 1_000_000, "g": 1_000_000_000}
LEVELS = ("0", "1", "X", "x", "")
#: Share of the cells there that must be levels.
_MOST = 0.9


def vcd(head: bytes) -> float:
    """Say how sure it is that these bytes are VCD, 0..1."""
    first = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    if not first.startswith(_SECTIONS):
        return 0.0
    return 1.0 if b"$end" in head else 0.6


def sigrok_session(head: bytes) -> float:
    """Say how sure it is that these bytes are a session, 0..1: any zip archive is, so that its reader can say what is wrong."""
    return 1.0 if head.startswith(_ZIP) else 0.0


def saleae_binary(head: bytes) -> float:
    """Say how sure it is that these bytes are a binary export of Saleae, 0..1."""
    if head.startswith(MAGIC):
        return 1.0
    return 0.9 if word_size(head) else 0.0


def saleae_channels(folder: Path) -> list[Path]:
    """Return the files of the channels that Logic 2 exported into a folder, in their order."""
    found = [(int(name[1]), path) for path in folder.glob("digital_*.bin") if (name := _CHANNEL.fullmatch(path.name))]
    return [path for _, path in sorted(found)]


def word_size(head: bytes) -> int:
    """Return the bytes of a word of Logic 1, 0 where these are not rows of sample numbers that rise and words that change."""
    for size, code in _WORDS.items():
        row = struct.Struct(f"<Q{code}")
        if len(head) < _ROWS * row.size:
            continue
        rows = row.iter_unpack(head[: len(head) // row.size * row.size])
        if all(first[0] < then[0] < SAMPLE_LIMIT and first[1] != then[1] for first, then in pairwise(rows)):
            return size
    return 0


class Heading(NamedTuple):
    """The heading of Saleae's CSV: its line from 0 on, what divides its cells, the channels.

    `numbered`: rows have sample numbers, not times; `rate`: samples a second, 0 where that is not told.
    """

    line: int
    delimiter: str
    names: list[str]
    numbered: bool
    rate: int


def heading_of(lines: Sequence[str]) -> Heading | None:
    """Return the heading of Saleae's CSV among the first lines, None where there is none."""
    rate = 0
    for number, line in enumerate(lines[:_BEFORE]):
        delimiter = "\t" if "\t" in line else ","
        cells = [cell.strip().strip('"') for cell in line.lstrip("\ufeff").split(delimiter)]
        if len(cells) > 1 and cells[0].lower() in _TIMES + _SAMPLES:
            names = [name or f"Channel {at}" for at, name in enumerate(cells[1:])]
            return Heading(number, delimiter, names, cells[0].lower() in _SAMPLES, rate)
        found = _RATE.search(line)
        if found is not None:
            rate = round(float(found[1]) * SCALES[found[2].lower()])
    return None


def saleae_csv(head: bytes) -> float:
    """Say how sure it is that this text has levels, 0..1."""
    lines = head_lines(head)
    heading = heading_of(lines)
    if heading is None:
        return 0.0
    rows = [line.split(heading.delimiter)[1:] for line in lines[heading.line + 1 :][:_LOOKED]]
    cells = [cell.strip() for row in rows for cell in row]
    # One damaged level does not make it something else: that is told with its line.
    return 0.97 if cells and sum(cell in LEVELS for cell in cells) >= _MOST * len(cells) else 0.0


#: What says how sure a format is, by its name among `FORMATS`.
SCORES: dict[str, Callable[[bytes], float]] = {
    "sigrok-session": sigrok_session,
    "vcd": vcd,
    "saleae-binary": saleae_binary,
    "saleae-levels": saleae_csv,
}
