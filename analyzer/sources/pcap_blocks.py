"""Records of a pcap file whose link is SocketCAN as columns.

    seconds, fraction, stored, original | identifier and flags, length, FD flags, 2 reserved, data | ...

Most writers store 16 bytes of each frame, so that records of one length follow each other; they are taken together.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator

import numpy as np

from analyzer.columns.block import STANDARD_ID, CanBlock
from analyzer.columns.codec import Bytes, Flags, Integers
from analyzer.link.arrays import windows
from analyzer.sources.found import Found, without_rest
from analyzer.values import SECOND_NS

_RECORD_SIZE = 16
_CAN_HEADER = 8
FD_SIZE = 72
#: Records whose lengths are compared at first.
_AHEAD = 64
_WHOLE = _RECORD_SIZE + _CAN_HEADER + 8


def pieces(buffer: bytes, order: str, unit: int) -> Iterator[tuple[int, int, CanBlock | None]]:
    """Yield records in stretches: from which byte to which, and their frames; None: read them singly.

    The last stretch ends with the buffer, which may end within a record. The port of a block is empty.
    """
    codes = np.frombuffer(buffer + bytes(_WHOLE), dtype=np.uint8)
    starts, end = starts_in(buffer, 0, order)
    for first, last, _, block in _found(codes, starts, order, unit).stretches():
        yield int(starts[first]), int(starts[last]) if last < len(starts) else end, block
    yield end, len(buffer), None


def starts_in(buffer: bytes, at: int, order: str) -> tuple[Integers, int]:
    """Return where the records of a pcap file begin, as `starts_of` does."""
    length = struct.Struct(order + "L").unpack_from

    def size_of(at: int) -> int:
        size: int = _RECORD_SIZE + length(buffer, at + 8)[0]
        return size if size <= _RECORD_SIZE + FD_SIZE else 0

    return starts_of(buffer, np.frombuffer(buffer, dtype=np.uint8), at, size_of, slice(8, 12))


def starts_of(buffer: bytes, codes: Bytes, at: int, size_of: Callable[[int], int], said: slice) -> tuple[Integers, int]:
    """Return where the whole records begin, as far as their sizes can be true, and where the last of them ends.

    `codes`: the buffer, with room behind it. `size_of`: tells the size of the record at a place, 0: this is none to be taken.
    `said`: the bytes of a record that say so, four or eight.
    """
    found: list[Integers] = []
    singly: list[int] = []
    end, ahead, width = len(buffer), _AHEAD, said.stop - said.start
    while end - at >= said.stop:
        size = size_of(at)
        count = min((end - at) // size, ahead) if size else 0
        if not count:
            break
        if len(singly) % _AHEAD:
            # Sizes changed just now: they may go on to.
            count = 1
        elif count > 1:
            words = np.ndarray(count, dtype=f"u{width}", buffer=codes, offset=at + said.start, strides=(size,))
            same = words == words[0]
            count = count if same.all() else int(same.argmin())
        ahead = 2 * count + _AHEAD
        if count < _AHEAD // 4:
            singly.extend(range(at, at + size * count, size))
        else:
            found += [np.array(singly, dtype=np.int64), at + size * np.arange(count)]
            singly = []
        at += size * count
    return np.concatenate([*found, np.array(singly, dtype=np.int64)]), at


def _found(codes: Bytes, starts: Integers, order: str, unit: int) -> Found:
    rows = windows(codes, starts, _WHOLE)
    head = rows[:, :_RECORD_SIZE].view(np.dtype(order + "u4")).astype(np.int64)
    found = Found.of(len(starts))
    found.names.append("")
    plain = take_frames(found, rows[:, _RECORD_SIZE:], head[:, 2], head[:, 3])
    found.t_ns = head[:, 0] * SECOND_NS + head[:, 1] * unit
    found.bus = plain.astype(np.int64) - 1
    return found


def take_frames(found: Found, can: Bytes, stored: Integers, original: Integers) -> Flags:
    """Take SocketCAN frames apart, of which so many bytes are stored. Say of each whether it is a plain data frame."""
    ids = found.ids = can[:, :4].view(">u4")[:, 0].astype(np.int64)
    sizes = found.sizes = can[:, 4].astype(np.int64)
    found.data = without_rest(can[:, _CAN_HEADER : _CAN_HEADER + 8], sizes)
    plain: Flags = (ids <= STANDARD_ID) & (sizes <= 8) & (can[:, 5] == 0)
    plain &= (stored >= _CAN_HEADER + sizes) & (stored >= original) & (stored != FD_SIZE)
    return plain
