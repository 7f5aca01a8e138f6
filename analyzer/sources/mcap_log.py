"""A log of this program, given back as the traffic it was made of, to be decoded again.

Each message that has `_raw` (decoded frames, `/<bus>/unknown`, `/<bus>/junk`, `/<bus>/raw`) becomes a chunk or a CAN
frame with its exact bytes and time; `/comments` become comments, `/recording` events. What the log said a frame means is not
given on, so that another dialect starts afresh.

Rules: each byte of a bus is given once, found by `_offset`, although `/<bus>/raw` repeats what the frames hold. Where a
raw topic says that it is complete it alone is read, with the pauses that it notes: so the log of a live recording is
decoded as it was while it ran. If frames are asked for instead (`Source.framed`), raw bytes are given only where there are
none. A log that was not finished is read as far as it goes. Of a long log, plain CAN frames come as blocks (`mcap_blocks`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Any

import msgspec

from analyzer.catalogue import Role
from analyzer.columns.block import CanBlock
from analyzer.errors import UnreadableError
from analyzer.events import RESUMED, SETUPS, TOPIC, checked
from analyzer.records import CanFrame, Chunk, Event, Silence
from analyzer.sources import magic
from analyzer.sources.coverage import GAP_LIMIT, Coverage, Raw, Waiting
from analyzer.sources.mcap_scan import LogMessage, Messages
from analyzer.sources.recording_parts import clock_of
from analyzer.sources.source import COMMENT_LIMIT, Record, Source, clean_port, describe
from analyzer.system.decoding import UNDECODABLE
from analyzer.values import counted

_PROFILE = "servotap"
_COMMENTS = "/comments"
_RAW = "raw"
#: For messages that are read singly: no bus of a topic has such a name.
_NO_BUS = "/"
#: Data bytes of the longest CAN frame.
CAN_BYTES = 64
_ROLES = {role.value: role for role in Role}


class _Logged(msgspec.Struct, gc=False):
    """The keys of a message that matter here."""

    raw: str | None = msgspec.field(name="_raw", default=None)
    offset: Annotated[int, msgspec.Meta(ge=0, le=1 << 62)] | None = msgspec.field(name="_offset", default=None)
    # An error frame has a bit above the 29 of an identifier.
    can_id: Annotated[int, msgspec.Meta(ge=0, le=0x3FFF_FFFF)] | None = msgspec.field(name="_can_id", default=None)
    can_flags: tuple[str, ...] = msgspec.field(name="_can_flags", default=())
    direction: str = msgspec.field(name="_direction", default="")
    backward_ns: Annotated[int, msgspec.Meta(ge=0)] = msgspec.field(name="_backward_ns", default=0)
    silence: bool = msgspec.field(name="_silence", default=False)
    findings: tuple[str, ...] = msgspec.field(name="_findings", default=())
    message: str = ""
    bus: str | None = None

    @property
    def is_plain(self) -> bool:
        """Whether it is traffic, with nothing odd about its frame."""
        return self.raw is not None and not (self.silence or self.can_flags or self.backward_ns)


class _Lane:
    """What a channel says of its messages."""

    def __init__(self, topic: str, metadata: dict[str, str]) -> None:
        parts = topic.split("/")
        self.topic = topic
        self.bus = parts[1] if len(parts) > 1 else ""
        self.last = parts[-1]
        self.can = metadata.get("bus_kind") == "can"
        self.is_raw = self.last == _RAW and len(parts) == 3
        #: All that came stands in this topic; or, of any other topic, in the raw one of its bus.
        self.complete = self.is_raw and metadata.get("complete") == "true"
        #: Nothing of it is wanted: no traffic, or traffic that stands elsewhere, too.
        self.idle = (len(parts), self.last) in ((4, "state"), (3, "stats")) or topic == "/findings"


def read(source: Source) -> Iterator[Record | CanBlock]:
    """Read the messages in the order of the log."""
    if not source.head.startswith(magic.MCAP):
        raise UnreadableError(f"{source.name}: expected an MCAP log (89 4D 43 41 50 ...), got another beginning")
    if source.size is not None:
        source.clock = clock_of(source.files[0])
    source.time_source = "log: times of the log that was read, exact to 1 ns"
    return _Log(source).records()


class _Log:
    """A log that is being read."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._lanes: dict[int, _Lane] = {}
        self._covered: dict[str, Coverage] = {}
        #: Buses whose raw topic holds all, and those whose raw topic was declared at all.
        self._complete: set[str] = set()
        self._waiting: Waiting | None = None
        self._decode = msgspec.json.Decoder(_Logged).decode
        #: What was said last of how each bus is to be read; and those that have begun.
        self._setups: dict[str, Event] = {}
        self._begun: set[str] = set()
        self._sequence = 0

    def records(self) -> Iterator[Record | CanBlock]:
        """Yield what the log holds."""
        # Only now: every format is asked whether a capture is its own, and most captures are not.
        from mcap.records import Channel, Header, Metadata

        from analyzer.sources.mcap_records import records

        source = self._source
        self._waiting = Waiting() if source.framed else None
        profile = None
        traffic = False
        for record in records(source):
            if isinstance(record, LogMessage):
                for taken in self._message(record):
                    traffic = True
                    yield taken
            elif isinstance(record, Messages):
                for several in self._together(record):
                    traffic = True
                    yield several
            elif isinstance(record, Channel):
                self._declare(record.id, _Lane(record.topic, record.metadata))
            elif isinstance(record, Header):
                profile = record.profile
                # Another part has channels of its own.
                self._lanes.clear()
            elif isinstance(record, Metadata) and record.name.startswith(_PROFILE) and record.metadata.get("time_source"):
                source.time_source = f"log: {record.metadata['time_source']}"
        if self._waiting is not None:
            for chunk in self._waiting.rest():
                traffic = True
                yield chunk
        if not traffic and profile != _PROFILE:
            raise UnreadableError(
                f"{source.name}: expected an MCAP log of servotap, got one of profile {profile!r} without raw bytes"
            )
        for bus, coverage in self._covered.items():
            if coverage.head and source.skip_before_ns is None:
                source.note(_begins_at(bus, coverage.head))
            if missing := coverage.missing - coverage.head:
                source.note(f"{counted(missing, 'byte')} of {bus} missing in the log")
            if coverage.late:
                source.note(f"{counted(coverage.late, 'message')} of {bus} out of order in the log")

    def _declare(self, number: int, lane: _Lane) -> None:
        self._lanes[number] = lane
        if lane.complete and self._waiting is None:
            self._complete.add(lane.bus)

    def _message(self, record: LogMessage) -> Iterator[Record]:
        source = self._source
        lane = self._lanes.get(record.channel_id)
        if lane is None:
            # The chunk that declared it is damaged; its bytes are still good.
            source.note("some topics' declarations are lost: their bytes are taken as of one bus")
            lane = self._lanes[record.channel_id] = _Lane("", {})
        if self._passes_over(lane):
            return
        if source.skip_before_ns is not None and record.log_ns < source.skip_before_ns and lane.topic != TOPIC:
            return
        if source.rewound and 0 < record.sequence <= self._sequence:
            return
        self._sequence = max(self._sequence, record.sequence)
        try:
            if lane.topic == TOPIC:
                yield from self._event(record)
                return
            logged = self._decode(record.data)
        except UNDECODABLE as error:
            source.problem(f"a message of {lane.topic}: {describe(error)}")
            return
        yield from self._given(lane, record.log_ns, logged)

    def _given(self, lane: _Lane, log_ns: int, logged: _Logged) -> Iterator[Record]:
        """Yield what a message gives, once its JSON has been read."""
        try:
            taken = self._traffic(lane, log_ns - logged.backward_ns, logged)
        except UNDECODABLE as error:
            self._source.problem(f"a message of {lane.topic}: {describe(error)}")
            return
        if self._waiting is not None:
            yield from self._waiting.due(log_ns)
        if taken is not None:
            if lane.bus not in self._begun and logged.offset is not None:
                yield from self._begin(lane, log_ns, logged.offset)
            yield taken

    def _passes_over(self, lane: _Lane) -> bool:
        """Say whether nothing of a topic is wanted, or all of it stands in the raw topic of its bus."""
        return lane.idle or (lane.bus in self._complete and not lane.is_raw)

    def _together(self, messages: Messages) -> Iterator[Record | CanBlock]:
        """Yield what messages hold that follow each other: plain CAN frames as blocks, all else one by one."""
        from analyzer.sources.mcap_blocks import Read

        def bus_of(channel: int) -> str | None:
            lane = self._lanes.get(channel)
            if lane is None or lane.topic == TOPIC:
                return _NO_BUS
            return None if self._passes_over(lane) else lane.bus

        try:
            read = Read(messages, bus_of, self._decode)
        except UNDECODABLE:
            # One by one it is known which is damaged.
            for number in range(len(messages.starts)):
                yield from self._message(messages.single(number))
            return
        for start, stop, bus, block in read.found().stretches():
            for row in range(start, stop):
                if block is not None and bus in self._begun:
                    yield replace(block.part(slice(row - start, None)), port=self._source.port(bus or None, "can"))
                    break
                lane = self._lanes.get(read.channels[row])
                if lane is None or lane.topic == TOPIC:
                    yield from self._message(messages.single(int(read.rows[row])))
                else:
                    yield from self._given(lane, read.log_ns[row], read.logged[row])

    def _traffic(self, lane: _Lane, t_ns: int, logged: _Logged) -> Record | None:
        source, waiting = self._source, self._waiting
        if logged.raw is None:
            if lane.topic != _COMMENTS or not logged.message:
                return None
            comment = source.comment(t_ns, logged.message)
            # A mark is about all buses.
            return comment if logged.bus is None else msgspec.structs.replace(comment, port=clean_port(logged.bus))
        if logged.silence:
            return Silence(t_ns, source.port(lane.bus or None)) if waiting is None else None
        data = bytes.fromhex(logged.raw)
        direction = _ROLES.get(logged.direction, Role.UNKNOWN)
        if waiting is not None and not logged.direction and not logged.findings and logged.can_id is None:
            direction = _ROLES.get(lane.last, Role.UNKNOWN)
        if logged.can_id is not None:
            flags = logged.can_flags
            if len(data) > CAN_BYTES:
                raise ValueError(f"expected a CAN frame of up to {CAN_BYTES} bytes, got {len(data)}")
            return CanFrame(
                t_ns,
                source.port(lane.bus or None, "can"),
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
            coverage = self._coverage(lane.bus, logged.offset)
            if waiting is not None and lane.is_raw:
                waiting.add(Raw(coverage, logged.offset, Chunk(t_ns, self._serial(lane), data, direction)))
                return None
            first, stop = coverage.fresh(logged.offset, len(data))
            data = data[first:stop]
        return Chunk(t_ns, self._serial(lane), data, direction) if data else None

    def _serial(self, lane: _Lane) -> str:
        return self._source.port(lane.bus or None, "serial")

    def _coverage(self, bus: str, offset: int) -> Coverage:
        """Return what was given of a bus."""
        known = self._covered.get(bus)
        if known is None:
            # Of a bus that begins in the midst, what was before is not missed; where nothing was said of it, all is.
            known = Coverage(offset if bus in self._setups else 0)
            if len(self._covered) < GAP_LIMIT:
                self._covered[bus] = known
        return known

    # --- events ---------------------------------------------------------------------------------------------------

    def _event(self, record: LogMessage) -> Iterator[Record]:
        values: dict[str, Any] = msgspec.json.decode(record.data, type=dict[str, Any])
        name, bus, text = (str(values.pop(key, ""))[:COMMENT_LIMIT] for key in ("event", "bus", "text"))
        details = values.pop("details", None)
        if isinstance(details, str):
            values |= msgspec.json.decode(details, type=dict[str, Any])
        values, wrong = checked(values)
        if name in SETUPS and not bus:
            self._source.problem(f"an event {name!r} of {TOPIC} that names no bus")
            return
        if wrong:
            self._source.problem(f"an event {name!r} of {TOPIC}, left out of it: {'; '.join(wrong)}")
        values["text"] = text
        port = self._source.port(bus) if bus else ""
        event = Event(record.log_ns, port, name, values)
        if name in SETUPS and bus:
            self._setups[bus] = event
        skipped = self._source.skip_before_ns is not None and record.log_ns < self._source.skip_before_ns
        if not skipped or name in SETUPS or name == "part":
            yield event

    def _begin(self, lane: _Lane, t_ns: int, offset: int) -> Iterator[Record]:
        """Say where a bus begins, if that is not where it was said to: a log of a stretch, or one read from the midst."""
        self._begun.add(lane.bus)
        said = self._setups.get(lane.bus)
        if said is None or said.values.get("offset", 0) == offset:
            return
        if self._source.skip_before_ns is None:
            self._source.note(_begins_at(lane.bus, offset))
        yield Event(t_ns, self._source.port(lane.bus or None), RESUMED, {**said.values, "offset": offset})


def _begins_at(bus: str, offset: int) -> str:
    return f"{bus} begins at byte {offset}: what came before is not in the log"
