"""Captures as rows of the lake's tables: what a worker does with some captures.

    capture -> ParquetTables -> rows that are held -> data files -> Added, Taken

Rules: rows of a capture that fails half way reach no table. A small capture is held until it has ended; a long one has files of
its own. So a file holds many small captures, and memory does not grow with a long one.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import posixpath
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analyzer import __version__
from analyzer.cli.reading import LONG_CAPTURE, OpenCapture, open_reading
from analyzer.columns.block import ByteBlock, CanBlock
from analyzer.diagnosis.diagnose import diagnosis, lines
from analyzer.diagnosis.watch import Watch
from analyzer.entries import Sink
from analyzer.errors import ServotapError, UnreadableError
from analyzer.fleet.files import Added, Destination, Files, Owner
from analyzer.fleet.place import Found, Place, no_room
from analyzer.pipeline import Item, Pipeline
from analyzer.records import Severity
from analyzer.sinks.parquet import ParquetTables
from analyzer.sinks.summary import Summary
from analyzer.sources.source import Source
from analyzer.sources.times import Clock, is_dated
from analyzer.table.extras import needed
from analyzer.values import printable

if TYPE_CHECKING:
    import pyarrow

#: Rows of one capture that are held; a capture with more has files of its own.
HELD = 1 << 17
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
        own: dict[str, Any] = {"capture": self.unseen, "source": self.source.url, "name": found.name}
        own |= {
            "machine": self.machine or None,
            "size": found.size,
            "mark": found.mark,
            "version": __version__,
            "ingested_at": datetime.now(UTC),
        }
        return own | values


@dataclass
class Taken:
    """What became of some captures. `captures`: a row of the table `captures` each; `ranges`: of one that was split."""

    captures: list[dict[str, Any]] = field(default_factory=list)
    added: list[Added] = field(default_factory=list)
    frames: int = 0
    read: int = 0
    ranges: int = 0


class _Held:
    """A table of a capture: rows that wait until the capture is through."""

    def __init__(self, capture: Capture, name: str) -> None:
        self._capture = capture
        self.name = name
        self.pieces: list[pyarrow.Table] = []

    def write(self, rows: pyarrow.Table) -> None:
        self.pieces.append(rows)
        self._capture.holds(len(rows))

    def close(self) -> None:
        """Nothing more comes."""


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
        held = _Held(self, name)
        self.held.append(held)
        return held

    def holds(self, rows: int) -> None:
        """Count rows that are held; too many go to files of the capture's own."""
        self._rows += rows
        if self._rows >= HELD:
            if self.own is None:
                self.own = Files(self.files.to)
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
        owner = Owner(self.day.isoformat(), self.work.machine or None)
        for held in self.held:
            for piece in held.pieces if held.name != "metadata" else ():
                self._spans(piece["time"])
                files.add(held.name, piece, self.sha256, owner)
            held.pieces = []
        self._rows = 0

    def _spans(self, times: pyarrow.ChunkedArray) -> None:
        span = needed("pyarrow.compute").min_max(times.cast("int64")).as_py()
        if span["min"] is not None:
            self.first_ns = span["min"] if self.first_ns is None else min(self.first_ns, span["min"])
            self.last_ns = span["max"] if self.last_ns is None else max(self.last_ns, span["max"])


def _first_ns(item: Item) -> int | None:
    if isinstance(item, (CanBlock, ByteBlock)):
        return None if item.t_ns is None else int(item.t_ns[0])
    return item.t_ns


def _day(seconds: float) -> date:
    return datetime.fromtimestamp(seconds, UTC).date()


# --- what a worker does -----------------------------------------------------------------------------------------------


def take(works: list[Work], to: Destination, options: argparse.Namespace) -> Taken:
    """Decode captures into data files of a lake; nothing of it counts before it is committed.

    What cannot be read becomes a row that says why. Raises OSError where the lake cannot be written.
    """
    taken, shared, seen = Taken(), Files(to), set[str]()
    for work in works:
        row, own = _take_one(work, shared, seen, options)
        seen.add(row["capture"])
        taken.captures.append(row)
        taken.added += own
        taken.frames += row.get("frames") or 0
        taken.read += work.found.size
    taken.added += shared.finish()
    return taken


def reason_of(error: Exception, name: str) -> str:
    """Return why a capture cannot be read, without the name of its file: that stands beside it."""
    file = posixpath.basename(name)
    said = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return printable(said.removeprefix(f"{file}:").removeprefix(f"{file} ").lstrip())


def _take_one(work: Work, shared: Files, seen: set[str], options: argparse.Namespace) -> tuple[dict[str, Any], list[Added]]:
    """Decode a capture; return its row of the table `captures`, and its own files."""
    row = work.row()
    try:
        with work.source.as_file(work.found) as path:
            content = Content.of(path)
            row["capture"] = sha256 = content.sha256
            if sha256 in work.before or sha256 in seen:
                return row | {"status": "known"}, []
            capture = Capture(work, shared, sha256)
            row |= into_tables(content, capture, options)
            if row["status"] not in TAKEN:
                return row, []
    except (ServotapError, OSError) as error:
        if no_room(error):
            raise
        return row | {"status": "unreadable", "reason": reason_of(error, work.found.name)}, []
    except Exception as error:
        # One capture may bring out a fault of the decoder: the others are taken all the same, and it can be tried again.
        return row | {"status": "failed", "reason": printable(f"a fault of servotap: {type(error).__name__}: {error}")}, []
    capture.release(capture.own or shared)
    row |= {"date": capture.day, "first_ns": capture.first_ns, "last_ns": capture.last_ns}
    return row, [] if capture.own is None else capture.own.finish()


@dataclass(frozen=True)
class Content:
    """What a file holds. `stamp`: its size and time."""

    path: Path
    sha256: str
    stamp: tuple[int, int]

    @classmethod
    def of(cls, path: Path) -> Content:
        """Return the content of a file as it is now."""
        return cls(path, stamp=_stamp(path), sha256=_sha256(path))

    def of_reading(self, values: dict[str, Any], source: Source) -> dict[str, Any]:
        """Return values for the row of `captures`, as failed where a source has read another content.

        A source hashes what it reads. Where it left something out, or the file has another time now, the file is hashed again.
        """
        kept = _stamp(self.path) == self.stamp
        if ((source.sha256 if kept else None) or _sha256(self.path)) == self.sha256:
            return values
        return values | {"status": "failed", "reason": "it changed while it was read: ingest it again when it is whole"}


def _stamp(path: Path) -> tuple[int, int]:
    about = path.stat()
    return about.st_size, about.st_mtime_ns


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def into_tables(content: Content, capture: Capture, options: argparse.Namespace) -> dict[str, Any]:
    """Decode a capture into its tables. Return values for its row of `captures`. Raises UnreadableError."""
    reading = open_reading(str(content.path), options)
    tables = ParquetTables(capture.target, reading.source.clock)

    def feed(pipeline: Pipeline, item: Item) -> None:
        capture.sees(item)
        pipeline.feed(item)

    found = decoded(reading, (tables,), feed)
    tables.finish({})
    return content.of_reading(found, reading.source)


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
            status, reason = "incomplete", reason_of(error, source.name)
        end(pipeline)
        pipeline.close()
        return {"status": status, "reason": reason} | _about(reading, summary.settle(), watch)


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
