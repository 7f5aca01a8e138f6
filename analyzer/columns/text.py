"""Texts of many rows at once, as JSON has them, and how they come to stand where they belong.

A cell holds one text a row, at its right side. What stands to the left of a narrow text is of no meaning: pieces of a row are
written from the right to the left, so the piece before a cell is written over it. So no row needs a step of its own, and
nothing has to be taken out afterwards.

      {"speed": | 0000-12 | ,"_raw":"32 FF"}        pieces
                     <---                            what is written first and what then
      {"speed":-12,"_raw":"32 FF"}
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from analyzer.columns.codec import Bytes, Flags, Integers
from analyzer.columns.groups import ranks, taken

#: Bytes that stand before the first cell of any message, at least: so much of a cell may be without meaning.
ROOM = 31
_GROUP = 10_000
#: Four digits as one word.
_DIGITS = np.ascontiguousarray(np.indices((10, 10, 10, 10), np.uint8).reshape(4, _GROUP).T + ord("0")).view(np.uint32)[:, 0]
#: Digits of numbers that always fit into such a word.
_SMALL_DIGITS = 9
_MINUS = ord("-")
#: A byte as two hex digits in one word.
_HEX = np.frombuffer(bytes(range(256)).hex().upper().encode(), dtype=np.uint16)
#: Python writes numbers with an exponent below the first (but for 0), and from the second on.
_SMALL, _GREAT = 1e-4, 1e16
_MINUS_ZERO = np.int64(-1 << 63)


class Cell(msgspec.Struct, frozen=True, eq=False):
    """One text a row. `codes`: ASCII, a row for each; `widths`: how many at the right of each row are its text."""

    codes: Bytes
    widths: Integers | int

    def take(self, rows: Integers) -> Cell:
        """Return the texts of some rows."""
        return Cell(taken(self.codes, rows), self.widths if isinstance(self.widths, int) else self.widths.take(rows))


#: A text that all rows have, or one for each.
Piece = bytes | Cell


def width(pieces: Sequence[Piece]) -> Integers | int:
    """Return how long rows of such pieces are."""
    return sum((len(p) if isinstance(p, bytes) else p.widths for p in pieces), 0)


def take(pieces: Sequence[Piece], rows: Integers) -> list[Piece]:
    """Return the pieces of some rows."""
    return [piece if isinstance(piece, bytes) else piece.take(rows) for piece in pieces]


def place(out: Bytes, ends: Integers, pieces: Sequence[Piece]) -> Integers:
    """Write rows of pieces side by side, so that each row ends where it should. Return where each begins.

    Left of each row must be room, `ROOM` bytes, that are written afterwards, or all widths must be fixed.
    """
    fixed: list[Bytes | bytes] = []
    for piece in reversed(pieces):
        if isinstance(piece, bytes):
            fixed.insert(0, piece)
        elif isinstance(piece.widths, int):
            fixed.insert(0, piece.codes[:, piece.codes.shape[1] - piece.widths :])
        else:
            codes = joined([piece.codes, *fixed], len(ends))
            _put(out, ends, codes, piece.codes.shape[1] - piece.widths)
            ends = ends - (codes.shape[1] - piece.codes.shape[1]) - piece.widths
            fixed = []
    if fixed:
        codes = joined(fixed, len(ends))
        put(out, ends, codes)
        ends = ends - codes.shape[1]
    return ends


def put(out: Bytes, ends: Integers, codes: Bytes) -> None:
    """Write rows of one width, each so that it ends where it should."""
    size = codes.shape[1]
    if size and len(ends):
        # One item of a type as wide as a row is written at once.
        there = np.ndarray(len(out) - size + 1, dtype=f"V{size}", buffer=out, strides=(1,))
        there[ends - size] = codes.view(f"V{size}")[:, 0]


def _put(out: Bytes, ends: Integers, codes: Bytes, spare: Integers) -> None:
    """Write rows of which some bytes at the left are without meaning: not many of these."""
    while len(ends) and (narrow := spare > ROOM).any():
        put(out, ends[~narrow], codes[~narrow])
        ends, codes, spare = ends[narrow], np.ascontiguousarray(codes[narrow, ROOM:]), spare[narrow] - ROOM
    put(out, ends, codes)


def joined(pieces: Sequence[Bytes | bytes], rows: int) -> Bytes:
    """Return rows side by side; a piece that is plain bytes stands in each row."""
    if len(pieces) == 1 and not isinstance(pieces[0], bytes) and pieces[0].flags.c_contiguous:
        return pieces[0]
    common = b"".join(p if isinstance(p, bytes) else bytes(p.shape[1]) for p in pieces)
    size, at = len(common), 0
    whole = np.empty(rows, dtype=f"V{size}")
    whole[:] = np.frombuffer(common, dtype=whole.dtype)[0]
    for piece in pieces:
        if isinstance(piece, bytes):
            at += len(piece)
        elif piece.shape[1]:
            own = f"V{piece.shape[1]}"
            np.ndarray(rows, dtype=own, buffer=whole, offset=at, strides=(size,))[:] = piece.view(own)[:, 0]
            at += piece.shape[1]
    return whole.view(np.uint8).reshape(rows, size)


def only(wanted: Flags, piece: Piece) -> Cell:
    """Return a piece that some rows have, the others have nothing."""
    codes = joined([piece], len(wanted)) if isinstance(piece, bytes) else piece.codes
    return Cell(codes, width([piece]) * wanted)


def integers(values: Integers) -> Cell:
    """Return integers as text."""
    if not len(values):
        return Cell(np.zeros((0, 1), dtype=np.uint8), 1)
    negative: Integers | None = None
    if values.min() < 0:
        negative = np.flatnonzero(values < 0)
        values = np.abs(values)
    least, greatest = len(str(int(values.min()))), len(str(int(values.max())))
    # Small words are compared and divided faster.
    values = values.astype(np.uint32) if greatest <= _SMALL_DIGITS else values
    more = np.zeros(len(values), dtype=np.uint8)
    for digits in range(least, greatest):
        more += (values >= 10**digits).view(np.uint8)
    codes = _digits(values, greatest + (negative is not None))
    if negative is not None:
        size = codes.shape[1]
        more[negative] += 1
        codes.reshape(-1)[negative * size + (size - least) - more[negative]] = _MINUS
    elif least == greatest:
        return Cell(codes, greatest)
    return Cell(codes, more + np.int64(least))


def fixed_digits(values: Integers, digits: int) -> Cell:
    """Return integers that are not negative as text with so many digits, leading zeros written."""
    return Cell(_digits(values, digits), digits)


def _digits(values: NDArray[np.integer[Any]], digits: int) -> Bytes:
    """Return so many digits, and before them more of no meaning, in whole words."""
    groups = -(-digits // 4)
    codes = np.empty((len(values), groups), dtype=np.uint32)
    rest = values.astype(np.uint32, copy=False) if digits <= _SMALL_DIGITS else values
    for place in range(groups - 1, 0, -1):
        above = rest // _GROUP
        codes[:, place] = _DIGITS.take(rest - above * _GROUP)
        rest = above
    codes[:, 0] = _DIGITS.take(rest)
    return codes.view(np.uint8)


def floats(values: NDArray[np.float64]) -> list[Piece]:
    """Return numbers as the shortest text that reads back the same, as Python writes it."""
    size = np.abs(values)
    if not size.max(initial=0) < _GREAT:
        return [_each(values)]
    whole = values.astype(np.int64)
    if (whole == values).all() and not (values.view(np.int64) == _MINUS_ZERO).any():
        # Most drives send whole numbers, whose texts are made faster.
        return [integers(whole), b".0"]
    return [_each(values) if ((size < _SMALL) & (size > 0)).any() else _split(msgspec.json.encode(values.tolist())[1:-1])]


def _each(values: NDArray[np.float64]) -> Cell:
    """Return numbers of which some have an exponent, which JSON encoders write in another way."""
    return _split(b",".join(repr(value).encode() for value in values.tolist()))


def _split(text: bytes) -> Cell:
    """Return texts between commas."""
    codes = np.frombuffer(text, dtype=np.uint8)
    ends = np.append(np.flatnonzero(codes == ord(",")), len(codes))
    return _at(text, ends, np.diff(ends, prepend=-1) - 1)


def _at(text: bytes, ends: Integers, widths: Integers) -> Cell:
    """Return the texts that end at some places of a text."""
    size = int(widths.max(initial=1))
    before = bytes(size) + text
    windows = np.ndarray(len(text) + 1, dtype=f"V{size}", buffer=before, strides=(1,))
    return Cell(windows[ends].view(np.uint8).reshape(len(ends), size), widths)


def names(values: Integers, table: Mapping[int, str]) -> Cell:
    """Return the name of each value. Raises KeyError for a value without one."""
    known, places = ranks(values) if not len(values) or values.min() >= 0 else np.unique(values, return_inverse=True)
    return of_table(places, [table[v].encode() for v in known.tolist()])


def of_table(places: NDArray[np.integer], texts: Sequence[bytes]) -> Cell:
    """Return, for each place, the text at it."""
    widths = np.array([len(t) for t in texts], dtype=np.int64)
    cell = _at(b"".join(texts), np.cumsum(widths), widths)
    if len(set(widths.tolist())) == 1:
        return Cell(taken(cell.codes, places), int(widths[0]))
    return Cell(taken(cell.codes, places), widths.take(places))


def hexadecimal(data: Bytes, size: int) -> Cell:
    """Return the first bytes of each row as hex digits with blanks between."""
    codes = np.full((len(data), 3 * size), ord(" "), dtype=np.uint8)
    np.ndarray((len(data), size), dtype=np.uint16, buffer=codes, strides=(3 * size, 3))[:] = _HEX.take(data[:, :size])
    return Cell(codes[:, : max(0, 3 * size - 1)], max(0, 3 * size - 1))
