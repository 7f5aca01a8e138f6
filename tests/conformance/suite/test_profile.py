"""Drives of a profile under test: their places, bounds and settings."""

from __future__ import annotations

import argparse

import pytest

import servotap
from analyzer.errors import ServotapError, UsageError
from conformance.gate.permissions import add_gate_arguments
from conformance.suite import target
from conformance.suite.options import add_safety_arguments, plan_from
from tests.live.test_profile import BENCH


@pytest.fixture(autouse=True)
def bench(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "servotap.toml").write_text(BENCH)


def plan_of(drives, *words, on=()):
    parser = argparse.ArgumentParser()
    add_gate_arguments(parser)
    add_safety_arguments(parser)
    return plan_from(parser.parse_args(words), target.parse_all(drives, on), claims=())


def test_a_name_brings_its_place():
    arm, lift = target.parse_all(["left"], [])
    assert (arm.text, arm.model, arm.on) == ("mks-rs485@1,model=42D", "42D", "left=serial:/dev/ttyUSB7,baud=115200,parity=even")
    assert lift.text == "mks-modbus@2"
    assert [each.text for each in target.parse_all([], ["arm"])] == ["mks-rs485@1,model=42D"]
    assert target.any_real(["arm"], [])
    assert not target.any_real(["arm"], ["emulated"])
    with pytest.raises(UsageError, match="mks-can@0x12 is a drive on can"):
        target.parse_all(["wrist"], ["left"])


def test_a_drive_of_a_profile_can_be_emulated():
    (arm,) = target.parse_all(["arm"], ["emulated"])
    assert arm.emulated
    assert arm.specification.model == "42D"


def test_the_bounds_of_a_profile_count_where_no_option_says_otherwise():
    assert plan_of(["arm"]).allowance.speed == 300
    assert plan_of(["arm"]).allowance.subdivision == 16
    assert plan_of(["arm"], "--max-speed", "50").allowance.speed == 50
    # It brings no permission.
    assert {risk.value for risk in plan_of(["arm"]).allowance.risks} == {"read"}


def test_the_settings_of_a_profile_are_put_back(tmp_path):
    assert plan_of(["arm"]).settings == {"mks-rs485@1": {"current": "1600 mA", "work_mode": "5"}}
    given = tmp_path / "settings.json"
    given.write_text('{"mks-rs485@1": {"current": 800}}')
    assert plan_of(["arm"], "--settings", str(given)).settings == {"mks-rs485@1": {"current": "800"}}


def test_a_bus_without_drives(tmp_path):
    (tmp_path / "servotap.toml").write_text('[bus.left]\nport = "p"\n')
    with pytest.raises(UsageError, match=r"left is a bus without drives: add a \[drive.NAME\] with bus = 'left'"):
        target.parse_all(["left"], [])


def test_from_python_a_name_brings_its_place_and_bounds(tmp_path):
    with pytest.raises(UsageError, match="left is a bus of several drives: name one of them"):
        servotap.drive("left")
    with servotap.drive("arm", "emulated") as drive:
        assert (drive.name, drive.emulated) == ("mks-rs485@1", True)
        with pytest.raises(ServotapError, match="above --max-speed 300"):
            drive.send("run_speed", direction="cw", speed=400, acceleration=200, allow=("motion", "unbounded"))
