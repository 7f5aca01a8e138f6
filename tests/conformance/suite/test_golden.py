"""What the suite says stays what it was: the claims whole, a sample of the faults (`golden.py` has the rest)."""

from __future__ import annotations

import json
from zlib import crc32

import pytest

from conformance.tools import mutants
from tests.conformance import golden

#: One of so many of the faults is tried here.
STEP = 67


def drawn(line):
    """Say whether a fault is tried here: by its name, so that a new one does not change which others are."""
    return crc32(named(line).encode()) % STEP == 0


def named(line):
    kept = json.loads(line)
    return f"{kept['dialect']}/{kept['fault']}"


def test_claims_are_those_that_are_kept():
    assert list(golden.claims()) == golden.kept("claims")


@pytest.mark.parametrize("line", [line for line in golden.kept("faults") if drawn(line)], ids=named)
def test_a_fault_is_refuted_by_the_claims_that_refuted_it(line):
    kept = json.loads(line)
    targets = mutants.telling_targets([kept["dialect"]])

    def refuted(most):
        (mutant,) = mutants.mutants(targets, only=[kept["fault"]], full=True, most=most)
        return sorted(claim for claim, _ in mutant.refuted)

    found = refuted(golden.LIKELIEST)
    if golden.hurts(kept["fault"]) and not golden.two_ways(found):
        found = refuted(None)
    elif not found and kept["refuted"]:
        # One was found by a search.
        (mutant,) = mutants.mutants(targets, only=[kept["fault"]], among=kept["refuted"])
        found = sorted(claim for claim, _ in mutant.refuted)
    assert found == kept["refuted"]
