"""Zero: what 92 makes of the place where the shaft stands.

Rules kept here:
- Zero is zero for everything that counts: position, carry and value, pulses, and the targets of absolute moves.
- 92 turns nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from analyzer.catalogue import Command, Dialect, Verb
from analyzer.protocols.mks_shared import COUNTS_PER_TURN
from conformance.claim import Claim
from conformance.claims.motion_claim import expect_stays, motion_claim, refute
from conformance.motion import motion, moves
from conformance.motion.motion import QUICK, SECOND_NS
from conformance.talk.probe import Probe

_JITTER = 3
#: What reads 0 after 92: the read, in words, and its fields.
_ZEROED = (
    (Verb.READ_POSITION, "position", ("position",)),
    (Verb.READ_PULSES, "pulses", ("pulses",)),
    (Verb.READ_ENCODER_CARRY, "carry", ("carry", "encoder")),
)


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about zero."""
    zero = dialect.by_verb[Verb.SET_ZERO]
    made = partial(motion_claim, dialect, zero)
    for verb, what, names in _ZEROED:
        yield made(what, f"After 92 the {what} reads 0.", "another number", partial(_zero, verb, names))
    yield made("stands", "92 turns nothing, and the motor moves as before.", "a shaft that moved, or is not held", _zero_stands)
    for verb in (Verb.MOVE_ABSOLUTE_AXIS, Verb.MOVE_ABSOLUTE_PULSES):
        yield made(
            f"and-{verb.value}",
            f"After 92 {verb.value} to 0 comes back to where 92 was given.",
            "another place",
            partial(_zero_is_target, verb),
        )


def _away(probe: Probe) -> None:
    motion.ready_to_move(probe)
    moves.travel(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), 1.3, speed=180, acceleration=QUICK)


def _zero(verb: Verb, names: tuple[str, ...], probe: Probe, command: Command) -> None:
    _away(probe)
    exchange = probe.do(command)
    values = probe.reply(probe.ask(verb)).values
    carry = values.get("carry", 0) * COUNTS_PER_TURN
    total = carry + sum(values[n] for n in names if n != "carry")
    if abs(total) > _JITTER:
        got = ", ".join(f"{n} {values[n]}" for n in names)
        raise refute(exchange, "the place where 92 was given is not zero", expected="0", got=got)


def _zero_stands(probe: Probe, command: Command) -> None:
    _away(probe)
    probe.do(command)
    before = motion.position(probe)
    probe.wait(SECOND_NS)
    exchange = probe.traffic[-1]
    expect_stays(before, motion.position(probe), exchange, "92 turns the shaft")
    trip = moves.travel(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), 0.25)
    if abs(abs(trip.degrees) - 90) > motion.SAME:
        text = "a move after 92 goes another way than was asked"
        raise refute(trip.exchange, text, expected="90 degrees", got=f"{trip.degrees:+.2f} degrees")


def _zero_is_target(verb: Verb, probe: Probe, command: Command) -> None:
    move = probe.command(verb)
    moves.prepare(probe, move)
    _away(probe)
    probe.do(command)
    there = moves.travel(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), 0.4)
    exchange = probe.do(move, moves.values_of(move, 0, 120, QUICK))
    probe.wait(SECOND_NS)
    end = motion.wait_standing(probe)
    went = end.value - there.end.value
    if abs(went + there.degrees) > motion.SAME:
        text = f"{verb.value} to 0 does not come back to where 92 was given"
        raise refute(exchange, text, expected=f"{-there.degrees:+.2f} degrees", got=f"{went:+.2f} degrees")
