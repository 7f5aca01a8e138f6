"""An exchange: what was sent, what came back, when, and what the analyzer makes of it.

The bytes of both directions go through the analyzer's own pipeline (`conformance.talk.dialogue`). So claims, `send`, `scan`
and `replay` see what `show` would say of a recording.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from msgspec.structs import replace

from analyzer.catalogue import Command, Role
from analyzer.decoder import physical, units_of
from analyzer.entries import Entry
from analyzer.records import CanFrame, Chunk, Finding, Junk, Message
from analyzer.transactions import meaning_of
from analyzer.values import fields_text

_BUS = "bus"


class Completion(StrEnum):
    """How far a request got: answered for good, refused or gone wrong, begun and not ended, or without any answer."""

    DONE = "done"
    FAILED = "failed"
    RUNNING = "running"
    SILENT = "silent"


@dataclass(frozen=True)
class Answer:
    """One frame that came back. `first_ns`, `last_ns`: on the line's clock; `latency_ns`: since the end of the request.

    `bare`: it came without its checksum, as was seen of old firmware (`conformance.talk.no_checksum`). `paired`: the analyzer
    took it for the reply to a request that was sent here.
    """

    entry: Entry
    latency_ns: int
    bare: bool = False
    paired: bool = False

    @property
    def message(self) -> Message:
        """The frame decoded."""
        return self.entry.message

    @property
    def command(self) -> Command | None:
        """The command it answers, None where its code is not in the catalogue."""
        return self.entry.message.command

    @property
    def values(self) -> Mapping[str, Any]:
        """Integers as sent, by field; empty where no layout fits."""
        return self.entry.message.values

    @property
    def data(self) -> bytes:
        """The whole frame; on CAN the data bytes."""
        return self.entry.message.frame.data

    @property
    def rules(self) -> tuple[str, ...]:
        """Rules of the analyzer that the frame breaks."""
        return tuple(f.rule for f in self.entry.findings)

    @property
    def last_ns(self) -> int:
        """When its last byte had come."""
        return self.entry.message.frame.last_ns

    @property
    def first_ns(self) -> int:
        """When it began on the wire, as far as that can be told."""
        return self.entry.message.frame.first_ns

    @property
    def is_whole(self) -> bool:
        """Whether it can be read: its layout and its checksum fit."""
        return self.message.form is not None and self.message.frame.checksum_ok and self.message.role is not Role.REQUEST

    @property
    def meaning(self) -> str:
        """What it means for its command: interim, final or failed."""
        message = self.entry.message
        if not message.frame.checksum_ok or message.form is None:
            return "failed"
        return meaning_of(message, message.command)[0]


@dataclass
class Exchange:
    """What was sent at one go and what came back until listening ended.

    `sent`: bytes or the CAN frame, None where only was listened. `sent_ns`: when its last bit was on the wire. `command`
    and `values` (integers as sent): what was asked, where it was built from a command. `requests`: the frames in what was
    sent; `answers`: all frames that came, but for `foreign`: those of CAN nodes that are no drives; `received`: every byte
    that came (on CAN the data of the frames of drives); `passed`: bytes of CAN frames that came and were not read. `until_ns`:
    how long was listened. `awaited`: a reply was waited for. `again`: the same request sent once more, where the line had
    damaged or lost something. `own_only`: a reply in the name of another address is no reply to this.
    """

    sent: bytes | CanFrame | None
    sent_ns: int
    command: Command | None = None
    address: int | None = None
    values: Mapping[str, Any] = field(default_factory=dict)
    answers: list[Answer] = field(default_factory=list)
    foreign: list[Message] = field(default_factory=list)
    junk: list[Junk] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    until_ns: int = 0
    requests: list[Entry] = field(default_factory=list)
    received: bytes = b""
    passed: int = 0
    awaited: bool = False
    again: Exchange | None = None
    own_only: bool = False

    @property
    def silent(self) -> bool:
        """Whether nothing at all came back."""
        return not self.answers and not self.junk

    @property
    def damaged(self) -> bool:
        """Whether something came that cannot be read: bytes that are no frame, or a frame whose checksum does not fit."""
        return bool(self.junk) or any(not a.message.frame.checksum_ok for a in self.answers)

    @property
    def unanswered(self) -> bool:
        """Whether nothing at all came back to a command whose reply was waited for."""
        return self.awaited and self.silent and self.command is not None and bool(self.command.reply_forms)

    @property
    def unread(self) -> int:
        """How many bytes came that cannot be read."""
        wrong = (a.data for a in self.answers if not a.message.frame.checksum_ok)
        return sum(len(j.data) for j in self.junk) + sum(map(len, wrong))

    @property
    def data(self) -> bytes:
        """What was sent: the bytes, on CAN the data bytes."""
        if isinstance(self.sent, CanFrame):
            return self.sent.data
        return self.sent or b""

    @property
    def reply(self) -> Answer | None:
        """The first answer of the asked command (or the first of all, where none was asked), or None."""
        own = [a for a in self.answers if self.may_be_own(a)]
        replies = [a for a in own if a.message.role is not Role.REQUEST]
        # The final reply of an earlier command may come first, or a frame of others with its code and a wrong checksum.
        asked = [a for a in replies if self.asked_for(a)]
        for answer in (*(a for a in asked if a.message.frame.checksum_ok), *asked):
            return answer
        for answer in replies:
            if self.command is None or answer.command is not None:
                return answer
        return own[0] if own else None

    def may_be_own(self, answer: Answer) -> bool:
        """Say whether an answer may be of the drive that was asked."""
        return not self.own_only or answer.message.address == self.address

    def asked_for(self, answer: Answer) -> bool:
        """Say whether an answer is to the asked command, rather than the final reply of an earlier one."""
        asked, got = self.command, answer.command
        return asked is not None and got is not None and got.name == asked.name and self.may_be_own(answer)

    def owns(self, answer: Answer) -> bool:
        """Say whether the analyzer pairs an answer with what was sent here, rather than with an earlier request."""
        return any(answer.entry.request_sequence == request.sequence for request in self.requests)

    @property
    def is_read(self) -> bool:
        """Whether a whole reply to the asked command is there."""
        answer = self.reply
        return answer is not None and self.asked_for(answer) and answer.is_whole

    @property
    def replies(self) -> list[Answer]:
        """Answers that the analyzer pairs with a request that was sent here, this one or an earlier one."""
        return [a for a in self.answers if a.paired]

    @property
    def others(self) -> list[Answer]:
        """All other frames that came."""
        return [a for a in self.answers if not a.paired]

    @property
    def completion(self) -> Completion:
        """How far the request got, by its replies."""
        meanings = [a.meaning for a in self.replies]
        if not meanings:
            return Completion.SILENT
        if "failed" in meanings:
            return Completion.FAILED
        return Completion.DONE if "final" in meanings else Completion.RUNNING

    def status(self, name: str = "status") -> list[int]:
        """Return the statuses that were answered, in order."""
        return [a.values[name] for a in self.answers if name in a.values]

    def lines(self) -> list[str]:
        """Return the exchange for people: one line a frame, hex and decoded, with times since the request's end."""
        result = []
        if self.sent is not None:
            what = "; ".join(said(entry.message) for entry in self.requests)
            if not what and self.command is not None:
                what = f"{self.command.name} {_shown(self.values)}".rstrip()
            result.append(f"  > {hex_of(self.sent)}   {what}".rstrip())
        parts: list[tuple[int, str]] = [(a.last_ns, _answer_line(a)) for a in self.answers]
        parts += [(j.last_ns, f"  ! {j.data.hex(' ').upper()}   {j.reason}") for j in self.junk]
        result += [text for _, text in sorted(parts, key=lambda part: part[0])]
        if not parts:
            result.append(f"  < nothing within {(self.until_ns - self.sent_ns) / 1e6:.0f} ms")
        result += [f"    {f.rule}: {f.text}" for f in self.findings]
        return result

    def records(self) -> list[Chunk | CanFrame]:
        """Return what went over the line, in order; what was sent has the direction of a request."""
        result: list[Chunk | CanFrame] = [] if self.sent is None else [sent_record(self.sent, self.sent_ns)]
        came: list[Chunk | CanFrame] = [_received_record(a) for a in self.answers]
        came += [Chunk(j.last_ns, _BUS, j.data, Role.REPLY) for j in self.junk]
        return result + sorted(came, key=lambda record: record.t_ns or 0)


def sent_record(item: bytes | CanFrame, t_ns: int, port: str = _BUS) -> Chunk | CanFrame:
    """Return what was sent as a record of the line."""
    if isinstance(item, CanFrame):
        return replace(item, t_ns=t_ns, port=port, direction=Role.REQUEST)
    return Chunk(t_ns, port, item, Role.REQUEST, True)


def _received_record(answer: Answer) -> Chunk | CanFrame:
    can = answer.message.frame.can
    if can is not None:
        return replace(can, t_ns=answer.last_ns, direction=Role.REPLY)
    return Chunk(answer.last_ns, _BUS, answer.data, Role.REPLY)


def hex_of(item: bytes | CanFrame) -> str:
    """Return what was sent as hex text; on CAN the identifier before `#`."""
    if isinstance(item, CanFrame):
        return f"{item.id:03X}#{item.data.hex(' ').upper()}"
    return item.hex(" ").upper()


def _shown(values: Mapping[str, Any]) -> str:
    return " ".join(f"{name}={value}" for name, value in values.items())


def said(message: Message) -> str:
    """Return what a frame says: its command, and its fields in their units."""
    name = message.command.name if message.command is not None else "unknown"
    return f"{name} {fields_text(physical(message), units_of(message))}".rstrip()


def _answer_line(answer: Answer) -> str:
    message = answer.message
    frame = message.frame
    data = hex_of(frame.can) if frame.can is not None else frame.data.hex(" ").upper()
    wrong = "  NO CHECKSUM" if answer.bare else "" if frame.checksum_ok else "  CHECKSUM WRONG"
    return f"  < {data}   +{answer.latency_ns / 1e6:.2f} ms  {said(message)}{wrong}".rstrip()
