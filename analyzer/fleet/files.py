"""Data files of a lake: rows of many captures in one file, rows of a long capture in files of its own.

    rows of a capture -> as the lake has them -> sorted by day and machine -> a file for each table and partition

The tables are those of `decode --to parquet`, with the columns that a lake needs. Delta Lake knows microseconds, no unsigned
numbers and no dictionaries. So `time` is exact to a microsecond, and `time_ns` has what `time` cannot tell: a time that is
finer, or that does not count from the epoch. It is empty elsewhere: twice the same would be a third of a lake. `transactions`
are replies with their outcomes, and requests without a reply.

A small file costs as much as thousands of rows: half a millisecond of work, a request to its store, 4 kB of names and types.
"""

from __future__ import annotations

import uuid
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analyzer.fleet.place import Place
from analyzer.sinks.parquet_file import packing
from analyzer.sources.times import DATED
from analyzer.table.extras import needed

if TYPE_CHECKING:
    import pyarrow

#: Rows that stand together in a file, and bytes after which a file ends and the next one begins.
GROUP, FILE_BYTES = 1 << 17, 32 << 20
#: Rows below which zstd costs more work than all the rest of a file.
_FEW = 1000
#: Nanoseconds in a microsecond; what the column `time_ns` is.
_IN_US, _FINE = 1000, "in the files empty where time tells the same"
#: What every table but `captures` can be partitioned by.
PARTITIONS = ("date", "machine")
#: Findings of a reply, and the outcome of its request that each means.
_FAILED = ("failed_status", "modbus_exception", "refused_write")
#: What became of a request.
_OUTCOMES = ("answered", "failed", "damaged", "unanswered")


class Owner(NamedTuple):
    """The day (as `2026-03-01`) and the machine of a capture."""

    date: str
    machine: str | None


@dataclass(frozen=True)
class Destination:
    """Where a worker puts data files: the place of a lake, and what its tables are partitioned by."""

    place: Place
    partitions: tuple[str, ...] = PARTITIONS


@dataclass
class Added:
    """A data file of a table. `table`: as `messages/mks-can/read_speed/reply`; `path`: below the table.

    `schema`: of Arrow, without the partitions; `values`: of the partitions.
    `count`: of its rows; `captures`: whose they are.
    """

    table: str
    path: str
    schema: Any
    size: int
    values: dict[str, str | None]
    count: int
    captures: tuple[str, ...]


def table_of(name: str) -> str:
    """Return the lake's table for one of `decode --to parquet`: dialect, command and role are folders."""
    dialect, _, rest = name.partition(".")
    return f"messages/{dialect}/" + "/".join(rest.rsplit(".", 1)) if rest else name


def lake_schema(schema: pyarrow.Schema) -> pyarrow.Schema:
    """Return the schema of a lake's table, without partitions, for that of a capture's."""
    pa = needed("pyarrow")
    fields = [pa.field("capture", pa.string())]
    for each in schema:
        if each.name == "time":
            fields.append(pa.field("time", pa.timestamp("us", "UTC")))
            fields.append(pa.field("time_ns", pa.int64(), metadata={"unit": "ns", "note": _FINE}))
        else:
            fields.append(each.with_type(_type(each.type)))
    return pa.schema(fields, metadata=schema.metadata)


def _type(kind: Any) -> Any:
    pa = needed("pyarrow")
    if pa.types.is_dictionary(kind):
        return kind.value_type
    return pa.decimal128(20, 0) if kind == pa.uint64() else kind


def _as_lake(pieces: Sequence[tuple[str, pyarrow.Table]]) -> pyarrow.Table:
    """Return rows of captures, each with its `capture`, as the lake has them, dictionaries aside. All have one schema."""
    pa = needed("pyarrow")
    rows = pa.concat_tables([piece for _, piece in pieces])
    columns = {name: rows[name] for name in rows.column_names}
    columns["capture"] = _repeated([capture for capture, _ in pieces], [len(piece) for _, piece in pieces])
    columns["time"], columns["time_ns"] = _times(rows["time"])
    schema = _coded(lake_schema(rows.schema), [name for name, each in columns.items() if pa.types.is_dictionary(each.type)])
    shown = [columns[each.name].cast(each.type) for each in schema]
    return pa.Table.from_arrays(shown, schema=schema)


def _times(times: pyarrow.ChunkedArray) -> tuple[pyarrow.ChunkedArray, pyarrow.ChunkedArray]:
    """Return times in microseconds where they count from the epoch, and in nanoseconds where microseconds do not tell them."""
    pa, compute = needed("pyarrow"), needed("pyarrow.compute")
    exact = times.cast(pa.int64())
    span = compute.min_max(exact).as_py()
    if span["min"] is not None and not DATED[0] < span["min"] <= span["max"] < DATED[1]:
        dated = compute.and_(compute.greater(exact, DATED[0]), compute.less(exact, DATED[1]))
        times = compute.if_else(dated, times, None)
    shown = times.cast(pa.timestamp("us", times.type.tz), safe=False)
    told = compute.equal(compute.multiply(shown.cast(pa.int64()), _IN_US), exact)
    return shown, compute.if_else(compute.fill_null(told, False), None, exact)


def _coded(schema: pyarrow.Schema, names: Collection[str]) -> pyarrow.Schema:
    """Return a schema whose texts of some names are dictionaries."""
    pa = needed("pyarrow")
    kind = pa.dictionary(pa.int32(), pa.string())
    return pa.schema([each.with_type(kind) if each.name in names else each for each in schema], metadata=schema.metadata)


def _repeated(texts: Sequence[str], counts: Sequence[int]) -> pyarrow.DictionaryArray:
    """Return texts of which each stands in so many rows."""
    pa = needed("pyarrow")
    numbers = {text: number for number, text in enumerate(dict.fromkeys(texts))}
    codes = np.repeat(np.array([numbers[text] for text in texts], np.int32), counts)
    return pa.DictionaryArray.from_arrays(pa.array(codes), pa.array(numbers, pa.string()))


def _shape(rows: pyarrow.Table, before: pyarrow.Schema | None) -> pyarrow.Schema:
    """Return the schema in which rows are written: without columns that have no value, and with it whether one misses any.

    For readers, a column that a file does not have is empty, and a value that cannot miss takes less work. `before`: of rows
    that stand in the same file.
    """
    fields = []
    for each, column in zip(rows.schema, rows.columns, strict=True):
        missing, place = column.null_count, -1 if before is None else before.get_field_index(each.name)
        if place >= 0 or missing < len(rows):
            whole = not missing and (before is None or (place >= 0 and not before.field(place).nullable))
            fields.append(each.with_nullable(not whole))
    return needed("pyarrow").schema(fields, metadata=rows.schema.metadata)


class DataFile:
    """A data file that grows in memory; `finish` brings it to the lake. `values`: of the partitions; `before`: the one before.

    Its first rows say which columns it has, together with those of the file before.
    """

    def __init__(
        self, table: str, schema: pyarrow.Schema, values: Mapping[str, str | None], before: DataFile | None = None
    ) -> None:
        # Whether a text is written from a dictionary says nothing of the table.
        self._schema = needed("pyarrow").schema([each.with_type(_type(each.type)) for each in schema], metadata=schema.metadata)
        self._table, self._values = table, dict(values)
        self._written: Any = None if before is None else before._written
        self._buffer = needed("pyarrow").BufferOutputStream()
        self._writer: Any = None
        self._count = 0
        self._captures: dict[str, None] = {}

    def fits(self, rows: pyarrow.Table) -> bool:
        """Say whether it has all columns of some rows, and room for more."""
        return bool(_shape(rows, self._written) == self._written and self._buffer.tell() < FILE_BYTES)

    def write(self, rows: pyarrow.Table, captures: Collection[str]) -> None:
        """Write rows as one row group; `captures`: whose they are."""
        pa, parquet = needed("pyarrow"), needed("pyarrow.parquet")
        if self._writer is None:
            self._written = _shape(rows, self._written)
            # A lake is kept for years, so columns of each encoding are compressed. Units stand in the schema of the log.
            how = packing(self._written) | {"compression": "snappy" if len(rows) < _FEW else "zstd", "compression_level": None}
            self._writer = parquet.ParquetWriter(self._buffer, self._written, store_schema=False, **how)
        columns = [rows[name] for name in self._written.names]
        self._writer.write_table(pa.Table.from_arrays(columns, schema=self._written))
        self._count += len(rows)
        self._captures |= dict.fromkeys(captures)

    def finish(self, place: Place) -> Added:
        self._writer.close()
        data, name = memoryview(self._buffer.getvalue()), f"{uuid.uuid4().hex}.parquet"
        place.write(f"{self._table}/{name}", data)
        return Added(self._table, name, self._schema, len(data), self._values, self._count, tuple(self._captures))


class Files:
    """The data files of a task or of a long capture: one for each table and partition, and for each 32 MiB."""

    def __init__(self, to: Destination) -> None:
        self.to = to
        self._owners: dict[str, Owner] = {}
        self._waiting: dict[tuple[str, bytes], list[tuple[str, pyarrow.Table]]] = {}
        self._rows = Counter[tuple[str, bytes]]()
        self._transactions: list[pyarrow.Table] = []
        self._open: dict[tuple[str, bytes, tuple[str | None, ...]], DataFile] = {}
        self._added: list[Added] = []

    def add(self, name: str, rows: pyarrow.Table, capture: str, owner: Owner) -> None:
        self._owners[capture] = owner
        # Captures with and without dates have two schemas for one table, and so may two versions of a package.
        key = (name, rows.schema.serialize().to_pybytes())
        self._waiting.setdefault(key, []).append((capture, rows))
        self._rows[key] += len(rows)
        if self._rows[key] >= GROUP:
            del self._rows[key]
            self._convert(name, self._waiting.pop(key))

    def finish(self) -> list[Added]:
        for (name, _), pieces in self._waiting.items():
            self._convert(name, pieces)
        self._write_transactions()
        self._added += [file.finish(self.to.place) for file in self._open.values()]
        return self._added

    def _convert(self, name: str, pieces: list[tuple[str, pyarrow.Table]]) -> None:
        table, rows = table_of(name), _as_lake(pieces)
        self._write(table, rows)
        found = transactions(table, rows)
        if found is not None:
            self._transactions.append(found)
            if sum(map(len, self._transactions)) >= GROUP:
                self._write_transactions()

    def _write_transactions(self) -> None:
        if self._transactions:
            self._write("transactions", needed("pyarrow").concat_tables(self._transactions))
            self._transactions = []

    def _write(self, table: str, rows: pyarrow.Table) -> None:
        """Write rows of any captures to the files of their partitions, sorted by day and machine."""
        pa = needed("pyarrow")
        # Pieces have dictionaries of their own, of which some texts have no row.
        rows = rows.unify_dictionaries()
        coded = rows["capture"].combine_chunks()
        known, codes = coded.dictionary.to_pylist(), coded.indices.to_numpy()
        there = np.flatnonzero(np.bincount(codes, minlength=len(known))).tolist()
        in_order = sorted(there, key=lambda code: (self._owners[known[code]].date, self._owners[known[code]].machine or ""))
        captures = [known[code] for code in in_order]
        owners = [self._owners[capture] for capture in captures]
        rank_of = np.zeros(len(known), np.int32)
        rank_of[in_order] = np.arange(len(in_order))
        ranks = rank_of[codes]
        if (np.diff(ranks) < 0).any():
            order = np.argsort(ranks, kind="stable")
            rows, ranks = rows.take(pa.array(order)), ranks[order]
        if "machine" not in self.to.partitions:
            machines = pa.array([owner.machine for owner in owners], pa.string())
            rows = rows.append_column(pa.field("machine", pa.string()), machines.take(pa.array(ranks)))
        schema = rows.schema.serialize().to_pybytes()
        said = [tuple(getattr(owner, name) for name in self.to.partitions) for owner in owners]
        for partition, numbers in groupby(range(len(captures)), key=said.__getitem__):
            first, *others = numbers
            own = captures[first : first + len(others) + 1]
            start, end = np.searchsorted(ranks, [first, first + len(own)])
            coded = pa.DictionaryArray.from_arrays(pa.array(ranks[start:end] - first), pa.array(own))
            part = rows.slice(start, end - start).set_column(0, rows.schema.field(0), coded)
            key = (table, schema, partition)
            file = self._open.get(key)
            if file is None or not file.fits(part):
                if file is not None:
                    self._added.append(file.finish(self.to.place))
                values = dict(zip(self.to.partitions, partition, strict=True))
                file = self._open[key] = DataFile(table, rows.schema, values, file)
            file.write(part, own)


def transactions_schema() -> pyarrow.Schema:
    """Return the schema of the table `transactions`, without partitions."""
    pa = needed("pyarrow")
    place = [("capture", pa.string()), ("time", pa.timestamp("us", "UTC")), ("time_ns", pa.int64())]
    place += [("bus", pa.string()), ("address", pa.int64()), ("sequence", pa.int64()), ("request_sequence", pa.int64())]
    own = [("dialect", pa.string()), ("command", pa.string()), ("outcome", pa.string())]
    return pa.schema([*place, *own, pa.field("latency", pa.float64(), metadata={"unit": "s"})])


def transactions(table: str, rows: pyarrow.Table) -> pyarrow.Table | None:
    """Return the requests that rows of a table tell of, with their outcomes; None for a table that tells of none.

    `outcome`: answered, failed, damaged (the reply's checksum is wrong), or unanswered, where the dialect stays empty.
    """
    pa, compute = needed("pyarrow"), needed("pyarrow.compute")
    parts = table.split("/")
    columns: dict[str, Any] = {}
    if len(parts) == 4 and parts[3] == "reply":
        columns = {"dialect": _repeated([parts[1]], [len(rows)]), "command": _repeated([parts[2]], [len(rows)])}
        columns |= {"latency": rows["_latency"], "request_sequence": rows["_request_sequence"]}
        failed, good = _with_any(rows["_findings"], _FAILED), rows["_checksum_ok"].to_numpy()
        columns["outcome"] = _chosen(np.where(good, failed, _OUTCOMES.index("damaged")))
    elif table == "findings":
        rows = rows.filter(compute.equal(rows["rule"], "unanswered"))
        if not len(rows):
            return None
        # A topic is /bus/address/command/role.
        commands = [text.split("/")[3] for text in rows["topic"].to_pylist()]
        columns = {"command": pa.array(commands).dictionary_encode(), "request_sequence": rows["sequence"]}
        columns |= {"outcome": _chosen(np.full(len(rows), _OUTCOMES.index("unanswered")))}
        columns |= {"dialect": pa.nulls(len(rows), pa.string()).dictionary_encode()}
    else:
        return None
    schema = _coded(transactions_schema(), ("capture", "dialect", "command", "outcome"))
    arrays = [
        columns[each.name] if each.name in columns else
        rows[each.name] if each.name in rows.column_names else pa.nulls(len(rows), each.type)
        for each in schema
    ]  # fmt: skip
    return pa.Table.from_arrays([array.cast(each.type) for array, each in zip(arrays, schema, strict=True)], schema=schema)


def _chosen(numbers: Any) -> pyarrow.DictionaryArray:
    """Return outcomes by their numbers."""
    pa = needed("pyarrow")
    return pa.DictionaryArray.from_arrays(pa.array(numbers.astype(np.int32)), pa.array(_OUTCOMES))


def _with_any(lists: Any, words: tuple[str, ...]) -> NDArray[np.bool_]:
    """Say of each list of texts whether one of some words stands in it."""
    pa, compute = needed("pyarrow"), needed("pyarrow.compute")
    whole, hits = lists.combine_chunks(), np.zeros(len(lists), dtype=np.bool_)
    found = compute.is_in(compute.list_flatten(whole), pa.array(words))
    hits[compute.list_parent_indices(whole).filter(found).to_numpy()] = True
    return hits


def only(place: Place, added: Sequence[Added], captures: Collection[str]) -> list[Added]:
    """Return data files with the rows of some captures alone: those that hold others too are written anew."""
    parquet, compute, pa = needed("pyarrow.parquet"), needed("pyarrow.compute"), needed("pyarrow")
    kept = []
    for each in added:
        wanted = [capture for capture in each.captures if capture in captures]
        if len(wanted) == len(each.captures):
            kept.append(each)
        elif wanted:
            file = DataFile(each.table, each.schema, each.values)
            rows = parquet.read_table(pa.BufferReader(place.read(f"{each.table}/{each.path}")), schema=each.schema)
            file.write(rows.filter(compute.is_in(rows["capture"], pa.array(wanted))), wanted)
            kept.append(file.finish(place))
    return kept
