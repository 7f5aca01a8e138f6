"""Rows: what the pipeline yields, kept in a file without a name until all is known.

What messages of one topic and form have in common is a `Shape` and stands once; a row is what differs. Findings stand in the
row of their message; one that is told later (a request that stayed unanswered) is a row of its own.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import msgspec

from analyzer.catalogue import Command, Dialect, Form, Role
from analyzer.decoder import physical
from analyzer.entries import Entry
from analyzer.records import Comment, Finding, Junk
from analyzer.sources.times import Clock, ShownTime, is_dated
from analyzer.system import sized
from analyzer.table.columns import SLOTS, TWIN, Column, fields_of, reader_of

_BATCH = 1000
_IN_MEMORY = 32 << 20


class Row(msgspec.Struct, array_like=True, gc=False):
    """One message, a piece of junk, or a finding that came later. `shape`: its number."""

    shape: int
    t_ns: int
    address: int | None
    offset: int | None
    sequence: int
    raw: str | None
    values: list[Any]
    checksum_ok: bool | None = None
    latency_ns: int | None = None
    request_sequence: int | None = None
    junk: str | None = None
    rules: list[str] = []
    texts: list[str] = []
    severity: int = 0


@dataclass(frozen=True)
class Shape:
    """What rows have in common. `state`: of each part of the derived state its quantity, its value's place, its factor."""

    topic: str
    bus: str
    dialect: str
    role: str
    command: str
    columns: tuple[Column, ...] = ()
    state: tuple[tuple[str, int, float], ...] = ()


@dataclass
class Recorded:
    """All rows of a capture. Close it when it is no longer needed.

    `begin_ns`: the time of the first row; `first_ns`, `last_ns`: the earliest and the latest. `sound`: shapes of which a row
    passed its checksum. `twins`: text twins that are needed. `about`: what is said of the file as a whole. `folder`: where what
    does not fit in memory waits, None for the system's own.
    """

    stream: IO[bytes]
    shapes: list[Shape] = field(default_factory=list)
    count: int = 0
    size: int = 0
    begin_ns: int = 0
    first_ns: int = 0
    last_ns: int = 0
    comments: int = 0
    dialects: tuple[Dialect, ...] = ()
    sound: set[int] = field(default_factory=set)
    twins: set[str] = field(default_factory=set)
    clock: Clock = Clock.UTC
    times: ShownTime = field(default_factory=ShownTime)
    about: dict[str, str] = field(default_factory=dict)
    folder: Path | None = None

    @property
    def dated(self) -> bool:
        """Whether the times have dates, else they count from some beginning."""
        return self.clock is not Clock.DAY and is_dated(self.first_ns) and is_dated(self.last_ns)

    def columns_of(self, shape: Shape) -> list[Column]:
        """Return the columns of a shape that have values, text twins only where a value needs one."""
        return [c for c in shape.columns if not c.field.endswith(TWIN) or c.field in self.twins]

    def rows(self) -> Iterator[Row]:
        decode = msgspec.msgpack.Decoder(list[Row]).decode
        stream = self.stream
        stream.seek(0)
        while data := sized.take(stream):
            yield from decode(data)

    def position(self) -> int:
        """Return how many of `size` bytes were read."""
        return self.stream.tell()

    def close(self) -> None:
        self.stream.close()


class Rows:
    """A sink that keeps all messages, junk and findings as rows. `folder`: where what does not fit in memory waits."""

    def __init__(self, folder: Path | None = None) -> None:
        # It stays open: what it holds is read until the table is no longer needed.
        stream = tempfile.SpooledTemporaryFile(max_size=_IN_MEMORY, dir=None if folder is None else str(folder))  # noqa: SIM115
        self.recorded = Recorded(stream, folder=folder)
        self._encode = msgspec.msgpack.Encoder().encode
        self._numbers: dict[tuple[str, str, str, int, int], int] = {}
        self._kept: list[tuple[Command | None, Form | None]] = []
        self._readers: dict[int, Callable[[bytes], list[Any]]] = {}
        self._twins: dict[int, list[int]] = {}
        self._rows: list[Row] = []

    # --- sink -----------------------------------------------------------------------------------------------------

    def entry(self, entry: Entry) -> None:
        message, frame, form = entry.message, entry.message.frame, entry.message.form
        key = (entry.topic, frame.dialect.name, message.role, id(message.command), id(form))
        number = self._numbers.get(key)
        if number is None:
            number = self._numbers[key] = self._shape_of(entry)
            self._kept.append((message.command, form))  # so that no other gets their ids
        values: list[Any] = []
        if form is not None and message.command is not None:
            if message.command.slots is not None:
                values = [msgspec.json.encode(physical(message)["slots"]).decode()]
            else:
                values = self._readers[number](message.data)
                for place in self._twins[number]:
                    if values[place] is not None:
                        self.recorded.twins.add(self.recorded.shapes[number].columns[place].field)
        if frame.checksum_ok:
            self.recorded.sound.add(number)
        self._add(
            Row(
                number,
                frame.last_ns,
                message.address,
                frame.offset,
                entry.sequence,
                frame.data.hex(" ").upper(),
                values,
                None if message.role is Role.FOREIGN else frame.checksum_ok,
                entry.latency_ns if entry.request_sequence is not None else None,
                entry.request_sequence,
            )
        )

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        number = self._plain_shape(topic, junk.port, "junk")
        raw = junk.data.hex(" ").upper()
        self._add(Row(number, junk.last_ns, None, junk.offset, sequence, raw, [], junk=junk.reason.value))

    def finding(self, found: Finding) -> None:
        """Keep a finding: in the row of its message, if that was the last one."""
        row = self._rows[-1] if self._rows else None
        if row is None or row.sequence != found.sequence or found.sequence == 0:
            number = self._plain_shape(found.topic, found.port, "finding")
            row = Row(number, found.last_ns, found.address, found.offset, found.sequence, None, [])
            self._add(row)
        row.rules = [*row.rules, found.rule]
        row.texts = [*row.texts, found.text]
        row.severity = max(row.severity, found.severity.rank)

    def comment(self, comment: Comment) -> None:
        self.recorded.comments += 1

    def finish(self) -> Recorded:
        self._write(self._rows)
        self._rows = []
        self.recorded.size = self.recorded.stream.tell()
        return self.recorded

    # --- shapes -----------------------------------------------------------------------------------------------------

    def _shape_of(self, entry: Entry) -> int:
        message, frame, form, command = entry.message, entry.message.frame, entry.message.form, entry.message.command
        columns: tuple[Column, ...] = ()
        state: tuple[tuple[str, int, float], ...] = ()
        if form is not None and command is not None:
            columns = (SLOTS,) if command.slots is not None else fields_of(frame.dialect, command, form)
            state = _state_parts(form, columns) if message.role is Role.REPLY else ()
            number = len(self.recorded.shapes)
            self._readers[number] = reader_of(form)
            self._twins[number] = [n for n, column in enumerate(columns) if column.field.endswith(TWIN)]
        name = command.name if command is not None else ""
        dialect = "" if message.role is Role.FOREIGN else frame.dialect.name
        shape = Shape(entry.topic, frame.port, dialect, message.role.value, name, columns, state)
        self.recorded.shapes.append(shape)
        return len(self.recorded.shapes) - 1

    def _plain_shape(self, topic: str, bus: str, role: str) -> int:
        key = (topic, bus, role, 0, 0)
        number = self._numbers.get(key)
        if number is None:
            number = self._numbers[key] = len(self.recorded.shapes)
            self.recorded.shapes.append(Shape(topic, bus, "", role, topic.split("/")[3] if topic.count("/") == 4 else ""))
        return number

    # --- the file ---------------------------------------------------------------------------------------------------

    def _add(self, row: Row) -> None:
        recorded = self.recorded
        if not recorded.count:
            recorded.begin_ns = recorded.first_ns = recorded.last_ns = row.t_ns
        recorded.first_ns = min(recorded.first_ns, row.t_ns)
        recorded.last_ns = max(recorded.last_ns, row.t_ns)
        recorded.count += 1
        if len(self._rows) >= _BATCH:
            self._write(self._rows)
            self._rows = []
        self._rows.append(row)

    def _write(self, rows: list[Row]) -> None:
        sized.put(self.recorded.stream, self._encode(rows))


def _state_parts(form: Form, columns: tuple[Column, ...]) -> tuple[tuple[str, int, float], ...]:
    places = {column.field: place for place, column in enumerate(columns)}
    parts = [(f.state.quantity, places[f.name], f.state.factor) for f in form.layout.named.values() if f.state is not None]
    return tuple(parts)
