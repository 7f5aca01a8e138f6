"""Subdivisions: how fast the shaft turns, and how far pulses take it, at each.

    real rpm = speed as sent                        at 16, 32 and 64 subdivisions
    real rpm = speed as sent x 16 / subdivision     at the others

Rule kept here: a turn has 200 pulses for each subdivision.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Verb
from analyzer.layout import Effect
from conformance.claims.crossed import motions_of
from conformance.claims.declare import Case
from conformance.claims.motion_claim import of_motion, risks_by
from conformance.motion import course, motion, ramp
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


def _axis_moves(dialect: Dialect) -> Iterator[Case]:
    found = dialect.effect(Effect.SUBDIVISION)
    if found is not None and dialect.subdivision is not None:
        for command in motions_of(dialect):
            if motion.of(command).distance and not motion.takes_pulses(command):
                yield Case(dialect, command, facts={"risks": motion.risks(dialect, *command.all_risks)})


@of_motion(each=_axis_moves, refuted_by="another length, or another way")
def _at_each_subdivision(probe: Probe, command: Command) -> None:
    """At each subdivision {command} goes as far as asked, either way: it counts by the encoder."""
    for case in _subdivisions(probe.dialect):
        motion.ready_to_move(probe, subdivision=case["sent"])
        # Where it stands by more than one look: a lone read may be a stray one.
        stands = motion.wait_standing(probe)
        for way in (1, -1):
            how = {"acceleration": QUICK, "subdivision": case["subdivision"]}
            move = motion.follow(probe, command, way * _SHORT, **how)
            text = f"{command.name} goes elsewhere at {case['subdivision']} subdivisions"
            # Told from half, twice, and the other way.
            within = motion.miss(probe) + 1
            went, stands = move.end.value - stands.value, move.end
            probe.expect(went, near=way * _SHORT, within=within, unit="degrees", refutes=text, exchange=move.exchange)


def _lowest(dialect: Dialect) -> Iterator[Case]:
    for command in motions_of(dialect):
        yield Case(dialect, command, facts={"risks": motion.risks(dialect, *command.all_risks)})


@of_motion(each=_lowest, refuted_by="a shaft that stays, another way, or a ramp that is none", at_best=Certainty.LIKELY)
def _lowest_values(probe: Probe, command: Command) -> None:
    """{command} takes the lowest speed and the slowest ramp, 1 each, either way."""
    motion.ready_to_move(probe, subdivision=motion.SUBDIVISION)
    runs = not motion.of(command).distance
    for way in (1, -1):
        for rpm, acceleration, degrees in ((1, QUICK, _SLOW), (_RAMPED, 1, 2 * _SHORT)):
            before = motion.wait_standing(probe)
            speed = way * rpm if runs else rpm
            exchange = motion.ask(probe, command, way * degrees, quiet_ns=0, rpm=speed, acceleration=acceleration)
            text = f"{command.name} at speed {rpm} and acceleration {acceleration} is refused or not answered"
            taken = motion.readable(exchange) and not probe.refused(exchange)
            probe.expect("a refusal or no answer", holds=taken, expected="motion", refutes=text, exchange=exchange)
            probe.wait(exchange.sent_ns + _MIDWAY_NS - probe.gate.now_ns())
            on = motion.position(probe)
            law = course.run(0, rpm, acceleration) if runs else course.move(degrees / 360, rpm, acceleration)
            since_ns, until_ns = (on.t_ns + side * on.spread_ns - exchange.sent_ns for side in (-1, 1))
            late_ns = exchange.reply.first_ns - exchange.sent_ns if exchange.reply is not None else 0
            first_ns = (since_ns - late_ns - _LAG_NS) / (1 + ramp.SLOW_QUIRK) - ramp.step_ns(acceleration)
            low, high = law.turns(first_ns, until_ns / (1 - CLOCK_SHARE) + ramp.step_ns(acceleration))
            text = f"{command.name} at speed {rpm} and acceleration {acceleration} leaves its course"
            within = motion.miss(probe) + probe.noise.swing
            probe.expect(
                abs(on.value - before.value),
                at_least=low * 360 - within,
                at_most=high * 360 + within,
                unit="degrees",
                refutes=text,
                exchange=exchange,
            )
            motion.stop(probe)
    motion.wait_standing(probe)


#: Degrees that are moved at each subdivision, and at the lowest speed; the speed of the slowest ramp (rpm).
_SHORT, _SLOW, _RAMPED = 8, 4, 20
#: When the shaft is looked at: at the lowest speed it has gone a degree and more. What it may lag behind.
_MIDWAY_NS, _LAG_NS = 250 * MS, 10 * MS
