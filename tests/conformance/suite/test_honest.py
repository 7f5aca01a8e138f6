"""Honest drives over a port, in real time: nothing is refuted, although shaft, line and adapter are those of the world."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from analyzer import dialects
from conformance import claims as registry
from conformance.drives import make
from conformance.drives.can_bus import CanBus
from conformance.motion import motion, resting
from conformance.safety import stopping
from conformance.serve.can import CanPort
from conformance.suite.rig_emulated import EmulatedRig
from tests.conformance.drives.served import Bridge, drives, on_can, on_pty
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


@contextmanager
def served(drive: str) -> Iterator[str]:
    """Serve a drive on a pseudo-terminal, a CAN drive behind an slcan adapter; yield the endpoint."""
    if not drive.startswith("mks-can"):
        with on_pty(drive) as port:
            yield f"serial:{port},baud={115200 if drive.startswith('lk') else 38400}"
        return
    bridge = Bridge()
    try:
        port = CanPort("slcan", bridge.paths[1], sleep_after_open=0, bitrate=500000)
        with on_can(CanBus(drives(drive), speed=port.bitrate), port):
            yield f"can:slcan:{bridge.paths[0]},bitrate=500000,sleep_after_open=0"
    finally:
        bridge.close()


@pytest.mark.parametrize(
    "drive",
    [
        "mks-rs485@1,work_mode=sr_vfoc,real=bench",
        "mks-modbus@1,work_mode=sr_vfoc,real=bench,clock=+1%",
        "mks-can@1,real=bench,clock=-1%",
        "lk-rs485@1,real=poor,latency-timer=1ms",
    ],
)
def test_an_honest_drive_on_a_port_is_not_accused(drive, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = drive.partition(",")[0]
    chosen = [c.id for c in registry.every(dialects.get(name.partition("@")[0])) if c.id.endswith(_TELLING)]
    named = [word for claim in chosen for word in ("--claim", claim)]
    allowed = ("--allow", "motion,setting", "--subdivision", "16", "--max-speed", "300")
    with served(drive) as endpoint:
        status = main(["test", name, "--on", endpoint, *allowed, *named])
    out, err = capsys.readouterr()
    assert status == 0, out + err
    assert "noise measured" in out
