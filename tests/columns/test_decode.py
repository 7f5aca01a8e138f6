"""`servotap decode` writes the same log and says the same, whether a capture goes by blocks or frame by frame."""

from __future__ import annotations

import json
import random

import pytest

from analyzer import dialects, sources
from analyzer.cli import decode, main
from analyzer.sources import stream
from tests.columns.both_ways import messages, short_runs
from tests.columns.can_traffic import frames
from tests.columns.serial_traffic import POLLS, polls


def run(capture, target, capsys, dialect="mks-can"):
    assert main(["decode", str(capture), "-o", str(target), "--json", "--dialect", dialect]) == 0
    said = json.loads(capsys.readouterr().out)
    del said["log"]
    return messages(target.read_bytes()), said


def test_decode(tmp_path, capsys, monkeypatch):
    capture = tmp_path / "can.log"
    rows = [f for f in frames(dialects.get("mks-can"), random.Random(4), 3000, 0.02, 0.02) if not (f.extended or f.error)]
    capture.write_text("".join(f"({f.t_ns // 10**9}.{f.t_ns % 10**9:09d}) can0 {f.id:03X}#{f.data.hex()}\n" for f in rows))
    monkeypatch.setattr(decode, "LONG_CAPTURE", 1 << 30)
    single = run(capture, tmp_path / "single.mcap", capsys)
    monkeypatch.setattr(decode, "LONG_CAPTURE", 0)
    with short_runs():
        assert run(capture, tmp_path / "together.mcap", capsys) == single
    assert b"frames_by_columns" in (tmp_path / "together.mcap").read_bytes()


def as_bytes(rows, capture):
    capture.write_bytes(b"\x00\x80" + b"".join(row.data for row in rows))


def as_text(rows, capture):
    lines = [f"09:00:{n // 100:02d}.{n % 100 * 10:03d} {'><'[n % 2]} {row.data.hex(' ').upper()}" for n, row in enumerate(rows)]
    capture.write_text("\n".join([*lines[:700], "something else", *lines[700:]]) + "\n")


@pytest.mark.parametrize("written", [as_bytes, as_text])
@pytest.mark.parametrize("name", POLLS)
def test_serial_lines(name, written, tmp_path, capsys, monkeypatch):
    capture = tmp_path / "line"
    written(polls(name, random.Random(5), 1500), capture)
    # The first read is never part of a block: by it the dialects are chosen.
    for module in (stream, sources):
        monkeypatch.setattr(module, "BLOCK", 1000)
    monkeypatch.setattr(decode, "LONG_CAPTURE", 1 << 30)
    single = run(capture, tmp_path / "single.mcap", capsys, name)
    monkeypatch.setattr(decode, "LONG_CAPTURE", 0)
    assert run(capture, tmp_path / "together.mcap", capsys, name) == single
    assert b"frames_by_columns" in (tmp_path / "together.mcap").read_bytes()
