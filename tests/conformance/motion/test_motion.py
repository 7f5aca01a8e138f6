"""Making a drive ready, watching it and bringing it to rest, in every dialect; journeys of the MKS drives."""

from __future__ import annotations

import pytest

from analyzer.catalogue import Risk, Verb
from conformance.claim import Claim, Inconclusive, Theme
from conformance.drives import make
from conformance.motion import motion
from conformance.motion import moves as journey
from conformance.suite.rig_emulated import EmulatedRig
from conformance.talk.probe import Probe

DRIVES = ("mks-rs485@1", "mks-modbus@1", "mks-can@1", "lk-rs485@1")
MKS = DRIVES[:3]


def probe_of(drive: str) -> Probe:
    """Return a probe of a new drive."""
    rig = EmulatedRig(make.parse(drive))
    name = rig.dialect.name
    return rig.probe(Claim(f"{name}/motion/test", Theme.MOTION, name, "It moves.", "1", "no motion", lambda probe: None))


@pytest.mark.parametrize("drive", DRIVES)
def test_a_drive_runs_at_the_speed_asked_for_and_comes_to_rest(drive):
    probe = probe_of(drive)
    motion.ready_to_move(probe)
    motion.run_at(probe, 60)
    probe.wait(motion.SECOND_NS)
    first = motion.position(probe)
    probe.wait(motion.SECOND_NS)
    rpm, spread = motion.speed_between(first, motion.position(probe))
    assert rpm == pytest.approx(60, abs=spread + 0.1)
    assert motion.speed(probe).value == pytest.approx(60, abs=1)
    end = motion.stand_still(probe)
    probe.wait(motion.SECOND_NS)
    assert motion.position(probe).value == pytest.approx(end.value, abs=motion.SAME)
    if Verb.READ_ENABLED in probe.dialect.by_verb:
        assert probe.read(Verb.READ_ENABLED) == 1


@pytest.mark.parametrize("drive", DRIVES)
def test_a_sample_says_when_it_held(drive):
    probe = probe_of(drive)
    before_ns = probe.gate.now_ns()
    sample = motion.position(probe)
    assert before_ns < sample.t_ns < probe.gate.now_ns()
    assert 0 < sample.spread_ns < 2 * motion.MS


@pytest.mark.parametrize("drive", MKS)
def test_a_work_mode_is_kept_where_the_bus_moves_the_motor_in_it(drive):
    probe = probe_of(drive)
    slowest = motion.bus_modes(probe.dialect)[0]
    motion.ready_to_move(probe, slowest)
    before = len(probe.traffic)
    motion.ready_to_move(probe)
    assert [e.command.name for e in probe.traffic[before:] if e.command is not None] == ["enable"]


def test_a_shaft_that_goes_on_is_inconclusive_and_not_waited_for_without_end():
    probe = probe_of("mks-rs485@1,fault=speed-stop-ignored")
    motion.ready_to_move(probe)
    motion.run_at(probe, 60)
    with pytest.raises(Inconclusive, match="does not come to rest within 5 s"):
        motion.stand_still(probe, limit_ns=5 * motion.SECOND_NS)


def test_the_risks_of_moving_are_those_of_what_is_sent():
    assert motion.risks(make.parse("lk-rs485@1").dialect) == {Risk.MOTION}
    assert motion.risks(make.parse("mks-can@1").dialect) == {Risk.MOTION, Risk.SETTING, Risk.TORQUE}
    assert motion.settings(make.parse("mks-modbus@1").dialect, "respond") == ("work_mode", "subdivision", "respond")


@pytest.mark.parametrize("drive", MKS)
@pytest.mark.parametrize("number", range(4))
def test_a_journey_goes_as_far_as_it_says(drive, number):
    probe = probe_of(drive)
    command = journey.moves(probe.dialect)[number]
    there, back = journey.pair(probe, command, 1000, -300)
    unit = 360 / journey.units_per_turn(command)
    assert abs(there.degrees) == pytest.approx(1000 * unit, abs=motion.SAME)
    assert abs(back.degrees) == pytest.approx(300 * unit, abs=motion.SAME)
    assert there.statuses == ([1, 2] if journey.tells(probe.dialect) else [])


def test_a_journey_from_a_place_that_no_move_reaches_is_inconclusive():
    probe = probe_of("mks-rs485@1")
    journey.prepare(probe)
    probe.drive.memory.zero = -(2**31)  # the encoder reads beyond what a move can be told
    with pytest.raises(Inconclusive, match="from where"):
        journey.travel(probe, probe.command(Verb.MOVE_ABSOLUTE_AXIS), 0.1)


def test_lk_has_no_journeys():
    assert not journey.is_mks(make.parse("lk-rs485@1").dialect)
    assert motion.can_move(make.parse("lk-rs485@1").dialect)
