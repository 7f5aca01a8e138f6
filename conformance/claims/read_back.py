"""Read-back: what is set is what is read, stored in its own place, and kept or lost as the manual says.

    read       what is set is what the parameter read answers              (CAN 00, LK C0)
    others     setting one changes no other
    effect     where nothing can be read: what the drive does is what was set
    restart    41 keeps what is stored                                     restore    3F puts the defaults back
    power      cutting the power is a restart

This module has what can be read by a parameter read; effects stand in `read_back_effects`, restart in `read_back_restart`,
restore in `read_back_restore`, LK in `read_back_lk`.

Rules kept here:
- Which settings of a CAN drive can be read is open (the manual names two): one that cannot be read is observed. One that
  can be read must read as it was set.
- Values are such that swapped bytes, a neighbour's place and a missing byte show.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from analyzer import layout
from analyzer.catalogue import Command, Dialect, Doubt, Verb
from conformance.claim import Aspect, Claim, Inconclusive, Observed, Refuted, Theme
from conformance.claims import effects, ranges, read_back_effects, read_back_lk, read_back_restart, read_back_restore
from conformance.claims.declare import declare
from conformance.claims.effects import LINK_FIELDS
from conformance.claims.requests import needing_plain_replies
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims of this theme for a dialect."""
    return map(needing_plain_replies, _claims(dialect))


def _claims(dialect: Dialect) -> Iterator[Claim]:
    for command in dialect.commands:
        if command.readable:
            yield _link(dialect, command) if is_link(command) else _read(dialect, command)
            if not is_link(command):
                yield _others(dialect, command)
        if command.verb is Verb.WRITE_USER_ID:
            yield _user_id(dialect, command)
    yield from read_back_effects.claims(dialect)
    yield from read_back_restart.claims(dialect)
    yield from read_back_restore.claims(dialect)
    yield from read_back_lk.claims(dialect)


def is_link(command: Command) -> bool:
    """Say whether a setting is one of where and how the drive answers."""
    return bool(set(command.request_forms[0].layout.named) & LINK_FIELDS)


def stored(probe: Probe, command: Command) -> tuple[dict[str, int], Exchange]:
    """Return the stored values of a setting and the exchange that read them.

    Raises Observed where it cannot be read, Inconclusive where it is not answered or by another layout.
    """
    exchange = probe.ask(Verb.READ_PARAMETER, {"parameter": command.code})
    answer = probe.reply(exchange)
    if probe.refused(exchange):
        raise Observed(f"{command.name} cannot be read: {answer.data.hex(' ').upper()}")
    names = command.request_forms[0].layout.named.keys()
    values = {n: int(v) for n, v in answer.values.items() if n in names}
    if not values:
        raise Inconclusive(f"the read of {command.name} was answered {answer.data.hex(' ').upper()}")
    return values, exchange


def compare(command: Command, wanted: Mapping[str, Any], got: Mapping[str, int], exchange: Exchange | None, when: str) -> None:
    """Refute where values differ. `when`: after what they were read."""
    wrong = {n: v for n, v in got.items() if n in wanted and wanted[n] != v}
    if wrong:
        shown = ", ".join(f"{n} {v}" for n, v in wrong.items())
        expected = ", ".join(f"{n} {wanted[n]}" for n in wrong)
        raise Refuted(
            f"{command.name} {when}: {shown}, expected {expected}", expected=expected, got=shown, exchange=exchange,
            key=f"{command.name} {when}",
        )  # fmt: skip


def needs(dialect: Dialect, command: Command) -> dict[str, Any]:
    """Return what a claim must declare that sets a setting to telling values."""
    form = command.request_forms[0]
    return ranges.needs(dialect, command, effects.differing(form))


# --- one setting ------------------------------------------------------------------------------------------------------


def _read(dialect: Dialect, command: Command) -> Claim:
    form = command.request_forms[0]

    def check(probe: Probe) -> None:
        ranges.prepare(probe, command)
        for values in effects.differing(form):
            probe.do(command, values)
            got, exchange = stored(probe, command)
            compare(command, values, got, exchange, "is read as")

    return declare(
        dialect, Theme.READ_BACK, f"{command.name}/read", f"What {command.name} sets is what is read.", "another value", check,
        command=command, aspect=Aspect.STATE, rests_on=(Doubt.LAYOUT,),
        fields=tuple(form.layout.named), **needs(dialect, command),
    )  # fmt: skip


def _others(dialect: Dialect, command: Command) -> Claim:
    form = command.request_forms[0]
    own = set(form.layout.named)
    others = [c for c in dialect.commands if c.readable and c.name != command.name]

    def readable(probe: Probe) -> dict[str, dict[str, int]]:
        found = {}
        for other in others:
            exchange = probe.ask(Verb.READ_PARAMETER, {"parameter": other.code})
            answer = probe.reply(exchange)
            if not probe.refused(exchange):
                # A field that both have is one setting: 93 and 94 of the CAN drives.
                found[other.name] = {n: int(v) for n, v in answer.values.items() if n not in own}
        return found

    def check(probe: Probe) -> None:
        ranges.prepare(probe, command)
        before = readable(probe)
        for values in effects.differing(form):
            exchange = probe.do(command, values)
            after = readable(probe)
            for name, was in before.items():
                if after.get(name) != was:
                    raise Refuted(
                        f"{command.name} changes {name}", expected=f"{name}: {was} as before", got=str(after.get(name)),
                        exchange=exchange, key=f"{command.name} changes {name}",
                    )  # fmt: skip

    return declare(
        dialect, Theme.READ_BACK, f"{command.name}/others", f"{command.name} changes no other setting.",
        "another setting that reads differently", check, command=command, aspect=Aspect.STATE, **needs(dialect, command),
    )  # fmt: skip


def _link(dialect: Dialect, command: Command) -> Claim:
    """Make the claim that a setting of the link reads as the link is."""
    name = next(iter(set(command.request_forms[0].layout.named) & LINK_FIELDS))

    def check(probe: Probe) -> None:
        wanted = probe.address
        if name == command.sets(layout.Effect.BAUD_RATE):
            rate = probe.gate.line.endpoint.bits_per_second
            wanted = next((v for v, r in probe.dialect.rates.items() if r == rate), -1)
        got, exchange = stored(probe, command)
        compare(command, {name: wanted}, got, exchange, "is read as")

    return declare(
        dialect, Theme.READ_BACK, f"{command.name}/read", f"{name} reads as the drive is reached.", "another value", check,
        command=command, aspect=Aspect.STATE, fields=(name,),
    )  # fmt: skip


def _user_id(dialect: Dialect, command: Command) -> Claim:
    field = next(iter(command.request_forms[0].layout.named.values()))

    def check(probe: Probe) -> None:
        for value in (0x01020304, field.high, 0x80000000, field.low):
            exchange = probe.do(command, {field.name: value})
            got = probe.read(Verb.READ_USER_ID)
            compare(command, {field.name: value}, {field.name: got}, exchange, "is read as")

    return declare(
        dialect, Theme.READ_BACK, f"{command.name}/read", "The user's number reads as it was written.", "another number", check,
        command=command, aspect=Aspect.STATE, fields=(field.name,), settings=(field.name,), risks=command.all_risks,
    )  # fmt: skip
