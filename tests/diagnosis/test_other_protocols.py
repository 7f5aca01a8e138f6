"""Unknown protocols, recognised by letters or by a usual check; and traffic that is no protocol."""

from __future__ import annotations

import random

import pytest

from tests.diagnosis.spoiled_line import levels, received
from tests.diagnosis.test_diagnosis import READS, first, told


def framed(body: bytes, end: bytes = b"") -> bytes:
    return body + bytes((sum(body) & 0xFF,)) + end


BODIES = [bytes.fromhex(text) for text in ("A1 55 20 01", "A1 56 31 02 07", "A1 57 42 03 09 4D", "A1 58 53 04")]


@pytest.mark.parametrize("end", [b"", b"\x99"])
def test_frames_with_a_sum_are_of_another_protocol(end):
    assert first(*((">", framed(body, end)) for body in BODIES)) == "unsupported_dialect"


def test_the_sum_may_leave_the_head_out():
    frames = [body[:1] + framed(body[1:]) for body in BODIES]
    assert first(*(("<", frame) for frame in frames)) == "unsupported_dialect"


def test_two_frames_can_fit_by_chance():
    assert "unsupported_dialect" not in [each.cause for each in told(*((">", framed(body)) for body in BODIES[:2]))]


def test_frames_without_a_check_are_no_protocol():
    chance = random.Random(5)
    rows = [("<", bytes(chance.randrange(256) for _ in range(chance.randrange(5, 12)))) for _ in range(40)]
    assert "unsupported_dialect" not in [each.cause for each in told(*rows)]


def test_frames_of_a_known_dialect_bar_it():
    rows = [(">", READS[0]), *((">", framed(body)) for body in BODIES)]
    assert "unsupported_dialect" not in [each.cause for each in told(*rows)]


@pytest.mark.parametrize("spoilt", [0, 2])
def test_text_that_comes_is_of_another_protocol(spoilt):
    text = bytearray(b"1-0:32.36.0(00010)\r\n0-0:96.13.0()\r\n1-0:32.7.0(229.4*V)\r\n")
    for at in range(spoilt):
        text[9 + 20 * at] |= 0x80
    assert first(("<", bytes(text))) == "unsupported_dialect"


def test_digits_of_bytes_are_a_mistake_of_the_host():
    assert first((">", b"FA01302B")) == "text_mode"


@pytest.mark.parametrize("ratio", [0.5, 0.75, 2.0])
def test_a_line_at_another_speed_is_no_protocol(ratio):
    rows = [("<", received(levels(frame), ratio)) for frame in READS]
    assert "unsupported_dialect" not in [each.cause for each in told(*rows)]


@pytest.mark.parametrize(
    "frame", ["10 40 FD 3D 16", "68 06 06 68 08 02 72 11 22 33 E2 16", "A5 01 90 08 01 02 03 04 05 06 07 08 62"]
)
def test_makes_with_a_frame_of_their_own(frame):
    assert first(("<", bytes.fromhex(frame))) == "unsupported_dialect"


def test_a_host_reads_two_frames_of_daly_at_once():
    one = bytes.fromhex("A5 01 90 08 01 02 03 04 05 06 07 08 62")
    assert first(("<", one * 2)) == "unsupported_dialect"


def hart(body):
    frame = bytes.fromhex(body)
    check = 0
    for byte in frame:
        check ^= byte
    return bytes((*b"\xff" * 5, *frame, check))


@pytest.mark.parametrize(
    ("ask", "answer"),
    [("82 93 11 2A 7C 05 03 00", "86 93 11 2A 7C 05 03 06 00 00 41 20 00 00"), ("02 80 00 00", "06 80 00 04 00 00 FE 93")],
)
def test_hart_is_of_another_maker(ask, answer):
    rows = [(">", hart(ask)), ("<", hart(answer))]
    assert [each.cause for each in told(*(3 * rows))] == ["unsupported_dialect"]


def test_a_preamble_alone_is_not_hart():
    assert "HART" not in str(told((">", b"\xff" * 5 + b"\x82\x93\x11\x2a")))


@pytest.mark.parametrize(
    ("head", "size"), [("A5 07", 2), ("EB 91 03", 3), ("FE FE 04", 1), ("01", 2), ("AA 06", 2), ("7E 02 05", 4)]
)
def test_what_one_frame_of_an_unknown_protocol_is_like_says_nothing_of_the_line(head, size):
    """Replies begin as their requests do, and one of them is as long: no echo, no start that is missing, no wires swapped."""
    chance = random.Random(f"{head} {size}")
    rows = []
    for number in range(12):
        code = bytes.fromhex(head) + bytes((0x40 + 9 * (number % 3),))
        tail = chance.randbytes(1) + b"\x0d"
        answer = chance.randbytes(size if not number % 3 else size + 1 + number % 3)
        rows += [(">", code + bytes(size) + tail), ("<", code + answer + chance.randbytes(1) + b"\x0d")]
    assert {each.cause for each in told(*rows)} <= {"unsupported_dialect"}


def test_meters_that_wake_up_and_end_as_others_do_say_nothing_of_the_line():
    def meter(body):
        return framed(bytes.fromhex(f"68 01 02 03 04 05 06 68 {body}"), b"\x16")

    asked = b"\xfe\xfe" + meter("11 04 33 33 34 33")
    rows = [row for value in range(6) for row in (asked, meter(f"91 06 33 33 34 33 4{value} 55"))]
    assert "wrong_baud" not in [each.cause for each in told(*rows)]


def test_a_byte_count_among_the_bytes_of_another_protocol_is_no_promise():
    chance = random.Random(1)
    rows = [("<", bytes((0x0F, *chance.randbytes(22), 0, 0))) for _ in range(5)]
    assert "reply_cut" in [each.cause for each in told(("<", b"\x0f\x03\x20" + rows[0][1][3:]))]
    assert "reply_cut" not in [each.cause for each in told(*rows, ("<", b"\x0f\x03\x20" + rows[0][1][3:]))]
