"""Lines of candump's log form as columns.

    (1436509052.249713) can0 001#F60140023A

Lines of one length that look like the first of them are read together, place by place. They hold plain data frames with
identifiers of 11 bits. All other lines are left to the reader of single lines, in their place.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from analyzer.columns.block import CanBlock
from analyzer.columns.codec import Bytes, Flags, Integers
from analyzer.columns.groups import groups
from analyzer.sources.candump import LOG
from analyzer.sources.found import SHORTEST, STANDARD_ID, Found

#: Kinds of lines of one length: of several buses, or with other digits.
_MOST_KINDS = 8
#: Digits of seconds that fit into 63 bits as nanoseconds.
_SECONDS = 9 + 1
_NO_DIGIT = 255
_NIBBLES = np.full(256, _NO_DIGIT, dtype=np.uint8)
for _code in b"0123456789ABCDEFabcdef":
    _NIBBLES[_code] = int(chr(_code), 16)
_MARKS = {None: 0, "R": 0, "r": 0, "T": 1, "t": 1}


def pieces(text: bytes) -> Iterator[tuple[int, int, str, CanBlock | None]]:
    """Yield the lines of a text in stretches: from which to which, on which bus, and their frames; None: read them singly.

    `text` ends with a line end. The port of a block is empty.
    """
    codes = np.frombuffer(text, dtype=np.uint8)
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
    table = np.lib.stride_tricks.sliding_window_view(codes, length)[starts]
    seconds, fraction, ident, data = (table[:, slice(*match.span(n))] for n in (1, 2, 4, 5))
    digits, nibbles = np.hstack((seconds, fraction)) - np.uint8(ord("0")), _NIBBLES[np.hstack((ident, data))]
    free = np.zeros(length, dtype=np.bool_)
    for group in (1, 2, 4, 5):
        free[slice(*match.span(group))] = True
    good = _rows_of(digits <= 9) & _rows_of(nibbles != _NO_DIGIT) & _rows_of(table[:, ~free] == table[0, ~free])
    ids = nibbles[:, :3].astype(np.int64) @ np.array([256, 16, 1])
    good &= ids <= STANDARD_ID
    whole, parts = digits[:, : seconds.shape[1]], digits[:, seconds.shape[1] :]
    t_ns = _number(whole) * 1_000_000_000 + _number(parts) * 10 ** (9 - fraction.shape[1])
    # Of so many digits, the greatest numbers do not fit.
    good &= t_ns >= 0
    taken = rows[good]
    found.t_ns[taken] = t_ns[good]
    found.ids[taken] = ids[good]
    size = data.shape[1] // 2
    found.sizes[taken] = size
    found.data[taken, :size] = nibbles[good, 3::2] << 4 | nibbles[good, 4::2]
    found.marks[taken] = _MARKS[match[7]]
    name = match[3]
    if name not in found.names:
        found.names.append(name)
    found.bus[taken] = found.names.index(name)
    done |= good
    return done


def _rows_of(cells: Flags) -> Flags:
    """Say of each row whether all its cells are true; usually all of all rows are, which is found out faster."""
    if cells.all():
        return np.ones(len(cells), dtype=np.bool_)
    rows: Flags = np.logical_and.reduce(cells, axis=1)
    return rows


def _number(digits: NDArray[np.uint8]) -> Integers:
    """Return the numbers that rows of digits stand for: eight digits at once as the bytes of a word."""
    rows, count = digits.shape
    padded = np.zeros((rows, -(-count // 8) * 8), dtype=np.uint8)
    padded[:, padded.shape[1] - count :] = digits
    words = padded.view("<u8")
    for width, mask in ((8, 0x00FF00FF00FF00FF), (16, 0x0000FFFF0000FFFF), (32, 0x00000000FFFFFFFF)):
        # Of two neighbours, the one of more weight stands in the lower bits.
        words = (words * np.uint64(10 ** (width // 8)) + (words >> np.uint64(width))) & np.uint64(mask)
    value = words[:, 0].astype(np.int64)
    for place in range(1, words.shape[1]):
        value = value * 100_000_000 + words[:, place].astype(np.int64)
    return value
