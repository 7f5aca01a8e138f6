"""Modbus: functions, registers, quantities, byte counts, refused writes, exceptions, addresses.

    01 04 00 31 00 03  ->  01 04 06 ..          a register with its own quantity
    01 03 00 31 00 03  ->  01 83 01             a function that the drive does not have
    01 04 00 35 00 01  ->  01 84 02             a register that no command has
    01 04 00 31 00 02  ->  01 84 03             a quantity that is not the register's
    01 06 00 82 00 09  ->  01 06 00 82 FF FF    a value that the manual does not allow

Rules kept here:
- The manual says that the drive speaks Modbus-RTU and what its registers are; what it leaves to the standard (Modbus
  Application Protocol V1.1b3) is likely, not certain: silence on what calls for an exception is refuted all the same.
- Where the standard and the registers leave room (a read of a register that is written, one register by the function of
  several) the claim is open.
- What writes something that no command has needs `unknown`, even though the drive is to refuse it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, Risk, Subject, Verb
from analyzer.link import READS, WRITE_MANY, WRITE_ONE
from analyzer.protocols.modbus import ModbusException
from conformance.claim import Theme
from conformance.claims.control_reads import ask_alone, expect_silence, plain_read
from conformance.claims.declare import Case, claim, described_in
from conformance.claims.modbus.frames import expect_exceptions, on_modbus, request
from conformance.claims.motion.motion_claim import of_motion
from conformance.motion import declared, motion
from conformance.motion.declared import CALM
from conformance.talk.garbling import harmless
from conformance.talk.probe import Probe

FUNCTION, ADDRESS, VALUE = (
    ModbusException.ILLEGAL_FUNCTION,
    ModbusException.ILLEGAL_DATA_ADDRESS,
    ModbusException.ILLEGAL_DATA_VALUE,
)
#: Other functions of the standard, and codes that it leaves to the user.
_OTHER_FUNCTIONS = (0x07, 0x08, 0x0B, 0x11, 0x14, 0x16, 0x17, 0x18, 0x2B, 0x41, 0x64, 0x7F)
_LONGEST_READ = 125
#: Addresses that the standard keeps back, as far as no other dialect begins its frames with them.
_RESERVED = (248, 249, 253, 254, 255)


def _with_standard(case: Case) -> str:
    """Return the section of what the manual leaves to the standard."""
    return f"{described_in(Subject.FRAMING)(case)}; Modbus V1.1b3, 7"


# --- what calls for an exception --------------------------------------------------------------------------------------

#: What is asked (in words), the function, the frame.
Asked = Iterator[tuple[str, int, bytes]]


@dataclass(frozen=True)
class _Denied:
    """Requests that an exception answers. `make(probe)` yields them."""

    name: str
    statement: str
    code: int
    make: Callable[[Probe], Asked]
    sure: Certainty = Certainty.LIKELY
    risks: frozenset[Risk] = frozenset()


def _reads(dialect: Dialect) -> list[Command]:
    return [c for c in dialect.commands if c.function in READS]


def _registers(dialect: Dialect, functions: frozenset[int]) -> set[int]:
    return {c.code for c in dialect.commands if c.function in functions}


def _other_reads(probe: Probe) -> Asked:
    """Ask for known registers by the other functions that read."""
    own = {c.function for c in probe.dialect.commands}
    for function in sorted(READS - own):
        for command in _reads(probe.dialect):
            yield f"function {function:02X}h", function, request(probe, function, command.code, command.quantity)


def _other_writes(probe: Probe) -> Asked:
    """Write by the functions for coils."""
    yield "function 05h", 0x05, request(probe, 0x05, 0x00F7, 0xFF00)
    yield "function 0Fh", 0x0F, request(probe, 0x0F, 0x00F7, 8, data=b"\x01\x01")


def _unknown_functions(probe: Probe) -> Asked:
    for function in _OTHER_FUNCTIONS:
        yield f"function {function:02X}h", function, request(probe, function, 0x0000, 0x0001)


def _between(probe: Probe) -> Asked:
    """Read registers between, below and above those that are there, with a quantity that some register has."""
    dialect = probe.dialect
    known = _registers(dialect, READS)
    function = _reads(dialect)[0].function or 0
    beside = {r for k in known for r in (k - 1, k + 1)} | {0x0000, 0x00FF, 0x7FFF, 0xFFFF}
    everything = {c.code for c in dialect.commands}
    for register in sorted(beside - everything):
        for quantity in (1, 3):
            yield f"register {register:04X}h", function, request(probe, function, register, quantity)


def _high_byte(probe: Probe) -> Asked:
    """Read registers whose low byte is that of one that is there."""
    for command in _reads(probe.dialect):
        function = command.function or 0
        for high in (0x01, 0x80, 0xFF):
            register = command.code | high << 8
            yield f"register {register:04X}h", function, request(probe, function, register, command.quantity)


def _written(probe: Probe) -> Asked:
    """Read registers that are written."""
    reads = _registers(probe.dialect, READS)
    function = _reads(probe.dialect)[0].function or 0
    for register in sorted(_registers(probe.dialect, WRITE_ONE | WRITE_MANY) - reads)[::4]:
        yield f"register {register:04X}h, which is written", function, request(probe, function, register, 1)


def _quantities(probe: Probe) -> Asked:
    """Read registers with other quantities than their own."""
    for command in _reads(probe.dialect):
        function, own = command.function or 0, command.quantity
        for quantity in sorted({0, 1, own - 1, own + 1, own + 3, 125} - {own}):
            what = f"{quantity} registers from {command.code:04X}h, which has {own}"
            yield what, function, request(probe, function, command.code, quantity)


def _too_many(probe: Probe) -> Asked:
    """Read more registers than the standard allows."""
    for command in _reads(probe.dialect)[:2]:
        function = command.function or 0
        for quantity in (_LONGEST_READ + 1, 0x0100 + command.quantity, 0xFFFF):
            yield f"{quantity} registers", function, request(probe, function, command.code, quantity)


_KINDS = (
    _Denied("function/other_reads", "Registers are read by function 04h alone; 01h, 02h and 03h are refused by exception 01.",
          FUNCTION, _other_reads),
    _Denied("function/coils", "There are no coils: functions 05h and 0Fh are refused by exception 01.", FUNCTION, _other_writes,
          risks=frozenset({Risk.UNKNOWN})),
    _Denied("function/unknown", "A function that the drive does not have is refused by exception 01.", FUNCTION,
          _unknown_functions, risks=frozenset({Risk.UNKNOWN})),
    _Denied("register/between", "A read of a register that no command has is refused by exception 02.", ADDRESS, _between),
    _Denied("register/high_byte", "Both bytes of a register count: one more high byte is another register (exception 02).",
          ADDRESS, _high_byte),
    _Denied("register/written", "A read of a register that is only written is refused by exception 02.", ADDRESS, _written,
          sure=Certainty.OPEN),
    _Denied("quantity/others", "A register is read with its own quantity and no other (exception 03).", VALUE, _quantities),
    _Denied("quantity/too_many", "A read of more than 125 registers is refused by exception 03.", VALUE, _too_many),
)  # fmt: skip


def _kinds(dialect: Dialect) -> Iterator[Case]:
    for case in on_modbus(dialect):
        for kind in _KINDS:
            facts = {"statement": kind.statement, "at_best": kind.sure, "risks": kind.risks}
            yield Case(case.dialect, given={"kind": kind}, facts=facts)


@claim(
    Theme.MODBUS,
    each=_kinds,
    name="{kind}",
    refuted_by="another exception, or an answer that is none",
    section=_with_standard,
    parameters={},
)
def _refused(probe: Probe, kind: _Denied) -> None:
    ask_alone(probe)
    following = probe.build(plain_read(probe.dialect)).frame
    # Bytes that begin a frame of another dialect are left to drives that are alone.
    asked = [each for each in kind.make(probe) if harmless(each[-1], probe.address, following, beside=kind.risks)]
    expect_exceptions(probe, [(what, function, frame, kind.code) for what, function, frame in asked])


def _turning(dialect: Dialect) -> Iterator[Case]:
    for case in on_modbus(dialect):
        if declared.can_move(dialect):
            yield Case(case.dialect, dialect.by_verb[Verb.RUN_SPEED])


@of_motion(
    theme=Theme.MODBUS,
    each=_turning,
    name="exception/turning",
    refuted_by="another exception, or an answer that is none",
    section=_with_standard,
    at_best=Certainty.LIKELY,
    aspect=None,
)
def _refused_while_turning(probe: Probe) -> None:
    """While the shaft turns a wrong function, register or quantity is refused by the same exceptions as at rest."""
    motion.ready_to_move(probe)
    motion.run_at(probe, CALM)
    read = plain_read(probe.dialect)
    own, asked = read.function or 0, []
    for function, register, quantity, code in (
        (0x03, read.code, read.quantity, FUNCTION),
        (own, 0x0035, 1, ADDRESS),
        (own, read.code, read.quantity + 1, VALUE),
    ):
        what = f"function {function:02X}h at register {register:04X}h while the shaft turns"
        asked.append((what, function, request(probe, function, register, quantity), code))
    expect_exceptions(probe, asked)


# --- addresses --------------------------------------------------------------------------------------------------------


@claim(
    Theme.MODBUS,
    each=on_modbus,
    name="address/reserved",
    refuted_by="any answer",
    section="8.2.15; Modbus over Serial Line V1.02, 2.2",
    alone=True,
    rests_on=(Doubt.ADDRESSING,),
)
def _reserved_addresses(probe: Probe) -> None:
    """A request to an address above 247, which Modbus keeps back, is not answered."""
    ask_alone(probe)
    read = plain_read(probe.dialect)
    for address in _RESERVED:
        frame = request(probe, read.function or 0, read.code, read.quantity, address=address)
        expect_silence(probe, probe.send(frame), f"the reserved address {address} is answered")


def _by_broadcast(own: int) -> tuple[int, ...]:
    return (0,)


def _to_others(own: int) -> tuple[int, ...]:
    return (own % 247 + 1, (own + 100) % 247 + 1)


def _other_addresses(dialect: Dialect) -> Iterable[Case]:
    for case in on_modbus(dialect):
        yield Case(case.dialect, given={"kind": "broadcast", "how": "by broadcast", "addresses": _by_broadcast})
        yield Case(case.dialect, given={"kind": "other", "how": "to another address", "addresses": _to_others})


@claim(
    Theme.MODBUS,
    each=_other_addresses,
    name="exception/{kind}",
    refuted_by="any answer",
    section=_with_standard,
    alone=True,
    parameters={},
)
def _no_exception(probe: Probe, how: str, addresses: Callable[[int], tuple[int, ...]]) -> None:
    """What calls for an exception is not answered when it is sent {how}."""
    ask_alone(probe)
    read = plain_read(probe.dialect)
    for address in addresses(probe.address):
        for function, register, quantity in (
            (0x03, read.code, read.quantity),
            (read.function or 0, 0x0035, 1),
            (read.function or 0, read.code, 0),
        ):
            frame = request(probe, function, register, quantity, address=address)
            expect_silence(probe, probe.send(frame), f"a wrong request {how} is answered")
