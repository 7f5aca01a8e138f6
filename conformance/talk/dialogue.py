"""A dialogue: one request through a gate, and what came back, decoded and paired as a listener would have it.

    talk = Dialogue(gate, dialects).ask(item, timeout_ns=200 * MS)
    talk.replies, talk.latency_ns, talk.outcome

Both directions go through the analyzer's own pipeline, so that `send`, `scan` and `replay` say what `show` would say of a
recording of them. A dialogue goes on: what was said before is known when a late reply comes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from msgspec.structs import replace

from analyzer.catalogue import Dialect, Role
from analyzer.pipeline import Entry, Options, Pipeline
from analyzer.records import CanFrame, Chunk, Comment, Finding, Junk
from analyzer.transactions import meaning_of
from conformance.gate.gate import Gate, Item

MS = 1_000_000
#: A pause after which what came is decoded as it stands.
_PAUSE_NS = 15 * MS


class Outcome(StrEnum):
    """How a request ended: answered for good, refused or gone wrong, begun and not ended, or without any answer."""

    DONE = "done"
    FAILED = "failed"
    RUNNING = "running"
    SILENT = "silent"


@dataclass
class Talk:
    """What was sent at one go, and what came back while it was listened for.

    `requests`: the frames in what was sent; `replies`: frames that answer one of them, in order; `others`: all other frames
    that came; `heard`: every byte that came (on CAN the data of the frames). `sent_ns`: when the last of it was on the wire.
    """

    item: Item | None
    sent_ns: int
    requests: list[Entry] = field(default_factory=list)
    replies: list[Entry] = field(default_factory=list)
    others: list[Entry] = field(default_factory=list)
    junk: list[Junk] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    heard: bytes = b""
    until_ns: int = 0

    @property
    def entries(self) -> list[Entry]:
        """All frames that came, in order."""
        return sorted([*self.replies, *self.others], key=lambda e: e.sequence)

    def meaning(self, entry: Entry) -> str:
        """Return what a reply means for its command: interim, final or failed."""
        if not entry.message.frame.checksum_ok or entry.message.form is None:
            return "failed"
        return meaning_of(entry.message, entry.message.command)[0]

    @property
    def outcome(self) -> Outcome:
        """How it ended."""
        if not self.replies:
            return Outcome.SILENT
        told = [self.meaning(e) for e in self.replies]
        if "failed" in told:
            return Outcome.FAILED
        return Outcome.DONE if "final" in told else Outcome.RUNNING

    def latency_ns(self, entry: Entry) -> int:
        """Return the time from the end of what was sent to the beginning of a frame, as well as that can be told."""
        return max(0, entry.message.frame.first_ns - self.sent_ns)


class _Heard:
    """A sink that sorts what comes out of the pipeline into the talk that is under way."""

    def __init__(self) -> None:
        self.talk = Talk(None, 0)
        self.own: list[range] = []
        self._asked: set[int] = set()

    def _is_own(self, offset: int) -> bool:
        return any(offset in span for span in self.own)

    def entry(self, entry: Entry) -> None:
        """Take a frame."""
        talk = self.talk
        if self._is_own(entry.message.frame.offset):
            self._asked.add(entry.sequence)
            talk.requests.append(entry)
        elif entry.request_sequence is not None and entry.request_sequence in self._asked:
            talk.replies.append(entry)
        else:
            talk.others.append(entry)

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        """Take bytes that are no frame."""
        if not self._is_own(junk.offset):
            self.talk.junk.append(junk)

    def finding(self, found: Finding) -> None:
        """Take a finding about what came."""
        if not self._is_own(found.offset):
            self.talk.findings.append(found)

    def comment(self, comment: Comment) -> None:
        """Do nothing: a line has no comments."""


class Dialogue:
    """Asks and listens on one line. `dialects`: what may be spoken there."""

    def __init__(self, gate: Gate, dialects: Sequence[Dialect], *, late_ns: int = 1000 * MS) -> None:
        self.gate = gate
        bus = gate.line.endpoint.bus_kind
        self.dialects = tuple(d for d in dialects if d.bus == bus)
        self._name = gate.line.endpoint.name
        self._heard = _Heard()
        self._pipeline = Pipeline(self.dialects, (self._heard,), Options(byte_ns=gate.line.byte_ns, late_ns=late_ns))

    def ask(self, item: Item, timeout_ns: int, *, whole: bool = False, done_ns: int = 0, quiet_ns: int = 0) -> Talk:
        """Send an item and listen: to its reply, or to the end of the time.

        `whole`: on until a reply that ends the command, for at most `done_ns` once it has begun. `quiet_ns`: on behind the
        last reply, for one more. Raises Refused, LineLost.
        """
        talk = self._begin(item, self.gate.send(item))
        return self._listen(talk, talk.sent_ns + timeout_ns, whole, done_ns, quiet_ns)

    def listen(self, duration_ns: int) -> Talk:
        """Send nothing and listen. Raises LineLost."""
        now_ns = self.gate.now_ns()
        talk = self._heard.talk = Talk(None, now_ns)
        return self._listen(talk, now_ns + duration_ns, True, 0, 0)

    def _begin(self, item: Item, sent_ns: int) -> Talk:
        talk = self._heard.talk = Talk(item, sent_ns)
        data = item.data if isinstance(item, CanFrame) else item
        port = self._pipeline.ports.get(self._name)
        start = port.bytes_in if port is not None else 0
        self._heard.own = [*self._heard.own[-3:], range(start, start + max(1, len(data)))]
        if isinstance(item, CanFrame):
            self._pipeline.feed(replace(item, t_ns=sent_ns, port=self._name, direction=Role.REQUEST))
        else:
            self._pipeline.feed(Chunk(sent_ns, self._name, item, Role.REQUEST, True))
        return talk

    def _listen(self, talk: Talk, deadline_ns: int, whole: bool, done_ns: int, quiet_ns: int) -> Talk:
        gate = self.gate
        pending = begun = ended = False
        while (left_ns := deadline_ns - gate.now_ns()) > 0:
            got = gate.receive(min(left_ns, _PAUSE_NS) if pending else left_ns)
            if got is not None:
                talk.heard += got.data
                self._pipeline.feed(replace(got, port=self._name))
                pending = True
            elif pending:
                self._pipeline.silence(self._name)
                pending = False
            if ended:
                continue
            if talk.outcome in (Outcome.DONE, Outcome.FAILED) or (talk.replies and not whole):
                if not quiet_ns:
                    break
                ended, deadline_ns = True, min(deadline_ns, gate.now_ns() + quiet_ns)
            elif talk.replies and done_ns and not begun:
                begun, deadline_ns = True, gate.now_ns() + done_ns
        self._pipeline.silence(self._name)
        talk.until_ns = gate.now_ns()
        return talk
