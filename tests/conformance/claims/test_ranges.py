"""Claims about ranges: limits, choices, gaps, reserved bits, widths, and that a refused value changes nothing."""

from __future__ import annotations

import pytest

from conformance.claim import Outcome, Theme
from tests.conformance import theme_runs

#: What is not run where: an address that the other dialect does not have.
ELSEWHERE = {"mks-rs485@255,model=57D": {"set_modbus/modbus/listed"}}


@pytest.mark.parametrize("drive", ["mks-rs485@255,model=57D", "lk-rs485@32,model=MS"])
def test_a_drive_as_its_manual_has_it_confirms_every_claim(drive):
    assert set(theme_runs.not_confirmed(Theme.RANGES, drive)) == ELSEWHERE.get(drive, set())


FAULTS = (
    ("mks-rs485@1,model=57D", "current-highest-refused", "set_current/current/highest"),
    ("mks-modbus@1,model=42D", "current-one-more", "set_current/current/above"),
    ("mks-can@1", "current-clipped", "set_current/current/above"),
    ("mks-rs485@1", "zero-speed-5", "set_zero_mode/zero_speed/above"),
    ("mks-can@1", "stall-tolerance-highest-refused", "set_stall_tolerance/stall_tolerance/highest"),
    ("mks-rs485@1", "address-highest-refused", "set_address/new_address/highest"),
    ("mks-modbus@1", "address-248-accepted", "set_address/new_address/above"),
    ("mks-can@1", "address-not-stored", "set_address/new_address/inside"),
    ("mks-can@1", "group-0-accepted", "set_group_address/group_address/below"),
    ("mks-can@1", "lowest-position-accepted", "move_relative_axis/position/below"),
    ("mks-modbus@1", "acceleration-256-accepted", "move_absolute_axis/acceleration/above"),
    ("mks-can@1", "work-mode-6-accepted", "set_work_mode/work_mode/unlisted"),
    ("mks-can@1", "subdivision-25-refused", "set_subdivision/subdivision/listed"),
    ("mks-rs485@1", "baud-256000-refused", "set_baud_rate/baud_rate/256000"),
    ("mks-can@1", "bit-rate-4-accepted", "set_bit_rate/bit_rate/unlisted"),
    ("mks-rs485@1", "save-any-state", "save_speed/save_state/unlisted"),
    ("mks-modbus@1", "refusal-says-success", "set_key_lock/key_lock/unlisted"),
    ("mks-rs485@1", "speed-above-3000-refused", "move_relative_pulses/speed/above"),
    ("mks-can@1", "speed-unlimited", "run_speed/speed/above"),
    ("mks-can@1", "speed-8-bit", "move_absolute_axis/speed/width"),
    ("mks-rs485@1", "speed-12-bit", "move_absolute_pulses/speed/above"),
    ("mks-modbus@1", "speed-12-bit", "run_speed/speed/above"),
    ("mks-can@1", "speed-15-bit", "move_relative_axis/speed/above"),
    ("mks-rs485@1", "position-16-bit", "move_absolute_axis/position/width"),
    ("mks-modbus@1", "pulses-16-bit", "move_relative_pulses/pulses/width"),
    ("lk-rs485@1,model=MF", "lk-torque-one-more", "run_torque/torque_current/above"),
    ("lk-rs485@1,model=MS", "lk-power-short-below", "run_open_loop/power/lowest"),
    ("lk-rs485@1", "lk-angle-one-more", "move_single_turn_limited/angle/above"),
    ("lk-rs485@1", "lk-direction-any", "move_single_turn/direction/unlisted"),
    ("lk-rs485@1", "lk-target-int32", "move_multi_turn/position/width"),
    ("lk-rs485@1", "lk-asked-speed-int16", "run_speed/speed/width"),
    ("lk-rs485@1", "lk-asked-speed-24-bit", "run_speed/speed/inside"),
    ("lk-rs485@1", "lk-max-speed-24-bit", "move_multi_turn_limited/max_speed/highest"),
    ("lk-rs485@1", "lk-single-turn-36000-turned", "move_single_turn/angle/lowest"),
    ("lk-rs485@1", "lk-runs-open-loop", "models"),
    ("lk-rs485@1,model=MS", "lk-ms-runs-torque", "models"),
)


@pytest.mark.parametrize(("drive", "fault", "claim"), FAULTS)
def test_a_fault_is_refuted_by_the_claim_about_it(drive, fault, claim):
    verdicts = theme_runs.run(Theme.RANGES, f"{drive},fault={fault}", claim)
    assert (verdicts[claim].outcome, verdicts[claim].reason) == (Outcome.REFUTED, verdicts[claim].reason)


def test_a_fault_of_one_limit_is_refuted_by_that_claim_alone():
    wanted = ("set_zero_mode", "set_home", "set_current", "set_work_mode")
    assert theme_runs.refuted(Theme.RANGES, "mks-rs485@1,fault=zero-speed-4-refused", *wanted) == {
        "set_zero_mode/zero_speed/highest"
    }


def test_a_line_that_loses_replies_is_no_drive_that_ignores_values():
    for fault in ("lost-reply", "first-reply-only", "late-reply", "echo", "doubled-reply"):
        assert theme_runs.refuted(Theme.RANGES, f"mks-rs485@1,fault={fault}", "set_baud", "set_address", "set_modbus") == set()
        assert theme_runs.refuted(Theme.RANGES, f"mks-can@1,fault={fault}", "set_current", "set_bit_rate") == set()


def test_what_a_refutation_says():
    (verdict,) = theme_runs.run(
        Theme.RANGES, "mks-rs485@1,model=42D,fault=current-one-more", "set_current/current/above"
    ).values()
    assert verdict.reason == "set_current: current 3001 is accepted"
    assert verdict.got == "FB 01 83 01 80"
    assert "FA 01 83 0B B9 42" in "\n".join(verdict.exchange.lines())
