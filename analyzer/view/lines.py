"""Lines of text for frames: cells that stand in columns, and the names that a filter can use.

Everything that comes from a capture goes through `printable` and never acts as markup, so it cannot steer the terminal.
Each colour also has a letter: E W i for the severity, > < ? ~ * for the sender.
"""

from __future__ import annotations

from rich.text import Text

from analyzer.live.snapshot import EVENT, FOREIGN, JUNK, FrameLine
from analyzer.sources.times import ShownTime
from analyzer.values import SECOND_NS, fields_text, printable, raw_text

#: Role -> its sign and its colour.
ROLES = {
    "request": (">", "cyan"),
    "reply": ("<", "green"),
    "message": ("-", "blue"),
    "unknown": ("?", "yellow"),
    "foreign": ("·", "dim"),
    JUNK: ("~", "magenta"),
    EVENT: ("*", "bold blue"),
}
#: Severity -> its letter and its colour.
SEVERITIES = {"error": ("E", "bold red"), "warning": ("W", "bold yellow"), "info": ("i", "cyan"), "": (" ", "")}
#: How times are shown: of day, since the first frame, since the line above.
CLOCK, ELAPSED, STEP = "clock", "elapsed", "step"
TIMES = (CLOCK, ELAPSED, STEP)
#: What a row shows of the frame: its fields, its bytes, or both side by side.
FIELDS, BYTES, BOTH = "fields", "bytes", "both"
MS = 1_000_000
_TIME_WIDTH = 15
_COMMAND_WIDTHS = (18, 22)
_NARROW = 100


def bytes_text(line: FrameLine) -> str:
    """Return a frame's bytes as hex; on CAN its identifier first."""
    return raw_text(line.raw, line.can_id, extended=line.extended)


def said_text(line: FrameLine) -> str:
    """Return what a frame says: its fields, and a reply's latency."""
    if line.role == EVENT:
        return printable(line.text)
    said = printable(fields_text(line.values, line.units)) if line.values else ""
    if line.latency_ns is not None:
        said += f"  ({line.latency_ns / 1e6:.3f} ms)"
    return said


def search_text(line: FrameLine) -> str:
    """Return everything of a line that a search looks through, in lower case."""
    parts = (line.bus, line.who, line.role, line.command, " ".join(line.rules), said_text(line), bytes_text(line))
    return " ".join(parts).lower()


class Columns:
    """How frames stand in columns: which time, fields or bytes, how wide the bus. It makes rows of a given width."""

    def __init__(self, times: ShownTime) -> None:
        self._times = times
        self.time = CLOCK
        #: None: both where there is room for both, else the fields.
        self.shows: str | None = None
        self.bus_width = 3
        #: Of an address; of identifiers of 29 bits as soon as one is shown.
        self.who_width = 4
        self.first_ns = 0

    def next_time(self) -> str:
        self.time = TIMES[(TIMES.index(self.time) + 1) % len(TIMES)]
        return self.time

    def next_shows(self, width: int) -> str:
        """Show fields, bytes or both, the one after what is shown now; return its name."""
        order = (FIELDS, BYTES, BOTH)
        self.shows = order[(order.index(self._shows(width)) + 1) % 3]
        return self.shows

    def _shows(self, width: int) -> str:
        return self.shows or (BOTH if width >= 120 else FIELDS)

    def _room(self, width: int) -> tuple[int, int]:
        left = max(10, width - (2 + _TIME_WIDTH + 1 + self.bus_width + 1 + self.who_width + 3 + _command_width(width) + 1))
        shows = self._shows(width)
        if shows == FIELDS:
            return left, 0
        if shows == BYTES:
            return 0, left
        size = min(left // 2, 36)
        return left - size - 1, size

    def _when(self, t_ns: int, before_ns: int | None) -> str:
        """Return a time: of day, or seconds since the first frame or the line above."""
        if self.time == ELAPSED:
            return f"{(t_ns - self.first_ns) / SECOND_NS:.6f}"
        if self.time == STEP:
            return "" if before_ns is None else f"{(t_ns - before_ns) / SECOND_NS:+.6f}"
        return self._times.text(t_ns)

    def heading(self, width: int) -> Text:
        fields, size = self._room(width)
        which = {CLOCK: f"time {self._times.zone}".rstrip(), ELAPSED: "seconds", STEP: "since above"}[self.time]
        text = f"  {which:>{_TIME_WIDTH}} {'bus':<{self.bus_width}} {'addr':>{self.who_width}}   "
        text += f"{'command':<{_command_width(width)}} "
        text += (f"{'fields':<{fields}} " if fields and size else "fields" if fields else "") + ("bytes" if size else "")
        return Text(text[:width].ljust(width), style="bold", no_wrap=True)

    def row(self, line: FrameLine, width: int, before_ns: int | None = None) -> Text:
        """Return a frame as a row; `before_ns`: time of the line above it."""
        sign, colour = ROLES.get(line.role, ("?", ""))
        letter, alarm = SEVERITIES.get(line.severity, (" ", ""))
        self.who_width = max(self.who_width, min(len(line.who), 10))
        fields, size = self._room(width)
        when = self._when(line.t_ns, before_ns)
        if line.t_ns == 0 and line.role == EVENT:
            when = ""
        bus = printable(line.bus)[: self.bus_width]
        row = Text(no_wrap=True)
        row.append(letter + " ", alarm)
        row.append(f"{when:>{_TIME_WIDTH}} {bus:<{self.bus_width}} {printable(line.who):>{self.who_width}} ", "")
        room = _command_width(width)
        row.append(f"{sign} {cut(printable(line.command), room):<{room}} ", colour)
        if fields:
            start = row.cell_len
            if line.rules:
                row.append("!" + printable(",".join(line.rules)) + " ", alarm)
            # A frame without fields says nothing; bytes that are no frame are shown as they are.
            row.append(
                said_text(line)
                or (
                    bytes_text(line)
                    if not size and (line.role in (JUNK, FOREIGN) or line.command.startswith("unknown"))
                    else ""
                ),
                colour,
            )
            if size:
                row.truncate(start + fields, pad=True)
                row.append(" ")
        if size:
            row.append(bytes_text(line), "dim" if fields else colour)
        row.truncate(width, pad=True)
        return row


def _command_width(width: int) -> int:
    return _COMMAND_WIDTHS[width >= _NARROW]


def cut(text: str, width: int) -> str:
    """Return a text in at most `width` characters."""
    return text if len(text) <= width else text[: width - 1] + "…"
