"""candump: both forms, every kind of frame, times to the last digit."""

from __future__ import annotations

from pathlib import Path

import pytest
from can.io.canutils import CanutilsLogReader

from analyzer.catalogue import Role
from analyzer.records import CanFrame, Comment
from analyzer.sources import Record, Source
from tests.contracts.source_contract import read_all
from tests.sources import builders

U, REQUEST = Role.UNKNOWN, Role.REQUEST


def read(tmp_path: Path, text: str, **options: object) -> tuple[Source, list[Record]]:
    path = tmp_path / "capture.log"
    path.write_text(text)
    return read_all(path, **options)


@pytest.mark.parametrize(
    ("line", "frame"),
    [
        ("(1.5) can0 001#F601", CanFrame(1_500_000_000, "can0", 1, b"\xf6\x01")),
        ("(1682894455.899123456) can0 7FF#", CanFrame(1_682_894_455_899_123_456, "can0", 0x7FF, b"")),
        ("(1682894455.8) vcan1 123#11 R", CanFrame(1_682_894_455_800_000_000, "vcan1", 0x123, b"\x11")),
        ("(0.000001) can0 123#11 T", CanFrame(1_000, "can0", 0x123, b"\x11", REQUEST)),
        ("(1.0) can0 00000123#11", CanFrame(10**9, "can0", 0x123, b"\x11", U, extended=True)),
        ("(1.0) can0 1FFFFFFF#", CanFrame(10**9, "can0", 0x1FFFFFFF, b"", U, extended=True)),
        ("(1.0) can0 123#R", CanFrame(10**9, "can0", 0x123, b"", U, remote=True)),
        ("(1.0) can0 123#R4 T", CanFrame(10**9, "can0", 0x123, b"", REQUEST, remote=True)),
        ("(1.0) can0 123##1AABB", CanFrame(10**9, "can0", 0x123, b"\xaa\xbb", U, fd=True)),
        ("(1.0) can0 123##0", CanFrame(10**9, "can0", 0x123, b"", U, fd=True)),
        ("(1.0) can0 123#1122334455667788_F", CanFrame(10**9, "can0", 0x123, bytes.fromhex("1122334455667788"))),
        ("(1.0) can0 20000004#0004000000000000", CanFrame(10**9, "can0", 4, bytes.fromhex("0004000000000000"), U, error=True)),
        ("(1.0) 0 123#11", CanFrame(10**9, "0", 0x123, b"\x11")),
        ("  can0  001   [4]  F6 01 40 02", CanFrame(None, "can0", 1, bytes.fromhex("F6014002"))),
        (" (1.5)  can0  001   [1]  F6", CanFrame(1_500_000_000, "can0", 1, b"\xf6")),
        (" (2023-04-30 22:40:55.899123)  can0  001   [1]  F6", CanFrame(1_682_894_455_899_123_000, "can0", 1, b"\xf6")),
        (" (1.5)  can0  TX B E  001  [12]  " + "AA " * 12, CanFrame(1_500_000_000, "can0", 1, b"\xaa" * 12, REQUEST, fd=True)),
        (" (1.5)  can0  RX - -  001   [1]  F6   '.'", CanFrame(1_500_000_000, "can0", 1, b"\xf6")),
        ("  can0  123   [8]  remote request", CanFrame(None, "can0", 0x123, b"", U, remote=True)),
        ("  can0  123   [0]  remote request", CanFrame(None, "can0", 0x123, b"", U, remote=True)),
        ("  can0  00000123   [1]  11", CanFrame(None, "can0", 0x123, b"\x11", U, extended=True)),
        ("  can0  20000080   [8]  00 00 00 00 00 00 00 00   ERRORFRAME", CanFrame(None, "can0", 0x80, bytes(8), U, error=True)),
        ("\x1b[34m  can0  \x1b[0m001   [1]  F6", CanFrame(None, "can0", 1, b"\xf6")),
    ],
)
def test_lines(line: str, frame: CanFrame, tmp_path: Path) -> None:
    source, records = read(tmp_path, line + "\n")
    assert source.format == "candump"
    assert records == [frame]


def test_deltas_are_summed(tmp_path: Path) -> None:
    given = ("000.000000", "000.500000", "000.000001", "001.000000")
    records = read(tmp_path, "".join(f" ({t})  can0  001   [1]  F6\n" for t in given))[1]
    assert [r.t_ns for r in records] == [0, 500_000_000, 500_001_000, 1_500_001_000]


def test_seconds_since_the_start_are_not_summed(tmp_path: Path) -> None:
    given = ("000.000000", "000.500000", "000.500001", "001.000000")
    records = read(tmp_path, "".join(f" ({t})  can0  001   [1]  F6\n" for t in given))[1]
    assert [r.t_ns for r in records] == [0, 500_000_000, 500_001_000, 1_000_000_000]


def test_bad_lines_are_problems_with_their_numbers(tmp_path: Path) -> None:
    lines = ["(1.0) can0 001#F6"] * 8
    lines[2] = "(1.0) can0 001#F60"
    lines[4] = "garbage"
    lines[6] = "  can0  001   [4]  F6 01"
    source, records = read(tmp_path, "\n".join(lines) + "\n")
    assert len(records) == 5
    assert [p.line for p in source.problems] == [3, 5, 7]
    assert "expected 4 data bytes, got 2" in source.notes[0] or "expected 4" in str(source.problems[2])
    assert "got 'garbage'" in str(source.problems[1])
    assert any("3 problems" in note for note in source.notes)


def test_an_explained_error_frame(tmp_path: Path) -> None:
    text = "  can0  20000004   [8]  00 08 00 00 00 00 60 00   ERRORFRAME\n\tcontroller-problem{tx-error-warning}\n"
    records = read(tmp_path, text)[1]
    assert isinstance(records[0], CanFrame)
    assert records[0].error
    assert records[1] == Comment(None, "can0", "controller-problem{tx-error-warning}")


def test_a_cut_last_line_is_noted(tmp_path: Path) -> None:
    source, records = read(tmp_path, "(1.0) can0 001#F601\n(1.1) can0 001#F6")
    assert len(records) == 2
    assert any("line 2" in note and "cut" in note for note in source.notes)


def test_a_name_for_the_bus(tmp_path: Path) -> None:
    text = "(1.0) can0 001#F6\n(1.0) can1 001#F6\n(1.0) can0 001#F6\n"
    assert [r.port for r in read(tmp_path, text, bus="left")[1]] == ["left", "left_can1", "left"]
    assert [r.port for r in read(tmp_path, text)[1]] == ["can0", "can1", "can0"]


def test_the_same_frames_as_python_can(tmp_path: Path) -> None:
    path = builders.candump(tmp_path / "capture.log")
    ours = [r for r in read_all(path)[1] if isinstance(r, CanFrame)]
    with path.open() as file:
        theirs = list(CanutilsLogReader(file))
    assert len(ours) == len(theirs) == 40
    for a, b in zip(ours, theirs, strict=True):
        assert (a.id, a.data, a.extended, a.port) == (b.arbitration_id, bytes(b.data), b.is_extended_id, b.channel)
        assert (a.direction is REQUEST) == (not b.is_rx)
        assert a.t_ns is not None
        assert abs(a.t_ns / 1e9 - b.timestamp) < 1e-6
    assert [a.t_ns for a in ours] == builders.times(40)
