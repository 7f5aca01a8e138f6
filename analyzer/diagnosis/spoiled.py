"""Frames that are whole but for their edges: a start that is missing, or bytes of a glitch before or behind."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from analyzer.catalogue import Role
from analyzer.diagnosis.scene import Confidence, Piece, Scene, Shown, Stretch, Suspicion, Trouble, shown
from analyzer.framer import GLITCHES
from analyzer.values import counted

#: Bytes of one glitch.
_GLITCH_BYTES = 3
#: Bytes that a receiver misses while it wakes up.
_LOST_BYTES = 3


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the edges of frames."""
    leading: list[tuple[Trouble, bytes, Role]] = []
    trailing: list[tuple[Trouble, bytes, Role]] = []
    lost: list[tuple[Trouble, bytes, Role]] = []
    heads = _heads(scene)
    before = {p.stop: p for p in scene.pieces if p.sound and p.can is None}
    behind = {p.offset: p for p in scene.pieces if p.sound and p.can is None}
    for trouble in scene.damaged:
        stretch = trouble.stretch
        if stretch is None or stretch.can_id is not None:
            continue
        found = _with_start(scene, stretch, heads)
        if found is not None:
            lost.append((trouble, *found))
        elif (edge := _glitch(scene, stretch, before, behind)) is not None:
            (leading if edge[0] else trailing).append((trouble, *edge[1:]))
    if scene.often(len(lost), lost[0][2] if lost else Role.REPLY):
        yield _said(
            "lost_start", lost, "The first bytes of {} are missing.",
            "{} becomes the whole frame {} with its first bytes back",
            "Receive before the drive answers: switch the RS485 driver round as soon as the last stop bit is out, and "
            "do not clear the input after sending",
        )  # fmt: skip
    if scene.often(len(leading), Role.REPLY):
        yield _said(
            "leading_glitch", leading, "Stray bytes stand before {}.", "{} stands before the whole frame {}",
            "Bias the line (A up, B down, 120 Ohm at both ends), and drop bytes before a head; the frame itself is whole",
        )  # fmt: skip
    if scene.often(len(trailing), Role.REPLY):
        yield _said(
            "trailing_glitch", trailing, "Stray bytes stand behind {}.", "{} stands behind the whole frame {}",
            "Release the driver only after the last stop bit and bias the line; take as many bytes as the frame has",
        )  # fmt: skip


def _heads(scene: Scene) -> tuple[bytes, ...]:
    """Return the first bytes that frames on this bus have."""
    found: dict[bytes, None] = {}
    for piece in scene.pieces:
        if piece.sound and piece.message is not None and piece.can is None:
            for size in range(1, _LOST_BYTES):
                found[piece.data[:size]] = None
                # What a request asks for tells how its reply begins.
                if piece.is_request and (head := _reply_head(piece)):
                    found[head[:size]] = None
    for dialect in scene.reader.dialects:
        for first in dialect.link.first_bytes:
            found[bytes((first,))] = None
    return tuple(found)


def _reply_head(piece: Piece) -> bytes:
    message = piece.message
    if message is None or message.command is None or not message.command.reply_forms or message.command.code < 0:
        return b""
    form = message.command.reply_forms[0]
    data = bytes(form.layout.byte_length)
    return message.frame.dialect.link.build(message.command, form, message.address, data, Role.REPLY)


def _with_start(scene: Scene, stretch: Stretch, heads: Iterable[bytes]) -> tuple[bytes, Role] | None:
    """Return the frame that a stretch is with its start put in front."""
    if len(stretch.data) < 2:
        return None
    for head in heads:
        whole = head + stretch.data
        reading = scene.reader.best(whole, role=stretch.direction) if len(whole) > 3 + len(head) else None
        if reading is not None:
            return whole, reading.message.role
    return None


def _glitch(
    scene: Scene, stretch: Stretch, before: dict[int, Piece], behind: dict[int, Piece]
) -> tuple[bool, bytes, Role] | None:
    """Return whether bytes before a frame are a glitch (or behind it), the frame, and who sent it."""
    data = stretch.data
    if len(data) <= _GLITCH_BYTES and GLITCHES.issuperset(data):
        after, earlier = behind.get(stretch.stop), before.get(stretch.offset)
        # In one read with it, or where nothing else is known the next frame.
        if after is not None and after.message is not None and not stretch.ends:
            return True, after.data, after.message.role
        if earlier is not None and earlier.message is not None and not stretch.opens:
            return False, earlier.data, earlier.message.role
        return None
    for size in range(1, min(_GLITCH_BYTES + 1, len(data) - 3)):
        for is_leading, frame, cut in ((True, data[size:], data[:size]), (False, data[:-size], data[-size:])):
            if not GLITCHES.issuperset(cut):
                continue
            reading = scene.reader.best(frame, role=stretch.direction)
            if reading is not None:
                return is_leading, frame, reading.message.role
    return None


def _said(cause: str, found: list[tuple[Trouble, bytes, Role]], say: str, evidence: str, todo: str) -> Suspicion:
    first, frame, _ = found[0]
    roles = {role for _, _, role in found}
    whose = "replies" if roles == {Role.REPLY} else "requests" if roles == {Role.REQUEST} else "frames"
    assert first.stretch is not None  # found in damaged bytes
    text = evidence.format(shown(first.stretch.data), shown(frame))
    return Suspicion(
        cause,
        Confidence.CERTAIN if len(found) > 1 else Confidence.LIKELY,
        [trouble for trouble, _, _ in found],
        say.format(whose),
        f"{text}, at byte {first.offset}; {counted(len(found), 'time')}",
        todo,
        tuple(Shown(t.offset, shown(t.stretch.data), shown(whole)) for t, whole, _ in found if t.stretch is not None),
    )
