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
        self._before = running_sums(codes)
        #: A stretch is followed by its own sum where this, at its end, is the sum of all before it.
        self._less = self._before[:-1] - codes

    def fit(self, starts: Integers, stops: Integers) -> Flags:
        """Say of stretches whether the byte behind each is the sum of it."""
        result: Flags = self._less.take(stops) == self._before.take(starts)
        return result


#: Every second byte of a word, and a factor that adds to each of them those below it.
_EVERY_SECOND, _ADD_BELOW = np.uint64(0x00FF00FF00FF00FF), np.uint64(0x0001000100010001)


def running_sums(codes: Bytes) -> Bytes:
    """Return the sum of the bytes before each place, and of all bytes: 8 bits each.

    Within words of eight bytes they are reckoned at once, in parts of 16 bits: the bytes at even places apart from those at odd
    ones. So only one sum a word has to wait for the one before it.
    """
    count = len(codes)
    room = np.zeros(count // 8 * 8 + 16, dtype=np.uint8)
    # The sums before each place stand one to the left of the bytes, and the words where the bytes do.
    room[8 : 8 + count] = codes
    sums = room[8:].view("<u8")
    even, odd = sums & _EVERY_SECOND, sums >> np.uint64(8) & _EVERY_SECOND
    even *= _ADD_BELOW
    odd *= _ADD_BELOW
    before = np.zeros(len(sums), dtype=np.uint8)
    np.cumsum((even + odd >> np.uint64(48)).astype(np.uint8)[:-1], dtype=np.uint8, out=before[1:])
    even += before * _ADD_BELOW
    np.add(even, odd, out=sums)
    sums &= _EVERY_SECOND
    sums <<= np.uint64(8)
    # A byte at an even place has one at an odd place less below it.
    odd <<= np.uint64(16)
    even += odd
    even &= _EVERY_SECOND
    sums |= even
    return room[7 : 8 + count]


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
        return self._fitting(windows(self._codes, starts, size), crc16.modbus(bytes(size - 2)))

    def fit_each(self, starts: Integers, sizes: Bytes) -> Flags:
        """Say it of stretches of several lengths, each of which has room for a CRC."""
        order = np.argsort(sizes, kind="stable")
        starts, fits = starts.take(order), np.zeros(len(starts), dtype=np.bool_)
        rare, end = [order[:0]], 0
        for size, count in enumerate(np.bincount(sizes).tolist()):
            begin, end = end, end + count
            if count >= self._FEW:
                fits[begin:end] = self.fit(starts[begin:end], size)
            elif count:
                rare.append(np.arange(begin, end))
        rows = np.concatenate(rare)
        fits[rows] = self._fit_together(starts.take(rows), sizes.take(order.take(rows)))
        result = np.empty_like(fits)
        result[order] = fits
        return result

    def _fit_together(self, starts: Integers, sizes: Bytes) -> Flags:
        """Say it of stretches that stand at the right of rows. Zeros before their first bytes give nothing."""
        longest = self._longest
        codes = np.concatenate((np.zeros(longest, dtype=np.uint8), self._codes))
        rows = windows(codes, starts + sizes, longest) * (np.arange(longest) >= longest - sizes[:, None].astype(np.int64))
        alone = np.array([crc16.modbus(bytes(max(0, size - 2))) for size in range(longest + 1)], dtype=np.uint16)
        return self._fitting(rows, alone.take(sizes))

    def _fitting(self, rows: Bytes, alone: int | NDArray[np.uint16]) -> Flags:
        """Say which rows end with the CRC of what stands before it. `alone`: what the start value alone gives."""
        size = rows.shape[1] - 2
        total = rows[:, size:].view("<u2")[:, 0] ^ np.uint16(alone)
        for place, pairs in enumerate(rows[:, : size - size % 2].view("<u2").T):
            total ^= self._share(size - 2 * place - 2).take(pairs)
        if size % 2:
            # A byte with a zero before it: with nothing behind, the zero gives nothing.
            total ^= self._share(0).take(rows[:, size - 1].astype(np.uint16) << 8)
        fits: Flags = total == 0
        return fits

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
