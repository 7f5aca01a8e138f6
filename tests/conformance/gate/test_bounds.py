"""Bounds: the speed, distance and acceleration of a frame's motion, and refusals where they are unknown."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

import pytest

from analyzer import dialects
from analyzer.catalogue import Command, Motion, MotionKind, Risk, Verb, always
from analyzer.encoder import build
from analyzer.layout import Layout, i32, u16
from conformance.bus.emulated import EmulatedLine
from conformance.drives import make
from conformance.gate.bounds import Bounds, Leeway
from conformance.gate.budget import Budget
from conformance.gate.gate import Allowance, Gate, Judge
from conformance.model import strategies
from tests.conformance.vectors import EVERYTHING, on_can

MKS, MODBUS, CAN, LK = (dialects.get(n) for n in ("mks-rs485", "mks-modbus", "mks-can", "lk-rs485"))
MF = LK.for_model("MF")
SECOND_NS = 1_000_000_000


def judge(*, dialect: Any = None, **bounds: Any) -> Judge:
    return Judge(Allowance(EVERYTHING, alone=True, **bounds), None if dialect is None else [dialect])


def refusal(given: Judge, dialect: Any, command: str, **values: int) -> str:
    if command.startswith("move_") and dialect is not LK:
        # With zeros alone it would be a stop.
        values = {"speed": 5} | values
    frame = build(dialect, command, 1, values)
    found = given.objections(frame if dialect.bus == "serial" else on_can(1, frame))
    return "; ".join(reason for o in found for reason in o.reasons)


# --- speed ------------------------------------------------------------------------------------------------------------


def test_an_unknown_subdivision_counts_as_1():
    bounded = judge(speed=320)
    assert refusal(bounded, MKS, "run_speed", speed=20, acceleration=2) == ""
    told = refusal(bounded, MKS, "run_speed", speed=21, acceleration=2)
    assert "up to 336 rpm while the subdivision is not known" in told
    assert "--subdivision" in told


@pytest.mark.parametrize(
    ("subdivision", "sent", "rpm"),
    [(16, 300, 300), (32, 300, 300), (64, 300, 300), (8, 150, 300), (128, 2400, 300), (0, 3000, 187)],
)
def test_real_rpm_by_the_subdivision(subdivision: int, sent: int, rpm: int):
    bounded = judge(speed=rpm + 1)
    bounded.known.note_subdivision(subdivision)
    assert refusal(bounded, MKS, "run_speed", speed=sent, acceleration=2) == ""
    bounded = judge(speed=rpm - 1)
    bounded.known.note_subdivision(subdivision)
    assert "above --max-speed" in refusal(bounded, MKS, "run_speed", speed=sent, acceleration=2)


def test_the_bound_is_what_the_emulated_drive_does():
    # What the gate takes for the real rpm is what a drive does that was told the same.
    for subdivision in (1, 8, 16, 100, 256):
        drive = make.make(make.parse(f"mks-rs485@1,work_mode=sr_vfoc,subdivision={subdivision % 256}"))
        gate = Gate(EmulatedLine([drive]), Allowance(EVERYTHING, subdivision=subdivision))
        item = build(MKS, "run_speed", 1, {"speed": 30, "acceleration": 0})
        expected = gate.rehearsal().known.rpm(gate.interpret(item)[0])
        gate.send(item)
        gate.wait(SECOND_NS)
        before = float(drive.axis)
        gate.wait(SECOND_NS)
        assert (float(drive.axis) - before) * 60 / 16384 == pytest.approx(expected, rel=0.01)


def test_a_subdivision_that_is_sent_may_be_or_may_not():
    bounded = judge(speed=320, subdivision=16)
    frame = build(MKS, "set_subdivision", 1, {"subdivision": 4})
    bounded.admit(frame)
    assert "1200 rpm" in refusal(bounded, MKS, "run_speed", speed=300, acceleration=2)
    assert refusal(bounded, MKS, "run_speed", speed=80, acceleration=2) == ""
    bounded.known.note_subdivision(16, 1)
    assert refusal(bounded, MKS, "run_speed", speed=300, acceleration=2) == ""


def test_a_subdivision_that_is_sent_to_all_may_be_that_of_a_drive_addressed_later():
    bounded = judge(speed=320, subdivision=16)
    bounded.admit(build(MKS, "set_subdivision", 0, {"subdivision": 1}))
    assert "above --max-speed" in refusal(bounded, MKS, "run_speed", speed=300, acceleration=2)


def test_lk_speeds_are_in_degrees():
    bounded = judge(speed=60)
    assert refusal(bounded, LK, "run_speed", speed=36000) == ""
    assert "61 rpm" in refusal(bounded, LK, "run_speed", speed=-36600)
    assert refusal(bounded, LK, "move_increment_limited", position=100, max_speed=36000) == ""
    assert "60.0" in refusal(bounded, LK, "move_increment_limited", position=100, max_speed=36020)


@pytest.mark.parametrize(
    ("command", "values"),
    [
        ("move_increment", {"position": 100}), ("move_multi_turn", {"position": 100}), ("move_single_turn", {"angle": 100}),
        ("run_torque", {"torque_current": 1}), ("run_open_loop", {"power": 1}),
        ("move_increment_limited", {"position": 100, "max_speed": 0}),
    ],
)  # fmt: skip
def test_a_speed_that_is_not_in_the_frame_is_refused(command: str, values: dict[str, int]):
    assert "its speed cannot be told" in refusal(judge(speed=60), LK, command, **values)


def test_homing_is_bounded_by_the_speed_that_was_set():
    bounded = judge(speed=100, subdivision=16)
    assert "set_home says it" in refusal(bounded, MKS, "home")
    assert "above --max-speed" in refusal(bounded, MKS, "set_home", home_speed=200)
    bounded.admit(build(MKS, "set_home", 1, {"home_speed": 60}))
    assert refusal(bounded, MKS, "home") == ""


def test_what_is_no_motion_has_no_speed():
    bounded = judge(speed=1, turns=0.001, acceleration=1)
    for command, values in (("read_speed", {}), ("enable", {"enabled": 1}), ("set_direction", {}), ("set_work_mode", {})):
        assert refusal(bounded, MKS, command, **values) == ""


@pytest.mark.parametrize("dialect", [MKS, MODBUS, CAN], ids=lambda d: d.name)
def test_a_stop_is_never_bounded(dialect: Any):
    bounded = judge(speed=1, turns=0.001, acceleration=1, current=1)
    for command in dialect.commands:
        if command.name.startswith("stop_"):
            assert refusal(bounded, dialect, command.name, acceleration=0) == ""
    assert refusal(bounded, LK, "stop") == ""
    assert refusal(bounded, dialect, "emergency_stop") == ""


# --- turns ------------------------------------------------------------------------------------------------------------


def test_relative_moves_by_their_length():
    bounded = judge(turns=2)
    assert refusal(bounded, MKS, "move_relative_axis", position=2 * 16384) == ""
    assert "2.25 turns" in refusal(bounded, MKS, "move_relative_axis", position=-9 * 4096)
    assert refusal(bounded, LK, "move_increment", position=72000) == ""
    assert "2.5 turns" in refusal(bounded, LK, "move_increment", position=-90000)
    # Pulses: at an unknown subdivision, 200 are a turn.
    assert refusal(bounded, MKS, "move_relative_pulses", pulses=400) == ""
    assert "turns" in refusal(bounded, MKS, "move_relative_pulses", pulses=401)
    bounded.known.note_subdivision(16)
    assert refusal(bounded, MKS, "move_relative_pulses", pulses=6400) == ""
    assert "2.5 turns" in refusal(bounded, MKS, "move_relative_pulses", pulses=8000)


def test_absolute_moves_need_to_know_where_the_drive_is():
    bounded = judge(turns=2)
    assert "without the drive's position" in refusal(bounded, MKS, "move_absolute_axis", position=0)
    bounded.known.note_position(720.0, 1)
    assert refusal(bounded, MKS, "move_absolute_axis", position=0) == ""
    assert refusal(bounded, MKS, "move_absolute_axis", position=4 * 16384) == ""
    assert "2.5 turns" in refusal(bounded, MKS, "move_absolute_axis", position=-8192)
    assert "without" in refusal(bounded, MKS, "move_absolute_pulses", position=0)
    bounded.known.note_position(0.0, 1, pulses=3200)
    bounded.known.note_subdivision(16, 1)
    assert refusal(bounded, MKS, "move_absolute_pulses", position=-3200) == ""
    assert "turns" in refusal(bounded, MKS, "move_absolute_pulses", position=-3201)
    bounded.known.note_position(360.0, 1)
    assert refusal(bounded, LK, "move_multi_turn", position=108000) == ""
    assert "turns" in refusal(bounded, LK, "move_multi_turn", position=108100)


def test_a_move_that_left_may_have_been_made_or_not():
    bounded = judge(turns=2)
    bounded.known.note_position(0.0, 1)
    bounded.admit(build(MKS, "move_relative_axis", 1, {"speed": 1, "position": 16384}))
    # It stands somewhere from 0 to 360 degrees.
    assert refusal(bounded, MKS, "move_absolute_axis", position=16384) == ""
    assert "2.5 turns" in refusal(bounded, MKS, "move_absolute_axis", position=16384 * 5 // 2)
    assert refusal(bounded, MKS, "move_absolute_axis", position=2 * 16384) == ""


@pytest.mark.parametrize("command", ["run_speed", "home", "set_zero", "restart", "enable", "calibrate"])
def test_after_these_nobody_knows_where_it_is(command: str):
    bounded = judge(turns=2)
    bounded.known.note_position(0.0, 1)
    bounded.admit(build(MKS, command, 1, {"speed": 1} if command == "run_speed" else {}))
    assert "without the drive's position" in refusal(bounded, MKS, "move_absolute_axis", position=0)


def test_within_one_turn_it_is_one_turn():
    assert refusal(judge(turns=1), LK, "move_single_turn", angle=1) == ""
    assert "1 turns" in refusal(judge(turns=0.9), LK, "move_single_turn", angle=1)


def test_a_run_is_what_unbounded_says():
    assert refusal(judge(turns=1), MKS, "run_speed", speed=10) == ""


# --- acceleration and current -----------------------------------------------------------------------------------------


def test_acceleration():
    bounded = judge(acceleration=200)
    assert refusal(bounded, MKS, "run_speed", speed=10, acceleration=200) == ""
    assert "acceleration 201, above" in refusal(bounded, MKS, "run_speed", speed=10, acceleration=201)
    assert "at once" in refusal(bounded, MKS, "run_speed", speed=10, acceleration=0)
    assert "at once" in refusal(bounded, CAN, "move_relative_axis", speed=10, position=5)


def test_current():
    bounded = judge(current=1500)
    assert refusal(bounded, MKS, "set_current", current=1500) == ""
    assert "current 1501 mA, above" in refusal(bounded, MKS, "set_current", current=1501)
    assert "home_current" in refusal(bounded, MKS, "set_no_limit_home", home_current=1600)
    assert "not known without the drive's model" in refusal(bounded, LK, "run_torque", torque_current=1)
    bounded = judge(current=1500, dialect=MF)
    assert refusal(bounded, MF, "run_torque", torque_current=180) == ""
    assert "torque_current 1611.33 mA" in refusal(bounded, MF, "run_torque", torque_current=-200)
    assert "torque_limit in mA is not known" in refusal(bounded, MF, "write_parameter", parameter=30, torque_limit=5)


# --- all ways to say it -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dialect", [MKS, MODBUS, CAN], ids=lambda d: d.name)
def test_bounds_hold_in_every_dialect_and_wrapping(dialect: Any):
    bounded = judge(speed=100, subdivision=16, turns=1, acceleration=100)
    values = {"speed": 101, "acceleration": 101, "position": 16385}
    told = refusal(bounded, dialect, "move_relative_axis", **values)
    for bound in ("--max-speed", "--max-turns", "--max-acceleration"):
        assert bound in told
    assert refusal(bounded, dialect, "move_relative_axis", speed=100, acceleration=100, position=-16384) == ""


def test_a_package_and_a_cut_frame_are_bounded():
    bounded = judge(speed=100, subdivision=16)
    slot = {"address": 1, "command": "run_speed", "speed": 101, "acceleration": 1}
    package = build(MKS, "long_package", 0, {"slots": [slot]})
    assert any("above --max-speed" in r for o in bounded.objections(package) for r in o.reasons)
    run = build(MKS, "run_speed", 1, {"speed": 50, "acceleration": 1})
    assert bounded.objections(run) == []
    # The speed of a frame that is cut off could still be any.
    assert any("cannot be told" in r for o in bounded.objections(run[:4]) for r in o.reasons)


# --- motion that the catalogue does not declare -----------------------------------------------------------------------

_TURNS = Command(
    name="spin_turns", verb=Verb.SAVE_SPEED, code=0x55, section="", summary="", risk=(always(Risk.MOTION),),
    request=Layout(u16("turns"), u16("speed", unit="rpm")), reply=Layout(),
)  # fmt: skip


@pytest.mark.parametrize("bound", ["speed", "turns", "acceleration", "current"])
def test_a_motion_that_is_not_declared_is_beyond_every_bound(bound: str):
    # Its length and its speed are unknown; the names of its verb and fields say nothing.
    dialect = replace(MKS, commands=(*MKS.commands, _TURNS))
    assert refusal(judge(dialect=dialect), dialect, "spin_turns", turns=50, speed=1) == ""
    assert "not in the catalogue" in refusal(judge(dialect=dialect, **{bound: 0.1}), dialect, "spin_turns", turns=50, speed=1)
    budget = judge(dialect=dialect, budget=Budget(turns=1000))
    assert "how far it turns cannot be told" in refusal(budget, dialect, "spin_turns", turns=50)


def test_a_motion_that_is_declared_is_bounded_whatever_its_verb():
    motion = Motion(kind=MotionKind.MOVE_BY, speed="speed", distance="turns")
    declared = replace(
        _TURNS, motion=motion, request=Layout(i32("turns", unit="deg", scale=Fraction(1, 100)), u16("speed", unit="rpm"))
    )
    dialect = replace(MKS, commands=(*MKS.commands, declared))
    bounded = judge(dialect=dialect, turns=2, speed=100, subdivision=16)
    assert refusal(bounded, dialect, "spin_turns", turns=72000, speed=100) == ""
    assert "2.5 turns" in refusal(bounded, dialect, "spin_turns", turns=-90000, speed=100)
    assert "101 rpm" in refusal(bounded, dialect, "spin_turns", turns=1, speed=101)


def test_what_a_motion_is_not_declared_for_is_never_drawn():
    dialect = replace(MKS, commands=(_TURNS,))
    assert not strategies.requests(dialect, {Risk.MOTION}, Leeway()).is_empty
    assert strategies.requests(dialect, {Risk.MOTION}, Leeway(Bounds(current=1))).is_empty
