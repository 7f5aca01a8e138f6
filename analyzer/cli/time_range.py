"""The time range of a capture: `--since` and `--until`.

Decoding begins some seconds before the range, without output. So half frames and open requests at its beginning are decoded
as in the whole capture. What was learnt of the drives long before (groups, silenced drives) is not known.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from analyzer.entries import Entry, EventSink, Sink
from analyzer.errors import UsageError
from analyzer.events import SETUPS
from analyzer.records import CanFrame, Chunk, Comment, Event, Finding, Junk
from analyzer.sources.times import Anchor, ShownTime, TimeOption, iso, parse_time

if TYPE_CHECKING:
    from analyzer.sources import Source
    from analyzer.sources.source import Record

#: How long before the range decoding begins: longer than a request waits for its reply.
WARM_NS = 5_500_000_000
_BEFORE_ALL_NS = -(1 << 63)
_AFTER_ALL_NS = 1 << 63

T = TypeVar("T")


def add_time_range_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of every command that can read a time range."""
    moment = "2026-11-21T16:22:11Z, 09:00:05, 5s or +1:30 (from the start), -5min (from the end)"
    parser.add_argument("--since", type=_moment, metavar="T", help=f"only traffic from this time on: {moment}")
    parser.add_argument("--until", type=_moment, metavar="T", help="only traffic up to this time, same notation")
    parser.add_argument("--utc", action="store_true", help="show times in UTC instead of the local zone, and read them so")


def _moment(text: str) -> TimeOption:
    try:
        return parse_time(text)
    except UsageError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


class TimeRange:
    """The time range of one source. `since_ns`, `until_ns` are known with the first item, or before."""

    def __init__(self, source: Source, since: TimeOption | None, until: TimeOption | None, *, utc: bool = False) -> None:
        self._source = source
        self._utc = utc
        self._since, self._until = since, until
        self.since_ns, self.until_ns = _BEFORE_ALL_NS, _AFTER_ALL_NS
        #: Bytes that were decoded unseen.
        self.unseen_bytes = 0
        self._resolved = not self.wanted
        to_end = any(moment is not None and moment.anchor is Anchor.END for moment in (since, until))
        if self.wanted and (source.kind == "log" or to_end):
            bounds = _log_bounds(source) if source.kind == "log" else _bounds(source)
            if bounds is not None:
                self._resolve(*bounds)
                if since is not None and source.kind == "log":
                    source.skip_before_ns = self.since_ns - WARM_NS

    @property
    def wanted(self) -> bool:
        """Whether it is not the whole."""
        return self._since is not None or self._until is not None

    @property
    def shown(self) -> ShownTime:
        return ShownTime(self._source.clock, utc=self._utc)

    def _resolve(self, start_ns: int, end_ns: int) -> None:
        self._resolved = True
        if self._since is not None:
            self.since_ns = self._since.resolve(start_ns, end_ns, self.shown)
        if self._until is not None:
            self.until_ns = self._until.resolve(start_ns, end_ns, self.shown)
        if self.until_ns < self.since_ns:
            raise UsageError(f"--until {iso(self.until_ns)} lies before --since {iso(self.since_ns)}")

    def items(self, records: Iterable[Record]) -> Iterator[Record]:
        """Yield the records to decode: the range, and some seconds before it."""
        if not self.wanted:
            yield from records
            return
        for record in records:
            t_ns = record.t_ns
            if t_ns is not None:
                if not self._resolved:
                    self._resolve(t_ns, t_ns)
                if t_ns > self.until_ns:
                    return
                said = isinstance(record, Event) and (record.name in SETUPS or record.name == "part")
                if t_ns < self.since_ns - WARM_NS and not said:
                    continue
            elif not isinstance(record, Comment):
                raise UsageError(f"{self._source.name} has no timestamps: --since and --until cannot apply")
            yield record

    def sinks(self, sinks: Sequence[Sink]) -> Sequence[Sink]:
        """Return sinks that see only the range."""
        if self._since is None:
            return sinks
        return [_Within(sink, self, counts=not number) for number, sink in enumerate(sinks)]

    def about(self) -> dict[str, str]:
        """Return its metadata for a log."""
        values = {}
        if self._since is not None:
            values["since"] = iso(self.since_ns)
        if self._until is not None:
            values["until"] = iso(self.until_ns)
        return values


class _Within:
    """A sink that passes on only the range. `counts`: it counts the bytes before the range."""

    def __init__(self, sink: Sink, stretch: TimeRange, *, counts: bool) -> None:
        self._sink = sink
        self._stretch = stretch
        self._counts = counts
        self._happened = sink.happened if isinstance(sink, EventSink) else None

    def entry(self, entry: Entry) -> None:
        if entry.message.frame.last_ns >= self._stretch.since_ns:
            self._sink.entry(entry)
        elif self._counts:
            self._stretch.unseen_bytes += len(entry.message.frame.data)

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        if junk.last_ns >= self._stretch.since_ns:
            self._sink.junk(junk, sequence, topic)
        elif self._counts:
            self._stretch.unseen_bytes += len(junk.data)

    def finding(self, found: Finding) -> None:
        if found.last_ns >= self._stretch.since_ns:
            self._sink.finding(found)

    def comment(self, comment: Comment) -> None:
        if comment.t_ns is None or comment.t_ns >= self._stretch.since_ns:
            self._sink.comment(comment)

    def happened(self, event: Event, sequence: int) -> None:
        """Pass an event on; what was said of the buses counts for all that follows."""
        if self._happened is not None and (event.t_ns >= self._stretch.since_ns or event.name in SETUPS):
            self._happened(event, sequence)


def _log_bounds(source: Source) -> tuple[int, int] | None:
    """Return the first and last time of a log, all its parts together."""
    from analyzer.sources.mcap_records import bounds

    if source.size is None or source.stream.compression:
        return None
    found = [each for path in source.files if (each := bounds(path)) is not None]
    return (min(first for first, _ in found), max(last for _, last in found)) if found else None


def _bounds(source: Source) -> tuple[int, int] | None:
    """Return the first and last time of a capture, by reading it once before."""
    from analyzer.sources import open_source

    if source.size is None:
        raise UsageError("a time before the end needs a file: the end of standard input is unknown")
    first: int | None = None
    last = 0
    with open_source(
        Path(source.path),
        format=source.format,
        baud=source.baud,
        channels=source.channels,
        inverted=source.inverted,
        uart=source.uart,
    ) as before:
        for record in before:
            if isinstance(record, (Chunk, CanFrame)) and record.t_ns is not None:
                first = record.t_ns if first is None else first
                last = max(last, record.t_ns)
        source.clock = before.clock
    return None if first is None else (first, last)
