"""Moves: how far each of the four moves goes, which way, how fast, and what it answers.

    FD  relative, in pulses     FE  absolute, in pulses     F4  relative, in counts     F5  absolute, in counts

Rules kept here:
- A turn is 16384 counts, and 200 pulses at each subdivision: 3200 at 16, to which the suite sets the drive.
- Counts have a sign that the manual's examples fix. What the direction bit and the sign of pulses turn is not judged;
  that both values of one command turn opposite ways is.
- Positions are read when the shaft has come to rest; only `told-when-there` reads at once.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Certainty, Command, Dialect, Verb
from conformance.claim import Claim, Inconclusive
from conformance.claims.known_quirks import known
from conformance.claims.motion_claim import expect_speed, expect_stays, motion_claim, refute
from conformance.motion import motion
from conformance.motion import moves as journey
from conformance.motion.motion import MS, QUICK, SAME, SECOND_NS
from conformance.motion.moves import Journey
from conformance.talk.probe import Probe, Until

#: A way that no power of two divides, in turns, and one back that is shorter.
_THERE, _BACK = 0.27, -0.11
#: More units than 16 bits hold, and the subdivision at which so many pulses are less than two turns.
_FAR, _FINE = 70_000, 256
#: How far a shaft may go beyond its target on the way, in degrees.
_OVERSHOOT = 2.0
#: How far a shaft that is settling was seen to be from its target, in degrees, and a little more.
_SETTLING = 32 * 360 / 16384
_STATUSES = (1, 2)


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about the moves of a dialect."""
    for command in journey.moves(dialect):
        yield from _about(dialect, command)


def _about(dialect: Dialect, command: Command) -> Iterator[Claim]:
    made = partial(motion_claim, dialect, command)
    name = command.name
    unit = "pulses" if journey.by_pulses(command) else "counts"
    where = "to a place" if journey.is_absolute(command) else "by a distance"
    yield made(
        "distance",
        f"{name} moves the shaft {where} in {unit}: 16384 counts, or 3200 pulses at 16 subdivisions, are a turn.",
        "a shaft that went farther or less far",
        _distance,
    )
    signed = "direction" not in command.request_forms[0].layout.named
    both = "a greater and a smaller position" if signed else "direction 0 and direction 1"
    yield made("opposite", f"{name} turns the shaft opposite ways for {both}.", "the same way twice", _opposite)
    yield made(
        "far",
        f"{name} takes all bits of its {unit}: {_FAR} of them, either way, are {_FAR}.",
        "a shaft that went as far as fewer bits say",
        _far,
    )
    yield made("speed", f"{name} turns the shaft at the speed that is asked for.", "another speed on the way", _speed)
    yield made(
        "within",
        f"{name} slows the shaft down by its ramp, so that it does not go beyond the target.",
        f"a shaft more than {_OVERSHOOT:g} degrees beyond the target on the way",
        _within,
        at_best=Certainty.LIKELY,
    )
    yield made(
        "again",
        f"{name} can be asked for again and again: the ways add up and nothing is lost.",
        "several short moves that are not one long one",
        _again,
    )
    if not journey.by_pulses(command):
        yield made(
            "sign",
            f"{name}: a greater position raises what read_position reads, by so many counts.",
            "an encoder value that falls, or does not come to what was asked",
            _sign,
        )
    if journey.is_absolute(command):
        yield made(
            "same-place", f"{name} to where the shaft stands turns nothing.", "a shaft that turned, or a refusal", _same_place
        )
        yield made(
            "reads-as-asked",
            f"After {name} the drive reads the {unit} that were asked for, above and below zero.",
            "another number",
            _reads_as_asked,
        )
    if journey.tells(dialect):
        yield made(
            "replies",
            f"{name} is answered twice: status 1 when it begins, status 2 when it is done.",
            "other statuses, another order, more or fewer replies",
            _replies,
        )
        yield made(
            "told-when-there",
            f"When {name} says that it is complete, the shaft is at its target.",
            "a shaft that is elsewhere when status 2 comes",
            _told_when_there,
            quirks=known(dialect, "settling"),
        )


# --- where a move ends ------------------------------------------------------------------------------------------------


def _degrees(command: Command, amount: int, subdivision: int = journey.SUBDIVISION) -> float:
    return amount * 360 / journey.units_per_turn(command, subdivision)


def _amount(command: Command, turns: float) -> int:
    return round(turns * journey.units_per_turn(command))


def _there_and_back(command: Command) -> tuple[int, int]:
    return _amount(command, _THERE), _amount(command, _BACK)


def _expect_way(trip: Journey, degrees: float, what: str) -> None:
    """Refute unless a journey went so many degrees, whichever way."""
    if abs(abs(trip.degrees) - abs(degrees)) > SAME:
        raise refute(
            trip.exchange,
            f"{trip.command.name}: {what}",
            expected=f"{abs(degrees):.2f} degrees",
            got=f"{abs(trip.degrees):.2f} degrees",
            key=f"{trip.command.name} distance",
        )


def _distance(probe: Probe, command: Command) -> None:
    amounts = _there_and_back(command)
    for trip, amount in zip(journey.pair(probe, command, *amounts), amounts, strict=True):
        _expect_way(trip, _degrees(command, amount), "another distance than was asked for")


def _opposite(probe: Probe, command: Command) -> None:
    there, back = journey.pair(probe, command, *_there_and_back(command))
    if there.degrees * back.degrees >= 0 or min(abs(there.degrees), abs(back.degrees)) <= SAME:
        raise refute(
            back.exchange,
            f"{command.name} does not turn two ways",
            expected="two ways",
            got=f"{there.degrees:+.2f} and {back.degrees:+.2f} degrees",
        )


def _sign(probe: Probe, command: Command) -> None:
    amounts = _there_and_back(command)
    for trip, amount in zip(journey.pair(probe, command, *amounts), amounts, strict=True):
        expected = _degrees(command, amount)
        if abs(trip.degrees - expected) > SAME:
            raise refute(
                trip.exchange,
                f"{command.name}: the position does not change by what was asked",
                expected=f"{expected:+.2f} degrees",
                got=f"{trip.degrees:+.2f} degrees",
            )


def _far(probe: Probe, command: Command) -> None:
    fine = journey.by_pulses(command)
    motion.ready_to_move(probe, subdivision=_finest(probe) if fine else None)
    subdivision = _FINE if fine else journey.SUBDIVISION
    # At 256 subdivisions the shaft turns at a sixteenth of the speed that is sent.
    speed = 3000 if fine else 300
    for amount in (_FAR, -_FAR):
        trip = journey.travel(probe, command, amount=amount, speed=speed, acceleration=QUICK, subdivision=subdivision)
        _expect_way(trip, _degrees(command, amount, subdivision), f"{amount} were asked for")


def _finest(probe: Probe) -> int:
    """Return how the finest subdivision is sent: as itself where the field holds it, else as 0."""
    field = probe.command(Verb.SET_SUBDIVISION).request_forms[0].layout.named["subdivision"]
    return _FINE if field.wire_maximum >= _FINE else 0


def _again(probe: Probe, command: Command) -> None:
    journey.prepare(probe, command)
    step, times = _amount(command, 0.031) | 1, 5
    trips = [journey.travel(probe, command, amount=step, acceleration=QUICK) for _ in range(times)]
    whole = trips[-1].end.value - trips[0].start.value
    expected = _degrees(command, times * step)
    if abs(abs(whole) - abs(expected)) > SAME:
        raise refute(
            trips[-1].exchange,
            f"{command.name}: {times} moves do not add up",
            expected=f"{expected:.2f} degrees",
            got=f"{abs(whole):.2f} degrees",
        )


def _same_place(probe: Probe, command: Command) -> None:
    journey.prepare(probe, command)
    journey.travel(probe, command, _THERE)
    start = motion.position(probe)
    exchange = journey.ask(probe, command, amount=0, until=Until.DONE if journey.tells(probe.dialect) else Until.REPLY)
    if journey.refused(probe, exchange):
        text = f"{command.name} to the same place is refused"
        raise refute(exchange, text, expected="no refusal", got="a refusal")
    probe.wait(SECOND_NS)
    expect_stays(start, motion.wait_standing(probe), exchange, f"{command.name} to the same place turns the shaft")


def _reads_as_asked(probe: Probe, command: Command) -> None:
    journey.prepare(probe, command)
    for turns in (0.3, -0.6):
        amount = _amount(command, turns)
        target = journey.place(probe, command) + amount
        trip = journey.travel(probe, command, amount=amount)
        read = journey.place(probe, command)
        if abs(read - target) > 2:
            text = f"{command.name}: the drive reads another place than was asked for"
            raise refute(trip.exchange, text, expected=str(target), got=str(read))


# --- on the way -------------------------------------------------------------------------------------------------------


def _speed(probe: Probe, command: Command) -> None:
    journey.prepare(probe, command)
    # 300 rpm does not fit a byte; two turns at it take half a second, of which the ramps take 0.18 s.
    for asked, turns, look_ns in ((60, 1.0, 300 * MS), (300, 2.0, 150 * MS)):
        exchange = journey.begin(probe, command, turns, speed=asked, acceleration=QUICK, quiet_ns=0)
        probe.wait(exchange.sent_ns + look_ns - probe.gate.now_ns())
        seen = motion.speed(probe)
        motion.wait_standing(probe)
        expect_speed(seen, asked, exchange, f"{command.name} does not turn at the speed that was asked for")


def _within(probe: Probe, command: Command) -> None:
    journey.prepare(probe, command)
    start = motion.position(probe)
    exchange = journey.begin(probe, command, 1.0, speed=300, acceleration=236, quiet_ns=0)
    seen = motion.sampled(probe, 1000 * MS, 40 * MS)
    end = motion.wait_standing(probe)
    way = 1 if end.value > start.value else -1
    beyond = max((s.value - end.value) * way for s in seen)
    if beyond > _OVERSHOOT:
        raise refute(
            exchange,
            f"{command.name} goes beyond its target and comes back",
            expected=f"at most {_OVERSHOOT:g} degrees beyond",
            got=f"{beyond:.1f} degrees beyond",
        )


# --- replies ----------------------------------------------------------------------------------------------------------


def _replies(probe: Probe, command: Command) -> None:
    journey.prepare(probe, command)
    trip = journey.travel(probe, command, _THERE)
    probe.wait(SECOND_NS)
    statuses = tuple(a.values[command.replies.status] for a in journey.told(probe.traffic, command))
    if statuses != _STATUSES:
        got = ", ".join(map(str, statuses)) or "none"
        raise refute(
            trip.exchange,
            f"{command.name}: other replies than 1 and then 2",
            expected="1, 2",
            got=got,
            key=f"{command.name} {got}",
        )


def _told_when_there(probe: Probe, command: Command) -> None:
    journey.prepare(probe, command)
    exchange = journey.ask(probe, command, _THERE, until=Until.DONE, quiet_ns=0)
    probe.reply(exchange)
    if exchange.status(command.replies.status)[-1:] != [2]:
        raise Inconclusive(f"{command.name} did not say that it was complete")
    at_once = motion.position(probe)
    off = abs(motion.wait_standing(probe).value - at_once.value)
    if off > SAME and off <= _SETTLING and "settling" in probe.claim.quirks:
        probe.meets("settling")
    elif off > SAME:
        raise refute(
            exchange,
            f"{command.name} is told as complete before the shaft is there",
            expected=f"within {SAME:.2f} degrees of where it comes to rest",
            got=f"{off:.2f} degrees away",
        )
