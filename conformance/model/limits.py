"""The limits of fields and layouts as lists of integers: values at and beyond the limits, and reserved bits.

    edges(field)             the limits, or every choice           beyond(field)        the nearest forbidden values
    across(field, n)         some values spread over it
    allowed(field)           spans of allowed values               forbidden(field)     spans of forbidden ones
    between(spans, n, seed)  some values that are drawn
    reserved_masks(layout)   the reserved bits, as data            with_bits(layout, values, mask)

Strategies (`conformance.model.strategies`) and claims are made from these lists.
"""

from __future__ import annotations

import random
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from analyzer.catalogue import Command
from analyzer.codec import codec
from analyzer.layout import Field, FieldKind, Layout
from conformance.gate.bounds import NO_BOUNDS, Leeway, Span, span

#: How often a value is drawn; and how many bits it may be away from 0 where a span holds that: small ones and large ones.
_DRAWS, _REACH = 24, (8, 16, 32, 64)


def listed(field: Field) -> tuple[int, ...] | None:
    """Return all allowed values of a field that has a list of them, None for one that has a range."""
    if field.fixed is not None:
        return (field.fixed,)
    if field.kind is FieldKind.RESERVED:
        return (0,)
    if field.values is None and field.choices is None:
        return None
    return tuple(v for v in sorted(field.values or field.choice_names) if field.allows(v))


def edges(field: Field, leeway: Leeway = NO_BOUNDS) -> tuple[int, ...]:
    """Return the limits of a field, or all its choices, within the bounds of `leeway`; empty where they leave nothing."""
    kept = span(field, leeway)
    choices = listed(field)
    if choices is not None:
        return tuple(v for v in choices if kept[0] <= v <= kept[1])
    return tuple(sorted(set(kept))) if kept[0] <= kept[1] else ()


def allowed(
    field: Field, leeway: Leeway = NO_BOUNDS, without: Sequence[Span] = (), command: Command | None = None
) -> list[Span]:
    """Return the spans of values that the manual, the bounds of `leeway` and `without` leave.

    `command`: the command of the field, where its motion matters.
    """
    choices = listed(field)
    kept = span(field, leeway, command)
    if choices is not None:
        left = [(v, v) for v in choices if kept[0] <= v <= kept[1]]
    else:
        left = [kept] if kept[0] <= kept[1] else []
    for low, high in without:
        cut = [((a, min(b, low - 1)), (max(a, high + 1), b)) for a, b in left]
        left = [each for pair in cut for each in pair if each[0] <= each[1]]
    return left


def forbidden(field: Field) -> list[Span]:
    """Return the spans of values that the manual forbids and the bits can hold."""
    if field.kind is FieldKind.BYTES or field.kind is FieldKind.RESERVED or field.fixed is not None:
        return []
    result, at = [], field.wire_minimum
    for low, high in allowed(field):
        if at < low:
            result.append((at, low - 1))
        at = high + 1
    if at <= field.wire_maximum:
        result.append((at, field.wire_maximum))
    return result


def across(field: Field, count: int) -> tuple[int, ...]:
    """Return up to `count` allowed numbers within a range, each by one factor greater than the one before.

    A threshold between two of them shows, wherever in the range it is.
    """
    first, share = max(1, field.low), 1 / (count + 1)
    values = (round(first * (max(first, field.high) / first) ** (share * number)) for number in range(1, count + 1))
    return tuple(dict.fromkeys(value for value in values if field.low < value < field.high and field.allows(value)))


def between(spans: Iterable[Span], count: int, seed: str) -> tuple[int, ...]:
    """Return up to `count` different values between the ends of spans, small ones and large ones; the same for one seed."""
    chance = random.Random(seed)
    wide = [(low + 1, high - 1) for low, high in spans if high - low > 1]
    found: dict[int, None] = {}
    for _ in range(_DRAWS if wide else 0):
        low, high = chance.choice(wide)
        middle, reach = max(low, min(0, high)), 1 << chance.choice(_REACH)
        found[chance.randint(max(low, middle - reach), min(high, middle + reach))] = None
    return tuple(found)[:count]


def beyond(field: Field) -> tuple[int, ...]:
    """Return the forbidden values next to the limits and in the gaps between choices, and the last the bits can hold."""
    ends = {end for each in forbidden(field) for end in each}
    near = {v + step for low, high in allowed(field) for v in (low, high) for step in (-1, 1)}
    outermost = {field.wire_minimum, field.wire_maximum}
    return tuple(sorted(ends & (near | outermost)))


def reserved_masks(layout: Layout) -> tuple[int, ...]:
    """Return the reserved bits of a layout, each alone, the lowest first, as numbers over its whole data."""
    total = layout.byte_length * 8
    return tuple(
        sorted(
            1 << (total - 1 - bit)
            for offset, field in layout
            if field.kind is FieldKind.RESERVED
            for bit in range(offset, offset + field.bit_width)
        )
    )


def with_bits(layout: Layout, values: Mapping[str, Any], mask: int) -> bytes:
    """Return the data of values with the bits of a mask set too."""
    data = codec(layout).encode(values)
    return (int.from_bytes(data, "big") | mask).to_bytes(len(data), "big")
