"""Reports of a motion's end, which drives send by themselves: those that are awaited, and two of them that meet.

A line with two senders is low where one of them sends a low level: two frames that begin together come as the bits both have.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from functools import cache, lru_cache
from itertools import permutations
from typing import NamedTuple

from analyzer.diagnosis.bits import CELLS, at_once
from analyzer.diagnosis.exchanges import replies_to
from analyzer.diagnosis.scene import Piece, Scene, Stretch

#: Bytes at each end that are right where two reports overlap.
_EDGE = 2
#: Reports that are compared.
_MOST = 6
#: Requests before damaged bytes among which a motion is looked for.
_NEAR = 50


class Meeting(NamedTuple):
    """Two reports of which a receiver reads one sending. `whole`: every bit is that of both."""

    one: bytes
    other: bytes
    whole: bool


def meeting(scene: Scene, stretch: Stretch) -> Meeting | None:
    """Return the two awaited reports that meet in damaged bytes."""
    pairs = list(permutations(list(_awaited(scene, stretch.offset))[-_MOST:], 2))
    for one, other in pairs:
        begins = stretch.data[0] == one[0] or stretch.data[0] in overlaid(one[:_EDGE])
        if begins and len(stretch.data) < len(one) + len(other) and stretch.data in _heard(one, other):
            return Meeting(one, other, True)
    for one, other in pairs:
        size = len(stretch.data)
        overlaps = max(len(one), len(other)) <= size < len(one) + len(other)
        if overlaps and stretch.data.startswith(one[:_EDGE]) and stretch.data.endswith(other[-_EDGE:]):
            return Meeting(one, other, False)
    return None


@cache
def overlaid(head: bytes) -> bytes:
    """Return the first bytes that are read of two frames with one head at once, up to a byte apart: a low level wins."""
    return bytes({data[0] for data in at_once(head, head, CELLS) if data})


@lru_cache
def _heard(one: bytes, other: bytes) -> frozenset[bytes]:
    """Return what is read of two reports, the other at once or while the first is sent."""
    return frozenset(at_once(one, other, CELLS * len(one)))


def _awaited(scene: Scene, offset: int) -> Iterator[bytes]:
    """Yield the reports that drives still owe at a place on the bus: of the last motion of each."""
    before = bisect_left(scene.requests, offset, key=lambda piece: piece.offset)
    near = scene.requests[max(0, before - _NEAR) : before]
    # A host reads while they run.
    moved = [(p, p.message, p.message.command) for p in near if p.message is not None and p.message.command is not None]
    last = {message.address: (piece, command) for piece, message, command in moved if command.motion is not None}
    for piece, command in last.values():
        if not lacks_end(scene, piece):
            continue
        for reply in replies_to(piece):
            for status in command.replies.final:
                frame = reply.link.completed(reply.head + bytes((status,)))
                if len(frame) == reply.size:
                    yield frame


def lacks_end(scene: Scene, piece: Piece) -> bool:
    """Say whether a request is a motion that began, and whose end was not reported."""
    command = None if piece.message is None else piece.message.command
    if command is None or command.motion is None or not command.motion.tells_end:
        return False
    told = [r.message.values.get(command.replies.status) for r in scene.replies.get(piece.sequence, ()) if r.message]
    return bool(told) and command.replies.interim.issuperset(told[-1:])
