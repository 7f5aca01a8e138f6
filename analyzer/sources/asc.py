"""ASC, the text log of Vector's tools, through python-can.

    date Sun Apr 30 10:40:55.899 pm 2023
    base hex  timestamps absolute
    internal events logged
    Begin Triggerblock Sun Apr 30 10:40:55.899 pm 2023
       0.000512 1  001             Rx   d 4 F6 01 40 02

Rules: a time is the header's date plus the printed seconds, exact to their digits; with `timestamps relative` the
seconds of all lines are summed. The header has no zone; its date is taken as UTC. `Tx` says that the host sent a
frame; `TxRq`, the wish to send one, is left out, since the frame follows.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, cast

from analyzer.records import CanFrame
from analyzer.sources.can_library import Tap, frames
from analyzer.sources.lines import Lines, head_lines, is_like, share
from analyzer.sources.source import Source, quote
from analyzer.sources.times import Clock, clock_ns, day_ns, number_ns
from analyzer.system.own_process import without
from analyzer.values import counted

if TYPE_CHECKING:
    from can import Message

_HEADER = re.compile(r"\s*(date\s+\w+\s|base\s+(hex|dec)\b|//|(no\s+)?internal\s+events\s+logged)", re.IGNORECASE)
_HEADED = re.compile(r"\s*(date\s+\w+\s+\w+\s+\d+\s+\d+:\d\d:\d\d|base\s+(hex|dec)\b)", re.IGNORECASE)
_FRAME = re.compile(r"\s*\d+\.\d+\s+(\d+\s+([0-9A-F]+x?\s+(Tx|Rx)|ErrorFrame)\b|CANFD\s+\d+\s)", re.IGNORECASE)
_STAMP = re.compile(r"\s*(\d+\.\d+)\s")
_DATE = re.compile(
    r"\s*(?:date|begin\s+triggerblock)\s+\w+\s+(\w+)\s+(\d+)\s+(\d+):(\d\d):(\d\d)(?:\.(\d+))?\s*(am|pm)?\s+(\d{4})",
    re.IGNORECASE,
)
_RELATIVE = re.compile(r"\s*base\s+\w+\s+timestamps\s+relative", re.IGNORECASE)
#: A line of a frame, even of a damaged one: a channel, an identifier, a direction, its kind.
_TRAFFIC = re.compile(r"\s*\S+\s+\S+\s+[0-9A-F]+x?\s+(?:Rx|Tx)\s+[dr]\b", re.IGNORECASE)
_DATA = re.compile(r"\sd\s+([0-9A-F])((?:\s+[0-9A-F]{2}(?![^\s]))*)\s*(?:Length\b.*)?$", re.IGNORECASE)
_DECIMAL = re.compile(r"\s*base\s+dec\b", re.IGNORECASE)
_WISH = re.compile(r"\sTxRq\s", re.IGNORECASE)
_MONTHS = {
    "jan": 1, "feb": 2, "mar": 3, "mär": 3, "apr": 4, "may": 5, "mai": 5, "jun": 6, "jul": 7, "aug": 8, "sep": 9,
    "oct": 10, "okt": 10, "nov": 11, "dec": 12, "dez": 12,
}  # fmt: skip


def score(head: bytes) -> float:
    """Say how sure it is that these bytes are ASC, 0..1."""
    lines = head_lines(head)[:5]
    if any(_HEADED.match(line) for line in lines):
        return 0.95
    return 0.9 * share(head, _FRAME)


def read(source: Source) -> Iterator[CanFrame]:
    """Read the frames; other events of the log are left out."""
    source.time_source = "capture: the date of the header, taken as UTC, and the printed seconds, exact to their digits"
    source.clock = Clock.PRINTED
    return _records(source)


class _Clock:
    """Keeps the time of a log from its lines."""

    def __init__(self) -> None:
        self._start_ns = 0
        self._now_ns = 0
        self._relative = False

    def line(self, line: str) -> None:
        """Take what a line says of the time."""
        stamp = _STAMP.match(line)
        if stamp is not None:
            seconds = number_ns(stamp[1])
            self._now_ns = self._now_ns + seconds if self._relative else seconds
        elif (dated := _DATE.match(line)) is not None:
            self._start_ns = _date_ns(dated) or self._start_ns
        elif _RELATIVE.match(line):
            self._relative = True

    @property
    def t_ns(self) -> int:
        """The time of the line taken last."""
        return self._start_ns + self._now_ns


def _date_ns(dated: re.Match[str]) -> int | None:
    month, day, hour, minute, second, fraction, half, year = dated.groups()
    number = _MONTHS.get(month[:3].lower())
    if number is None:
        return None
    if half:
        hour = str(int(hour) % 12 + (12 if half.lower() == "pm" else 0))
    try:
        return day_ns(int(year), number, int(day)) + clock_ns(hour, minute, second, fraction)
    except ValueError:
        return None


def _records(source: Source) -> Iterator[CanFrame]:
    with without("asammdf"):
        from can.io.asc import ASCReader

    clock = _Clock()

    decimal = False
    #: A line that python-can has not made a frame of yet; it passes over what it does not know.
    due: tuple[int, str] | None = None
    taken = ""

    def tell_passed() -> None:
        nonlocal due
        if due is not None:
            source.problem(f"expected a frame, got {quote(due[1].strip())!r}", line=due[0])
        due = None

    def keep(line: str) -> bool:
        nonlocal decimal, due
        tell_passed()
        clock.line(line)
        decimal = decimal or _DECIMAL.match(line) is not None
        if _WISH.search(line) is not None:
            return False
        due = (lines.number, line) if _TRAFFIC.match(line) or (taken and is_like(line, taken)) else None
        return True

    lines = Lines(source)
    tap = Tap(lines, lambda line: _HEADER.match(line) is not None, keep, ("no internal events logged",))

    def place(message: Message) -> tuple[int, str]:
        nonlocal due, taken
        if due is not None:
            taken, due = due[1], None
        said = None if decimal else _DATA.search(tap.line)
        if said is not None and int(said[1], 16) != len(said[2].split()):
            source.problem(f"expected {counted(int(said[1], 16), 'byte')}, got {len(said[2].split())}", line=tap.number)
        # python-can counts channels from 0, the file from 1.
        name = f"can{message.channel + 1}" if isinstance(message.channel, int) else None
        return clock.t_ns, source.port(name)

    yield from frames(source, tap, cast(Callable[[Tap], Any], ASCReader), place)
    tell_passed()
