"""Random requests, good and bad, in any order: a drive never raises and never answers what the manual forbids."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.codec import codec
from analyzer.decoder import Decoder
from analyzer.records import CanFrame, Frame
from tests.conformance.drives.test_mks_rig import NAMES, SECOND, Rig, frame_of


@st.composite
def requests(draw, name):
    """Draw a request of the catalogue with any values at all, and maybe damage it; return its bytes and address."""
    dialect = dialects.get(name)
    command = draw(st.sampled_from(sorted(dialect.by_name)).map(dialect.by_name.get))
    form = command.request_forms[draw(st.integers(0, len(command.request_forms) - 1))]
    if command.slots is not None:
        data = draw(st.binary(min_size=50, max_size=50) | st.binary(max_size=60))
    else:
        values = {}
        for name, field in form.layout.named.items():
            good = st.sampled_from([field.low, field.high, min(field.high, max(field.low, 100))])
            any_value = st.integers(field.wire_minimum, field.wire_maximum)
            if field.choices is not None:
                good = st.sampled_from(sorted(field.choice_names))
            values[name] = field.fixed if field.fixed is not None else draw(good | any_value)
        data = codec(form.layout).encode(values)
    address = draw(st.sampled_from([1, 1, 1, 1, 0, 80, 2, 255]))
    frame = bytearray(dialect.link.build(command, form, address, data, Role.REQUEST))
    damage = draw(st.sampled_from(["none"] * 6 + ["flip", "cut", "longer"]))
    if damage == "flip":
        place = draw(st.integers(0, len(frame) - 1))
        frame[place] ^= 1 << draw(st.integers(0, 7))
    elif damage == "cut":
        frame = frame[: draw(st.integers(0, len(frame) - 1))]
    elif damage == "longer":
        frame += draw(st.binary(min_size=1, max_size=4))
    return bytes(frame), address


#: What happens between requests: time, and things done to the drive from outside.
SCENES = st.one_of(
    st.tuples(st.just("wait"), st.sampled_from([0, 1, 10**6, 10**9, 10**11])),
    st.tuples(st.just("block"), st.booleans()),
    st.tuples(st.just("switch"), st.booleans()),
    st.tuples(st.just("turn"), st.integers(-50_000, 50_000)),
    st.tuples(st.just("supply"), st.sampled_from([0, 9, 24, 48])),
    st.tuples(st.just("power"), st.just(0)),
)


def play(rig, scene, value):
    drive = rig.drive
    if scene == "wait":
        rig.wait(value)
    elif scene == "block":
        drive.block(value)
    elif scene == "switch":
        drive.limit_switch("left" if rig.now % 2 else "right", value)
    elif scene == "turn":
        drive.turn_shaft(value)
    elif scene == "supply":
        drive.supply(value)
    else:
        drive.power_cycle(rig.now)


def message_of(dialect, data, can_id):
    return Decoder(dialect).decode(frame_of(dialect, data, 0, can_id))[0]


def forbidden(dialect, data, address, can_id):
    """Say why the manual forbids any answer to bytes, or return an empty text; told by the analyzer, not by the drive."""
    if not all(c.ok for c in dialect.link.checks(data, can_id)):
        return "bad check"
    if len(data) < 2:
        return "nothing"
    message = message_of(dialect, data, can_id)
    if message.address != address:
        return "another address, broadcast or group"
    if dialect.name == "mks-rs485" and data[0] != 0xFA:
        return "not a request"
    if dialect.name != "mks-modbus" and (message.command is None or message.form is None):
        return "unknown"
    return "package" if message.command is not None and message.command.slots is not None else ""


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=150, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_random_requests(name, data):
    model = data.draw(st.sampled_from(["", *dialects.get(name).models]))
    mode = data.draw(st.sampled_from([5, 5, 4, 3, 2]))
    rig = Rig(name, model=model, mode=mode, group_address=80)
    rig.drive.place_switch("left", -3000)
    moves = set()
    # 300 examples of 34 requests at least: more than ten thousand a dialect.
    for _ in range(data.draw(st.integers(34, 40))):
        drive = rig.drive
        dialect = drive.dialect
        if data.draw(st.integers(0, 3)) == 0:
            play(rig, *data.draw(SCENES))
        sent, to = data.draw(requests(dialect.name))
        can_id = to if rig.can else None
        address = drive.address
        rig.wait(0)
        said = rig.send(sent, can_id)
        why = forbidden(dialect, sent, address, can_id)
        asked = message_of(dialect, sent, can_id).command if len(sent) > 1 else None
        if not why and asked is not None and asked.motion is not None:
            moves.add(asked.name)
        if why:
            # What is sent to all may end a move before, as by protection; then its end is told, which answers nothing.
            ends = moves - {asked.name if asked is not None else ""}
            said = [each for each in said if message_of(dialect, each.data, each.can_id).command.name not in ends]
        assert not (why and said), why
        for each in said:
            if each.can_id is not None:
                assert each.can_id == address
                assert len(each.data) <= 8
            assert each.at_ns >= rig.now
            assert all(c.ok for c in dialect.link.checks(each.data, each.can_id))
        rig.wait(data.draw(st.sampled_from([0, 10**6, SECOND])))


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=200)
@given(blob=st.binary(max_size=64), address=st.sampled_from([0, 1, 80, 0x7FF]))
def test_any_bytes_at_all(name, blob, address):
    rig = Rig(name, group_address=80)
    dialect = rig.drive.dialect
    can_id = address if rig.can else None
    for data in (blob, dialect.link.completed(blob, can_id)):
        can = CanFrame(0, "bus", can_id, data) if rig.can else None
        good = all(c.ok for c in dialect.link.checks(data, can_id))
        rig.drive.receive(Frame("bus", 0, 0, 0, data, dialect, Role.REQUEST, good, can), rig.now)
        rig.wait(SECOND)
