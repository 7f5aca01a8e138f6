"""Make one log of several, in the order of their times: of one machine on two computers, of the parts of a recording.

Parts of one recording belong together as they are. If buses of different logs have one name, each gets its log's name in
front. Sequence numbers continue those of the previous log, also where messages name them.
"""

from __future__ import annotations

import argparse
import filecmp
import heapq
from collections.abc import Iterator
from operator import itemgetter
from pathlib import Path
from typing import IO, Any

import msgspec
from mcap.records import Channel

from analyzer.cli.log_copy import EVERYTHING, TAGGED, Copy, Log, Taken, write_made
from analyzer.cli.reading import showing_progress
from analyzer.cli.signals import Interrupt
from analyzer.errors import UsageError
from analyzer.port import topic_name
from analyzer.sources.mcap_scan import LogMessage
from analyzer.sources.recording_parts import METADATA, look
from analyzer.sources.times import Clock
from analyzer.system.decoding import UNDECODABLE

EXAMPLES = """\
examples:
  servotap merge left.mcap right.mcap -o both.mcap
  servotap merge logs/ -o week.mcap              the parts of a recording as one
"""
#: Topics that no bus names.
_SHARED = frozenset(("recording", "findings", "comments", "tests"))
_SEQUENCE_LIMIT = 1 << 32
_decode = msgspec.json.Decoder(dict[str, Any]).decode


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("files", nargs="+", metavar="FILE", help="logs (MCAP), or folders of parts")
    parser.add_argument("-o", "--output", required=True, metavar="OUT.mcap", help="the one log")
    parser.add_argument("--force", action="store_true", help="replace a log that exists")


def run(arguments: argparse.Namespace) -> int:
    """Merge the logs; return 0."""
    return write_made(arguments.files, arguments, lambda logs, stream: _Merge(logs).write(stream))


def _refuse_twice(logs: list[Log]) -> None:
    """Raise UsageError where two of the logs are one file, a copy of it, or one part of a recording."""
    parts: dict[tuple[str, int], Path] = {}
    sizes: dict[int, list[Path]] = {}
    for file in (file for log in logs for file in log.files):
        _, recording, number = look(file)
        alike = sizes.setdefault(file.stat().st_size, [])
        twin = next((other for other in alike if filecmp.cmp(file, other, shallow=False)), None)
        twin = twin or (parts.get((recording, number)) if recording else None)
        if twin is not None:
            raise UsageError(f"{file} has the same messages as {twin}: name each log once")
        alike.append(file)
        parts[recording, number] = file


class _Input:
    """One log on its way into another. `shift`: what its sequence numbers grow by; `names`: of its buses, new by old."""

    def __init__(self, log: Log, shift: int, names: dict[str, str]) -> None:
        self.log = log
        self.shift = shift
        self.names = names

    def topic(self, channel: Channel) -> str:
        """Return the topic of a channel in the merged log."""
        parts = channel.topic.split("/")
        if len(parts) > 2 and parts[1] in self.names:
            parts[1] = self.names[parts[1]]
        return "/".join(parts)

    def message(self, taken: Taken) -> LogMessage:
        """Return a message as it stands in the merged log."""
        message = taken.message
        shift, data = self.shift, message.data
        if shift and message.sequence:
            message = message._replace(sequence=(message.sequence + shift) % _SEQUENCE_LIMIT)
        top = taken.channel.topic.split("/")[1:2]
        if top and top[0] in _SHARED and (shift or self.names):
            return message._replace(data=self._renamed(data))
        if shift and b'"_request_sequence":' in data:
            return message._replace(data=TAGGED.sub(lambda m: b'"_request_sequence":%d' % (int(m[1]) + shift), data))
        return message

    def _renamed(self, data: bytes) -> bytes:
        """Return the JSON of a message with other names and numbers; as it is where it is damaged."""
        try:
            return msgspec.json.encode(self._with_names(_decode(data)))
        except (*UNDECODABLE, OverflowError):
            return data

    def _with_names(self, said: dict[str, Any]) -> dict[str, Any]:
        bus = said.get("bus")
        if isinstance(bus, str) and bus in self.names:
            said["bus"] = self.names[bus]
            file = said.get("file")
            if isinstance(file, str) and file.startswith(f"/{bus}/"):
                said["file"] = f"/{self.names[bus]}{file[len(bus) + 1 :]}"
        line = said.get("line")
        if isinstance(line, int) and line:
            said["line"] = line + self.shift
        return said


class _Merge:
    """Several logs that become one."""

    def __init__(self, logs: list[Log]) -> None:
        _refuse_twice(logs)
        self._logs = logs
        self.notes: list[str] = []

    def write(self, stream: IO[bytes]) -> tuple[str, list[str]]:
        """Write the log; return what it holds, and notes for the user."""
        size = sum(log.size for log in self._logs)
        with Interrupt() as interrupt, showing_progress("merging", 2 * size, lambda: sum(log.read for log in self._logs)):
            inputs = self._inputs(interrupt)
            clocks = {log.source.clock for log in self._logs}
            copy = Copy(stream, self._logs[0].header, clocks.pop() if len(clocks) == 1 else Clock.UTC)
            for each in inputs:
                for schema, channel in each.log.declared():
                    copy.declare(schema, channel, each.topic(channel))
            rows = [self._rows(number, each) for number, each in enumerate(inputs)]
            for _, number, taken in interrupt.items(heapq.merge(*rows, key=itemgetter(0))):
                each = inputs[number]
                copy.add(copy.declare(taken.schema, taken.channel, each.topic(taken.channel)), each.message(taken))
            if interrupt.asked:
                raise KeyboardInterrupt
        if not copy.messages:
            raise UsageError("the logs hold no messages")
        self._describe(copy, inputs)
        copy.finish()
        self.notes += [f"{log.name}: {note}" for log in self._logs for note in log.notes]
        buses = sorted({b for each in inputs for b in each.names.values()})
        renamed = f"; renamed: {', '.join(buses)}" if buses else ""
        return copy.said + renamed, self.notes

    @staticmethod
    def _rows(number: int, each: _Input) -> Iterator[tuple[int, int, Taken]]:
        last_ns = 0
        for taken in each.log.messages(*EVERYTHING):
            # Its own order counts, also where a log has a time that goes back.
            last_ns = max(last_ns, taken.message.log_ns)
            yield last_ns, number, taken

    def _inputs(self, interrupt: Interrupt) -> list[_Input]:
        """Look through the logs once: which buses and how many sequence numbers each has."""
        inputs: list[_Input] = []
        taken_names: set[str] = set()
        groups: dict[str, _Input] = {}
        highest = 0
        for log in self._logs:
            buses: dict[str, None] = {}
            top = 0
            for _, channel, message in interrupt.items(log.messages(*EVERYTHING)):
                parts = channel.topic.split("/")
                if len(parts) > 2 and parts[1] not in _SHARED:
                    buses[parts[1]] = None
                top = max(top, message.sequence)
            if interrupt.asked:
                raise KeyboardInterrupt
            about = log.metadata.get(METADATA) or log.metadata.get("servotap") or {}
            recording = about.get("recording", "")
            same = groups.get(recording) if recording else None
            if same is not None:
                # Another part of a recording: its buses and numbers are the same ones.
                inputs.append(_Input(log, same.shift, same.names))
                highest = max(highest, top + same.shift)
                continue
            names = {bus: self._free(bus, log, taken_names) for bus in buses}
            taken_names.update(names.values())
            each = _Input(log, highest, {old: new for old, new in names.items() if old != new})
            groups[recording or log.path] = each
            inputs.append(each)
            highest += top
        if highest >= _SEQUENCE_LIMIT:
            self.notes.append("sequence numbers exceeded 32 bits and started again at 0")
        return inputs

    @staticmethod
    def _free(bus: str, log: Log, taken: set[str]) -> str:
        """Return a name for a bus that no other log has."""
        if bus not in taken:
            return bus
        stem = topic_name(log.name.removesuffix(".mcap"))
        name, number = f"{stem}_{bus}", 2
        while name in taken:
            name, number = f"{stem}_{bus}_{number}", number + 1
        return name

    def _describe(self, copy: Copy, inputs: list[_Input]) -> None:
        values = {"source": "; ".join(log.name for log in self._logs), "merged_of": str(len(self._logs))}
        about = [log.metadata.get("servotap") or log.metadata.get(METADATA) or {} for log in self._logs]
        sources = {a["time_source"]: None for a in about if a.get("time_source")}
        dialects = {name: None for a in about for name in a.get("dialect", "").split(",") if name}
        values |= {"time_source": "; ".join(sources), "dialect": ",".join(dialects)}
        values["renamed"] = "; ".join(f"{e.log.name}: {old} is {new}" for e in inputs for old, new in e.names.items())
        recordings = {a.get("recording", "") for a in about}
        if len(recordings) == 1:
            values["recording"] = recordings.pop()
        copy.describe("servotap", values)
