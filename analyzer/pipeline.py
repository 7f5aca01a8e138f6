"""The pipeline: chunks and CAN frames in, entries, junk and findings out to the sinks.

    source -> framer -> decoder -> transactions -> findings -> sinks

One `Port` per bus holds its framer, context and transactions; the pipeline numbers what comes out (one count for the
whole log) and hands it on in order. It does no I/O: sinks do. Nothing is kept but the state of each port, so memory does
not grow with the input.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import msgspec

from analyzer.catalogue import Dialect, Role
from analyzer.context import Context
from analyzer.decoder import Decoder
from analyzer.errors import UsageError
from analyzer.findings import Issue, finding, is_plain, of_junk, of_message
from analyzer.framer import SILENCE_NS, Framer
from analyzer.records import CanFrame, Chunk, Comment, Finding, Frame, Junk, Lane, Message
from analyzer.transactions import Late, Transactions

#: Data bits of a CAN frame besides its payload, for made-up times: standard frame with its gap.
CAN_OVERHEAD_BITS = 47
#: A CAN identifier of the standard format has 11 bits.
CAN_ID_LIMIT = 0x7FF


class Entry(msgspec.Struct, frozen=True, gc=False):
    """A message with its place in the log and in its exchange."""

    message: Message
    sequence: int
    topic: str
    findings: tuple[Finding, ...] = ()
    latency_ns: int | None = None
    request_sequence: int | None = None
    first_reply: bool = False


class Sink(Protocol):
    """Takes what comes out of the pipeline, in order."""

    def entry(self, entry: Entry) -> None:
        """Take a decoded frame; its findings follow through `finding`."""

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        """Take bytes that are no frame; a finding follows."""

    def finding(self, found: Finding) -> None:
        """Take a finding."""

    def comment(self, comment: Comment) -> None:
        """Take a comment of the capture."""


@runtime_checkable
class PlainSink(Protocol):
    """A sink that takes the usual case in fewer steps: a frame of a lane, with no finding."""

    def plain(
        self, lane: Lane, frame: Frame, sequence: int, latency_ns: int | None, request_sequence: int | None
    ) -> None:
        """Take a frame; a reply is its request's first and has that request's sequence."""


@dataclass(frozen=True, slots=True)
class Options:
    """What a user can choose.

    `byte_ns`: time of one byte on the line, 0 if unknown; `synthetic_byte_ns` and `synthetic_bit_ns` make up the times of
    a capture that has none (serial bytes, CAN bits), and with `timed` False no latency is told from them.
    """

    byte_ns: int = 0
    synthetic_byte_ns: int = 10_000_000_000 // 38400
    synthetic_bit_ns: int = 2000
    timed: bool = True
    late_ns: int = 1_000_000_000
    silence_ns: int = SILENCE_NS
    groups: frozenset[int] = field(default_factory=frozenset)


def topic_name(text: str) -> str:
    """Return a text as one part of a topic: letters, digits, `_`, `-` and `.`; anything else becomes `_`."""
    cleaned = "".join(c if (c.isascii() and c.isalnum()) or c in "_-." else "_" for c in text.strip())
    return cleaned or "bus"


class Port:
    """One bus: its framer (serial), decoders, context and transactions."""

    def __init__(self, name: str, dialects: Sequence[Dialect], options: Options) -> None:
        self.name = name
        self.bus = topic_name(name)
        self.context = Context(options.groups)
        self.decoders = {d.name: Decoder(d) for d in dialects}
        serial = [d for d in dialects if d.bus == "serial"]
        self.can = [d for d in dialects if d.bus == "can"]
        self.framer = (
            Framer(name, serial, self.context, byte_ns=options.byte_ns, silence_ns=options.silence_ns)
            if serial
            else None
        )
        self.transactions = Transactions(
            self.context, late_ns=options.late_ns, half_duplex=bool(serial), timed=options.timed
        )
        self.clock_ns = 0
        self.bytes_in = 0
        self._request_topics: dict[tuple[int, str], str] = {}
        self._reply_topics: dict[tuple[int, str], str] = {}

    def topic(self, message: Message) -> str:
        """Return the topic of a message."""
        command, role = message.command, message.role
        if command is None or role is Role.UNKNOWN:
            return f"/{self.bus}/unknown"
        topics = self._request_topics if role is Role.REQUEST else self._reply_topics
        key = (message.address, command.name)
        known = topics.get(key)
        if known is None:
            who = "all" if command.slots is not None else str(message.address)
            known = topics[key] = f"/{self.bus}/{who}/{command.name}/{role}"
        return known


class Pipeline:
    """Decodes what it is fed and passes it to `sinks`. `dialects`: all that may be on the buses."""

    def __init__(self, dialects: Sequence[Dialect], sinks: Sequence[Sink], options: Options | None = None) -> None:
        self.dialects = tuple(dialects)
        self.sinks = tuple(sinks)
        self.options = options or Options()
        # A sink may take frames that are in order as they are, without an entry being built for it.
        self._plain_sinks = [s.plain for s in self.sinks if isinstance(s, PlainSink)]
        self._entry_sinks = [s for s in self.sinks if not isinstance(s, PlainSink)]
        self.ports: dict[str, Port] = {}
        self.sequence = 0

    def run(self, items: Iterable[Chunk | CanFrame | Comment]) -> None:
        """Feed all items, then close."""
        for item in items:
            self.feed(item)
        self.close()

    def feed(self, item: Chunk | CanFrame | Comment) -> None:
        """Take the next item of the source."""
        if isinstance(item, CanFrame):
            self._feed_can(self._port(item), item)
        elif isinstance(item, Chunk):
            self._feed_chunk(self._port(item), item)
        else:
            for sink in self.sinks:
                sink.comment(item)

    def _port(self, item: Chunk | CanFrame) -> Port:
        """Return the port of an item, its bytes counted."""
        port = self.ports.get(item.port)
        if port is None:
            port = self.ports[item.port] = Port(item.port, self.dialects, self.options)
        port.bytes_in += len(item.data)
        return port

    def silence(self, name: str) -> None:
        """Say that nothing more belongs to what came on a port so far."""
        port = self.ports.get(name)
        if port is not None and port.framer is not None:
            self._take(port, port.framer.silence())

    def close(self) -> None:
        """End the input: what waits is decided, open requests are given up."""
        for port in self.ports.values():
            if port.framer is not None:
                self._take(port, port.framer.close())
            for late in port.transactions.close():
                self._late(port, late)

    # --- serial ---------------------------------------------------------------------------------------------------

    def _feed_chunk(self, port: Port, chunk: Chunk) -> None:
        if port.framer is None:
            raise UsageError(f"{port.name} is a serial line, and {self.dialects[0].name} is a CAN dialect")
        if chunk.t_ns is None:
            port.clock_ns += len(chunk.data) * self.options.synthetic_byte_ns
            chunk = Chunk(port.clock_ns, chunk.port, chunk.data, chunk.direction, chunk.burst)
        self._take(port, port.framer.feed(chunk))

    def _take(self, port: Port, events: Iterator[Frame | Junk]) -> None:
        """Take the framer's events one at a time: each may change what it makes of the next."""
        for event in events:
            if isinstance(event, Frame):
                self._frame(port, event)
            else:
                self._junk(port, event)

    # --- CAN ------------------------------------------------------------------------------------------------------

    def _feed_can(self, port: Port, can: CanFrame) -> None:
        t_ns = can.t_ns
        if t_ns is None:
            port.clock_ns += (CAN_OVERHEAD_BITS + 8 * len(can.data)) * self.options.synthetic_bit_ns
            t_ns = port.clock_ns
        offset = port.bytes_in - len(can.data)
        dialect = port.can[0] if port.can else self.dialects[0]
        if not port.can:
            raise UsageError(f"{port.name} is a CAN bus, and {dialect.name} is a dialect of serial lines")
        usual = not (can.error or can.fd or can.extended or can.remote) and can.id <= CAN_ID_LIMIT and len(can.data) > 1
        foreign = None if usual else _foreign(can)
        if foreign is not None:
            frame = Frame(port.name, t_ns, t_ns, offset, can.data, dialect, can.direction, True, can)
            message = Message(frame, Role.UNKNOWN, can.id, None, None, can.data)
            self._write(port, message, [foreign])
            return
        if len(port.can) > 1:
            dialect = next((d for d in port.can if d.link.fits(can.data, can.id)), dialect)
        good = dialect.link.fits(can.data, can.id)
        self._frame(port, Frame(port.name, t_ns, t_ns, offset, can.data, dialect, can.direction, good, can))

    # --- what both share ------------------------------------------------------------------------------------------

    def _frame(self, port: Port, frame: Frame) -> None:
        context = port.context
        decoder = port.decoders[frame.dialect.name]
        if frame.checksum_ok and not context.borrowed:
            lane = decoder.lane(frame, context)
            if (
                lane is not None
                and (lane.sound is None or lane.sound(frame.data[lane.start : lane.stop]))
                and self._plain(port, lane, frame)
            ):
                return
        message, asked = decoder.decode(frame, context)
        topic = port.topic(message)
        paired = port.transactions.observe(message, self.sequence + 1, asked, topic)
        for late in paired.earlier:
            self._late(port, late)
        request = paired.request
        asked_by = None if request is None else request.sequence
        if not paired.issues and is_plain(message, context):
            self.sequence += 1
            entry = Entry(message, self.sequence, topic, (), paired.latency_ns, asked_by, paired.first)
            for sink in self.sinks:
                sink.entry(entry)
            return
        issues = of_message(message, context) + list(paired.issues)
        self._write(port, message, issues, topic, paired.latency_ns, asked_by, paired.first)

    def _plain(self, port: Port, lane: Lane, frame: Frame) -> bool:
        """Pass a frame on that is in order in every way; return False, with nothing done, if it has to be looked at."""
        sequence = self.sequence + 1
        latency_ns = asked_by = None
        if not lane.topic:
            lane.topic = port.topic(lane.message(frame))
        if frame.role is not Role.UNKNOWN and frame.role is not lane.role:
            return False
        if lane.is_request:
            if not port.transactions.plain_request(lane, frame, sequence):
                return False
        else:
            request = port.transactions.plain_reply(lane, frame)
            if request is None:
                return False
            asked_by = request.sequence
            if self.options.timed:
                latency_ns = frame.first_ns - request.t_ns
                if latency_ns < 0:
                    latency_ns = 0
        self.sequence = sequence
        for plain in self._plain_sinks:
            plain(lane, frame, sequence, latency_ns, asked_by)
        if self._entry_sinks:
            first = not lane.is_request
            entry = Entry(lane.message(frame), sequence, lane.topic, (), latency_ns, asked_by, first)
            for sink in self._entry_sinks:
                sink.entry(entry)
        return True

    def _write(
        self,
        port: Port,
        message: Message,
        issues: Sequence[Issue],
        topic: str = "",
        latency_ns: int | None = None,
        request_sequence: int | None = None,
        first_reply: bool = False,
    ) -> None:
        self.sequence += 1
        topic = topic or port.topic(message)
        found: tuple[Finding, ...] = ()
        if issues:
            found = tuple(self._tie(port, message, issue, topic, self.sequence) for issue in issues)
        entry = Entry(message, self.sequence, topic, found, latency_ns, request_sequence, first_reply)
        for sink in self.sinks:
            sink.entry(entry)
            for each in found:
                sink.finding(each)

    def _tie(self, port: Port, message: Message, issue: Issue, topic: str, sequence: int) -> Finding:
        command, frame = message.command, message.frame
        return finding(
            issue,
            port=port.name,
            address=message.address,
            first_ns=frame.first_ns,
            last_ns=frame.last_ns,
            section=command.section if command is not None else "",
            offset=frame.offset,
            topic=topic,
            sequence=sequence,
        )

    def _late(self, port: Port, late: Late) -> None:
        request = late.request
        found = self._tie(port, request.message, late.issue, request.topic, request.sequence)
        for sink in self.sinks:
            sink.finding(found)

    def _junk(self, port: Port, junk: Junk) -> None:
        self.sequence += 1
        topic = f"/{port.bus}/junk"
        found = finding(
            of_junk(junk),
            port=port.name,
            address=None,
            first_ns=junk.first_ns,
            last_ns=junk.last_ns,
            section="",
            offset=junk.offset,
            topic=topic,
            sequence=self.sequence,
        )
        for sink in self.sinks:
            sink.junk(junk, self.sequence, topic)
            sink.finding(found)


def _foreign(can: CanFrame) -> Issue | None:
    """Return why a CAN frame cannot be of a dialect with standard identifiers, or None."""
    if can.error:
        return Issue("can_error_frame", f"error frame, class 0x{can.id:X}, data {can.data.hex(' ').upper() or 'none'}")
    if can.fd:
        return Issue("foreign_can_frame", "a CAN FD frame, expected CAN 2.0A")
    if can.extended or can.id > CAN_ID_LIMIT:
        return Issue("foreign_can_frame", f"identifier 0x{can.id:X} has 29 bits, expected 11")
    if can.remote:
        return Issue("foreign_can_frame", "a remote frame, expected a data frame")
    if len(can.data) < 2:
        return Issue("foreign_can_frame", f"{len(can.data)} data bytes, expected a code and a checksum at least")
    return None
