"""The encoder and the values people write: each field decodes to the encoded value."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.encoder import assemble, build, choose_form
from analyzer.errors import UsageError
from analyzer.layout import FieldKind, fixed, i16, rest, u8
from analyzer.reference.explanation import Explainer
from analyzer.reference.hex_frame import Given, read_frame, write_frame
from analyzer.values import decimal, parse_value, range_text, refusal, value_text

FORMS = [
    (dialect, command, role, form)
    for dialect in dialects.every()
    for command in dialect.commands
    if command.slots is None
    for role, forms in ((Role.REQUEST, command.request_forms), (Role.REPLY, command.reply_forms))
    for form in forms
]


def draw_values(data, layout):
    """Draw integers as sent that the bits of each field can hold."""
    values = {}
    for name, field in layout.named.items():
        if field.fixed is None:
            values[name] = data.draw(st.integers(field.wire_minimum, field.wire_maximum))
    return values


@settings(max_examples=600)
@given(st.data())
def test_what_is_built_is_explained_alike(data):
    dialect, command, role, form = data.draw(st.sampled_from(FORMS))
    values = draw_values(data, form.layout)
    address = data.draw(st.integers(*dialect.addresses))
    built = assemble(dialect, command, address, values, role, form)
    assert dict(built.values) | values == dict(built.values)
    can_id = address if dialect.bus == "can" else None
    given_frame = Given(built.frame, can_id)
    assert read_frame(write_frame(built.frame, can_id)).data in (built.frame, bytes((address & 0xFF,)) + built.frame)
    found = Explainer([dialect]).explain(given_frame, role=role)
    assert found.checks_ok
    assert found.right == built.frame or found.message.form is None or dialect.exception is found.message.form
    if found.message.form is form:
        assert found.message.values == dict(built.values)


@settings(max_examples=400)
@given(st.data())
def test_a_value_shown_is_the_value_read(data):
    _, _, _, form = data.draw(st.sampled_from([f for f in FORMS if f[3].layout.named]))
    field = data.draw(st.sampled_from([f for f in form.layout.named.values() if f.kind is not FieldKind.BYTES]))
    value = data.draw(st.integers(field.wire_minimum, field.wire_maximum))
    assert parse_value(field, str(value), as_sent=True) == value
    assert parse_value(field, hex(value), as_sent=True) == value
    exact = Fraction(value) * field.scale
    if 10**6 % exact.denominator == 0:
        assert parse_value(field, decimal(exact)) == value
        assert parse_value(field, f"{decimal(exact)} {field.unit}") == value
    if value in field.choice_names:
        assert parse_value(field, field.choice_names[value].upper()) == value


def test_defaults_fill_what_is_left_out():
    dialect = dialects.get("mks-can").for_model("57E")
    assert build(dialect, "set_current", 1) == bytes.fromhex("83 0C 80 10")


def test_physical_numbers():
    dialect = dialects.get("lk-rs485")
    assert build(dialect, "run_speed", 1, {"speed": 360.0}, physical=True) == build(dialect, "run_speed", 1, {"speed": 36000})
    assert build(dialect, "run_speed", 1, {"speed": "360"}, physical=True).hex() == "3ea20104e5a08c00002c"


def test_bytes_are_taken_as_they_are():
    dialect = dialects.get("mks-rs485")
    assert build(dialect, "long_package", 0, {"slot_bytes": bytes(50)}) == bytes.fromhex("FC" + "00" * 50 + "FC")
    assert assemble(dialect, "long_package", 0, {"slot_bytes": bytes(49)}).refusals


def test_a_form_by_the_values_that_make_it_what_it_is():
    command = dialects.get("lk-rs485").by_name["write_parameter"]
    assert choose_form(command, Role.REQUEST, {"parameter": 32})[0].name == "speed_limit"
    assert choose_form(command, Role.REQUEST, {"parameter": 200})[0].name == "unlisted_parameter"
    with pytest.raises(UsageError, match="has angle_kp, speed_kp together"):
        choose_form(command, Role.REQUEST, {"angle_kp": 1, "speed_kp": 1})


@pytest.mark.parametrize(
    ("field", "text", "value"),
    [
        (u8("x"), "0x10", 16),
        (u8("x"), "+7", 7),
        (u8("x"), "7.0", 7),
        (u8("x", maximum=1), "yes", 1),
        (i16("x", scale=Fraction(1, 100)), "-1.005", -100),
        (i16("x", scale=Fraction(1, 100)), "-1.006", -101),
        (rest("x"), "01 ff", b"\x01\xff"),
    ],
)
def test_values_from_text(field, text, value):
    assert parse_value(field, text) == value


@pytest.mark.parametrize("text", ["", " ", "1,5", "1e3", "inf", "0x", "--1", "1/2", "yes", "\x1b", "9" * 5000])
def test_texts_that_are_no_values(text):
    with pytest.raises(UsageError, match="x: got"):
        parse_value(u8("x"), text)


def test_words_for_ranges_and_values():
    assert range_text(u8("x", maximum=7, unit="V", scale=Fraction(1, 2))) == "0..3.5 V"
    assert range_text(fixed("x", 8, 3)) == "always 3"
    assert range_text(u8("x", values=frozenset({1, 5}))) == "1, 5"
    assert refusal(u8("x", maximum=7), 7) is None
    assert refusal(fixed("x", 8, 3), 4) == "x: got 4, expected 3"
    assert value_text(rest("x"), b"\x01\x02") == "01 02"
    assert decimal(Fraction(-1, 3)) == "-0.333333"
    assert decimal(Fraction(-9, 1280)) == "-0.007031"
    assert decimal(2**63) == "9223372036854775808"
