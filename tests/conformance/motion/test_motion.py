"""Making a drive ready, asking it for motion, watching it and bringing it to rest, in every dialect."""

from __future__ import annotations

import pytest

from analyzer.catalogue import Risk, Verb
from conformance.claim import Claim, Inconclusive, Theme
from conformance.drives import make
from conformance.gate.permissions import Allowance
from conformance.motion import arriving, declared, motion
from conformance.motion.declared import FORCE, MOVES, SAME
from conformance.suite.rig_emulated import EmulatedRig
from conformance.talk.probe import MS, SECOND_NS
from tests.conformance.motion.probes import probe_of

DRIVES = ("mks-rs485@1", "mks-modbus@1", "mks-can@1", "lk-rs485@1")
MKS = DRIVES[:3]


@pytest.mark.parametrize("drive", DRIVES)
def test_a_drive_runs_at_the_speed_asked_for_and_comes_to_rest(drive):
    probe = probe_of(drive)
    motion.ready_to_move(probe)
    motion.run_at(probe, 60)
    probe.wait(SECOND_NS)
    first = motion.position(probe)
    probe.wait(SECOND_NS)
    rpm, spread = motion.speed_between(first, motion.position(probe))
    assert rpm == pytest.approx(60, abs=spread + 0.1)
    assert motion.speed(probe).value == pytest.approx(60, abs=1)
    end = motion.stand_still(probe)
    probe.wait(SECOND_NS)
    assert motion.position(probe).value == pytest.approx(end.value, abs=SAME)
    if Verb.READ_ENABLED in probe.dialect.by_verb:
        assert probe.read(Verb.READ_ENABLED) == 1


@pytest.mark.parametrize("drive", DRIVES)
def test_a_sample_says_when_it_held(drive):
    probe = probe_of(drive)
    before_ns = probe.gate.now_ns()
    sample = motion.position(probe)
    assert before_ns < sample.t_ns < probe.gate.now_ns()
    assert 0 < sample.spread_ns < 2 * MS


@pytest.mark.parametrize("drive", MKS)
def test_a_work_mode_is_kept_where_the_bus_moves_the_motor_in_it(drive):
    probe = probe_of(drive)
    slowest = declared.bus_modes(probe.dialect)[0]
    motion.ready_to_move(probe, slowest)
    before = len(probe.traffic)
    motion.ready_to_move(probe)
    assert [e.command.name for e in probe.traffic[before:] if e.command is not None] == ["enable"]


def test_a_shaft_that_goes_on_is_inconclusive_and_not_waited_for_without_end():
    probe = probe_of("mks-rs485@1,fault=speed-stop-ignored")
    motion.ready_to_move(probe)
    motion.run_at(probe, 60)
    with pytest.raises(Inconclusive, match="goes on at 60 rpm after it was told to stop"):
        motion.stand_still(probe, limit_ns=5 * SECOND_NS)


def test_the_risks_of_moving_are_those_of_what_is_sent():
    assert declared.risks(make.parse("lk-rs485@1").dialect) == {Risk.MOTION}
    assert declared.risks(make.parse("mks-can@1").dialect) == {Risk.MOTION, Risk.SETTING, Risk.TORQUE}
    assert declared.settings(make.parse("mks-modbus@1").dialect, "respond") == ("work_mode", "subdivision", "respond")


def _moves() -> list[tuple[str, str]]:
    return [(drive, c.name) for drive in DRIVES for c in make.parse(drive).dialect.motions(*MOVES)]


@pytest.mark.parametrize(("drive", "name"), _moves())
def test_a_move_goes_as_far_as_it_was_asked_to(drive, name):
    probe = probe_of(drive)
    command = probe.command(name)
    motion.prepare(probe, command)
    there, back = arriving.follow(probe, command, 111.1), arriving.follow(probe, command, -33.3)
    near = declared.near(probe.dialect)
    assert there.asked == pytest.approx(111.1, abs=0.06)
    assert abs(there.degrees) == pytest.approx(there.asked, abs=near)
    assert back.degrees == pytest.approx(back.asked * there.degrees / there.asked, abs=near)
    assert there.statuses == ([1, 2] if arriving.tells_end(probe.dialect) else [])


def test_what_is_sent_is_in_the_units_of_each_command():
    mks, lk = make.parse("mks-rs485@1").dialect, make.parse("lk-rs485@1").dialect
    how = {"rpm": 60, "acceleration": 7}

    def values(dialect, name, degrees, **more):
        return declared.values_of(dialect, dialect.by_name[name], degrees, **how | more)

    assert values(mks, "run_speed", 0, rpm=-60) == {"direction": 1, "speed": 60, "acceleration": 7}
    pulses = {"speed": 60, "acceleration": 7, "direction": 1, "pulses": 800}
    assert values(mks, "move_relative_pulses", -90) == pulses
    assert values(mks, "move_relative_pulses", -90, subdivision=256) == pulses | {"speed": 960, "pulses": 12_800}
    assert values(mks, "move_relative_axis", -90) == {"speed": 60, "acceleration": 7, "position": -4096}
    assert values(mks, "move_absolute_axis", 90, start=1000) == {"speed": 60, "acceleration": 7, "position": 5096}
    assert values(lk, "run_speed", 0, rpm=-60) == {"speed": -36_000}
    assert values(lk, "move_increment_limited", -90) == {"position": -9_000, "max_speed": 36_000}
    assert values(lk, "move_single_turn", -90, start=1_000) == {"direction": 1, "angle": 28_000}
    assert values(lk, "run_torque", 90) == {"torque_current": FORCE}


def test_a_move_from_a_place_that_no_move_reaches_is_inconclusive():
    probe = probe_of("mks-rs485@1")
    motion.ready_to_move(probe)
    probe.drive.memory.zero = -(2**31)  # the encoder reads beyond what a move can be told
    with pytest.raises(Inconclusive, match="from where"):
        arriving.follow(probe, probe.command(Verb.MOVE_ABSOLUTE_AXIS), 36)


def test_a_target_whose_bytes_begin_another_frame_is_asked_for_beside_it():
    rig = EmulatedRig(make.parse("lk-rs485@1,model=MS"), allowance=Allowance(frozenset({Risk.READ, Risk.MOTION})))
    name = rig.dialect.name
    risks = frozenset({Risk.MOTION})
    probe = rig.probe(Claim(f"{name}/motion/test", Theme.MOTION, name, "x", "", "x", lambda probe: None, risks=risks))
    # 77FB, low byte first, is the head and the address of a reply; the rest fits a frame.
    command, angle = probe.command("move_single_turn_limited"), 0x77FB
    exchange = motion.ask(probe, command, angle / 100, rpm=60, start=0)
    assert exchange.values["angle"] == angle - 3
    assert motion.wait_standing(probe).value == pytest.approx((angle - 3) / 100, abs=0.02)
