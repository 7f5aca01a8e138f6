"""Layouts and codecs: every layout of every dialect round-trips, and what it breaks is named."""

from __future__ import annotations

from fractions import Fraction

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from analyzer import dialects
from analyzer.codec import codec
from analyzer.layout import Field, FieldKind, Layout, Order, bits, fixed, reserved, rest, sint, u8, u16, uint

LAYOUTS = [
    (f"{d.name}-{c.name}-{f.name}", f.layout)
    for d in dialects.every()
    for c in (*d.commands, *d.fallbacks.values())
    for f in (*c.request_forms, *c.reply_forms)
]


def reference(layout: Layout, data: bytes) -> dict[str, int]:
    """Read a layout bit by bit, the slow and plain way."""
    result = {}
    for offset, field in layout:
        chosen = data[offset // 8 : (offset + field.bit_width) // 8] if field.order is Order.LITTLE else b""
        text = "".join(f"{b:08b}" for b in data)[offset : offset + field.bit_width]
        value = int.from_bytes(chosen, "little") if chosen else int(text or "0", 2)
        if field.kind is FieldKind.INT and value >> (field.bit_width - 1):
            value -= 1 << field.bit_width
        if field.kind is not FieldKind.RESERVED:
            result[field.name] = value
    return result


@pytest.mark.parametrize("layout", [x for _, x in LAYOUTS], ids=[n for n, _ in LAYOUTS])
def test_every_layout_reads_as_the_plain_way_and_writes_back(layout):
    coder = codec(layout)
    for seed in range(7):
        data = bytes((seed * 37 + 91 * i + (255 if seed == 6 else 0)) & 0xFF for i in range(layout.byte_length))
        wire = coder.wire(data)
        if layout.open_ended:
            continue
        assert wire == reference(layout, data)
        back = coder.encode(wire)
        masked = coder.encode(coder.wire(back))
        assert coder.wire(back) == wire
        assert masked == back
        assert msgspec.json.decode(coder.json(data).rstrip(b",") + b"}") == coder.physical(data)
        assert coder.physical(data) == coder.physical_slowly(data)
        assert bool(coder.broken(data)) == (not coder.valid(data))


def fields():
    """Layouts of random widths, big-endian, filled up to whole bytes."""
    widths = st.lists(st.tuples(st.integers(1, 40), st.booleans()), min_size=1, max_size=6)

    def build(parts):
        made = [Field(name=f"f{i}", bit_width=w, kind=FieldKind.INT if s else FieldKind.UINT) for i, (w, s) in enumerate(parts)]
        missing = -sum(w for w, _ in parts) % 8
        return Layout(*made, *([reserved(missing)] if missing else []))

    return widths.map(build)


@given(fields(), st.data())
def test_any_layout_round_trips(layout, data):
    values = {name: data.draw(st.integers(field.wire_minimum, field.wire_maximum)) for name, field in layout.named.items()}
    raw = codec(layout).encode(values)
    assert len(raw) == layout.byte_length
    assert codec(layout).wire(raw) == values == reference(layout, raw)


def test_what_is_broken_is_named_with_expected_and_got():
    layout = Layout(bits("a", 4, maximum=9), reserved(4), u16("speed", maximum=3000, unit="rpm"))
    rules = [(v.rule, v.text) for v in codec(layout).broken(bytes.fromhex("F1 0FA0"))]
    assert rules == [
        ("out_of_range", "a: got 15, expected 0..9"),
        ("reserved_bits", "reserved: expected 0, got 1"),
        ("out_of_range", "speed: got 4000 rpm, expected 0..3000 rpm"),
    ]


def test_int24_has_one_value_too_many():
    layout = dialects.get("mks-can").by_name["move_absolute_axis"].request_forms[-1].layout
    coder = codec(layout)
    ok = coder.encode({"speed": 1, "acceleration": 1, "position": -8388607})
    assert coder.broken(ok) == ()
    lowest = ok[:-3] + b"\x80\x00\x00"
    assert [v.rule for v in coder.broken(lowest)] == ["out_of_range"]


def test_integers_beyond_a_double_get_a_text_twin():
    layout = Layout(sint("position", 64, scale=Fraction(1, 100)))
    shown = codec(layout).physical((2**53 + 1).to_bytes(8, "big"))
    assert shown["position_text"] == "90071992547409.93"
    assert "position_text" not in codec(layout).physical((12345).to_bytes(8, "big"))


def test_encode_refuses_what_the_bits_cannot_hold_and_unknown_names():
    layout = Layout(u8("a"), fixed("b", 8, 7))
    assert codec(layout).encode({"a": 1}) == b"\x01\x07"
    with pytest.raises(ValueError, match=r"a: 256 does not fit 8 bits, expected 0\.\.255"):
        codec(layout).encode({"a": 256})
    with pytest.raises(KeyError, match="speed"):
        codec(layout).encode({"speed": 1})


@pytest.mark.parametrize(
    "declare",
    [
        lambda: Layout(u8("a"), u8("a")),
        lambda: Layout(rest("a"), u8("b")),
        lambda: Layout(bits("a", 4), u16("b", order=Order.LITTLE), bits("c", 4)),
        lambda: Layout(bits("a", 3)),
        lambda: u8("address"),
        lambda: u8("_raw"),
        lambda: uint("a", 12, order=Order.LITTLE),
    ],
)
def test_a_declaration_that_cannot_be_is_refused(declare):
    with pytest.raises(ValueError, match=r"\S"):
        declare()
