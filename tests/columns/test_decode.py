"""`servotap decode` writes the same log and says the same, whether a capture goes by blocks or frame by frame."""

from __future__ import annotations

import json
import random

from analyzer import dialects
from analyzer.cli import decode, main
from tests.columns.both_ways import messages, short_runs
from tests.columns.can_traffic import frames


def run(capture, target, capsys):
    assert main(["decode", str(capture), "-o", str(target), "--json", "--dialect", "mks-can"]) == 0
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
