"""A capture in the view: read once from beginning to end, while its frames are already shown.

A thread reads and decodes; every frame goes into a `FrameStore`, from which the view takes the visible frames. A plot or
a filter reads the store in small steps. Long captures need a temporary file.
"""

from __future__ import annotations

import threading
import time
from array import array
from bisect import bisect_left
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING

from analyzer.diagnosis.running import Running
from analyzer.entries import Entry, plain_entry
from analyzer.errors import ServotapError, UsageError
from analyzer.live.snapshot import EVENT, FindingLine, FrameLine, Snapshot
from analyzer.live.snapshot_lines import event_line, finding_line, frame_line, junk_line
from analyzer.live.snapshot_sink import SnapshotSink
from analyzer.records import Comment, Event, Finding, Frame, Junk, Lane
from analyzer.view.condition import Condition
from analyzer.view.kept import Wanted
from analyzer.view.series import SERIES, Point, Series, series_of, series_prefixes
from analyzer.view.source import ViewSource
from analyzer.view.store import BLOCK, FrameStore, Record
from analyzer.view.watch import FINDINGS, Watch

if TYPE_CHECKING:
    from analyzer.cli.reading import OpenCapture

#: Seconds between two snapshots of the counts.
_PERIOD = 0.1


class _Keeper:
    """A sink that stores every line, and every finding up to a limit."""

    def __init__(self, store: FrameStore) -> None:
        self._store = store
        self.findings: list[FindingLine] = []
        self.series: dict[str, str] = {}
        self._seen: set[tuple[str, int]] = set()
        self.first_ns: int | None = None
        self.last_ns = 0

    def plain(self, lane: Lane, frame: Frame, sequence: int, latency_ns: int | None, request_sequence: int | None) -> None:
        if frame.last_ns > self.last_ns:
            self.last_ns = frame.last_ns
        if (lane.topic, id(lane.form)) not in self._seen:
            self._series(frame_line(plain_entry(lane, frame, sequence, latency_ns, request_sequence)), id(lane.form))
        self._store.add_plain(lane, frame, sequence, latency_ns, request_sequence)

    def entry(self, entry: Entry) -> None:
        line = frame_line(entry)
        self.last_ns = max(self.last_ns, line.t_ns)
        if (entry.topic, id(entry.message.form)) not in self._seen:
            self._series(line, id(entry.message.form))
        self._store.add_line(line)

    def _series(self, line: FrameLine, form: int) -> None:
        """Note what can be plotted of a message that is of a kind not seen before."""
        self._seen.add((line.topic, form))
        if self.first_ns is None:
            self.first_ns = line.t_ns
        for name, _, unit in series_of(line):
            if len(self.series) < SERIES:
                self.series[name] = unit

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        self.last_ns = max(self.last_ns, junk.last_ns)
        self._store.add_line(junk_line(junk, sequence, topic))

    def finding(self, found: Finding) -> None:
        self._store.late(found.sequence, found.rule)
        if len(self.findings) < FINDINGS:
            self.findings.append(finding_line(found))

    def happened(self, event: Event, sequence: int) -> None:
        self._store.add_line(event_line(event, sequence))

    def comment(self, comment: Comment) -> None:
        t_ns = self.last_ns if comment.t_ns is None else comment.t_ns
        self._store.add_line(FrameLine(0, t_ns, comment.port, EVENT, "comment", text=comment.text))


class WantedNumbers(Wanted):
    """Lines of a store that are wanted: eight bytes for each."""

    first = 0

    def __init__(self, store: FrameStore, condition: Condition) -> None:
        super().__init__(store)
        self._store = store
        self._condition = condition
        self._numbers = array("Q")
        #: Lane -> the answer for all its frames; None: each has to be asked.
        self._lanes: dict[int, bool | None] = {}

    @property
    def stop(self) -> int:
        return len(self._numbers)

    def line(self, number: int) -> FrameLine:
        return self._store.line(self._numbers[number])

    def number_of(self, sequence: int) -> int | None:
        number = self._store.number_of(sequence)
        if number is None:
            return None
        at = bisect_left(self._numbers, number)
        return at if at < len(self._numbers) and self._numbers[at] == number else None

    def look(self, seconds: float) -> None:
        until = time.perf_counter() + seconds
        store, lanes = self._store, self._lanes
        while self.looked < store.stop and time.perf_counter() < until:
            block, skip = divmod(self.looked, BLOCK)
            # A block that is being filled grows meanwhile: what is taken here is what counts.
            for number, record in enumerate(store.records(block)[skip:], self.looked):
                if record.lane is not None:
                    key = id(record.lane)
                    if key not in lanes:
                        lanes[key] = self._condition.of_lane(record.line())
                    answer = lanes[key]
                    if answer is not None:
                        if answer:
                            self._numbers.append(number)
                        self.looked = number + 1
                        continue
                if self._condition(store.line(number)):
                    self._numbers.append(number)
                self.looked = number + 1


class CapturePlot:
    """Points of series, looked for in the store, block by block."""

    def __init__(self, store: FrameStore, names: Sequence[str], low_ns: int, high_ns: int) -> None:
        self._store = store
        self._series = {name: Series() for name in names}
        self._low_ns, self._high_ns = low_ns, high_ns
        self._block = store.block_of(low_ns)
        self._last = store.block_of(high_ns)
        #: Lane -> whether its frames can have points of these series.
        self._lanes: dict[int, bool] = {}

    @property
    def done(self) -> bool:
        return self._block > self._last or self._block >= self._store.blocks

    def look(self, seconds: float) -> None:
        until = time.perf_counter() + seconds
        while not self.done and time.perf_counter() < until:
            for record in self._store.records(self._block)[:]:
                if record.lane is None or self._matters(record):
                    self._take(record.line())
            self._block += 1

    def _matters(self, record: Record) -> bool:
        known = self._lanes.get(id(record.lane))
        if known is None:
            prefixes = series_prefixes(record.line())
            known = self._lanes[id(record.lane)] = any(name.startswith(prefixes) for name in self._series)
        return known

    def _take(self, line: FrameLine) -> None:
        if self._low_ns <= line.t_ns <= self._high_ns:
            for name, value, _ in series_of(line):
                series = self._series.get(name)
                if series is not None:
                    series.add(line.t_ns, value)

    def points(self, name: str) -> list[Point]:
        series = self._series.get(name)
        return series.points(self._low_ns, self._high_ns) if series is not None else []


class Stopped(BaseException):
    """Reading was asked to stop while it waited. No error: what reads must not take it for one."""


class CaptureSource(ViewSource):
    """A capture that is open; a thread reads it to its end, or as long as it grows."""

    live = False

    def __init__(self, reading: OpenCapture) -> None:
        self._reading = reading
        follow = reading.source.follow
        self.growing = follow is not None
        if follow is not None:
            follow.wait = self._wait
        self.watch = Watch(reading.source.name)
        self.watch.log_bytes = reading.source.size or 0
        self.dialects = reading.possible
        self.times = reading.time_range.shown
        self.lines: FrameStore = FrameStore()
        self._keeper = _Keeper(self.lines)
        # The speed is known where it was given; a guess would make up a load, and so would made-up times.
        unit_ns = reading.options.byte_ns if reading.has_times else 0
        told = {bus: setup.byte_ns for bus, setup in reading.ports.items() if setup.byte_ns}
        self._feed = SnapshotSink(byte_ns={"": unit_ns, **told}, bit_ns={"": unit_ns and reading.options.synthetic_bit_ns})
        self._causes = Running()
        self.note = "" if reading.has_times else reading.time_source
        self._snapshots: deque[Snapshot] = deque(maxlen=4)
        self._stop = threading.Event()
        self._ended = threading.Event()
        self._due = 0.0
        self._taken = False
        self._listed = 0
        self._thread = threading.Thread(target=self._read, name="servotap-view-reader", daemon=True)
        self._thread.start()

    def _read(self) -> None:
        reading = self._reading
        pipeline = reading.pipeline((self._keeper, self._feed, self._causes))
        try:
            for item in reading:
                self._causes.take(item)
                pipeline.feed(item)
                now = time.perf_counter()
                if now >= self._due:
                    self._due = now + _PERIOD
                    self._publish()
                if self._stop.is_set():
                    return
            pipeline.close()
        except Stopped:
            return
        except (ServotapError, OSError) as error:
            self.broken = str(error) if isinstance(error, ServotapError) else f"reading broke off: {error.strerror or error}"
            pipeline.close()
        finally:
            self._publish(ended=True)
            self._ended.set()

    def _publish(self, *, ended: bool = False) -> None:
        now_ns = time.monotonic_ns()
        (self._causes.end if ended else self._causes.look)(now_ns, self._reading.dialects)
        self._feed.causes = self._causes.causes
        self._snapshots.append(self._feed.snapshot(self._keeper.last_ns, whole=True, ended=ended))

    def _wait(self, seconds: float) -> None:
        """Wait for more of a log that grows; raise Stopped when the view ends."""
        self._publish()
        if self._stop.wait(seconds):
            raise Stopped

    @property
    def state(self) -> str:
        if self.broken:
            return "BROKEN OFF"
        if self.done:
            return "FILE"
        if self.growing:
            return "FOLLOWING"
        size = self._reading.source.size
        if not size:
            return "READING"
        return f"READING {min(99, 100 * self._reading.source.position() // size)} %"

    @property
    def done(self) -> bool:
        return self._taken

    def take(self) -> bool:
        if self._taken:
            return False
        ended = self._ended.is_set()
        while self._snapshots:
            snapshot = self._snapshots.popleft()
            snapshot.findings = []
            self.watch.take(snapshot)
        self.watch.missed = 0
        self.watch.log_bytes = self._reading.source.size or 0
        for found in self._keeper.findings[self._listed :]:
            self.watch.findings.append(found)
            self._listed += 1
        self._taken = ended
        return True

    def wanted(self, condition: Condition) -> Wanted:
        return WantedNumbers(self.lines, condition)

    def hop(self, number: int, step: int) -> int:
        return self.lines.hop(number, step)

    def series(self) -> dict[str, str]:
        return self._keeper.series.copy()

    def span(self) -> tuple[int, int]:
        return self._keeper.first_ns or 0, self._keeper.last_ns

    def plot(self, names: Sequence[str], low_ns: int, high_ns: int) -> CapturePlot:
        return CapturePlot(self.lines, names, low_ns, high_ns)

    def mark(self, text: str) -> str:
        raise UsageError("a file is read-only; marks need a recording (servotap record --view)")

    def close(self) -> None:
        self._stop.set()
        self._thread.join(2.0)
        self.lines.close()
