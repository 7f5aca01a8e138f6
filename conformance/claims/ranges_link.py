"""Ranges of settings that change the link: every address, speed and dialect that the manual lists is taken, and can be left.

    set_address/new_address/lowest, highest     the drive answers at that address
    set_baud_rate/baud_rate/RATE                the drive answers at that speed
    set_modbus/modbus/listed                    the drive answers in that dialect

Rules kept here:
- The reply to such a setting uses the old setting; one that already uses the new is accepted.
- The claim follows the drive, sees that it answers there and leads it back.
- What is refused stands in `ranges`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from analyzer import dialects as registry
from analyzer import encoder
from analyzer.catalogue import Command, Dialect, Doubt, Risk
from analyzer.errors import UsageError
from analyzer.layout import Effect, Field
from conformance.claim import Aspect, Claim, Inconclusive, NotRun, Refuted, Theme
from conformance.claims.declare import declare
from conformance.claims.known_quirks import known
from conformance.motion.motion import MS
from conformance.talk.acceptance import Acceptance, acceptance, answers, expect_accepted, need_reliable_replies
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe, Until

#: A drive that changes its link gets so long for it.
SETTLE_NS = 200 * MS
NEW_ADDRESS_ANSWERS = "new-address-answers"
#: Head, address and check are no reply yet.
_SHORTEST = 4
_AWAY = 0x5A
_NEEDS: dict[str, Any] = {"risks": {Risk.SETTING, Risk.LINK}, "alone": True}


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about settings of the link."""
    for command, field in dialect.effects(Effect.BAUD_RATE):
        for value, rate in dialect.rates.items():
            yield _speed(dialect, command, field, value, rate)
    for command, field in dialect.effects(Effect.ADDRESS):
        yield _address(dialect, command, field, "lowest", field.low)
        yield _address(dialect, command, field, "highest", field.high)
        yield _address(dialect, command, field, "inside", _AWAY)
    for command, field in dialect.effects(Effect.DIALECT):
        yield _other_dialect(dialect, command, field.name)


# --- addresses --------------------------------------------------------------------------------------------------------


def readdress(probe: Probe, command: Command, address: int, *, at: int | None = None) -> Exchange:
    """Give the drive an address, whichever of the two it answers from; refute where it refuses."""
    built = probe.build(command, {command.sets(Effect.ADDRESS): address}, address=at)
    exchange = probe.ask_built(built)
    if exchange.silent:
        raise Inconclusive(f"{command.name} {address} was not answered")
    from_new = exchange.answers and exchange.answers[0].message.address == address != built.address
    if from_new and NEW_ADDRESS_ANSWERS in probe.claim.quirks:
        probe.meets(NEW_ADDRESS_ANSWERS)
    if acceptance(probe, exchange) is Acceptance.REFUSED:
        raise Refuted(
            f"{command.name}: {address} is refused", expected="success: the manual allows it",
            got=exchange.answers[0].data.hex(" ").upper(), exchange=exchange, key="set_address refused",
        )  # fmt: skip
    probe.wait(SETTLE_NS)
    return exchange


def _address(dialect: Dialect, command: Command, field: Field, what: str, value: int) -> Claim:
    def check(probe: Probe) -> None:
        need_reliable_replies(probe)
        before = probe.address
        if before == value:
            # Away first, so that something changes.
            readdress(probe, command, _AWAY)
            exchange = readdress(probe, command, value, at=_AWAY)
        else:
            exchange = readdress(probe, command, value)
        there, here = answers(probe, value), before != value and answers(probe, before)
        if there and before != value:
            readdress(probe, command, before, at=value)
        if not there or here:
            raise Refuted(
                f"set_address {value}: the drive answers at {before if here else 'neither address'}",
                expected=f"it answers at {value} alone", got=_answers(there, here, value, before), exchange=exchange,
                key="set_address not stored",
            )  # fmt: skip

    statement = f"A drive that is given the address {value} answers there."
    return declare(
        dialect, Theme.RANGES, f"{command.name}/{field.name}/{what}", statement,
        "a refusal, or an answer at the old address", check, command=command,
        aspect=Aspect.RANGE if what == "inside" else Aspect.BOUNDARY, fields=(field.name,), settings=(field.name,),
        rests_on=(Doubt.VALUES,), quirks=known(dialect, NEW_ADDRESS_ANSWERS),
        parameters={"field": field.name, "value": value}, **_NEEDS,
    )  # fmt: skip


def _answers(there: bool, here: bool, value: int, before: int) -> str:
    places = [str(a) for a, yes in ((value, there), (before, here)) if yes]
    return f"it answers at {' and '.join(places)}" if places else "silence at both"


# --- speeds of the line -----------------------------------------------------------------------------------------------


def follow(probe: Probe, rate: int) -> None:
    """Bring this end to a speed. Raises NotRun where that cannot be."""
    try:
        probe.gate.set_speed(rate)
    except UsageError as error:
        raise NotRun(f"this end cannot follow the drive to {rate} bits per second: {error}") from None


def set_speed(probe: Probe, rate: int) -> None:
    """Set the drive to a speed, without following it. Raises Inconclusive where it has no such setting."""
    code = next((v for v, r in probe.dialect.rates.items() if r == rate), None)
    found = probe.dialect.effect(Effect.BAUD_RATE)
    if found is not None and code is not None:
        command, field = found
        probe.ask(command, {field.name: code})
        return
    raise Inconclusive(f"{probe.dialect.name} has no setting for {rate} bits per second")


def _speed(dialect: Dialect, command: Command, field: Field, value: int, rate: int) -> Claim:
    def check(probe: Probe) -> None:
        before = probe.gate.line.endpoint.bits_per_second
        codes = {r: v for v, r in dialect.rates.items()}
        if before not in codes:
            raise Inconclusive(f"the line is at {before} bits per second, which is no setting of the drive")
        need_reliable_replies(probe)
        exchange = probe.ask(command, {field.name: value})
        if not exchange.silent and acceptance(probe, exchange) is Acceptance.REFUSED:
            raise Refuted(
                f"{command.name}: {rate} is refused", expected="success: the manual lists it",
                got=exchange.answers[0].data.hex(" ").upper(), exchange=exchange, key=f"{command.name} refused",
            )  # fmt: skip
        follow(probe, rate)
        try:
            probe.wait(SETTLE_NS)
            there = answers(probe, probe.address)
            if there and rate != before:
                probe.ask(command, {field.name: codes[before]})
        finally:
            follow(probe, before)
        probe.wait(SETTLE_NS)
        if not there:
            raise Refuted(
                f"{command.name} {rate}: the drive does not answer at that speed", expected=f"an answer at {rate}",
                got="silence", exchange=exchange, key=f"{command.name} not stored",
            )  # fmt: skip

    statement = f"A drive that is set to {rate} bits per second answers there."
    return declare(
        dialect, Theme.RANGES, f"{command.name}/{field.name}/{rate}", statement,
        "a refusal, or silence at the new speed", check, command=command, aspect=Aspect.RANGE, fields=(field.name,),
        settings=(field.name,), parameters={"field": field.name, "value": value, "rate": rate}, **_NEEDS,
    )  # fmt: skip


# --- dialects ---------------------------------------------------------------------------------------------------------


def foreign(
    probe: Probe, other: Dialect, what: str, values: dict[str, int] | None = None, *, address: int | None = None
) -> bytes:
    """Send a request in another dialect, and return what came back."""
    item = encoder.build(other, what, probe.address if address is None else address, values)
    exchange = probe.send(item, until=Until.TIMEOUT, timeout_ns=SETTLE_NS)
    pieces = [(a.first_ns, a.data) for a in exchange.answers] + [(j.first_ns or 0, j.data) for j in exchange.junk]
    return b"".join(data for _, data in sorted(pieces))


def _other_dialect(dialect: Dialect, command: Command, field: str) -> Claim:
    other = registry.get(dialect.siblings[0])
    own, new = dialect.chosen_by, other.chosen_by

    def check(probe: Probe) -> None:
        if probe.address > other.addresses[1]:
            raise NotRun(f"a drive at {probe.address} cannot speak {other.name}, whose addresses end at {other.addresses[1]}")
        need_reliable_replies(probe)
        # Real drives were seen to answer frames of the other dialect with fragments: only a whole reply counts.
        before = foreign(probe, other, "read_speed")
        if whole(other, probe.address, before):
            raise Refuted(f"a {dialect.name} drive answers {other.name}", expected="silence", got=before.hex(" ").upper())
        expect_accepted(probe, command, {field: own}, f"{field} {own}, which it has")
        exchange = expect_accepted(probe, command, {field: new}, f"{field} {new}")
        probe.wait(SETTLE_NS)
        answer = foreign(probe, other, "read_speed")
        still = answers(probe, probe.address)
        foreign(probe, other, command.name, {field: own})
        probe.wait(SETTLE_NS)
        back = answers(probe, probe.address)
        readable(other, probe.address, answer)
        if not whole(other, probe.address, answer) or still:
            speaks = f"still speaks {dialect.name}" if still else f"does not speak {other.name}"
            raise Refuted(
                f"{command.name} {new}: the drive {speaks}",
                expected=f"a reply in {other.name}, silence in {dialect.name}",
                got=answer.hex(" ").upper() or f"silence in {other.name}", exchange=exchange, key=f"{command.name} not stored",
            )  # fmt: skip
        if not back:
            raise Refuted(
                f"the drive does not come back to {dialect.name}", expected=f"a reply in {dialect.name}", got="silence",
                exchange=exchange, key=f"{command.name} not left",
            )  # fmt: skip

    return declare(
        dialect, Theme.RANGES, f"{command.name}/{field}/listed",
        f"{command.name} switches between {dialect.name} and {other.name}.",
        "a refusal, or answers in the old dialect", check, command=command, aspect=Aspect.RANGE, fields=(field,),
        settings=(field,), **_NEEDS,
    )  # fmt: skip


def readable(dialect: Dialect, address: int, data: bytes) -> None:
    """Raise Inconclusive for bytes that are neither a reply nor nothing: other claims are about those."""
    if data and not whole(dialect, address, data):
        raise Inconclusive(f"what came in {dialect.name} is no reply: {data.hex(' ').upper()}")


def whole(dialect: Dialect, address: int, data: bytes) -> bool:
    """Say whether data is the reply to a read of the speed in a dialect."""
    return len(data) > _SHORTEST and dialect.link.fits(data) and dialect.link.parse(data).address == address
