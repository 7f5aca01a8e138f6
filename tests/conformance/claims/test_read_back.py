"""Claims about what is stored: that it reads as it was set, does what it says, survives a restart and is restored."""

from __future__ import annotations

import pytest

from conformance.claim import Outcome, Theme
from tests.conformance import theme_runs


def test_a_setting_that_cannot_be_read_is_observed():
    (verdict,) = theme_runs.run(Theme.READ_BACK, "mks-can@1,fault=subdivision-unreadable", "set_subdivision/read").values()
    assert verdict.outcome is Outcome.OBSERVED


@pytest.mark.parametrize("fault", ["position-low-byte-first", "position-half-width", "speed-low-byte-first", "speed-doubled"])
def test_what_reads_wrongly_is_not_taken_for_a_setting_that_is_not_stored(fault):
    assert theme_runs.refuted(Theme.READ_BACK, f"mks-rs485@1,fault={fault}", "set_subdivision", "set_home") == set()


def test_a_firmware_without_parameters_is_a_known_quirk():
    verdicts = theme_runs.run(Theme.READ_BACK, "lk-rs485@1,quirk=lk-firmware-235", "parameter/speed_limit")
    assert {v.outcome for v in verdicts.values()} == {Outcome.OBSERVED}
    assert {v.quirks for v in verdicts.values()} == {("lk-firmware-235",)}
