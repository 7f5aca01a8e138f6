"""Causes in how frames are made up: checks that are kept, padding, letters, adapters, other makes."""

from __future__ import annotations

import pytest

from analyzer import dialects as registry
from analyzer.encoder import build
from analyzer.link.modbus import modbus_crc
from analyzer.records import CanFrame
from tests.diagnosis.test_diagnosis import READS, diagnosed, exchanged, first, told

NATIVE, MODBUS, CAN, LK = (registry.get(n) for n in ("mks-rs485", "mks-modbus", "mks-can", "lk-rs485"))


def sum8(text):
    body = bytes.fromhex(text)
    return body + bytes((sum(body) & 0xFF,))


# --- checks and padding -----------------------------------------------------------------------------------------------------


def test_the_check_of_an_example_is_kept():
    right = build(NATIVE, "run_speed", 1, {"speed": 320, "acceleration": 2})
    typed = [right[:3] + speed.to_bytes(2, "big") + right[5:] for speed in (200, 600, 1250)]
    found = told(*exchanged("mks-rs485@1,work_mode=sr_vfoc", right), *((">", frame) for frame in typed))
    assert found[0].cause == "wrong_checksum"
    assert len(found[0].frames) == 3


@pytest.mark.parametrize("size", [8, 12])
def test_requests_that_are_padded(size):
    rows = [(">", frame.ljust(size, b"\0")) for frame in (*READS[:2], build(NATIVE, "run_speed", 1, {"speed": 300}))]
    found = told(*rows)
    assert (found[0].cause, found[0].frames[0].right) == ("wrong_length", READS[0].hex(" ").upper())


@pytest.mark.parametrize("check", [b"\0", b"\x17"])
def test_can_frames_that_are_padded(check):
    right = build(CAN, "run_speed", 1, {"speed": 300, "acceleration": 2})
    frame = CanFrame(0, "can0", 1, (right[:-1].ljust(7, b"\0")) + check)
    other = CanFrame(9_000_000, "can0", 1, right.ljust(8, b"\0"))
    found = diagnosed([frame, other]).causes[0].suspicion
    assert (found.cause, found.frames[0].right) == ("wrong_length", f"001 {right.hex(' ').upper()}")


# --- letters, headers, adapters ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["{0:02X}", "0x{0:02x},", r"\x{0:02x}", "{0:02x} "])
def test_digits_sent_as_letters(form):
    text = "".join(form.format(byte) for frame in READS[:3] for byte in frame)
    assert first((">", text.encode())) == "text_mode"


@pytest.mark.parametrize("ends", [(b"\r", b"\n"), (b"\n", b"\r")])
def test_each_end_of_a_line_is_turned_into_the_other(ends):
    replies = [
        NATIVE.link.completed(bytes.fromhex(f"FB 01 31 00 00 {tail}"))
        for tail in ("00 00 0D 0E", "00 0D 0D 52", "00 00 0A FF", "0A 00 3B 04")
    ]
    came = [reply.replace(*ends) for reply in replies]
    found = told(*(row for reply in came for row in ((">", READS[0]), ("<", reply))))
    assert [each.cause for each in found] == ["text_mode"]
    assert found[0].frames[0].right == next(a for a, b in zip(replies, came, strict=True) if a != b).hex(" ").upper()


def test_software_flow_control():
    replies = [NATIVE.link.completed(bytes.fromhex(f"FB 01 33 00 00 {byte} 11")) for byte in ("13", "07", "2A", "55")]
    rows = [row for reply in replies for row in ((">", READS[2]), ("<", reply.replace(b"\x11", b"").replace(b"\x13", b"", 0)))]
    assert first(*rows) == "text_mode"


def test_software_flow_control_that_takes_several_bytes_of_a_frame():
    replies = [NATIVE.link.completed(bytes.fromhex(f"FB 01 33 00 11 {tail}")) for tail in ("13 13", "13 40", "13 11", "11 7A")]
    rows = [row for reply in replies for row in ((">", READS[2]), ("<", reply.translate(None, b"\x11\x13")))]
    assert first(*rows) == "text_mode"


@pytest.mark.parametrize(
    "row",
    [
        "> 00 01 00 00 00 06 01 04 00 30 00 03 00 02 00 00 00 06 01 04 00 31 00 03",
        "< 00 01 00 00 00 06 01 03 02 39 02",
        "< 00 00 00 00 00 03 01 84 02 00 00 00 00 00 03 01 84 02",
    ],
)
def test_headers_of_modbus_tcp(row):
    assert first(row) == "tcp_framing"


def test_modbus_tcp_that_is_answered_is_no_fault_of_the_host():
    rows = ("> 00 01 00 00 00 06 01 03 00 30 00 01", "< 00 01 00 00 00 05 01 03 02 00 07")
    assert all(each.confidence == "possible" for each in told(*rows))


def stick(data):
    return b"AT" + (1 << 21).to_bytes(4, "big") + bytes((len(data),)) + data + b"\r\n"


ON_CAN = [sum8("01 31")[1:], sum8("01 F6 01 40 02")[1:], sum8("01 3A")[1:]]


@pytest.mark.parametrize(
    "wrap",
    [
        stick,
        lambda data: b"t001%d" % len(data) + data.hex().upper().encode() + b"\r",
        lambda data: b"\xaa" + bytes((0xC0 | len(data),)) + b"\x01\x00" + data + b"\x55",
        lambda data: bytes((len(data),)) + b"\0\0\0\1" + data.ljust(8, b"\0"),
        lambda data: b"\xf1\0\1\0\0\0\0" + bytes((len(data),)) + data + b"\0",
    ],
)
def test_adapters(wrap):
    found = told(*((">", wrap(data)) for data in ON_CAN))
    assert found[0].cause == "adapter_framing"
    assert "001 31 32" in found[0].evidence


def test_the_words_of_an_adapter():
    assert first((">", b"S6\rO\rt00123132\r")) == "adapter_framing"


# --- other makes ------------------------------------------------------------------------------------------------------------


def inverted(body):
    return body + bytes((~sum(body[2:]) & 0xFF,))


def rmd(body):
    return body + modbus_crc(body).to_bytes(2, "little")


@pytest.mark.parametrize(
    "rows",
    [
        [sum8("E0 30"), sum8("E0 F6 10"), sum8("E0 01")],
        [bytes.fromhex(text) for text in ("E0 36", "E0 F6 01", "E0 01")],
        [bytes.fromhex(text) for text in ("01 F6 01 05 DC 0A 00 6B", "01 F6 02 6B", "01 36 6B")],
        [inverted(bytes.fromhex(text)) for text in ("FF FF 01 04 02 38 02", "FF FF 01 02 01")],
        [inverted(bytes.fromhex(text)) for text in ("55 55 01 07 01 F4 01 E8 03", "55 55 01 03 1C")],
        [bytes.fromhex(text) for text in ("FF FF FD 00 01 03 00 01 19 4E", "FF FF FD 00 02 03 00 01 19 72")],
        [rmd(bytes.fromhex(text)) for text in ("3E 01 08 9A 00 00 00 00 00 00 00", "3E 01 08 9C 00 00 00 00 00 00 00")],
        [b":010300000001FB\r\n", b":010400300003C8\r\n"],
    ],
)
def test_other_makes(rows):
    assert first(*((">", row) for row in rows)) == "unsupported_dialect"


def test_a_new_address_that_answers():
    asked, told_by = (rmd(bytes.fromhex(text)) for text in ("01 06 40 03 00 17", "17 06 40 03 00 17"))
    assert first((">", asked), ("<", told_by)) == "address_changed"


@pytest.mark.parametrize("row", ["> 3E 80 01 04 C3", "> 3E A2 01 02 E3 10 27 37"])
def test_a_head_that_promises_another_length(row):
    assert first(row) == "wrong_length"


def test_a_glitch_behind_a_foreign_frame_is_no_address():
    assert "wrong_address" not in [each.cause for each in told("FE 04 00 03 00 01 D5 C5 00")]
