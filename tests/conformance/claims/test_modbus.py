"""The theme Modbus: functions, registers, quantities, byte counts, refusals, exceptions."""

from __future__ import annotations

import pytest

from conformance.claim import Outcome, Theme
from conformance.drives import make
from conformance.suite.rig_emulated import EmulatedRig
from tests.conformance.theme_runs import claims_of, judge, refuted, run


@pytest.mark.parametrize("dialect", ["mks-rs485", "mks-can", "lk-rs485"])
def test_other_dialects_have_no_such_claims(dialect):
    assert claims_of(Theme.MODBUS, EmulatedRig(make.parse(f"{dialect}@1"))) == []


def test_silence_in_the_place_of_an_exception_is_observed():
    verdicts = run(Theme.MODBUS, "mks-modbus@1,fault=modbus-no-exceptions", "function", "register", "quantity")
    assert Outcome.REFUTED not in {verdict.outcome for verdict in verdicts.values()}
    for name in ("function/unknown", "register/between", "quantity/others"):
        assert verdicts[name].outcome is Outcome.OBSERVED


@pytest.mark.parametrize("fault", ["doubled-reply", "checksum-wrong", "spurious-bytes", "lost-reply"])
def test_faults_of_every_reply_are_not_called_faults_of_exceptions(fault):
    assert refuted(Theme.MODBUS, f"mks-modbus@1,fault={fault}", "function", "register", "quantity", "byte_count") == set()


def test_the_register_of_the_later_manual_is_a_known_quirk():
    verdicts = run(Theme.MODBUS, "mks-modbus@1,quirk=register-94h", "register/")
    assert (verdicts["register/unknown_write"].outcome, *verdicts["register/unknown_write"].quirks) == (
        Outcome.REFUTED,
        "register-94h",
    )
    assert verdicts["register/between"].outcome is Outcome.CONFIRMED


@pytest.mark.parametrize("address", [2, 26, 41])
def test_registers_that_no_command_has_are_refused_at_every_address(address):
    assert judge(f"mks-modbus@{address}", "modbus/register/unknown_write").outcome is Outcome.CONFIRMED
