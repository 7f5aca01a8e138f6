"""What can hurt is noticed in two ways: by two claims, of which one needs no hands on the drive. As the kept results say."""

from __future__ import annotations

import json
from fnmatch import fnmatch

import pytest

from tests.conformance import golden

#: Motion with a wrong check, by a wrong address, while disabled, while protected.
HURTS = (
    "executes-bad-*", "hears-bad-*", "executes-another-address", "executes-motion-of-another", "answers-another-address",
    "disabled-moves", "protected-moves", "package-any-checksum", "package-every-slot", "package-broadcast-slot",
    "lk-answers-other-address", "lk-answers-address-0", "lk-obeys-*", "lk-answers-wrong-*-sum", "lk-off-still-moves",
)  # fmt: skip
#: Where there are not two ways yet. None may be added.
SHORT = {
    ("mks-rs485", "protected-moves"), ("mks-modbus", "protected-moves"), ("mks-can", "protected-moves"),
    ("mks-rs485", "package-broadcast-slot"), ("lk-rs485", "lk-obeys-wrong-data-sum"), ("lk-rs485", "lk-obeys-wrong-head-sum"),
}  # fmt: skip


def test_what_can_hurt_is_noticed_in_two_ways():
    by_hand = {c["id"] for c in map(json.loads, golden.kept("claims")) if "emulated" in c["flags"]}
    faults = [f for f in map(json.loads, golden.kept("faults")) if any(fnmatch(f["fault"], p) for p in HURTS)]
    assert len(faults) > 30
    short = {(f["dialect"], f["fault"]) for f in faults if len(f["refuted"]) < 2 or set(f["refuted"]) <= by_hand}
    assert short <= SHORT


@pytest.mark.parametrize("pattern", HURTS)
def test_each_of_these_faults_is_there(pattern: str):
    assert any(fnmatch(json.loads(line)["fault"], pattern) for line in golden.kept("faults"))
