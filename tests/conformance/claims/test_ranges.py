"""Claims about ranges: limits, choices, gaps, reserved bits, widths, and that a refused value changes nothing."""

from __future__ import annotations

from conformance.claim import Theme
from tests.conformance import theme_runs


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
