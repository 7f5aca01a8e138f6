"""Chapters of the story of an MKS drive (`mks_story.py`) about motion: where it goes, how fast, what begins and ends it."""

from __future__ import annotations

from analyzer import dialects
from tests.conformance.drives.test_mks_rig import MS, SECOND

MODBUS = dialects.get("mks-modbus")


def reads_in_motion(open_story):
    story = open_story(protection=0)
    story.tell("run_speed", direction=1, speed=700, acceleration=255)
    story.wait(100 * MS, 3)
    story.tell("read_pulses")
    story.drive.block()
    story.wait(300 * MS)
    story.tell("read_angle_error")
    yield story


def runs(open_story):
    for mode, speed, acceleration, direction in (
        (5, 700, 250, 1), (4, 4000, 0, 0), (3, 500, 0, 1), (5, 3001, 0, 0), (5, 3000, 255, 0), (5, 4095, 0, 0),
    ):  # fmt: skip
        story = open_story(mode=mode)
        story.tell("run_speed", speed=speed, acceleration=acceleration, direction=direction)
        story.wait(SECOND, 8)
        story.tell("stop_speed", acceleration=acceleration)
        story.wait(SECOND, 8)
        yield story


def moves(open_story):
    for command, values in (
        ("move_relative_pulses", {"pulses": 32000, "direction": 0}), ("move_absolute_pulses", {"position": 5000}),
        ("move_relative_pulses", {"pulses": 70000, "direction": 1}), ("move_absolute_pulses", {"position": -5000}),
        ("move_relative_axis", {"position": 100_000}), ("move_relative_axis", {"position": -30_000}),
        ("move_absolute_axis", {"position": 40_000}), ("move_absolute_axis", {"position": -20_000}),
    ):  # fmt: skip
        for acceleration in (250, 0):
            story = open_story()
            story.drive.motor.jump(0, 2000)
            story.tell(command, speed=600, acceleration=acceleration, **values)
            story.wait(2 * SECOND, 6)
            story.wait(20 * SECOND)
            story.tell("read_position")
            story.tell("read_pulses")
            yield story
    story = open_story()
    for position in (-8388608, 8388607):
        story.tell("move_absolute_axis", speed=600, position=position)
    if story.dialect is MODBUS:
        story.tell("move_absolute_axis", speed=600, position=5, acceleration=256)
        story.wait(SECOND, 2)
    for speed in (2999, 3000, 3001, 5000):
        story.tell("move_absolute_axis", speed=speed, position=100_000)
    yield story
    story = open_story()
    story.tell("move_relative_axis", speed=0x803C, position=100_000)
    story.wait(SECOND, 4)
    yield story
    story = open_story(mode=3)
    story.tell("move_relative_axis", speed=600, position=100_000)
    story.wait(SECOND, 2)
    yield story


def stops(open_story):
    for move, stop, values in (
        ("move_relative_axis", "stop_relative_axis", {"position": 1_000_000}), ("run_speed", "stop_speed", {}),
        ("move_relative_axis", "emergency_stop", {"position": 1_000_000}), ("run_speed", "enable", {}),
        ("move_absolute_axis", "set_zero", {"position": 1_000_000}), ("run_speed", "emergency_stop", {}),
    ):  # fmt: skip
        for acceleration in (220, 0):
            story = open_story()
            story.tell(move, speed=600, acceleration=255, **values)
            story.wait(SECOND)
            story.tell(stop, **({"acceleration": acceleration} if stop.startswith("stop") else {}))
            story.wait(2 * SECOND, 10)
            story.wait(5 * SECOND)
            yield story


def updates(open_story):
    for command in ("move_absolute_axis", "move_relative_axis"):
        story = open_story()
        story.tell(command, speed=300, acceleration=254, position=100_000)
        story.wait(500 * MS)
        story.tell(command, speed=600, acceleration=254, position=200_000)
        story.wait(3 * SECOND, 20)
        story.tell("run_speed", speed=60)
        story.wait(20 * SECOND)
        yield story


def states(open_story):
    story = open_story()
    story.tell("enable", enabled=0)
    story.tell("read_enabled")
    story.tell("run_speed", speed=60)
    story.tell("move_relative_axis", speed=60, position=500)
    story.wait(SECOND, 2)
    story.drive.turn_shaft(50)
    story.tell("read_position")
    story.tell("enable", enabled=1)
    story.drive.turn_shaft(50)
    story.tell("read_position")
    yield story
    for tolerance in (None, 50):
        story = open_story(protection=1, **({"stall_tolerance": 100} if story.name == "mks-can" else {}))
        if tolerance is not None:
            story.tell("set_stall_tolerance", stall_tolerance=tolerance)
        story.tell("run_speed", speed=60)
        story.wait(100 * MS)
        story.drive.block()
        for _ in range(8):
            story.wait(100 * MS, 1)
            story.tell("read_protection")
        story.drive.block(False)
        story.tell("run_speed", speed=60)
        story.wait(100 * MS, 1)
        story.tell("release_protection")
        story.tell("read_protection")
        story.tell("run_speed", speed=60)
        story.wait(100 * MS, 1)
        yield story
    for mode in (2, 0, 3):
        story = open_story(mode=mode)
        story.tell("run_speed", speed=60)
        story.tell("enable", enabled=0)
        story.wait(100 * MS, 1)
        yield story
    story = open_story()
    story.tell("set_direction", motor_direction=1)
    story.tell("run_speed", speed=60)
    story.wait(100 * MS, 1)
    story.tell("set_work_mode", work_mode=2)
    story.tell("run_speed", speed=60)
    yield story


def subdivisions(open_story):
    for subdivision in (8, 32, 128, 0):
        story = open_story()
        story.tell("set_subdivision", subdivision=subdivision)
        story.tell("run_speed", speed=400)
        story.wait(100 * MS, 2)
        story.tell("emergency_stop")
        story.tell("move_relative_pulses", speed=400, pulses=400)
        story.wait(5 * SECOND, 3)
        yield story


def homing(open_story):
    for direction, speed, trigger in ((0, 120, 0), (1, 600, 0), (0, 600, 1), (0, 30, 0)):
        story = open_story()
        story.tell("set_home", home_direction=direction, home_speed=speed, home_trigger=trigger)
        story.drive.place_switch("left", -10_000 if direction == 0 else 10_000)
        story.tell("home")
        story.wait(SECOND, 10)
        story.wait(20 * SECOND)
        story.tell("read_position")
        story.tell("read_pulses")
        story.tell("read_enabled")
        yield story
    for closed in (True, False):
        story = open_story(home_speed=300)
        story.drive.place_switch("left", 3000 if closed else -3000)
        story.tell("home")
        story.wait(SECOND, 6)
        yield story
    story = open_story(home_speed=60, home_mode=1, return_angle=0x4000)
    story.drive.obstruct("left", -5000)
    story.tell("home")
    story.wait(2 * SECOND, 10)
    yield story


def limits(open_story):
    story = open_story()
    story.drive.place_switch("left", -5000)
    story.drive.place_switch("right", 20_000)
    story.tell("set_home", home_speed=600, end_limit=1)
    story.tell("set_limit_remap", limit_remap=1)
    story.tell("home")
    story.wait(5 * SECOND)
    story.tell("read_enabled")
    story.drive.turn_shaft(100)
    story.tell("read_position")
    story.tell("enable", enabled=1)
    story.tell("move_relative_axis", speed=600, position=100_000)
    story.wait(5 * SECOND, 5)
    story.tell("move_relative_axis", speed=600, position=-1000)
    story.wait(SECOND)
    story.tell("move_relative_axis", speed=600, position=-3000)
    story.wait(SECOND, 1)
    story.tell("run_speed", speed=600)
    story.wait(SECOND, 2)
    yield story


def saved_runs(open_story):
    for state in (0xC8, 0xCA):
        story = open_story()
        story.tell("run_speed", speed=120, direction=1)
        story.tell("save_speed", save_state=0xC8)
        story.tell("save_speed", save_state=state)
        story.tell("save_speed", save_state=0xC9)
        story.tell("restart")
        story.wait(5 * SECOND)
        story.wait(100 * MS, 2)
        yield story


def zero_modes(open_story):
    for mode, direction in ((1, 0), (1, 1), (2, 0)):
        story = open_story()
        story.tell("set_zero_mode", zero_mode=mode, set_zero=1, zero_speed=0, zero_direction=direction)
        story.tell("move_relative_axis", speed=600, position=5000)
        story.wait(SECOND)
        story.drive.power_cycle(story.now)
        for _ in range(6):
            story.wait(400 * MS, 1)
            story.tell("read_zero_status")
        yield story


def calibration(open_story):
    story = open_story()
    story.tell("calibrate")
    story.wait(6 * SECOND, 6)
    story.wait(20 * SECOND, 2)
    yield story


def conditions(open_story):
    """Fast and rising shafts and their stops, checks that do not fit, another subdivision and speed after a restart."""
    for acceleration, wait in ((0, 100 * MS), (1, 600 * MS)):
        story = open_story(subdivision=128)
        story.tell("run_speed", direction=1, speed=3000, acceleration=0)
        story.tell("emergency_stop")
        story.tell("set_subdivision", subdivision=16)
        story.tell("read_encoder_carry")
        story.tell("read_pulses")
        story.tell("run_speed", direction=1, speed=1500, acceleration=acceleration)
        story.wait(wait, 3)
        for command in ("read_enabled", "read_protection", "read_encoder_carry", "read_pulses", "read_angle_error"):
            story.tell(command)
        story.tell("enable", enabled=1)
        story.tell("save_speed", save_state=0xC8)
        story.wait(100 * MS, 2)
        story.tell("emergency_stop")
        story.wait(100 * MS, 2)
        story.tell("stop_speed", direction=0, speed=0, acceleration=0)
        story.wait(100 * MS, 2)
        for command in ("read_angle_error", "set_zero", "read_position", "read_encoder_carry"):
            story.tell(command)
        story.tell(
            "move_relative_pulses",
            direction=0,
            speed=300,
            acceleration=0,
            pulses=0xF0_0000 << (0 if story.name == "mks-can" else 8),
        )
        story.wait(300 * MS, 2)
        story.tell("set_direction", motor_direction=1)
        story.tell("move_absolute_pulses", speed=300, acceleration=0, position=5000)
        story.wait(SECOND, 2)
        for _ in range(2):
            story.drive.power_cycle(story.now)
            story.wait(400 * MS, 4)
        story.tell("stop_speed", direction=0, speed=0, acceleration=0)
        story.tell("set_subdivision", subdivision=128)
        story.tell("run_speed", direction=0, speed=800, acceleration=0)
        story.wait(200 * MS, 2)
        yield story
