"""Bytes as arrays: what links need to find many frames at once. Imported only where a capture is long."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar, NamedTuple

import numpy as np
from fastcrc import crc16
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
    """The CRC of Modbus over many stretches of some bytes.

    A CRC is linear: that of a stretch is what each byte alone would give at its place, all of it added without carry. Two bytes
    are looked up at once.
    """

    _POLYNOMIAL = 0xA001
    #: What two bytes give, by how many follow.
    _shares: ClassVar[dict[int, NDArray[np.uint16]]] = {}

    def __init__(self, codes: Bytes) -> None:
        self._pairs = codes.astype(np.uint16)
        self._pairs[:-1] |= codes[1:].astype(np.uint16) << 8

    def fit(self, starts: Integers, size: int) -> Flags:
        """Say which stretches of a length end with their own CRC, low byte first."""
        # Zeros show what the start value alone gives.
        total = np.full(len(starts), crc16.modbus(bytes(size)), dtype=np.uint16)
        for place in range(0, size - 1, 2):
            total ^= self._share(size - place - 2).take(self._pairs.take(starts + place))
        if size % 2:
            last = self._pairs.take(starts + size - 1) & np.uint16(0xFF)
            # A byte with a zero before it: with nothing behind, the zero gives nothing.
            total ^= self._share(0).take(last << 8)
        result: Flags = total == 0
        return result

    @classmethod
    def _share(cls, behind: int) -> NDArray[np.uint16]:
        known = cls._shares.get(behind)
        if known is None:
            pairs = np.arange(1 << 16, dtype=np.uint16)
            # A byte more behind is eight shifts more.
            known = cls._shares[behind] = cls._shifted(cls._share(behind - 1) if behind else cls._shifted(pairs))
        return known

    @classmethod
    def _shifted(cls, values: NDArray[np.uint16]) -> NDArray[np.uint16]:
        for _ in range(8):
            values = (values >> np.uint16(1)) ^ (values & np.uint16(1)) * np.uint16(cls._POLYNOMIAL)
        return values


def rows_of(values: Bytes) -> Iterator[tuple[int, Integers]]:
    """Yield each value but 0 that occurs, rising, with the rows that have it."""
    order, ends = np.argsort(values, kind="stable"), np.cumsum(np.bincount(values, minlength=1))
    for value in (np.flatnonzero(np.diff(ends)) + 1).tolist():
        yield value, order[ends[value - 1] : ends[value]]


def places_of(codes: Bytes, values: bytes, room: int) -> Integers:
    """Return where one of some bytes stands, with room for so many bytes."""
    looked_at = codes[: max(0, len(codes) - room + 1)]
    there = looked_at == values[0]
    for value in values[1:]:
        there |= looked_at == value
    return np.flatnonzero(there)
