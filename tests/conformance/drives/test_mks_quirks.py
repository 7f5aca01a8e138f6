"""Every quirk shows to a host, and is as it was seen on a real drive."""

from __future__ import annotations

import pytest

from conformance.drives.mks.quirks import QUIRKS
from tests.conformance.drives.mks_story import MODBUS, differs
from tests.conformance.drives.test_mks_rig import MS, NAMES, SECOND, Rig, make

QUIRKY = [(quirk, name) for quirk in QUIRKS for name in NAMES if name in quirk.dialects]


@pytest.mark.parametrize(("quirk", "name"), QUIRKY, ids=[f"{q.name}-{n}" for q, n in QUIRKY])
def test_a_quirk_changes_what_is_seen(quirk, name):
    assert differs(name, quirks=(quirk,))


def quirky(name, quirk, **options):
    return Rig(make(name, quirks=[q for q in QUIRKS if q.name == quirk], **options))


def test_the_later_manuals_register_94h():
    frame = bytes.fromhex("01 10 00 94 00 04 08 00 00 20 00 00 00 02 58 83 ce")
    rig = quirky("mks-modbus", "register-94h", home_mode=1)
    (said,) = rig.send(frame)
    assert said.data == MODBUS.link.completed(bytes.fromhex("01 10 00 94 00 04"))
    assert (rig.drive.settings["return_angle"], rig.drive.settings["home_mode"]) == (0x2000, 0)
    assert rig.drive.settings["home_current"] == 600
    assert Rig("mks-modbus").send(frame)[0].data[1] == 0x90


def test_the_can_drive_that_was_seen():
    rig = quirky("mks-can", "version-cal-1")
    (said,) = rig.send_at("read_version")
    assert said.data[:-1] == bytes.fromhex("40 92 01 00 01")
    rig = quirky("mks-can", "settling")
    rig.ask("move_relative_axis", speed=600, acceleration=250, position=4096)
    (done,) = rig.wait(SECOND)
    rig = quirky("mks-can", "settling")
    rig.send_at("move_relative_axis", speed=600, acceleration=250, position=4096)
    rig.wait(done.at_ns + MS)
    assert rig.axis() == 4082
    rig.wait(SECOND)
    assert rig.axis() == 4096


def test_what_the_report_on_a_42d_saw():
    rig = quirky("mks-rs485", "reversed-direction")
    rig.ask("run_speed", direction=0, speed=60)
    assert rig.value("read_speed") == -60
    rig = quirky("mks-rs485", "calibration-answers-1")
    assert rig.ask("calibrate") == [{"status": 1}]
    rig.wait(9 * SECOND)
    assert rig.value("read_status") == 6
    assert rig.wait(2 * SECOND) == []
    assert rig.value("read_status") == 1
    rig = quirky("mks-rs485", "hasty-writes-dropped")
    assert rig.status("set_current", current=500) == 1
    assert rig.status("set_current", current=600) is None
    rig.wait(SECOND)
    assert rig.status("set_current", current=600) == 1
    rig = quirky("mks-rs485", "slow-restart")
    rig.ask("restart")
    rig.wait(SECOND)
    assert rig.ask("read_speed") == []
    rig.wait(SECOND)
    assert rig.value("read_speed") == 0
    rig = quirky("mks-rs485", "new-address-answers")
    (said,) = rig.send_at("set_address", new_address=7)
    assert said.data == bytes.fromhex("FB 07 8B 01 8E")
    rig = quirky("mks-rs485", "status-stays-slowing")
    rig.ask("move_relative_axis", speed=600, acceleration=250, position=4096)
    rig.wait(500 * MS)
    assert (rig.value("read_speed"), rig.value("read_status")) == (0, 3)
    rig.wait(SECOND)
    assert rig.value("read_status") == 1


def test_after_a_limit_stop_the_next_motion_is_ignored():
    rig = quirky("mks-can", "deaf-after-limit-stop", end_limit=1, limits_homed=1)
    rig.drive.place_switch("left", -1000)
    said = rig.ask("move_relative_axis", speed=600, position=-5000) + rig.wait_values(SECOND)
    assert [v["status"] for v in said] == [1, 3]
    assert rig.ask("move_relative_axis", speed=600, position=500) == []
    assert rig.status("move_relative_axis", speed=600, position=500) == 1
