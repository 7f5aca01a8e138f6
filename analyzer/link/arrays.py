"""Bytes as arrays: what links need to find many frames at once. Imported only where a capture is long."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Found(NamedTuple):
    """Where frames begin, in ascending order, and how long they are. `looks`: how many bytes had to be looked at to tell."""

    starts: Integers
    sizes: Integers
    looks: Integers


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


class Crc16:
    """The CRC of Modbus over many stretches of one length.

    A CRC is linear: that of a stretch is what each byte alone would give at its place, all of it added without carry.
    """

    _POLYNOMIAL, _START = 0xA001, 0xFFFF

    def __init__(self) -> None:
        shares = np.arange(256, dtype=np.uint16)
        for _ in range(8):
            shares = (shares >> 1) ^ (shares & 1) * np.uint16(self._POLYNOMIAL)
        #: Shares of a byte by how many others follow it, and what the start value gives by how many bytes there are.
        self._shares, self._starts = [shares], [self._START]

    def fit(self, codes: Bytes, starts: Integers, size: int) -> Flags:
        """Say which stretches end with their own CRC, low byte first."""
        while len(self._shares) < size:
            last = self._shares[-1]
            self._shares.append((last >> 8) ^ self._shares[0][last & 0xFF])
        while len(self._starts) <= size:
            value = self._starts[-1]
            self._starts.append(value >> 8 ^ int(self._shares[0][value & 0xFF]))
        total = np.full(len(starts), self._starts[size], dtype=np.uint16)
        for place in range(size):
            total ^= self._shares[size - 1 - place][codes[starts + place]]
        return total == 0


def places_of(codes: Bytes, values: bytes, room: int) -> Integers:
    """Return where one of some bytes stands, with room for so many bytes."""
    looked_at = codes[: max(0, len(codes) - room + 1)]
    there = looked_at == values[0]
    for value in values[1:]:
        there |= looked_at == value
    return np.flatnonzero(there)
