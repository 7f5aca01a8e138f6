"""Frames of a text that stand field by field: each byte or two in a line, with what they mean beside them.

    01 - slave address            | 0 | 01 | Slave    |            ser.write(0x01)
    03 - function                 | 1 | 03 | Function |            ser.write(0x03)

Rules: rows are a frame if most are short. Rows of other tables are one if the first two names mean a unit and a function.
Rows of a dump stand among words, too: each has the place of its first byte.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import groupby, pairwise

#: Lines that name the fields of a frame one by one, or that write its bytes one by one.
_FIELD = re.compile(
    r"\s*(?P<call>[\w.>-]+\b[Ww]rite\(\s*)?(?P<bytes>(?:0[xX])?[0-9A-Fa-f]{2}(?:[ ,]+(?:0[xX])?[0-9A-Fa-f]{2}){0,3})"
    r"(?(call)\s*\)[;\s]*(?P<end>)|[\s:,;#/=-]+(?P<name>[^\W\d_]{3}.*))"
)
_HEX_BYTES = r"(?P<bytes>(?:0[xX])?[0-9A-Fa-f]{2}(?:[ ,]+(?:0[xX])?[0-9A-Fa-f]{2}){0,3})[hH]?"
#: Rows of other tables: a cell of bytes before that of their name, or a name before its bytes.
ROWS = (
    re.compile(
        rf"\s*\|(?:\s*#?\d+(?:\s*-\s*\d+)?\s*\|)?(?P<call>(?!))?\s*{_HEX_BYTES}\s*\|\s*(?P<name>[^\W\d_]{{2}}[^|]*)\|.*"
    ),
    re.compile(rf"\W*(?P<call>(?!))?(?P<name>[^\W\d_]{{2}}[^:=|]{{0,60}}?)[\s:=|]+{_HEX_BYTES}[\s|]*"),
)
#: The names of the first fields of a Modbus frame.
_UNIT_NAME = re.compile(r"slave|unit|address|addr|device|station|\bid\b", re.IGNORECASE)
_CODE_NAME = re.compile(r"func|command|\bcmd|\bcode\b|\bfc\b", re.IGNORECASE)
#: A cell of a table that is printed below each other, whose names stand elsewhere.
_CELL = re.compile(r"(?P<call>(?!))?\s*(?P<bytes>[0-9A-Fa-f]{2}(?: ?[0-9A-Fa-f]{2})?)\s*(?P<name>(?!))?")
#: Rows of a frame, and bytes of a short one; cells of a frame.
_LEAST_FIELDS, _FIELD_BYTES = 3, 2
_LEAST_CELLS, _MOST_CELLS = 4, 32
_WORDS = re.compile(r"[^\W\d_]{3,}")
#: A row of a dump, and the place behind its last byte.
_DUMP_ROW = re.compile(r"\W*([0-9A-Fa-f]{4,8}):?\s{1,3}((?:(?:[0-9A-Fa-f]{2}){1,2}(?:\s{1,2}|$|(?=\s*\|)))+)")
#: A row of memory as a debugger shows it: `0x20000108 <rx_buf+8>:  0xa0  0xec`.
_MEMORY_ROW = re.compile(r"0x([0-9A-Fa-f]{6,16})(?: <[\w+.]+>)?:((?:\s+0x[0-9A-Fa-f]{2})+)")
_DUMP_END = re.compile(r"\s*[0-9A-Fa-f]{4,8}\s*")


def has_fields(lines: Sequence[str]) -> bool:
    """Say whether lines below each other name the fields of a frame."""
    return (
        has_cells(lines)
        or any(map(_MEMORY_ROW.fullmatch, lines))
        or any(
            is_frame(list(rows))
            for named, rows in groupby((_field_of(line) for line in lines), key=lambda row: row is not None)
            if named
        )
    )


def begins_dump(line: str) -> bool:
    """Say whether a line is the first row of a dump."""
    row = _DUMP_ROW.match(line)
    return row is not None and int(row[1], 16) == 0


def has_cells(lines: Sequence[str]) -> bool:
    """Say whether the cells of a frame stand below a line of words: of most frames some cell has two bytes, and some one."""
    runs = [list(rows) for _, rows in groupby(lines, key=lambda line: _CELL.fullmatch(line) is not None)]
    return any(
        _CELL.fullmatch(rows[0]) is not None and len({len(row.strip()) for row in rows}) > 1
        and _LEAST_CELLS <= len(rows) <= _MOST_CELLS and _WORDS.search(above[-1]) is not None
        for above, rows in pairwise(runs)
    )  # fmt: skip


def is_frame(rows: Sequence[re.Match[str] | None]) -> bool:
    """Say whether rows are fields, rather than frames with words behind them, or a list of other things."""
    names = [row["name"] or "" for row in rows if row is not None and row.re in ROWS]
    if names and (len(names) != len(rows) or not _UNIT_NAME.search(names[0]) or not any(map(_CODE_NAME.search, names[1:2]))):
        return False
    short = sum(1 for row in rows if row is not None and len(row["bytes"].split()) <= _FIELD_BYTES)
    return len(rows) >= _LEAST_FIELDS and 2 * short > len(rows)


def _field_of(text: str) -> re.Match[str] | None:
    """Return a line that names a field of a frame, and has its bytes."""
    return _FIELD.match(text) or next((row for each in ROWS if (row := each.fullmatch(text)) is not None), None)


class Parts:
    """Lines that are the fields of one frame, or the rows of one dump. `named`, `cells`: which lines are fields."""

    def __init__(self, named: bool, cells: bool) -> None:
        self._named, self._cells = named, cells
        self._fields: list[re.Match[str]] = []
        self._rows = bytearray()
        #: Where the memory begins that a debugger shows.
        self._base = 0

    def take(self, text: str) -> bool:
        """Take a line that is the next field of a frame, or the next row of a dump; say whether it is one."""
        field = _field_of(text) if self._named and not self._rows else None
        if field is None and self._cells and not self._rows and len(self._fields) < _MOST_CELLS:
            field = _CELL.fullmatch(text)
        if field is not None:
            if self._fields and field["name"] and field["name"] == self._fields[0]["name"]:
                return False
            self._fields.append(field)
            return True
        memory = _MEMORY_ROW.fullmatch(text)
        if memory is not None and not self._rows:
            self._base = int(memory[1], 16)
        row = memory or _DUMP_ROW.match(text)
        if row is None and self._rows and _DUMP_END.fullmatch(text) is not None:
            return int(text, 16) == len(self._rows)
        if row is None or self._fields or int(row[1], 16) - (self._base if memory else 0) != len(self._rows):
            return False
        self._rows += bytes.fromhex(row[2].replace("0x", ""))
        return True

    def end(self) -> tuple[bytes, list[re.Match[str]]]:
        """Return the bytes of the rows so far, and the fields, and begin anew."""
        found = bytes(self._rows), self._fields
        self._rows.clear()
        self._fields = []
        return found
