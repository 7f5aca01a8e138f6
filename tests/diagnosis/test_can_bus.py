"""CAN: error frames of every kind of adapter and file, identifiers that no drive listens to, frames of others."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from analyzer.catalogue import Role
from analyzer.cli import main
from analyzer.diagnosis.scene import Confidence
from analyzer.records import CanFrame, Comment
from analyzer.sources import can_state, open_source
from tests.diagnosis.test_diagnosis import can, diagnosed

GOOD = ["001#3233", "001#32006497"]
STUFF, RECESSIVE, NO_ACK = "20000088#0000040000000000", "20000088#0000900000000000", "20000020#0000000000008000"
WARNING, PASSIVE, OFF = "20000004#0008000000006000", "20000004#0020000000008000", "20000040#0000000000000000"
ACK_SLOT = "20000088#0000001900000000"


def causes(items):
    return [each.suspicion for each in diagnosed(items).causes]


def first(*rows):
    found = causes(can(*rows))
    return found[0].cause if found else None


@pytest.mark.parametrize(
    ("rows", "cause"),
    [
        (["001#3132", *[NO_ACK] * 4], "can_no_ack"),
        (["001#3132", *[ACK_SLOT] * 3], "can_no_ack"),
        (["001#3132", WARNING, PASSIVE, PASSIVE], "can_no_ack"),
        (["001#3132", WARNING, PASSIVE, OFF], "can_bus_off"),
        ([STUFF] * 8, "can_wrong_bitrate"),
        # The counters of a change of state run ahead of those of the errors around it; no counter falls.
        (
            [f"20000088#00000403000000{n:02X}" for n in (8, 16)] + ["20000004#0004000000000068"] + [f"{STUFF[:-2]}18"] * 8,
            "can_wrong_bitrate",
        ),
        (["001#3132", *[RECESSIVE] * 3, PASSIVE], "can_bit_errors"),
        ([RECESSIVE], "can_bit_errors"),
        # Frames of others show that speed and wires are right.
        (["00316F13#4353", "0030A301#", STUFF, STUFF], "can_bit_errors"),
        ([*GOOD * 3, NO_ACK, NO_ACK, *GOOD], "can_no_ack"),
        # One destroyed frame among many is the bus at work.
        ([*GOOD * 20, STUFF, *GOOD], None),
    ],
)
def test_error_frames(rows, cause):
    assert first(*rows) == cause


CHANGE = ["001#3A3B", "001#3A013C", "001#8A018C"]


@pytest.mark.parametrize(
    ("rows", "cause"),
    [
        ([*CHANGE, "001#8A018C", *[STUFF] * 9], "can_wrong_bitrate"),
        # The drive refused it, or frames of others get through at the new one: the speed is right.
        ([*CHANGE, "001#8A008B", *[STUFF] * 9], "can_bit_errors"),
        ([*CHANGE, "001#8A018C", "001#3A3B", "001#3A013C", *[STUFF] * 9], "can_bit_errors"),
        # Errors before the change have another cause.
        ([STUFF, STUFF, *CHANGE, "001#8A018C", *[STUFF] * 9], "can_bit_errors"),
    ],
)
def test_errors_behind_a_change_of_the_bit_rate(rows, cause):
    assert first(*rows) == cause


def test_errors_without_a_class_leave_the_cause_open():
    bare = [CanFrame(n * 1_000_000, "can0", 0, b"", error=True) for n in range(5)]
    (found,) = causes(bare)
    assert (found.cause, found.confidence) == ("can_no_ack", Confidence.POSSIBLE)
    assert causes([*can(*GOOD * 3), *bare])[0].cause == "can_bit_errors"


def test_bus_off_explains_the_silence_and_the_bit_rate_stands_behind_it():
    found = diagnosed(can("001#3132", STUFF, STUFF, STUFF, OFF)).causes
    assert [each.suspicion.cause for each in found][:1] == ["can_bus_off"]
    assert found[0].share == 1


@pytest.mark.parametrize(
    ("rows", "right"),
    [
        (["201#3132", "201#3A3B", "201#F301F5"], "001 31 32"),
        (["602#3133", "602#3A3C"], "002 31 33"),
        # Sums of identifier 3, sent to 1.
        (["001#3134", "001#3A3D", "001#F301F7"], "003 31 34"),
    ],
)
def test_an_identifier_that_no_drive_listens_to(rows, right):
    found, *others = causes(can(*rows))
    assert found.cause == "can_wrong_id"
    assert found.frames[0].right == right
    # A sum of another identifier can be a wrong one, too.
    assert {each.cause for each in others} <= {"wrong_checksum"}


def test_a_drive_that_answers_at_a_high_identifier_is_in_order():
    assert first("201#3233", "201#32006497") is None


def test_frames_of_lk_motors_that_are_too_short():
    (found,) = causes(can("141#88", "141#9A"))
    assert found.cause == "unsupported_dialect"
    assert "eight bytes" in found.say


@pytest.mark.parametrize(
    ("rows", "found"),
    [
        (["601#4000100000000000", "601#4041600000000000"], ["unsupported_dialect"]),
        (["601#4000100000000000"], []),
        # A node answers, or tells its state: it speaks CANopen.
        (["601#4000100000000000", "601#4041600000000000", "581#4341600000000000"], []),
        (["601#4000100000000000", "601#4041600000000000", "701#05"], []),
    ],
)
def test_objects_of_canopen_that_nobody_answers_beside_a_drive(rows, found):
    assert [each.cause for each in causes(can(*GOOD, *rows, *GOOD))] == found


def test_a_request_that_is_filled_up_to_eight_bytes():
    (found,) = causes([CanFrame(0, "can0", 1, bytes.fromhex("F600640200000055"), Role.REQUEST)])
    assert (found.cause, found.frames[0].right) == ("wrong_length", "001 F6 00 64 02 5D")


def test_a_bus_of_others_is_not_called_in_order(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "others.log"
    path.write_text("".join(f"({n}.0) can0 705#05\n({n}.5) can0 185#0102030405060708\n" for n in range(9)))
    assert main(["diagnose", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == "unknown"
    assert main(["diagnose", str(path)]) == 0
    assert "no frame of a known dialect" in capsys.readouterr().out


def test_candump_with_its_words_below_error_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "errors.txt"
    error = " (000.002)  can0  RX - -  20000020   [8]  00 00 00 00 00 00 80 00   ERRORFRAME\n\tno-acknowledgement-on-tx\n"
    path.write_text(" (000.001)  can0  TX - -  001   [2]  31 32\n" + 3 * (error + "\terror-counter-tx-rx{{128}{0}}\n"))
    assert main(["diagnose", str(path)]) == 1
    assert "(can_no_ack, certain, 100% of the trouble)" in capsys.readouterr().out


IP = "    can state {} restart-ms 0\n  re-started bus-errors arbit-lost error-warn error-pass bus-off\n"
DRIVER = "[ {}.25] m_can_platform 2094000.can can1: {}\n"


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        (IP.format("BUS-OFF (berr-counter tx 248 rx 0)"), "can_bus_off"),
        (IP.format("ERROR-ACTIVE (berr-counter tx 0 rx 0)") + "  3  0  0  7  7  3\n", "can_bus_off"),
        (IP.format("ERROR-PASSIVE (berr-counter tx 128 rx 0)"), "can_no_ack"),
        (
            IP.format("<LOOPBACK,BERR-REPORTING> state ERROR-PASSIVE (berr-counter tx 0 rx 127)").replace("state <", "<"),
            "can_bit_errors",
        ),
        (IP.format("ERROR-ACTIVE (berr-counter tx 0 rx 0)") + "  0  0  0  0  0  0\n", None),
        ("$ cansend can0 001#3132\nwrite: No buffer space available\n", "can_no_ack"),
        ("".join(DRIVER.format(n, "Bit1 Error Detected") for n in range(3)), "can_bit_errors"),
        ("".join(DRIVER.format(n, "Stuff Error Detected") for n in range(3)), "can_wrong_bitrate"),
        (DRIVER.format(1, "entered error passive state") + DRIVER.format(2, "bus-off"), "can_bus_off"),
        (DRIVER.format(1, "Acknowledge Error Detected") * 2, "can_no_ack"),
        ("Alert: an error has occurred on the bus.\n" * 3 + "Alert: the controller has become error passive.\n", "can_no_ack"),
        ("[RX] E3400F800 (Bus Off, recessive bit error)\n", "can_bus_off"),
        ("[ERROR] Received error frame: 20000004#000c000000000000\n" + "[INFO] state 1\n" * 20, "can_no_ack"),
    ],
)
def test_the_state_of_a_controller_in_words(text, cause, tmp_path, capsys):
    path = tmp_path / "paste"
    path.write_text(text)
    assert main(["diagnose", str(path), "--json"]) == (cause is not None)
    found = json.loads(capsys.readouterr().out)["causes"]
    assert [each["cause"] for each in found[:1]] == ([cause] if cause else [])


def test_a_program_that_could_say_it_tells_no_state():
    assert can_state.score(b'Serial.println("Alert: an error has occurred on the bus.");\n' * 3) == 0


@pytest.mark.parametrize(
    "text",
    [
        "2026-03-02 09:00:00.000 > FA 01 30 2B\n2026-03-02 09:00:00.003 < FB 01 F6 01 F3\n",
        "date Sun Apr 30 10:40:55.899 pm 2023\nbase hex  timestamps absolute\n   0.000511 1  001   Rx   d 3 F6 01 F8\n",
        "time,id,dlc,data,note\n0.001,0x001,3,F6 01 F8,\n",
        "(1709640000.000001) can0 001#F60140023A\n",
    ],
)
def test_a_word_on_a_controller_takes_no_bytes_from_a_capture_of_another_format(text, tmp_path):
    path = tmp_path / "capture"
    path.write_text(text + text.splitlines(keepends=True)[-1] * 5)
    with open_source(path) as source:
        alone = [(each.t_ns, each.data) for each in source if not isinstance(each, Comment)]
    path.write_text(path.read_text() + "// can0: bus-off\n")
    with open_source(path) as source:
        assert [(each.t_ns, each.data) for each in source if not isinstance(each, Comment)] == alone


OTHER = "(5.1000) can0 001#3031\n(5.1005) can0 001#30000000001E61B0\n(6.1000) can0 001#F1F2\n(6.1005) can0 001#F101F3\n"


@pytest.mark.parametrize(
    ("log", "cause"),
    [
        # A setting that nobody takes, sent again: it looks like its own reply.
        ("".join(f"({n}.1000) can0 002#F301F6\n" for n in range(1, 5)) + OTHER, "wrong_address"),
        ("".join(f"({n}.1000) can0 002#F300F5\n" for n in range(1, 5)) + OTHER, "wrong_address"),
        # A drive answers so, once soon; all of a slow bus answer so; seconds do not tell.
        ("(1.1) can0 002#F301F6\n(1.1005) can0 002#F301F6\n(2.1) can0 002#F301F6\n(3.1) can0 002#F301F6\n" + OTHER, None),
        ("(1.1) can0 002#F301F6\n(1.4) can0 002#F301F6\n(2.1) can0 001#F1F2\n(2.35) can0 001#F101F3\n", None),
        ("(1.0) can0 002#F301F6\n(2.0) can0 002#F301F6\n(3.0) can0 001#F1F2\n(3.0) can0 001#F101F3\n", None),
    ],
)
def test_a_request_that_is_sent_again_is_no_reply_to_itself(log, cause, causes_of):
    assert causes_of(log)[:1] == ([cause] if cause else [])


def test_no_pace_is_blamed_where_error_frames_come():
    lost = ["001#3132", "002#3133", "002#3100000000400174"]
    rows = [row for _ in range(6) for row in (*lost, "001#3132", STUFF, "001#3100000000200052")]
    assert first(*rows) == "can_bit_errors"
    assert "too_fast" not in {each.cause for each in causes(can(*rows))}
    assert "too_fast" in {each.cause for each in causes(can(*(row for row in rows if row != STUFF)))}


@pytest.mark.parametrize(
    "said",
    [
        "E (2354) TWAI: alert: BUS_OFF state=2 tx_err 256 rx_err 0 bus_error_count 41",
        "E (2354) servo: alert: BUS_OFF",
        "I (2354) twai: state = 2",
        "W (2354) servo: twai TWAI_STATE_BUS_OFF",
    ],
)
def test_words_of_firmware_that_is_off_the_bus(said, causes_of):
    asked = (
        "I (1330) servo: TX ID: 0x001 DLC: 2 Data: 31 32\nI (1334) servo: RX ID: 0x001 DLC: 8 Data: 31 00 00 00 00 40 00 72\n"
        "I (2350) servo: TX ID: 0x001 DLC: 5 Data: F6 01 2C C8 EC\n"
    )
    assert causes_of(f"{asked}W (2353) TWAI: alert: ERROR_PASSIVE tx_err 136 rx_err 0\n{said}\n") == ["can_bus_off"]
    assert "can_bus_off" not in causes_of(f"{asked}if (state == TWAI_STATE_BUS_OFF)\n case TWAI_STATE_BUS_OFF:\n")


@pytest.mark.parametrize(
    "said", ["TWAI status: bus_off=0 tx_err=0", "TWAI: bus_off: 0", "state: bus_off: no", "twai: state = 1"]
)
def test_words_of_firmware_that_is_on_the_bus(said):
    assert can_state.score(f"I (2354) {said}\n".encode() * 3) == 0
