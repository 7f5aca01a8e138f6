"""Modbus-RTU slaves of any make: by their functions alone (`DIALECT`), or by a list of their registers (`slave`).

    read     address, function | register, quantity                     reply: byte count, registers or coils
    write    address, function | register, value                        reply: the same
    many     address, function | register, quantity, byte count, data   reply: register, quantity

Source: Modbus Application Protocol V1.1b3, sections 6 and 7.

Rules kept here:
- A command is a function. Its data are all that follows the function; those of a reply come behind those of its request,
  for a read reply does not say which registers it has.
- A value that a frame holds whole stands under its name. All other registers stand under `unmapped`, by their addresses.
- Without a list, registers and coils are a list of numbers, in the order of their addresses.
"""

from __future__ import annotations

import struct
from bisect import bisect_left
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from fractions import Fraction
from typing import Any

from analyzer.catalogue import Command, Dialect, Form, Risk, Verb, always
from analyzer.layout import Field, FieldKind, Layout, MisfitError, ReadLayout, u16
from analyzer.link import ModbusSlaveLink
from analyzer.protocols.modbus import EXCEPTION, FALLBACKS
from analyzer.values import counted, printable

_MANUAL = "Modbus Application Protocol V1.1b3"


class Table(StrEnum):
    """What a slave has: bits and registers, of each those that can be written and those that cannot."""

    COIL = "coil"
    DISCRETE = "discrete"
    HOLDING = "holding"
    INPUT = "input"

    @property
    def of_bits(self) -> bool:
        """Whether it has bits, and no registers."""
        return self in (Table.COIL, Table.DISCRETE)


#: Function -> its name, its table, its section, what it does.
_READS = {
    0x01: ("read_coils", Table.COIL, "6.1", "read coils"),
    0x02: ("read_discrete_inputs", Table.DISCRETE, "6.2", "read discrete inputs"),
    0x03: ("read_holding_registers", Table.HOLDING, "6.3", "read holding registers"),
    0x04: ("read_input_registers", Table.INPUT, "6.4", "read input registers"),
}
_WRITES = {
    0x05: ("write_single_coil", Table.COIL, "6.5", "write a coil"),
    0x06: ("write_single_register", Table.HOLDING, "6.6", "write a holding register"),
}
_MANY = {
    0x0F: ("write_multiple_coils", Table.COIL, "6.11", "write coils"),
    0x10: ("write_multiple_registers", Table.HOLDING, "6.12", "write holding registers"),
}
#: What a write of one coil says.
_COILS = {b"\0\0": 0, b"\xff\0": 1}
#: Type -> how its bytes are unpacked, high byte first.
NUMBERS = {"u16": "H", "i16": "h", "u32": "I", "i32": "i", "u64": "Q", "i64": "q", "f32": "f", "f64": "d"}
#: Names that fields of every slave have.
TAKEN = frozenset({"register", "quantity", "unmapped"})


@dataclass(frozen=True)
class Value:
    """A named value of a slave: a row of its list.

    `count`: registers that it takes, or one bit. `kind`: a key of `NUMBERS`, `bool` or `string`. `low_first`: of several
    registers the low one has the first address. Physical is the number times `scale` plus `offset`, in `unit`.
    """

    table: Table
    address: int
    name: str
    kind: str
    count: int = 1
    low_first: bool = False
    scale: Fraction = Fraction(1)
    offset: Fraction = Fraction(0)
    unit: str = ""
    note: str = ""

    @property
    def field(self) -> Field:
        """What the value is, for schemas and tables."""
        note = "; ".join(filter(None, (self.note, f"{self.table} 0x{self.address:04X}, {self.kind}")))
        if self.kind == "string":
            return Field(name=self.name, bit_width=0, kind=FieldKind.TEXT, note=note)
        if self.kind == "bool":
            return Field(name=self.name, bit_width=1, note=note)
        whole = self.scale == 1 and not self.offset and self.kind[0] != "f"
        if not whole:
            return Field(name=self.name, bit_width=0, kind=FieldKind.NUMBER, unit=self.unit, note=note)
        kind = FieldKind.INT if self.kind[0] == "i" else FieldKind.UINT
        return Field(name=self.name, bit_width=16 * self.count, kind=kind, unit=self.unit, note=note)

    def read(self, units: Sequence[int]) -> int | float | str:
        """Return the value of its registers, or of its bit."""
        if self.kind == "bool":
            return units[0]
        data = b"".join(unit.to_bytes(2, "big") for unit in (reversed(units) if self.low_first else units))
        if self.kind == "string":
            return printable(data.split(b"\0", 1)[0].decode("utf-8", "replace").rstrip())
        number: int | float = struct.unpack(">" + NUMBERS[self.kind], data)[0]
        if self.scale == 1 and not self.offset:
            return number
        if isinstance(number, int):
            return float(number * self.scale + self.offset)
        return number * float(self.scale) + float(self.offset)


class _Named:
    """The values of one table, and how bits or registers from an address on become their values."""

    def __init__(self, table: Table, values: Iterable[Value] | None) -> None:
        self._of_bits = table.of_bits
        self._values = None if values is None else sorted((v for v in values if v.table is table), key=lambda v: v.address)
        self._starts = [v.address for v in self._values or ()]

    @property
    def fields(self) -> tuple[Field, ...]:
        if self._values is None:
            return (Field(name="values", bit_width=0, kind=FieldKind.NUMBERS, note="in the order of their addresses"),)
        unmapped = Field(name="unmapped", bit_width=0, kind=FieldKind.TEXT, note="what has no name, or is not here whole")
        return (*(v.field for v in self._values), unmapped)

    def read(self, first: int, units: Sequence[int]) -> dict[str, Any]:
        if self._values is None:
            return {"values": list(units)}
        result: dict[str, Any] = {}
        stop, at = first + len(units), first
        left: list[int] = []
        for value in self._values[bisect_left(self._starts, first) : bisect_left(self._starts, stop)]:
            if value.address + value.count <= stop:
                left += range(at, value.address)
                at = value.address + value.count
                result[value.name] = value.read(units[value.address - first : at - first])
        left += range(at, stop)
        if left:
            width = 1 if self._of_bits else 4
            result["unmapped"] = ", ".join(f"0x{n:04X}: {units[n - first]:0{width}X}" for n in left)
        return result


def _units(of_bits: bool, register: int, quantity: int, data: bytes) -> list[int]:
    """Return the registers or the bits behind a byte count. Raises MisfitError where they are not as many as they should be."""
    wanted = (quantity + 7) // 8 if of_bits else 2 * quantity
    if data[0] != wanted or len(data) != wanted + 1:
        what = counted(quantity, "bit" if of_bits else "register")
        raise MisfitError("wrong_length", f"{what} from 0x{register:04X}: expected {wanted} bytes, got {len(data) - 1}")
    own = data[1:]
    if of_bits:
        return [own[n >> 3] >> (n & 7) & 1 for n in range(quantity)]
    return [own[n] << 8 | own[n + 1] for n in range(0, wanted, 2)]


def _place(data: bytes) -> tuple[int, int]:
    return data[0] << 8 | data[1], data[2] << 8 | data[3]


def _read_many(named: _Named, of_bits: bool) -> Callable[[bytes], dict[str, Any]]:
    """Return what reads a register, a quantity, a byte count and that many bytes."""

    def read(data: bytes) -> dict[str, Any]:
        register, quantity = _place(data)
        return {"register": register, "quantity": quantity} | named.read(
            register, _units(of_bits, register, quantity, data[4:])
        )

    return read


def _read_one(named: _Named, of_bits: bool) -> Callable[[bytes], dict[str, Any]]:
    """Return what reads a register and the value that is written to it."""

    def read(data: bytes) -> dict[str, Any]:
        register, value = _place(data)
        if of_bits:
            if data[2:] not in _COILS:
                raise MisfitError("unknown_choice", f"coil: got 0x{value:04X}, expected 0xFF00 or 0x0000")
            value = _COILS[data[2:]]
        return {"register": register} | named.read(register, [value])

    return read


def _echoed(read: Callable[[bytes], dict[str, Any]]) -> Callable[[bytes], dict[str, Any]]:
    """Return what reads a reply that repeats the first four bytes of its request, behind that request."""

    def read_reply(data: bytes) -> dict[str, Any]:
        asked, told = data[:4], data[-4:]
        if asked != told:
            raise MisfitError("wrong_length", f"expected {asked.hex(' ').upper()} once more, got {told.hex(' ').upper()}")
        return read(told)

    return read_reply


def _command(function: int, about: tuple[str, Table, str, str], request: Layout, reply: Layout) -> Command:
    name, _, section, summary = about
    risk = Risk.READ if function in _READS else Risk.UNKNOWN
    return Command(
        name=name, verb=Verb.OTHER, code=0, function=function, section=section, summary=summary, risk=(always(risk),),
        request=request, reply=(Form(reply, "reply", needs_request=True, after_request=True),),
    )  # fmt: skip


def commands(values: Sequence[Value] | None) -> tuple[Command, ...]:
    """Return the commands of a slave. `values`: its list, None where there is none."""
    register, quantity = u16("register"), u16("quantity")
    named = {table: _Named(table, values) for table in Table}
    result = []
    for function, about in _READS.items():
        own, of_bits = named[about[1]], about[1].of_bits
        reply = ReadLayout(register, quantity, *own.fields, reader=_read_many(own, of_bits), shortest=5)
        result.append(_command(function, about, Layout(register, quantity), reply))
    for function, about in _WRITES.items():
        own = named[about[1]]
        read = _read_one(own, about[1].of_bits)
        fields = (register, *own.fields)
        request = ReadLayout(*fields, reader=read, shortest=4)
        result.append(_command(function, about, request, ReadLayout(*fields, reader=_echoed(read), shortest=8)))
    for function, about in _MANY.items():
        own, of_bits = named[about[1]], about[1].of_bits
        request = ReadLayout(register, quantity, *own.fields, reader=_read_many(own, of_bits), shortest=5)
        answer = _echoed(lambda data: dict(zip(("register", "quantity"), _place(data), strict=True)))
        result.append(_command(function, about, request, ReadLayout(register, quantity, reader=answer, shortest=9)))
    return tuple(result)


def slave(name: str, title: str, manual: str, units: Iterable[int] = (), values: Sequence[Value] | None = None) -> Dialect:
    """Return the dialect of slaves at some addresses (none: any), of which `values` is the list (None: there is none)."""
    return Dialect(
        name=name,
        title=title,
        manual=manual,
        bus="serial",
        link=ModbusSlaveLink(units=frozenset(units)),
        commands=commands(values),
        addresses=(1, 247),
        broadcast=0,
        fallbacks=FALLBACKS,
        exception=EXCEPTION,
        of_drives=False,
    )


DIALECT = slave("modbus", "Modbus-RTU slave", _MANUAL)
