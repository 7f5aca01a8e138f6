"""Files that are not captures, and captures with impossible content: each with its message."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from analyzer.columns.block import CanBlock
from analyzer.errors import UnreadableError, UsageError
from analyzer.records import Chunk, Comment
from analyzer.sources import FORMATS, open_source, stream
from analyzer.sources.source import FAR_NS, clean_port
from tests.contracts.source_contract import read_all
from tests.sources import builders

C_SOURCE = """\
#include <stdio.h>

/* Adds two numbers: 0xFA and 1. */
int add(int a, int b)
{
    return a + b;  // FA 01
}

int main(void)
{
    printf("%d\\n", add(0xFA, 1));
    return 0;
}
"""
EMAIL = """\
From: someone@example.org
To: you@example.org
Subject: Re: servo
Date: Sun, 30 Apr 2023 22:40:55 +0200

Dear all,

the drive does not move. I sent it a command and it said nothing.

> Did you try at 10:30?

Best regards
"""


@pytest.mark.parametrize("text", [C_SOURCE, EMAIL, "hello\n", "a,b\n1,2\n", "{}\n", "<html></html>\n"])
def test_a_text_of_something_else(text: str, tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text(text)
    with pytest.raises(UnreadableError) as raised:
        open_source(path)
    message = str(raised.value)
    assert message.startswith("notes.txt is not a recognised capture format (text, beginning ")
    assert "candump" in message
    assert "hex" in message
    assert "--format NAME" in message


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("text", [C_SOURCE, EMAIL])
def test_a_text_of_something_else_that_is_forced(text: str, name: str, tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text(text)
    try:
        _, records = read_all(path, format=name)
    except UnreadableError:
        pass
    else:
        assert name in ("raw", "hex", "trc", "asc", "spy", "candump")
        assert all(isinstance(r, Chunk | Comment) for r in records)


def test_an_empty_file(tmp_path: Path) -> None:
    path = tmp_path / "empty.log"
    path.touch()
    for name in (None, *FORMATS):
        with pytest.raises(UnreadableError, match=r"empty\.log is empty"):
            open_source(path, format=name)


def test_a_directory(tmp_path: Path) -> None:
    with pytest.raises(UnreadableError, match="is a folder, expected a capture file"):
        open_source(tmp_path)


def test_of_a_folder_with_captures_and_a_log_it_is_told_that_the_log_alone_is_read(tmp_path):
    captures = Path(__file__).parents[2] / "captures"
    for name in ("mks_rs485.mcap", "mks_rs485.log", "mks_can.asc"):
        (tmp_path / name).write_bytes((captures / name).read_bytes())
    with open_source(tmp_path) as source:
        assert f"only the logs (*.mcap) of {tmp_path} are read, not 2 other files" in source.notes


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(UnreadableError, match="No such file or directory") as raised:
        open_source(tmp_path / "none.log")
    assert str(tmp_path / "none.log") in str(raised.value)


def test_a_path_that_is_none() -> None:
    with pytest.raises(UnreadableError, match="is not a path"):
        open_source("a\0b")


def test_no_permission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "secret.log"
    path.write_text("FA 01\n")

    def refuse(*_: object) -> int:
        raise PermissionError(13, "Permission denied")

    # The user who runs the tests may read everything.
    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(UnreadableError, match=r"secret\.log: Permission denied"):
        open_source(path)


def test_a_device() -> None:
    with pytest.raises(UnreadableError, match="is a device, expected a capture file"):
        open_source("/dev/zero")


def test_a_medium_that_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "bad.log"
    path.write_bytes(b"FA 01 F6\n" * 20_000)
    source = open_source(path)

    def fail(*_: object) -> bytes:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(stream, "_read_at", fail)
    with source, pytest.raises(UnreadableError, match=r"bad\.log: reading failed at byte 65536: Input/output error"):
        list(source)
    assert source.sha256 is None


def test_a_medium_that_fails_loses_nothing_before_that_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, line = tmp_path / "bad.log", "(1436509052.249713) can0 001#F60140023A\n"
    path.write_text(line * 40_000)
    good, whole = 1_000_000, stream._read_at

    def fails(fd: int, count: int, position: int) -> bytes:
        if position >= good:
            raise OSError(5, "Input/output error")
        return whole(fd, min(count, good - position), position)

    monkeypatch.setattr(stream, "_read_at", fails)
    items: list[object] = []
    with open_source(path) as source:
        source.in_blocks = True
        with pytest.raises(UnreadableError, match=rf"bad\.log: reading failed at byte {good}: Input/output error"):
            items.extend(source.items())
    assert sum(len(item) if isinstance(item, CanBlock) else 1 for item in items) == good // len(line)


def test_a_file_that_is_cut_while_it_is_read(tmp_path: Path) -> None:
    path, line = tmp_path / "cut.log", b"FA 01 F6\n"
    path.write_bytes(line * 20_000)
    with open_source(path) as source:
        for number, _ in enumerate(source):
            if not number:
                os.truncate(path, 90_000)
    assert number + 1 == 10_000
    assert "the file ends at byte 90000 of 180000: it was cut while it was read" in source.notes[-1]
    assert source.sha256 is None


@pytest.mark.parametrize(
    ("given", "hint"), [("candmp", "candump"), ("pcap-ng", "pcapng"), ("CANDUMP", "candump"), ("hexx", "hex")]
)
def test_an_unknown_format_suggests_the_near_one(given: str, hint: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=f"unknown format {given!r}.*did you mean {hint!r}"):
        open_source(tmp_path / "x", format=given)


def test_a_speed_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="baud: expected a number above 0, got 0"):
        open_source(tmp_path / "x", baud=0)


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"PK\x03\x04" + bytes(50), "a zip archive"),
        (b"SQLite format 3\x00" + bytes(50), "an SQLite database"),
        (b"%PDF-1.4\n", "a PDF"),
        (b"BZh91AY", "bzip2 data"),
        (b"\x7fELF" + bytes(50), "a program"),
    ],
)
def test_files_given_by_mistake(data: bytes, what: str, tmp_path: Path) -> None:
    path = tmp_path / "x.bin"
    path.write_bytes(data)
    with pytest.raises(UnreadableError, match=what):
        open_source(path)


def test_times_that_cannot_be(tmp_path: Path) -> None:
    path = tmp_path / "times.log"
    stamps = ("5.0", "4.0", "0.0", "7258118400.0", "99999999999999999.0", "6.0")
    path.write_text("".join(f"({t}) can0 001#F6\n" for t in stamps))
    source, records = read_all(path)
    second = 10**9
    assert [r.t_ns for r in records] == [
        5 * second, 4 * second, 0, 7_258_118_400 * second, 7_258_118_400 * second, 6 * second,
    ]  # fmt: skip
    assert 7_258_118_400 * second > FAR_NS
    notes = " | ".join(source.notes)
    assert "times run backwards 3 times" in notes
    assert "1 time after the year 2100" in notes
    assert "1 time beyond any calendar" in notes


@pytest.mark.parametrize(
    ("stamp", "text"),
    [
        ("2023-13-40 10:00:00", "month must be in 1..12"),
        ("25:00:00.5", "expected a time of day"),
        ("1999-02-30T01:02:03", "day"),
    ],
)
def test_dates_that_cannot_be(stamp: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / "times.log"
    path.write_text(f"{stamp} TX: FA 01 F6\n" * 3)
    source, records = read_all(path)
    assert len(records) == 3
    assert text in source.problems[0].text
    assert source.problems[0].line == 1


def test_terminal_escapes_in_names_and_comments(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    path.write_text("[bus\x07]>\n[bus:\x1b]0;x] TX: FA 01 F6\nTX: FA 01 F6\n\x1b[31mred [bold]rich[/] <b>html</b>\n")
    records = read_all(path)[1]
    assert all(r.port.isprintable() for r in records)
    assert [r.text for r in records if isinstance(r, Comment)][-1] == "red [bold]rich[/] <b>html</b>"


@pytest.mark.parametrize(
    ("name", "port"),
    [("/dev/ttyUSB0", "ttyUSB0"), ("COM3", "COM3"), ("\\\\.\\COM12", "COM12"), ("bus:0", "bus_0"),
     ("a\x1b[31mb/", "a_31mb"), ("../..", ""), ("x" * 99, "x" * 40), ("Achse 1", "Achse_1")],
)  # fmt: skip
def test_port_names(name: str, port: str) -> None:
    assert clean_port(name) == port


def test_problems_are_bounded(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    path.write_text("(1.0) can0 001#F6\n" * 5000 + "(1.0) can0 001#F6X\n" * 4000)
    source, records = read_all(path)
    assert len(records) == 5000
    assert (source.problem_count, len(source.problems)) == (4000, 20)
    assert "and 3997 more" in source.notes[-1]


def test_many_ports_are_bounded(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    path.write_text("".join(f"(1.0) can{n} 001#F6\n" for n in range(1000)))
    source, records = read_all(path)
    assert len({r.port for r in records}) == 64
    assert any("more than 64 lines" in note for note in source.notes)


def test_a_capture_without_traffic(tmp_path: Path) -> None:
    path = tmp_path / "x.asc"
    path.write_text("date Sun Apr 30 10:40:55.899 pm 2023\nbase hex  timestamps absolute\n")
    source, records = read_all(path)
    assert records == []
    assert source.notes == ["the capture holds no traffic"]


#: What Python's `splitlines`, `split`, `strip` and `\s` take for white space, or `\d` for a digit, and others do not.
ODD = "\x0b\x0c\x1c\x1d\x1e\x1f\x85\xa0\u2028\u2029\u3000\r\u0663\u00b2\ufeff\u212a\u017f"
#: Levels are refused whole where one line is damaged.
TEXTS = [name for name in builders.SAMPLES if name not in (*builders.BINARY, "vcd", "saleae-levels")]


@pytest.mark.parametrize("odd", ODD, ids=ascii)
def test_a_character_that_python_takes_for_white_space_or_a_digit_costs_its_line_alone(odd: str, tmp_path: Path) -> None:
    for name in TEXTS:
        sample = builders.SAMPLES[name]
        path = sample.make(tmp_path)
        lines = path.read_text().split("\n")
        whole = len(read_all(path, format=sample.format)[1])
        for n in range(8):
            # At the places where fields begin and end, and inside them.
            n = len(lines) // 3 + n
            at = [found.start() for found in re.finditer(r"\b|\W", lines[n])]
            place = at[(5 * n) % len(at)] if at else 0
            lines[n] = lines[n][:place] + odd + lines[n][place + n % 2 :]
        path.write_text("\n".join(lines))
        with open_source(path):
            pass
        source, records = read_all(path, format=sample.format)
        assert not any("breaks off" in p.text for p in source.problems)
        assert len(records) >= whole - 8
        path.unlink()


def test_a_line_separator_of_python_between_bytes_is_a_blank(tmp_path: Path) -> None:
    path = tmp_path / "paste.txt"
    path.write_text("0xFA 0x01 0x32 0x2D 0xFA 0x01\x1e0x32 0x2D\n")
    (chunk,) = read_all(path)[1]
    assert isinstance(chunk, Chunk)
    assert chunk.data.hex() == "fa01322dfa01322d"


@pytest.mark.parametrize(
    "stamp", ["+0.5 MS", "+0.5 \u017f", "+1\u03bcs", "5 \u212a", "\u0661\u0662:00:00", "3/5/2024\u202812:00:00"]
)
def test_a_stamp_in_odd_letters_is_no_fault(stamp: str, tmp_path: Path) -> None:
    path = tmp_path / "stamps.txt"
    path.write_text(f"{stamp} TX: FA 01 32 2D\n" * 3)
    assert len([r for r in read_all(path)[1] if isinstance(r, Chunk)]) == 3
