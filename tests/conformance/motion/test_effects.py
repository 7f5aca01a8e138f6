"""Observable effects: each dialect's is seen where it is executed, and not seen where it is not."""

from __future__ import annotations

import pytest

from conformance.claim import Inconclusive, Refuted
from conformance.motion import effects
from tests.conformance.motion.probes import probe_of

DRIVES = {
    "mks-rs485@1": "move_relative_axis",
    "mks-modbus@1": "move_relative_axis",
    "mks-can@1": "write_user_id",
    "lk-rs485@1": "set_position",
}


@pytest.mark.parametrize(("drive", "command"), DRIVES.items())
def test_a_change_is_seen_once_it_is_executed(drive, command):
    probe = probe_of(drive)
    effect = effects.observable(probe.dialect)
    effect.prepare(probe)
    change = effect.change(probe)
    assert change.command.name == effect.command.name == command
    assert not effect.done(probe, change)
    probe.do(change.command, change.values)
    assert effect.done(probe, change)
    assert not effect.is_done(effect.read(probe), change.undone)


def test_another_effect_refutes():
    probe = probe_of("mks-can@1")
    effect = effects.observable(probe.dialect)
    change = effect.change(probe)
    probe.do(change.command, {"user_id": 7})
    with pytest.raises(Refuted, match="another effect"):
        effect.done(probe, change)


def test_a_drive_that_executes_nothing_proves_nothing():
    probe = probe_of("mks-rs485@1,fault=disabled-moves")
    effect = effects.observable(probe.dialect)
    with pytest.raises(Inconclusive):
        effect.control(probe)
