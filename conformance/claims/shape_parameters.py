"""Shape of what a parameter read answers, parameter by parameter: the reply is of the parameter that was asked for.

    CAN   00 82 -> 82 05           the code of the setting, in the layout that sets it
    LK    C0 0A -> C0 0A 64 00 ..  the number of the parameter, in its own layout

Which parameters a drive can read, and whether what it answers is what was set, is for the theme read-back.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from analyzer.catalogue import Command, Dialect, Doubt, Verb
from analyzer.codec import codec
from conformance.claim import Aspect, Claim, Inconclusive, Refuted, Theme
from conformance.claims.declare import declare
from conformance.claims.known_quirks import known
from conformance.talk.exchange import Exchange
from conformance.talk.reply_match import MatchedReply, replies

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

OTHER_FIRMWARE = "lk-firmware-235"


def parameters(dialect: Dialect) -> Iterator[Claim]:
    """Make a claim for each parameter that a dialect's parameter read lists."""
    command = dialect.by_verb.get(Verb.READ_PARAMETER)
    if command is None:
        return
    for name, field in command.request_forms[0].layout.named.items():
        for value, choice in field.choice_names.items():
            # A model that has not got a setting has nothing to tell of it.
            if not command.replies.failed_forms or any(c.readable for c in dialect.by_code.get(value, ())):
                yield _listed(dialect, command, name, value, choice)
        strange = _not_listed(dialect, command, set(field.choice_names))
        if strange is not None:
            yield _unreadable(dialect, command, name, strange)


def _listed(dialect: Dialect, command: Command, name: str, value: int, choice: str) -> Claim:
    quirks = known(dialect, OTHER_FIRMWARE)

    def check(probe: Probe) -> None:
        exchange = probe.ask(command, {name: value})
        if exchange.silent and quirks:
            probe.meets(OTHER_FIRMWARE)
            return
        reading = _whole(probe, exchange)
        code = reading.part("code")
        if code is not None and not code.ok:
            raise _refuted(exchange, choice, f"the code {code.expected.hex().upper()}", f"{code.got.hex().upper()}")
        form = reading.template.form
        if form.name in command.replies.failed_forms and codec(form.layout).matches(reading.own):
            raise _refuted(exchange, choice, f"the value of {choice}", f"{reading.own.hex(' ').upper()}: it cannot be read")
        if not codec(form.layout).matches(reading.own) or not reading.length_fits:
            size = form.layout.byte_length
            raise _refuted(exchange, choice, f"{size} bytes in the layout of {choice}", reading.own.hex(" ").upper())
        got = codec(form.layout).wire(reading.own)
        if name in got and got[name] != value:
            raise _refuted(exchange, choice, f"{name} {value}", f"{name} {got[name]}")
        broken = codec(form.layout).broken(reading.own)
        if broken:
            raise _refuted(exchange, choice, broken[0].text, reading.data.hex(" ").upper())

    return declare(
        dialect,
        Theme.SHAPE,
        f"{command.name}/of/{choice}",
        f"{command.name} of {choice} is answered in the layout of {choice}.",
        "the reply of another parameter, another layout, or a value that the parameter cannot have",
        check,
        command=command,
        aspect=Aspect.SHAPE,
        rests_on=(Doubt.MEANING,),
        about=(choice,),
        quirks=quirks,
        parameters={name: value},
    )


def _not_listed(dialect: Dialect, command: Command, listed: set[int]) -> int | None:
    """Return a code that is no parameter and that the manual has an answer to, None where it has none."""
    if not command.replies.failed_forms:
        return None
    reads = dialect.by_verb.get(Verb.READ_POSITION)
    return reads.code if reads is not None and reads.code not in listed else None


def _unreadable(dialect: Dialect, command: Command, name: str, value: int) -> Claim:
    failed = command.replies.failed_forms

    def check(probe: Probe) -> None:
        exchange = probe.ask(command, {name: value})
        if exchange.silent:
            raise _refuted(exchange, f"{value:02X}", "an answer that it cannot be read", "silence")
        reading = _whole(probe, exchange)
        form = reading.template.form
        if form.name not in failed or not codec(form.layout).matches(reading.own):
            raise _refuted(exchange, f"{value:02X}", "FF FF", reading.own.hex(" ").upper())

    return declare(
        dialect,
        Theme.SHAPE,
        f"{command.name}/unreadable",
        f"{command.name} of a code that is no parameter is answered FF FF under that code.",
        "silence, or other bytes",
        check,
        command=command,
        aspect=Aspect.SHAPE,
        rests_on=(Doubt.REFUSAL,),
        parameters={name: value},
    )


def _whole(probe: Probe, exchange: Exchange) -> MatchedReply:
    """Return the reply. Raises Inconclusive where there is none, or its checks do not fit."""
    reading = replies(exchange, probe.dialect).first
    if reading is None or not all(check.ok for check in reading.checks):
        raise Inconclusive(f"the answer to {dict(exchange.values)} cannot be read")
    return reading


def _refuted(exchange: Exchange, choice: str, expected: str, got: str) -> Refuted:
    what = "the reply of another parameter or layout"
    return Refuted(f"{choice}: {what}", expected=expected, got=got, exchange=exchange, key=what)
