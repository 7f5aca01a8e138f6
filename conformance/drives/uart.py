"""A UART on a line: it reads the levels of several senders at its own speed.

    idle 1 | start 0 | eight data bits, the lowest first | stop 1 | idle        ten bits a byte

Two effects follow from the levels alone. A listener at another speed reads garbled bytes: more or fewer than were sent, but the
same each time. With several senders each low level wins, so their bytes are ANDed. Speeds that differ by less than about
four per cent read the same.

A byte with a low stop bit is passed on as it was read: a real UART marks it, and most hosts drop the mark.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from typing import NamedTuple

#: Bits of a byte on the line, with start and stop.
BITS = 10
SECOND_NS = 1_000_000_000


def byte_ns(baud: int) -> int:
    """Return the time of one byte on the line in nanoseconds."""
    return BITS * SECOND_NS // baud


class SentBytes(NamedTuple):
    """Bytes that one sender puts on the line without a pause, the first start bit at `start_ns`."""

    start_ns: int
    baud: int
    data: bytes

    @property
    def end_ns(self) -> int:
        """The end of the last stop bit."""
        return self.start_ns + len(self.data) * BITS * SECOND_NS // self.baud


class ReceivedByte(NamedTuple):
    """A byte that a listener read; `t_ns`: the end of its stop bit."""

    t_ns: int
    byte: int


def hear(sent: Iterable[SentBytes], baud: int, muted: Sequence[tuple[int, int]] = ()) -> list[ReceivedByte]:
    """Return what a listener at `baud` reads of all that was sent. `muted`: stretches in which it does not listen."""
    lows = _without(_merged(low for each in sent for low in _lows(each)), muted)
    bit = SECOND_NS / baud
    starts = [start for start, _ in lows]
    heard: list[ReceivedByte] = []
    ready = float("-inf")
    index = 0
    while index < len(lows):
        edge, end = lows[index]
        if edge < ready or end - edge < bit / 2:
            # Within the byte before, a line that never went high since, or too short for a start bit.
            index += 1
            continue
        byte = sum((not _low(lows, starts, edge + (i + 1.5) * bit)) << i for i in range(8))
        heard.append(ReceivedByte(round(edge + BITS * bit), byte))
        ready = edge + 9.5 * bit
        index = bisect_right(starts, ready - 1)
    return heard


def _lows(sent: SentBytes) -> Iterable[tuple[float, float]]:
    """Yield the stretches in which a sender holds the line low."""
    bit = SECOND_NS / sent.baud
    for number, byte in enumerate(sent.data):
        frame = byte << 1 | 1 << 9
        first = sent.start_ns + number * BITS * bit
        at = 0
        while at < BITS:
            if frame >> at & 1:
                at += 1
                continue
            stop = at
            while not frame >> stop & 1:
                stop += 1
            yield first + at * bit, first + stop * bit
            at = stop


def _merged(lows: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return stretches in order, those that touch as one."""
    result: list[tuple[float, float]] = []
    for start, end in sorted(lows):
        if result and start <= result[-1][1] + 1:
            result[-1] = (result[-1][0], max(result[-1][1], end))
        else:
            result.append((start, end))
    return result


def _without(lows: list[tuple[float, float]], muted: Sequence[tuple[int, int]]) -> list[tuple[float, float]]:
    """Return the stretches without those in which the listener does not listen."""
    for deaf_from, deaf_until in muted:
        kept = []
        for start, end in lows:
            if start < deaf_from:
                kept.append((start, min(end, deaf_from)))
            if end > deaf_until:
                kept.append((max(start, deaf_until), end))
        lows = [(a, b) for a, b in kept if a < b]
    return lows


def _low(lows: list[tuple[float, float]], starts: list[float], t_ns: float) -> bool:
    index = bisect_right(starts, t_ns) - 1
    return index >= 0 and t_ns < lows[index][1]
