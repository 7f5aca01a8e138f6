"""Counts of a recording, as a checkpoint keeps them."""

from __future__ import annotations

import msgspec
import pytest

from analyzer.live.checkpoint import CountsState
from analyzer.live.counts import RecordingCounts


def test_a_checkpoint_without_one_of_the_counts_is_damaged() -> None:
    counts = RecordingCounts(lambda port, size: None)
    state = counts.state()
    counts.restore(msgspec.to_builtins(msgspec.convert(state, CountsState)))
    assert counts.state() == state
    for name in list(state["before"]):
        less = state | {"before": {key: value for key, value in state["before"].items() if key != name}}
        with pytest.raises(msgspec.ValidationError, match=name):
            msgspec.convert(less, CountsState)
