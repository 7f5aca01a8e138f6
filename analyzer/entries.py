"""What comes out of the pipeline: entries, junk, findings, comments and events, and what a sink does to take them.

A sink takes all of it in order (`Sink`). It may also take frames that are in order in fewer steps: one at a time
(`PlainSink`), or many at once (`RunSink`), with no entry built. And it may take events (`EventSink`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, runtime_checkable

import msgspec

from analyzer.records import Comment, Event, Finding, Frame, Junk, Lane, Message

if TYPE_CHECKING:
    from analyzer.columns.plain import Plain


class Entry(msgspec.Struct, frozen=True, gc=False):
    """A message with its place in the log and in its exchange."""

    message: Message
    sequence: int
    topic: str
    findings: tuple[Finding, ...] = ()
    latency_ns: int | None = None
    request_sequence: int | None = None
    first_reply: bool = False


def plain_entry(lane: Lane, frame: Frame, sequence: int, latency_ns: int | None, request_sequence: int | None) -> Entry:
    """Return the entry of a frame that is in order, as `PlainSink.plain` takes it. A reply is then the first one."""
    return Entry(lane.message(frame), sequence, lane.topic, (), latency_ns, request_sequence, not lane.is_request)


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

    def plain(self, lane: Lane, frame: Frame, sequence: int, latency_ns: int | None, request_sequence: int | None) -> None:
        """Take a frame; a reply is its request's first and has that request's sequence."""


@runtime_checkable
class RunSink(Protocol):
    """A sink that takes many plain frames at once."""

    def begin(self, plain: Plain) -> None:
        """Take the next block; of its frames, only those of a run count."""

    def run(self, start: int, stop: int, sequence: int) -> None:
        """Take the plain exchanges in some rows of the block, whose first frame has the number `sequence`."""


@runtime_checkable
class EventSink(Protocol):
    """A sink that takes events, too; a finding about one follows."""

    def happened(self, event: Event, sequence: int) -> None:
        """Take an event."""
