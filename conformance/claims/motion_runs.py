"""Runs at a speed: how fast the shaft turns for what is sent, which way, and for how long.

Rules kept here:
- The speed is measured from positions, by the clock of the line; what the drive says of its speed is another claim's.
- Which way a direction bit turns the shaft is observed; that run and relative move take it alike is judged.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from analyzer.catalogue import Certainty, Command, Dialect, Verb
from conformance.claim import Claim, Inconclusive
from conformance.claims.declare import Case, commands, declared_in
from conformance.claims.known_quirks import may_meet
from conformance.claims.motion_claim import expect_speed, of_motion
from conformance.motion import motion, moves
from conformance.motion.motion import MS, QUICK, SECOND_NS
from conformance.talk.probe import Probe

#: Speeds that differ by less are one.
_SHARE = 0.005
_CALM = 60
#: Whether the setting of the motor's direction turns motion by the bus, by the manual of each dialect.
_DIRECTION_TURNS_BUS: Mapping[str, bool] = {"mks-rs485": False, "mks-modbus": False, "mks-can": True}


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about runs at a speed."""
    return declared_in(__name__, dialect)


_runs = commands(Verb.RUN_SPEED)


def _at_speeds(dialect: Dialect) -> Iterator[Case]:
    for rpm in (1, 60, 300):
        yield Case(dialect, dialect.by_verb[Verb.RUN_SPEED], {"rpm": rpm}, {"name": f"run_speed/speed-{rpm}"})


# --- measuring a speed ------------------------------------------------------------------------------------------------


def measured(probe: Probe, over_ns: int) -> tuple[float, float]:
    """Return the speed of a turning shaft from two positions (rpm, signed), and its uncertainty."""
    first = motion.position(probe)
    probe.wait(over_ns)
    return motion.speed_between(first, motion.position(probe))


@of_motion(each=_at_speeds, refuted_by="positions that change by another speed", quirks=may_meet("slow-replies-in-motion"))
def _turns_at(probe: Probe, rpm: int) -> None:
    """Asked for {rpm} rpm, the shaft turns at {rpm} rpm."""
    motion.ready_to_move(probe, subdivision=moves.SUBDIVISION)
    exchange = motion.run_at(probe, rpm, QUICK)
    probe.wait(300 * MS)
    # At 1 rpm the shaft needs a while to go far enough to measure.
    speed, spread = measured(probe, 2 * SECOND_NS if rpm < 10 else SECOND_NS)
    motion.stand_still(probe)
    text = "the shaft does not turn at the speed that was asked for"
    probe.expect(abs(speed), near=rpm, within=rpm * _SHARE + spread, unit="rpm", refutes=text, exchange=exchange)
    if spread > rpm / 10:
        if "slow-replies-in-motion" not in probe.claim.quirks:
            raise Inconclusive(f"the replies came too late to measure a speed ({spread:.1f} rpm uncertain)")
        probe.meets("slow-replies-in-motion")
    else:
        probe.measured["rpm"] = abs(speed)


# --- which way --------------------------------------------------------------------------------------------------------


def _way(probe: Probe, direction: int) -> float:
    """Return how far a short run in a direction turns the shaft, in degrees, from rest to rest."""
    before = motion.position(probe)
    motion.run_at(probe, -_CALM if direction else _CALM, QUICK)
    probe.wait(300 * MS)
    return motion.stand_still(probe).value - before.value


def _relative_way(probe: Probe) -> float:
    """Return how far a relative move of direction 0 turns the shaft, in degrees."""
    return moves.travel(probe, probe.command(Verb.MOVE_RELATIVE_PULSES), 0.1).degrees


def _expect_ways(probe: Probe, ways: tuple[float, float], opposite: bool, refutes: str) -> None:
    probe.expect(
        f"{ways[0]:+.1f} and {ways[1]:+.1f} degrees",
        holds=ways[0] * ways[1] < 0 if opposite else ways[0] * ways[1] > 0,
        expected="opposite ways" if opposite else "one way",
        refutes=refutes,
    )


@of_motion(each=_runs, refuted_by="one way for both")
def _opposite(probe: Probe) -> None:
    """Direction 0 and direction 1 turn the shaft opposite ways."""
    motion.ready_to_move(probe)
    _expect_ways(probe, (_way(probe, 0), _way(probe, 1)), True, "direction 0 and direction 1 do not turn opposite ways")


@of_motion(each=_runs, refuted_by="an encoder value that falls", at_best=Certainty.OPEN, quirks=may_meet("reversed-direction"))
def _raises(probe: Probe) -> None:
    """Direction 0 is counter-clockwise and raises the encoder value."""
    motion.ready_to_move(probe)
    way = _way(probe, 0)
    if way < 0 and "reversed-direction" in probe.claim.quirks and _relative_way(probe) < 0:
        probe.meets("reversed-direction")
    else:
        text = "direction 0 does not raise the encoder value"
        probe.expect(f"{way:+.1f} degrees", holds=way > 0, expected="a greater position", refutes=text)


@of_motion(
    each=_runs,
    refuted_by="a run and a move of one direction that go opposite ways",
    at_best=Certainty.LIKELY,
    risks=lambda case: case.dialect.by_verb[Verb.MOVE_RELATIVE_PULSES].all_risks,
)
def _same_sense(probe: Probe) -> None:
    """The direction bit turns the shaft the same way in a run as in a relative move by pulses."""
    motion.ready_to_move(probe)
    ways = (_way(probe, 0), _relative_way(probe))
    _expect_ways(probe, ways, False, "direction 0 turns the shaft one way in a run and the other way in a move")


def _direction_settings(dialect: Dialect) -> Iterator[Case]:
    if Verb.SET_DIRECTION in dialect.by_verb:
        turns = _DIRECTION_TURNS_BUS[dialect.name]
        statement = f"The setting of the motor's direction {'turns' if turns else 'does not turn'} motion by the bus."
        refuted_by = "a run that turns the same way with both settings" if turns else "a run that turns another way"
        facts = {"statement": statement, "refuted_by": refuted_by}
        yield Case(dialect, dialect.by_verb[Verb.SET_DIRECTION], {"turns": turns}, facts)


@of_motion(
    each=_direction_settings,
    refuted_by="",
    risks=lambda case: case.dialect.by_verb[Verb.RUN_SPEED].all_risks,
    settings=("motor_direction",),
)
def _and_the_bus(probe: Probe, command: Command, turns: bool) -> None:
    motion.ready_to_move(probe)
    ways = []
    for value in (0, 1):
        probe.do(command, {"motor_direction": value})
        ways.append(_way(probe, 0))
    _expect_ways(probe, (ways[0], ways[1]), turns, "the setting of the motor's direction and motion by the bus")


# --- as time goes on --------------------------------------------------------------------------------------------------


@of_motion(each=_runs, refuted_by="a shaft that slows down or stops by itself")
def _lasts(probe: Probe) -> None:
    """A run goes on until it is told otherwise."""
    motion.ready_to_move(probe, subdivision=moves.SUBDIVISION)
    exchange = motion.run_at(probe, _CALM, QUICK)
    probe.wait(5 * SECOND_NS)
    seen = motion.speed(probe)
    motion.stand_still(probe)
    expect_speed(seen, _CALM, exchange, "a run does not go on")


@of_motion(each=_runs, refuted_by="another speed than that of the newer run, or a stop")
def _changes_speed(probe: Probe) -> None:
    """A run at another speed takes over from the one under way, without a stop between."""
    motion.ready_to_move(probe, subdivision=moves.SUBDIVISION)
    for rpm, acceleration in ((120, QUICK), (60, 56), (180, QUICK)):
        exchange = motion.run_at(probe, rpm, acceleration)
        if rpm == 60:
            seen = motion.speed(probe)  # the ramp from 120 to 60 rpm takes 600 ms at 10 ms for each rpm
            text = "a newer run stops the shaft first"
            probe.expect(abs(seen.value), at_least=60 - 1, unit="rpm", refutes=text, exchange=exchange)
        probe.wait(800 * MS)
        expect_speed(motion.speed(probe), rpm, exchange, "a newer run does not take over")
    motion.stand_still(probe)


@of_motion(each=_runs, refuted_by="a shaft that keeps its direction or stops")
def _turns_round(probe: Probe) -> None:
    """A run the other way takes over from the one under way."""
    motion.ready_to_move(probe, subdivision=moves.SUBDIVISION)
    motion.run_at(probe, _CALM, QUICK)
    probe.wait(300 * MS)
    before, _ = measured(probe, 200 * MS)
    exchange = motion.run_at(probe, -_CALM, QUICK)
    probe.wait(300 * MS)
    after, spread = measured(probe, 200 * MS)
    motion.stand_still(probe)
    probe.expect(
        f"{before:+.1f} rpm, then {after:+.1f}",
        holds=before * after < 0 and abs(abs(after) - _CALM) <= 2 + spread,
        expected=f"{before:+.1f} rpm, then {-before:+.1f}",
        refutes="a run the other way does not turn the shaft round",
        exchange=exchange,
    )


def _told_runs(dialect: Dialect) -> Iterator[Case]:
    return (case for case in _runs(dialect) if moves.tells(dialect))


@of_motion(each=_told_runs, refuted_by="another status, or more replies")
def _replies(probe: Probe, command: Command) -> None:
    """A run is answered once, by status 1."""
    motion.ready_to_move(probe)
    exchange = motion.run_at(probe, _CALM, QUICK)
    probe.wait(2 * SECOND_NS)
    statuses = [a.values[command.replies.status] for a in moves.told(probe.traffic, command)]
    motion.stand_still(probe)
    probe.expect(statuses, equal=[1], refutes="a run is not answered by status 1 alone", exchange=exchange)
