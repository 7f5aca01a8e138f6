"""Requests and replies of an MKS drive as frames: native, Modbus-RTU, CAN.

    native   FA 01 F6 01 40 02 34                ->  run_speed(direction 0, speed 320, acceleration 2)  ->  FB 01 F6 01 F3
    Modbus   01 10 00 F6 00 02 04 00 02 01 40 .. ->  run_speed(...)  ->  01 10 00 F6 00 02 ..   executed: the echo
             01 06 00 82 00 09 ..                                    ->  01 06 00 82 FF FF ..   refused: FFFFh, or quantity 0
             01 03 00 82 00 01 ..                                    ->  01 83 01 ..            exception
    CAN      001#F60140023A                      ->  run_speed(...)  ->  001#F601F8
             001#008283                          ->  read_parameter(work_mode)  ->  001#820588  the setting's own layout

Rules kept here:
- Native frames: the head says who sent a frame. A drive takes FA and FC, no other head.
- CAN: a reply has the drive's own ID. A drive takes standard data frames only: no remote, extended or FD frame.
- Behaviours answer as the native drive does: by a `status` with the meanings of the native command's `Replies`. Modbus
  has no statuses: a write answers its echo, or the "refused" form where the native drive would answer that it failed.
- Modbus answers exception 01 for a function that the drive does not have. It answers 03 for a quantity or byte count other
  than the register's own, and 02 for a register that does not begin a command of that function.
- Modbus does not report the end of a motion: the host must read status F1h.
- A reply on a Modbus line (an exception, a 10h of eight bytes, a read of another length) is no request and is not answered.

Not emulated: diagnostics and the other functions of the Modbus standard, which the manual leaves out.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

from analyzer.catalogue import Command, Dialect, Form, Replies, Role, Trait
from analyzer.codec import codec
from analyzer.link import READS, WRITE_MANY, ModbusLink
from analyzer.protocols import mks_rs485
from analyzer.protocols.modbus import FALLBACKS, ModbusException
from analyzer.records import Message
from conformance.drives.drive import Request, Responder, Values, encoded

#: The longest read that the Modbus standard has, in registers.
_LONGEST_READ = 125
#: Bytes of a Modbus write of one register, and of every read.
_SHORT = 8


class MksResponder(Responder):
    """One dialect as an MKS drive speaks it.

    `completes`: a reply of its own tells the end of a motion. `turns_bus_motion`: the setting of the motor's direction
    turns motion by the bus too. `lets_go_at_home`: with the end limit on, the shaft is let go when homing to a switch ends.
    `backs_off_by_angle`: homing from a closed switch first goes back by the return angle, else until the switch opens.
    `supply`: the volts it works at.
    """

    completes = True
    supply = (12.0, 24.0)

    def __init__(self, dialect: Dialect) -> None:
        super().__init__(dialect)
        self.turns_bus_motion = Trait.DIRECTION_TURNS_BUS_MOTION in dialect.traits
        self.lets_go_at_home = Trait.LETS_GO_AT_END_LIMIT in dialect.traits
        self.backs_off_by_angle = Trait.BACKS_OFF_BY_ANGLE in dialect.traits

    def exception(self, message: Message) -> int | None:
        """Return the Modbus exception that answers a request, None where a command answers it."""
        return None


class NativeResponder(MksResponder):
    """The native frames of the RS485 drives: heads FA and FB, sum8, and the FC package."""

    def understands(self, message: Message) -> bool:
        """Say whether a message is a request that the drive knows, with a head that says so."""
        return self.dialect.link.parse(message.frame.data).role is Role.REQUEST and super().understands(message)


class ModbusResponder(MksResponder):
    """Modbus-RTU frames on the registers of the RS485 manual's Part 8."""

    completes = False

    def understands(self, message: Message) -> bool:
        """Say whether a message is a request, known or one that an exception answers."""
        frame = message.frame
        head = self.dialect.link.parse(frame.data)
        if message.role is not Role.REQUEST or head.exception is not None or len(frame.data) < 4:
            return False
        if head.function in WRITE_MANY:
            return len(frame.data) > _SHORT
        if head.function in self._functions:
            return len(frame.data) == _SHORT
        return True

    @cached_property
    def _functions(self) -> set[int | None]:
        return {c.function for c in self.dialect.commands}

    def exception(self, message: Message) -> int | None:
        """Return the exception that answers a request, None where a command answers it."""
        frame = message.frame
        head = self.dialect.link.parse(frame.data)
        if head.function not in self._functions:
            return ModbusException.ILLEGAL_FUNCTION
        if head.function in READS and not 1 <= (head.quantity or 0) <= _LONGEST_READ:
            return ModbusException.ILLEGAL_DATA_VALUE
        named = [c for c in self.dialect.by_code.get(head.code or 0, ()) if c.function == head.function]
        if not named:
            return ModbusException.ILLEGAL_DATA_ADDRESS
        if head.quantity not in {c.quantity for c in named} or message.form is None:
            return ModbusException.ILLEGAL_DATA_VALUE
        if head.function in WRITE_MANY and not self._counted(message):
            return ModbusException.ILLEGAL_DATA_VALUE
        return None

    def _counted(self, message: Message) -> bool:
        """Say whether a write of several registers has the byte count of its register."""
        link, frame = self.dialect.link, message.frame
        assert isinstance(link, ModbusLink)
        head = link.parse(frame.data)
        counted = frame.data[head.start - 1]
        expected = link.byte_count(head.function or 0, head.code or 0, head.quantity or 0)
        return counted == expected == len(message.data)

    def refusal(self, message: Message, address: int) -> tuple[Command, bytes] | None:
        """Return the exception that answers a request, None where a command answers it."""
        code, form = self.exception(message), self.dialect.exception
        if code is None:
            return None
        assert form is not None
        head = bytes((address, message.frame.data[1] | 0x80))
        data = self.dialect.link.completed(head + codec(form.layout).encode({"exception": code}))
        return message.command or FALLBACKS[0x03], data

    def meanings(self, command: Command) -> Replies:
        """Return the meanings of the native command's statuses."""
        return mks_rs485.DIALECT.by_verb[command.verb].replies

    def reply(self, request: Request, values: Values, address: int) -> bytes:
        """Return the registers of a read, the echo of a write, or its refusal."""
        command = request.command
        if command.function in READS:
            return super().reply(request, values, address)
        refused = values.get("status") in self.meanings(command).failed
        form = next(f for f in command.reply_forms if (f.name in command.replies.failed_forms) == refused)
        data = encoded(form, {} if refused else request.values)
        return self.dialect.link.build(command, form, address, data, Role.REPLY)


class CanResponder(MksResponder):
    """The CAN frames of the E drives."""

    supply = (20.0, 60.0)

    def understands(self, message: Message) -> bool:
        """Say whether a message is a request in a standard data frame."""
        can = message.frame.can
        plain = can is not None and not (can.extended or can.remote or can.error or can.fd)
        return plain and super().understands(message)

    def form(self, request: Request, values: Values) -> Form:
        """Return the form of a reply; a code that the catalogue does not have cannot be read either."""
        if "unreadable" in values:
            command = request.command
            form = next(f for f in command.reply_forms if f.name in command.replies.failed_forms)
            return replace(form, code=request.values["parameter"])
        return super().form(request, values)
