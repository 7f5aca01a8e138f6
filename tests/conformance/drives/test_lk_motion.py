"""The LK motor's motion against formulas written here anew, read through 0x92 and 0x9C as a host would."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from tests.conformance.drives.lk_bench import STEP_NS, Bench

RAMP = 3600.0  # deg/s2, of the power-up speed_ramp
LIMIT = 720.0  # deg/s, of the power-up speed_limit
MODELS = ("MF", "MG", "MH", "MS")


def trapezoid(distance: float, top: float, ramp: float, t: float) -> tuple[float, float]:
    """Return way and speed at `t` of a move from rest to rest: textbook trapezoid or triangle."""
    side, way = math.copysign(1.0, distance), abs(distance)
    if way * ramp <= top * top:
        top = math.sqrt(way * ramp)
    rise = top / ramp
    total = way / top + rise
    if t <= 0:
        return 0.0, 0.0
    if t >= total:
        return distance, 0.0
    if t < rise:
        return side * ramp * t * t / 2, side * ramp * t
    if t <= total - rise:
        return side * (top * rise / 2 + top * (t - rise)), side * top
    left = total - t
    return side * (way - ramp * left * left / 2), side * ramp * left


def close(got: float, expected: float) -> bool:
    """Within 1 LSB and 1 %."""
    return abs(got - expected) <= 1.0 and abs(got - expected) <= max(0.51, abs(expected) * 0.01)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(
    ("command", "values", "distance", "top"),
    [
        ("move_multi_turn", {"position": 36000}, 360.0, LIMIT),
        ("move_multi_turn", {"position": -500}, -5.0, LIMIT),
        ("move_multi_turn_limited", {"position": 123456, "max_speed": 20000}, 1234.56, 200.0),
        ("move_multi_turn_limited", {"position": -100001, "max_speed": 100000}, -1000.01, 1000.0),
        ("move_single_turn", {"direction": 0, "angle": 9000}, 90.0, LIMIT),
        ("move_single_turn", {"direction": 1, "angle": 9000}, -270.0, LIMIT),
        ("move_single_turn_limited", {"direction": 1, "angle": 35999, "max_speed": 4500}, -0.01, 45.0),
        ("move_increment", {"position": -72000}, -720.0, LIMIT),
        ("move_increment_limited", {"position": 33333, "max_speed": 333}, 333.33, 3.33),
    ],
)
def test_move_follows_the_trapezoid(model: str, command: str, values: dict[str, int], distance: float, top: float) -> None:
    bench = Bench(model=model)
    bench.ask(command, **values)
    total = abs(distance) / top + 2 * top / RAMP + 0.2
    for number in range(40):
        bench.t_ns = round(total * number / 40 * 1e9) + STEP_NS
        way, _ = trapezoid(distance, top, RAMP, bench.seconds)
        assert close(bench.position(), way * 100), (bench.seconds, way)
        _, speed = trapezoid(distance, top, RAMP, bench.seconds)
        assert close(bench.speed(), speed), (bench.seconds, speed)
    bench.t_ns = round((total + 1) * 1e9)
    assert bench.position() == round(distance * 100)
    assert bench.speed() == 0
    assert bench.drive.next_ns() is None


def test_next_ns_is_the_end_of_a_move() -> None:
    bench = Bench()
    bench.ask("move_multi_turn", position=36000)
    end_ns = bench.drive.next_ns()
    assert end_ns is not None
    assert end_ns / 1e9 == pytest.approx(360 / LIMIT + LIMIT / RAMP)
    bench.t_ns = end_ns
    assert bench.position() == 36000


@pytest.mark.parametrize("speed", [1, -1, 12345, -50000, 72000])
def test_speed_loop(speed: int) -> None:
    bench = Bench(model="MF")
    bench.ask("run_speed", speed=speed)
    rise = abs(speed) / 100 / RAMP
    for number in range(30):
        bench.t_ns = number * 20_000_000
        t = bench.seconds
        side = math.copysign(1.0, speed)
        way = RAMP * t * t / 2 if t < rise else abs(speed) / 100 * (t - rise / 2)
        assert close(bench.position(), side * way * 100)
        t = bench.seconds
        assert close(bench.speed(), side * min(RAMP * t, abs(speed) / 100))


@pytest.mark.parametrize("stop", [("stop", {}), ("run_speed", {"speed": 0})])
def test_stop_ramps_down_and_holds(stop: tuple[str, dict[str, int]]) -> None:
    bench = Bench()
    bench.ask("run_speed", speed=36_000)
    bench.wait(1)
    before, t0 = bench.position() / 100, bench.t_ns - STEP_NS
    bench.ask(stop[0], **stop[1])
    begun = before + 360 * (bench.t_ns - STEP_NS - t0) / 1e9
    bench.wait(1)
    rest = bench.position()
    assert close(rest, (begun + 360**2 / 2 / RAMP) * 100)
    bench.drive.turn_shaft(20.0)
    bench.wait(1)
    assert bench.position() == pytest.approx(rest + 2000, abs=1)  # a speed loop at 0 holds where it is
    assert bench.speed() == 0


@pytest.mark.parametrize(("model", "name"), [("MF", "torque_current"), ("MG", "torque_current"), ("MS", "power")])
@pytest.mark.parametrize("torque", [100, -333])
def test_torque_settles_by_the_first_order_law(model: str, name: str, torque: int) -> None:
    bench = Bench(model=model, settings={"current_ramp": 0})
    bench.ask("run_open_loop" if name == "power" else "run_torque", **{name: torque})
    build = bench.drive.motor.build
    settled = torque * build.settled_speed
    for number in range(1, 40):
        bench.t_ns = number * 30_000_000
        t = bench.seconds
        assert close(bench.position() / 100, settled * (t - build.lag * (1 - math.exp(-t / build.lag))))
        state = bench.read("read_state_2")
        assert close(state["speed"], settled * (1 - math.exp(-(bench.seconds - 0.001) / build.lag)))
        assert state[name] == torque
    bench.wait(3)
    assert bench.speed() == round(settled)


def test_torque_ramp() -> None:
    bench = Bench(settings={"current_ramp": 1000})
    bench.ask("run_torque", torque_current=500)
    for ms in (100, 250, 499, 600):
        bench.t_ns = ms * 1_000_000
        assert bench.read("read_state_2")["torque_current"] == pytest.approx(min(ms, 500), abs=1)
    # Against small steps: speed' = (level - speed) / lag.
    build, speed, step = bench.drive.motor.build, 0.0, 1e-5
    for number in range(60_000):
        level = min(1000 * number * step, 500) * build.settled_speed
        speed += (level - speed) / build.lag * step
    bench.t_ns = 600_000_000
    assert bench.speed() == pytest.approx(speed, rel=0.001)


def rest_time(distance: float, top: float) -> float:
    """Return the time of a move from rest to rest."""
    if distance * RAMP <= top * top:
        top = math.sqrt(distance * RAMP)
    return distance / top + top / RAMP if top else 0.0


def shortest_time(distance: float, speed: float, top: float) -> float:
    """Return the time of the fastest move from a turning shaft, out of moves from rest to rest."""
    if distance < 0:
        distance, speed = -distance, -speed
    brake = speed * speed / 2 / RAMP
    if speed < 0 or brake > distance:  # stops first, somewhere on the wrong side
        stop = math.copysign(brake, speed)
        return abs(speed) / RAMP + rest_time(abs(distance - stop), top)
    if speed > top:
        return speed / RAMP + (distance - brake) / top
    return rest_time(distance + brake, top) - speed / RAMP  # as though it had begun at rest further back


@pytest.mark.parametrize("start", [-700.0, -100.0, 0.0, 350.0, 720.0])
@pytest.mark.parametrize("target", [-2000.0, -30.0, 0.0, 10.0, 50.0, 72.0, 900.0])
def test_position_from_a_turning_shaft_is_fastest_within_its_limits(start: float, target: float) -> None:
    bench = Bench()
    bench.ask("run_speed", speed=round(start * 100))
    bench.wait(1)
    bench.ask("set_position", position=0)
    bench.t_ns -= STEP_NS
    begin_ns = bench.t_ns
    bench.ask("move_multi_turn_limited", position=round(target * 100), max_speed=50_000)
    end_ns = bench.drive.next_ns() or begin_ns
    assert (end_ns - begin_ns) / 1e9 == pytest.approx(shortest_time(target, start, 500.0), abs=1e-6)
    samples = []
    while bench.t_ns < end_ns:
        bench.drive.advance(bench.t_ns)
        samples.append(bench.drive.motor.motion)
        bench.t_ns += STEP_NS
    for before, after in pairwise(samples):
        assert abs(after.speed - before.speed) <= RAMP * 0.001 + 1e-6
        assert abs(after.speed) <= max(500.0, abs(before.speed)) + 1e-6
        assert abs(after.angle - before.angle) <= (max(abs(before.speed), abs(after.speed)) + RAMP * 0.001) * 0.001
    bench.wait(0.001)
    assert bench.position() == round(target * 100)
    assert bench.speed() == 0


def test_max_speed_0_lets_nothing_pass() -> None:
    bench = Bench()
    bench.ask("move_multi_turn_limited", position=36000, max_speed=0)
    bench.wait(5)
    assert bench.position() == 0


def test_limits_hold_at_once_for_what_is_under_way() -> None:
    bench = Bench()
    bench.ask("move_multi_turn", position=360_000)
    bench.wait(1)
    assert bench.speed() == LIMIT
    bench.ask("write_parameter", parameter=32, speed_limit=-9000)
    bench.wait(0.5)
    assert bench.speed() == 90
    bench.ask("write_parameter", parameter=32, speed_limit=72_000)
    bench.ask("write_parameter", parameter=38, speed_ramp=36_000)
    before = bench.speed()
    bench.wait(0.5)
    assert bench.speed() == pytest.approx(before + 360 * 0.501, abs=1.1)
    bench.wait(30)
    assert bench.position() == 360_000


def test_torque_limit_bounds_acceleration_and_torque() -> None:
    bench = Bench(model="MF", settings={"torque_limit": 90})
    bench.ask("run_speed", speed=36_000)
    bench.wait(0.1)
    assert bench.speed() == pytest.approx(90 * 3.0 / 0.15 * 0.101, abs=1)
    bench.ask("run_torque", torque_current=500)
    bench.wait(3)
    state = bench.read("read_state_2")
    assert state["torque_current"] == 90
    assert state["speed"] == 270


def test_without_torque_nothing_moves_and_nothing_brakes() -> None:
    bench = Bench(settings={"torque_limit": 0})
    for command, values in (
        ("run_speed", {"speed": 36000}),
        ("move_multi_turn", {"position": 9000}),
        ("move_single_turn", {"direction": 1, "angle": 9000}),
        ("run_torque", {"torque_current": 300}),
    ):
        bench.ask(command, **values)
        bench.wait(1)
        assert bench.position() == 0


def test_speed_ramp_0_leaves_the_torque_limit() -> None:
    bench = Bench(settings={"speed_ramp": 0, "torque_limit": 100})
    bench.ask("run_speed", speed=36_000)
    bench.wait(0.05)
    assert bench.speed() == pytest.approx(100 * 3.0 / 0.15 * 0.051, abs=1)


def test_off_lets_the_shaft_run_out() -> None:
    bench = Bench()
    bench.ask("run_speed", speed=36_000)
    bench.wait(1)
    at, t0 = bench.position(), bench.t_ns - STEP_NS
    bench.ask("motor_off")
    begun = at / 100 + 360 * (bench.t_ns - STEP_NS - t0) / 1e9
    bench.wait(3)
    assert bench.position() / 100 == pytest.approx(begun + 360 * 0.15, abs=0.02)
    assert bench.speed() == 0


def test_brake_and_hand_hold_the_shaft_and_the_rest_is_done_later() -> None:
    bench = Bench()
    bench.ask("move_multi_turn", position=36000)
    bench.wait(0.3)
    assert bench.read("brake", brake_control=0x00) == {"brake_state": 0}
    at = bench.position()
    bench.wait(0.5)
    state = bench.read("read_state_2")
    assert bench.position() == at
    assert state["speed"] == 0
    assert state["torque_current"] == 2048
    assert bench.read("brake", brake_control=0x10) == {"brake_state": 0}
    assert bench.read("brake", brake_control=0x01) == {"brake_state": 1}
    bench.wait(2)
    assert bench.position() == 36000
    bench.drive.block()
    bench.ask("move_multi_turn", position=0)
    bench.wait(0.5)
    assert bench.position() == 36000
    bench.drive.block(False)
    bench.wait(2)
    assert bench.position() == 0


def test_a_hand_turns_what_is_not_held() -> None:
    bench = Bench()
    bench.drive.turn_shaft(-30.0)
    assert bench.position() == -3000
    assert bench.read("read_single_turn")["angle"] == 33000
    bench.ask("move_multi_turn", position=0)
    bench.wait(2)
    bench.drive.turn_shaft(15.0)
    assert bench.position() > 1000
    bench.wait(2)
    assert bench.position() == 0  # a position loop goes back
    bench.drive.block()
    bench.drive.turn_shaft(15.0)
    assert bench.position() == 0
