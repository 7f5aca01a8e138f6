"""Newer motion: a command that comes while another one is carried out takes its place.

The MKS manual promises it for moves to a place by the encoder (mode 4: new speeds and new targets on the way). For the other
moves it says nothing: what they do is observed.

Rules kept here:
- What was superseded is not told as complete: the newer command's two replies are all that comes.
- Moves are slow, so that the newer command comes well before the end.
"""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Verb
from conformance.claims.declare import Case, motions
from conformance.claims.motion_claim import (
    command_of,
    expect_speed,
    expect_taken,
    has_direction,
    has_sign,
    of_motion,
    risks_by,
    that_tell_their_end,
)
from conformance.claims.moves import takes_counts, without_max_speed
from conformance.motion import motion
from conformance.motion.motion import CALM, MOVES, MS, QUICK, SECOND_NS
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe

#: The older move: one turn at 30 rpm lasts two seconds; the newer one comes after half of one.
_DEGREES, _RPM, _WHEN_NS = 360, 30, 500 * MS
#: The move that the MKS manual lets be updated.
_UPDATED = Verb.MOVE_ABSOLUTE_AXIS
_moves = motions(*MOVES, where=takes_counts)
_update = motions(MotionKind.MOVE_TO, where=lambda c: c.verb is _UPDATED and takes_counts(c))


def _certainty(case: Case) -> Certainty:
    return Certainty.CERTAIN if command_of(case).verb is _UPDATED else Certainty.OPEN


def _under_way(probe: Probe, command: Command) -> float:
    """Begin the older move and let a while pass; return where it began, in degrees."""
    motion.prepare(probe, command)
    start = motion.position(probe)
    motion.begin(probe, command, _DEGREES, rpm=_RPM, acceleration=QUICK)
    probe.wait(_WHEN_NS)
    return start.value


def _newer(probe: Probe, command: Command, degrees: float) -> Exchange:
    """Ask for the newer move, and refute where it is refused."""
    exchange = motion.ask(probe, command, degrees, acceleration=QUICK)
    expect_taken(probe, exchange, f"{command.name} is refused while one is under way")
    return exchange


@of_motion(each=_moves, refuted_by="a shaft that ends elsewhere", at_best=_certainty)
def _newer_target(probe: Probe, command: Command) -> None:
    """{command} that comes while one is under way takes its place: the shaft ends where the newer one says."""
    start = _under_way(probe, command)
    here = motion.position(probe)
    exchange = _newer(probe, command, 90)
    end = motion.wait_standing(probe)
    # The shaft went on between the look at it and the newer command: at 30 rpm by 180 degrees a second.
    looked_ns = exchange.sent_ns - here.t_ns + here.spread_ns
    way = 1 if end.value > start else -1
    probe.expect(
        end.value - start,
        near=here.value + way * 90 - start,
        within=_RPM * 6 * looked_ns / SECOND_NS + 5,
        unit="degrees from the start",
        refutes=f"{command.name}: a newer one does not take the place of the older one",
        exchange=exchange,
    )


@of_motion(each=_moves, refuted_by="a shaft that keeps the older speed", at_best=_certainty)
def _newer_speed(probe: Probe, command: Command) -> None:
    """{command} that comes while one is under way gives the shaft its own speed."""
    _under_way(probe, command)
    exchange = _newer(probe, command, _DEGREES)
    probe.wait(200 * MS)
    seen = motion.speed(probe)
    motion.stand_still(probe)
    expect_speed(seen, CALM, exchange, f"{command.name}: a newer one does not give the shaft its speed")


@of_motion(
    each=that_tell_their_end(_moves), refuted_by="a completion of the older one, or none of the newer one", at_best=_certainty
)
def _superseded(probe: Probe, command: Command) -> None:
    """{command} that another one supersedes is not told as complete; the newer one is."""
    _under_way(probe, command)
    before = len(probe.traffic)
    # A second of motion: a reply may be late while the motor turns, and is still the first of the two.
    exchange = motion.begin(probe, command, 90, rpm=_RPM // 2, acceleration=QUICK)
    # Listened to, not asked: a request could collide with what is told. The older one would have ended too by then.
    probe.wait(2 * SECOND_NS)
    motion.wait_standing(probe)
    text = f"{command.name}: what comes after a newer one is not its two replies"
    probe.expect(motion.statuses(probe.traffic[before:], command), equal=[1, 2], refutes=text, exchange=exchange)


@of_motion(
    each=_update,
    name="{command}/update-without-stop",
    refuted_by="a shaft that slows down or stops first",
    at_best=Certainty.LIKELY,
)
def _without_stop(probe: Probe, command: Command) -> None:
    """A newer target farther on is taken up without a stop between."""
    motion.prepare(probe, command)
    motion.begin(probe, command, 2 * _DEGREES, acceleration=56)
    probe.wait(700 * MS)
    exchange = motion.begin(probe, command, 2 * _DEGREES, acceleration=56, quiet_ns=0)
    seen = motion.speed(probe)
    motion.stand_still(probe)
    text = f"{command.name}: a newer target slows the shaft down first"
    probe.expect(abs(seen.value), at_least=CALM * 0.8, unit="rpm", refutes=text, exchange=exchange)


def _newer_moves(dialect: Dialect) -> Iterator[Case]:
    """Yield the moves to a place without a speed, each with the older one from which it takes over, which has one."""
    for case in without_max_speed(dialect):
        if motion.of(command_of(case)).kind is MotionKind.MOVE_TO:
            yield Case(dialect, case.command, {"older": case["limited"]})


@of_motion(
    each=lambda dialect: (Case(dialect, case.command, {"older": case.command}) for case in _update(dialect)),
    name="{command}/update-back",
    statement="A newer target behind the shaft turns it round: it ends there.",
    refuted_by="a shaft that ends elsewhere",
)
@of_motion(
    each=_newer_moves,
    name="{command}/newer",
    statement="A newer move takes the place of the one under way.",
    refuted_by="a shaft that ends elsewhere",
    at_best=Certainty.LIKELY,
)
def _turns_back(probe: Probe, command: Command, older: Command) -> None:
    motion.prepare(probe, command)
    begun, start = motion.position(probe), motion.place(probe, command)
    motion.begin(probe, older, _DEGREES, rpm=_RPM, acceleration=QUICK, start=start)
    probe.wait(_WHEN_NS)
    exchange = motion.begin(probe, command, -30, acceleration=QUICK, start=start)
    went = motion.wait_standing(probe).value - begun.value
    text, within = f"{command.name}: a newer target behind the shaft is not where it ends", motion.near(probe.dialect)
    probe.expect(went, near=-30, within=within, unit="degrees from the start", refutes=text, exchange=exchange)


@of_motion(
    each=_update,
    name="{command}/takes-over-a-run",
    refuted_by="a run that goes on, or another place",
    at_best=Certainty.LIKELY,
    risks=risks_by(Verb.RUN_SPEED),
)
def _after_a_run(probe: Probe, command: Command) -> None:
    """A move takes over from a run at a speed and ends at its target."""
    motion.prepare(probe, command)
    begun, start = motion.position(probe), motion.place(probe, command)
    motion.run_at(probe, _RPM, QUICK)
    probe.wait(500 * MS)
    exchange = motion.begin(probe, command, 66, acceleration=QUICK, start=start)
    went = motion.wait_standing(probe).value - begun.value
    text, within = f"{command.name} does not take over from a run", motion.near(probe.dialect)
    probe.expect(went, near=66, within=within, unit="degrees from the start", refutes=text, exchange=exchange)


@of_motion(
    each=motions(MotionKind.RUN, where=has_direction),
    refuted_by="a shaft that stops at the target of the move",
    at_best=Certainty.LIKELY,
)
def _takes_over_a_move(probe: Probe) -> None:
    """A run at a speed takes over from a move and goes on beyond its target."""
    move = probe.command(_UPDATED)
    motion.prepare(probe, move)
    motion.begin(probe, move, 180, rpm=_RPM, acceleration=QUICK)
    probe.wait(300 * MS)
    exchange = motion.run_at(probe, _RPM, QUICK)
    probe.wait(1500 * MS)
    seen = motion.speed(probe)
    motion.stand_still(probe)
    expect_speed(seen, _RPM, exchange, "a run does not take over from a move")


@of_motion(
    each=lambda dialect: (c for c in motions(MotionKind.RUN, *MOVES)(dialect) if motion.of(command_of(c)).acceleration),
    name="{command}/speed-0",
    statement="{command} with speed 0 stops the shaft, whatever else it says.",
    refuted_by="a shaft that goes on",
    at_best=Certainty.OPEN,
    risks=risks_by(Verb.RUN_SPEED),
)
@of_motion(
    each=motions(MotionKind.RUN, where=has_sign),
    name="{command}/zero",
    statement="Speed 0 stops the shaft.",
    refuted_by="a shaft that turns",
)
def _speed_0(probe: Probe, command: Command) -> None:
    motion.prepare(probe, command)
    motion.run_at(probe, CALM, QUICK)
    probe.wait(200 * MS)
    # A run with direction 0 as well would be the stop of this command.
    direction = {"direction": 1} if motion.of(command).kind is MotionKind.RUN and has_direction(command) else {}
    exchange = motion.ask(probe, command, 90, rpm=0, acceleration=QUICK, more=direction)
    probe.wait(600 * MS)
    seen = motion.speed(probe)
    motion.stand_still(probe)
    expect_speed(seen, 0, exchange, f"{command.name} with speed 0 does not stop the shaft")
