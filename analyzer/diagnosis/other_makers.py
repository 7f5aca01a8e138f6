"""Frames of motors that are not known here: each make is told by a head, a length or a check of its own."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import NamedTuple

from analyzer.diagnosis.scene import Confidence, Scene, Shown, Suspicion, Trouble, shown
from analyzer.link.modbus import modbus_crc
from analyzer.values import counted

#: Different frames of a make without a check from which on they are no chance.
_ENOUGH = 3
#: The share of the damaged sendings that have to be of one make.
_SHARE = 0.6


class Make(NamedTuple):
    """A make of motors. `is_frame`: whether a sending is one of its frames; `sure`: by a check, so that two tell."""

    name: str
    is_frame: Callable[[bytes], bool]
    sure: bool
    next: str


#: Codes of the older closed-loop steppers of MKS, without the address.
_CODES_42C = frozenset(bytes.fromhex("30 33 36 39 3A 3D 3E F3 F6 F7 FD FF")) | {
    *range(0x80, 0x8C), *range(0x90, 0x95), *range(0xA1, 0xA6),
}  # fmt: skip
#: Codes of RMD motors.
_CODES_RMD = frozenset((32, *range(0x30, 0x35), *range(0x60, 0x66), *range(0x76, 0x82), *range(0x8F, 0x95), *range(0x9A, 0xB7)))
_SHORT = 9


def _mks_42c(data: bytes) -> bool:
    return 2 < len(data) <= _SHORT and 0xE0 <= data[0] <= 0xE9 and sum(data[:-1]) & 0xFF == data[-1]


def _mks_42c_plain(data: bytes) -> bool:
    return 2 <= len(data) < _SHORT and 0xE0 <= data[0] <= 0xE9 and (data[1] in _CODES_42C or data[1] <= 2)


def _fixed_end(data: bytes) -> bool:
    return 3 <= len(data) <= 16 and data[-1] == 0x6B and 0 < data[0] < 0x20


def _two_ff(data: bytes) -> bool:
    size = len(data)
    return size >= 6 and data[:2] == b"\xff\xff" and data[3] == size - 4 and ~sum(data[2:-1]) & 0xFF == data[-1]


def _two_55(data: bytes) -> bool:
    size = len(data)
    return size >= 6 and data[:2] == b"\x55\x55" and data[3] == size - 3 and ~sum(data[2:-1]) & 0xFF == data[-1]


def _ff_ff_fd(data: bytes) -> bool:
    return len(data) >= 10 and data[:4] == b"\xff\xff\xfd\x00" and int.from_bytes(data[5:7], "little") == len(data) - 7


def _rmd(data: bytes) -> bool:
    return len(data) == 13 and data[0] == 0x3E and data[2] == 8 and data[3] in _CODES_RMD and modbus_crc(data) == 0


def _vesc(data: bytes) -> bool:
    return len(data) >= 6 and data[0] == 2 and data[1] == len(data) - 5 and data[-1] == 3


def _tmcl(data: bytes) -> bool:
    return len(data) == 9 and data[0] < 0x20 and sum(data[:-1]) & 0xFF == data[-1] and any(data[4:8])


_ASCII = re.compile(rb":(?:[0-9A-F]{2}){3,}\r\n")


def _modbus_ascii(data: bytes) -> bool:
    return _ASCII.fullmatch(data) is not None and sum(bytes.fromhex(data[1:-2].decode())) & 0xFF == 0


_UART = "its manual has them; the dialects known here are those of `servotap catalogue`"
MAKES = (
    Make("an MKS SERVO42C (heads E0 to E9)", _mks_42c, True, "The SERVO42D and 57D have the heads FA and FB; " + _UART),
    Make("an MKS SERVO42C of firmware 1.0 (heads E0 to E9)", _mks_42c_plain, False, "Newer firmware has a sum; " + _UART),
    Make("an Emm or ZDT stepper (a last byte 6B)", _fixed_end, False, "Use the protocol of its maker: " + _UART),
    Make("a Dynamixel or Feetech servo (FF FF)", _two_ff, True, "Use the library of its maker: " + _UART),
    Make("a Dynamixel servo of protocol 2 (FF FF FD 00)", _ff_ff_fd, True, "Use the library of its maker: " + _UART),
    Make("a bus servo of Hiwonder or LewanSoul (55 55)", _two_55, True, "Use the library of its maker: " + _UART),
    Make("an RMD motor on RS485 (3E, a count of 8, a CRC)", _rmd, True, "LK motors have sums and no CRC: " + _UART),
    Make("a VESC (02 ... 03)", _vesc, False, "Use its own tool: " + _UART),
    Make("a Trinamic module (TMCL, nine bytes)", _tmcl, False, "Use its own library: " + _UART),
    Make("Modbus ASCII", _modbus_ascii, True, "Set both sides to Modbus RTU"),
)


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect a motor that is not known here."""
    sent = [(t, t.stretch.data) for t in scene.damaged if t.stretch is not None and t.stretch.can_id is None]
    for piece in scene.pieces:
        if piece.sound and piece.can is None and piece.message is not None:
            if piece.message.command not in piece.message.frame.dialect.fallbacks.values():
                return
            sent.append((Trouble("damaged", piece.offset, None, piece), piece.data))
    for make in MAKES:
        found = [(trouble, data) for trouble, data in sent if make.is_frame(data)]
        if len({data for _, data in found}) < (1 if make.sure else _ENOUGH) or len(found) < _SHARE * len(sent):
            continue
        first, data = found[0]
        yield Suspicion(
            "unsupported_dialect", Confidence.LIKELY, [t for t, _ in found],
            f"These are frames of {make.name}, a dialect that is not known here.",
            f"{shown(data)} at byte {first.offset}; {counted(len(found), 'frame')} like it",
            make.next,
            tuple(Shown(t.offset, shown(d)) for t, d in found),
        )  # fmt: skip
        return
