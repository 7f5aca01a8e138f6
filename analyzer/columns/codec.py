"""The fields of a layout as columns: the same declaration that `analyzer.codec` reads one frame by."""

from __future__ import annotations

from functools import lru_cache

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
#: The most values for which a table of allowed ones is made.
_DENSE = 1 << 16
#: What determines the text of data -> the number of that.
_READINGS: dict[object, int] = {}
#: Greatest divisor of a word's unit whose fractions are written without an exponent.
_FINEST = 10_000


class ColumnCodec:
    """Reads the data of many frames of one layout. `start`: bytes of a frame before the layout.

    `data` is always of shape (frames, bytes of a frame, in whole words).
    """

    def __init__(self, layout: Layout, start: int = 0) -> None:
        self.layout = layout
        self._every = [(offset + 8 * start, field) for offset, field in layout]
        self._limits = [(offset, f, *limits) for offset, f in self._every if (limits := _limits(f)) is not None]
        #: The same number where data have the same fields at the same places, and so the same text.
        self.reading = _READINGS.setdefault((start, tuple(map(_reading, layout.fields))), len(_READINGS))

    @property
    def takes_all(self) -> bool:
        """Whether any data at all match and are valid."""
        return not self._limits and all(field.fixed is None for _, field in self._every)

    @staticmethod
    def fits(layout: Layout) -> bool:
        """Say whether a layout can be read by columns: all fields have a fixed width and are exact as JSON numbers."""
        return all(0 < field.bit_width <= _WIDEST or _is_word(offset, field) for offset, field in layout)

    def wire(self, data: Bytes) -> dict[str, Integers]:
        """Return the integers as sent, by field name."""
        return {f.name: column(data, offset, f) for offset, f in self._every if f.kind is not FieldKind.RESERVED}

    def valid(self, data: Bytes) -> Flags:
        """Say of each frame whether all values are as the manual lists them."""
        good = np.ones(len(data), dtype=np.bool_)
        for offset, field, lowest, highest, allowed in self._limits:
            value = column(data, offset, field)
            if allowed is None:
                good &= (lowest <= value) & (value <= highest)
            elif highest - lowest < _DENSE:
                good &= _among(allowed, lowest, highest).take(value - lowest)
            else:
                good &= np.isin(value, allowed)
        return good

    def matches(self, data: Bytes) -> Flags:
        """Say of each frame whether every fixed field has its value; the length fits already."""
        good = np.ones(len(data), dtype=np.bool_)
        for offset, field in self._every:
            if field.fixed is not None:
                good &= column(data, offset, field) == field.fixed
        return good


def _reading(field: Field) -> object:
    """Return what determines how a field reads: not what is allowed in it."""
    choices = None if field.choices is None else tuple(field.choice_names.items())
    state = None if field.state is None else (field.state.quantity, field.state.factor)
    return field.kind, field.name, field.bit_width, field.order, field.scale, choices, state


def _is_word(offset: int, field: Field) -> bool:
    plain = field.kind is FieldKind.INT and field.choices is None and field.values is None and field.fixed is None
    return field.bit_width == _WORD and offset % 8 == 0 and plain and field.scale.denominator <= _FINEST


def _limits(field: Field) -> tuple[int, int, tuple[int, ...] | None] | None:
    """Return the least and the greatest integer, and the allowed ones where there are gaps; None where all are allowed."""
    if field.fixed is not None:
        return None
    if field.kind is FieldKind.RESERVED:
        return 0, 0, None
    if field.choices is not None or field.values is not None:
        lowest, highest = field.wire_minimum, field.wire_maximum
        allowed = (v for v in (field.values or field.choice_names) if field.allows(v) and lowest <= v <= highest)
        return lowest, highest, tuple(allowed)
    lowest, highest = field.low, field.high
    if field.bit_width > _WIDEST:
        most = EXACT // field.scale.numerator
        lowest, highest = max(lowest, -most), min(highest, most)
    return None if lowest <= field.wire_minimum and highest >= field.wire_maximum else (lowest, highest, None)


@lru_cache(maxsize=1 << 10)
def _among(allowed: tuple[int, ...], lowest: int, highest: int) -> Flags:
    """Return a table that says of each integer whether it is allowed."""
    table: Flags = np.zeros(highest - lowest + 1, dtype=np.bool_)
    table[np.array(allowed, dtype=np.int64) - lowest] = True
    return table


def column_codec(layout: Layout, start: int) -> ColumnCodec:
    """Return the codec of a layout behind so many bytes; made once, and kept with it."""
    kept: dict[int, ColumnCodec] = layout.__dict__.setdefault("_column_codecs", {})
    if start not in kept:
        kept[start] = ColumnCodec(layout, start)
    return kept[start]


def column(data: Bytes, offset: int, field: Field) -> Integers:
    """Return a field of every frame as integers as sent; `offset` in bits from the beginning of the frame.

    A word that holds the whole field is moved to the left until the field's first bit is its highest, then to the right.
    """
    count, width = data.shape
    bits, stop = field.bit_width, (offset + field.bit_width - 1) // 8 + 1
    begin = min(offset // 8, width - 8)
    order, first = (">", offset - 8 * begin)
    if field.order is Order.LITTLE:
        # Its first byte is the lowest, and its bits are counted from the end of its last byte.
        order, first = "<", _WORD - (8 * (offset // 8 - begin) + 8 * stop - offset - bits) - bits
    words = np.ndarray(count, dtype=f"{order}u8", buffer=data, offset=begin, strides=(width,)).astype(np.uint64)
    words <<= np.uint64(first)
    value: Integers = words.view(np.int64)
    if field.kind is FieldKind.INT:
        # A signed number moves its sign along.
        value >>= np.int64(_WORD - bits)
    else:
        words >>= np.uint64(_WORD - bits)
    return value
