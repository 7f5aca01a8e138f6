"""The values of a motion are its own: the lowest ones are taken, and none is that of the motion before.

    speed 1, acceleration 1          either way: the shaft keeps to its course
    slow ramp, then acceleration 0   at once; then a slow ramp again: by it

Rules kept here:
- The shaft is looked at once on its way, and held against the law of ramps.
"""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.catalogue import Certainty, Command, Dialect, Verb
from conformance.claims.crossed.course import motions_of
from conformance.claims.declare import Case
from conformance.claims.motion.motion_claim import of_motion
from conformance.motion import course, declared, motion, ramp
from conformance.motion.attempts import undamaged
from conformance.motion.declared import CALM, QUICK
from conformance.motion.motion import Sample
from conformance.talk.exchange import Exchange
from conformance.talk.noise import CLOCK_SHARE
from conformance.talk.probe import MS, Probe

#: Degrees that are moved by the slowest ramp, and at the lowest speed; the speed of that ramp (rpm).
_SHORT, _SLOW, _RAMPED = 8, 4, 20
#: When the shaft is looked at: at the lowest speed it has gone a degree and more.
_MIDWAY_NS = 250 * MS
#: What a shaft may lag behind its law.
_LAG_NS = 10 * MS
#: A slow ramp, of 5 ms for a rpm; how long the first motion turns by it; the speed, the way and the look of those behind it.
_EASY, _FIRST_NS = 156, 100 * MS
_RPM, _WAY, _SEEN_NS = 2 * CALM, 90, 60 * MS


def _motions(dialect: Dialect) -> Iterator[Case]:
    for command in motions_of(dialect):
        yield Case(dialect, command, facts={"risks": declared.risks(dialect, *command.all_risks)})


def _motions_behind_a_run(dialect: Dialect) -> Iterator[Case]:
    for command in motions_of(dialect):
        risks = declared.risks(dialect, *command.all_risks, *dialect.by_verb[Verb.RUN_SPEED].all_risks)
        yield Case(dialect, command, facts={"risks": risks})


def _begun(
    probe: Probe, command: Command, rpm: float, acceleration: int, degrees: float, look_ns: int
) -> tuple[Sample, Exchange, Sample]:
    """Begin a motion; return where the shaft stood, what was said, and where the shaft is a little later."""
    before = motion.wait_standing(probe)
    speed = abs(rpm) if declared.of(command).distance else rpm
    exchange = motion.ask(probe, command, degrees, quiet_ns=0, rpm=speed, acceleration=acceleration)
    probe.wait(exchange.sent_ns + look_ns - probe.gate.now_ns())
    return before, exchange, motion.position(probe)


def _expect_on_course(
    probe: Probe, command: Command, rpm: float, acceleration: int, degrees: float, look_ns: int, where: str = ""
) -> None:
    """Begin a motion from rest, refute unless it is taken and the shaft keeps to its course, and stop it."""
    before, exchange, on = undamaged(probe, _begun, command, rpm, acceleration, degrees, look_ns)
    what = f"{command.name} at speed {abs(rpm):g} and acceleration {acceleration}{where}"
    taken = exchange.is_read and not probe.refused(exchange)
    text = f"{what} is refused or not answered"
    probe.expect("a refusal or no answer", holds=taken, expected="motion", refutes=text, exchange=exchange)
    runs = not declared.of(command).distance
    law = course.run(0, abs(rpm), acceleration) if runs else course.move(abs(degrees) / 360, abs(rpm), acceleration)
    since_ns, until_ns = (on.t_ns + side * on.spread_ns - exchange.sent_ns for side in (-1, 1))
    late_ns = exchange.reply.first_ns - exchange.sent_ns if exchange.reply is not None else 0
    first_ns = (since_ns - late_ns - _LAG_NS) / (1 + ramp.SLOW_QUIRK) - ramp.slack_ns(acceleration)
    low, high = law.turns(first_ns, until_ns / (1 - CLOCK_SHARE) + ramp.slack_ns(acceleration))
    within = motion.miss(probe) + probe.noise.swing
    probe.expect(
        abs(on.value - before.value),
        at_least=low * 360 - within,
        at_most=high * 360 + within,
        unit="degrees",
        refutes=f"{what} leaves its course",
        exchange=exchange,
    )
    motion.stop(probe)


@of_motion(each=_motions, refuted_by="a shaft that stays, another way, or a ramp that is none", at_best=Certainty.LIKELY)
def _lowest_values(probe: Probe, command: Command) -> None:
    """{command} takes the lowest speed and the slowest ramp, 1 each, either way."""
    motion.ready_to_move(probe, subdivision=declared.SUBDIVISION)
    for way in (1, -1):
        for rpm, acceleration, degrees in ((1, QUICK, _SLOW), (_RAMPED, 1, 2 * _SHORT)):
            _expect_on_course(probe, command, way * rpm, acceleration, way * degrees, _MIDWAY_NS)
    motion.wait_standing(probe)


@of_motion(each=_motions_behind_a_run, refuted_by="the ramp of the motion before", at_best=Certainty.LIKELY)
def _own_ramp(probe: Probe, command: Command) -> None:
    """{command} turns at once by acceleration 0 behind a slow motion, and by its own ramp behind one that was at once."""
    motion.ready_to_move(probe, subdivision=declared.SUBDIVISION)
    motion.run_at(probe, -CALM, _EASY)
    probe.wait(_FIRST_NS)
    probe.ask(Verb.EMERGENCY_STOP)
    _expect_on_course(probe, command, _RPM, 0, _WAY, _SEEN_NS, " behind a slow motion")
    probe.ask(Verb.EMERGENCY_STOP)
    _expect_on_course(probe, command, -_RPM, _EASY, -_WAY, 2 * _SEEN_NS, " behind one that was at once")
    motion.wait_standing(probe)
