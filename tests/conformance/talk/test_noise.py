"""Noise and resolution by units: what a difference has to exceed before it tells something."""

from __future__ import annotations

import pytest

from conformance.talk.noise import COUNT, QUIET, Noise

LIVE = Noise(degrees=COUNT, loop=3 * COUNT, rpm=1.0, share=0.01, supply={"V": 0.1, "degC": 1.0})


@pytest.mark.parametrize(
    ("unit", "value", "expected"),
    [
        ("degrees", 0, 11 * COUNT),
        ("degrees from the start", 0, 11 * COUNT),
        ("0.01 degrees", 0, 1100 * COUNT),
        ("counts", 0, 11),
        ("rpm", 100, 2.5),
        ("deg/s", 600, 15),
        ("0.01 V", 2400, 30),
        ("A", 1, 0),
        ("degC", 20, 3),
        ("turns", 1, 0),
        ("", 1, 0),
    ],
)
def test_the_noise_of_a_unit_is_what_was_measured(unit, value, expected):
    assert LIVE.of(unit, value) == pytest.approx(expected)
    assert QUIET.of(unit, value) == 0


@pytest.mark.parametrize(("unit", "expected"), [("counts", 2), ("0.01 V", 2), ("x 0.01 A", 2), ("degC", 2), ("rpm", 2)])
def test_two_looks_are_one_value_within_two_steps(unit, expected):
    assert Noise.step(unit) == pytest.approx(expected)


def test_a_unit_without_a_resolution_has_to_be_told_one():
    with pytest.raises(KeyError):
        Noise.step("turns")


def test_noise_is_bounded_by_what_a_manual_can_allow():
    wild = Noise(degrees=90, loop=90, rpm=500, share=0.9, supply={"V": 20.0})
    assert (wild.place, wild.of("V"), wild.speed(100)) == (0.9, 1.0, 5.5)


def test_a_shaft_that_has_just_arrived_may_swing_less_than_one_that_is_known_to_settle():
    assert 8 * COUNT <= QUIET.swing < 12 * COUNT < LIVE.swing


def test_a_shaft_whose_speed_trembles_rests_beside_its_target_too():
    assert Noise(share=0.01).counts == 8
    assert not Noise(lag=1.0).counts


def test_looks_at_an_encoder_of_16_bits_differ_by_what_a_tremble_told_in_hundredths_hides():
    # Two counts of 14 bits either way are 0.044 degrees, told as 0.04.
    assert Noise(degrees=0.04).encoder >= 4 * 4
