"""Exports of Saleae and sigrok."""

from __future__ import annotations

from pathlib import Path

import pytest

from analyzer.catalogue import Role
from analyzer.records import Chunk
from analyzer.sources import Record, Source
from tests.contracts.source_contract import read_all

U, REQUEST, REPLY = Role.UNKNOWN, Role.REQUEST, Role.REPLY


def read(tmp_path: Path, text: str, **options: object) -> tuple[Source, list[Record]]:
    path = tmp_path / "export.csv"
    path.write_text(text)
    return read_all(path, **options)


LOGIC_1 = "Time [s],Value,Parity Error,Framing Error\n"
LOGIC_2 = "name,type,start_time,duration,data,error\n"


@pytest.mark.parametrize(
    ("rows", "data"),
    [
        (("0xFA", "0x01", "0x2C"), "FA012C"),
        (("250", "1", "44"), "FA012C"),
        (("0b1111 1010", "0b00000001", "0b00101100"), "FA012C"),
        (("'250'", "A", "COMMA"), "FA412C"),
        (("\\r", "5", "' '"), "0D3520"),
        (("\\xFA", "7", "x"), "FA3778"),
    ],
)
def test_values_of_logic_1(rows: tuple[str, ...], data: str, tmp_path: Path) -> None:
    text = LOGIC_1 + "".join(f"{n}.000000001000000,{value},,\n" for n, value in enumerate(rows))
    source, records = read(tmp_path, text)
    assert source.format == "saleae"
    assert source.problems == []
    assert b"".join(r.data for r in records if isinstance(r, Chunk)).hex().upper() == data
    assert [r.t_ns for r in records] == [1, 1_000_000_001, 2_000_000_001]
    assert all(isinstance(r, Chunk) and not r.burst and r.direction is U for r in records)


def test_the_line_speed_gives_the_end_of_a_byte(tmp_path: Path) -> None:
    source, records = read(tmp_path, LOGIC_1 + "0.001,0xFA,,\n", baud=100_000)
    assert records[0].t_ns == 1_000_000 + 100_000
    assert "the end of each byte" in source.time_source


def test_errors_are_counted_and_bytes_kept(tmp_path: Path) -> None:
    source, records = read(tmp_path, LOGIC_1 + "0.1,0xFA,Error,\n0.2,0xFB,,Error\n0.3,0x01,,\n")
    assert len(records) == 3
    assert source.notes == ["2 bytes with a parity or framing error"]


@pytest.mark.parametrize(("wrong", "uart"), [("FA 39 30 2D", "8E1"), ("01 31 34 07", "8O1")])
def test_bytes_of_one_parity_that_are_misframed_tell_how_they_stand_on_the_line(wrong, uart, tmp_path: Path) -> None:
    sent = bytes.fromhex("FA 39 30 2D 01 31 34 07 FA 39")
    rows = [(byte, "Error" if byte in bytes.fromhex(wrong) else "") for byte in sent]
    text = LOGIC_1 + "".join(f"{n}.0,0x{byte:02X},,{error}\n" for n, (byte, error) in enumerate(rows))
    assert read(tmp_path, text)[0].uarts == {uart}
    # One byte that came both ways is noise, and a parity that the analyzer awaits is its own setting.
    assert read(tmp_path, text + "20.0,0xFA,,\n21.0,0xFA,,Error\n")[0].uarts == set()
    assert read(tmp_path, text.replace(",,Error", ",Error,"))[0].uarts == {f"8N1 read as {uart}"}
    assert read(tmp_path, text.replace(",,Error", ",Error,") + "20.0,0xFA,,\n21.0,0xFA,Error,\n")[0].uarts == set()


def test_times_before_the_trigger_are_moved(tmp_path: Path) -> None:
    source, records = read(tmp_path, LOGIC_1 + "-0.5,0xFA,,\n0.25,0xFB,,\n")
    assert [r.t_ns for r in records] == [0, 750_000_000]
    assert "moved by 0.5 s" in source.notes[0]


def test_logic_2_with_two_analyzers(tmp_path: Path) -> None:
    text = LOGIC_2 + (
        '"RX","data",0.0001,1e-05,0x11,\n"TX","data",0.0006025,2.375e-05,0xFA,\n"TX","start",0.0007,1e-05,0x00,\n'
        '"RX","data",0.001,2.5e-05,0xFB,"framing"\n'
        '"Axis, left","data",0.002,0,0x01,\n"Async Serial","data",0.003,0,0x02,\n'
    )
    source, records = read(tmp_path, text)
    assert records == [
        Chunk(110_000, "serial", b"\x11", U),
        Chunk(626_250, "serial", b"\xfa", REQUEST),
        Chunk(1_025_000, "serial", b"\xfb", REPLY),
        Chunk(2_000_000, "Axis_left", b"\x01", U),
        Chunk(3_000_000, "serial", b"\x02", U),
    ]
    assert source.notes == ["1 byte with a parity or framing error"]


def test_logic_2_with_dates(tmp_path: Path) -> None:
    text = "name,type,start_time,duration,data\n" + '"Async Serial","data",2023-04-30T22:40:55.899123456Z,0,0xFA\n'
    assert read(tmp_path, text)[1][0].t_ns == 1_682_894_455_899_123_456


def test_all_analyzers_of_logic_1(tmp_path: Path) -> None:
    text = "Time [s],Analyzer Name,Decoded Protocol Result\n0.1,Async Serial,0xFA\n0.2,Async Serial,'1' (0x31)\n"
    assert [r.data for r in read(tmp_path, text)[1] if isinstance(r, Chunk)] == [b"\xfa", b"1"]


def test_bad_rows(tmp_path: Path) -> None:
    source, records = read(tmp_path, LOGIC_1 + "0.1,0xFA,,\n0.2,0x1FF,,\nx,0x01,,\n0.4\n0.5,0xFB,,\n")
    assert [r.data for r in records if isinstance(r, Chunk)] == [b"\xfa", b"\xfb"]
    assert [p.line for p in source.problems] == [3, 4, 5]


@pytest.mark.parametrize(
    "line",
    [
        "uart-1: FA", "uart-1: RX: FA", "uart-1: rx-data: FA", "12-34 uart-1: FA", "12-34 uart-1: rx-data: FA",
        "2313-2329 UART: RX data: FA", "2313-2329 UART: RX: FA", '"2313-2329" "UART": "RX data": "FA"',
        'uart-1: "FA"', 'uart-1: "0xFA"', "uart-1: [FA]", "uart-1: 11111010", "uart: @FA",
    ],
)  # fmt: skip
def test_annotations_of_sigrok(line: str, tmp_path: Path) -> None:
    source, records = read(tmp_path, line + "\n")
    assert source.format == "sigrok"
    assert records == [Chunk(None, "serial", b"\xfa")]


def test_a_burst_of_a_line_is_one_chunk(tmp_path: Path) -> None:
    assert read(tmp_path, "uart-1: FA 01 30 2B\n")[1] == [Chunk(None, "serial", bytes.fromhex("FA01302B"), U, True)]


def test_other_annotations_are_passed_over(tmp_path: Path) -> None:
    lines = [
        "uart-1: Start bit", "uart-1: 0", "uart-1: 1", "uart-1: rx-data-bits: 1", "uart-1: FA", "uart-1: Parity OK bit",
        "uart-1: Stop bit", "uart-1: rx-start: Start bit", "uart-1: RX bits: 0", "uart-1: Frame error",
        "uart-1: rx-data: 01",
    ]  # fmt: skip
    source, records = read(tmp_path, "\n".join(lines) + "\n")
    assert [r.data for r in records if isinstance(r, Chunk)] == [b"\xfa", b"\x01"]
    assert source.problems == []


def test_who_sent_is_known_once_something_was_sent(tmp_path: Path) -> None:
    text = "uart-1: rx-data: 01\nuart-1: tx-data: FA\nuart-1: rx-data: FB\n"
    assert [r.direction for r in read(tmp_path, text)[1] if isinstance(r, Chunk)] == [U, REQUEST, REPLY]


def test_sample_numbers_need_the_line_speed(tmp_path: Path) -> None:
    # At 1 MHz and 100 kBd a bit is 10 samples, the 8 bits of a byte 80.
    text = "100-180 uart-1: rx-data: FA\n200-280 uart-1: rx-data: 01\n"
    source, records = read(tmp_path, text, baud=100_000)
    assert [r.t_ns for r in records] == [180_000, 280_000]
    source, records = read(tmp_path, text)
    assert [r.t_ns for r in records] == [None, None]
    assert source.time_source == "none"
    assert any("--baud" in note for note in source.notes)


def test_a_second_decoder_is_a_port(tmp_path: Path) -> None:
    text = "uart-1: FA\nuart-2: FB\n"
    assert [r.port for r in read(tmp_path, text)[1]] == ["serial", "uart-2"]
