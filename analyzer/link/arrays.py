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

    @classmethod
    def fits(cls, rows: Bytes) -> Flags:
        """Say which rows of one length end with their own CRC, low byte first."""
        count, size = rows.shape
        # Zeros show what the start value alone gives.
        total = np.full(count, crc16.modbus(bytes(size)), dtype=np.uint16)
        even = size - size % 2
        for place, pairs in enumerate(rows[:, :even].view("<u2").T):
            total ^= cls._share(size - 2 * place - 2).take(pairs)
        if size % 2:
            # A byte with a zero before it: with nothing behind, the zero gives nothing.
            total ^= cls._share(0).take(rows[:, -1].astype(np.uint16) << 8)
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


def windows(codes: Bytes, starts: Integers, size: int) -> Bytes:
    """Return so many bytes from each of some places on."""
    # Items of one type as wide as a row are taken at once.
    there = np.ndarray(max(0, len(codes) - size + 1), dtype=f"V{size}", buffer=codes, strides=(1,))
    rows: Bytes = there[starts].view(np.uint8).reshape(len(starts), size)
    return rows


def places_of(codes: Bytes, values: bytes, room: int) -> Integers:
    """Return where one of some bytes stands, with room for so many bytes."""
    looked_at = codes[: max(0, len(codes) - room + 1)]
    there = looked_at == values[0]
    for value in values[1:]:
        there |= looked_at == value
    return np.flatnonzero(there)
