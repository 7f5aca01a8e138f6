"""Captures as rows of the lake's tables: what a worker does with some captures.

    capture -> ParquetTables -> rows with `capture` -> a Parquet file for each table and day -> Added, Taken

The tables are those of `decode --to parquet`, with the columns that a lake needs. Delta Lake knows microseconds, no unsigned
numbers and no dictionaries, so `time` is exact to a microsecond, `time_ns` to a nanosecond. A time that is none of the epoch
is in `time_ns` alone. `transactions` are replies with their outcomes, and requests without a reply.

Rules: rows of a capture that fails half way reach no table. A small capture is held until it has ended; a long one has files of
its own. So a file holds many small captures, and memory does not grow with a long one.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import tempfile
import uuid
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analyzer import __version__
from analyzer.cli.reading import LONG_CAPTURE, OpenCapture, open_reading
from analyzer.columns.block import ByteBlock, CanBlock
from analyzer.diagnosis.diagnose import diagnosis, lines
from analyzer.diagnosis.watch import Watch
from analyzer.errors import ServotapError, UnreadableError
from analyzer.fleet.place import Found, Place, no_room
from analyzer.pipeline import Item, Pipeline, Sink
from analyzer.records import Severity
from analyzer.sinks.parquet import ParquetTables
from analyzer.sinks.summary import Summary
from analyzer.sources.times import DATED, Clock, is_dated
from analyzer.table.extras import needed
from analyzer.values import printable

if TYPE_CHECKING:
    import pyarrow

#: Rows of one capture that are held; a capture with more has files of its own.
HELD = 1 << 17
#: Rows that stand together in a file.
GROUP = 1 << 17
#: Columns whose values hardly repeat and mostly grow: a dictionary of them would cost ten times as much as their differences.
_RUNNING = ("time", "time_ns", "sequence", "_request_sequence", "request_sequence", "_offset")
#: The partitions of every table but `captures`.
PARTITIONS = ("date", "machine")
#: Findings of a reply that say what became of its request.
_FAILED = ("failed_status", "modbus_exception", "refused_write")
#: Statuses of captures whose rows are in the tables.
TAKEN = frozenset({"decoded", "incomplete"})
#: Stands in place of the SHA-256 of what could not be read at all.
UNSEEN = "unseen:"


@dataclass(frozen=True)
class Work:
    """A capture to take. `machine`, `date`: what its path says; `before`: SHA-256 of captures that have its size."""

    source: Place
    found: Found
    machine: str = ""
    date: date | None = None
    before: frozenset[str] = frozenset()

    @property
    def unseen(self) -> str:
        """The name of a capture that cannot be read, in place of its SHA-256."""
        return UNSEEN + hashlib.sha256(f"{self.source.url} {self.found.name}".encode()).hexdigest()

    def row(self, **values: Any) -> dict[str, Any]:
        """Return a row of the table `captures`."""
        found = self.found
        own: dict[str, Any] = {
            "capture": self.unseen,
            "source": self.source.url,
            "name": found.name,
            "machine": self.machine or None,
        }
        own |= {"size": found.size, "mark": found.mark, "version": __version__, "ingested_at": datetime.now(UTC)}
        return own | values


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


@dataclass
class Taken:
    """What became of some captures. `captures`: a row of the table `captures` each; `ranges`: of one that was split."""

    captures: list[dict[str, Any]] = field(default_factory=list)
    added: list[Added] = field(default_factory=list)
    frames: int = 0
    read: int = 0
    ranges: int = 0


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
            fields.append(pa.field("time_ns", pa.int64(), metadata={"unit": "ns"}))
        else:
            fields.append(each.with_type(_type(pa, each.type)))
    return pa.schema(fields, metadata=schema.metadata)


def _type(pa: Any, kind: Any) -> Any:
    if pa.types.is_dictionary(kind):
        return kind.value_type
    return pa.decimal128(20, 0) if kind == pa.uint64() else kind


def _as_lake(rows: pyarrow.Table, schema: pyarrow.Schema) -> pyarrow.Table:
    """Return rows of captures, with their `capture`, as the lake has them."""
    pa, compute = needed("pyarrow"), needed("pyarrow.compute")
    columns = {name: rows[name] for name in rows.column_names}
    times = columns["time_ns"] = rows["time"].cast(pa.int64())
    dated = compute.and_(compute.greater(times, DATED[0]), compute.less(times, DATED[1]))
    columns["time"] = compute.if_else(dated, rows["time"], None)
    shown = [columns[each.name].cast(each.type, safe=each.name != "time") for each in schema]
    return pa.Table.from_arrays(shown, schema=schema)


class _Held:
    """A table of a capture: rows that wait until the capture is through."""

    def __init__(self, capture: Capture, name: str, schema: pyarrow.Schema) -> None:
        self._capture = capture
        self.name = name
        self.schema = schema
        self.pieces: list[pyarrow.Table] = []

    def write(self, rows: pyarrow.Table) -> None:
        """Hold the next rows."""
        self.pieces.append(rows)
        self._capture.holds(len(rows))

    def close(self) -> None:
        """Nothing more comes."""


class _File:
    """A data file that is being written, locally; `finish` brings it to the lake. `schema`: of the lake's table."""

    def __init__(self, folder: Path, table: str, schema: pyarrow.Schema, values: Mapping[str, str | None]) -> None:
        self.table, self.values = table, dict(values)
        self._schema = schema
        self.name = f"{uuid.uuid4().hex}.parquet"
        self._path = folder / self.name
        self._writer: Any = None
        self._count = 0
        self._captures: dict[str, None] = {}

    def write(self, rows: pyarrow.Table, captures: Iterable[str]) -> None:
        """Write rows as the lake has them, as one row group. `captures`: whose they are."""
        if self._writer is None:
            running = [name for name in _RUNNING if name in self._schema.names]
            others = [each.name for each in self._schema if each.name not in running]
            self._writer = needed("pyarrow.parquet").ParquetWriter(
                self._path, self._schema, compression="zstd", compression_level=1,
                use_dictionary=[*others, *(f"{name}.list.element" for name in others)],
                column_encoding=dict.fromkeys(running, "DELTA_BINARY_PACKED"),
            )  # fmt: skip
        self._writer.write_table(rows)
        self._count += len(rows)
        self._captures |= dict.fromkeys(captures)

    def finish(self, lake: Place) -> Added:
        """Bring the file to the lake."""
        self._writer.close()
        size = self._path.stat().st_size
        lake.put(self._path, f"{self.table}/{self.name}")
        return Added(self.table, self.name, self._schema, size, self.values, self._count, tuple(self._captures))


class _Waiting:
    """Rows of captures that are through, which wait until there are enough of them for a file."""

    def __init__(self, file: _File, schema: pyarrow.Schema) -> None:
        self.file, self.schema = file, schema
        self.pieces: list[pyarrow.Table] = []
        self.count = 0
        self.captures: dict[str, None] = {}


class Files:
    """The data files of a task or of a long capture: one for each table, day and machine. They grow in `folder`."""

    def __init__(self, lake: Place, folder: Path) -> None:
        self.lake, self.folder = lake, folder
        self._waiting: dict[tuple[str, str | None, str | None, bytes], _Waiting] = {}
        self._transactions: dict[tuple[str | None, str | None], _File] = {}

    def add(self, name: str, rows: pyarrow.Table, values: Mapping[str, str | None], capture: str) -> None:
        """Take rows of a capture's table."""
        # Two versions of a package may have two schemas for one table.
        key = (name, values["date"], values["machine"], rows.schema.serialize().to_pybytes())
        waiting = self._waiting.get(key)
        if waiting is None:
            schema = lake_schema(rows.schema)
            waiting = self._waiting[key] = _Waiting(_File(self.folder, table_of(name), schema, values), schema)
        waiting.pieces.append(rows.append_column("capture", needed("pyarrow").repeat(capture, len(rows)).cast("string")))
        waiting.captures[capture] = None
        waiting.count += len(rows)
        if waiting.count >= GROUP:
            self._write(waiting)

    def _write(self, waiting: _Waiting) -> None:
        if not waiting.pieces:
            return
        file = waiting.file
        rows = _as_lake(needed("pyarrow").concat_tables(waiting.pieces), waiting.schema)
        file.write(rows, waiting.captures)
        done = transactions(file.table, rows)
        if done is not None:
            key = (file.values["date"], file.values["machine"])
            if key not in self._transactions:
                self._transactions[key] = _File(self.folder, "transactions", done.schema, file.values)
            self._transactions[key].write(done, waiting.captures)
        waiting.pieces, waiting.count, waiting.captures = [], 0, {}

    def finish(self) -> list[Added]:
        """Bring all files to the lake, and return them."""
        for waiting in self._waiting.values():
            self._write(waiting)
        files = (*(waiting.file for waiting in self._waiting.values()), *self._transactions.values())
        return [file.finish(self.lake) for file in files]


class Capture:
    """A capture on its way into tables."""

    def __init__(self, work: Work, files: Files, sha256: str) -> None:
        self.work, self.files, self.sha256 = work, files, sha256
        self.held: list[_Held] = []
        self._rows = 0
        #: Files of a long capture's own.
        self.own: Files | None = None
        self._day = work.date
        self._dated = work.date is not None
        self.first_ns: int | None = None
        self.last_ns: int | None = None

    def target(self, name: str, schema: pyarrow.Schema) -> _Held:
        """Return what takes a table."""
        held = _Held(self, name, schema)
        self.held.append(held)
        return held

    def holds(self, rows: int) -> None:
        """Count rows that are held; too many go to files of the capture's own."""
        self._rows += rows
        if self._rows >= HELD:
            if self.own is None:
                self.own = Files(self.files.lake, self.files.folder)
            self.release(self.own)

    def sees(self, item: Item) -> None:
        """Take the day from the first item that has a time, where the path does not say it."""
        if not self._dated:
            first_ns = _first_ns(item)
            if first_ns is not None:
                self._dated = True
                self._day = _day(first_ns // 1_000_000_000) if is_dated(first_ns) else None

    @property
    def day(self) -> date:
        """The day that the path says, else of the first frame, else of the file."""
        return self._day or _day(self.work.found.modified)

    def release(self, files: Files) -> None:
        """Give what is held to files."""
        self._spans()
        values = {"date": self.day.isoformat(), "machine": self.work.machine or None}
        for held in self.held:
            if held.pieces and held.name != "metadata":
                files.add(held.name, needed("pyarrow").concat_tables(held.pieces), values, self.sha256)
            held.pieces = []
        self._rows = 0

    def _spans(self) -> None:
        compute = needed("pyarrow.compute")
        for held in self.held:
            for piece in held.pieces if "time" in held.schema.names else ():
                span = compute.min_max(piece["time"].cast("int64")).as_py()
                if span["min"] is not None:
                    self.first_ns = span["min"] if self.first_ns is None else min(self.first_ns, span["min"])
                    self.last_ns = span["max"] if self.last_ns is None else max(self.last_ns, span["max"])


def _first_ns(item: Item) -> int | None:
    if isinstance(item, (CanBlock, ByteBlock)):
        return None if item.t_ns is None else int(item.t_ns[0])
    return item.t_ns


def _day(seconds: float) -> date:
    return datetime.fromtimestamp(seconds, UTC).date()


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
        columns = {"dialect": pa.repeat(parts[1], len(rows)), "command": pa.repeat(parts[2], len(rows))}
        columns |= {"latency": rows["_latency"], "request_sequence": rows["_request_sequence"]}
        failed = _with_any(rows["_findings"], _FAILED)
        good = compute.if_else(failed, "failed", "answered")
        columns["outcome"] = compute.if_else(rows["_checksum_ok"], good, "damaged")
    elif table == "findings":
        rows = rows.filter(compute.equal(rows["rule"], "unanswered"))
        if not len(rows):
            return None
        # A topic is /bus/address/command/role.
        commands = [text.split("/")[3] for text in rows["topic"].to_pylist()]
        columns = {"command": pa.array(commands), "outcome": pa.repeat("unanswered", len(rows))}
        columns |= {"request_sequence": rows["sequence"]}
    else:
        return None
    schema = transactions_schema()
    arrays = [
        columns[each.name] if each.name in columns else
        rows[each.name] if each.name in rows.column_names else pa.nulls(len(rows), each.type)
        for each in schema
    ]  # fmt: skip
    return pa.Table.from_arrays([array.cast(each.type) for array, each in zip(arrays, schema, strict=True)], schema=schema)


def _with_any(lists: Any, words: tuple[str, ...]) -> Any:
    """Say of each list of texts whether one of some words stands in it."""
    pa, compute = needed("pyarrow"), needed("pyarrow.compute")
    whole, hits = lists.combine_chunks(), np.zeros(len(lists), dtype=np.bool_)
    found = compute.is_in(compute.list_flatten(whole), pa.array(words))
    hits[compute.list_parent_indices(whole).filter(found).to_numpy()] = True
    return pa.array(hits)


def only(lake: Place, added: Sequence[Added], captures: Collection[str]) -> list[Added]:
    """Return data files with the rows of some captures alone: those that hold others too are written anew."""
    parquet, compute, pa = needed("pyarrow.parquet"), needed("pyarrow.compute"), needed("pyarrow")
    kept = []
    for each in added:
        wanted = [capture for capture in each.captures if capture in captures]
        if len(wanted) == len(each.captures):
            kept.append(each)
        elif wanted:
            with tempfile.TemporaryDirectory(prefix="servotap-") as folder:
                file = _File(Path(folder), each.table, each.schema, each.values)
                rows = parquet.read_table(pa.BufferReader(lake.read(f"{each.table}/{each.path}")), schema=each.schema)
                file.write(rows.filter(compute.is_in(rows["capture"], pa.array(wanted))), wanted)
                kept.append(file.finish(lake))
    return kept


# --- what a worker does -----------------------------------------------------------------------------------------------


def take(works: list[Work], lake: Place, options: argparse.Namespace) -> Taken:
    """Decode captures into data files of a lake; nothing of it counts before it is committed.

    What cannot be read becomes a row that says why. Raises OSError where the lake cannot be written.
    """
    taken = Taken()
    with tempfile.TemporaryDirectory(prefix="servotap-") as folder:
        shared = Files(lake, Path(folder))
        seen: set[str] = set()
        for work in works:
            row, own = _take_one(work, shared, seen, options)
            seen.add(row["capture"])
            taken.captures.append(row)
            taken.added += own
            taken.frames += row.get("frames") or 0
            taken.read += work.found.size
        taken.added += shared.finish()
    return taken


def _take_one(work: Work, shared: Files, seen: set[str], options: argparse.Namespace) -> tuple[dict[str, Any], list[Added]]:
    """Decode a capture; return its row of the table `captures`, and its own files."""
    row = work.row()
    try:
        with work.source.as_file(work.found) as path:
            row["capture"] = sha256 = sha256_of(path)
            if sha256 in work.before or sha256 in seen:
                return row | {"status": "known"}, []
            capture = Capture(work, shared, sha256)
            row |= into_tables(str(path), capture, options)
            if sha256_of(path) != sha256:
                return row | {
                    "status": "failed",
                    "reason": "it changed while it was read: ingest it again when it is whole",
                }, []
    except (ServotapError, OSError) as error:
        if no_room(error):
            raise
        return row | {"status": "unreadable", "reason": printable(str(error))}, []
    except Exception as error:
        # One capture may bring out a fault of the decoder: the others are taken all the same, and it can be tried again.
        return row | {"status": "failed", "reason": printable(f"a fault of servotap: {type(error).__name__}: {error}")}, []
    capture.release(capture.own or shared)
    row |= {"date": capture.day, "first_ns": capture.first_ns, "last_ns": capture.last_ns}
    return row, [] if capture.own is None else capture.own.finish()


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


class _Nowhere:
    """A table that is not kept."""

    def write(self, rows: pyarrow.Table) -> None:
        """Forget the rows."""

    def close(self) -> None:
        """Nothing is held."""


def decoded_alone(path: str, options: argparse.Namespace) -> dict[str, Any]:
    """Decode a capture without keeping its tables. Return values for its row of `captures`. Raises UnreadableError."""
    reading = open_reading(path, options)
    tables = ParquetTables(lambda name, schema: _Nowhere(), reading.source.clock)
    found = decoded(reading, (tables,), lambda pipeline, item: pipeline.feed(item))
    tables.finish({})
    return found


def into_tables(path: str, capture: Capture, options: argparse.Namespace) -> dict[str, Any]:
    """Decode a capture into its tables. Return values for its row of `captures`. Raises UnreadableError."""
    reading = open_reading(path, options)
    tables = ParquetTables(capture.target, reading.source.clock)

    def feed(pipeline: Pipeline, item: Item) -> None:
        capture.sees(item)
        pipeline.feed(item)

    found = decoded(reading, (tables,), feed)
    tables.finish({})
    return found


def decoded(
    reading: OpenCapture,
    sinks: Sequence[Sink],
    feed: Callable[[Pipeline, Item], None],
    end: Callable[[Pipeline], None] = lambda pipeline: None,
) -> dict[str, Any]:
    """Decode a capture into sinks, each item by `feed`; `end` is called before the pipeline is closed.

    Return values for its row of `captures`. Raises UnreadableError.
    """
    source, status, reason = reading.source, "decoded", ""
    with contextlib.closing(source):
        source.in_blocks = (source.size or 0) >= LONG_CAPTURE and not reading.time_range.wanted
        summary, watch = Summary(), Watch()
        pipeline = reading.pipeline((*sinks, summary, watch))
        try:
            for item in reading:
                watch.take(item)
                feed(pipeline, item)
        except UnreadableError as error:
            if not pipeline.sequence:
                raise
            status, reason = "incomplete", str(error)
        end(pipeline)
        pipeline.close()
        return {"status": status, "reason": printable(reason)} | _about(reading, summary.settle(), watch)


def _about(reading: OpenCapture, summary: Summary, watch: Watch) -> dict[str, Any]:
    source = reading.source
    found = diagnosis(watch, reading.dialects)
    return {
        "format": source.format,
        "dialects": [d.name for d in reading.dialects],
        "clock": source.clock.name.lower() if reading.has_times else Clock.DAY.name.lower(),
        "frames": summary.frames,
        "frame_bytes": summary.frame_bytes,
        "junk_bytes": sum(summary.junk_bytes.values()),
        "findings": sum(summary.findings.values()),
        "errors": summary.severities[Severity.ERROR],
        "causes": [each.suspicion.cause for each in found.causes],
        "diagnosis": [printable(text) for text in lines(found)] if found.causes else [],
        "notes": [printable(note) for note in source.notes],
    }


def captures_schema() -> pyarrow.Schema:
    """Return the schema of the table `captures`: a row for each content.

    `status`: decoded, incomplete (it breaks off), unreadable, failed; `reason`: why. `first_ns`, `last_ns`: of its frames.
    """
    pa = needed("pyarrow")
    texts = ("capture", "batch", "status", "reason", "source", "name", "machine")
    numbers = ("size", "frames", "frame_bytes", "junk_bytes", "findings", "errors", "first_ns", "last_ns")
    units = {"size": "bytes", "frame_bytes": "bytes", "junk_bytes": "bytes", "first_ns": "ns", "last_ns": "ns"}
    return pa.schema(
        [
            *(pa.field(name, pa.string()) for name in texts),
            pa.field("date", pa.date32()),
            *(pa.field(name, pa.int64(), metadata={"unit": units[name]} if name in units else None) for name in numbers),
            *(pa.field(name, pa.string()) for name in ("format", "clock", "mark", "version")),
            *(pa.field(name, pa.list_(pa.string())) for name in ("dialects", "causes", "diagnosis", "notes")),
            pa.field("ingested_at", pa.timestamp("us", "UTC")),
        ]
    )
