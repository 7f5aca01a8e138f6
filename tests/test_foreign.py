"""Other nodes on a bus: their frames are kept, told apart, and nothing is found wrong with them."""

from __future__ import annotations

import pytest

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.pipeline import Pipeline
from analyzer.records import CanFrame
from tests.collect import Collect, can, crc, run, serial, sum8

DRIVE = ("001#3233", "001#320140 74".replace(" ", ""))
#: A CANopen node, an RMD motor, a J1939 node: none of them is a drive of the dialect.
CANOPEN = ("080#", "000#0101", "701#05", "601#4018100100000000", "581#4318100113000000", "181#0000000000000000")
RMD = ("141#9C00000000000000", "141#9C25010050007A01", "141#A200000010270000")
J1939 = CanFrame(0, "can0", 0x18FEF100, bytes(8), extended=True)


def test_nodes_of_other_protocols_are_foreign_without_findings():
    sink = can(*CANOPEN, *DRIVE, *RMD)
    assert sink.rules == []
    assert sink.topics.count("foreign") == len(CANOPEN) + len(RMD)
    assert [t for t in sink.topics if t != "foreign"] == ["1/read_speed/request", "1/read_speed/reply"]
    assert {e.message.role for e in sink.entries if e.topic.endswith("foreign")} == {Role.FOREIGN}


def test_an_identifier_of_29_bits_is_another_one_than_that_of_11_bits():
    twin = CanFrame(5, "can0", 1, bytes.fromhex("3233"), extended=True)
    sink = run([CanFrame(0, "can0", 1, bytes.fromhex("3233")), twin, J1939], "mks-can")
    assert [e.message.who for e in sink.entries] == ["0x001", "0x00000001", "0x18FEF100"]
    assert [e.message.role for e in sink.entries] == [Role.REQUEST, Role.FOREIGN, Role.FOREIGN]


@pytest.mark.parametrize(
    ("frame", "rules"),
    [
        ("001#F601400200", ["bad_checksum"]),  # a checksum that is wrong
        ("001#F6014002", ["bad_checksum", "wrong_length"]),  # one that was forgotten
        ("001#32", ["foreign_can_frame"]),  # the same of a read
    ],
)
def test_a_program_that_sends_a_wrong_checksum_or_none_is_told_so(frame, rules):
    assert can(frame).rules == rules


def test_a_drive_that_was_heard_is_judged_in_all_it_sends():
    assert can(*DRIVE, "001#9C00000000000000").rules == ["bad_checksum", "unknown_command"]
    assert can("001#9C00000000000000", *DRIVE, "001#9C00").rules == ["bad_checksum", "unknown_command"]


def test_a_foreign_frame_that_fits_by_chance_makes_no_drive_of_a_node_that_was_odd_for_long():
    odd = ["141#9C00000000000000"] * 40
    sink = can(*odd, "141#3273", *odd)
    assert sink.rules == []
    assert set(sink.topics) == {"foreign"}
    # Two in a row are no chance.
    assert can(*odd, "141#3273", "141#3273").topics[-1] == f"{0x141}/read_speed/request"


def test_foreign_frames_do_not_part_a_request_from_its_reply():
    sink = can((0, DRIVE[0]), (1, RMD[0]), (2, CANOPEN[2]), (3, DRIVE[1]))
    assert sink.entries[-1].latency_ns == 3_000_000
    assert sink.entries[-1].request_sequence == 1


def test_the_user_says_who_is_a_drive():
    wrong = "141#9C00000000000000"
    assert can(wrong, listed=frozenset({0x141})).rules == ["bad_checksum", "unknown_command"]
    heard = can(*DRIVE, "000#3232", listed=frozenset({2}))
    # What is for all is for the drives, too.
    assert heard.topics == ["foreign", "foreign", "0/read_speed/request"]
    assert heard.rules == []


def test_on_a_serial_line_the_user_s_word_alone_counts():
    frames = [sum8("FA 01 32"), sum8("FA 07 32"), "FA 07 32 00", sum8("FA 00 F7")]
    assert "unanswered" in serial("mks-rs485", *frames).rules
    sink = serial("mks-rs485", *frames, listed=frozenset({1}))
    assert sink.topics == ["1/read_speed/request", "foreign", "foreign", "0/emergency_stop/request"]
    assert [e.message.who for e in sink.entries] == ["1", "7", "7", "0"]
    assert [f.address for f in sink.findings] == [1]


def test_another_modbus_device_on_the_line_is_foreign():
    asked, told = crc("09 03 00 00 00 01"), crc("09 03 02 00 64")
    sink = serial("mks-modbus", asked, told, listed=frozenset({1}))
    assert sink.topics == ["foreign", "foreign"]
    assert sink.rules == []


def test_who_is_a_drive_is_known_to_a_pipeline_that_goes_on():
    first, sink = Pipeline([dialects.get("mks-can")], (Collect(),)), Collect()
    frames = [CanFrame(n, "can0", 1, bytes.fromhex(text[4:])) for n, text in enumerate((*DRIVE, "001#9C00"))]
    for frame in frames[:2]:
        first.feed(frame)
    second = Pipeline([dialects.get("mks-can")], (sink,))
    second.restore(first.state(), {})
    second.feed(frames[2])
    assert sink.rules == ["bad_checksum", "unknown_command"]
