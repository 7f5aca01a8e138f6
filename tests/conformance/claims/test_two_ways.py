"""What can hurt is noticed in two ways: by two claims, of which one needs no hands on the drive. As the kept results say."""

from __future__ import annotations

import json
from fnmatch import fnmatch

import pytest

from tests.conformance import golden


def test_what_can_hurt_is_noticed_in_two_ways():
    faults = [f for f in map(json.loads, golden.kept("faults")) if golden.hurts(f["fault"])]
    assert len(faults) > 30
    assert [(f["dialect"], f["fault"]) for f in faults if not golden.two_ways(f["refuted"])] == []


@pytest.mark.parametrize("pattern", golden.HURTS)
def test_each_of_these_faults_is_there(pattern: str):
    assert any(fnmatch(json.loads(line)["fault"], pattern) for line in golden.kept("faults"))
