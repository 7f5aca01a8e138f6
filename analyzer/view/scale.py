"""Charts with scales: round ticks of values to the left, of times below."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, floor, log10

from analyzer.sources.times import ShownTime
from analyzer.values import SECOND_NS
from analyzer.view.braille import chart

#: Columns of the scale to the left, without its line.
SCALE_WIDTH = 8
#: Columns that a time takes on the axis, with the room beside it.
_TIME_ROOM = 9
#: Steps of a time axis: decimal ones below ten seconds, those of a clock from there on.
_STEPS_NS = (
    *(factor * 10**power for power in range(3, 10) for factor in (1, 2, 5)),
    *(n * SECOND_NS for n in (10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 21600, 43200, 86400)),
)


def round_ticks(least: float, greatest: float, most: int) -> list[float]:
    """Return at most `most` round numbers, at equal steps, between which all values lie; at least two."""
    if greatest <= least:
        room = abs(least) * 0.1 or 1.0
        least, greatest = least - room, greatest + room
    parts = max(1, most - 1)
    rough = greatest / parts - least / parts
    power = 10.0 ** floor(log10(rough)) if rough else 0.0
    if not power:
        return [least, greatest]
    for step in (power * factor for factor in (1, 2, 2.5, 5, 10, 20, 50)):
        first, last = floor(least / step), ceil(greatest / step)
        if last - first + 1 <= max(2, most):
            # Whole steps, counted: sums of floats would drift.
            return [n * step for n in range(first, last + 1)]
    return [least, greatest]


def time_ticks(first_ns: int, last_ns: int, times: ShownTime, most: int) -> list[tuple[int, str]]:
    """Return about `most` round times of a stretch, as they are shown: with as many digits as their step needs."""
    span = max(1, last_ns - first_ns)
    step = next((s for s in _STEPS_NS if span // s <= most), _STEPS_NS[-1] * ceil(span / most / _STEPS_NS[-1]))
    digits = next(n for n in range(7) if step % 10 ** (9 - n) == 0) if step < SECOND_NS else 0
    zone_ns = times.zone_ns(first_ns)
    start = -(-(first_ns + zone_ns) // step) * step - zone_ns
    ticks = range(start, last_ns + 1, step)
    return [(t, _cut(times.text(t), digits)) for t in ticks]


def _cut(text: str, digits: int) -> str:
    """Return a time with fewer digits behind the point; it is printed with six."""
    return (text[: len(text) - 6 + digits] if digits else text[:-7]).strip()


def scaled(points: Sequence[tuple[int, float]], span: tuple[int, int], width: int, height: int) -> list[tuple[str, str]]:
    """Return points (time, value) as rows of a chart, each behind its part of the scale: `width` and `height` of the chart."""
    values = [value for _, value in points]
    ticks = round_ticks(min(values), max(values), max(2, (height + 1) // 2))
    drawn = chart(points, span, (ticks[0], ticks[-1]), (width, height))
    labels = {round((height - 1) * (ticks[-1] - t) / (ticks[-1] - ticks[0])): number_text(t) for t in ticks}
    return [(f"{labels.get(at, ''):>{SCALE_WIDTH}}{'┤' if at in labels else '│'}", row) for at, row in enumerate(drawn)]


def time_axis(span: tuple[int, int], width: int, times: ShownTime, left: str, length: str) -> str:
    """Return the two rows below a chart of `width`: round times; to the left how long it is, and a word."""
    line, labels = list("─" * width), " " * width
    for t_ns, label in time_ticks(*span, times, max(2, width // _TIME_ROOM)):
        at = min(width - 1, (t_ns - span[0]) * width // max(1, span[1] - span[0]))
        line[at] = "┬"
        place = max(0, min(at - len(label) // 2, width - len(label)))
        if not labels[max(0, place - 1) : place + len(label) + 1].strip():
            labels = labels[:place] + label + labels[place + len(label) :]
    return f"{length[:SCALE_WIDTH]:>{SCALE_WIDTH}}└{''.join(line)}\n{left:>{SCALE_WIDTH}} {labels}"


def number_text(value: float) -> str:
    """Return a number in at most eight characters."""
    return next(text for digits in (6, 4, 3, 2, 1) if len(text := f"{value:.{digits}g}") <= SCALE_WIDTH or digits == 1)
