"""Replies without a checksum: read all the same where real drives were seen to send such.

    FB 01 31 00 00 00 00 10 00        the reply to 31 as firmware of an older model has it: all of it but its sum

One old firmware (quirk no-checksum) has no checksum in any reply. If nothing of it could be read, every claim would be
inconclusive; so the probe reads such a reply, and the claims about checksums and lengths alone say what they met.

Rules kept here:
- Only what lacks its checksum and nothing else is read: with the sum that fits, it is a whole reply of the dialect.
- Only drives of which no reply came with a checksum before the run judges (`Noise.checked`). Of others such a reply has lost
  some bytes, and its values are no values.
- Only dialects of which such drives are known; elsewhere a missing checksum stays what it is, bytes that are no frame.
- The bytes stay as they came: reports show them without the sum.
"""

from __future__ import annotations

from msgspec.structs import replace

from analyzer.catalogue import Dialect, Role, Trait
from analyzer.entries import Entry
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.records import Chunk, Comment, Finding, Junk, JunkReason
from conformance.talk.exchange import Exchange

_PORT = "bus"
#: Head, address and code.
_HEAD = 3


class _One:
    """A sink that keeps the frames."""

    def __init__(self) -> None:
        self.entries: list[Entry] = []

    def entry(self, entry: Entry) -> None:
        """Keep a frame."""
        self.entries.append(entry)

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        """Do nothing: this junk is known already."""

    def finding(self, found: Finding) -> None:
        """Do nothing: findings were made of the bytes as they came."""

    def comment(self, comment: Comment) -> None:
        """Do nothing: a line has no comments."""


class BareReplies:
    """Reads replies of a drive that sends no checksums. One for each probe, so that its pipeline is made once."""

    def __init__(self, dialect: Dialect) -> None:
        self._dialect = dialect
        self._sink = _One()
        self._pipeline: Pipeline | None = None
        #: The request that the pipeline was last shown.
        self._shown: Exchange | None = None
        #: When chunks came that were given their missing checksum.
        self._completed: set[int] = set()
        #: Whether the drive is known to send no checksums, and the replies that it can then send: code and length.
        self._met = False
        self._replies: frozenset[tuple[int, int]] = frozenset()

    def completed(self, chunk: Chunk) -> Chunk:
        """Return a chunk, with its checksum where it is a reply that lacks it.

        This is done only after a first reply without a checksum. Then the bytes need no second look, and two replies close
        together stay two.
        """
        data = chunk.data
        if not self._met or len(data) < _HEAD or (data[2], len(data) - _HEAD) not in self._replies:
            return chunk
        if chunk.t_ns is not None:
            self._completed.add(chunk.t_ns)
        return replace(chunk, data=self._dialect.link.completed(data, None))

    def of_junk(self, junk: Junk, exchange: Exchange) -> Entry | None:
        """Return the reply that a piece of junk is but for its checksum, None where it is not."""
        if Trait.SEEN_WITHOUT_CHECKSUM not in self._dialect.traits or junk.reason is not JunkReason.TRUNCATED:
            return None
        return self._read(junk.data, junk.first_ns, junk.last_ns, junk.offset, exchange)

    def of_entry(self, entry: Entry, exchange: Exchange) -> Entry | None:
        """Return a reply without its checksum as it came, None where a frame is no such reply.

        It was completed, or it is a frame of no known form, whose last byte only looks like a checksum.
        """
        message = entry.message
        if message.frame.last_ns in self._completed:
            return replace(entry, message=replace(message, frame=replace(message.frame, data=message.frame.data[:-1])))
        if (
            message.form is not None
            or message.role is not Role.REPLY
            or Trait.SEEN_WITHOUT_CHECKSUM not in self._dialect.traits
        ):
            return None
        frame = message.frame
        return self._read(frame.data, frame.first_ns, frame.last_ns, frame.offset, exchange)

    def _read(self, data: bytes, first_ns: int, last_ns: int, offset: int, exchange: Exchange) -> Entry | None:
        if self._pipeline is None:
            self._pipeline = Pipeline((self._dialect,), (self._sink,), Options())
        pipeline, sent = self._pipeline, exchange.sent
        if self._shown is not exchange and exchange.command is not None and isinstance(sent, bytes):
            # The request tells a stop's reply from that of its run.
            pipeline.feed(Chunk(exchange.sent_ns, _PORT, sent, Role.REQUEST, True))
            self._shown = exchange
        self._sink.entries = []
        whole = self._dialect.link.completed(data, None)
        pipeline.feed(Chunk(max(last_ns, exchange.sent_ns), _PORT, whole, Role.REPLY))
        pipeline.silence(_PORT)
        found = self._sink.entries
        if len(found) != 1:
            return None
        frame = found[0].message.frame
        if frame.data != whole or not frame.checksum_ok or found[0].message.form is None:
            return None
        # A status that the manual does not list is the rest of a reply that ran into another frame.
        if any(finding.rule == "unknown_choice" for finding in found[0].findings):
            return None
        self._learn()
        as_it_came = replace(frame, data=data, first_ns=first_ns, last_ns=last_ns, offset=offset)
        return replace(found[0], message=replace(found[0].message, frame=as_it_came))

    def _learn(self) -> None:
        if not self._met:
            self._met = True
            self._replies = frozenset(
                (c.code if f.code is None else f.code, f.layout.byte_length)
                for c in self._dialect.commands
                for f in c.reply_forms
            )
