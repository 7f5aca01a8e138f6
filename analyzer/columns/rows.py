"""The plain frames of a block as messages of a log: for each its fields, and behind a reply the state that it carries.

    | header | fields as JSON | the log's own keys | header | state as JSON |     one row a frame

How long each row is stands fixed first. Then the texts of rows that are alike are written to their places, as they stand in a
chunk of the log.
"""

from __future__ import annotations

from binascii import hexlify
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analyzer.catalogue import Role
from analyzer.columns import text
from analyzer.columns.block import DIRECTIONS, CanBlock
from analyzer.columns.codec import Bytes, ColumnCodec, Flags, Integers
from analyzer.columns.groups import groups, ranks, words
from analyzer.columns.pairs import Plain
from analyzer.layout import Field
from analyzer.records import Lane

HEADER = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log_ns", "<u8"), ("publish_ns", "<u8")]
)
_SECOND = 1_000_000_000
_MESSAGE = 5
#: Of a header, the bytes that its length does not count: opcode and length.
_UNCOUNTED = 9
_MARKS = [b"" if role is Role.UNKNOWN else f',"_direction":"{role}"'.encode() for role in DIRECTIONS]


@dataclass(frozen=True, slots=True)
class Messages:
    """Messages as they stand in a chunk. `starts`, `ends`: places in `data`; these and the others have one entry each."""

    data: Bytes
    starts: Integers
    ends: Integers
    channels: Integers
    log_ns: Integers


class Rows:
    """The messages of a block's plain frames, made once for all of them and given out by runs.

    `channels`: of each lane that is used, that of its topic and that of its state, 0 where it has none. `sequences`, `log_ns`:
    of each row, the number and the time of its messages; the times rise.
    """

    def __init__(self, plain: Plain, channels: Integers, sequences: Integers, log_ns: Integers) -> None:
        self.plain = plain
        states = np.array([*(lane.states for lane in plain.lanes), False])[plain.lane]
        #: Where the messages of each row begin among all: its own, and behind it the state that it carries.
        self._firsts = np.zeros(len(plain.lane) + 1, dtype=np.int64)
        np.cumsum((plain.lane >= 0).astype(np.int64) + states, out=self._firsts[1:])
        rows = np.repeat(np.arange(len(plain.lane)), np.diff(self._firsts))
        lengths = np.full(len(rows), HEADER.itemsize, dtype=np.int64)
        parts = [
            (self._firsts[own] + place, pieces, text.width(pieces))
            for place, own, pieces in (*_tails(plain, sequences), *_heads(plain))
        ]
        for own, _, width in parts:
            lengths[own] += width
        self._ends = np.cumsum(lengths)
        self._starts = self._ends - lengths
        self._channels = channels[plain.lane[rows], np.arange(len(rows)) - self._firsts[rows]]
        self._log_ns = log_ns[rows]
        self._data = np.empty(int(self._ends[-1]), dtype=np.uint8)
        left = self._ends.copy()
        for own, pieces, width in parts:
            ends = left[own]
            text.place(self._data, ends, pieces)
            left[own] = ends - width
        headers = np.empty(len(lengths), dtype=HEADER)
        headers["opcode"] = _MESSAGE
        headers["length"] = lengths - _UNCOUNTED
        headers["channel"] = self._channels
        headers["sequence"] = sequences[rows] & 0xFFFFFFFF
        headers["log_ns"] = self._log_ns
        headers["publish_ns"] = np.maximum(plain.block.first_ns, 0)[rows]
        codes = headers.view(np.uint8).reshape(len(headers), HEADER.itemsize)
        text.put(self._data, self._starts + HEADER.itemsize, codes)

    def messages(self, start: int, stop: int) -> Messages:
        """Return the messages of some rows."""
        own = slice(int(self._firsts[start]), int(self._firsts[stop]))
        return Messages(self._data, self._starts[own], self._ends[own], self._channels[own], self._log_ns[own])


def alike(plain: Plain, wanted: Flags | None = None) -> Iterator[tuple[Integers, Lane]]:
    """Yield the rows of lanes that read alike and have frames of one length, with one of these lanes.

    `wanted`: of each row, whether it is; None: all that are plain.
    """
    kinds: dict[tuple[int, bool, int], int] = {}
    numbers = [kinds.setdefault((id(lane.form), lane.is_request, lane.start), len(kinds)) for lane in plain.lanes]
    examples = dict(zip(numbers, plain.lanes, strict=True))
    kind = np.array([*numbers, -1], dtype=np.int64)[plain.lane] + 1
    for number, rows in groups(kind if wanted is None else kind * wanted):
        if number:
            yield rows, examples[number - 1]


#: Pieces of some rows: 0 for their messages, 1 for the states; the rows.
_Part = tuple[int, Integers, list[text.Piece]]


def _tails(plain: Plain, sequences: Integers) -> Iterator[_Part]:
    """Yield the ends of all messages, which are the log's own keys: of requests and of replies."""
    block = plain.block
    is_request = np.array([*(lane.is_request for lane in plain.lanes), False])[plain.lane]
    for rows, reply in ((np.flatnonzero(is_request), False), (np.flatnonzero((plain.lane >= 0) & ~is_request), True)):
        if not len(rows):
            continue
        pieces: list[text.Piece] = [b'","_checksum_ok":true,"_offset":', text.naturals(plain.offsets[rows])]
        if reply:
            pieces += _reply(plain, rows, sequences)
        if isinstance(block, CanBlock):
            pieces += [b',"_can_id":', text.naturals(block.ids[rows])]
            marks = block.directions[rows]
            if marks.any():
                pieces.append(text.of_table(marks, _MARKS))
        yield 0, rows, [*pieces, b"}"]


def _reply(plain: Plain, rows: Integers, sequences: Integers) -> list[text.Piece]:
    latencies = plain.latencies[rows]
    seconds, rest = np.divmod(np.maximum(latencies, 0), _SECOND)
    pieces: list[text.Piece] = [b',"_latency":', text.naturals(seconds), b".", text.fixed_digits(rest, 9)]
    if not (known := latencies > 0).all():
        pieces = [text.only(known, piece) for piece in pieces]
    return [*pieces, b',"_request_sequence":', text.naturals(sequences[rows] - plain.behind[rows])]


def _heads(plain: Plain) -> Iterator[_Part]:
    """Yield the beginnings of all messages, which are the fields of a command and the bytes, and the states that they carry."""
    block, singly = plain.block, plain.lane >= 0
    for rows, places, texts in _few(plain):
        singly[rows] = False
        yield 0, rows, [text.of_table(places, texts)]
    for rows, lane in alike(plain, singly):
        named = lane.form.layout.named
        wire = ColumnCodec(lane.form.layout).wire(block.data[rows, lane.start : lane.stop])
        pieces: list[text.Piece] = [b"{"]
        for name, values in wire.items():
            field = named[name]
            pieces += [f'"{name}":'.encode(), _number(values, field), b","]
            if field.choices is not None:
                pieces += [f'"{name}_name":"'.encode(), text.names(values, field.choice_names), b'",']
        # A code that has one layout has one length.
        size = int(block.sizes[rows[0]])
        yield 0, rows, [*pieces, b'"_raw":"', text.hexadecimal(block.data[rows, :size])]
        if lane.states:
            parts: list[text.Piece] = []
            for quantity, shares in states(lane, wire).items():
                parts += [(b"," if parts else b"{") + f'"{quantity}":'.encode(), text.floats(shares)]
            yield 1, rows, [*parts, b"}"]


def _few(plain: Plain) -> Iterator[tuple[Integers, Integers, list[bytes]]]:
    """Yield the rows of lanes whose frames can have few texts: for each row a place among the texts, and these."""
    lanes, block = plain.lanes, plain.block
    short = np.array([lane.stop - lane.start <= 1 and not lane.states for lane in lanes])
    rows = np.flatnonzero(np.append(short, False)[plain.lane])
    if not len(rows):
        return
    width = block.data.shape[1]
    starts = np.array([min(lane.start, width - 1) for lane in lanes])[plain.lane[rows]]
    known, places = ranks(plain.lane[rows] << 8 | block.data.reshape(-1)[width * rows + starts])
    examples = np.empty(len(known), dtype=np.int64)
    examples[places] = rows
    # Without a checksum, two frames of a lane and a value can still differ.
    same = np.ones(len(rows), dtype=np.bool_)
    for word in words(block.data).T:
        same &= word[rows] == word[examples][places]
    texts = []
    for row, number in zip(examples.tolist(), (known >> 8).tolist(), strict=True):
        data, lane = block.data[row, : block.sizes[row]].tobytes(), lanes[number]
        texts.append(lane.json(data[lane.start : lane.stop]) + b'"_raw":"' + hexlify(data, " ").upper())
    # Texts that are about as wide stand in one table.
    bands = np.array([len(t) // text.ROOM for t in texts])
    for band, own in groups(np.where(same, bands[places] + 1, 0)):
        if band:
            chosen = np.flatnonzero(bands == band - 1)
            number_of = np.zeros(len(texts), dtype=np.int64)
            number_of[chosen] = np.arange(len(chosen))
            yield rows[own], number_of[places[own]], [texts[n] for n in chosen.tolist()]


def _number(values: Integers, field: Field) -> text.Cell:
    shown = physical_column(values, field)
    return text.integers(shown) if shown.dtype == np.int64 else text.floats(shown)


def physical_column(values: Integers, field: Field) -> NDArray[Any]:
    """Return values in the field's unit, as the codec of single frames reckons them."""
    whole = values * field.scale.numerator
    return whole if field.scale.denominator == 1 else whole / field.scale.denominator


def states(lane: Lane, wire: Mapping[str, Integers]) -> dict[str, NDArray[np.float64]]:
    """Return the state that frames of a lane carry, by quantity. `wire`: their fields as sent."""
    parts = [f for f in lane.form.layout.fields if f.state is not None]
    sums: dict[str, NDArray[np.float64]] = {}
    for field in parts:
        assert field.state is not None  # only such fields are parts
        share = physical_column(wire[field.name], field) * float(field.state.factor)
        sums[field.state.quantity] = sums.get(field.state.quantity, 0.0) + share if len(parts) > 1 else share
    return sums
