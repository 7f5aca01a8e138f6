"""Fields and layouts as declarations: bounds, limits of models, and what a declaration may not be."""

from __future__ import annotations

from enum import IntEnum
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from analyzer.layout import Field, FieldKind, Layout, ModelLimits, Order, fixed, i16, reserved, rest, sint, u8, u16, uint


class Direction(IntEnum):
    CCW = 0
    CW = 1


@given(st.integers(1, 64), st.booleans())
def test_the_bits_bound_a_field_without_limits(width, signed):
    field = (sint if signed else uint)("x", width)
    assert field.high - field.low == (1 << width) - 1
    assert (field.low < 0) == signed
    assert field.allows(field.low)
    assert field.allows(field.high)
    assert not field.allows(field.low - 1)
    assert not field.allows(field.high + 1)


@given(st.integers(-(1 << 15), (1 << 15) - 1), st.fractions(Fraction(1, 4096), 100, max_denominator=4096))
def test_a_physical_value_leads_back_to_the_integer_as_sent(value, scale):
    field = i16("x", scale=scale)
    assert field.wire(field.physical(value)) == value


def test_limits_choices_values_and_fixed_values_are_each_held():
    assert [n for n in range(8) if u8("x", minimum=2, maximum=4).allows(n)] == [2, 3, 4]
    assert [n for n in range(8) if u8("x", choices=Direction).allows(n)] == [0, 1]
    assert [n for n in range(8) if u8("x", values=frozenset({1, 4})).allows(n)] == [1, 4]
    assert [n for n in range(8) if fixed("x", 8, 5).allows(n)] == [5]
    assert [n for n in range(8) if reserved(8).allows(n)] == [0]
    assert u8("x", choices=Direction).choice_names == {0: "ccw", 1: "cw"}


def test_a_model_changes_only_what_it_declares():
    limits = {"42D": ModelLimits(maximum=3000), "MG": ModelLimits(scale=Fraction(66, 4096), unit="A")}
    field = u16("current", maximum=5200, unit="mA", default=1600, models=limits)
    assert (field.for_model("42D").high, field.for_model("42D").unit) == (3000, "mA")
    assert (field.for_model("MG").high, field.for_model("MG").unit) == (5200, "A")
    assert field.for_model("57D") is field
    assert Layout(field).for_model("42D").named["current"].high == 3000


@given(st.lists(st.integers(1, 24), min_size=1, max_size=8))
def test_fields_cover_a_layout_without_gaps(widths):
    widths.append(-sum(widths) % 8 or 8)
    layout = Layout(*(uint(f"f{n}", width) for n, width in enumerate(widths)))
    assert layout.byte_length * 8 == sum(widths)
    ends = [offset + field.bit_width for offset, field in layout]
    assert list(layout.offsets) == [0, *ends[:-1]]
    assert [n for n in range(40) if layout.fits(n)] == [layout.byte_length]


def test_an_open_ended_layout_fits_every_length_from_its_fixed_part_on():
    layout = Layout(u8("head"), rest("data"))
    assert layout.open_ended
    assert [n for n in range(4) if layout.fits(n)] == [1, 2, 3]
    assert set(Layout(u8("x"), reserved(8)).named) == {"x"}


@pytest.mark.parametrize(
    ("declare", "why"),
    [
        (lambda: Layout(u8("a"), u8("a")), "two fields of one name"),
        (lambda: Layout(rest("a"), u8("b")), "not the last"),
        (lambda: Layout(uint("a", 4)), "do not fill whole bytes"),
        (lambda: Layout(uint("a", 4), Field(name="b", bit_width=8, order=Order.LITTLE), uint("c", 4)), "starts at bit 4"),
        (lambda: Field(name="b", bit_width=12, order=Order.LITTLE), "expected whole bytes"),
        (lambda: u8("voltage", scale=0.1), "expected a Fraction"),
        (lambda: u8("address"), "taken by the log"),
        (lambda: u8("_raw"), "taken by the log"),
    ],
)
def test_what_cannot_be_declared(declare, why):
    with pytest.raises(ValueError, match=why):
        declare()


def test_reserved_bits_may_share_a_name():
    layout = Layout(uint("a", 4), reserved(4), uint("b", 4), reserved(4))
    assert [f.kind for _, f in layout].count(FieldKind.RESERVED) == 2
