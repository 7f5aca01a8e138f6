"""Numbers that words print beside frames of a known command, and what its fields say.

A program that prints a signed field as an unsigned one prints a number that no drive means. A person who wants 320 rpm and
sends 0x320 has sent 800. Who wants 90 degrees and sends 90 to a field of 0.01 degrees has sent 0.9. The number stands in the
words, and the field tells its other reading.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from analyzer.diagnosis.meant import COMPLAINT
from analyzer.diagnosis.scene import Confidence, Piece, Scene, Shown, Suspicion, Trouble, whole
from analyzer.layout import Field, FieldKind
from analyzer.values import counted

_NUMBER = re.compile(r"(?<![\w.:/-])(-?\d{2,15})(?![\d:x]|\.\d)\s*([A-Za-z]*(?:/(?:s|min))?)")
#: Other words for the catalogue's units. Only fields without a step use them.
_ALSO = {
    "rpm": frozenset(("r/min", "rev/min", "u/min", "revs/min")),
    "pulses": frozenset(("pulse", "steps", "step", "microsteps")),
    "counts": frozenset(("count",)),
}
#: Words that stand before a wanted number.
_WANTED = (
    r"\b(?:want|wish|need|intend|mean|meant|ask|order|command|request|desire|target|goal|set)\w*\b[^.;\n]{{0,40}}\b{}(?!\d)"
)
#: The fewest bits of a field whose unsigned reading is no usual number; the fewest digits of a number that is sent.
_WIDE, _DIGITS = 16, 3
#: Numbers with a point too, and their unit; a whole turn that is told in words.
_MEASURE = re.compile(r"(?<![\w.:/-])(-?\d{1,15}(?:\.\d{1,6})?)(?![\d:x.])\s*([A-Za-z°]+(?:/s)?)?")
_ONE_TURN = re.compile(r"\b(?:one|a) (?:full|whole|single|complete)?\s*(?:turn|rev(?:olution)?|rotation)\b", re.IGNORECASE)
#: How people write the unit of a field, and units of the same quantity in which they think instead.
_DEGREES = frozenset(("deg", "degree", "degrees", "grad", "°"))
_SPELLED = {
    "deg": _DEGREES,
    "deg/s": frozenset(("dps", "deg/s", "°/s", "degrees/s", "rpm")),
    "V": frozenset(("v", "volt", "volts")),
}
#: Of those the ones that are another unit: a number fits there if the field has it in its own.
_OTHER = frozenset(("rpm",))
_AMPERES = frozenset(("a", "amp", "amps", "ampere", "amperes"))
_TURNS = frozenset(("turn", "turns", "rev", "revs", "revolution", "revolutions", "rotation", "rotations"))
#: Units in which people think, by those of fields that have no step; the number that was meant stands in the field.
_INSTEAD = {
    "counts": _DEGREES,
    "pulses": _DEGREES,
    "rpm": frozenset(("dps", "deg/s", "°/s", "degrees/s", "rad/s", "rps", "hz", "pps", "steps/s", "pulses/s")),
}
#: Steps that a motor has a turn, each in so many parts; counts that its encoder has.
_STEPS, _PARTS, _COUNTS = 200, tuple(1 << n for n in range(9)), 0x4000
#: A smaller number is met by chance.
_LEAST = 10
#: Bits of the numbers that programs have, and how near a number that is printed comes to its value.
_PROGRAM_BITS, _PRINTED = (16, 24, 32, 64), 1e-9
#: The least number that is unsigned by no chance.
_MUCH = 1 << 15


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect how numbers of the words become fields, and fields numbers."""
    words = "\n".join(scene.words)
    measured = {(float(number), unit.lower()) for number, unit in _MEASURE.findall(words)}
    yield from _scaled(scene, measured)
    if not scene.noted or COMPLAINT.search(words) is not None:
        yield from _of_other_steps(scene, measured | ({(1.0, "turn")} if _ONE_TURN.search(words) else set()))
    said = {(int(number), unit.lower()) for number, unit in _NUMBER.findall(words)}
    if not measured:
        return
    numbers, exact = {number for number, _ in said}, {number for number, _ in measured}
    signed: list[tuple[Piece, str, int, int]] = []
    short: list[tuple[Piece, str, int, int]] = []
    digits: list[tuple[Piece, str, int, int]] = []
    wanted: dict[tuple[str, int], bool] = {}
    for piece in scene.pieces:
        for field, value in _fields(piece):
            if field.kind is FieldKind.INT and field.bit_width >= _WIDE:
                if piece.is_reply and value < 0 and (unsigned := _as_unsigned(field, value, numbers | exact)):
                    signed.append((piece, field.name, unsigned, value))
                elif piece.is_request and value >= _MUCH and value not in numbers:
                    widths = (bits for bits in _PROGRAM_BITS if value < 1 << bits < 1 << field.bit_width)
                    short += ((piece, field.name, value, value - (1 << n)) for n in widths if value - (1 << n) in numbers)
            text = f"{value:x}" if piece.is_request and field.unit and field.scale == 1 else ""
            if len(text) < _DIGITS or not text.isdecimal():
                continue
            if (key := (field.unit.lower(), value)) not in wanted:
                wanted[key] = _wanted(words, said, key[0], int(text), value)
            if wanted[key]:
                digits.append((piece, field.name, value, int(text)))
    yield from _said(
        "unit_or_sign", signed, "The program prints {0} as {1}: the field is signed, and says {2}.",
        "Take the bytes as two's complement of the field's width",
    )  # fmt: skip
    yield from _said(
        "unit_or_sign", short, "The field {0} says {1}: {2} is meant, in two's complement of fewer bits than the field has.",
        "Extend the sign over all bytes of the field",
    )  # fmt: skip
    yield from _said(
        "decimal_as_hex", digits, "The decimal digits of {0} are sent as hexadecimal ones: {2} is meant, and {1} is sent.",
        "Convert the number before it is sent",
    )  # fmt: skip


def _wanted(words: str, said: set[tuple[int, str]], unit: str, meant: int, sent: int) -> bool:
    """Say whether the words want one number, and have the other only as what came of it."""
    units = {unit, *_ALSO.get(unit, ())}
    if not any((meant, each) in said for each in units):
        return False
    came = any((sent, each) in said for each in units)
    return (
        not came or COMPLAINT.search(words) is not None or (re.search(_WANTED.format(meant), words, re.IGNORECASE) is not None)
    )


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


def _as_unsigned(field: Field, value: int, said: set[float]) -> int:
    """Return the number that the words have where a negative value is taken for an unsigned one; 0 where they have none.

    A program that prints both knows.
    """
    if value in said or field.physical(value) in said:
        return 0
    for bits in {field.bit_width, *_PROGRAM_BITS}:
        unsigned = value + (1 << bits)
        shown = (unsigned, float(field.physical(unsigned)))
        if unsigned >= _MUCH and any(abs(number - each) <= _PRINTED * each for number in said for each in shown):
            return unsigned
    return 0


def _of_other_steps(scene: Scene, said: set[tuple[float, str]]) -> Iterator[Suspicion]:
    """Suspect steps of a motor where its encoder's counts are asked for, and the reverse; and parts of an ampere."""
    turns = {number if unit in _TURNS else number / 360 for number, unit in said if unit in _TURNS | _DEGREES}
    amperes = {number for number, unit in said if unit in _AMPERES}
    found: list[tuple[Piece, str, int, str]] = []
    for piece in scene.pieces:
        for field, value in _fields(piece) if piece.is_request else ():
            amount, own = abs(value), {field.unit.lower(), *_ALSO.get(field.unit, ())}
            others = {unit for number, unit in said if number == amount >= _LEAST}
            if own.isdisjoint(others) and (same := others & _INSTEAD.get(field.unit, frozenset())):
                meant = [f"{amount} {unit}" for unit in sorted(same)]
            elif field.unit == "mA" and not any(number * 1000 == amount for number in amperes):
                meant = [f"{number:g} A" for number in amperes if amount and amount in (number, 10 * number, 100 * number)]
            elif field.unit == "counts" and amount not in {number * _COUNTS for number in turns}:
                meant = [f"{n:g} turns" for n in turns if any(amount == n * _STEPS * parts for parts in _PARTS) and n]
            elif field.unit == "pulses":
                meant = [f"{number:g} turns" for number in turns if number and amount == number * _COUNTS]
            else:
                continue
            found += ((piece, field.name, value, f"{value} {field.unit}, not {each}") for each in meant[:1])
    yield from _said(
        "unit_or_sign", found, "The field {0} has another unit than the words: {1} in it is {2}.",
        "Convert the number before it is sent: `servotap catalogue` has the unit of each field",
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
