"""Replies with another address, or another function, than the request.

A late reply looks the same. So a unit that still owes a reply to an earlier request is not suspected.
"""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.catalogue import Role
from analyzer.diagnosis.exchanges import Exchange, Turn, awaited, chains
from analyzer.diagnosis.scene import Confidence, Scene, Shown, Suspicion, Trouble, shown
from analyzer.link import FUNCTIONS, READS, modbus_crc
from analyzer.values import counted


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect what differs between requests and what comes at once."""
    yield from _other_address(scene)
    yield from _other_function(scene)


def _other_function(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the function of requests that a unit answers in another one, in which it was never asked."""
    found: list[tuple[Exchange, Turn]] = []
    for chain in chains(scene):
        asked: set[bytes] = set()
        for exchange in chain:
            request = exchange.request
            asked.add(request.data[:2])
            reply = _checked(exchange)
            same_unit = reply is not None and reply.data[:1] == request.data[:1] and request.data[1] in FUNCTIONS
            if same_unit and reply is not None and reply.data[1] in FUNCTIONS and reply.data[:2] not in asked:
                found.append((exchange, reply))
    if not found or not scene.directed:
        return
    exchange, reply = found[0]
    offsets = {turn.offset for e, r in found for turn in (e.request, r)}
    yield Suspicion(
        "wrong_function", Confidence.LIKELY,
        [t for t in scene.troubles if t.offset in offsets] or [Trouble("unsolicited_reply", r.offset) for _, r in found],
        f"The unit is asked in function {exchange.request.data[1]:02X}, which it does not know, and answers in function "
        f"{reply.data[1]:02X}.",
        f"{shown(reply.data)} at byte {reply.offset} follows {shown(exchange.request.data)}; {counted(len(found), 'time')}",
        "Look up which function the register has (03, 04, 06 or 10); many units write one register by 06 alone",
        tuple(Shown(r.offset, shown(r.data)) for _, r in found),
    )  # fmt: skip


def _other_address(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the address where each reply fits its request except for the sender's address."""
    found: list[tuple[Exchange, Turn]] = []
    for chain in chains(scene):
        open_: set[int] = set()
        for exchange in chain:
            asked = exchange.request.data[0]
            reply = _of_another(exchange)
            if reply is None:
                open_ = open_ - {asked} if exchange.received else open_ | {asked}
            elif reply.data[0] not in open_:
                # A unit that still owes a reply may send it late.
                found.append((exchange, reply))
    if not found or (len(found) == 1 and not scene.directed):
        return
    exchange, reply = found[0]
    asked, answers = exchange.request.data[0], reply.data[0]
    offsets = {turn.offset for e, r in found for turn in (e.request, r)}
    yield Suspicion(
        "wrong_address", Confidence.CERTAIN if len(found) > 1 else Confidence.LIKELY,
        [t for t in scene.troubles if t.offset in offsets] or [Trouble("unsolicited_reply", r.offset) for _, r in found],
        f"The unit is asked as {asked}, and answers as {answers}: {answers} is its address.",
        f"{shown(reply.data)} at byte {reply.offset} answers {shown(exchange.request.data)}; {counted(len(found), 'time')}",
        f"Ask it as {answers}"
        + ("; 0 is for all units, and none should answer it" if not asked else f", or set its address to {asked}"),
        tuple(Shown(r.offset, shown(r.data)) for _, r in found),
    )  # fmt: skip


def _checked(exchange: Exchange) -> Turn | None:
    """Return what came at once, if it is one frame of Modbus whose check fits, and no request."""
    reply = exchange.received[0] if len(exchange.received) == 1 else None
    if exchange.request.message is None or reply is None or len(reply.data) < _SHORTEST or modbus_crc(reply.data) != 0:
        return None
    return None if reply.message is not None and reply.message.role is Role.REQUEST else reply


#: The shortest reply.
_SHORTEST = 5


def _of_another(exchange: Exchange) -> Turn | None:
    """Return the reply that fits a request to read, but for its address."""
    request, reply = exchange.request, _checked(exchange)
    if request.message is None or request.data[1] not in READS or reply is None:
        return None
    fits = any(
        a.size == len(reply.data) and reply.data[1 : len(a.head)] == a.head[1:] and reply.data[0] != a.head[0]
        for a in awaited(request.message)
    )
    return reply if fits else None
