"""Exchanges with an LK drive that show faults which no claim refutes: what it hears, tells and keeps, and its motion."""

from __future__ import annotations

from analyzer.link import sum8
from tests.conformance.drives.lk_bench import Bench, look


def echoes(bench: Bench) -> None:
    for name in ("motor_off", "motor_on", "stop", "clear_turns"):
        bench.ask(name)
    bench.ask("set_position", position=-123456)


def kept(bench: Bench) -> None:
    """Look at what is stored and told after each command that stores nothing."""
    bench.ask("write_parameter", parameter=11, speed_kp=7, speed_ki=8, speed_kd=9)
    bench.ask("write_parameter", parameter=10, angle_kp=7, angle_ki=8, angle_kd=9)
    bench.ask("write_parameter", parameter=32, speed_limit=50_000)
    bench.drive.supply(30)
    bench.drive.hot(70)
    bench.drive.turn_shaft(500.0)
    for present in (True, False):
        bench.drive.trip("overcurrent", present)
    for name in (
        "read_state_1",
        "read_state_1",
        "read_state_2",
        "stop",
        "motor_off",
        "motor_on",
        "clear_errors",
        "clear_turns",
    ):
        bench.ask(name)
        bench.ask("read_position")
        for number in (10, 11, 32):
            bench.ask("read_parameter", parameter=number)


def errors(bench: Bench) -> None:
    bench.ask("read_state_1")
    bench.drive.supply(8)
    bench.ask("read_state_1")
    bench.ask("clear_errors")
    bench.drive.supply(24)
    bench.ask("clear_errors")
    bench.ask("run_speed", speed=1000)
    bench.wait(0.5)
    look(bench)


def zero(bench: Bench) -> None:
    bench.drive.turn_shaft(100.0)
    bench.ask("set_zero")
    bench.ask("read_encoder")
    bench.drive.power_cycle(bench.t_ns)
    bench.ask("read_encoder")
    bench.drive.turn_shaft(10.0)
    bench.ask("set_zero")
    bench.ask("read_encoder")


def multi_turn(bench: Bench) -> None:
    """Move from 50 degrees, called 100, and look during and after it."""
    bench.drive.turn_shaft(50.0)
    bench.ask("set_position", position=10_000)
    bench.ask("move_multi_turn", position=25_000)
    for seconds in (0.145, 0.145, 0.145, 2):
        bench.wait(seconds)
        look(bench)


def stop(bench: Bench) -> None:
    bench.ask("run_speed", speed=50_000)
    bench.wait(2)
    bench.ask("run_speed", speed=50_000)
    bench.ask("stop")
    bench.wait(0.05)
    look(bench)
    bench.ask("read_state_1")
    bench.wait(1)
    look(bench)


def limits(bench: Bench) -> None:
    bench.ask("write_parameter", parameter=32, speed_limit=20_000)
    bench.ask("write_parameter", parameter=30, torque_limit=100)
    bench.ask("write_parameter", parameter=38, speed_ramp=150_000)
    bench.ask("write_parameter", parameter=34, angle_limit=4000)
    for number in (30, 32, 34, 38):
        bench.ask("read_parameter", parameter=number)
    bench.ask("run_speed", speed=60_000)
    bench.wait(0.1)
    look(bench)
    bench.wait(1)
    look(bench)
    bench.ask("motor_off")
    bench.wait(2)
    bench.ask("motor_on")
    bench.ask("set_position", position=0)
    bench.ask("move_multi_turn", position=9000)
    bench.wait(2)
    look(bench)


def torque_limit(bench: Bench) -> None:
    bench.ask("write_parameter", parameter=30, torque_limit=100)
    bench.ask("run_torque", torque_current=300)
    bench.wait(1)
    look(bench)


def afterwards(bench: Bench) -> None:
    """Things that hold on from what was before: a force, a stopped move, a ramp, a run, a position, flags."""
    for torque in (90, 0, 90):
        bench.ask("run_torque", torque_current=torque)
        bench.wait(0.3)
        look(bench)
        bench.ask("read_state_3")
    bench.ask("stop")
    bench.wait(2)
    look(bench)
    for command in ("motor_off", "read_state_3", "motor_on"):
        bench.ask(command)
        bench.wait(0.5)
    bench.ask("brake", brake_control=1)
    for command, increment in (("move_increment", 180_000), ("stop", None), ("move_increment", 1_000)):
        bench.ask(command, **({} if increment is None else {"position": increment}))
        bench.wait(0.2 if increment != 1_000 else 2)
    look(bench)
    bench.ask("brake", brake_control=16)
    for speed in (50, 1_000):
        bench.ask("run_speed", speed=speed)
        bench.wait(1)
        look(bench)
    bench.ask("write_parameter", parameter=38, speed_ramp=1_000)
    bench.ask("run_speed", speed=5_000)
    bench.wait(0.5)
    look(bench)
    bench.ask("stop")
    bench.wait(20)
    head = bytes((0x3E, 0xA2, 1, 0))
    bench.send(head + bytes((sum8(head),)))
    bench.wait(1)
    look(bench)
    bench.ask("stop")
    bench.ask("write_parameter", parameter=38, speed_ramp=360_000)
    bench.wait(1)
    bench.ask("set_position", position=12_345)
    bench.ask("move_single_turn", direction=0, angle=1_000)
    bench.wait(2)
    look(bench)
    for present in (True, False):
        bench.drive.trip("overcurrent", present)
    bench.ask("clear_errors")


SCRIPTS = (multi_turn, echoes, errors, zero, stop, limits, torque_limit, kept, afterwards)
