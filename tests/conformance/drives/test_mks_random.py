"""Random requests, good and bad, in any order: a drive never raises and never answers what the manual forbids."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.decoder import Decoder
from analyzer.records import CanFrame, Frame
from tests.conformance.drives.test_mks_faults import any_request
from tests.conformance.drives.test_mks_rig import NAMES, SECOND, Rig, frame_of


def any_frame(chance, dialect):
    """Return the bytes of a request of the catalogue with any values at all, now and then damaged, and its address."""
    frame, address = any_request(chance, dialect)
    damage = chance.choice(["none"] * 6 + ["flip", "cut", "longer"])
    if damage == "flip":
        place = chance.randrange(len(frame))
        frame = frame[:place] + bytes((frame[place] ^ 1 << chance.randrange(8),)) + frame[place + 1 :]
    elif damage == "cut":
        frame = frame[: chance.randrange(len(frame))]
    elif damage == "longer":
        frame += chance.randbytes(chance.randint(1, 4))
    return frame, address


#: What happens between requests: time, and things done to the drive from outside.
SCENES = (
    ("wait", (0, 1, 10**6, 10**9, 10**11)),
    ("block", (False, True)),
    ("switch", (False, True)),
    ("turn", range(-50_000, 50_001)),
    ("supply", (0, 9, 24, 48)),
    ("power", (0,)),
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
@settings(max_examples=150)
@given(chance=st.integers(0, 1 << 64).map(random.Random))
def test_random_requests(name, chance):
    model = chance.choice(["", *dialects.get(name).models])
    mode = chance.choice([5, 5, 4, 3, 2])
    rig = Rig(name, model=model, mode=mode, group_address=80)
    rig.drive.place_switch("left", -3000)
    moves = set()
    # 150 examples: more than five thousand requests a dialect. To draw each value by itself takes most of the time.
    for _ in range(37):
        drive = rig.drive
        dialect = drive.dialect
        if chance.random() < 0.25:
            scene, values = chance.choice(SCENES)
            play(rig, scene, chance.choice(values))
        sent, to = any_frame(chance, dialect)
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
        rig.wait(chance.choice([0, 10**6, SECOND]))


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
