"""The suite is tested too: it refutes drives that are known to be wrong.

How mutants are judged and told. A sample of the faults is tried in `suite/test_golden.py`, those of one condition in
`claims/test_refuted.py`; `benchmarks/mutation.py` runs all.
"""

from __future__ import annotations

import re
from dataclasses import replace

from conformance.suite import plan
from conformance.suite.target import parse
from conformance.tools import mutants


def test_a_claim_that_says_the_right_thing_refutes():
    target = parse("mks-rs485@1,model=42D")
    fault = next(f for f in mutants.faults_of(target.dialect) if f.name == "checksum-wrong")
    (mutant,) = mutants.mutants([target], only=[fault.name])
    assert not mutant.survived
    assert "checksum" in " ".join(mutant.refuted[0])


def test_one_claim_of_each_kind_is_tried_before_a_second():
    target = parse("mks-rs485@1,model=42D")
    fault = replace(mutants.faults_of(target.dialect)[0], name="reserved", text="", breaks="")
    ids = ["shape/enable/reserved", "shape/read_io/reserved", "shape/reply/reserved", "shape/read_io/length"]
    named = {claim.id.split("/", 1)[1]: claim for claim in plan.every_claim(target)}
    found = mutants._likely_first([replace(named["shape/read_io/length"], id=f"mks-rs485/{name}") for name in ids], fault)
    assert [claim.id.split("/", 1)[1] for claim in found] == [ids[0], ids[2], ids[1], ids[3]]


def test_a_fault_that_nothing_can_see_survives(monkeypatch):
    target = parse("mks-rs485@1,model=42D")
    fault = mutants.faults_of(target.dialect)[0]
    assert mutants.judge(target, fault, []).survived


def test_the_table_says_by_how_many_claims_and_whether_on_hardware():
    target = parse("mks-rs485@1,model=42D")
    fault = next(f for f in mutants.faults_of(target.dialect) if f.name == "checksum-wrong")
    claims = [c for c in plan.every_claim(target) if "/shape/read_speed/" in c.id]
    by_hand = [replace(c, emulated=True) for c in claims]
    told = mutants._verdict(mutants.judge(target, fault, claims, full=True), full=True)
    assert re.match(r"refuted by (\d+) claims, \1 on hardware; by mks-rs485/shape/read_speed/", told), told
    assert ", none on hardware" in mutants._verdict(mutants.judge(target, fault, by_hand, full=True), full=True)
