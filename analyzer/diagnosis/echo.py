"""The host gets its own bytes back: all of a request in front of the reply, or as much of it as the host reads."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

from analyzer.catalogue import Role
from analyzer.diagnosis.exchanges import fragments, replies_to
from analyzer.diagnosis.scene import Confidence, Scene, Shown, Stretch, Suspicion, Trouble, shown
from analyzer.link import READS, modbus_crc, read_bytes
from analyzer.values import counted

#: Bytes that must come back where a request does not come back whole; once alone, and several times.
_ONCE, _LEAST = 5, 3
#: A request, its echo, and its reply.
_ROW = 3
#: The share of the zeros or ones that may be changed; and of these so many times more go one way than the other.
_CHANGED, _ONE_WAY = 0.6, 4
#: A request to read.
_READ_BYTES = 8
_OFF = "Switch the receiver off while sending (tie RE to DE)"
_DROP = f"{_OFF}, or drop as many bytes as were sent before reading the reply"


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect an echo."""
    if fragments(scene):
        return
    repeated = scene.repeated
    # What the capture says was sent is no echo: it was sent again.
    back = [e for e in scene.of("host_echo") if e not in repeated and scene.direction(e.offset) is not Role.REQUEST]
    if scene.directed and not scene.shows_sent:
        # A host that receives the same again and again has sent nothing that could come back.
        back = []
    parted = [(sent, rows) for sent, rows in _parted(scene) if not set(back).intersection(rows)]
    found = [(e, "" if e.piece is None else shown(e.piece.data)) for e in back] + [(rows[0], sent) for sent, rows in parted]
    told = {trouble for trouble, _ in found}.union(*(rows for _, rows in parted))
    found += [(t, shown(sent)) for t, sent in _received(scene) if t not in told]
    found += [] if found else _glued(scene)
    offsets = {trouble.offset for trouble, _ in found}
    exchanges = sum(
        (sent.direction, came.direction) == (Role.REQUEST, Role.REPLY)
        # A reply that is its request by the manual tells neither.
        and (sent.data != came.data or came.offset in offsets or not found)
        for sent, came in (pairwise(scene.bursts) if scene.directed else ())
    )
    if not found and (doubled := _doubled(scene)):
        yield Suspicion(
            "echo", Confidence.LIKELY, doubled,
            "Each request stands twice before its reply: one that is sent, and its echo.",
            f"{shown(doubled[0].piece.data if doubled[0].piece else b'')} at byte {doubled[0].offset}, and all {len(doubled)}",
            _DROP,
            tuple(Shown(t.offset, shown(t.piece.data)) for t in doubled if t.piece is not None),
        )  # fmt: skip
        return
    if not found:
        changed = list(_changed(scene))
        yield from _damaged(
            # A reply of another protocol can begin as its request does, and be as long, but not each time.
            changed if len(changed) > exchanges / 2 else [], "came behind {}",
            "The host receives its own bytes, damaged: as many as it has sent, and most of their bits.",
            f"{_OFF}; then look for what else pulls at the line: A and B swapped at another node, a driver that stays on, a "
            "level of 5 V at an input of 3.3 V",
        )  # fmt: skip
        yield from _damaged(
            list(_cut(scene)), "is {} without its end",
            "What was received is a request, cut to the length of its reply: the host gets its own bytes back.", _DROP,
        )  # fmt: skip
        return
    # An adapter that echoes does so each time: one of two answered by other bytes is none.
    if len(found) <= exchanges / 2 if exchanges else not scene.often(len(found), Role.REQUEST):
        return
    first, data = found[0]
    told = {trouble for trouble, _ in found}
    # What came back damaged is an echo, too.
    found += [(t, shown(sent)) for t, sent in _changed(scene) if t not in told]
    # Of a dialect that is not known the request is damaged, too; its reply behind its own bytes leaves no doubt.
    sent = {t.stretch.stop: t for t in scene.damaged if t.stretch is not None and t.stretch.direction is Role.REQUEST}
    asked = [sent[t.offset] for t, _ in found if t.stretch is not None and t.offset in sent]
    behind = [
        t for t in asked if (own := _after(scene, t)) is not None and len(own.data) > len(t.stretch.data if t.stretch else b"")
    ]
    yield Suspicion(
        "echo", Confidence.CERTAIN if len(found) > 1 or behind else Confidence.LIKELY,
        [*asked, *dict.fromkeys((*(trouble for trouble, _ in found), *(t for _, rows in parted for t in rows)))],
        "What the host receives begins with what it has sent: its own bytes come back.",
        f"{data}, which was sent, comes back at byte {first.offset}; {counted(len(found), 'time')}",
        _DROP,
        tuple(Shown(trouble.offset, text) for trouble, text in found),
    )  # fmt: skip


def _doubled(scene: Scene) -> list[Trouble]:
    """Return the first of each pair of equal requests where all requests come in pairs, and a reply behind each.

    Without times and directions one request that comes twice may be sent again; different ones, each twice, are not.
    """
    pieces = scene.pieces
    if scene.directed or scene.timed or len({p.data for p in scene.requests}) < _LEAST or len(pieces) % _ROW:
        return []
    rows = list(zip(pieces[::_ROW], pieces[1::_ROW], pieces[2::_ROW], strict=True))
    if not all(sent.is_request and sent.data == back.data and came.is_reply and came.sound for sent, back, came in rows):
        return []
    first = {one for one, _, _ in rows}
    return [t for t in scene.of("unanswered", "silent_address") if t.piece in first]


def _damaged(found: list[tuple[Trouble, bytes]], how: str, say: str, todo: str) -> Iterator[Suspicion]:
    """Suspect an echo of damaged bytes, with what was sent. `how`: what the received bytes are to those sent."""
    if not found:
        return
    frames = tuple(Shown(t.offset, shown(t.stretch.data), shown(sent)) for t, sent in found if t.stretch is not None)
    first = frames[0]
    evidence = f"{first.data} at byte {first.offset} {how.format(first.right)}; {counted(len(found), 'time')}"
    yield Suspicion("echo", Confidence.LIKELY, [trouble for trouble, _ in found], say, evidence, todo, frames)


def _changed(scene: Scene) -> Iterator[tuple[Trouble, bytes]]:
    """Yield damaged bytes that are as many as were sent right before, and agree with them in most bits."""
    for trouble in scene.damaged if scene.directed else ():
        stretch = trouble.stretch
        if stretch is None or stretch.can_id is not None or stretch.direction is not Role.REPLY or trouble in scene.explained:
            continue
        own = scene.ending.get(stretch.offset)
        if (
            own is None
            or own.direction is not Role.REQUEST
            or len(own.data) != len(stretch.data)
            or len(own.data) < _ONCE
            or _may_be_reply(scene, stretch.data, own)
        ):
            continue
        got, was = int.from_bytes(stretch.data), int.from_bytes(own.data)
        added, lost, ones = (got & ~was).bit_count(), (was & ~got).bit_count(), was.bit_count()
        # What else drives the line only adds bits, or only takes them away; of those that it can change many stay.
        one_way = min(added, lost) * _ONE_WAY <= max(added, lost)
        if one_way and lost < ones * _CHANGED and added < (8 * len(own.data) - ones) * _CHANGED:
            yield trouble, own.data


def _cut(scene: Scene) -> Iterator[tuple[Trouble, bytes]]:
    """Yield damaged bytes that are a request but for its last byte, where no request is shown."""
    if any(scene.direction(piece.offset) is Role.REQUEST or piece.is_request for piece in scene.pieces):
        return
    for trouble in scene.damaged:
        if trouble.stretch is not None and trouble.stretch.ends and (whole := _cut_read(trouble.stretch.data)) is not None:
            yield trouble, whole


def _cut_read(data: bytes) -> bytes | None:
    """Return the request that bytes begin, if they are as many as its reply has and its check begins behind them."""
    if len(data) != _READ_BYTES - 1 or data[1] not in READS:
        return None
    body = data[:-1]
    crc = modbus_crc(body).to_bytes(2, "little")
    count = read_bytes(data[1], int.from_bytes(data[4:6], "big"))
    return body + crc if crc[0] == data[-1] and 5 + count == len(data) else None


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
        if sent is None or len(burst.data) < _LEAST or _may_be_reply(scene, burst.data, sent):
            continue
        if trouble is None:
            # It begins with a sound request, and more comes behind it.
            if burst.data.startswith(sent.data) and len(burst.data) > len(sent.data) >= _ONCE and _unsound(sent):
                yield Trouble("host_echo", burst.offset), sent.data
            continue
        if burst.data.startswith(sent.data) and len(sent.data) >= _LEAST:
            yield trouble, sent.data
        elif burst.data.startswith(rest := sent.data[1:]) and (
            len(sent.data) > _ONCE or _replied(scene, burst.data, len(rest), sent)
        ):
            # The receiver is switched on within the first byte, or the host has thrown it away.
            yield trouble, rest
        elif sent.data.startswith(burst.data):
            cut.append((trouble, burst.data))
        else:
            # A log may show it byte by byte first, and then whole.
            continue
        sent = None
    if len(cut) > 1 or any(len(data) >= _ONCE for _, data in cut):
        yield from cut


def _parted(scene: Scene) -> list[tuple[str, list[Trouble]]]:
    """Return requests that come back in more reads than one, before the reply, with the troubles of these reads."""
    found = []
    for sent, heard in _exchanged(scene):
        data = b"".join(burst.data for burst in heard)
        size = len(sent.data)
        if not len(heard[0].data) < size < len(data) or not data.startswith(sent.data):
            continue
        # A write is answered by its own bytes; then the reply stands behind them again.
        if size < _ONCE or (_may_be_reply(scene, data[:size], sent) and not _replied(scene, data, size, sent)):
            continue
        troubles = [t for t in scene.troubles if heard[0].offset <= t.offset < heard[-1].stop]
        found.append((shown(sent.data), troubles or [Trouble("host_echo", heard[0].offset)]))
    return found


def _exchanged(scene: Scene) -> Iterator[tuple[Stretch, list[Stretch]]]:
    """Yield what the host has sent at once, and all that it receives before it sends again."""
    sent: Stretch | None = None
    heard: list[Stretch] = []
    for burst in (*scene.bursts, None) if scene.directed else ():
        if burst is not None and burst.direction is Role.REPLY:
            heard.append(burst)
            continue
        if sent is not None and heard:
            yield sent, heard
        sent, heard = burst if burst is not None and burst.direction is Role.REQUEST else None, []


def _glued(scene: Scene) -> list[tuple[Trouble, str]]:
    """Return requests that came with their reply in one read, where the host has sent them, or words call it the response.

    A listener receives both, and nothing is wrong.
    """
    sent = {burst.data for burst in scene.bursts if burst.direction is Role.REQUEST}
    told = bool(scene.words) and not scene.noted
    return [
        (Trouble("host_echo", request.offset, None, request), shown(request.data))
        for burst in scene.bursts if burst.direction is Role.REPLY and len(burst.pieces) > 1
        for request, reply in pairwise(burst.pieces)
        if request.sound and request.is_request and request.can is None and reply.asked_by == request.sequence
        and request.offset == burst.offset and (told or not sent.isdisjoint((request.data, request.data[:-2])))
    ]  # fmt: skip


def _after(scene: Scene, trouble: Trouble) -> Stretch | None:
    """Return what came right behind damaged bytes."""
    stop = trouble.stretch.stop if trouble.stretch is not None else 0
    return next((burst for burst in scene.bursts if burst.offset == stop), None)


def _unsound(burst: Stretch) -> bool:
    """Say whether the pipeline took a sending for no frame, so that it could not see its echo."""
    return not any(piece.sound for piece in burst.pieces)


def _replied(scene: Scene, data: bytes, at: int, sent: Stretch) -> bool:
    """Say whether the reply to what was sent stands at a place in bytes."""
    return any(reply.stands(data, at) for reply in replies_to(scene.asked_before(sent.stop)))


def _may_be_reply(scene: Scene, data: bytes, sent: Stretch) -> bool:
    """Say whether bytes can be the beginning of the reply: a write is answered by its own bytes."""
    return any(reply.begins(data[: reply.size]) for reply in replies_to(scene.asked_before(sent.stop)))
