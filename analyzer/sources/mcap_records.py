"""The records of a log in order, over all its parts, as far as they go.

    parts -> records -> chunks unpacked -> Header, Schema, Channel, Metadata, LogMessage

Where the source gives blocks, messages of a chunk that follow each other come together.

Rules: what is damaged becomes a problem, and what stands behind a damaged chunk is read on. Of a log that is whole, chunks
that lie before the wanted stretch are not even read. A log that is still being written is followed (`tail`).
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol

from mcap.records import Channel, ChunkIndex, Header, Metadata, Schema

from analyzer.errors import ServotapError
from analyzer.events import TOPIC
from analyzer.sources import mcap_scan as scan
from analyzer.sources.magic import MCAP
from analyzer.sources.mcap_scan import LogMessage, Messages
from analyzer.sources.source import Source, describe
from analyzer.sources.tail import Rewound, Tail

if TYPE_CHECKING:
    from mcap.summary import Summary

LogRecord = Header | Schema | Channel | Metadata | LogMessage | Messages
_READ = {scan.HEADER: Header.read, scan.SCHEMA: Schema.read, scan.CHANNEL: Channel.read, scan.METADATA: Metadata.read}
#: What ends the reading of a part.
UNFINISHED = "the log is incomplete and ends here; everything before was read (servotap recover repairs it)"


class Reader(Protocol):
    """The bytes of one part in order."""

    offset: int

    def read(self, count: int) -> bytes:
        """Return `count` bytes. Raises EOFError where the log breaks off."""


class _Sequential:
    """The source's stream. `skips`: places where a record begins that is not wanted, and how many bytes to go on."""

    def __init__(self, source: Source, skips: Mapping[int, int]) -> None:
        self._stream = source.stream
        self._skips = skips
        self.offset = 0

    def read(self, count: int) -> bytes:
        """Return `count` bytes."""
        while self._skips and self.offset in self._skips:
            length = self._skips[self.offset]
            self._stream.skip(length)
            self.offset += length
        data = self._stream.exactly(count)
        self.offset += len(data)
        if len(data) < count:
            raise EOFError(UNFINISHED)
        return data


def records(source: Source) -> Iterator[LogRecord]:
    """Yield the records of all parts."""
    if source.follow is not None:
        yield from _followed(source)
        return
    while True:
        outline = outline_of(source) if source.skip_before_ns is not None else None
        for record in records_of_part(source, outline.skips if outline is not None else {}):
            yield record
            if isinstance(record, Header) and outline is not None:
                # The chunks that declared them may not be read.
                yield from outline.declared
        if not source.next_part():
            return


def records_of_part(source: Source, skips: Mapping[int, int]) -> Iterator[LogRecord]:
    """Yield the records of the part that is open, but for those at some places (see `skips_of`)."""
    reader = _Sequential(source, skips)
    try:
        yield from _top(source, reader)
    except (ServotapError, GeneratorExit, Rewound):
        raise
    # A damaged record can make the library raise any exception.
    except Exception as error:
        text = str(error) if isinstance(error, EOFError) else f"the log is incomplete: {describe(error)}"
        source.problem(text, offset=reader.offset)


def _top(source: Source, reader: Reader, *, magic: bool = True) -> Iterator[LogRecord]:
    if magic and reader.read(len(MCAP)) != MCAP:
        raise ValueError("it does not begin as an MCAP file")
    while True:
        opcode, length = scan.HEAD.unpack(reader.read(scan.HEAD.size))
        if length > scan.RECORD_LIMIT:
            raise ValueError(f"a record of {length} bytes, expected at most {scan.RECORD_LIMIT}")
        body = reader.read(length) if length else b""
        source.stream.budget.record()
        if opcode == scan.CHUNK:
            yield from _chunk(source, body, reader.offset)
        elif opcode == scan.MESSAGE or opcode in _READ:
            yield from _record(source, opcode, body, reader.offset)
        elif opcode == scan.DATA_END:
            return
        elif not opcode:
            raise ValueError("a record of kind 0")


def _record(source: Source, opcode: int, body: bytes, offset: int) -> Iterator[LogRecord]:
    """Yield what a record holds; one that is damaged costs itself alone."""
    try:
        taken = scan.message(body) if opcode == scan.MESSAGE else scan.parsed(body, _READ[opcode])
    # As above.
    except Exception as error:
        source.problem(f"a record of the log cannot be read: {describe(error)}", offset=offset)
        return
    yield taken


def _chunk(source: Source, body: bytes, offset: int) -> Iterator[LogRecord]:
    """Yield the records of a chunk; one that is damaged gives nothing."""
    budget = source.stream.budget
    try:
        packed = scan.packed(body)
        data = scan.unpack(packed)
        if packed.compression:
            budget.unpacked(len(data))
        bodies = scan.bodies(data)
        budget.record(len(bodies) - 1)
    except ServotapError:
        raise
    # As above: zstandard, lz4 and the library each have errors of their own.
    except Exception as error:
        source.problem(f"a chunk of the log cannot be read: {describe(error)}", offset=offset)
        return
    size = scan.HEAD.size
    for number in range(len(bodies) - 1):
        if source.in_blocks:
            yield from _together(source, data, bodies[number:], offset)
            return
        first, stop = bodies[number], bodies[number + 1] - size
        opcode = data[first - size]
        if opcode == scan.MESSAGE or opcode in _READ:
            yield from _record(source, opcode, data[first:stop], offset)


def _together(source: Source, data: bytes, bodies: array[int], offset: int) -> Iterator[LogRecord]:
    """Yield the records of a chunk, messages that follow each other together. `bodies`: where they begin."""
    from analyzer.sources.mcap_blocks import pieces

    for piece in pieces(data, bodies):
        if isinstance(piece, Messages):
            yield piece
        elif piece[0] == scan.MESSAGE or piece[0] in _READ:
            opcode, first, stop = piece
            yield from _record(source, opcode, data[first:stop], offset)


# --- what a whole log says of itself --------------------------------------------------------------------------------


class Outline(NamedTuple):
    """What stands in a log's summary. `declared`: its schemas and channels; `skips`: as in `_Sequential`."""

    declared: list[Schema | Channel]
    skips: dict[int, int]
    start_ns: int
    end_ns: int


def outline_of(source: Source) -> Outline | None:
    """Return what the part that is to be read says of itself; None for one that is not whole, or no plain file."""
    if source.stream.compression or source.size is None:
        return None
    return outline(Path(source.stream.path), source.skip_before_ns or 0)


def outline(path: Path, before_ns: int) -> Outline | None:
    """Return what a log says of itself, with what lies before a time as `skips`; None where it is not whole."""
    summary = summary_of(path)
    if summary is None or summary.statistics is None:
        return None
    # What was said of the buses counts for all that follows, wherever it stands.
    kept = {c.id for c in summary.channels.values() if c.topic == TOPIC}
    skips = skips_of(
        summary, lambda index: index.message_end_time < before_ns and not kept & index.message_index_offsets.keys()
    )
    statistics = summary.statistics
    return Outline(
        [*summary.schemas.values(), *summary.channels.values()],
        skips,
        statistics.message_start_time,
        statistics.message_end_time,
    )


def skips_of(summary: Summary, unwanted: Callable[[ChunkIndex], bool]) -> dict[int, int]:
    """Return the places of the chunks that are not wanted, and how many bytes each has with its index."""
    return {i.chunk_start_offset: i.chunk_length + i.message_index_length for i in summary.chunk_indexes if unwanted(i)}


def summary_of(path: Path) -> Summary | None:
    """Return the summary of a log; None where it has none that is whole."""
    from mcap.reader import SeekingReader

    try:
        with path.open("rb") as stream:
            reader = SeekingReader(stream, record_size_limit=scan.RECORD_LIMIT, validate_crcs=True)
            return reader.get_summary()
    # As above.
    except Exception:
        return None


def bounds(path: Path) -> tuple[int, int] | None:
    """Return the first and the last time of a log, also of one that breaks off; None for one without messages."""
    whole = outline(path, 0)
    if whole is not None:
        return (whole.start_ns, whole.end_ns) if whole.end_ns else None
    first_ns: int | None = None
    last_ns = 0
    size = path.stat().st_size
    with path.open("rb") as stream:
        at = len(MCAP)
        while at + scan.HEAD.size <= size:
            stream.seek(at)
            opcode, length = scan.HEAD.unpack(stream.read(scan.HEAD.size))
            if length > scan.RECORD_LIMIT or at + scan.HEAD.size + length > size:
                break
            times = stream.read(24)
            if opcode == scan.CHUNK and len(times) == 24 and int.from_bytes(times[16:24], "little"):
                start_ns, end_ns = int.from_bytes(times[:8], "little"), int.from_bytes(times[8:16], "little")
                if end_ns:
                    first_ns = start_ns if first_ns is None else min(first_ns, start_ns)
                    last_ns = max(last_ns, end_ns)
            at += scan.HEAD.size + length
    return None if first_ns is None else (first_ns, last_ns)


# --- one that is being written --------------------------------------------------------------------------------------


def _followed(source: Source) -> Iterator[LogRecord]:
    """Yield the records of parts as they are written, until the recording ends or loses its writer."""
    assert source.follow is not None
    path: Path | None = Path(source.stream.path)
    rest = source.take_parts()
    while path is not None:
        following = ""
        if not path.exists():
            source.note(f"{path.name} was dropped before it was read")
            path = rest.pop(0) if rest else None
            continue
        with Tail(path, source.follow, finished=bool(rest)) as tail:
            places = [0]
            while True:
                try:
                    for record in _marked(source, tail, places):
                        if isinstance(record, Metadata) and record.metadata.get("next"):
                            following = record.metadata["next"]
                        yield record
                    break
                except Rewound:
                    tail.offset = max(place for place in places if place <= tail.size)
                    source.rewound = True
        if tail.why:
            source.note(tail.why)
        path = rest.pop(0) if rest else tail.wait_for(path.with_name(following)) if following else None


def _marked(source: Source, tail: Tail, places: list[int]) -> Iterator[LogRecord]:
    """Yield the records of a part, noting where each of the last ones began."""

    class Marking:
        """Notes where records begin: they are read head first."""

        offset = 0

        def read(self, count: int) -> bytes:
            if count == scan.HEAD.size:
                places.append(tail.offset)
                del places[1:-1000]
            data = tail.read(count)
            source.stream.budget.read += count
            self.offset = tail.offset
            return data

    try:
        yield from _top(source, Marking(), magic=tail.offset == 0)
    except (ServotapError, GeneratorExit, Rewound):
        raise
    except EOFError as error:
        if not tail.why:
            source.problem(str(error), offset=tail.offset)
    # As above.
    except Exception as error:
        source.problem(f"the log is incomplete: {describe(error)}", offset=tail.offset)
