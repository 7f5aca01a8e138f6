"""What the host does with what it gets: it reads too little, or it gets its own bytes back."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator

from analyzer.catalogue import Role
from analyzer.diagnosis.exchanges import awaited
from analyzer.diagnosis.failing import failing_by_check
from analyzer.diagnosis.rendered import read_otherwise
from analyzer.diagnosis.scene import Confidence, Scene, Shown, Stretch, Suspicion, Trouble, shown
from analyzer.link import FUNCTIONS, LAST_EXCEPTION, LAST_UNIT, READS, REGISTER_READS, modbus_crc
from analyzer.records import Message
from analyzer.values import counted


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the host."""
    yield from _cut(scene)


def _cut(scene: Scene) -> Iterator[Suspicion]:
    cut: list[tuple[Trouble, bytes, int]] = []
    known, told = scene.directed, False
    heads = Counter(t.stretch.data[:_HEAD] for t in scene.damaged if t.stretch is not None)
    for trouble in scene.damaged:
        stretch = trouble.stretch
        if stretch is None or stretch.direction is Role.REQUEST or not stretch.ends or not stretch.opens:
            continue
        if trouble in scene.explained:
            continue
        asked = asked_before(scene, stretch)
        wanted = (_wanted(asked, stretch.data) if asked is not None else _promised(stretch, heads)) or _refusal(asked, stretch)
        # What the capture ends in may have gone on; what goes on in the reads behind it was not cut.
        if wanted and not _goes_on(scene, stretch, wanted) and (scene.directed or stretch.stop != scene.pieces[-1].stop):
            cut.append((trouble, stretch.data, wanted))
            told |= asked is not None
    # A single byte can be anything, unless it is all that comes of each reply.
    if any(len(data) == 1 for _, data, _ in cut) and len(cut) < _SINGLE:
        cut = [row for row in cut if len(row[1]) > 1]
    if not scene.often(len(cut), Role.REPLY):
        return
    # A promise stands among the bytes of another protocol by chance.
    heard = [t for t in scene.damaged if t.stretch is not None and t.stretch.direction is not Role.REQUEST]
    if not told and 2 * len(cut) < len(heard):
        return
    known |= told
    if not known and read_otherwise([data for _, data, _ in cut]):
        return
    first, data, wanted = cut[0]
    unchecked = _without_check(scene, [(data, wanted) for _, data, wanted in cut])
    sure = len(cut) > 1 and known and not unchecked
    yield Suspicion(
        "reply_cut", Confidence.CERTAIN if sure else Confidence.LIKELY, [t for t, _, _ in cut],
        "The host reads only a part of the reply.",
        f"{shown(data)} at byte {first.offset} has {counted(len(data), 'byte')} of {wanted}; {counted(len(cut), 'time')}",
        f"Read until {wanted} bytes are there or a timeout has passed, not what has come by the time of one read",
        tuple(Shown(t.offset, shown(d)) for t, d, _ in cut),
    )  # fmt: skip
    if unchecked:
        yield Suspicion(
            "firmware_quirk", Confidence.LIKELY, [t for t, _, _ in cut],
            "Replies of several lengths lack their check and nothing else: the drive may send none.",
            f"{shown(data)} at byte {first.offset} lacks its last {counted(wanted - len(data), 'byte')}, "
            f"as {counted(len(cut), 'reply', 'replies')} of {len({wanted for _, _, wanted in cut})} lengths do",
            "See by a recording of the line whether the check comes; if not, take replies without it, or change the firmware",
            tuple(Shown(t.offset, shown(d)) for t, d, _ in cut),
        )  # fmt: skip
    yield from _with_more(scene, [t for t, _, _ in cut], heads)


def _without_check(scene: Scene, cut: list[tuple[bytes, int]]) -> bool:
    """Say whether all replies, of several lengths, lack as many bytes as their check has: no one count of bytes cuts so."""
    asked = next((piece.message for piece in scene.requests if piece.message is not None), None)
    if asked is None or any(piece.is_reply and piece.sound for piece in scene.pieces):
        return False
    check = len(asked.frame.dialect.link.checks(asked.frame.data)[-1].expected)
    return len({wanted for _, wanted in cut}) > 1 and all(wanted - len(data) == check for data, wanted in cut)


def _with_more(scene: Scene, cut: list[Trouble], heads: Counter[bytes]) -> Iterator[Suspicion]:
    """Suspect, as the second, that the rest of each cut reply comes in the read behind it."""
    found = [(t, t.stretch, rest) for t in cut if t.stretch is not None and (rest := _behind(scene, t.stretch, heads))]
    if len(found) < max(len(cut), 2):
        return
    trouble, stretch, rest = found[0]
    yield Suspicion(
        "split_frame", Confidence.POSSIBLE, cut,
        "Behind each cut reply another read comes that begins no frame: it may be the rest, with bytes lost between.",
        f"{shown(stretch.data)} at byte {trouble.offset}, then {shown(rest)}; {counted(len(found), 'time')}",
        "Join what is read until as many bytes are there as the reply promises, and look for what empties the buffer between",
        tuple(Shown(t.offset, shown(s.data)) for t, s, _ in found),
    )  # fmt: skip


def _behind(scene: Scene, stretch: Stretch, heads: Counter[bytes]) -> bytes | None:
    """Return the read behind a stretch, where it is no request and begins no frame."""
    at = bisect_right(scene.bursts, stretch.offset, key=lambda b: b.offset)
    burst = scene.bursts[at] if at < len(scene.bursts) else None
    if burst is None or burst.direction is Role.REQUEST or heads[burst.data[:_HEAD]] > 1:
        return None
    if len(burst.data) < _SHORTEST - 1 or burst.data[1] & 0x7F in FUNCTIONS:
        return None
    return None if any(p.offset == burst.offset for p in scene.pieces if p.sound) else burst.data


def _goes_on(scene: Scene, stretch: Stretch, wanted: int) -> bool:
    """Say whether the reads behind make a reply of it whose CRC fits; a log may show each of them again when it is handled."""
    data = last = stretch.data
    for burst in scene.bursts[bisect_right(scene.bursts, stretch.offset, key=lambda b: b.offset) :]:
        if burst.direction is Role.REQUEST or len(data) >= wanted:
            break
        data, last = data if burst.data == last else data + burst.data, burst.data
    return len(data) == wanted and data[1] in READS and modbus_crc(data) == 0


def asked_before(scene: Scene, stretch: Stretch) -> Message | None:
    """Return the request that comes last before a stretch, mended if its check alone was wrong."""
    piece = scene.asked_before(stretch.offset)
    found = piece.message if piece is not None else None
    for trouble in scene.damaged:
        if trouble.stretch is not None and trouble.stretch.stop == stretch.offset:
            failing = failing_by_check(scene, trouble, trouble.stretch)
            reading = scene.reader.best(failing.right) if failing is not None else None
            found = reading.message if reading is not None else found
    return found


def _promised(stretch: Stretch, heads: Counter[bytes]) -> int:
    """Return how many bytes a Modbus reply has by its own count, if fewer are there; else 0.

    That is one whose last byte is missing, or one of registers that ends before its data do: it is marked as received, or
    begins as others do. `heads`: how often damaged bytes begin so.
    """
    data = stretch.data
    received = stretch.direction is Role.REPLY or heads[data[:_HEAD]] > 1
    if (
        received
        and len(data) >= _LEAST
        and 0 < data[0] <= LAST_UNIT
        and data[1] in REGISTER_READS
        and data[2]
        and not data[2] % 2
    ):
        size = _SHORTEST + data[2]
        if len(data) <= size - _CHECK and size <= _LONGEST:
            return size
    whole = len(data) > _SHORTEST and data[1] in READS and 3 + data[2] + 1 == len(data)
    return len(data) + 1 if whole and modbus_crc(data[:-1]) & 0xFF == data[-1] else 0


def _refusal(asked: Message | None, stretch: Stretch) -> int:
    """Return how many bytes an exception has, if these are one without its CRC, or with half of it; else 0."""
    data = stretch.data
    if not _SHORTEST - 2 <= len(data) < _SHORTEST or data[1] ^ 0x80 not in FUNCTIONS or not 0 < data[2] <= LAST_EXCEPTION:
        return 0
    if asked is not None and bytes((data[0], data[1] & 0x7F)) != asked.frame.data[:2]:
        return 0
    half = len(data) < _SHORTEST - 1 or modbus_crc(data[:-1]) & 0xFF == data[-1]
    return _SHORTEST if half and (asked is not None or stretch.direction is Role.REPLY) else 0


#: The size of an exception.
_SHORTEST = 5
#: Unit, function and count of a reply; and replies of which one byte alone came.
_HEAD, _SINGLE = 3, 3
#: Bytes of a beginning that tell, of a CRC, and of the longest reply.
_LEAST, _CHECK, _LONGEST = 4, 2, 255


def _wanted(asked: Message, data: bytes) -> int:
    """Return how many bytes the reply to a request has, if these are its beginning; else 0."""
    return next((reply.size for reply in awaited(asked) if len(data) < reply.size and reply.begins(data)), 0)
