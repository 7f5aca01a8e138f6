"""Newer motion: a command that comes while another one is carried out takes its place.

The MKS manual promises it for moves to a place by the encoder (mode 4: new speeds and new targets on the way). For the other
moves it says nothing: what they do is observed. LK motors have one goal: each command of motion sets it.

Rules kept here:
- What was superseded is not told as complete: the newer command's two replies are all that comes.
- Moves are slow, so that the newer command comes well before the end.
"""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Risk, Verb
from conformance.claim import Inconclusive
from conformance.claims.declare import Case, Cases, motions
from conformance.claims.motion.motion_claim import (
    command_of,
    expect_speed,
    expect_taken,
    has_direction,
    has_sign,
    of_motion,
    risks_by,
    that_tell_their_end,
)
from conformance.claims.motion.moves import takes_angle, takes_counts, with_max_speed, without_max_speed
from conformance.claims.motion.stops import expect_standing
from conformance.motion import arriving, declared, motion
from conformance.motion.attempts import damaged
from conformance.motion.declared import CALM, FORCE, MOVES, QUICK, SUBDIVISION
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, SECOND_NS, Probe

#: The older move: 270 degrees at 30 rpm last a second and a half; the newer one comes after 0.3 of one.
_DEGREES, _RPM, _WHEN_NS = 270, 30, 300 * MS
#: When a shaft that takes over has its speed, and when one without a law of ramps may stand.
_SPEED_NS, _RESTS_NS = 200 * MS, 500 * MS
#: The move that the MKS manual lets be updated.
_UPDATED = Verb.MOVE_ABSOLUTE_AXIS
_moves = motions(*MOVES, where=takes_counts)
#: Increments with a speed: an angle counts from where the shaft is.
_increments = motions(MotionKind.MOVE_BY, where=lambda c: takes_angle(c) and bool(declared.of(c).speed))
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


def _not_crossed(each: Cases) -> Cases:
    """Return those of some cases whose dialect has no crossed motions: there `takes-over` shows speed and target too."""
    return lambda dialect: each(dialect) if dialect.ramp is None else ()


@of_motion(
    each=_not_crossed(lambda dialect: (*_moves(dialect), *_increments(dialect))),
    refuted_by="a shaft that ends elsewhere",
    at_best=_certainty,
)
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


def _with_speed(dialect: Dialect) -> Iterator[Case]:
    yield from with_max_speed(dialect)
    yield from motions(MotionKind.RUN)(dialect)


@of_motion(each=_not_crossed(_with_speed), refuted_by="a shaft that keeps the older speed", at_best=Certainty.LIKELY)
def _newer_speed(probe: Probe, command: Command) -> None:
    """{command} that comes while one is under way gives the shaft its own speed, a higher one and a lower one."""
    motion.ready_to_move(probe)
    _begin_way(probe, command, 1, _RPM)
    # Within a turn there is no room for more.
    probe.wait(_SPEED_NS)
    for rpm in (CALM, _RPM):
        exchange = _begin_way(probe, command, 1, rpm)
        probe.wait(_SPEED_NS)
        seen = motion.speed(probe)
        if abs(seen.value - rpm) > 1:
            motion.stop(probe)
        expect_speed(seen, rpm, exchange, f"{command.name}: a newer one does not give the shaft its speed")
    motion.stand_still(probe)


#: A ramp by which 60 rpm take a while: 5 ms for one rpm.
_SLOW_RAMP = 156


@of_motion(
    each=motions(MotionKind.MOVE_TO, where=lambda c: takes_counts(c) and bool(declared.of(c).acceleration)),
    name="{command}/newer-acceleration-alone",
    refuted_by="a motion that goes on as before",
    at_best=_certainty,
)
def _newer_acceleration(probe: Probe, command: Command) -> None:
    """{command} that comes while one is under way, and differs in its acceleration alone, changes that."""
    motion.prepare(probe, command)
    start, degrees = motion.place(probe, command), 2 * _DEGREES
    motion.begin(probe, command, degrees, rpm=CALM, acceleration=_SLOW_RAMP, start=start)
    probe.wait(100 * MS)
    exchange = motion.ask(probe, command, degrees, rpm=CALM, acceleration=QUICK, start=start, quiet_ns=0)
    expect_taken(probe, exchange, f"{command.name} is refused while one is under way")
    probe.wait(60 * MS)
    seen = motion.speed(probe)
    motion.stand_still(probe)
    expect_speed(seen, CALM, exchange, f"{command.name}: a newer one that differs in its acceleration alone changes nothing")


@of_motion(
    each=that_tell_their_end(_update), refuted_by="a completion of the older one, or none of the newer one", at_best=_certainty
)
def _superseded(probe: Probe, command: Command) -> None:
    """{command} that another one supersedes is not told as complete; the newer one is."""
    _under_way(probe, command)
    before = len(probe.traffic)
    # A second of motion: a reply may be late while the motor turns, and is still the first of the two.
    exchange = motion.begin(probe, command, 90, rpm=_RPM // 2, acceleration=QUICK)
    # Listened to, not asked: a request could collide with what is told. The older one would have ended too by then.
    probe.wait(1500 * MS)
    motion.wait_standing(probe)
    text = f"{command.name}: what comes after a newer one is not its two replies"
    probe.expect(arriving.statuses(probe.traffic[before:], command), equal=[1, 2], refutes=text, exchange=exchange)


@of_motion(
    each=_update,
    name="{command}/update-without-stop",
    refuted_by="a shaft that slows down or stops first",
    at_best=Certainty.LIKELY,
)
def _without_stop(probe: Probe, command: Command) -> None:
    """A newer target farther on is taken up without a stop between."""
    motion.prepare(probe, command)
    # Its ramp takes 0.3 s.
    motion.begin(probe, command, 2 * _DEGREES, acceleration=156)
    probe.wait(350 * MS)
    exchange = motion.begin(probe, command, 2 * _DEGREES, acceleration=156, quiet_ns=0)
    seen = motion.speed(probe)
    motion.stand_still(probe)
    text = f"{command.name}: a newer target slows the shaft down first"
    probe.expect(abs(seen.value), at_least=CALM * 0.8, unit="rpm", refutes=text, exchange=exchange)


def _newer_moves(dialect: Dialect) -> Iterator[Case]:
    """Yield the moves to a place without a speed, each with the older one from which it takes over, which has one."""
    for case in without_max_speed(dialect):
        if declared.of(command_of(case)).kind is MotionKind.MOVE_TO:
            yield Case(dialect, case.command, {"older": case["limited"]})


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
    text, within = f"{command.name}: a newer target behind the shaft is not where it ends", declared.near(probe.dialect)
    probe.expect(went, near=-30, within=within, unit="degrees from the start", refutes=text, exchange=exchange)


def _certain_of_speed_0(case: Case) -> Certainty:
    """The section on speeds that has the highest one of each mode says it, of runs and moves alike; that of CAN does not."""
    return Certainty.LIKELY if case.dialect.mode_speeds else Certainty.OPEN


@of_motion(
    each=lambda dialect: (c for c in motions(MotionKind.RUN, *MOVES)(dialect) if declared.of(command_of(c)).acceleration),
    name="{command}/speed-0",
    statement="{command} with speed 0 stops the shaft, with any of its other values.",
    refuted_by="a shaft that goes on",
    at_best=_certain_of_speed_0,
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
    probe.wait(_SPEED_NS)
    # A run with direction 0 as well would be the stop of this command.
    direction = {"direction": 1} if declared.of(command).kind is MotionKind.RUN and has_direction(command) else {}
    exchange = motion.ask(probe, command, 90, rpm=0, acceleration=QUICK, more=direction)
    probe.wait(_SPEED_NS if probe.dialect.ramp is not None else _RESTS_NS)
    expect_standing(probe, exchange, f"{command.name} with speed 0 does not stop the shaft")


# --- every motion over every other one ----------------------------------------------------------------------------------

#: How far each motion is asked to go (degrees): longer than it is looked at, within a turn where it must be.
_FAR, _IN_TURN = 720, 300
#: How far back within a turn: the shaft goes on before it turns round, and what is left of the turn is the room for that.
_BACK_IN_TURN = 120
#: The least speed that has a direction (rpm); how often and how long it is looked for.
_LEAST, _EVERY_NS, _WITHIN_NS = 3, 30 * MS, 2 * SECOND_NS
#: How often one motion is begun over another one at most, where the line damages replies.
_TRIES = 3


def _every_motion(dialect: Dialect) -> list[Command]:
    every = dialect.motions(MotionKind.RUN, *MOVES, MotionKind.TORQUE)
    return [c for c in every if dialect.model or not c.models]


def _over_others(dialect: Dialect) -> Iterator[Case]:
    """Yield the motions of drives without a law of ramps; those with one are crossed (`claims.crossed.newer`)."""
    if dialect.ramp is not None:
        return
    every = dialect.motions(MotionKind.RUN, *MOVES, MotionKind.TORQUE) if declared.can_move(dialect) else ()
    risks = frozenset[Risk]().union(*(c.all_risks for c in every))
    for command in every:
        # MKS promises it of moves to a place by the encoder, and of runs.
        open_ = takes_counts(command) and command.verb is not _UPDATED if declared.of(command).distance else False
        certainty = Certainty.OPEN if open_ else Certainty.LIKELY
        yield Case(dialect, command, facts={"risks": declared.risks(dialect, *risks), "at_best": certainty})


def _begin_way(probe: Probe, command: Command, way: int, rpm: float = CALM, in_turn: int = _IN_TURN) -> Exchange:
    """Ask for a long motion in a direction, at rest or during another motion; `in_turn`: how far it goes within a turn."""
    kind = declared.of(command).kind
    degrees = way * (in_turn if kind is MotionKind.MOVE_IN_TURN else _FAR)
    force = declared.values_of(probe.dialect, command) if kind is MotionKind.TORQUE else {}
    more = dict.fromkeys(force, way * FORCE)
    rpm = way * rpm if kind is MotionKind.RUN else rpm
    return motion.ask(probe, command, degrees, rpm=rpm, acceleration=QUICK, more=more, quiet_ns=0)


def _direction(probe: Probe, wanted: int = 0) -> int:
    """Return which way the shaft turns, once it does (the `wanted` way, if there is one), 0 where it does not."""
    seen = [0]

    def turns() -> bool:
        rpm = motion.speed(probe).value
        seen.append((rpm > 0) - (rpm < 0) if abs(rpm) >= _LEAST else 0)
        return seen[-1] == wanted if wanted else bool(seen[-1])

    motion.wait_until(probe, turns, every_ns=_EVERY_NS, limit_ns=_WITHIN_NS)
    return seen[-1]


def _turned_over(probe: Probe, older: Command, command: Command, way: int, sense: int) -> tuple[Exchange, int, int]:
    """Begin a motion, and another one the other way; return its exchange, and which way the shaft turned before and after."""
    _begin_way(probe, older, way, _RPM)
    probe.wait(_EVERY_NS)
    before = _direction(probe)
    if not before:
        raise Inconclusive(f"{older.name} does not turn the shaft")
    fast = abs(motion.speed(probe).value)
    exchange = _begin_way(probe, command, -before * sense, in_turn=_BACK_IN_TURN)
    after = _direction(probe, -before)
    if after == before and abs(motion.speed(probe).value) < fast / 2:
        raise Inconclusive(f"the shaft slows down too slowly to see whether {command.name} takes over")
    return exchange, before, after


@of_motion(each=_over_others, name="{command}/takes-over", refuted_by="a shaft that turns on as before, or a refusal")
def _takes_over(probe: Probe, command: Command) -> None:
    """{command} takes over from each other motion, in either direction, and turns the shaft the other way."""
    motion.ready_to_move(probe, subdivision=SUBDIVISION)
    _begin_way(probe, command, 1)
    sense = _direction(probe)
    motion.stand_still(probe)
    if not sense:
        raise Inconclusive(f"{command.name} does not turn the shaft")
    for older in _every_motion(probe.dialect):
        for way in (1, -1) if older.name != command.name else ():
            for _ in range(_TRIES):
                since = len(probe.traffic)
                exchange, before, after = _turned_over(probe, older, command, way, sense)
                if after == -before or not damaged(probe, since):
                    break
                # A request was lost, or a motion came to its end while a reply was waited for that the line damaged.
                motion.stand_still(probe)
            else:
                # What is not answered again and again is the drive's.
                if not exchange.unanswered:
                    raise Inconclusive(f"the line damages replies while {command.name} takes over from {older.name}")
            taken = not motion.refused(probe, exchange)
            if after != -before:
                motion.stop(probe)
            probe.expect(
                "a refusal" if not taken else "the way of before" if after == before else "another way or none",
                holds=taken and after == -before,
                expected="the other way",
                refutes=f"{command.name} does not take over from {older.name}",
                exchange=exchange,
                key=f"{command.name} does not take over from another motion",
            )
    motion.stand_still(probe)


# --- what is told of a shaft under way ----------------------------------------------------------------------------------

#: How long a shaft turns unread, and how far it has gone then at least (degrees).
_UNREAD_NS, _GONE = 300 * MS, 45.0


def _that_tell_state(dialect: Dialect) -> Iterator[Case]:
    """Yield the motions that are answered with a speed and an encoder value."""
    for case in _over_others(dialect):
        if {"speed", "encoder"} <= command_of(case).reply_forms[0].layout.named.keys():
            yield case


@of_motion(each=_that_tell_state, name="{command}/tells-now", refuted_by="the speed or the encoder value of an older read")
def _tells_now(probe: Probe, command: Command) -> None:
    """{command} is answered with the speed and the encoder value of its moment, not with those that were read last."""
    motion.ready_to_move(probe)
    motion.stand_still(probe)
    old = probe.reply(probe.ask(Verb.READ_STATE_2, quiet_ns=0)).values
    before = motion.position(probe)
    motion.run_at(probe, CALM)
    probe.wait(_UNREAD_NS)
    gone = abs(motion.position(probe).value - before.value)
    exchange = _begin_way(probe, command, 1)
    told = probe.reply(exchange).values
    motion.stand_still(probe)
    if gone < _GONE:
        raise Inconclusive("a run does not turn the shaft")
    text = f"{command.name} is answered with the state of the last read"
    expected = f"a shaft that turns, elsewhere than at {old['encoder']}"
    now = abs(told["speed"]) >= CALM * 6 / 2 and told["encoder"] != old["encoder"]
    got = f"{told['speed']} deg/s, encoder {told['encoder']}"
    probe.expect(got, holds=now, expected=expected, refutes=text, exchange=exchange)
