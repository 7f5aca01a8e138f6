"""Captures from Python: records as they come, tables for data frames, plots.

Records are decoded anew each time they are looked at, so memory does not grow with the capture. Tables keep the decoded rows,
most of them in a temporary file, until the capture is closed or changes.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import warnings
from collections import OrderedDict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from analyzer.catalogue import Role
from analyzer.cli.export_table import keep_rows
from analyzer.cli.reading import OpenCapture, add_reading_arguments, open_reading
from analyzer.decoder import physical, units_of
from analyzer.entries import Entry
from analyzer.errors import UnreadableError, UsageError
from analyzer.records import Comment, Finding, Junk
from analyzer.sources.times import Clock, is_dated, parse_time
from analyzer.table.extras import needed
from analyzer.table.rows import Recorded
from analyzer.table.tables import Chosen, Long, Table, Wide, parse_rate
from analyzer.transactions import meaning_of
from servotap.arguments import check

if TYPE_CHECKING:
    import pandas
    import polars
    import pyarrow
    from matplotlib.axes import Axes

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
#: Requests that are kept while their replies may come.
_MOST_OPEN = 4096

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Frame:
    """One decoded frame.

    `t_ns`: when its last byte came, since the epoch or since some beginning; `time`: the same where it has a date, to the
    microsecond. `fields`: in their units, choices by their names; empty where no command fits. `command`: empty for an unknown
    one. `raw`: all bytes; on CAN the data bytes, behind `can_id`. `latency_ns`: of a reply.
    """

    t_ns: int
    time: datetime | None
    bus: str
    dialect: str
    address: int
    role: str
    command: str
    fields: Mapping[str, Any]
    units: Mapping[str, Any]
    checksum_ok: bool
    findings: tuple[Finding, ...]
    raw: bytes
    can_id: int | None
    latency_ns: int | None
    sequence: int
    request_sequence: int | None
    topic: str

    def __getitem__(self, name: str) -> Any:
        return self.fields[name]


@dataclass(slots=True)
class Transaction:
    """A request and its replies.

    `request` None: a reply that came when its request was long done, or without one. `outcome`: answered, failed, running (no
    final reply came), damaged (its checksum is wrong), unanswered, or silent (none was due).
    """

    request: Frame | None
    replies: tuple[Frame, ...] = ()
    outcome: str = "silent"
    findings: tuple[Finding, ...] = ()

    @property
    def first(self) -> Frame:
        """The request, or the reply that stands alone."""
        return self.replies[0] if self.request is None else self.request

    @property
    def reply(self) -> Frame | None:
        """The last reply."""
        return self.replies[-1] if self.replies else None

    @property
    def latency_ns(self) -> int | None:
        """From the end of the request to the start of the first reply; None where that is not known."""
        return self.replies[0].latency_ns if self.replies else None


def frame_of(entry: Entry, clock: Clock = Clock.UTC) -> Frame:
    """Return an entry of the pipeline as a frame."""
    message, frame = entry.message, entry.message.frame
    got = physical(message)
    fields = {
        name: got.get(f"{name}_name", value)
        for name, value in got.items()
        if not (name.endswith("_name") and name.removesuffix("_name") in got)
    }
    dated = clock is not Clock.DAY and is_dated(frame.last_ns)
    moment = _EPOCH + timedelta(microseconds=frame.last_ns // 1000) if dated else None
    return Frame(
        frame.last_ns,
        moment.replace(tzinfo=None) if moment is not None and clock is Clock.PRINTED else moment,
        frame.port,
        "" if message.role is Role.FOREIGN else frame.dialect.name,
        message.address,
        message.role.value,
        "" if message.command is None else message.command.name,
        fields,
        units_of(message),
        frame.checksum_ok,
        entry.findings,
        frame.data,
        None if frame.can is None else frame.can.id,
        entry.latency_ns if entry.request_sequence is not None else None,
        entry.sequence,
        entry.request_sequence,
        entry.topic,
    )


class Records(Generic[T]):
    """Records of one kind. Each iteration decodes the capture from its beginning."""

    def __init__(self, look: Callable[[], Iterator[T]], what: str) -> None:
        self._look = look
        self._what = what

    def __iter__(self) -> Iterator[T]:
        return self._look()

    def __repr__(self) -> str:
        return f"<{self._what}>"


class _Kept:
    """A sink that keeps what came since it was last emptied."""

    def __init__(self) -> None:
        self._came: list[Entry | Junk | Finding] = []

    def entry(self, entry: Entry) -> None:
        self._came.append(entry)

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        self._came.append(junk)

    def finding(self, found: Finding) -> None:
        self._came.append(found)

    def comment(self, comment: Comment) -> None:
        pass

    def taken(self) -> list[Entry | Junk | Finding]:
        came, self._came = self._came, []
        return came


class Capture:
    """A capture of any format, a log, or a folder of parts.

    `dialect`, `model`, `ids`, `since` and `until` as for `servotap show`; `channels`, `inverted` and `uart` (`8E1`) of a logic
    analyzer; `dbc`, `modbus_map`: files that describe the other devices of the bus. Raises UnreadableError, UsageError.

    `dialects`: those that were chosen; `format`: what it is; `notes`: what a reader of it should know. A capture that breaks
    off gives what came before, with a warning.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        dialect: str = "auto",
        model: str | None = None,
        baud: int | None = None,
        format: str | None = None,
        channels: Sequence[str] = (),
        inverted: bool = False,
        uart: str = "",
        groups: Collection[int] = (),
        ids: str = "",
        dbc: Collection[str | os.PathLike[str]] = (),
        modbus_map: Collection[str | os.PathLike[str]] = (),
        since: str | None = None,
        until: str | None = None,
    ) -> None:
        check(
            path=path, dialect=dialect, model=model, baud=baud, format=format, channels=channels, uart=uart, groups=groups,
            ids=ids, dbc=dbc, modbus_map=modbus_map, since=since, until=until,
        )  # fmt: skip
        self.path = Path(path)
        if str(path) == "-":
            raise UsageError("standard input can be read once only: give a file")
        parser = argparse.ArgumentParser()
        add_reading_arguments(parser)
        self._options = parser.parse_args([])
        vars(self._options).update(
            dialect=dialect,
            model=model,
            baud=baud,
            format=format,
            channel=list(channels),
            inverted=inverted,
            uart=uart,
            group=list(groups),
            ids=[ids] if ids else [],
            dbc=[os.fspath(each) for each in dbc],
            modbus_map=[os.fspath(each) for each in modbus_map],
            since=None if since is None else parse_time(since),
            until=None if until is None else parse_time(until),
        )
        self._recorded: Recorded | None = None
        self._seen: tuple[tuple[str, int, int], ...] = ()
        with self._reading() as reading:
            self.dialects = tuple(d.name for d in reading.dialects)
            self.format: str = reading.source.format
            self.notes = tuple(reading.source.notes)
            self._clock = reading.source.clock

    def __repr__(self) -> str:
        return f"<Capture {self.path.name}: {self.format}, {', '.join(self.dialects)}>"

    def __enter__(self) -> Capture:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Drop the rows that are kept for tables. The capture can still be used."""
        if self._recorded is not None:
            self._recorded.close()
            self._recorded = None

    # --- records ------------------------------------------------------------------------------------------------------

    @property
    def frames(self) -> Records[Frame]:
        """All frames, decoded."""
        return Records(self._frames, f"frames of {self.path.name}")

    @property
    def findings(self) -> Records[Finding]:
        """What is wrong, in the order in which it was told."""
        return Records(lambda: (each for each in self._look() if isinstance(each, Finding)), f"findings of {self.path.name}")

    @property
    def junk(self) -> Records[Junk]:
        """Bytes that belong to no frame, and why."""
        return Records(lambda: (each for each in self._look() if isinstance(each, Junk)), f"junk of {self.path.name}")

    @property
    def transactions(self) -> Records[Transaction]:
        """Requests with their replies, in the order of the requests."""
        return Records(self._transactions, f"transactions of {self.path.name}")

    def _frames(self) -> Iterator[Frame]:
        return (frame_of(each, self._clock) for each in self._look() if isinstance(each, Entry))

    def _transactions(self) -> Iterator[Transaction]:
        waiting: OrderedDict[int, Transaction] = OrderedDict()
        for each in self._look():
            if isinstance(each, Finding):
                asked = waiting.get(each.sequence)
                if asked is not None and asked.request is not None and each not in asked.request.findings:
                    asked.findings += (each,)
                    asked.outcome = "unanswered" if each.rule == "unanswered" else asked.outcome
            elif isinstance(each, Entry):
                frame = frame_of(each, self._clock)
                if frame.role == "request":
                    waiting[frame.sequence] = Transaction(frame, findings=frame.findings)
                elif frame.role == "reply":
                    asked = waiting.get(frame.request_sequence or 0)
                    meaning = meaning_of(each.message, each.message.command)[0]
                    outcome = _OUTCOMES[meaning] if frame.checksum_ok else "damaged"
                    if asked is None:
                        yield Transaction(None, (frame,), outcome, frame.findings)
                    else:
                        asked.replies += (frame,)
                        asked.findings += frame.findings
                        asked.outcome = outcome
                if len(waiting) > _MOST_OPEN:
                    yield waiting.popitem(last=False)[1]
        yield from waiting.values()

    @contextlib.contextmanager
    def _reading(self) -> Iterator[OpenCapture]:
        reading = open_reading(str(self.path), self._options)
        with contextlib.closing(reading.source):
            yield reading

    def _look(self) -> Iterator[Entry | Junk | Finding]:
        kept = _Kept()
        with self._reading() as reading:
            pipeline = reading.pipeline((kept,))
            try:
                for item in reading:
                    pipeline.feed(item)
                    yield from kept.taken()
            except UnreadableError as error:
                if not pipeline.sequence:
                    raise
                _warn(f"{self.path.name} breaks off: {error}")
            pipeline.close()
            yield from kept.taken()
            self._end(reading)

    def _end(self, reading: OpenCapture) -> None:
        """Take over what is known at the end, and warn of what could not be read."""
        source = reading.source
        self.notes = tuple(source.notes)
        if source.problem_count:
            more = f", and {source.problem_count - 1} more places" if source.problem_count > 1 else ""
            _warn(f"{self.path.name}: {source.problems[0]}{more}")

    # --- tables -------------------------------------------------------------------------------------------------------

    def to_arrow(
        self,
        *,
        wide: bool = False,
        rate: str | float | None = None,
        topics: str | Sequence[str] = (),
        fields: str | Sequence[str] = (),
    ) -> pyarrow.Table:
        """Return a table as `servotap export` writes it: a row a message; with `wide` or a `rate` (Hz) a column for each field.

        Units, sections and choices stand in the metadata of the columns.
        """
        from analyzer.table.arrow import arrow_table

        needed("pyarrow")
        return arrow_table(self._table(wide, rate, topics, fields))

    def to_pandas(
        self,
        *,
        wide: bool = False,
        rate: str | float | None = None,
        topics: str | Sequence[str] = (),
        fields: str | Sequence[str] = (),
    ) -> pandas.DataFrame:
        """Return the table of `to_arrow` as a data frame; whole numbers and flags may be missing (Int64, boolean).

        `attrs["units"]` holds the units by column.
        """
        library = needed("pandas")
        table = self.to_arrow(wide=wide, rate=rate, topics=topics, fields=fields)
        arrow = needed("pyarrow")
        kinds = {arrow.int64(): library.Int64Dtype(), arrow.bool_(): library.BooleanDtype()}
        frame: pandas.DataFrame = table.to_pandas(types_mapper=kinds.get)
        frame.attrs["units"] = {
            each.name: each.metadata[b"unit"].decode() for each in table.schema if b"unit" in (each.metadata or {})
        }
        return frame

    def to_polars(
        self,
        *,
        wide: bool = False,
        rate: str | float | None = None,
        topics: str | Sequence[str] = (),
        fields: str | Sequence[str] = (),
    ) -> polars.DataFrame:
        """Return the table of `to_arrow` as a data frame of polars."""
        made: polars.DataFrame = needed("polars").from_arrow(self.to_arrow(wide=wide, rate=rate, topics=topics, fields=fields))
        return made

    def plot(self, *names: str, topics: str | Sequence[str] = ()) -> list[Axes]:
        """Plot fields over time, one below the other: `speed`, `position` of the drives' states, or any field or column.

        Return the axes; `axes[0].figure.savefig(...)` or `matplotlib.pyplot.show()` shows them.
        """
        from servotap.plots import plot

        check(names=names)
        return plot(Wide(self._rows(), Chosen(_listed(topics))), names, self.path.name)

    def _table(self, wide: bool, rate: str | float | None, topics: str | Sequence[str], fields: str | Sequence[str]) -> Table:
        chosen = Chosen(_listed(topics), _listed(fields))
        step: Fraction | None = None if rate is None else parse_rate(str(rate))
        recorded = self._rows()
        return Wide(recorded, chosen, step) if wide or step is not None else Long(recorded, chosen)

    def _rows(self) -> Recorded:
        """Return the rows of the capture, kept from the last time where it has not changed since."""
        with self._reading() as reading:
            seen = tuple((str(f), f.stat().st_size, f.stat().st_mtime_ns) for f in reading.source.files)
            if self._recorded is None or seen != self._seen:
                self.close()
                self._recorded = keep_rows(reading, reading)
                self._seen = seen
                if "incomplete" in self._recorded.about:
                    _warn(f"{self.path.name} breaks off: {self._recorded.about['incomplete']}")
                self._end(reading)
        return self._recorded


_OUTCOMES = {"final": "answered", "failed": "failed", "interim": "running"}


def _listed(given: str | Sequence[str]) -> list[str]:
    check(listed=given)
    return [word.strip() for word in (given.split(",") if isinstance(given, str) else given) if word.strip()]


def _warn(text: str) -> None:
    warnings.warn(text, stacklevel=4)
