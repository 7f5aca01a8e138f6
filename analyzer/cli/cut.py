"""Copy a time range of a log, or some of its buses, into a smaller log: complete by itself, without decoding again.

The setup of the buses (endpoints, dialects) stands at its beginning, so the smaller log can be decoded again. A cut splits no
frame and no request from its reply: the range grows until all that it touches is whole.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from operator import itemgetter
from typing import IO, Any

from mcap.records import Channel

from analyzer.cli.log_copy import EVERYTHING, TAGGED, Copy, Log, Taken, write_made
from analyzer.cli.reading import showing_progress
from analyzer.cli.signals import Interrupt
from analyzer.cli.time_range import WARM_NS, add_time_range_arguments
from analyzer.errors import UsageError
from analyzer.events import SETUPS, TOPIC
from analyzer.sources.mcap_scan import fields_of
from analyzer.sources.recording_parts import METADATA
from analyzer.sources.times import ShownTime, iso

EXAMPLES = """\
examples:
  servotap cut week.mcap --since 2026-11-21T16:20:00Z --until 2026-11-21T16:25:00Z -o crash.mcap
  servotap cut logs/ --since -5min -o end.mcap
  servotap cut week.mcap --since +1h --until +2h --bus left -o left.mcap
"""
#: Topics of all buses, whose messages say which bus they are of.
_SHARED = frozenset((TOPIC, "/findings", "/comments"))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("file", metavar="FILE", help="a log (MCAP), or a folder of its parts")
    add_time_range_arguments(parser)
    parser.add_argument("--bus", action="append", default=[], metavar="NAME", help="only this bus; may be repeated")
    parser.add_argument("-o", "--output", required=True, metavar="OUT.mcap", help="the smaller log")
    parser.add_argument("--force", action="store_true", help="replace a log that exists")


def run(arguments: argparse.Namespace) -> int:
    """Cut the log; return 0."""
    return write_made([arguments.file], arguments, lambda logs, stream: _Cut(logs[0], arguments).write(stream))


class _Cut:
    """One cut."""

    def __init__(self, log: Log, arguments: argparse.Namespace) -> None:
        self._log = log
        self._buses = set(arguments.bus)
        start_ns, end_ns = log.bounds()
        since, until = arguments.since, arguments.until
        shown = ShownTime(log.source.clock, utc=arguments.utc)
        self._since_ns = since.resolve(start_ns, end_ns, shown) if since is not None else start_ns
        self._until_ns = until.resolve(start_ns, end_ns, shown) if until is not None else end_ns
        if self._until_ns < self._since_ns:
            raise UsageError(f"--until {iso(self._until_ns)} lies before --since {iso(self._since_ns)}")
        if self._since_ns > end_ns or self._until_ns < start_ns:
            raise UsageError(f"nothing of {log.name} lies there: it goes from {iso(start_ns)} to {iso(end_ns)}")
        if since is not None:
            self._since_ns = self._unbroken(self._since_ns, -1)
        if until is not None:
            self._until_ns = self._unbroken(self._until_ns, 1)

    def write(self, stream: IO[bytes]) -> tuple[str, Sequence[str]]:
        """Write the cut; return what it holds, and notes for the user."""
        log = self._log
        found: dict[str, None] = {}

        def wanted(channel: Channel) -> bool:
            bus = channel.topic.split("/")[1] if channel.topic.startswith("/") else ""
            if channel.topic not in _SHARED:
                found[bus] = None
            return not self._buses or channel.topic in _SHARED or bus in self._buses

        copy: Copy | None = None
        with Interrupt() as interrupt, showing_progress(f"cutting {log.name}", log.size, lambda: log.read):
            before = self._before(wanted)
            for taken in interrupt.items(log.messages(self._since_ns, self._until_ns, wanted)):
                if copy is None:
                    copy = Copy(stream, log.header, log.source.clock)
                    self._begin(copy, before, taken)
                if self._is_ours(taken):
                    copy.add(copy.declare(taken.schema, taken.channel), taken.message)
            if interrupt.asked:
                raise KeyboardInterrupt
        missing = self._buses - set(found)
        if missing:
            raise UsageError(f"no bus {', '.join(sorted(missing))} in {log.name}; there are {', '.join(found) or 'none'}")
        if copy is None or not copy.messages:
            raise UsageError(f"nothing of {log.name} lies between {iso(self._since_ns)} and {iso(self._until_ns)}")
        self._describe(copy)
        copy.finish()
        return copy.said, log.notes

    # --- where to cut ---------------------------------------------------------------------------------------------

    def _unbroken(self, at_ns: int, step: int) -> int:
        """Return the next moment, earlier (-1) or later (1), at which no frame is half and no request waits for its reply.

        A reply that comes later than requests wait is not looked for.
        """
        begun: dict[int, int] = {}
        whole: list[tuple[int, int]] = []
        for _, _, message in self._log.messages(at_ns - WARM_NS, at_ns + WARM_NS, self._is_traffic):
            begun[message.sequence] = first_ns = min(message.publish_ns, message.log_ns)
            if (tagged := TAGGED.search(message.data)) is not None:
                first_ns = begun.get(int(tagged[1]), first_ns)
            whole.append((first_ns, message.log_ns))
        self._log.read = 0
        if step < 0:
            for first_ns, last_ns in sorted(whole, key=itemgetter(1), reverse=True):
                if first_ns < at_ns <= last_ns:
                    at_ns = first_ns
        else:
            for first_ns, last_ns in sorted(whole):
                if first_ns <= at_ns < last_ns:
                    at_ns = last_ns
        return at_ns

    def _is_traffic(self, channel: Channel) -> bool:
        parts = channel.topic.split("/")
        if len(parts) < 3 or parts[2] == "stats" or parts[-1] == "state":
            return False
        return not self._buses or parts[1] in self._buses

    # --- what was said before -------------------------------------------------------------------------------------

    def _before(self, wanted: Any) -> list[Taken]:
        """Return the last setup of each bus before the range, and how the log was decoded."""
        kept: dict[tuple[str, str], Taken] = {}
        for taken in self._log.messages(*EVERYTHING, lambda channel: channel.topic == TOPIC and wanted(channel)):
            if taken.message.log_ns >= self._since_ns:
                break
            said = fields_of(taken.message.data)
            name, bus = str(said.get("event", "")), str(said.get("bus", ""))
            if name in SETUPS or name == "part":
                # What is said of a bus is whole each time it is said.
                kept["" if name == "part" else "setup", bus] = taken
        self._log.read = 0
        return [taken for taken in kept.values() if self._is_ours(taken)]

    def _begin(self, copy: Copy, before: list[Taken], first: Taken) -> None:
        """Declare what stands at the beginning of a log and say what was said before."""
        for schema, channel in self._log.declared():
            parts = channel.topic.split("/")
            # A log is read by whether its raw topics are declared before anything else of their bus.
            if len(parts) == 3 and parts[2] == "raw" and (not self._buses or parts[1] in self._buses):
                copy.declare(schema, channel)
        for schema, channel, message in before:
            copy.add(copy.declare(schema, channel), message._replace(log_ns=first.message.log_ns))

    def _is_ours(self, taken: Taken) -> bool:
        """Say whether a message of a topic of all buses is of a wanted one."""
        if not self._buses or taken.channel.topic not in _SHARED:
            return True
        bus = str(fields_of(taken.message.data).get("bus", ""))
        return bus == "" or bus in self._buses

    def _describe(self, copy: Copy) -> None:
        values = dict(self._log.metadata.get("servotap") or self._log.metadata.get(METADATA) or {})
        for name in ("part", "previous", "next", "bytes_total", "bytes_in_frames", "bytes_junk", "frames", "findings"):
            # They are of the whole.
            values.pop(name, None)
        values |= {"cut_of": self._log.name, "since": iso(self._since_ns), "until": iso(self._until_ns)}
        if self._buses:
            values["buses"] = ",".join(sorted(self._buses))
        copy.describe("servotap", values)
