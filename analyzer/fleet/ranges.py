"""A huge capture in ranges, so that several workers decode it at once.

    scan    capture -> items -> pipeline without tables -> its row of `captures`
                        '-> ranges/<scan>/<number>.range: the state of the pipeline before them, and the items
    range   state, items -> pipeline -> tables -> data files

A frame may begin in one range and end in the next; a request may wait there for its reply; what was learnt of a drive counts
from then on. So one worker reads the capture through and pairs its frames, which is about a quarter of the work. It hands the
state of the pipeline over at each border. Another worker goes on from there as if it had read all before. The items lie in the
range's file, so no format needs a way to begin in the middle, and no worker fetches the capture again.

Rules: ranges are taken while the scan goes on. A capture whose scan or range fails reaches no table. The client
makes a key for each scan, and the scan signs its files with it. A worker reads no file without that signature.
"""

from __future__ import annotations

import argparse
import contextlib
import hmac
import io
import pickle
import secrets
import uuid
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import zstandard

from analyzer import dialects as registry
from analyzer.cli.reading import OpenCapture, open_reading
from analyzer.columns.block import ByteBlock, CanBlock
from analyzer.columns.memory import keep
from analyzer.devices import load
from analyzer.errors import ServotapError, UnreadableError
from analyzer.events import SETUPS
from analyzer.fleet.files import Destination, Files
from analyzer.fleet.lake import RANGES
from analyzer.fleet.place import Place, no_room
from analyzer.fleet.rows import TAKEN, Capture, Content, Taken, Work, decoded, reason_of, take
from analyzer.pipeline import Item, Pipeline
from analyzer.port import PortSetup
from analyzer.records import Chunk, Event
from analyzer.sinks.object_table import Table, TableUnpickler, dumped
from analyzer.sinks.parquet import ParquetTables
from analyzer.table.extras import needed

#: Bytes of a capture from which on it is split, and of a range's items, about.
HUGE, RANGE_BYTES = 256 << 20, 32 << 20
#: What an item takes beside its own bytes, about; a frame of a block.
_ITEM, _ROW = 64, 40
_CHECK = 32


@dataclass(frozen=True)
class Scan:
    """A huge capture that is read through. `key`: proves that its ranges are of this scan."""

    work: Work
    name: str = field(default_factory=lambda: uuid.uuid4().hex)
    key: bytes = field(default_factory=lambda: secrets.token_bytes(_CHECK), repr=False)

    @property
    def folder(self) -> str:
        return f"{RANGES}/{self.name}"

    def path(self, number: int) -> str:
        """Return the name of a range, below the lake."""
        return f"{self.folder}/{number:06}.range"


@dataclass(frozen=True)
class Range:
    """A range of a scan."""

    scan: Scan
    number: int


Task = list[Work] | Scan | Range


def do(task: Task, to: Destination, options: argparse.Namespace) -> Taken:
    """Do what a worker is given. Raises OSError where the lake cannot be written."""
    with memory_kept():
        if isinstance(task, Scan):
            return scan(task, to, options)
        return take_range(task, to, options) if isinstance(task, Range) else take(task, to, options)


@contextlib.contextmanager
def memory_kept() -> Iterator[None]:
    """Have columns and tables of Arrow made in memory that is kept, as long as this lasts.

    Arrow's own memory goes back to the system soon after a table is gone: rows that wait for more then cost a third more.
    """
    pa = needed("pyarrow")
    before = pa.default_memory_pool()
    keep()
    pa.set_memory_pool(pa.system_memory_pool())
    try:
        yield
    finally:
        pa.set_memory_pool(before)


def works_of(task: Task) -> list[Work]:
    """Return the captures of a task."""
    if isinstance(task, list):
        return task
    return [task.work if isinstance(task, Scan) else task.scan.work]


def waiting(lake: Place, task: Scan) -> int:
    """Return how many ranges a scan has written so far."""
    return len(lake.glob(f"{task.folder}/*.range"))


# --- the scan -----------------------------------------------------------------------------------------------------------


class _Spool:
    """Writes the items of a capture in ranges."""

    def __init__(self, task: Scan, to: Destination, reading: OpenCapture, sha256: str) -> None:
        self._task, self._place, self._clock = task, to.place, reading.source.clock
        # What the pipeline begins with; later the buses may be set up otherwise.
        self._start = (reading.dialects, reading.options, dict(reading.ports), reading.others)
        self._model = reading.model
        self._table = Table(reading.possible)
        self.capture = Capture(task.work, Files(to), sha256)
        self._items: list[Item] = []
        self._setups: list[PortSetup | None] = []
        self._size = 0
        self._before = b""
        self.written = 0

    def feed(self, pipeline: Pipeline, item: Item) -> None:
        self.capture.sees(item)
        if not self._items:
            self._before = self._state(pipeline)
        # The pipeline notes in a block how far it is.
        self._items.append(replace(item) if isinstance(item, ByteBlock) else item)
        self._size += _weight(item)
        pipeline.feed(item)
        if isinstance(item, Event) and item.name in SETUPS:
            port = pipeline.ports.get(item.port)
            self._setups.append(None if port is None else port.setup)
        if self._size >= RANGE_BYTES:
            self._write(last=False)

    def end(self, pipeline: Pipeline) -> None:
        """Write the last range; what waits in the pipeline belongs to it."""
        if not self._items:
            self._before = self._state(pipeline)
        self._write(last=True)

    def _state(self, pipeline: Pipeline) -> bytes:
        setups = {name: port.setup for name, port in pipeline.ports.items()}
        return dumped((pipeline.state(), setups), self._table)

    def _write(self, *, last: bool) -> None:
        about = {
            "sha256": self.capture.sha256, "day": self.capture.day, "clock": self._clock, "start": self._start,
            "items": self._items, "setups": self._setups, "last": last,
        }  # fmt: skip
        names = [dialect.name for dialect in self._table.dialects]
        outer = (names, self._model, self._table.digest, self._before, dumped(about, self._table))
        data = zstandard.ZstdCompressor(level=1).compress(pickle.dumps(outer, pickle.HIGHEST_PROTOCOL))
        self._place.write(self._task.path(self.written), hmac.digest(self._task.key, data, "sha256") + data)
        self.written += 1
        self._items, self._setups, self._size = [], [], 0


def _weight(item: Item) -> int:
    if isinstance(item, CanBlock):
        return _ROW * len(item)
    rows = _ROW * len(item) if isinstance(item, ByteBlock) else 0
    return _ITEM + rows + (len(item.data) if isinstance(item, (ByteBlock, Chunk)) else 0)


def scan(task: Scan, to: Destination, options: argparse.Namespace) -> Taken:
    """Read a huge capture through and write its ranges. Raises OSError where the lake cannot be written."""
    work = task.work
    row = work.row()
    size, frames, ranges = work.found.size, 0, 0
    try:
        with work.source.as_file(work.found) as path:
            content = Content.of(path)
            row["capture"] = content.sha256
            if content.sha256 in work.before:
                return Taken([row | {"status": "known"}], read=size)
            reading = open_reading(str(path), options)
            if reading.time_range.wanted:
                # What is decoded unseen belongs to no range.
                reading.source.close()
                return take([work], to, options)
            spool = _Spool(task, to, reading, content.sha256)
            row |= content.of_reading(decoded(reading, (), spool.feed, spool.end), reading.source)
            if row["status"] not in TAKEN:
                return Taken([row], read=size)
            frames, ranges = row["frames"], spool.written
            row["date"] = spool.capture.day
    except (ServotapError, OSError) as error:
        if no_room(error):
            raise
        return Taken([row | {"status": "unreadable", "reason": reason_of(error, work.found.name)}], read=size)
    return Taken([row], frames=frames, read=size, ranges=ranges)


# --- a range ------------------------------------------------------------------------------------------------------------


def take_range(task: Range, to: Destination, options: argparse.Namespace) -> Taken:
    """Decode a range into data files of a lake. The row of `captures` has the times of its frames alone.

    Raises UnreadableError for a file that another program or version wrote, OSError where the lake cannot be written.
    """
    name, lake = task.scan.path(task.number), to.place
    try:
        whole = lake.read(name)
    except FileNotFoundError:
        raise UnreadableError(f"{lake.path(name)} is gone: ingest it again") from None
    data = whole[_CHECK:]
    if not hmac.compare_digest(whole[:_CHECK], hmac.digest(task.scan.key, data, "sha256")):
        raise UnreadableError(f"{lake.path(name)} is damaged")
    names, model, digest, before, rest = pickle.loads(zstandard.ZstdDecompressor().decompress(data))
    devices = [d for file in load(options.dbc, options.modbus_map, lambda text: None) for d in file.dialects]
    known = registry.readable_by_name(devices, model)
    table = Table([known[each] for each in names])
    if table.digest != digest:
        raise UnreadableError(f"{lake.path(name)} is of another version of Servotap: all workers need the same")
    state, setups = TableUnpickler(io.BytesIO(before), table).load()
    about: dict[str, Any] = TableUnpickler(io.BytesIO(rest), table).load()
    capture = Capture(replace(task.scan.work, date=about["day"]), Files(to), about["sha256"])
    capture.own = capture.files
    tables = ParquetTables(capture.target, about["clock"])
    said: Iterator[PortSetup | None] = iter(about["setups"])
    dialects, given, ports, others = about["start"]
    pipeline = Pipeline(dialects, (tables,), given, ports=ports, on_setup=lambda event: next(said), others=lambda: others)
    pipeline.restore(state, setups)
    for item in about["items"]:
        pipeline.feed(item)
    if about["last"]:
        pipeline.close()
    tables.finish({})
    capture.release(capture.files)
    added = capture.files.finish()
    times = {"capture": capture.sha256, "first_ns": capture.first_ns, "last_ns": capture.last_ns}
    return Taken([times], added)


def joined(scanned: Taken, taken: list[Taken]) -> Taken:
    """Return what became of a capture from its scan and its ranges. Raises UnreadableError where the content is not one."""
    row = dict(scanned.captures[0])
    parts = [each.captures[0] for each in taken]
    if any(part["capture"] != row["capture"] for part in parts):
        raise UnreadableError("it changed while it was read: ingest it again when it is whole")
    row["first_ns"] = min((part["first_ns"] for part in parts if part["first_ns"] is not None), default=None)
    row["last_ns"] = max((part["last_ns"] for part in parts if part["last_ns"] is not None), default=None)
    added = [file for each in taken for file in each.added]
    return Taken([row], added, scanned.frames, scanned.read)


def is_split(scanned: Taken) -> bool:
    """Say whether the ranges of a scan are wanted: it took the capture, and split it."""
    return scanned.ranges > 0 and scanned.captures[0]["status"] in TAKEN
