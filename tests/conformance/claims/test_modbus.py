"""The theme Modbus: functions, registers, quantities, byte counts, refusals, exceptions."""

from __future__ import annotations

import pytest

from conformance.claim import Outcome, Theme
from conformance.drives import make
from conformance.suite.rig_emulated import EmulatedRig
from tests.conformance.theme_runs import claims_of, not_confirmed, refuted, run


@pytest.mark.parametrize("drive", ["mks-modbus@247,model=57D"])
def test_conforming_drives_confirm_every_claim(drive):
    assert not_confirmed(Theme.MODBUS, drive) == {}


@pytest.mark.parametrize("dialect", ["mks-rs485", "mks-can", "lk-rs485"])
def test_other_dialects_have_no_such_claims(dialect):
    assert claims_of(Theme.MODBUS, EmulatedRig(make.parse(f"{dialect}@1"))) == []


@pytest.mark.parametrize(
    ("fault", "names"),
    [
        ("exception-always-04", {"function/other_reads", "register/between"}),
        ("exceptions-mixed-up", {"register/between", "quantity/others"}),
        ("exception-without-bit", {"function/other_reads", "register/between"}),
        ("function-03-reads", {"function/other_reads"}),
        ("any-quantity-reads", {"quantity/others"}),
        ("register-low-byte-only", {"register/high_byte"}),
        ("home-takes-six-bytes", {"byte_count/odd"}),
        ("refused-by-exception", {"write_one/refused", "write_many/refused"}),
        ("refusal-echoes-value", {"write_one/refused"}),
        ("refusal-echoes-quantity", {"write_many/refused"}),
        ("write-echo-zero", {"write_one/echo"}),
        ("write-many-quantity-off-by-one", {"write_many/echo"}),
        ("modbus-completions", {"write_many/once"}),
    ],
)
def test_a_fault_is_refuted_by_the_claims_that_say_so(fault, names):
    assert names <= refuted(Theme.MODBUS, f"mks-modbus@1,fault={fault}", *names)


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
