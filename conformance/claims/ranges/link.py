"""Ranges of settings that change the link: the drive can be reached by every listed address, speed and dialect, and led back.

    set_address/new_address/lowest, highest     the drive answers at that address
    set_baud_rate/baud_rate/RATE                the drive answers at that speed
    set_modbus/modbus/listed                    the drive answers in that dialect

Forbidden values stand in `ranges.settings`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from analyzer import dialects as registry
from analyzer.catalogue import Command, Dialect, Doubt, Risk
from analyzer.layout import Effect, Field
from analyzer.link import HeadLink
from conformance.claim import Aspect, NotRun
from conformance.claims.declare import Case
from conformance.claims.known_quirks import may_meet
from conformance.claims.ranges import edges
from conformance.claims.ranges.edges import of_ranges
from conformance.claims.settings.link_changes import (
    NEW_ADDRESS_ANSWERS,
    SETTLE_NS,
    ask_in,
    at_rate,
    change_address,
    expect_not_refused,
    is_reply,
    need_reply_or_silence,
    other_address,
)
from conformance.talk.acceptance import answers, expect_accepted, need_reliable_replies
from conformance.talk.probe import Probe

#: Addresses of one byte.
_BYTE = 0xFF


def _case(dialect: Dialect, command: Command, field: Field, where: str, **given: Any) -> Case:
    found = edges.case(
        dialect,
        command,
        field,
        where,
        (),
        settings=(field.name,),
        risks={Risk.SETTING, Risk.LINK},
        alone=True,
        parameters={"field": field.name, **given} if given else {},
    )
    return Case(dialect, command, {"field": field, **given}, found.facts)


# --- addresses --------------------------------------------------------------------------------------------------------


def _addresses(dialect: Dialect) -> Iterator[Case]:
    for command, field in dialect.effects(Effect.ADDRESS):
        # An address that is the first byte of a frame too tells more than others.
        heads = sorted(dialect.link.first_bytes) if isinstance(dialect.link, HeadLink) else []
        inside = next((head for head in heads if field.allows(head)), other_address(dialect))
        for where, value in (("lowest", field.low), ("highest", field.high), ("inside", inside)):
            yield _case(dialect, command, field, where, value=value)


@of_ranges(
    each=_addresses,
    refuted_by="a refusal, or an answer at the old address",
    rests_on=(Doubt.VALUES,),
    quirks=may_meet(NEW_ADDRESS_ANSWERS),
)
def _address(probe: Probe, command: Command, value: int) -> None:
    """A drive that is given the address {value} answers there."""
    need_reliable_replies(probe)
    before = probe.address
    if before == value:
        # Away first, so that something changes.
        away = other_address(probe.dialect)
        change_address(probe, command, away)
        exchange = change_address(probe, command, value, at=away)
    else:
        exchange = change_address(probe, command, value)
    there, here = answers(probe, value), before != value and answers(probe, before)
    if there and before != value:
        change_address(probe, command, before, at=value)
    places = [str(address) for address, answered in ((value, there), (before, here)) if answered]
    probe.expect(
        f"it answers at {' and '.join(places)}" if places else "silence at both",
        holds=there and not here,
        expected=f"it answers at {value} alone",
        refutes=f"{command.name} {value}: the drive answers at {before if here else 'neither address'}",
        exchange=exchange,
        key=f"{command.name} not stored",
    )


def _every_address(dialect: Dialect) -> Iterator[Case]:
    for command, field in dialect.effects(Effect.ADDRESS):
        case = _case(dialect, command, field, "every")
        yield Case(dialect, command, case.given, {**case.facts, "emulated": True})


@of_ranges(each=_every_address, refuted_by="a refusal, or silence there", rests_on=(Doubt.VALUES,))
def _each_address(probe: Probe, command: Command, field: Field) -> None:
    """A drive that is given any address answers there."""
    need_reliable_replies(probe)
    own = here = probe.address
    every = [value for value in range(max(field.low, 1), min(field.high, _BYTE) + 1) if value != own]
    for value in (*every, own):
        exchange = change_address(probe, command, value, at=here)
        there = answers(probe, value)
        text = f"{command.name}: a drive that is given one address does not answer there"
        shown = f"silence at {value}"
        probe.expect(shown, holds=there, expected=f"an answer at {value}", refutes=text, exchange=exchange)
        here = value


# --- speeds of the line -----------------------------------------------------------------------------------------------


def _rates(dialect: Dialect) -> Iterator[Case]:
    for command, field in dialect.effects(Effect.BAUD_RATE):
        for value, rate in dialect.rates.items():
            yield _case(dialect, command, field, str(rate), value=value, rate=rate)


@of_ranges(each=_rates, refuted_by="a refusal, or silence at the new speed")
def _rate(probe: Probe, command: Command, rate: int) -> None:
    """A drive that is set to {rate} bits per second answers there."""
    need_reliable_replies(probe)
    with at_rate(probe, rate) as exchange:
        if not exchange.silent:
            expect_not_refused(probe, command, rate, exchange)
        there = answers(probe, probe.address)
    probe.expect(
        f"an answer at {rate}" if there else "silence",
        holds=there,
        expected=f"an answer at {rate}",
        refutes=f"{command.name} {rate}: the drive does not answer at that speed",
        exchange=exchange,
        key=f"{command.name} not stored",
    )


# --- dialects ---------------------------------------------------------------------------------------------------------


def _siblings(dialect: Dialect) -> Iterator[Case]:
    for command, field in dialect.effects(Effect.DIALECT):
        found = _case(dialect, command, field, "listed")
        yield Case(dialect, command, {"field": field, "other": dialect.siblings[0]}, found.facts)


@of_ranges(each=_siblings, refuted_by="a refusal, or answers in the old dialect", aspect=Aspect.RANGE)
def _dialect(probe: Probe, command: Command, field: Field, other: str) -> None:
    """{command} switches between {dialect} and {other}."""
    dialect, sibling, address = probe.dialect, registry.get(other), probe.address
    own, new = dialect.chosen_by, sibling.chosen_by
    if address > sibling.addresses[1]:
        raise NotRun(f"a drive at {address} cannot speak {other}, whose addresses end at {sibling.addresses[1]}")
    need_reliable_replies(probe)
    # Real drives were seen to answer frames of the other dialect with fragments: only a whole reply counts.
    before = ask_in(probe, sibling, "read_speed")
    probe.expect(
        before.hex(" ").upper(),
        holds=not is_reply(sibling, address, before),
        expected="silence",
        refutes=f"a {dialect.name} drive answers {other}",
    )
    expect_accepted(probe, command, {field.name: own}, f"{field.name} {own}, which it has")
    exchange = expect_accepted(probe, command, {field.name: new}, f"{field.name} {new}")
    probe.wait(SETTLE_NS)
    answer = ask_in(probe, sibling, "read_speed")
    still = answers(probe, address)
    assert own is not None  # a dialect that can be chosen is chosen by a value
    ask_in(probe, sibling, command.name, {field.name: own})
    probe.wait(SETTLE_NS)
    back = answers(probe, address)
    need_reply_or_silence(sibling, address, answer)
    speaks = f"still speaks {dialect.name}" if still else f"does not speak {other}"
    probe.expect(
        answer.hex(" ").upper() or f"silence in {other}",
        holds=is_reply(sibling, address, answer) and not still,
        expected=f"a reply in {other}, silence in {dialect.name}",
        refutes=f"{command.name} {new}: the drive {speaks}",
        exchange=exchange,
        key=f"{command.name} not stored",
    )
    probe.expect(
        "silence",
        holds=back,
        expected=f"a reply in {dialect.name}",
        refutes=f"the drive does not come back to {dialect.name}",
        exchange=exchange,
        key=f"{command.name} not left",
    )
