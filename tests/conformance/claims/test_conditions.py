"""Faults that show in one condition alone, or as something else than is told, and a claim that refutes each."""

from __future__ import annotations

import pytest

from conformance.claim import Outcome
from conformance.drives.faults import lk_conditions, mks_conditions, mks_effects, mks_sequences
from conformance.drives.make import every_fault
from conformance.suite import engine, plan
from conformance.suite.rig_emulated import EmulatedRig
from conformance.suite.target import EMULATED, parse

#: Faults -> a claim that refutes each: all of a condition, and others that no exchange of a drive's own tests shows.
REFUTED_BY = {
    "group-id-kept": "read-back/restore/set_group_address",
    "lk-speed-ramp-late": "timing/write_parameter/speed-ramp-under-way-move_multi_turn",
    "limits-passed-at-once": "motion/set_home/end-limit-stops-move_absolute_pulses",
    "right-limit-passed-slowly": "motion/set_home/end-limit-stops-run_speed-right",
    "zero-speed-5-at-corners": "ranges/set_zero_mode/at-corners",
    "home-direction-2-at-corners": "ranges/set_home/at-corners",
    "lk-torque-without-sign": "motion/read_state_2/torque-sign",
    "lk-torque-limit-one-way": "motion/write_parameter/torque-limit-at-once-run_torque",
    "fe-of-old-zero": "motion/home/zero",
    "homing-ccw-untold": "motion/home/replies",
    "home-backs-off-half-a-turn": "motion/home/backs-off-cw",
    "home-backs-off-16-bits": "motion/home/backs-off-ccw",
    "target-kept-protected": "motion/release_protection/limp",
    "stuck-at-limit": "motion/set_home/end-limit-lets-back",
    "zero-speed-4-as-3": "motion/set_zero_mode/faster",
    "near-by-quarters": "motion/set_zero_mode/near",
    "short-way-down": "motion/set_zero_mode/direction-ccw",
    "fe-unwatched": "motion/release_protection/limp-either-way",
    "enabling-turns-back": "motion/enable/on-holds-here",
    "target-kept": "motion/move_relative_axis/behind-ended",
    "as-sent-at-odd": "motion/run_speed/at-each-subdivision",
    "long-run-executed": "framing/run_speed/other-length",
    "long-settings-executed": "framing/settings/other-length",
    "respond-0-needs-active": "motion/set_respond/0-silences-run_speed",
    "refused-aloud": "motion/set_respond/0-silences-refusals",
    "newer-keeps-ramp": "motion/run_speed/takes-over",
    "newer-keeps-faster": "motion/move_absolute_axis/again-and-again",
    "speeds-as-before": "resilience/settings/run_speed",
    "off-behind-settings": "resilience/settings/run_speed",
    "protected-behind-motions": "motion/run_speed/again-and-again",
    "protection-slows": "resilience/settings/leave-motion",
    "way-back-slower-cw": "read-back/set_zero_mode/restart",
    "way-back-slower-ccw": "read-back/set_zero_mode/restart",
    "way-back-untold": "motion/read_zero_status/tells-cw",
    "address-fa-refused": "ranges/set_address/new_address/inside",
    "stops-of-all-by-ramp": "addressing/broadcast/run_speed/stop_speed",
    "stops-of-all-at-once": "addressing/broadcast/as-sent",
    "fine-subdivision-lost": "read-back/settings/restart",
    "user-id-unset-lost": "read-back/write_user_id/restart",
    "broadcast-settings-lost": "read-back/settings/restart-broadcast",
    "group-settings-lost": "read-back/settings/restart-group",
    "package-settings-lost": "read-back/settings/restart-package",
    "hears-bad-group-bit-7": "addressing/group/other",
    "hears-bad-group-bit-4": "addressing/group/move_absolute_axis/stop_absolute_axis",
    "home-speed-byte": "read-back/settings/restart",
    "enable-level-forgotten": "read-back/set_enable_level/restart-enable-level",
    "stops-lose-pulses": "motion/read_pulses/behind-stops",
    "homing-unstopped": "motion/emergency_stop/ends-home",
    "emergency-completes-pulses": "motion/emergency_stop/replies",
    "emergency-completes-home": "motion/emergency_stop/ends-home",
    "status-behind-emergency-ramp": "motion/read_status/behind-emergency",
    "status-behind-emergency-home": "motion/read_status/behind-emergency",
    "speed-0-cw-goes-on": "motion/run_speed/speed-0",
    "homing-above-mode": "motion/home/within-mode",
    "cleaning-stops": "read-back/save_speed/clean",
    "cleaned-turning-alone": "read-back/save_speed/clean-at-rest",
    "third-target-lost": "motion/move_absolute_axis/again-and-again",
    "package-first-motion": "addressing/package/behind_setting",
    "package-of-two-codes": "addressing/package/first_of_kinds",
    "right-limit-passed": "motion/set_home/end-limit-stops-move_relative_pulses-right",
    "homing-back-as-stopped": "motion/home/status-from-closed",
    "homing-ccw-lets-go": "motion/home/holds",
    "current-capped": "read-back/set_current/ends",
    "protection-stays": "motion/set_protection/off-again",
    "group-left-by-speed": "read-back/set_group_address/stays",
    "holding-refused-open": "resilience/settings/run_speed",
    "short-moves-undone": "motion/move_relative_pulses/steps",
    "moves-scaled-at-32": "motion/move_relative_axis/crossed-speed",
    "inner-request-obeyed": "addressing/other/inside",
    "check-ff-passes": "framing/run_speed/wrong_check",
    "check-0-passes": "framing/move_absolute_pulses/wrong_check",
    "check-next-passes": "framing/move_relative_axis/wrong_check",
    "crc-first-byte": "framing/move_absolute_axis/wrong_check",
    "crc-swapped": "framing/move_relative_pulses/wrong_check",
    "home-unchecked": "framing/home/wrong_check",
    "broadcast-unchecked": "framing/broadcast/wrong_check",
    "stop-unchecked": "framing/stops/wrong_check",
    "sets-for-next": "addressing/other/set_subdivision",
    "run-by-06": "modbus/run_speed/other_forms",
    "group-motion-answered": "addressing/group/run_speed/stop_speed",
    "carry-frozen-when-fast": "motion/read_encoder_carry/crossed",
    "pulses-counted-at-rest": "motion/read_pulses/crossed",
    "off-while-turning": "motion/run_speed/leaves-states",
    "protected-while-turning": "motion/run_speed/leaves-states",
    "error-counts-turns": "motion/run_speed/leaves-states",
    "slow-speed-tenfold": "motion/read_speed/crossed",
    "zero-check-sent-1": "motion/read_position/each-check",
    "fast-stop-ignored": "motion/stop_speed/when-fast",
    "rising-stop-ignored": "motion/emergency_stop/when-rising-move_relative_axis",
    "emergency-latches": "motion/emergency_stop/keeps-torque",
    "enabling-stops": "motion/enable/on-goes-on",
    "saving-stops": "read-back/save_speed/restart",
    "zero-low-word": "motion/set_zero/position",
    "no-ramp-goes-beyond": "motion/move_absolute_pulses/crossed-ends",
    "high-pulses-back": "ranges/move_relative_pulses/pulses/width",
    "direction-turns-fe": "motion/set_direction/and-move_absolute_pulses",
    "restart-turns-round": "read-back/restart/motion-as-before",
    "restart-speed-as-sent": "read-back/restart/motion-as-before",
    "baud-rate-lost": "read-back/set_baud_rate/restart",
    "dialect-lost": "read-back/set_modbus/restart",
    "saved-run-once": "read-back/save_speed/as-it-was",
    "saved-ramp-lost": "read-back/save_speed/as-it-was",
    "saved-speed-byte": "read-back/save_speed/as-it-was",
    "package-without-ramp": "addressing/package/as-sent",
    "package-never-disables": "addressing/package/enable",
    "package-stop-at-once": "addressing/package/as-sent",
    "package-speed-byte": "addressing/package/move_relative_axis",
    "package-without-emergency-stop": "addressing/package/move_absolute_pulses",
    "package-without-homing": "addressing/package/home",
    "package-without-run-kept": "read-back/save_speed/package",
    "broadcast-run-not-kept": "read-back/save_speed/broadcast",
    "broadcast-mode-ignored": "addressing/broadcast/set_work_mode",
    "broadcast-group-ignored": "addressing/broadcast/set_group_address",
    "broadcast-zero-ignored": "addressing/broadcast/set_zero_mode",
    "group-restart-ignored": "read-back/save_speed/group",
    "group-ports-ignored": "addressing/group/write_io",
    "group-homing-ignored": "read-back/settings/restart-group",
    "calibration-goes-on": "motion/calibrate/halted",
    "refusals-need-active": "motion/set_respond/0-silences-refusals",
    "homing-untold-behind-setting": "motion/home/told-though",
    "subdivision-25-read-as-24": "ranges/set_subdivision/subdivision/listed",
    "left-is-clockwise": "motion/set_home/end-limit-stops-run_speed-ccw",
    "deaf-after-motion": "resilience/reads/stopped",
    "deaf-after-refusal": "motion/move_relative_pulses/behind-refusals",
    "deaf-after-long-pause": "resilience/idle/first-long",
    "silent-below-zero": "resilience/reads/below-zero",
    "silent-disabled": "motion/run_speed/disabled",
    "every-150th-lost": "resilience/reads/answered",
    "fast-status-2": "motion/read_status/crossed",
    "open-status-0": "motion/read_status/crossed",
    "slower-status-2": "motion/read_status/crossed",
    "home-trigger-kept": "read-back/restore/home-trigger",
    "home-direction-kept": "read-back/restore/home-direction",
    "end-limit-kept": "read-back/restore/end-limit",
    "limit-remap-kept": "read-back/restore/limit-remap",
    "protection-kept": "read-back/restore/protection",
    "respond-kept": "read-back/restore/respond",
    "active-kept": "read-back/restore/active",
    "group-address-kept": "read-back/restore/group",
    "home-speed-kept": "read-back/restore/home-speed",
    "saved-run-kept": "read-back/restore/save_speed",
    "zero-mode-kept": "read-back/restore/set_zero_mode",
    "home-trigger-forgotten": "read-back/set_home/restart-home-trigger",
    "home-direction-forgotten": "read-back/set_home/restart-home-direction",
    "end-limit-forgotten": "read-back/set_home/restart-end-limit",
    "limit-remap-forgotten": "read-back/set_limit_remap/restart-limit-remap",
    "no-limit-home-forgotten": "read-back/set_no_limit_home/restart-home-mode",
    "protection-forgotten": "read-back/set_protection/restart-protection",
    "tired-of-motion": "resilience/moves/in-a-row",
    "hasty-setting-lost": "timing/settings/in-a-row",
    "zero-not-cleaned": "read-back/set_zero_mode/clean",
    "homing-always-told": "motion/set_respond/inactive-home",
    "open-without-limits": "motion/set_home/end-limit-stops-move_relative_axis",
    "zero-refused-while-off": "resilience/switches/off",
    "setting-undone-while-off": "resilience/settings/off",
    "remap-refused-while-turning": "resilience/settings/run_speed",
    "group-deaf-to-all": "resilience/switches/grouped",
    "zero-status-2-after-homing": "resilience/reads/homed",
    "update-undone": "motion/move_absolute_axis/takes-over",
    "tolerance-capped": "motion/set_stall_tolerance/angle",
    "steep-stop-ignored": "motion/stop_relative_pulses/crossed-stops",
    "closed-cw-emergency-slow": "motion/emergency_stop/ends-run_speed",
    "closed-cw-emergency-ignored": "motion/emergency_stop/ends-move_relative_pulses",
    "home-over-motion-undone": "motion/home/takes-over",
    "home-over-motion-refused": "motion/home/takes-over",
    "group-left-by-address": "read-back/set_group_address/stays",
    "direction-turns-open-runs": "motion/set_direction/and-the-bus",
    "direction-ends-motion": "motion/set_direction/and-the-bus",
    "direction-lost-by-restart": "motion/set_direction/and-the-bus",
    "long-setting-stored": "framing/settings/other-length",
    "current-echo-low-byte": "modbus/write_one/echo-of-current",
    "exception-2-turning": "modbus/exception/turning",
    "in-place-on-its-way": "motion/read_io/crossed",
    "ports-given-back-by-moves": "read-back/write_io/stays",
    "speed-long-after-restart": "resilience/reads/restarted",
    "slow-speed-zero": "motion/run_speed/slow",
    "slow-run-after-homing": "resilience/reads/homing",
    "group-without-ramp": "addressing/group/as-sent",
    "open-home-slow": "motion/home/turns",
    "falling-emergency-ignored": "motion/emergency_stop/while-slowing",
    "falling-motion-undone": "motion/move_relative_pulses/while-slowing",
    "f5-as-sent-at-128": "motion/move_absolute_axis/at-each-subdivision",
    "zero-direction-turned": "read-back/set_zero_mode/restart",
    "zero-speed-fixed": "read-back/set_zero_mode/restart",
    "emergency-without-check": "framing/emergency_stop/other-length",
    "completion-cut": "motion/set_respond/1-answers-again",
    "completion-of-noise": "motion/set_respond/1-answers-again",
    "protected-keeps-torque": "motion/set_protection/lets-go",
    "protected-goes-on": "motion/release_protection/limp-either-way",
    "release-takes-up": "motion/release_protection/limp",
    "disabled-keeps-torque": "motion/read_position/while-disabled",
    "en-pin-keeps-torque": "read-back/set_enable_level/pin",
    "limits-by-low-pins": "motion/set_home/end-limit-stops-move_relative_axis",
    "closed-start-by-low-pin": "motion/home/from-closed-ccw",
    "current-of-steps": "read-back/set_current/ends",
    "slow-homing-capped": "motion/home/speed-2000",
    "small-tolerance-coarse": "motion/set_stall_tolerance/limp-angle",
    "great-tolerance-capped": "motion/set_stall_tolerance/limp-angle",
    "high-groups-deaf": "read-back/set_group_address/effect",
    "division-above-100": "motion/set_pulse_division/flips",
    "division-of-positive": "motion/set_pulse_division/flips",
    "division-from-50": "motion/set_pulse_division/flips",
    "division-not-above-5000": "motion/set_pulse_division/flips",
    "division-of-16-bits": "motion/set_pulse_division/flips",
    "lk-runs-release-brake": "motion/brake/stays-applied",
    "lk-moves-release-brake": "motion/brake/stays-applied",
    "lk-increments-release-brake": "motion/brake/stays-applied",
    "lk-on-while-turning": "motion/motor_off/ends-motion",
    "lk-offset-of-next": "motion/set_zero/fits-behind",
    "lk-zero-raw-stale": "motion/set_zero/fits-behind",
    "lk-newer-keeps-faster": "motion/move_multi_turn_limited/newer-speed",
    "lk-changed-move-steep": "timing/write_parameter/one-slope-move_increment_limited",
    "lk-changed-run-flat": "timing/write_parameter/one-slope-run_speed",
    "lk-moves-bend": "timing/write_parameter/one-slope-move_single_turn",
    "lk-runs-bend": "timing/write_parameter/one-slope-run_speed",
    "lk-moves-end-soft": "timing/write_parameter/one-slope-move_multi_turn",
    "lk-short-circuit-stays": "motion/clear_errors/clears",
    "lk-high-voltage-cleared": "motion/clear_errors/keeps",
    "lk-several-stay": "motion/clear_errors/keeps",
    "lk-lowest-flag-alone": "motion/clear_errors/clears",
    "lk-silent-when-stalled": "motion/read_state_1/flag-stalled",
    "lk-high-speed-limits-ignored": "motion/write_parameter/speed-limit-move_increment-each-way",
    "lk-wide-angle-limits-ignored": "motion/write_parameter/angle-limit-move_multi_turn-each-way",
}
#: What a fault of the protection and of the angle error is seen by without a hand that holds the shaft.
LIMP = (
    ("protected-moves", "motion/release_protection/limp"),
    ("protection-hidden", "motion/release_protection/limp"),
    ("protected-goes-on", "motion/release_protection/limp"),
    ("angle-error-in-counts", "motion/read_angle_error/limp"),
    ("angle-error-sign-turned", "motion/read_angle_error/limp"),
)


def verdict(name, claim):
    target = parse(name, EMULATED)
    found = next(c for c in plan.every_claim(target) if c.id.split("/", 1)[1] == claim)
    return engine.run_claim(found, EmulatedRig(target.specification))


def test_each_fault_has_its_claim():
    of_conditions = (*mks_conditions.FAULTS, *mks_sequences.FAULTS, *mks_effects.FAULTS, *lk_conditions.FAULTS)
    assert {fault.name for fault in of_conditions} <= set(REFUTED_BY) <= {fault.name for fault in every_fault()}


@pytest.mark.parametrize("fault", [f for f in every_fault() if f.name in REFUTED_BY], ids=lambda f: f.name)
def test_a_fault_of_a_condition_is_refuted(fault):
    for dialect in fault.dialects:
        # The range of a torque depends on the model.
        model = ",model=MF" if dialect == "lk-rs485" else ""
        seen = verdict(f"{dialect}@1{model},fault={fault.name}", REFUTED_BY[fault.name])
        assert seen.outcome is Outcome.REFUTED, (dialect, seen.reason)


def test_a_limit_shows_without_a_switch():
    for fault, wanted in (("", Outcome.CONFIRMED), (",fault=limits-by-low-pins", Outcome.REFUTED)):
        seen = verdict(f"mks-can@1{fault}", "motion/set_home/end-limit-by-level")
        assert seen.outcome is wanted, seen.reason


@pytest.mark.parametrize("address", [2, 26, 41])
def test_registers_that_no_command_has_are_refused_at_every_address(address):
    assert verdict(f"mks-modbus@{address}", "modbus/register/unknown_write").outcome is Outcome.CONFIRMED


@pytest.mark.parametrize(("fault", "claim"), LIMP)
def test_a_motor_without_current_shows_the_protection_and_the_error(fault, claim):
    seen = verdict(f"mks-modbus@1,fault={fault}", claim)
    assert seen.outcome is Outcome.REFUTED, seen.reason
