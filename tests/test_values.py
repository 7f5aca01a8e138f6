"""Values as people write them: what is printed is read back, and what is refused says what was expected."""

from __future__ import annotations

from enum import IntEnum
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from analyzer import dialects
from analyzer.errors import UsageError
from analyzer.layout import FieldKind, i16, rest, u8, u16
from analyzer.values import counted, decimal, near, parse_value, printable, quote, range_text, refusal, value_text, with_unit

FIELDS = {
    f"{d.name}-{c.name}-{f.name}": f
    for d in dialects.every()
    for c in d.commands
    for form in (*c.request_forms, *c.reply_forms)
    for f in form.layout.named.values()
    if f.kind is not FieldKind.BYTES and f.bit_width <= 32
}


class Switch(IntEnum):
    DISABLED = 0
    ENABLED = 1


class Direction(IntEnum):
    CCW = 0
    CW = 1


@pytest.mark.parametrize("field", FIELDS.values(), ids=FIELDS)
def test_the_bounds_of_every_field_are_printed_and_read_back(field):
    for value in {field.low, field.high, field.default or field.low}:
        name = field.choice_names.get(value)
        # Six digits are printed; a scale without a finite decimal is read back to the nearest integer.
        assert parse_value(field, name or with_unit(field, value)) == value
        assert parse_value(field, str(value), as_sent=True) == value
        assert (refusal(field, value) is None) == field.allows(value)


@given(st.fractions(-(10**9), 10**9))
def test_decimals_are_exact_to_six_digits(value):
    assert abs(Fraction(decimal(value)) - value) <= Fraction(1, 2 * 10**6)


def test_what_a_text_means():
    assert parse_value(u16("speed", unit="rpm"), "320 rpm") == 320
    assert parse_value(u16("speed"), "0x140") == 320
    assert parse_value(i16("angle", scale=Fraction(1, 100), unit="deg"), "-3.5 deg") == -350
    assert parse_value(u8("x", choices=Direction), "CW") == 1
    assert parse_value(u8("x", choices=Switch), "on") == 1
    assert parse_value(u8("x", maximum=1), "off") == 0
    assert parse_value(rest("data"), "FA 01") == b"\xfa\x01"


@pytest.mark.parametrize(
    ("field", "text", "why"),
    [
        (u8("x"), "3.5", "expected a whole number"),
        (u8("x", choices=Direction), "cww", "did you mean"),
        # A direction is never on.
        (u8("x", choices=Direction), "on", "expected 0 ccw, 1 cw"),
        (u8("x"), "1" * 1000, r"\(1000 characters\)"),
        (rest("data"), "FA 0", "expected hex bytes"),
    ],
)
def test_a_text_that_means_nothing(field, text, why):
    with pytest.raises(UsageError, match=why):
        parse_value(field, text)


def test_ranges_are_told_as_they_are_declared():
    assert range_text(u16("speed", maximum=3000, unit="rpm")) == "0..3000 rpm"
    assert range_text(u8("x", choices=Direction)) == "0 ccw, 1 cw"
    assert range_text(u8("x", values=frozenset({16, 8}))) == "8, 16"
    assert range_text(u8("x", values=frozenset(range(40))), 10) == "one of 40"
    assert refusal(u16("speed", maximum=3000, unit="rpm"), 3001) == "speed: got 3001 rpm, expected 0..3000 rpm"
    assert value_text(u8("x", choices=Direction), 1) == "1 cw"


@given(st.text(max_size=200))
def test_nothing_that_is_shown_steers_a_terminal(text):
    assert printable(text).isprintable()
    assert quote(text).isprintable()
    assert quote(text).isascii()


def test_counts_and_near_names():
    assert [counted(n, "frame") for n in range(3)] == ["0 frames", "1 frame", "2 frames"]
    assert near("run_sped", ["run_speed", "home"]) == "; did you mean run_speed?"
    assert near("xyz", ["run_speed", "home"]) == ""
