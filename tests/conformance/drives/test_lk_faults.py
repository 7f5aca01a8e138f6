"""Each named fault of the LK drive shows on the bus: an exchange whose answer differs from the conforming drive's."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable

import pytest

from analyzer.link import sum8
from conformance.drives.drive import Fault
from conformance.drives.make import every_fault
from tests.conformance.claims.test_conditions import REFUTED_BY
from tests.conformance.drives.lk_bench import Bench

Script = Callable[[Bench], None]
#: The faults that only an LK drive has; the others are shown by the claims that refute them.
FAULTS = [fault for fault in every_fault() if fault.dialects == ("lk-rs485",) and fault.name not in REFUTED_BY]


# --- exchanges --------------------------------------------------------------------------------------------------------


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


def afterwards(bench: Bench) -> None:
    """Things that hold on from what was before: a force, a stopped move, a ramp, a run, a position, flags."""
    for torque in (90, 0, 90):
        bench.ask("run_torque" if bench.drive.model != "MS" else "run_open_loop", **{_force(bench): torque})
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


def _force(bench: Bench) -> str:
    return "power" if bench.drive.model == "MS" else "torque_current"


def look(bench: Bench) -> None:
    bench.ask("read_state_2")
    bench.ask("read_position")
    bench.ask("read_single_turn")


def asking(command: str, seconds: float = 2.0, /, **values: int) -> Script:
    """Give one command at 50 degrees, called 100, and look during and after it."""

    def script(bench: Bench) -> None:
        bench.drive.turn_shaft(50.0)
        bench.ask("set_position", position=10_000)
        bench.ask(command, **values)
        for _ in range(3):
            bench.wait(0.145)
            look(bench)
        bench.wait(seconds)
        look(bench)

    return script


def off(bench: Bench) -> None:
    bench.ask("run_speed", speed=30_000)
    bench.wait(0.5)
    bench.ask("motor_off")
    bench.ask("read_state_1")
    bench.wait(2)
    look(bench)
    bench.ask("move_increment", position=9000)
    bench.wait(1)
    look(bench)
    bench.ask("motor_on")
    bench.ask("read_state_1")
    bench.wait(1)
    look(bench)


def over_others(bench: Bench) -> None:
    """Let motion of one kind take over from another, and look."""
    bench.drive.turn_shaft(50.0)
    for older, newer in (
        (("run_speed", {"speed": 18_000}), ("move_increment", {"position": -9_000})),
        (("move_multi_turn_limited", {"position": 72_000, "max_speed": 18_000}), ("run_speed", {"speed": -18_000})),
        (("run_speed", {"speed": -18_000}), ("move_single_turn", {"angle": 9_000, "direction": 0})),
        (("run_torque", {"torque_current": 200}), ("move_multi_turn", {"position": 0})),
    ):
        bench.ask(older[0], **older[1])
        for _ in range(2):
            bench.wait(0.3)
            look(bench)
            bench.ask("read_encoder")
        bench.ask(newer[0], **newer[1])
        bench.drive.hot(47)
        bench.wait(0.3)
        look(bench)
        bench.ask("stop")
        bench.wait(1)


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


def brake(bench: Bench) -> None:
    for control in (0x10, 0x00, 0x10, 0x10):
        bench.ask("brake", brake_control=control)
    bench.ask("move_increment", position=500)
    bench.wait(0.5)
    look(bench)
    bench.ask("brake", brake_control=0x01)


def far(bench: Bench) -> None:
    bench.ask("set_position", position=2**31 - 10)
    bench.ask("move_increment", position=100)
    bench.wait(1)
    bench.ask("read_position")
    bench.ask("set_position", position=0)
    bench.ask("move_multi_turn", position=2**32 - 100)
    bench.wait(0.5)
    bench.ask("read_position")


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


def very_fast(bench: Bench) -> None:
    """Run and move at speeds of which 24 bits leave nothing."""
    bench.ask("run_speed", speed=1 << 29)
    bench.wait(0.1)
    look(bench)
    bench.ask("stop")
    bench.wait(2)
    bench.ask("move_increment_limited", position=72_000, max_speed=1 << 31)
    bench.wait(0.1)
    look(bench)


def limited_below(bench: Bench) -> None:
    """Run counter-clockwise beyond a speed limit."""
    bench.ask("write_parameter", parameter=32, speed_limit=10_000)
    bench.ask("run_speed", speed=-36_000)
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


def ended(name: str, seconds: float, **values: int) -> Script:
    """Ask for a motion and end it by a stop, and by switching off; look, and ask for a move without switching on."""

    def script(bench: Bench) -> None:
        for ended_by in ("stop", "motor_off"):
            bench.ask(name, **values)
            bench.wait(seconds)
            look(bench)
            bench.ask(ended_by)
            bench.wait(1)
            look(bench)
            bench.ask("move_increment", position=500)
            bench.wait(0.5)
            look(bench)
            bench.ask("motor_on")
            bench.wait(1)

    return script


def lengths(bench: Bench) -> None:
    for position in (36_000, -200_000):
        bench.ask("move_increment_limited", position=position, max_speed=70_000)
        bench.wait(5)
        look(bench)
    bench.ask("clear_turns")
    look(bench)


def raw(code: int, data: bytes = b"") -> bytes:
    head = bytes((0x3E, code, 1, len(data)))
    return head + bytes((sum8(head),)) + (data + bytes((sum8(data),)) if data else b"")


def other_models(bench: Bench) -> None:
    bench.send(raw(0xA0, b"\x64\0"))
    bench.send(raw(0xA1, b"\x64\0"))
    bench.wait(0.5)
    look(bench)


def changed(bench: Bench) -> None:
    """Change speeds by a slow ramp; move without torque, behind a slow move, and against the brake."""
    bench.ask("write_parameter", parameter=38, speed_ramp=36_000)
    for speed in (36_000, 18_000, -18_000):
        bench.ask("run_speed", speed=speed)
        bench.wait(0.3)
        look(bench)
        bench.wait(1.0)
    bench.ask("brake", brake_control=0)
    bench.wait(0.1)
    look(bench)
    bench.ask("brake", brake_control=1)
    bench.ask("stop")
    bench.ask("move_increment_limited", position=100, max_speed=500)
    bench.wait(1)
    bench.ask("move_multi_turn", position=90_000)
    bench.wait(1)
    look(bench)
    bench.ask("stop")
    bench.ask("write_parameter", parameter=30, torque_limit=0)
    bench.ask("move_increment", position=9_000)
    bench.wait(1)
    look(bench)


def below(bench: Bench) -> None:
    """Turn faster and to places below zero, by a ramp, beyond a speed limit; take torque away under way."""
    bench.ask("write_parameter", parameter=38, speed_ramp=36_000)
    for speed in (-18_000, -36_000):
        bench.ask("run_speed", speed=speed)
        bench.wait(1)
        look(bench)
    bench.ask("stop")
    bench.wait(2)
    bench.ask("set_position", position=0)
    for command, position in (("move_multi_turn_limited", -72_000), ("move_increment_limited", -72_000)):
        bench.ask(command, position=position, max_speed=500)
        for _ in range(3):
            bench.wait(0.4)
            look(bench)
        bench.ask("stop")
        bench.wait(2)
    bench.ask("write_parameter", parameter=32, speed_limit=10_000)
    bench.ask("move_increment", position=72_000)
    for limit in (5_000, 10_000):
        bench.wait(1)
        look(bench)
        bench.ask("write_parameter", parameter=32, speed_limit=limit)
    bench.ask("stop")
    bench.wait(2)
    bench.ask("run_torque", torque_current=300)
    bench.wait(0.2)
    bench.ask("write_parameter", parameter=30, torque_limit=10)
    bench.wait(0.5)
    look(bench)


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


SCRIPTS: dict[str, Script] = {
    "changed": changed,
    "below": below,
    "wide zero": wide_zero,
    "over others": over_others,
    "kept": kept,
    "afterwards": afterwards,
    "wrong heads": wrong_heads,
    "echoes": echoes,
    "readings": readings,
    "phases": phases,
    "off": off,
    "stop": stop,
    "errors": errors,
    "brake": brake,
    "far": far,
    "zero": zero,
    "position and power": position_and_power,
    "turns": turns,
    "whole turns": whole_turns,
    "very fast": very_fast,
    "limited below": limited_below,
    "limits": limits,
    "torque limit": torque_limit,
    "gains": gains,
    "parameters and power": parameters_and_power,
    "states": states,
    "strangers": strangers,
    "other models": other_models,
    "speed": asking("run_speed", speed=-30_000),
    "crawl": asking("run_speed", speed=100),
    "fast": asking("run_speed", speed=70_000),
    "torque": asking("run_torque", torque_current=-500),
    "highest torque": asking("run_torque", torque_current=2048),
    "too much torque": asking("run_torque", torque_current=2049),
    "lowest torque": asking("run_torque", torque_current=-2048),
    "too little torque": asking("run_torque", torque_current=-2049),
    "far too much torque": asking("run_torque", torque_current=9999),
    "lowest power": asking("run_open_loop", power=-850),
    "too little power": asking("run_open_loop", power=-851),
    "far too much power": asking("run_open_loop", power=9999),
    "highest power": asking("run_open_loop", power=850),
    "too much power": asking("run_open_loop", power=851),
    "multi-turn": asking("move_multi_turn", position=25_000),
    "slow": asking("move_multi_turn_limited", position=25_000, max_speed=5000),
    "clockwise": asking("move_single_turn", direction=0, angle=26_000),
    "counter-clockwise": asking("move_single_turn", direction=1, angle=1000),
    "highest angle": asking("move_single_turn", direction=0, angle=35_999),
    "lowest angle": asking("move_single_turn", direction=0, angle=0),
    "360 degrees": asking("move_single_turn", direction=0, angle=36_000),
    "too high an angle": asking("move_single_turn", direction=0, angle=40_000),
    "no direction": asking("move_single_turn", direction=2, angle=9000),
    "increment": asking("move_increment", position=-9000),
    "ended torque": ended("run_torque", 0.5, torque_current=60),
    "ended move": ended("move_increment_limited", 0.5, position=30_000, max_speed=9_000),
    "lengths": lengths,
}
MS_SCRIPTS = {name for name in SCRIPTS if "power" in name} - {"parameters and power", "position and power"}

#: The exchange that shows each fault.
SHOWN_BY: dict[str, str] = {
    "lk-data-sum-wrong": "readings",
    "lk-head-sum-wrong": "readings",
    "lk-data-sum-missing": "readings",
    "lk-data-sum-of-nothing": "echoes",
    "lk-data-sum-with-head": "readings",
    "lk-head-sum-without-start": "echoes",
    "lk-reply-start-wrong": "echoes",
    "lk-reply-code-wrong": "speed",
    "lk-echo-code-wrong": "echoes",
    "lk-reply-address-wrong": "readings",
    "lk-reply-length-wrong": "readings",
    "lk-reply-short": "speed",
    "lk-motion-reply-empty": "multi-turn",
    "lk-set-position-reply-empty": "echoes",
    "lk-echo-with-status": "echoes",
    "lk-parameter-bytes-shifted": "gains",
    "lk-answers-other-address": "strangers",
    "lk-answers-address-0": "strangers",
    "lk-answers-wrong-data-sum": "strangers",
    "lk-answers-wrong-head-sum": "strangers",
    "lk-answers-unknown-code": "strangers",
    "lk-answers-wrong-length": "strangers",
    "lk-silent-while-off": "off",
    "lk-reply-late": "readings",
    "lk-reply-lost": "readings",
    "lk-reply-twice": "readings",
    "lk-reply-cut": "readings",
    "lk-reply-noise": "readings",
    "lk-speed-bytes-swapped": "readings",
    "lk-angle-bytes-swapped": "readings",
    "lk-voltage-bytes-swapped": "readings",
    "lk-asked-speed-swapped": "speed",
    "lk-asked-angle-swapped": "clockwise",
    "lk-speed-sign-lost": "speed",
    "lk-position-sign-lost": "readings",
    "lk-torque-sign-lost": "torque",
    "lk-asked-speed-sign-lost": "speed",
    "lk-increment-sign-lost": "increment",
    "lk-temperature-unsigned": "readings",
    "lk-position-int32": "far",
    "lk-target-int32": "far",
    "lk-asked-speed-int16": "fast",
    "lk-asked-speed-24-bit": "very fast",
    "lk-max-speed-24-bit": "very fast",
    "lk-parameter-int16": "limits",
    "lk-asked-speed-tenfold": "speed",
    "lk-speed-tenth": "speed",
    "lk-position-tenth": "multi-turn",
    "lk-target-tenfold": "multi-turn",
    "lk-voltage-tenth": "readings",
    "lk-torque-half": "torque",
    "lk-max-speed-tenfold": "slow",
    "lk-angle-doubled": "readings",
    "lk-encoder-bytes-swapped": "readings",
    "lk-encoder-doubled": "readings",
    "lk-encoder-half-width": "readings",
    "lk-position-bytes-swapped": "readings",
    "lk-position-doubled": "readings",
    "lk-position-half-width": "readings",
    "lk-position-sign-turned": "readings",
    "lk-speed-doubled": "readings",
    "lk-speed-half-width": "readings",
    "lk-speed-sign-turned": "readings",
    "lk-torque-bytes-swapped": "torque",
    "lk-torque-doubled": "torque",
    "lk-torque-half-width": "torque",
    "lk-torque-sign-turned": "torque",
    "lk-voltage-doubled": "readings",
    "lk-voltage-half-width": "readings",
    "lk-voltage-sign-turned": "readings",
    "lk-torque-any": "too much torque",
    "lk-power-any": "too much power",
    "lk-torque-short": "highest torque",
    "lk-power-short": "highest power",
    "lk-torque-short-below": "lowest torque",
    "lk-torque-one-more": "too much torque",
    "lk-torque-one-less": "too little torque",
    "lk-power-short-below": "lowest power",
    "lk-power-one-more": "too much power",
    "lk-power-one-less": "too little power",
    "lk-angle-one-more": "360 degrees",
    "lk-angle-not-0": "lowest angle",
    "lk-direction-not-1": "counter-clockwise",
    "lk-angle-any": "too high an angle",
    "lk-angle-short": "highest angle",
    "lk-direction-any": "no direction",
    "lk-state-1-swapped": "readings",
    "lk-state-always-on": "off",
    "lk-error-bits-shifted": "errors",
    "lk-error-bits-hidden": "errors",
    "lk-error-bits-frozen": "errors",
    "lk-encoder-not-offset": "zero",
    "lk-encoder-offset-added": "zero",
    "lk-encoder-coarse": "readings",
    "lk-single-turn-runs-on": "turns",
    "lk-position-single-turn": "turns",
    "lk-phases-in-step": "phases",
    "lk-zero-not-raw": "zero",
    "lk-parameter-other": "gains",
    "lk-gains-swapped": "gains",
    "lk-parameter-write-zeros": "gains",
    "lk-brake-state-inverted": "brake",
    "lk-brake-state-unlisted": "brake",
    "lk-brake-read-releases": "brake",
    "lk-single-turn-inverted": "clockwise",
    "lk-single-turn-shortest": "clockwise",
    "lk-speed-inverted": "speed",
    "lk-increment-absolute": "increment",
    "lk-multi-turn-relative": "multi-turn",
    "lk-max-speed-ignored": "slow",
    "lk-speed-limit-ignored": "limits",
    "lk-speed-ramp-ignored": "limits",
    "lk-torque-limit-ignored": "torque limit",
    "lk-angle-limit-ignored": "limits",
    "lk-angle-limit-above-only": "states",
    "lk-run-no-faster-below": "below",
    "lk-max-speed-half-below": "below",
    "lk-ramp-steep-below": "below",
    "lk-speed-limit-below-only": "below",
    "lk-run-limit-clockwise-only": "limited below",
    "lk-torque-limit-late": "below",
    "lk-speed-limit-late": "below",
    "lk-reads-silent-while-off": "states",
    "lk-parameters-silent-while-turning": "states",
    "lk-reads-silent-in-error": "states",
    "lk-stop-ignored-backwards": "states",
    "lk-stop-drops-turns-of-a-run": "states",
    "lk-off-drops-turns-of-a-run": "states",
    "lk-turns-kept-while-turning": "states",
    "lk-clear-errors-turns-off": "states",
    "lk-cleared-state-always-on": "states",
    "lk-increment-lost-in-a-run": "over others",
    "lk-run-lost-in-a-move": "over others",
    "lk-move-lost-in-a-torque": "over others",
    "lk-single-turn-lost-backwards": "over others",
    "lk-single-turn-frozen-backwards": "over others",
    "lk-encoder-frozen-turning": "over others",
    "lk-cleared-flags-told": "afterwards",
    "lk-motion-tells-last-read": "afterwards",
    "lk-brake-reads-on-after-motion": "afterwards",
    "lk-slow-runs-stand": "afterwards",
    "lk-single-turn-by-position": "afterwards",
    "lk-increment-of-stopped-move": "afterwards",
    "lk-ramp-when-standing": "afterwards",
    "lk-no-torque-ignored": "afterwards",
    "lk-phases-told-while-off": "afterwards",
    "lk-torque-told-after-stop": "afterwards",
    "lk-run-without-data-repeats": "afterwards",
    "lk-gains-lost-by-stop": "kept",
    "lk-gains-lost-by-off": "kept",
    "lk-limit-lost-by-clearing": "kept",
    "lk-voltage-capped": "kept",
    "lk-temperature-capped": "kept",
    "lk-flags-read-away": "kept",
    "lk-clear-turns-to-zero": "kept",
    "lk-stop-unchecked": "wrong heads",
    "lk-clear-turns-unchecked": "wrong heads",
    "lk-clear-errors-unchecked": "wrong heads",
    "lk-phases-doubled": "phases",
    "lk-ramp-fast": "multi-turn",
    "lk-ramp-slow": "multi-turn",
    "lk-overshoot": "multi-turn",
    "lk-stops-short": "multi-turn",
    "lk-stop-is-off": "stop",
    "lk-stop-coasts": "stop",
    "lk-stop-ignored": "stop",
    "lk-stop-clears-turns": "stop",
    "lk-off-still-moves": "off",
    "lk-off-keeps-running": "off",
    "lk-off-ignored": "off",
    "lk-on-needed-twice": "off",
    "lk-on-resumes": "off",
    "lk-off-at-power-up": "speed",
    "lk-brake-without-effect": "brake",
    "lk-brake-backwards": "brake",
    "lk-clear-errors-always": "errors",
    "lk-clear-errors-never": "errors",
    "lk-set-position-ignored": "position and power",
    "lk-set-position-kept": "position and power",
    "lk-clear-turns-ignored": "turns",
    "lk-zero-at-once": "zero",
    "lk-zero-lost": "zero",
    "lk-parameter-not-stored": "gains",
    "lk-parameter-elsewhere": "gains",
    "lk-parameter-survives": "parameters and power",
    "lk-ms-runs-torque": "other models",
    "lk-runs-open-loop": "other models",
    "lk-obeys-other-address": "strangers",
    "lk-obeys-wrong-data-sum": "strangers",
    "lk-obeys-wrong-head-sum": "strangers",
    "lk-stop-keeps-torque": "ended torque",
    "lk-stop-keeps-moves": "ended move",
    "lk-stop-needs-on": "ended move",
    "lk-off-keeps-torque": "ended torque",
    "lk-state-2-cold": "readings",
    "lk-state-3-cold": "phases",
    "lk-motion-cold": "speed",
    "lk-motion-temperature-first": "over others",
    "lk-motion-encoder-stale": "over others",
    "lk-motion-current-stale": "over others",
    "lk-motion-speed-0": "stop",
    "lk-motion-encoder-raw": "speed",
    "lk-cleared-no-voltage": "errors",
    "lk-supply-current-swapped": "readings",
    "lk-reads-silent-moving": "readings",
    "lk-reads-unfit-moving": "readings",
    "lk-off-while-turning": "readings",
    "lk-stalled-while-turning": "readings",
    "lk-zero-not-told": "zero",
    "lk-single-turn-shifted": "turns",
    "lk-single-turn-36000": "whole turns",
    "lk-single-turn-36000-turned": "whole turns",
    "lk-whole-turns-ignored": "lengths",
    "lk-fast-moves-long": "lengths",
    "lk-clear-turns-upward": "lengths",
    "lk-torque-limit-of-runs-alone": "changed",
    "lk-torque-half-range": "highest torque",
    "lk-max-speed-kept": "changed",
    "lk-ramp-steep-turning-round": "changed",
    "lk-ramp-steep-slowing": "changed",
    "lk-brake-lost-while-turning": "changed",
    "lk-late-while-turning": "changed",
    "lk-errors-kept-while-off": "wide zero",
    "lk-zero-short": "wide zero",
}


def model_of(script: str, fault: str = "") -> str:
    return "MS" if script in MS_SCRIPTS or fault == "lk-ms-runs-torque" else "MF"


def played(script: str, model: str, *faults: Fault) -> list[list[tuple[int, str]]]:
    bench = Bench(model=model, faults=faults)
    SCRIPTS[script](bench)
    return bench.trace


def test_each_fault_has_its_exchange() -> None:
    names = [fault.name for fault in FAULTS]
    assert len(names) == len(set(names)) >= 30
    assert set(SHOWN_BY) == set(names)
    assert set(SHOWN_BY.values()) <= set(SCRIPTS)


@pytest.mark.parametrize("fault", FAULTS, ids=lambda f: f.name)
def test_fault_shows(fault: Fault) -> None:
    script = SHOWN_BY[fault.name]
    model = model_of(script, fault.name)
    assert played(script, model) == played(script, model)
    assert played(script, model, fault) != played(script, model)


@pytest.mark.parametrize("fault", FAULTS, ids=lambda f: f.name)
def test_fault_says_what_it_is(fault: Fault) -> None:
    assert fault.name.startswith("lk-")
    assert fault.name == fault.name.lower()
    assert " " not in fault.name
    assert "_" not in fault.name
    assert fault.dialects == ("lk-rs485",)
    assert fault.text
    assert not fault.text.endswith(".")
    assert fault.breaks


@pytest.mark.parametrize("fault", FAULTS, ids=lambda f: f.name)
def test_fault_never_raises(fault: Fault) -> None:
    for script in SCRIPTS.values():
        script(Bench(model="MS", faults=(fault,)))


def test_no_two_faults_are_one() -> None:
    """Over all exchanges, two faults differ somewhere; those that differ already are not played again."""
    alike = [list(FAULTS)]
    for name in SCRIPTS:
        shown = defaultdict(list)
        for number, group in enumerate(alike):
            for fault in group:
                shown[number, repr(played(name, model_of(name, fault.name), fault))].append(fault)
        alike = [group for group in shown.values() if len(group) > 1]
    assert alike == []


def test_faults_of_one_drive_are_not_those_of_another() -> None:
    faulty, good = Bench(faults=FAULTS[:1]), Bench()
    readings(faulty)
    readings(good)
    assert good.trace == played("readings", "MF")
    assert faulty.trace != good.trace
