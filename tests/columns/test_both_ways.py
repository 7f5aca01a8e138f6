"""What goes through columns comes out the same as frame by frame."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from analyzer import dialects
from analyzer.columns import pairs
from analyzer.sources import found, open_source
from tests.columns.both_ways import outcome, same
from tests.columns.can_traffic import frames
from tests.toy.dialect import DIALECT as TOY

MKS = dialects.get("mks-can")
CAPTURES = Path(__file__).parents[2] / "captures"


@pytest.mark.parametrize(("busy", "odd"), [(0, 0), (0.01, 0), (0, 0.02), (0.05, 0.05), (0.5, 0.5)])
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("dialect", [MKS, TOY], ids=lambda dialect: dialect.name)
def test_exchanges(dialect, seed, busy, odd, monkeypatch):
    # Short runs and short stretches without: so they begin and end at as many places as there can be.
    monkeypatch.setattr(pairs, "SHORTEST_RUN", 2)
    monkeypatch.setattr(pairs, "LEAST_SHARE", 0)
    monkeypatch.setattr(pairs, "AFTER_REFUSAL", 2)
    most = random.Random(seed).choice((7, 100, 250, 1000))
    pipeline = same(list(frames(dialect, random.Random(seed), 600, busy, odd)), dialect, most)
    assert pipeline.in_runs or most < 10 or busy + odd > 0.05


def test_odd_frames_leave_one_by_one():
    # A reply that is lost, an echo and a frame of another node stop their own exchange and nothing else.
    polls = list(frames(MKS, random.Random(3), 2000, 0, 0, polls=("read_speed", "read_position", "read_pulses")))
    odd = [*polls[:801], *polls[802:1200], polls[1200], *polls[1200:]]
    pipeline = same(odd, MKS, 1000)
    assert pipeline.in_runs > 0.9 * len(odd)


@pytest.mark.parametrize(
    "path", [p for p in sorted(CAPTURES.glob("mks_can.*")) if p.suffix != ".golden"], ids=lambda path: path.name
)
def test_captures(path, monkeypatch):
    monkeypatch.setattr(pairs, "SHORTEST_RUN", 2)
    monkeypatch.setattr(pairs, "LEAST_SHARE", 0)
    monkeypatch.setattr(found, "SHORTEST", 2)
    single, together = open_source(str(path)), open_source(str(path))
    together.in_blocks = True
    streamed, columns = outcome(list(single), MKS)[0], outcome(list(together.items()), MKS)[0]
    assert streamed == columns
