"""Settings of the link that are sent to several drives: the drive that hears them has another address or speed then.

    FA 00 8B 5A ..    every drive has the address 5A
    FA 50 8A 05 ..    every drive of the group 50h speaks at 57600 baud

Rules kept here:
- The drive is led back by itself, at its new address or speed.
- Nothing else may hear these: every drive of the wire would have one address.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial

from analyzer.catalogue import Command, Dialect
from analyzer.layout import Effect, Field
from conformance.claims.addressing.ways import Many, addressing, ways
from conformance.claims.control_reads import expect_silence
from conformance.claims.declare import Case, Cases
from conformance.claims.settings.link_changes import another_rate, at_rate, change_address, other_address, settle
from conformance.motion import declared
from conformance.talk.acceptance import answers, need_reliable_replies
from conformance.talk.exchange import Exchange
from conformance.talk.probe import MS, Probe

#: How long such a setting is listened to.
_SILENT_NS = 20 * MS


def _by_ways(effect: Effect) -> Cases:
    """Return cases of a setting of the link, one for each way to several drives."""

    def cases(dialect: Dialect) -> Iterator[Case]:
        for many in ways(dialect) if declared.can_move(dialect) else ():
            for command, field in dialect.effects(effect):
                risks = {*command.all_risks, *many.risks(dialect)}
                facts = {"risks": risks, "settings": (field.name, *many.settings)}
                yield Case(dialect, command, {"many": many, "what": many.what, "field": field}, facts)

    return cases


def _send(many: Many, probe: Probe, command: Command, values: Mapping[str, int]) -> Exchange:
    to = many.join(probe)
    return probe.send(many.frame(probe, command, values, to), timeout_ns=_SILENT_NS)


@addressing("an answer at the old address, or to what was sent", _by_ways(Effect.ADDRESS), name="{many}/{command}")
def _address(probe: Probe, many: Many, command: Command, field: Field) -> None:
    """An address that {command} gives by {what} is the drive's, and that is not answered."""
    need_reliable_replies(probe)
    before, away = probe.address, other_address(probe.dialect)
    sent = _send(many, probe, command, {field.name: away})
    settle(probe, away)
    there, here = answers(probe, away), answers(probe, before)
    if there:
        change_address(probe, command, before, at=away)
    places = [str(address) for address, answered in ((away, there), (before, here)) if answered]
    text = f"{command.name} by {many.what} does not give the drive that address alone"
    shown = f"an answer at {' and '.join(places) or 'neither'}"
    probe.expect(shown, holds=there and not here, expected=f"an answer at {away} alone", refutes=text, exchange=sent)
    expect_silence(probe, sent, f"{command.name} by {many.what} is answered")


@addressing("silence at the new speed, or an answer to what was sent", _by_ways(Effect.BAUD_RATE), name="{many}/{command}")
def _rate(probe: Probe, many: Many, command: Command) -> None:
    """A speed that {command} sets by {what} is the drive's, and that is not answered."""
    need_reliable_replies(probe)
    other = another_rate(probe)
    with at_rate(probe, other, partial(_send, many)) as sent:
        there = answers(probe, probe.address)
    text = f"{command.name} by {many.what} does not set the speed of the drive"
    probe.expect("silence", holds=there, expected=f"an answer at {other} bits per second", refutes=text, exchange=sent)
    expect_silence(probe, sent, f"{command.name} by {many.what} is answered")
