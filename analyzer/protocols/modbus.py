"""Shared by every Modbus dialect: standard functions on registers that no manual lists, and exception replies.

    read     address, function | register, quantity      reply: byte count, registers
    write    address, function | register, value         reply: the same
    many     address, function | register, quantity, byte count, registers    reply: register, quantity

Source: Modbus Application Protocol V1.1b3, sections 6 and 7. These commands are fallbacks: they stand for a use of a
function that the dialect's manual does not list, so such frames keep their registers and values.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

from analyzer.catalogue import Command, Form, Replies, Risk, Verb, always
from analyzer.layout import Layout, rest, u8, u16


class ModbusException(IntEnum):
    """Exception codes of the standard."""

    ILLEGAL_FUNCTION = 1
    ILLEGAL_DATA_ADDRESS = 2
    ILLEGAL_DATA_VALUE = 3
    SERVER_DEVICE_FAILURE = 4
    ACKNOWLEDGE = 5
    SERVER_DEVICE_BUSY = 6
    MEMORY_PARITY_ERROR = 8
    GATEWAY_PATH_UNAVAILABLE = 10
    GATEWAY_TARGET_FAILED = 11


EXCEPTION = Form(Layout(u8("exception", choices=ModbusException)), name="exception")

_REGISTER = u16("register")
_QUANTITY = u16("quantity")


def _fallback(name: str, function: int, summary: str, risk: Risk, request: Layout, reply: Layout) -> Command:
    return Command(
        name=name,
        verb=Verb.OTHER,
        code=-1,
        function=function,
        section="Modbus",
        summary=summary,
        risk=(always(risk),),
        request=request,
        reply=reply,
        replies=Replies(),
    )


def _read(function: int) -> Command:
    return _fallback(
        "unknown_read",
        function,
        "read of registers that the manual does not list",
        Risk.READ,
        Layout(_REGISTER, _QUANTITY),
        Layout(u8("byte_count"), rest("registers")),
    )


def _write(function: int) -> Command:
    return _fallback(
        "unknown_write",
        function,
        "write of a register that the manual does not list",
        Risk.UNKNOWN,
        Layout(_REGISTER, u16("value")),
        Layout(_REGISTER, u16("value")),
    )


def _write_many(function: int) -> Command:
    return _fallback(
        "unknown_write_many",
        function,
        "write of registers that the manual does not list",
        Risk.UNKNOWN,
        Layout(_REGISTER, _QUANTITY, u8("byte_count"), rest("registers")),
        Layout(_REGISTER, _QUANTITY),
    )


FALLBACKS: Mapping[int, Command] = {
    **{f: _read(f) for f in (0x01, 0x02, 0x03, 0x04)},
    **{f: _write(f) for f in (0x05, 0x06)},
    **{f: _write_many(f) for f in (0x0F, 0x10)},
}
