"""What an emulated drive is: frames in, replies out, time as an argument.

    bytes -> receiver -> Drive.receive(frame, t_ns) -> behaviour (by verb) -> reply values -> bytes -> Outgoing

A drive does no I/O and reads no clock. Whoever owns it calls `receive` for each frame that the drive's receiver finds,
and `advance` to let time pass; both return what the drive sends, each with the time at which it is ready to be sent.
`next_ns` says when something will happen without any input (a completion reply), so that a virtual clock can jump there.

Commands to behaviour: a table from `Verb` to a function that takes the request's values (integers as sent, by field name)
and returns the reply's values, or None for silence. Layouts, lengths, ranges and reply forms come from the catalogue; no
behaviour packs or unpacks a byte.

Quirks and faults change a drive at named places, and nowhere else; see `Hooks`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import msgspec

from analyzer.catalogue import Command, Dialect
from analyzer.decoder import Slot
from analyzer.records import Frame, Message

if TYPE_CHECKING:
    from conformance.drives.motor import Motor

Values = dict[str, Any]


class Outgoing(msgspec.Struct, frozen=True, gc=False):
    """Bytes that a drive sends. `at_ns`: when they are ready; the bus decides when they are on the wire.

    On CAN `data` are the data bytes and `can_id` the identifier.
    """

    at_ns: int
    data: bytes
    can_id: int | None = None


@dataclass
class Hooks:
    """The places where a quirk or a fault can change a drive. Each is a list of functions, applied in order.

    `setup(drive)`: once, when the drive is made: parameters of the motor, limits, delays.
    `accept(drive, frame, message, wanted) -> bool`: whether the drive takes a frame as meant for it; `wanted` is what
    the manual says.
    `answer(drive, message, wanted) -> bool`: whether it answers a frame that it has taken; `wanted` as above.
    `slots(drive, slots, chosen) -> slots`: which of a package's slots it executes; `chosen` are those of the manual.
    `allow(drive, command, values, wanted) -> bool`: whether values are within the manual's ranges and choices.
    `request(drive, command, values) -> values`: the values of a request before the drive acts on them.
    `result(drive, command, request_values, reply_values) -> reply_values or None`: what it answers, before encoding.
    `reply(drive, command, outgoing) -> iterable of Outgoing`: the bytes it sends: changed, lost, doubled, late, more.
    `stored(drive, name, value) -> (name, value) or None`: what a setting becomes when it is stored.
    `powered(drive)`: after each power-up but the first.
    """

    setup: list[Callable[[Drive], None]] = field(default_factory=list)
    accept: list[Callable[[Drive, Frame, Message, bool], bool]] = field(default_factory=list)
    answer: list[Callable[[Drive, Message, bool], bool]] = field(default_factory=list)
    slots: list[Callable[[Drive, list[Slot], list[Slot]], list[Slot]]] = field(default_factory=list)
    allow: list[Callable[[Drive, Command, Values, bool], bool]] = field(default_factory=list)
    request: list[Callable[[Drive, Command, Values], Values]] = field(default_factory=list)
    result: list[Callable[[Drive, Command, Values, Values | None], Values | None]] = field(default_factory=list)
    reply: list[Callable[[Drive, Command, Outgoing], Iterable[Outgoing]]] = field(default_factory=list)
    stored: list[Callable[[Drive, str, int], tuple[str, int] | None]] = field(default_factory=list)
    powered: list[Callable[[Drive], None]] = field(default_factory=list)


@dataclass(frozen=True)
class Quirk:
    """One behaviour that a real drive was seen to have beside its manual. `source`: where it was seen."""

    name: str
    dialects: tuple[str, ...]
    text: str
    source: str
    install: Callable[[Hooks], None]


@dataclass(frozen=True)
class Fault:
    """One named defect that a good suite must refute. `breaks`: the theme of what it breaks, in a word or two."""

    name: str
    dialects: tuple[str, ...]
    text: str
    breaks: str
    install: Callable[[Hooks], None]


class Drive(ABC):
    """The base of all emulated drives: what does not depend on the dialect.

    `settings`: what is stored, by the setting command's field names, integers as sent (`work_mode`, `current`, ...).
    `seed` makes measured noise repeatable.
    """

    dialect: Dialect
    motor: Motor
    #: Other dialects whose frames it is given too: none, but for a quirk.
    hears: tuple[Dialect, ...] = ()

    def __init__(
        self,
        dialect: Dialect,
        address: int,
        *,
        model: str = "",
        settings: Mapping[str, int] | None = None,
        quirks: Iterable[Quirk] = (),
        faults: Iterable[Fault] = (),
        seed: int = 0,
    ) -> None:
        self.dialect = dialect.for_model(model) if model else dialect
        self.address = address
        self.model = model
        self.seed = seed
        self.now_ns = 0
        self.hooks = Hooks()
        self.settings: dict[str, int] = dict(settings or {})
        changes: list[Quirk | Fault] = [*quirks, *faults]
        for change in changes:
            change.install(self.hooks)

    @abstractmethod
    def receive(self, frame: Frame, t_ns: int) -> list[Outgoing]:
        """Take a frame that is complete at `t_ns`, also one that is damaged or not for this drive; return replies."""

    @abstractmethod
    def advance(self, t_ns: int) -> list[Outgoing]:
        """Let time pass until `t_ns`; return what the drive sends by itself (completion replies)."""

    @abstractmethod
    def next_ns(self) -> int | None:
        """Return when the drive will do something by itself, or None while nothing is under way."""

    @abstractmethod
    def power_cycle(self, t_ns: int) -> None:
        """Switch the drive off and on: what is in RAM is gone, what happens at power-on happens."""
