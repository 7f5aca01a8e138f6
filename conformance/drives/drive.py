"""The base of every emulated drive: one path for all requests, with time as an argument.

    frame -> accepted? -> addressed? -> request -> allowed? -> behaviour -> reply values -> reply -> Outgoing
             Responder.read, .understands          Drive.obey              Responder.reply

A drive does no I/O and reads no clock. Its owner calls `receive` for each frame that the drive's receiver finds, and
`advance` to let time pass. Both return what the drive sends, each with the time at which it is ready to be sent.
`next_ns` says when the drive will act without any input, so that a virtual clock can jump there.

Behaviours take the values of a request (integers as sent, by field name) and return the values of its reply, or None for
silence. Layouts, lengths, ranges and reply forms come from the catalogue; no behaviour packs or unpacks a byte.

Rules kept here:
- Silence: a bad checksum, another address, an unknown code or length, a drive that is off or starting.
- Broadcasts, groups and packages are executed and not answered. Of the slots of a package for one address only the first
  counts.
- A request whose values the manual does not allow is refused and changes nothing.
- Replies are ready `reply_delay_ns` after the request. They carry the address that the drive had when it was asked.
- Everything happens at its exact time (the next whole ns), in whatever steps the owner lets time pass.
- A drive reckons in the time of its own clock (`now_ns`), and its owner in that of the line: `clock_ppm` lies between them.

Quirks and faults change a drive through its `Hooks`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol, TypedDict

import msgspec

from analyzer.catalogue import Command, Dialect, Form, Replies, Risk, Role
from analyzer.codec import Violation, codec
from analyzer.decoder import Decoder, Slot, slots_of
from analyzer.layout import Effect, Field, FieldKind
from analyzer.records import Frame, Message

Values = dict[str, Any]

#: The speed of a drive whose setting stands for none, and the lowest that a setting can hold as a number.
_ANY_SPEED, _LOWEST_SPEED = 115_200, 300
_MILLION = 1_000_000
#: A frame has a code and a check at least.
_SHORTEST = 2


class Outgoing(msgspec.Struct, frozen=True, gc=False):
    """Bytes that a drive sends. `at_ns`: when they are ready; the bus decides when they are on the wire.

    On CAN `data` are the data bytes and `can_id` the identifier.
    """

    at_ns: int
    data: bytes
    can_id: int | None = None


# --- what changes a drive -----------------------------------------------------------------------------------------------


@dataclass
class Hooks:
    """Functions by which quirks and faults change a drive. Each list is applied in order.

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


class Change(Protocol):
    """What changes a drive through its hooks: a quirk, a fault, realism."""

    def install(self, hooks: Hooks, /) -> None:
        """Add its functions."""


class Rest(NamedTuple):
    """How the shaft comes to rest. `at_ns`: when; `since_ns`: for how long, negative before; `way`: the sign of its turning.

    `rpm`: its speed.
    """

    at_ns: float
    since_ns: float
    way: int
    rpm: float = 0.0


class Options(TypedDict, total=False):
    """What all drives can be made with.

    `settings`: what is stored at first, by the setting command's field names, integers as sent; they replace the defaults.
    `realism`: what makes it real, behind all else. `seed` makes chance repeatable.
    """

    settings: Mapping[str, int] | None
    quirks: Iterable[Quirk]
    faults: Iterable[Fault]
    realism: Change | None
    seed: int


# --- requests and replies -------------------------------------------------------------------------------------------------


@dataclass(eq=False, slots=True)
class Request:
    """A command that a drive was given. `values`: integers as sent; `broken`: what in them the manual does not allow.

    `answered`: whether it may be answered at all. `reply_ns`: when its first reply is ready.
    """

    responder: Responder
    command: Command
    form: Form
    values: Values
    broken: tuple[Violation, ...]
    answered: bool
    reply_ns: int = 0

    @property
    def physical(self) -> dict[str, float]:
        """The values in the units of their fields."""
        fields = self.form.layout.named
        return {name: fields[name].physical(value) for name, value in self.values.items() if name in fields}


class Responder:
    """Reads the requests of one dialect, as one model has it, and puts replies into its frames."""

    def __init__(self, dialect: Dialect) -> None:
        self.dialect = dialect
        self._decoder = _decoder(dialect)

    def read(self, frame: Frame) -> Message:
        """Return the message of a frame. Where its head does not say who sent it, it is a request."""
        asked = frame if frame.role is Role.REQUEST else msgspec.structs.replace(frame, role=Role.REQUEST)
        return self._decoder.decode(asked)[0]

    def understands(self, message: Message) -> bool:
        """Say whether a message is a request that the drive knows, of the length that it has."""
        command = message.command
        if message.role is not Role.REQUEST or command is None or message.form is None:
            return False
        return command.slots is None or len(message.data) == command.slots.count * command.slots.size

    def refusal(self, message: Message, address: int) -> tuple[Command, bytes] | None:
        """Return what answers a request that no command of the catalogue fits, None where a command does."""
        return None

    def meanings(self, command: Command) -> Replies:
        """Return the meanings of the statuses by which a drive's behaviours answer a command."""
        return command.replies

    def request(self, message: Message | Slot, answered: bool) -> Request | None:
        """Return what a message tells the drive to do, or None where no request of the catalogue fits."""
        command, form = message.command, message.form
        if isinstance(message, Message) and message.role is not Role.REQUEST:
            command, form = self._as_request(message)
        if command is None or form is None or command.verb not in self.dialect.by_verb:
            return None
        coder = codec(form.layout)
        return Request(self, command, form, coder.wire(message.data), coder.broken(message.data), answered)

    def _as_request(self, message: Message) -> tuple[Command, Form] | tuple[None, None]:
        """Return the request that the data of a reply would be."""
        frame = message.frame
        head = self.dialect.link.parse(frame.data, frame.can.id if frame.can else None)
        for command in self.dialect.by_code.get(-1 if head.code is None else head.code, ()):
            for form in command.request_forms:
                if command.slots is None and codec(form.layout).matches(message.data):
                    return command, form
        return None, None

    def reply(self, request: Request, values: Values, address: int) -> bytes:
        """Return the bytes that answer a request."""
        form = self.form(request, values)
        return self.dialect.link.build(request.command, form, address, encoded(form, values), Role.REPLY)

    def form(self, request: Request, values: Values) -> Form:
        """Return the first form of a reply whose fields all have a value."""
        for form in request.command.reply_forms:
            if form.layout.named.keys() <= values.keys() and (
                form.request_values is None or form.request_values.items() <= request.values.items()
            ):
                return form
        raise LookupError(f"{request.command.name}: no form of its reply has {', '.join(values) or 'nothing'}")


def _decoder(dialect: Dialect) -> Decoder:
    """Return the decoder of a dialect; made once, and kept with it."""
    kept: Decoder | None = dialect.__dict__.get("_decoder")
    if kept is None:
        kept = dialect.__dict__["_decoder"] = Decoder(dialect)
    return kept


def encoded(form: Form, values: Mapping[str, Any]) -> bytes:
    """Return the data of a form. A value that is too large is wrapped to the bits of its field, as a counter is."""
    coder, fields = codec(form.layout), form.layout.named
    known = {name: values[name] for name in fields if name in values}
    try:
        return coder.encode(known)
    except ValueError:
        return coder.encode({name: _wrapped(fields[name], value) for name, value in known.items()})


def _wrapped(field: Field, value: int | bytes) -> int | bytes:
    if isinstance(value, bytes) or field.kind is FieldKind.BYTES:
        return value
    return (value - field.wire_minimum) % (1 << field.bit_width) + field.wire_minimum


# --- drives -----------------------------------------------------------------------------------------------------------


class Drive(ABC):
    """One drive. `responders`: its dialects; it speaks the first one unless a setting says otherwise."""

    #: Other dialects whose frames the drive is given too: none, but for a quirk.
    hears: tuple[Dialect, ...] = ()

    def __init__(
        self,
        responders: Sequence[Responder],
        address: int,
        *,
        settings: Mapping[str, int] | None = None,
        quirks: Iterable[Quirk] = (),
        faults: Iterable[Fault] = (),
        realism: Change | None = None,
        seed: int = 0,
    ) -> None:
        self.responders = tuple(responders)
        self.dialect = responders[0].dialect
        self.model = self.dialect.model
        self.address = address
        self.settings: dict[str, int] = dict(settings or {})
        self.seed = seed
        self.now_ns = 0
        #: By how many parts of a million its clock is faster than the line's.
        self.clock_ppm = 0
        self.reply_delay_ns = 1_000_000
        self.hooks = Hooks()
        changes: list[Change | None] = [*quirks, *faults, realism]
        for change in changes:
            if change is not None:
                change.install(self.hooks)
        #: The names of the settings that hold the speed of the link and the group that the drive is in. A drive whose speed
        #: no command sets is given it in bits per second.
        self.speed_setting = self._named(Effect.BAUD_RATE) or "baud_rate"
        self.group_setting = self._named(Effect.GROUP)
        self._outbox: list[Outgoing] = []
        self._due: tuple[int, Callable[[], None]] | None = None
        self._stale = True

    def _named(self, effect: Effect) -> str:
        """Return the name of the setting that has an effect, in any dialect of the drive; empty where there is none."""
        found = (responder.dialect.effect(effect) for responder in self.responders)
        return next((declared.name for _, declared in filter(None, found)), "")

    @property
    def responder(self) -> Responder:
        """The responder of the dialect that the drive speaks now."""
        return self.responders[0]

    @property
    def speed(self) -> int:
        """The bits per second at which the drive listens and sends; its dialect's default where no setting says."""
        value = self.settings.get(self.speed_setting)
        if value is None:
            return self.dialect.baud_rates[0] if self.dialect.baud_rates else _ANY_SPEED
        return self.dialect.rates.get(value) or (value if value >= _LOWEST_SPEED else _ANY_SPEED)

    # --- a frame --------------------------------------------------------------------------------------------------

    def receive(self, frame: Frame, t_ns: int) -> list[Outgoing]:
        """Take a frame that is complete at `t_ns`, also one that is damaged or not for this drive; return replies."""
        self._pass(self._own(t_ns))
        if self.listening and len(frame.data) >= _SHORTEST:
            self._take(frame)
            self.changed()
            self._pass(self.now_ns)
        return self._sent()

    @property
    def listening(self) -> bool:
        """Whether the drive hears what is on the bus: it has power and has started."""
        return True

    def _take(self, frame: Frame) -> None:
        responder = self.responder
        message = responder.read(frame)
        known = frame.dialect.name == responder.dialect.name and responder.understands(message)
        package = message.command is not None and message.command.slots is not None
        own = message.address == self.address and not package
        shared = package or message.address in (responder.dialect.broadcast, self.settings.get(self.group_setting))
        wanted = frame.checksum_ok and known and (own or shared)
        for accept in self.hooks.accept:
            wanted = accept(self, frame, message, wanted)
        if not wanted:
            return
        answered = self.answers_to(message, own)
        for answer in self.hooks.answer:
            answered = answer(self, message, answered)
        refusal = responder.refusal(message, self.address) if known and not package else None
        if refusal is None:
            self._execute(responder, frame, message, answered, package)
        elif answered:
            self.send(refusal[0], self._ready(refusal[1]))

    def answers_to(self, message: Message, own: bool) -> bool:
        """Say whether the drive answers a frame that it has taken: only what is sent to it alone (`own`)."""
        return own

    def _execute(self, responder: Responder, frame: Frame, message: Message, answered: bool, package: bool) -> None:
        if not package and (message.command is None or message.form is None):
            self.unfit(frame)
        for each in self._slots(message) if package else (message,):
            request = responder.request(each, answered)
            if request is not None:
                self.obey(request)

    def unfit(self, frame: Frame) -> None:
        """Take a frame that no command is for, as a fault may."""
        return

    def _slots(self, message: Message) -> list[Slot]:
        """Return the slots of a package that the drive executes: the first with its own address."""
        assert message.command is not None
        every = slots_of(self.responder.dialect, message.command, message.data)
        chosen = [slot for slot in every if slot.address == self.address][:1]
        for choose in self.hooks.slots:
            chosen = choose(self, every, chosen)
        return chosen

    # --- a request ------------------------------------------------------------------------------------------------

    def obey(self, request: Request) -> None:
        """Do what a request says, and answer it."""
        command, address = request.command, self.address
        allowed = self.allows(request)
        for change in self.hooks.request:
            request.values = change(self, command, dict(request.values))
        request.reply_ns = self.now_ns + self.reply_delay_ns
        answered = request.answered and not self.silenced(command)
        result = self.behave(request) if allowed else self.refused(request)
        self.answer(request, result, answered, address, request.reply_ns)

    def allows(self, request: Request) -> bool:
        """Say whether the values of a request are what the manual allows; a read has nothing to refuse."""
        if request.command.all_risks == {Risk.READ}:
            return True
        wanted = all(self.tolerates(request.command, violation) for violation in request.broken)
        for allow in self.hooks.allow:
            wanted = allow(self, request.command, request.values, wanted)
        return wanted

    def tolerates(self, command: Command, violation: Violation) -> bool:
        """Say whether the drive overlooks what a request breaks."""
        return False

    def silenced(self, command: Command) -> bool:
        """Say whether the replies of a command are switched off."""
        return False

    @abstractmethod
    def behave(self, request: Request) -> Values | None:
        """Do what a request says that is allowed; return the values of its reply, None for silence."""

    @abstractmethod
    def refused(self, request: Request) -> Values | None:
        """Return the values of the reply to a request that is not obeyed."""

    # --- a reply --------------------------------------------------------------------------------------------------

    def answer(self, request: Request, result: Values | None, answered: bool, address: int, at_ns: int) -> None:
        """Send the reply to a request, if it is `answered`, from an address, ready at a time."""
        for change in self.hooks.result:
            result = change(self, request.command, request.values, result)
        if result is None or not answered:
            return
        data = request.responder.reply(request, result, address)
        self.send(request.command, Outgoing(at_ns, data, address if request.responder.dialect.bus == "can" else None))

    def _ready(self, data: bytes) -> Outgoing:
        """Return bytes that are ready when the next reply may be."""
        return Outgoing(self.now_ns + self.reply_delay_ns, data)

    def send(self, command: Command, outgoing: Outgoing) -> None:
        """Send bytes that answer a command."""
        sent = [outgoing]
        for change in self.hooks.reply:
            sent = [changed for each in sent for changed in change(self, command, each)]
        self._outbox += sent

    def discard_replies(self) -> None:
        """Drop what is ready and not sent yet."""
        self._outbox = []

    def _sent(self) -> list[Outgoing]:
        sent, self._outbox = self._outbox, []
        if self.clock_ppm:
            sent = [msgspec.structs.replace(each, at_ns=self._of_line(each.at_ns)) for each in sent]
        return sent

    # --- settings -------------------------------------------------------------------------------------------------

    def store(self, name: str, value: int) -> None:
        """Store the value of a setting."""
        stored: tuple[str, int] | None = (name, value)
        for change in self.hooks.stored:
            stored = None if stored is None else change(self, *stored)
        if stored is not None:
            self.keep(*stored)

    def keep(self, name: str, value: int) -> None:
        """Take a value that is stored into effect."""
        self.settings[name] = value

    # --- time -----------------------------------------------------------------------------------------------------

    def advance(self, t_ns: int) -> list[Outgoing]:
        """Let time pass until `t_ns`; return what the drive sends by itself (completion replies)."""
        self._pass(self._own(t_ns))
        return self._sent()

    def next_ns(self) -> int | None:
        """Return when the drive will do something by itself, or None while nothing is under way."""
        if self._outbox:
            return self._of_line(self.now_ns)
        due = self._next()
        return None if due is None else self._of_line(due[0])

    def _own(self, t_ns: int) -> int:
        """Return a time of the line as the drive's clock has it."""
        return t_ns * (_MILLION + self.clock_ppm) // _MILLION if self.clock_ppm else t_ns

    def _of_line(self, own_ns: int) -> int:
        """Return the first time of the line at which the drive's clock shows a time."""
        return -(-own_ns * _MILLION // (_MILLION + self.clock_ppm)) if self.clock_ppm else own_ns

    def changed(self) -> None:
        """Say that something changed, so that what comes next must be found anew."""
        self._stale = True

    def _pass(self, t_ns: int) -> None:
        while (due := self._next()) is not None and due[0] <= t_ns:
            self.reach(due[0])
            due[1]()
            self.changed()
        self.reach(max(self.now_ns, t_ns))

    def reach(self, t_ns: int) -> None:
        """Be at a time, before which nothing is left to do."""
        self.now_ns = t_ns

    def _next(self) -> tuple[int, Callable[[], None]] | None:
        if self._stale:
            self._due, self._stale = self.foresee(), False
        return self._due

    @abstractmethod
    def foresee(self) -> tuple[int, Callable[[], None]] | None:
        """Return what the drive does next by itself, and when, or None while nothing is under way."""

    @property
    @abstractmethod
    def counts_per_turn(self) -> int:
        """What the encoder counts in a turn, as it is sent."""

    @property
    @abstractmethod
    def rest(self) -> Rest:
        """When and how the shaft came to rest, or will."""

    @abstractmethod
    def hold(self, settings: Mapping[str, int]) -> None:
        """Have held these settings all the time."""

    @abstractmethod
    def stand(self, told: Mapping[str, int]) -> None:
        """Let a shaft that rests be where these fields of reads say that it is."""

    @abstractmethod
    def hot(self, temperature: float) -> None:
        """Set the temperature of the motor (degC)."""

    @abstractmethod
    def power_cycle(self, t_ns: int) -> None:
        """Switch the drive off and on: what is in RAM is gone, what happens at power-on happens."""
