"""What people paste: each kind of `captures/pastes.py` gives its frames, with their times and senders."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from analyzer.catalogue import Role
from analyzer.errors import UnreadableError
from analyzer.pipeline import Pipeline
from analyzer.records import CanFrame, Chunk, Comment
from analyzer.sources import Record, Source
from analyzer.sources.hexline import take_apart
from analyzer.sources.prose import quotations
from analyzer.sources.written import Radix
from analyzer.sources.written import read as read_written
from tests.collect import Collect
from tests.contracts.source_contract import check_record, read_all
from tests.view.screen import reading_of

CAPTURES = Path(__file__).parents[2] / "captures"
sys.path.insert(0, str(CAPTURES))
from pastes import PASTES, Paste, listing  # noqa: E402

SENDERS = {">": Role.REQUEST, "<": Role.REPLY, "?": Role.UNKNOWN}
#: Dumps and bytes one by one: how the bytes are cut says nothing.
UNCUT = ("byte-a-line", "hexdump", "xxd")


def wanted(line: str) -> tuple[int | None, Role, str]:
    stamp, sender, data = line.split(" ", 2)
    whole, _, fraction = stamp.partition(".")
    return None if stamp == "-" else int(whole) * 10**9 + int(fraction.ljust(9, "0")), SENDERS[sender], data


def shown(record: Chunk | CanFrame) -> tuple[int | None, Role, str]:
    if isinstance(record, Chunk):
        return record.t_ns, record.direction, record.data.hex(" ").upper()
    number = f"{record.id:08X}" if record.extended else f"{record.id:03X}"
    return record.t_ns, record.direction, f"{number}#{record.data.hex().upper()}"


def read(tmp_path: Path, text: str) -> tuple[Source, list[Record]]:
    path = tmp_path / "paste.txt"
    path.write_text(text)
    return read_all(path)


def data_of(records: list[Record]) -> list[str]:
    return [data for _, _, data in traffic(records)]


def traffic(records: list[Record]) -> list[tuple[int | None, Role, str]]:
    return [shown(record) for record in records if isinstance(record, Chunk | CanFrame)]


@pytest.mark.parametrize("paste", PASTES, ids=lambda paste: paste.name)
@pytest.mark.parametrize("end", ["\n", "\r\n"], ids=["lf", "crlf"])
def test_its_frames_are_read(paste: Paste, end: str, tmp_path: Path) -> None:
    path = tmp_path / "paste.txt"
    path.write_bytes(paste.text.replace("\n", end).encode())
    source, records = read_all(path)
    for record in records:
        check_record(record)
    found = traffic(records)
    if paste.name in UNCUT:
        found = [(None, Role.UNKNOWN, " ".join(data for _, _, data in found))]
    if paste.name == "pulseview":
        found = [(None, role, data) for _, role, data in found]
    assert found == [wanted(line) for line in paste.frames]
    assert source.problems == []
    assert not paste.says or any(paste.says in note for note in source.notes)


#: Frames that are none of a drive here: cut short, half shown, or of another node.
OTHERS = {
    "arduino-words": 1, "decimal": 1, "decimal-list": 1, "python-can": 1, "mcp-can": 1, "slcan": 1, "savvycan": 1,
    "busmaster": 1,
}  # fmt: skip
#: Kinds whose examples come byte by byte, or glued.
FRAMES = {"byte-a-line": 2, "hexdump": 2, "xxd": 2, "saleae": 1, "pulseview": 1}


@pytest.mark.parametrize("paste", PASTES, ids=lambda paste: paste.name)
def test_its_frames_are_decoded(paste: Paste, tmp_path: Path) -> None:
    path = tmp_path / "paste.txt"
    path.write_text(paste.text)
    sink = Collect()
    reading = reading_of(path)
    with reading.source:
        Pipeline(reading.dialects, (sink,), reading.options).run(reading)
    known = [e for e in sink.entries if e.message.command is not None and e.message.frame.checksum_ok]
    assert len(known) == FRAMES.get(paste.name, len(paste.frames) - OTHERS.get(paste.name, 0))
    bad = {f.rule for f in sink.findings} - {"unanswered", "unsolicited_reply", "silent_address"}
    assert bad <= ({"junk_noise"} if paste.name in OTHERS else set())


def test_the_list_stands_in_the_readme() -> None:
    assert listing().rstrip("\n") in (CAPTURES / "README.md").read_text()
    assert len({paste.name for paste in PASTES}) == len(PASTES) >= 30


# --- hexadecimal or decimal ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "radix"),
    [
        ("01 04 00 32", Radix.HEX),
        ("1 4 0 3C", Radix.HEX),
        ("1 4 0 30", Radix.EITHER),
        ("1 4 0 250", Radix.DECIMAL),
        ("-6 1", Radix.DECIMAL),
        ("[250, 1]", Radix.DECIMAL),
        ("001 004", Radix.DECIMAL),
    ],
)
def test_decimal_only_where_it_is_certain(text: str, radix: Radix) -> None:
    found = read_written(text)
    assert found is not None
    assert found.radix is radix


@pytest.mark.parametrize("text", ["256 1 2", "-129 1", "1.5 2", "250", "FA 250", "250 FA"])
def test_what_is_no_decimal_bytes(text: str) -> None:
    assert read_written(text) is None


def test_what_can_be_either_is_read_as_hexadecimal_and_said(tmp_path: Path) -> None:
    source, records = read(tmp_path, "TX: 1 4 0 30 0 1\nRX: 1 4 2 1 40\n")
    assert data_of(records) == ["01 04 00 30 00 01", "01 04 02 01 40"]
    assert any("hexadecimal or decimal" in note for note in source.notes)


def test_both_kinds_of_numbers_in_one_text_are_said(tmp_path: Path) -> None:
    source, records = read(tmp_path, "TX: FA 01 30 2B\nRX: 250 1 48\nRX: 1 4 0 10\n")
    assert data_of(records) == ["FA 01 30 2B", "FA 01 30", "01 04 00 0A"]
    assert any("some lines are decimal" in note for note in source.notes)


@pytest.mark.parametrize("rows", ["0.1,123,45\n0.2,124,44\n", "".join(f"{n} 200 {n * 3 % 256} 7\n" for n in range(20))])
def test_rows_of_a_table_are_no_traffic(rows: str, tmp_path: Path) -> None:
    with pytest.raises(UnreadableError, match="not a recognised capture format"):
        read(tmp_path, rows)


# --- numbers before the bytes -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "data", "number"),
    [
        ("receive:   1: FF", "ff", 1),
        ("receive:   5: FB 01 F6 01 F3", "fb01f601f3", 5),
        ("send 4: FA 01 30 2B", "fa01302b", 4),
        ("1: FA 01 30 2B", "fa01302b", 1),
        ("12:34:56.5 RX 2: FB 01", "fb01", 2),
        ("RX: 01:02:03:04", "01020304", None),
    ],
)
def test_a_number_and_a_colon_are_no_byte(line: str, data: str, number: int | None) -> None:
    found = take_apart(line)
    assert (found.data.hex(), found.number) == (data, number)


def test_a_number_that_does_not_count_the_bytes_is_said(tmp_path: Path) -> None:
    source, records = read(tmp_path, "receive: 5: FB 01\n")
    assert data_of(records) == ["FB 01"]
    assert any("line 1: the '5:' before 2 bytes" in note for note in source.notes)
    assert read(tmp_path, "receive: 2: FB 01\n")[0].notes == []


# --- who sent -----------------------------------------------------------------------------------------------------------


def test_an_arrow_tells_who_sent_where_it_is_not_on_every_line(tmp_path: Path) -> None:
    records = read(tmp_path, "12:00:00 -> FA 01 30 2B\n12:00:01 <- FB 01 F6 01 F3\n")[1]
    assert [role for _, role, _ in traffic(records)] == [Role.REQUEST, Role.REPLY]


def test_a_host_that_only_sends_is_no_quotation(tmp_path: Path) -> None:
    records = read(tmp_path, "> FA 01 30 2B\n> FA 01 30 2B\n")[1]
    assert [role for _, role, _ in traffic(records)] == [Role.REQUEST, Role.REQUEST]


def test_brackets_of_one_kind_tell_nothing(tmp_path: Path) -> None:
    records = read(tmp_path, "<FA><01><30><2B>\n<FB><01><F6><01><F3>\n")[1]
    assert [role for _, role, _ in traffic(records)] == [Role.UNKNOWN, Role.UNKNOWN]


def test_brackets_behind_which_libmodbus_waits_are_requests(tmp_path: Path) -> None:
    asked = "[01][06][00][F3][00][01][B8][39]\nWaiting for a confirmation...\nERROR Connection timed out: select\n"
    records = read(tmp_path, asked * 2)[1]
    assert [role for _, role, _ in traffic(records)] == [Role.REQUEST, Role.REQUEST]


def test_the_name_of_a_logger_is_not_who_speaks() -> None:
    assert take_apart("[servo]: TX: FA 01").role is Role.REQUEST
    assert take_apart("[slave] FA 01").role is Role.REPLY
    assert take_apart("slave TX: FA 01").role is Role.REPLY


# --- one and two in a line ----------------------------------------------------------------------------------------------

ONE = [("> ", "FA 01 30 2B")]
BOTH = [*ONE, ("< ", "FB 01 F6 01 F3")]
UNKNOWN = [("? ", "FA 01 30 2B"), ("? ", "FB 01 F6 01 F3")]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("send: fa 01 30 2b   recv: fb 01 f6 01 f3", BOTH),
        ("TX -> FA 01 30 2B | RX <- FB 01 F6 01 F3", BOTH),
        ("Command: FA 01 30 2B, Response: FB 01 F6 01 F3", BOTH),
        ("TX=FA01302B RX=FB01F601F3", BOTH),
        ("FA 01 30 2B -> FB 01 F6 01 F3", BOTH),
        ("{'tx': 'FA 01 30 2B', 'rx': 'FB 01 F6 01 F3'}", BOTH),
        ("Sent 4 bytes: FA 01 30 2B\nReceived 5 bytes: FB 01 F6 01 F3", BOTH),
        ("Sent to motor 1: FA 01 30 2B\nReceived from motor 1: FB 01 F6 01 F3", BOTH),
        ("Sending: [250, 1, 48, 43]\nGot: [251, 1, 246, 1, 243]", BOTH),
        ("--> [FA 01 30 2B]\n<-- [FB 01 F6 01 F3]", BOTH),
        ("00:00:01 Out FA 01 30 2B\n00:00:01 In  FB 01 F6 01 F3", BOTH),
        ("W: FA 01 30 2B\nR: FB 01 F6 01 F3", BOTH),
        ("INFO motor::bus: tx [fa, 01, 30, 2b]\nINFO motor::bus: rx [fb, 01, f6, 01, f3]", BOTH),
        ("TX\nFA 01 30 2B\nRX\nFB 01 F6 01 F3", BOTH),
        ("$ echo -ne '\\xFA\\x01\\x30\\x2B' > /dev/ttyUSB0", ONE),
        ("Request: FA 01 30 2B\nReply: timeout", ONE),
        ("Frame: FA 01 30 2B\nFrame: FB 01 F6 01 F3", UNKNOWN),
        ("frame=FA01302B\nframe=FB01F601F3", UNKNOWN),
        ("1. FA 01 30 2B\n2. FB 01 F6 01 F3", UNKNOWN),
        ("- FA 01 30 2B\n- FB 01 F6 01 F3", UNKNOWN),
        ("CAN TX id=0x001 len=2 data=F6 F7", [("> ", "001#F6F7")]),
        ("can tx: 001 [2] F6 F7\ncan rx: 001 [1] F6", [("> ", "001#F6F7"), ("? ", "001#F6")]),
        ("cansend can0 001#F6F7\n  can0  001   [1]  F6", [("> ", "001#F6F7"), ("? ", "001#F6")]),
        ("0001h  2  F6 F7", [("? ", "001#F6F7")]),
    ],
)
def test_what_programs_of_ones_own_print(text: str, found: list[tuple[str, str]], tmp_path: Path) -> None:
    source, records = read(tmp_path, text + "\n")
    assert [(role, data) for _, role, data in traffic(records)] == [(SENDERS[mark.strip()], data) for mark, data in found]
    assert source.problems == []


def test_bytes_with_an_index_come_one_by_one(tmp_path: Path) -> None:
    source, records = read(tmp_path, "buffer[4]raw\n0: 0xfa\n1: 0x1\n2: 0x30\n3: 0x2b\n")
    assert data_of(records) == ["FA", "01", "30", "2B"]
    assert source.notes == []


def test_a_byte_a_line_behind_its_mark_may_have_one_digit(tmp_path: Path) -> None:
    source, records = read(tmp_path, "TX\nfa\n1\n30\n2b\nRX\nfb\n1\n32\n0\n64\n92\n")
    assert data_of(records) == ["FA 01 30 2B", "FB 01 32 00 64 92"]
    source, records = read(tmp_path, "".join(f"12:00:00.1 -> {digits}\n" for digits in ("FA", "1", "30", "2B")))
    assert data_of(records) == ["FA", "01", "30", "2B"]
    assert not any(isinstance(r, Chunk) and r.burst for r in records)
    assert source.problems == []


# --- sentences ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("I send FA 01 30 2B and get FB 01 F6", [(8, "fa01302b", Role.REQUEST), (28, "fb01f6", Role.REPLY)]),
        ("the motor returns 0xFB 0x01 0xF6 0x00 0xF2.", [(19, "fb01f600f2", Role.REPLY)]),
        ('e.g. "e0 f6 10 e6" does not work', [(7, "e0f610e6", Role.UNKNOWN)]),
        ("reply is `fb01f601f3`", [(11, "fb01f601f3", Role.REPLY)]),
        ("FB01F601F3 came", [(1, "fb01f601f3", Role.UNKNOWN)]),
        (
            "I sent 01 04 00 32 00 01 90 05. Then FB 01 F6 01 F3",
            [(8, "0104003200019005", Role.REQUEST), (38, "fb01f601f3", Role.UNKNOWN)],
        ),
    ],
)
def test_frames_in_sentences(line: str, found: list[tuple[int, str, Role]]) -> None:
    assert [(each.column, each.data.hex(), each.role) for each in quotations(line)] == found


@pytest.mark.parametrize(
    "line",
    [
        "at 12:00:00 on 20 11 23 it went",
        "the card has DC:DA:0C:C5:6E:98",
        "commit 3fa9c1d2e4 is bad, so is deadbeef",
        "call +49 30 12 34 56",
        "use 0xFA or 0xFB",
        "version 1.0.5 of 2024-03-05",
        "we add a be to it",
        "10.20.30.40.50",
    ],
)
def test_what_is_no_frame_in_a_sentence(line: str) -> None:
    assert quotations(line) == []


def test_sentences_beside_a_log_are_not_read_but_told(tmp_path: Path) -> None:
    text = "TX: FA 01 30 2B\nRX: FB 01 F6 01 F3\nI see that FA 01 F6 00 00 02 F9 does not stop it\nFrame was FA 01 30 2B here\n"
    source, records = read(tmp_path, text)
    assert data_of(records) == ["FA 01 30 2B", "FB 01 F6 01 F3"]
    # What was sent is known; only the new frame counts.
    assert any("1 line of words with bytes" in note for note in source.notes)


def test_each_frame_of_a_sentence_comes_with_its_place(tmp_path: Path) -> None:
    records = read(tmp_path, "Hello,\nI send FA 01 30 2B all day\n")[1]
    assert [r.text for r in records if isinstance(r, Comment)] == ["Hello,", "line 2, column 8: I send FA 01 30 2B all day"]


# --- CAN and columns ----------------------------------------------------------------------------------------------------


def test_the_minute_of_an_slcan_adapter(tmp_path: Path) -> None:
    records = read(tmp_path, "t0012F6F7EA5F\nt0012F6F7000A\n")[1]
    assert [t_ns for t_ns, _, _ in traffic(records)] == [59_999_000_000, 60_010_000_000]


def test_lines_of_an_slcan_adapter_with_arrows_and_a_written_end(tmp_path: Path) -> None:
    lines = ["-> t00123A3B", "<- z", "<- t00133A013C", "-> t0013F301F5", "<- t0013F301F5"]
    source, records = read(tmp_path, "".join(line + "\\r\n" for line in lines))
    assert data_of(records) == ["001#3A3B", "001#3A013C", "001#F301F5", "001#F301F5"]
    assert not source.problems
    assert not any(isinstance(each, Comment) for each in records)


def test_a_broken_can_line_is_a_problem_with_its_line(tmp_path: Path) -> None:
    source, records = read(tmp_path, "ID: 0x01 Data: F6 01 F8\nready\nID: 0x01 Data: F6 0G F8\n")
    assert data_of(records) == ["001#F601F8"]
    assert [r.text for r in records if isinstance(r, Comment)] == ["ready"]
    assert [str(p) for p in source.problems] == ["line 3: expected a CAN frame, got 'ID: 0x01 Data: F6 0G F8'"]


def test_bytes_of_a_can_line_may_all_be_short(tmp_path: Path) -> None:
    records = read(tmp_path, "ID: 0x01 DLC: 3 Data: 1 2 A\nID: 0x01 DLC: 1 Data: 5\n")[1]
    assert data_of(records) == ["001#01020A", "001#05"]


def test_a_length_that_is_not_that_of_the_bytes_is_a_problem(tmp_path: Path) -> None:
    source, records = read(tmp_path, "ID: 0x01 DLC: 3 Data: F6 01 F8\nID: 0x01 DLC: 4 Data: F6 01 F8\n")
    assert data_of(records) == ["001#F601F8"]
    assert source.problems[0].line == 2


@pytest.mark.parametrize(
    ("line", "said"), [("ID: 17", True), ("ID: 0x17", False), ("ID: 1A", False), ("ID: 7", False), ("ID: 017", False)]
)
def test_an_identifier_that_may_be_decimal_is_said(line: str, said: bool, tmp_path: Path) -> None:
    source, records = read(tmp_path, f"{line} Data: F6 01 F8\n")
    assert len(records) == 1
    assert any("identifiers without 0x" in note for note in source.notes) is said


def test_decimal_data_of_can_are_read_as_such_and_said(tmp_path: Path) -> None:
    source, records = read(tmp_path, "ID: 17 Data: 246 1 248\nID: 17 Data: 49 10\nID: 17 Data: 246 1 300\n")
    assert data_of(records) == ["011#F601F8", "011#310A"]
    assert any("decimal numbers" in note for note in source.notes)
    assert [problem.line for problem in source.problems] == [3]


def test_rows_of_numbers_are_no_can_frames(tmp_path: Path) -> None:
    source, records = read(tmp_path, "100 10 48 43\n101 20 48 44\n")
    assert (source.kind, data_of(records)) == ("serial", ["64 0A 30 2B", "65 14 30 2C"])
    assert any("decimal" in note for note in source.notes)


def test_json_of_can_and_of_a_line(tmp_path: Path) -> None:
    source, records = read(tmp_path, '{"id": 1, "data": [246, 1, 248], "ts": 1.5}\n{"id": 1, "data": [], "dlc": 0}\n')
    assert (source.kind, data_of(records)) == ("can", ["001#F601F8", "001#"])
    # Rows that are counted are no identifiers.
    text = "".join(f'{{"id": {n}, "data": "FA 01 30 2B"}}\n' for n in range(7, 11))
    source, records = read(tmp_path, text)
    assert (source.kind, data_of(records)) == ("serial", ["FA 01 30 2B"] * 4)


def test_a_request_and_its_reply_in_one_row(tmp_path: Path) -> None:
    records = read(tmp_path, "time,request,reply\n0.5,FA 01 30 2B,FB 01 F6 01 F3\n0.7,FA 01 30 2B,\n")[1]
    assert [(role, data) for _, role, data in traffic(records)] == [
        (Role.REQUEST, "FA 01 30 2B"), (Role.REPLY, "FB 01 F6 01 F3"), (Role.REQUEST, "FA 01 30 2B"),
    ]  # fmt: skip


def test_what_a_table_leaves_open_is_said(tmp_path: Path) -> None:
    source, records = read(tmp_path, "time,can_id,data,speed\n5,10,F6 01,1\n9,11,F6 02,2\nx,10,F6 03,3\n5,10,zz,1\n")
    assert [record[::2] for record in traffic(records)] == [
        (5_000_000, "010#F601"), (9_000_000, "011#F602"), (9_000_000, "010#F603"),
    ]  # fmt: skip
    notes = "\n".join(source.notes)
    for said in (
        "not read: speed",
        "read as hexadecimal",
        "read as milliseconds",
        "expected a time, got 'x'",
        "expected bytes",
    ):
        assert said in notes


@pytest.mark.parametrize(
    ("number", "t_ns"),
    [
        ("1709640000", 1_709_640_000 * 10**9),
        ("1709640000120", 1_709_640_000_120 * 10**6),
        ("1709640000120000", 1_709_640_000_120 * 10**6),
    ],
)
def test_a_time_since_1970_has_its_unit_by_its_size(number: str, t_ns: int, tmp_path: Path) -> None:
    records = read(tmp_path, f'{{"t": {number}, "data": "FA 01 30 2B"}}\n')[1]
    assert traffic(records)[0][0] == t_ns


def test_a_whole_time_among_decimal_ones_is_in_seconds(tmp_path: Path) -> None:
    """JSON of some languages writes 2 for 2.0."""
    records = read(tmp_path, "".join(f'{{"t": {t}, "data": "FA 01 30 2B"}}\n' for t in ("1.75", "2", "2.5")))[1]
    assert [t_ns for t_ns, _, _ in traffic(records)] == [1_750_000_000, 2_000_000_000, 2_500_000_000]


@pytest.mark.parametrize("stamp", ["3/25/2024 12:00:00", "25/3/2024 12:00:00", "3/25/2024 12:00:00 PM"])
def test_a_day_above_twelve_shows_the_order_of_a_date(stamp: str, tmp_path: Path) -> None:
    source, records = read(tmp_path, f"{stamp} TX: FA 01 30 2B\n")
    assert traffic(records)[0][0] == 1_711_368_000 * 10**9
    assert source.notes == []
