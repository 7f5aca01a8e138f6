"""A live recording in the view: the snapshots of its supervisor become counts, lines and series, in bounded memory.

A full bus has more frames than a person can read. A snapshot holds some of them, the newest are kept, and the view counts
the frames not shown. During a pause the lines stay, and the newest of the further lines wait.
"""

from __future__ import annotations

import queue
from collections import deque
from collections.abc import Callable, Sequence

import msgspec

from analyzer import dialects as registry
from analyzer.live.snapshot import FrameLine, Snapshot
from analyzer.sources.times import ShownTime
from analyzer.view.condition import Condition
from analyzer.view.kept import KeptLines, Wanted, WantedKept
from analyzer.view.series import Plotted, Point
from analyzer.view.source import ViewSource
from analyzer.view.watch import Watch

#: Lines that are kept, of all and of those that a filter lets through.
LINES = 20_000
#: Snapshots that wait for the view: those of about two seconds.
WAITING = 20


class SnapshotQueue:
    """Snapshots on their way from the thread of a recording to its view.

    One that finds no room is dropped, and the view sees that its number is missing: it cannot slow a recording. `ended`: it
    was closed, and nothing waits any more.
    """

    def __init__(self) -> None:
        self._waiting: queue.Queue[Snapshot] = queue.Queue(WAITING)
        self._closed = False

    @property
    def ended(self) -> bool:
        # In this order: what comes before it is closed waits by then.
        return self._closed and self._waiting.empty()

    def offer(self, snapshot: Snapshot) -> bool:
        try:
            self._waiting.put_nowait(snapshot)
        except queue.Full:
            return False
        return True

    def take(self) -> list[Snapshot]:
        return [self._waiting.get_nowait() for _ in range(self._waiting.qsize())]

    def close(self) -> None:
        self._closed = True


class LivePlot:
    """Points of what was shown so far."""

    def __init__(self, plotted: Plotted, span: tuple[int, int]) -> None:
        self._plotted = plotted
        self._span = span

    done = True

    def look(self, seconds: float) -> None:
        """Do nothing: they are all here."""

    def points(self, name: str) -> list[Point]:
        series = self._plotted.series.get(name)
        return series.points(*self._span) if series is not None else []


class LiveSource(ViewSource):
    """Snapshots of a recording. `mark`: see `run_live`."""

    live = growing = True

    def __init__(self, snapshots: SnapshotQueue, *, mark: Callable[[str], str], log: str = "", model: str = "") -> None:
        self._snapshots = snapshots
        self._mark = mark
        self.watch = Watch(log)
        self.lines: KeptLines = KeptLines(LINES)
        self.times = ShownTime()
        self.dialects = tuple(registry.for_model(registry.every(), model or None))
        self._plotted = Plotted()
        self._paused = False
        self._waiting: deque[FrameLine] = deque(maxlen=LINES)
        self._waited = 0
        self._received = 0

    @property
    def state(self) -> str:
        if self.done:
            return "ENDED"
        behind = self.watch.behind_ns
        return f"LIVE, decoding {behind / 1e9:.1f} s behind" if behind > 500_000_000 else "LIVE"

    @property
    def not_shown(self) -> int:
        return max(0, self.watch.things - self._received)

    @property
    def done(self) -> bool:
        return self._snapshots.ended or self.watch.ended

    def take(self) -> bool:
        was_done = self.done
        snapshots = self._snapshots.take()
        for snapshot in snapshots:
            self._snapshot(snapshot)
        return bool(snapshots) or self.done != was_done

    def _snapshot(self, snapshot: Snapshot) -> None:
        self.watch.take(snapshot)
        for line in snapshot.frames:
            self._received += line.sequence != 0
            self._plotted.add(line)
            if self._paused:
                self._waited += 1
                self._waiting.append(line)
            else:
                self.lines.append(line)
        for found in snapshot.findings:
            number = self.lines.number_of(found.sequence) if found.sequence else None
            if number is not None and found.rule not in self.lines.line(number).rules:
                line = self.lines.line(number)
                changed = msgspec.structs.replace(
                    line, rules=(*line.rules, found.rule), severity=line.severity or found.severity
                )
                self.lines.put(number, changed)

    def pause(self, paused: bool) -> int:
        if not paused:
            for line in self._waiting:
                self.lines.append(line)
            self._waiting.clear()
            self._waited = 0
        self._paused = paused
        return self._waited

    def wanted(self, condition: Condition) -> Wanted:
        return WantedKept(self.lines, condition, LINES)

    def series(self) -> dict[str, str]:
        return {name: series.unit for name, series in self._plotted.series.items()}

    def span(self) -> tuple[int, int]:
        return self._plotted.first_ns, max(self._plotted.last_ns, self.watch.t_ns)

    def plot(self, names: Sequence[str], low_ns: int, high_ns: int) -> LivePlot:
        return LivePlot(self._plotted, (low_ns, high_ns))

    def mark(self, text: str) -> str:
        return self._mark(text)
