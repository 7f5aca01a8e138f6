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


def read_back(probe: Probe, command: Command, quiet_ns: int | None = None) -> tuple[dict[str, int] | None, Exchange]:
    """Read a setting back; return its fields as sent, and the exchange.

    None instead of fields: the drive says that it cannot be read. No fields: it answered by another layout. Raises
    Inconclusive where there is no readable reply.
    """
    exchange = probe.ask(Verb.READ_PARAMETER, {"parameter": command.code}, quiet_ns=quiet_ns)
    answer = probe.reply(exchange)
    if probe.refused(exchange):
        return None, exchange
    names = command.request_forms[0].layout.named
    return {n: int(v) for n, v in answer.values.items() if n in names}, exchange
