"""Looking at an LK motor for a moment: whether it obeyed a command, without letting it run.

Rules kept here:
- A motion that is to show that it was obeyed is looked at for a moment and stopped.
- Moves that have a `max_speed` are given 60 rpm.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from analyzer.catalogue import Command, Dialect, Risk
from analyzer.layout import Field
from conformance.claim import Aspect, Claim, Refuted, Theme
from conformance.claims.declare import declare
from conformance.motion import motion
from conformance.motion.motion import MS
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Probe

#: 60 rpm as sent, and 116 rpm, which needs more than 16 bits.
MODERATE, WIDE = 36_000, 70_000
#: How long a motion is looked at.
LOOK_NS = 60 * MS
#: Degrees in which a shaft counts as one that stayed, and in which two angles are one.
STILL, SAME = 1.0, 0.3
#: A shaft that went less than this (deg) did not obey.
LEAST = 0.05


def moderate(command: Command, **values: int) -> dict[str, int]:
    """Return values of a move with a moderate speed where it takes one."""
    has_limit = "max_speed" in command.request_forms[0].layout.named
    return ({"max_speed": MODERATE} if has_limit else {}) | values


def begun(probe: Probe, command: Command, values: dict[str, int]) -> tuple[float, Exchange]:
    """Ask for a motion of a shaft that stands, look for a moment, and stop; return how far it went (deg).

    Raises Inconclusive where it is not answered.
    """
    start = motion.position(probe)
    exchange = probe.ask(command, values)
    probe.reply(exchange)
    probe.wait(LOOK_NS)
    gone = motion.position(probe).value - start.value
    motion.stand_still(probe)
    return gone, exchange


def obeyed(command: Command, shown: str, gone: float, sign: int, exchange: Exchange) -> None:
    """Refute where the shaft did not go the way of a sign."""
    if gone * sign <= 0 or abs(gone) < LEAST:
        got = "a shaft that stays" if abs(gone) < LEAST else f"{gone:+.2f} deg"
        way = "clockwise" if sign > 0 else "counter-clockwise"
        raise Refuted(
            f"{command.name}: {shown} is not obeyed", expected=f"a shaft that turns {way}",
            got=got, exchange=exchange, key=f"{command.name} not obeyed",
        )  # fmt: skip


def stays(command: Command, shown: str, gone: float, exchange: Exchange) -> None:
    """Refute where the shaft went somewhere."""
    if abs(gone) > STILL:
        raise Refuted(
            f"{command.name}: {shown} is obeyed", expected="a shaft that stays: the manual does not allow it",
            got=f"{gone:+.2f} deg", exchange=exchange, key=f"{command.name} obeyed",
        )  # fmt: skip


def claim_of(
    dialect: Dialect, command: Command, field: Field, what: str, statement: str, refuted_by: str,
    check: Callable[[Probe], None], values: tuple[int, ...], risks: set[Risk], **rest: Any,
) -> Claim:  # fmt: skip
    """Return a claim about a field of a command that moves the shaft."""
    aspect = Aspect.BOUNDARY if what in ("lowest", "highest", "below", "above") else Aspect.RANGE
    return declare(
        dialect, Theme.RANGES, f"{command.name}/{field.name}/{what}", statement, refuted_by, check, command=command,
        aspect=aspect, fields=(field.name,), parameters={"field": field.name, "values": values},
        risks=motion.risks(dialect, *risks), **rest,
    )  # fmt: skip
