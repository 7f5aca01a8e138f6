"""Claims about state: walks on drives as the manual has them, on honest ones, and on those that lie in one state alone."""

from __future__ import annotations

from dataclasses import replace

import pytest

from conformance.claim import Outcome, Refuted, Theme
from conformance.drives import make
from conformance.drives.drive import Fault
from conformance.model import corners, route, story
from conformance.model.asides import Aside, aside
from conformance.model.steps import parse_steps, steps_text
from conformance.suite.rig_emulated import EmulatedRig
from tests.conformance import theme_runs

DRIVES = ("mks-rs485@1,model=42D", "mks-modbus@1,model=57D", "mks-can@1,model=42E", "lk-rs485@1,model=MF")
#: One of so many rows of a walk.
PART = 24


def walk(text, *, leg=1, legs=PART):
    """Do a part of a walk on a drive; return the probe."""
    rig = EmulatedRig(make.parse(text))
    probe = rig.probe(theme_runs.claims_of(Theme.STATE, rig)[0])
    story.check(probe, route.steps(probe.dialect, leg=leg, legs=legs))
    return probe


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("real", ["", ",real=bench", ",real=poor"])
def test_honest_drives_are_what_their_twins_are(drive, real):
    probe = walk(drive + real)
    assert probe.measured["steps"] > 10
    assert not probe.quirks


def test_a_walk_does_not_rest_on_the_unit_of_a_speed_limit():
    def in_whole_degrees(drive):
        hundredths = type(drive).limits.fget
        whole = property(lambda d: replace(hundredths(d), speed=100 * hundredths(d).speed))
        drive.__class__ = type("Whole", (type(drive),), {"limits": whole})
        drive.motor.limit(drive.limits)

    fault = Fault("whole", ("lk-rs485",), "0x20 counts deg/s", "its unit", lambda hooks: hooks.setup.append(in_whole_degrees))
    rig = EmulatedRig(replace(make.parse("lk-rs485@1,model=MF"), faults=(fault,)))
    probe = rig.probe(theme_runs.claims_of(Theme.STATE, rig)[0])
    story.check(probe, parse_steps("run_speed rpm=-600; read_state_2; stop"))
    assert probe.measured["steps"] == 3


@pytest.mark.parametrize("part", corners.PARTS)
@pytest.mark.parametrize("drive", ["mks-modbus@1,real=bench", "mks-can@1,real=poor"])
def test_honest_drives_are_what_their_twins_are_at_corners(drive, part):
    rig = EmulatedRig(make.parse(drive))
    probe = rig.probe(theme_runs.claims_of(Theme.STATE, rig, [f"corners/{part}"])[0])
    story.check(probe, corners.steps(probe.dialect, part))
    assert probe.measured["steps"] == len(list(corners.steps(probe.dialect, part)))


def test_a_frame_for_another_drive_is_not_for_the_group():
    rig = EmulatedRig(make.parse("mks-can@16,group_address=17"))
    probe = rig.probe(theme_runs.claims_of(Theme.STATE, rig)[0])
    assert aside(probe, Aside.OTHER_RUN, 17).id not in (16, 17)


#: Faults that show at a corner, and the part of the corners that it is in.
CORNERS = (
    ("mks-modbus", "slow-speed-tenfold", "speeds"),
    ("mks-can", "falling-pulses-full", "ends"),
    ("mks-can", "completion-missing-at-zero", "ends"),
    ("mks-can", "low-word-stops-fe", "numbers"),
    ("mks-modbus", "run-unstopped-by-fd", "stops"),
    ("mks-modbus", "enabling-takes-up", "switches"),
    ("mks-can", "emergency-without-check", "damage"),
)


@pytest.mark.parametrize(("dialect", "fault", "part"), CORNERS)
def test_a_fault_of_a_corner_is_refuted_there(dialect, fault, part):
    verdict = theme_runs.judge(f"{dialect}@1,fault={fault}", f"state/corners/{part}")
    assert verdict.outcome is Outcome.REFUTED
    assert len(verdict.steps) < 10


#: Faults that show in one state, or after one deed, and the steps that show them.
FAULTS = (
    ("mks-rs485", "speed-ignores-subdivision", "set_subdivision subdivision=128; run_speed rpm=60; look first=0 count=13"),
    (
        "mks-rs485",
        "disabled-moves",
        "enable enabled=0; move_relative_axis degrees=40 rpm=60 acceleration=248; look first=0 count=6",
    ),
    (
        "mks-modbus",
        "pulse-mode-moves",
        "set_work_mode work_mode=2; move_relative_axis degrees=40 rpm=60 acceleration=248; look first=0 count=6",
    ),
    ("mks-can", "subdivision-lost", "set_subdivision subdivision=64; restart; read_parameter parameter=132"),
    (
        "mks-rs485",
        "package-fourth-slot-unsigned",
        "move_relative_axis degrees=-40 rpm=60 acceleration=248 way=6; look first=1 count=1",
    ),
    ("mks-can", "ignores-group-stops", "set_group_address group_address=80; run_speed rpm=60; stop_speed acceleration=0 way=2"),
    (
        "mks-rs485",
        "end-untold-behind-group",
        "set_group_address group_address=80; move_relative_axis degrees=90 rpm=60 acceleration=248 aside=4",
    ),
    ("mks-can", "low-word-stops-fe", "move_absolute_pulses position=65536 rpm=200 acceleration=255 leave=1; read_status"),
    ("mks-can", "long-run-executed", "run_speed rpm=100 acceleration=255 spoiled=8; read_status"),
    ("mks-modbus", "broadcast-one-way", "run_speed rpm=-60 way=1; look first=0 count=6"),
    ("lk-rs485", "lk-off-still-moves", "motor_off; run_speed rpm=60; look first=0 count=8"),
)


@pytest.mark.parametrize(("dialect", "fault", "steps"), FAULTS)
def test_a_fault_of_one_state_is_refuted_by_a_few_steps(dialect, fault, steps):
    told = parse_steps(steps)
    assert steps_text(told) == steps
    for text, refuted in ((f"{dialect}@1", False), (f"{dialect}@1,fault={fault}", True)):
        rig = EmulatedRig(make.parse(text))
        probe = rig.probe(theme_runs.claims_of(Theme.STATE, rig)[0])
        if not refuted:
            story.check(probe, told)
            continue
        with pytest.raises(Refuted) as error:
            story.check(probe, told)
        assert 1 <= len(error.value.steps) <= len(told)
        assert steps_text(error.value.steps) in error.value.got
