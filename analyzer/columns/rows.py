"""The plain frames of a block as messages of a log: for each its fields, and behind a reply the state that it carries.

    | header | fields as JSON | the log's own keys | header | state as JSON |     one row a frame

How long each row is stands fixed first. Then the texts of rows that are alike are written to their places, as they stand in a
chunk of the log.
"""

from __future__ import annotations

from binascii import hexlify
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from operator import attrgetter
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from analyzer.catalogue import Role
from analyzer.codec import Codec
from analyzer.columns import text
from analyzer.columns.block import DIRECTIONS, CanBlock
from analyzer.columns.codec import Bytes, Flags, Integers, column_codec
from analyzer.columns.groups import groups, ranks, taken, words
from analyzer.columns.plain import Plain
from analyzer.framer import JUMP_BACK_NS
from analyzer.layout import Field
from analyzer.records import Lane

HEADER = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log_ns", "<u8"), ("publish_ns", "<u8")]
)
_SECOND = 1_000_000_000
#: Groups of lanes, and what is asked of each, that are kept.
_GROUPS = 64
_MESSAGE = 5
#: Of a header, the bytes that its length does not count: opcode and length.
_UNCOUNTED = 9
_MARKS = [b"" if role is Role.UNKNOWN else f',"_direction":"{role}"'.encode() for role in DIRECTIONS]


class Messages(msgspec.Struct, frozen=True, eq=False):
    """Messages as they stand in a chunk, of which the arrays have one entry each. `ends`: places in `data`.

    `entries`: of shape (messages, 2), times and where they begin in `data`.
    """

    data: Bytes
    ends: Integers
    channels: NDArray[np.uint16]
    entries: Integers


class Rows:
    """The messages of a block's plain frames, made once for all of them and given out by runs.

    `channels`: of each lane that is used, that of its topic and that of its state, 0 where it has none. `sequences`, `log_ns`:
    of each row, the number and the time of its messages; the times rise. `gaps`: bytes that stand before the messages of some
    rows, by row: for messages that are made elsewhere.
    """

    def __init__(
        self, plain: Plain, channels: Integers, sequences: Integers, log_ns: Integers, gaps: Mapping[int, int] | None = None
    ) -> None:
        self.plain = plain
        count = len(plain.lane)
        each = of_lanes(plain, _messages, 0)
        #: Where the messages of each row begin among all: its own, and behind it the state that it carries.
        self._firsts = np.zeros(count + 1, dtype=np.int64)
        np.cumsum(each, out=self._firsts[1:])
        rows = np.repeat(np.arange(count), each)
        carried: list[_Part] = []
        parts = [*_tails(plain, sequences, log_ns), *_heads(plain, carried)]
        sizes = np.zeros(count, dtype=np.int64)
        for own, pieces in parts:
            sizes[own] += text.width(pieces)
        lengths = sizes.take(rows)
        for own, pieces in carried:
            lengths[self._firsts.take(own) + 1] = text.width(pieces)
        room = lengths + HEADER.itemsize
        for row, size in (gaps or {}).items():
            room[self._firsts[row]] += size
        self._ends = np.cumsum(room)
        places = 2 * plain.lane.take(rows) + (np.arange(len(rows)) - self._firsts.take(rows))
        self._channels = channels.reshape(-1).astype(np.uint16).take(places)
        self._entries = np.empty((len(rows), 2), dtype=np.int64)
        logged = self._entries[:, 0] = log_ns.take(rows)
        np.subtract(self._ends, lengths + HEADER.itemsize, out=self._entries[:, 1])
        headers = np.empty(len(rows), dtype=HEADER)
        headers["opcode"] = _MESSAGE
        headers["length"] = lengths + (HEADER.itemsize - _UNCOUNTED)
        headers["channel"] = self._channels
        headers["sequence"] = (sequences & 0xFFFFFFFF).take(rows)
        headers["log_ns"] = logged
        first_ns = plain.block.first_ns
        headers["publish_ns"] = logged if first_ns is log_ns else np.maximum(first_ns, 0).take(rows)
        codes = headers.view(np.uint8).reshape(len(headers), HEADER.itemsize)
        self._data = np.empty(int(self._ends[-1]), dtype=np.uint8)
        # From the right to the left: the ends of all messages, then their beginnings, then their headers.
        ends = self._ends.take(self._firsts[:-1], mode="clip")
        for own, pieces in parts:
            ends[own] = text.place(self._data, ends.take(own), pieces)
        for own, pieces in carried:
            text.place(self._data, self._ends.take(self._firsts.take(own) + 1), pieces)
        text.put(self._data, self._entries[:, 1] + HEADER.itemsize, codes)

    def fill(self, row: int, messages: bytes) -> tuple[Bytes, int]:
        """Write messages into the gap before a row that was not given out yet. Return what they stand in, and where."""
        start = int(self._entries[self._firsts[row], 1]) - len(messages)
        self._data[start : start + len(messages)] = np.frombuffer(messages, dtype=np.uint8)
        return self._data, start

    def messages(self, start: int, stop: int) -> Messages:
        """Return the messages of some rows."""
        own = slice(int(self._firsts[start]), int(self._firsts[stop]))
        return Messages(self._data, self._ends[own], self._channels[own], self._entries[own])


def alike(plain: Plain, numbers: Integers, wanted: Flags) -> Iterator[tuple[Integers, Lane]]:
    """Yield the rows of lanes that have the same number and frames of one length, with one of these lanes.

    `numbers`: of each lane, above 0, and behind them 0; `wanted`: of each row, whether it is.
    """
    for _, rows in groups(numbers.take(plain.lane, mode="wrap") * wanted):
        yield rows, plain.lanes[plain.lane[rows[0]]]


def of_lanes(plain: Plain, what: Callable[[Lane], Any], other: Any) -> NDArray[Any]:
    """Return for each row what its lane has. `other`: for rows without a lane, whose number is -1."""
    return _each(plain.lanes, what, other).take(plain.lane, mode="wrap")


@lru_cache(maxsize=_GROUPS)
def _each(lanes: tuple[Lane, ...], what: Callable[[Lane], Any], other: Any) -> NDArray[Any]:
    """Return what each lane has, and `other` behind them. It is kept, since most blocks have the lanes of the block before."""
    return np.array([*map(what, lanes), other])


def _messages(lane: Lane) -> int:
    return 1 + lane.states


def _has_few(lane: Lane) -> bool:
    """Say whether frames can have few texts."""
    return lane.stop - lane.start <= 1 and not lane.states


def _reading(lane: Lane) -> int:
    """Return a number that is the same where the same fields stand at the same places."""
    return 1 + lane.states + 2 * column_codec(lane.form.layout, lane.start).reading


_START, _IS_REQUEST = attrgetter("start"), attrgetter("is_request")


#: Rows, and pieces of their messages.
_Part = tuple[Integers, list[text.Piece]]


def _heads(plain: Plain, carried: list[_Part]) -> Iterator[_Part]:
    """Yield the beginnings of all messages: the fields of a command and its bytes. Add the states to `carried`."""
    left = plain.lane >= 0
    for rows, table in _few(plain):
        left[rows] = False
        yield rows, [table]
    for rows, lane in alike(plain, _each(plain.lanes, _reading, 0), left):
        data = taken(plain.block.data, rows)
        wire = column_codec(lane.form.layout, lane.start).wire(data)
        named = lane.form.layout.named
        pieces: list[text.Piece] = [b"{"]
        numbers: dict[str, list[text.Piece]] = {}
        for name, values in wire.items():
            field = named[name]
            numbers[name] = _number(values, field)
            pieces += [f'"{name}":'.encode(), *numbers[name], b","]
            if field.choices is not None:
                pieces += [f'"{name}_name":"'.encode(), text.names(values, field.choice_names), b'",']
        # A code that has one layout has one length.
        size = int(plain.block.sizes[rows[0]])
        yield rows, [*pieces, b'"_raw":"', text.hexadecimal(data, size)]
        if lane.states:
            parts: list[text.Piece] = []
            for quantity, shares in states(lane, wire).items():
                parts += [(b"," if parts else b"{") + f'"{quantity}":'.encode(), *_state(lane, quantity, shares, numbers)]
            carried.append((rows, [*parts, b"}"]))


def _tails(plain: Plain, sequences: Integers, log_ns: Integers) -> Iterator[_Part]:
    """Yield the ends of all messages, which are the log's own keys: those of requests, and those of replies.

    `sequences`: of each row; replies tell the numbers of their requests. `log_ns`: where the clock was set back, later than
    the row's own time.
    """
    block = plain.block
    backward_ns = np.where(block.t_ns < log_ns - JUMP_BACK_NS, log_ns - block.t_ns, 0)
    asks = of_lanes(plain, _IS_REQUEST, False)
    for rows, is_request in ((np.flatnonzero(asks), True), (np.flatnonzero((plain.lane >= 0) & ~asks), False)):
        if not len(rows):
            continue
        pieces: list[text.Piece] = [b'","_checksum_ok":true,"_offset":', text.integers(plain.offsets.take(rows))]
        own_ns = backward_ns.take(rows)
        if own_ns.any():
            pieces += [text.only(own_ns > 0, piece) for piece in (b',"_backward_ns":', text.integers(own_ns))]
        if not is_request:
            pieces += _reply(plain, rows, sequences)
        if isinstance(block, CanBlock):
            pieces += [b',"_can_id":', text.integers(block.ids.take(rows))]
            marks = block.directions.take(rows)
            if marks.any():
                pieces.append(text.of_table(marks, _MARKS))
        yield rows, [*pieces, b"}"]


def _reply(plain: Plain, rows: Integers, sequences: Integers) -> list[text.Piece]:
    latencies = plain.latencies.take(rows)
    seconds, rest = np.divmod(np.maximum(latencies, 0), _SECOND)
    pieces: list[text.Piece] = [b',"_latency":', text.integers(seconds), b".", text.fixed_digits(rest, 9)]
    if not (known := latencies > 0).all():
        pieces = [text.only(known, piece) for piece in pieces]
    return [*pieces, b',"_request_sequence":', text.integers(sequences.take(rows) - plain.behind.take(rows))]


def _few(plain: Plain) -> Iterator[tuple[Integers, text.Cell]]:
    """Yield rows of lanes whose frames can have few texts, and the beginnings of their messages, as far as the bytes."""
    lanes, block = plain.lanes, plain.block
    rows = np.flatnonzero(of_lanes(plain, _has_few, False))
    if not len(rows):
        return
    width, numbers = block.data.shape[1], plain.lane.take(rows)
    starts = np.minimum(_each(lanes, _START, 0), width - 1).take(numbers)
    known, places = ranks(numbers << 8 | block.data.reshape(-1).take(width * rows + starts))
    examples = np.empty(len(known), dtype=np.int64)
    examples[places] = rows
    # Without a checksum, two frames of a lane and a value can still differ.
    same = np.ones(len(rows), dtype=np.bool_)
    for word in words(block.data).T:
        same &= word.take(rows) == word.take(examples).take(places)
    whole, sizes = block.data.take(examples, axis=0).tobytes(), block.sizes.take(examples).tolist()
    texts = [
        _head(lane.codec, lane.start, lane.stop, whole[at : at + size])
        for lane, at, size in zip(
            map(lanes.__getitem__, (known >> 8).tolist()), range(0, len(whole), width), sizes, strict=True
        )
    ]
    # Texts that are about as wide stand in one table.
    kinds = 1 + np.array([len(each) for each in texts]) // text.ROOM
    for kind, own in groups(kinds.take(places) * same):
        chosen = np.flatnonzero(kinds == kind)
        number_of = np.zeros(len(kinds), dtype=np.int64)
        number_of[chosen] = np.arange(len(chosen))
        table = text.of_table(number_of.take(places.take(own)), [texts[n] for n in chosen.tolist()])
        yield rows.take(own), table


@lru_cache(maxsize=1 << 14)
def _head(codec: Codec, start: int, stop: int, data: bytes) -> bytes:
    """Return the text of a frame as far as its bytes."""
    return codec.json(data[start:stop]) + b'"_raw":"' + hexlify(data, " ").upper()


def _number(values: Integers, field: Field) -> list[text.Piece]:
    shown = physical_column(values, field)
    return [text.integers(shown)] if shown.dtype == np.int64 else text.floats(shown)


def _state(lane: Lane, quantity: str, shares: NDArray[np.float64], numbers: Mapping[str, list[text.Piece]]) -> list[text.Piece]:
    """Return a quantity of some rows as text. `numbers`: their fields as text."""
    own = [f for f in lane.form.layout.fields if f.state is not None and f.state.quantity == quantity]
    if len(own) > 1 or own[0].state is None or own[0].state.factor != 1 or own[0].scale.numerator != 1:
        return text.floats(shares)
    # It is the field itself, but a number that is no integer.
    return numbers[own[0].name] if own[0].scale.denominator != 1 else [*numbers[own[0].name], b".0"]


def physical_column(values: Integers, field: Field) -> NDArray[Any]:
    """Return values in the field's unit, as the codec of single frames reckons them."""
    whole = values if field.scale.numerator == 1 else values * field.scale.numerator
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
