"""Hex dumps and raw bytes."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from analyzer.records import Chunk, Comment
from tests.contracts.source_contract import read_all

DATA = bytes.fromhex("FA01F601400234FB01F601F3") * 9


def xxd(data: bytes) -> str:
    rows = ""
    for at in range(0, len(data), 16):
        row = data[at : at + 16]
        groups = " ".join(row[n : n + 2].hex() for n in range(0, len(row), 2))
        rows += f"{at:08x}: {groups:<39}  {''.join(chr(b) if 32 <= b < 127 else '.' for b in row)}\n"
    return rows


def canonical(data: bytes) -> str:
    rows = ""
    for at in range(0, len(data), 16):
        row = data[at : at + 16]
        digits = f"{row[:8].hex(' ')}  {row[8:].hex(' ')}"
        rows += f"{at:08x}  {digits:<48}  |{''.join(chr(b) if 32 <= b < 127 else '.' for b in row)}|\n"
    return rows + f"{len(data):08x}\n"


def od(data: bytes) -> str:
    return "".join(f"{at:06x} {data[at : at + 16].hex(' ')}\n" for at in range(0, len(data), 16)) + f"{len(data):06x}\n"


@pytest.mark.parametrize("dump", [xxd, canonical, od])
@pytest.mark.parametrize("size", [5, 8, 16, 17, 108])
def test_dumps(dump: object, size: int, tmp_path: Path) -> None:
    assert callable(dump)
    path = tmp_path / "dump.txt"
    path.write_text(dump(DATA[:size]))
    source, records = read_all(path, format=None if size > 16 else "hexdump")
    assert source.format == "hexdump"
    assert b"".join(r.data for r in records if isinstance(r, Chunk)) == DATA[:size]
    assert source.problems == []


def plain(data: bytes) -> str:
    return "".join(f"{data[at : at + 30].hex()}\n" for at in range(0, len(data), 30))


@pytest.mark.parametrize("dump", [xxd, canonical, od, plain])
@pytest.mark.parametrize(
    ("above", "behind"),
    [("$ xxd sniff.bin\n", ""), ("pi@host:~ $ hexdump a\n", "pi@host:~ $ \n"), ("Since then this comes:\n\n", "Why?\n")],
)
def test_words_around_a_dump_are_comments(dump: object, above: str, behind: str, tmp_path: Path) -> None:
    assert callable(dump)
    path = tmp_path / "dump.txt"
    path.write_text(above + dump(DATA) + behind)
    source, records = read_all(path)
    assert source.format == "hexdump"
    assert b"".join(r.data for r in records if isinstance(r, Chunk)) == DATA
    said = [r.text for r in records if isinstance(r, Comment)]
    assert said == [line.strip() for line in (above + behind).splitlines() if line]
    assert source.problems == []


@pytest.mark.parametrize("rows", [[DATA[:30]] * 4, [DATA[:30], DATA[:8]], [DATA[:29], DATA[30:59], DATA[:8]]])
def test_frames_of_a_line_each_are_no_dump(rows: list[bytes], tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    path.write_text("".join(f"{row.hex()}\n" for row in rows))
    source, records = read_all(path)
    assert source.format == "hex"
    assert [r.data for r in records if isinstance(r, Chunk)] == rows


def test_whole_rows_without_the_offset_behind_the_last_are_no_can_frames(tmp_path: Path) -> None:
    path = tmp_path / "dump.txt"
    data = (DATA * 2)[:96]
    path.write_text("".join(canonical(data).splitlines(keepends=True)[:-1]))
    source, records = read_all(path)
    assert (source.format, b"".join(r.data for r in records if isinstance(r, Chunk))) == ("hexdump", data)


def test_rows_that_a_star_stands_for(tmp_path: Path) -> None:
    path = tmp_path / "dump.txt"
    row = "fa 01 f6 01 40 02 34 fb  01 f6 01 f3 00 00 00 00"
    path.write_text(f"00000000  {row}  |................|\n*\n00000040  01                    |.|\n00000041\n")
    records = read_all(path)[1]
    assert b"".join(r.data for r in records if isinstance(r, Chunk)) == bytes.fromhex(row.replace(" ", "")) * 4 + b"\x01"


def test_missing_rows_are_a_problem(tmp_path: Path) -> None:
    path = tmp_path / "dump.txt"
    rows = canonical(DATA).splitlines(keepends=True)
    path.write_text("".join(rows[:2] + rows[3:]))
    source, records = read_all(path)
    assert sum(len(r.data) for r in records if isinstance(r, Chunk)) == len(DATA) - 16
    assert str(source.problems[0]) == "line 3: 16 bytes missing before offset 30"


def test_random_bytes_are_raw(tmp_path: Path) -> None:
    path = tmp_path / "noise"
    data = random.Random(7).randbytes(1_000_000)
    path.write_bytes(data)
    source, records = read_all(path)
    assert source.format == "raw"
    assert source.time_source == "none"
    assert b"".join(r.data for r in records if isinstance(r, Chunk)) == data
    assert max(len(r.data) for r in records if isinstance(r, Chunk)) <= 1 << 16


@pytest.mark.parametrize("text", ["FA01F1EC", "3E800100BF", "FB01F601F3", "3E94010093010203", "010300000001840A"])
def test_a_single_frame_is_raw(text: str, tmp_path: Path) -> None:
    path = tmp_path / "frame.bin"
    path.write_bytes(bytes.fromhex(text))
    source, records = read_all(path)
    assert source.format == "raw"
    assert records == [Chunk(None, "serial", bytes.fromhex(text))]


def test_a_text_can_be_read_as_raw_bytes(tmp_path: Path) -> None:
    path = tmp_path / "text"
    path.write_bytes(b"hello")
    assert read_all(path, format="raw", bus="left")[1] == [Chunk(None, "left", b"hello")]


def test_a_star_that_stands_for_more_than_the_file_pays_for_is_a_gap(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_text("00000000  fa\n*\n00001000  fb\n*\n40000000  fc\n")
    source, records = read_all(path)
    assert [len(r.data) for r in records if isinstance(r, Chunk)] == [1, 0xFFF, 1, 1]
    assert "bytes missing before offset 40000000" in source.problems[0].text
