"""`servotap decode` writes the same log and says the same, whether a capture goes by blocks or frame by frame."""

from __future__ import annotations

import json
import random

import pytest

from analyzer import dialects
from analyzer.cli import decode, main
from analyzer.columns import pairs
from tests.columns.both_ways import messages
from tests.columns.can_traffic import frames


def run(capture, target, capsys):
    assert main(["decode", str(capture), "-o", str(target), "--json", "--dialect", "mks-can"]) == 0
    said = json.loads(capsys.readouterr().out)
    del said["log"]
    return messages(target.read_bytes()), said


@pytest.mark.parametrize("odd", [0, 0.02])
def test_decode(odd, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(pairs, "SHORTEST_RUN", 2)
    monkeypatch.setattr(pairs, "LEAST_SHARE", 0)
    capture = tmp_path / "can.log"
    rows = [f for f in frames(dialects.get("mks-can"), random.Random(4), 4000, 0.02, odd) if not (f.extended or f.error)]
    capture.write_text("".join(f"({f.t_ns // 10**9}.{f.t_ns % 10**9:09d}) can0 {f.id:03X}#{f.data.hex()}\n" for f in rows))
    monkeypatch.setattr(decode, "LONG_CAPTURE", 1 << 30)
    single = run(capture, tmp_path / "single.mcap", capsys)
    monkeypatch.setattr(decode, "LONG_CAPTURE", 0)
    assert run(capture, tmp_path / "together.mcap", capsys) == single
    assert b"frames_by_columns" in (tmp_path / "together.mcap").read_bytes()
