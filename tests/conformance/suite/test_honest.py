"""Honest drives over a port, in real time: nothing is refuted, although shaft, line and adapter are those of the world."""

from __future__ import annotations

import pytest

from analyzer import dialects
from conformance import claims as registry
from conformance.drives import make
from conformance.motion import motion, resting
from conformance.safety import stopping
from conformance.suite.rig_emulated import EmulatedRig
from tests.conformance.drives.served import on_pty
from tests.conformance.suite.test_suite import main

#: Claims that noise would refute, by the end of their ids.
_TELLING = ("read_speed/at-rest", "read_position/clean", "shape/one-piece", "clear_errors/tells-state", "set_position/stands")


@pytest.mark.parametrize(("rpm", "stands"), [(0, True), (1, False), (-1, False)])
@pytest.mark.parametrize("drive", ["lk-rs485@1,real=poor", "mks-rs485@1,work_mode=sr_vfoc,real=poor", "mks-can@1,real=poor"])
def test_a_shaft_that_trembles_stands_and_one_that_creeps_along_does_not(drive, rpm, stands):
    each = EmulatedRig(make.parse(drive))
    probe = each.probe(next(c for c in registry.every(each.dialect) if resting.can_turn(each.dialect, c)))
    motion.ready_to_move(probe)
    if rpm:
        motion.run_at(probe, rpm, motion.QUICK)
        probe.wait(motion.SECOND_NS)
    assert (stopping.prove_standing(probe, 800 * motion.MS) == "") is stands


@pytest.mark.parametrize("drive", ["mks-rs485@1,work_mode=sr_vfoc,real=bench", "lk-rs485@1,real=poor,latency-timer=1ms"])
def test_an_honest_drive_on_a_port_is_not_accused(drive, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = drive.partition(",")[0]
    chosen = [c.id for c in registry.every(dialects.get(name.partition("@")[0])) if c.id.endswith(_TELLING)]
    named = [word for claim in chosen for word in ("--claim", claim)]
    allowed = ("--allow", "motion,setting", "--subdivision", "16", "--max-speed", "300")
    with on_pty(drive) as port:
        status = main(["test", name, "--on", f"serial:{port},baud={115200 if drive[:2] == 'lk' else 38400}", *allowed, *named])
    out, err = capsys.readouterr()
    assert status == 0, out + err
    assert "noise measured" in out
