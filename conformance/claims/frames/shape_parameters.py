"""Shape of what a parameter read answers, parameter by parameter: the reply is of the parameter that was asked for.

    CAN   00 82 -> 82 05           the code of the setting, in the layout that sets it
    LK    C0 0A -> C0 0A 64 00 ..  the number of the parameter, in its own layout

Which parameters a drive can read, and whether what it answers is what was set, is for the theme read-back.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from analyzer.catalogue import Command, Dialect, Doubt, Verb
from analyzer.codec import codec
from conformance.claim import Aspect, Inconclusive, Theme
from conformance.claims.declare import Case, Cases, claim, commands
from conformance.claims.known_quirks import may_meet
from conformance.model.lk_parameters import OTHER_FIRMWARE
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe
from conformance.talk.reply_match import MatchedReply, replies


def _of_parameters(refuted_by: str, each: Cases, **facts: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    return claim(Theme.SHAPE, each=each, refuted_by=refuted_by, aspect=Aspect.SHAPE, **facts)


def _expect(probe: Probe, exchange: Exchange, choice: str, holds: bool, expected: str, got: str) -> None:
    what = "the reply of another parameter or layout"
    probe.expect(got, holds=holds, expected=expected, refutes=f"{choice}: {what}", exchange=exchange, key=what)


def _checked(probe: Probe, exchange: Exchange) -> MatchedReply:
    """Return the reply. Raises Inconclusive where there is none, or its checks do not fit."""
    reading = replies(exchange, probe.dialect).first
    if reading is None or not all(check.ok for check in reading.checks):
        raise Inconclusive(f"the answer to {dict(exchange.values)} cannot be read")
    return reading


def _listed(dialect: Dialect) -> Iterator[Case]:
    """Yield each parameter that the read lists and the drive has."""
    for case in commands(Verb.READ_PARAMETER)(dialect):
        command = case.command
        assert command is not None
        for name, field in command.request_forms[0].layout.named.items():
            for value, choice in field.choice_names.items():
                # A model that has not got a setting has nothing to tell of it.
                if not command.replies.failed_forms or any(c.readable for c in dialect.by_code.get(value, ())):
                    facts = {"about": (choice,), "parameters": {name: value}}
                    yield Case(dialect, command, {"field": name, "value": value, "choice": choice}, facts)


@_of_parameters(
    "the reply of another parameter, another layout, or a value that the parameter cannot have",
    _listed,
    name="{command}/of/{choice}",
    rests_on=(Doubt.MEANING,),
    quirks=may_meet(OTHER_FIRMWARE),
)
def _in_its_layout(probe: Probe, command: Command, field: str, value: int, choice: str) -> None:
    """{command} of {choice} is answered in the layout of {choice}."""
    exchange = probe.ask(command, {field: value})
    if exchange.silent and probe.claim.quirks:
        probe.meets(OTHER_FIRMWARE)
        return
    reading = _checked(probe, exchange)
    own = reading.own.hex(" ").upper()
    code = reading.part("code")
    if code is not None:
        expected, got = f"the code {code.expected.hex().upper()}", code.got.hex().upper()
        _expect(probe, exchange, choice, code.ok, expected, got)
    form, layout = reading.template.form, codec(reading.template.form.layout)
    matches = layout.matches(reading.own)
    failed = form.name in command.replies.failed_forms and matches
    _expect(probe, exchange, choice, not failed, f"the value of {choice}", f"{own}: it cannot be read")
    expected = f"{form.layout.byte_length} bytes in the layout of {choice}"
    _expect(probe, exchange, choice, matches and reading.length_fits, expected, own)
    seen = layout.wire(reading.own).get(field, value)
    _expect(probe, exchange, choice, seen == value, f"{field} {value}", f"{field} {seen}")
    for violation in layout.broken(reading.own):
        _expect(probe, exchange, choice, False, violation.text, reading.data.hex(" ").upper())


def _unlisted(dialect: Dialect) -> Iterator[Case]:
    """Yield a code that is no parameter, where the manual has an answer to it."""
    for case in commands(Verb.READ_PARAMETER)(dialect):
        assert case.command is not None
        read = dialect.by_verb.get(Verb.READ_POSITION)
        for name, field in case.command.request_forms[0].layout.named.items():
            if case.command.replies.failed_forms and read is not None and read.code not in field.choice_names:
                yield Case(dialect, case.command, {"field": name, "value": read.code}, {"parameters": {name: read.code}})


@_of_parameters("silence, or other bytes", _unlisted, rests_on=(Doubt.REFUSAL,))
def _unreadable(probe: Probe, command: Command, field: str, value: int) -> None:
    """{command} of a code that is no parameter is answered FF FF under that code."""
    exchange, code = probe.ask(command, {field: value}), f"{value:02X}"
    _expect(probe, exchange, code, not exchange.silent, "an answer that it cannot be read", "silence")
    reading = _checked(probe, exchange)
    told = reading.part("code")
    if told is not None:
        _expect(probe, exchange, code, told.ok, f"the code {told.expected.hex().upper()}", told.got.hex().upper())
    form = reading.template.form
    refused = form.name in command.replies.failed_forms and codec(form.layout).matches(reading.own)
    _expect(probe, exchange, code, refused, "FF FF", reading.own.hex(" ").upper())
