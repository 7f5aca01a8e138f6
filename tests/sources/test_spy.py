"""Logs of pyserial's spy:// ports, made by pyserial itself."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from serial.urlhandler import protocol_spy

from analyzer.catalogue import Role
from analyzer.records import Chunk, Comment
from analyzer.sources import Record
from tests.contracts.source_contract import read_all


class Log:
    """pyserial's own formatter, with a clock that is set."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, color: bool = False) -> None:
        self.now = 1000.0
        monkeypatch.setattr(protocol_spy.time, "time", lambda: self.now)
        self.text = io.StringIO()
        self.spy = protocol_spy.FormatHexdump(self.text, color)

    def read(self, folder: Path) -> list[Record]:
        path = folder / "spy.log"
        path.write_text(self.text.getvalue())
        source, records = read_all(path)
        assert source.format == "spy"
        assert source.problems == []
        return records


@pytest.mark.parametrize("color", [False, True])
@pytest.mark.parametrize("size", [1, 7, 8, 9, 15, 16, 17, 32, 52, 300])
def test_what_pyserial_wrote(size: int, color: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    log = Log(monkeypatch, color)
    data = bytes((0xFA + n * 7) & 0xFF for n in range(size))
    log.spy.tx(data)
    log.now += 1.234
    log.spy.rx(data[::-1])
    log.spy.rx(data)
    assert log.read(tmp_path) == [
        Chunk(0, "serial", data, Role.REQUEST, True),
        Chunk(1_234_000_000, "serial", data[::-1], Role.REPLY),
        Chunk(1_234_000_000, "serial", data, Role.REPLY),
    ]


def test_calls_are_comments(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    log = Log(monkeypatch)
    log.spy.control("Q-RX", "reset_input_buffer")
    log.spy.tx(b"\xfa" * 16)
    log.spy.control("BRK", "send_break 0.25s")
    log.spy.rx(b"")
    log.spy.control("RTS", "inactive")
    assert log.read(tmp_path) == [
        Comment(0, "serial", "Q-RX reset_input_buffer"),
        Chunk(0, "serial", b"\xfa" * 16, Role.REQUEST, True),
        Comment(0, "serial", "BRK send_break 0.25s"),
        Comment(0, "serial", "RTS inactive"),
    ]


def test_bytes_that_look_like_hex_in_the_margin(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    log = Log(monkeypatch)
    log.spy.tx(b"FA 01 F6")
    assert log.read(tmp_path) == [Chunk(0, "serial", b"FA 01 F6", Role.REQUEST, True)]


def test_a_bad_line(tmp_path: Path) -> None:
    path = tmp_path / "spy.log"
    row = "000000.000 TX   0000  FA 01                                             ..\n"
    path.write_text(row * 3 + "000000.000 TX   zzzz\nnonsense\n" + row)
    source, records = read_all(path)
    assert len([r for r in records if isinstance(r, Chunk)]) == 4
    assert [p.line for p in source.problems] == [4, 5]


def test_rows_of_which_bytes_are_missing_are_problems(tmp_path: Path) -> None:
    path = tmp_path / "spy.log"
    whole = "FA 01 30 2B FA 01 30 2B  FA 01 30 2B FA 01 30 2B  ................"
    path.write_text(
        f"000003.001 TX   0000  {whole}\n000004.001 TX   0000  {whole.replace('2B  FA', ']B  FA')}\n"
        "000005.001 TX   0010  FA 01 30 2B                                       ....\n"
    )
    source, records = read_all(path)
    assert len(records) == 3
    assert [(p.line, p.text) for p in source.problems] == [
        (2, "expected 16 bytes, as many as the characters show, got 7"),
        (3, "the rows before offset 0010 are missing"),
    ]
