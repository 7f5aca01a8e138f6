"""Hex text: a line for each piece of serial bytes, for people, grep and this program's own reader.

    2026-07-01 12:00:00.123456789 > FA 01 F6 01 40 02 34               from the host
    2026-07-01 12:00:00.126000000 < [bus:left] FB 01 F6 01 F3          from a drive; the bus has a name
    2026-07-01 12:00:00.200000000 [bus:left] FA 01 32 2D               unknown sender
    // text                                                            a comment of the capture

Rules: dates in UTC if the capture has dates, else seconds from its start, else no times. A comment begins so that its text
cannot pass for bytes.
"""

from __future__ import annotations

import time
from typing import IO

from analyzer.catalogue import Role
from analyzer.export import Choices, Writer
from analyzer.records import CanFrame, Chunk, Comment
from analyzer.values import SECOND_NS

_MARKS = {Role.REQUEST: " >", Role.REPLY: " <", Role.UNKNOWN: ""}
#: What the reader calls a line that has no name.
_NAMELESS = "serial"
#: Later than this a time counts from 1970 and not from the start of a capture: 2000-01-01.
_DATES_FROM_NS = 946_684_800 * SECOND_NS
#: Later than this no calendar goes: 9999-12-31.
_DATES_TO_NS = 253_402_300_800 * SECOND_NS
#: The longest piece that stands on one line.
_LINE_BYTES = 1 << 16


class HexTextWriter(Writer):
    """Writes a line for each piece."""

    needs_times = False

    def __init__(self, stream: IO[bytes], choices: Choices) -> None:
        super().__init__(stream, choices)
        self._second = -1
        self._dated = ""
        self._names: dict[str, str] = {}

    def traffic(self, item: Chunk | CanFrame) -> None:
        assert isinstance(item, Chunk)  # the table of formats says what is held
        name = self._names.get(item.port)
        if name is None:
            name = self._names[item.port] = "" if item.port == _NAMELESS else f" [bus:{item.port}]"
        head = f"{self._time(item.t_ns)}{_MARKS[item.direction]}{name} "
        for at in range(0, len(item.data), _LINE_BYTES):
            line = head + item.data[at : at + _LINE_BYTES].hex(" ").upper()
            self.stream.write(line.strip().encode() + b"\n")

    def comment(self, comment: Comment) -> bool:
        """Write a comment, each of its lines as one."""
        for line in comment.text.splitlines():
            shown = "".join(c if c.isprintable() else " " for c in line.lstrip("/#; ")).strip()
            self.stream.write(f"// {shown}\n".encode())
        return True

    def _time(self, t_ns: int | None) -> str:
        if t_ns is None:
            return ""
        seconds, rest = divmod(t_ns, SECOND_NS)
        if not _DATES_FROM_NS <= t_ns < _DATES_TO_NS:
            return f"{seconds}.{rest:09d}"
        if seconds != self._second:
            self._second = seconds
            self._dated = time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime(seconds))
        return f"{self._dated}.{rest:09d}"
