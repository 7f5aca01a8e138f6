"""A chart of braille dots: eight dots a character, two across and four down.

U+2800 + bits:   1  8      0x01 0x08
                 2 10      0x02 0x10
                 4 20      0x04 0x20
                40 80      0x40 0x80
"""

from __future__ import annotations

from collections.abc import Sequence

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
        """Set a dot; one outside is left out."""
        if 0 <= x < self.across and 0 <= y < self.up:
            row = self.up - 1 - y
            self._cells[row // 4][x // 2] |= _DOTS[row % 4][x % 2]

    def column(self, x: int, low: int, high: int) -> None:
        """Set the dots of a column from `low` to `high`."""
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
