"""Zero: what 92 makes of the place where the shaft stands.

Rules kept here:
- Zero is zero for everything that counts the encoder: position, carry and value, and the targets of absolute moves.
- Whether 92 makes the count of pulses zero too is not printed: it is observed.
- 92 turns nothing.
"""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.catalogue import Certainty, Command, Dialect, MotionKind, Verb
from conformance.claims.declare import Case, commands, needing
from conformance.claims.motion.motion_claim import expect_stays, of_motion, risks_by
from conformance.motion import arriving, declared, motion
from conformance.motion.declared import CALM, QUICK
from conformance.talk.exchange import Exchange
from conformance.talk.probe import SECOND_NS, Probe

#: What reads 0 after 92: the quantity in words, the read, and its fields.
_ZEROED = {
    "position": (Verb.READ_POSITION, ("position",)),
    "pulses": (Verb.READ_PULSES, ("pulses",)),
    "carry": (Verb.READ_ENCODER_CARRY, ("carry", "encoder")),
}


def _away(probe: Probe, degrees: float = 468) -> None:
    motion.ready_to_move(probe)
    arriving.follow(
        probe, probe.command(Verb.MOVE_RELATIVE_AXIS), degrees, rpm=360 if abs(degrees) < 720 else 900, acceleration=QUICK
    )


#: Zero of a drive that counts turns and what is left of them.
_zeros = needing(Verb.READ_ENCODER_CARRY, commands(Verb.SET_ZERO))


def _surety(of_pulses: bool) -> dict[str, Certainty]:
    return {"at_best": Certainty.OPEN} if of_pulses else {}


def _quantities(dialect: Dialect) -> Iterator[Case]:
    for what in _ZEROED:
        for case in _zeros(dialect):
            yield Case(dialect, case.command, {"what": what}, _surety(what == "pulses"))


def zeroed(probe: Probe, command: Command) -> list[tuple[Exchange, dict[str, Exchange]]]:
    """Give 92 beyond 16 bits of counts, above and below zero, and return what each read tells then."""
    found = []
    for degrees in (468, -2412):
        _away(probe, degrees)
        exchange = probe.do(command)
        reads = {what: verb for what, (verb, _) in _ZEROED.items() if verb in probe.dialect.by_verb}
        found.append((exchange, {what: probe.ask(verb) for what, verb in reads.items()}))
    return found


@of_motion(each=_quantities, name="{command}/{what}", refuted_by="another number")
def _reads_zero(probe: Probe, command: Command, what: str) -> None:
    """After 92 the {what} reads 0."""
    names = _ZEROED[what][1]
    for exchange, told in probe.recorded(zeroed, command):
        values = probe.reply(told[what]).values
        total = sum(values[n] * (probe.dialect.counts_per_turn if n == "carry" else 1) for n in names)
        probe.expect(
            ", ".join(f"{n} {values[n]}" for n in names),
            holds=abs(total) <= probe.within("counts"),
            expected="0",
            refutes="the place where 92 was given is not zero",
            exchange=exchange,
        )


@of_motion(each=_zeros, refuted_by="a shaft that moved, or is not held")
def _stands(probe: Probe, command: Command) -> None:
    """92 turns nothing, and the motor moves as before."""
    _away(probe)
    probe.do(command)
    before = motion.position(probe)
    probe.wait(SECOND_NS // 3)
    exchange = probe.traffic[-1]
    expect_stays(before, motion.position(probe), exchange, "92 turns the shaft")
    move = arriving.follow(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), 90)
    text = "a move after 92 goes another way than was asked"
    probe.expect(abs(move.degrees), near=90, unit="degrees", refutes=text, exchange=move.exchange)


@of_motion(each=_zeros, refuted_by="a position that counts on", risks=risks_by(Verb.RUN_SPEED), at_best=Certainty.LIKELY)
def _while_turning(probe: Probe, command: Command) -> None:
    """92 while the shaft turns makes zero of where it is then; it is answered 1, or refused."""
    _away(probe)
    motion.run_at(probe, CALM, QUICK)
    probe.wait(SECOND_NS // 8)
    exchange = probe.ask(command, quiet_ns=0)
    taken = not motion.refused(probe, exchange)
    seen = motion.position(probe)
    motion.stand_still(probe)
    late_ns = seen.t_ns + seen.spread_ns - exchange.sent_ns
    text = "92 while the shaft turns is answered as done, and the position is not counted from there"
    if taken:
        most = CALM * 6 * late_ns / SECOND_NS + 5
        probe.expect(abs(seen.value), at_most=most, unit="degrees", refutes=text, exchange=exchange)


def _places(dialect: Dialect) -> Iterator[Case]:
    for move in reversed(dialect.motions(MotionKind.MOVE_TO)):
        for case in _zeros(dialect):
            yield Case(dialect, case.command, {"move": move}, _surety(declared.takes_pulses(move)))


@of_motion(each=_places, name="{command}/and-{move}", refuted_by="another place")
def _is_target(probe: Probe, command: Command, move: Command) -> None:
    """After 92 {move} counts from where 92 was given: below it, from there farther and back, and to 0."""
    motion.prepare(probe, move)
    _away(probe)
    zero = motion.wait_standing(probe).value
    probe.do(command)
    shift = zero - motion.position(probe).value
    sense = 1
    for number, degrees in enumerate((-144, -288, -72)):
        values = declared.values_of(probe.dialect, move, degrees, rpm=120, acceleration=QUICK)
        exchange = probe.do(move, values)
        went = motion.wait_standing(probe).value + shift - zero
        # The sense of pulses is not told.
        sense = sense if number else (-1 if went > 0 and declared.takes_pulses(move) else 1)
        text = f"{move.name} to {degrees} degrees goes elsewhere after 92"
        within = 2 * probe.noise.step("degrees")
        probe.expect(went * sense, near=degrees, within=within, unit="degrees", refutes=text, exchange=exchange)
    there = arriving.follow(probe, probe.command(Verb.MOVE_RELATIVE_AXIS), 144)
    exchange = motion.begin(probe, move, rpm=120, acceleration=QUICK, start=0)
    probe.wait(SECOND_NS)
    went = motion.wait_standing(probe).value - there.end.value
    text = f"{move.name} to 0 does not come back to where 92 was given"
    wanted = -(there.end.value + shift - zero)
    probe.expect(went, near=wanted, unit="degrees", refutes=text, exchange=exchange)
