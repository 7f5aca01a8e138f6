"""The theme resilience: many requests, floods, noise, idle hours, lost power, and a drive that is busy."""

from __future__ import annotations

import pytest

from analyzer.records import Frame, Message
from conformance.claim import Outcome, Theme
from conformance.drives.drive import Drive, Fault, Hooks
from conformance.drives.mks.core import MksCore
from tests.conformance.theme_runs import refuted, run


@pytest.mark.parametrize(
    ("quirk", "drive", "name"),
    [("hasty-writes-dropped", "mks-rs485@1", "hasty_settings"), ("lk-firmware-235", "lk-rs485@1", "hasty_settings")],
)
def test_a_quirk_is_refuted_and_named(quirk, drive, name):
    verdict = run(Theme.RESILIENCE, f"{drive},quirk={quirk}", name)[name]
    assert (verdict.outcome, verdict.quirks) == (Outcome.REFUTED, (quirk,))


def test_a_drive_that_lets_a_setting_stop_it_is_refuted():
    def stored(drive: Drive, name: str, value: int) -> tuple[str, int]:
        assert isinstance(drive, MksCore)
        drive.motor.halt(drive.now_ns)
        return name, value

    fault = Fault("halts", ("mks-can",), "settings stop the shaft", "stop", lambda hooks: hooks.stored.append(stored))
    assert refuted(Theme.RESILIENCE, "mks-can@1", "settings/run_speed", "moving", fault=fault) == {"settings/run_speed"}


def test_a_drive_that_is_deaf_after_power_comes_back_is_refuted():
    deaf: list[Drive] = []

    def accept(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        return wanted and drive not in deaf

    def install(hooks: Hooks) -> None:
        hooks.powered.append(deaf.append)
        hooks.accept.append(accept)

    fault = Fault("deaf", ("lk-rs485",), "it hears nothing after power-up", "power", install)
    assert refuted(Theme.RESILIENCE, "lk-rs485@1", "power", "idle", fault=fault) == {"power/back", "power/in_frame"}
