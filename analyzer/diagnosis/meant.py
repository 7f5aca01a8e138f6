"""Values of replies that people say are wrong: what was got and what should be, found among the readings of the same bytes.

A reply is sound, and its registers mean nothing to the catalogue. The words have the number that came out, or the one that is
right, or both. Which two readings of the bytes they are tells the cause: another scale, another sign, another order of words or
bytes, or another number of registers.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from itertools import islice, product
from math import isfinite
from typing import NamedTuple

from analyzer.diagnosis.scene import Confidence, Piece, Scene, Shown, Suspicion, Trouble, shown
from analyzer.link import REGISTER_READS, modbus_crc
from analyzer.values import counted

#: Bytes of one register.
_ONE = 2
#: Bytes of the registers of a block, and the digits of a number that is met in one by no chance.
_BLOCK, _TELLING_DIGITS = 16, 3
#: Replies and numbers that are looked at.
_MOST_REPLIES, _MOST_NUMBERS = 20, 40
#: Characters before a number that tell what it is.
_BEFORE = 80
#: How near a number comes to a reading: one that was printed, and one that somebody expects.
_PRINTED, _EXPECTED = 2e-3, 2e-2
_SCALES = (10, 100, 1000)
#: How near a number of many digits comes to its reading, and between what such values are.
_SAME, _PLAUSIBLE = 1e-5, (1e-3, 1e6)
_HUGE = 1e20
#: What comes before the words of a line that has frames: its place and its time; and bytes among words.
_PLACE = re.compile(
    r"^line \d+, columns? [\d, ]+: "
    # A date and a time are digits as bytes are.
    r"|\b(?:\d{4}[-/.]\d\d[-/.]\d\d|\d\d[-/.]\d\d[-/.]\d{4})[ T](?=\d)|(?<![\w:])\d\d?:\d\d:\d\d(?:[.,]\d{1,9})?(?![\w:])"
)
_BYTES = re.compile(
    r"(?<!\w)(?:(?:0x)?[0-9A-Fa-f]{2}(?:[ ,:\]\[<>-]+|$)){3,}|0x[0-9A-Fa-f]+|(?<!\w)(?:[0-9A-Fa-f]{2}){4,}(?!\w)"
)
_NUMBER = re.compile(r"(?<![\w.:/-])-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?(?![\d:x])")
#: Words before a value that is right, and words of a complaint.
_RIGHT = re.compile(
    r"\b(?:instead of|rather than|should|expect\w*|supposed|real(?:ly)?|actual(?:ly)?|correct|true|right|display|meter|screen|"
    r"menu|panel)\b[^.;\n]{0,40}$",
    re.IGNORECASE,
)
COMPLAINT = re.compile(
    r"\b(?:instead|rather than|should|expect\w*|supposed|wrong|too (?:large|high|big|low|small|much)|nonsense|strange|weird|"
    r"odd|garbage|crazy|incorrect|off by|but|hardly|barely|kaum)\b",
    re.IGNORECASE,
)
#: What a program shows, and then what stands on the device.
_COMPARED = re.compile(
    r"\b(?:shows?|gets?|prints?|reads?|returns?|gives?|see)\b[^\n]{0,20}\d[^\n]{0,20}\b(?:meter|display|screen|panel|inverter|device)\b"
    r"[^\n]{0,12}\b(?:shows?|says?|reads?)\b",
    re.IGNORECASE,
)
_FACTOR = re.compile(
    r"\b(?:10|100|1000|ten|hundred|thousand)\s?(?:x|times|-?fold)\s+(?:too|higher|larger|bigger|more|lower|smaller|what|the|as)\b"
    r"|\bfactor (?:of )?(?:10|100|1000|ten|hundred)\b",
    re.IGNORECASE,
)
_NEGATIVE = re.compile(r"\b(?:negative|minus|below zero|signed|two'?s complement)\b", re.IGNORECASE)
_SIXTEEN = re.compile(r"\b(?:u?int_?16|16[ -]?bit|one register|single register|1 register|s16|u16)\b", re.IGNORECASE)
_THIRTY_TWO = re.compile(
    r"(?:\b|_)(?:u?int_?32|32[ -]?bit|float|two registers|2 registers|double word|dword|s32|u32)", re.IGNORECASE
)
_ORDERED = re.compile(r"\b(?:swap\w*|backwards?|endian\w*|(?:byte|word)[ _]?order\w*)\b", re.IGNORECASE)


class Reading(NamedTuple):
    """A number that bytes can be. `order`: of their words and bytes; `size`: how many bytes; `kind`: integer or float."""

    at: int
    size: int
    kind: str
    order: str
    value: float


class _Said(NamedTuple):
    """A number in the words. `right`: the words say that it is the right one; `exact`: it has digits behind the point."""

    value: float
    right: bool
    exact: bool


class _Odd(NamedTuple):
    """A reply whose value is wrong: what it was taken for, and what it is."""

    piece: Piece
    cause: str
    say: str
    todo: str


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect how the host reads the values of replies."""
    words = "\n".join(_BYTES.sub(" ", _PLACE.sub("", line)) for line in scene.words)
    if not words or (scene.noted and COMPLAINT.search(words) is None and _COMPARED.search(words) is None):
        return
    replies = [p for p in scene.pieces if _registers(p)][:_MOST_REPLIES]
    said = _said(words)
    odd = next((odd for piece in replies if (odd := _odd(piece, words, _telling(piece, said))) is not None), None)
    odd = odd or _told(scene, replies, words)
    if odd is None:
        return
    own = [t for t in scene.troubles if t.piece is odd.piece]
    yield Suspicion(
        odd.cause, Confidence.LIKELY, own or [Trouble(odd.cause, odd.piece.offset, None, odd.piece)], odd.say,
        f"{shown(odd.piece.data)} at byte {odd.piece.offset}", odd.todo, (Shown(odd.piece.offset, shown(odd.piece.data)),),
    )  # fmt: skip


def _registers(piece: Piece) -> bytes:
    """Return the registers of a sound Modbus reply; empty where it is none."""
    data = piece.data
    whole = piece.can is None and len(data) > 6 and data[1] in REGISTER_READS and len(data) == data[2] + 5
    return data[3:-2] if whole and modbus_crc(data) == 0 and not data[2] % 2 else b""


def _said(words: str) -> list[_Said]:
    """Return the numbers of the words."""
    found = []
    for row in islice(_NUMBER.finditer(words), _MOST_NUMBERS):
        line = words[max(words.rfind("\n", 0, row.start()) + 1, row.start() - _BEFORE) : row.start()]
        found.append(_Said(float(row[0]), _RIGHT.search(line) is not None, "." in row[0]))
    return found


def _telling(piece: Piece, said: list[_Said]) -> list[_Said]:
    """Return the numbers that tell something of a reply: among many registers a short number is met by chance."""
    if len(_registers(piece)) <= _BLOCK:
        return said
    return [each for each in said if len(f"{abs(each.value):g}".replace(".", "").strip("0")) >= _TELLING_DIGITS]


def _readings(data: bytes) -> Iterator[Reading]:
    """Yield what registers can be."""
    for at in range(0, len(data) - 1, 2):
        word = data[at : at + 2]
        yield Reading(at, 2, "unsigned", "AB", int.from_bytes(word, "big"))
        yield Reading(at, 2, "signed", "AB", int.from_bytes(word, "big", signed=True))
        yield Reading(at, 2, "unsigned", "BA", int.from_bytes(word, "little"))
        four = data[at : at + 4]
        if len(four) < 4:
            continue
        for order in ("ABCD", "CDAB", "BADC", "DCBA"):
            turned = bytes(four["ABCD".index(letter)] for letter in order)
            yield Reading(at, 4, "unsigned", order, int.from_bytes(turned, "big"))
            yield Reading(at, 4, "signed", order, int.from_bytes(turned, "big", signed=True))
            value = struct.unpack(">f", turned)[0]
            if isfinite(value):
                yield Reading(at, 4, "float", order, value)


def _near(number: float, value: float, within: float) -> bool:
    return number == value or (value != 0 and abs(number - value) <= within * abs(value))


def _odd(piece: Piece, words: str, said: list[_Said]) -> _Odd | None:
    """Return what is wrong with the value of a reply, by the numbers of the words."""
    readings = list(_readings(_registers(piece)))
    if not any(s.right for s in said) and any(s.exact and _is_understood(s.value, readings) for s in said):
        return None
    # What libraries make of registers, unless told otherwise.
    plain = [r for r in readings if r.order in ("AB", "ABCD") and (r.kind == "unsigned" or r.kind == "float")]
    got = [r for r in readings if r.value and any(not s.right and _near(s.value, r.value, _PRINTED) for s in said)]
    right = [s.value for s in said if s.right and s.value] or [s.value for s in said if s.value]
    for one in (r for r in plain if r.kind == "float" and not 1 / _HUGE < abs(r.value) < _HUGE):
        # Nobody means a float that is next to nothing, or that huge.
        for value in (s.value for s in said if s.exact):
            if (found := _order(one, value, readings, _PRINTED, words)) is not None:
                return _Odd(piece, *found)
    for rank, within in product(_CAUSES, (_PRINTED, _EXPECTED)):
        for one in got or plain:
            for value in right:
                if not got and not any(s.right and s.value == value for s in said):
                    continue
                if not _near(value, one.value, _PRINTED) and (found := rank(one, value, readings, within, words)):
                    return _Odd(piece, *found)
    return None


def _is_understood(value: float, readings: list[Reading]) -> bool:
    """Say whether a number with many digits is the float that the reply has: a wrong reading gives other digits."""
    within = (
        r.value for r in readings if r.kind == "float" and r.order == "ABCD" and _PLAUSIBLE[0] < abs(r.value) < _PLAUSIBLE[1]
    )
    return len(f"{value:.9g}".replace(".", "")) > _TELLING_DIGITS and any(_near(value, each, _SAME) for each in within)


def _scaled(one: Reading, value: float, readings: list[Reading], within: float, words: str) -> tuple[str, str, str] | None:
    """Return the cause where the value is the same number in another unit."""
    if one.kind == "float" or abs(one.value) < _SCALES[0]:
        return None
    scale = next((k for k in _SCALES if _near(value * k, one.value, within)), 0)
    if not scale:
        return None
    say = f"The register counts in parts of {scale}: {one.value:g} is {one.value / scale:g}."
    return "unit_or_sign", say, f"Divide the value by {scale}, as the manual's column for units says"


def _sign(one: Reading, value: float, readings: list[Reading], within: float, words: str) -> tuple[str, str, str] | None:
    """Return the cause where the value is negative."""
    for other in readings:
        same = (other.at, other.size, other.order) == (one.at, one.size, one.order)
        if (
            same
            and one.kind == "unsigned"
            and other.kind == "signed"
            and other.value < 0
            and _scale(value, other.value, within)
        ):
            say = f"The register is signed: {one.value:g} is {other.value:g} as two's complement."
            return "unit_or_sign", say, f"Read it as a signed number of {8 * one.size} bits"
    return None


def _order(one: Reading, value: float, readings: list[Reading], within: float, words: str) -> tuple[str, str, str] | None:
    """Return the cause where the value is that of the same bytes in another order."""
    if one.size == 4 and one.kind != "float" and _SIXTEEN.search(words) is not None:
        return None
    for other in readings:
        same = (other.at, other.size) == (one.at, one.size) and other.order != one.order
        if same and (other.kind == "float") == (one.kind == "float") and _near(value, other.value, within):
            say = f"The words or bytes of the value stand in another order: {other.order} makes {other.value:g} of them."
            return "wrong_byte_order", say, f"Read it in the order {other.order} (ABCD is the first byte first)"
    return None


def _width(one: Reading, value: float, readings: list[Reading], within: float, words: str) -> tuple[str, str, str] | None:
    """Return the cause where the value has another number of registers."""
    for other in readings:
        inside = other.size != one.size and max(other.at, one.at) < min(other.at + other.size, one.at + one.size)
        plain = other.order in ("AB", "ABCD") or other.kind == "float"
        if inside and plain and other.value and _scale(value, other.value, within):
            registers = counted(other.size // 2, "register")
            say = f"The value has {registers}, and {one.size // 2} were taken for it: {other.value:g} is in the first."
            return "wrong_register", say.replace(" is in the first", " comes out of the right ones"), f"Read {registers} for it"
    return None


def _type(one: Reading, value: float, readings: list[Reading], within: float, words: str) -> tuple[str, str, str] | None:
    """Return the cause where the value is a float and was read as an integer, or the reverse."""
    for other in readings:
        same = (other.at, other.size) == (one.at, one.size) and (other.kind == "float") != (one.kind == "float")
        if same and _near(value, other.value, within):
            kind = "a float" if other.kind == "float" else "an integer"
            say = f"The value is {kind}: in the order {other.order} the bytes are {other.value:g}."
            return "wrong_byte_order" if other.order != one.order else "unit_or_sign", say, f"Read it as {kind}, {other.order}"
    return None


#: What may be wrong, the simplest first.
_CAUSES = (_scaled, _sign, _order, _width, _type)


def _scale(value: float, of: float, within: float) -> bool:
    return any(_near(value * k, of, within) for k in (1, *_SCALES))


def _told(scene: Scene, replies: list[Piece], words: str) -> _Odd | None:
    """Return what the words say themselves, where they have no numbers that fit."""
    if not replies:
        return None
    if _FACTOR.search(words) is not None:
        say = "The value counts in tenths or hundredths of its unit."
        return _Odd(replies[-1], "unit_or_sign", say, "Multiply it by the unit that the manual names for the register")
    if _NEGATIVE.search(words) is not None:
        for piece in replies:
            if any(word >= 0xFF00 for word in _words(piece)):
                say = "A register is negative: above 32767 it is a number in two's complement."
                return _Odd(piece, "unit_or_sign", say, "Read it as a signed number of 16 bits")
    long, ordered = _THIRTY_TWO.search(words) is not None, _ORDERED.search(words) is not None
    if long and not ordered and all(len(_registers(piece)) == _ONE for piece in replies):
        say = "One register was read, and the value has two."
        return _Odd(replies[-1], "wrong_register", say, "Read two registers, from the first of the value on")
    if long or ordered:
        for piece in replies:
            low = [r for r in _readings(_registers(piece)) if r.kind == "float" and 0.01 < abs(r.value) < 1e6]
            if low and not any(r.order == "ABCD" for r in low) and (found := [r for r in low if r.order == "CDAB"]):
                say = f"The words of a float stand in the wrong order: swapped they are {found[0].value:g}."
                return _Odd(piece, "wrong_byte_order", say, "Read it in the order CDAB (the low word first)")
    return None


def _words(piece: Piece) -> Iterator[int]:
    data = _registers(piece)
    return (int.from_bytes(data[at : at + 2], "big") for at in range(0, len(data), 2))
