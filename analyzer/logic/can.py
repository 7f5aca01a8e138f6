"""A CAN receiver over edges: classic frames of 11 and 29 bits, and what destroys them.

    idle  SOF  identifier, control, data, CRC   CRC delimiter  ACK  ACK delimiter  EOF   intermission
    1...1  0   ... a 6th bit is always another ...     1        0         1        1 x 7     1 x 3

Low is dominant, as on the RX pin of a controller and on CAN_L; `inverted` takes CAN_H. Between two edges lies a run of some
bits, and each edge corrects the clock, as ISO 11898-1 has it. So the clocks of the senders may differ.

Rules: a frame begins at a dominant edge behind at least `_QUIET` recessive bits. It is given when its CRC fits and it is
acknowledged, or ends without an error flag. Six equal bits inside a frame are a stuff error, as error flags are made. Each
destroyed frame becomes one error frame with the classes of SocketCAN. CAN FD frames are counted and passed over.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from analyzer.columns.codec import Integers
from analyzer.logic.levels import Levels

#: Recessive bits behind which a frame can begin: no frame has so many inside, and EOF with its delimiter has more.
_QUIET = 7
#: Bits of the delimiter and EOF behind the ACK slot.
_END = 8
_STUFF = 5
#: Recessive bits behind which nothing more of a frame can come, and behind which a dominant run is an overload flag.
_SETTLED, _OVERLOAD = 11, 10
#: Runs without a quiet one between them; more are no CAN.
_MOST_RUNS = 4096
#: Longest run that is told in bits.
_LONG = 32
#: Bits up to where FDF tells CAN FD, and up to the end of the length code; of 11 and of 29 bits of identifier.
_FDF_BITS, _CONTROL_BITS = (15, 34), (19, 39)
_CRC_BITS, _MOST_BYTES = 15, 8
#: How far from whole bits the runs of a CAN FD frame's head may be, which no CRC holds, in bits.
_ON_BITS = 0.3
#: How much of an edge's deviation corrects the clock, where lengths of runs alone give no frame.
_TRACKING = 0.3
_CRC_POLYNOMIAL = 0x4599
#: Classes of SocketCAN's error frames, and the byte of their data that says what kind of violation it was.
PROTOCOL, NO_ACK, BUS_ERROR = 0x08, 0x20, 0x80
_KIND_AT, FORM, STUFF = 2, 0x02, 0x04
#: Where in a frame: the CRC sequence, as the byte behind the kind tells it.
_PLACE_CRC = 0x08


@dataclass
class Seen:
    """A frame that was read, or destroyed (`error`, with the number and data of its error frame). `t_ns`: its end."""

    start_ns: int
    t_ns: int
    id: int
    data: bytes
    extended: bool = False
    remote: bool = False
    error: bool = False
    acknowledged: bool = True
    crc_fits: bool = True


@dataclass
class Read:
    """The frames of a stretch, in order. `fd`: how many CAN FD frames were passed over; `rest`: what belongs to none yet.

    `broken`: stretches between two pauses that are no frame.
    """

    rest: Levels
    frames: list[Seen] = field(default_factory=list)
    fd: int = 0
    first_fd_ns: int = 0
    broken: int = 0

    @property
    def good(self) -> int:
        """Frames whose CRC fits, also those that were destroyed behind it."""
        return sum(frame.crc_fits for frame in self.frames)

    @property
    def whole(self) -> int:
        """Frames that end as they should behind a CRC that fits."""
        return sum(not frame.error for frame in self.frames)


def _crc_row(byte: int) -> int:
    value = byte << 7
    for _ in range(8):
        value = (value << 1) ^ (_CRC_POLYNOMIAL if value & 0x4000 else 0)
    return value & 0x7FFF


_CRC_TABLE = tuple(_crc_row(byte) for byte in range(256))


def crc15(bits: int, count: int) -> int:
    """Return the CRC of CAN over the lowest `count` bits of a number, the highest first."""
    value = 0
    # Zeros before the first bit change nothing.
    for byte in bits.to_bytes((count + 7) // 8, "big"):
        value = (value << 8 & 0x7FFF) ^ _CRC_TABLE[(value >> 7) ^ byte]
    return value


def read(levels: Levels, bit_ns: float, *, inverted: bool = False, final: bool = True) -> Read:
    """Read the frames of a stretch. `final`: nothing follows, so a frame that breaks off is left out."""
    line = levels.inverted() if inverted else levels
    clean = line.without_glitches(bit_ns)
    found = Read(levels.since(len(levels.edges)))
    # Runs begin with a dominant one.
    edges = clean.edges[1 - clean.first :]
    if not len(edges):
        return found
    bits = np.clip(np.rint(np.diff(edges, append=clean.end_ns) / bit_ns), 1, _LONG).astype(np.int64)
    quiet_ns = int(edges[0]) - (clean.start_ns if clean.first else int(clean.edges[0]))
    quiet = np.append(min(round(quiet_ns / bit_ns), _LONG), bits[1::2])[: (len(bits) + 1) // 2]
    # A stretch may begin right before a frame; what is none there is no error.
    uncertain = bool(clean.first) and quiet[0] < _QUIET
    quiet[0] = _LONG if uncertain else quiet[0]
    begins = (2 * np.flatnonzero(quiet >= _QUIET)).tolist()
    runs = bits.tolist()
    stops = [*begins[1:], len(runs)] if begins else []
    if begins and not final and len(runs) - begins[-1] < _MOST_RUNS and (len(runs) % 2 or runs[-1] < _SETTLED):
        found.rest = levels.since(int(np.searchsorted(line.edges, edges[begins[-1]])))
        del begins[-1]
    for start, stop in zip(begins, stops, strict=False):
        frame = _Frame(runs[start:stop], edges[start:stop], bit_ns)
        if runs[start] > _STUFF and quiet[start // 2] <= _OVERLOAD:
            continue
        seen = frame.seen()
        if seen is None or seen.error:
            again = _Frame(_by_clock(edges[start:stop], bit_ns) + runs[stop - 1 : stop], edges[start:stop], bit_ns)
            seen = better if (better := again.seen()) is not None and not better.error else seen
        if frame.fd:
            found.fd += 1
            found.first_fd_ns = found.first_fd_ns or int(edges[start])
        elif seen is None:
            found.broken += 1
        elif not (seen.error and uncertain and not start):
            found.frames.append(seen)
    return found


def _by_clock(edges: Integers, bit_ns: float) -> list[int]:
    """Return the bits of each run, as a clock counts them that every edge corrects by a part."""
    runs = []
    expected = float(edges[0])
    for edge in edges[1:].tolist():
        count = max(1, round((edge - expected) / bit_ns))
        expected += count * bit_ns
        expected += _TRACKING * (edge - expected)
        runs.append(min(count, _LONG))
    return runs


class _Frame:
    """One frame, from its SOF up to the next quiet: the bits of its runs, dominant ones first, and where each begins."""

    def __init__(self, runs: list[int], edges: Integers, bit_ns: float) -> None:
        self._runs, self._edges, self._bit_ns = runs, edges, bit_ns
        self._bits = self._count = 0
        self.fd = False

    def seen(self) -> Seen | None:
        """Return what was read; None where it breaks off, or is CAN FD."""
        need, place = _FDF_BITS[0], 0
        stuffed = False
        for place, raw in enumerate(self._runs):
            fresh = raw - stuffed
            self._bits = self._bits << fresh | (((1 << fresh) - 1) if place & 1 else 0)
            self._count += fresh
            while self._count >= need and (further := self._need()) != need and not self.fd:
                need = further
            if self.fd:
                lengths = np.diff(self._edges[: place + 2]) / self._bit_ns
                self.fd = bool((np.abs(lengths - np.rint(lengths)) < _ON_BITS).all())
                return None
            over = max(0, self._count - need)
            if raw - over > _STUFF or (raw - over == _STUFF and over):
                return self._error(STUFF, 0, place, crc_fits=False)
            stuffed = raw - over == _STUFF
            if self._count >= need:
                return self._ended(need, over, place, stuffed)
        return None

    def _field(self, start: int, size: int) -> int:
        """Return some bits, counted from SOF."""
        return self._bits >> (self._count - start - size) & ((1 << size) - 1)

    @property
    def _extended(self) -> bool:
        return bool(self._field(13, 1))

    def _need(self) -> int:
        """Return how many bits the frame has up to the end of its CRC, or up to where more of that is known."""
        fdf, control = _FDF_BITS[self._extended], _CONTROL_BITS[self._extended]
        if self._count < fdf:
            return fdf
        self.fd = bool(self._field(fdf - 1, 1))
        return control if self._count < control else control + 8 * self._size(control) + _CRC_BITS

    def _size(self, control: int) -> int:
        remote = self._field(32 if self._extended else 12, 1)
        return 0 if remote else min(self._field(control - 4, 4), _MOST_BYTES)

    def _ended(self, need: int, over: int, place: int, stuffed: bool) -> Seen:
        """Return the frame whose CRC ends in a run. `over`: bits of that run behind it; `stuffed`: a stuff bit follows."""
        # Runs behind the CRC, dominant ones with even numbers, and their bits.
        tail = [(place, over)] + [(number, self._runs[number]) for number in range(place + 1, min(place + 5, len(self._runs)))]
        if stuffed and len(tail) > 1:
            tail[1] = (tail[1][0], tail[1][1] - 1)
        tail = [(number, bits) for number, bits in tail if bits]
        levels = "".join(str(number & 1) * bits for number, bits in tail)
        self._bits >>= over
        self._count -= over
        if crc15(self._bits >> _CRC_BITS, need - _CRC_BITS) != self._bits & (1 << _CRC_BITS) - 1:
            return self._error(FORM, _PLACE_CRC, place, crc_fits=False)
        acknowledged = levels[1:2] == "0"
        if not levels.startswith(_TAILS[acknowledged]):
            if not acknowledged and levels.startswith("11"):
                return self._error(0, 0, place, NO_ACK)
            return self._error(FORM, 0, place)
        start_ns = int(self._edges[0])
        # Counted from the last edge: behind the ACK slot, or else in front of the run that the CRC ends in.
        if acknowledged:
            end_ns = round(int(self._edges[tail[1][0] + 1]) + _END * self._bit_ns)
        else:
            behind = self._runs[place] - over + stuffed + 2 + _END
            end_ns = round(int(self._edges[place]) + behind * self._bit_ns)
        control = _CONTROL_BITS[self._extended]
        size = self._size(control)
        number = self._field(1, 11) << 18 | self._field(14, 18) if self._extended else self._field(1, 11)
        data = self._field(control, 8 * size).to_bytes(size, "big")
        remote = bool(self._field(32 if self._extended else 12, 1))
        return Seen(start_ns, end_ns, number, data, self._extended, remote, False, acknowledged)

    def _error(self, kind: int, where: int, place: int, what: int = PROTOCOL, *, crc_fits: bool = True) -> Seen:
        """Return the error frame of a frame that was destroyed in one of its runs."""
        data = bytearray(8)
        data[_KIND_AT : _KIND_AT + 2] = kind, where
        t_ns = round(int(self._edges[place]) + min(self._runs[place], _STUFF + 1) * self._bit_ns)
        return Seen(int(self._edges[0]), t_ns, what | BUS_ERROR, bytes(data), error=True, crc_fits=crc_fits)


#: What stands behind the CRC: delimiter, ACK slot, delimiter, and as much of EOF as a receiver needs; without and with ACK.
_TAILS = ("1" * 9, "10" + "1" * 7)
