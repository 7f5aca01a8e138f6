"""Limits of fields as lists of integers: values that are spread over a range."""

from __future__ import annotations

from itertools import pairwise

import pytest

from analyzer.layout import u16, u32
from conformance.model import limits


@pytest.mark.parametrize(("low", "high", "count"), [(0, 3000, 3), (1, 65535, 5), (100, 4_000_000_000, 8)])
def test_values_across_a_range_rise_by_one_factor(low: int, high: int, count: int) -> None:
    found = limits.across(u32("period", minimum=low, maximum=high), count)
    assert len(found) == count
    assert low < found[0]
    assert found[-1] < high
    factor = (high / max(1, low)) ** (1 / (count + 1))
    assert all(1 < after / before < 1.2 * factor for before, after in pairwise((max(1, low), *found, high)))


def test_a_range_too_small_for_all_has_fewer_values() -> None:
    assert limits.across(u16("mode", minimum=0, maximum=2), 4) == (1,)
