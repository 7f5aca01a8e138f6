"""What the LK drive keeps and for how long: RAM, flash, the position, turns, and what happens at power-up."""

from __future__ import annotations

import pytest

from analyzer.protocols.lk_rs485 import PARAMETER_FORMS
from tests.conformance.drives.lk_bench import Bench

LISTED = [f for f in PARAMETER_FORMS if f.layout.named["parameter"].fixed is not None]


@pytest.mark.parametrize("form", LISTED, ids=lambda f: f.name)
def test_parameters_are_read_back_and_gone_with_the_power(form) -> None:  # type: ignore[no-untyped-def]
    bench = Bench()
    number = form.layout.named["parameter"].fixed
    before = {f.name: bench.read("read_parameter", parameter=f.layout.named["parameter"].fixed) for f in LISTED}
    fields = {n: f for n, f in form.layout.named.items() if n != "parameter"}
    for end in ("low", "high"):
        values = {n: getattr(f, end) for n, f in fields.items()}
        assert bench.read("write_parameter", parameter=number, **values) == {"parameter": number, **values}
        assert bench.read("read_parameter", parameter=number) == {"parameter": number, **values}
    for other in LISTED:
        if other is not form:
            shown = bench.read("read_parameter", parameter=other.layout.named["parameter"].fixed)
            assert shown == before[other.name]
    bench.drive.power_cycle(bench.t_ns)
    assert bench.read("read_parameter", parameter=number) == before[form.name]


def test_settings_at_construction_come_back_with_the_power() -> None:
    bench = Bench(settings={"speed_limit": 9000, "angle_kp": 7})
    bench.ask("write_parameter", parameter=32, speed_limit=18000)
    bench.ask("run_speed", speed=50000)
    bench.wait(1)
    assert bench.speed() == 180
    bench.drive.power_cycle(bench.t_ns)
    bench.ask("run_speed", speed=50000)
    bench.wait(1)
    assert bench.speed() == 90
    assert bench.read("read_parameter", parameter=10)["angle_kp"] == 7


def test_zero_takes_effect_with_the_power_and_stays() -> None:
    bench = Bench(model="MS", angle=90.0)
    bench.drive.turn_shaft(810.0)  # at 900 degrees, 180 within the turn
    assert bench.read("set_zero") == {"encoder_zero": 0x8000}
    assert bench.read("read_encoder") == {"encoder": 0x8000, "encoder_raw": 0x8000, "encoder_offset": 0}
    assert bench.read("read_single_turn")["angle"] == 18000
    assert bench.position() == 90000
    for _ in range(2):
        bench.drive.power_cycle(bench.t_ns)
        assert bench.read("read_encoder") == {"encoder": 0, "encoder_raw": 0x8000, "encoder_offset": 0x8000}
        assert bench.read("read_single_turn")["angle"] == 0
        assert bench.position() == 0
    assert bench.drive.settings["encoder_zero"] == 0x8000


def test_position_is_set_in_ram() -> None:
    bench = Bench(angle=10.0)
    assert bench.position() == 1000
    assert bench.read("set_position", position=-3600050) == {"position": -3600050}
    assert bench.position() == -3600050
    assert bench.read("read_single_turn")["angle"] == 1000  # the encoder is not asked
    bench.ask("move_multi_turn", position=-3600000)
    bench.wait(1)
    assert bench.position() == -3600000
    assert bench.read("read_single_turn")["angle"] == 1050
    bench.drive.power_cycle(bench.t_ns)
    assert bench.position() == 1050


@pytest.mark.parametrize(("at", "left"), [(0, 0), (12345, 12345), (84321, 12321), (-100, 35900), (-72000, 0), (36000, 0)])
def test_clear_turns_keeps_the_angle_within_the_turn(at: int, left: int) -> None:
    bench = Bench()
    bench.ask("move_multi_turn", position=at)
    bench.wait(5)
    bench.ask("clear_turns")
    assert bench.position() == left
    assert bench.read("read_single_turn")["angle"] == left


@pytest.mark.parametrize("command", ["clear_turns", "set_position", "set_zero"])
def test_motion_goes_on_when_its_position_gets_another_name(command: str) -> None:
    bench = Bench()
    bench.ask("move_multi_turn", position=100_000)
    bench.wait(0.7)
    moved = bench.drive.motor.motion.angle
    bench.ask(command)
    bench.wait(5)
    assert bench.drive.motor.motion.angle == pytest.approx(1000.0)
    assert moved < 900


def test_off_and_stop_keep_the_turns() -> None:
    bench = Bench()
    bench.ask("move_multi_turn", position=100_000)
    bench.wait(5)
    for command in ("stop", "motor_off", "motor_on"):
        bench.ask(command)
        assert bench.position() == 100_000


def test_power_up_is_on_released_at_rest_and_without_turns_or_errors() -> None:
    bench = Bench()
    bench.ask("move_multi_turn", position=100_000)
    bench.wait(5)
    bench.ask("brake", brake_control=0)
    bench.ask("motor_off")
    bench.drive.trip("overcurrent")
    bench.drive.trip("overcurrent", False)
    bench.drive.power_cycle(bench.t_ns)
    state = bench.read("read_state_1")
    assert (state["state"], state["overcurrent"]) == (0, 0)
    assert bench.read("brake", brake_control=0x10) == {"brake_state": 1}
    assert bench.position() == 28000
    bench.ask("run_speed", speed=9000)
    bench.wait(1)
    assert bench.speed() == 90
    bench.drive.power_cycle(bench.t_ns)
    assert bench.speed() == 0


def test_an_error_whose_cause_lasts_is_there_again_after_power_up() -> None:
    bench = Bench()
    bench.drive.supply(5)
    bench.drive.power_cycle(bench.t_ns)
    assert bench.read("read_state_1")["low_voltage"] == 1
