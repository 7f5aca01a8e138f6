"""What stands in a capture is given on or named: no byte is left out without a word."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from analyzer.records import CanFrame, Chunk
from analyzer.sources import open_source
from tests.contracts.source_contract import read_all
from tests.sources.builders import SAMPLES, block, pcap_file, section, socketcan
from tests.sources.test_hexdump_and_raw import canonical

T = 1_682_894_455_899_123_456
CSV = "time,id,dlc,data,rtr\n0.001,0x001,3,F6 01 F8,0\n"
CELLS = "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4\n1000,00000001,false,Rx,0,3,F6,01,F8\n"
LOG = "(1.0) can0 001#F601F8\n"
PYTHON_CAN = "timestamp,arbitration_id,extended,remote,error,dlc,data\n1.0,0x1,0,0,0,3,9gH4\n"
PRINTED = "Timestamp: 1.0    ID: 0001    S Rx    DL:  3    f6 01 f8    Channel: can0\n"
WHOLE, REMOTE = "the frame has them all", "a remote frame carries no data, got F6 01 F8"


@pytest.mark.parametrize(
    ("text", "data", "said"),
    [
        (CSV + "0.002,0x001,0,F6 01 F8,0", "F6 01 F8", f"line 3: expected 0 bytes, got 3; {WHOLE}"),
        (CSV + "0.002,0x001,2,F6 01 F8,0", "F6 01 F8", f"line 3: expected 2 bytes, got 3; {WHOLE}"),
        (CSV + "0.002,0x001,8,F6 01 F8,0", "F6 01 F8", f"line 3: expected 8 bytes, got 3; {WHOLE}"),
        (CSV + "0.002,0x001,2,F6 01 00 00,0", "F6 01", ""),
        (CSV + "0.002,0x001,9,F6 01 F8 00 00 00 00 00,0", "F6 01 F8 00 00 00 00 00", ""),
        (CSV + "0.002,0x001,0,,0", "", ""),
        (CSV + "0.002,0x001,3,F6 01 F8,1", "", f"line 3: {REMOTE}"),
        (CSV + "0.002,0x001,3,00 00 00,1", "", ""),
        (CELLS + "2000,00000001,false,Rx,0,0,F6,01,F8", "F6 01 F8", f"line 3: expected 0 bytes, got 3; {WHOLE}"),
        (CELLS + "2000,00000001,false,Rx,0,2,F6,01,F8,00", "F6 01 F8 00", f"line 3: expected 2 bytes, got 4; {WHOLE}"),
        (CELLS + "2000,00000001,false,Rx,0,2,F6,01,00,00", "F6 01", ""),
        (LOG + "(1.1) can0 001#F601F8#11", None, "line 2: expected '(seconds) interface ID#data'"),
        (LOG + "(1.1) can0 40000001#F601F8", None, "line 2: expected '(seconds) interface ID#data'"),
        (PYTHON_CAN + "1.1,0x1,0,1,0,3,9gH4", "", "line 3: a remote frame carries no data, got 9gH4"),
        (PRINTED * 3 + PRINTED.replace("S Rx", "S Rx R"), "", f"line 4: {REMOTE}"),
    ],
)  # fmt: skip
def test_lines(text: str, data: str | None, said: str, tmp_path: Path) -> None:
    path = tmp_path / "capture.txt"
    path.write_text(text.rstrip("\n") + "\n")
    source, records = read_all(path)
    last = [r for r in records if isinstance(r, CanFrame)][-1]
    assert last.data == bytes.fromhex("F6 01 F8" if data is None else data)
    assert "; ".join(map(str, source.problems)).startswith(said)
    assert len(source.problems) == bool(said)


TRC = """\
;$FILEVERSION=2.1
;$STARTTIME=46083.375
;$COLUMNS=N,O,T,B,I,d,R,L,D
      0         0.000 DT  1     0001 Rx -  2    30 31
      1        10.000 DT  1     0001 Tx -  2    40 41
      2        11.000 ST  1          Rx -  4    00 00 00 08
"""


@pytest.mark.parametrize("line", [4, 5])
@pytest.mark.parametrize(
    ("good", "bad", "said"),
    [
        ("x -", "xg-", "expected Rx or Tx"),
        (" DT", " D ", "expected one of DT, RR"),
        (" 0001", "-0001", "expected an identifier"),
        (".000", ".0:0", "expected a time"),
        ("  1 ", "  q ", "expected the number of a bus"),
        ("-  2", "-  3", "expected 3 bytes"),
        ("-  2", "-  Z", "expected a length"),
        ("0 ", "0g", "expected bytes in hexadecimal"),
        ("- ", "  ", "expected a length"),
    ],
)  # fmt: skip
def test_a_trc_line_that_is_no_whole_frame_is_told(good: str, bad: str, said: str, line: int, tmp_path: Path) -> None:
    lines = TRC.splitlines(keepends=True)
    head, sep, rest = lines[line - 1].rpartition(good)
    lines[line - 1] = head + bad + rest
    assert sep
    path = tmp_path / "capture.trc"
    path.write_text("".join(lines))
    source, records = read_all(path)
    assert len(records) == 1
    (problem,) = source.problems
    assert problem.line == line
    assert problem.text.startswith(said)
    assert "1 line left out: not frames (bus status, errors)" in source.notes


@pytest.mark.parametrize("kind", ["pcap", "enhanced", "old", "simple"])
def test_a_record_that_was_cut_when_it_was_captured(kind: str, tmp_path: Path) -> None:
    data = bytes.fromhex("FB0130FFFFFFFF2269B3")
    if kind == "pcap":
        written = pcap_file(147, [(T, data[:6])])
        written = written[:36] + struct.pack("<L", len(data)) + written[40:]
    else:
        cut = {
            "enhanced": lambda: block(6, struct.pack("<LLLLL", 0, 0, 9, 6, 10) + data[:6] + bytes(2)),
            "old": lambda: block(2, struct.pack("<HHLLLL", 0, 0, 0, 9, 6, 10) + data[:6] + bytes(2)),
            "simple": lambda: block(3, struct.pack("<L", 10) + data[:6] + bytes(2)),
        }[kind]()
        described = block(1, struct.pack("<HHL", 147, 0, 6 if kind == "simple" else 0))
        written = section() + described + cut
    path = tmp_path / "capture.bin"
    path.write_bytes(written)
    source, records = read_all(path)
    assert [r.data for r in records if isinstance(r, Chunk)] == [data[:6]]
    (problem,) = source.problems
    assert "a record was cut when it was captured: 6 of 10 bytes" in str(problem)


def test_a_remote_frame_with_data_in_a_pcap(tmp_path: Path) -> None:
    path = tmp_path / "capture.pcap"
    path.write_bytes(pcap_file(227, [(T, socketcan(0x40000001, b"\xf6\x01\xf8")), (T, socketcan(0x40000001, bytes(3)))]))
    source, records = read_all(path)
    assert records == [CanFrame(T, "can", 1, b"", remote=True)] * 2
    assert [REMOTE in str(problem) for problem in source.problems] == [True]


def test_rows_of_a_second_dump_that_a_star_stands_for(tmp_path: Path) -> None:
    data = bytes(range(16)) + b"\xaa" * 64 + b"\x01"
    rows = canonical(data).splitlines(keepends=True)
    starred = "".join([*rows[:2], "*\n", *rows[5:]])
    path = tmp_path / "dump.txt"
    path.write_text(starred * 2)
    assert b"".join(r.data for r in read_all(path)[1] if isinstance(r, Chunk)) == data * 2


ASC = "date Sun Apr 30 10:40:55.899 pm 2023\nbase hex  timestamps absolute\ninternal events logged\n"
SIGROK = "100-300 uart-1: FA\n300-326 uart-1: 1\n400-600 uart-1: 30\n"
SALEAE = 'name,type,start_time,duration,data,error\n"Async Serial","data",1.14,0.0002,0xFA,\n'
TABLE = "| time | dir | data |\n|---|---|---|\n| 0.110 | TX | `FA 01` |\n| 0.115 | TX | `FA 01` |\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (ASC + "   0.1 1  001             Rx   d 2 F6 01\n   0.2 >1  001            Rx   d 2 F6 01\n", "line 5: expected a frame"),  # noqa: E501
        (ASC + "   0.1 1  001             Rx   d 2 F6 01\n   0.2 1  001             Rx   d 2 F6 01 40\n", "line 5: expected 2 bytes, got 3"),  # noqa: E501
        (ASC + "   0.1 1  001  Rx   d 2 F6 01  Length = 0 BitCount = 0 ID = 1\n   0.2 1  001  TxRq   d 1 F6\n", ""),
        (SIGROK, ""),
        (SIGROK + "700-900 uart-1: 0\n", "line 4: expected a byte of two hex digits"),
        (SALEAE + '"Async Serial","start",1.15,0.0002,0x01,\n', ""),
        (SALEAE + '"Async Serial","dat?",1.15,0.0002,0x01,\n', "rows of the type dat? are left out"),
        (TABLE, ""),
        (TABLE + "| 0.120 | TX | `FA 01|30 2B` |\n", "line 5: cells behind the last heading are left out: '30 2B'"),
    ],
)  # fmt: skip
def test_a_line_of_traffic_that_is_not_read_whole_is_told(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "capture.txt"
    path.write_text(text)
    source, records = read_all(path)
    assert records
    assert said in "; ".join(source.notes)
    assert len(source.problems) == (said.startswith("line"))


TEXTS = ("candump", "candump-screen", "asc", "trc", "can-text", "columns", "columns-json", "spy", "sigrok", "hexdump")


@pytest.mark.parametrize("name", TEXTS)
def test_one_damaged_line_of_a_short_text_changes_no_format_and_is_named(name: str, tmp_path: Path) -> None:
    whole = SAMPLES[name].make(tmp_path)
    lines = whole.read_text().splitlines()[: 24 if name == "trc" else 15]
    # Below the heading of a file, and above where a hex dump shows its end.
    where = len(lines) - 4
    path = tmp_path / "damaged"
    for at in range(len(lines[where]) // 2, 2, -5):
        damaged = [*lines[:where], f"{lines[where][:at]};{lines[where][at + 1 :]}", *lines[where + 1 :]]
        path.write_text("\n".join(damaged) + "\n")
        with open_source(path, baud=115200) as source:
            assert source.format == SAMPLES[name].format, damaged[where]
            data = b"".join(record.data for record in source if isinstance(record, Chunk | CanFrame))
        # What was damaged holds no byte: a note in a cell, a mark.
        assert source.problems or data == _bytes(lines, tmp_path), damaged[where]
        assert all(problem.line in (None, where + 1, where + 2) for problem in source.problems)


def _bytes(lines: list[str], folder: Path) -> bytes:
    path = folder / "undamaged"
    path.write_text("\n".join(lines) + "\n")
    with open_source(path, baud=115200) as source:
        return b"".join(record.data for record in source if isinstance(record, Chunk | CanFrame))
