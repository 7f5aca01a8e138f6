"""Requests that a listener takes for replies: where the two look alike, a request that is sent again is one, too.

So it is with a setting of 0 or 1 on CAN, a write of Modbus, some commands of LK. A single frame does not tell; a whole capture
does: replies of drives come soon, and from an address that is no drive's comes nothing else.
"""

from __future__ import annotations

from statistics import median

from msgspec.structs import replace

from analyzer.catalogue import Role
from analyzer.decoder import Decoder
from analyzer.diagnosis.scene import Piece
from analyzer.findings import RULES
from analyzer.records import Finding, Message
from analyzer.values import SECOND_NS

#: A frame that comes sooner is a reply.
SOON_NS = 100_000_000
#: A frame is no reply if it comes so many times later than the others; where there are no others, behind so long.
_LATER, _ALONE_NS = 20, SECOND_NS // 2


def told_apart(pieces: list[Piece], findings: list[Finding]) -> tuple[list[Piece], list[Finding]]:
    """Return frames and findings of a bus with such requests as what they are: unanswered."""
    by_sequence = {piece.sequence: piece for piece in pieces}
    replies = [(p, by_sequence[p.asked_by]) for p in pieces if p.is_reply and p.asked_by in by_sequence]
    alike = [(p, asked) for p, asked in replies if _may_be_request(p, asked)]
    late = {p.sequence for p, _ in alike}
    # An address of which even one reply is plain is that of a drive.
    drives = {_drive(p) for p in pieces if p.is_reply and p.sequence not in late}
    others = [p.t_ns - asked.t_ns for p, asked in replies if _drive(p) in drives]
    latest = _LATER * median(others) if others else _ALONE_NS
    found = [(p, asked) for p, asked in alike if _drive(p) not in drives and p.t_ns - asked.t_ns >= latest]
    # Times in whole seconds tell nothing of what is sooner.
    if not found or len({piece.t_ns % SECOND_NS for piece in pieces}) == 1:
        return pieces, findings
    again = {p.sequence for p, _ in found}
    silent = again | {asked.sequence for _, asked in found}
    told = [f for f in findings if f.sequence not in silent] + [_unanswered(p) for p in pieces if p.sequence in silent]
    return [_as_request(p) if p.sequence in silent else p for p in pieces], told


def _may_be_request(reply: Piece, asked: Piece) -> bool:
    """Say whether a reply can be its request, sent again: it is the same and late, and the capture does not say who sent it."""
    message, before = reply.message, asked.message
    assert message is not None  # a reply and its request are messages
    assert before is not None
    unmarked = message.frame.role is Role.UNKNOWN and before.frame.role is not Role.REPLY
    own = reply.can.id == asked.can.id if reply.can is not None and asked.can is not None else True
    return unmarked and own and reply.data == asked.data and reply.t_ns - asked.t_ns > SOON_NS


def _drive(piece: Piece) -> tuple[str, int]:
    message = piece.message
    assert message is not None  # asked of replies
    return message.frame.dialect.name, message.address


def _as_request(piece: Piece) -> Piece:
    message = piece.message
    assert message is not None  # chosen so
    sent: Message = Decoder(message.frame.dialect).decode(replace(message.frame, role=Role.REQUEST))[0]
    return replace(piece, message=sent, asked_by=None, rules=frozenset(("unanswered",)))


def _unanswered(piece: Piece) -> Finding:
    message = piece.message
    assert message is not None  # chosen so
    rule = RULES["unanswered"]
    return Finding(
        rule.id, rule.severity, message.frame.port, message.address, piece.t_ns, piece.t_ns,
        "it is sent again, and no reply came", offset=piece.offset, sequence=piece.sequence,
    )  # fmt: skip
