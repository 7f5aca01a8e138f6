"""TRC, the text trace of PEAK's tools, versions 1.0, 1.1, 1.3, 2.0 and 2.1.

    ;$FILEVERSION=2.1
    ;$STARTTIME=45046.9450914352
    ;$COLUMNS=N,O,T,B,I,d,R,L,D
          1      1059.900 DT  1     0001 Rx -  4    F6 01 40 02

Rules: a time is the start plus the printed milliseconds, exact to their digits. The start is days since 1899-12-30,
taken as UTC; version 1.0 has none a program can read, so its times count from zero. Lines of status, errors and events are
counted; what else is no whole frame is a problem.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from decimal import Decimal

from analyzer.catalogue import Role
from analyzer.errors import UnreadableError
from analyzer.records import CanFrame
from analyzer.sources.lines import Lines, cut_note, head_lines, is_like, share
from analyzer.sources.source import Source, quote
from analyzer.sources.times import DAY, Clock, number_ns
from analyzer.values import CAN_ID_MASK, FD_LENGTHS, counted

_FIELD = re.compile(r"\s*;\$(FILEVERSION|STARTTIME|COLUMNS)\s*=\s*(\S+)")
_FRAME = re.compile(r"\s*\d+\)?\s+\d+\.?\d*\s+(\w\w\s+)?(\d+\s+)?((Tx|Rx)\s+)?[0-9A-Fa-f]{4,8}\s")
#: The columns of each version; version 2 names its own.
_COLUMNS = {"1.0": "N,O,I,L,D", "1.1": "N,O,d,I,L,D", "1.3": "N,O,B,d,I,R,L,D", "2.0": "", "2.1": ""}
#: Kinds of frames: data, remote, and CAN FD.
_KINDS = ("DT", "RR", "FD", "FB", "FE", "BI")
#: What stands for a kind or a direction in lines that tell of the bus.
_STATUS = ("ST", "EC", "ER", "EV", "Warng", "Error")
_ID = re.compile(r"[0-9A-Fa-f]{1,8}")
_NO_ID = "FFFFFFFF"
_STANDARD_DIGITS = 4
_CLASSIC_BYTES = 8
#: 1970-01-01 in days since 1899-12-30.
_EPOCH_DAYS = 25569
_MILLISECOND = 1_000_000


def score(head: bytes) -> float:
    """Say how sure it is that these bytes are a TRC trace, 0..1."""
    if any(_FIELD.match(line) for line in head_lines(head)[:30]):
        return 1.0
    plain = [line for line in head_lines(head) if not line.lstrip().startswith(";")]
    if not plain or not re.match(r"\s*1\)\s", plain[0]):
        return 0.0
    return 0.9 * share("\n".join(plain).encode() + b"\n", _FRAME)


def read(source: Source) -> Iterator[CanFrame]:
    """Read the frames."""
    source.time_source = "capture: the header's start, taken as UTC, and the printed milliseconds, exact to their digits"
    source.clock = Clock.PRINTED
    fields = {m[1]: m[2] for line in head_lines(source.head) if (m := _FIELD.match(line)) is not None}
    version = fields.get("FILEVERSION", "1.0")
    if version not in _COLUMNS:
        raise UnreadableError(f"{source.name}: TRC version {version} is not supported, expected one of {', '.join(_COLUMNS)}")
    columns = (_COLUMNS[version] or fields.get("COLUMNS", "")).split(",")
    missing = [name for name in ("O", "I", "D") if name not in columns] + ["L"] * (not {"l", "L"} & set(columns))
    if missing:
        raise UnreadableError(f"{source.name}: TRC version {version} without the columns {', '.join(missing)} in its header")
    return _records(source, columns, _start_ns(fields.get("STARTTIME")))


def _start_ns(days: str | None) -> int:
    try:
        start = int((Decimal(days or "") - _EPOCH_DAYS) * DAY)
    except (ArithmeticError, ValueError):
        return 0
    return max(start, 0)


def _records(source: Source, columns: Sequence[str], start_ns: int) -> Iterator[CanFrame]:
    lines = Lines(source)
    left = 0
    taken = ""
    for line in lines:
        comment = line.lstrip().startswith(";") and not (taken and is_like(line, taken))
        if not line.strip() or comment:
            continue
        cells = dict(zip(columns, line.split(maxsplit=len(columns) - 1), strict=False))
        if cells.get("T") in _STATUS or cells.get("d") in _STATUS or cells.get("I") == _NO_ID:
            left += 1
            continue
        try:
            frame = _frame(source, cells, start_ns)
        except ValueError as error:
            source.problem(f"{error}, got {quote(line.strip())!r}", line=lines.number)
        else:
            taken = line
            yield source.carried(frame, lines.number)
    if left:
        source.note(f"{counted(left, 'line')} left out: not frames (bus status, errors)")
    cut_note(source, lines)


def _frame(source: Source, cells: dict[str, str], start_ns: int) -> CanFrame:
    """Return the frame of a line by its cells. Raises ValueError, which says what was expected, where it is not whole."""
    kind, direction, identifier = cells.get("T", "DT"), cells.get("d", "Rx"), cells.get("I", "")
    if kind not in _KINDS:
        raise ValueError(f"expected one of {', '.join((*_KINDS, *_STATUS[:4]))}")
    if direction not in ("Rx", "Tx"):
        raise ValueError("expected Rx or Tx")
    if not _ID.fullmatch(identifier) or int(identifier, 16) > CAN_ID_MASK:
        raise ValueError("expected an identifier of 29 bits in hexadecimal")
    printed = cells.get("D", "")
    remote, fd = kind == "RR" or printed == "RTR", kind not in ("DT", "RR")
    length, data = _length(cells, fd), b"" if printed == "RTR" else _data(printed)
    if not remote and len(data) != length:
        raise ValueError(f"expected {counted(length, 'byte')}")
    try:
        t_ns = start_ns + number_ns(cells["O"], _MILLISECOND)
    except ValueError:
        raise ValueError("expected a time in milliseconds") from None
    if not cells.get("B", "1").isdecimal():
        raise ValueError("expected the number of a bus")
    port = source.port(f"can{cells['B']}" if "B" in cells else None)
    role = Role.UNKNOWN if direction == "Rx" else Role.REQUEST
    return CanFrame(t_ns, port, int(identifier, 16), data, role, len(identifier) > _STANDARD_DIGITS, remote, fd=fd)


def _length(cells: dict[str, str], fd: bool) -> int:
    """Return how many bytes a line says; `L` is the code of a length, `l` the length itself."""
    text = cells.get("l") or cells.get("L", "")
    if not re.fullmatch(r"[0-9]{1,2}", text) or int(text) > (FD_LENGTHS[-1] if "l" in cells else len(FD_LENGTHS) - 1):
        raise ValueError("expected a length")
    if "l" in cells:
        return int(text)
    return FD_LENGTHS[int(text) if fd else min(int(text), _CLASSIC_BYTES)]


def _data(text: str) -> bytes:
    try:
        return bytes.fromhex(text)
    except ValueError:
        raise ValueError("expected bytes in hexadecimal") from None
