"""TRC, the text trace of PEAK's tools, versions 1.0, 1.1, 1.3, 2.0 and 2.1, through python-can.

    ;$FILEVERSION=2.1
    ;$STARTTIME=45046.9450914352
    ;$COLUMNS=N,O,T,B,I,d,R,L,D
          1      1059.900 DT  1     0001 Rx -  4    F6 01 40 02

Rules: a time is the start plus the printed milliseconds, exact to their digits. The start is days since 1899-12-30,
taken as UTC; version 1.0 has none a program can read, so its times count from zero. Lines that are no frame (bus
status) are counted.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from decimal import Decimal
from typing import TYPE_CHECKING, Any, cast

from analyzer.errors import UnreadableError
from analyzer.records import CanFrame
from analyzer.sources.can_library import Tap, frames
from analyzer.sources.lines import Lines, head_lines, share
from analyzer.sources.source import Source
from analyzer.sources.times import DAY, Clock, number_ns
from analyzer.values import counted

if TYPE_CHECKING:
    from can import Message

_FIELD = re.compile(r"\s*;\$(FILEVERSION|STARTTIME|COLUMNS)\s*=\s*(\S+)")
_FRAME = re.compile(r"\s*\d+\)?\s+\d+\.?\d*\s+(\w\w\s+)?(\d+\s+)?((Tx|Rx)\s+)?[0-9A-Fa-f]{4,8}\s")
_SUPPORTED = ("1.0", "1.1", "1.3", "2.0", "2.1")
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
    if version not in _SUPPORTED:
        raise UnreadableError(f"{source.name}: TRC version {version} is not supported, expected one of {', '.join(_SUPPORTED)}")
    columns = fields.get("COLUMNS", "").split(",")
    if version >= "2" and not {"N", "O"} <= set(columns):
        raise UnreadableError(
            f"{source.name}: TRC version {version} without the columns N and O for numbers and times in its header"
        )
    return _records(source, version, columns, _start_ns(fields.get("STARTTIME")))


def _start_ns(days: str | None) -> int:
    try:
        start = int((Decimal(days or "") - _EPOCH_DAYS) * DAY)
    except (ArithmeticError, ValueError):
        return 0
    return max(start, 0)


def _records(source: Source, version: str, columns: list[str], start_ns: int) -> Iterator[CanFrame]:
    from can.io.trc import TRCReader

    # python-can gives up on a damaged header, and this one was read already.
    header = [";$STARTTIME=0"]
    if version != "1.0":
        header.append(f";$FILEVERSION={version}")
    if version >= "2":
        header.append(f";$COLUMNS={','.join(columns)}")
    tap = Tap(Lines(source), lambda line: False, lambda line: not line.lstrip().startswith(";"), header)
    at = columns.index("O") if version >= "2" else 1
    named = version == "1.3" or "B" in columns
    given = 0
    first = 0

    def place(message: Message) -> tuple[int, str]:
        t_ns = start_ns + number_ns(tap.line.split(maxsplit=at + 1)[at], _MILLISECOND)
        return t_ns, source.port(f"can{message.channel}" if named else None)

    for frame in frames(source, tap, cast(Callable[[Tap], Any], TRCReader), place):
        given += 1
        first = first or tap.number
        yield frame
    left = tap.number - first + 1 - given - source.problem_count
    if given and left > 0:
        source.note(f"{counted(left, 'line')} left out: not frames (comments, bus status)")
