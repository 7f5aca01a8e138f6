"""Records of the pipeline: immutable, and a lane says of its frames what their messages say."""

from __future__ import annotations

import pytest

from analyzer.codec import codec
from analyzer.records import Chunk, Event, Lane
from tests.collect import serial, sum8


def test_records_cannot_be_changed():
    chunk = Chunk(0, "a", b"\xfa")
    with pytest.raises(AttributeError):
        chunk.data = b""
    assert Event(0, "a", "note") == Event(0, "a", "note", {})


def test_a_message_reads_its_values_from_its_own_data():
    message = serial("mks-rs485", (0, sum8("FA 01 F6 01 40 02"))).entries[0].message
    assert message.values == {"direction": 0, "speed": 320, "acceleration": 2}
    unknown = serial("mks-rs485", (0, sum8("FA 01 77"))).entries[0].message
    assert unknown.values == {}


def test_a_lane_makes_the_message_of_a_frame():
    message = serial("mks-rs485", (0, sum8("FA 01 F6 01 40 02"))).entries[0].message
    frame = message.frame
    lane = Lane(frame.dialect, message.role, 1, message.command, message.form, 3, 6)
    assert lane.message(frame) == message
    assert lane.is_request
    assert lane.plain
    assert lane.codec is codec(message.form.layout)
    assert not Lane(frame.dialect, message.role, 0, message.command, message.form, 3, 6).plain
