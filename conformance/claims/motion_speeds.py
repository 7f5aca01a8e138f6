"""Speeds at each subdivision, and up to which limit.

    real rpm = speed as sent                        at 16, 32 and 64 subdivisions
    real rpm = speed as sent x 16 / subdivision     at the others

Rules kept here:
- A turn has 200 pulses for each subdivision.
- A work mode has a highest speed (400, 1500, 3000 rpm); a greater one, in whatever width, runs at it and is no error.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Verb
from conformance.claim import Claim
from conformance.claims.motion_claim import expect_speed, motion_claim, refute
from conformance.motion import motion
from conformance.motion import moves as journey
from conformance.motion.motion import MS, QUICK, SECOND_NS
from conformance.motion.motion import mean_speed as measured
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe

#: The highest speed of any drive, and that of a drive whose manual has no table of modes.
_HIGHEST = 3000
#: Speeds that differ by less are one.
_SHARE = 0.005
#: Subdivisions at which the rule of speeds and pulses is tried, as the number that they stand for.
_SUBDIVISIONS = (2, 8, 16, 32, 64, 100, 128, 256)
#: The shaft turns about so fast in a claim about subdivisions, in rpm.
_CALM = 60


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about subdivisions and limits of speed."""
    run = dialect.by_verb[Verb.RUN_SPEED]
    made = partial(motion_claim, dialect, run)
    for subdivision in _SUBDIVISIONS:
        yield from _about_subdivision(dialect, subdivision)
    for command in (run, *journey.moves(dialect)):
        yield from _about_limits(dialect, command)
    for mode in run.modes:
        top = dialect.mode_speeds.get(mode, _HIGHEST)
        yield made(
            f"highest-{mode}",
            f"In mode {mode} the shaft turns at up to {top} rpm, and at {top} rpm when more is asked for.",
            "another speed",
            partial(_highest_of_mode, mode, top),
            at_best=Certainty.LIKELY,
            parameters={"mode": mode, "rpm": top},
        )


# --- subdivisions -----------------------------------------------------------------------------------------------------


def _sent_as(dialect: Dialect, subdivision: int) -> int | None:
    """Return how a subdivision is sent, None where the dialect has none such."""
    field = dialect.by_verb[Verb.SET_SUBDIVISION].request_forms[0].layout.named["subdivision"]
    sent = subdivision if subdivision <= field.wire_maximum else 0
    return sent if field.allows(sent) else None


def _about_subdivision(dialect: Dialect, subdivision: int) -> Iterator[Claim]:
    sent, rule = _sent_as(dialect, subdivision), dialect.subdivision
    if sent is None or rule is None:
        return
    slower = 1 if subdivision in rule.plain else subdivision / rule.counted_at
    speed = max(1, round(_CALM * slower))
    rpm = speed / slower
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
        f"At {subdivision} subdivisions a turn has {rule.full_steps * subdivision} pulses.",
        "a move by pulses of another length",
        partial(_pulses_at, sent, subdivision),
        risks=dialect.by_verb[Verb.MOVE_RELATIVE_PULSES].all_risks,
    )


def _speed_at(sent: int, speed: int, rpm: float, probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe, subdivision=sent)
    exchange = motion.run_at(probe, speed, QUICK)
    # The ramp goes by the real speed, or by the speed as sent: either way it is over then.
    probe.wait(max(300 * MS, speed * MS // 2))
    seen, spread = measured(probe, 3 * SECOND_NS)
    motion.stand_still(probe)
    if abs(abs(seen) - rpm) > rpm * _SHARE + spread:
        raise refute(
            exchange,
            "the speed of the shaft does not follow the subdivision as the manual says",
            expected=f"{rpm:g} rpm",
            got=f"{abs(seen):.2f} rpm +-{spread:.2f}",
        )


def _pulses_at(sent: int, subdivision: int, probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe, subdivision=sent)
    move = probe.command(Verb.MOVE_RELATIVE_PULSES)
    speed = max(1, min(3000, _CALM * subdivision // 16))
    trip = journey.travel(probe, move, amount=25 * subdivision, speed=speed, acceleration=QUICK, subdivision=subdivision)
    if abs(abs(trip.degrees) - 45) > motion.SAME:
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
    motion.ready_to_move(probe, motion.bus_modes(probe.dialect)[-1], subdivision=journey.SUBDIVISION)
    for speed in speeds:
        exchange = _at_full_tilt(probe, command, speed)
        if journey.refused(probe, exchange):
            text = f"{command.name} at speed {speed} is refused"
            raise refute(exchange, text, expected="status 1" if journey.tells(probe.dialect) else "an echo", got="a refusal")
        # At 50 us for one rpm the shaft has 3000 rpm after 150 ms, and a move of 20 turns keeps it for 250 ms.
        probe.wait(exchange.sent_ns + 230 * MS - probe.gate.now_ns())
        seen = motion.speed(probe)
        motion.stand_still(probe)
        expect_speed(seen, _HIGHEST, exchange, f"{command.name} at speed {speed} turns at another speed")


def _at_full_tilt(probe: Probe, command: Command, speed: int) -> Exchange:
    if command.verb is Verb.RUN_SPEED:
        return probe.ask(command, {"speed": speed, "acceleration": 255}, quiet_ns=0)
    return journey.ask(probe, command, 20.0, speed=speed, acceleration=255, quiet_ns=0)


def _highest_of_mode(mode: str, top: int, probe: Probe, command: Command) -> None:
    motion.ready_to_move(probe, mode, subdivision=journey.SUBDIVISION)
    for speed in (top, _HIGHEST):
        exchange = probe.ask(command, {"speed": speed, "acceleration": 255})
        if journey.refused(probe, exchange):
            raise refute(exchange, f"speed {speed} is refused in mode {mode}", expected="no refusal", got="a refusal")
        probe.wait(300 * MS)
        seen = motion.speed(probe)
        motion.stand_still(probe)
        expect_speed(seen, top, exchange, f"speed {speed} in mode {mode} turns at another speed")
