"""Show the decoded frames of a capture or an MCAP log as a table, one line a frame, as they come.

A filter is an expression over a message's fields: address, bus, command, dialect, role, time (s), latency (ms),
checksum_ok, findings, raw, offset, section, sequence, and every field of the commands by name. Numbers are in the units
that the table shows, or carry one (latency > 5ms); a choice is named or numbered (status == "complete").
"""

from __future__ import annotations

import argparse
import contextlib
import shutil
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import msgspec

from analyzer.catalogue import Role
from analyzer.cli.filter import Filter, bytes_text, vocabulary
from analyzer.cli.option_types import whole
from analyzer.cli.reading import LONG_CAPTURE, add_reading_arguments, open_reading, progress, tell_notes
from analyzer.decoder import physical, units_of
from analyzer.entries import Entry
from analyzer.events import text_of
from analyzer.live.lock import recorded
from analyzer.records import Comment, Event, Finding, Junk, Message
from analyzer.sources.tail import Follow
from analyzer.sources.times import ShownTime
from analyzer.values import fields_text, printable

if TYPE_CHECKING:
    from analyzer.cli.sieve import Sieve
    from analyzer.columns.plain import Plain

EXAMPLES = """\
examples:
  servotap show capture.log
  servotap show capture.log --filter 'address == 1 and command == "read_speed" and speed > 300'
  servotap show capture.log --filter 'latency > 5ms or "error" in findings'
  servotap show week.mcap --since +10min --until +11min
  servotap show --follow week.mcap --since -10s
  candump -L can0 | servotap show -
"""

#: Events that do not matter to a reader of the traffic.
_UNSHOWN = frozenset(("part", "resumed", "clock_drift"))
_COLORS = {"request": "36", "reply": "32", "message": "34", "unknown": "33", "foreign": "2"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("file", metavar="FILE", help="a capture, an MCAP log, or a folder of its parts; - reads standard input")
    parser.add_argument("--follow", action="store_true", help="follow a log that is being recorded, until Ctrl-C or its end")
    parser.add_argument("--filter", metavar="EXPRESSION", help="show only messages that match this expression")
    parser.add_argument("--limit", type=whole, metavar="N", help="stop after N lines")
    parser.add_argument("--json", action="store_true", help="one JSON object per line")
    parser.add_argument("--bytes", action="store_true", help="show the bytes of each frame too")
    add_reading_arguments(parser)


class _Enough(Exception):
    """The wanted number of lines was shown."""


class Table:
    """A sink that prints a line per frame and per piece of junk, and the findings below theirs."""

    def __init__(self, arguments: argparse.Namespace, wanted: Filter | None, times: ShownTime, who_width: int = 4) -> None:
        self._wanted = wanted
        self._times = times
        self._json: bool = arguments.json
        self._bytes: bool = arguments.bytes
        self._left: int | None = arguments.limit
        self._color = sys.stdout.isatty()
        # On a terminal a line is cut at its edge: the next one stands below it, whole.
        self._width = shutil.get_terminal_size().columns if self._color else 0
        self._flush: bool = self._color or arguments.follow
        self._who = who_width
        self._sieve: Sieve | None = None
        self._shown: set[int] = set()
        #: Lines of frames and junk.
        self.lines = 0
        if not self._json:
            print(f"{'time':>15}  {'bus':<8} {'addr':>{self._who}} {'role':<7} {'command':<24} fields")

    def begin(self, plain: Plain) -> None:
        self._plain = plain

    def run(self, start: int, stop: int, sequence: int) -> None:
        from analyzer.cli.sieve import Run, Sieve

        run = Run(self._plain, start, stop, sequence)
        if self._wanted is None:
            rows = list(range(start, stop))
        else:
            self._sieve = self._sieve or Sieve(self._wanted, _filtered)
            rows = self._sieve.rows(run)
        for row in rows:
            self._print(run.entry(row))

    def entry(self, entry: Entry) -> None:
        if self._wanted is None or self._wanted(_filtered(entry)):
            self._print(entry)

    def _print(self, entry: Entry) -> None:
        fields = physical(entry.message)
        self._shown = {entry.sequence}
        message = entry.message
        if self._json:
            names = names_of(entry, fields)
            self._line(msgspec.json.encode({**names, **({"slots": fields["slots"]} if "slots" in fields else {})}).decode())
            return
        role = message.role.value
        shown = fields_text(fields, units_of(message))
        if entry.latency_ns is not None and entry.request_sequence is not None:
            shown += f"  ({entry.latency_ns / 1e6:.3f} ms)"
        if self._bytes or message.form is None:
            shown += f"  [{bytes_text(message.frame)}]"
        command = "" if message.role is Role.FOREIGN else command_name(message)
        # An identifier of 29 bits is wider than the others; from here on there is room for it.
        self._who = max(self._who, len(message.who))
        time_text = self._time(message.frame.last_ns)
        text = f"{time_text}  {printable(message.frame.port):<8} {message.who:>{self._who}} {role:<7} {command:<24} {shown}"
        self._line(self._shown_as(text, _COLORS[role]))

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        if self._wanted is not None:
            return
        self._shown = {sequence}
        if self._json:
            shown = {"time": junk.last_ns / 1e9, "bus": junk.port, "junk": junk.reason.value, "offset": junk.offset}
            self._line(msgspec.json.encode({**shown, "raw": junk.data.hex(" ").upper()}).decode())
            return
        data = junk.data[:24].hex(" ").upper() + (" ..." if len(junk.data) > 24 else "")
        place = f"{self._time(junk.last_ns)}  {printable(junk.port):<8} {'':>{self._who}}"
        text = f"{place} {'junk':<7} {junk.reason.value:<24} [{data}]"
        self._line(self._shown_as(text, "35"))

    def finding(self, found: Finding) -> None:
        if self._json or (self._wanted is not None and found.sequence not in self._shown):
            return
        about = "" if found.sequence in self._shown else f" (frame {found.sequence}, {found.topic})"
        section = f", section {found.section}" if found.section else ""
        text = f"{'':>15}  ! {found.severity.value} {found.rule}: {printable(found.text)}{section}{about}"
        print(self._shown_as(text, "31"))

    def happened(self, event: Event, sequence: int) -> None:
        if self._wanted is not None or self._json or event.name in _UNSHOWN:
            return
        who = f"{printable(event.port)}: " if event.port else ""
        text = f"{self._time(event.t_ns)}  # {who}{event.name}: {printable(text_of(event))}"
        print(self._shown_as(text, "2"), flush=self._flush)

    def comment(self, comment: Comment) -> None:
        if self._wanted is None and not self._json:
            print(f"{'':>15}  # {printable(comment.text).lstrip('# ')}")

    def _shown_as(self, text: str, color: str) -> str:
        """Return a line as it is shown: on a terminal in a colour, and cut at the edge."""
        if not self._color:
            return text
        cut = text if len(text) <= self._width else text[: self._width - 1] + "…"
        return f"\x1b[{color}m{cut}\x1b[0m"

    def _line(self, text: str) -> None:
        if self._left is not None:
            if self._left <= 0:
                raise _Enough
            self._left -= 1
        self.lines += 1
        print(text, flush=self._flush)

    def _time(self, t_ns: int) -> str:
        """Return a time as it is shown; where the date changes, a line with it comes before."""
        dated = self._times.new_date(t_ns)
        if dated:
            print(f"{'':>15}  # {dated}")
        return self._times.text(t_ns)


def names_of(entry: Entry, fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a filter can name of a message."""
    message = entry.message
    frame = message.frame
    names: dict[str, Any] = {n: v for n, v in fields.items() if n != "slots"}
    names.update(
        time=frame.last_ns / 1e9,
        bus=frame.port,
        dialect=frame.dialect.name if message.role is not Role.FOREIGN else "",
        address=message.address,
        role=message.role.value,
        command=command_name(message),
        checksum_ok=frame.checksum_ok,
        findings=[f.rule for f in entry.findings],
        raw=bytes_text(frame),
        offset=frame.offset,
        sequence=entry.sequence,
        section=message.command.section if message.command is not None else "",
    )
    if entry.request_sequence is not None:
        names["request_sequence"] = entry.request_sequence
        if entry.latency_ns is not None:
            names["latency"] = entry.latency_ns / 1e9
    return names


def command_name(message: Message) -> str:
    """Return the name of a message's command, `unknown`, or `foreign` for another node's frame."""
    if message.command is not None:
        return message.command.name
    return "foreign" if message.role is Role.FOREIGN else "unknown"


def _filtered(entry: Entry) -> dict[str, Any]:
    """Return the names of a message as a filter means them: the latency in ms, findings with their severities."""
    names = names_of(entry, physical(entry.message))
    names["findings"] = [word for found in entry.findings for word in (found.rule, found.severity)]
    if "latency" in names and entry.latency_ns is not None:
        names["latency"] = entry.latency_ns / 1e6
    return names


def run(arguments: argparse.Namespace) -> int:
    """Show the frames; return 0."""
    try:
        return _show(arguments)
    except KeyboardInterrupt:
        if not arguments.follow:
            raise
        # The usual end of following.
        return 0


def _show(arguments: argparse.Namespace) -> int:
    follow = Follow(recorded) if arguments.follow else None
    reading = open_reading(arguments.file, arguments, follow)
    with contextlib.closing(reading.source):
        wanted = None
        if arguments.filter:
            wanted = Filter(arguments.filter, vocabulary(reading.possible))
        size = reading.source.size
        whole = not (arguments.follow or reading.time_range.wanted)
        reading.source.in_blocks = whole and size is not None and size >= LONG_CAPTURE
        if reading.source.in_blocks:
            from analyzer.columns.memory import keep

            keep()
        table = Table(arguments, wanted, reading.time_range.shown, reading.who_width)
        pipeline = reading.pipeline((table,))
        with contextlib.suppress(_Enough):
            if wanted is not None and not arguments.follow:
                with progress(reading.source, f"reading {reading.source.name}"):
                    pipeline.run(reading)
            else:
                pipeline.run(reading)
        tell_notes(reading.source.notes)
        if not table.lines and arguments.limit != 0 and (wanted is not None or reading.time_range.wanted):
            asked = " and ".join(["the filter"] * (wanted is not None) + ["the time range"] * reading.time_range.wanted)
            tell_notes([f"no frame fits {asked}"])
    return 0
