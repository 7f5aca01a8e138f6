"""Values as people write and read them: `320`, `3.5`, `0x10`, `cw`, `on` <-> the integer as sent.

A written value is in the unit of its field. What a scale cannot hit exactly goes to the nearest integer as sent; a field
without a scale takes whole numbers only. Nothing here checks ranges but `refusal`, so that frames outside the manual can
be built on purpose.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from fractions import Fraction
from itertools import zip_longest
from typing import Any

from analyzer.errors import UsageError
from analyzer.layout import Field, FieldKind

_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)")
_HEX = re.compile(r"[+-]?0[xX][0-9a-fA-F]+")
#: Longer texts are no values; it also bounds the work that a hostile one can cause.
_LONGEST = 64
_ON = frozenset({"on", "true", "yes", "enabled"})
_OFF = frozenset({"off", "false", "no", "disabled"})
#: Names of the value 1 that `on` may stand for; a direction is never on.
_SWITCH_NAMES = frozenset({"enabled", "on", "high"})
_DECIMALS = 6
#: The highest CAN identifier of 11 bits, and all 29 bits of a longer one.
CAN_ID_LIMIT = 0x7FF
CAN_ID_MASK = 0x1FFF_FFFF
#: Bytes of a CAN FD frame by its length code.
FD_LENGTHS: tuple[int, ...] = (*range(9), 12, 16, 20, 24, 32, 48, 64)
#: Nanoseconds of a second.
SECOND_NS = 1_000_000_000
#: Units as people write them: how many of the first unit of their kind each is.
_KINDS: tuple[Mapping[str, Fraction], ...] = (
    {"s": Fraction(1), "ms": Fraction(1, 1000), "us": Fraction(1, 10**6), "ns": Fraction(1, 10**9), "min": Fraction(60)},
    {"A": Fraction(1), "mA": Fraction(1, 1000)},
    {"V": Fraction(1), "mV": Fraction(1, 1000)},
    {"deg": Fraction(1), "turns": Fraction(360)},
    {"rpm": Fraction(1), "deg/s": Fraction(1, 6)},
)
#: Other spellings of a unit.
_SPELLINGS = {"µs": "us", "μs": "us", "°": "deg", "turn": "turns", "rev": "turns", "dps": "deg/s", "°C": "degC", "C": "degC"}


def quote(text: str, longest: int = 60) -> str:
    """Return a text of the user as ASCII in quotes, cut where it is long: nothing in it steers a terminal."""
    return _cut(text, longest, ascii)


def brief(value: object) -> str:
    """Return a value as Python writes it, in ASCII, cut where it is long."""
    return _cut(ascii(value), 60, str)


def _cut(text: str, longest: int, show: Callable[[str], str]) -> str:
    return show(text) if len(text) <= longest else f"{show(text[:longest])} ... ({len(text)} characters)"


def printable(text: str, kept: str = "") -> str:
    """Return a text with its control characters but `kept` made visible: nothing in a capture steers a terminal."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in kept else escaped(c) for c in text)


def escaped(text: str) -> str:
    """Return the characters of a text as escapes: those beyond ASCII as JSON has them, so that JSON stays JSON."""
    from json.encoder import encode_basestring_ascii

    return "".join(ascii(c)[1:-1] if c < " " else encode_basestring_ascii(c)[1:-1] for c in text)


def storable(text: str) -> str:
    """Return a text that UTF-8 can hold: bytes of a file's name that are none become escapes."""
    return text.encode("utf-8", "backslashreplace").decode()


def is_host(text: str) -> bool:
    """Say whether a text can name a host. Looking up one that cannot, as `a..b`, fails as no other look-up does."""
    try:
        text.encode("idna")
    except UnicodeError:
        return False
    return True


def counted(count: int, noun: str, nouns: str = "") -> str:
    """Return a count with its noun: 1 frame, 2 frames. `nouns`: the plural of one that takes no s."""
    return f"{count} {noun}" if count == 1 else f"{count} {nouns or noun + 's'}"


def identifier(number: int, *, extended: bool = False) -> str:
    """Return a CAN identifier in hexadecimal: three digits, eight where it has 29 bits."""
    return f"0x{number:08X}" if extended or number > CAN_ID_LIMIT else f"0x{number:03X}"


def raw_text(data: str, can_id: int | None, *, extended: bool = False) -> str:
    """Return what filters call `raw`: the bytes of a frame as hex, on CAN its identifier first."""
    return data if can_id is None else f"{can_id:0{8 if extended else 2}X} {data}".rstrip()


def addresses(text: str, option: str, lowest: int = 1) -> list[int]:
    """Return the addresses of `1-32` or `1,2,0x123-0x12F`, each once, in order; none is below `lowest`. Raises UsageError."""
    found: dict[int, None] = {}
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        try:
            low = int(first, 0)
            high = int(last, 0) if dash else low
        except ValueError:
            low = high = -1
        if low > CAN_ID_LIMIT and low <= high <= CAN_ID_MASK:
            raise UsageError(f"{option}: got {quote(part)}, an identifier of 29 bits: drives have 11, 0x7FF at most")
        if not lowest <= low <= high <= CAN_ID_LIMIT:
            wanted = f"addresses from {lowest} to {CAN_ID_LIMIT} (0x{CAN_ID_LIMIT:X})"
            raise UsageError(f"{option}: got {quote(part)}, expected {wanted}, as 1-32 or 1,2,0x123-0x12F")
        found |= dict.fromkeys(range(low, high + 1))
    return list(found)


def near(word: str, known: Iterable[str], most: int = 3) -> str:
    """Return `; did you mean A or B?` with at most so many names next to a word, or nothing."""
    import difflib

    found = difflib.get_close_matches(word[:_LONGEST].lower(), list(known), most, 0.5)
    return f"; did you mean {' or '.join(found)}?" if found else ""


def decimal(value: Fraction | int) -> str:
    """Return a number in decimal, exact up to six digits behind the point."""
    whole = round(Fraction(value) * 10**_DECIMALS)
    digits = str(abs(whole)).rjust(_DECIMALS + 1, "0")
    text = f"{digits[:-_DECIMALS]}.{digits[-_DECIMALS:]}".rstrip("0").rstrip(".")
    return f"-{text}" if whole < 0 else text


def factor(written: str, unit: str) -> Fraction | None:
    """Return what a number in the unit as written is to be multiplied by to be in `unit`; None where they do not convert."""
    word = _SPELLINGS.get(written, written)
    if word.lower() == unit.lower():
        return Fraction(1)
    return next((kind[word] / kind[unit] for kind in _KINDS if word in kind and unit in kind), None)


def with_unit(field: Field, value: int) -> str:
    """Return an integer as sent as its physical value with the unit."""
    shown = decimal(value * field.scale)
    return f"{shown} {field.unit}" if field.unit else shown


def value_text(field: Field, value: int | bytes) -> str:
    """Return a value as sent for people: with its unit, or with the name of its choice."""
    if isinstance(value, bytes):
        return value.hex(" ").upper() or "none"
    name = field.choice_names.get(value)
    return f"{decimal(value * field.scale)} {name}" if name is not None else with_unit(field, value)


def fields_text(values: Mapping[str, Any], units: Mapping[str, Any]) -> str:
    """Return the fields of a message as `name=value unit`, choices by their names; of a package one slot behind the other."""
    if "slots" in values:
        each: Iterable[Any] = zip_longest(values["slots"], units.get("slots", ()), fillvalue={})
        return "; ".join(fields_text(slot, of_slot) for slot, of_slot in each)
    parts = []
    for name, value in values.items():
        if name.endswith(("_name", "_text")) and name[:-5] in values:
            continue
        shown = values.get(name + "_name", value)
        parts.append(f"{name}={shown:.9g}" if isinstance(shown, float) else f"{name}={shown}")
        if name in units and shown is value:
            parts.append(units[name])
    return " ".join(parts)


def range_text(field: Field, most: int | None = None) -> str:
    """Return what a field may hold: its choices, its values or its range; of choices and values at most `most`."""
    if field.kind is FieldKind.BYTES:
        return "bytes"
    if field.fixed is not None:
        return f"always {value_text(field, field.fixed)}"
    if field.choices is not None:
        listed = [f"{v} {n}" for v, n in sorted(field.choice_names.items()) if field.allows(v)]
        return _listed(listed, most)
    if field.values is not None:
        return _listed([decimal(v * field.scale) for v in sorted(field.values)], most)
    low, high = decimal(field.low * field.scale), with_unit(field, field.high)
    return f"{low}..{high}" if field.low != field.high else high


def _listed(items: list[str], most: int | None) -> str:
    return ", ".join(items) if most is None or len(items) <= most else f"one of {len(items)}"


def refusal(field: Field, value: int | bytes) -> str | None:
    """Return why the manual does not allow a value as sent, by the field's name, or None."""
    if isinstance(value, bytes) or field.allows(value):
        return None
    expected = range_text(field) if field.fixed is None else value_text(field, field.fixed)
    return f"{field.name}: got {value_text(field, value)}, expected {expected}"


def parse_value(field: Field, text: str, *, as_sent: bool = False) -> int | bytes:
    """Return the integer as sent (bytes for a field of bytes) that a text means.

    `as_sent`: a number is the integer as sent, not a physical value. Names of choices, on and off are taken either way.
    Raises UsageError for what is neither a number nor a name of this field.
    """
    stripped = text.strip()
    if field.kind is FieldKind.BYTES:
        try:
            return bytes.fromhex(stripped)
        except ValueError:
            raise UsageError(f"{field.name}: got {quote(stripped)}, expected hex bytes") from None
    if len(stripped) > _LONGEST:
        raise _unknown(field, text)
    word = stripped.lower().replace("-", "_")
    for value, name in field.choice_names.items():
        if word == name:
            return value
    switch = _parse_switch(field, word)
    if switch is not None:
        return switch
    number = _parse_number(field, stripped)
    if number is None:
        raise _unknown(field, text)
    if as_sent or field.scale == 1:
        if number.denominator != 1:
            raise UsageError(f"{field.name}: got {stripped}, expected a whole number")
        return int(number)
    return round(number / field.scale)


def _parse_number(field: Field, text: str) -> Fraction | None:
    if _HEX.fullmatch(text):
        return Fraction(int(text, 16))
    found = _NUMBER.match(text)
    unit = text[found.end() :].strip() if found else ""
    times = factor(unit, field.unit) if unit else Fraction(1)
    return Fraction(found[0]) * times if found is not None and times is not None else None


def _parse_switch(field: Field, word: str) -> int | None:
    names = field.choice_names
    if names:
        switches = set(names) == {0, 1} and names[1] in _SWITCH_NAMES
    else:
        switches = field.low == 0 and field.high == 1
    if not switches or word not in _ON | _OFF:
        return None
    return int(word in _ON)


def _unknown(field: Field, text: str) -> UsageError:
    names = field.choice_names.values()
    return UsageError(f"{field.name}: got {quote(text)}, expected {range_text(field)}{near(text, names)}")
