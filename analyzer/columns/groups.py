"""Which rows have the same value."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analyzer.columns.codec import Bytes, Integers

#: Values below this are counted in a table; greater ones are sorted.
_DENSE = 1 << 20
#: Numbers of 16 bits are sorted by digits, in a time that grows with their count alone.
_SHORT = 1 << 16


def ranks(values: NDArray[Any]) -> tuple[Integers, NDArray[Any]]:
    """Return the values that occur, rising, and for each entry its place among them. No value is negative."""
    if int(values.max(initial=0)) >= _DENSE:
        known, places = np.unique(values, return_inverse=True)
        return known, places
    known = np.flatnonzero(np.bincount(values) > 0)
    table = np.empty(int(known[-1]) + 1 if len(known) else 0, dtype=np.uint16 if len(known) <= _SHORT else np.int64)
    table[known] = np.arange(len(known))
    return known, table.take(values)


def groups(values: NDArray[Any]) -> Iterator[tuple[int, Integers]]:
    """Yield each value above 0 that occurs, rising, with the rows that have it. No value is negative."""
    known, places = ranks(values)
    order, start = np.argsort(places, kind="stable"), 0
    for value, count in zip(known.tolist(), np.bincount(places).tolist(), strict=True):
        if value:
            yield value, order[start : start + count]
        start += count


def taken(rows: Bytes, places: NDArray[np.integer[Any]]) -> Bytes:
    """Return the rows of bytes at some places. `rows`: one behind the other."""
    size = rows.shape[1]
    # Items of a type as wide as a row are taken at once.
    result: Bytes = rows.view(f"V{size}")[:, 0].take(places).view(np.uint8).reshape(len(places), size)
    return result


def words(data: Bytes) -> NDArray[np.uint64]:
    """Return rows of bytes, whose number is a multiple of eight, as words."""
    result: NDArray[np.uint64] = np.ascontiguousarray(data).view(np.uint64)
    return result


def numbered(data: Bytes, numbers: Integers | None = None) -> Integers:
    """Return numbers that are the same where rows of bytes are, and given numbers are, too."""
    if numbers is None:
        numbers = np.zeros(len(data), dtype=np.int64)
    for place in range(data.shape[1]):
        if int(numbers.max(initial=0)) >= _DENSE >> 8:
            # Ranks keep them small.
            numbers = ranks(numbers)[1].astype(np.int64)
        numbers = numbers << 8 | data[:, place]
    return numbers
