"""Series for the plot: points of one field over time, in bounded memory.

If there are more points than fit, neighbours are reduced to their least and greatest, so a peak is never lost.
A series is named `bus/address/state.speed` or `bus/address/read_speed.reply.speed`.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Iterator

from analyzer.layout import STATE_UNITS
from analyzer.live.snapshot import FrameLine

#: Points of a series, two for each stretch once stretches were joined.
POINTS = 4000
#: Series of one view; further fields are not offered.
SERIES = 300
Point = tuple[int, float]


class Series:
    """Points of one field: all of them, joined where they are many, and the newest as they came."""

    def __init__(self, unit: str = "") -> None:
        self.unit = unit
        self._times, self._values = array("q"), array("d")
        self._newest_times, self._newest_values = array("q"), array("d")
        #: Points that come for one that is kept, and those of the stretch that is under way.
        self._stride = 1
        self._open: list[Point] = []
        self.count = 0
        self.last = 0.0

    def add(self, t_ns: int, value: float) -> None:
        """Add a point; times do not decrease."""
        if not math.isfinite(value):
            return
        self.count += 1
        self.last = value
        self._newest_times.append(t_ns)
        self._newest_values.append(value)
        if len(self._newest_times) > POINTS + POINTS // 4:
            del self._newest_times[: POINTS // 4]
            del self._newest_values[: POINTS // 4]
        self._open.append((t_ns, value))
        if len(self._open) < self._stride:
            return
        for t, v in _extremes(self._open):
            self._times.append(t)
            self._values.append(v)
        self._open = []
        if len(self._times) > 2 * POINTS:
            self._join()

    def _join(self) -> None:
        points = list(zip(self._times, self._values, strict=True))
        self._times, self._values = array("q"), array("d")
        for at in range(0, len(points), 4):
            for t, v in _extremes(points[at : at + 4]):
                self._times.append(t)
                self._values.append(v)
        self._stride *= 2

    def points(self, low_ns: int, high_ns: int) -> list[Point]:
        """Return the points of a time, the finest that are kept."""
        if self._newest_times and self._newest_times[0] <= low_ns:
            kept: Iterable[Point] = zip(self._newest_times, self._newest_values, strict=True)
        else:
            kept = [*zip(self._times, self._values, strict=True), *self._open]
        return [(t, v) for t, v in kept if low_ns <= t <= high_ns]


def _extremes(points: list[Point]) -> list[Point]:
    """Return the least and the greatest of some points, in their order; one where they are the same point."""
    low = min(points, key=lambda p: p[1])
    high = max(points, key=lambda p: p[1])
    return [low] if low is high else sorted((low, high))


def series_of(line: FrameLine) -> Iterator[tuple[str, float, str]]:
    """Yield the series that a frame has points of, the values, and their units."""
    if not line.checksum_ok or not line.dialect:
        return
    state, own = series_prefixes(line)
    for name, value in line.state.items():
        yield state + name, value, STATE_UNITS.get(name, "")
    if line.latency_ns is not None:
        yield own + "_latency", line.latency_ns / 1e6, "ms"
    for name, value in line.values.items():
        if isinstance(value, (int, float)):
            yield own + name, value, line.units.get(name, "")


def series_prefixes(line: FrameLine) -> tuple[str, str]:
    """Return how the names of series begin that frames like this one have points of: state, and the fields' own."""
    place = f"{line.bus}/{line.who}/"
    return f"{place}state.", f"{place}{line.command}.{line.role}."


class Plotted:
    """All series of what is watched, as frames are shown."""

    def __init__(self) -> None:
        self.series: dict[str, Series] = {}
        self.first_ns = 0
        self.last_ns = 0

    def add(self, line: FrameLine) -> None:
        for name, value, unit in series_of(line):
            series = self.series.get(name)
            if series is None:
                if len(self.series) >= SERIES:
                    continue
                series = self.series[name] = Series(unit)
            series.add(line.t_ns, value)
        if line.dialect:
            self.first_ns = self.first_ns or line.t_ns
            self.last_ns = max(self.last_ns, line.t_ns)
