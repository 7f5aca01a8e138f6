"""Speakers: how an MKS drive takes frames for orders and puts its answers into frames. One for each dialect.

    Frame -> hear -> Message -> order -> Order(command, values)          what the drive then does is the same everywhere
    reply values by name -> reply -> bytes

Rules kept here:
- Codes, layouts, forms and checks come from the catalogue. A speaker holds no command and packs no byte.
- Behaviours answer in the words of the native drive: a `status` whose meanings are the native command's `Replies`. A
  dialect without statuses says the same by its own forms (`ModbusSpeaker`).
- What a drive measures is wrapped to the bits of its field, as a counter in a drive is.

Not emulated: the display and its menu, which are other ways to the same settings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from msgspec.structs import replace

from analyzer.catalogue import Command, Dialect, Form, Replies, Role
from analyzer.codec import Violation, codec
from analyzer.decoder import Decoder, Slot, slots_of
from analyzer.layout import Field, Kind
from analyzer.records import Frame, Message
from conformance.drives.drive import Values


@dataclass
class Order:
    """A command that a drive was given by a `speaker`. `values`: integers as sent; `broken`: what of the manual they break.

    `answered`: it may be answered at all (broadcasts are not). `reply_ns`: when its first reply is ready.
    """

    speaker: Speaker
    command: Command
    values: Values
    broken: tuple[Violation, ...]
    answered: bool
    t_ns: int
    reply_ns: int = 0


class Speaker:
    """One dialect as a drive of one model speaks it.

    `completes`: the end of a motion is told by a reply of its own. `turns_bus_motion`: the setting of the motor's
    direction turns motion by the bus too. `lets_go_at_home`: with the end limit on, homing to a switch ends with the
    shaft let go. `backs_off_by_angle`: homing from a closed switch first goes back by the return angle, and not until
    the switch opens. `supply`: the volts it works at.
    """

    completes = True
    turns_bus_motion = False
    lets_go_at_home = True
    backs_off_by_angle = False
    supply = (12.0, 24.0)

    def __init__(self, dialect: Dialect) -> None:
        self.dialect = dialect
        self._decoder = _decoder(dialect)

    # --- from frames ----------------------------------------------------------------------------------------------

    def hear(self, frame: Frame) -> Message:
        """Return the message of a frame; where its head does not say who sent it, it was the host."""
        heard = frame if frame.role is Role.REQUEST else replace(frame, role=Role.REQUEST)
        return self._decoder.decode(heard)[0]

    def understands(self, message: Message) -> bool:
        """Say whether a message is a request that the drive knows, of the length that it has."""
        command = message.command
        if message.role is not Role.REQUEST or command is None or message.form is None:
            return False
        return command.slots is None or len(message.data) == command.slots.count * command.slots.size

    def exception(self, message: Message) -> int | None:
        """Return the code by which a request is refused that has no form of the catalogue, None where there is none."""
        return None

    def slots(self, message: Message, address: int) -> tuple[list[Slot], list[Slot]]:
        """Return the slots of a package, and those of them that a drive executes: the first with its own address."""
        assert message.command is not None
        every = slots_of(self.dialect, message.command, message.data)
        return every, [slot for slot in every if slot.address == address][:1]

    def order(self, message: Message | Slot, t_ns: int, answered: bool) -> Order | None:
        """Return what a message tells the drive to do, or None where no request of the catalogue fits."""
        command, form, data = message.command, message.form, message.data
        if isinstance(message, Message) and message.role is not Role.REQUEST:
            found = self._as_request(message)
            if found is None:
                return None
            command, form, data = found
        if command is None or form is None or command.verb not in self.dialect.by_verb:
            return None
        coder = codec(form.layout)
        return Order(self, command, coder.wire(data), coder.broken(data), answered, t_ns)

    def _as_request(self, message: Message) -> tuple[Command, Form, bytes] | None:
        """Return the request that the data of a reply would be."""
        frame = message.frame
        head = self.dialect.link.parse(frame.data, frame.can.id if frame.can else None)
        for command in self.dialect.by_code.get(-1 if head.code is None else head.code, ()):
            for form in command.request_forms:
                if command.slots is None and codec(form.layout).matches(message.data):
                    return command, form, message.data
        return None

    # --- to frames ------------------------------------------------------------------------------------------------

    def meanings(self, command: Command) -> Replies:
        """Return what the statuses mean in which the drive's behaviours answer a command."""
        return command.replies

    def reply(self, command: Command, asked: Values, values: Values, address: int) -> bytes:
        """Return the bytes that answer a command; `asked` are the values of its request."""
        form = self._form(command, asked, values)
        data = codec(form.layout).encode(fitted(form.layout.named, values))
        return self.dialect.link.build(command, form, address, data, Role.REPLY)

    def _form(self, command: Command, asked: Values, values: Values) -> Form:
        for form in command.reply_forms:
            wanted = form.request_values or {}
            if all(asked.get(n) == v for n, v in wanted.items()) and form.layout.named.keys() <= values.keys():
                return form
        raise LookupError(f"{command.name}: no form of its reply has {', '.join(values) or 'nothing'}")


def _decoder(dialect: Dialect) -> Decoder:
    """Return the decoder of a dialect; made once, and kept with it."""
    kept: Decoder | None = dialect.__dict__.get("_decoder")
    if kept is None:
        kept = dialect.__dict__["_decoder"] = Decoder(dialect)
    return kept


def fitted(fields: Mapping[str, Field], values: Mapping[str, Any]) -> dict[str, int | bytes]:
    """Return the values of these fields, integers wrapped to the bits they have."""
    return {name: _wrapped(field, values[name]) for name, field in fields.items() if name in values}


def _wrapped(field: Field, value: int | bytes) -> int | bytes:
    if isinstance(value, bytes) or field.kind is Kind.BYTES:
        return value
    return (value - field.wire_minimum) % (1 << field.bit_width) + field.wire_minimum
