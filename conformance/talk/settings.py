"""Settings of the drive under test: which of them change its link, and what it has stored."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analyzer.catalogue import Command, Verb
from analyzer.layout import Effect
from conformance.talk.exchange import Exchange

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

#: Effects on where and how a drive answers.
LINK_EFFECTS = (Effect.ADDRESS, Effect.DIALECT, Effect.BAUD_RATE)


def changes_link(command: Command) -> bool:
    """Say whether a setting changes where or how the drive answers."""
    return any(command.sets(effect) for effect in LINK_EFFECTS)


def to_defaults(probe: Probe, *names: str) -> None:
    """Set fields that a claim rests on to their defaults, where the drive tells that they have other values."""
    for command in probe.dialect.commands:
        fields = command.request_forms[0].layout.named if command.readable else {}
        usual = {n: int(d) for n in names if n in fields and (d := fields[n].default) is not None}
        held = (read_back(probe, command)[0] or {}) if usual else {}
        if any(held.get(n, value) != value for n, value in usual.items()):
            probe.do(command, held | usual)


def read_back(probe: Probe, command: Command) -> tuple[dict[str, int] | None, Exchange]:
    """Read a setting back; return its fields as sent, and the exchange.

    None instead of fields: the drive says that it cannot be read. No fields: it answered by another layout. Raises
    Inconclusive where there is no readable reply.
    """
    exchange = probe.ask(Verb.READ_PARAMETER, {"parameter": command.code}, quiet_ns=0)
    answer = probe.reply(exchange)
    if probe.refused(exchange):
        return None, exchange
    names = command.request_forms[0].layout.named
    return {n: int(v) for n, v in answer.values.items() if n in names}, exchange
