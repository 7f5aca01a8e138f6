"""Hex text: logs of serial traffic as people have them, a line of hex bytes after the other (see `hexline.py`).

Rules: each line of traffic is a burst of its own; lines of bytes below a header (a line with only a time or a mark)
are one. `Tx`, `Send` and `>` mean that the host sent, `Rx`, `Recv` and `<` that the drive did; in a log that marks
every line as received they mean nothing, for a listener wrote it. Lines of words are comments, broken lines are
problems.

Times: exact to their digits. Without a date they count from zero, and a time of day that passes midnight goes on.
`+0.012` counts from the start, or from the line before where the values go back.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

from analyzer.catalogue import Role
from analyzer.records import Chunk, Comment
from analyzer.sources.hexline import HexLine, Shape, take_apart
from analyzer.sources.lines import Lines, head_lines
from analyzer.sources.source import Source, quote
from analyzer.sources.times import UNITS, Clock, DayCount, Deltas, clock_ns, day_ns, falls, number_ns, zone_ns

#: Lines of a head that are looked at to find the format.
_SAMPLE_LINES = 400
#: Traffic lines, as a share of all, below which a text is no log.
_LEAST_SHARE = 0.2
_LEAST_MARKED_SHARE = 0.05
_MARKED_LINES = 3
#: So many lines marked as received, and none as sent, are a listener's.
_LISTENER_LINES = 8
#: A header's lines are collected up to this many bytes.
_COLLECTED = 1 << 16
#: How many bytes a line has: nothing to tell anyone.
_COUNTED = re.compile(r"\(?\s*(?:len\w*\s*[=:]?\s*)?\d+\s*(?:bytes?|B)?\s*\)?", re.IGNORECASE)
_HEX_LETTER = re.compile(r"[A-Fa-f]|0x|\\x")
_BUS_NAME = re.compile(r"(?:bus|com|port|can|tty|uart|usart|rs-?485|rs-?232|usb|serial|line|ch|channel|axis)\W?\w*", re.I)
#: A name as this program exports it: a bus, and not a number of one.
_EXPORTED_NAME = re.compile(r"bus:(?!\d+$)([\w.-]+)")

_CLOCK = re.compile(r"(\d{1,2}):(\d\d):(\d\d)(?:[.,:](\d{1,9}))?")
_DATED = re.compile(
    r"(\d{1,4})[-/.](\d{1,2})[-/.](\d{1,4})[T_,\s]{1,2}(\d{1,2}):(\d\d):(\d\d)(?:[.,:](\d{1,9}))?\s?(Z|[+-]\d\d:?\d\d)?"
)
_NUMBER = re.compile(r"\+?(\d+(?:\.\d+)?)\s?([a-zµ]*)")

_SOURCES = {
    "date": "dates as printed, taken as UTC where they name no zone",
    "dmy": "dates as printed, taken as UTC",
    "clock": "times of day as printed, without a date",
    "step": "seconds as printed",
    "seconds": "seconds as printed",
    "units": "numbers as printed",
    "epoch_ms": "milliseconds as printed",
}


def score(head: bytes) -> float:
    """Say how sure it is that these bytes are hex text, 0..1."""
    lines = head_lines(head)[:_SAMPLE_LINES]
    parts = [take_apart(line) for line in lines]
    traffic = [p for p in parts if p.shape is Shape.TRAFFIC]
    counted = sum(1 for p in parts if p.shape is not Shape.COMMENT or not p.text.startswith(("#", "//", ";")))
    if not traffic or not counted:
        return 0.0
    ratio = len(traffic) / counted
    marked = sum(1 for p in traffic if p.marked and len(p.data) > 1)
    # Rows of decimal numbers pass for hex; real traffic is not free of letters for long.
    letters = any(_HEX_LETTER.search(p.data.hex()) for p in traffic)
    if not letters and not marked and sum(len(p.data) for p in traffic) > 4:
        return 0.1
    if ratio >= _LEAST_SHARE or (marked >= _MARKED_LINES and ratio >= _LEAST_MARKED_SHARE):
        return 0.4 + 0.5 * min(1.0, ratio)
    return 0.25 * ratio / _LEAST_SHARE


def read(source: Source) -> Iterator[Chunk | Comment]:
    """Read the lines one by one."""
    parts = [take_apart(line) for line in head_lines(source.head)]
    timed = next((p.stamp_kind for p in parts if p.stamp_kind and p.shape in (Shape.TRAFFIC, Shape.HEADER)), "")
    if timed:
        source.time_source = f"capture: {_SOURCES[timed]}, exact to their digits"
        zoned = any((dated := _DATED.match(p.stamp)) is not None and dated[dated.re.groups] for p in parts)
        source.clock = Clock.UTC if zoned else _CLOCKS.get(timed, Clock.UTC)
    roles = [p.role for p in parts if p.shape in (Shape.TRAFFIC, Shape.HEADER)]
    deaf = roles.count(Role.REPLY) >= _LISTENER_LINES and Role.REQUEST not in roles
    if deaf:
        source.note("every line is marked as received, as a listener's log is: the marks do not tell the sender")
    return _Reader(source, _Clock(parts), deaf).records()


#: Kinds of stamps that are no times since the epoch.
_CLOCKS = {"clock": Clock.DAY, "date": Clock.PRINTED, "dmy": Clock.PRINTED}


class _Clock:
    """Reads printed times in the order of the lines."""

    def __init__(self, parts: list[HexLine]) -> None:
        self._days = DayCount()
        steps = [_number_ns(p.stamp) for p in parts if p.stamp_kind == "step"]
        step: Callable[[int], int] = Deltas() if falls(steps) else int
        self._kinds: dict[str, Callable[[str], int]] = {
            "date": _dated_ns,
            "dmy": _dated_ns,
            "clock": lambda text: self._days(_daytime_ns(text)),
            "step": lambda text: step(_number_ns(text)),
            "seconds": _number_ns,
            "units": _number_ns,
            "epoch_ms": lambda text: int(text) * 1_000_000,
        }

    def __call__(self, line: HexLine) -> int | None:
        """Return the time of a line, None without one. Raises ValueError for a time that is none."""
        return self._kinds[line.stamp_kind](line.stamp) if line.stamp_kind else None


def _number_ns(text: str) -> int:
    found = _NUMBER.fullmatch(text.strip())
    if found is None:
        raise ValueError(f"expected a number, got {text!r}")
    return number_ns(found[1], UNITS.get(found[2] or "s", UNITS["s"]))


def _daytime_ns(text: str) -> int:
    found = _CLOCK.match(text)
    if found is None:
        raise ValueError(f"expected a time of day, got {text!r}")
    return clock_ns(*found.groups())


def _dated_ns(text: str) -> int:
    found = _DATED.match(text)
    if found is None:
        raise ValueError(f"expected a date, got {text!r}")
    first, month, last, hour, minute, second, fraction, zone = found.groups()
    year, day = (first, last) if len(first) == 4 else (last, first)
    ns = day_ns(int(year), int(month), int(day)) + clock_ns(hour, minute, second, fraction)
    return ns - zone_ns(zone) if zone is not None else ns


class _Reader:
    """Turns lines into records; holds the header that waits for its bytes."""

    def __init__(self, source: Source, clock: _Clock, deaf: bool) -> None:
        self._source = source
        self._lines = Lines(source)
        self._clock = clock
        self._deaf = deaf
        self._header: HexLine | None = None
        self._header_ns: int | None = None
        self._collected = bytearray()

    def records(self) -> Iterator[Chunk | Comment]:
        """Yield the records of all lines."""
        source = self._source
        for text in self._lines:
            line = take_apart(text)
            if self._header is not None:
                plain = line.shape is Shape.TRAFFIC and not line.marked and not line.stamp_kind
                if plain and not self._header.ascii and len(self._collected) < _COLLECTED:
                    self._collected += line.data
                    continue
                if line.shape is Shape.BLANK and not self._collected:
                    continue
                if self._header.ascii and line.shape is not Shape.BLANK and not line.stamp_kind:
                    yield source.comment(self._header_ns, text)
                    continue
                yield from self._end_header()
            if line.shape is Shape.BLANK:
                continue
            t_ns = self._time(line)
            if line.shape is Shape.TRAFFIC:
                yield self._chunk(t_ns, line, line.data)
                if line.note and not _COUNTED.fullmatch(line.note):
                    yield source.comment(t_ns, line.note)
            elif line.shape is Shape.HEADER:
                self._header, self._header_ns = line, t_ns
            elif line.shape is Shape.COMMENT:
                yield source.comment(t_ns, line.text)
            else:
                source.problem(f"expected hex bytes, got {quote(line.text.strip())!r}", line=self._lines.number)
        yield from self._end_header()

    def _time(self, line: HexLine) -> int | None:
        try:
            return self._clock(line)
        except ValueError as error:
            self._source.problem(str(error), line=self._lines.number)
            return None

    def _chunk(self, t_ns: int | None, line: HexLine, data: bytes) -> Chunk:
        name = line.name if line.name and _BUS_NAME.fullmatch(line.name) else None
        exported = _EXPORTED_NAME.fullmatch(line.name)
        if exported is not None:
            name = exported[1]
        return Chunk(t_ns, self._source.port(name), data, Role.UNKNOWN if self._deaf else line.role, True)

    def _end_header(self) -> Iterator[Chunk | Comment]:
        header, data = self._header, bytes(self._collected)
        self._header = None
        self._collected.clear()
        if header is None:
            return
        if data:
            yield self._chunk(self._header_ns, header, data)
        elif not header.ascii:
            yield self._source.comment(self._header_ns, header.text)
