"""Pairing: each row of the theory in `analyzer.transactions`, seen from outside the pipeline."""

from __future__ import annotations

import pytest

from tests.collect import can, crc, serial, sum8

ASK_SPEED = sum8("FA 01 32")
SPEED = sum8("FB 01 32 00 64")
MOVE = sum8("FA 01 FD 01 40 02 00 00 FA 00")
MOVE_STARTED, MOVE_DONE, MOVE_LIMIT, MOVE_FAILED = (sum8(f"FB 01 FD 0{n}") for n in (1, 2, 3, 0))


def latencies(sink):
    return [e.latency_ns for e in sink.entries]


def test_a_reply_belongs_to_its_request_and_has_a_latency():
    sink = serial("mks-rs485", (0, ASK_SPEED), (3, SPEED))
    assert sink.topics == ["1/read_speed/request", "1/read_speed/reply"]
    assert sink.entries[1].request_sequence == sink.entries[0].sequence
    assert latencies(sink) == [None, 3_000_000]
    assert sink.rules == []


def test_interim_and_completion_belong_to_one_request():
    sink = serial("mks-rs485", (0, MOVE), (2, MOVE_STARTED), (900, MOVE_DONE))
    assert [e.request_sequence for e in sink.entries] == [None, 1, 1]
    assert [e.first_reply for e in sink.entries] == [False, True, False]
    assert sink.rules == []


def test_a_stop_at_the_limit_is_an_end_and_no_failure():
    assert serial("mks-rs485", (0, MOVE), (2, MOVE_STARTED), (900, MOVE_LIMIT)).rules == []


def test_a_failed_status_is_a_finding_on_the_reply():
    sink = serial("mks-rs485", (0, MOVE), (2, MOVE_FAILED))
    assert sink.rules == ["failed_status"]
    assert sink.findings[0].sequence == 2
    assert sink.findings[0].section == "6.6.1"


def test_the_interim_reply_once_more_is_a_duplicate():
    sink = serial("mks-rs485", (0, MOVE), (2, MOVE_STARTED), (4, MOVE_STARTED), (900, MOVE_DONE))
    assert sink.rules == ["duplicate_reply"]


def test_a_reply_once_more_is_a_duplicate_and_another_is_unsolicited():
    other = sum8("FB 01 F1 01")
    sink = serial("mks-rs485", (0, ASK_SPEED), (3, SPEED), (6, SPEED), (9, other))
    assert sink.rules == ["duplicate_reply", "unsolicited_reply"]


def test_a_newer_motion_command_supersedes_without_a_finding():
    sink = serial("mks-rs485", (0, MOVE), (2, MOVE_STARTED), (100, MOVE.replace("40", "40")), (102, MOVE_STARTED),
                  (500, MOVE_DONE))  # fmt: skip
    assert sink.rules == []
    assert [e.request_sequence for e in sink.entries] == [None, 1, None, 3, 3]


def test_a_move_ends_after_all_where_the_newer_one_was_refused():
    release, released = sum8("FA 01 3D"), sum8("FB 01 3D 01")
    sink = serial("mks-rs485", (0, MOVE), (2, MOVE_STARTED), (100, release), (102, released), (500, MOVE_DONE))
    assert sink.rules == []
    assert sink.entries[-1].request_sequence == 1


def test_a_stop_ends_a_move_with_its_own_replies():
    stop = sum8("FA 01 FD 00 00 02 00 00 00 00")
    sink = serial("mks-rs485", (0, MOVE), (2, MOVE_STARTED), (100, stop), (102, MOVE_STARTED), (300, MOVE_DONE))
    assert sink.topics[2:] == ["1/stop_relative_pulses/request"] + ["1/stop_relative_pulses/reply"] * 2
    assert sink.rules == []


def test_a_request_without_a_reply_is_unanswered_and_named():
    sink = serial("mks-rs485", (0, ASK_SPEED), (3, SPEED), (10, sum8("FA 01 F1")), (20, ASK_SPEED), (23, SPEED))
    assert sink.rules == ["unanswered"]
    found = sink.findings[0]
    assert (found.sequence, found.topic, found.section) == (3, "/bus/1/read_status/request", "6.2.1")


def test_a_repeated_request_is_a_retry_and_the_first_one_unanswered():
    sink = serial("mks-rs485", (0, ASK_SPEED), (50, ASK_SPEED), (53, SPEED))
    assert sink.rules == ["unanswered"]
    assert "repeated" in sink.findings[0].text
    assert sink.entries[2].request_sequence == 2


def test_the_same_bytes_at_once_are_the_hosts_echo():
    sink = serial("mks-rs485", (0, ASK_SPEED), (1, ASK_SPEED), (5, SPEED))
    assert sink.rules == ["host_echo"]
    assert sink.entries[2].request_sequence == 1


def test_a_marked_echo_is_an_echo_however_late():
    sink = serial("mks-rs485", (0, ">" + ASK_SPEED), (30, "<" + ASK_SPEED), (35, "<" + SPEED))
    assert sink.rules == ["host_echo"]


def test_an_echo_of_lingkong_is_called_so_only_where_others_echo():
    ask, off = "3E 9A 01 00 D9", "3E 80 01 00 BF"
    state = "3E 9A 01 07 E0 21 B0 09 00 00 00 00 DA"
    quiet = serial("lk-rs485", (0, off), (1, off))
    assert (quiet.topics, quiet.rules) == (["1/motor_off/request", "1/motor_off/reply"], [])
    rows = [(0, ask), (0.5, ask), (2, state), (10, ask), (10.5, ask), (12, state), (20, off), (20.5, off), (22, off)]
    echoing = serial("lk-rs485", *rows)
    assert echoing.rules == ["host_echo"] * 3
    assert echoing.entries[-1].request_sequence == 7


def test_late_is_a_limit_of_the_user():
    rows = [(0, ASK_SPEED), (30, SPEED)]
    assert serial("mks-rs485", *rows).rules == []
    sink = serial("mks-rs485", *rows, late_ns=20_000_000)
    assert sink.rules == ["late_reply"]
    assert "30.0 ms" in sink.findings[0].text


def test_a_reply_after_the_request_was_given_up_is_late_and_still_its_own():
    status, stopped = sum8("FA 01 F1"), sum8("FB 01 F1 01")
    sink = serial("mks-rs485", (0, status), (100, ASK_SPEED), (103, SPEED), (150, stopped))
    assert sink.rules == ["unanswered", "late_reply"]
    assert sink.entries[3].request_sequence == 1


def test_broadcast_and_package_expect_no_reply():
    package = sum8("FC" + "01 F6 00 32 0A 00 00 00 00 00" + "00" * 40)
    sink = serial("mks-rs485", (0, sum8("FA 00 F6 01 40 02")), (50, package), (90, ASK_SPEED), (93, SPEED))
    assert sink.rules == []


def test_an_answered_broadcast_is_a_finding():
    sink = serial("mks-rs485", (0, sum8("FA 00 F6 01 40 02")), (3, sum8("FB 01 F6 01")))
    assert sink.rules == ["answered_broadcast"]


def test_a_group_is_known_by_option_or_learnt_from_8d():
    run = sum8("FA 50 F6 01 40 02")
    asked = serial("mks-rs485", (0, run), (50, ASK_SPEED), (53, SPEED), groups=frozenset({0x50}))
    assert asked.rules == []
    rows = [(0, sum8("FA 01 8D 50")), (3, sum8("FB 01 8D 01")), (50, run), (90, ASK_SPEED), (93, SPEED)]
    assert serial("mks-rs485", *rows).rules == []


def test_silent_motion_is_one_info_per_address_and_no_flood():
    rows = [(0, ASK_SPEED), (3, SPEED)]
    for n in range(1, 6):
        rows += [(100 * n, sum8(f"FA 01 F6 01 4{n} 02")), (100 * n + 50, ASK_SPEED), (100 * n + 53, SPEED)]
    assert serial("mks-rs485", *rows).rules == ["silent_address"]


def test_respond_off_is_learnt_and_silences_motion_only():
    rows = [(0, sum8("FA 01 8C 00 01")), (3, sum8("FB 01 8C 01")), (50, sum8("FA 01 F6 01 40 02")), (90, ASK_SPEED)]
    sink = serial("mks-rs485", *rows, (93, SPEED))
    assert sink.rules == []
    assert serial("mks-rs485", *rows, (5000, sum8("FA 01 F1")), (5003, sum8("FB 01 F1 01"))).rules == ["unanswered"]


def test_active_off_makes_the_first_reply_the_last():
    rows = [(0, sum8("FA 01 8C 01 00")), (3, sum8("FB 01 8C 01")), (50, MOVE), (53, MOVE_STARTED)]
    sink = serial("mks-rs485", *rows, (60, ASK_SPEED), (63, SPEED), (70, MOVE_DONE))
    assert sink.rules == ["unsolicited_reply"]


def test_a_bad_request_needs_no_answer_and_a_bad_reply_is_one():
    bad = ASK_SPEED[:-2] + "00"
    sink = serial("mks-rs485", (0, bad), (50, ASK_SPEED), (53, SPEED[:-2] + "00"), (90, ASK_SPEED), (93, SPEED))
    assert sink.rules == ["bad_checksum", "bad_checksum"]


def test_the_end_of_a_capture_right_after_a_request_is_no_error():
    sink = serial("mks-rs485", (0, ASK_SPEED), (3, SPEED), (10, ASK_SPEED))
    assert [(f.rule, f.severity) for f in sink.findings] == [("unanswered", "info")]


# --- Modbus -------------------------------------------------------------------------------------------------------


def test_a_modbus_echo_is_the_reply():
    write = crc("01 06 00 82 00 05")
    sink = serial("mks-modbus", (0, write), (5, write))
    assert sink.topics == ["1/set_work_mode/request", "1/set_work_mode/reply"]
    assert sink.rules == []


def test_refused_writes_by_06_and_10():
    rows = [(0, crc("01 06 00 82 00 05")), (5, crc("01 06 00 82 FF FF"))]
    assert serial("mks-modbus", *rows).rules == ["refused_write"]
    rows = [(0, crc("01 10 00 F6 00 02 04 01 02 01 40")), (5, crc("01 10 00 F6 00 00"))]
    assert serial("mks-modbus", *rows).rules == ["refused_write"]


def test_a_modbus_exception_ends_the_request():
    sink = serial("mks-modbus", (0, crc("01 04 00 30 00 03")), (5, crc("01 84 02")))
    assert sink.rules == ["modbus_exception"]
    assert sink.shown[1] == ("1/read_encoder_carry/reply", {"exception": 2, "exception_name": "illegal_data_address"})
    assert "illegal_data_address" in sink.findings[0].text


def test_a_reply_to_a_register_that_is_not_listed_begins_with_its_byte_count():
    sink = serial("mks-modbus", (0, crc("01 03 00 6D 00 01")), (5, crc("01 03 02 00 1A")))
    assert sink.shown[1] == ("1/unknown_read/reply", {"byte_count": 2, "registers": "00 1A"})


def test_a_modbus_read_reply_without_its_request_keeps_its_registers():
    sink = serial("mks-modbus", (0, crc("01 04 02 01 2C")), (90, crc("01 04 00 32 00 01")), (95, crc("01 04 02 01 2C")))
    assert sink.shown[0] == ("1/unknown_read/reply", {"byte_count": 2, "registers": "01 2C"})
    assert sink.shown[2] == ("1/read_speed/reply", {"speed": 300})
    assert sink.rules == ["unknown_command", "unsolicited_reply"]


def test_registers_that_overlap_are_commands_of_their_own():
    rows = [(0, crc("01 04 00 30 00 06")), (5, crc("01 04 0C" + " 00" * 12))]
    sink = serial("mks-modbus", *rows)
    assert sink.rules == ["wrong_length", "wrong_length"]
    assert sink.entries[1].request_sequence == 1
    assert "expected 3 registers, got 6" in sink.findings[0].text


# --- CAN ----------------------------------------------------------------------------------------------------------


def test_can_roles_come_from_length_values_and_open_requests():
    sink = can("001#F3 01 F5".replace(" ", ""), "001#F301F5", "001#820588", "001#820184", "001#8000 81".replace(" ", ""),
               "001#800081", "001#800182")  # fmt: skip
    assert sink.topics == [
        "1/enable/request", "1/enable/reply", "1/set_work_mode/request", "1/set_work_mode/reply",
        "1/calibrate/request", "1/calibrate/reply", "1/calibrate/reply",
    ]  # fmt: skip
    assert sink.rules == []


def test_can_parameter_reads_have_the_layout_of_their_setting():
    sink = can("001#00838 4".replace(" ", ""), "001#83064 0CA".replace(" ", ""), "001#003031", "001#30FFFF2F")
    assert sink.topics == ["1/read_parameter/request", "1/read_parameter/reply"] * 2
    assert sink.shown[1][1]["current"] == 0x0640
    # 0x30 is no setting: asking for it is outside the list, and FF FF is the answer to that.
    assert sink.rules == ["unknown_choice", "failed_status"]


@pytest.mark.parametrize("frame", ["001#", "001#F6"])
def test_can_frames_outside_the_dialect_are_kept_and_named(frame):
    sink = can(frame, listed=frozenset({1}))
    assert sink.topics == ["unknown"]
    assert sink.rules == ["foreign_can_frame"]


# --- several dialects ---------------------------------------------------------------------------------------------


def test_a_request_in_the_wrong_dialect_is_named():
    rows = [(0, sum8("FA 01 8E 01")), (5, sum8("FB 01 8E 01")), (50, ASK_SPEED), (100, crc("01 04 00 32 00 01")),
            (105, crc("01 04 02 00 64"))]  # fmt: skip
    sink = serial("mks-rs485 mks-modbus", *rows)
    assert sink.topics[-1] == "1/read_speed/reply"
    assert sink.rules == ["other_dialect", "unanswered"]


def test_a_reply_that_was_read_together_with_its_request_has_no_latency():
    sink = serial("mks-rs485", (0, ASK_SPEED + " " + sum8("FB 01 32 00 64")), (50, ASK_SPEED), (53, sum8("FB 01 32 00 64")))
    replies = [entry for entry in sink.entries if entry.request_sequence is not None]
    assert [entry.latency_ns is None for entry in replies] == [True, False]


def test_equal_requests_without_times_are_no_echo():
    sink = serial("mks-rs485", ASK_SPEED, ASK_SPEED, timed=False)
    assert sink.rules == ["unanswered", "unanswered"]
    assert sink.findings[0].text.endswith("the host repeated it")


def test_a_new_address_may_answer_the_request_that_gave_it():
    sink = serial("mks-rs485", (0, "FA 01 8B 05 8B"), (5, "FB 05 8B 01 8C"), (10, "FA 05 32 31"))
    assert [f.rule for f in sink.findings if f.severity > "info"] == []
    assert sink.entries[1].request_sequence == 1


def test_the_same_bytes_under_an_earlier_time_are_no_echo():
    sink = serial("mks-rs485", (5000, ASK_SPEED), (50, ASK_SPEED), (53, SPEED))
    assert sink.rules == ["unanswered"]
    assert sink.findings[0].text.endswith("the host repeated it")


def test_a_reply_right_behind_a_request_is_no_late_one_to_an_equal_one_long_before():
    other, reply_to_other = sum8("FA 01 F1"), sum8("FB 01 F1 01")
    lost = [(0, ASK_SPEED), (2, other)]
    polls = [
        row for t in (100, 200, 300, 400) for row in ((t, ASK_SPEED), (t + 4, SPEED), (t + 50, other), (t + 54, reply_to_other))
    ]
    sink = serial("mks-rs485", *lost, *polls)
    assert sorted(sink.rules) == ["unanswered", "unanswered"]
    assert {e.latency_ns for e in sink.entries} == {None, 4_000_000}
