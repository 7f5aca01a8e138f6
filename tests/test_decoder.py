"""The decoder by itself: who sent a frame, which form it has, and that no bytes make it raise."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.context import Context, Request
from analyzer.decoder import Decoder, physical, slots_of
from analyzer.records import CanFrame, Frame
from tests.collect import crc, sum8

DECODERS = {d.name: Decoder(d) for d in dialects.every()}


def frame(name, text, role=Role.UNKNOWN):
    """A frame of hex text; on CAN `001#F601` with its identifier."""
    dialect = dialects.get(name)
    identifier, _, payload = text.rpartition("#")
    data = bytes.fromhex(payload)
    can = CanFrame(0, "bus", int(identifier, 16), data) if identifier else None
    return Frame("bus", 0, 0, 0, data, dialect, role, True, can)


def decoded(name, text, role=Role.UNKNOWN, context=None):
    return DECODERS[name].decode(frame(name, text, role), context)[0]


@given(st.sampled_from(sorted(DECODERS)), st.binary(min_size=1, max_size=60), st.sampled_from(list(Role)))
def test_no_bytes_make_it_raise(name, data, role):
    dialect = dialects.get(name)
    can = CanFrame(0, "bus", 1, data[:8]) if dialect.bus == "can" else None
    made = Frame("bus", 0, 0, 0, data[:8] if can else data, dialect, role, False, can)
    message, _ = DECODERS[name].decode(made, Context())
    physical(message)
    assert message.frame is made
    assert (message.form is None) <= (not message.values)


def test_the_head_tells_the_role_before_the_mark_of_the_capture():
    assert decoded("mks-rs485", sum8("FA 01 32"), Role.REPLY).role is Role.REQUEST
    assert decoded("mks-rs485", sum8("FB 01 32 00 64"), Role.REQUEST).role is Role.REPLY


def test_without_a_head_the_mark_then_the_length_tell_the_role():
    ask, answer = "001#3233", "001#32006497"
    assert decoded("mks-can", ask).role is Role.REQUEST
    assert decoded("mks-can", answer).role is Role.REPLY
    assert decoded("mks-can", "001#800081").role is Role.UNKNOWN
    assert decoded("mks-can", "001#800081", Role.REPLY).role is Role.REPLY


def test_an_open_request_tells_which_registers_a_modbus_reply_carries():
    name = "mks-modbus"
    context = Context()
    answer = crc("01 04 02 01 40")
    assert decoded(name, answer, context=context).command.name == "unknown_read"
    ask = decoded(name, crc("01 04 00 32 00 01"))
    context.open[1] = [Request.of(ask, 1, "/bus/1/read_speed/request")]
    message, request = DECODERS[name].decode(frame(name, answer), context)
    assert message.command.name == "read_speed"
    assert request is context.open[1][0]


@pytest.mark.parametrize(
    ("text", "rule"),
    [("FA 01 77", "unknown_command"), ("FA 01 F6 01 40", "wrong_length"), ("FA 01 F6 0F A0 02", "out_of_range")],
)
def test_what_does_not_fit_the_catalogue_survives_with_its_rule(text, rule):
    assert [v.rule for v in decoded("mks-rs485", sum8(text)).violations] == [rule]


@pytest.mark.parametrize("dialect", [d for d in dialects.every() if d.bus == "serial"], ids=lambda d: d.name)
def test_a_lane_decodes_as_the_decoder_does(dialect):
    decoder = Decoder(dialect)
    seen = 0
    for vector in (v for command in dialect.commands for v in command.vectors if not v.erratum and v.checksum):
        made = Frame("bus", 0, 0, 0, vector.data, dialect, Role.UNKNOWN, True)
        lane = decoder.lane(made, Context())
        if lane is not None:
            seen += 1
            assert lane.message(made) == decoder.decode(made, Context())[0]
    assert seen


def test_the_slots_of_a_package_are_requests_of_their_own():
    command = dialects.find_command(dialects.get("mks-rs485"), "long_package")
    size = command.slots.size
    data = bytes.fromhex("01 F6 01 40 02").ljust(size, b"\0") + bytes(size) + bytes.fromhex("02 77")
    first, last = slots_of(dialects.get("mks-rs485"), command, data)
    assert (first.address, first.command.name) == (1, "run_speed")
    assert (last.address, last.command, [v.rule for v in last.violations]) == (2, None, ["unknown_command"])
