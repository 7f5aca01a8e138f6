"""Objects of a BLF file that are CAN messages as columns: objects with one header that follow each other."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from analyzer.catalogue import Role
from analyzer.columns.block import DIRECTIONS, STANDARD_ID, CanBlock
from analyzer.columns.groups import ranks
from analyzer.sources.found import SHORTEST, Found, without_rest

_OBJECT = np.dtype(
    [
        ("head", "V16"), ("unit", "<u4"), ("client", "<u2"), ("version", "<u2"), ("ticks", "<u8"),
        ("channel", "<u2"), ("flags", "u1"), ("length", "u1"), ("id", "<u4"), ("data", "u1", 8),
    ]
)  # fmt: skip
SIZE = _OBJECT.itemsize
_TEN_MICROSECONDS = 1
_SENT, _REMOTE = 0x01, 0x80
_MARKS = np.array([DIRECTIONS.index(Role.UNKNOWN), DIRECTIONS.index(Role.REQUEST)])
_LAST_NS = 1 << 62
#: Nanoseconds of a tick, and how many ticks a time has at most: otherwise, and where a tick is ten microseconds.
_UNITS = np.array([1, 10_000], dtype=np.uint64)
_TICKS = _LAST_NS // _UNITS


def alike(buffer: bytearray, at: int) -> int:
    """Return how many objects with the header of this one follow each other; 1: too few to be read together."""
    most = (len(buffer) - at) // SIZE
    head = bytes(buffer[at : at + 16])
    if most < SHORTEST or buffer[at + (SHORTEST - 1) * SIZE : at + (SHORTEST - 1) * SIZE + 16] != head:
        return 1
    # Ever more at a time: what is looked at in vain is no more than what was found.
    count, more = 0, SHORTEST
    first, second = np.frombuffer(head, dtype=np.uint64)
    while count < most:
        begin, more = at + count * SIZE, min(more, most - count)
        words = np.frombuffer(buffer, np.uint64, more * SIZE // 8, begin).reshape(more, SIZE // 8)
        same = (words[:, 0] == first) & (words[:, 1] == second)
        if not same.all():
            count += int(same.argmin())
            break
        count, more = count + more, 2 * more
    return count if count >= SHORTEST else 1


def remote(data: bytes) -> np.ndarray:
    """Say of each object whether it is a remote frame."""
    found: np.ndarray = np.frombuffer(data, dtype=_OBJECT)["flags"] & _REMOTE != 0
    return found


def pieces(data: bytes, start_ns: int) -> Iterator[tuple[int, int, str, CanBlock | None]]:
    """Yield objects in stretches: from which to which, on which bus, and their frames; None: read them singly."""
    rows = np.frombuffer(data, dtype=_OBJECT)
    if abs(start_ns) >= _LAST_NS:
        # The calendar of a damaged header goes beyond what columns hold.
        yield 0, len(rows), "", None
        return
    found = Found.of(len(rows))
    units = _UNITS.take(rows["unit"] == _TEN_MICROSECONDS)
    plain = (rows["id"] <= STANDARD_ID) & (rows["length"] <= 8) & ~remote(data)
    plain &= rows["ticks"] < _TICKS.take(rows["unit"] == _TEN_MICROSECONDS)
    found.t_ns[:] = start_ns + (rows["ticks"] * units).astype(np.int64)
    found.ids[:], found.sizes[:] = rows["id"], rows["length"]
    found.data = without_rest(rows["data"], rows["length"])
    found.marks[:] = _MARKS.take(rows["flags"] & _SENT)
    channels = ranks(rows["channel"])[0]
    found.names += [f"can{channel}" if channel else "" for channel in channels.tolist()]
    found.bus[plain] = channels.searchsorted(rows["channel"][plain]) if len(channels) > 1 else 0
    yield from found.stretches()
