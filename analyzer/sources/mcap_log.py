"""A log of this program, given back as the traffic it was made of, to be decoded again.

Each message that has `_raw` (decoded frames, `/<bus>/unknown`, `/<bus>/junk`, `/<bus>/raw`) becomes a chunk or a CAN
frame with its exact bytes and time; `/comments` become comments. What the log said a frame means is not given on, so
that another dialect starts afresh.

Rules: each byte of a bus is given once, found by `_offset`, although `/<bus>/raw` repeats what the frames hold. A log
that was not finished is read as far as it goes. Chunks are unpacked here, within bounds, for the library trusts the
size a chunk claims.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import IO, cast

import msgspec

from analyzer.catalogue import Role
from analyzer.errors import ServotapError, UnreadableError
from analyzer.records import CanFrame, Chunk, Comment
from analyzer.sources.source import Record, Source, describe

_MAGIC = b"\x89MCAP0\r\n"
_PROFILE = "servotap"
_COMMENTS = "/comments"
_RAW = "raw"
#: Bytes of one record, and of one chunk unpacked; this program writes chunks of 1 MiB.
_RECORD_LIMIT = 64 << 20
_UNPACKED_LIMIT = 64 << 20
#: Stretches of a bus that may be missing for a time: messages out of order.
_GAP_LIMIT = 1000
_ROLES = {role.value: role for role in Role}


class _Logged(msgspec.Struct):
    """The keys of a message that matter here."""

    raw: str | None = msgspec.field(name="_raw", default=None)
    offset: int | None = msgspec.field(name="_offset", default=None)
    can_id: int | None = msgspec.field(name="_can_id", default=None)
    can_flags: list[str] = msgspec.field(name="_can_flags", default_factory=list)
    direction: str = msgspec.field(name="_direction", default="")
    message: str = ""


class _Lane:
    """What a channel says of its messages."""

    def __init__(self, topic: str, metadata: dict[str, str]) -> None:
        parts = topic.split("/")
        self.topic = topic
        self.bus = parts[1] if len(parts) > 1 else ""
        self.last = parts[-1]
        self.can = metadata.get("bus_kind") == "can"


class _Coverage:
    """Which bytes of a bus were given: all below `_end` but the gaps."""

    def __init__(self) -> None:
        self._end = 0
        self._gaps: list[tuple[int, int]] = []
        self.late = 0

    def fresh(self, offset: int, size: int) -> tuple[int, int]:
        """Return the part of a message's bytes that was not given yet, as first and last+1 of its own bytes."""
        stop = offset + size
        if offset >= self._end:
            if offset > self._end and len(self._gaps) < _GAP_LIMIT:
                self._gaps.append((self._end, offset))
            self._end = stop
            return 0, size
        for at, (low, high) in enumerate(self._gaps):
            if low <= offset < high:
                self.late += 1
                stop = min(stop, high)
                self._gaps[at : at + 1] = [gap for gap in ((low, offset), (stop, high)) if gap[0] < gap[1]]
                return 0, stop - offset
        if stop > self._end:
            first = self._end - offset
            self._end = stop
            return first, size
        return 0, 0

    @property
    def missing(self) -> int:
        """Bytes that never came."""
        return sum(high - low for low, high in self._gaps)


def score(head: bytes) -> float:
    """Say how sure it is that these bytes are an MCAP log, 0..1."""
    return 1.0 if head.startswith(_MAGIC) else 0.0


def read(source: Source) -> Iterator[Record]:
    """Read the messages in the order of the log."""
    if not source.head.startswith(_MAGIC):
        raise UnreadableError(f"{source.name}: expected an MCAP log (89 4D 43 41 50 ...), got another beginning")
    source.time_source = "log: times of the log that was read, exact to 1 ns"
    return _records(source)


class _File:
    """The stream as a file for the library, which reads without bounds of its own."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self.offset = 0

    def read(self, count: int) -> bytes:
        """Return `count` bytes. Raises ValueError where none can be meant, EOFError where the log breaks off."""
        if not 0 <= count <= _RECORD_LIMIT:
            raise ValueError(f"a record of {count} bytes, expected at most {_RECORD_LIMIT}")
        data = self._source.stream.exactly(count)
        self.offset += len(data)
        if len(data) < count:
            raise EOFError("the log breaks off; what came before is read (decode it again to have a whole one)")
        return data


def _records(source: Source) -> Iterator[Record]:
    from mcap.records import Channel, Header, Message, Metadata

    lanes: dict[int, _Lane] = {}
    covered: dict[str, _Coverage] = {}
    decode = msgspec.json.Decoder(_Logged).decode
    profile = None
    traffic = False
    for record in _unpacked(source):
        if isinstance(record, Message):
            lane = lanes.get(record.channel_id)
            if lane is None:
                # The chunk that declared it is damaged; its bytes are still good.
                source.note("some topics' declarations are lost: their bytes are taken as of one bus")
                lane = lanes[record.channel_id] = _Lane("", {})
            try:
                logged = decode(record.data)
                taken = _traffic(source, lane, record.log_time, logged, covered)
            except (msgspec.MsgspecError, ValueError, RecursionError) as error:
                source.problem(f"a message of {lane.topic}: {describe(error)}")
                continue
            if taken is not None:
                traffic = True
                yield taken
        elif isinstance(record, Channel):
            lanes[record.id] = _Lane(record.topic, record.metadata)
        elif isinstance(record, Header):
            profile = record.profile
        elif isinstance(record, Metadata) and record.name == _PROFILE and record.metadata.get("time_source"):
            source.time_source = f"log: {record.metadata['time_source']}"
    if not traffic and profile != _PROFILE:
        raise UnreadableError(
            f"{source.name}: expected an MCAP log of servotap, got one of profile {profile!r} without raw bytes"
        )
    for bus, coverage in covered.items():
        if coverage.missing:
            source.note(f"{coverage.missing} bytes of {bus} are not in the log")
        if coverage.late:
            source.note(f"{coverage.late} messages of {bus} stand out of order in the log")


def _traffic(
    source: Source, lane: _Lane, t_ns: int, logged: _Logged, covered: dict[str, _Coverage]
) -> Chunk | CanFrame | Comment | None:
    if logged.raw is None:
        return source.comment(t_ns, logged.message) if lane.topic == _COMMENTS and logged.message else None
    data = bytes.fromhex(logged.raw)
    direction = _ROLES.get(logged.direction, Role.UNKNOWN)
    if logged.can_id is not None:
        flags = logged.can_flags
        return CanFrame(
            t_ns,
            source.port(lane.bus or None),
            logged.can_id,
            data,
            direction,
            "extended" in flags,
            "remote" in flags,
            "error" in flags,
            "fd" in flags,
        )
    if lane.can:
        return None
    if logged.offset is not None and lane.bus:
        coverage = covered.setdefault(lane.bus, _Coverage()) if len(covered) < _GAP_LIMIT else _Coverage()
        first, stop = coverage.fresh(logged.offset, len(data))
        data = data[first:stop]
    return Chunk(t_ns, source.port(lane.bus or None), data, direction) if data else None


def _unpacked(source: Source) -> Iterator[object]:
    """Yield the log's records, those of chunks too, as far as they go."""
    from mcap.records import Chunk as Packed
    from mcap.stream_reader import StreamReader

    file = _File(source)
    reader = StreamReader(cast(IO[bytes], file), emit_chunks=True, record_size_limit=_RECORD_LIMIT)
    try:
        for record in reader.records:
            if isinstance(record, Packed):
                yield from _chunk(source, record, file.offset)
            else:
                yield record
    except (ServotapError, GeneratorExit):
        raise
    # The library raises whatever a damaged record makes it stumble over.
    except Exception as error:
        source.problem(f"the log is not whole: {describe(error)}", offset=file.offset)


def _chunk(source: Source, packed: object, offset: int) -> Iterator[object]:
    """Yield the records of a chunk."""
    from mcap.records import Chunk as Packed
    from mcap.stream_reader import breakup_chunk

    assert isinstance(packed, Packed)
    try:
        data = _unpack(packed.compression, packed.data)
        plain = Packed(
            compression="",
            data=data,
            message_end_time=packed.message_end_time,
            message_start_time=packed.message_start_time,
            uncompressed_crc=packed.uncompressed_crc,
            uncompressed_size=len(data),
        )
        records = breakup_chunk(plain, validate_crc=True)
    # As above: zstandard, lz4 and the library each have errors of their own.
    except Exception as error:
        source.problem(f"a chunk of the log cannot be read: {describe(error)}", offset=offset)
        return
    yield from records


def _unpack(compression: str, data: bytes) -> bytes:
    """Return a chunk's data. Raises ValueError for one that grows beyond bounds or is packed in an unknown way."""
    if not compression:
        return data
    opened: IO[bytes]
    if compression == "zstd":
        import zstandard

        opened = cast(IO[bytes], zstandard.ZstdDecompressor().stream_reader(io.BytesIO(data)))
    elif compression == "lz4":
        import lz4.frame  # type: ignore[import-untyped]

        opened = lz4.frame.open(io.BytesIO(data))
    else:
        raise ValueError(f"expected compression zstd or lz4, got {compression[:40]!r}")
    unpacked = opened.read(_UNPACKED_LIMIT + 1)
    if len(unpacked) > _UNPACKED_LIMIT:
        raise ValueError(f"{len(data)} bytes unpack to more than {_UNPACKED_LIMIT >> 20} MiB")
    return unpacked
