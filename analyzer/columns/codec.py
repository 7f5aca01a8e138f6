"""The fields of a layout as columns: the same declaration that `analyzer.codec` reads one frame by."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from analyzer.codec import EXACT
from analyzer.layout import Field, FieldKind, Layout, Order

Bytes = NDArray[np.uint8]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]

#: Widest field of any kind. Of whole words the values up to `EXACT` are read: beyond it an integer is not exact as a JSON
#: number, and the slow way writes a text twin.
_WIDEST, _WORD = 53, 64
#: Greatest divisor of a word's unit whose fractions are written without an exponent.
_FINEST = 10_000


class ColumnCodec:
    """Reads the data of many frames of one layout. `data` is always of shape (frames, bytes of the layout)."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.items = [(o, f) for o, f in layout if f.kind is not FieldKind.RESERVED]

    @staticmethod
    def fits(layout: Layout) -> bool:
        """Say whether a layout can be read by columns: all fields have a fixed width and are exact as JSON numbers."""
        return all(0 < field.bit_width <= _WIDEST or _is_word(offset, field) for offset, field in layout)

    def wire(self, data: Bytes) -> dict[str, Integers]:
        """Return the integers as sent, by field name."""
        return {field.name: column(data, offset, field) for offset, field in self.items}

    def valid(self, data: Bytes) -> Flags:
        """Say of each frame whether all values are as the manual lists them."""
        good = np.ones(len(data), dtype=np.bool_)
        for offset, field in self.layout:
            if field.fixed is not None:
                continue
            lowest, highest, allowed = limits(field)
            if field.bit_width > _WIDEST:
                most = EXACT // field.scale.numerator
                lowest, highest = max(lowest, -most), min(highest, most)
            if allowed is None and lowest <= field.wire_minimum and highest >= field.wire_maximum:
                continue
            value = column(data, offset, field)
            good &= (lowest <= value) & (value <= highest)
            if allowed is not None:
                good &= np.isin(value, allowed)
        return good

    def matches(self, data: Bytes) -> Flags:
        """Say of each frame whether every fixed field has its value; the length fits already."""
        good = np.ones(len(data), dtype=np.bool_)
        for offset, field in self.layout:
            if field.fixed is not None:
                good &= column(data, offset, field) == field.fixed
        return good


def _is_word(offset: int, field: Field) -> bool:
    plain = field.kind is FieldKind.INT and field.choices is None and field.values is None and field.fixed is None
    return field.bit_width == _WORD and offset % 8 == 0 and plain and field.scale.denominator <= _FINEST


def limits(field: Field) -> tuple[int, int, list[int] | None]:
    """Return the least and the greatest allowed integer, and the allowed ones where there are gaps."""
    if field.kind is FieldKind.RESERVED:
        return 0, 0, None
    if field.choices is None and field.values is None:
        return field.low, field.high, None
    allowed = sorted(v for v in (field.values or field.choice_names) if field.allows(v))
    return field.wire_minimum, field.wire_maximum, allowed


def column(data: Bytes, offset: int, field: Field) -> Integers:
    """Return a field of every frame as integers as sent; `offset` in bits."""
    first, last = offset // 8, (offset + field.bit_width - 1) // 8 + 1
    places = range(first, last) if field.order is Order.BIG else range(last - 1, first - 1, -1)
    value: Any = np.zeros(len(data), dtype=np.int64)
    for place in places:
        value = value << 8 | data[:, place]
    if field.bit_width == _WORD:
        # All bits of the number are its own, the sign too.
        word: Integers = value
        return word
    value = value >> (last * 8 - offset - field.bit_width) & ((1 << field.bit_width) - 1)
    if field.kind is FieldKind.INT:
        half = 1 << (field.bit_width - 1)
        value = (value ^ half) - half
    result: Integers = value
    return result
