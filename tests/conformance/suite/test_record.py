"""Records: the verdict of any claim as plain data."""

from __future__ import annotations

from conformance.claim import Outcome, Verdict
from conformance.suite.plan import every_claim
from conformance.suite.record import record
from conformance.suite.target import every_emulated


def test_every_claim_has_a_record_whose_commands_go_by_name():
    found = {
        claim.id: record(Verdict(claim, Outcome.CONFIRMED), target.text).parameters
        for target in every_emulated()
        for claim in every_claim(target)
    }
    assert "emergency_stop" in found["mks-can/read-back/write_io/stays"]["deeds"]
    assert all(len(str(parameters)) < 1000 for parameters in found.values())
