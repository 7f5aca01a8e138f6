"""Lines of candump's log form as columns.

    (1436509052.249713) can0 001#F60140023A

Lines of one length that look like the first of them are read together, place by place. They hold plain data frames with
identifiers of 11 bits. All other lines are left to the reader of single lines, in their place.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from analyzer.columns.block import STANDARD_ID, CanBlock
from analyzer.columns.codec import Bytes, Flags, Integers
from analyzer.columns.groups import groups
from analyzer.link.arrays import windows
from analyzer.sources.candump import LOG
from analyzer.sources.found import SHORTEST, Found

#: Kinds of lines of one length: of several buses, or with other digits.
_MOST_KINDS = 8
#: Digits of seconds that fit into 63 bits as nanoseconds.
_SECONDS = 9 + 1
#: Two hex digits as one word -> the byte, or more than any.
_NO_BYTE = 256
_BYTES = np.full(1 << 16, _NO_BYTE, dtype=np.uint16)
#: A hex digit likewise.
_DIGITS = np.full(1 << 8, _NO_BYTE, dtype=np.uint16)
for _high in b"0123456789ABCDEFabcdef":
    _DIGITS[_high] = int(chr(_high), 16)
    for _low in b"0123456789ABCDEFabcdef":
        _BYTES[_low << 8 | _high] = int(chr(_high) + chr(_low), 16)
_ZEROS = 0x3030303030303030
_ALL = (1 << 64) - 1
_DIGITS_OF_WORD = 8
_MARKS = {None: 0, "R": 0, "r": 0, "T": 1, "t": 1}
Words = NDArray[np.uint64]
Span = tuple[int, int]


def pieces(text: bytes) -> Iterator[tuple[int, int, str, CanBlock | None]]:
    """Yield the lines of a text in stretches: from which to which, on which bus, and their frames; None: read them singly.

    `text` has no line end behind the last one. The port of a block is empty.
    """
    # A line is read by whole words: behind the last there must be room.
    codes = np.frombuffer(b"".join((text, b"\n", bytes(8))), dtype=np.uint8)
    ends = np.flatnonzero(codes == ord("\n"))
    starts = np.concatenate(([0], ends[:-1] + 1))
    yield from _read(codes, starts, ends - starts).stretches()


def _read(codes: Bytes, starts: Integers, lengths: Integers) -> Found:
    found = Found.of(len(starts))
    for length, rows in groups(lengths):
        for _ in range(_MOST_KINDS):
            if len(rows) <= SHORTEST // 8:
                break
            rows = rows[~_kind(codes, starts[rows], length, rows, found)]
    return found


def _kind(codes: Bytes, starts: Integers, length: int, rows: Integers, found: Found) -> Flags:
    """Read the lines that look like the first of some of one length. Say which were dealt with."""
    line = codes[int(starts[0]) : int(starts[0]) + length].tobytes()
    match = LOG.match(line.decode("ascii", "replace"))
    done: Flags = np.zeros(len(rows), dtype=np.bool_)
    done[0] = True
    if match is None or match[6] or len(match[1]) > _SECONDS or len(match[4]) != 3 or len(match[5]) > 16 or len(match[5]) % 2:
        return done
    size = len(match[5]) // 2
    table = windows(codes, starts, -(-length // 8) * 8)
    fixed = np.zeros(table.shape[1], dtype=np.uint8)
    fixed[:length] = 255
    for group in (1, 2, 4, 5):
        fixed[slice(*match.span(group))] = 0
    ticks, odd = _number(table, match.span(1), match.span(2))
    for word, kept in zip(table.view(np.uint64).T, fixed.view(np.uint64), strict=True):
        if kept:
            odd |= (word ^ word[0]) & kept
    first, _ = match.span(4)
    high, low = _DIGITS.take(table[:, first]), _BYTES.take(table[:, first + 1 : first + 3].view("<u2")[:, 0])
    good: Flags = (odd == 0) & ((high | low) < _NO_BYTE)
    data = _BYTES.take(table[:, slice(*match.span(5))].view("<u2")) if size else np.zeros((len(rows), 0), dtype=np.uint16)
    # Usually nothing is wrong in any, which is found out faster.
    if data.max(initial=0) >= _NO_BYTE:
        good &= (data < _NO_BYTE).all(axis=1)
    ids = high.astype(np.int64) << 8 | low
    good &= ids <= STANDARD_ID
    t_ns = (ticks * np.uint64(10 ** (9 - len(match[2])))).astype(np.int64)
    # Of so many digits, the greatest numbers do not fit.
    good &= t_ns >= 0
    chosen = slice(None) if good.all() else good
    taken = rows[chosen]
    found.t_ns[taken] = t_ns[chosen]
    found.ids[taken] = ids[chosen]
    found.sizes[taken] = size
    if mark := _MARKS[match[7]]:
        found.marks[taken] = mark
    whole = np.zeros((len(rows), 8), dtype=np.uint8)
    whole[:, :size] = data
    found.data.view(np.uint64)[taken] = whole.view(np.uint64)[chosen]
    name = match[3]
    if name not in found.names:
        found.names.append(name)
    found.bus[taken] = found.names.index(name)
    done |= good
    return done


def _number(table: Bytes, whole: Span, fraction: Span) -> tuple[Words, Words]:
    """Return the numbers that the digits in some columns make, those of a fraction behind those of a whole.

    Beside them, of each row something that is not 0 if they are no digits. Eight are reckoned at once, as the bytes of a word.
    """
    value, wrong = np.zeros((2, len(table)), dtype=np.uint64)
    (start, stop), (point, end), weight = whole, fraction, 1
    while stop > start or end > point:
        behind = min(_DIGITS_OF_WORD, end - point)
        before = min(_DIGITS_OF_WORD - behind, stop - start)
        words = _last(table, end, behind) | _last(table, stop, before) >> np.uint64(8 * behind)
        # The last digits stand in the upper bytes; in the others belong zeros.
        words |= np.uint64(_ZEROS >> 8 * (behind + before))
        if (words == words[0]).all():
            # Of a time, the first digits are most often the same in all lines.
            words = words[:1]
        digits = words ^ np.uint64(_ZEROS)
        wrong |= (digits | digits + np.uint64(0x7676767676767676)) & np.uint64(0x8080808080808080)
        for width, mask in ((8, 0x00FF00FF00FF00FF), (16, 0x0000FFFF0000FFFF), (32, 0x00000000FFFFFFFF)):
            # Of two neighbours, the one of more weight stands in the lower bits.
            digits = (digits * np.uint64(10 ** (width // 8)) + (digits >> np.uint64(width))) & np.uint64(mask)
        value += digits * np.uint64(weight)
        stop, end, weight = stop - before, end - behind, weight * 10**_DIGITS_OF_WORD
    return value, wrong


def _last(table: Bytes, stop: int, count: int) -> Words:
    """Return the last of the bytes before a column as the upper bytes of a word, zeros below them."""
    first = max(stop - 8, 0)
    words: Words = table[:, first : first + 8].view("<u8")[:, 0] << np.uint64(8 * (first + 8 - stop))
    return words & np.uint64(_ALL << 8 * (8 - count) & _ALL)
