"""Fields and layouts: which bits of a frame's own data mean what.

A `Field` is one run of bits with a name; a `Layout` is a sequence of fields. Both are declarations: they hold no code
that knows a command. `analyzer.codec` reads and writes them by the declaration. So a decoder, an encoder, a Hypothesis
strategy, a JSON Schema and a reference page all come from the same line.

Rules kept here:
- Bits are counted from the most significant bit of the first byte of a command's own data.
- Every number in a declaration (limits, defaults, choices, fixed values) is the integer as sent on the wire; a physical
  value is that integer times `scale`, in `unit`.
- A little-endian field begins and ends on a byte boundary.
- What differs between models of one drive is declared beside the field (`models`) and resolved once, by
  `Layout.for_model`, never while decoding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import IntEnum, StrEnum
from fractions import Fraction
from functools import cache, cached_property, partial
from typing import Any


class Order(StrEnum):
    """Byte order of a field."""

    BIG = "big"
    LITTLE = "little"


class FieldKind(StrEnum):
    """How the bits of a field are read. Only a `ReadLayout` has fields of the last three kinds."""

    UINT = "uint"
    INT = "int"
    BYTES = "bytes"
    RESERVED = "reserved"
    NUMBER = "number"
    TEXT = "text"
    NUMBERS = "numbers"


#: Kinds whose values are no single number.
NOT_NUMERIC = frozenset({FieldKind.BYTES, FieldKind.TEXT, FieldKind.NUMBERS})


class Effect(StrEnum):
    """What a field of a request changes about the drive or its link."""

    ADDRESS = "address"
    BAUD_RATE = "baud_rate"
    GROUP = "group"
    DIALECT = "dialect"
    RESPOND = "respond"
    ACTIVE = "active"
    WORK_MODE = "work_mode"
    SUBDIVISION = "subdivision"
    CURRENT = "current"
    HOME_SPEED = "home_speed"


#: What changes who answers, and how.
ANSWERING = frozenset((Effect.ADDRESS, Effect.GROUP, Effect.DIALECT, Effect.RESPOND, Effect.ACTIVE))


@cache
def _enum_names(choices: type[IntEnum]) -> dict[int, str]:
    return {int(c): c.name.lower() for c in choices}


#: Bits of an integer that a double, and so JSON, holds exactly.
_EXACT_BITS = 53
#: Names that a decoded message or a filter uses for something else; no field may take one.
RESERVED_NAMES = frozenset({"address", "command", "role", "dialect", "bus", "time", "slots"})


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelLimits:
    """What one model of a drive does otherwise: limits, default, scale or unit of a field. None: as declared."""

    minimum: int | None = None
    maximum: int | None = None
    default: int | None = None
    scale: Fraction | None = None
    unit: str | None = None


@dataclass(frozen=True, slots=True)
class StatePart:
    """This field feeds a quantity of the derived state: physical value times `factor`, summed over its parts.

    Quantities and their units: position deg, speed rpm, current A, voltage V, temperature degC.
    """

    quantity: str
    factor: float


#: The unit of each quantity of the derived state, the same for every dialect.
STATE_UNITS: Mapping[str, str] = {"position": "deg", "speed": "rpm", "current": "A", "voltage": "V", "temperature": "degC"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """One run of bits.

    `minimum`, `maximum`, `default`, `fixed` and the members of `choices` are integers as sent. `bit_width` 0 means the
    rest of the data (kind `bytes`, last field only). `effect`: what the field sets; several fields can set a current, which
    includes a torque or a power. `fixed` is a value that makes a layout what it is: data that holds
    another one is not of this layout. A reserved field expects 0. `values` are allowed values with gaps that have no
    names (CAN subdivisions).
    """

    name: str
    bit_width: int
    kind: FieldKind = FieldKind.UINT
    order: Order = Order.BIG
    minimum: int | None = None
    maximum: int | None = None
    values: frozenset[int] | None = None
    choices: type[IntEnum] | Mapping[int, str] | None = None
    unit: str = ""
    scale: Fraction = Fraction(1)
    default: int | None = None
    fixed: int | None = None
    printed: str = ""
    note: str = ""
    models: Mapping[str, ModelLimits] | None = None
    state: StatePart | None = None
    effect: Effect | None = None

    def __post_init__(self) -> None:
        if self.name in RESERVED_NAMES or self.name.startswith("_"):
            raise ValueError(f"field name {self.name!r} is taken by the log")
        if self.order is Order.LITTLE and self.bit_width % 8:
            raise ValueError(f"little-endian field {self.name!r} has {self.bit_width} bits, expected whole bytes")
        if isinstance(self.scale, float):
            raise ValueError(f"field {self.name!r} has the scale {self.scale}, expected a Fraction as Fraction(1, 10)")

    @property
    def wire_minimum(self) -> int:
        """The smallest integer the bits can hold."""
        return -(1 << (self.bit_width - 1)) if self.kind is FieldKind.INT else 0

    @property
    def wire_maximum(self) -> int:
        """The largest integer the bits can hold."""
        return (1 << (self.bit_width - 1)) - 1 if self.kind is FieldKind.INT else (1 << self.bit_width) - 1

    @property
    def low(self) -> int:
        """The smallest allowed integer, as sent."""
        return self.wire_minimum if self.minimum is None else self.minimum

    @property
    def high(self) -> int:
        """The largest allowed integer, as sent."""
        return self.wire_maximum if self.maximum is None else self.maximum

    def allows(self, value: int) -> bool:
        """Say whether an integer as sent is within the range, the choices and the fixed value."""
        if self.fixed is not None:
            return value == self.fixed
        if self.kind is FieldKind.RESERVED:
            return value == 0
        if self.values is not None and value not in self.values:
            return False
        if self.choices is not None and value not in self.choice_names:
            return False
        return self.low <= value <= self.high

    @property
    def has_text_twin(self) -> bool:
        """Whether a number may not hold its value, which then stands beside it as a text."""
        return self.bit_width > _EXACT_BITS or self.kind is FieldKind.NUMBER

    @property
    def choice_names(self) -> dict[int, str]:
        """Integer as sent -> name; those of an enumeration in lower case. Empty without choices."""
        if self.choices is None:
            return {}
        return dict(self.choices) if isinstance(self.choices, Mapping) else _enum_names(self.choices)

    def physical(self, value: int) -> int | float:
        """Return the physical value of an integer as sent, in `unit`."""
        if self.scale == 1:
            return value
        return value * self.scale.numerator / self.scale.denominator

    def wire(self, physical: float | int | Fraction) -> int:
        """Return the integer as sent that is nearest to a physical value."""
        if self.scale == 1 and isinstance(physical, int):
            return physical
        return round(Fraction(physical).limit_denominator(10**9) / self.scale)

    def for_model(self, model: str) -> Field:
        """Return this field as one model has it."""
        limits = (self.models or {}).get(model)
        if limits is None:
            return self
        changes: dict[str, Any] = {
            name: value
            for name in ("minimum", "maximum", "default", "scale", "unit")
            if (value := getattr(limits, name)) is not None
        }
        return replace(self, **changes)


@dataclass(frozen=True)
class Layout:
    """A sequence of fields that covers a command's own data from its first bit.

    Raises ValueError for two fields of one name, and for an open-ended field before the last. It also raises it for a
    little-endian field off a byte boundary, and for bits that do not fill whole bytes.
    """

    fields: tuple[Field, ...]

    def __init__(self, *fields: Field) -> None:
        object.__setattr__(self, "fields", fields)
        names = [f.name for f in fields if f.kind is not FieldKind.RESERVED]
        if len(names) != len(set(names)):
            raise ValueError(f"two fields of one name in {names}")
        offset = 0
        for index, field in enumerate(fields):
            if field.bit_width == 0 and index != len(fields) - 1:
                raise ValueError(f"open-ended field {field.name!r} is not the last")
            if field.order is Order.LITTLE and offset % 8:
                raise ValueError(f"little-endian field {field.name!r} starts at bit {offset}")
            offset += field.bit_width
        if offset % 8:
            raise ValueError(f"{offset} bits do not fill whole bytes in {names}")

    @cached_property
    def offsets(self) -> tuple[int, ...]:
        """The bit offset of each field, in order."""
        result, offset = [], 0
        for field in self.fields:
            result.append(offset)
            offset += field.bit_width
        return tuple(result)

    @cached_property
    def byte_length(self) -> int:
        """Bytes of the fixed part."""
        return sum(f.bit_width for f in self.fields) // 8

    @cached_property
    def open_ended(self) -> bool:
        """Whether the last field takes all that is left."""
        return bool(self.fields) and self.fields[-1].bit_width == 0

    @cached_property
    def named(self) -> dict[str, Field]:
        """Fields by name, reserved bits left out."""
        return {f.name: f for f in self.fields if f.kind is not FieldKind.RESERVED}

    @cached_property
    def units(self) -> dict[str, str]:
        """Units of the fields that have one, by name."""
        return {name: field.unit for name, field in self.named.items() if field.unit}

    def __iter__(self) -> Iterator[tuple[int, Field]]:
        """Yield (bit offset, field)."""
        return zip(self.offsets, self.fields, strict=True)

    def fits(self, length: int) -> bool:
        """Say whether data of `length` bytes can be of this layout."""
        return length >= self.byte_length if self.open_ended else length == self.byte_length

    def for_model(self, model: str) -> Layout:
        """Return this layout as one model has it."""
        return Layout(*(f.for_model(model) for f in self.fields))


class MisfitError(ValueError):
    """Data that a reader cannot read: the rule of findings that they break, and what was expected and got."""

    def __init__(self, rule: str, text: str) -> None:
        super().__init__(text)
        self.rule = rule


class ReadLayout(Layout):
    """Fields that a function reads: their bits may stand anywhere, and some of them may not be there.

    `reader` returns the values that are there: physical values by name, names of choices under `<name>_name`. It raises
    `MisfitError` for data that it cannot read. `shortest`: the fewest bytes of data.
    """

    reader: Callable[[bytes], dict[str, Any]]

    def __init__(self, *fields: Field, reader: Callable[[bytes], dict[str, Any]], shortest: int = 0) -> None:
        # The places of the fields are the reader's own: only the shortest length is known here.
        about = {"fields": fields, "reader": reader, "byte_length": shortest, "open_ended": True, "offsets": (0,) * len(fields)}
        self.__dict__.update(about)
        if len(self.named) != len(fields):
            raise ValueError(f"two fields of one name in {[f.name for f in fields]}")

    def for_model(self, model: str) -> Layout:
        return self


def uint(name: str, width: int, **options: Any) -> Field:
    """Declare an unsigned field of `width` bits."""
    return Field(name=name, bit_width=width, **options)


def sint(name: str, width: int, **options: Any) -> Field:
    """Declare a two's complement field of `width` bits."""
    return Field(name=name, bit_width=width, kind=FieldKind.INT, **options)


bits = uint
#: Fields of whole bytes, as `uint` and `sint` declare them: `u8("status", choices=Status)`.
u8, u16, u32 = (partial(uint, width=width) for width in (8, 16, 32))
i8, i16, i32 = (partial(sint, width=width) for width in (8, 16, 32))


def fixed(name: str, width: int, value: int, **options: Any) -> Field:
    """Declare a field whose value makes the layout what it is."""
    return uint(name, width, fixed=value, **options)


def reserved(width: int, name: str = "reserved", **options: Any) -> Field:
    """Declare bits that are to be 0."""
    return Field(name=name, bit_width=width, kind=FieldKind.RESERVED, **options)


def rest(name: str, **options: Any) -> Field:
    """Declare all bytes that are left."""
    return Field(name=name, bit_width=0, kind=FieldKind.BYTES, **options)
