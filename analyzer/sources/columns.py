"""Tables with named columns: CSV with a heading, JSON lines, Markdown tables; of CAN or of a serial line.

    Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3                  SavvyCAN
    120000,00000001,false,Tx,0,3,F6,01,F8
    {"time": 0.12, "dir": "tx", "data": "FA 01 30 2B"}           JSON lines; {"type":"Buffer","data":[250,1]} of Node-RED
    { id: 1, ext: false, data: <Buffer f6 01 f8> }               what Node.js prints
    | 0.120 | TX | `FA 01 30 2B` |                               a row of a Markdown table

Rules: a column is found by its name (`_NAMES`). With an identifier the rows are CAN frames, else bytes of
a serial line. Numbers of JSON are decimal, texts are hexadecimal unless one of them can only be decimal. A time takes its unit
from its name (`time_ms`); a number that is one since 1970 has its unit by its size; SavvyCAN counts microseconds; other whole
numbers are taken as milliseconds, with a note.
"""

from __future__ import annotations

import ast
import csv
import itertools
import json
import re
from collections.abc import Iterable, Iterator, Sequence
from decimal import Decimal
from typing import Any

from analyzer.catalogue import Role
from analyzer.records import CanFrame, Chunk, Comment
from analyzer.sources import written
from analyzer.sources.can_text import can_name
from analyzer.sources.lines import Lines, fitting, head_lines, is_like
from analyzer.sources.marks import role_of, role_of_name
from analyzer.sources.source import Source, quote
from analyzer.sources.stamps import Stamp, StampClock, stamp_of
from analyzer.sources.times import number_ns
from analyzer.values import CAN_ID_LIMIT, CAN_ID_MASK, FD_LENGTHS, SECOND_NS, counted

#: What columns are called, in small letters and without anything but letters and digits.
_NAMES: dict[str, tuple[str, ...]] = {
    "time": ("timestamp", "timestamps", "time", "times", "timesec", "ts", "t", "datetime", "timems", "timeus", "timens",
             "tms", "tus", "tns",
             "timestampms", "timestampus", "timestampns", "ms", "us", "millis", "micros", "seconds", "elapsed",
             "zeit", "zeitstempel", "系统时间", "时间", "start", "starts", "starttime", "begin", "uhrzeit", "时间标识"),
    "mark": ("dir", "direction", "txrx", "rxtx", "topic", "传输方向", "方向", "sender", "type", "event", "richtung", "row",
             "line"),
    "data": ("data", "databytes", "datahex", "bytes", "byte", "databyte", "hex", "payload", "frame", "raw", "buffer", "message",
             "msg", "daten", "telegram", "telegramm",
             "value", "text", "wert", "bytehex", "uartdata", "uartrxtx", "uartrx", "uarttx", "数据", "数据hex"),
    "id": ("id", "canid", "arbitrationid", "identifier", "idhex", "id号", "帧id", "frameid", "identifierhex"),
    "extended": ("extended", "isextended", "ext", "ide", "isextendedid", "帧格式"),
    "remote": ("remote", "rtr", "isremoteframe", "帧类型"),
    "length": ("len", "dlc", "length", "dl", "长度", "数据长度"),
    "port": ("bus", "channel", "chn", "interface", "port", "can通道", "通道"),
}  # fmt: skip
#: Columns that say by their own name who sent their bytes.
_SENT = re.compile(r"(tx|request|sent|send|rx|response|reply|answer|received?|recv)(?:buf|buffer|data|bytes|hex|frame)?")
#: Columns of one byte each.
_CELL = re.compile(r"(?:d|data|byte|b)\d+")
_UNIT = re.compile(r"(?:time|timestamp|t)?(ms|us|ns|millis|micros|seconds)$")
_UNITS = {"ms": SECOND_NS // 1000, "us": SECOND_NS // 1_000_000, "ns": 1}
_UNITS |= {"millis": _UNITS["ms"], "micros": _UNITS["us"], "seconds": SECOND_NS}
_TRUE = ("true", "1", "yes", "x", "扩展帧", "远程帧")
#: What a cell tells by its own words: programs of ZLG put them below either heading.
_TOLD = {"标准帧": "extended", "扩展帧": "extended", "数据帧": "remote", "远程帧": "remote"}
_CLEAN = re.compile(r"^\d+:|[\W_]+")
_RULE = re.compile(r"[\s|:-]+")
#: A buffer of Node.js, and a name of its objects.
_BUFFER, _NAME = re.compile(r"<Buffer((?: [0-9a-fA-F]{2})*)>"), re.compile(r"(?<=[{,\s])([A-Za-z_]\w*):(?=\s)")
_WHOLE = re.compile(r"\d{1,19}")
_NUMBER = re.compile(r"\d{1,19}[.,]\d{1,12}")
_POWER = re.compile(r"\d\.\d{1,12}[eE][+-]\d{1,2}")
_PAIR = re.compile(r"[0-9A-Fa-f]{2}")
#: What tools put before the bytes of a cell.
_BEFORE = re.compile(r"x\|\s*")
_CAN_BYTES = 64
_LARGEST = 0xFF
#: Lines among which the heading must be.
_HEADING_LINES = 10
_LEAST_SHARE = 0.5
_LONGEST_LITERAL = 1 << 14
#: Digits of a whole number of seconds since 1970, and of smaller units.
_EPOCH_DIGITS = {10: SECOND_NS, 13: _UNITS["ms"], 16: _UNITS["us"], 19: _UNITS["ns"]}

Row = dict[str, Any]


def score(head: bytes) -> float:
    """Say how sure it is that these bytes are a table with columns that are known, 0..1."""
    lines = head_lines(head)
    table = _Table.of(lines)
    if table is None:
        return 0.0
    fits = [(row := table.row(line)) is not None and bool(_bytes_in(row)) for line in lines]
    share = fitting(lines, fits)
    return 0.5 + 0.45 * share if any(fits) and share >= (_LEAST_SHARE if len(lines) > 2 else 0.3) else 0.0


class _Table:
    """The form of a table: its heading, and what parts its cells."""

    def __init__(self, names: list[str] | None, separator: str) -> None:
        self._heading = self.names = names
        #: Cells of one byte each are decimal numbers: one has three digits, and none a letter.
        self.decimal = False
        self._separator = separator

    @classmethod
    def of(cls, lines: Sequence[str]) -> _Table | None:
        """Find the heading among the first lines; None where there is none that is known."""
        for line in lines[:_HEADING_LINES]:
            text = line.strip()
            if (row := _of_json(text)) is not None and _bytes_in(row):
                return cls(None, "")
            for separator in ("|",) if text.startswith("|") else (",", ";", "\t"):
                names = [_key(cell) for cell in _cells(text, separator)]
                if len(names) > 1 and _is_heading(names):
                    table = cls(names, separator)
                    table.names = _with_mark(names, [_cells(each, separator) for each in lines])
                    rows = [row for each in lines if (row := table.row(each)) is not None]
                    cells = [cell for row in rows for cell in _single(row)]
                    table.decimal = bool(cells) and all(map(str.isdecimal, cells)) and any(len(cell) == 3 for cell in cells)
                    return table
        return None

    def row(self, line: str) -> Row | None:
        """Return the cells of a line by what their columns are, None for a line that is no row."""
        text = line.strip(" \r\n") if self._separator == "\t" else line.strip()
        if self.names is None:
            return _of_json(text)
        cells = _cells(text, self._separator)
        ruled = self._separator == "|" and _RULE.fullmatch(text)
        if len(cells) < 2 or ruled or [_key(cell) for cell in cells] == self._heading:
            return None
        row = _named(zip(self.names, cells, strict=False))
        if self.decimal and (singles := _single(row)):
            row["cells"] = [f"{int(cell):02X}" if cell.isdecimal() and int(cell) <= _LARGEST else cell for cell in singles]
            if str(row.get("id", "")).isdecimal():
                row["id"] = int(row["id"])
        beyond = [cell for cell in cells[len(self.names) :] if cell]
        if beyond and self.names[-1] in _NAMES["data"] and all(map(_PAIR.fullmatch, (row.get("data", ""), *beyond))):
            # Each byte has a cell of its own.
            row["data"] = " ".join((row["data"], *beyond))
        elif beyond and _CELL.fullmatch(self.names[-1]) and all(map(_PAIR.fullmatch, beyond)):
            row.setdefault("cells", []).extend(beyond)
        elif beyond:
            row["beyond"] = beyond
        return row

    def unread(self) -> list[str]:
        """Return the names of columns that mean nothing here."""
        known = {name for names in _NAMES.values() for name in names}
        return [n for n in self.names or () if n and n not in known and not _SENT.fullmatch(n) and not _CELL.fullmatch(n)]


def _single(row: Row) -> list[str]:
    """Return the cells of a row that hold one byte each."""
    return row.get("cells") or [str(row[name]) for name in ("data",) if name in row]


def _key(name: str) -> str:
    return _CLEAN.sub("", name.lower())


def _cells(text: str, separator: str) -> list[str]:
    if separator == "|":
        return [cell.strip(" `") for cell in text.strip().strip("|").split("|")]
    return [cell.strip() for cell in next(csv.reader([text], delimiter=separator), [])]


def _is_heading(names: list[str]) -> bool:
    has = {what for what, known in _NAMES.items() if any(name in known for name in names)}
    holds = "data" in has or any(_CELL.fullmatch(name) for name in names) or any(map(_SENT.fullmatch, names))
    sides = {role_of_name(sender[1]) for name in names if (sender := _SENT.fullmatch(name)) is not None}
    told = has & {"id", "time"} or len(sides) > 1 or any(name in _NAMES["mark"][:-2] for name in names)
    return holds and bool(told)


def _with_mark(names: list[str], rows: list[list[str]]) -> list[str]:
    """Return the names of columns; where none is of marks, one that has nothing but both marks is, whatever it is called."""
    rows = [row for row in rows if len(row) >= len(names) and [_key(cell) for cell in row[: len(names)]] != names]
    for place in () if not rows or any(name in _NAMES["mark"] for name in names) else range(len(names)):
        if {_marked(row[place]) for row in rows} == {Role.REQUEST, Role.REPLY}:
            return [*names[:place], _NAMES["mark"][0], *names[place + 1 :]]
    return names


def _of_json(text: str) -> Row | None:
    text = text.strip("[],\n ")
    if not text.startswith("{"):
        return None
    if "<Buffer" in text:
        # Node.js prints an object without quotes around its names.
        text = _BUFFER.sub(lambda buffer: str(list(bytes.fromhex(buffer[1]))), text)
        text = _NAME.sub(r'"\1":', text).replace("'", '"').replace("undefined", "null")
    try:
        found = json.loads(text, parse_float=str)
    except (ValueError, RecursionError):
        found = _of_python(text)
    if not isinstance(found, dict):
        return None
    return _named((_key(str(name)), value) for name, value in found.items())


def _of_python(text: str) -> Any:
    """Return what Python printed as a dictionary."""
    try:
        return ast.literal_eval(text) if len(text) <= _LONGEST_LITERAL else None
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        return None


def _named(cells: Iterable[tuple[str, Any]]) -> Row:
    row: Row = {}
    for name, value in cells:
        if value in ("", None):
            continue
        if _CELL.fullmatch(name):
            row.setdefault("cells", []).append(str(value))
            continue
        if (sender := _SENT.fullmatch(name)) is not None:
            row.setdefault("sides", []).append((value, role_of_name(sender[1])))
        what = next((what for what, names in _NAMES.items() if name in names), None)
        what = _TOLD.get(str(value), what) if what in _TOLD.values() else what
        if what is not None and what not in row:
            row[what] = value
            if what == "time":
                row["unit"] = unit[1] if (unit := _UNIT.fullmatch(name)) is not None else ""
    return row


def _bytes_in(row: Row) -> list[tuple[bytes, Role]]:
    """Return the bytes of a row and who sent them."""
    mark = _marked(str(row.get("mark", "")).strip())
    if "cells" in row:
        cells = written.read(" ".join(cell.rjust(2, "0") for cell in row["cells"]))
        return [] if cells is None else [(_filled(cells.data, _length(row, len(cells.data))), mark)]
    # The request stands first, wherever its column is.
    sides = sorted(row.get("sides", ()), key=lambda side: side[1] is not Role.REQUEST)
    found = [(_data(value), role) for value, role in sides]
    if "data" in row:
        data = _data(row["data"])
        found.insert(0, (_filled(data, _length(row, len(data))) if data and "id" in row else data, mark))
    taken = [(data, role) for data, role in found if data]
    return taken or ([(b"", mark)] if "id" in row and _length(row, 1) == 0 else [])


def _marked(said: str) -> Role:
    """Return who sent, as a cell says it; it may have a letter or a sign alone."""
    return known if (known := role_of_name(said)) is not Role.UNKNOWN else role_of((), said.lower())


def _filled(data: bytes, length: int) -> bytes:
    """Return bytes without the zeros that fill them up beyond their length."""
    return data if any(data[length:]) else data[:length]


def _data(value: Any) -> bytes | None:
    """Return the bytes of a cell: a text, a list of numbers, or Node.js's buffer."""
    if isinstance(value, dict):
        return _data(value.get("data"))
    if isinstance(value, list):
        if value and all(isinstance(each, int) and -128 <= each <= 255 for each in value):
            return bytes(each & 0xFF for each in value)
        value = " ".join(map(str, value))
    if isinstance(value, (bytes, bytearray)):
        return bytes(value)
    found = written.read(_BEFORE.sub("", value, count=1).strip(" `")) if isinstance(value, str) else None
    return None if found is None else found.data


def _length(row: Row, known: int) -> int:
    text = str(row.get("length", known))
    return int(text, 0) if re.fullmatch(r"0x[0-9a-fA-F]{1,2}|[1-9]?\d", text) else known


def _identifier(value: Any) -> int | None:
    if isinstance(value, int):
        return value
    text = str(value).strip()
    return int(text, 16) if re.fullmatch(r"(?:0[xX])?[0-9A-Fa-f]{1,8}", text) else None


def read(source: Source) -> Iterator[Chunk | CanFrame | Comment]:
    """Read the rows one by one."""
    lines = head_lines(source.head)
    table = _Table.of(lines)
    if table is None:
        source.problem("expected a heading with columns for bytes and for times, identifiers or directions, or lines of JSON")
        return iter(())
    rows = [row for line in lines if (row := table.row(line)) is not None and _bytes_in(row)]
    is_can = _is_can(rows)
    source.kind = "can" if is_can else "serial"
    if unread := table.unread():
        source.note(f"columns that are not read: {', '.join(unread)}")
    if is_can and any(
        isinstance(i := row["id"], str) and i.isdecimal() and len(i) not in (3, 8) and int(i) > 9 for row in rows
    ):
        source.note("identifiers without 0x are read as hexadecimal")
    return _records(source, table, is_can, _Times(rows, source))


def _is_can(rows: list[Row]) -> bool:
    """Say whether identifiers are those of CAN frames: not the numbers of rows, nor beside more bytes than a frame has."""
    texts = [row["id"] for row in rows if "id" in row]
    numbers = [n for text in texts if (n := _identifier(text)) is not None and n <= CAN_ID_MASK]
    if not numbers or len(numbers) < len(rows) or _counts(numbers) or _counts([int(t) for t in texts if str(t).isdecimal()]):
        return False
    return all(len(data) <= _CAN_BYTES for row in rows for data, _ in _bytes_in(row))


def _counts(numbers: list[int]) -> bool:
    """Say whether a column counts the rows: each number is above the last, by one but for rows without bytes."""
    rises = all(after > before for before, after in itertools.pairwise(numbers))
    return rises and len(numbers) > 2 and numbers[-1] - numbers[0] < 2 * len(numbers)


class _Times:
    """Reads the times of rows."""

    def __init__(self, rows: list[Row], source: Source) -> None:
        texts = [str(row["time"]) for row in rows if "time" in row]
        self._clock = StampClock((self._stamp(text) for text in texts), source)
        whole = [text for text in texts if _WHOLE.fullmatch(text) and len(text) not in _EPOCH_DIGITS]
        self._unit = _UNITS["ms"]
        if not texts:
            return
        if not source.time_source.startswith("capture"):
            source.time_source = "capture: numbers as printed, exact to their digits"
        if not whole or any(row.get("unit") for row in rows):
            return
        if any(_NUMBER.fullmatch(text) for text in texts):
            # JSON of some languages writes 2 for 2.0.
            self._unit = SECOND_NS
            return
        if "cells" in rows[0] and "extended" in rows[0]:
            self._unit = _UNITS["us"]
            source.time_source = "capture: microseconds as SavvyCAN prints them"
        else:
            source.note("times are whole numbers without a unit: they are read as milliseconds")

    @staticmethod
    def _stamp(text: str) -> Stamp:
        return Stamp() if _WHOLE.fullmatch(text) or _NUMBER.fullmatch(text) else stamp_of(text)

    def __call__(self, row: Row) -> int | None:
        """Return the time of a row, None without one. Raises ValueError for a time that is none."""
        if "time" not in row:
            return None
        text = str(row["time"]).strip()
        if _NUMBER.fullmatch(text):
            text = text.replace(",", ".")
        elif _POWER.fullmatch(text):
            text = f"{Decimal(text):f}"
        if row["unit"]:
            return number_ns(text, _UNITS[row["unit"]])
        if _WHOLE.fullmatch(text):
            return number_ns(text, _EPOCH_DIGITS.get(len(text), self._unit))
        if _NUMBER.fullmatch(text):
            return number_ns(text, _EPOCH_DIGITS.get(len(text.partition(".")[0]), SECOND_NS))
        stamp = self._stamp(text)
        if not stamp.kind:
            raise ValueError(f"expected a time, got {quote(text)!r}")
        return self._clock(stamp)


def _records(source: Source, table: _Table, is_can: bool, times: _Times) -> Iterator[Chunk | CanFrame | Comment]:
    lines = Lines(source)
    taken = ""
    for line in lines:
        row = table.row(line)
        found = _bytes_in(row) if row is not None else []
        if row is None or not found:
            if line.strip() and (row or (taken and is_like(line, taken))):
                source.problem(f"expected bytes, got {quote(line.strip())!r}", line=lines.number)
            elif (
                line.strip()
                and not _RULE.fullmatch(line)
                and not _is_heading([_key(cell) for cell in re.split(r"[,;|\t]", line)])
            ):
                yield source.comment(None, line)
            continue
        taken = line
        if "beyond" in row:
            said = f"cells behind the last heading are left out: {quote(' '.join(row['beyond']))!r}"
            source.problem(said, line=lines.number)
        try:
            t_ns = times(row)
        except ValueError as error:
            source.problem(f"{error}; the frame is kept", line=lines.number)
            t_ns = None
        port = source.port(can_name(str(row["port"])) if "port" in row and is_can else None)
        for data, role in found:
            if not is_can:
                if not data:
                    continue
                yield Chunk(t_ns, port, data, role, len(data) > 1)
                continue
            number = _identifier(row.get("id"))
            if number is None or number > CAN_ID_MASK or len(data) > _CAN_BYTES:
                source.problem(f"expected a CAN frame, got {quote(line.strip())!r}", line=lines.number)
                continue
            extended = str(row.get("extended", "")).lower() in _TRUE or number > CAN_ID_LIMIT
            remote = str(row.get("remote", "")).lower() in _TRUE
            direction = role if role is Role.REQUEST else Role.UNKNOWN
            length = _length(row, len(data))
            # Of the codes beyond 8, each stands for more bytes of CAN FD; a classic frame then has 8.
            if not remote and len(data) != length and not (8 < length <= 15 and len(data) in (8, FD_LENGTHS[length])):
                source.problem(
                    f"expected {counted(length, 'byte')}, got {len(data)}; the frame has them all", line=lines.number
                )
            frame = CanFrame(t_ns, port, number, data, direction, extended, remote, False, len(data) > 8)
            yield source.carried(frame, lines.number)
