"""Bytes anywhere in a text: their sender, bytes of no frame, and notes of what is left out."""

from __future__ import annotations

from pathlib import Path

import pytest

from analyzer.catalogue import Role
from analyzer.cli import main
from analyzer.errors import UnreadableError
from analyzer.records import CanFrame, Chunk
from analyzer.sources.prose import mentions
from tests.contracts.source_contract import read_all

MARKS = {Role.REQUEST: ">", Role.REPLY: "<", Role.UNKNOWN: "?"}


def said(tmp_path: Path, text: str) -> list[str]:
    path = tmp_path / "paste.txt"
    path.write_text(text + "\n")
    return [
        f"{MARKS[record.direction]} {record.data.hex(' ').upper()}"
        for record in read_all(path)[1]
        if isinstance(record, Chunk | CanFrame)
    ]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("cycle: [01][04][00][32][00][01][90][05]\nWaiting ...\n<01><04><02>", ["> 01 04 00 32 00 01 90 05", "< 01 04 02"]),
        ("-->10-15-0-204\n<--129-4\n", ["> 0A 0F 00 CC", "< 81 04"]),
        ("[01][04][00][00][00][12][70][07]\nWaiting ...\n < 00 >< 00 >< 00 >\n", ["> 01 04 00 00 00 12 70 07", "< 00 00 00"]),
        ("no response in the loop:\nDEBUG Thread-1 -> 1-3-0-13-0-1-21-201\n", ["> 01 03 00 0D 00 01 15 C9"]),
        ("[250][001][048][043]\nnothing comes\n", ["? FA 01 30 2B"]),
        ("16#FA 16#01 16#30 16#2B\n", ["? FA 01 30 2B"]),
        ("&HFA &H01 &H30 &H2B\n", ["? FA 01 30 2B"]),
        ("I want to read the angle\nFA 01 30 2B\nand I get\nFB 01 30 00 00\n", ["> FA 01 30 2B", "< FB 01 30 00 00"]),
        ("FA 01 30 2B  <--- request\n00 FB 01 F6 01 F3  <--- reply\n", ["> FA 01 30 2B", "< 00 FB 01 F6 01 F3"]),
        ("PC sends FA 01 30 2B (4 bytes), it gets Response: FB 01 F6 01 F3", ["> FA 01 30 2B", "< FB 01 F6 01 F3"]),
        ("The response is: '\\x01\\x84\\x02\\xc2Á' (plain: '\\x01\\x84\\x02\\xc2Á')", ["< 01 84 02 C2 C1"]),
        ("Sending : 01,04,00,32 HEX gives an output of 7F,7E,FF", ["> 01 04 00 32", "< 7F 7E FF"]),
        ("01 unit\n84 error code\n02 exception\n01 unit\n84 error code\n03 exception\n", ["? 01 84 02", "? 01 84 03"]),
        ("uint8_t tx[] = {\n 0xFA, 0x01,\n 0x30, 0x2B\n};\n", ["> FA 01 30 2B"]),
        ("void loop() {\n Serial.write(0xFA);\n Serial.write(0x01);\n Serial.write(0x30);\n}\n", ["> FA 01 30"]),
        ("got:\n | 0000: FB 01 30 00  |..0.|\n | 0004: 01 20  |. |\nend\n", ["? FB 01 30 00 01 20"]),
        ("# the request: FA 01 F6 01\n# and [0xFA, 0x01, 0x30, 0x2B]\n", ["> FA 01 F6 01", "? FA 01 30 2B"]),
        ("to stop run `cansend can0 001#F701F9`, it helps\n", ["> F7 01 F9"]),
        ("0x001  F7 01 F9    request\n0x001  F7 01 F9    reply\n", ["? F7 01 F9", "? F7 01 F9"]),
        ("Send e0 36\n\nreturn E0 01\n", ["> E0 36", "< E0 01"]),
    ],
)
def test_bytes_and_their_sender(text: str, found: list[str], tmp_path: Path) -> None:
    assert said(tmp_path, text) == found


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("the motor does not return FB 01 F6 01 F3", "did not come"),
        ("00 FB 01 F6 came, instead of FB 01 F6 01 F3", "should have come"),
        ("the reply should be FB 01 F6 01 F3", "should have come"),
        ("the card is DC:DA:0C:C5:6E:98", "network card"),
        ("commit 3fa9c1d2e4aabb0011223344556677889900aabb", "hash"),
    ],
)
def test_what_is_left_out_is_said(line: str, why: str) -> None:
    assert [why in each.left for each in mentions(line)][-1]


def test_a_request_that_nobody_answers_is_no_missing_reply() -> None:
    (found,) = mentions("it does not answer FA 01 30 2B")
    assert (found.role, found.left) == (Role.REQUEST, "")


@pytest.mark.parametrize(
    "text",
    [
        "The current is 1600 mA since 12:30:00 on 2024-05-05, and 300 rpm.\n",
        "uuid 123e4567-e89b-12d3-a456-426614174000 at 192.168.1.10\n",
        "levels of 12, 24, 36, 48, 50 V\n",
        "int a = 10, b = 20, c = 30;\nreturn 0;\n",
    ],
)
def test_numbers_of_people_are_no_bytes(text: str, tmp_path: Path) -> None:
    with pytest.raises(UnreadableError, match="frames are expected as FA 01 30 2B"):
        said(tmp_path, text)


def test_numbers_of_socketcan_have_their_flags(tmp_path: Path) -> None:
    path = tmp_path / "paste.txt"
    path.write_text("node: error msg ID: 0x20000004, Data[0..7]: 0x00, 0x08, 0x00, 0x00 (can0)\n")
    (frame,) = read_all(path)[1]
    assert isinstance(frame, CanFrame)
    assert (frame.id, frame.error, frame.port, frame.data) == (4, True, "can0", b"\0\x08\0\0")


@pytest.mark.parametrize("quotation", ["", "> | "])
def test_candump_with_error_frames_is_candump(quotation: str, tmp_path: Path) -> None:
    path = tmp_path / "paste.txt"
    error = "  can0  RX - -  2000000C   [8]  00 00 04 00 00 00 00 00   ERRORFRAME\n\tcontroller-problem{}\n"
    text = "  can0  RX - -  001   [1]  31\n" + 5 * (error + "\tprotocol-violation{{bit-stuffing-error}{}}\n")
    path.write_text("".join(f"{quotation}{line}\n" for line in text.splitlines()))
    source, records = read_all(path)
    assert source.format == "candump"
    assert sum(isinstance(record, CanFrame) and record.error for record in records) == 5
    assert source.problems == []


def test_diagnose_says_what_it_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "post.txt"
    path.write_text("I send FA 01 31 32 and FA 01 3A 3B, and it does not return FB 01 31 00.\n")
    assert main(["diagnose", str(path)]) == 1
    told = capsys.readouterr()
    assert "wrong_checksum_rule" in told.out
    assert "FB 01 31 00 is left out: what did not come" in told.err
