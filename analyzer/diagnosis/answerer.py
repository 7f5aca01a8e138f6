"""Replies with another address, or another function, than the request; and two replies to one request.

A late reply looks the same. So a unit that still owes a reply to an earlier request is not suspected.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from analyzer.catalogue import Risk, Role
from analyzer.diagnosis.exchanges import Exchange, Turn, awaited, chains
from analyzer.diagnosis.scene import SILENT, Confidence, Piece, Scene, Shown, Suspicion, Trouble, shown, whole
from analyzer.link import FUNCTIONS, READS, modbus_crc
from analyzer.values import counted


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect what differs between requests and what comes at once."""
    yield from _other_address(scene)
    yield from _other_function(scene)
    yield from _two_answer(scene)


def _two_answer(scene: Scene) -> Iterator[Suspicion]:
    """Suspect two drives of one address: each read is answered a second time at once, with another value.

    A firmware that answers twice says the same twice, or answers some commands once.
    """
    troubles = {t.piece: t for t in scene.of("duplicate_reply", "unsolicited_reply") if t.piece is not None}
    reads: Counter[int] = Counter()
    twice: dict[int, list[tuple[Piece, Piece]]] = {}
    asked: Piece | None = None
    replies: list[Piece] = []
    for piece in scene.pieces:
        message = piece.message
        if piece.is_request and message is not None and message.command is not None:
            asked = piece if message.command.all_risks == {Risk.READ} else None
            replies.clear()
            continue
        if asked is None or asked.message is None or message is None or not (piece.is_reply and piece.sound):
            continue
        replies.append(piece)
        address = asked.message.address
        if piece.asked_by == asked.sequence:
            reads[address] += 1
        elif len(replies) == _BOTH and piece in troubles and _same_form(*replies) and piece.t_ns - asked.t_ns < _AT_ONCE_NS:
            twice.setdefault(address, []).append((replies[0], piece))
    late = {t.piece.message.address for t in scene.of(*SILENT) if t.piece is not None and t.piece.message is not None}
    for address, pairs in twice.items():
        differ = sum(one.data != other.data for one, other in pairs)
        if address in late or not differ or 2 * len(pairs) <= reads[address] or (len(pairs) == 1 and not scene.directed):
            continue
        one, other = pairs[0]
        others = reads.total() - reads[address]
        sure = Confidence.CERTAIN if differ > 1 and others > 1 else Confidence.LIKELY
        yield Suspicion(
            "duplicate_address", Confidence.POSSIBLE if len(pairs) == 1 else sure, [troubles[piece] for _, piece in pairs],
            f"Two drives have the address {address}, and answer one after the other.",
            f"{whole(one)} at byte {one.offset} and {whole(other)} answer one request; "
            f"{len(pairs)} of {counted(reads[address], 'read')} of address {address} are answered twice"
            + (f", none of {others} of others" if others and len(twice) == 1 else ""),
            f"Disconnect one drive after the other and ask address {address} again; give each drive its own address",
            tuple(Shown(piece.offset, whole(piece)) for _, piece in pairs),
        )  # fmt: skip


def _same_form(one: Piece, other: Piece) -> bool:
    """Say whether two replies are of one drive and one command; a register whose request is closed is no longer named."""
    head = 1 if one.can is not None else _HEAD
    same = one.message is not None and other.message is not None and one.message.address == other.message.address
    return same and len(one.data) == len(other.data) and one.data[:head] == other.data[:head]


#: Bytes of a reply on a serial bus that tell its drive and its command; two replies; how soon both come.
_HEAD, _BOTH, _AT_ONCE_NS = 3, 2, 100_000_000


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
