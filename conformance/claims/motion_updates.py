"""Newer motion: a command that comes while another one is carried out takes its place.

The manual promises it for moves to a place by the encoder (mode 4: new speeds and new targets on the way). For the other
moves it says nothing: what they do is observed.

Rules kept here:
- What was superseded is not told as complete: the newer command's two replies are all that comes.
- Moves are slow, so that the newer command comes well before the end.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Verb
from conformance.claim import Claim
from conformance.claims.motion_claim import expect_speed, motion_claim, refute
from conformance.motion import motion
from conformance.motion import moves as journey
from conformance.motion.motion import MS, QUICK, SAME, SECOND_NS
from conformance.talk.probe import Probe

#: The older move: two turns at 30 rpm last four seconds; the newer one comes after one.
_TURNS, _RPM, _WHEN_NS = 2.0, 30, SECOND_NS
#: The newer move's speed.
_NEWER_RPM = 60
#: The move that the manual lets be updated.
_UPDATED = Verb.MOVE_ABSOLUTE_AXIS


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about newer motion."""
    for command in journey.moves(dialect):
        sure = Certainty.CERTAIN if command.verb is _UPDATED else Certainty.OPEN
        made = partial(motion_claim, dialect, command, at_best=sure)
        yield made(
            "newer-target",
            f"{command.name} that comes while one is under way takes its place: the shaft ends where the newer one says.",
            "a shaft that ends elsewhere",
            _newer_target,
        )
        yield made(
            "newer-speed",
            f"{command.name} that comes while one is under way gives the shaft its own speed.",
            "a shaft that keeps the older speed",
            _newer_speed,
        )
        if journey.tells(dialect):
            yield made(
                "superseded",
                f"{command.name} that another one supersedes is not told as complete; the newer one is.",
                "a completion of the older one, or none of the newer one",
                _superseded,
            )
    update = dialect.by_verb[_UPDATED]
    yield motion_claim(
        dialect,
        update,
        "update-without-stop",
        "A newer target farther on is taken up without a stop between.",
        "a shaft that slows down or stops first",
        _without_stop,
        at_best=Certainty.LIKELY,
    )
    yield motion_claim(
        dialect,
        update,
        "update-back",
        "A newer target behind the shaft turns it round: it ends there.",
        "a shaft that ends elsewhere",
        _back,
    )
    yield motion_claim(
        dialect,
        update,
        "takes-over-a-run",
        "A move takes over from a run at a speed and ends at its target.",
        "a run that goes on, or another place",
        _after_run,
        at_best=Certainty.LIKELY,
        risks=dialect.by_verb[Verb.RUN_SPEED].all_risks,
    )
    run = dialect.by_verb[Verb.RUN_SPEED]
    yield motion_claim(
        dialect,
        run,
        "takes-over-a-move",
        "A run at a speed takes over from a move and goes on beyond its target.",
        "a shaft that stops at the target of the move",
        _run_after_move,
        at_best=Certainty.LIKELY,
    )
    for command in (run, *journey.moves(dialect)):
        yield motion_claim(
            dialect,
            command,
            "speed-0",
            f"{command.name} with speed 0 stops the shaft, whatever else it says.",
            "a shaft that goes on",
            _speed_0,
            at_best=Certainty.OPEN,
            risks=run.all_risks,
        )


def _under_way(probe: Probe, command: Command) -> float:
    """Begin the older move and let a while pass; return where it began, in degrees."""
    journey.prepare(probe, command)
    start = motion.position(probe)
    journey.begin(probe, command, _TURNS, speed=_RPM, acceleration=QUICK)
    probe.wait(_WHEN_NS)
    return start.value


def _newer_target(probe: Probe, command: Command) -> None:
    start = _under_way(probe, command)
    here = motion.position(probe)
    exchange = journey.begin(probe, command, 0.25, speed=_NEWER_RPM, acceleration=QUICK)
    end = motion.wait_standing(probe)
    # The shaft went on between the look at it and the newer command: at 30 rpm by 180 degrees a second.
    looked_ns = exchange.sent_ns - here.t_ns + here.spread_ns
    slack = _RPM * 6 * looked_ns / 1e9 + 5
    way = 1 if end.value > start else -1
    expected = here.value + way * 90
    if abs(end.value - expected) > slack:
        raise refute(
            exchange,
            f"{command.name}: a newer one does not take the place of the older one",
            expected=f"{expected - start:+.0f} degrees from the start, give or take {slack:.0f}",
            got=f"{end.value - start:+.1f} degrees",
        )


def _newer_speed(probe: Probe, command: Command) -> None:
    _under_way(probe, command)
    exchange = journey.begin(probe, command, _TURNS, speed=_NEWER_RPM, acceleration=QUICK)
    probe.wait(300 * MS)
    seen = motion.speed(probe)
    motion.wait_standing(probe)
    expect_speed(seen, _NEWER_RPM, exchange, f"{command.name}: a newer one does not give the shaft its speed")


def _superseded(probe: Probe, command: Command) -> None:
    _under_way(probe, command)
    before = len(probe.traffic)
    # Two seconds of motion: a reply may be late while the motor turns, and is still the first of the two.
    exchange = journey.begin(probe, command, 0.5, speed=_RPM // 2, acceleration=QUICK)
    # Listened to, not asked: a request could collide with what is told.
    probe.wait(5 * SECOND_NS)
    motion.wait_standing(probe)
    statuses = [a.values[command.replies.status] for a in journey.told(probe.traffic[before:], command)]
    if statuses != [1, 2]:
        raise refute(
            exchange,
            f"{command.name}: what comes after a newer one is not its two replies",
            expected="1, 2",
            got=", ".join(map(str, statuses)) or "none",
        )


def _without_stop(probe: Probe, command: Command) -> None:
    journey.prepare(probe, command)
    journey.begin(probe, command, _TURNS, speed=_NEWER_RPM, acceleration=56)
    probe.wait(SECOND_NS)
    exchange = journey.begin(probe, command, _TURNS, speed=_NEWER_RPM, acceleration=56, quiet_ns=0)
    seen = motion.speed(probe)
    motion.wait_standing(probe)
    if abs(seen.value) < _NEWER_RPM * 0.8:
        raise refute(
            exchange,
            f"{command.name}: a newer target slows the shaft down first",
            expected=f"{_NEWER_RPM} rpm",
            got=f"{seen.value:g} rpm right after the newer command",
        )


def _back(probe: Probe, command: Command) -> None:
    journey.prepare(probe, command)
    start, home = motion.position(probe), journey.place(probe, command)
    journey.begin(probe, command, _TURNS, speed=_RPM, acceleration=QUICK)
    probe.wait(_WHEN_NS)
    values = journey.values_of(command, -1000, _NEWER_RPM, QUICK, home)
    exchange = probe.do(command, values)
    end = motion.wait_standing(probe)
    expected = -1000 * 360 / journey.units_per_turn(command)
    if abs(end.value - start.value - expected) > SAME:
        raise refute(
            exchange,
            f"{command.name}: a newer target behind the shaft is not where it ends",
            expected=f"{expected:+.2f} degrees from the start",
            got=f"{end.value - start.value:+.2f} degrees",
        )


def _after_run(probe: Probe, command: Command) -> None:
    journey.prepare(probe, command)
    start, home = motion.position(probe), journey.place(probe, command)
    motion.run_at(probe, _RPM, QUICK)
    probe.wait(500 * MS)
    exchange = probe.do(command, journey.values_of(command, 3000, _NEWER_RPM, QUICK, home))
    end = motion.wait_standing(probe)
    expected = 3000 * 360 / journey.units_per_turn(command)
    if abs(end.value - start.value - expected) > SAME:
        raise refute(
            exchange,
            f"{command.name} does not take over from a run",
            expected=f"{expected:+.2f} degrees from the start",
            got=f"{end.value - start.value:+.2f} degrees",
        )


def _run_after_move(probe: Probe, command: Command) -> None:
    move = probe.command(_UPDATED)
    journey.prepare(probe, move)
    journey.begin(probe, move, 0.5, speed=_RPM, acceleration=QUICK)
    probe.wait(300 * MS)
    exchange = motion.run_at(probe, _RPM, QUICK)
    probe.wait(3 * SECOND_NS)
    seen = motion.speed(probe)
    motion.stand_still(probe)
    expect_speed(seen, _RPM, exchange, "a run does not take over from a move")


def _speed_0(probe: Probe, command: Command) -> None:
    journey.prepare(probe, command)
    motion.run_at(probe, _NEWER_RPM, QUICK)
    probe.wait(500 * MS)
    if command.verb is Verb.RUN_SPEED:
        # With direction 0 as well it would be the stop of this command.
        exchange = probe.ask(command, {"direction": 1, "speed": 0, "acceleration": QUICK})
    else:
        exchange = journey.ask(probe, command, 0.25, speed=0, acceleration=QUICK)
    probe.wait(SECOND_NS)
    seen = motion.speed(probe)
    motion.stand_still(probe)
    expect_speed(seen, 0, exchange, f"{command.name} with speed 0 does not stop the shaft")
