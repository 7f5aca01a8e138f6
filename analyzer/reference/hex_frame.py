"""One frame from text: hex bytes as people paste them, and the two common notations of a CAN frame.

    FA 01 F6 01 40 02 34        blanks, commas, colons, dashes, semicolons or nothing between the bytes
    0xFA, 0x01, 0xF6            C and Python; brackets and braces around them; \\xFA\\x01; FAh 01h
    001#F60140023A              candump and cansend: identifier # data; a time and an interface may stand before
    can0  001   [6]  F6 01 40   candump on a terminal
    001 F6 01 40 02 3A          identifier of three digits, then data bytes

Plain bytes may also be a CAN frame, identifier first: who reads them decides. Digits without a partner are an error, never
a guess, unless separators or `0x` show that a byte was meant (`FA 1 F6`).
"""

from __future__ import annotations

import re
from typing import NamedTuple

from analyzer.errors import UnreadableError
from analyzer.values import CAN_ID_LIMIT, quote

#: The longest frame of any bus here is one of Modbus (256); text for many more bytes is no frame.
LONGEST = 512
LONGEST_TEXT = 16 * LONGEST
_LONGEST_CAN_TEXT = 256
CAN_DATA_LIMIT = 8

_SEPARATORS = re.compile(r"[\s,;:_\-\[\](){}]+")
_TOKEN = re.compile(r"(?:0[xX]|\\x|\$)?([0-9a-fA-F]+)[hH]?")
_CAN_HASH = re.compile(r"(?:\([^()]*\)\s*)?(?:[\w.\-]+\s+)?([0-9a-fA-F]+)(#{1,2})([0-9a-fA-FRr.\s]*?)(?:\s+[TR])?")
_CAN_DUMP = re.compile(r"(?:\([^()]*\)\s*)?[\w.\-]+\s+([0-9a-fA-F]{3}|[0-9a-fA-F]{8})\s+\[(\d+)\]((?:\s+[0-9a-fA-F]{2})*)")


class Given(NamedTuple):
    """What a text says. `can_id` None: bytes of which it does not say that they are a CAN frame."""

    data: bytes
    can_id: int | None = None


def read_frame(text: str) -> Given:
    """Return the bytes that a text means.

    Raises UnreadableError that says what was expected and what was got.
    """
    text = text.strip()
    if not text:
        raise UnreadableError("expected the hex bytes of a frame, got nothing")
    if len(text) > LONGEST_TEXT:
        raise UnreadableError(f"expected a frame of at most {LONGEST} bytes, got {quote(text, 20)}")
    if len(text) > _LONGEST_CAN_TEXT:
        return _plain(text)
    dump = _CAN_DUMP.fullmatch(text)
    if dump is not None:
        given = _can(dump[1], dump[3], text)
        if len(given.data) != int(dump[2][:4]):
            raise UnreadableError(f"expected [{dump[2][:4]}] data bytes, got {len(given.data)} in {quote(text)}")
        return given
    if "#" in text:
        frame = _CAN_HASH.fullmatch(text)
        if frame is None:
            raise UnreadableError(f"expected a CAN frame as 001#F60140023A, got {quote(text)}")
        if frame[2] == "##":
            raise UnreadableError(f"expected a CAN 2.0 frame, got a CAN FD frame: {quote(text)}")
        if frame[3][:1] in ("R", "r"):
            raise UnreadableError(f"expected a data frame, got a remote frame: {quote(text)}")
        return _can(frame[1], frame[3].replace(".", ""), text)
    return _plain(text)


def _can(identifier: str, digits: str, text: str) -> Given:
    can_id = int(identifier, 16)
    if len(identifier) > 4:
        known = f"0x{can_id:08X} has 29 bits: another node's, for drives have 11"
        raise UnreadableError(f"expected an identifier of 11 bits in three digits, got {quote(text)}: {known}")
    if len(identifier) > 3 or can_id > CAN_ID_LIMIT:
        raise UnreadableError(f"expected an identifier of 11 bits in three digits, got {identifier} in {quote(text)}")
    data = _bytes(digits, text) if digits.strip() else b""
    if len(data) > CAN_DATA_LIMIT:
        raise UnreadableError(f"expected at most {CAN_DATA_LIMIT} data bytes in a CAN frame, got {len(data)}")
    return Given(data, can_id)


def _plain(text: str) -> Given:
    text = re.sub(r"^b?['\"](.*)['\"]$", r"\1", text).replace("\\x", " \\x")
    tokens = [t for t in _SEPARATORS.split(text) if t]
    if not tokens:
        raise UnreadableError(f"expected the hex bytes of a frame, got {quote(text)}")
    first = _TOKEN.fullmatch(tokens[0])
    if first is not None and len(first[1]) == 3 and len(tokens) > 1:
        return _can(first[1], " ".join(tokens[1:]), text)
    return Given(_bytes(text, text))


def _bytes(digits: str, text: str) -> bytes:
    tokens = [t for t in _SEPARATORS.split(digits) if t]
    result = bytearray()
    for token in tokens:
        match = _TOKEN.fullmatch(token)
        if match is None:
            raise UnreadableError(f"expected hex bytes, got {quote(token, 20)} in {quote(text)}")
        found = match[1]
        if len(found) % 2:
            alone = len(found) > 1 or (len(tokens) == 1 and found == token)
            if alone:
                raise UnreadableError(f"expected two digits a byte, got {len(found)} digits in {quote(token, 20)}")
            found = "0" + found
        result += bytes.fromhex(found)
    if len(result) > LONGEST:
        raise UnreadableError(f"expected a frame of at most {LONGEST} bytes, got {len(result)}")
    return bytes(result)


def write_frame(data: bytes, can_id: int | None = None, *, candump: bool = False) -> str:
    """Return a frame as text that `read_frame` reads: hex with blanks; CAN: identifier first, or `001#F60140023A`."""
    if can_id is None:
        return data.hex(" ").upper()
    if candump:
        return f"{can_id:03X}#{data.hex().upper()}"
    identifier = f"{can_id:02X}" if can_id <= 0xFF else f"{can_id:03X}"
    return f"{identifier} {data.hex(' ').upper()}".rstrip()
