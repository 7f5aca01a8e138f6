"""Numbers that words print beside frames of a known command, and what its fields say.

A program that prints a signed field as an unsigned one prints a number that no drive means. A person who wants 320 rpm and
sends 0x320 has sent 800. Who wants 90 degrees and sends 90 to a field of 0.01 degrees has sent 0.9. The number stands in the
words, and the field tells its other reading.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from analyzer.diagnosis.scene import Confidence, Piece, Scene, Shown, Suspicion, Trouble, whole
from analyzer.layout import Field, FieldKind
from analyzer.values import counted

_NUMBER = re.compile(r"(?<![\w.:/-])(-?\d{2,15})(?![\d:x]|\.\d)\s*([A-Za-z]*)")
#: The fewest bits of a field whose unsigned reading is no usual number; the fewest digits of a number that is sent.
_WIDE, _DIGITS = 16, 3
#: Numbers with a point too, and their unit.
_MEASURE = re.compile(r"(?<![\w.:/-])(-?\d{1,15}(?:\.\d{1,6})?)(?![\d:x.])\s*([A-Za-z°]+(?:/s)?)")
#: How people write the unit of a field, and units of the same quantity in which they think instead.
_SPELLED = {
    "deg": frozenset(("deg", "degree", "degrees", "grad", "°")),
    "deg/s": frozenset(("dps", "deg/s", "°/s", "degrees/s", "rpm")),
    "V": frozenset(("v", "volt", "volts")),
}
#: Of those the ones that are another unit: a number fits there if the field has it in its own.
_OTHER = frozenset(("rpm",))
#: A smaller number is met by chance.
_LEAST = 10


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect how numbers of the words become fields, and fields numbers."""
    words = "\n".join(scene.words)
    yield from _scaled(scene, {(float(number), unit.lower()) for number, unit in _MEASURE.findall(words)})
    said = [(int(number), unit.lower()) for number, unit in _NUMBER.findall(words)]
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
            of_digits = piece.is_request and unit and field.scale == 1 and len(text) >= _DIGITS and text.isdecimal()
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


def _scaled(scene: Scene, said: set[tuple[float, str]]) -> Iterator[Suspicion]:
    """Suspect fields that have the number of the words in steps of their own, or in their own unit for that of the words."""
    numbers = {number for number, _ in said}
    found: list[tuple[Piece, str, int, str]] = []
    for piece in scene.pieces if said else ():
        for field, value in _fields(piece):
            physical, units = field.physical(value), _SPELLED.get(field.unit, frozenset())
            if field.scale == 1 or abs(value) < _LEAST:
                continue
            meant = [(number, unit) for number, unit in said if unit in units
                     and number == (physical if unit in _OTHER else value)]  # fmt: skip
            if meant and (meant[0][1] in _OTHER or physical not in numbers):
                found.append((piece, field.name, value, f"{physical:g} {field.unit}, not {meant[0][0]:g} {meant[0][1]}"))
    yield from _said(
        "unit_or_sign", found, "The field {0} has another unit than the words: {1} in it is {2}.",
        "Multiply or divide by the step of the field: `servotap catalogue` has the unit of each",
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
        if isinstance(value, int) and field.choices is None:
            yield field, value


def _said(cause: str, found: Sequence[tuple[Piece, str, int, int | str]], say: str, todo: str) -> Iterator[Suspicion]:
    if not found:
        return
    piece, name, got, meant = found[0]
    pieces = list(dict.fromkeys(each[0] for each in found))
    yield Suspicion(
        cause, Confidence.LIKELY, [Trouble(cause, p.offset, None, p) for p in pieces], say.format(name, got, meant),
        f"{whole(piece)} at byte {piece.offset}, and the number in the words; {counted(len(pieces), 'time')}",
        todo, tuple(Shown(p.offset, whole(p)) for p in pieces),
    )  # fmt: skip
