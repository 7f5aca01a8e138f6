"""Subdivisions: how fast the shaft turns, and how far pulses take it, at each.

    real rpm = speed as sent                        at 16, 32 and 64 subdivisions
    real rpm = speed as sent x 16 / subdivision     at the others

Rule kept here: a turn has 200 pulses for each subdivision.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Verb
from analyzer.layout import Effect
from conformance.claims.declare import Case
from conformance.claims.motion_claim import of_motion, risks_by
from conformance.motion import motion
from conformance.motion.motion import CALM, MS, QUICK
from conformance.talk.noise import CLOCK_SHARE
from conformance.talk.probe import Probe

#: Subdivisions at which the rule of speeds and pulses is tried, as the number that they stand for.
_TRIED = (2, 8, 16, 32, 64, 100, 128, 256)


def _subdivisions(dialect: Dialect) -> Iterator[Case]:
    """Yield the subdivisions of a dialect: how each is sent, the speed to send at it, and the rpm that this means."""
    found, law = dialect.effect(Effect.SUBDIVISION), dialect.subdivision
    if found is None or law is None:
        return
    command, field = found
    for subdivision in _TRIED:
        sent = subdivision if subdivision <= field.wire_maximum else 0
        if field.allows(sent):
            run = motion.field_of(dialect.by_verb[Verb.RUN_SPEED], "speed")
            speed = motion.speed_as_sent(dialect, run, CALM, subdivision)
            rpm = speed if subdivision in law.plain else speed * law.counted_at / subdivision
            yield Case(
                dialect,
                command,
                {"subdivision": subdivision, "sent": sent, "speed": speed, "rpm": rpm, "pulses": 200 * subdivision},
            )


def _settings_of_subdivisions(dialect: Dialect) -> Iterator[Case]:
    found = dialect.effect(Effect.SUBDIVISION)
    if found is not None and dialect.subdivision is not None:
        yield Case(dialect, found[0])


_of_subdivision = partial(of_motion, each=_subdivisions, parameters=lambda case: {"subdivision": case["subdivision"]})


@_of_subdivision(
    name="{command}/speed-at-{subdivision}",
    refuted_by="another speed of the shaft",
    at_best=Certainty.LIKELY,
    risks=risks_by(Verb.RUN_SPEED),
)
def _speed(probe: Probe, sent: int, speed: int, rpm: float) -> None:
    """At {subdivision} subdivisions a run at speed {speed} turns the shaft at {rpm:g} rpm."""
    motion.ready_to_move(probe, subdivision=sent)
    exchange = motion.run_at(probe, speed, QUICK)
    # The ramp goes by the real speed, or by the speed as sent: either way it is over then.
    probe.wait(max(300 * MS, speed * MS // 2))
    seen, spread = motion.mean_speed(probe, 400 * MS)
    motion.stand_still(probe)
    text = "the speed of the shaft does not follow the subdivision as the manual says"
    probe.expect(abs(seen), near=rpm, within=rpm * CLOCK_SHARE + spread, unit="rpm", refutes=text, exchange=exchange)


@_of_subdivision(
    name="{command}/pulses-at-{subdivision}",
    refuted_by="a move by pulses of another length",
    risks=risks_by(Verb.MOVE_RELATIVE_PULSES),
)
def _pulses(probe: Probe, sent: int, subdivision: int) -> None:
    """At {subdivision} subdivisions a turn has {pulses} pulses."""
    motion.ready_to_move(probe, subdivision=sent)
    command = probe.command(Verb.MOVE_RELATIVE_PULSES)
    move = motion.follow(probe, command, 45, acceleration=QUICK, subdivision=subdivision)
    text = f"{25 * subdivision} pulses at {subdivision} subdivisions are not an eighth of a turn"
    probe.expect(abs(move.degrees), near=45, unit="degrees", refutes=text, exchange=move.exchange)


#: The subdivisions of the CAN manual that have no claims of their own.
_OTHERS = (4, 5, 10, 20, 25, 40, 50, 200)


@of_motion(
    each=_settings_of_subdivisions,
    name="{command}/pulses-at-others",
    refuted_by="a move by pulses of another length",
    statement=f"At {', '.join(map(str, _OTHERS))} subdivisions too a turn has 200 pulses for each.",
    risks=risks_by(Verb.MOVE_RELATIVE_PULSES),
)
def _pulses_at_others(probe: Probe) -> None:
    for subdivision in _OTHERS:
        _pulses(probe, subdivision, subdivision)


#: Subdivisions at which moves are tried: below those that leave speeds as they are, and above.
_OF_MOVES = (8, 100, 256)


def _moves(dialect: Dialect) -> Iterator[Case]:
    """Yield each move at some subdivisions, as `_subdivisions` does runs."""
    for case in _subdivisions(dialect):
        if case["subdivision"] in _OF_MOVES:
            for command in dialect.motions(MotionKind.MOVE_BY, MotionKind.MOVE_TO):
                yield Case(dialect, command, {n: case[n] for n in ("subdivision", "sent", "rpm")})


@of_motion(
    each=_moves,
    name="{command}/speed-at-{subdivision}",
    refuted_by="another speed, or another way",
    at_best=Certainty.LIKELY,
    parameters=lambda case: {"subdivision": case["subdivision"]},
)
def _speed_of_a_move(probe: Probe, command: Command, subdivision: int, sent: int, rpm: float) -> None:
    """At {subdivision} subdivisions {command} turns the shaft at {rpm:g} rpm, as asked, and by 450 degrees."""
    motion.ready_to_move(probe, subdivision=sent)
    how = {"rpm": rpm, "acceleration": QUICK, "subdivision": subdivision}
    for turns in (_TURNS, _MORE_TURNS):
        before = motion.position(probe)
        exchange = motion.begin(probe, command, turns * 360, **how)
        # The ramp goes by the real speed, or by the speed as sent: either way it is over then.
        probe.wait(500 * MS)
        seen, spread = motion.mean_speed(probe, 400 * MS)
        end = motion.wait_standing(probe)
        # Replies may come so late that the shaft stood by then.
        if spread <= rpm * _LATE:
            break
    text = f"the speed of {command.name} does not follow the subdivision as the manual says"
    probe.expect(abs(seen), near=rpm, within=rpm * CLOCK_SHARE + spread, unit="rpm", refutes=text, exchange=exchange)
    text = f"{command.name} does not go as far at {subdivision} subdivisions as it should"
    degrees = abs(end.value - before.value)
    probe.expect(degrees, near=turns * 360, unit="degrees", refutes=text, exchange=exchange)


#: A second and a quarter at 60 rpm, and what is long enough for a drive that is slow to reply while it turns.
_TURNS, _MORE_TURNS = 1.25, 4.5
#: The share of a speed by which late replies leave it uncertain.
_LATE = 0.05
