"""A drive that falls silent in the middle of a run: it is said since when, and the run ends without accusing the drive."""

from __future__ import annotations

import pytest

from analyzer.catalogue import Risk
from conformance.claim import NotStopped, Outcome, Refuted
from conformance.suite import engine
from conformance.suite.rig_real import DriveSilent, LineFlooded
from tests.conformance.safety.test_keeper import EmulatedPort, claim

S = 1_000_000_000
MOVES = (Risk.MOTION, Risk.SETTING, Risk.TORQUE, Risk.UNBOUNDED)


class Cable:
    """What is on the line of a rig gets through while it is plugged in."""

    def __init__(self, rig, monkeypatch):
        self.plugged = True
        monkeypatch.setattr(type(rig.drives[0]), "listening", property(lambda drive: self.plugged))


@pytest.fixture
def rig(tmp_path):
    return EmulatedPort("mks-can@1,work_mode=bus_closed", tmp_path)


def accuses(probe):
    if not probe.ask("read_speed").answers:
        raise Refuted("read_speed is not answered")


def test_the_run_ends_soon_with_a_fault_of_the_rig(rig, monkeypatch, capsys):
    cable = Cable(rig, monkeypatch)
    assert engine.run_claim(claim(rig, accuses), rig).outcome is Outcome.CONFIRMED
    began_ns = rig.line.now_ns()
    cable.plugged = False
    with pytest.raises(DriveSilent, match=r"mks-can@1 is silent since \d\d:\d\d:\d\d, from read_speed on") as ended:
        engine.run_claim(claim(rig, accuses), rig)
    assert ended.value.exit_status == 10
    assert rig.line.now_ns() - began_ns < 25 * S
    rig.close()
    assert rig.line.now_ns() - began_ns < 30 * S
    assert capsys.readouterr().err.startswith("servotap: mks-can@1: silent since ")


def test_a_claim_that_asks_on_and_on_is_broken_off(rig, monkeypatch):
    cable = Cable(rig, monkeypatch)
    began_ns = rig.line.now_ns()

    def check(probe):
        cable.plugged = False
        while True:
            probe.ask("read_speed")

    with pytest.raises(DriveSilent):
        engine.run_claim(claim(rig, check), rig)
    assert rig.line.now_ns() - began_ns < 30 * S
    rig.close()


def test_a_claim_on_a_line_that_brings_more_than_any_line_is_broken_off(tmp_path, monkeypatch):
    rig = EmulatedPort("mks-rs485@1", tmp_path)
    monkeypatch.setattr(type(rig.line), "passed", property(lambda line: line.now_ns() // 1000))
    began_ns = rig.line.now_ns()

    def check(probe):
        while True:
            probe.ask("read_speed")

    with pytest.raises(LineFlooded, match=r"nothing can be judged: others send .* a line of 38400 bit/s brings 3840"):
        engine.run_claim(claim(rig, check), rig)
    assert 15 * S <= rig.line.now_ns() - began_ns < 17 * S
    rig.close()


def test_what_moved_cannot_be_proved_to_stand(rig, monkeypatch):
    cable = Cable(rig, monkeypatch)
    began_ns = rig.line.now_ns()

    def check(probe):
        probe.do("enable", {"enabled": 1})
        probe.ask("run_speed", {"direction": 1, "speed": 100, "acceleration": 0})
        cable.plugged = False
        accuses(probe)

    with pytest.raises(NotStopped) as ended:
        engine.run_claim(claim(rig, check, *MOVES), rig)
    assert ended.value.exit_status == 20
    rig.close()
    assert rig.line.now_ns() - began_ns < 60 * S


def test_a_drive_that_comes_back_is_judged(rig, monkeypatch):
    cable = Cable(rig, monkeypatch)
    sent = []

    def plug(t_ns, item):
        sent.append(t_ns)
        cable.plugged = t_ns - sent[0] > 8 * S

    def check(probe):
        rig.gate.on_sent.append(plug)
        accuses(probe)

    verdict = engine._once(claim(rig, check), rig)
    assert verdict.outcome is Outcome.REFUTED
    assert sent[-1] - sent[0] > 8 * S
    rig.close()


@pytest.mark.parametrize("part", ["_open_line", "_last"])
def test_ctrl_c_before_anything_was_changed_leaves_no_journal(part, tmp_path, monkeypatch):
    def interrupted(rig):
        raise KeyboardInterrupt

    monkeypatch.setattr(EmulatedPort, part, interrupted)
    with pytest.raises(KeyboardInterrupt):
        EmulatedPort("mks-can@1,work_mode=bus_closed", tmp_path).close()
    assert list(tmp_path.iterdir()) == []
