"""Bytes as arrays: what links need to find many frames at once. Imported only where a capture is long."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Found(NamedTuple):
    """Where frames begin, in ascending order, and how long they are."""

    starts: Integers
    sizes: Integers


class Sums:
    """Sums of 8 bits over any stretches of some bytes."""

    def __init__(self, codes: Bytes) -> None:
        self.codes = codes
        self._before = np.zeros(len(codes) + 1, dtype=np.uint8)
        np.cumsum(codes, dtype=np.uint8, out=self._before[1:])

    def fit(self, starts: Integers, stops: Integers) -> Flags:
        """Say of stretches whether the byte behind each is the sum of it."""
        result: Flags = self._before[stops] - self._before[starts] == self.codes[stops]
        return result


def places_of(codes: Bytes, values: bytes, room: int) -> Integers:
    """Return where one of some bytes stands, with room for so many bytes."""
    looked_at = codes[: max(0, len(codes) - room + 1)]
    there = looked_at == values[0]
    for value in values[1:]:
        there |= looked_at == value
    return np.flatnonzero(there)
