"""Write captures and logs as one page for the browser: what was captured, what is wrong, all values over time.

The page is one file that needs no network. A log is not decoded again; a capture is decoded first. Several files stand on one
page, one behind the other.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from pathlib import Path

from analyzer.cli.as_log import as_log
from analyzer.cli.output import free_target, inputs, write_whole
from analyzer.cli.reading import add_reading_arguments, open_reading
from analyzer.diagnosis.diagnose import Diagnosis, diagnosis
from analyzer.diagnosis.watch import Watch
from analyzer.errors import UnreadableError, UsageError
from analyzer.report.page import Log, Unread, html
from analyzer.report.traffic import Traffic
from analyzer.sources.times import Anchor, TimeOption
from analyzer.values import printable, storable

EXAMPLES = """\
exit status: 0; 2 if a file could not be read.

examples:
  servotap report week.mcap                         writes week.html
  servotap report capture.log -o capture.html
  servotap report monday.mcap tuesday.mcap -o both.html
  servotap report week.mcap --since -10min -o end.html
"""

#: Frames of a log that are decoded again for the diagnosis, from its first finding on.
LOOKED = 50_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "files", nargs="+", metavar="FILE", help="captures, logs, folders with the parts of a recording; - reads standard input"
    )
    parser.add_argument("-o", "--output", metavar="OUT.html", help="the page (default: FILE.html, for one FILE)")
    parser.add_argument("--force", action="store_true", help="replace a page that exists")
    add_reading_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Write the page; return 0, 2 if a file could not be read. Raises UnreadableError where there is none other."""
    target = _target(arguments)
    logs: list[Log | Unread] = []
    status = 0
    for path in arguments.files:
        try:
            logs.append(_log(path, arguments))
        except UnreadableError as error:
            # A page without any capture is worth nothing.
            if len(arguments.files) == 1:
                raise
            print(f"servotap report: {printable(str(error))}", file=sys.stderr)
            logs.append(Unread(storable(Path(path).name), str(error)))
            status = 2
    data = html(logs).encode(errors="backslashreplace")
    write_whole(target, data, replace=arguments.force)
    for log in logs:
        if isinstance(log, Log):
            print(printable(f"{log.name}: {log.verdict}"))
    print(printable(f"wrote {target}, {len(data) / 1e6:.1f} MB"))
    return status


def _target(arguments: argparse.Namespace) -> Path:
    """Return the file to write. Raises UsageError where it cannot be."""
    if arguments.output is not None:
        target = Path(arguments.output)
    elif len(arguments.files) > 1 or arguments.files[0] == "-":
        raise UsageError("name the page with -o OUT.html")
    else:
        target = Path(str(Path(arguments.files[0])).removesuffix(".mcap") + ".html")
    return free_target(target, arguments.force, inputs((*arguments.files, *arguments.dbc, *arguments.modbus_map)))


def _log(path: str, arguments: argparse.Namespace) -> Log:
    """Read a capture as a log, and look for what is wrong with it."""
    with as_log(path, arguments) as log:
        traffic = Traffic(log.source, log.since_ns, log.until_ns)
        traffic.read()
        notes = [*log.source.notes, *log.notes]
    looked = ""
    if log.watch is None:
        found, looked = _diagnosis(path, arguments, traffic)
    else:
        found = diagnosis(log.watch, log.dialects)
    return Log(log.name, traffic, log.shown, found, looked, notes)


def _diagnosis(path: str, arguments: argparse.Namespace, traffic: Traffic) -> tuple[Diagnosis, str]:
    """Return what is wrong in a log, and which part of it was looked at where it is long."""
    given = argparse.Namespace(**vars(arguments))
    since_ns = traffic.first_finding_ns
    long = traffic.frames > LOOKED
    if long and since_ns is not None:
        given.since = TimeOption(Anchor.CLOCK, since_ns, "")
    watch = Watch()
    try:
        reading = open_reading(path, given)
    except UnreadableError as error:
        return Diagnosis("none", (), 0), f"There is no diagnosis, for the log cannot be decoded again: {error}"
    with contextlib.closing(reading.source):
        pipeline = reading.pipeline([watch])
        for item in reading:
            watch.take(item)
            pipeline.feed(item)
            if watch.frames >= LOOKED:
                break
        else:
            # What still waits for its reply at the end has got none; where the looking ends, that is not known.
            pipeline.close()
    looked = ""
    if long:
        begin = "its first finding" if since_ns is not None else "its beginning"
        looked = f"The diagnosis looked at {watch.frames:,} frames from {begin} on; servotap diagnose looks at all."
    return diagnosis(watch, reading.dialects), looked
