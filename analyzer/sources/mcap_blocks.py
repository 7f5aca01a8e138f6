"""Messages of a log as columns: CAN frames become blocks.

    chunk -> where messages stand -> those of topics that matter -> the few keys that say what came -> columns

Every message is read as JSON, as a single one is: only what is done with it is done for many together. All that is no plain CAN
frame is left to be read singly, in its place.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from analyzer.catalogue import Role
from analyzer.columns.block import DIRECTIONS, STANDARD_ID, WIDEST_DATA
from analyzer.columns.codec import Flags, Integers
from analyzer.columns.groups import ranks
from analyzer.link.arrays import windows
from analyzer.sources.found import Found, without_rest
from analyzer.sources.mcap_scan import HEAD, MESSAGE, Messages

_HEAD = np.dtype([("channel", "<u2"), ("sequence", "<u4"), ("log_ns", "<u8"), ("publish_ns", "<u8")])
_MARKS = {"" if role is Role.UNKNOWN else role.value: mark for mark, role in enumerate(DIRECTIONS)}
#: Times that fit into 63 bits, by far.
_LATEST_NS = 1 << 62
#: Characters of a byte as hex text, with the blank behind it.
_HEX = 3
_BLANK = ord(" ")


def pieces(data: bytes, bodies: array[int]) -> Iterator[Messages | tuple[int, int, int]]:
    """Yield the records of a chunk: messages that follow each other together; of another its opcode and its body's place."""
    places = np.array(bodies).astype(np.int64)
    starts, stops = places[:-1], places[1:] - HEAD.size
    opcodes = np.frombuffer(data, dtype=np.uint8)[starts - HEAD.size]
    # A message that is too short is left to be told so.
    fits = (opcodes == MESSAGE) & (stops - starts >= _HEAD.itemsize)
    at = 0
    for other in [*np.flatnonzero(~fits).tolist(), len(starts)]:
        if at < other:
            yield Messages(data, starts[at:other], stops[at:other])
        if other < len(starts):
            yield int(opcodes[other]), int(starts[other]), int(stops[other])
        at = other + 1


class Read:
    """Messages of the channels that matter, with what they say. `rows`: their places among the messages.

    `bus_of`: the bus of a channel; None: its messages do not matter. `decode`: reads the JSON of one; raises for a damaged one.
    """

    def __init__(self, messages: Messages, bus_of: Callable[[int], str | None], decode: Callable[[bytes], Any]) -> None:
        heads = windows(np.frombuffer(messages.data, dtype=np.uint8), messages.starts, _HEAD.itemsize).view(_HEAD)[:, 0]
        known, places = ranks(heads["channel"])
        buses = [bus_of(channel) for channel in known.tolist()]
        self.rows = np.flatnonzero(np.array([bus is not None for bus in buses])[places])
        self.channels: list[int] = heads["channel"][self.rows].tolist()
        self.log_ns: list[int] = heads["log_ns"][self.rows].tolist()
        data = messages.data
        bounds = messages.starts[self.rows] + _HEAD.itemsize, messages.stops[self.rows]
        self.logged = [decode(data[start:stop]) for start, stop in zip(*(bound.tolist() for bound in bounds), strict=True)]
        self._names = sorted({bus for bus in buses if bus is not None})
        self._buses = np.array([-1 if bus is None else self._names.index(bus) for bus in buses])[places[self.rows]]

    def found(self) -> Found:
        """Return what the rows hold; those that are no plain CAN frames are left."""
        logged = self.logged
        found = Found.of(len(logged))
        found.names = self._names
        rows = np.flatnonzero([each.can_id is not None and each.is_plain for each in logged])
        if not len(rows):
            return found
        own = [logged[row] for row in rows.tolist()]
        texts = [each.raw for each in own]
        lengths = np.fromiter(map(len, texts), np.int64, len(own))
        ids = np.fromiter((each.can_id for each in own), np.int64, len(own))
        t_ns = np.array(self.log_ns, dtype=np.uint64)[rows]
        marks = np.fromiter((_MARKS.get(each.direction, -1) for each in own), np.int64, len(own))
        fits = (ids <= STANDARD_ID) & (t_ns < _LATEST_NS) & (marks >= 0)
        fits &= (lengths % _HEX == _HEX - 1) & (lengths < _HEX * WIDEST_DATA)
        data = _data(texts, lengths, fits)
        if data is None:
            return found
        chosen = rows[fits]
        found.t_ns[chosen], found.ids[chosen], found.marks[chosen] = t_ns[fits], ids[fits], marks[fits]
        found.sizes[chosen], found.data[chosen] = (lengths[fits] + 1) // _HEX, data
        found.bus[chosen] = self._buses[chosen]
        return found


def _data(texts: Sequence[str], lengths: Integers, chosen: Flags) -> Any:
    """Return the bytes of some hex texts, 8 a row with zeros behind; None where one is not written as a log has it."""
    if not chosen.all():
        texts = [texts[row] for row in np.flatnonzero(chosen).tolist()]
    text = " ".join(texts)
    sizes = (lengths[chosen] + 1) // _HEX
    try:
        data = bytes.fromhex(text)
    except ValueError:
        return None
    # Texts with a blank behind each byte but the last have as many bytes as they are long.
    codes = np.frombuffer(text.encode(), dtype=np.uint8)
    if len(data) != int(sizes.sum()) or not (codes[_HEX - 1 :: _HEX] == _BLANK).all():
        return None
    rows = windows(np.frombuffer(data + bytes(WIDEST_DATA), dtype=np.uint8), np.cumsum(sizes) - sizes, WIDEST_DATA)
    return without_rest(rows, sizes)
