"""Export a capture or a log for other programs: decoded as a table (CSV, Parquet, Excel), or its raw bytes (candump, pcapng
for Wireshark, hex text). The end of the file's name says which, or --to.

A table has a row a message; with --wide a column for each field of each topic, the last value held. Raw bytes are not decoded:
a decoded log gives one piece for each frame, --chunks gives its bytes as they came. The file is whole or not there.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import IO

from analyzer.cli.export_table import export_table
from analyzer.cli.output import free_target, inputs, target_of, whole
from analyzer.cli.reading import add_reading_arguments, progress, source_options
from analyzer.cli.signals import Interrupt
from analyzer.cli.time_range import TimeRange
from analyzer.errors import UnreadableError, UsageError
from analyzer.export import CAN, FORMATS, SERIAL, Choices, Count, Export, ExportResult, writer
from analyzer.live.endpoint import DEFAULT_BAUD, DEFAULT_BITRATE
from analyzer.records import CanFrame, Chunk, Comment
from analyzer.sources import Source, open_source
from analyzer.table.files import KINDS
from analyzer.table.tables import parse_rate
from analyzer.values import counted, printable

EXAMPLES = """\
examples:
  servotap export week.mcap -o week.csv                     a row a message, units in the header
  servotap export week.mcap -o week.parquet --fields speed,position
  servotap export week.mcap -o week.xlsx --wide --rate 10Hz --topics state,'read_*'
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
    tables = ", ".join(KINDS)
    parser.add_argument("--to", choices=(*KINDS, *FORMATS), metavar="FORMAT", help=f"{tables}: decoded as a table; {titles}")
    parser.add_argument("-o", "--output", metavar="OUT", help="the file, or a folder; - is standard output")
    parser.add_argument("--force", action="store_true", help="replace a file that exists")
    add_reading_arguments(parser)
    table = parser.add_argument_group("tables")
    table.add_argument("--wide", action="store_true", help="a column for each field of each topic, a row at each change")
    table.add_argument("--rate", type=_rate, metavar="R", help="rows at even steps, as 100Hz or 10ms; implies --wide")
    table.add_argument(
        "--topics", action="append", default=[], metavar="LIST",
        help="only these: parts of a topic (read_*,1,reply,state) or whole ones (/left/1/read_speed/*)",
    )  # fmt: skip
    table.add_argument("--fields", action="append", default=[], metavar="LIST", help="only these, as speed,pos*")
    raw = parser.add_argument_group("raw bytes")
    raw.add_argument("--serial-as", choices=("user", "rtac"), default="user", help="link type of serial bytes in pcapng")
    raw.add_argument("--chunks", action="store_true", help="bytes of a log as they were received, not one piece per frame")
    raw.add_argument("--nanoseconds", action="store_true", help="nine digits in candump, which canplayer may misread")


def _rate(text: str) -> Fraction:
    try:
        return parse_rate(text)
    except UsageError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


#: Options that tables alone have, and those of raw bytes: their values where they are not given.
_OF_TABLES: dict[str, object] = {
    "wide": False,
    "rate": None,
    "topics": [],
    "fields": [],
    "dialect": "auto",
    "model": None,
    "group": [],
    "ids": [],
    "late": None,
}
_OF_RAW: dict[str, object] = {"serial_as": "user", "chunks": False, "nanoseconds": False}


def run(arguments: argparse.Namespace) -> int:
    """Export one capture; return 0."""
    arguments.to = arguments.to or _format_of(arguments.output)
    strange = _OF_RAW if arguments.to in KINDS else _OF_TABLES
    for name, usual in strange.items():
        if getattr(arguments, name) != usual:
            others = " and ".join(FORMATS if arguments.to in KINDS else KINDS)
            raise UsageError(f"--{name.replace('_', '-')} is for {others}, and this is {arguments.to}")
    target = _target(arguments)
    export = export_table if arguments.to in KINDS else _export_raw
    with Interrupt() as interrupt:
        if target is None:
            told = export(arguments, sys.stdout.buffer, interrupt, None)
            sys.stdout.buffer.flush()
        else:
            with whole(target, replace=arguments.force) as stream:
                told = export(arguments, stream, interrupt, target)
                if interrupt.asked:
                    raise KeyboardInterrupt
        if interrupt.asked:
            raise KeyboardInterrupt
    # Beside data on standard output, on standard error.
    for row in told:
        print(printable(row), file=sys.stderr if target is None else sys.stdout)
    return 0


def _format_of(output: str | None) -> str:
    """Return the format that the end of a file's name says. Raises UsageError where it says none."""
    ends = {**{f".{kind}": kind for kind in KINDS}, **{entry.ending: name for name, entry in FORMATS.items()}}
    found = next((name for end, name in ends.items() if output is not None and output.lower().endswith(end)), None)
    if found is None:
        raise UsageError(f"which format? expected --to, or -o with a name that ends in {', '.join(ends)}")
    return found


def _target(arguments: argparse.Namespace) -> Path | None:
    """Return the file to write, None for standard output."""
    table = KINDS.get(arguments.to)
    ending = FORMATS[arguments.to].ending if table is None else f".{arguments.to}"
    if arguments.output == "-":
        binary = FORMATS[arguments.to].binary if table is None else bool(table.package)
        if binary and sys.stdout.isatty():
            raise UsageError(f"{arguments.to} is binary and not for a terminal: name a file with -o, or use a pipe")
        return None
    if arguments.output is None:
        if arguments.file == "-":
            raise UsageError("standard input has no file name: name the output with -o")
        target = Path(str(Path(arguments.file)).removesuffix(".mcap") + ending)
    else:
        target = target_of(Path(arguments.output))
        if target.is_dir():
            name = "standard_input" if arguments.file == "-" else Path(arguments.file).name
            target = target / (name.removesuffix(".mcap") + ending)
    return free_target(target, arguments.force, inputs((arguments.file, *arguments.dbc, *arguments.modbus_map)))


# --- raw bytes --------------------------------------------------------------------------------------------------------


def _export_raw(arguments: argparse.Namespace, stream: IO[bytes], interrupt: Interrupt, target: Path | None) -> list[str]:
    """Export all bytes; return the lines that tell of it."""
    opening = partial(open_source, arguments.file, **source_options(arguments))
    with contextlib.closing(interrupt.opened(opening)) as source:
        source.framed = not arguments.chunks
        outcome, broken = _write(source, stream, arguments, interrupt)
        return _report(source, outcome, broken, target, arguments)


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


def _report(
    source: Source, outcome: ExportResult, broken: str, target: Path | None, arguments: argparse.Namespace
) -> list[str]:
    """Return what was exported and what was not."""
    rows = [f"{source.name} ({source.title}) -> {target or 'standard output'}"]
    rows += [f"  {_counted(name, count)}" for name, count in outcome.written]
    if outcome.left_out:
        left = ", ".join(_counted(name, count) for name, count in outcome.left_out)
        held = " and ".join(_KINDS[kind] for kind in FORMATS[arguments.to].holds)
        rows.append(f"left out: {left}: {arguments.to} holds {held} alone")
    if outcome.lost_comments:
        rows.append(f"left out: {counted(outcome.lost_comments, 'comment')}: {arguments.to} has no place for them")
    return rows + [f"note: {text}" for text in _notes(source, outcome, broken)]


def _notes(source: Source, outcome: ExportResult, broken: str) -> Sequence[str]:
    notes = list(source.notes)
    if broken:
        notes.append(f"the capture is incomplete: {broken}")
    if outcome.made_up:
        notes.append(f"the capture has no times: {outcome.made_up} were estimated from the line speed (--baud)")
    if outcome.negative:
        notes.append(f"{counted(outcome.negative, 'time')} before zero, written as zero")
    return notes
