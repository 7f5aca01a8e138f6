"""Hex text in the forms people have it."""

from __future__ import annotations

from pathlib import Path

import pytest

from analyzer.catalogue import Role
from analyzer.records import Chunk, Comment
from analyzer.sources import Record, Source
from analyzer.sources.hexline import Shape, bytes_of, take_apart
from tests.contracts.source_contract import read_all

U, REQUEST, REPLY = Role.UNKNOWN, Role.REQUEST, Role.REPLY
FRAME = bytes.fromhex("FA01F601400234")
S = 1_000_000_000


def read(tmp_path: Path, text: str | bytes, **options: object) -> tuple[Source, list[Record]]:
    path = tmp_path / "capture.txt"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_all(path, **options)


@pytest.mark.parametrize(
    "text",
    [
        "FA 01 F6 01 40 02 34",
        "fa01f601400234",
        "FA01 F601 4002 34",
        "0xFA 0x01 0xF6 0x01 0x40 0x02 0x34",
        "0xfa,0x1,0xf6,0x1,0x40,0x2,0x34",
        "{0xFA, 0x01, 0xF6, 0x01, 0x40, 0x02, 0x34}",
        "[0xFA, 0x01, 0xF6, 0x01, 0x40, 0x02, 0x34]",
        "0xFA01F601400234",
        "FA:01:F6:01:40:02:34",
        "FA-01-F6-01-40-02-34",
        "FA,01,F6,01,40,02,34",
        "\\xFA\\x01\\xF6\\x01\\x40\\x02\\x34",
        "FAh 01h F6h 01h 40h 02h 34h",
        "FA 1 F6 1 40 2 34",
        "b'\\xfa\\x01\\xf6\\x01@\\x024'",
        "bytearray(b'\\xfa\\x01\\xf6\\x01@\\x024')",
        '"FA 01 F6 01 40 02 34"',
        "<FA 01 F6 01 40 02 34>",
        "$FA $01 $F6 $01 $40 $02 $34",
    ],
)
def test_ways_to_write_bytes(text: str) -> None:
    assert bytes_of(text) == FRAME
    for mark, role in (("", U), ("TX: ", REQUEST), ("12:34:56.789 RX ", REPLY)):
        line = take_apart(mark + text)
        assert (line.shape, line.data, line.role) == (Shape.TRAFFIC, FRAME, role)


@pytest.mark.parametrize("text", ["", "hello", "FA 01 G6", "FA 0", "12:34:56", "0xFG", "b'abc", "1.5", "FA 001"])
def test_what_is_no_bytes(text: str) -> None:
    # "FA 0" is bytes printed without leading zeros; "FA 001" cannot be told.
    assert bytes_of(text) in (None, b"", b"\xfa\0")


MARKS = [
    ("> ", REQUEST),
    ("< ", REPLY),
    (">> ", REQUEST),
    ("<< ", REPLY),
    ("-> ", REQUEST),
    ("<- ", REPLY),
    ("--> ", REQUEST),
    ("<-- ", REPLY),
    ("→ ", REQUEST),
    ("← ", REPLY),
    ("TX ", REQUEST),
    ("RX ", REPLY),
    ("Tx: ", REQUEST),
    ("Rx:", REPLY),
    ("tx> ", REQUEST),
    ("rx< ", REPLY),
    ("[TX] ", REQUEST),
    ("(RX) ", REPLY),
    ("TX -> ", REQUEST),
    ("RX <- ", REPLY),
    ("TXD: ", REQUEST),
    ("RXD: ", REPLY),
    ("T: ", REQUEST),
    ("R: ", REPLY),
    ("OUT: ", REQUEST),
    ("IN: ", REPLY),
    ("Sending :  ", REQUEST),
    ("Recieved :  ", REPLY),
    ("send: ", REQUEST),
    ("recv: ", REPLY),
    ("sent ", REQUEST),
    ("received: ", REPLY),
    ("write: ", REQUEST),
    ("read: ", REPLY),
    ("Send HEX: ", REQUEST),
    ("Recv data: ", REPLY),
    ("request: ", REQUEST),
    ("response: ", REPLY),
    ("query ", REQUEST),
    ("reply ", REPLY),
    ("host: ", REQUEST),
    ("drive: ", REPLY),
    ("Master TX: ", REQUEST),
    ("Slave TX: ", REPLY),
    ("Slave RX: ", REQUEST),
    ("Rx response: ", REPLY),
    ("000-Tx:", REQUEST),
    ("000123-Rx:", REPLY),
    ("Tx:000002-", REQUEST),
    ("TX (7 bytes): ", REQUEST),
    ("RX[7]: ", REPLY),
    ("RX len=7 : ", REPLY),
    ("[RTU]>Tx > 12:34:56:789 - ", REQUEST),
    ("[bus:0] Recieved :  ", REPLY),
    ("发→◇", REQUEST),
    ("收←◆", REPLY),
    ("DEBUG:pymodbus.logging:send: ", REQUEST),
    ("I (1234) rs485: RX: ", REPLY),
    ("ttyUSB0 < ", REPLY),
    ("COM3: TX: ", REQUEST),
    ("", U),
    ("12:00:00 ", U),
    ("[12] ", U),
]


@pytest.mark.parametrize(("mark", "role"), MARKS)
def test_marks(mark: str, role: Role) -> None:
    line = take_apart(f"{mark}FA 01 F6 01 40 02 34")
    assert (line.shape, line.data, line.role) == (Shape.TRAFFIC, FRAME, role)


TIMES = [
    ("2023-04-30 22:40:55.899 ", 1_682_894_455_899_000_000),
    ("2023-04-30T22:40:55.899123456Z ", 1_682_894_455_899_123_456),
    ("2023-04-30T22:40:55,899 ", 1_682_894_455_899_000_000),
    ("2023-04-30 22:40:55:899 ", 1_682_894_455_899_000_000),
    ("2023/04/30 22:40:55 ", 1_682_894_455_000_000_000),
    ("[2023-04-30 22:40:55.899] ", 1_682_894_455_899_000_000),
    ("2023-05-01T00:40:55.899+02:00 ", 1_682_894_455_899_000_000),
    ("30.04.2023 22:40:55.899 ", 1_682_894_455_899_000_000),
    ("30.04.23 22:40:55.899;", 1_682_894_455_899_000_000),
    ("1682894455.899123456 ", 1_682_894_455_899_123_456),
    ("(1682894455.899123) ", 1_682_894_455_899_123_000),
    ("1682894455899 ", 1_682_894_455_899_000_000),
    ("[12:34:56.789] ", 45_296_789_000_000),
    ("12:34:56.789123: ", 45_296_789_123_000),
    ("12:34:56,789 - ", 45_296_789_000_000),
    ("0.012345 ", 12_345_000),
    ("[  12.345678] ", 12_345_678_000),
    ("+0.012 ", 12_000_000),
    ("12.5 ms ", 12_500_000),
    ("1500us: ", 1_500_000),
    ("3s ", 3_000_000_000),
]


@pytest.mark.parametrize(("stamp", "t_ns"), TIMES)
@pytest.mark.parametrize("mark", ["TX: ", "", "> "])
def test_times(stamp: str, t_ns: int, mark: str, tmp_path: Path) -> None:
    source, records = read(tmp_path, f"{stamp}{mark}FA 01 F6\n")
    assert records == [Chunk(t_ns, "serial", b"\xfa\x01\xf6", REQUEST if mark else U, True)]
    assert source.time_source.startswith("capture: ")


def test_a_time_behind_the_mark(tmp_path: Path) -> None:
    records = read(tmp_path, "TX 12:34:56.789: FA 01\n")[1]
    assert records == [Chunk(45_296_789_000_000, "serial", b"\xfa\x01", REQUEST, True)]


@pytest.mark.parametrize("line", ["0x", "b''", "TX: 0x", "[]", "TX: b''"])
def test_no_bytes_are_no_traffic(line: str) -> None:
    assert take_apart(line).shape is not Shape.TRAFFIC


def test_colons_between_bytes_are_no_time() -> None:
    assert take_apart("TX: 12:34:56:78:9A").data == bytes.fromhex("123456789A")
    assert take_apart("12:34:56:78:9A").data == bytes.fromhex("123456789A")


def test_midnight(tmp_path: Path) -> None:
    stamps = ("23:59:59.999", "00:00:00.001", "00:00:00.000", "23:59:59.999", "00:00:01.0")
    text = "".join(f"[{stamp}] > FA 01\n" for stamp in stamps)
    source, records = read(tmp_path, text)
    day = 86_400 * S
    assert [r.t_ns for r in records] == [
        day - 1_000_000, day + 1_000_000, day, 2 * day - 1_000_000, 2 * day + S,
    ]  # fmt: skip
    assert any("backwards once" in note for note in source.notes)


def test_steps_that_go_back_are_from_line_to_line(tmp_path: Path) -> None:
    records = read(tmp_path, "+0.500 > FA\n+0.001 < FB\n+0.500 > FA\n")[1]
    assert [r.t_ns for r in records] == [500_000_000, 501_000_000, 1_001_000_000]
    records = read(tmp_path, "+0.001 > FA\n+0.500 < FB\n+0.600 > FA\n")[1]
    assert [r.t_ns for r in records] == [1_000_000, 500_000_000, 600_000_000]


def test_no_times(tmp_path: Path) -> None:
    source, records = read(tmp_path, "FA 01 F6\n")
    assert source.time_source == "none"
    assert records[0].t_ns is None


def test_a_line_without_a_time_takes_the_one_before_or_the_first(tmp_path: Path) -> None:
    source, records = read(tmp_path, "FA 01\n1.5 FA 01\nFA 02\n")
    assert [r.t_ns for r in records] == [1_500_000_000] * 3
    assert any("2 records without a time" in note for note in source.notes)


#: As the manual prints it: two of the package's 52 bytes were lost in print.
ASSISTANT = """\
[2023-04-30 22:40:55.899]# SEND HEX>
FC 01 F6 00 32 0A 00 00 00 00 02 F6 80 64 20 00 00 00 00 03 FD 01 2C 02
00 04 E2 00 00 04 F4 02 58 64 00 19 00 00 00 05 F5 04 B0 C8 00 0C 80 00 00 11

[2023-04-30 22:40:55.950]# RECV HEX>

FB 01 F6 01 F3

[2023-04-30 22:40:56.000]# RECV ASCII>
ADD BAD BED
"""


def test_the_serial_assistant_of_the_manual(tmp_path: Path) -> None:
    first, second, text = read(tmp_path, ASSISTANT)[1]
    start = 1_682_894_455_000_000_000
    assert isinstance(first, Chunk)
    assert (first.t_ns, len(first.data), first.direction, first.burst) == (start + 899_000_000, 50, REQUEST, True)
    assert second == Chunk(start + 950_000_000, "serial", bytes.fromhex("FB01F601F3"), REPLY, True)
    assert text == Comment(start + S, "serial", "ADD BAD BED")


def test_sscom_in_its_own_encoding(tmp_path: Path) -> None:
    records = read(tmp_path, "[22:00:41.748]发→◇FA 01 F6\n[22:00:41.810]收←◆FB 01 F6\n".encode("gb18030"))[1]
    assert [(r.direction, r.data.hex()) for r in records if isinstance(r, Chunk)] == [(REQUEST, "fa01f6"), (REPLY, "fb01f6")]


LK = """\
[bus:0] Sending :  3e a4 01 0c ef 7d 86
[bus:0] Recieved :  3e a4 01 07 ea 21 71
Target:    34429 Encoder:    19945 errors:3/116  (errors in checksum of second part of response: 3)
[bus:1] Sending :  3e a4 02 0c f0 c6
"""


def test_lines_between_the_traffic_are_comments(tmp_path: Path) -> None:
    source, records = read(tmp_path, LK)
    assert records == [
        Chunk(None, "bus_0", bytes.fromhex("3ea4010cef7d86"), REQUEST, True),
        Chunk(None, "bus_0", bytes.fromhex("3ea40107ea2171"), REPLY, True),
        Comment(None, "bus_0", LK.splitlines()[2]),
        Chunk(None, "bus_1", bytes.fromhex("3ea4020cf0c6"), REQUEST, True),
    ]
    assert source.notes == []


def test_comments(tmp_path: Path) -> None:
    text = "# FA 01 a note\n// FA 01\n; note\nFA 01 F6 # run\nFA 01 F7 // stop\nFA 01 (2 bytes)\n* FA 01\n"
    records = read(tmp_path, text)[1]
    assert [r.data.hex() if isinstance(r, Chunk) else r.text for r in records if not isinstance(r, type(None))] == [
        "# FA 01 a note", "// FA 01", "; note", "fa01f6", "# run", "fa01f7", "// stop", "fa01", "* FA 01",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("line", "rest"),
    [
        ("TX: FA 01 G6 01", "FA 01 G6 01"),
        ("FA 01 F6 01 4Q 02", "FA 01 F6 01 4Q 02"),
        ("< FB0", "FB0"),
        ("FA01F6014", "FA01F6014"),
        ("12:00:00.5 RX: FB 01 F", None),
        ("0xFA 0xZZ 0x01", "0xFA 0xZZ 0x01"),
    ],
)
def test_broken_hex_is_a_problem_with_its_line(line: str, rest: str | None, tmp_path: Path) -> None:
    source, records = read(tmp_path, f"FA 01 F6\n{line}\nFA 01 F7\n")
    if rest is None:
        assert source.problems == []
        return
    assert [r.data.hex() for r in records if isinstance(r, Chunk)] == ["fa01f6", "fa01f7"]
    assert str(source.problems[0]) == f"line 2: expected hex bytes, got {rest!r}"


def test_a_listeners_log_does_not_tell_who_sent(tmp_path: Path) -> None:
    source, records = read(tmp_path, "RX: FA 01 F6\nRX: FB 01 F6\n" * 5)
    assert {r.direction for r in records if isinstance(r, Chunk)} == {U}
    assert any("listener" in note for note in source.notes)


def test_rows_of_decimal_numbers_are_no_traffic(tmp_path: Path) -> None:
    from analyzer.errors import UnreadableError

    with pytest.raises(UnreadableError, match="not a recognised capture format"):
        read(tmp_path, "time,a,b\n" + "0.1,23,45\n0.2,24,44\n" * 20)


def test_invalid_utf8(tmp_path: Path) -> None:
    records = read(tmp_path, b"TX: FA 01 F6\nRX: FB 01 F6\nger\xe4t \xff\xfe an\nTX: FA 02\n")[1]
    assert len(records) == 4
    assert isinstance(records[2], Comment)


def test_line_ends(tmp_path: Path) -> None:
    for end in ("\n", "\r\n", "\r"):
        assert len(read(tmp_path, end.join(["FA 01 F6"] * 5) + end)[1]) == 5


AS_TYPED = [
    # A number of the line or a length before the bytes is never a byte.
    ("1 FA 01 32 2D\n2 FB 01 32 01 40 6F\n10 FA 01 32 2D\n", [None, None, None], (U, U, U)),
    ("4\tFA 01 32 2D\n6\tFB 01 32 01 40 6F\n", [None, None], (U, U)),
    ("1 01 04 00 32 00 01 90 05\n2 01 04 02 01 40 B9 50\n10 01 04 02 01 40 B9 50\n", [None] * 3, (U, U, U)),
    ("07 04 00 32 00 01 90 05\n07 04 02 01 40 B9 50 00\n", [None, None], (U, U)),
    ("TX 4 FA 01 32 2D\nRX 6 FB 01 32 01 40 6F\n", [None, None], (REQUEST, REPLY)),
    (
        "001 | 0:00:01.100 | TX | 4 | FA 01 32 2D\n002 | 0:00:01.105 | RX | 6 | FB 01 32 01 40 6F\n",
        [1.1, 1.105],
        (REQUEST, REPLY),
    ),
    # A time behind a logger's words.
    ("INFO 0:00:01.100 TX: FA 01 32 2D\nINFO 0:00:01.105 RX: FB 01 32 01 40 6F\n", [1.1, 1.105], (REQUEST, REPLY)),
    (
        "0\t0:00:01\ta.exe\tIRP_MJ_WRITE\tSerial0\tSUCCESS\tLength 4: FA 01 32 2D\n"
        "1\t0:00:02\ta.exe\tIRP_MJ_READ\tSerial0\tSUCCESS\tLength 6: FB 01 32 01 40 6F\n",
        [1, 2],
        (REQUEST, REPLY),
    ),
    # Words of other languages, letters in a column.
    ("0:00:01,100 Gesendet: fa 01 32 2d\n0:00:01,105 Empfangen: fb 01 32 01 40 6f\n", [1.1, 1.105], (REQUEST, REPLY)),
    ("0:00:01.1 送信 FA 01 32 2D\n0:00:02 受信 FB 01 32 01 40 6F\n", [1.1, 2], (REQUEST, REPLY)),
    ("Отправлено: FA 01 32 2D\nПолучено: FB 01 32 01 40 6F\n", [None, None], (REQUEST, REPLY)),
    ("0:00:01\tW\tFA 01 32 2D\n0:00:02\tR\tFB 01 32 01 40 6F\n", [1, 2], (REQUEST, REPLY)),
    # Words behind the bytes; a list over several lines.
    ("send: 0xfa 0x1 0x32 0x2d\nrecv: 0xfb 0x1 0x32 0x1 0x40 0x6f extra data: \n", [None, None], (REQUEST, REPLY)),
    ("uint8_t run[] = { 0xFA, 0x01,\n   0x32, 0x2D };\n", [None], (U,)),
]


@pytest.mark.parametrize(("text", "seconds", "roles"), AS_TYPED)
def test_logs_as_programs_and_people_type_them(
    tmp_path: Path, text: str, seconds: list[float | None], roles: tuple[Role, ...]
) -> None:
    source, records = read(tmp_path, text)
    chunks = [record for record in records if isinstance(record, Chunk)]
    assert source.problems == []
    assert [chunk.direction for chunk in chunks] == list(roles)
    assert [None if chunk.t_ns is None else chunk.t_ns / S for chunk in chunks] == seconds
    assert {chunk.data[0] for chunk in chunks} <= {0xFA, 0xFB, 0x01, 0x07, 0x32}
    assert all(len(chunk.data) in (2, 4, 6, 7, 8) for chunk in chunks)


@pytest.mark.parametrize("marks", ["HC", "ME", "AB", ">F", "qa", "DH"])
@pytest.mark.parametrize(
    "form",
    [
        "0.00{n} {mark} {data}",
        "0:00:01.10{n} {mark} {data}",
        "10:00:0{n} {mark} {data}",
        "{mark} {data}",
        "0.00{n} | {mark} | {data}",
    ],
)
def test_a_letter_alone_before_the_bytes_is_a_mark_even_if_it_is_a_digit(form: str, marks: str, tmp_path: Path) -> None:
    frames = ["3E 9C 02 00 DC", "3E 9C 02 07 E3 1C 14 00 32 00 3A 07 A3"] * 2
    lines = [form.format(n=n, mark=marks[n % 2], data=frame) for n, frame in enumerate(frames)]
    source, records = read(tmp_path, "\n".join(lines))
    assert source.problems == []
    assert [record.data for record in records if isinstance(record, Chunk)] == [bytes.fromhex(frame) for frame in frames]


def test_a_line_that_is_cut_makes_no_byte_of_a_letter(tmp_path: Path) -> None:
    _, records = read(tmp_path, "B FA 01 32 2D\nC FB 01 32 01 40 6F\nB FA 01 32 2D\nC FB 3")
    data = [record.data for record in records if isinstance(record, Chunk)]
    assert data[:3] == [bytes.fromhex(each) for each in ("FA 01 32 2D", "FB 01 32 01 40 6F", "FA 01 32 2D")]


@pytest.mark.parametrize("stamp", ["", "0:00:01 "])
def test_a_letter_is_a_byte_where_bytes_stand_without_their_zeros(stamp: str, tmp_path: Path) -> None:
    # Only the second line shows it.
    _, records = read(tmp_path, f"{stamp}C 86 12 E2 65\n{stamp}C 6 0 1F 0 3 9C D0\n{stamp}C 10 51 9A 33\n")
    expected = ["0C 86 12 E2 65", "0C 06 00 1F 00 03 9C D0", "0C 10 51 9A 33"]
    assert [record.data for record in records if isinstance(record, Chunk)] == [bytes.fromhex(each) for each in expected]


@pytest.mark.parametrize("line", ["D FB 1 31 2D", "D FB 01 3 2D", "B 12 34"])
def test_a_letter_is_a_byte_before_others_of_one_digit_and_before_few(line: str) -> None:
    found = take_apart(line)
    assert found.data == bytes(int(digits, 16) for digits in line.split())
    assert found.sign == ""


def test_a_number_before_the_bytes_is_told(tmp_path: Path) -> None:
    source, _ = read(tmp_path, "7 FA 01 32 2D\n3 FB 01 32 01 40 6F\n")
    assert "line 1: the '7' before 4 bytes is read as the number of the line" in " ".join(source.notes)


@pytest.mark.parametrize(
    ("heading", "first", "second"),
    [("n;ms;dir;data", "1;5", "2;1006"), ("time;dir;data", "0,005", "1,006"), ("us;dir;data", "5000", "1006000")],
)
def test_times_of_a_table_without_a_word_for_time_or_with_a_comma(
    tmp_path: Path, heading: str, first: str, second: str
) -> None:
    source, records = read(tmp_path, f"{heading}\n{first};tx;FA 01 32 2D\n{second};rx;FB 01 32 01 40 6F\n")
    assert source.problems == []
    assert [chunk.t_ns for chunk in records if isinstance(chunk, Chunk)] == [5_000_000, 1_006_000_000]
