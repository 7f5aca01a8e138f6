"""Subdivisions: how fast the shaft turns, and how far pulses take it, at each.

    real rpm = speed as sent                        at 16, 32 and 64 subdivisions
    real rpm = speed as sent x 16 / subdivision     at the others

Rule kept here: a turn has 200 pulses for each subdivision.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Certainty, Dialect, Verb
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
