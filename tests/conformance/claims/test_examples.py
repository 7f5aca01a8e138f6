"""The theme examples: every printed request, re-addressed, and its reply to the byte."""

from __future__ import annotations

import pytest

from analyzer import dialects
from analyzer.catalogue import Certainty, Role
from conformance.claim import Outcome, Theme
from conformance.drives import make
from conformance.suite.rig_emulated import EmulatedRig
from tests.conformance.theme_runs import claims_of, refuted, run


@pytest.mark.parametrize("dialect", ["mks-rs485", "mks-modbus", "mks-can", "lk-rs485"])
def test_every_printed_request_and_reply_stands_in_a_claim(dialect):
    spoken = dialects.get(dialect)
    claims = claims_of(Theme.EXAMPLES, EmulatedRig(make.parse(f"{dialect}@1")))
    told = " ".join(f"{c.statement} {c.parameters['printed']}" for c in claims)
    sent = [c.parameters["printed"] for c in claims]
    for command in spoken.commands:
        for vector in command.vectors:
            if vector.role is Role.REPLY:
                assert vector.printed in told, f"{command.name}: {vector.printed}"
            elif not vector.computed:
                # What is printed with and without its checksum, or again, is sent once; what is corrected, corrected.
                same = [p for p in sent if p.startswith(vector.printed) or vector.printed.startswith(p)]
                assert same or vector.erratum, f"{command.name}: {vector.printed}"


def test_an_example_is_sent_to_the_drive_that_is_there_and_its_reply_judged_to_the_byte():
    verdict = run(Theme.EXAMPLES, "mks-can@0x123", "save_speed/1")["save_speed/1"]
    assert verdict.outcome is Outcome.CONFIRMED
    sent = [e for e in verdict.traffic if getattr(e, "id", None) == 0x123 and e.data[:1] == b"\xff"]
    assert [frame.data.hex(" ").upper() for frame in sent] == ["FF C8 EA", "FF 01 23"]


def test_an_example_is_as_sure_as_its_erratum():
    claims = {c.id.split("/", 2)[2]: c for c in claims_of(Theme.EXAMPLES, EmulatedRig(make.parse("mks-rs485@1")))}
    assert claims["save_speed/1"].certainty is Certainty.OPEN
    assert claims["move_relative_axis/2"].certainty is Certainty.CERTAIN
    assert "corrected" in claims["move_relative_axis/2"].statement


def test_a_fault_in_an_example_of_an_open_point_is_observed():
    found = run(Theme.EXAMPLES, "lk-rs485@1,fault=lk-gains-swapped", "write_parameter/1")["write_parameter/1"]
    assert (found.outcome, found.claim.certainty) == (Outcome.OBSERVED, Certainty.OPEN)


def test_values_that_are_measured_are_left_aside():
    assert refuted(Theme.EXAMPLES, "mks-rs485@1,fault=position-offset", "read_") == set()
