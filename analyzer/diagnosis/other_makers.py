"""Frames of motors that are not known here: each make is told by a head, a length or a check of its own."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import reduce
from operator import xor
from typing import NamedTuple

from analyzer.catalogue import Role
from analyzer.diagnosis.scene import Confidence, Scene, Shown, Suspicion, Trouble, shown
from analyzer.link.modbus import modbus_crc
from analyzer.values import counted

#: Different frames of a make that are no chance beside known ones.
_BESIDE = 3
#: The share of the damaged sendings that have to be of one make.
_SHARE = 0.6


class Make(NamedTuple):
    """A make of motors. `is_frame`: whether a sending is one of its frames; `least`: how many different ones tell.

    One where a check is its own; more where it has none.
    """

    name: str
    is_frame: Callable[[bytes], bool]
    least: int
    next: str


#: Codes of the older closed-loop steppers of MKS, without the address.
_CODES_42C = frozenset(bytes.fromhex("30 33 36 39 3A 3D 3E F3 F6 F7 FD FF")) | {
    *range(0x80, 0x8C), *range(0x90, 0x95), *range(0xA1, 0xA6),
}  # fmt: skip
#: Bytes of its requests with their sum, and how many different ones tell.
_HEADS_42C, _LEAST_42C = range(0xE0, 0xEA), 2
_REQUESTS_42C = {
    **dict.fromkeys(bytes.fromhex("30 33 36 39 3A 3D 3E 3F F7"), 3),
    **dict.fromkeys(bytes.fromhex("80 81 82 83 84 85 86 87 88 89 8A 8B 90 91 92 93 94 F3 F6 FF"), 4),
    **dict.fromkeys(bytes.fromhex("A1 A2 A3 A4 A5"), 5), 0xFD: 8,
}  # fmt: skip
#: Codes of RMD motors.
CODES_RMD = frozenset((32, *range(0x30, 0x35), *range(0x60, 0x66), *range(0x76, 0x82), *range(0x8F, 0x95), *range(0x9A, 0xB7)))
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
    return len(data) == 13 and data[0] == 0x3E and data[2] == 8 and data[3] in CODES_RMD and modbus_crc(data) == 0


def _vesc(data: bytes) -> bool:
    return len(data) >= 6 and data[0] == 2 and data[1] == len(data) - 5 and data[-1] == 3


def _tmcl(data: bytes) -> bool:
    return len(data) == 9 and data[0] < 0x20 and sum(data[:-1]) & 0xFF == data[-1] and any(data[4:8])


_ASCII = re.compile(rb":((?:[0-9A-F]{2}){3,})\r?\n?")
#: The end of a frame, in a log that does not begin with one.
_ASCII_END = re.compile(rb"(?:[0-9A-F]{2}){2,}\r?\n")


def _modbus_ascii(data: bytes) -> bool:
    whole = _ASCII.fullmatch(data)
    return sum(bytes.fromhex(whole[1].decode())) & 0xFF == 0 if whole is not None else _ASCII_END.fullmatch(data) is not None


def _jbd(data: bytes) -> bool:
    size = len(data)
    whole = size >= 7 and data[0] == 0xDD and data[-1] == 0x77 and data[3] == size - 7
    return whole and (sum(data[2:-3]) + int.from_bytes(data[-3:-1], "big")) & 0xFFFF == 0


def _jk(data: bytes) -> bool:
    return len(data) > 10 and data[:2] == b"NW" and int.from_bytes(data[2:4], "big") == len(data) - 2


def _daly(data: bytes) -> bool:
    """Say whether bytes are frames of thirteen, as a host reads several at once."""
    rows = [data[at : at + 13] for at in range(0, len(data), 13)]
    return bool(rows) and all(
        len(row) == 13 and row[0] == 0xA5 and row[3] == 8 and sum(row[:-1]) & 0xFF == row[-1] for row in rows
    )


def _m_bus(data: bytes) -> bool:
    size = len(data)
    if size == 5 and data[0] == 0x10:
        return data[-1] == 0x16 and sum(data[1:3]) & 0xFF == data[3]
    whole = size >= 9 and data[0] == data[3] == 0x68 and data[1] == data[2] == size - 6
    return whole and data[-1] == 0x16 and sum(data[4:-2]) & 0xFF == data[-2]


def _meter(data: bytes) -> bool:
    return len(data) >= 12 and data[0] == data[7] == 0x68 and data[-1] == 0x16 and sum(data[:-2]) & 0xFF == data[-2]


def _tpkt(data: bytes) -> bool:
    return (
        len(data) > 7 and data[:2] == b"\x03\x00" and int.from_bytes(data[2:4], "big") == len(data) and data[4] == len(data) - 5
    )


def _bacnet(data: bytes) -> bool:
    """Say whether bytes begin as BACnet MS/TP: preamble and a type, then a head of eight bytes whose check fits."""
    if len(data) < _PREAMBLE or data[:2] != b"\x55\xff" or data[2] > _LAST_TYPE:
        return False
    crc = 0xFF
    for byte in data[2:_MSTP_HEAD]:
        value = crc ^ byte
        for shift in range(1, 8):
            value ^= (crc ^ byte) << shift
        crc = value & 0xFE ^ value >> 8 & 1
    return len(data) < _MSTP_HEAD or crc == _MSTP_GOOD


def _hart(data: bytes) -> bool:
    """Say whether bytes are a frame of HART: a preamble, a kind, a short or long address, a command, a count, a check."""
    frame = data.lstrip(b"\xff")
    if len(data) - len(frame) < _HART_PREAMBLE or not frame or frame[0] & 0x7F not in _HART_KINDS:
        return False
    count = 7 if frame[0] & 0x80 else 3
    return len(frame) > count and len(frame) == count + frame[count] + 2 and reduce(xor, frame) == 0


#: Of HART: the fewest bytes of its preamble, and its kinds: a burst, a request and a reply.
_HART_PREAMBLE, _HART_KINDS = 2, (1, 2, 6)
#: Of BACnet MS/TP: preamble with the type, its last type, its head with a check, and what that leaves where it fits.
_PREAMBLE, _LAST_TYPE, _MSTP_HEAD, _MSTP_GOOD = 3, 7, 8, 0x55
_TEXT = re.compile(rb"[\x20-\x7e\r\n\t]*[A-Za-z]{4}[\x20-\x7e\r\n\t]*")


def _words(data: bytes) -> bool:
    """Say whether bytes are words: hex digits, as text, are none."""
    return len(data) >= 6 and _TEXT.fullmatch(data) is not None and re.search(rb"[G-Zg-z]", data) is not None


_UART = "its manual has them; the dialects known here are those of `servotap catalogue`"
_LIBRARY, _PROTOCOL = f"Use the library of its maker: {_UART}", f"Use the protocol of its maker: {_UART}"
_SERVICE = f"Look for the port that speaks Modbus (TCP 502), or switch it on: {_UART}"
MAKES = (
    Make("an MKS SERVO42C (heads E0 to E9)", _mks_42c, 1, "The SERVO42D and 57D have the heads FA and FB; " + _UART),
    Make("an MKS SERVO42C of firmware 1.0 (heads E0 to E9)", _mks_42c_plain, 3, "Newer firmware has a sum; " + _UART),
    Make("an Emm or ZDT stepper (a last byte 6B)", _fixed_end, 4, _PROTOCOL),
    Make("a Dynamixel or Feetech servo (FF FF)", _two_ff, 1, _LIBRARY),
    Make("a Dynamixel servo of protocol 2 (FF FF FD 00)", _ff_ff_fd, 1, _LIBRARY),
    Make("a bus servo of Hiwonder or LewanSoul (55 55)", _two_55, 1, _LIBRARY),
    Make("an RMD motor on RS485 (3E, a count of 8, a CRC)", _rmd, 1, "LK motors have sums and no CRC: " + _UART),
    Make("a VESC (02 ... 03)", _vesc, 4, "Use its own tool: " + _UART),
    Make("a Trinamic module (TMCL, nine bytes)", _tmcl, 4, "Use its own library: " + _UART),
    Make("a battery (7E ... 0D)", lambda data: len(data) >= 6 and data[0] == 0x7E and data[-1] == 0x0D, 2, _PROTOCOL),
    Make("a battery of JBD (DD ... 77)", _jbd, 1, _PROTOCOL),
    Make("a battery of JK (4E 57)", _jk, 1, _PROTOCOL),
    Make("a battery of Daly (A5, thirteen bytes)", _daly, 1, _PROTOCOL),
    Make("an electricity meter (68 ... 68 ... 16)", _meter, 1, _PROTOCOL),
    Make("a meter on M-Bus (10 ... 16, 68 ... 16)", _m_bus, 1, _PROTOCOL),
    Make("BACnet MS/TP (55 FF)", _bacnet, 1, "Switch the device to Modbus, if it has both; else use a BACnet tool"),
    Make("a HART transmitter (FF FF ... 02 or 82)", _hart, 1, "Use a HART tool and its modem; " + _UART),
    Make("a controller of Omron (FINS)", lambda data: data.startswith(b"FINS") and len(data) >= 8, 1, _SERVICE),
    Make("a controller of Siemens (S7, which begins a connection by 03 00)", _tpkt, 1, _SERVICE),
    Make("Modbus ASCII", _modbus_ascii, 1, "Set both sides to Modbus RTU"),
)


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect a motor that is not known here."""
    yield from _console(scene)
    yield from _sums_of_42c(scene)
    damaged = [(t, t.stretch.data) for t in scene.damaged if t.stretch is not None and t.stretch.can_id is None]
    sent = list(damaged)
    known = False
    for piece in scene.pieces:
        if piece.sound and piece.can is None and piece.message is not None:
            known |= piece.message.command not in piece.message.frame.dialect.fallbacks.values()
            sent.append((Trouble("damaged", piece.offset, None, piece), piece.data))
    asked = [data for t, data in damaged if t.stretch is not None and t.stretch.direction is Role.REQUEST]
    heard = [data for t, data in sent if scene.direction(t.offset) is Role.REPLY]
    for make in MAKES:
        found = [(trouble, data) for trouble, data in sent if make.is_frame(data)]
        different = len({data for _, data in found})
        # Where all that the host sends is of a make, the replies are, too, also damaged ones.
        spoken = len(sent) == len(damaged) and bool(asked) and all(make.is_frame(data) for data in asked)
        # Beside frames that are known a check is needed, and several that have it.
        least = make.least - 2 * spoken if not known else _BESIDE if make.least == 1 else len(sent) + 1
        # All that comes may be of a make, while the host speaks another protocol to it.
        answers = bool(heard) and all(make.is_frame(data) for data in heard)
        if not found or different < least or (len(found) < _SHARE * len(sent) and not spoken and not answers):
            continue
        first, data = found[0]
        # A list of a program may be right for its own drive.
        confidence = Confidence.POSSIBLE if scene.listed else Confidence.LIKELY
        yield Suspicion(
            "unsupported_dialect", confidence, [t for t, _ in (damaged if spoken else found)],
            f"These are frames of {make.name}, a dialect that is not known here.",
            f"{shown(data)} at byte {first.offset}; {counted(len(found), 'frame')} like it",
            make.next,
            tuple(Shown(t.offset, shown(d)) for t, d in found),
        )  # fmt: skip
        return


def _sums_of_42c(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the sums of the requests to an MKS SERVO42C, where none is right: wrong ones, or none at all."""
    alone = [
        t for t in scene.damaged if t.stretch is not None and t.stretch.opens and t.stretch.ends and t.stretch.can_id is None
    ]
    of_42c = [(t, t.stretch.data) for t in alone if t.stretch is not None and t.stretch.data[0] in _HEADS_42C]
    if any(_mks_42c(data) for _, data in of_42c):
        return
    heard = [data for t, data in of_42c if t.stretch is not None and t.stretch.direction is Role.REPLY]
    sent = [(t, data, _REQUESTS_42C.get(data[1], 0)) for t, data in of_42c if data not in heard and len(data) > 1]
    wrong = [(t, data, data[:-1]) for t, data, size in sent if len(data) == size]
    missing = [(t, data, data) for t, data, size in sent if len(data) == size - 1]
    # A motor whose firmware has no sums answers without one.
    for found, cause, what in ((wrong, "wrong_checksum", "a sum that is not right"), (missing, "missing_checksum", "no sum")):
        if len({data for _, data, _ in found}) < _LEAST_42C or len(found) < len(sent) or heard:
            continue
        rights = [body + bytes((sum(body) & 0xFF,)) for _, _, body in found]
        first, data, _ = found[0]
        yield Suspicion(
            cause, Confidence.CERTAIN, [t for t, _, _ in found],
            f"The requests are those of an MKS SERVO42C, and have {what} at their end.",
            f"{shown(data)} at byte {first.offset}; right is {shown(rights[0])}; {counted(len(found), 'time')}",
            f"Put the sum of all bytes behind each: send {shown(rights[0])}; only firmware 1.0 has none",
            tuple(Shown(t.offset, shown(d), shown(right)) for (t, d, _), right in zip(found, rights, strict=True)),
        )  # fmt: skip
        return


def _console(scene: Scene) -> Iterator[Suspicion]:
    """Suspect a console or another service where all that comes is words, and frames were sent."""
    heard = [t for t in scene.damaged if t.stretch is not None and t.stretch.direction is Role.REPLY]
    read = any(p.sound for p in scene.pieces if scene.direction(p.offset) is Role.REPLY)
    if read or not heard or not all(t.stretch is not None and _words(t.stretch.data) for t in heard):
        return
    first = heard[0]
    assert first.stretch is not None  # chosen so above
    yield Suspicion(
        "unsupported_dialect", Confidence.LIKELY, scene.troubles,
        f"Words come back, no frames: {first.stretch.data.decode('ascii').strip()!r} is of a console or another service.",
        f"{shown(first.stretch.data)} at byte {first.offset}; {counted(len(heard), 'time')}",
        "Look for the right port: of a TCP gateway its own port for raw bytes or for Modbus, of a board the UART of the bus",
        (Shown(first.offset, shown(first.stretch.data)),),
    )  # fmt: skip
