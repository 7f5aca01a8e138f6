"""Faults of Modbus: functions, registers, quantities, byte counts, echoes, refusals and exceptions."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from msgspec.structs import replace

from analyzer.catalogue import Command, Verb
from analyzer.decoder import Decoder
from analyzer.link import READS, WRITE_MANY, WRITE_ONE
from analyzer.records import Frame, Message
from conformance.drives.drive import Drive, Fault, Hooks, Outgoing
from conformance.drives.faults.mks_makers import MODBUS, Install, accepted, body_of, byte, mks, rebuilt, said
from conformance.drives.mks.core import MksCore

_WORD = 2
#: Where things stand in a body: function, then a register and a value or a quantity, or a byte count.
_FUNCTION, _REGISTER, _VALUE, _COUNT = 1, 2, 4, 2


def _of(functions: Iterable[int], change: Callable[[bytes], bytes], *, exceptions: bool = False) -> Install:
    """Change the bodies of replies to these functions; `exceptions`: those that refuse by an exception instead."""
    chosen = frozenset(functions)

    def say(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        body = body_of(drive, outgoing)
        function = body[_FUNCTION]
        fits = function & 0x7F in chosen and bool(function & 0x80) == exceptions
        yield rebuilt(drive, outgoing, change(body)) if fits else outgoing

    return said(say)


def _refused(body: bytes) -> bool:
    many = body[_FUNCTION] in WRITE_MANY
    return body[_VALUE:] == (b"\0\0" if many else b"\xff\xff")


def _by_exception(body: bytes) -> bytes:
    return bytes((body[0], body[_FUNCTION] | 0x80, 3)) if _refused(body) else body


def _words_swapped(body: bytes) -> bytes:
    """Send numbers of several registers with the low register first."""
    data = body[_COUNT + 1 :]
    words = [data[n : n + _WORD] for n in range(0, len(data), _WORD)]
    return body[: _COUNT + 1] + b"".join(reversed(words))


def _heard_again(hooks: Hooks) -> None:
    """Echo the whole request of a write of several registers."""
    heard: list[bytes] = []

    def accept(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        heard[:] = [frame.data]
        return wanted

    def say(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        many = outgoing.data[_FUNCTION] in WRITE_MANY
        yield replace(outgoing, data=heard[0]) if many and heard else outgoing

    hooks.accept.append(accept)
    hooks.reply.append(say)


def _translated(change: Callable[[MksCore, bytes], bytes | None]) -> Install:
    """Take a frame for another one: what `change` makes of its body, None: for what it is."""

    def accept(drive: MksCore, frame: Frame, message: Message, wanted: bool) -> bool:
        link = drive.dialect.link
        body = frame.data[:-2]
        other = change(drive, body) if frame.checksum_ok and message.address == drive.address and len(body) > _VALUE else None
        if other is None:
            return wanted
        asked = replace(frame, data=link.completed(other))
        order = drive.speaker.order(Decoder(drive.dialect).decode(asked)[0], drive.now_ns, True)
        if order is None:
            return wanted
        drive.obey(order)
        return False

    return accepted(accept)


def _as_04(drive: MksCore, body: bytes) -> bytes | None:
    return byte(_FUNCTION, lambda _: 0x04)(body) if body[_FUNCTION] == 0x03 else None


def _any_quantity(drive: MksCore, body: bytes) -> bytes | None:
    """Take a read of any quantity for one of the register's own."""
    named = [c for c in drive.dialect.by_code.get(body[_REGISTER] << 8 | body[_REGISTER + 1], ()) if c.function == 0x04]
    if body[_FUNCTION] != 0x04 or not named:
        return None
    return body[:_VALUE] + named[0].quantity.to_bytes(_WORD, "big")


def _six_bytes(drive: MksCore, body: bytes) -> bytes | None:
    """Take six bytes for the home settings, as the standard would have it."""
    is_home = body[_FUNCTION] == 0x10 and body[_REGISTER:_VALUE] == b"\x00\x90" and body[6:7] == b"\x06"
    return body[:6] + b"\x05" + body[7:11] + body[12:13] if is_home else None


def _low_byte_register(drive: MksCore, body: bytes) -> bytes | None:
    """Look only at the low byte of a register."""
    return body[:_REGISTER] + b"\0" + body[_REGISTER + 1 :] if body[_REGISTER] else None


def _done_later(hooks: Hooks) -> None:
    """Tell the end of a move by a second echo."""

    def say(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        yield outgoing
        if command.verb in (Verb.MOVE_RELATIVE_AXIS, Verb.MOVE_ABSOLUTE_AXIS) and mks(drive).task is not None:
            yield replace(outgoing, at_ns=max(outgoing.at_ns, int(mks(drive).motor.settled)))

    hooks.reply.append(say)


FAULTS: tuple[Fault, ...] = (
    Fault("read-byte-count-in-registers", (MODBUS,), "reads count registers instead of bytes", "byte count",
          _of(READS, byte(_COUNT, lambda n: n // _WORD))),
    Fault("read-byte-count-off-by-one", (MODBUS,), "the byte count of reads is one too high", "byte count",
          _of(READS, byte(_COUNT, lambda n: n + 1))),
    Fault("read-words-swapped", (MODBUS,), "numbers of several registers come low register first", "byte order",
          _of(READS, _words_swapped)),
    Fault("read-repeats-register", (MODBUS,), "a read is answered with its register before the data", "shape",
          _of(READS, lambda b: b[: _COUNT + 1] + b"\0\x31" + b[_COUNT + 1 :])),
    Fault("write-echo-zero", (MODBUS,), "06h is echoed with the value 0", "echo",
          _of(WRITE_ONE, lambda b: b if _refused(b) else b[:_VALUE] + b"\0\0")),
    Fault("write-echo-next-register", (MODBUS,), "writes are echoed with the next register", "echo",
          _of(WRITE_ONE | WRITE_MANY, byte(_REGISTER + 1, lambda r: r + 1))),
    Fault("write-many-quantity-in-bytes", (MODBUS,), "10h is echoed with the byte count", "quantity",
          _of(WRITE_MANY, lambda b: b if _refused(b) else byte(_VALUE + 1, lambda q: 2 * q)(b))),
    Fault("write-many-quantity-off-by-one", (MODBUS,), "10h is echoed with a quantity one too low", "quantity",
          _of(WRITE_MANY, lambda b: b if _refused(b) else byte(_VALUE + 1, lambda q: q - 1)(b))),
    Fault("write-many-echoes-all", (MODBUS,), "10h is answered with the whole request", "echo", _heard_again),
    Fault("write-one-as-many", (MODBUS,), "06h is answered under function 10h", "code",
          _of(WRITE_ONE, byte(_FUNCTION, lambda _: 0x10))),
    Fault("refused-by-exception", (MODBUS,), "refused writes are answered with exception 03", "exception",
          _of(WRITE_ONE | WRITE_MANY, _by_exception)),
    Fault("refusal-echoes-value", (MODBUS,), "a refused 06h is echoed with 0", "echo",
          _of(WRITE_ONE, lambda b: b[:_VALUE] + b"\0\0" if _refused(b) else b)),
    Fault("refusal-echoes-quantity", (MODBUS,), "a refused 10h is echoed with its quantity", "quantity",
          _of(WRITE_MANY, lambda b: byte(_VALUE + 1, lambda _: 4)(b) if _refused(b) else b)),
    Fault("exception-always-04", (MODBUS,), "every exception is 04", "exception",
          _of(READS | WRITE_ONE | WRITE_MANY, byte(2, lambda _: 4), exceptions=True)),
    Fault("exceptions-mixed-up", (MODBUS,), "exceptions 02 and 03 stand for each other", "exception",
          _of(READS | WRITE_ONE | WRITE_MANY, byte(2, lambda c: {2: 3, 3: 2}.get(c, c)), exceptions=True)),
    Fault("exception-without-bit", (MODBUS,), "exceptions lack the high bit of the function", "exception",
          _of(READS | WRITE_ONE | WRITE_MANY, byte(_FUNCTION, lambda f: f & 0x7F), exceptions=True)),
    Fault("function-03-reads", (MODBUS,), "03h reads as 04h does", "function", _translated(_as_04)),
    Fault("any-quantity-reads", (MODBUS,), "a read of any quantity is answered with the register's own", "quantity",
          _translated(_any_quantity)),
    Fault("home-takes-six-bytes", (MODBUS,), "90h is taken with six bytes", "byte count", _translated(_six_bytes)),
    Fault("register-low-byte-only", (MODBUS,), "only the low byte of a register is looked at", "address",
          _translated(_low_byte_register)),
    Fault("modbus-completions", (MODBUS,), "the end of a move is told by a second echo", "completion", _done_later),
)  # fmt: skip
