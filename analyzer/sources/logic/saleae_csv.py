"""Levels as Saleae's programs export them in CSV: a row a change, a column a channel.

    Time [s],Channel 0,Channel 1          Logic 2; Logic 1 writes Time[s], and may use tabs
    -0.000012500,1,0
    2024-03-05T12:00:00.120000000Z,1,0    with times of day
    Sample,Channel 0                      Logic 1 with sample numbers; a line on the sample rate may stand before it

Rules: a row has the levels from its time on. `X`, for a channel that was off, leaves it as it was. Times before the trigger
are all moved to begin at zero. Sample numbers become times by a line on the sample rate, or by the line speed (`--baud`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from analyzer.errors import UnreadableError
from analyzer.records import CanFrame, Chunk, Event
from analyzer.sources.lines import Lines, head_lines
from analyzer.sources.logic.heads import LEVELS, Heading, heading_of
from analyzer.sources.logic.traffic import records
from analyzer.sources.logic.waveform import CHANNEL_LIMIT, Stretch, Waveform
from analyzer.sources.saleae import time_of
from analyzer.sources.source import Source, quote
from analyzer.values import SECOND_NS

#: Rows of one stretch.
_TOGETHER = 1 << 16


def read(source: Source) -> Iterator[Chunk | CanFrame | Event]:
    """Read the traffic. Raises UnreadableError for a text without such a heading."""
    heading = heading_of(head_lines(source.head))
    if heading is None:
        raise UnreadableError(f"{source.name}: expected a heading as in Time [s],Channel 0,Channel 1")
    if len(heading.names) > CHANNEL_LIMIT:
        raise UnreadableError(f"{source.name}: expected at most {CHANNEL_LIMIT} channels, got {len(heading.names)}")
    rated = not heading.numbered or bool(heading.rate)
    if rated:
        source.time_source = "capture: times of changes as a logic analyzer measured them"
    step_ns = SECOND_NS / heading.rate if heading.rate else float(heading.numbered)
    wave = Waveform(heading.names, iter(()), step_ns, rated)
    wave.stretches = _stretches(source, wave, heading)
    return records(source, wave)


def _stretches(source: Source, wave: Waveform, heading: Heading) -> Iterator[Stretch]:
    lines = Lines(source)
    rows = iter(lines)
    for _ in range(heading.line + 1):
        next(rows)
    levels = [-1] * len(heading.names)
    first = list(levels)
    edges: list[list[int]] = [[] for _ in levels]
    t_ns = -1
    shift_ns: int | None = None
    before: list[str] | None = None
    for line in rows:
        if not line.strip():
            continue
        time, *cells = line.split(heading.delimiter)
        try:
            now = _time(time.strip(), heading)
            if shift_ns is None:
                shift_ns = max(0, -now)
                if shift_ns:
                    source.note(f"times before the trigger: all are moved by {shift_ns / SECOND_NS:g} s")
            if now + shift_ns < t_ns:
                raise ValueError("a time before the last")
            found = _levels(cells, levels) if cells != before else []
        except ValueError as error:
            if not lines.ended:
                source.problem("the last row breaks off", line=lines.number)
                break
            raise UnreadableError(f"{source.name}: line {lines.number}: {error} in {quote(line.strip())!r}") from None
        t_ns, before = now + shift_ns, cells
        for channel, level in found:
            if levels[channel] < 0:
                first[channel] = level
            else:
                edges[channel].append(t_ns)
            levels[channel] = level
        if lines.number % _TOGETHER == 0:
            yield _taken(wave, first, edges, t_ns)
    yield _taken(wave, first, edges, max(t_ns, 0))


def _taken(wave: Waveform, first: list[int], edges: list[list[int]], end_ns: int) -> Stretch:
    wave.first[:] = [max(level, 0) for level in first]
    stretch = Stretch([np.array(found, dtype=np.int64) for found in edges], end_ns)
    for found in edges:
        found.clear()
    return stretch


def _time(text: str, heading: Heading) -> int:
    """Return the time of a row. Raises ValueError for a text that is none."""
    if not heading.numbered:
        return time_of(text)
    if not text.isdecimal() or len(text) > 15:
        raise ValueError(f"expected a sample number, got {quote(text)}")
    return int(text) * SECOND_NS // heading.rate if heading.rate else int(text)


def _levels(cells: Sequence[str], before: Sequence[int]) -> list[tuple[int, int]]:
    """Return the channels that changed with their levels. Raises ValueError for cells that are none."""
    if len(cells) != len(before):
        raise ValueError(f"{len(cells)} levels, expected {len(before)}")
    changed = []
    for channel, cell in enumerate(cells):
        cell = cell.strip()
        if cell not in LEVELS:
            raise ValueError(f"a level that is not 0, 1 or X: {quote(cell)}")
        if cell in ("0", "1") and int(cell) != before[channel]:
            changed.append((channel, int(cell)))
    return changed
