"""The table of a layout's fields on a reference page: where each stands, its type, unit, limits and names.

The first column is the number that stands for a field in the bit diagram. Values are in the field's unit. Choices, what
differs between models, and notes stand below the table.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from analyzer.layout import Field, FieldKind, Layout, ModelLimits, Order
from analyzer.reference.bit_diagram import key
from analyzer.reference.columns import WIDTH, columns
from analyzer.values import range_text, value_text, with_unit

#: A natural range wider than this many bits says nothing that the type does not.
_TELLING_WIDTH = 32
#: The first columns are always there; the others only where a field needs them.
_ALWAYS = 4


def field_table(layout: Layout, *, indent: str) -> Iterator[str]:
    """Yield the table of a layout's fields, and below it what does not go into a column."""
    rows: list[tuple[str, ...]] = [("", "field", "byte:bit", "type", "unit", "scale", "range", "default", "printed")]
    details: list[tuple[str, str]] = []
    number = 0
    for offset, field in layout:
        if field.kind is FieldKind.RESERVED:
            continue
        rows.append(_field_row(key(number), offset, field))
        details += _details(field)
        number += 1
    used = [i for i in range(len(rows[0])) if i < _ALWAYS or any(row[i] for row in rows[1:])]
    yield from columns([[row[i] for i in used] for row in rows], width=WIDTH, indent=indent)
    if details:
        yield ""
        yield from columns(details, width=WIDTH, indent=2 * indent)


def _field_row(letter: str, offset: int, field: Field) -> tuple[str, ...]:
    default = "" if field.default is None else value_text(_bare(field), field.default)
    scale = "" if field.scale == 1 else str(field.scale)
    kind = "bytes" if field.kind is FieldKind.BYTES else f"{field.kind.value}{field.bit_width}"
    kind += " le" if field.order is Order.LITTLE else ""
    return letter, field.name, _place(offset, field), kind, field.unit, scale, _limits(field), default, field.printed


def _place(offset: int, field: Field) -> str:
    """Return where a field stands: bytes from 0, and bits from 7 where it does not fill whole bytes."""
    first = offset // 8
    if field.bit_width == 0:
        return f"{first}.."
    end = offset + field.bit_width - 1
    last = end // 8
    if offset % 8 == 0 and end % 8 == 7:
        return str(first) if first == last else f"{first}-{last}"
    high, low = 7 - offset % 8, 7 - end % 8
    if first == last:
        return f"{first}:{high}" if high == low else f"{first}:{high}-{low}"
    return f"{first}:{high}-{last}:{low}"


def _bare(field: Field) -> Field:
    """Return a field without its unit, which has a column of its own."""
    return replace(field, unit="")


def _limits(field: Field) -> str:
    if field.kind is FieldKind.BYTES:
        return ""
    if field.fixed is not None:
        return f"always {value_text(_bare(field), field.fixed)}"
    if field.choices is not None or field.values is not None:
        return f"{len(field.values or field.choice_names)} values"
    if field.minimum is None and field.maximum is None and field.bit_width > _TELLING_WIDTH:
        return "any"
    return range_text(_bare(field))


def _details(field: Field) -> Iterator[tuple[str, str]]:
    if field.fixed is None and (field.choices is not None or field.values is not None):
        yield field.name, range_text(field)
    for model, limits in (field.models or {}).items():
        yield field.name, f"{model}: {_model_text(field.for_model(model), limits)}"
    if field.note:
        yield field.name, field.note


def _model_text(field: Field, limits: ModelLimits) -> str:
    words = []
    if limits.scale is not None or limits.unit is not None:
        words.append(f"{field.scale} {field.unit} as sent")
    if limits.minimum is not None or limits.maximum is not None:
        words.append(range_text(field))
    if limits.default is not None:
        words.append(f"default {with_unit(field, limits.default)}")
    return ", ".join(words)
