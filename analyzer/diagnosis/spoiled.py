"""Frames that are whole but for their edges: a start that is missing, or bytes of a glitch before or behind."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise, takewhile
from typing import NamedTuple

from analyzer.catalogue import Role
from analyzer.diagnosis.exchanges import crossed, replies_to
from analyzer.diagnosis.scene import Confidence, Scene, Shown, Stretch, Suspicion, Trouble, shown
from analyzer.framer import GLITCHES
from analyzer.link import FUNCTIONS, LAST_UNIT, REGISTER_READS, modbus_crc
from analyzer.values import counted

#: Bytes of one glitch: of those that a pulse makes, and of any others, where a frame stands in the same read.
_GLITCH_BYTES = 8
_STRAY_BYTES = 3
#: Bits of a byte that are high in what is read of an idle line, and such bytes that stand instead of a frame.
_HIGH, _INSTEAD = 7, 3
#: Bytes that a receiver misses while it wakes up.
_LOST_BYTES = 3
#: Sound frames that damaged ones are compared with.
_MOST_FRAMES = 200
#: Bytes that a reply must show before it is one that only lacks its end.
_LEAST_OF_REPLY = 5
#: A request to read registers.
_READ_BYTES = 8
#: No frame takes longer.
_FRAME_NS = 2_000_000_000
#: A sender's frames of which one with a glitch is no chance.
_OFTEN = 10


class _Edge(NamedTuple):
    """A glitch or a missing start: `stray` what is too much (empty: missing), and the frame, whole but for `lacks` bytes."""

    trouble: Trouble
    stray: bytes
    frame: bytes
    role: Role
    lacks: int = 0


class _Part(NamedTuple):
    """Bytes of a burst: a frame, or those between frames."""

    data: bytes
    role: Role
    trouble: Trouble | None


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the edges of frames."""
    leading: list[_Edge] = []
    trailing: list[_Edge] = []
    lost: list[_Edge] = []
    heads = _heads(scene) if scene.damaged else ()
    parts = _parts(scene)
    for trouble in scene.damaged:
        stretch = trouble.stretch
        if stretch is None or stretch.can_id is not None:
            continue
        found = _with_start(scene, stretch, heads)
        if found is not None and _leaves_out(scene, stretch, found[0][: len(found[0]) - len(stretch.data)]):
            # Nothing is wrong with it.
            scene.explained.add(trouble)
        elif found is not None:
            lost.append(_Edge(trouble, b"", *found))
    missing = {edge.trouble for edge in lost}
    for trouble, at, stray, frame in _around(scene):
        missing.add(trouble)
        (leading if at else trailing).append(_Edge(trouble, stray, frame, Role.UNKNOWN))
    for number, part in enumerate(parts):
        if part.trouble is None or part.trouble in missing:
            continue
        before = parts[number - 1] if number else None
        behind = parts[number + 1] if number + 1 < len(parts) else None
        if (edge := _glitch(scene, part, before, behind)) is not None:
            (leading if edge[0] else trailing).append(edge[1])
    if leading and {edge.stray for edge in leading} == {edge.stray for edge in trailing} and not any(map(_ends, trailing)):
        # Each sender begins so: what stands behind a reply stands before the next request.
        leading, trailing = leading + trailing, []
    # What stands between frames and within one is no matter of their edges.
    among = [edge for edge in (*leading, *trailing) if edge.stray]
    inside = list(_inside(scene, {edge.stray for edge in among})) if among else []
    if inside:
        strays = {edge.stray for edge in inside}
        among = [edge for edge in among if edge.stray in strays]
        leading, trailing = ([edge for edge in edges if edge not in among] for edges in (leading, trailing))
        yield Suspicion(
            "noise", Confidence.CERTAIN if len(inside) > 1 else Confidence.LIKELY,
            list(dict.fromkeys(edge.trouble for edge in (*inside, *among))),
            "Noise on the line: stray bytes come between frames, and within a frame.",
            f"{shown(inside[0].stray)} stands within {shown(inside[0].frame)} at byte {inside[0].trouble.offset}, and between "
            f"frames at byte {among[0].trouble.offset}; {counted(len(inside) + len(among), 'time')}",
            "Try another USB adapter; check the ground between host and drives, the termination (120 Ohm at both ends only) "
            "and the bias; repeat what fails",
            tuple(Shown(e.trouble.offset, shown(_stretch(e).data), shown(e.frame)) for e in inside),
        )  # fmt: skip
    # Noise takes a start away here and there.
    most = (
        2 * len(lost)
        >= sum(t.stretch is not None and t.stretch.direction is _stretch(lost[0]).direction for t in scene.spoiled)
        if lost
        else False
    )
    if lost and most and scene.often(len(lost), lost[0].role):
        yield _said(
            "lost_start", lost, "The first bytes of {} are missing.",
            f"{shown(_stretch(lost[0]).data)} becomes the whole frame {shown(lost[0].frame)} with its first bytes back",
            "Receive before the drive answers: switch the RS485 driver round as soon as the last stop bit is out, and "
            "do not clear the input after sending",
        )  # fmt: skip
    yield from _floating(scene)
    frames = sum(piece.sound for piece in scene.pieces)
    if _count_up(leading):
        # They are the numbers of rows, and nothing is wrong with these frames.
        scene.explained.update(edge.trouble for edge in leading)
        leading = []
    if leading and (len(leading) * _OFTEN >= frames or _is_all(scene, leading)):
        lacks = leading[0].lacks
        yield _said(
            "leading_glitch", leading, "Stray bytes stand before {}.",
            f"{shown(leading[0].stray)} stands before the {'' if lacks else 'whole '}frame {shown(leading[0].frame)}"
            + (f", which lacks {counted(lacks, 'byte')} at its end" if lacks else ""),
            "Bias the line (A up, B down, 120 Ohm at both ends), and drop bytes before a head; "
            + ("then read on to the end of the frame" if lacks else "the frame itself is whole"),
        )  # fmt: skip
    if trailing and (len(trailing) * _OFTEN >= frames or _is_all(scene, trailing)):
        yield _said(
            "trailing_glitch", trailing, "Stray bytes stand behind {}.",
            f"{shown(trailing[0].stray)} stands behind the whole frame {shown(trailing[0].frame)}",
            "Release the driver only after the last stop bit and bias the line; take as many bytes as the frame has",
        )  # fmt: skip


def _is_all(scene: Scene, edges: Sequence[_Edge]) -> bool:
    """Say whether nothing but such strays is damaged, and several are: noise hits frames, too."""
    return len(edges) >= _SEVERAL and len(edges) == len(scene.damaged)


def _count_up(edges: Sequence[_Edge]) -> bool:
    """Say whether stray bytes count up from frame to frame, in hexadecimal digits or in decimal ones, as no glitch does."""
    strays = [edge.stray for edge in edges]
    steps = [int.from_bytes(other) - int.from_bytes(one) for one, other in pairwise(strays)]
    return len(strays) >= _ROWS and max(map(len, strays)) == 1 and all(0 < step <= _DECIMAL_STEP for step in steps)


#: Strays that stand alike by no chance; the step from 09 to 10, read as hexadecimal.
_ROWS, _SEVERAL, _DECIMAL_STEP = 4, 3, 7


def _inside(scene: Scene, strays: set[bytes]) -> Iterator[_Edge]:
    """Yield sound frames of the bus that came once more with a stray byte within them; the end may be cut off by it."""
    frames = list(dict.fromkeys(p.data for p in scene.pieces if p.sound and p.can is None))[:_MOST_FRAMES]
    for trouble in scene.damaged:
        data = trouble.stretch.data if trouble.stretch is not None else b""
        for frame in frames:
            at = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(data, frame, strict=False)))
            behind = data[at + 1 :]
            whole = len(data) >= len(frame) and len(behind) >= _LEAST_OF_REPLY - 1 and frame[at:].startswith(behind)
            if at and whole and data[at : at + 1] in strays:
                yield _Edge(trouble, data[at : at + 1], frame, Role.UNKNOWN)
                break


def _floating(scene: Scene) -> Iterator[Suspicion]:
    """Suspect a line without bias: an idle level with a bit low here and there, for long, or instead of a reply."""
    own = [(t, t.stretch, idle) for t in scene.damaged if t.stretch is not None and (idle := _idle(t.stretch))]
    if not own:
        return
    _, first, idle = own[0]
    yield Suspicion(
        "noise", Confidence.CERTAIN if len(own) > 1 else Confidence.LIKELY, [trouble for trouble, _, _ in own],
        "The line floats while no node sends: its idle level is read as bytes, with a bit low here and there.",
        f"{shown(first.data[:24])} at byte {first.offset} has {counted(idle, 'byte')} of an idle line; "
        f"{counted(len(own), 'time')}",
        "Bias the line at one place (A up to 5 V, B down to ground, 390 to 680 Ohm each); terminate it at both ends; join the "
        "grounds; then see that the driver of each node is off while it does not send",
        tuple(Shown(stretch.offset, shown(stretch.data)) for _, stretch, _ in own),
    )  # fmt: skip


def _idle(stretch: Stretch) -> int:
    """Return how many bytes of an idle line stand before, behind or instead of a frame; 0 for what one glitch can be."""
    if stretch.direction is Role.REQUEST or stretch.can_id is not None:
        return 0
    high = [byte.bit_count() >= _HIGH for byte in stretch.data]
    if all(high) and len(high) >= _INSTEAD and stretch.opens and stretch.ends:
        return len(high)
    edges = sum(takewhile(bool, high)) + sum(takewhile(bool, reversed(high)))
    return edges if edges > _GLITCH_BYTES else 0


# --- a start that is missing --------------------------------------------------------------------------------------------


def _heads(scene: Scene) -> tuple[bytes, ...]:
    """Return the first bytes that frames on this bus have."""
    found: dict[bytes, None] = {}
    for piece in scene.pieces:
        if piece.sound and piece.message is not None and piece.can is None:
            for size in range(1, _LOST_BYTES):
                found[piece.data[:size]] = None
                # What a request asks for tells how its reply begins.
                for reply in replies_to(piece) if piece.is_request else ():
                    found[reply.head[:size]] = None
    for dialect in scene.reader.dialects:
        for first in dialect.link.first_bytes:
            found[bytes((first,))] = None
    return tuple(found)


def _with_start(scene: Scene, stretch: Stretch, heads: Iterable[bytes]) -> tuple[bytes, Role] | None:
    """Return the frame that a stretch is with its start put in front."""
    if len(stretch.data) < 2:
        return None
    # What a device received, in its own log, is what the host has sent.
    role = stretch.direction if scene.shows_sent else Role.UNKNOWN
    for reply in replies_to(scene.asked_before(stretch.offset)):
        missing = reply.size - len(stretch.data)
        if 0 < missing <= len(reply.head) and reply.stands(reply.head[:missing] + stretch.data, 0):
            return reply.head[:missing] + stretch.data, Role.REPLY
    for head in heads:
        whole = head + stretch.data
        reading = scene.reader.best(whole, role=role) if len(whole) > 3 + len(head) else None
        if reading is not None:
            return whole, reading.message.role
    # One address alone makes the CRC fit.
    if stretch.opens and len(stretch.data) >= _LEAST_OF_REPLY - 1 and stretch.data[0] & 0x7F in FUNCTIONS:
        for address in range(1, LAST_UNIT + 1):
            whole = bytes((address,)) + stretch.data
            if modbus_crc(whole) == 0 and (reading := scene.reader.best(whole, role=role)) is not None:
                return whole, reading.message.role
    return None


def _leaves_out(scene: Scene, stretch: Stretch, head: bytes) -> bool:
    """Say whether a log leaves the beginnings of frames out: what stands before lacks the same, and its check, too."""
    before = scene.ending.get(stretch.offset)
    if before is None or before.can_id is not None or before.checked:
        return False
    readings = (scene.reader.best(d.link.completed(head + before.data)) for d in scene.reader.dialects)
    return any(reading is not None and reading.message.role is Role.REQUEST for reading in readings)


# --- glitches -----------------------------------------------------------------------------------------------------------


def _parts(scene: Scene) -> list[_Part]:
    """Return the bytes in their order: frames, also those within damaged bytes, and what stands between them."""
    damaged = {t.stretch.offset: t for t in scene.damaged if t.stretch is not None and t.stretch.can_id is None}
    found: list[tuple[int, _Part]] = [
        (piece.offset, _Part(piece.data, piece.message.role, None))
        for piece in scene.pieces
        if piece.sound and piece.message is not None and piece.can is None
    ]
    if not found and not damaged:
        return []
    for offset, trouble in damaged.items():
        assert trouble.stretch is not None  # chosen so
        data, at = trouble.stretch.data, 0
        role = trouble.stretch.direction if scene.shows_sent else Role.UNKNOWN
        for start, reading in scene.reader.within(data, role):
            if start > at:
                found.append((offset + at, _Part(data[at:start], Role.UNKNOWN, trouble)))
            frame = reading.message.frame.data
            found.append((offset + start, _Part(frame, reading.message.role, None)))
            at = start + len(frame)
        if not at and (size := _checked(data)):
            # Of an address that no unit has; the CRC shows that it is whole.
            found.append((offset, _Part(data[:size], Role.REQUEST, None)))
            at = size
        if at < len(data):
            found.append((offset + at, _Part(data[at:], Role.UNKNOWN, trouble)))
    return [part for _, part in sorted(found, key=lambda each: each[0])]


def _checked(data: bytes) -> int:
    """Return the length of the request to read registers that bytes begin with, at any address; 0 where none does."""
    asks = len(data) >= _READ_BYTES and data[1] in REGISTER_READS and modbus_crc(data[:_READ_BYTES]) == 0
    return _READ_BYTES if asks else 0


def _glitch(scene: Scene, part: _Part, before: _Part | None, behind: _Part | None) -> tuple[bool, _Edge] | None:
    """Return whether bytes stand before a frame (or behind it), and the glitch."""
    trouble, data = part.trouble, part.data
    assert trouble is not None  # asked of damaged bytes
    stretch = trouble.stretch
    assert stretch is not None  # damaged bytes
    pulse = GLITCHES.issuperset(data)
    if (cut := _cut(scene, trouble, stretch)) is not None and data == stretch.data:
        return True, cut
    if len(data) > (_GLITCH_BYTES if pulse else _STRAY_BYTES):
        return None
    whole_burst = stretch.opens and stretch.ends and data == stretch.data
    asked = scene.asked_before(stretch.offset)
    # The end of the request before it is an echo whose start is missing.
    if not pulse and (whole_burst or (asked is not None and len(data) > 1 and asked.data.endswith(data))):
        return None
    opens = stretch.opens and stretch.data.startswith(data)
    ends = stretch.ends and stretch.data.endswith(data)
    after = behind if behind is not None and behind.trouble is None and (whole_burst or not ends) else None
    earlier = before if before is not None and before.trouble is None and (whole_burst or not opens) else None
    if earlier is not None and earlier.role is Role.REQUEST and (after is None or after.role is Role.REQUEST) and len(data) > 1:
        # What follows a request and is no reply is what became of the reply.
        return None
    if after is not None and earlier is not None:
        # Between a request and its reply the line was switched round; behind a reply the driver was switched off.
        is_leading = earlier.role is not Role.REPLY or _opens(scene, stretch)
        return is_leading, _Edge(trouble, data, *(after if is_leading else earlier)[:2])
    if after is not None:
        return True, _Edge(trouble, data, *after[:2])
    return (False, _Edge(trouble, data, *earlier[:2])) if earlier is not None else None


def _opens(scene: Scene, stretch: Stretch) -> bool:
    """Say whether bytes come long after what is before them, and soon before what follows: then its driver made them."""
    first, last = (bisect_left(scene.pieces, at, key=lambda piece: piece.offset) for at in (stretch.offset, stretch.stop))
    if not scene.timed or not first or last == len(scene.pieces):
        return False
    silent = stretch.t_ns - scene.pieces[first - 1].t_ns
    return silent > _FRAME_NS and scene.pieces[last].t_ns - stretch.t_ns < silent // _OFTEN


def _cut(scene: Scene, trouble: Trouble, stretch: Stretch) -> _Edge | None:
    """Return a glitch before a reply that lacks as many bytes at its end: the host reads as many as the reply has."""
    asked = replies_to(scene.asked_before(stretch.offset))
    if stretch.offset in crossed(scene):
        # Its end opens the next read: the reads are out of step.
        return None
    for size in range(1, min(_GLITCH_BYTES, len(stretch.data) - _LEAST_OF_REPLY) + 1):
        stray, rest = stretch.data[:size], stretch.data[size:]
        # Any bytes can be stray. Those that no pulse makes are taken as stray only where they are few.
        if not GLITCHES.issuperset(stray) and size > _STRAY_BYTES:
            return None
        for reply in asked:
            ends = stretch.ends or len(stretch.data) == reply.size
            # Its own end before it is no glitch: the reads are out of step.
            turned = not GLITCHES.issuperset(stray) and reply.stands(rest + stray, 0)
            if ends and not turned and rest.startswith(reply.head) and reply.size - size <= len(rest) < reply.size:
                return _Edge(trouble, stray, rest, Role.REPLY, reply.size - len(rest))
        if not asked and size == 1 and stretch.ends and GLITCHES.issuperset(stray) and _lacks_last(rest):
            return _Edge(trouble, stray, rest, Role.REPLY, 1)
    return None


def _around(scene: Scene) -> Iterator[tuple[Trouble, int, bytes, bytes]]:
    """Yield what came as bytes that stand in the capture without glitches around them, as where people say what was sent.

    With the place of these bytes, the stray ones, and the bytes themselves.
    """
    alone = [t for t in scene.damaged if t.stretch is not None and t.stretch.opens and t.stretch.ends]
    whole = {t.stretch.data for t in alone if t.stretch is not None and len(t.stretch.data) >= _LEAST_OF_REPLY}
    for trouble in alone if len(whole) > 1 else ():
        assert trouble.stretch is not None  # chosen so
        data = trouble.stretch.data
        for frame in whole - {data}:
            at = data.find(frame)
            stray = data[:at] + data[at + len(frame) :]
            if at >= 0 and len(stray) <= _GLITCH_BYTES and GLITCHES.issuperset(stray) and data[0] != frame[0]:
                yield trouble, at, stray, frame
                break


def _lacks_last(data: bytes) -> bool:
    """Say whether bytes are a reply of registers whose last byte alone is missing."""
    whole = data[1] in REGISTER_READS and 3 + data[2] + 1 == len(data)
    return whole and modbus_crc(data[:-1]) & 0xFF == data[-1]


def _stretch(edge: _Edge) -> Stretch:
    assert edge.trouble.stretch is not None  # found in damaged bytes
    return edge.trouble.stretch


def _ends(edge: _Edge) -> bool:
    """Say whether stray bytes are the last of what was sent at once."""
    return _stretch(edge).ends and _stretch(edge).data.endswith(edge.stray)


def _is_firm(edge: _Edge) -> bool:
    """Say whether one edge tells enough: the bytes stand as they are, or a CRC says that a missing start fits them."""
    return bool(edge.stray) or modbus_crc(edge.frame) == 0


def _said(cause: str, found: list[_Edge], say: str, evidence: str, todo: str) -> Suspicion:
    roles = {edge.role for edge in found}
    whose = "replies" if roles == {Role.REPLY} else "requests" if roles == {Role.REQUEST} else "frames"
    return Suspicion(
        cause,
        Confidence.CERTAIN if len(found) > 1 else Confidence.LIKELY if _is_firm(found[0]) else Confidence.POSSIBLE,
        list(dict.fromkeys(edge.trouble for edge in found)),
        say.format(whose),
        f"{evidence}, at byte {found[0].trouble.offset}; {counted(len(found), 'time')}",
        todo,
        tuple(Shown(e.trouble.offset, shown(_stretch(e).data), shown(e.frame)) for e in found),
    )
