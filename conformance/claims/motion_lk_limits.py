"""What the control parameters of LK motors (C1) do to motion: observed, for the manual does not say that they are limits.

The manual has parameters called speed limit, angle limit, torque limit and speed ramp, gives them no unit, and speaks
elsewhere of limits that a setup program sets. That they act on motion, at once and until the
power goes, in the units of the commands, is how they are taken; a drive that does otherwise is not refuted.

Rules kept here:
- A drive without C0 and C1 (firmware 2.35) is one that was seen.
- What a claim changed it puts back.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from analyzer.catalogue import Command, Dialect, Doubt, Risk
from conformance.claim import Claim, Inconclusive, Theme
from conformance.claims.known_quirks import known
from conformance.claims.motion_claim import motion_claim, refute
from conformance.claims.motion_lk_speeds import measured, run
from conformance.motion import motion
from conformance.motion.motion import MS, SECOND_NS
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe

_TORQUE_LIMIT, _SPEED_LIMIT, _ANGLE_LIMIT, _SPEED_RAMP = 30, 32, 34, 38
_FIRMWARE = "lk-firmware-235"


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about control parameters and motion."""
    write = dialect.by_name["write_parameter"]
    fields = ("speed_limit", "angle_limit", "torque_limit", "speed_ramp")
    made = partial(
        motion_claim,
        dialect,
        write,
        settings=fields,
        rests_on=(Doubt.EFFECT,),
        own={Risk.SETTING},
        quirks=known(dialect, _FIRMWARE),
    )
    spins = dialect.by_name["run_speed"].all_risks
    yield made("speed-limit", "The speed limit holds at once for a run.", "a faster shaft", _speed_limit, risks=spins)
    yield made("speed-limit-moves", "The speed limit holds for a move without a highest speed.", "a faster shaft", _move_limit)
    yield made("angle-limit", "A move to a position goes no farther than the angle limit.", "a shaft beyond it", _angle_limit)
    yield made("torque-limit", "With a torque limit of 0 nothing turns.", "motion", _torque_limit, risks={*spins, Risk.TORQUE})
    yield made(
        "speed-ramp", "The speed rises by the speed ramp: 0.01 deg/s2 a unit.", "another acceleration", _speed_ramp,
        theme=Theme.TIMING, risks=spins,
    )  # fmt: skip
    yield made(
        "speed-ramp-halved", "Half the speed ramp takes the shaft twice as long to its speed.", "as long, or not twice",
        _halved_ramp, theme=Theme.TIMING, risks=spins,
    )  # fmt: skip


def _parameter(probe: Probe, number: int, name: str) -> int | None:
    """Return a parameter as the drive has it, None where the drive has none and the claim knows of such."""
    exchange = probe.ask("read_parameter", {"parameter": number})
    if exchange.silent and _FIRMWARE in probe.claim.quirks:
        probe.meets(_FIRMWARE)
        return None
    values = probe.reply(exchange).values
    if name not in values:
        raise Inconclusive(f"the drive does not answer with its {name}")
    return int(values[name])


def _set(probe: Probe, number: int, name: str, value: int) -> Exchange:
    return probe.do("write_parameter", {"parameter": number, name: value})


def _speed_limit(probe: Probe, command: Command) -> None:
    def turn() -> Exchange:
        run(probe, 18_000)
        exchange = _set(probe, _SPEED_LIMIT, "speed_limit", 9_000)
        probe.wait(SECOND_NS)
        return exchange

    _expect_limited(probe, turn, "a run")


def _move_limit(probe: Probe, command: Command) -> None:
    def turn() -> Exchange:
        motion.ready_to_move(probe)
        exchange = _set(probe, _SPEED_LIMIT, "speed_limit", 9_000)
        probe.do("move_increment", {"position": 18_000})
        probe.wait(700 * MS)
        return exchange

    _expect_limited(probe, turn, "a move")


def _expect_limited(probe: Probe, turn: Callable[[], Exchange], what: str) -> None:
    """Expect a shaft that `turn` sets in motion at twice the limit it sets to turn at that limit, 90 deg/s."""
    kept = _parameter(probe, _SPEED_LIMIT, "speed_limit")
    if kept is None:
        return
    exchange = turn()
    speed, _ = measured(probe, 500 * MS)
    motion.stand_still(probe)
    _set(probe, _SPEED_LIMIT, "speed_limit", kept)
    if abs(abs(speed) - 90) > 3:
        raise refute(exchange, f"the speed limit does not hold for {what}", expected="90 deg/s", got=f"{speed:.0f} deg/s")


def _angle_limit(probe: Probe, command: Command) -> None:
    kept = _parameter(probe, _ANGLE_LIMIT, "angle_limit")
    if kept is None:
        return
    motion.ready_to_move(probe)
    probe.do("set_position", {"position": 0})
    exchange = _set(probe, _ANGLE_LIMIT, "angle_limit", 6_000)
    probe.do("move_multi_turn", {"position": 12_000})
    probe.wait(2 * SECOND_NS)
    at = motion.stand_still(probe).value
    _set(probe, _ANGLE_LIMIT, "angle_limit", kept)
    if abs(at - 60) > 1:
        raise refute(exchange, "a move goes beyond the angle limit", expected="60 degrees", got=f"{at:.1f} degrees")


def _torque_limit(probe: Probe, command: Command) -> None:
    kept = _parameter(probe, _TORQUE_LIMIT, "torque_limit")
    if kept is None:
        return
    motion.ready_to_move(probe)
    exchange = _set(probe, _TORQUE_LIMIT, "torque_limit", 0)
    before = motion.position(probe)
    probe.do("run_speed", {"speed": 18_000})
    probe.wait(SECOND_NS)
    went = motion.position(probe).value - before.value
    probe.do("stop")
    _set(probe, _TORQUE_LIMIT, "torque_limit", kept)
    motion.stand_still(probe)
    if abs(went) > 1:
        raise refute(exchange, "the shaft turns with a torque limit of 0", expected="no motion", got=f"{went:+.1f} degrees")


def _acceleration(probe: Probe, ramp: int) -> tuple[float, Exchange]:
    """Measure how fast the speed rises from rest, deg/s2, by the way that is missing once it is there."""
    motion.ready_to_move(probe)
    _set(probe, _SPEED_RAMP, "speed_ramp", ramp)
    here = motion.position(probe)
    exchange = probe.ask("run_speed", {"speed": 18_000}, quiet_ns=0)
    begun_ns = exchange.sent_ns
    probe.wait(3 * SECOND_NS)
    first = motion.position(probe)
    speed, _ = measured(probe, SECOND_NS)
    motion.stand_still(probe)
    missing_s = (first.t_ns - begun_ns) / SECOND_NS - (first.value - here.value) / speed
    return speed / (2 * missing_s) if missing_s > 1e-4 else float("inf"), exchange


def _speed_ramp(probe: Probe, command: Command) -> None:
    kept = _parameter(probe, _SPEED_RAMP, "speed_ramp")
    if kept is None:
        return
    seen, exchange = _acceleration(probe, 18_000)
    _set(probe, _SPEED_RAMP, "speed_ramp", kept)
    probe.measured["deg_s2"] = seen
    if abs(seen - 180) > 5:
        raise refute(exchange, "the speed rises by another ramp", expected="180 deg/s2", got=f"{seen:.0f} deg/s2")


def _halved_ramp(probe: Probe, command: Command) -> None:
    kept = _parameter(probe, _SPEED_RAMP, "speed_ramp")
    if kept is None:
        return
    fast, _ = _acceleration(probe, 36_000)
    slow, exchange = _acceleration(probe, 18_000)
    _set(probe, _SPEED_RAMP, "speed_ramp", kept)
    if not 1.9 < fast / slow < 2.1:
        text = "half the speed ramp is not half the acceleration"
        raise refute(exchange, text, expected="2", got=f"{fast:.0f} and {slow:.0f} deg/s2: {fast / slow:.2f}")
