"""Claims about timing, the ramp law they stand on, and the measures they take."""

from __future__ import annotations

import pytest

from conformance.claim import Outcome
from conformance.drives.mks.paths import move_path, ramp_step_ns
from conformance.motion import ramp
from conformance.motion.ramp import Fit, Judgement
from tests.conformance.theme_runs import judge


def test_a_ramp_is_measured_to_a_fraction_of_a_per_cent():
    verdict = judge("mks-rs485@1", "timing/run_speed/ramp-56")
    assert verdict.measured["ramp_ms"] == pytest.approx(1200, abs=12)
    assert verdict.measured["uncertain_ms"] < 30


def test_the_delay_of_lk_is_reported_and_never_refutes():
    assert judge("lk-rs485@1", "timing/replies/delay").measured["delay_p50_ms"] == pytest.approx(0.25, abs=0.001)
    assert judge("lk-rs485@1,fault=lk-late-while-turning", "timing/replies/turning").outcome is Outcome.OBSERVED
    late = judge("lk-rs485@1,fault=lk-reply-late", "timing/replies/delay")
    assert late.outcome is Outcome.OBSERVED
    assert late.measured["delay_p50_ms"] == pytest.approx(20.25, abs=0.01)


def test_latencies_are_told_with_their_spread():
    measured = judge("mks-can@1", "timing/replies/at-rest").measured
    assert 0 < measured["reply_p50_ms"] <= measured["reply_p99_ms"] <= measured["reply_longest_ms"] < 5
    assert measured["uncertain_ms"] == 0


# --- the law ----------------------------------------------------------------------------------------------------------


def test_the_law_is_the_table_of_the_manual():
    # 6.1: at acceleration 236 the speed is 1 rpm after 1 ms and 3000 rpm after 3000 ms.
    assert ramp.step_ns(236) == 1_000_000
    assert ramp.ramp_ns(0, 3000, 236) == 3_000_000_000
    assert ramp.step_ns(255) == 50_000
    assert ramp.step_ns(1) == 255 * 50_000
    assert ramp.step_ns(0) == 0
    with pytest.raises(ValueError, match="256"):
        ramp.step_ns(256)


def test_a_move_is_a_trapezoid_or_a_triangle():
    # A turn at 120 rpm takes 500 ms, and each ramp of 336 ms covers half of what it would at full speed.
    assert ramp.move_ns(1, 120, 200) == pytest.approx(836e6)
    assert ramp.move_ns(0.5, 60, 0) == pytest.approx(500e6)
    assert ramp.peak(1, 300, 56) == pytest.approx(77.46, abs=0.01)
    assert ramp.move_ns(1, 300, 56) == pytest.approx(2 * 77.46 * 10e6, rel=1e-3)
    assert ramp.move_ns(0, 60, 200) == 0


@pytest.mark.parametrize(("turns", "rpm", "acceleration"), [(1, 120, 200), (0.3, 300, 56), (5, 900, 250), (0.1, 60, 0)])
def test_the_law_and_the_emulated_path_agree_within_its_slack(turns, rpm, acceleration):
    path = move_path(0, 0, 0, round(turns * 480_000_000_000), rpm, ramp_step_ns(acceleration))
    law_ns = ramp.move_ns(turns, rpm, acceleration)
    assert abs(float(path.settled) - law_ns) <= ramp.slack_ns(acceleration, 2) + 1


@pytest.mark.parametrize(
    ("measured_ms", "spread_ms", "fit"),
    [
        (1000, 0, Fit.GOOD),
        (1020, 0, Fit.GOOD),
        (980, 0, Fit.GOOD),
        (1040, 0, Fit.SLOW_AS_SEEN),
        (1040, 35, Fit.GOOD),
        (1049, 0, Fit.SLOW_AS_SEEN),
        (1060, 0, Fit.SLOW),
        (975, 0, Fit.FAST),
        (975, 10, Fit.GOOD),
        (1000, 300, Fit.BLIND),
        (2000, 300, Fit.SLOW),
        (500, 300, Fit.FAST),
    ],
)
def test_a_measured_time_is_judged_with_its_uncertainty(measured_ms, spread_ms, fit):
    assert Judgement(measured_ms * 1e6, 1e9, spread_ms * 1e6).fit is fit
