"""The engine of exchanges: sends through a gate, listens, and sorts what comes as the analyzer reads it.

    exchange = Dialogue(gate, dialects).ask(item, 200 * MS)
    exchange.replies, exchange.others, exchange.junk, exchange.completion

Claims (by a probe), `send`, `scan`, `replay` and what stops a drive or puts its settings back all talk by it. Both directions
go through one pipeline of the analyzer. It goes on from exchange to exchange, so a late reply is known for what it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from enum import Enum

from msgspec.structs import replace

from analyzer.catalogue import Dialect, Role
from analyzer.encoder import Built
from analyzer.entries import Entry
from analyzer.errors import PluginError
from analyzer.pipeline import Pipeline
from analyzer.port import Options, usual_setup
from analyzer.records import CanFrame, Chunk, Comment, Finding, Junk, Message
from conformance.gate.gate import Gate, Item
from conformance.talk.exchange import Answer, Exchange, sent_record
from conformance.talk.no_checksum import BareReplies

MS = 1_000_000
#: A pause after which what came is decoded as it stands, although more might have belonged to it.
PAUSE_NS = 15 * MS
#: The pause where whole frames have come and nothing else: what is longer than its frame comes on without one.
_WHOLE_PAUSE_NS = 2 * MS
#: Bytes of the longest frame; what goes on beyond it is no frame.
_LONGEST_FRAME = 64
#: So long after a deadline, this process stood still: a machine that is free wakes it within that.
_STOOD_STILL_NS = 5 * MS
#: Read at the most behind a deadline: pieces, and bytes, unless the line can have brought more since the request. Others may
#: send without end, and a server on a network is faster than a line.
_MOST_WAITING, _MOST_WAITING_BYTES = 256, 4096
#: Requests whose replies are still known for theirs.
_OPEN_REQUESTS = 256
#: Spans of the bus that were sent here: what is decoded late may lie in an earlier one.
_OWN_SPANS = 4


class Until(Enum):
    """How long to listen: to the first reply, to a whole one to what was asked, to one that ends it, or to the time-out."""

    REPLY = "reply"
    READ = "read"
    DONE = "done"
    TIMEOUT = "timeout"


#: Says whether the wait is over. It is given only the new answers, for others may send without end.
Ended = Callable[[Exchange, Sequence[Answer]], bool]

#: Each wait and its end, where a reply must pair with a request.
PAIRED: Mapping[Until, Ended] = {
    Until.REPLY: lambda exchange, new: any(a.paired for a in new),
    Until.READ: lambda exchange, new: any(exchange.asked_for(a) and a.is_whole for a in new),
    Until.DONE: lambda exchange, new: any(a.paired and a.meaning in ("failed", "final") for a in new),
    Until.TIMEOUT: lambda exchange, new: False,
}


class _Sorter:
    """A sink that keeps what came since it was last emptied, without what was sent here."""

    def __init__(self) -> None:
        self.entries: list[Entry] = []
        self.junk_pieces: list[Junk] = []
        self.findings: list[Finding] = []
        #: Frames of other nodes.
        self.foreign: list[Message] = []
        self.own: list[tuple[range, Exchange]] = []
        #: What a CAN frame is sent in, while it is decoded: it may have no data, and so no place in the stream of bytes.
        self.sending: Exchange | None = None
        #: Sequences of requests that were sent here, the oldest first.
        self.asked: dict[int, None] = {}

    def sends(self, offset: int, size: int, exchange: Exchange) -> None:
        """Take it that the bytes from `offset` on are what an exchange sends."""
        self.own = [*self.own[1 - _OWN_SPANS :], (range(offset, offset + size), exchange)]

    def _owner(self, offset: int) -> Exchange | None:
        return self.sending or next((exchange for span, exchange in self.own if offset in span), None)

    def entry(self, entry: Entry) -> None:
        """Keep a frame."""
        owner = self._owner(entry.message.frame.offset)
        if owner is None and entry.message.role is Role.FOREIGN:
            self.foreign.append(entry.message)
        elif owner is None:
            self.entries.append(entry)
        if owner is None:
            return
        owner.requests.append(entry)
        self.asked[entry.sequence] = None
        if len(self.asked) > _OPEN_REQUESTS:
            del self.asked[next(iter(self.asked))]

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        """Keep bytes that are no frame."""
        if self._owner(junk.offset) is None:
            self.junk_pieces.append(junk)

    def finding(self, found: Finding) -> None:
        """Keep a finding about what came."""
        if self._owner(found.offset) is None and found.sequence not in self.asked:
            self.findings.append(found)

    def comment(self, comment: Comment) -> None:
        """Do nothing: a line has no comments."""


class Dialogue:
    """Sends and listens on one line.

    `dialects`: what may be spoken there. `direction`: of what comes, None: as the line says. `bare`: reads replies that lack
    their checksum. `log`: called for each record that leaves or comes. `stray`: bytes of the line that come before each reply
    and are no part of it. `repeats`: how many of the last bytes of each reply come once more.
    """

    def __init__(
        self,
        gate: Gate,
        dialects: Sequence[Dialect],
        *,
        late_ns: int = 1000 * MS,
        pause_ns: int = PAUSE_NS,
        direction: Role | None = None,
        bare: BareReplies | None = None,
        log: Callable[[Chunk | CanFrame], None] | None = None,
        stray: bytes = b"",
        repeats: int = 0,
    ) -> None:
        self.gate = gate
        line = gate.line
        self.dialects = tuple(d for d in dialects if d.bus == line.endpoint.bus_kind)
        self._name = line.endpoint.name
        self._pause_ns = pause_ns
        self._direction = direction
        self._bare = bare
        self._log = log
        self._stray = stray
        self._repeats = repeats
        #: A chunk that may be a byte of the line or the end of a reply, until the next one tells.
        self._held: Chunk | None = None
        self._sorter = _Sorter()
        self._pipeline = Pipeline(self.dialects, (self._sorter,), Options(byte_ns=line.byte_ns, late_ns=late_ns))
        self._pipeline.set_up(self._name, usual_setup(self.dialects))
        self._exchange = Exchange(None, 0)
        self._passed = 0
        self._pending = False

    # --- one request ----------------------------------------------------------------------------------------------

    def ask(self, item: Item, timeout_ns: int, *, until: Until = Until.REPLY, done_ns: int = 0, quiet_ns: int = 0) -> Exchange:
        """Send an item and listen for what the analyzer pairs with it.

        `done_ns`: how long to listen once the command has begun, in place of the time-out. `quiet_ns`: how long to listen for
        more behind what was waited for. Raises Refused, LineLost.
        """
        return self.collect(self.send(item), PAIRED[until], timeout_ns, done_ns=done_ns, quiet_ns=quiet_ns)

    def listen(self, duration_ns: int) -> Exchange:
        """Send nothing and listen. Raises LineLost."""
        return self.collect(self.begin(Exchange(None, self.gate.now_ns())), PAIRED[Until.TIMEOUT], duration_ns)

    # --- its parts ------------------------------------------------------------------------------------------------

    def send(self, item: Item, built: Built | None = None, *, shown: bool = True) -> Exchange:
        """Send an item and begin its exchange. `shown` False: the analyzer does not see it. Raises Refused, LineLost."""
        exchange = Exchange(item, self.gate.send(item))
        if built is not None:
            exchange.command, exchange.address, exchange.values = built.command, built.address, dict(built.values)
        record = sent_record(item, exchange.sent_ns, self._name)
        if self._log is not None:
            self._log(record)
        if shown:
            port = self._pipeline.ports[self._name]
            self._sorter.sends(port.bytes_in, len(record.data), exchange)
            if isinstance(record, CanFrame) and not record.extended:
                # The suite speaks to drives only, so this identifier is a drive's.
                port.nodes.drives.add(record.id)
            self._sorter.sending = exchange if isinstance(record, CanFrame) else None
            self._pipeline.feed(record)
            self._sorter.sending = None
        return self.begin(exchange)

    def begin(self, exchange: Exchange) -> Exchange:
        """Let what comes from now on be a part of an exchange."""
        self._exchange, self._passed = exchange, self.gate.line.passed
        self._take()
        return exchange

    def collect(
        self,
        exchange: Exchange,
        ended: Ended,
        timeout_ns: int,
        *,
        quiet_ns: int = 0,
        done_ns: int = 0,
        wrecked: Callable[[Exchange], int] | None = None,
    ) -> Exchange:
        """Listen until an exchange has ended, then for `quiet_ns`; at most for the time-out. Raises LineLost.

        `wrecked`: says for how long nothing must come behind what cannot be read, so that no reply will; 0: one still may.
        A frame that has begun before the time-out is read to its end.
        """
        gate = self.gate
        deadline_ns = latest_ns = exchange.sent_ns + timeout_ns
        over = begun = False
        seen = unread = 0
        while gate.now_ns() < deadline_ns:
            self.receive(deadline_ns)
            if over:
                continue
            new, seen = exchange.answers[seen:], len(exchange.answers)
            if ended(exchange, new):
                over, deadline_ns = True, min(deadline_ns, gate.now_ns() + quiet_ns)
            elif done_ns and not begun and any(a.paired for a in new):
                begun, deadline_ns = True, gate.now_ns() + done_ns
            elif wrecked is not None and exchange.unread > unread:
                unread, on_ns = exchange.unread, wrecked(exchange)
                deadline_ns = min(latest_ns, gate.now_ns() + on_ns) if on_ns else latest_ns
        if gate.now_ns() - deadline_ns > _STOOD_STILL_NS:
            self.read_waiting()
        # A frame that has begun belongs to this exchange to its end, or to the pause that ends it.
        until_ns = gate.now_ns() + _LONGEST_FRAME * gate.line.byte_ns + 2 * self._pause_ns
        while self._half_way and gate.now_ns() < until_ns:
            self.receive(until_ns)
        return self.finish()

    def read_waiting(self) -> None:
        """Take into the exchange what has come already. Raises LineLost.

        A busy machine can let this process stand still until after a deadline, and what came meanwhile came in time.
        """
        byte_ns = self.gate.line.byte_ns
        brought = (self.gate.now_ns() - self._exchange.sent_ns) // byte_ns if byte_ns else 0
        most = max(_MOST_WAITING_BYTES, brought)
        waited = 0
        for _ in range(_MOST_WAITING):
            got = self.receive(self.gate.now_ns())
            if got is None or waited > most:
                return
            waited += len(got.data)

    def receive(self, until_ns: int) -> Chunk | CanFrame | None:
        """Take what comes next into the exchange; None after a pause, or when the time is over. Raises LineLost."""
        left_ns = max(0, until_ns - self.gate.now_ns())
        pause_ns = self._longest_pause_ns if self._pending else left_ns
        got = self.gate.receive(min(left_ns, pause_ns))
        if got is not None:
            self._feed(got)
            self._pending = True
        elif self._pending and pause_ns <= left_ns:
            self._silence()
            self._pending = False
        self._take()
        return got

    @property
    def _half_way(self) -> bool:
        """Whether a frame has begun to come, and is not whole."""
        framer = self._pipeline.ports[self._name].framer
        return self._pending and framer is not None and not framer.between

    @property
    def _longest_pause_ns(self) -> int:
        """How long a pause may be before what came is decoded as it stands."""
        framer = self._pipeline.ports[self._name].framer
        return min(self._pause_ns, _WHOLE_PAUSE_NS) if framer is not None and framer.between else self._pause_ns

    def finish(self) -> Exchange:
        """Decode what came as it stands, and end the exchange. Raises PluginError for a dialect that is left out."""
        self._silence()
        self._pending = False
        self._take()
        for link in (dialect.link for dialect in self.dialects if dialect.link.left_out):
            # What a drive sent is not known: it is no silence, and says nothing of the drive.
            raise PluginError(f"a dialect of this line cannot be read: {link.left_out}")
        self._exchange.until_ns = self.gate.now_ns()
        self._exchange.passed = self.gate.line.passed - self._passed
        return self._exchange

    # --- what comes -----------------------------------------------------------------------------------------------

    def _feed(self, got: Chunk | CanFrame) -> None:
        if self._log is not None:
            self._log(got)
        if self._stray and isinstance(got, Chunk):
            got = self._without_stray(got)
        if self._repeats and isinstance(got, Chunk):
            got = self._without_repeated(got)
        self._take_in(got)

    def _take_in(self, got: Chunk | CanFrame) -> None:
        direction = got.direction if self._direction is None else self._direction
        if isinstance(got, CanFrame):
            known = len(self._sorter.foreign)
            self._pipeline.feed(replace(got, port=self._name, direction=direction))
            if len(self._sorter.foreign) == known:
                self._exchange.received += got.data
            return
        self._exchange.received += got.data
        chunk = replace(got, port=self._name, direction=direction)
        self._pipeline.feed(chunk if self._bare is None else self._bare.completed(chunk))

    def _without_stray(self, got: Chunk) -> Chunk:
        """Return what comes without what the line shows before a reply: where one begins, and behind a whole one."""
        data, rest, held = got.data, got.data.removeprefix(self._stray), self._held
        begin = self._exchange.received[:1]
        self._held = None
        if not self._pending:
            data = rest
        elif self._half_way:
            # It goes on with a frame, even if its bytes look like a new one: that can begin only behind a whole one.
            pass
        elif data == self._stray and held is None:
            self._held, data = got, b""
        elif held is not None and data[:1] != begin:
            data = held.data + (rest if rest[:1] == begin else data)
        elif rest[:1] == begin:
            data = rest
        return replace(got, data=data)

    def _without_repeated(self, got: Chunk) -> Chunk:
        """Return a whole reply that comes at one go without its end once more."""
        data = got.data[: -self._repeats]
        for dialect in self.dialects if data.endswith(got.data[-self._repeats :]) else ():
            checks = dialect.link.checks(data, None)
            if checks and all(check.ok for check in checks):
                return replace(got, data=data)
        return got

    def _silence(self) -> None:
        """Decode what came as it stands: nothing more belongs to it."""
        held, self._held = self._held, None
        if held is not None:
            self._take_in(held)
        self._pipeline.silence(self._name)

    def _take(self) -> None:
        exchange, sorter, bare = self._exchange, self._sorter, self._bare
        for entry in sorter.entries:
            whole = None if bare is None else bare.of_entry(entry, exchange)
            latency_ns = max(0, entry.message.frame.first_ns - exchange.sent_ns)
            paired = entry.request_sequence in sorter.asked
            exchange.answers.append(Answer(whole or entry, latency_ns, whole is not None, paired))
        for junk in sorter.junk_pieces:
            if junk.data == self._stray or (self._repeats and self._is_repeated(junk)):
                sorter.findings = [f for f in sorter.findings if f.offset != junk.offset]
                continue
            whole = None if bare is None else bare.of_junk(junk, exchange)
            if whole is None:
                exchange.junk.append(junk)
            else:
                exchange.answers.append(Answer(whole, max(0, junk.first_ns - exchange.sent_ns), True))
        exchange.findings += sorter.findings
        exchange.foreign += sorter.foreign
        sorter.entries, sorter.junk_pieces, sorter.findings, sorter.foreign = [], [], [], []

    def _is_repeated(self, junk: Junk) -> bool:
        """Say whether junk is the end of a reply once more; then it is taken out of what was received."""
        exchange = self._exchange
        for answer in exchange.answers:
            frame = answer.message.frame
            if junk.offset == frame.offset + len(frame.data) and junk.data == frame.data[-self._repeats :]:
                exchange.received = exchange.received.replace(frame.data + junk.data, frame.data, 1)
                return True
        return False
