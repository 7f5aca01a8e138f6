"""The theme addressing: own, other, broadcast, group, package, another address."""

from __future__ import annotations

import pytest

from analyzer.catalogue import Verb
from analyzer.records import Frame, Message
from conformance.claim import Outcome, Theme
from conformance.drives import make
from conformance.drives.drive import Drive, Fault
from conformance.drives.mks.core import MksCore
from conformance.suite import engine
from conformance.suite.rig_emulated import EmulatedRig
from tests.conformance.theme_runs import claims_of, refuted, run


def test_a_package_that_is_executed_whatever_its_sum_is_refuted():
    def any_sum(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        return wanted or frame.data[:1] == b"\xfc"

    fault = Fault("sum", ("mks-rs485",), "packages are not checked", "package", lambda h: h.accept.append(any_sum))
    assert refuted(Theme.ADDRESSING, "mks-rs485@1", "package", fault=fault) == {
        "package/checksum",
        "package/damaged",
        "package/length",
    }


def test_a_broadcast_that_is_executed_twice_is_refuted():
    def again(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        assert isinstance(drive, MksCore)
        if wanted and message.address == 0:
            request = drive.responder.request(message, False)
            if request is not None:
                drive.obey(request)
                drive.motor.jump(drive.now_ns, 1_000)
        return wanted

    fault = Fault("twice", ("mks-rs485",), "broadcasts are executed twice", "broadcast", lambda h: h.accept.append(again))
    assert refuted(Theme.ADDRESSING, "mks-rs485@1", "broadcast/executed", fault=fault)


def test_settings_alone_may_be_deaf_to_broadcasts():
    def no_settings(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        command = message.command
        is_setting = command is not None and command.name == "set_zero"
        return wanted and not (message.address == 0 and is_setting)

    fault = Fault("deaf", ("mks-rs485",), "settings by broadcast are ignored", "broadcast",
                  lambda hooks: hooks.accept.append(no_settings))  # fmt: skip
    assert refuted(Theme.ADDRESSING, "mks-rs485@1", "broadcast", fault=fault) == {"broadcast/set_zero"}


@pytest.mark.parametrize(
    ("fault", "names"), [("group-deaf-to-settings", {"group/settings"}), ("group-low-byte-only", {"group/other"})]
)
def test_a_group_that_is_not_heard_whole_is_refuted(fault, names):
    assert refuted(Theme.ADDRESSING, f"mks-can@1,fault={fault}", "group/settings", "group/other", "group/own") == names


def test_a_drive_that_executes_nothing_proves_nothing_about_other_addresses():
    verdicts = run(Theme.ADDRESSING, "mks-can@1,fault=user-id-not-stored", "other/not_executed")
    assert verdicts["other/not_executed"].outcome is Outcome.INCONCLUSIVE


def test_the_reply_from_the_new_address_is_a_known_quirk():
    verdicts = run(Theme.ADDRESSING, "mks-rs485@1,quirk=new-address-answers", "set_address/")
    assert (verdicts["set_address/moves"].outcome, *verdicts["set_address/moves"].quirks) == (
        Outcome.REFUTED,
        "new-address-answers",
    )


class TurnedBefore(EmulatedRig):
    """A rig whose drives have turned by some degrees before a claim."""

    degrees = 0

    def make_drive(self):
        drive = super().make_drive()
        drive.motor.jump(drive.now_ns, round(self.degrees * 16384 / 360))
        return drive


@pytest.mark.parametrize("degrees", [0, 120, 276, 300])
def test_a_zero_by_broadcast_shows_wherever_the_shaft_is(degrees):
    rig = TurnedBefore(make.parse("mks-rs485@1"))
    rig.degrees = degrees
    (claim,) = claims_of(Theme.ADDRESSING, rig, ["broadcast/set_zero_mode"])
    assert engine.run_claim(claim, rig).outcome is Outcome.CONFIRMED


@pytest.mark.parametrize(("drive", "ways"), [("mks-rs485", {"broadcast", "package"}), ("mks-modbus", {"broadcast"})])
def test_a_restart_by_broadcast_that_is_answered_is_refuted(drive, ways):
    def told(drive: Drive, message: Message, wanted: bool) -> bool:
        return wanted or (message.address == 0 and message.command is not None and message.command.verb is Verb.RESTART)

    fault = Fault("restart", (drive,), "a restart by broadcast is answered", "broadcast", lambda h: h.answer.append(told))
    assert refuted(Theme.READ_BACK, f"{drive}@1", "save_speed", fault=fault) == {f"save_speed/{way}" for way in ways}


def test_a_motion_by_the_group_that_is_refused_and_answered_is_refuted():
    def told(drive: Drive, message: Message, wanted: bool) -> bool:
        assert isinstance(drive, MksCore)
        return wanted or (message.address == drive.settings["group_address"] and not drive.enabled and message.address != 0)

    fault = Fault("group", ("mks-rs485",), "what a group refuses is answered", "group", lambda h: h.answer.append(told))
    assert refuted(Theme.ADDRESSING, "mks-rs485@1", "group/outcomes", fault=fault)
