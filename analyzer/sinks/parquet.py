"""Tables of a capture as Parquet files in one folder: a sink with the values of the log, under the same names.

    mks-can.read_speed.reply.parquet    a table for each dialect, command and role
    unknown, foreign, junk              frames without a command, of other nodes; bytes that are no frame
    states                              position, speed, ... of the drives, in the same units for every dialect
    findings, comments, events          what was found, said and happened
    metadata                            what stands in the metadata of a log, as names and values

Times are timestamps in nanoseconds, names of choices dictionaries. Unit, section and manual are metadata of the columns. Plain
frames of a block become columns at once; all others become rows, and each table is in the order of its sequence numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise, takewhile
from typing import TYPE_CHECKING, Any, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from analyzer import events
from analyzer.catalogue import Command, Dialect, Role
from analyzer.columns.block import DIRECTIONS, CanBlock
from analyzer.columns.codec import Flags, Integers, column_codec
from analyzer.columns.groups import taken
from analyzer.columns.plain import Plain
from analyzer.columns.rows import alike, physical_column, states
from analyzer.decoder import physical, state_of
from analyzer.entries import Entry, plain_entry
from analyzer.layout import STATE_UNITS, Field, FieldKind
from analyzer.port import topic_name
from analyzer.records import Comment, Event, Finding, Frame, Junk, Lane
from analyzer.sinks.schemas import forms_of
from analyzer.sources.times import Clock
from analyzer.system.own_process import without
from analyzer.table.extras import needed
from analyzer.values import SECOND_NS

if TYPE_CHECKING:
    import pyarrow

#: Rows of all tables that are held, and that stand together in the files. A row that was taken alone needs more room.
HELD = 1 << 17
_ALONE = 8
#: Places at which rows that were taken one by one part those of blocks; with more of them, all rows are copied in their order.
_MOST_CUTS = 64
#: Bits beyond which a number needs a sign's place.
_LONG = 64


class Target(Protocol):
    """What takes the rows of one table, some at a time and in order."""

    def write(self, rows: pyarrow.Table) -> None:
        """Take the next rows."""

    def close(self) -> None:
        """Take the end of the table; a table may have no rows."""


class _Table:
    """A table: rows that were taken one by one, columns of many, and what both go to."""

    def __init__(self, target: Target, schema: pyarrow.Schema, choices: Mapping[str, Field]) -> None:
        self.schema = schema
        self.choices = choices
        #: NumPy's types of the columns that are numbers.
        self.numbers = {f.name: f.type.to_pandas_dtype() for f in schema if str(f.type).startswith(("int", "uint", "double"))}
        self.rows: list[dict[str, Any]] = []
        self._target = target
        self._batches: list[pyarrow.Table] = []
        #: Of the last of many rows, the number; whether all of them rise so far.
        self._last, self._rises = 0, True
        #: Rows that were taken together.
        self.many = 0

    def add(self, columns: Mapping[str, Any], sequences: Integers) -> None:
        """Take many rows in their order, with their numbers; a column that is not given is empty."""
        pa, count = needed("pyarrow"), len(sequences)
        arrays = [columns[f.name] if f.name in columns else pa.nulls(count, f.type) for f in self.schema]
        self._batches.append(pa.Table.from_arrays(arrays, schema=self.schema))
        self._rises &= bool(self._last < sequences[0])
        self._last, self.many = int(sequences[-1]), self.many + count

    @property
    def held(self) -> int:
        """How many rows are held; one that was taken alone needs the room of some others."""
        return self.many + _ALONE * len(self.rows)

    def wait(self) -> None:
        """Copy what is held: as it came, it is a part of columns that stay as long as it does."""
        if len(self._batches) > 1:
            self._batches = [needed("pyarrow").concat_tables(self._batches).combine_chunks()]

    def write(self) -> None:
        pa = needed("pyarrow")
        alone = [pa.Table.from_pylist(self.rows, schema=self.schema)] if self.rows else []
        if not self._batches and not alone:
            return
        held = pa.concat_tables([*self._batches, *alone])
        if self._batches and (alone or not self._rises):
            held = self._ordered(held, len(self.rows))
        self.rows.clear()
        self._batches.clear()
        self._last, self._rises, self.many = 0, True, 0
        self._target.write(held)

    @staticmethod
    def _ordered(held: pyarrow.Table, alone: int) -> pyarrow.Table:
        """Return rows in the order of their numbers; so many at the end were taken one by one."""
        pa = needed("pyarrow")
        sequences = held["sequence"].to_numpy()
        many = len(sequences) - alone
        places, firsts = np.unique(sequences[:many].searchsorted(sequences[many:]), return_index=True)
        if len(places) > _MOST_CUTS or (np.diff(sequences[:many]) < 0).any():
            return held.take(pa.array(np.argsort(sequences, kind="stable")))
        # Few rows between many: no row has to be copied.
        parts, at = [], 0
        for place, (start, stop) in zip(places.tolist(), pairwise([*firsts.tolist(), alone]), strict=True):
            parts += [held.slice(at, place - at), held.slice(many + start, stop - start)]
            at = place
        return pa.concat_tables([*parts, held.slice(at, many - at)])

    def close(self) -> None:
        self.write()
        self._target.close()


#: Rows, and their own columns as numbers.
_Part = tuple[Integers, Mapping[str, NDArray[Any]]]
#: Columns as numbers, each with which of them count as none.
_Own = Mapping[str, tuple[NDArray[Any], Flags | None]]
#: What makes columns of some rows, which have these numbers.
_Shared = Callable[[Plain, Integers, Integers], dict[str, "pyarrow.Array"]]


def _merged(parts: Sequence[_Part]) -> tuple[Integers, _Own]:
    """Return the rows of some parts in their order, and their columns; a part need not have all."""
    rows, columns = parts[0]
    if len(parts) == 1:
        return rows, {name: (values, None) for name, values in columns.items()}
    rows = np.sort(np.concatenate([own for own, _ in parts]))
    merged: dict[str, tuple[NDArray[Any], Flags]] = {}
    for own, columns in parts:
        at = rows.searchsorted(own)
        for name, values in columns.items():
            whole, missing = merged.setdefault(name, (np.zeros(len(rows), values.dtype), np.ones(len(rows), np.bool_)))
            whole[at], missing[at] = values, False
    return rows, merged


class ParquetTables:
    """A sink that makes tables. `target`: gives what takes a table, by its name and schema; `clock`: what the times are."""

    def __init__(self, target: Callable[[str, pyarrow.Schema], Target], clock: Clock = Clock.UTC) -> None:
        pa = self._pa = needed("pyarrow")
        with without("pandas"):
            # With its first array, pyarrow looks once for pandas.
            pa.array([0])
        self._target = target
        self._time = pa.timestamp("ns", "UTC" if clock is Clock.UTC else None)
        self._tables: dict[str, _Table] = {}
        self._plain: Plain | None = None
        #: Runs that were taken of the block, and the sequence number of the first frame of each.
        self._taken: list[tuple[int, int, int]] = []
        #: Blocks that are held, each with the sequence numbers of its rows, 0 where one is in no run.
        self._blocks: list[tuple[Plain, Integers]] = []
        self._held = 0

    # --- frames by columns ----------------------------------------------------------------------------------------

    def begin(self, plain: Plain) -> None:
        self._hold()
        if self._held >= HELD:
            self._write()
        self._plain = plain

    def run(self, start: int, stop: int, sequence: int) -> None:
        self._taken.append((start, stop, sequence))

    def _hold(self) -> None:
        """Hold what was taken of the block."""
        plain = self._plain
        if plain is not None and self._taken:
            sequences = np.zeros(len(plain.lane), dtype=np.int64)
            for start, stop, sequence in self._taken:
                sequences[start:stop] = np.arange(sequence, sequence + stop - start)
                self._held += stop - start
            self._blocks.append((plain, sequences))
        self._taken = []

    def _write(self) -> None:
        """Give all that is held to the tables, and have the longest written."""
        blocks, self._blocks = self._blocks, []
        while blocks:
            count = sum(1 for _ in takewhile(lambda each: each[0].joins == blocks[0][0].joins, blocks))
            joined = Plain.joined([plain for plain, _ in blocks[:count]])
            sequences = np.concatenate([numbers for _, numbers in blocks[:count]])
            # What is joined is held no more.
            del blocks[:count]
            self._settle(joined, sequences)
        # Short tables wait for more rows: each that is written costs about as much as some thousand rows.
        tables = sorted(self._tables.values(), key=lambda table: -table.held)
        held = sum(table.held for table in tables)
        for table in tables:
            if held > HELD // 2:
                held -= table.held
                table.write()
            else:
                table.wait()
        self._held = 0

    def _settle(self, plain: Plain, sequences: Integers) -> None:
        """Give the rows of a block that have a number to their tables."""
        keys: dict[object, int] = {}
        numbers = [keys.setdefault((id(lane.form), lane.is_request, lane.start), 1 + len(keys)) for lane in plain.lanes]
        kinds: dict[str, list[tuple[Integers, Lane]]] = {}
        for rows, lane in alike(plain, np.array([*numbers, 0]), sequences > 0):
            kinds.setdefault(f"{lane.command.name}.{lane.role}", []).append((rows, lane))
        carried: list[_Part] = []
        parts = [self._read(plain, each, carried) for each in kinds.values()]
        self._give(parts, plain, sequences, self._framed)
        if carried:
            self._give([(self._states(), *_merged(carried))], plain, sequences, self._placed)

    def _give(self, parts: Sequence[tuple[_Table, Integers, _Own]], plain: Plain, sequences: Integers, shared: _Shared) -> None:
        """Give rows and their own columns to tables. `shared`: makes what all have, of which each table takes a part."""
        order = np.concatenate([rows for _, rows, _ in parts])
        numbers, at = sequences.take(order), 0
        columns = shared(plain, order, numbers)
        for table, rows, own in parts:
            count = len(rows)
            parted = {name: column.slice(at, count) for name, column in columns.items()}
            table.add(parted | {name: self._column(table, name, *each) for name, each in own.items()}, numbers[at : at + count])
            at += count

    def _placed(self, plain: Plain, rows: Integers, numbers: Integers) -> dict[str, pyarrow.Array]:
        """Return the columns that all tables have. `numbers`: of the rows."""
        block = plain.block
        addresses = np.array([lane.address for lane in plain.lanes]).take(plain.lane.take(rows))
        return {
            "time": self._numbers(block.t_ns.take(rows)).view(self._time),
            "bus": self._pa.repeat(topic_name(block.port), len(rows)),
            "address": self._numbers(addresses),
            "sequence": self._numbers(numbers),
        }

    def _framed(self, plain: Plain, rows: Integers, numbers: Integers) -> dict[str, pyarrow.Array]:
        """Return the columns that all frames have; those of replies are of no meaning for requests."""
        pa, block, count = self._pa, plain.block, len(rows)
        sizes, whole = block.sizes.take(rows), taken(block.data, rows)
        stops = np.zeros(count + 1, dtype=np.int32)
        sizes.cumsum(dtype=np.int32, out=stops[1:])
        data = whole[np.arange(whole.shape[1]) < sizes[:, None]]
        latencies = plain.latencies.take(rows)
        columns = {
            **self._placed(plain, rows, numbers),
            "_raw": pa.Array.from_buffers(pa.binary(), count, [None, pa.py_buffer(stops), pa.py_buffer(data)]),
            "_checksum_ok": pa.repeat(True, count),
            "_offset": self._numbers(plain.offsets.take(rows)),
            "_latency": self._numbers(latencies / SECOND_NS, latencies <= 0),
            "_request_sequence": self._numbers(numbers - plain.behind.take(rows)),
        }
        if isinstance(block, CanBlock):
            columns["_can_id"] = self._numbers(block.ids.take(rows).astype(np.int64))
            marks = block.directions.take(rows)
            if marks.any():
                names = pa.array([None if role is Role.UNKNOWN else role.value for role in DIRECTIONS])
                columns["_direction"] = names.take(pa.array(marks))
        return columns

    def _read(
        self, plain: Plain, kinds: Sequence[tuple[Integers, Lane]], carried: list[_Part]
    ) -> tuple[_Table, Integers, _Own]:
        """Return a table, its rows, and their fields, of each kind that reads in its own way. Add the states to `carried`."""
        lane = kinds[0][1]
        table = self._command(plain.dialect, lane.command, lane.role)
        parts: list[_Part] = []
        for rows, each in kinds:
            layout = each.form.layout
            wire = column_codec(layout, each.start).wire(taken(plain.block.data, rows))
            # What pyarrow casts by would have to be loaded.
            fields = {
                name: physical_column(values, layout.named[name]).astype(table.numbers[name], copy=False)
                for name, values in wire.items()
            }
            parts.append((rows, fields | {f"{name}_name": wire[name] for name in wire.keys() & table.choices}))
            if each.states:
                carried.append((rows, states(each, wire)))
        return table, *_merged(parts)

    def _column(self, table: _Table, name: str, values: NDArray[Any], missing: Flags | None) -> pyarrow.Array:
        """Return a table's own column: numbers, or the names of choices."""
        field = None if name in table.numbers else table.choices.get(name.removesuffix("_name"))
        if field is None:
            return self._numbers(values, missing)
        known = sorted(field.choice_names)
        places = np.searchsorted(known, values).clip(0, len(known) - 1)
        unnamed = np.array(known).take(places) != values
        indices = self._numbers(places.astype(np.int32), unnamed if missing is None else unnamed | missing)
        return self._pa.DictionaryArray.from_arrays(indices, [field.choice_names[value] for value in known])

    def _numbers(self, values: NDArray[Any], missing: Flags | None = None) -> pyarrow.Array:
        """Return numbers as a column that stands where they do. `missing`: which of them count as none."""
        pa = self._pa
        # By `pyarrow.array`, the masked arrays of NumPy would be loaded.
        known = None if missing is None or not missing.any() else pa.py_buffer(np.packbits(~missing, bitorder="little"))
        return pa.Array.from_buffers(pa.from_numpy_dtype(values.dtype), len(values), [known, pa.py_buffer(values)])

    def _count_one(self) -> None:
        self._held += _ALONE
        if self._held >= HELD:
            self._hold()
            self._write()

    # --- frames one by one ----------------------------------------------------------------------------------------

    def plain(self, lane: Lane, frame: Frame, sequence: int, latency_ns: int | None, request_sequence: int | None) -> None:
        self.entry(plain_entry(lane, frame, sequence, latency_ns, request_sequence))

    def entry(self, entry: Entry) -> None:
        message = entry.message
        frame, command, can = message.frame, message.command, message.frame.can
        shown = physical(message)
        row = {
            **self._place(frame.last_ns, frame.port, message.address, entry.sequence),
            "_raw": frame.data, "_checksum_ok": frame.checksum_ok, "_offset": frame.offset,
            "_findings": [found.rule for found in entry.findings] or None,
            "_latency": None if entry.latency_ns is None else entry.latency_ns / SECOND_NS,
            "_request_sequence": entry.request_sequence,
        }  # fmt: skip
        if can is not None:
            row["_can_id"] = can.id
            row["_direction"] = None if frame.role is Role.UNKNOWN else frame.role.value
        if message.role is Role.FOREIGN or command is None or message.role is Role.UNKNOWN:
            table = self._odd("foreign" if message.role is Role.FOREIGN else "unknown")
            said = {"dialect": frame.dialect.name, "role": message.role.value, "command": command and command.name}
            row |= {**said, "values": msgspec.json.encode(shown).decode() if shown else None}
        else:
            table = self._command(frame.dialect, command, message.role)
            if command.slots is not None:
                shown = {"slots": msgspec.json.encode(shown["slots"]).decode()}
            row |= shown
        table.rows.append(row)
        self._count_one()
        if found := state_of(message, shown):
            place = self._place(frame.last_ns, frame.port, message.address, entry.sequence)
            self._states().rows.append(place | found)

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        row = self._place(junk.last_ns, junk.port, None, sequence)
        row |= {"reason": junk.reason.value, "length": len(junk.data), "_raw": junk.data, "_offset": junk.offset}
        self._other("junk", reason="string", length="int64", _raw="binary", _offset="int64").rows.append(row)

    def finding(self, found: Finding) -> None:
        row = self._place(found.last_ns, found.port, found.address, found.sequence)
        row |= {"rule": found.rule, "severity": found.severity.value, "text": found.text, "topic": found.topic}
        row |= {"section": found.section, "_offset": found.offset}
        words = dict.fromkeys(("rule", "severity", "text", "topic", "section"), "string")
        self._other("findings", **words, _offset="int64").rows.append(row)

    def comment(self, comment: Comment) -> None:
        row = self._place(comment.t_ns, comment.port, None, None)
        self._other("comments", text="string").rows.append(row | {"text": comment.text})

    def happened(self, event: Event, sequence: int) -> None:
        row = self._place(event.t_ns, event.port, None, sequence)
        values = msgspec.json.encode(dict(event.values)).decode()
        row |= {"event": event.name, "text": events.text_of(event), "values": values}
        self._other("events", event="string", text="string", values="string").rows.append(row)

    def finish(self, metadata: Mapping[str, str]) -> None:
        """End the files; the folder is whole after this."""
        self._hold()
        self._write()
        pa = self._pa
        schema = pa.schema({"name": pa.string(), "value": pa.string()})
        about = _Table(self._target("metadata", schema), schema, {})
        about.rows += [{"name": name, "value": text} for name, text in metadata.items()]
        for table in (*self._tables.values(), about):
            table.close()

    def abandon(self) -> None:
        """Give the tables up: who made the folder removes it."""

    # --- tables ---------------------------------------------------------------------------------------------------

    @staticmethod
    def _place(t_ns: int | None, port: str, address: int | None, sequence: int | None) -> dict[str, Any]:
        return {"time": t_ns, "bus": topic_name(port) if port else None, "address": address, "sequence": sequence}

    def _command(self, dialect: Dialect, command: Command, role: Role) -> _Table:
        name = f"{dialect.name}.{command.name}.{role.value}"
        return self._tables.get(name) or self._new_command(name, dialect, command, role)

    def _new_command(self, name: str, dialect: Dialect, command: Command, role: Role) -> _Table:
        pa = self._pa
        declared: dict[str, list[Field]] = {}
        for form in forms_of(dialect, command, role):
            for known, field in form.layout.named.items():
                declared.setdefault(known, []).append(field)
        own = []
        about = {"section": command.section, "manual": dialect.manual}
        for known, fields in declared.items():
            first = fields[0]
            words = about | ({"unit": first.unit} if first.unit else {}) | ({"note": first.note} if first.note else {})
            own.append(pa.field(known, self._type(fields), metadata=words))
            if first.choices is not None:
                own.append(pa.field(known + "_name", pa.dictionary(pa.int32(), pa.string()), metadata=about))
            if any(field.has_text_twin for field in fields):
                own.append(pa.field(known + "_text", pa.string(), metadata=about))
        if command.slots is not None:
            own = [pa.field("slots", pa.string(), metadata=about)]
        choices = {known: fields[0] for known, fields in declared.items() if fields[0].choices is not None}
        words = about | {"dialect": dialect.name, "command": command.name, "role": role.value, "summary": command.summary}
        return self._new(name, [*own, *self._frame(role, dialect.bus)], words, choices)

    def _type(self, fields: Sequence[Field]) -> Any:
        pa = self._pa
        if any(field.kind in (FieldKind.BYTES, FieldKind.TEXT) for field in fields):
            return pa.string()
        if any(field.kind is FieldKind.NUMBERS for field in fields):
            return pa.list_(pa.int64())
        if any(field.scale != 1 or field.kind is FieldKind.NUMBER for field in fields):
            return pa.float64()
        return pa.uint64() if any(f.kind is FieldKind.UINT and f.bit_width >= _LONG for f in fields) else pa.int64()

    def _frame(self, role: Role, bus: str) -> list[Any]:
        """Return what each frame has besides its fields."""
        pa = self._pa
        own = {"_raw": pa.binary(), "_checksum_ok": pa.bool_(), "_offset": pa.int64(), "_findings": pa.list_(pa.string())}
        if role in (Role.REPLY, Role.UNKNOWN):
            own |= {"_latency": pa.float64(), "_request_sequence": pa.int64()}
        if bus == "can":
            own |= {"_can_id": pa.int64(), "_direction": pa.string()}
        units = {"_latency": {"unit": "s"}}
        return [pa.field(name, kind, metadata=units.get(name)) for name, kind in own.items()]

    def _odd(self, name: str) -> _Table:
        words = [self._pa.field(known, self._pa.string()) for known in ("dialect", "role", "command", "values")]
        return self._tables.get(name) or self._new(name, [*words, *self._frame(Role.UNKNOWN, "can")])

    def _states(self) -> _Table:
        pa = self._pa
        own = [pa.field(name, pa.float64(), metadata={"unit": unit}) for name, unit in STATE_UNITS.items()]
        return self._tables.get("states") or self._new("states", own)

    def _other(self, name: str, **types: str) -> _Table:
        pa = self._pa
        self._count_one()
        known = self._tables.get(name)
        return known or self._new(name, [pa.field(each, pa.type_for_alias(kind)) for each, kind in types.items()])

    def _new(
        self, name: str, own: Sequence[Any], about: Mapping[str, str] | None = None, choices: Mapping[str, Field] | None = None
    ) -> _Table:
        pa = self._pa
        place = [("time", self._time), ("bus", pa.string()), ("address", pa.int64()), ("sequence", pa.int64())]
        schema = pa.schema([*(pa.field(*each) for each in place), *own], metadata=dict(about or {}))
        table = self._tables[name] = _Table(self._target(name, schema), schema, choices or {})
        return table
