"""Records of pcapng interfaces whose link is SocketCAN as columns.

    6, length, interface, time, stored, original | identifier and flags, length, FD flags, 2 reserved, data | length

Records with options, and all other blocks, are left to be read singly.
"""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from analyzer.columns.block import CanBlock
from analyzer.columns.codec import Bytes, Integers
from analyzer.link.arrays import windows
from analyzer.sources.found import Found
from analyzer.sources.pcap_blocks import FD_SIZE, starts_of, take_frames

_ENHANCED = 6
_HEAD, _FRAME, _TAIL = 28, 16, 4
_LEAST, _MOST = _HEAD + _TAIL, _HEAD + FD_SIZE + _TAIL
_LAST_NS = 1 << 61


class CanInterface(NamedTuple):
    """An interface whose records are SocketCAN frames: its port, the nanoseconds of a tick, the time of tick 0."""

    port: str
    tick_ns: int
    start_ns: int


def pieces(buffer: bytes, order: str, interfaces: Sequence[CanInterface | None]) -> Iterator[tuple[int, CanBlock | None]]:
    """Yield the records in stretches: their bytes, and their frames; None: read them singly.

    The buffer begins with a block. They end before the first block that is no such record.
    """
    two = struct.Struct(order + "LL").unpack_from

    def size_of(at: int) -> int:
        kind, size = two(buffer, at)
        return size if kind == _ENHANCED and _LEAST <= size <= _MOST and not size % 4 else 0

    codes = np.frombuffer(buffer + bytes(_HEAD + _FRAME), dtype=np.uint8)
    starts, end = starts_of(buffer, codes, 0, size_of, slice(0, 8))
    for first, last, port, block in _found(codes, starts, order, interfaces).stretches():
        size = (int(starts[last]) if last < len(starts) else end) - int(starts[first])
        yield size, None if block is None else dataclasses.replace(block, port=port)


def _found(codes: Bytes, starts: Integers, order: str, interfaces: Sequence[CanInterface | None]) -> Found:
    found = Found.of(len(starts))
    if not len(starts) or not interfaces:
        return found
    rows, word = windows(codes, starts, _HEAD + _FRAME), np.dtype(order + "u4")
    _, length, number, high, low, stored, original = rows[:, :_HEAD].view(word).astype(np.int64).T
    plain = take_frames(found, rows[:, _HEAD:], stored, original)
    # Nothing but the record, and its length once more.
    again = windows(codes, starts + length - _TAIL, _TAIL).view(word)[:, 0]
    plain &= (length == _LEAST + stored + -stored % 4) & (again == length)
    number = np.where(number < len(interfaces), number, len(interfaces))
    known = [each or CanInterface("", 0, 0) for each in (*interfaces, None)]
    tick_ns, start_ns = (np.array([each[place] for each in known])[number] for place in (1, 2))
    plain &= (tick_ns > 0) & (high < _LAST_NS // np.maximum(tick_ns, 1) >> 32)
    found.t_ns[:] = np.where(plain, start_ns + (high << 32 | low) * tick_ns, 0)
    found.names = [each.port for each in known]
    found.bus[plain] = number[plain]
    return found
