"""Options of a run: the plan that they ask for, and what a fault of the rig makes of the exit status."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import pytest

from analyzer.errors import UnreadableError, UsageError
from conformance.bus.line import LineLost
from conformance.claim import NotStopped, RigFault
from conformance.gate.permissions import add_gate_arguments
from conformance.suite.options import add_safety_arguments, plan_from
from conformance.suite.plan import Plan
from conformance.suite.target import parse

CLAIM = "mks-rs485/shape/*"


def plan(*words: str, place: str = "emulated", claims: tuple[str, ...] = (CLAIM,)) -> Plan:
    parser = argparse.ArgumentParser(exit_on_error=False)
    add_gate_arguments(parser)
    add_safety_arguments(parser)
    return plan_from(parser.parse_args(words), [parse("mks-rs485@1", place)], claims=claims)


def test_without_a_word_an_emulated_drive_may_be_sent_everything_and_a_real_one_reads():
    assert plan().allowance is None
    real = plan(place="serial:/dev/ttyUSB0,baud=38400").allowance
    assert real is not None
    assert {risk.value for risk in real.risks} == {"read"}


def test_what_is_allowed_is_allowed_everywhere():
    given = plan("--allow", "motion").allowance
    assert given is not None
    assert "motion" in {risk.value for risk in given.risks}


def test_settings_are_read_from_the_file(tmp_path: Path):
    path = tmp_path / "settings.json"
    path.write_text(json.dumps({"subdivision": 16}))
    assert plan("--settings", str(path)).settings == {"": {"subdivision": "16"}}
    assert plan().settings == {}


def test_a_setting_that_no_drive_has_is_refused(tmp_path: Path):
    path = tmp_path / "settings.json"
    path.write_text(json.dumps({"work_mod": "sr_vfoc"}))
    with pytest.raises(UnreadableError, match="no dialect has a setting 'work_mod'; did you mean work_mode"):
        plan("--settings", str(path))


@pytest.mark.parametrize("seconds", ["0", "-1", "x", "4000"])
def test_the_longest_run_has_bounds(seconds: str):
    with pytest.raises(argparse.ArgumentError, match="expected seconds above 0, up to 3600"):
        plan("--max-run", seconds)
    assert plan("--max-run", "3600").longest_run == 3600


def test_quirks_are_accepted_by_name():
    assert plan().accepted == ()
    assert plan("--accept-quirk", "settling", "--accept-quirk", "all").accepted == ("settling", "all")
    with pytest.raises(UsageError, match="no quirk 'setling'"):
        plan("--accept-quirk", "setling")


def test_claims_that_there_are_not_are_refused():
    with pytest.raises(UsageError, match="no claim"):
        plan(claims=("mks-rs485/shap/*",))


def test_faults_have_their_exit_status():
    assert (RigFault.exit_status, LineLost.exit_status, NotStopped.exit_status) == (10, 10, 20)
