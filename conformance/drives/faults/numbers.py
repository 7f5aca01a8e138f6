"""What can be wrong with a number as sent, by what the catalogue says of its field, and with the limits of a field."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from fractions import Fraction

from analyzer.layout import Field, FieldKind

#: (value, field) -> value
Number = Callable[[int, Field], int]

# --- byte order, sign, width, scale ----------------------------------------------------------------------------------


def swap_bytes(value: int, field: Field) -> int:
    """Return a number with its bytes in the other order."""
    raw = (value % (1 << field.bit_width)).to_bytes(field.bit_width // 8, "little")
    return int.from_bytes(raw, "big", signed=field.kind is FieldKind.INT)


def negated(value: int, field: Field) -> int:
    """Return a number with the wrong sign."""
    return -value


def without_sign(value: int, field: Field) -> int:
    """Return a number without its sign."""
    return abs(value)


def half_width(value: int, field: Field) -> int:
    """Return what half the bits of a field hold of a number, without a sign."""
    return value % (1 << field.bit_width // 2)


def half_signed(value: int, field: Field) -> int:
    """Return what half the bits of a field hold of a signed number."""
    half = 1 << (field.bit_width // 2 - 1)
    return (value + half) % (2 * half) - half


def low_bits(count: int) -> Number:
    """Keep only the low bits."""
    return lambda value, field: value % (1 << count)


def scaled(numerator: int, denominator: int = 1) -> Number:
    """Multiply, to the nearest whole number."""
    return lambda value, field: round(Fraction(value * numerator, denominator))


# --- other values ----------------------------------------------------------------------------------------------------


def always(value: int) -> Number:
    """Put the same value in place of every other."""
    return lambda _, field: value


def plus(number: int) -> Number:
    """Add a number."""
    return lambda value, field: value + number


def at_least(bound: int) -> Number:
    """Put a bound in place of what is below it."""
    return lambda value, field: max(value, bound)


def at_most(bound: int) -> Number:
    """Put a bound in place of what is above it."""
    return lambda value, field: min(value, bound)


def to_highest(value: int, field: Field) -> int:
    """Put the highest allowed value in place of what is above it."""
    return min(value, field.high)


def renamed(old: int, new: int) -> Number:
    """Put one value in place of another."""
    return lambda value, field: new if value == old else value


def exchanged(one: int, other: int) -> Number:
    """Put two values in each other's place."""
    return lambda value, field: {one: other, other: one}.get(value, value)


# --- limits ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Judge:
    """A verdict on some values of a field; the others are judged as the manual does. `values` None: on all of them."""

    verdict: bool
    values: Callable[[Field], Collection[int]] | None = None

    def concerns(self, field: Field, value: int) -> bool:
        """Say whether the verdict is on this value."""
        return self.values is None or value in self.values(field)

    def differs(self, field: Field) -> bool:
        """Say whether the verdict differs from the manual for a value that the field can carry."""
        values = (field.wire_minimum, field.wire_maximum) if self.values is None else self.values(field)
        return any(field.allows(v) != self.verdict for v in values if field.wire_minimum <= v <= field.wire_maximum)


one_more = Judge(True, lambda field: {field.high + 1})
one_less = Judge(True, lambda field: {field.low - 1})
highest_refused = Judge(False, lambda field: {field.high})
lowest_refused = Judge(False, lambda field: {field.low})
unlimited = Judge(True)


def accepts(*values: int) -> Judge:
    """Accept values that the manual does not allow."""
    return Judge(True, lambda field: values)


def refuses(*values: int) -> Judge:
    """Refuse values that the manual allows."""
    return Judge(False, lambda field: values)
