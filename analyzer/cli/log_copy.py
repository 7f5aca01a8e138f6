"""What `cut` and `merge` share: the messages of a log in its order, and a log that takes over messages of others.

Of whole logs only the chunks that are wanted are read; others are read as far as they go. What is damaged costs itself and is
noted. Written is by the `mcap` library.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import IO, NamedTuple

from mcap.records import Channel, ChunkIndex, Header, Metadata, Schema
from mcap.summary import Summary
from mcap.writer import CompressionType, Writer

from analyzer import __version__
from analyzer.cli.output import free_target, inputs, whole
from analyzer.cli.reading import tell_notes
from analyzer.errors import UnreadableError, UsageError
from analyzer.sinks.mcap_chunk import CHUNK_SIZE
from analyzer.sources import Source, open_source
from analyzer.sources.mcap_records import bounds, records, records_of_part, skips_of, summary_of
from analyzer.sources.mcap_scan import LogMessage
from analyzer.sources.recording_parts import CLOCK_METADATA
from analyzer.sources.times import Clock, iso
from analyzer.values import counted, printable

#: A time range that holds all messages of a log.
EVERYTHING = -1, 1 << 64
#: What a reply says of its request.
TAGGED = re.compile(rb'"_request_sequence":(\d{1,10})(?!\d)')
#: Messages after which it is told how far reading has come, for a person who waits.
_TELL_EVERY = 4096
#: Messages of an incomplete log that are skipped in search of its declarations.
_FIRST_MESSAGES = 1000


class Taken(NamedTuple):
    """A message with the declarations of its log. `schema` None: it has none."""

    schema: Schema | None
    channel: Channel
    message: LogMessage


class Log:
    """A log, in one file or in parts, to be copied from. Raises UnreadableError for what is none."""

    def __init__(self, path: str) -> None:
        self.path = path
        self.source = _opened(path)
        self.files = self.source.files
        self.name = self.source.name
        self.size = self.source.size or 0
        self.metadata: dict[str, dict[str, str]] = {}
        self.header = Header("", "")
        self._summaries = {file: summary_of(file) for file in self.files}
        self._problems: dict[str, None] = {}
        self.read = 0
        for file, summary in self._summaries.items():
            if summary is None or summary.statistics is None:
                self.source.note(f"{file.name} is incomplete: reading stops where it ends (servotap recover repairs it)")

    @property
    def notes(self) -> Sequence[str]:
        """What a person should know of it."""
        return [*self.source.notes, *self._problems]

    def bounds(self) -> tuple[int, int]:
        """Return the first and last time. Raises UnreadableError for a log without messages."""
        found = [each for file in self.files if (each := bounds(file)) is not None]
        if not found:
            raise UnreadableError(f"{self.name} holds no messages")
        return min(first for first, _ in found), max(last for _, last in found)

    def declared(self) -> list[tuple[Schema | None, Channel]]:
        """Return what the log declares; of an incomplete one, only what stands before its first messages."""
        found: dict[str, tuple[Schema | None, Channel]] = {}
        for file, summary in self._summaries.items():
            for schema, channel in _first_declared(file) if summary is None else _declared(summary):
                found.setdefault(channel.topic, (schema, channel))
        return list(found.values())

    def messages(
        self, since_ns: int, until_ns: int, wanted: Callable[[Channel], bool] = lambda channel: True
    ) -> Iterator[Taken]:
        """Yield the messages of a time range, both ends included, in the order of the log."""
        for file in self.files:
            yield from self._messages(file, since_ns, until_ns, wanted)
            self.read += file.stat().st_size

    def _messages(self, file: Path, since_ns: int, until_ns: int, wanted: Callable[[Channel], bool]) -> Iterator[Taken]:
        summary = self._summaries[file]
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel | None] = {}
        skips: Mapping[int, int] = {}
        if summary is not None:
            schemas |= summary.schemas
            channels |= {number: channel if wanted(channel) else None for number, channel in summary.channels.items()}
            numbers = {number for number, channel in channels.items() if channel is not None}

            def is_unwanted(index: ChunkIndex) -> bool:
                outside = index.message_end_time < since_ns or index.message_start_time > until_ns
                return outside or (bool(index.message_index_offsets) and not numbers & index.message_index_offsets.keys())

            skips = skips_of(summary, is_unwanted)
        begun, lost = self.read, 0
        with Source(str(file)) as source:
            for count, record in enumerate(records_of_part(source, skips)):
                if not count % _TELL_EVERY:
                    self.read = begun + source.position()
                if isinstance(record, LogMessage):
                    channel = channels.get(record.channel_id)
                    lost += record.channel_id not in channels
                    if channel is not None and since_ns <= record.log_ns <= until_ns:
                        yield Taken(schemas.get(channel.schema_id), channel, record)
                elif isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    channels[record.id] = record if wanted(record) else None
                elif isinstance(record, Metadata):
                    self.metadata[record.name] = dict(record.metadata)
                elif isinstance(record, Header):
                    self.header = record
            if lost:
                source.problem(f"{counted(lost, 'message')} of topics whose declarations are lost: left out")
            self._problems |= dict.fromkeys(f"{file.name}: {problem}" for problem in source.problems)
        self.read = begun

    def close(self) -> None:
        self.source.close()


def _opened(path: str) -> Source:
    if path == "-":
        raise UsageError("standard input cannot be read twice: name a log file")
    source = open_source(path)
    if source.format != "mcap":
        source.close()
        raise UsageError(f"{path} is {source.title}, expected an MCAP log (servotap decode creates one)")
    return source


def _declared(summary: Summary) -> list[tuple[Schema | None, Channel]]:
    return [(summary.schemas.get(channel.schema_id), channel) for channel in summary.channels.values()]


def _first_declared(file: Path) -> list[tuple[Schema | None, Channel]]:
    schemas: dict[int, Schema] = {}
    found: list[tuple[Schema | None, Channel]] = []
    with Source(str(file)) as source:
        count = 0
        for record in records(source):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                found.append((schemas.get(record.schema_id), record))
            elif isinstance(record, LogMessage):
                count += 1
                if count > _FIRST_MESSAGES:
                    break
    return found


def write_made(
    paths: Sequence[str], arguments: argparse.Namespace, write: Callable[[list[Log], IO[bytes]], tuple[str, Sequence[str]]]
) -> int:
    """Write what is made of some logs to the file of -o; return 0. `write` returns what it holds, and notes for the user.

    Raises UsageError where that file is one of the logs.
    """
    with ExitStack() as stack:
        logs = [stack.enter_context(closing(Log(path))) for path in paths]
        target = free_target(Path(arguments.output), arguments.force, inputs(str(file) for log in logs for file in log.files))
        with whole(target, replace=arguments.force) as stream:
            said, notes = write(logs, stream)
    print(f"wrote {printable(arguments.output)}: {said}")
    tell_notes(notes)
    return 0


class Copy:
    """A log under construction that takes over messages of others. `stream`: where it goes; `clock`: what its times are."""

    def __init__(self, stream: IO[bytes], header: Header, clock: Clock) -> None:
        self._writer = Writer(stream, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD)
        library = header.library if header.profile != "servotap" else f"servotap {__version__}"
        self._writer.start(profile=header.profile, library=library)
        if clock is not Clock.UTC:
            self.describe(CLOCK_METADATA, {"clock": clock})
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: dict[tuple[str, int, str], int] = {}
        self.messages = 0
        self.first_ns: int | None = None
        self.last_ns = 0

    def declare(self, schema: Schema | None, channel: Channel, topic: str = "") -> int:
        """Declare a channel, maybe under another topic, and return its id; the same once."""
        schema_id = 0
        if schema is not None:
            key = schema.name, schema.encoding, schema.data
            if key not in self._schemas:
                self._schemas[key] = self._writer.register_schema(schema.name, schema.encoding, schema.data)
            schema_id = self._schemas[key]
        topic = topic or channel.topic
        wanted = topic, schema_id, channel.message_encoding
        if wanted not in self._channels:
            self._channels[wanted] = self._writer.register_channel(
                topic, channel.message_encoding, schema_id, dict(channel.metadata)
            )
        return self._channels[wanted]

    def add(self, channel_id: int, message: LogMessage) -> None:
        self._writer.add_message(
            channel_id, message.log_ns, message.data, publish_time=message.publish_ns, sequence=message.sequence
        )
        self.messages += 1
        if self.first_ns is None:
            self.first_ns = message.log_ns
        self.last_ns = max(self.last_ns, message.log_ns)

    @property
    def said(self) -> str:
        """What it holds, in words."""
        return f"{counted(self.messages, 'message')} from {iso(self.first_ns or 0)} to {iso(self.last_ns)}"

    def describe(self, name: str, values: Mapping[str, str]) -> None:
        self._writer.add_metadata(name, {key: value for key, value in values.items() if value})

    def finish(self) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]
