"""Looks at a shaft, on its way and at rest, and which rows of a table of motions were carried out before."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from analyzer.catalogue import Command, Risk, Verb
from conformance.claim import Inconclusive, NotRun
from conformance.gate.gate import Refused
from conformance.motion.course import Span
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe


class _Tried(Protocol):
    @property
    def row(self) -> Any: ...


#: The status by which a motion tells its end.
_END = 2
#: How often a read is asked at most that the line damages.
_ASKED = 4

Row = TypeVar("Row")
Tried = TypeVar("Tried", bound=_Tried)


@dataclass(frozen=True)
class Look:
    """One read. `values`: what it told, None where it was not answered, twice. It held at a moment of the span."""

    read: Command
    values: Mapping[str, int] | None
    span: Span
    exchange: Exchange


def place(look: Look) -> int:
    """Return the position of a look, as it was told."""
    assert look.values is not None  # it was told
    return look.values["position"]


def look(probe: Probe, read: Command) -> Look:
    """Ask a read, and once more where it is not answered, and return what it told; more often where the line damages it."""
    exchange = probe.ask(read, quiet_ns=0)
    for asked in range(1, _ASKED):
        if exchange.is_read or (asked > 1 and not exchange.damaged):
            break
        exchange = probe.ask(read, quiet_ns=0)
    answer = exchange.reply
    if answer is None or not exchange.is_read:
        return Look(read, None, (exchange.sent_ns, probe.gate.now_ns()), exchange)
    return Look(read, answer.values, (exchange.sent_ns, max(exchange.sent_ns, answer.first_ns)), exchange)


def on_the_way(probe: Probe, reads: Iterator[Command], every_ns: int, until_ns: int) -> Iterator[Look]:
    """Look at one read after the other, so far apart at least, until a time."""
    while (begun_ns := probe.gate.now_ns()) < until_ns:
        yield look(probe, next(reads))
        probe.wait(min(begun_ns + every_ns, until_ns) - probe.gate.now_ns())


def at_rest(probe: Probe, reads: Sequence[Command]) -> tuple[Look, ...]:
    """Look at a shaft that rests by these reads, at its position first and last."""
    position = probe.command(Verb.READ_POSITION)
    return tuple(look(probe, read) for read in (position, *reads, position))


def damaged(traffic: Sequence[Exchange], told: Collection[int] = (), *, ends: bool = False) -> bool:
    """Say whether the line damaged what was said of the commands of a motion; a look that it damaged was made once more.

    `ends`: the end is told unasked, perhaps while a look is made; `told`: the statuses that came.
    """
    if ends and _END not in told and any(exchange.damaged for exchange in traffic):
        return True
    asked = (e for e in traffic if e.command is None or e.command.all_risks != {Risk.READ})
    return any(exchange.damaged for exchange in asked)


def divided(first_of: Callable[[], tuple[Tried, ...]], rows: Iterable[Row]) -> tuple[tuple[Tried, ...], list[Row]]:
    """Return what the first of some rows showed, and the other ones."""
    try:
        first = first_of()
    except (Inconclusive, NotRun, Refused):
        # It was another motion perhaps.
        first = ()
    known = {tried.row for tried in first}
    return first, [row for row in rows if row not in known]
