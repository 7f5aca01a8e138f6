"""The host gets its own bytes back: all of a request in front of the reply, or as much of it as the host reads."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

from analyzer.catalogue import Role
from analyzer.diagnosis.exchanges import replies_to
from analyzer.diagnosis.scene import Confidence, Scene, Shown, Stretch, Suspicion, Trouble, shown
from analyzer.values import counted

#: Bytes that must come back where a request does not come back whole; once alone, and several times.
_ONCE, _LEAST = 5, 3


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect an echo."""
    whole = [(e, "" if e.piece is None else shown(e.piece.data)) for e in scene.of("host_echo")]
    sides = [burst.direction for burst in scene.bursts] if scene.directed else []
    exchanges = sum(pair == (Role.REQUEST, Role.REPLY) for pair in pairwise(sides))
    found = whole + [(t, shown(sent)) for t, sent in _received(scene) if t not in [w for w, _ in whole]]
    # An adapter that echoes does so each time.
    if not found or (len(found) < exchanges / 2 if exchanges else not scene.often(len(found), Role.REQUEST)):
        return
    first, data = found[0]
    yield Suspicion(
        "echo", Confidence.CERTAIN if len(found) > 1 else Confidence.LIKELY, [trouble for trouble, _ in found],
        "What the host receives begins with what it has sent: its own bytes come back.",
        f"{data}, which was sent, comes back at byte {first.offset}; {counted(len(found), 'time')}",
        "Switch the receiver off while sending (tie RE to DE), or drop as many bytes as were sent before reading the reply",
        tuple(Shown(trouble.offset, text) for trouble, text in found),
    )  # fmt: skip


def _received(scene: Scene) -> Iterator[tuple[Trouble, bytes]]:
    """Yield damaged bytes that begin with what was sent before, with as much of it as came back."""
    damaged = {t.stretch.offset: t for t in scene.damaged if t.stretch is not None and t.stretch.can_id is None}
    cut: list[tuple[Trouble, bytes]] = []
    sent: Stretch | None = None
    for burst in scene.bursts if scene.directed else ():
        if burst.direction is not Role.REPLY:
            sent = burst if burst.direction is Role.REQUEST else None
            continue
        trouble = damaged.get(burst.offset)
        if sent is None or trouble is None or len(burst.data) < _LEAST or _may_be_reply(scene, burst):
            continue
        if burst.data.startswith(sent.data) and len(sent.data) >= _LEAST:
            yield trouble, sent.data
        elif sent.data.startswith(burst.data):
            cut.append((trouble, burst.data))
        sent = None
    if len(cut) > 1 or any(len(data) >= _ONCE for _, data in cut):
        yield from cut


def _may_be_reply(scene: Scene, burst: Stretch) -> bool:
    """Say whether bytes can be the beginning of the reply: a write is answered by its own bytes."""
    asked = scene.asked_before(burst.offset)
    return any(reply.begins(burst.data[: reply.size]) for reply in replies_to(asked))
