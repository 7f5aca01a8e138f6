"""Rules by which hosts make the check of a frame, and which are none of the drives'."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import NamedTuple

from analyzer.link.modbus import modbus_crc


class Rule(NamedTuple):
    """A way to compute a check: of a frame without its check and its CAN identifier, the bytes that it appends."""

    name: str
    cause: str
    of: Callable[[bytes, int], bytes]

    @property
    def strong(self) -> bool:
        """Whether one frame is evidence: a CRC of 16 bits; the high byte of a sum is mostly 0, and a lost bit is any."""
        return len(self.of(b"\1\2\3", 0)) > 1 and "sum" not in self.name and self.cause != "wrong_parity"


def _byte(value: int) -> bytes:
    return bytes((value & 0xFF,))


def _crc16(data: bytes, value: int, poly: int) -> int:
    """Return a CRC of 16 bits that shifts to the left."""
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1 ^ (poly if value & 0x8000 else 0)) & 0xFFFF
    return value


def _turned(data: bytes, value: int, poly: int) -> int:
    """Return a CRC of 16 bits that shifts to the right, as that of Modbus does. `poly`: with its bits turned round."""
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (poly if value & 1 else 0)
    return value


def _crc8(data: bytes) -> int:
    value = 0
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = (value << 1 ^ (0x07 if value & 0x80 else 0)) & 0xFF
    return value


def _seven(crc: int) -> bytes:
    return bytes((crc & 0x7F, crc >> 8 & 0x7F))


def _xor(data: bytes) -> int:
    return reduce(int.__xor__, data, 0)


_RULE = "wrong_checksum_rule"
#: Rules that people take instead of the right one, the commonest first.
RULES = (
    Rule("the CRC with its bytes swapped", "crc_swapped", lambda b, i: modbus_crc(b).to_bytes(2, "big")),
    Rule("the sum without the head byte", _RULE, lambda b, i: _byte(sum(b[1:]))),
    Rule("the sum without the CAN identifier", _RULE, lambda b, i: _byte(sum(b))),
    Rule("the XOR of all bytes", _RULE, lambda b, i: _byte(_xor(b))),
    Rule("the sum of all bytes, in 8 bits", _RULE, lambda b, i: _byte(sum(b) + i)),
    Rule("a Modbus CRC", _RULE, lambda b, i: modbus_crc(b).to_bytes(2, "little")),
    Rule("the CRC without the address", _RULE, lambda b, i: modbus_crc(b[1:]).to_bytes(2, "little")),
    Rule("the CRC without the address, high byte first", _RULE, lambda b, i: modbus_crc(b[1:]).to_bytes(2, "big")),
    Rule("the CRC of address and function alone", _RULE, lambda b, i: modbus_crc(b[:2]).to_bytes(2, "little")),
    Rule("the sum without head and address", _RULE, lambda b, i: _byte(sum(b[2:]))),
    Rule("the XOR without the head byte", _RULE, lambda b, i: _byte(_xor(b[1:]))),
    Rule("the XOR with the CAN identifier", _RULE, lambda b, i: _byte(_xor(b) ^ i ^ i >> 8)),
    Rule("the two's complement of the sum", _RULE, lambda b, i: _byte(-sum(b) - i)),
    Rule("the inverted sum", _RULE, lambda b, i: _byte(~(sum(b) + i))),
    Rule("a CRC-8", _RULE, lambda b, i: _byte(_crc8(b))),
    Rule("the CRC begun with 0 instead of FFFF", _RULE, lambda b, i: _turned(b, 0, 0xA001).to_bytes(2, "little")),
    Rule("a CRC-16/CCITT", _RULE, lambda b, i: _crc16(b, 0xFFFF, 0x1021).to_bytes(2, "big")),
    Rule("a CRC-16/CCITT, low byte first", _RULE, lambda b, i: _crc16(b, 0xFFFF, 0x1021).to_bytes(2, "little")),
    Rule("a CRC-16/XMODEM", _RULE, lambda b, i: _crc16(b, 0, 0x1021).to_bytes(2, "big")),
    Rule("a CRC-16/MCRF4XX", _RULE, lambda b, i: _turned(b, 0xFFFF, 0x8408).to_bytes(2, "little")),
    Rule("a CRC-16/X-25", _RULE, lambda b, i: (_turned(b, 0xFFFF, 0x8408) ^ 0xFFFF).to_bytes(2, "little")),
    Rule("a CRC-16/KERMIT", _RULE, lambda b, i: _turned(b, 0, 0x8408).to_bytes(2, "little")),
    Rule("a CRC-16/USB", _RULE, lambda b, i: (modbus_crc(b) ^ 0xFFFF).to_bytes(2, "little")),
    Rule("a CRC-16/CMS", _RULE, lambda b, i: _crc16(b, 0xFFFF, 0x8005).to_bytes(2, "big")),
    Rule("a CRC-16/UMTS", _RULE, lambda b, i: _crc16(b, 0, 0x8005).to_bytes(2, "big")),
    Rule("the right CRC with bit 7 of its bytes lost", "wrong_parity", lambda b, i: _seven(modbus_crc(b))),
    Rule("the sum of all bytes in 16 bits", _RULE, lambda b, i: (sum(b) & 0xFFFF).to_bytes(2, "big")),
    Rule("the sum of all bytes in 16 bits, low byte first", _RULE, lambda b, i: (sum(b) & 0xFFFF).to_bytes(2, "little")),
)


def _sum(data: bytes) -> bytes:
    return _byte(sum(data))


#: Rules for frames whose head has a check of its own: of the head without it and of the data, the whole frame.
_OF_TWO: tuple[tuple[str, Callable[[bytes, bytes], bytes]], ...] = (
    ("one sum over all bytes, and none behind the head", lambda h, d: h + d + _sum(h + d)),
    ("one sum over the data, and none behind the head", lambda h, d: h + d + _sum(d)),
    ("the sum of all bytes at its end", lambda h, d: h + _sum(h) + d + _sum(h + _sum(h) + d)),
    ("the sum of all bytes but the head's own sum at its end", lambda h, d: h + _sum(h) + d + _sum(h + d)),
    ("the sum of the data behind its head", lambda h, d: h + _sum(d) + d + _sum(d)),
    ("the sum of all bytes behind its head", lambda h, d: h + _sum(h + d) + d + _sum(d)),
    ("the sum of the head without its first byte", lambda h, d: h + _sum(h[1:]) + d + _sum(d)),
    ("one sum over the head, and none behind the data", lambda h, d: h + _sum(h) + d),
    ("the XOR of all bytes at its end", lambda h, d: h + _sum(h) + d + _byte(_xor(h + _sum(h) + d))),
    ("the XOR of the data at its end", lambda h, d: h + _sum(h) + d + _byte(_xor(d))),
    ("the inverted sums of head and data", lambda h, d: h + _byte(~sum(h)) + d + _byte(~sum(d))),
    ("the two's complements of both sums", lambda h, d: h + _byte(-sum(h)) + d + _byte(-sum(d))),
    ("the XOR of head and data", lambda h, d: h + _byte(_xor(h)) + d + _byte(_xor(d))),
)
RULES_OF_TWO = tuple((Rule(name, _RULE, lambda b, i: b""), whole) for name, whole in _OF_TWO)
ORDER = {rule: at for at, rule in enumerate((*RULES, *(rule for rule, _ in RULES_OF_TWO)))}
