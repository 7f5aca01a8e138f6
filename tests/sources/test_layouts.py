"""How people lay out what they paste: quotations, HTML, lists, strings, labels; each with what must stay unread."""

from __future__ import annotations

from pathlib import Path

import pytest

from analyzer.records import CanFrame, Chunk
from analyzer.sources import open_source

ASKED, ANSWERED = "11 03 00 C0 00 01 86 A6", "11 03 02 00 04 78 44"
LIBRARY = "Library debug mode. {} instrument: {} (8 bytes), after 1.2 ms\n"


def iec(text: str) -> str:
    """Return bytes as controllers write them."""
    return " ".join(f"16#{byte}" for byte in text.split())


def read(tmp_path: Path, text: str) -> list[tuple[str, str]]:
    path = tmp_path / "paste.txt"
    path.write_text(text, "utf-8")
    with open_source(path) as source:
        return [(r.direction.value, r.data.hex(" ").upper()) for r in source if isinstance(r, Chunk)]


BOTH = [("request", ASKED), ("reply", ANSWERED)]


@pytest.mark.parametrize(
    "text",
    [
        # A post quotes some lines; a number among them and a call with values are no bytes.
        "I read a register:\n\n> instrument.read_register(192)\n> "
        + LIBRARY.format("Will write to", ASKED)
        + "> "
        + LIBRARY.format("Response from", ANSWERED)
        + ">\n> 4\n\nand write it:\n\n> instrument.write_register(192, 0)\n",
        # Python 2 prints the characters of bytes as they are.
        LIBRARY.format("Writing to", r"'\x11\x03\x00\xc0\x00\x01\x86\xa6'")
        + LIBRARY.format("Response from", r"'\x11\x03\x02\x00\x04xD'"),
        # HTML, and decimal numbers.
        "<b>INFO Transport - TX: 17, 3, 0, 192, 0, 1, 134, 166</b>\n<b>INFO Transport - RX: 17, 3, 2, 0, 4, 120, 68</b>\n",
        # Names of what holds the bytes.
        f"txBuffer: {ASKED}\nReadFrame: **{ANSWERED[:2]}**{ANSWERED[2:]}\n",
        # A library's words beside a log of bytes: a label stands before what is new, and what was there is said again.
        f"TX: {ASKED}\nSending frame again with retry 1\nResponse from unit on the bus: [{', '.join(ANSWERED.split())}]\n"
        f"Processing frame: {ANSWERED[3:-6]}\nCurrent frame received: {ANSWERED}\n",
        # A call of a program, with what came of it behind an arrow.
        f"0.0s socket.send  {ASKED.replace(' ', '')}   -> ok\n0.1s socket.recv  {ANSWERED.replace(' ', '')}\n",
        f"[10:00:00] wr {ASKED.replace(' ', '').lower()}\n[10:00:01] rd {ANSWERED.replace(' ', '').lower()}\n",
        # Each call with what it returned, which may be the same again.
        f"DEBUG:bus:write(8) -> {bytes.fromhex(ASKED)}\nDEBUG:bus:read(7) -> {bytes.fromhex(ANSWERED)}\n",
        f"08:00:00 SEND {iec(ASKED)}  -> sent\n08:00:01 RECV {iec(ANSWERED)}\n",
        # A controller's table, in its own digits.
        f"Zeitstempel;SendBuf;RecvBuf;Status\n2024-03-01 08:00:00;{iec(ASKED)};{iec(ANSWERED)};16#0000\n",
    ],
    ids=["quoted", "characters", "html", "names", "labels", "calls", "short-words", "returned", "iec", "controller"],
)
def test_one_exchange(text: str, tmp_path: Path) -> None:
    assert read(tmp_path, text) == BOTH


@pytest.mark.parametrize(
    "text",
    [
        "write Uint8Array(4) [250, 10, 50, 54]\ndata Uint8Array(6) [251, 10, 50, 255, 129, 183]\n",
        "10:20:00.250 | FB_Servo | Sende 4 Byte: 16#FA, 16#0A, 16#32, 16#36\n"
        "10:20:00.254 | FB_Servo | Empfange 6 Byte: 16#FB, 16#0A, 16#32, 16#FF, 16#81, 16#B7\n",
        # The tag of a logger is no sender.
        "10:20:01.000 D/Servo: write [-6, 10, 50, 54]\n10:20:01.004 D/Servo: read [-5, 10, 50, -1, -127, -73]\n",
        "07-08 10:20:01.000  123  125 D Motor   : write [-6, 10, 50, 54]\n"
        "07-08 10:20:01.004  123  125 D Motor   : read [-5, 10, 50, -1, -127, -73]\n",
        # Six bytes that could be the address of a network card.
        '{"usb.src": ["host"], "usb.capdata": ["fa:0a:32:36"]}\n{"usb.src": ["1.4.1"], "usb.capdata": ["fb:0a:32:ff:81:b7"]}\n',
    ],
    ids=["node", "german", "android", "logcat", "usb"],
)
def test_every_line_of_a_log_is_read(text: str, tmp_path: Path) -> None:
    came = read(tmp_path, text * 3)
    assert [data for _, data in came] == ["FA 0A 32 36", "FB 0A 32 FF 81 B7"] * 3
    if "D/" in text or " D " in text:
        assert [role for role, _ in came] == ["request", "reply"] * 3


def test_the_name_of_a_block_speaks_for_no_drive(tmp_path: Path) -> None:
    rows = [f"08.07.2025 10:20:0{n}.000 | FB_Servo | Sende 4 Byte: 16#FA, 16#0A, 16#32, 16#36\n" for n in range(3)]
    assert read(tmp_path, "".join(rows)) == [("request", "FA 0A 32 36")] * 3
    assert read(tmp_path, "The call FB_Servo sends FA 0A 32 36 and no more.\n") == [("request", "FA 0A 32 36")]


def test_objects_that_node_prints_are_rows(tmp_path: Path) -> None:
    path = tmp_path / "node.log"
    path.write_text(
        "{ dir: 'tx', id: 16, ext: false, rtr: undefined, data: <Buffer 32 42> }\n"
        "{ dir: 'rx', id: 16, ext: false, data: <Buffer 32 00 68 aa> }\n"
    )
    with open_source(path) as source:
        frames = [(each.id, each.data.hex(), each.direction.value) for each in source if isinstance(each, CanFrame)]
    assert frames == [(16, "3242", "request"), (16, "320068aa", "unknown")]


def test_a_length_and_a_colon_stand_before_the_data_of_can(tmp_path: Path) -> None:
    path = tmp_path / "can.txt"
    path.write_text("Sent packet with id 0x8 and length 2: 32 3A\nReceived packet with id 0x8 and length 4: 32 00 68 A2\n")
    with open_source(path) as source:
        assert [(each.id, each.data.hex()) for each in source if isinstance(each, CanFrame)] == [(8, "323a"), (8, "320068a2")]
    # Without a length it is an address on a serial line.
    assert read(tmp_path, "id 1: FA 01 30 2B\n" * 3) == [("unknown", "FA 01 30 2B")] * 3


def test_characters_beyond_ascii_are_bytes(tmp_path: Path) -> None:
    text = f"TX: {ASKED}\nResponse: '\\x11\\x03\\x02\\x00\u00fe\u00b8D' (7 bytes)\n"
    assert read(tmp_path, text) == [("request", ASKED), ("reply", "11 03 02 00 FE B8 44")]


def test_a_list_without_zeros_before_digits_is_decimal(tmp_path: Path) -> None:
    text = 'sent {"data":{"type":"Buffer","data":[58,48,49,48,51,13,10]}}\n'
    assert read(tmp_path, text) == [("request", "3A 30 31 30 33 0D 0A")]


def test_what_a_call_returns_again_is_read_again(tmp_path: Path) -> None:
    text = f"DEBUG:bus:write {bytes.fromhex(ASKED)}\nDEBUG:bus:read(7) -> {bytes.fromhex(ANSWERED)}\n"
    assert read(tmp_path, text * 3) == BOTH * 3
    text = f"ser.write {ASKED.replace(' ', '')}\nser.read(7) {ANSWERED.replace(' ', '')}\n"
    assert read(tmp_path, text * 3) == BOTH * 3


@pytest.mark.parametrize("text", ["TX: [01, 03, 06, 31]\nRX: [3D, 31, 79]\n", "TX: [0x01, 3, 6, 0x31]\nRX: [0x3D, 49, 0x79]\n"])
def test_other_lists_are_as_they_were(text: str, tmp_path: Path) -> None:
    assert [data for _, data in read(tmp_path, text)] == ["01 03 06 31", "3D 31 79"]


def test_marks_of_a_log_are_no_quotation(tmp_path: Path) -> None:
    assert read(tmp_path, f"> {ASKED}\n< {ANSWERED}\n> motor does not turn\n") == BOTH


def test_what_should_have_come_below_words_did_not(tmp_path: Path) -> None:
    text = f"I send\n{ASKED}\n\nThe reply should be\n{ANSWERED}\n\nbut I get\n11 83 02 C1 34\n"
    assert read(tmp_path, text) == [("request", ASKED), ("reply", "11 83 02 C1 34")]


def test_sentences_with_bytes_beside_a_log_stay_unread(tmp_path: Path) -> None:
    text = f"TX: {ASKED}\nRX: {ANSWERED}\nI would send 11 03 00 C1 00 01 D7 66 next and see\n"
    assert read(tmp_path, text) == BOTH


def test_bytes_without_gaps_and_zeros_are_not_guessed(tmp_path: Path) -> None:
    path = tmp_path / "paste.txt"
    path.write_text(
        "const byte ask[] = {0x11, 0x03, 0x00, 0xC0, 0x00, 0x01, 0x86, 0xA6};\n\nI get:\n113204384\n1132043844\n113205396\n"
    )
    with open_source(path) as source:
        assert [r.data.hex() for r in source if isinstance(r, Chunk)] == ["110300c0000186a6"]
        assert any("without leading zeros" in note for note in source.notes)


def test_what_a_library_keeps_of_several_reads_is_known(tmp_path: Path) -> None:
    text = (
        f"send: {ASKED}\nrecv: 11 03 02\nProcessing: 11 03 02\nrecv: 00 04 78 44\nProcessing: 00 04 78 44\n"
        "Getting frame: 03 02 00 04\n"
    )
    assert read(tmp_path, text) == [("request", ASKED), ("reply", "11 03 02"), ("reply", "00 04 78 44")]


def test_what_is_cleared_before_a_request_was_received(tmp_path: Path) -> None:
    text = f"send: {ASKED}\nWARNING: cleanup recv buffer before send: 00 22 00 22 E0 5D\nrecv: {ANSWERED}\n"
    assert read(tmp_path, text)[1] == ("reply", "00 22 00 22 E0 5D")


@pytest.mark.parametrize(
    "table",
    [
        "time_ms,telegram,b0,b1,b2,b3\n0,OUT,250,1,48,43\n2,IN,251,1,48,44\n",
        "time,telegram,i/o\n0.1,FA 01 30 2B,OUT\n0.2,FB 01 30 2C,IN\n",
        "t;wer;hex\n1;Master;FA01302B\n2;Slave;FB01302C\n",
    ],
)
def test_a_column_of_marks_alone_says_who_sent_whatever_it_is_called(table, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text(table)
    with open_source(path) as source:
        chunks = [(each.direction.value, each.data.hex()) for each in source if isinstance(each, Chunk)]
    assert chunks == [("request", "fa01302b"), ("reply", "fb01302c")]


@pytest.mark.parametrize("marks", ["T R", "t r", "> <", "out in", "W R", "-> <-"])
@pytest.mark.parametrize("heading", ["Time (s),Dir,ID,DLC,Data", "ID,DLC,Data,Direction"])
def test_a_column_of_directions_may_have_a_letter_or_a_sign(marks, heading, tmp_path: Path) -> None:
    sent, received = marks.split()
    rows = [(sent, "00C", "3", "F6 01 03"), (received, "00C", "3", "F6 02 04"), (sent, "00D", "2", "F1 FE")]
    cells = [
        {"Time (s)": f"0.{n}", "Dir": r[0], "Direction": r[0], "ID": r[1], "DLC": r[2], "Data": r[3]}
        for n, r in enumerate(rows)
    ]
    path = tmp_path / "can.csv"
    path.write_text("\n".join((heading, *(",".join(row[name] for name in heading.split(",")) for row in cells))) + "\n")
    with open_source(path) as source:
        roles = [each.direction.value for each in source if isinstance(each, CanFrame)]
    # A listener receives everything: on CAN only what was sent is told.
    assert roles == ["request", "unknown", "request"]


@pytest.mark.parametrize(
    "rows",
    [
        "addr 01  FA013A35  --\naddr 02  FA023A36  FB023A0138\n",
        "addr 01  FA 01 3A 35  --\naddr 02  FA 02 3A 36  FB 02 3A 01 38\n",
        "01  FA013A35\n02  FA023A36\n03  FB023A0138\n",
        "drive 0A  FA013A35  timeout\ndrive 0B  FA023A36  FB023A0138\n",
        "addr;request;answer\n1;FA 01 3A 35;-\n2;FA 02 3A 36;FB 02 3A 01 38\n",
        "  7  FA 01 3A 35  --\n  8  FA 02 3A 36  --\n  9  FB 02 3A 01 38\n",
    ],
)
def test_a_number_of_a_row_is_no_byte(rows, tmp_path: Path) -> None:
    assert "".join(data for _, data in read(tmp_path, rows)).replace(" ", "") == "FA013A35FA023A36FB023A0138"


def test_an_address_that_counts_up_is_a_byte(tmp_path: Path) -> None:
    rows = ["01 04 00 33 00 02 81 C4", "02 04 00 33 00 02 81 F7", "03 04 00 33 00 02 80 26", "04 04 00 33 00 02 81 91"]
    assert [data for _, data in read(tmp_path, "\n".join(rows) + "\n")] == rows


def test_digits_without_gaps_that_have_a_check_are_a_frame(tmp_path: Path) -> None:
    text = f"[10:00:00] tell {ASKED.replace(' ', '').lower()}\n[10:00:01] hear deadbeef01 and 110300c00001\n"
    assert [data for _, data in read(tmp_path, text)] == [ASKED]


@pytest.mark.parametrize(
    ("heading", "row"),
    [
        ("Id,Time[ns],0:UART: RX/TX", "{n},{n}310000.00,{byte:02X}"),
        ("Id,Time,TX", "{n},0.{n:02},0x{byte:02X}"),
        ("Index,Time (s),UART data", "{n},0.{n:02},0x{byte:02X}"),
        ("Nr;Zeit;Wert", "{n};0,{n:02};{byte:02X}"),
        ("Id,Time,Value", "{n},0.{n:02},{byte}"),
    ],
)
def test_a_number_of_a_row_is_no_identifier(heading: str, row: str, tmp_path: Path) -> None:
    sent = bytes.fromhex("FA 01 31 2C FB 01 31 00 00 00 00 02 BC EB")
    rows = [row.format(n=n, byte=byte) for n, byte in enumerate(sent)]
    assert "".join(data for _, data in read(tmp_path, "\n".join((heading, *rows)) + "\n")) == sent.hex().upper()


@pytest.mark.parametrize(("size", "ends"), [(16, False), (24, False), (9, True)])
def test_a_line_of_a_dump_ends_where_it_is_full(size: int, ends: bool, tmp_path: Path) -> None:
    data = bytes.fromhex("FA 01 31 2C FB 01 31 00 00 00 00 02 BC EB FA 01 F1 EC FB 01 F1 01 EE") * 6
    path = tmp_path / "dump.txt"
    path.write_text("\n".join(data[at : at + size].hex(" ") for at in range(0, len(data), size)) + "\n")
    with open_source(path) as source:
        assert {each.burst for each in source if isinstance(each, Chunk)} == {ends}


@pytest.mark.parametrize("heading", ["Time,ID,Data", "Time,ID,Data length,D0,D1", "Time,ID,D0"])
def test_an_empty_cell_before_cells_without_a_heading_loses_no_row(heading: str, tmp_path: Path) -> None:
    rows = [f"0.00{n},0x001,{',' * (n % 2)}F3,01,F5" for n in range(1, 9)]
    path = tmp_path / "table.csv"
    path.write_text("\n".join((heading, *rows)) + "\n", "utf-8")
    with open_source(path) as source:
        read = list(source)
        problems = source.problems
    assert sum(isinstance(record, CanFrame | Chunk) for record in read) + len(problems) >= len(rows)


@pytest.mark.parametrize("column", ["b{}", "byte{:02}", "D{}", "d{:02}"])
def test_a_table_has_a_column_for_each_of_many_bytes(column: str, tmp_path: Path) -> None:
    sent, replied = "3E 9C 01 00 DB", "3E 9C 01 07 E2 1F 22 00 78 00 E8 03 A4"
    names = ",".join(column.format(n) for n in range(16))
    rows = [",".join(str(byte) for byte in bytes.fromhex(frame)) for frame in (sent, replied)]
    text = f"time_ms,dir,{names}\n0,TX,{rows[0]},,,,,,,,,,,\n2,RX,{rows[1]},,,\n"
    assert read(tmp_path, text) == [("request", sent), ("reply", replied)]
