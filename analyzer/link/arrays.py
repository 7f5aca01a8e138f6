"""Bytes as arrays: what links need to find many frames at once. Imported only where a capture is long."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import numpy as np
from fastcrc import crc16
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Found(NamedTuple):
    """Where frames begin, in ascending order, and how long they are. `looks`: how many bytes had to be looked at to tell.

    `unsure`: where else one may begin, in ascending order, or one of another length, too.
    """

    starts: Integers
    sizes: Integers
    looks: Integers
    unsure: Integers


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
    """The CRC of Modbus over many stretches of some bytes, of so many bytes at most.

    A CRC is linear: that of a stretch is what each byte alone would give at its place, all of it added without carry. Two bytes
    are looked up at once.
    """

    _POLYNOMIAL = 0xA001
    #: What two bytes give, by how many follow.
    _shares: ClassVar[dict[int, NDArray[np.uint16]]] = {}
    #: Fewer stretches of one length than this cost more by themselves than together with those of other lengths.
    _FEW = 512

    def __init__(self, codes: Bytes, longest: int) -> None:
        self._codes, self._longest = codes, longest

    def fit(self, starts: Integers, size: int) -> Flags:
        """Say which stretches of one length end with their own CRC, low byte first."""
        rows = windows(self._codes, starts, size)
        # Zeros show what the start value alone gives.
        total = np.full(len(rows), crc16.modbus(bytes(size)), dtype=np.uint16)
        fits: Flags = self._added(rows, total) == 0
        return fits

    def fit_each(self, starts: Integers, sizes: Bytes) -> Flags:
        """Say it of stretches of several lengths, none of which is 0."""
        result = np.zeros(len(starts), dtype=np.bool_)
        order, counts = np.argsort(sizes, kind="stable"), np.bincount(sizes, minlength=1)
        ends = np.cumsum(counts)
        rare = []
        for size in np.flatnonzero(counts).tolist():
            rows = order[ends[size] - counts[size] : ends[size]]
            if len(rows) < self._FEW:
                rare.append(rows)
            else:
                result[rows] = self.fit(starts.take(rows), size)
        if rare:
            rows = np.concatenate(rare)
            result[rows] = self._fit_together(starts.take(rows), sizes.take(rows))
        return result

    def _fit_together(self, starts: Integers, sizes: Bytes) -> Flags:
        """Say it of stretches that stand at the right of rows. Zeros before their first bytes give nothing."""
        longest = self._longest
        codes = np.concatenate((np.zeros(longest, dtype=np.uint8), self._codes))
        rows = windows(codes, starts + sizes, longest) * (np.arange(longest) >= longest - sizes[:, None].astype(np.int64))
        alone = np.array([crc16.modbus(bytes(size)) for size in range(longest + 1)], dtype=np.uint16)
        fits: Flags = self._added(rows, alone.take(sizes)) == 0
        return fits

    def _added(self, rows: Bytes, total: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Add to a total what the bytes of each row give."""
        size = rows.shape[1]
        even = size - size % 2
        for place, pairs in enumerate(rows[:, :even].view("<u2").T):
            total ^= self._share(size - 2 * place - 2).take(pairs)
        if size % 2:
            # A byte with a zero before it: with nothing behind, the zero gives nothing.
            total ^= self._share(0).take(rows[:, -1].astype(np.uint16) << 8)
        return total

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
