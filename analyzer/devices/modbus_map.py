"""Registers of Modbus slaves from a CSV file: a row a value.

    unit,address,name,type,scale,offset,unit_of_measure,table,word_order,note
    5,0x0000,voltage,u16,0.1,,V,input
    5,0x0006,energy,u32,0.01,,kWh,input,little
    5,3,pump,coil

The heading names the columns, in any order; `unit`, `address`, `name` and `type` must be there. A column that is not known is
passed over. Commas, semicolons or tabs stand between values; beside semicolons and tabs a number may have a decimal comma.
A line that begins with # is a comment; empty rows, and Excel's line `sep=;`, are passed over.

- `unit`: the address of the slave, 1 to 247. `address`: the first register as a frame has it, counted from 0.
- `type`: u16 i16 u32 i32 u64 i64 f32 f64 (also uint16, int16, float32 ...), `bool` or `coil`, `string N` of N characters.
- `table`: coil, discrete, holding, input (also `input register` ...), or the function 1 to 4 that reads it. Without it
  `holding`, of a bit `coil`.
- `word_order`: big (the high register first), or little.
- A value is the number sent, times `scale`, plus `offset`.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterator, Mapping
from fractions import Fraction
from pathlib import Path
from typing import TypeVar

from analyzer.catalogue import Dialect
from analyzer.devices.text import Text
from analyzer.layout import RESERVED_NAMES
from analyzer.protocols.modbus_slave import NUMBERS, TAKEN, Table, Value, slave
from analyzer.values import printable, quote

T = TypeVar("T")
_NEEDED = ("unit", "address", "name", "type")
_TABLES = {table.value: table for table in Table} | dict(zip("1234", Table, strict=True))
_ORDERS = {"": False, "big": False, "little": True}
_NUMBER = re.compile(r"[+-]?\d{1,12}(\.\d{0,12})?([eE][+-]?\d{1,2})?|[+-]?\.\d{1,12}|[+-]?\d{1,12}/\d{1,12}")
_WHOLE = re.compile(r"0[xX][0-9a-fA-F]{1,8}|\d{1,8}")
_TYPE_WORDS = re.compile(r"(u|)int(?=(?:16|32|64)$)|float(?=(?:32|64)$)")
_TABLE_WORDS = re.compile(r"(?<=\w)[ _](registers?|inputs?)$|(?<=coil)s$")
_SEPARATOR = re.compile(r'"?sep=.?"?', re.IGNORECASE)
_TEXT = re.compile(r"string\s*(\d{1,3})")
#: Registers that one frame can carry.
_MOST_REGISTERS = 125
_LAST_REGISTER = 0xFFFF


class _Wrong(ValueError):
    """A cell that is not what it should be."""


def slaves(text: Text, name: str, note: Callable[[str], None]) -> tuple[Dialect, ...]:
    """Return a dialect for each slave of a file. `note`: takes what a reader should know of it.

    Raises UnreadableError, with the row, for a file that is wrong.
    """
    units: dict[int, list[Value]] = {}
    places: dict[tuple[int, Table, int], str] = {}
    names: dict[tuple[int, str], int] = {}
    for line, row in _rows(text):
        try:
            unit, value = _value(row)
            for other in (names.setdefault((unit, each), line) for each in (value.name, *_twins(value))):
                if other != line:
                    raise _Wrong(f"name: {value.name} of unit {unit} stands in row {other} already")
            for register in range(value.address, value.address + value.count):
                before = places.setdefault((unit, value.table, register), f"{value.name} (row {line})")
                if before != f"{value.name} (row {line})":
                    raise _Wrong(f"address: {value.table} 0x{register:04X} of unit {unit} is {before} already")
        except _Wrong as error:
            raise text.error(str(error), line) from None
        units.setdefault(unit, []).append(value)
    if not units:
        raise text.error("expected rows with registers, got none")
    title = printable(Path(text.path).name)
    for unit, values in units.items():
        if all(_is_numbered(value.address) for value in values):
            first = values[0].address
            note(
                f"{title}: unit {unit}: addresses count from 0, as frames have them; if {first} is meant as manuals number "
                f"registers, write {first % 10_000 - 1}"
            )
    manual = f"CSV file {title}"
    several = len(units) > 1
    return tuple(
        slave(f"{name}-{unit}" if several else name, f"{title}, unit {unit}", manual, (unit,), values)
        for unit, values in units.items()
    )


def _is_numbered(address: int) -> bool:
    """Say whether an address looks like a number of a manual: 10001, 30001 or 40001 is the first of its table."""
    return address // 10_000 in (1, 3, 4) and address % 10_000 > 0


def _twins(value: Value) -> tuple[str, ...]:
    return (f"{value.name}_text",) if value.field.has_text_twin else ()


def _rows(text: Text) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield the rows with their lines. Raises UnreadableError."""
    lines = text.text.splitlines()
    heading: list[str] = []
    between = ","
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.lstrip().startswith("#") or _SEPARATOR.fullmatch(line.strip()):
            continue
        if not heading:
            between = next((each for each in ";\t" if each in line), ",")
        try:
            cells = [cell.strip() for cell in next(csv.reader(io.StringIO(line), delimiter=between, strict=True))]
        except csv.Error as error:
            raise text.error(f"expected values with {between!r} between them: {error}", number) from None
        if not heading:
            heading = [cell.lower() for cell in cells]
            missing = [name for name in _NEEDED if heading.count(name) != 1]
            if missing:
                raise text.error(f"expected a heading with {', '.join(_NEEDED)}, got {quote(line)}", number)
            continue
        if not any(cells):
            continue
        if len(cells) > len(heading) and any(cells[len(heading) :]):
            raise text.error(f"expected {len(heading)} values as in the heading, got {len(cells)}", number)
        row = dict(zip(heading, cells, strict=False))
        if between != ",":
            row |= {name: row[name].replace(",", ".") for name in ("scale", "offset") if name in row}
        yield number, row


def _value(row: Mapping[str, str]) -> tuple[int, Value]:
    """Return the unit and the value of a row. Raises _Wrong."""
    unit = _cell(row, "unit", "an address from 1 to 247", lambda cell: _whole(cell, 1, 247))
    address = _cell(row, "address", "0 to 65535, as 16 or 0x10", lambda cell: _whole(cell, 0, _LAST_REGISTER))
    name = _cell(row, "name", f"letters, digits and _{_proposed(row.get('name', ''))}", _name)
    kind, count = _cell(row, "type", "u16 i16 u32 i32 u64 i64 f32 f64 bool coil, or string N", _type)
    usual = Table.COIL if kind == "bool" else Table.HOLDING
    table = _cell(
        row,
        "table",
        "coil, discrete, holding or input",
        lambda cell: _TABLES[_TABLE_WORDS.sub("", cell.lower())] if cell else usual,
    )
    if table.of_bits is not (kind == "bool"):
        raise _Wrong(f"type: {'bool' if table.of_bits else 'a number or a string'} expected for {table}, got {row['type']}")
    if address + count - 1 > _LAST_REGISTER:
        raise _Wrong(f"address: expected {count} registers up to 0xFFFF, got 0x{address:04X}")
    low_first = _cell(row, "word_order", "big or little", lambda cell: _ORDERS[cell.lower()])
    number = "a number from 1e-12 to 1e12, as 0.1 or 1/10"
    scale = _cell(row, "scale", number, lambda cell: _fraction(cell, least=Fraction(1, 10**12)) if cell else Fraction(1))
    offset = _cell(row, "offset", number, lambda cell: _fraction(cell) if cell else Fraction(0))
    if kind in ("bool", "string") and (scale != 1 or offset):
        raise _Wrong(f"scale: expected none for {kind}, got {row.get('scale') or row.get('offset')}")
    of_measure, note = printable(row.get("unit_of_measure", "")), printable(row.get("note", ""))
    return unit, Value(table, address, name, kind, count, low_first, scale, offset, of_measure, note)


def _cell(row: Mapping[str, str], column: str, expected: str, read: Callable[[str], T]) -> T:
    cell = row.get(column, "")
    try:
        return read(cell)
    except (ValueError, KeyError, ZeroDivisionError):
        raise _Wrong(f"{column}: expected {expected}, got {quote(cell)}") from None


def _whole(cell: str, low: int, high: int) -> int:
    if not _WHOLE.fullmatch(cell):
        raise ValueError
    number = int(cell, 16 if cell[:2].lower() == "0x" else 10)
    if not low <= number <= high:
        raise ValueError
    return number


def _name(cell: str) -> str:
    if not cell.isidentifier() or cell.startswith("_") or cell in RESERVED_NAMES | TAKEN or len(cell) > 64:
        raise ValueError
    return cell


def _proposed(cell: str) -> str:
    """Return the name that is near to a text, in words; nothing where there is none."""
    near = re.sub(r"\W+", "_", cell).strip("_")
    try:
        return f", as {_name(near)}"
    except ValueError:
        return ""


def _type(cell: str) -> tuple[str, int]:
    word = _TYPE_WORDS.sub(lambda found: "f" if found[1] is None else found[1] or "i", cell.lower())
    if word in ("bool", "coil"):
        return "bool", 1
    if word in NUMBERS:
        return word, int(word[1:]) // 16
    found = _TEXT.fullmatch(word)
    count = (int(found[1]) + 1) // 2 if found is not None else 0
    if not 1 <= count <= _MOST_REGISTERS:
        raise ValueError
    return "string", count


def _fraction(cell: str, least: Fraction = Fraction(0)) -> Fraction:
    if not _NUMBER.fullmatch(cell):
        raise ValueError
    number = Fraction(cell)
    if not least <= abs(number) <= 10**12:
        raise ValueError
    return number
