"""Decode captures of any format into annotated MCAP logs or Parquet tables, and end with a summary.

The log is written next to the capture as FILE.mcap, or to the file of -o. With --dialect auto (the default) the dialects
are ranked on the data, and the reason is shown.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analyzer.cli.decode_targets import Capture, captures
from analyzer.cli.option_types import positive
from analyzer.cli.output import Output, OutputFolder
from analyzer.cli.reading import LONG_CAPTURE, OpenCapture, add_reading_arguments, now_text, open_reading, progress
from analyzer.cli.signals import Interrupt
from analyzer.diagnosis.watch import Watch
from analyzer.entries import Sink
from analyzer.errors import UnreadableError, UsageError
from analyzer.pipeline import Pipeline
from analyzer.records import Severity
from analyzer.sinks.forked import available
from analyzer.sinks.summary import Summary
from analyzer.table.extras import needed
from analyzer.values import printable

if TYPE_CHECKING:
    from analyzer.sinks.mcap_log import McapLog
    from analyzer.sinks.object_table import Table
    from analyzer.sinks.parquet import ParquetTables
    from analyzer.sinks.process import SinkProcess
    from analyzer.sinks.workers import Workers

EXAMPLES = """\
examples:
  servotap decode capture.log                         writes capture.log.mcap
  servotap decode wire.bin --dialect mks-rs485 --baud 38400
  servotap decode a.log b.pcapng -o logs/             a folder that exists
  candump -L can0 | servotap decode - -o can.mcap
  servotap decode scope.sr --channel RX               levels of a logic analyzer; by itself it finds channel and rate
  servotap decode old.mcap -o new.mcap --dialect mks-modbus
  servotap decode week.mcap --since +10min --until +11min -o minute.mcap
  servotap decode week/ -o logs/                      all captures of a folder and its subfolders, several at once
  servotap decode long.blf --jobs 1                   in one process; the log is the same
  servotap decode can.log --dbc battery.dbc --dbc charger.dbc
  servotap decode bus.log --modbus-map meter.csv
  servotap decode can.log --to parquet                a folder can.log.parquet: a table for each command
"""


#: Cores that one process uses.
_OF_ONE_PROCESS = 2


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def processes(cores: int) -> int:
    """Return how many processes decode one capture soonest: one process uses two cores, as a thread of it packs the log."""
    return 1 if cores <= _OF_ONE_PROCESS else cores


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "files", nargs="+", metavar="FILE", help="captures, logs, folders of them or of parts; - reads standard input"
    )
    parser.add_argument("-o", "--output", metavar="OUT.mcap", help="the log, or a folder for several")
    parser.add_argument("--to", choices=("mcap", "parquet"), default="mcap", help="a log, or a folder of Parquet tables")
    add_reading_arguments(parser)
    parser.add_argument("--strict", action="store_true", help="exit with 1 if there are findings of severity error")
    parser.add_argument("--json", action="store_true", help="print the summary as JSON, one line per file")
    parser.add_argument("--force", action="store_true", help="replace a log that exists")
    parser.add_argument(
        "--jobs", type=positive, metavar="N", help="processes at most (default: the cores; one process uses two for a capture)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Decode each file; return 0, 1 for errors found under --strict, 2 for a file that could not be read."""
    if arguments.to == "parquet":
        # What is missing is told before anything is made.
        needed("pyarrow")
    found = captures(arguments)
    if len(found) == 1:
        arguments.jobs = arguments.jobs or processes(cores())
        done = decode(found[0], arguments, watched_here)
        done.report(arguments)
        if done.stopped.startswith("stopped"):
            raise KeyboardInterrupt
        return done.status(arguments)
    from analyzer.cli.decode_many import Far, Outcome, decode_many

    arguments.jobs = arguments.jobs or cores()

    def decode_one(capture: Capture, arguments: argparse.Namespace, far: Far) -> Outcome:
        done = decode(capture, arguments, lambda reading, frames: far.noting(reading.source.position, frames))
        # The evidence is told by `servotap diagnose`.
        causes = [text for text in done.causes() if not text.startswith(" ")]
        return Outcome(done.as_object(), causes, stopped=done.stopped.startswith("stopped"), status=done.status(arguments))

    return decode_many(found, arguments, decode_one)


def _table(reading: OpenCapture) -> Table:
    """Return the objects that processes tell each other of; most often no other dialect comes up, and none is loaded."""
    from analyzer.sinks.object_table import Table

    return Table(reading.dialects, lambda: reading.possible)


class _Sinks:
    """The log and the summary of a capture. Where it is long, other processes have a share of the work.

    `jobs`: processes in all. Rows of a log are packed by workers; tables, and frames that come one by one, are written by
    another process.
    """

    def __init__(self, reading: OpenCapture, output: Output | OutputFolder, jobs: int) -> None:
        self._source, options = reading.source, reading.options
        source = self._source
        self._process: SinkProcess | None = None
        self._workers: Workers | None = None
        long = source.size is not None and source.size >= LONG_CAPTURE
        source.in_blocks = long and not reading.time_range.wanted
        if source.in_blocks:
            from analyzer.columns import memory, rows  # noqa: F401

            memory.keep()
            # What columns are made by is loaded now, and stays as all that was loaded before.
            gc.freeze()
        several = long and jobs > 1 and available()
        if several and source.in_blocks and isinstance(output, Output):
            from analyzer.sinks.workers import MOST, Workers

            source.workers = self._workers = Workers(min(jobs - 1, MOST), _table(reading))

        def make() -> tuple[McapLog | ParquetTables, Summary]:
            if isinstance(output, OutputFolder):
                from analyzer.sinks.parquet import ParquetTables
                from analyzer.sinks.parquet_file import files_in

                return ParquetTables(files_in(output.part), source.clock), Summary()
            from analyzer.sinks.mcap_file import McapFile
            from analyzer.sinks.mcap_log import LIBRARY, PROFILE, McapLog

            byte_ns, bit_ns = options.byte_ns, options.synthetic_bit_ns
            file = McapFile(output.stream, profile=PROFILE, library=LIBRARY, packer=self._workers)
            return McapLog(file, byte_ns=byte_ns, bit_ns=bit_ns, clock=source.clock), Summary()

        self.given: tuple[Sink, ...]
        if several and self._workers is None:
            from analyzer.sinks.process import SinkProcess

            self._process = SinkProcess(_table(reading), make)
            self.given = (self._process,)
        else:
            self._log, self._summary = make()
            self.given = (self._log, self._summary)

    def summary(self) -> Summary:
        """Return the counts of everything so far."""
        if self._workers is not None:
            self._workers.settle()
            for how in self._workers.died:
                self._source.note(f"a process that packed the log ended early ({how}); what it was to do was done again")
        if self._process is None:
            return self._summary.settle()
        accounted: Summary = self._process.call(1, "settle")
        return accounted

    def finish(self, metadata: Mapping[str, str]) -> None:
        if self._process is None:
            self._log.finish(metadata)
        else:
            self._process.call(0, "finish", dict(metadata))
            self._process.close()

    def abandon(self) -> None:
        if self._process is None:
            self._log.abandon()
        else:
            self._process.abandon()


@dataclass
class _Done:
    """A capture that was decoded. `stopped`: what ended it before its end."""

    reading: OpenCapture
    summary: Summary
    target: Path
    watch: Watch
    stopped: str

    def status(self, arguments: argparse.Namespace) -> int:
        return 1 if arguments.strict and self.summary.severities[Severity.ERROR] else 0

    def as_object(self) -> dict[str, Any]:
        reading = self.reading
        return {
            "file": reading.source.path,
            "log": str(self.target),
            "format": reading.source.format,
            "dialects": [d.name for d in reading.dialects],
            "reason": reading.choice.reason,
            "time_source": reading.time_source,
            **self.summary.as_object(),
            "notes": list(reading.source.notes) + ([self.stopped] if self.stopped else []),
        }

    def causes(self) -> list[str]:
        """Return what is wrong, where a cause was found."""
        scenes = [] if self.watch.quiet else self.watch.scenes(self.reading.dialects)
        if not scenes:
            # Nothing has to be explained, so nothing that explains is loaded.
            return []
        from analyzer.diagnosis.diagnose import lines, weighed

        found = weighed(scenes)
        return lines(found) if found.causes else []

    def report(self, arguments: argparse.Namespace) -> None:
        if arguments.json:
            import json

            print(json.dumps(self.as_object()))
            return
        from analyzer.cli.summary_text import print_summary

        print_summary(self.reading, self.summary, self.target, self.stopped)
        for text in self.causes():
            print(printable(text))


#: Shows or notes how far a capture has come; it is given what counts the frames.
Progress = Callable[[OpenCapture, Callable[[], int]], contextlib.AbstractContextManager[None]]


def watched_here(reading: OpenCapture, frames: Callable[[], int]) -> contextlib.AbstractContextManager[None]:
    """Show on the terminal how far a capture has come."""
    return progress(reading.source, f"decoding {reading.source.name}", frames)


def decode(capture: Capture, arguments: argparse.Namespace, watched: Progress) -> _Done:
    """Decode one capture into one log."""
    reading = open_reading(capture.path, arguments)
    # What is loaded by now stays: the collector need not look at it again and again while records come and go, and a
    # worker that is forked shares it untouched.
    gc.freeze()
    try:
        return _decode(capture, reading, arguments, watched)
    finally:
        gc.unfreeze()


def _decode(capture: Capture, reading: OpenCapture, arguments: argparse.Namespace, watched: Progress) -> _Done:
    # From before the log exists to when it is whole, Ctrl-C ends the reading and nothing else.
    target = capture.target
    with contextlib.closing(reading.source), Interrupt() as interrupt:
        capture.make_folder()
        replaces = target.exists()
        output = (OutputFolder if arguments.to == "parquet" else Output)(target, arguments.force)
        sinks = _Sinks(reading, output, arguments.jobs)
        watch = Watch()
        pipeline = reading.pipeline((*sinks.given, watch))
        stopped = ""
        try:
            try:
                with watched(reading, lambda: pipeline.sequence):
                    for item in interrupt.items(reading):
                        watch.take(item)
                        pipeline.feed(item)
                if interrupt.asked and replaces:
                    # A part of a capture is no replacement for what may be all of it.
                    raise KeyboardInterrupt
                if interrupt.asked:
                    stopped = f"stopped by {interrupt.asked}"
            except UnreadableError as error:
                if not pipeline.sequence:
                    raise
                stopped = f"the capture is incomplete: {error}"
            pipeline.close()
            summary = sinks.summary()
            sinks.finish(_metadata(reading, pipeline, summary, arguments, stopped))
            output.keep()
        except OSError as error:
            sinks.abandon()
            output.drop()
            raise UsageError(f"cannot write {target}: {error.strerror or error}; the incomplete log was removed") from None
        except BaseException:
            sinks.abandon()
            output.drop()
            raise
    return _Done(reading, summary, target, watch, stopped)


def _metadata(
    reading: OpenCapture, pipeline: Pipeline, summary: Summary, arguments: argparse.Namespace, stopped: str
) -> dict[str, str]:
    source = reading.source
    total = pipeline.bytes_in - reading.time_range.unseen_bytes
    accounted = summary.frame_bytes + sum(summary.junk_bytes.values())
    if accounted != total:
        # A byte was lost or accounted twice: a fault of this program.
        raise RuntimeError(f"{total} bytes came in, {accounted} accounted for")
    values = {
        "source": source.name,
        "source_size": str(source.size if source.size is not None else source.position()),
        "format": source.format,
        "dialect_reason": reading.choice.reason,
        "time_source": reading.time_source,
        "decoded_at": now_text(),
        **summary.about(reading.dialects, total),
    }
    if pipeline.in_runs:
        values["frames_by_columns"] = str(pipeline.in_runs)
    if source.sha256:
        values["source_sha256"] = source.sha256
    for file in reading.device_files:
        values |= file.about
    if reading.model:
        values["model"] = reading.model
    values |= reading.time_range.about()
    if arguments.baud:
        values["bit_rate" if reading.dialects[0].bus == "can" else "baud"] = str(arguments.baud)
    if stopped:
        values["incomplete"] = stopped
    if source.notes:
        values["notes"] = "; ".join(source.notes)
    return values
