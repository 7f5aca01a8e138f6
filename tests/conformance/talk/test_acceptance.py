"""Acceptance of requests: done, refused or silence, and what says nothing of it; settings of the link, stored settings."""

from __future__ import annotations

import pytest

from analyzer import dialects
from analyzer.catalogue import Risk, Verb
from conformance.claim import Claim, Inconclusive, Refuted, Theme
from conformance.drives import make
from conformance.suite.rig_emulated import EmulatedRig
from conformance.talk import settings
from conformance.talk.acceptance import (
    Acceptance,
    answers,
    expect_accepted,
    expect_refused,
    need_plain_replies,
    need_reliable_replies,
    try_request,
    without_repeats,
)
from conformance.talk.restarts import power_cycle, restart


def probe_of(drive):
    rig = EmulatedRig(make.parse(drive))
    name = rig.dialect.name
    risks = frozenset(Risk)
    return rig.probe(Claim(f"{name}/state/x", Theme.STATE, name, "x", "", "x", lambda probe: None, risks=risks))


@pytest.mark.parametrize("drive", ["mks-rs485@1,model=42D", "mks-modbus@1,model=42D", "mks-can@1,model=42E"])
def test_a_drive_does_what_is_allowed_and_refuses_the_rest(drive):
    probe = probe_of(drive)
    command = probe.command(Verb.SET_CURRENT)
    assert try_request(probe, probe.build(command, {"current": 1000}))[0] is Acceptance.DONE
    assert try_request(probe, probe.build(command, {"current": 9999}))[0] is Acceptance.REFUSED
    expect_accepted(probe, command, {"current": 1000}, "current 1000")
    expect_refused(probe, probe.build(command, {"current": 9999}), "current 9999")
    with pytest.raises(Refuted) as error:
        expect_accepted(probe, command, {"current": 9999}, "current 9999")
    assert error.value.text == "set_current: current 9999 is refused"
    with pytest.raises(Refuted) as error:
        expect_refused(probe, probe.build(command, {"current": 1000}), "current 1000")
    assert error.value.text == "set_current: current 1000 is accepted"


@pytest.mark.parametrize("fault", ["echo", "doubled-reply"])
def test_replies_that_are_not_plain_show_nothing_of_values(fault):
    need_plain_replies(probe_of("mks-rs485@1"))
    with pytest.raises(Inconclusive):
        need_plain_replies(probe_of(f"mks-rs485@1,fault={fault}"))


def test_a_line_that_loses_replies_is_not_reliable():
    need_reliable_replies(probe_of("mks-rs485@1"))
    with pytest.raises(Inconclusive):
        need_reliable_replies(probe_of("mks-rs485@1,fault=lost-reply"))


def test_a_status_that_comes_twice_is_for_another_claim():
    assert without_repeats([1, 2]) == [1, 2]
    with pytest.raises(Inconclusive, match="twice"):
        without_repeats([1, 1, 2])


@pytest.mark.parametrize("drive", ["mks-rs485@1", "mks-can@1"])
def test_a_drive_answers_again_after_a_restart_and_after_its_power_was_cut(drive):
    probe = probe_of(drive)
    restart(probe)
    assert answers(probe)
    power_cycle(probe)
    assert answers(probe)
    assert not answers(probe, 9)


def test_the_catalogue_says_which_settings_change_the_link():
    found = {n: {c.name for c in dialects.get(n).commands if settings.changes_link(c)} for n in ("mks-rs485", "mks-can")}
    assert found == {"mks-rs485": {"set_address", "set_baud_rate", "set_modbus"}, "mks-can": {"set_address", "set_bit_rate"}}


def test_a_stored_setting_is_read_back():
    probe = probe_of("mks-can@1,model=42E")
    command = probe.command(Verb.SET_CURRENT)
    probe.do(command, {"current": 1234})
    assert settings.read_back(probe, command)[0] == {"current": 1234}
    unreadable = probe_of("mks-can@1,fault=subdivision-unreadable")
    assert settings.read_back(unreadable, unreadable.command(Verb.SET_SUBDIVISION))[0] is None
