"""Exchanges with an LK drive that show what it hears, tells and keeps."""

from __future__ import annotations

from analyzer.link import sum8
from tests.conformance.drives.lk_bench import Bench, Script, look


def echoes(bench: Bench) -> None:
    for name in ("motor_off", "motor_on", "stop", "clear_turns"):
        bench.ask(name)
    bench.ask("set_position", position=-123456)


def readings(bench: Bench) -> None:
    bench.drive.supply(19.5)
    bench.drive.hot(-7)
    bench.ask("run_speed", speed=-30_000)
    bench.wait(0.5)
    for name in ("read_state_1", "read_state_2", "read_encoder", "read_position", "read_single_turn"):
        bench.ask(name)
    for number in (10, 30, 32):
        bench.ask("read_parameter", parameter=number)


def phases(bench: Bench) -> None:
    bench.ask("run_torque", torque_current=700)
    bench.wait(1)
    bench.ask("read_state_3")


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


def wrong_heads(bench: Bench) -> None:
    """Send what stops and clears with a head whose sum is wrong, and look."""
    bench.drive.turn_shaft(500.0)
    bench.ask("run_speed", speed=18_000)
    bench.wait(0.5)
    for name in ("stop", "clear_turns", "clear_errors"):
        if name == "clear_errors":
            for present in (True, False):
                bench.drive.trip("overcurrent", present)
        request = bytearray(bench.request(name))
        request[4] ^= 1
        bench.send(bytes(request))
        bench.wait(0.5)
        look(bench)
        bench.ask("read_state_1")


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


def position_and_power(bench: Bench) -> None:
    bench.ask("set_position", position=500)
    bench.ask("read_position")
    bench.drive.power_cycle(bench.t_ns)
    bench.ask("read_position")


def turns(bench: Bench) -> None:
    bench.ask("move_multi_turn", position=100_000)
    bench.wait(3)
    look(bench)
    bench.ask("clear_turns")
    look(bench)


def whole_turns(bench: Bench) -> None:
    """Stand at the angle 0, within the first turn and behind another."""
    for _ in range(2):
        bench.ask("move_single_turn", direction=0, angle=0)
        bench.wait(3)
        bench.ask("read_single_turn")
        bench.ask("move_increment", position=36_000)
        bench.wait(3)
        bench.ask("read_single_turn")


def gains(bench: Bench) -> None:
    bench.ask("write_parameter", parameter=11, speed_kp=1, speed_ki=2, speed_kd=3)
    for number in (10, 11, 12):
        bench.ask("read_parameter", parameter=number)


def parameters_and_power(bench: Bench) -> None:
    bench.ask("write_parameter", parameter=32, speed_limit=20_000)
    bench.drive.power_cycle(bench.t_ns)
    bench.ask("read_parameter", parameter=32)


def states(bench: Bench) -> None:
    """Look at everything in each state: backwards, stopped, off, with an error flag, beyond a limit."""
    bench.ask("set_position", position=100_000)
    bench.ask("stop")
    look(bench)
    for ended_by in ("clear_turns", "stop", "motor_off"):
        bench.ask("run_speed", speed=-50_000)
        bench.wait(1)
        look(bench)
        bench.ask("read_parameter", parameter=32)
        bench.ask(ended_by)
        bench.wait(0.5)
        look(bench)
    bench.ask("clear_errors")
    bench.ask("read_state_1")
    bench.ask("motor_on")
    bench.drive.trip("motor_hot")
    bench.ask("read_encoder")
    bench.drive.trip("motor_hot", False)
    bench.ask("clear_errors")
    bench.ask("motor_on")
    bench.ask("set_position", position=0)
    bench.ask("write_parameter", parameter=34, angle_limit=4000)
    bench.ask("move_multi_turn", position=-8000)
    bench.wait(3)
    look(bench)


def strangers(bench: Bench) -> None:
    for address in (0, 2, 33):
        bench.send(bench.request("read_state_2", address=address))
    bench.send(raw(0x9F))
    bench.send(raw(0xA2, b"\1\2"))
    for frame in (bench.request("run_speed", speed=30_000), bench.request("read_position")):
        for at in (4, len(frame) - 1):
            spoiled = bytearray(frame)
            spoiled[at] ^= 1
            bench.send(bytes(spoiled))
    bench.send(bench.request("move_increment", address=2, position=500))
    bench.wait(0.3)
    look(bench)


def raw(code: int, data: bytes = b"") -> bytes:
    head = bytes((0x3E, code, 1, len(data)))
    return head + bytes((sum8(head),)) + (data + bytes((sum8(data),)) if data else b"")


def wide_zero(bench: Bench) -> None:
    bench.drive.turn_shaft(250.0)
    bench.ask("set_zero")
    bench.drive.power_cycle(bench.t_ns)
    bench.ask("read_encoder")
    bench.ask("motor_off")
    bench.drive.trip("overcurrent")
    bench.drive.trip("overcurrent", False)
    bench.ask("clear_errors")
    bench.ask("read_state_1")


TOLD: dict[str, Script] = {
    "wide zero": wide_zero,
    "kept": kept,
    "wrong heads": wrong_heads,
    "echoes": echoes,
    "readings": readings,
    "phases": phases,
    "errors": errors,
    "zero": zero,
    "position and power": position_and_power,
    "turns": turns,
    "whole turns": whole_turns,
    "gains": gains,
    "parameters and power": parameters_and_power,
    "states": states,
    "strangers": strangers,
}
