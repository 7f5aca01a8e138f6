"""The pipeline: chunks, CAN frames and events in, entries, junk and findings out to the sinks.

    source -> framer -> decoder -> transactions -> findings -> sinks

One `Port` per bus holds its framer, context and transactions; the pipeline numbers what comes out (one count for the
whole log) and hands it on in order. It does no I/O: sinks do. Nothing is kept but the state of each port, so memory does
not grow with the input.

What comes out depends on what is fed alone, never on when: a recording that is decoded while it runs and its log that is
decoded again give the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from msgspec.structs import replace

from analyzer import events
from analyzer.catalogue import Dialect, Role
from analyzer.columns.block import ByteBlock, CanBlock, FrameBlock
from analyzer.context import Request
from analyzer.entries import Entry, EventSink, PlainSink, RunSink, Sink, plain_entry
from analyzer.errors import UsageError
from analyzer.findings import Issue, finding, of_junk, of_message
from analyzer.foreign import is_unlisted
from analyzer.framer import Framer
from analyzer.port import Options, Port, PortSetup, usual_setup
from analyzer.records import CanFrame, Chunk, Comment, Event, Finding, Frame, Junk, JunkReason, Lane, Message, Severity, Silence
from analyzer.transactions import Late
from analyzer.values import CAN_ID_LIMIT, counted

if TYPE_CHECKING:
    from analyzer.columns.codec import Integers
    from analyzer.columns.framing import Framing, Row
    from analyzer.columns.pairs import Pairing

#: What can be fed.
Item = Chunk | CanFrame | CanBlock | ByteBlock | Comment | Silence | Event

#: Data bits of a CAN frame besides its payload, for made-up times: standard frame with its gap.
CAN_OVERHEAD_BITS = 47
#: The rule that waits until it is known whether a drive was meant.
_UNLISTED = "unknown_command"


class Pipeline:
    """Decodes what it is fed and passes it to `sinks`.

    `dialects`: all that may be on the buses. `ports`: buses of which more is known. `on_setup`: asked what a bus is set up
    for when an event says how it is to be read; None where events say nothing. `others`: dialects of a bus of another kind, if
    one comes up.
    """

    def __init__(
        self,
        dialects: Sequence[Dialect],
        sinks: Sequence[Sink],
        options: Options | None = None,
        *,
        ports: Mapping[str, PortSetup] | None = None,
        on_setup: Callable[[Event], PortSetup | None] | None = None,
        others: Callable[[], Sequence[Dialect]] = tuple,
    ) -> None:
        self.dialects = tuple(dialects)
        self.sinks = tuple(sinks)
        self.options = options or Options()
        # A sink may take frames that are in order as they are, without an entry being built for it.
        self._plain_sinks = [s.plain for s in self.sinks if isinstance(s, PlainSink)]
        self._entry_sinks = [s for s in self.sinks if not isinstance(s, PlainSink)]
        #: All sinks, if each takes runs.
        self._run_sinks = [s for s in self.sinks if isinstance(s, RunSink)]
        if len(self._run_sinks) < len(self.sinks):
            self._run_sinks.clear()
        self._pairings: dict[str, Pairing] = {}
        self._framings: dict[str, Framing] = {}
        self._event_sinks = [s for s in self.sinks if isinstance(s, EventSink)]
        self._setups = dict(ports or {})
        self._on_setup = on_setup
        self._others = others
        self.ports: dict[str, Port] = {}
        self.sequence = 0
        #: Frames that were passed on by runs of a block.
        self.in_runs = 0

    @property
    def bytes_in(self) -> int:
        """Bytes that came in on all buses."""
        return sum(port.bytes_in - port.start for port in self.ports.values())

    def run(self, items: Iterable[Item]) -> None:
        """Feed all items, then close."""
        for item in items:
            self.feed(item)
        self.close()

    def feed(self, item: Item) -> None:
        """Take the next item of the source."""
        if isinstance(item, Chunk):
            self._feed_chunk(self._port(item), item)
        elif isinstance(item, CanFrame):
            self._feed_can(self._port(item), item)
        elif isinstance(item, Silence):
            self.silence(item.port)
        elif isinstance(item, CanBlock):
            self._feed_block(item)
        elif isinstance(item, ByteBlock):
            self._feed_bytes(self._port(item), item)
        elif isinstance(item, Event):
            self._feed_event(item)
        else:
            for sink in self.sinks:
                sink.comment(item)

    def _port(self, item: Chunk | CanFrame | ByteBlock) -> Port:
        """Return the port of an item, its bytes counted."""
        port = self.ports.get(item.port)
        if port is None:
            setup = self._setups.get(item.port) or usual_setup(self.dialects)
            kind = "can" if isinstance(item, CanFrame) else "serial"
            if all(d.bus != kind for d in setup.dialects):
                setup = usual_setup([d for d in self._others() if d.bus == kind] or self.dialects)
            port = self.ports[item.port] = Port(item.port, setup, self.options)
        port.bytes_in += len(item.data)
        return port

    def set_up(self, name: str, setup: PortSetup) -> None:
        """Say what a bus is to be read as from here on; what waits on it is decided first."""
        port = self.ports.get(name)
        if port is None or (port.bytes_in == port.start and setup.offset != port.start):
            self.ports[name] = Port(name, setup, self.options)
        elif port.setup.dialects != setup.dialects or port.setup.byte_ns != setup.byte_ns:
            self._take(port, port.change(setup))

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
            for request in port.nodes.withheld.values():
                self._unlisted(port, request)
            port.nodes.withheld.clear()

    def state(self) -> dict[str, Any]:
        """Return what was seen so far, for `restore`."""
        return {"sequence": self.sequence, "ports": {name: port.state() for name, port in self.ports.items()}}

    def restore(self, state: Mapping[str, Any], setups: Mapping[str, PortSetup]) -> None:
        """Go on where another pipeline stood, its buses set up as they were there."""
        self.sequence = state["sequence"]
        for name, each in state["ports"].items():
            port = self.ports[name] = Port(name, setups.get(name) or usual_setup(self.dialects), self.options)
            port.restore(each)

    # --- events ---------------------------------------------------------------------------------------------------

    def _feed_event(self, event: Event) -> None:
        if events.cuts(event):
            for name in (event.port,) if event.port else tuple(self.ports):
                self.silence(name)
        setup = self._on_setup(event) if event.name in events.SETUPS and self._on_setup is not None else None
        if setup is not None:
            self.set_up(event.port, setup)
        self.sequence += 1
        for taker in self._event_sinks:
            taker.happened(event, self.sequence)
        issue = events.issue_of(event)
        if issue is None:
            return
        first_ns, last_ns = events.span_ns(event)
        port = self.ports.get(event.port)
        found = finding(
            issue,
            port=event.port,
            first_ns=first_ns,
            last_ns=last_ns,
            offset=0 if port is None else port.bytes_in,
            topic=events.TOPIC,
            sequence=self.sequence,
        )
        for sink in self.sinks:
            sink.finding(found)

    # --- serial ---------------------------------------------------------------------------------------------------

    def _feed_chunk(self, port: Port, chunk: Chunk) -> None:
        if chunk.t_ns is None:
            port.clock_ns += len(chunk.data) * self.options.synthetic_byte_ns
            chunk = Chunk(port.clock_ns, chunk.port, chunk.data, chunk.direction, chunk.burst)
        self._take(port, self._framer(port).feed(chunk))

    def _framer(self, port: Port) -> Framer:
        if port.framer is None:
            raise UsageError(f"{port.name} is a serial line, and {self.dialects[0].name} is a CAN dialect")
        return port.framer

    def _feed_bytes(self, port: Port, block: ByteBlock) -> None:
        """Pass rows of frames on together, all else one by one."""
        from analyzer.columns.framing import Framing

        framer, framing = self._framer(port), self._framings.get(port.name)
        if framing is None or framing.framer is not framer:
            framing = self._framings[port.name] = Framing(framer, timed=self.options.timed)
        if block.t_ns is None:
            block.t_ns = port.clock_ns + block.stops * self.options.synthetic_byte_ns
            port.clock_ns = int(block.t_ns[-1])
        for event in framing.feed(block):
            if isinstance(event, Frame):
                self._frame(port, event)
            elif isinstance(event, Junk):
                self._junk(port, event)
            else:
                self._feed_row(port, block, event)

    def _feed_row(self, port: Port, block: ByteBlock, row: Row) -> None:
        """Pass plain exchanges of a row of frames on together, all other frames one by one."""
        from analyzer.columns.framing import SHORTEST_TOGETHER

        frames, first, _, decided = row

        def one_by_one(start: int, stop: int) -> None:
            own = frames.frames(self._framer(port).dialects[0], start, stop)
            for block.taken, frame in zip(decided[start - first : stop - first].tolist(), own, strict=True):
                self._frame(port, frame)

        if len(frames) < SHORTEST_TOGETHER:
            one_by_one(first, row.stop)
        else:
            self._feed_runs(port, frames, first, row.stop, frames.offsets, one_by_one)

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
        if not port.can:
            raise UsageError(f"{port.name} is a CAN bus, and {self.dialects[0].name} is a dialect of serial lines")
        dialect = port.can_dialect(can)
        shortest = dialect.link.shortest
        usual = not (can.error or can.fd or can.extended or can.remote) and can.id <= CAN_ID_LIMIT and len(can.data) >= shortest
        good = not usual or dialect.link.fits(can.data, can.id)
        described = port.describes(can)
        if described is not None:
            self._told(
                port,
                Frame(port.name, t_ns, t_ns, offset, can.data, described, can.direction, True, can),
                dialect,
                usual and good,
            )
            return
        frame = Frame(port.name, t_ns, t_ns, offset, can.data, dialect, can.direction, good, can)
        if not can.error and (can.extended or can.id not in port.nodes.drives) and not port.from_drive(frame, can, usual=usual):
            self._foreign(port, frame, can.id)
        elif usual:
            self._frame(port, frame)
        else:
            self._write(port, Message(frame, Role.UNKNOWN, can.id, None, None, can.data), [_unusual(can)])

    def _feed_block(self, block: CanBlock) -> None:
        """Pass plain exchanges on together, all other frames one by one."""

        def one_by_one(start: int, stop: int) -> None:
            for frame in block.frames(start, stop):
                self._feed_can(self._port(frame), frame)

        # The first frame of a bus opens it.
        at = 0 if block.port in self.ports else 1
        one_by_one(0, at)
        port = self.ports[block.port]
        if self.options.timed:
            offsets = port.bytes_in - int(block.sizes[:at].sum()) + block.sizes.cumsum() - block.sizes
            self._feed_runs(port, block, at, len(block), offsets, one_by_one)
        else:
            one_by_one(at, len(block))

    # --- by columns -----------------------------------------------------------------------------------------------

    def _feed_runs(
        self,
        port: Port,
        block: CanBlock | FrameBlock,
        at: int,
        end: int,
        offsets: Integers,
        one_by_one: Callable[[int, int], None],
    ) -> None:
        """Pass frames on from one row to another. `offsets`: of each row, the bytes of the bus before it."""
        from analyzer.columns.pairs import AFTER_REFUSAL, SHORTEST_RUN, Pairing

        dialect = Pairing.dialect_of(port, block) if self._run_sinks and len(block) >= SHORTEST_RUN else None
        if dialect is None:
            one_by_one(at, end)
            return
        pairing = self._pairings.get(port.name)
        if pairing is None or not pairing.is_of(port, dialect):
            pairing = self._pairings[port.name] = Pairing(port, dialect, self.options.late_ns)
        if pairing.block is not block:
            plain = pairing.look(block, offsets)
            if pairing.next_run(at, len(block))[0] < len(block):
                for sink in self._run_sinks:
                    sink.begin(plain)
        while at < end:
            start, stop = pairing.next_run(at, end)
            one_by_one(at, start)
            sequence = self.sequence + 1
            at = pairing.take(start, stop, sequence) if start < stop else stop
            if start < at:
                self.sequence += at - start
                self.in_runs += at - start
                if isinstance(block, CanBlock):
                    port.bytes_in += int(block.sizes[start:at].sum())
                for sink in self._run_sinks:
                    sink.run(start, at, sequence)
            if at < stop:
                refused = min(at + AFTER_REFUSAL, stop)
                one_by_one(at, refused)
                at = refused

    # --- what both share ------------------------------------------------------------------------------------------

    def _told(self, port: Port, frame: Frame, dialect: Dialect, good: bool) -> None:
        """Pass a message on that a file describes. `good`: its check fits as in the `dialect` of the drives."""
        can = frame.can
        assert can is not None  # only CAN frames are described by their identifier
        message = port.decoders[frame.dialect.name].decode(frame)[0]
        issues = of_message(message, port.context)
        drive = port.decoders[dialect.name].decode(replace(frame, dialect=dialect))[0] if good else None
        if port.nodes.claimed_twice(can.id, drive):
            text = f"{frame.dialect.title} describes it, and its frames check as {dialect.name}: read as {frame.dialect.name}"
            issues.append(Issue("foreign_can_frame", f"{text}; --ids 0x{can.id:X} reads it as a drive", Severity.INFO))
        self._write(port, message, issues)

    def _foreign(self, port: Port, frame: Frame, address: int) -> None:
        """Keep a frame of another node: it is for no drive and from none."""
        self._write(port, Message(frame, Role.FOREIGN, address, None, None, frame.data), ())

    def _frame(self, port: Port, frame: Frame) -> None:
        context = port.context
        if port.nodes.listed is not None and frame.can is None:
            address = frame.dialect.link.parse(frame.data).address
            if port.serves(address, frame.dialect) is False:
                self._foreign(port, frame, address)
                return
        decoder = port.decoders[frame.dialect.name]
        if frame.checksum_ok and not context.borrowed and not port.nodes.withheld:
            lane = decoder.lane(frame, context)
            if lane is not None and lane.valid(frame.data[lane.start : lane.stop]) and self._plain(port, lane, frame):
                return
        message, asked = decoder.decode(frame, context)
        # What was known before this message.
        heard = message.address in context.speaks or port.nodes.listed is not None
        topic = port.topic(message)
        paired = port.transactions.observe(message, self.sequence + 1, asked, topic)
        for late in paired.earlier:
            self._late(port, late)
        settled = port.nodes.settled(message, paired.request)
        if settled is not None:
            self._unlisted(port, settled)
        issues = [*of_message(message, context), *paired.issues]
        if is_unlisted(message) and port.nodes.excuses(message, None if heard else context.last_request):
            issues = [issue for issue in issues if issue.rule != _UNLISTED]
        asked_by = None if paired.request is None else paired.request.sequence
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
                # Read together with its request, a reply tells nothing of the time between them.
                latency_ns = frame.first_ns - request.t_ns
                if latency_ns <= 0:
                    latency_ns = None
        self.sequence = sequence
        for plain in self._plain_sinks:
            plain(lane, frame, sequence, latency_ns, asked_by)
        if self._entry_sinks:
            entry = plain_entry(lane, frame, sequence, latency_ns, asked_by)
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
        frame = message.frame
        if frame.dialect.link.left_out:
            # What its link said of it counts no more.
            junk = Junk(frame.port, frame.first_ns, frame.last_ns, frame.offset, frame.data, JunkReason.LEFT_OUT)
            if frame.can is None:
                self._junk(port, junk)
                return
            message = Message(frame, Role.UNKNOWN, frame.can.id, None, None, frame.data)
            issues, topic = [of_junk(junk)], ""
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
            who=message.who,
        )

    def _unlisted(self, port: Port, request: Request) -> None:
        """Tell, after all, that a request stands in no manual: no other slave answered it."""
        for violation in request.message.violations:
            if violation.rule == _UNLISTED:
                self._late(port, Late(request, Issue(violation.rule, violation.text)))

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
            first_ns=junk.first_ns,
            last_ns=junk.last_ns,
            offset=junk.offset,
            topic=topic,
            sequence=self.sequence,
        )
        for sink in self.sinks:
            sink.junk(junk, self.sequence, topic)
            sink.finding(found)


def _unusual(can: CanFrame) -> Issue:
    """Return what is wrong with a CAN frame of a drive's identifier that is of no dialect."""
    if can.error:
        return Issue("can_error_frame", f"error frame, class 0x{can.id:X}, data {can.data.hex(' ').upper() or 'none'}")
    if can.fd:
        return Issue("foreign_can_frame", "a CAN FD frame, expected CAN 2.0A")
    if can.remote:
        return Issue("foreign_can_frame", "a remote frame, expected a data frame")
    return Issue("foreign_can_frame", f"{counted(len(can.data), 'data byte')}, expected a code and a checksum at least")
