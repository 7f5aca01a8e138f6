"""What the LK drive is like at power-up, as far as hands or harm come between; claims judge what it keeps and for how long."""

from __future__ import annotations

from tests.conformance.drives.lk_bench import Bench


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
