"""The theme shape: replies laid over what they must be, each claim saying one thing."""

from __future__ import annotations

import pytest

from conformance.claim import Outcome, Theme
from conformance.drives import make
from conformance.suite.rig_emulated import EmulatedRig
from tests.conformance.theme_runs import claims_of, refuted, run


@pytest.mark.parametrize(
    ("fault", "dialect", "about"),
    [
        ("checksum-wrong", "mks-rs485", "checksum"),
        ("checksum-without-id", "mks-can", "checksum"),
        ("crc-high-byte-first", "mks-modbus", "crc16"),
        ("lk-head-sum-wrong", "lk-rs485", "head_checksum"),
        ("lk-data-sum-with-head", "lk-rs485", "data_checksum"),
        ("wrong-reply-head", "mks-rs485", "head"),
        ("wrong-reply-code", "mks-rs485", "code"),
        ("wrong-reply-address", "mks-modbus", "address"),
        ("reply-under-id-0", "mks-can", "address"),
        ("reply-too-short", "mks-can", "length"),
        ("reply-too-long", "mks-modbus", "length"),
        ("lk-reply-length-wrong", "lk-rs485", "length"),
        ("read-byte-count-off-by-one", "mks-modbus", "length"),
        ("write-many-quantity-in-bytes", "mks-modbus", "quantity"),
        ("write-echo-next-register", "mks-modbus", "register"),
        ("doubled-reply", "lk-rs485", "once"),
        ("spurious-bytes", "mks-rs485", "clean"),
        ("trailing-byte", "mks-modbus", "clean"),
        ("pause-in-frame", "mks-rs485", "one-piece"),
        ("pause-in-frame", "mks-modbus", "one-piece"),
        ("late-reply", "mks-can", "answered"),
    ],
)
def test_a_fault_of_every_reply_is_refuted_by_the_claims_that_say_so(fault, dialect, about):
    reads = ("read_position/", "read_encoder/", "read_speed/", "set_direction/", "set_home/", "clear_turns/", "one-piece")
    found = {name.rpartition("/")[2] for name in refuted(Theme.SHAPE, f"{dialect}@1,fault={fault}", *reads)}
    assert found == {about}


def test_old_firmware_without_checksums_is_a_known_quirk():
    verdicts = run(Theme.SHAPE, "mks-rs485@1,quirk=no-checksum", "read_speed/")
    assert verdicts["read_speed/checksum"].outcome is Outcome.REFUTED
    assert {v.quirks for v in verdicts.values() if v.outcome is Outcome.REFUTED} == {("no-checksum",)}
    assert {v.outcome for v in verdicts.values()} == {Outcome.REFUTED, Outcome.CONFIRMED}


def test_claims_about_one_command_share_an_exchange_and_a_second_run_asks_again():
    rig = EmulatedRig(make.parse("mks-rs485@1"))
    head, code = claims_of(Theme.SHAPE, rig, ("read_speed/head", "read_speed/code"))
    first, second, again = rig.probe(head), rig.probe(code), rig.probe(head)
    for probe in (first, second, again):
        probe.claim.check(probe)
    assert [len(p.raw) for p in (first, second, again)] == [2, 0, 2]
    assert second.traffic == first.traffic


def test_a_refutation_carries_what_was_expected_and_the_exchange():
    verdict = run(Theme.SHAPE, "mks-rs485@1,fault=wrong-reply-code", "read_speed/code")["read_speed/code"]
    assert (verdict.expected, verdict.got) == ("code 32", "33")
    assert verdict.exchange is not None
    assert verdict.exchange.data == bytes.fromhex("FA 01 32 2D")


def test_a_command_of_some_models_is_not_judged_where_the_model_is_unknown():
    assert run(Theme.SHAPE, "lk-rs485@1", "run_torque/once")["run_torque/once"].outcome is Outcome.NOT_RUN
