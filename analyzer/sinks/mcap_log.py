"""The log: decoded records as an MCAP file for Foxglove, PlotJuggler and any MCAP reader.

    /<bus>/<address>/<command>/<request|reply>   the decoded fields, flat, with reserved keys that begin with _
    /<bus>/<address>/state                       position, speed, current ... from any reply that carries them
    /<bus>/unknown  /<bus>/foreign  /<bus>/junk  /<bus>/stats    /findings  /comments  /recording

`log_time` is the time of the last byte and never decreases; `publish_time` is the estimated start on the wire. Where the clock
of a capture was set back, `_backward_ns` says how far a message's own time lies before its `log_time`.
"""

from __future__ import annotations

from binascii import hexlify
from collections.abc import Callable, Mapping
from typing import IO, TYPE_CHECKING, Any, NamedTuple

import msgspec

from analyzer import __version__, events
from analyzer.catalogue import Role
from analyzer.codec import codec
from analyzer.columns.block import CanBlock, FrameBlock
from analyzer.decoder import physical
from analyzer.entries import Entry, plain_entry
from analyzer.framer import JUMP_BACK_NS
from analyzer.pipeline import CAN_OVERHEAD_BITS
from analyzer.port import topic_name
from analyzer.records import CanFrame, Comment, Event, Finding, Frame, Junk, Lane, Message, Severity
from analyzer.sinks import schemas
from analyzer.sinks.mcap_file import LogFile, McapFile
from analyzer.sources.recording_parts import CLOCK_METADATA
from analyzer.sources.source import LATEST_NS
from analyzer.sources.times import Clock
from analyzer.values import SECOND_NS

if TYPE_CHECKING:
    from analyzer.columns.codec import Integers
    from analyzer.columns.plain import Plain

PROFILE = "servotap"
LIBRARY = f"servotap {__version__}"
_LEVELS = {Severity.INFO: 2, Severity.WARNING: 3, Severity.ERROR: 4}
_encode = msgspec.json.Encoder().encode


class _Topic:
    """What is kept per topic: the channel and, for replies, which fields feed the derived state."""

    __slots__ = ("channel", "odd", "state", "state_lane")

    def __init__(self, channel: int) -> None:
        self.channel = channel
        self.odd = False
        self.state: dict[int, tuple[tuple[str, str, float], ...]] = {}
        self.state_lane: _Topic | None = None


class Speed(NamedTuple):
    """How long things take on a bus, in nanoseconds, 0 where it is not known: a byte on a serial line, a bit on CAN."""

    byte_ns: int = 0
    bit_ns: int = 0


class Second:
    """Counts of one second of a bus."""

    __slots__ = ("bytes", "end_ns", "errors", "frames", "junk_bytes", "speed", "warnings", "wire_ns")

    def __init__(self, end_ns: int, speed: Speed) -> None:
        self.end_ns = end_ns
        self.speed = speed
        self.frames = self.bytes = self.junk_bytes = self.errors = self.warnings = self.wire_ns = 0


class McapLog:
    """A sink that writes the log to a file, or to a stream open for binary writing.

    `byte_ns`, `bit_ns`: time of a byte and of a bit for the bus load, 0 where it is not known; `speeds`: by bus, where
    they differ. `clock`: what its times are.
    """

    def __init__(
        self,
        target: IO[bytes] | LogFile,
        *,
        byte_ns: int = 0,
        bit_ns: int = 0,
        speeds: Mapping[str, Speed] | None = None,
        clock: Clock = Clock.UTC,
    ) -> None:
        self._file: LogFile
        self._file = target if isinstance(target, LogFile) else McapFile(target, profile=PROFILE, library=LIBRARY)
        self._lanes: dict[str, _Topic] = {}
        self._schemas: dict[str, int] = {}
        #: Channels that the file has and no lane was opened for yet: of a file that another left.
        self._channels: dict[str, int] = {}
        self._last_ns = 0
        self._seconds: dict[str, Second] = {}
        #: The present block, and of each of its lanes the channels of its topic and its state, 0 where none is open. Those of
        #: all lanes so far.
        self._plain: Plain
        self._channels_of: Integers
        self._channels_of_lanes: dict[Lane, tuple[int, int]] = {}
        self._speed = Speed(byte_ns, bit_ns)
        self._speeds = dict(speeds or {})
        if clock is not Clock.UTC:
            self._file.add_metadata(CLOCK_METADATA, {"clock": clock})

    @property
    def messages(self) -> int:
        return self._file.messages

    # --- sink -----------------------------------------------------------------------------------------------------

    def plain(self, lane: Lane, frame: Frame, sequence: int, latency_ns: int | None, request_sequence: int | None) -> None:
        """Write a frame that is in order, and the state it carries."""
        kept = self._lanes.get(lane.topic)
        log_ns = frame.last_ns
        if kept is None or kept.odd or log_ns < self._last_ns - JUMP_BACK_NS:
            self.entry(plain_entry(lane, frame, sequence, latency_ns, request_sequence))
            return
        data = frame.data
        log_ns = self._clock(log_ns)
        own = data[lane.start : lane.stop]
        start, raw = lane.codec.json(own), hexlify(data, " ").upper()
        if request_sequence is None:
            text = b'%b"_raw":"%b","_checksum_ok":true,"_offset":%d}' % (start, raw, frame.offset)
        elif latency_ns is None:
            text = b'%b"_raw":"%b","_checksum_ok":true,"_offset":%d,"_request_sequence":%d}' % (
                start, raw, frame.offset, request_sequence,
            )  # fmt: skip
        else:
            seconds, rest = divmod(latency_ns, SECOND_NS)
            text = b'%b"_raw":"%b","_checksum_ok":true,"_offset":%d,"_latency":%d.%09d,"_request_sequence":%d}' % (
                start, raw, frame.offset, seconds, rest, request_sequence,
            )  # fmt: skip
        can = frame.can
        if can is not None:
            if frame.role is Role.UNKNOWN:
                text = b'%b,"_can_id":%d}' % (text[:-1], can.id)
            else:
                text = b'%b,"_can_id":%d,"_direction":"%b"}' % (text[:-1], can.id, frame.role.encode())
        publish_ns = frame.first_ns
        self._file.add_message(kept.channel, sequence, log_ns, publish_ns if publish_ns > 0 else 0, text)
        if not lane.is_request:
            parts = kept.state.get(id(lane.form))
            if parts is None:
                parts = self._state_parts(kept, lane.message(frame))
            if parts:
                self._state(frame, lane.address, lane.codec.physical(own), sequence, kept, parts, log_ns)
        second = self._seconds.get(frame.port)
        if second is None or log_ns >= second.end_ns:
            second = self._second(frame.port, log_ns)
        size = len(data)
        second.frames += 1
        second.bytes += size
        byte_ns, bit_ns = second.speed
        second.wire_ns += size * byte_ns if can is None else (CAN_OVERHEAD_BITS + 8 * size) * bit_ns

    def begin(self, plain: Plain) -> None:
        import numpy as np

        self._plain = plain
        self._channels_of = np.array([self._channels_of_lanes.get(lane, (0, 0)) for lane in plain.lanes]).reshape(-1, 2)

    def _open_lanes(self, start: int, stop: int) -> None:
        """Open the topics of some rows that have none, in the order of the rows."""
        plain = self._plain
        firsts = plain.firsts(start, stop)
        for row in sorted(firsts[(self._channels_of[:, 0] == 0) & (firsts < stop)].tolist()):
            number = plain.lane[row]
            lane = plain.lanes[number]
            kept = self._lanes.get(lane.topic) or self._open_lane(lane.topic, lane.message(plain.frame(row)))
            state = self._state_topic(kept, plain.block.port, lane.address) if lane.states else None
            channels = self._channels_of_lanes[lane] = kept.channel, 0 if state is None else state.channel
            self._channels_of[number] = channels

    def run(self, start: int, stop: int, sequence: int) -> None:
        """Write plain exchanges, and the state that they carry."""
        assert isinstance(self._file, McapFile)  # only a capture that is read whole comes in blocks
        plain, block = self._plain, self._plain.block
        if not self._channels_of[:, 0].all():
            self._open_lanes(start, stop)
        log_ns = block.t_ns[start:stop].clip(self._last_ns, LATEST_NS)
        second = self._seconds.get(block.port)
        written = counted = 0
        while counted < len(log_ns):
            behind = 0 if second is None else int(log_ns.searchsorted(second.end_ns))
            if second is not None:
                _count(second, block, start + counted, start + behind)
            # The first frame of a second stands before the counts of the last second.
            end = min(behind + 1, len(log_ns))
            own = sequence + written, log_ns[written:end]
            self._file.add_rows(plain, self._channels_of, start + written, start + end, *own)
            self._last_ns = int(log_ns[end - 1])
            if behind < len(log_ns):
                second = self._second(block.port, int(log_ns[behind]))
            written, counted = end, behind if behind < len(log_ns) else end

    def entry(self, entry: Entry) -> None:
        """Write a decoded frame, and the state it carries."""
        message = entry.message
        frame = message.frame
        form = message.form
        lane = self._lanes.get(entry.topic)
        if lane is None:
            lane = self._open_lane(entry.topic, message)
        log_ns = self._clock(frame.last_ns)
        backward_ns = _backward_ns(frame.last_ns, log_ns)
        if form is None or lane.odd or entry.findings or frame.can is not None or backward_ns:
            data = self._odd(entry, lane, backward_ns)
        else:
            start, raw = codec(form.layout).json(message.data), hexlify(frame.data, " ").upper()
            ok = b"true" if frame.checksum_ok else b"false"
            if entry.request_sequence is None:
                data = b'%b"_raw":"%b","_checksum_ok":%b,"_offset":%d}' % (start, raw, ok, frame.offset)
            elif entry.latency_ns is None:
                data = b'%b"_raw":"%b","_checksum_ok":%b,"_offset":%d,"_request_sequence":%d}' % (
                    start, raw, ok, frame.offset, entry.request_sequence,
                )  # fmt: skip
            else:
                seconds, rest = divmod(entry.latency_ns, SECOND_NS)
                data = b'%b"_raw":"%b","_checksum_ok":%b,"_offset":%d,"_latency":%d.%09d,"_request_sequence":%d}' % (
                    start, raw, ok, frame.offset, seconds, rest, entry.request_sequence,
                )  # fmt: skip
        publish_ns = frame.first_ns
        if publish_ns < 0:
            publish_ns = 0
        self._file.add_message(lane.channel, entry.sequence, log_ns, publish_ns, data)
        if form is not None and frame.checksum_ok:
            parts = lane.state.get(id(form))
            if parts is None:
                parts = self._state_parts(lane, message)
            if parts:
                self._state(frame, message.address, physical(message), entry.sequence, lane, parts, log_ns)
        second = self._seconds.get(frame.port)
        if second is None or log_ns >= second.end_ns:
            second = self._second(frame.port, log_ns)
        size = len(frame.data)
        second.frames += 1
        second.bytes += size
        byte_ns, bit_ns = second.speed
        second.wire_ns += size * byte_ns if frame.can is None else (CAN_OVERHEAD_BITS + 8 * size) * bit_ns

    def _odd(self, entry: Entry, lane: _Topic, backward_ns: int) -> bytes:
        """Return the JSON of a message that is more than its fields: unknown, with findings, a package, on CAN.

        `backward_ns`: how far its time lies before the one under which it is logged.
        """
        message = entry.message
        frame = message.frame
        shown = physical(message)
        if message.role is Role.FOREIGN:
            shown |= {"address": message.address, "who": message.who, "length": len(frame.data)}
        elif lane.odd and (message.command is None or message.role is Role.UNKNOWN):
            shown["address"] = message.address
            shown["dialect"] = frame.dialect.name
            shown["role"] = message.role.value
            if message.command is not None:
                shown["command"] = message.command.name
        shown["_raw"] = frame.data.hex(" ").upper()
        if message.role is not Role.FOREIGN:
            shown["_checksum_ok"] = frame.checksum_ok
        shown["_offset"] = frame.offset
        if backward_ns:
            shown["_backward_ns"] = backward_ns
        if entry.findings:
            shown["_findings"] = [f.rule for f in entry.findings]
        if entry.request_sequence is not None:
            if entry.latency_ns is not None:
                shown["_latency"] = entry.latency_ns / 1e9
            shown["_request_sequence"] = entry.request_sequence
        can = frame.can
        if can is not None:
            shown["_can_id"] = can.id
            if frame.role is not Role.UNKNOWN:
                shown["_direction"] = frame.role.value
            flags = can_flags(can)
            if flags:
                shown["_can_flags"] = flags
        return _encode(shown)

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        lane = self._lanes.get(topic)
        if lane is None:
            lane = self._add_lane(topic, "servotap.junk", schemas.junk_schema, {"bus_kind": "serial"})
        data = {
            "reason": junk.reason.value,
            "length": len(junk.data),
            "_raw": junk.data.hex(" ").upper(),
            "_offset": junk.offset,
        }
        log_ns = self._clock(junk.last_ns)
        if backward_ns := _backward_ns(junk.last_ns, log_ns):
            data["_backward_ns"] = backward_ns
        self._file.add_message(lane.channel, sequence, log_ns, max(0, junk.first_ns), _encode(data))
        second = self._second(junk.port, log_ns)
        second.junk_bytes += len(junk.data)
        second.bytes += len(junk.data)
        second.wire_ns += len(junk.data) * second.speed.byte_ns

    def finding(self, found: Finding) -> None:
        second = self._seconds.get(found.port)
        if second is not None:
            second.errors += found.severity is Severity.ERROR
            second.warnings += found.severity is Severity.WARNING
        data: dict[str, Any] = {
            "timestamp": {"sec": found.first_ns // SECOND_NS, "nsec": found.first_ns % SECOND_NS},
            "level": _LEVELS[found.severity],
            "message": found.text,
            "name": found.rule,
            "file": found.topic,
            "line": found.sequence,
            "section": found.section,
            "bus": topic_name(found.port) if found.port else "",
            "offset": found.offset,
        }
        if found.address is not None:
            data["address"] = found.address
        self._log("/findings", data, found.sequence, found.last_ns)

    def comment(self, comment: Comment) -> None:
        t_ns = self._last_ns if comment.t_ns is None else comment.t_ns
        data = {
            "timestamp": {"sec": max(0, t_ns) // SECOND_NS, "nsec": max(0, t_ns) % SECOND_NS},
            "level": 2,
            "message": comment.text,
            "name": "comment",
            "bus": topic_name(comment.port) if comment.port else "",
        }
        self._log("/comments", data, 0, t_ns)

    def happened(self, event: Event, sequence: int) -> None:
        lane = self._lanes.get(events.TOPIC)
        if lane is None:
            lane = self._add_lane(events.TOPIC, "servotap.recording", schemas.event_schema, {})
        bus = topic_name(event.port) if event.port else ""
        if event.name in events.SETUPS:
            self._learn_speed(event)
        data = {"event": event.name, "bus": bus, "text": events.text_of(event), **schemas.event_values(event.values)}
        log_ns = self._clock(event.t_ns)
        self._file.add_message(lane.channel, sequence, log_ns, log_ns, _encode(data))

    def _learn_speed(self, event: Event) -> None:
        values = event.values
        byte_ns, speed = values.get("byte_ns"), values.get("speed")
        if values.get("kind") == "can" and isinstance(speed, int) and speed > 0:
            self._speeds[event.port] = Speed(0, SECOND_NS // speed)
        elif isinstance(byte_ns, int) and byte_ns > 0:
            self._speeds[event.port] = Speed(byte_ns, 0)

    def finish(self, metadata: Mapping[str, str]) -> None:
        """Write the last counts, the metadata and the summary; the file is whole after this."""
        self._end_seconds()
        self._file.add_metadata("servotap", metadata)
        self._file.finish()

    def _end_seconds(self) -> None:
        for bus, second in self._seconds.items():
            self._write_second(bus, second)
        self._seconds.clear()

    def flush(self) -> None:
        self._file.flush()

    def abandon(self) -> None:
        self._file.abandon()

    # --- topics ---------------------------------------------------------------------------------------------------

    def _open_lane(self, topic: str, message: Message) -> _Topic:
        dialect, command = message.frame.dialect, message.command
        if message.role is Role.FOREIGN:
            lane = self._add_lane(topic, "servotap.foreign", schemas.foreign_schema, {"bus_kind": dialect.bus})
            lane.odd = True
            return lane
        about = {"dialect": dialect.name, "manual": dialect.manual, "bus_kind": dialect.bus}
        if command is None or message.role is Role.UNKNOWN:
            lane = self._add_lane(topic, "servotap.unknown", schemas.unknown_schema, {"bus_kind": dialect.bus})
            lane.odd = True
            return lane
        about["section"] = command.section
        about["command"] = command.name
        about["code"] = f"0x{command.code:04X}" if command.function is not None else f"0x{command.code:02X}"
        name = f"servotap.{dialect.name}.{command.name}.{message.role}"
        lane = self._add_lane(topic, name, lambda: schemas.command_schema(dialect, command, message.role), about)
        lane.odd = command.slots is not None
        return lane

    def _add_lane(self, topic: str, name: str, schema: Callable[[], bytes], about: Mapping[str, str]) -> _Topic:
        channel = self._channels.get(topic)
        if channel is None:
            schema_id = self._schemas.get(name)
            if schema_id is None:
                schema_id = self._schemas[name] = self._file.add_schema(name, schema())
            channel = self._file.add_channel(topic, schema_id, about)
        lane = self._lanes[topic] = _Topic(channel)
        return lane

    def _log(self, topic: str, data: dict[str, Any], sequence: int, t_ns: int) -> None:
        lane = self._lanes.get(topic) or self._add_lane(topic, "foxglove.Log", schemas.log_schema, {})
        log_ns = self._clock(t_ns)
        self._file.add_message(lane.channel, sequence, log_ns, log_ns, _encode(data))

    # --- derived topics -------------------------------------------------------------------------------------------

    @staticmethod
    def _state_parts(lane: _Topic, message: Message) -> tuple[tuple[str, str, float], ...]:
        form = message.form
        assert form is not None  # asked only for a message that fits a form
        named = form.layout.named.values() if message.role is Role.REPLY else ()
        parts = tuple((f.name, f.state.quantity, f.state.factor) for f in named if f.state is not None)
        lane.state[id(form)] = parts
        return parts

    def _state(
        self,
        frame: Frame,
        address: int,
        fields: dict[str, Any],
        sequence: int,
        lane: _Topic,
        parts: tuple[tuple[str, str, float], ...],
        log_ns: int,
    ) -> None:
        target = lane.state_lane or self._state_topic(lane, frame.port, address)
        if len(parts) == 1:
            name, quantity, factor = parts[0]
            data = b'{"%b":%a}' % (quantity.encode(), fields[name] * factor)
        else:
            state: dict[str, float] = {}
            for name, quantity, factor in parts:
                state[quantity] = state.get(quantity, 0.0) + fields[name] * factor
            data = _encode(state)
        self._file.add_message(target.channel, sequence, log_ns, max(0, frame.first_ns), data)

    def _state_topic(self, lane: _Topic, port: str, address: int) -> _Topic:
        """Return the topic of the state that a topic's messages carry."""
        topic = f"/{topic_name(port)}/{address}/state"
        lane.state_lane = self._lanes.get(topic) or self._add_lane(topic, "servotap.state", schemas.state_schema, {})
        return lane.state_lane

    def _second(self, port: str, log_ns: int) -> Second:
        second = self._seconds.get(port)
        if second is None or log_ns >= second.end_ns:
            if second is not None:
                self._write_second(port, second)
            speed = self._speeds.get(port, self._speed)
            second = self._seconds[port] = Second((log_ns // SECOND_NS + 1) * SECOND_NS, speed)
        return second

    def _write_second(self, port: str, second: Second) -> None:
        topic = f"/{topic_name(port)}/stats"
        lane = self._lanes.get(topic) or self._add_lane(topic, "servotap.stats", schemas.stats_schema, {})
        data: dict[str, Any] = {name: getattr(second, name) for name in ("frames", "bytes", "junk_bytes", "errors", "warnings")}
        if any(second.speed):
            data["load"] = second.wire_ns / SECOND_NS
        log_ns = self._clock(self._last_ns)
        self._file.add_message(lane.channel, 0, log_ns, log_ns, _encode(data))

    def _clock(self, t_ns: int) -> int:
        """Return a log time that never decreases and fits the format."""
        if t_ns > self._last_ns:
            self._last_ns = min(t_ns, LATEST_NS)
        return self._last_ns


def _backward_ns(t_ns: int, log_ns: int) -> int:
    """Return how far a time lies before the one of the log, where its clock was set back; buses differ by less."""
    return log_ns - t_ns if t_ns < log_ns - JUMP_BACK_NS else 0


def _count(second: Second, block: CanBlock | FrameBlock, start: int, stop: int) -> None:
    """Count frames of a block."""
    frames, size = stop - start, int(block.sizes[start:stop].sum())
    second.frames += frames
    second.bytes += size
    byte_ns, bit_ns = second.speed
    second.wire_ns += (CAN_OVERHEAD_BITS * frames + 8 * size) * bit_ns if isinstance(block, CanBlock) else size * byte_ns


def can_flags(can: CanFrame) -> list[str]:
    """Return what is special about a CAN frame, by name."""
    return [name for name in ("extended", "remote", "error", "fd") if getattr(can, name)]
