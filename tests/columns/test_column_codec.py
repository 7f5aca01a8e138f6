"""The columns of a layout hold what the codec of single frames reads."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from analyzer import dialects
from analyzer.codec import EXACT, codec
from analyzer.columns.codec import ColumnCodec
from analyzer.layout import Field, FieldKind, Layout, Order

WIDTHS = st.integers(1, 53)


@st.composite
def layouts(draw):
    """Draw a layout of whole bytes."""
    fields, bits = [], 0
    for number in range(draw(st.integers(1, 5))):
        kind = draw(st.sampled_from((FieldKind.UINT, FieldKind.INT, FieldKind.RESERVED)))
        order = draw(st.sampled_from(Order))
        width = 8 * draw(st.integers(1, 6)) if order is Order.LITTLE or draw(st.booleans()) else draw(WIDTHS)
        if order is Order.LITTLE and bits % 8:
            fields.append(Field(name=f"gap_{number}", bit_width=8 - bits % 8, kind=FieldKind.RESERVED))
            bits += 8 - bits % 8
        values = st.integers(0, (1 << (width - 1)) - 1)
        allowed = (
            {}
            if kind is FieldKind.RESERVED
            else draw(
                st.one_of(
                    st.just({}),
                    st.fixed_dictionaries({}, optional={"minimum": values, "maximum": values}),
                    st.fixed_dictionaries({"fixed": values}),
                    st.fixed_dictionaries({"values": st.frozensets(values, min_size=1, max_size=4)}),
                )
            )
        )
        fields.append(Field(name=f"field_{number}", bit_width=width, kind=kind, order=order, **allowed))
        bits += width
    if bits % 8:
        fields.append(Field(name="rest", bit_width=8 - bits % 8, kind=FieldKind.RESERVED))
    return Layout(*fields)


def check(layout: Layout, rows: list[bytes]) -> None:
    """Compare all that the two codecs say of the data of some frames."""
    named = [f for f in layout.fields if f.kind is not FieldKind.RESERVED]
    single, start = codec(layout), len(rows) % 11
    columns = ColumnCodec(layout, start)
    width = -(-(start + layout.byte_length) // 8) * 8
    data = np.full((len(rows), width), 0xA5, dtype=np.uint8)
    data[:, start : start + layout.byte_length] = np.frombuffer(b"".join(rows), dtype=np.uint8).reshape(len(rows), -1)
    wire = {name: values.tolist() for name, values in columns.wire(data).items()}
    assert [{name: values[n] for name, values in wire.items()} for n in range(len(rows))] == [single.wire(row) for row in rows]
    assert columns.matches(data).tolist() == [single.matches(row) for row in rows]
    # The codec of single frames takes the numbers that JSON does not hold exactly.
    exact = [
        all(abs(v) * f.scale.numerator <= EXACT for v, f in zip(single.wire(row).values(), named, strict=True)) for row in rows
    ]
    assert columns.valid(data).tolist() == [single.valid(row) and fits for row, fits in zip(rows, exact, strict=True)]


@given(st.data())
def test_layouts_and_data_of_any_kind(data):
    layout = data.draw(layouts())
    size = layout.byte_length
    check(layout, data.draw(st.lists(st.binary(min_size=size, max_size=size), min_size=1, max_size=12)))


FORMS = [
    pytest.param(form.layout, id=f"{dialect.name}-{command.name}-{role}-{number}")
    for dialect in dialects.every()
    for command in dialect.commands
    for role, forms in (("request", command.request_forms), ("reply", command.reply_forms))
    for number, form in enumerate(forms)
    if ColumnCodec.fits(form.layout) and form.layout.byte_length
]


@pytest.mark.parametrize("layout", FORMS)
def test_layouts_of_the_manuals(layout):
    size = layout.byte_length
    rows = [bytes(size), b"\xff" * size, bytes(range(1, size + 1)), bytes(range(255, 255 - size, -1))]
    # Around what a field allows, and every value of a byte.
    rows += [bytes([value] * size) for value in range(0, 256, 3)]
    for field in layout.fields:
        if field.kind is not FieldKind.RESERVED:
            pattern = {f.name: 0 for f in layout.fields if f.kind is not FieldKind.RESERVED}
            for value in {field.low, field.high, *list(field.choice_names)[:4]}:
                rows.append(codec(layout).encode(pattern | {field.name: value}))
    check(layout, rows)
