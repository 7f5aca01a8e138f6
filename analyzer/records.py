"""What flows through the pipeline: chunks, CAN frames and events in; frames and junk, messages, transactions, findings out.

All times are integer nanoseconds; the times of a capture without any are estimated from the line speed and marked as such
in the log's metadata. Records are immutable and hold no resources.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Any

import msgspec

from analyzer.catalogue import Command, Dialect, Form, Role
from analyzer.codec import Violation, codec
from analyzer.link import Head
from analyzer.values import identifier


class Severity(StrEnum):
    """How bad a finding is."""

    INFO = "info"
    WARNING = "warning"
    ERROR = "error"

    @property
    def rank(self) -> int:
        """1 for an info, 2 for a warning, 3 for an error."""
        return tuple(Severity).index(self) + 1


class JunkReason(StrEnum):
    """Why bytes belong to no frame."""

    NOISE = "noise"
    TRUNCATED = "truncated"
    COLLISION = "collision"
    LEFT_OUT = "left_out"


class Chunk(msgspec.Struct, frozen=True, gc=False):
    """Bytes of a serial line as the host got them.

    `t_ns`: arrival of the last byte, or None where the capture has no times. `direction`: who sent them where the
    capture says so, else `unknown`. `burst`: the capture itself delimits these bytes (a line of a log, a packet).
    `torn`: the reader says that some of them are missing, or of those right before.
    """

    t_ns: int | None
    port: str
    data: bytes
    direction: Role = Role.UNKNOWN
    burst: bool = False
    torn: bool = False


class CanFrame(msgspec.Struct, frozen=True, gc=False):
    """One frame of a CAN bus.

    `direction`: from the capture's Rx/Tx mark as seen by the host, else `unknown`.
    """

    t_ns: int | None
    port: str
    id: int
    data: bytes
    direction: Role = Role.UNKNOWN
    extended: bool = False
    remote: bool = False
    error: bool = False
    fd: bool = False


class Comment(msgspec.Struct, frozen=True, gc=False):
    """Text in a capture apart from its traffic: a comment, a marker. It is shown as text, never interpreted."""

    t_ns: int | None
    port: str
    text: str


class Silence(msgspec.Struct, frozen=True, gc=False):
    """A pause on a serial line that was watched: nothing more belongs to what came on the port up to `t_ns`."""

    t_ns: int
    port: str


class Event(msgspec.Struct, frozen=True, gc=False):
    """What happened to a recording apart from its traffic: a port was lost, bytes were dropped, a dialect was found.

    `port`: empty where it is about all of them. `name`: a row of `analyzer.events`, or a word that is not known there.
    `values`: numbers, texts and lists of texts; times of day as text, durations in seconds.
    """

    t_ns: int
    port: str
    name: str
    values: dict[str, Any] = {}


class Frame(msgspec.Struct, frozen=True, gc=False):
    """Bytes that are one frame of a dialect.

    `offset`: bytes of the port before it. `role`: from the head of the frame or the capture's direction, else `unknown`.
    """

    port: str
    first_ns: int
    last_ns: int
    offset: int
    data: bytes
    dialect: Dialect
    role: Role
    checksum_ok: bool
    can: CanFrame | None = None

    @property
    def head(self) -> Head:
        """Return what it says of itself, before any command is known."""
        return self.dialect.link.parse(self.data, None if self.can is None else self.can.id)


class Junk(msgspec.Struct, frozen=True, gc=False):
    """Bytes that belong to no frame, and why."""

    port: str
    first_ns: int
    last_ns: int
    offset: int
    data: bytes
    reason: JunkReason


class Message(msgspec.Struct, frozen=True, gc=False):
    """A frame decoded.

    `command` None: the code is not in the catalogue. `form` None: no form of the command fits. `data`: the command's own
    data, from which `values` are read when they are asked for.
    """

    frame: Frame
    role: Role
    address: int
    command: Command | None
    form: Form | None
    data: bytes
    violations: tuple[Violation, ...] = ()

    @property
    def values(self) -> dict[str, Any]:
        """Return the integers as sent, by field name; empty where no form fits."""
        return codec(self.form.layout).wire(self.data) if self.form is not None else {}

    @property
    def who(self) -> str:
        """Return the address as people read it: on CAN the identifier in hexadecimal; `all` for a package."""
        if self.command is not None and self.command.slots is not None:
            return "all"
        can = self.frame.can
        return str(self.address) if can is None else identifier(self.address, extended=can.extended)

    @property
    def what(self) -> str:
        """Return the name of its command; `unknown` with its code, as far as it has one; `foreign` for another node's frame."""
        if self.command is not None:
            return self.command.name
        if self.role is Role.FOREIGN:
            return Role.FOREIGN.value
        code = self.frame.head.code
        return "unknown" if code is None else f"unknown 0x{code:02X}"


class Lane:
    """What all frames of one head and length share: who, what, and how their data are read.

    Only frames whose bytes alone tell role, command and form have a lane. So only the data of each frame have to be read.
    The port that keeps the lane gives its `topic`.
    """

    __slots__ = (
        "_has_data",
        "address",
        "codec",
        "command",
        "dialect",
        "form",
        "is_request",
        "meanings",
        "plain",
        "role",
        "start",
        "states",
        "stop",
        "topic",
    )  # fmt: skip

    def __init__(self, dialect: Dialect, role: Role, address: int, command: Command, form: Form, start: int, stop: int) -> None:
        self.dialect = dialect.name
        self.role = role
        self.is_request = role is Role.REQUEST
        self.address = address
        self.command = command
        self.form = form
        self.codec = codec(form.layout)
        self._has_data = bool(form.layout.fields)
        self.start = start
        self.stop = stop
        #: Whether its data carry the state of the drive.
        self.states = role is Role.REPLY and any(f.state is not None for f in form.layout.fields)
        #: A request that one drive answers, if that was not changed by a setting.
        self.plain = bool(command.reply_forms) and address != dialect.broadcast
        #: Data of a status reply -> what it means, as far as seen.
        self.meanings: dict[bytes, str] = {}
        self.topic = ""

    def valid(self, own: bytes) -> bool:
        """Say whether the data of a frame are as the manual lists them."""
        return not self._has_data or self.codec.valid(own)

    def message(self, frame: Frame) -> Message:
        """Return the message of a frame of this lane whose data are valid."""
        data = frame.data[self.start : self.stop]
        return Message(frame, self.role, self.address, self.command, self.form, data)


class Finding(msgspec.Struct, frozen=True, gc=False):
    """Something that is wrong, or that one should know.

    `sequence`: number of the message it is about, 0 for none; `offset` leads to its bytes. `who`: the address for people.
    """

    rule: str
    severity: Severity
    port: str
    address: int | None
    first_ns: int
    last_ns: int
    text: str
    section: str = ""
    offset: int = 0
    topic: str = ""
    sequence: int = 0
    who: str = ""
