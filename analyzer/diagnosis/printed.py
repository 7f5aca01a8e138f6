"""Numbers that words print beside frames of a known command, and what its fields say.

A program that prints a signed field as an unsigned one prints a number that no drive means. A person who wants 320 rpm and
sends 0x320 has sent 800. The number stands in the words, and the field tells its other reading.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from analyzer.diagnosis.scene import Confidence, Piece, Scene, Shown, Suspicion, Trouble, whole
from analyzer.layout import Field, FieldKind
from analyzer.values import counted

_NUMBER = re.compile(r"(?<![\w.:/-])(-?\d{2,15})(?![\d:x]|\.\d)\s*([A-Za-z]*)")
#: The fewest bits of a field whose unsigned reading is no usual number; the fewest digits of a number that is sent.
_WIDE, _DIGITS = 16, 3


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect how numbers of the words become fields, and fields numbers."""
    said = [(int(number), unit.lower()) for number, unit in _NUMBER.findall("\n".join(scene.words))]
    if not said:
        return
    numbers, with_unit = {number for number, _ in said}, set(said)
    signed: list[tuple[Piece, str, int, int]] = []
    digits: list[tuple[Piece, str, int, int]] = []
    for piece in scene.pieces:
        for field, value in _fields(piece):
            if piece.is_reply and value < 0 and field.kind is FieldKind.INT and field.bit_width >= _WIDE:
                unsigned = value + (1 << field.bit_width)
                # A program that prints both knows.
                if unsigned in numbers and value not in numbers:
                    signed.append((piece, field.name, unsigned, value))
            unit, text = field.unit.lower(), f"{value:x}"
            of_digits = piece.is_request and unit and len(text) >= _DIGITS and text.isdecimal()
            if of_digits and (int(text), unit) in with_unit and (value, unit) not in with_unit:
                digits.append((piece, field.name, value, int(text)))
    yield from _said(
        "unit_or_sign", signed, "The program prints {0} as {1}: the field is signed, and says {2}.",
        "Take the bytes as two's complement of the field's width",
    )  # fmt: skip
    yield from _said(
        "decimal_as_hex", digits, "The decimal digits of {0} are sent as hexadecimal ones: {2} is meant, and {1} is sent.",
        "Convert the number before it is sent",
    )  # fmt: skip


def _fields(piece: Piece) -> Iterator[tuple[Field, int]]:
    """Yield the fields of a sound frame that are plain numbers, with their values."""
    message = piece.message
    if not piece.sound or message is None or message.form is None or message.command is None:
        return
    if not message.frame.dialect.of_drives:
        return
    for field in message.form.layout.fields:
        value = message.values.get(field.name)
        if isinstance(value, int) and field.choices is None and field.physical(value) == value:
            yield field, value


def _said(cause: str, found: list[tuple[Piece, str, int, int]], say: str, todo: str) -> Iterator[Suspicion]:
    if not found:
        return
    piece, name, got, meant = found[0]
    pieces = list(dict.fromkeys(each[0] for each in found))
    yield Suspicion(
        cause, Confidence.LIKELY, [Trouble(cause, p.offset, None, p) for p in pieces], say.format(name, got, meant),
        f"{whole(piece)} at byte {piece.offset}, and the number in the words; {counted(len(pieces), 'time')}",
        todo, tuple(Shown(p.offset, whole(p)) for p in pieces),
    )  # fmt: skip
