"""Runs at a speed: how fast the shaft turns for what is sent, which way, and for how long.

Rules kept here:
- The speed is measured from positions, by the clock of the line; what the drive says of its speed is another claim's.
- Which way a direction bit turns the shaft is observed; that run and relative move take it alike is judged.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Verb
from conformance.claim import Claim, Inconclusive
from conformance.claims.known_quirks import known
from conformance.claims.motion_claim import expect_speed, motion_claim, refute
from conformance.motion import motion, moves
from conformance.motion.motion import MS, QUICK, SECOND_NS
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe

#: Speeds that differ by less are one.
_SHARE = 0.005
_CALM = 60
#: Whether the setting of the motor's direction turns motion by the bus, by the manual of each dialect.
_DIRECTION_TURNS_BUS: Mapping[str, bool] = {"mks-rs485": False, "mks-modbus": False, "mks-can": True}
#: Replies that may take long while the motor turns leave too little to measure.
_SLOW = ("slow-replies-in-motion",)


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about runs at a speed."""
    run = dialect.by_verb[Verb.RUN_SPEED]
    made = partial(motion_claim, dialect, run)
    for rpm in (1, 60, 300):
        yield made(
            f"speed-{rpm}",
            f"Asked for {rpm} rpm, the shaft turns at {rpm} rpm.",
            "positions that change by another speed",
            partial(_turns_at, rpm),
            parameters={"rpm": rpm},
            quirks=known(dialect, *_SLOW),
        )
    yield made("opposite", "Direction 0 and direction 1 turn the shaft opposite ways.", "one way for both", _opposite)
    yield made(
        "raises",
        "Direction 0 is counter-clockwise and raises the encoder value.",
        "an encoder value that falls",
        _raises,
        at_best=Certainty.OPEN,
        quirks=known(dialect, "reversed-direction"),
    )
    yield made(
        "same-sense",
        "The direction bit turns the shaft the same way in a run as in a relative move by pulses.",
        "a run and a move of one direction that go opposite ways",
        _same_sense,
        at_best=Certainty.LIKELY,
        risks=dialect.by_verb[Verb.MOVE_RELATIVE_PULSES].all_risks,
    )
    yield made("lasts", "A run goes on until it is told otherwise.", "a shaft that slows down or stops by itself", _lasts)
    yield made(
        "changes-speed",
        "A run at another speed takes over from the one under way, without a stop between.",
        "another speed than that of the newer run, or a stop",
        _changes_speed,
    )
    yield made(
        "turns-round",
        "A run the other way takes over from the one under way.",
        "a shaft that keeps its direction or stops",
        _turns_round,
    )
    if Verb.SET_DIRECTION in dialect.by_verb:
        turns = _DIRECTION_TURNS_BUS[dialect.name]
        yield motion_claim(
            dialect,
            dialect.by_verb[Verb.SET_DIRECTION],
            "and-the-bus",
            f"The setting of the motor's direction {'turns' if turns else 'does not turn'} motion by the bus.",
            "a run that turns the same way with both settings" if turns else "a run that turns another way",
            partial(_direction_setting, turns),
            risks=run.all_risks,
            settings=("motor_direction",),
        )
    if moves.tells(dialect):
        yield made("replies", "A run is answered once, by status 1.", "another status, or more replies", _one_reply)


# --- measuring a speed ------------------------------------------------------------------------------------------------


def measured(probe: Probe, over_ns: int) -> tuple[float, float]:
    """Return the speed of a turning shaft from two positions (rpm, signed), and its uncertainty."""
    first = motion.position(probe)
    probe.wait(over_ns)
    return motion.speed_between(first, motion.position(probe))


def _turns_at(rpm: int, probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe, subdivision=moves.SUBDIVISION)
    exchange = motion.run_at(probe, rpm, QUICK)
    probe.wait(300 * MS)
    # At 1 rpm the shaft needs a while to go far enough to measure.
    speed, spread = measured(probe, 2 * SECOND_NS if rpm < 10 else SECOND_NS)
    motion.stand_still(probe)
    _judge_speed(probe, exchange, speed, spread, rpm)


def _judge_speed(probe: Probe, exchange: Exchange, speed: float, spread: float, rpm: float) -> None:
    off = abs(abs(speed) - rpm)
    if off > rpm * _SHARE + spread:
        raise refute(
            exchange,
            "the shaft does not turn at the speed that was asked for",
            expected=f"{rpm:g} rpm",
            got=f"{abs(speed):.2f} rpm +-{spread:.2f}",
        )
    if spread > rpm / 10:
        if "slow-replies-in-motion" not in probe.claim.quirks:
            raise Inconclusive(f"the replies came too late to measure a speed ({spread:.1f} rpm uncertain)")
        probe.meets("slow-replies-in-motion")
        return
    probe.measured["rpm"] = abs(speed)


def _way(probe: Probe, direction: int) -> float:
    """Return how far a short run in a direction turns the shaft, in degrees, from rest to rest."""
    before = motion.position(probe)
    motion.run_at(probe, -_CALM if direction else _CALM, QUICK)
    probe.wait(300 * MS)
    return motion.stand_still(probe).value - before.value


def _opposite(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    one, other = _way(probe, 0), _way(probe, 1)
    if one * other >= 0:
        raise refute(
            probe.traffic[-1],
            "direction 0 and direction 1 do not turn opposite ways",
            expected="two ways",
            got=f"{one:+.1f} and {other:+.1f} degrees",
        )


def _raises(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    way = _way(probe, 0)
    if way < 0 and "reversed-direction" in probe.claim.quirks and _relative_way(probe) < 0:
        probe.meets("reversed-direction")
    elif way <= 0:
        text = "direction 0 does not raise the encoder value"
        raise refute(probe.traffic[-1], text, expected="a greater position", got=f"{way:+.1f} degrees")


def _relative_way(probe: Probe) -> float:
    """Return how far a relative move of direction 0 turns the shaft, in degrees."""
    return moves.travel(probe, probe.command(Verb.MOVE_RELATIVE_PULSES), 0.1).degrees


def _same_sense(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    run, move = _way(probe, 0), _relative_way(probe)
    if run * move <= 0:
        raise refute(
            probe.traffic[-1],
            "direction 0 turns the shaft one way in a run and the other way in a move",
            expected="one way",
            got=f"{run:+.1f} degrees by the run, {move:+.1f} by the move",
        )


# --- as time goes on --------------------------------------------------------------------------------------------------


def _lasts(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe, subdivision=moves.SUBDIVISION)
    exchange = motion.run_at(probe, _CALM, QUICK)
    probe.wait(5 * SECOND_NS)
    seen = motion.speed(probe)
    motion.stand_still(probe)
    expect_speed(seen, _CALM, exchange, "a run does not go on")


def _changes_speed(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe, subdivision=moves.SUBDIVISION)
    for rpm, acceleration in ((120, QUICK), (60, 56), (180, QUICK)):
        exchange = motion.run_at(probe, rpm, acceleration)
        if rpm == 60:
            seen = motion.speed(probe)  # the ramp from 120 to 60 rpm takes 600 ms at 10 ms for each rpm
            if abs(seen.value) < 60 - 1:
                raise refute(exchange, "a newer run stops the shaft first", expected="60 to 120 rpm", got=f"{seen.value:g}")
        probe.wait(800 * MS)
        expect_speed(motion.speed(probe), rpm, exchange, "a newer run does not take over")
    motion.stand_still(probe)


def _turns_round(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe, subdivision=moves.SUBDIVISION)
    motion.run_at(probe, _CALM, QUICK)
    probe.wait(300 * MS)
    before, _ = measured(probe, 200 * MS)
    exchange = motion.run_at(probe, -_CALM, QUICK)
    probe.wait(300 * MS)
    after, spread = measured(probe, 200 * MS)
    motion.stand_still(probe)
    if before * after >= 0 or abs(abs(after) - _CALM) > 2 + spread:
        raise refute(
            exchange,
            "a run the other way does not turn the shaft round",
            expected=f"{before:+.1f} rpm, then {-before:+.1f}",
            got=f"{before:+.1f} rpm, then {after:+.1f}",
        )


def _one_reply(probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    exchange = motion.run_at(probe, _CALM, QUICK)
    probe.wait(2 * SECOND_NS)
    statuses = [a.values[command.replies.status] for a in moves.told(probe.traffic, command)]
    motion.stand_still(probe)
    if statuses != [1]:
        got = ", ".join(map(str, statuses)) or "none"
        raise refute(exchange, "a run is not answered by status 1 alone", expected="1", got=got)


# --- the setting of the motor's direction -----------------------------------------------------------------------------


def _direction_setting(turns: bool, probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe)
    ways = []
    for value in (0, 1):
        probe.do(command, {"motor_direction": value})
        ways.append(_way(probe, 0))
    if (ways[0] * ways[1] < 0) is not turns:
        raise refute(
            probe.traffic[-1],
            "the setting of the motor's direction and motion by the bus",
            expected="opposite ways" if turns else "one way",
            got=f"{ways[0]:+.1f} and {ways[1]:+.1f} degrees",
        )
