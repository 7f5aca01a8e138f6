"""Runs at a speed: how fast the shaft turns for what is sent, which way, up to which limit.

    real rpm = speed as sent                        at 16, 32 and 64 subdivisions
    real rpm = speed as sent x 16 / subdivision     at the others

Rules kept here:
- The speed is measured from positions, by the clock of the line; what the drive says of its speed is another claim's.
- A work mode has a highest speed (400, 1500, 3000 rpm); a greater one, in whatever width, runs at it and is no error.
- Which way a direction bit turns the shaft is observed; that run and relative move take it alike is judged.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Verb
from analyzer.protocols.mks_shared import MODE_MAXIMUM_SPEEDS
from conformance import journey, moving
from conformance.claim import Claim, Inconclusive
from conformance.claims.known_quirks import known
from conformance.claims.motion_claim import expect_speed, motion_claim, refute
from conformance.exchange import Exchange
from conformance.moving import MS, SECOND_NS
from conformance.probe import Probe

#: The highest speed of any drive, and that of a drive whose manual has no table of modes.
_HIGHEST = 3000
#: Speeds that differ by less are one.
_SHARE = 0.005
#: Subdivisions at which the rule of speeds and pulses is tried, as the number that they stand for.
_SUBDIVISIONS = (2, 8, 16, 32, 64, 100, 128, 256)
_PLAIN = (16, 32, 64)
#: The shaft turns about so fast in a claim about subdivisions, in rpm.
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
    for subdivision in _SUBDIVISIONS:
        yield from _about_subdivision(dialect, subdivision)
    for command in (run, *journey.moves(dialect)):
        yield from _about_limits(dialect, command)
    for mode in run.modes:
        top = MODE_MAXIMUM_SPEEDS.get(mode, _HIGHEST)
        yield made(
            f"highest-{mode}",
            f"In mode {mode} the shaft turns at up to {top} rpm, and at {top} rpm when more is asked for.",
            "another speed",
            partial(_highest_of_mode, mode, top),
            at_best=Certainty.LIKELY,
            parameters={"mode": mode, "rpm": top},
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
    if journey.tells(dialect):
        yield made("replies", "A run is answered once, by status 1.", "another status, or more replies", _one_reply)


# --- measuring a speed ------------------------------------------------------------------------------------------------


def measured(probe: Probe, over_ns: int) -> tuple[float, float]:
    """Return the speed of a turning shaft from two positions (rpm, signed), and its uncertainty."""
    first = moving.position(probe)
    probe.wait(over_ns)
    return moving.speed_between(first, moving.position(probe))


def _turns_at(rpm: int, probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe, subdivision=journey.SUBDIVISION)
    exchange = moving.run_at(probe, rpm, 250)
    probe.wait(300 * MS)
    # At 1 rpm the shaft needs a while to go far enough to measure.
    speed, spread = measured(probe, 2 * SECOND_NS if rpm < 10 else SECOND_NS)
    moving.stand_still(probe)
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
    before = moving.position(probe)
    moving.run_at(probe, -_CALM if direction else _CALM, 250)
    probe.wait(300 * MS)
    return moving.stand_still(probe).value - before.value


def _opposite(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    one, other = _way(probe, 0), _way(probe, 1)
    if one * other >= 0:
        raise refute(
            probe.traffic[-1],
            "direction 0 and direction 1 do not turn opposite ways",
            expected="two ways",
            got=f"{one:+.1f} and {other:+.1f} degrees",
        )


def _raises(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    way = _way(probe, 0)
    if way < 0 and "reversed-direction" in probe.claim.quirks and _relative_way(probe) < 0:
        probe.meets("reversed-direction")
    elif way <= 0:
        text = "direction 0 does not raise the encoder value"
        raise refute(probe.traffic[-1], text, expected="a greater position", got=f"{way:+.1f} degrees")


def _relative_way(probe: Probe) -> float:
    """Return how far a relative move of direction 0 turns the shaft, in degrees."""
    return journey.travel(probe, probe.command(Verb.MOVE_RELATIVE_PULSES), 0.1).degrees


def _same_sense(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
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
    moving.ready_to_move(probe, subdivision=journey.SUBDIVISION)
    exchange = moving.run_at(probe, _CALM, 250)
    probe.wait(5 * SECOND_NS)
    seen = moving.speed(probe)
    moving.stand_still(probe)
    expect_speed(seen, _CALM, exchange, "a run does not go on")


def _changes_speed(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe, subdivision=journey.SUBDIVISION)
    for rpm, acceleration in ((120, 250), (60, 56), (180, 250)):
        exchange = moving.run_at(probe, rpm, acceleration)
        if rpm == 60:
            seen = moving.speed(probe)  # the ramp from 120 to 60 rpm takes 600 ms at 10 ms for each rpm
            if abs(seen.value) < 60 - 1:
                raise refute(exchange, "a newer run stops the shaft first", expected="60 to 120 rpm", got=f"{seen.value:g}")
        probe.wait(800 * MS)
        expect_speed(moving.speed(probe), rpm, exchange, "a newer run does not take over")
    moving.stand_still(probe)


def _turns_round(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe, subdivision=journey.SUBDIVISION)
    moving.run_at(probe, _CALM, 250)
    probe.wait(300 * MS)
    before, _ = measured(probe, 200 * MS)
    exchange = moving.run_at(probe, -_CALM, 250)
    probe.wait(300 * MS)
    after, spread = measured(probe, 200 * MS)
    moving.stand_still(probe)
    if before * after >= 0 or abs(abs(after) - _CALM) > 2 + spread:
        raise refute(
            exchange,
            "a run the other way does not turn the shaft round",
            expected=f"{before:+.1f} rpm, then {-before:+.1f}",
            got=f"{before:+.1f} rpm, then {after:+.1f}",
        )


def _one_reply(probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
    exchange = moving.run_at(probe, _CALM, 250)
    probe.wait(2 * SECOND_NS)
    statuses = [a.values[command.replies.status] for a in journey.told(probe.traffic, command)]
    moving.stand_still(probe)
    if statuses != [1]:
        got = ", ".join(map(str, statuses)) or "none"
        raise refute(exchange, "a run is not answered by status 1 alone", expected="1", got=got)


# --- subdivisions -----------------------------------------------------------------------------------------------------


def _sent_as(dialect: Dialect, subdivision: int) -> int | None:
    """Return how a subdivision is sent, None where the dialect has none such."""
    field = dialect.by_verb[Verb.SET_SUBDIVISION].request_forms[0].layout.named["subdivision"]
    sent = subdivision if subdivision <= field.wire_maximum else 0
    return sent if field.allows(sent) else None


def _about_subdivision(dialect: Dialect, subdivision: int) -> Iterator[Claim]:
    sent = _sent_as(dialect, subdivision)
    if sent is None:
        return
    speed = _CALM if subdivision in _PLAIN else max(1, round(_CALM * subdivision / 16))
    rpm = speed if subdivision in _PLAIN else speed * 16 / subdivision
    set_subdivision = dialect.by_verb[Verb.SET_SUBDIVISION]
    made = partial(motion_claim, dialect, set_subdivision, parameters={"subdivision": subdivision})
    yield made(
        f"speed-at-{subdivision}",
        f"At {subdivision} subdivisions a run at speed {speed} turns the shaft at {rpm:g} rpm.",
        "another speed of the shaft",
        partial(_speed_at, sent, speed, rpm),
        at_best=Certainty.LIKELY,
        risks=dialect.by_verb[Verb.RUN_SPEED].all_risks,
    )
    yield made(
        f"pulses-at-{subdivision}",
        f"At {subdivision} subdivisions a turn has {200 * subdivision} pulses.",
        "a move by pulses of another length",
        partial(_pulses_at, sent, subdivision),
        risks=dialect.by_verb[Verb.MOVE_RELATIVE_PULSES].all_risks,
    )


def _speed_at(sent: int, speed: int, rpm: float, probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe, subdivision=sent)
    exchange = moving.run_at(probe, speed, 250)
    # The ramp goes by the real speed, or by the speed as sent: either way it is over then.
    probe.wait(max(300 * MS, speed * MS // 2))
    seen, spread = measured(probe, 3 * SECOND_NS)
    moving.stand_still(probe)
    if abs(abs(seen) - rpm) > rpm * _SHARE + spread:
        raise refute(
            exchange,
            "the speed of the shaft does not follow the subdivision as the manual says",
            expected=f"{rpm:g} rpm",
            got=f"{abs(seen):.2f} rpm +-{spread:.2f}",
        )


def _pulses_at(sent: int, subdivision: int, probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe, subdivision=sent)
    move = probe.command(Verb.MOVE_RELATIVE_PULSES)
    speed = max(1, min(3000, _CALM * subdivision // 16))
    trip = journey.travel(
        probe, move, amount=25 * subdivision, speed=speed, acceleration=250, subdivision=subdivision
    )
    if abs(abs(trip.degrees) - 45) > moving.SAME:
        raise refute(
            trip.exchange,
            f"{25 * subdivision} pulses at {subdivision} subdivisions are not an eighth of a turn",
            expected="45 degrees",
            got=f"{abs(trip.degrees):.2f} degrees",
        )


# --- limits -----------------------------------------------------------------------------------------------------------


def _about_limits(dialect: Dialect, command: Command) -> Iterator[Claim]:
    made = partial(motion_claim, dialect, command)
    yield made(
        "highest",
        f"{command.name} at speed {_HIGHEST} turns the shaft at {_HIGHEST} rpm.",
        "a refusal, or another speed",
        partial(_reaches, (_HIGHEST,)),
        parameters={"speed": _HIGHEST},
    )
    beyond = (_HIGHEST + 1, journey.widest(command))
    yield made(
        "beyond-highest",
        f"{command.name} at a greater speed than {_HIGHEST} turns the shaft at {_HIGHEST} rpm and is no error.",
        "a refusal, or another speed",
        partial(_reaches, beyond),
        at_best=Certainty.LIKELY,
        parameters={"speeds": beyond},
    )


def _reaches(speeds: tuple[int, ...], probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe, moving.bus_modes(probe.dialect)[-1], subdivision=journey.SUBDIVISION)
    for speed in speeds:
        exchange = _at_full_tilt(probe, command, speed)
        if journey.refused(probe, exchange):
            text = f"{command.name} at speed {speed} is refused"
            raise refute(exchange, text, expected="status 1" if journey.tells(probe.dialect) else "an echo", got="a refusal")
        # At 50 us for one rpm the shaft has 3000 rpm after 150 ms, and a move of 20 turns keeps it for 250 ms.
        probe.wait(exchange.sent_ns + 230 * MS - probe.gate.now_ns())
        seen = moving.speed(probe)
        moving.stand_still(probe)
        expect_speed(seen, _HIGHEST, exchange, f"{command.name} at speed {speed} turns at another speed")


def _at_full_tilt(probe: Probe, command: Command, speed: int) -> Exchange:
    if command.verb is Verb.RUN_SPEED:
        return probe.ask(command, {"speed": speed, "acceleration": 255}, quiet_ns=0)
    return journey.ask(probe, command, 20.0, speed=speed, acceleration=255, quiet_ns=0)


def _highest_of_mode(mode: str, top: int, probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe, mode, subdivision=journey.SUBDIVISION)
    for speed in (top, _HIGHEST):
        exchange = probe.ask(command, {"speed": speed, "acceleration": 255})
        if journey.refused(probe, exchange):
            raise refute(exchange, f"speed {speed} is refused in mode {mode}", expected="no refusal", got="a refusal")
        probe.wait(300 * MS)
        seen = moving.speed(probe)
        moving.stand_still(probe)
        expect_speed(seen, top, exchange, f"speed {speed} in mode {mode} turns at another speed")


# --- the setting of the motor's direction -----------------------------------------------------------------------------


def _direction_setting(turns: bool, probe: Probe, command: Command) -> None:
    moving.ready_to_move(probe)
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

