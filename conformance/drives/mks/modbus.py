"""An MKS SERVO42D/57D on RS485 as a Modbus-RTU slave.

    01 10 00 F6 00 02 04 00 02 01 40 ..  ->  run_speed(...)  ->  01 10 00 F6 00 02 ..       executed: the echo
    01 06 00 82 00 09 ..                                     ->  01 06 00 82 FF FF ..       refused: FFFFh, or quantity 0
    01 03 00 82 00 01 ..                                     ->  01 83 01 ..                exception

Rules kept here:
- What a write answers is an echo, or the "refused" form where the native drive would answer that it failed.
- Exception 01 for a function that the drive does not have, 03 for a quantity or byte count other than the register's own,
  02 for a register that does not begin a command of that function.
- The end of a motion is not told: the status F1h must be asked.
- A group address that was set in native frames is still heard, and not answered.
- A reply on the line (an exception, a 10h of eight bytes, a read of another length) is no request and stays without one.

Not emulated: diagnostics and the other functions of the standard, which the manual leaves out.
"""

from __future__ import annotations

from analyzer.catalogue import Command, Form, Replies, Role
from analyzer.codec import codec
from analyzer.link import READS, WRITE_MANY, ModbusLink
from analyzer.protocols import mks_rs485
from analyzer.protocols.modbus import FALLBACKS, ModbusException
from analyzer.records import Message
from conformance.drives.drive import Values
from conformance.drives.mks.speaker import Speaker, fitted

#: The longest read that the standard has, in registers.
_LONGEST_READ = 125
#: Bytes of a write of one register, and of every read.
_SHORT = 8


class ModbusSpeaker(Speaker):
    """Modbus-RTU frames on the registers of the manual's Part 8."""

    completes = False
    #: What stands for a function that no command has.
    unknown: Command = FALLBACKS[0x03]

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

    @property
    def _functions(self) -> set[int | None]:
        return {c.function for c in self.dialect.commands}

    def exception(self, message: Message) -> int | None:
        """Return the exception that a request is answered with, None where a command answers it."""
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
        """Say whether the byte count of a write of several registers is the one that the register must have."""
        link, frame = self.dialect.link, message.frame
        assert isinstance(link, ModbusLink)
        head = link.parse(frame.data)
        counted = frame.data[head.start - 1]
        expected = link.byte_count(head.function or 0, head.code or 0, head.quantity or 0)
        return counted == expected == len(message.data)

    def meanings(self, command: Command) -> Replies:
        """Return the meanings of the native command's statuses, in which behaviours answer here too."""
        return mks_rs485.DIALECT.by_verb[command.verb].replies

    def reply(self, command: Command, asked: Values, values: Values, address: int) -> bytes:
        """Return the registers of a read, the echo of a write, or its refusal."""
        if command.function in READS:
            return super().reply(command, asked, values, address)
        refused = values.get("status") in self.meanings(command).failed
        form = next(f for f in command.reply_forms if (f.name in command.replies.failed_forms) == refused)
        data = codec(form.layout).encode({} if refused else fitted(form.layout.named, asked))
        return self.dialect.link.build(command, form, address, data, Role.REPLY)

    def refusal(self, message: Message, code: int, address: int) -> bytes:
        """Return the bytes of the exception that answers a request."""
        form: Form | None = self.dialect.exception
        assert form is not None
        head = bytes((address, message.frame.data[1] | 0x80))
        return self.dialect.link.completed(head + codec(form.layout).encode({"exception": code}))
