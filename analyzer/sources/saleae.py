"""Decoded bytes as Saleae's programs export them: CSV, a byte a row.

    Time [s],Value,Parity Error,Framing Error                    Logic 1, and Logic 2 for one analyzer
    0.042909760000000,0xFA,,
    name,type,start_time,duration,data,error                     Logic 2, table of all analyzers
    "TX","data",0.0006025,2.375e-05,0xFA,
    Time [s],Analyzer Name,Decoded Protocol Result               Logic 1, all analyzers

Rules: a time is the end of the byte: its start, and its duration where the file or the line speed gives it. Each byte is a
chunk. Names of analyzers that mean sent or received say who sent, once something was sent; other names are ports. Bytes with a
parity or framing error are given on and counted; where these are all bytes of one parity and no others, the line has a parity
that the analyzer took for a stop bit, or the analyzer took the stop bit for a parity. In a post the header stands among words,
which are comments, and strokes can part the cells.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

from analyzer.catalogue import Role
from analyzer.records import Chunk, Comment
from analyzer.sources.lines import Lines, head_lines
from analyzer.sources.marks import ReceivedMarks, role_of_name
from analyzer.sources.source import Source, quote
from analyzer.sources.times import Clock, clock_ns, day_ns, number_ns, zone_ns
from analyzer.values import SECOND_NS, counted

#: Columns by what they mean, in lower case; the first name that a header has counts.
_COLUMNS: dict[str, tuple[str, ...]] = {
    "time": ("time [s]", "start_time", "time", "start"),
    "data": ("value", "data", "decoded protocol result"),
    "name": ("name", "analyzer name"),
    "type": ("type",),
    "duration": ("duration",),
    "error": ("error",),
    "parity": ("parity error",),
    "framing": ("framing error",),
}
#: A header must have these columns, and one of the second group.
_NEEDED = ("time", "data")
_TELLING = ("type", "duration", "parity", "framing", "name")
#: What no analyzer of single bytes has: identifiers, directions and lengths.
_OTHERS = frozenset(("id", "frame id", "dlc", "dir", "direction", "len", "length"))
#: Types of rows that carry no byte of a line.
_WITHOUT_BYTES = ("start", "stop", "address", "enable", "disable", "result", "error")
_BITS_PER_BYTE = 10
#: What says that a byte is without error, and different bytes from which on it is no chance which ones have errors.
_WITHOUT_ERROR, _DIFFERENT = ("", "false", "0"), 6
#: Lines of a post among which a header is, and what parts its cells.
_HEADER_LINES, _SEPARATORS = 60, ",|;\t"
_RULE = re.compile(r"[\s|:-]+")

_VALUE = re.compile(r"(?:0x([0-9A-Fa-f]{1,16})|0b([01 ]{1,64})|'?(\d{1,3})'?)$")
_INSIDE = re.compile(r"\(?0x([0-9A-Fa-f]{2})\)?")
_ESCAPES = {
    "COMMA": 0x2C, "' '": 0x20, "space": 0x20, "\\r": 13, "\\n": 10, "\\t": 9, "\\0": 0, "\\\\": 0x5C, "TAB": 9,
    "CR": 13, "LF": 10,
}  # fmt: skip
_ESCAPED = re.compile(r"\\x([0-9A-Fa-f]{2})$")
_ISO = re.compile(r"(\d{4})-(\d\d)-(\d\d)[T ](\d\d):(\d\d):(\d\d)(?:\.(\d+))?(Z|[+-]\d\d:?\d\d)?$")
_SECONDS = re.compile(r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?$")
#: Rows below a header of which one has a time.
_BELOW = 4
#: Saleae's default names of its analyzers.
_UNNAMED = re.compile(r"async serial|uart|serial|modbus", re.IGNORECASE)


@dataclass
class _Table:
    """Which column holds what; -1: none. `above`: lines before the header."""

    places: dict[str, int]
    separator: str = ","
    above: int = 0
    characters: bool = False

    def row(self, line: str) -> list[str]:
        """Return the cells of a line."""
        if self.separator == "|":
            line = line.strip().strip("|")
        return next(csv.reader((line,), delimiter=self.separator), []) if '"' in line else line.split(self.separator)

    def holds(self, line: str) -> bool:
        """Say whether a line among words is a row, with a time in its place."""
        row = self.row(line)
        return len(row) > 1 and (_SECONDS.match(time := self.cell(row, "time")) or _ISO.match(time)) is not None

    def cell(self, row: list[str], what: str) -> str:
        """Return what a row says of one thing, "" where it does not."""
        place = self.places.get(what, -1)
        return row[place].strip() if 0 <= place < len(row) else ""


def _heading(lines: Sequence[str]) -> _Table | None:
    """Return the table of the first line that is a header, or of one among words that has a row below it."""
    for number, line in enumerate(lines[:_HEADER_LINES]):
        for separator in _SEPARATORS:
            table = _table(line, separator)
            if table is None:
                continue
            table.above = number
            if not number or any(table.holds(row) for row in lines[number + 1 : number + _BELOW]):
                return table
    return None


def _table(line: str, separator: str) -> _Table | None:
    """Return the columns of a header line, None if it is none."""
    line = line.lstrip("﻿")
    names = [
        name.strip().strip('"').lower() for name in (line.strip().strip("|") if separator == "|" else line).split(separator)
    ]
    places = {
        what: next(names.index(name) for name in known if name in names)
        for what, known in _COLUMNS.items()
        if any(name in names for name in known)
    }
    fits = all(what in places for what in _NEEDED) and any(what in places for what in _TELLING) and _OTHERS.isdisjoint(names)
    return _Table(places, separator) if fits else None


def score(head: bytes) -> float:
    """Say how sure it is that these bytes are Saleae's CSV, 0..1."""
    lines = head_lines(head)
    return 0.95 if _heading(lines) is not None else 0.0


def read(source: Source) -> Iterator[Chunk | Comment]:
    """Read the bytes."""
    table = _heading(head_lines(source.head))
    if table is None:
        source.problem("expected a header with a time and a value column, got another line", line=1)
        return iter(())
    of = "the end" if source.baud or "duration" in table.places else "the start"
    source.time_source = f"capture: seconds as a logic analyzer measured them, of {of} of each byte"
    return _records(source, table)


def _records(source: Source, table: _Table) -> Iterator[Chunk | Comment]:
    lines = Lines(source)
    rows = iter(lines)
    for text in islice(rows, table.above):
        if text.strip():
            yield source.comment(None, text)
    next(rows, "")
    sample = [table.row(line) for line in head_lines(source.head)[table.above + 1 :]]
    if any((dated := _ISO.match(table.cell(row, "time"))) is not None and not dated[dated.re.groups] for row in sample):
        source.clock = Clock.PRINTED
    # A table of characters has digits that are characters too; only the other values show it.
    table.characters = any(_number(table.cell(row, "data")) is None for row in sample)
    heard = ReceivedMarks()
    directions: dict[str, Role] = {}
    byte_ns = _BITS_PER_BYTE * SECOND_NS // source.baud if source.baud else 0
    misframed: dict[bool, set[bytes]] = {False: set(), True: set()}
    unpaired: dict[bool, set[bytes]] = {False: set(), True: set()}
    errors = shift_ns = 0
    first = True
    for line in rows:
        if not line.strip():
            continue
        try:
            row = table.row(line)
            if table.above and not table.holds(line):
                if not _RULE.fullmatch(line):
                    yield source.comment(None, line)
                continue
            if (kind := table.cell(row, "type")) not in ("", "data"):
                if kind not in _WITHOUT_BYTES and table.cell(row, "data"):
                    source.note(f"rows of the type {quote(kind)} are left out")
                continue
            value = _value(table, table.cell(row, "data"))
            t_ns = time_of(table.cell(row, "time"))
            duration = table.cell(row, "duration")
            t_ns += number_ns(duration) if duration else byte_ns
        except (ValueError, csv.Error) as error:
            source.problem(f"{error}: {quote(line.strip())!r}", line=lines.number)
            continue
        if first:
            first = False
            shift_ns = max(0, -t_ns)
            if shift_ns:
                source.note(f"times before the trigger: all are moved by {shift_ns / SECOND_NS:g} s")
        wrong = [what for what in ("error", "parity", "framing") if table.cell(row, what).lower() not in _WITHOUT_ERROR]
        of_parity = "parity" in (*wrong, *table.cell(row, "error").lower().split())
        unpaired[of_parity].add(value)
        misframed[bool(wrong) and not of_parity].add(value)
        errors += bool(wrong)
        name = table.cell(row, "name")
        direction = directions.get(name)
        if direction is None:
            direction = directions[name] = role_of_name(name)
        port = source.port(None if direction is not Role.UNKNOWN or _UNNAMED.fullmatch(name) else name)
        yield Chunk(t_ns + shift_ns, port, value, heard(direction))
    if errors:
        source.note(f"{counted(errors, 'byte')} with a parity or framing error")
        source.uarts |= _uarts(misframed) | {f"8N1 read as {word}" for word in _uarts(unpaired)}


def _uarts(values: dict[bool, set[bytes]]) -> set[str]:
    """Return the parity by which each byte has an error whose parity bit is low, and no other byte has one.

    An analyzer without parity takes that bit for the stop bit; one with a parity takes the stop bit, which is high, for it.
    """
    sums = [{value[0].bit_count() & 1 for value in values[wrong]} for wrong in (True, False)]
    told = sums[0].isdisjoint(sums[1]) and all(sums) and len(values[True] | values[False]) >= _DIFFERENT
    return {"8O1" if sums[0] == {1} else "8E1"} if told else set()


def time_of(text: str) -> int:
    """Return the time of a row, in seconds or as a date, in ns. Raises ValueError for a text that is none."""
    found = _ISO.match(text)
    if found is None:
        return number_ns(text)
    year, month, day, hour, minute, second, fraction, zone = found.groups()
    return day_ns(int(year), int(month), int(day)) + clock_ns(hour, minute, second, fraction) - zone_ns(zone)


def _number(text: str) -> int | None:
    found = _VALUE.match(text)
    if found is None:
        inside = _INSIDE.search(text)
        return int(inside[1], 16) if inside is not None else None
    digits, bits, decimal = found.groups()
    if digits is not None:
        return int(digits, 16)
    return int(bits.replace(" ", ""), 2) if bits is not None else int(decimal)


def _value(table: _Table, text: str) -> bytes:
    """Return a value as a byte. Raises ValueError for what is none."""
    value = None
    if table.characters:
        escaped = _ESCAPED.match(text)
        if escaped is not None:
            value = int(escaped[1], 16)
        elif text in _ESCAPES:
            value = _ESCAPES[text]
        elif len(text) == 1:
            value = ord(text)
    if value is None:
        value = _number(text)
    if value is None or value > 0xFF:
        raise ValueError(f"expected a byte, got {quote(text) or 'nothing'!r}")
    return bytes((value,))
