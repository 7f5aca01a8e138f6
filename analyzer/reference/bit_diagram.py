"""Bit diagrams: a layout drawn as rows of bytes with a box for each field, as in the RFCs.

          0               1               2
          7 6 5 4 3 2 1 0 7 6 5 4 3 2 1 0 7 6 5 4 3 2 1 0
         +-+-----+-----------------------+---------------+
       0 |1| rsv |         speed         | acceleration  |
         +-+-----+-----------------------+---------------+

Bytes stand in wire order, four in a row; the number of the row's first byte stands at the left. A box that is too narrow
for its name holds the field's number in the table below. The table says which numbers are little-endian; the diagram
shows only the places of their bytes.
"""

from __future__ import annotations

from typing import NamedTuple

from analyzer.layout import FieldKind, Layout

BYTES_A_ROW = 4
_KEYS = "123456789abcdefghijklmnopqrstuvwxyz"
_MARGIN = 5


class _Box(NamedTuple):
    """A part of a field within one row: first and last bit of the row (the last excluded), and its labels, best first."""

    start: int
    stop: int
    labels: tuple[str, ...]


def key(index: int) -> str:
    """Return the one letter that stands for the field of a number, counted from 0 without reserved bits."""
    return _KEYS[index] if index < len(_KEYS) else "*"


def bit_diagram(layout: Layout) -> list[str]:
    """Return the diagram of a layout as lines of at most 80 columns; none for a layout without fields."""
    rows = _rows(layout)
    if not rows:
        return []
    size = min(layout.byte_length, BYTES_A_ROW) or BYTES_A_ROW
    lead = " " * _MARGIN
    lines = [lead + "".join(f" {n:<15}" for n in range(size)).rstrip(), lead + " 7 6 5 4 3 2 1 0" * size]
    above: list[_Box] = []
    for number, boxes in enumerate(rows):
        lines.append(lead + _border(above, boxes))
        cells = "|".join(_label(box).center(2 * (box.stop - box.start) - 1) for box in boxes)
        lines.append(f"{number * BYTES_A_ROW:>{_MARGIN - 1}} |{cells}|")
        above = boxes
    lines.append(lead + _border(above, []))
    return [line.rstrip() for line in lines]


def _rows(layout: Layout) -> list[list[_Box]]:
    width = BYTES_A_ROW * 8
    rows: list[list[_Box]] = []
    number = 0
    for offset, field in layout:
        labels: tuple[str, ...]
        if field.kind is FieldKind.RESERVED:
            labels = ("reserved", "rsv", "-")
        else:
            labels = (field.name, key(number))
            number += 1
        if field.bit_width == 0:
            rows.append([_Box(0, width, (f"{field.name}, to the end",))])
            continue
        start, stop = offset, offset + field.bit_width
        while start < stop:
            row, at = divmod(start, width)
            end = min(stop - row * width, width)
            while len(rows) <= row:
                rows.append([])
            rows[row].append(_Box(at, end, labels))
            start = row * width + end
    return rows


def _label(box: _Box) -> str:
    room = 2 * (box.stop - box.start) - 1
    return next((label for label in box.labels if len(label) <= room), "")


def _border(above: list[_Box], below: list[_Box]) -> str:
    width = max(above[-1].stop if above else 0, below[-1].stop if below else 0)
    corners = {0} | {box.stop for box in (*above, *below)}
    return "".join("+" if at % 2 == 0 and at // 2 in corners else "-" for at in range(2 * width + 1))
