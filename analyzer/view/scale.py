"""Charts of eight dots a character (Braille patterns), with scales: round ticks of values to the left, of times below."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, floor, log10

from analyzer.sources.times import ShownTime
from analyzer.values import SECOND_NS

#: Columns of the scale to the left, without its line.
SCALE_WIDTH = 8
#: Columns that a time takes on the axis, with the room beside it.
_TIME_ROOM = 9
#: Steps of a time axis: decimal ones below ten seconds, those of a clock from there on.
_STEPS_NS = (
    *(factor * 10**power for power in range(3, 10) for factor in (1, 2, 5)),
    *(n * SECOND_NS for n in (10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 21600, 43200, 86400)),
)
#: Bits of a Braille pattern, above U+2800, by row and column: two dots across and four down.
_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
_EMPTY = 0x2800


class Canvas:
    """Dots on `width` by `height` characters; the origin is at the lower left."""

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = max(1, width), max(1, height)
        self._cells = [[0] * self.width for _ in range(self.height)]

    @property
    def across(self) -> int:
        """Dots from left to right."""
        return 2 * self.width

    @property
    def up(self) -> int:
        """Dots from bottom to top."""
        return 4 * self.height

    def dot(self, x: int, y: int) -> None:
        if 0 <= x < self.across and 0 <= y < self.up:
            row = self.up - 1 - y
            self._cells[row // 4][x // 2] |= _DOTS[row % 4][x % 2]

    def column(self, x: int, low: int, high: int) -> None:
        for y in range(max(0, low), min(self.up - 1, high) + 1):
            self.dot(x, y)

    def rows(self) -> list[str]:
        """Return the characters, the top row first; an empty cell is a blank."""
        return ["".join(chr(_EMPTY + cell) if cell else " " for cell in row) for row in self._cells]


def chart(
    points: Sequence[tuple[int, float]], span: tuple[int, int], limits: tuple[float, float], size: tuple[int, int]
) -> list[str]:
    """Return points (time, value) as rows of characters: `span` of time across, `limits` of values up.

    Neighbours are joined by a line; of many points in one column the least and the greatest are joined.
    """
    canvas = Canvas(*size)
    (start, stop), (least, greatest) = span, limits
    width = max(1, stop - start)
    height = greatest - least
    lows: dict[int, int] = {}
    highs: dict[int, int] = {}
    previous: tuple[int, int] | None = None
    for t, value in points:
        x = min(canvas.across - 1, max(0, (t - start) * canvas.across // width))
        share = (value - least) / height if height > 0 else 0.5
        y = min(canvas.up - 1, max(0, round(share * (canvas.up - 1))))
        if previous is not None and x > previous[0] + 1:
            _line(canvas, previous, (x, y))
        elif previous is not None and x == previous[0] + 1:
            # Start next to the previous dot, so that an edge has no hole and a line is thin.
            near = previous[1] + (y > previous[1]) - (y < previous[1])
            lows[x] = min(lows.get(x, y), near, y)
            highs[x] = max(highs.get(x, y), near, y)
        lows[x] = min(lows.get(x, y), y)
        highs[x] = max(highs.get(x, y), y)
        previous = (x, y)
    # A point alone would be a speck.
    lone = 1 if len(lows) == 1 else 0
    for x, low in lows.items():
        for near in range(x - lone, x + lone + 1):
            canvas.column(near, low - lone, highs[x] + lone)
    return canvas.rows()


def _line(canvas: Canvas, start: tuple[int, int], stop: tuple[int, int]) -> None:
    """Join two points that are more than a column apart."""
    (x0, y0), (x1, y1) = start, stop
    last = y0
    for x in range(x0 + 1, x1 + 1):
        y = y0 + round((y1 - y0) * (x - x0) / (x1 - x0))
        # Two dots side by side are drawn only where the line is level: a thin line is easier to follow.
        near = last + (y > last) - (y < last)
        canvas.column(x, min(near, y), max(near, y))
        last = y


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
