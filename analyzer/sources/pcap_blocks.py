"""Records of a pcap file whose link is SocketCAN as columns.

    seconds, fraction, stored, original | identifier and flags, length, FD flags, 2 reserved, data | ...

Most writers store 16 bytes of each frame, so that records of one length follow each other; they are taken together.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from analyzer.columns.block import CanBlock
from analyzer.columns.codec import Bytes, Integers
from analyzer.sources.found import STANDARD_ID, Found, without_rest
from analyzer.sources.source import SECOND_NS

_RECORD_SIZE = 16
_CAN_HEADER = 8
_FD_SIZE = 72
#: Records whose lengths are compared at first.
_AHEAD = 64
_WHOLE = _RECORD_SIZE + _CAN_HEADER + 8


def pieces(buffer: bytes, at: int, order: str, unit: int) -> Iterator[tuple[int, int, CanBlock | None]]:
    """Yield the records from a place on in stretches: from which byte to which, and their frames; None: read them singly.

    The last stretch ends with the buffer, which may end within a record. The port of a block is empty.
    """
    codes = np.frombuffer(buffer + bytes(_WHOLE), dtype=np.uint8)
    starts, end = _starts(buffer, codes, at, order)
    for first, last, _, block in _found(codes, starts, order, unit).stretches():
        yield int(starts[first]), int(starts[last]) if last < len(starts) else end, block
    yield end, len(buffer), None


def _starts(buffer: bytes, codes: Bytes, at: int, order: str) -> tuple[Integers, int]:
    """Return where the whole records begin, as far as their lengths can be true, and where the last of them ends."""
    found: list[Integers] = []
    singly: list[int] = []
    length, end, ahead = struct.Struct(order + "L"), len(buffer), _AHEAD
    while end - at >= _RECORD_SIZE:
        size = _RECORD_SIZE + length.unpack_from(buffer, at + 8)[0]
        count = min((end - at) // size, ahead)
        if not count or size > _RECORD_SIZE + _FD_SIZE:
            break
        if len(singly) % _AHEAD:
            # Lengths changed just now: they may go on to.
            count = 1
        elif count > 1:
            alike = codes[at + 8 : at + count * size].reshape(-1)[: (count - 1) * size + 4]
            words = np.lib.stride_tricks.sliding_window_view(alike, 4)[::size]
            same = (words == words[0]).all(axis=1)
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
    rows = np.lib.stride_tricks.sliding_window_view(codes, _WHOLE)[starts]
    head = rows[:, :_RECORD_SIZE].view(np.dtype(order + "u4")).astype(np.int64)
    can = rows[:, _RECORD_SIZE:]
    ids = _big(can[:, :4])
    sizes = can[:, 4].astype(np.int64)
    stored = head[:, 2]
    found = Found.of(len(starts))
    found.names.append("")
    plain = (ids <= STANDARD_ID) & (sizes <= 8) & (can[:, 5] == 0)
    plain &= (stored >= _CAN_HEADER + sizes) & (stored >= head[:, 3]) & (stored != _FD_SIZE)
    found.t_ns[:] = head[:, 0] * SECOND_NS + head[:, 1] * unit
    found.ids[:], found.sizes[:] = ids, sizes
    found.data = without_rest(can[:, _CAN_HEADER:], sizes)
    found.bus[plain] = 0
    return found


def _big(words: Bytes) -> NDArray[np.int64]:
    result: Integers = np.ascontiguousarray(words).view(">u4")[:, 0].astype(np.int64)
    return result
