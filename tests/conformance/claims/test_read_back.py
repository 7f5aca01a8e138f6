"""Claims about what is stored: that it reads as it was set, does what it says, survives a restart and is restored."""

from __future__ import annotations

import pytest

from conformance.claim import Outcome, Theme
from tests.conformance import theme_runs

#: Drives beside those of every theme, with the claims that are not about them: another protocol's address, another model.
_OTHERS = {
    "mks-rs485@255,model=57D": {
        "set_modbus/restart",
        "restore/limit-remap",
        "set_limit_remap/limit-remap-and-back",
        *(f"set_limit_remap/restart-{way}-limit-remap" for way in ("broadcast", "group", "package")),
    },
    "mks-rs485@3,baud=115200": {"set_limit_remap/effect"},
}


@pytest.mark.parametrize("drive", _OTHERS)
def test_a_drive_as_its_manual_has_it_confirms_every_claim_about_it(drive):
    found = theme_runs.not_confirmed(Theme.READ_BACK, drive)
    assert found.keys() == _OTHERS.get(drive, set())
    assert all(why.startswith(str(Outcome.NOT_RUN)) for why in found.values()), found


FAULTS = (
    ("mks-can", "current-bytes-swapped", "set_current/read"),
    ("mks-can", "parameter-off-by-one", "set_work_mode/read"),
    ("mks-can", "parameter-defaults", "set_direction/read"),
    ("mks-can", "user-id-not-stored", "write_user_id/read"),
    ("mks-can", "user-id-lost", "write_user_id/restart"),
    ("mks-can", "current-lost", "settings/restart"),
    ("mks-rs485", "work-mode-not-stored", "set_work_mode/effect"),
    ("mks-modbus", "subdivision-not-stored", "set_subdivision/effect"),
    ("mks-rs485", "group-not-stored", "set_group_address/effect"),
    ("mks-can", "group-lost", "set_group_address/restart"),
    ("mks-rs485", "group-lost", "set_group_address/power"),
    ("mks-can", "home-trigger-not-stored", "set_home/home_trigger"),
    ("mks-rs485", "limit-remap-ignored", "set_limit_remap/effect"),
    ("mks-modbus", "address-lost", "set_address/restart"),
    ("mks-rs485", "saved-run-lost", "save_speed/restart"),
    ("mks-can", "saved-direction-lost", "save_speed/restart"),
    ("mks-modbus", "clean-ignored", "save_speed/clean"),
    ("mks-modbus", "zero-mode-ignored", "set_zero_mode/restart"),
    ("mks-rs485", "restore-lies", "restore/settings"),
    ("mks-can", "current-kept", "restore/settings"),
    ("mks-rs485", "address-kept", "restore/link"),
    ("mks-modbus", "dialect-kept", "restore/link"),
    ("lk-rs485", "lk-gains-swapped", "parameter/current_pid/written"),
    ("lk-rs485", "lk-parameter-int16", "parameter/angle_limit/written"),
    ("lk-rs485", "lk-parameter-survives", "parameter/torque_limit/power"),
)


@pytest.mark.parametrize(("dialect", "fault", "claim"), FAULTS)
def test_a_fault_is_refuted_by_the_claim_about_it(dialect, fault, claim):
    model = ",model=42D" if dialect == "mks-rs485" else ""
    verdicts = theme_runs.run(Theme.READ_BACK, f"{dialect}@1{model},fault={fault}", claim)
    assert (verdicts[claim].outcome, verdicts[claim].reason) == (Outcome.REFUTED, verdicts[claim].reason)


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
