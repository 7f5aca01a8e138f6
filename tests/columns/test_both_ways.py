"""What goes through columns comes out the same as frame by frame."""

from __future__ import annotations

import random

import pytest

from analyzer.columns import pairs
from tests.columns.both_ways import same
from tests.columns.can_traffic import frames


@pytest.mark.parametrize(("busy", "odd"), [(0, 0), (0.01, 0), (0, 0.02), (0.05, 0.05), (0.5, 0.5)])
@pytest.mark.parametrize("seed", range(4))
def test_exchanges(seed, busy, odd, monkeypatch):
    # Short runs and short stretches without: so they begin and end at as many places as there can be.
    monkeypatch.setattr(pairs, "SHORTEST_RUN", 2)
    monkeypatch.setattr(pairs, "AFTER_REFUSAL", 2)
    most = random.Random(seed).choice((7, 100, 250, 1000))
    pipeline = same(list(frames("mks-can", random.Random(seed), 600, busy, odd)), "mks-can", most)
    assert pipeline.in_runs or most < 10 or busy + odd > 0.05
