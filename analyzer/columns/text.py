"""Numbers as JSON text, many at once.

A cell is an array of shape (rows, width) of ASCII codes. A 0 in it stands for nothing: once the cells of all rows stand side by
side, the zeros are taken out, and the rows follow each other as text.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from analyzer.columns.codec import Bytes, Integers

_GROUP = 10_000
#: Four digits as one word, with leading zeros and without.
_DIGITS = np.frombuffer(b"".join(b"%04d" % n for n in range(_GROUP)), dtype=np.uint32)
_LEADING = np.frombuffer(b"".join((b"%4d" % n).replace(b" ", b"\0") for n in range(_GROUP)), dtype=np.uint32)
_HEX = np.array([list(f"{n:02X} ".encode()) for n in range(256)], dtype=np.uint8)
#: Where Python writes a number with an exponent, and JSON encoders write that in another way.
_SMALL, _GREAT = 1e-4, 1e16


def joined(pieces: Sequence[Bytes | bytes], rows: int) -> Bytes:
    """Return cells side by side; a piece that is plain bytes stands in each row."""
    cell = np.empty((rows, sum(len(p) if isinstance(p, bytes) else p.shape[1] for p in pieces)), dtype=np.uint8)
    at = 0
    for piece in pieces:
        own = np.frombuffer(piece, dtype=np.uint8) if isinstance(piece, bytes) else piece
        end = at + own.shape[-1]
        cell[:, at:end] = own
        at = end
    return cell


def integers(values: Integers) -> Bytes:
    """Return integers of any sign as text."""
    negative = values < 0
    cell = naturals(np.abs(values))
    if not negative.any():
        return cell
    return np.hstack((np.where(negative, np.uint8(ord("-")), np.uint8(0))[:, None], cell))


def naturals(values: Integers) -> Bytes:
    """Return integers that are not negative as text."""
    greatest = int(values.max(initial=0))
    groups = max(1, -(-len(str(greatest)) // 4))
    cell = np.zeros((len(values), groups), dtype=np.uint32)
    rest = values
    for place in range(groups - 1, 0, -1):
        rest, low = np.divmod(rest, _GROUP)
        # Digits count from the first that is not 0; behind it, all four of a group do.
        cell[:, place] = np.where(rest > 0, _DIGITS[low], np.where(low > 0, _LEADING[low], 0))
        last = place == groups - 1
        if last:
            cell[:, place] = np.where((rest == 0) & (low == 0), _LEADING[0], cell[:, place])
    cell[:, 0] = np.where(rest > 0, _LEADING[rest], 0 if groups > 1 else _LEADING[0])
    return cell.view(np.uint8)


def fixed_digits(values: Integers, digits: int) -> Bytes:
    """Return integers that are not negative as text with so many digits, leading zeros written."""
    groups = -(-digits // 4)
    cell = np.empty((len(values), groups), dtype=np.uint32)
    rest = values
    for place in range(groups - 1, -1, -1):
        rest, low = np.divmod(rest, _GROUP)
        cell[:, place] = _DIGITS[low]
    return cell.view(np.uint8)[:, 4 * groups - digits :]


def floats(values: NDArray[np.float64]) -> Bytes:
    """Return numbers as the shortest text that reads back the same, as Python writes it."""
    size = np.abs(values)
    odd = (size < _SMALL) & (size > 0) | (size >= _GREAT) | ~np.isfinite(values)
    text = msgspec.json.encode(np.where(odd, 0.0, values).tolist())[1:-1]
    codes = np.frombuffer(text, dtype=np.uint8)
    ends = np.append(np.flatnonzero(codes == ord(",")), len(codes)) if len(values) else np.zeros(0, dtype=np.int64)
    lengths = np.diff(ends, prepend=-1) - 1
    cell = spread(codes[codes != ord(",")], lengths)
    if odd.any():
        texts = [repr(float(v)).encode() for v in values[odd]]
        wide = np.zeros((len(values), max(cell.shape[1], *(len(t) for t in texts))), dtype=np.uint8)
        wide[:, : cell.shape[1]] = cell
        for row, own in zip(np.flatnonzero(odd), texts, strict=True):
            wide[row] = 0
            wide[row, : len(own)] = np.frombuffer(own, dtype=np.uint8)
        cell = wide
    return cell


def spread(codes: Bytes, lengths: Integers) -> Bytes:
    """Return texts that follow each other, one a row."""
    width = int(lengths.max(initial=0))
    cell = np.zeros((len(lengths), width), dtype=np.uint8)
    cell[np.arange(width) < lengths[:, None]] = codes
    return cell


def names(values: Integers, table: Mapping[int, str]) -> Bytes:
    """Return the name of each value. Raises KeyError for a value without one."""
    known, places = np.unique(values, return_inverse=True)
    return of_table(places, [table[v].encode() for v in known.tolist()])


def of_table(places: Integers, texts: Sequence[bytes]) -> Bytes:
    """Return, for each place, the text at it."""
    lengths = np.array([len(t) for t in texts], dtype=np.int64)
    return spread(np.frombuffer(b"".join(texts), dtype=np.uint8), lengths)[places]


def hexadecimal(data: Bytes) -> Bytes:
    """Return bytes as hex digits with blanks between."""
    rows, width = data.shape
    return _HEX[data].reshape(rows, 3 * width)[:, : max(0, 3 * width - 1)]
