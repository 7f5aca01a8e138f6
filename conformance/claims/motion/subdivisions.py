"""Subdivisions: how fast the shaft turns, and how far each motion takes it, at each.

    real rpm = speed as sent                        at 16, 32 and 64 subdivisions
    real rpm = speed as sent x 16 / subdivision     at the others

    subdivision x motion        both ways by turns; moves by pulses at all subdivisions

What a subdivision shows is kept once, and judged by the claims about it and about each motion.

Rules kept here:
- A turn has 200 pulses for each subdivision; what counts by the encoder goes as far at each.
- The shaft is looked at once on its way, held against the law of ramps, and where it comes to rest.
- Whether a ramp goes by the speed of the shaft or by that which was sent no manual says.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Verb
from analyzer.layout import Effect
from conformance.claim import Inconclusive
from conformance.claims.crossed.course import motions_of
from conformance.claims.declare import Case
from conformance.claims.motion.motion_claim import of_motion
from conformance.gate.gate import Refused
from conformance.motion import arriving, course, declared, motion, ramp
from conformance.motion.attempts import undamaged
from conformance.motion.declared import CALM
from conformance.motion.motion import Sample
from conformance.talk.exchange import Exchange
from conformance.talk.noise import CLOCK_SHARE
from conformance.talk.probe import MS, Probe

#: Subdivisions at which the rule of speeds and pulses is tried, as the number that they stand for.
_TRIED = (2, 8, 16, 32, 64, 100, 128, 256)
#: Others: at the first of them each motion is tried too, at all a move by pulses and one motion more in turn.
_ALSO, _OTHERS = (1, 4, 7), (3, 5, 10, 20, 25, 40, 50, 67, 200, 255)
#: The way of a move in degrees, its ramp, and when the shaft is looked at: a move that is twice as fast is beyond it.
_WAY, _STEEP, _MIDWAY = 36, 255, 50 * MS
#: A speed that is no whole number of rpm, and how long it is looked at.
_PART, _PART_NS = 1.5, 400 * MS
#: What a shaft may lag behind its law.
_LAG_NS = 10 * MS


@dataclass(frozen=True)
class Tried:
    """A motion at a subdivision. `rpm`: the real speed; `way`: 1 or -1; `start`, `on`, `end`: where the shaft was.

    `slack_ns`: what its times may be off.
    """

    subdivision: int
    command: Command
    exchange: Exchange
    refused: bool
    way: int
    rpm: float
    slack_ns: float
    start: Sample
    on: Sample
    end: Sample

    @property
    def midway(self) -> tuple[float, float]:
        """How far it is at the look on its way, least and most, in degrees."""
        runs = not declared.of(self.command).distance
        law = course.run(0, self.rpm, _STEEP) if runs else course.move(_WAY / 360, self.rpm, _STEEP)
        reply = self.exchange.reply
        late_ns = reply.first_ns - self.exchange.sent_ns if reply is not None else 0
        since_ns, until_ns = (self.on.t_ns + side * self.on.spread_ns - self.exchange.sent_ns for side in (-1, 1))
        low, high = law.turns(
            (since_ns - late_ns - _LAG_NS - self.slack_ns) / (1 + ramp.SLOW_QUIRK),
            (until_ns + self.slack_ns) / (1 - CLOCK_SHARE),
        )
        return low * 360, high * 360


def _sent(dialect: Dialect, subdivision: int) -> int | None:
    """Return a subdivision as it is sent, None where it cannot be."""
    found = dialect.effect(Effect.SUBDIVISION)
    if found is None or dialect.subdivision is None:
        return None
    sent = subdivision if subdivision <= found[1].wire_maximum else 0
    return sent if found[1].allows(sent) else None


def _table(dialect: Dialect) -> dict[int, list[tuple[Command, int]]]:
    """Return the motions that are tried at each subdivision, and their ways."""
    every = motions_of(dialect)
    by_pulses = [c for c in every if c.verb is Verb.MOVE_RELATIVE_PULSES]
    others = [c for c in every if c not in by_pulses]
    found = {}
    for number, subdivision in enumerate((*_TRIED, *_ALSO, *_OTHERS)):
        tried = every if subdivision not in _OTHERS else (*by_pulses, others[number % len(others)])
        if _sent(dialect, subdivision) is not None:
            found[subdivision] = [(command, -1 if (number + place) % 2 else 1) for place, command in enumerate(tried)]
    return found


def turned(probe: Probe, subdivision: int) -> tuple[Tried, ...]:
    """Carry out the motions of a subdivision and return what was seen. Raises Refused where the gate lets none through."""
    found: list[Tried] = []
    motion.ready_to_move(probe, subdivision=_sent(probe.dialect, subdivision))
    rest = motion.wait_standing(probe)
    refused: Refused | None = None
    for command, way in _table(probe.dialect)[subdivision]:
        # The bytes of one way may hold another frame, which the gate refuses; those of the other way do not.
        for each in (way, -way):
            try:
                found.append(undamaged(probe, _try, subdivision, command, each, rest=rest))
                rest = found[-1].end
                break
            except Refused as error:
                refused = error
                rest = motion.stand_still(probe)
    if refused is not None and not found:
        raise refused
    return tuple(found)


def _try(probe: Probe, subdivision: int, command: Command, way: int, start: Sample) -> Tried:
    of, runs, law = declared.of(command), not declared.of(command).distance, probe.dialect.subdivision
    assert law is not None  # it has subdivisions
    rpm = way * CALM if runs else CALM
    exchange = motion.ask(probe, command, way * _WAY, quiet_ns=0, rpm=rpm, acceleration=_STEEP, subdivision=subdivision)
    sent = exchange.values[of.speed]
    real = float(sent) if subdivision in law.plain else sent * law.counted_at / subdivision
    slack_ns = abs(ramp.ramp_ns(0, sent, _STEEP) - ramp.ramp_ns(0, real, _STEEP)) + ramp.slack_ns(_STEEP)
    refused = not exchange.is_read or probe.refused(exchange)
    probe.wait(exchange.sent_ns + _MIDWAY - probe.gate.now_ns())
    on = motion.position(probe)
    if runs:
        motion.stop(probe, 0)
        end = motion.wait_standing(probe)
    else:
        law_ns = int((ramp.move_ns(_WAY / 360, real, _STEEP) + slack_ns) * (1 + ramp.SLOW_QUIRK))
        # A slow one is judged by where it was on its way.
        end = arriving.come_to_rest(probe, exchange, law_ns, law_ns)
    return Tried(subdivision, command, exchange, refused, way, real, slack_ns, start, on, end)


def _expect(probe: Probe, tried: Tried, text: str, *, speed: bool = True, way: bool = True) -> None:
    command, exchange = tried.command, tried.exchange
    shown = f"{command.name} {'+' if tried.way > 0 else '-'} at {tried.subdivision} subdivisions"
    taken = not tried.refused or not exchange.is_read
    probe.expect("a refusal or no answer", holds=taken, expected=f"motion: {shown}", refutes=text, exchange=exchange)
    if tried.refused:
        return
    within = motion.miss(probe) + probe.noise.swing + 1
    if speed:
        low, high = tried.midway
        probe.expect(
            abs(tried.on.value - tried.start.value),
            at_least=low - within,
            at_most=high + within,
            unit="degrees",
            expected=f"{low:.4g} to {high:.4g} degrees on the way at {tried.rpm:.4g} rpm: {shown}",
            refutes=text,
            exchange=exchange,
        )
    if way and declared.of(command).distance:
        went, signed = tried.end.value - tried.start.value, not declared.takes_pulses(command)
        probe.expect(
            went if signed else abs(went),
            near=tried.way * _WAY if signed else _WAY,
            within=within,
            unit="degrees",
            expected=f"{_WAY} degrees: {shown}",
            refutes=text,
            exchange=exchange,
        )


def _of(probe: Probe, subdivision: int, *verbs: Verb) -> list[Tried]:
    found = [tried for tried in probe.recorded(turned, subdivision) if tried.command.verb in verbs or not verbs]
    if not found:
        raise Inconclusive(f"no motion could be tried at {subdivision} subdivisions")
    return found


def _subdivisions(dialect: Dialect) -> Iterator[Case]:
    """Yield the subdivisions of a dialect, and the rpm that the speed which is sent at it means."""
    found, law = dialect.effect(Effect.SUBDIVISION), dialect.subdivision
    if found is None or law is None:
        return
    command, _ = found
    for subdivision in _TRIED:
        if _sent(dialect, subdivision) is not None:
            run = declared.field_of(dialect.by_verb[Verb.RUN_SPEED], "speed")
            speed = declared.speed_as_sent(dialect, run, CALM, subdivision)
            rpm = speed if subdivision in law.plain else speed * law.counted_at / subdivision
            yield Case(
                dialect,
                command,
                {"subdivision": subdivision, "speed": speed, "rpm": rpm, "pulses": 200 * subdivision},
                _facts(dialect),
            )


def _facts(dialect: Dialect) -> dict[str, object]:
    return {"risks": declared.risks(dialect, *frozenset().union(*(c.all_risks for c in motions_of(dialect))))}


def _settings_of_subdivisions(dialect: Dialect) -> Iterator[Case]:
    found = dialect.effect(Effect.SUBDIVISION)
    if found is not None and dialect.subdivision is not None:
        yield Case(dialect, found[0], facts=_facts(dialect))


def _other_subdivisions(dialect: Dialect) -> Iterator[Case]:
    others = sorted(n for n in (*_ALSO, *_OTHERS) if _sent(dialect, n) is not None)
    for case in _settings_of_subdivisions(dialect):
        statement = f"At {', '.join(map(str, others))} subdivisions too a turn has 200 pulses for each."
        yield Case(dialect, case.command, {"others": others}, {**case.facts, "statement": statement})


def _motions(dialect: Dialect) -> Iterator[Case]:
    for _ in _settings_of_subdivisions(dialect):
        for command in motions_of(dialect):
            yield Case(dialect, command, facts=_facts(dialect) | {"at_best": Certainty.LIKELY})


_of_subdivision = partial(of_motion, each=_subdivisions, parameters=lambda case: {"subdivision": case["subdivision"]})


@_of_subdivision(name="{command}/speed-at-{subdivision}", refuted_by="another speed of the shaft", at_best=Certainty.LIKELY)
def _speed(probe: Probe, subdivision: int) -> None:
    """At {subdivision} subdivisions speed {speed} turns the shaft at {rpm:g} rpm, in a run and in a move."""
    for tried in _of(probe, subdivision):
        _expect(probe, tried, "the speed of the shaft does not follow the subdivision as the manual says", way=False)


@_of_subdivision(name="{command}/pulses-at-{subdivision}", refuted_by="a move by pulses of another length")
def _pulses(probe: Probe, subdivision: int) -> None:
    """At {subdivision} subdivisions a turn has {pulses} pulses."""
    for tried in _of(probe, subdivision, Verb.MOVE_RELATIVE_PULSES):
        text = f"{20 * subdivision} pulses at {subdivision} subdivisions are not a tenth of a turn"
        _expect(probe, tried, text, speed=False)


@of_motion(each=_other_subdivisions, name="{command}/pulses-at-others", refuted_by="a move by pulses of another length")
def _pulses_at_others(probe: Probe, others: list[int]) -> None:
    for subdivision in others:
        _pulses(probe, subdivision)


@of_motion(each=_motions, refuted_by="another length, another way, or another speed")
def _at_each_subdivision(probe: Probe, command: Command) -> None:
    """At each subdivision {command} goes as far as asked and as fast as the law of subdivisions says."""
    for subdivision, motions in _table(probe.dialect).items():
        for tried in _of(probe, subdivision, command.verb) if command in (c for c, _ in motions) else ():
            _expect(probe, tried, f"{command.name} goes elsewhere or at another speed at {subdivision} subdivisions")


def _finest(dialect: Dialect) -> Iterator[Case]:
    """Yield each motion with the largest subdivision, at which a speed as sent is the smallest part of a rpm."""
    largest = dialect.subdivision.largest if dialect.subdivision is not None else 0
    for case in _motions(dialect) if _sent(dialect, largest) is not None else ():
        yield Case(dialect, case.command, {"subdivision": largest}, case.facts)


@of_motion(each=_finest, refuted_by="a whole number of rpm", parameters={})
def _parts_of_a_rpm(probe: Probe, command: Command, subdivision: int) -> None:
    """At {subdivision} subdivisions {command} turns the shaft at 1.5 rpm where that is what the speed means."""
    motion.ready_to_move(probe, subdivision=_sent(probe.dialect, subdivision))
    exchange, (rpm, spread) = undamaged(probe, _slow, command, subdivision)
    if spread > _PART / 4:
        raise Inconclusive(f"a speed cannot be measured: {spread:.1f} rpm are uncertain")
    within = _PART * 2 * CLOCK_SHARE + spread
    text = f"{command.name} turns the shaft at another speed than {_PART} rpm"
    probe.expect(abs(rpm), near=_PART, within=within, unit="rpm", refutes=text, exchange=exchange)


def _slow(probe: Probe, command: Command, subdivision: int) -> tuple[Exchange, tuple[float, float]]:
    """Turn the shaft by a part of a rpm; return what was said, the speed and its uncertainty, and stop it."""
    exchange = motion.begin(probe, command, _WAY, quiet_ns=0, rpm=_PART, acceleration=_STEEP, subdivision=subdivision)
    probe.wait(_LAG_NS)
    seen = motion.mean_speed(probe, _PART_NS)
    motion.stand_still(probe)
    return exchange, seen
