"""Codecs: what reads and writes the bytes of a layout, made from its declaration.

For each layout one small Python function is written and compiled, in which every field is one expression over the data:
`d[0] >> 7`, `(d[0] & 15) << 8 | d[1]`, `int.from_bytes(d[2:6], "big", signed=True)`. That is three times faster than a
loop over the fields, and the same expressions can be compiled for columns later.

    wire(data)      {name: integer as sent}
    physical(data)  {name: number in the field's unit, name_name: choice}
    json(data)      the same as JSON text, left open at its end for the log's own keys
    broken(data)    the rules that the values break: range, choice, reserved bits
    encode(values)  the bytes
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Set
from decimal import Decimal
from functools import cached_property
from math import isfinite
from sys import float_info
from typing import Any

import msgspec

from analyzer.layout import Field, FieldKind, Layout, MisfitError, Order, ReadLayout

#: The largest integer that a double, and so JSON, holds exactly.
EXACT = 2**53


class Violation(msgspec.Struct, frozen=True, gc=False):
    """A rule of the catalogue that a frame's bytes break: the rule's id, the field, and what was expected and got."""

    rule: str
    text: str
    field: str = ""


def _expression(offset: int, field: Field) -> str:
    """Return the Python expression over `d` that reads a field as an integer."""
    first, last = offset // 8, (offset + field.bit_width - 1) // 8 + 1
    shift = last * 8 - offset - field.bit_width
    aligned = offset % 8 == 0 and shift == 0
    if field.bit_width == 0:
        return f"d[{first}:]"
    if aligned and field.kind is not FieldKind.INT and field.bit_width == 8:
        return f"d[{first}]"
    if aligned and field.kind is not FieldKind.INT and field.bit_width == 16:
        high, low = (first, first + 1) if field.order is Order.BIG else (first + 1, first)
        return f"d[{high}] << 8 | d[{low}]"
    if aligned:
        signed = ", signed=True" if field.kind is FieldKind.INT else ""
        return f"int.from_bytes(d[{first}:{last}], '{field.order}'{signed})"
    whole = f"d[{first}]" if last - first == 1 else f"int.from_bytes(d[{first}:{last}], 'big')"
    text = f"{whole} >> {shift} & {(1 << field.bit_width) - 1}"
    if field.kind is FieldKind.INT:
        half = 1 << (field.bit_width - 1)
        text = f"(({text}) ^ {half}) - {half}"
    return text


def _scaled(text: str, field: Field) -> str:
    if field.scale == 1:
        return text
    up = "" if field.scale.numerator == 1 else f" * {field.scale.numerator}"
    down = "" if field.scale.denominator == 1 else f" / {field.scale.denominator}"
    return f"({text}){up}{down}"


def _compile(name: str, body: str, names: dict[str, Any]) -> Callable[[bytes], Any]:
    source = f"def {name}(d):\n{body}\n"
    exec(compile(source, f"<layout {name}>", "exec"), names)  # the source is built from declarations, never from input
    function: Callable[[bytes], Any] = names[name]
    return function


class Codec:
    """Reads and writes the data of one layout.

    `wire` and `physical` take data whose length fits the layout; `matches` says whether data are of it.
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.fixed = [(o, f) for o, f in layout if f.fixed is not None]
        self._items = [(o, f) for o, f in layout if f.kind is not FieldKind.RESERVED]

    # Each function is compiled when it is first asked for: most runs use a few commands of many.

    @cached_property
    def wire(self) -> Callable[[bytes], dict[str, Any]]:
        """Reads data into integers as sent, by name."""
        pairs = ", ".join(f"{f.name!r}: {_expression(o, f)}" for o, f in self._items)
        return _compile("wire", f"    return {{{pairs}}}", {})

    @cached_property
    def physical(self) -> Callable[[bytes], dict[str, Any]]:
        """Reads data into numbers in the fields' units, with name twins."""
        return self._physical(self._items)

    @cached_property
    def json(self) -> Callable[[bytes], bytes]:
        """Reads data into the same as JSON text, without the closing brace."""
        return self._json(self._items)

    @cached_property
    def valid(self) -> Callable[[bytes], bool]:
        """Says whether all values are as the manual lists them."""
        return self._validity()

    @cached_property
    def _fixed_match(self) -> Callable[[bytes], bool]:
        names = {f"is_{i}": f.fixed for i, (_, f) in enumerate(self.fixed)}
        tests = " and ".join(f"({_expression(o, f)}) == is_{i}" for i, (o, f) in enumerate(self.fixed))
        return _compile("fixed_match", f"    return {tests or True}", dict(names))

    def matches(self, data: bytes) -> bool:
        """Say whether data are of this layout: the length fits and every fixed field has its value."""
        return self.layout.fits(len(data)) and (not self.fixed or self._fixed_match(data))

    def misfit(self, data: bytes) -> Violation | None:
        """Return why data of a fitting length cannot be read; None where they can, as all data of declared bits."""
        return None

    def _physical(self, items: list[tuple[int, Field]]) -> Callable[[bytes], dict[str, Any]]:
        if any(f.bit_width == 0 or f.bit_width > 53 for _, f in items):
            return self.physical_slowly
        entries, names = [], {}
        for index, (offset, field) in enumerate(items):
            text = _expression(offset, field)
            entries.append(f"{field.name!r}: {_scaled(text, field)}")
            if field.choices is not None:
                names[f"names_{index}"] = field.choice_names
                entries.append(f"{field.name + '_name'!r}: names_{index}[{text}]")
        names["slowly"] = self.physical_slowly  # type: ignore[assignment]
        body = f"    return {{{', '.join(entries)}}}"
        if any(f.choices is not None for _, f in items):
            body = f"    try:\n    {body}\n    except KeyError:\n        return slowly(d)"
        return _compile("physical", body, dict(names))

    def _json(self, items: list[tuple[int, Field]]) -> Callable[[bytes], bytes]:
        """Make the function that writes the physical values as JSON, an object without its closing brace."""
        if any(f.bit_width == 0 or f.bit_width > 53 for _, f in items):
            return self._json_slowly
        pieces, values, names = [], [], {"slowly": self._json_slowly}
        for index, (offset, field) in enumerate(items):
            text = _expression(offset, field)
            # %a writes a float as Python shows it, which is the shortest JSON that reads back the same.
            pieces.append(f'"{field.name}":' + ("%d" if field.scale == 1 else "%a"))
            values.append(_scaled(text, field))
            if field.choices is not None:
                names[f"names_{index}"] = {v: n.encode() for v, n in field.choice_names.items()}  # type: ignore[assignment]
                pieces.append(f'"{field.name}_name":"%b"')
                values.append(f"names_{index}[{text}]")
        template = "{" + ",".join(pieces) + ("," if pieces else "")
        line = f"return b'{template}' % ({', '.join(values)},)" if values else "return b'{'"
        body = f"    {line}"
        if len(names) > 1:
            body = f"    try:\n        {line}\n    except KeyError:\n        return slowly(d)"
        return _compile("json", body, dict(names))

    def _json_slowly(self, data: bytes) -> bytes:
        text = msgspec.json.encode(self.physical_slowly(data))[:-1]
        return text + b"," if len(text) > 1 else text

    def physical_slowly(self, data: bytes) -> dict[str, Any]:
        """Return the physical values, with name twins where a choice has a name and text twins beyond 2**53."""
        result: dict[str, Any] = {}
        for name, value in self.wire(data).items():
            field = self.layout.named[name]
            if isinstance(value, bytes):
                result[name] = value.hex(" ").upper()
                continue
            result[name] = field.physical(value)
            if abs(value) > EXACT:
                exact = Decimal(value) * field.scale.numerator / field.scale.denominator
                result[name + "_text"] = format(exact, "f")
            choice = field.choice_names.get(value)
            if choice is not None:
                result[name + "_name"] = choice
        return result

    def _validity(self) -> Callable[[bytes], bool]:
        tests, names = [], {}
        for index, (offset, field) in enumerate(self.layout):
            text = _expression(offset, field)
            if field.kind is FieldKind.RESERVED:
                tests.append(f"not {text}" if field.bit_width == 8 else f"({text}) == 0")
            elif field.fixed is not None or field.bit_width == 0:
                continue
            elif field.choices is not None or field.values is not None:
                names[f"set_{index}"] = frozenset(v for v in (field.values or field.choice_names) if field.allows(v))
                tests.append(f"({text}) in set_{index}")
            elif field.low > field.wire_minimum or field.high < field.wire_maximum:
                tests.append(f"{field.low} <= ({text}) <= {field.high}")
        return _compile("valid", f"    return {' and '.join(tests) or True}", dict(names))

    @cached_property
    def _judged(self) -> list[tuple[Field, Callable[[bytes], int]]]:
        """The fields whose values may break something, each with what reads it."""
        judged = [(o, f) for o, f in self.layout if f.bit_width and f.fixed is None]
        return [(f, _compile("value", f"    return {_expression(o, f)}", {})) for o, f in judged]

    def broken(self, data: bytes) -> tuple[Violation, ...]:
        """Return what the values break; empty where all are as the manual says."""
        return () if self.valid(data) else self._broken(data)

    def _broken(self, data: bytes) -> tuple[Violation, ...]:
        result = []
        for field, read in self._judged:
            value = read(data)
            if field.allows(value):
                continue
            rule, text = _judge(field, value)
            result.append(Violation(rule, text, field.name))
        return tuple(result)

    def encode(self, values: Mapping[str, int | bytes]) -> bytes:
        """Return the bytes of integers as sent; fields left out take their fixed value, their default or 0.

        Raises KeyError for a name the layout does not have, ValueError for a value that its bits cannot hold.
        """
        unknown = set(values) - set(self.layout.named)
        if unknown:
            raise KeyError(", ".join(sorted(unknown)))
        total, tail = 0, b""
        for field in self.layout.fields:
            value: int | bytes = 0
            if field.kind is not FieldKind.RESERVED:
                preset = field.fixed if field.fixed is not None else field.default
                value = values.get(field.name, preset if preset is not None else 0)
            if isinstance(value, bytes):
                tail = value
                continue
            if not field.wire_minimum <= value <= field.wire_maximum and field.bit_width:
                raise ValueError(
                    f"{field.name}: {value} does not fit {field.bit_width} bits, "
                    f"expected {field.wire_minimum}..{field.wire_maximum}"
                )
            if field.order is Order.LITTLE:
                raw = value.to_bytes(field.bit_width // 8, "little", signed=field.kind is FieldKind.INT)
                value = int.from_bytes(raw, "big")
            total = total << field.bit_width | (value & ((1 << field.bit_width) - 1))
        return total.to_bytes(self.layout.byte_length, "big") + tail


def _judge(field: Field, value: int) -> tuple[str, str]:
    if field.kind is FieldKind.RESERVED:
        return "reserved_bits", f"{field.name}: expected 0, got {value}"
    if field.choices is not None and value not in field.choice_names:
        listed = ", ".join(f"{v} {n}" for v, n in sorted(field.choice_names.items())[:8])
        return "unknown_choice", f"{field.name}: got {value}, expected one of {listed}"
    if field.values is not None and value not in field.values:
        return "unknown_choice", f"{field.name}: got {value}, expected one of {sorted(field.values)}"
    unit = f" {field.unit}" if field.unit else ""
    got, low, high = (shown(field.physical(v)) for v in (value, field.low, field.high))
    return "out_of_range", f"{field.name}: got {got}{unit}, expected {low}..{high}{unit}"


def shown(value: float) -> str:
    """Return a number for people: integers in full, others to nine digits."""
    return str(value) if isinstance(value, int) else f"{value:.9g}"


class ReadCodec(Codec):
    """Reads data by the reader of their layout. It writes none."""

    def __init__(self, layout: ReadLayout) -> None:
        super().__init__(layout)
        self._reader = layout.reader
        self._numbers = frozenset(name for name, field in layout.named.items() if field.kind is FieldKind.NUMBER)
        #: The last data, their values, and why they have none: each frame is asked for both, more than once.
        self._last: tuple[bytes | None, dict[str, Any], MisfitError | None] = (None, {}, None)

    def _read(self, data: bytes) -> tuple[bytes | None, dict[str, Any], MisfitError | None]:
        if self._last[0] != data:
            try:
                self._last = data, _exact(self._reader(data), self._numbers), None
            except MisfitError as error:
                self._last = data, {}, error
        return self._last

    @cached_property
    def wire(self) -> Callable[[bytes], dict[str, Any]]:
        """Reads data into values by name; what was sent for them is the reader's own."""
        return self.physical_slowly

    @cached_property
    def physical(self) -> Callable[[bytes], dict[str, Any]]:
        return self.physical_slowly

    @cached_property
    def json(self) -> Callable[[bytes], bytes]:
        return self._json_slowly

    @cached_property
    def valid(self) -> Callable[[bytes], bool]:
        return lambda data: self.misfit(data) is None

    def physical_slowly(self, data: bytes) -> dict[str, Any]:
        return dict(self._read(data)[1])

    def matches(self, data: bytes) -> bool:
        return self.layout.fits(len(data)) and self.misfit(data) is None

    def misfit(self, data: bytes) -> Violation | None:
        error = self._read(data)[2]
        return None if error is None else Violation(error.rule, str(error))

    def broken(self, data: bytes) -> tuple[Violation, ...]:
        misfit = self.misfit(data)
        return () if misfit is None else (misfit,)

    def encode(self, values: Mapping[str, int | bytes]) -> bytes:
        raise ValueError("what a reader reads cannot be written")


def _exact(values: Mapping[str, Any], numbers: Set[str]) -> dict[str, Any]:
    """Return values as JSON and tables can hold them: a number that is none, or too long, has a text beside or instead of it.

    `numbers`: the fields that tables hold as doubles; all others are whole and have 64 bits at most.
    """
    result: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, float) and not isfinite(value):
            result[name + "_text"] = str(value)
            continue
        if isinstance(value, int) and abs(value) > EXACT:
            result[name + "_text"] = str(value)
            if name in numbers:
                if abs(value) > float_info.max:
                    continue
                value = float(value)
        result[name] = value
    return result


def codec(layout: Layout) -> Codec:
    """Return the codec of a layout; made once, and kept with it."""
    kept: Codec | None = layout.__dict__.get("_codec")
    if kept is None:
        kept = ReadCodec(layout) if isinstance(layout, ReadLayout) else Codec(layout)
        layout.__dict__["_codec"] = kept
    return kept
