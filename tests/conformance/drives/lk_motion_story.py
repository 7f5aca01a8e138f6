"""Exchanges with an LK drive that show its motion: where it goes, how fast, and what begins and ends it."""

from __future__ import annotations

from analyzer.link import sum8
from tests.conformance.drives.lk_bench import Bench, Script, look
from tests.conformance.drives.lk_story import raw


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


MOVED: dict[str, Script] = {
    "changed": changed,
    "below": below,
    "over others": over_others,
    "afterwards": afterwards,
    "off": off,
    "stop": stop,
    "brake": brake,
    "far": far,
    "very fast": very_fast,
    "limited below": limited_below,
    "limits": limits,
    "torque limit": torque_limit,
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
