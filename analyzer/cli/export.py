"""Export the raw bytes of a capture or a log for other programs: candump, pcapng for Wireshark, plain hex text.

Nothing is decoded. A decoded log gives one piece for each frame, with the role it was found to have; --chunks gives its
bytes as they came. The file stands beside the capture unless -o says otherwise, and is whole or not there.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO

from analyzer.cli.option_types import positive
from analyzer.cli.output import Output
from analyzer.cli.reading import progress
from analyzer.cli.signals import Interrupt
from analyzer.cli.time_range import TimeRange, add_time_range_arguments
from analyzer.errors import UnreadableError, UsageError
from analyzer.export import CAN, FORMATS, SERIAL, Choices, Count, Export, ExportResult, writer
from analyzer.live.endpoint import DEFAULT_BAUD, DEFAULT_BITRATE
from analyzer.records import CanFrame, Chunk, Comment
from analyzer.sources import Source, open_source
from analyzer.values import counted, printable

EXAMPLES = """\
examples:
  servotap export week.mcap --to pcapng                     writes week.pcapng
  servotap export week.mcap --to pcapng --serial-as rtac    with who sent in Wireshark's event column
  servotap export week.mcap --to candump -o - | canplayer
  servotap export left.mcap --to hex -o left.txt --since +10s --until +20s
  servotap export logs/ --to candump                        a recording in parts
  servotap export left.mcap --to pcapng -o - | wireshark -k -i -

in Wireshark:
  USER0: Preferences, Protocols, DLT_USER, edit, User 0 (DLT=147), payload dissector mbrtu for Modbus
  RTAC:  Decode As, RTAC Serial, mbrtu
"""

_KINDS = {CAN: "CAN", SERIAL: "serial"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("file", metavar="FILE", help="a capture or log of any format, a folder of parts; - is standard input")
    titles = "; ".join(f"{name}: {entry.summary}" for name, entry in FORMATS.items())
    parser.add_argument("--to", required=True, choices=tuple(FORMATS), metavar="FORMAT", help=titles)
    parser.add_argument("-o", "--output", metavar="OUT", help="the file, or a folder; - is standard output")
    parser.add_argument("--serial-as", choices=("user", "rtac"), default="user", help="link type of serial bytes in pcapng")
    parser.add_argument("--chunks", action="store_true", help="bytes of a log as they were received, not one piece per frame")
    parser.add_argument("--nanoseconds", action="store_true", help="nine digits in candump, which canplayer may misread")
    parser.add_argument("--baud", type=positive, metavar="N", help="line speed or bit rate, for a capture without times")
    parser.add_argument("--format", metavar="F", help="capture format, if detection by content fails")
    parser.add_argument("--force", action="store_true", help="replace a file that exists")
    add_time_range_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Export one capture; return 0."""
    target = _target(arguments)
    with contextlib.closing(_open(arguments)) as source, Interrupt() as interrupt:
        if target is None:
            outcome, broken = _write(source, sys.stdout.buffer, arguments, interrupt)
            sys.stdout.buffer.flush()
        else:
            output = Output(target, arguments.force)
            try:
                outcome, broken = _write(source, output.stream, arguments, interrupt)
                if interrupt.asked:
                    raise KeyboardInterrupt
                output.stream.flush()
                output.keep()
            except OSError as error:
                output.drop()
                raise UsageError(f"cannot write {target}: {error.strerror or error}; the incomplete file was removed") from None
            except BaseException:
                output.drop()
                raise
        if interrupt.asked:
            raise KeyboardInterrupt
    _report(source, outcome, broken, target, arguments)
    return 0


def _open(arguments: argparse.Namespace) -> Source:
    source = open_source(arguments.file, format=arguments.format, baud=arguments.baud)
    source.framed = not arguments.chunks
    return source


def _target(arguments: argparse.Namespace) -> Path | None:
    """Return the file to write, None for standard output."""
    ending = FORMATS[arguments.to].ending
    if arguments.output == "-":
        if FORMATS[arguments.to].binary and sys.stdout.isatty():
            raise UsageError(f"{arguments.to} is binary and not for a terminal: name a file with -o, or use a pipe")
        return None
    if arguments.output is None:
        if arguments.file == "-":
            raise UsageError("standard input has no file name: name the output with -o")
        target = Path(str(Path(arguments.file)).removesuffix(".mcap") + ending)
    else:
        target = Path(arguments.output)
        if target.is_symlink():
            target = target.resolve()
        if target.is_dir():
            name = "standard_input" if arguments.file == "-" else Path(arguments.file).name
            target = target / (name.removesuffix(".mcap") + ending)
    if target.exists() and not target.is_file():
        raise UsageError(f"{target} is not a regular file: cannot export to it")
    if arguments.file != "-" and target.exists() and Path(arguments.file).exists() and target.samefile(arguments.file):
        raise UsageError(f"{target} is the capture itself; choose another name with -o")
    if target.exists() and not arguments.force:
        raise UsageError(f"{target} exists; --force replaces it")
    return target


def _write(source: Source, stream: IO[bytes], arguments: argparse.Namespace, interrupt: Interrupt) -> tuple[ExportResult, str]:
    """Export all items; return what was written and why the capture broke off, if it did."""
    held = FORMATS[arguments.to].holds
    digits = 9 if arguments.nanoseconds else 6
    target = writer(arguments.to, stream, Choices(serial_as=arguments.serial_as, digits=digits))
    speed = arguments.baud or (DEFAULT_BITRATE if source.kind == CAN else DEFAULT_BAUD)
    export = Export(target, held, speed)
    broken: list[str] = []
    with progress(source, f"exporting {source.name}"):
        items = _in_time_range(source, arguments)
        export.run(interrupt.items(_until_broken(items, export.outcome, broken)))
    outcome = export.finish()
    if not outcome.written and not interrupt.asked:
        wanted = " or ".join(_KINDS[kind] for kind in held)
        if outcome.left_out:
            what = ", ".join(_counted(name, count) for name, count in outcome.left_out)
            raise UsageError(f"{source.name} has no {wanted} bus, and {arguments.to} holds nothing else (it has {what})")
        raise UsageError(f"{source.name} holds no traffic to export")
    return outcome, "".join(broken)


def _in_time_range(source: Source, arguments: argparse.Namespace) -> Iterator[Chunk | CanFrame | Comment]:
    """Yield the traffic and the comments of the time range."""
    time_range = TimeRange(source, arguments.since, arguments.until)
    for item in time_range.items(source):
        # Other items of a log (pauses, events of the recording) have no place in an export.
        if isinstance(item, Chunk | CanFrame | Comment) and (item.t_ns is None or item.t_ns >= time_range.since_ns):
            yield item


def _until_broken(
    items: Iterator[Chunk | CanFrame | Comment], outcome: ExportResult, broken: list[str]
) -> Iterator[Chunk | CanFrame | Comment]:
    """Yield items of a source that may break off in the midst; what came before is worth having."""
    try:
        yield from items
    except UnreadableError as error:
        if not outcome.buses:
            raise
        broken.append(str(error))


def _counted(name: str, count: Count) -> str:
    what = ("frame" if count.kind == CAN else "piece") + ("" if count.pieces == 1 else "s")
    return f"{count.pieces} {what} of {name} ({_KINDS[count.kind]}, {counted(count.bytes, 'byte')})"


def _report(source: Source, outcome: ExportResult, broken: str, target: Path | None, arguments: argparse.Namespace) -> None:
    """Say what was exported and what was not; beside data on standard output, on standard error."""
    rows = [f"{source.name} ({source.title}) -> {target or 'standard output'}"]
    rows += [f"  {_counted(name, count)}" for name, count in outcome.written]
    if outcome.left_out:
        left = ", ".join(_counted(name, count) for name, count in outcome.left_out)
        held = " and ".join(_KINDS[kind] for kind in FORMATS[arguments.to].holds)
        rows.append(f"left out: {left}: {arguments.to} holds {held} alone")
    if outcome.lost_comments:
        rows.append(f"left out: {counted(outcome.lost_comments, 'comment')}: {arguments.to} has no place for them")
    rows += [f"note: {text}" for text in _notes(source, outcome, broken, arguments)]
    stream = sys.stderr if target is None else sys.stdout
    for row in rows:
        print(printable(row), file=stream)


def _notes(source: Source, outcome: ExportResult, broken: str, arguments: argparse.Namespace) -> Sequence[str]:
    notes = list(source.notes)
    if broken:
        notes.append(f"the capture is incomplete: {broken}")
    if outcome.made_up:
        notes.append(f"the capture has no times: {outcome.made_up} were estimated from the line speed (--baud)")
    if outcome.negative:
        notes.append(f"{counted(outcome.negative, 'time')} before zero, written as zero")
    return notes
