"""Decode a capture of any format into an annotated MCAP log or Parquet tables, and end with a summary.

The log is written next to the capture as FILE.mcap, or to the file of -o. With --dialect auto (the default) the dialects
are ranked on the data, and the reason is shown.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analyzer import __version__
from analyzer.cli.option_types import positive
from analyzer.cli.output import Output, OutputFolder, target_of
from analyzer.cli.reading import OpenCapture, add_reading_arguments, now_text, open_reading, progress
from analyzer.cli.signals import Interrupt
from analyzer.diagnosis.diagnose import Diagnosis, diagnosis, lines
from analyzer.diagnosis.watch import Watch
from analyzer.errors import UnreadableError, UsageError
from analyzer.pipeline import Pipeline, Sink
from analyzer.records import Severity
from analyzer.sinks.forked import available
from analyzer.sinks.mcap_file import McapFile
from analyzer.sinks.mcap_log import LIBRARY, PROFILE, McapLog
from analyzer.sinks.process import SinkProcess
from analyzer.sinks.summary import Summary
from analyzer.table.extras import needed
from analyzer.values import printable

if TYPE_CHECKING:
    from analyzer.sinks.parquet import ParquetTables
    from analyzer.sinks.workers import Workers

#: From this size on, in bytes, writing in a process of its own is worth starting one.
LONG_CAPTURE = 1 << 20

EXAMPLES = """\
examples:
  servotap decode capture.log                         writes capture.log.mcap
  servotap decode wire.bin --dialect mks-rs485 --baud 38400
  servotap decode a.log b.pcapng -o logs/             a folder that exists
  candump -L can0 | servotap decode - -o can.mcap
  servotap decode old.mcap -o new.mcap --dialect mks-modbus
  servotap decode week.mcap --since +10min --until +11min -o minute.mcap
  servotap decode week/ -o logs/                      all captures of a folder; logs/ is made if it is missing
  servotap decode can.log --to parquet                a folder can.log.parquet: a table for each command
"""


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


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
    parser.add_argument("--jobs", type=positive, default=cores(), metavar="N", help="processes at most (default: the cores)")


def run(arguments: argparse.Namespace) -> int:
    """Decode each file; return 0, 1 for errors found under --strict, 2 for a file that could not be read."""
    if arguments.to == "parquet":
        # What is missing is told before anything is made.
        needed("pyarrow")
    status = 0
    targets: list[Path] = []
    arguments.files = [capture for path in arguments.files for capture in _captures(path, arguments)]
    for path in arguments.files:
        targets.append(_target(path, arguments, targets))
    for number, (path, target) in enumerate(zip(arguments.files, targets, strict=True), 1):
        try:
            summary = decode(path, target, arguments, f" ({number} of {len(targets)})" if len(targets) > 1 else "")
        except UnreadableError as error:
            if len(targets) == 1:
                raise
            print(f"servotap decode: {printable(str(error))}", file=sys.stderr)
            status = 2
            continue
        if arguments.strict and summary.severities[Severity.ERROR]:
            status = max(status, 1)
    return status


def _captures(path: str, arguments: argparse.Namespace) -> list[str]:
    """Return the captures that a name stands for: of a folder without logs each file, else the capture or log itself.

    The folder for their logs is made where it is missing.
    """
    folder = Path(path)
    if path == "-" or not folder.is_dir() or any(folder.glob("*.mcap")):
        return [path]
    found = sorted(each for each in folder.iterdir() if each.is_file() and not each.name.startswith("."))
    if not found:
        raise UnreadableError(f"{folder} is a directory without files, expected captures, or the parts of a recording (*.mcap)")
    if arguments.output is None:
        raise UsageError(f"{folder} is a folder of captures: name the folder for their logs with -o")
    target = target_of(Path(arguments.output))
    try:
        target.mkdir(exist_ok=True)
    except OSError as error:
        raise UsageError(f"-o {target}: expected a folder for the logs of {folder}: {error.strerror}") from None
    return [str(each) for each in found]


def _target(path: str, arguments: argparse.Namespace, taken: Sequence[Path]) -> Path:
    """Return the log of a capture, or the folder of its tables: another one than those that are taken."""
    end = "." + arguments.to
    if arguments.output is None:
        if path == "-":
            raise UsageError("standard input has no file name: name the log with -o")
        if Path(path).is_dir():
            # Next to the folder: inside it the log would be taken for one more part.
            folder = Path(path).resolve()
            target = folder.with_name(folder.name + ".decoded" + end)
        else:
            target = Path(path.removesuffix(end) + ".decoded" + end if path.endswith(end) else path + end)
    else:
        target = target_of(Path(arguments.output))
        # A folder of tables that was named so is replaced; in any other the tables of each capture have one.
        if target.is_dir() and target.suffix != ".parquet":
            target = target / (Path("standard_input" if path == "-" else path).name + end)
        elif len(arguments.files) > 1:
            raise UsageError(f"-o {arguments.output} is one file for {len(arguments.files)} captures; give a folder")
    first, number = target, 1
    while target in taken:
        number += 1
        target = first.with_name(f"{first.stem}-{number}{end}")
    if target is not first:
        print(
            f"note: {printable(str(first))} is the log of another capture: {printable(path)} goes to {printable(target.name)}",
            file=sys.stderr,
        )
    if arguments.to == "mcap" and target.exists() and not target.is_file():
        raise UsageError(f"{target} is not a regular file: cannot write a log there")
    if path != "-" and target.exists() and Path(path).exists() and target.samefile(path):
        raise UsageError(f"{target} is the capture itself; choose another name with -o")
    if target.exists() and not arguments.force:
        raise UsageError(f"{target} exists; --force replaces it")
    return target


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
        source.in_blocks = long and source.gives_blocks and not reading.time_range.wanted
        several = long and jobs > 1 and available()
        if several and source.in_blocks and isinstance(output, Output):
            # What is loaded before the workers begin, they share.
            from analyzer.sinks.workers import MOST, Workers

            self._workers = Workers(min(jobs - 1, MOST), reading.possible)

        def make() -> tuple[McapLog | ParquetTables, Summary]:
            if isinstance(output, OutputFolder):
                from analyzer.sinks.parquet import ParquetTables

                return ParquetTables(output.part, source.clock), Summary()
            byte_ns, bit_ns = options.byte_ns, options.synthetic_bit_ns
            file = McapFile(output.stream, profile=PROFILE, library=LIBRARY, packer=self._workers)
            return McapLog(file, byte_ns=byte_ns, bit_ns=bit_ns, clock=source.clock), Summary()

        self.given: tuple[Sink, ...]
        if several and self._workers is None:
            self._process = SinkProcess(reading.possible, make)
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
        """Make the log whole."""
        if self._process is None:
            self._log.finish(metadata)
        else:
            self._process.call(0, "finish", dict(metadata))
            self._process.close()

    def abandon(self) -> None:
        """Give the log up."""
        if self._process is None:
            self._log.abandon()
        else:
            self._process.abandon()


def decode(path: str, target: Path, arguments: argparse.Namespace, place: str = "") -> Summary:
    """Decode one capture into one log and print its summary. `place`: which of several it is, for the progress."""
    reading = open_reading(path, arguments)
    # What is loaded by now stays: the collector need not look at it again and again while records come and go, and a
    # worker that is forked shares it untouched.
    gc.freeze()
    try:
        return _decode(target, reading, arguments, place)
    finally:
        gc.unfreeze()


def _decode(target: Path, reading: OpenCapture, arguments: argparse.Namespace, place: str) -> Summary:
    # From before the log exists to when it is whole, Ctrl-C ends the reading and nothing else.
    with contextlib.closing(reading.source), Interrupt() as interrupt:
        output = (OutputFolder if arguments.to == "parquet" else Output)(target, arguments.force)
        sinks = _Sinks(reading, output, arguments.jobs)
        watch = Watch()
        pipeline = reading.pipeline((*sinks.given, watch))
        stopped = ""
        try:
            try:
                with progress(reading.source, f"decoding {reading.source.name}{place}"):
                    for item in interrupt.items(reading):
                        watch.take(item)
                        pipeline.feed(item)
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
    _report(reading, pipeline, summary, target, arguments, stopped)
    if not arguments.json:
        _tell_causes(diagnosis(watch, reading.dialects))
    if stopped.startswith("stopped"):
        raise KeyboardInterrupt
    return summary


def _metadata(
    reading: OpenCapture, pipeline: Pipeline, summary: Summary, arguments: argparse.Namespace, stopped: str
) -> dict[str, str]:
    source = reading.source
    total = sum(port.bytes_in - port.start for port in pipeline.ports.values()) - reading.time_range.unseen_bytes
    _account(total, summary)
    values = {
        "source": source.name,
        "source_size": str(source.size if source.size is not None else source.position()),
        "format": source.format,
        "dialect": ",".join(d.name for d in reading.dialects),
        "dialect_reason": reading.choice.reason,
        "manual": "; ".join(d.manual for d in reading.dialects),
        "time_source": reading.time_source,
        "version": __version__,
        "decoded_at": now_text(),
        "bytes_total": str(total),
        "bytes_in_frames": str(summary.frame_bytes),
        "bytes_junk": str(sum(summary.junk_bytes.values())),
        "frames": str(summary.frames),
        "findings": str(sum(summary.findings.values())),
    }
    if pipeline.in_runs:
        values["frames_by_columns"] = str(pipeline.in_runs)
    if source.sha256:
        values["source_sha256"] = source.sha256
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


def _account(total: int, summary: Summary) -> None:
    """Raise if a byte was lost or accounted twice: that would be a fault of this program."""
    accounted = summary.frame_bytes + sum(summary.junk_bytes.values())
    if accounted != total:
        raise RuntimeError(f"{total} bytes came in, {accounted} accounted for")


def _tell_causes(found: Diagnosis) -> None:
    """Say what is wrong, where a cause was found."""
    for line in lines(found) if found.causes else ():
        print(printable(line))


def _report(
    reading: OpenCapture, pipeline: Pipeline, summary: Summary, target: Path, arguments: argparse.Namespace, stopped: str
) -> None:
    if arguments.json:
        import json

        whole: dict[str, Any] = {
            "file": reading.source.path,
            "log": str(target),
            "format": reading.source.format,
            "dialects": [d.name for d in reading.dialects],
            "reason": reading.choice.reason,
            "time_source": reading.time_source,
            **summary.as_object(),
            "notes": list(reading.source.notes) + ([stopped] if stopped else []),
        }
        print(json.dumps(whole))
        return
    from analyzer.cli.summary_text import print_summary

    print_summary(reading, summary, target, stopped)
