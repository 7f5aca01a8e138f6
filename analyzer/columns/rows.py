"""The plain frames of a block as messages of a log: for each its fields, and behind a reply the state that it carries.

    | header | fields as JSON, padded | header | state as JSON, padded |     one row a frame

A row is as wide as the widest. Zeros in the text are padding and are taken out, so the rows follow each other as in a file.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analyzer.catalogue import Role
from analyzer.columns import text
from analyzer.columns.block import DIRECTIONS
from analyzer.columns.codec import Bytes, ColumnCodec, Flags, Integers
from analyzer.columns.groups import groups
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
    """Messages as they stand in a chunk. `ends`: where each ends in `data`; `channels`, `log_ns`: likewise one entry each."""

    data: Bytes
    ends: Integers
    channels: Integers
    log_ns: Integers


class Rows:
    """The messages of a block's plain frames, made once for all of them and given out by runs.

    `channels`: of each lane that is used, that of its topic and that of its state, 0 where it has none.
    """

    def __init__(self, plain: Plain, channels: Integers) -> None:
        self.plain = plain
        self._channels = channels
        count, head = len(plain.lane), HEADER.itemsize
        groups = list(alike(plain))
        cells = [(rows, _fields(plain, rows, lane), _state(plain, rows, lane)) for rows, lane in groups]
        # Both parts end where a word does, so that the bytes kept in them can be counted by words.
        self._second_head = _whole_words(head + max((own.shape[1] for _, own, _ in cells), default=0))
        width = self._second_head + _whole_words(head + max((state.shape[1] for _, _, state in cells), default=0))
        self._rows = np.zeros((count, width), dtype=np.uint8)
        self._has_state = np.zeros(count, dtype=np.bool_)
        for places, own, state in cells:
            self._rows[places, head : head + own.shape[1]] = own
            self._rows[places, self._second_head + head : self._second_head + head + state.shape[1]] = state
            self._has_state[places] = state.shape[1] > 0
        self._kept: Flags = self._rows != 0
        self._kept[:, :head] = True
        self._kept[:, self._second_head : self._second_head + head] = self._has_state[:, None]
        #: Bytes of the messages in each row.
        self._sizes = np.stack((_sizes(self._kept[:, : self._second_head]), _sizes(self._kept[:, self._second_head :])), axis=1)

    def messages(self, start: int, stop: int, log_ns: Integers) -> Messages:
        """Return the messages of some rows. `log_ns`: of each row, rising."""
        plain, head = self.plain, HEADER.itemsize
        rows, has_state, sizes = self._rows[start:stop], self._has_state[start:stop], self._sizes[start:stop]
        channels = self._channels[plain.lane[start:stop]]
        for place, at in enumerate((0, self._second_head)):
            headers = np.zeros(stop - start, dtype=HEADER)
            headers["opcode"] = _MESSAGE
            headers["length"] = sizes[:, place] - _UNCOUNTED
            headers["channel"] = channels[:, place]
            headers["sequence"] = np.arange(plain.first + start, plain.first + stop) & 0xFFFFFFFF
            headers["log_ns"] = log_ns
            headers["publish_ns"] = np.maximum(plain.block.t_ns[start:stop], 0)
            rows[:, at : at + head] = headers.view(np.uint8).reshape(stop - start, head)
        there = np.stack((np.ones(stop - start, dtype=np.bool_), has_state), axis=1)
        return Messages(
            rows[self._kept[start:stop]], np.cumsum(sizes[there]), channels[there],
            np.repeat(log_ns[:, None], 2, axis=1)[there],
        )  # fmt: skip


def _whole_words(size: int) -> int:
    return -(-size // 8) * 8


def _sizes(kept: Flags) -> Integers:
    """Return how many bytes of each row are kept, by words: their bytes are 0 or 1 and a row has at most 255 words."""
    words = kept.view(np.uint64).sum(axis=1)
    low, one = np.uint64(0x00FF00FF00FF00FF), np.uint64(0x0001000100010001)
    result: Integers = ((((words & low) + (words >> np.uint64(8) & low)) * one) >> np.uint64(48)).astype(np.int64)
    return result


def alike(plain: Plain) -> Iterator[tuple[Integers, Lane]]:
    """Yield the rows of lanes that read alike and have frames of one length, with one of these lanes."""
    kinds: dict[tuple[int, bool, int], int] = {}
    numbers = [kinds.setdefault((id(lane.form), lane.is_request, lane.start), len(kinds)) for lane in plain.lanes]
    examples = dict(zip(numbers, plain.lanes, strict=True))
    kind = np.array([*numbers, -1], dtype=np.int64)[plain.lane] + 1
    for number, rows in groups(kind):
        if number:
            yield rows, examples[number - 1]


def _fields(plain: Plain, rows: Integers, lane: Lane) -> Bytes:
    """Return the fields of some rows as JSON, with the log's own keys."""
    block = plain.block
    named = lane.form.layout.named
    pieces: list[Bytes | bytes] = [b"{"]
    for name, values in ColumnCodec(lane.form.layout).wire(block.data[rows, lane.start : lane.stop]).items():
        field = named[name]
        pieces += [f'"{name}":'.encode(), _number(values, field), b","]
        if field.choices is not None:
            pieces += [f'"{name}_name":"'.encode(), text.names(values, field.choice_names), b'",']
    # A code that has one layout has one length.
    size = int(block.sizes[rows[0]])
    pieces += [b'"_raw":"', text.hexadecimal(block.data[rows, :size]), b'","_checksum_ok":true,"_offset":']
    pieces.append(text.naturals(plain.offsets[rows]))
    if not lane.is_request:
        pieces += _reply(plain, rows)
    pieces += [b',"_can_id":', text.naturals(block.ids[rows])]
    marks = block.directions[rows]
    if marks.any():
        pieces.append(text.of_table(marks, _MARKS))
    return text.joined([*pieces, b"}"], len(rows))


def _number(values: Integers, field: Field) -> Bytes:
    shown = physical_column(values, field)
    return text.integers(shown) if shown.dtype == np.int64 else text.floats(shown)


def physical_column(values: Integers, field: Field) -> NDArray[Any]:
    """Return values in the field's unit, as the codec of single frames reckons them."""
    whole = values * field.scale.numerator
    return whole if field.scale.denominator == 1 else whole / field.scale.denominator


def _reply(plain: Plain, rows: Integers) -> list[Bytes | bytes]:
    latencies = plain.latencies[rows]
    known = latencies > 0
    seconds, rest = np.divmod(np.maximum(latencies, 0), _SECOND)
    cell = text.joined([b',"_latency":', text.naturals(seconds), b".", text.fixed_digits(rest, 9)], len(rows))
    if not known.all():
        cell[~known] = 0
    return [cell, b',"_request_sequence":', text.naturals(plain.first + rows - 1)]


def _state(plain: Plain, rows: Integers, lane: Lane) -> Bytes:
    """Return the state that some rows carry as JSON, without columns where they carry none."""
    if not lane.states:
        return np.zeros((len(rows), 0), dtype=np.uint8)
    pieces: list[Bytes | bytes] = []
    for quantity, values in states(plain, rows, lane).items():
        pieces += [(b"," if pieces else b"{") + f'"{quantity}":'.encode(), text.floats(values)]
    return text.joined([*pieces, b"}"], len(rows))


def states(plain: Plain, rows: Integers, lane: Lane) -> dict[str, NDArray[np.float64]]:
    """Return the state that some rows carry, by quantity."""
    wire = ColumnCodec(lane.form.layout).wire(plain.block.data[rows, lane.start : lane.stop])
    parts = [f for f in lane.form.layout.fields if f.state is not None]
    sums: dict[str, NDArray[np.float64]] = {}
    for field in parts:
        assert field.state is not None  # only such fields are parts
        share = physical_column(wire[field.name], field) * float(field.state.factor)
        sums[field.state.quantity] = sums.get(field.state.quantity, 0.0) + share if len(parts) > 1 else share
    return sums
