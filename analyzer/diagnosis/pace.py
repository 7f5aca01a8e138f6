"""When the host reads: too late, in parts, or out of step with what comes; and frames that it writes in parts."""

from __future__ import annotations

import re
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence

from analyzer.catalogue import Role
from analyzer.diagnosis.exchanges import Exchange, Placed, Turn, awaited, chains, placed
from analyzer.diagnosis.scene import Confidence, Piece, Read, Scene, Shown, Suspicion, Trouble, shown, whole
from analyzer.link import READS
from analyzer.values import SECOND_NS, counted

#: Replies to an earlier request from which on it is no chance.
_LATE = 3
#: Of the requests so many must be answered at all.
_ANSWERED = 0.6
#: Reads out of step from which on it is no chance, and their share of all reads.
_SHIFTED = 2
_SHIFTED_SHARE = 0.2
#: Bytes of a read that can be a frame.
_SHORTEST = 3
#: Parts in which one frame is written; those too short for a frame can be as many as it has bytes.
_PARTS, _BYTES = 3, 64
#: What findings say where replies come behind the next request.
_OUT_OF_STEP = ("unanswered", "unsolicited_reply", "late_reply", "duplicate_reply", "silent_address")


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect when the host writes and reads."""
    yield from _across(scene)
    yield from _in_parts(scene)
    yield from _given_up(scene)
    if not chains(scene):
        yield from _late_on_can(scene)
        return
    for part in (_late, _misaligned, _split, _split_replies):
        yield from part(scene)


def _late(scene: Scene) -> Iterator[Suspicion]:
    found = placed(scene)
    late = [p for p in found if p.back and not p.shift]
    asked = sum(len(chain) for chain in chains(scene))
    yield from _of_another(scene, [p for p in late if _not_asked(scene, p)])
    # All may have gone well before.
    since = sum(p.read.offset >= late[0].read.offset for p in found) if late else 0
    if len(late) < _LATE or len(found) < _ANSWERED * (asked - 1) or 2 * len(late) < since:
        return
    first = late[0]
    back = counted(first.back, "request")
    # A host that sends several and then reads all of their replies may mean to do so.
    # The last reply may come behind the one before it, once nothing more is asked.
    several = any(len(exchange.received) > 1 for chain in chains(scene) for exchange in chain[:-1])
    steady = len({p.back for p in late}) == 1 and not several
    yield Suspicion(
        "late_reply", Confidence.CERTAIN if steady else Confidence.POSSIBLE,
        scene.of(*_OUT_OF_STEP) or [Trouble("late_reply", p.read.offset) for p in late],
        f"Each reply answers an earlier request: the host is {back} ahead of what it reads.",
        f"{shown(first.read.data)} at byte {first.read.offset} answers the request before; {counted(len(late), 'time')}",
        "Wait longer for each reply (adapters hold bytes back up to 16 ms), and clear the input once before the next request",
        tuple(Shown(p.read.offset, shown(p.read.data)) for p in late),
    )  # fmt: skip


def _given_up(scene: Scene) -> Iterator[Suspicion]:
    """Suspect a timeout that is too short, where a log says it time after time, and replies come a little later."""
    said = [found for words in scene.words for found in _TIMEOUT.finditer(words)]
    limit_ns = max((int(float(found[1]) * SECOND_NS / (1000 if found[2].lower() == "ms" else 1)) for found in said), default=0)
    replies = [(request, scene.replies[request.sequence][0]) for request in scene.requests if request.sequence in scene.replies]
    late = [(request, reply) for request, reply in replies if limit_ns < reply.t_ns - request.t_ns] if scene.timed else []
    if len(said) < _GIVEN_UP or not _GIVEN_UP <= len(late) <= len(said) or 2 * len(late) <= len(said):
        return
    request, reply = late[0]
    latest = max(reply.t_ns - request.t_ns for request, reply in late)
    yield Suspicion(
        "late_reply", Confidence.CERTAIN,
        scene.of(*_OUT_OF_STEP) or [Trouble("late_reply", r.offset, None, r) for _, r in late],
        "The host gives each reply up before it comes: its timeout is too short.",
        f"{whole(reply)} at byte {reply.offset} comes {(reply.t_ns - request.t_ns) / 1e6:.3g} ms after {whole(request)}, "
        f"behind {said[0][0]!r}; {counted(len(late), 'time')}",
        f"Wait longer: the slowest of these replies took {latest / 1e6:.3g} ms; an adapter's buffer may delay it",
        tuple(Shown(r.offset, whole(r)) for _, r in late),
    )  # fmt: skip


#: What a log says when a host gives up, and how often it is no chance.
_TIMEOUT = re.compile(r"\btim(?:e|ed)[ -]?out (?:after|at) (\d+(?:\.\d+)?) ?(ms|s)\b", re.IGNORECASE)
_GIVEN_UP = 2


def _late_on_can(scene: Scene) -> Iterator[Suspicion]:
    """Suspect replies that come one by one, each behind the next request to the drive and long after its own."""
    asked: dict[int, Piece] = {}
    last: dict[int, Piece] = {}
    late: list[Piece] = []
    replies = 0
    for piece in scene.pieces:
        if piece.message is None or piece.can is None:
            continue
        if piece.is_request:
            asked[piece.sequence] = last[piece.message.address] = piece
        elif piece.asked_by in asked:
            # All may have gone well before.
            replies += bool(late)
            own, newer = asked[piece.asked_by], last[asked[piece.asked_by].message.address]  # type: ignore[union-attr]
            behind = own is not newer and piece.t_ns - own.t_ns > _BEHIND_NS and newer.t_ns - own.t_ns > _BEHIND_NS
            if behind or (own is not newer and not scene.timed and scene.behind.get(newer.sequence) is piece):
                # What has the code of the newer request may be its reply.
                late += [piece] if newer.data[:1] != piece.data[:1] else []
    if len(late) < _LATE or 2 * len(late) <= replies + 1:
        return
    yield Suspicion(
        "late_reply", Confidence.LIKELY if scene.timed else Confidence.POSSIBLE,
        scene.of(*_OUT_OF_STEP) or [Trouble("late_reply", piece.offset, None, piece) for piece in late],
        "Each reply answers an earlier request: the host has sent the next one before it came.",
        f"{whole(late[0])} at byte {late[0].offset} comes behind the next request; {counted(len(late), 'time')}",
        "Wait longer for each reply, and take those whose code is that of the request",
        tuple(Shown(piece.offset, whole(piece)) for piece in late),
    )  # fmt: skip


#: A host that has sent the next request so much later has waited for the reply, and given it up.
_BEHIND_NS = 5_000_000


def _not_asked(scene: Scene, placed_: Placed) -> bool:
    """Say whether a late reply cannot be that of the last request: it is of another address or function."""
    asked = scene.asked_before(placed_.read.offset)
    if not scene.directed or asked is None or asked.message is None:
        return False
    # Where a reply begins as its request does, its beginning tells which it answers; a write may change the address.
    heads = {reply.head[:2] for reply in awaited(asked.message)}
    return heads == {asked.data[:2]} and asked.data[:2] != placed_.read.data[:2] and asked.data[1] in READS


def _of_another(scene: Scene, late: list[Placed]) -> Iterator[Suspicion]:
    # A reply is late where it was owed: nothing came behind its request.
    silent = [e.request for chain in chains(scene) for e in chain if not e.received]
    late = [p for p in late if any(r.offset < p.read.offset and r.data[:2] == p.read.data[:2] for r in silent)]
    if not late or len(late) >= _LATE:
        return
    first = late[0]
    asked = scene.asked_before(first.read.offset)
    yield Suspicion(
        "late_reply", Confidence.LIKELY,
        scene.of("unanswered", "unsolicited_reply", "late_reply") or [Trouble("late_reply", p.read.offset) for p in late],
        "A reply comes when the host has already sent its next request, to another unit or of another function.",
        f"{shown(first.read.data)} at byte {first.read.offset} comes behind {shown(asked.data) if asked is not None else ''}",
        "Wait longer for each reply before the next request goes out, and clear the input before it",
        tuple(Shown(p.read.offset, shown(p.read.data)) for p in late),
    )  # fmt: skip


def _offset(trouble: Trouble) -> int:
    return trouble.offset


def _misaligned(scene: Scene) -> Iterator[Suspicion]:
    if not scene.directed and not any(read.firm for read in scene.reads):
        return
    crosses = [p for p in placed(scene) if p.crosses]
    crossing = {p.read.offset: p.shift for p in crosses if p.shift}
    reads = shifted = turned = 0
    first: tuple[Turn, int] | None = None
    troubles: list[Trouble] = []
    by_offset = sorted(scene.troubles, key=_offset)
    for chain in chains(scene):
        for exchange in chain:
            for turn in exchange.received:
                reads += 1
                if turn.data.startswith(exchange.request.data):
                    # The host's own bytes push its reply back.
                    continue
                shift = _turned(exchange, turn)
                turned += bool(shift)
                shift = shift or crossing.get(turn.offset, 0) or _shift(exchange, turn)
                if shift:
                    shifted += 1
                    first = first or (turn, shift)
                    # What is whole in such a read comes at the wrong time.
                    inside = (bisect_left(by_offset, at, key=_offset) for at in (turn.offset, turn.stop))
                    troubles += by_offset[slice(*inside)]
    # One that is a reply with a CRC, but for the place at which it begins, is no chance.
    least = 1 if turned else _SHIFTED
    if first is None or shifted < least or shifted < _SHIFTED_SHARE * reads:
        return
    turn, shift = first
    begins = bool(crosses) and not crosses[0].shift and not _whole_before(scene, crosses[0].read)
    # Who reads so many bytes each time is out of step from the first on; who reads what is there gets more or fewer.
    behind = [(exchange, turn) for chain in chains(scene) for exchange in chain[1:] for turn in exchange.received]
    alike = len({len(turn.data) for _, turn in behind}) == 1 and len(behind) > _SHIFTED
    counts = begins and (alike or (shifted > _SHIFTED and all(_is_counted(exchange, turn) for exchange, turn in behind)))
    if begins:
        yield Suspicion(
            "reply_cut", Confidence.POSSIBLE if counts else Confidence.CERTAIN, troubles or [Trouble("damaged", turn.offset)],
            "The host reads too early: a part of each reply is left, and opens its next read.",
            f"{shown(crosses[0].read.data)} at byte {crosses[0].read.offset} is the beginning of a reply, and "
            f"{shown(turn.data)} begins with the end of one; {counted(shifted, 'time')}",
            "Read until the length of the reply is there or a timeout has passed; clear the input before each request",
            tuple(Shown(t.offset, shown(t.stretch.data)) for t in troubles if t.stretch is not None),
        )  # fmt: skip
    if begins and not counts:
        return
    yield Suspicion(
        "read_misaligned", Confidence.CERTAIN if crossing and not begins else Confidence.LIKELY,
        troubles or [Trouble("damaged", turn.offset)],
        "The host's reads are out of step: each begins with the end of the reply before, and misses the end of its own.",
        f"{shown(turn.data)} at byte {turn.offset} is out of step by {counted(shift, 'byte')}; {counted(shifted, 'time')}",
        "Clear the input before each request, and look for the head of a reply instead of counting bytes",
        tuple(Shown(t.offset, shown(t.stretch.data)) for t in troubles if t.stretch is not None),
    )  # fmt: skip


def _across(scene: Scene) -> Iterator[Suspicion]:
    """Suspect reads of one size that begin and end within frames of that size, as those of a stream of equal requests do."""
    inside: list[tuple[Read, int]] = []
    # What a host has sent is whole.
    sent = {(piece.offset, piece.stop) for piece in scene.requests}
    bursts = [r for r in scene.reads if r.firm and r.stop - r.offset > _SHORTEST and (r.offset, r.stop) not in sent]
    if len({read.stop - read.offset for read in bursts}) > 1 or len({read.direction for read in bursts}) > 1:
        return
    whole = {(read.offset, read.stop) for read in scene.reads} & sent
    sound = (piece for piece in scene.pieces if piece.sound and piece.can is None)
    frames = {piece.offset: piece for piece in sound if (piece.offset, piece.stop) not in whole}
    # Rows of a dump cut frames of any size.
    if {len(piece.data) for piece in frames.values()} != {read.stop - read.offset for read in bursts}:
        return
    starts = sorted(frames)
    for read in bursts:
        size = read.stop - read.offset
        at = bisect_right(starts, read.offset)
        behind = frames[starts[at]] if at < len(starts) else None
        if behind is not None and read.offset < behind.offset < read.stop < behind.stop and len(behind.data) == size:
            inside.append((read, behind.offset - read.offset))
    if len(inside) < _SHIFTED or len({shift for _, shift in inside}) > 1 or 2 * len(inside) < len(bursts):
        return
    read, shift = inside[0]
    own = next(p for p in scene.pieces if p.offset == read.offset + shift)
    yield Suspicion(
        "read_misaligned", Confidence.CERTAIN, scene.troubles,
        "The reads are out of step: each begins with the end of one frame, and ends within the next.",
        f"{shown(own.data)} stands {counted(shift, 'byte')} behind the start of the read at byte {read.offset}; "
        f"{counted(len(inside), 'time')}",
        "Begin a frame where the line was silent (3.5 characters with Modbus) or where its head stands, not after so many "
        "bytes; clear the input once before the first",
        tuple(Shown(read.offset, shown(own.data)) for read, _ in inside),
    )  # fmt: skip


def _turned(exchange: Exchange, turn: Turn) -> int:
    """Return by how many bytes a read is turned: its end is the beginning of a reply whose check then fits; 0 where not."""
    message, data = exchange.request.message, turn.data
    for reply in awaited(message) if message is not None else ():
        if reply.size != len(data) or reply.stands(data, 0):
            continue
        for at in range(1, len(data)):
            if reply.stands(data[at:] + data[:at], 0):
                return at
    return 0


def _is_counted(exchange: Exchange, turn: Turn) -> bool:
    """Say whether a read has as many bytes as a reply to its request."""
    message = exchange.request.message
    return message is not None and any(len(turn.data) == reply.size for reply in awaited(message))


def _whole_before(scene: Scene, short: Turn) -> bool:
    """Say whether whole replies were read before the first short read: the host knows their length, and loses step once."""
    return any(not p.crosses and not p.shift and not p.back and p.read.offset < short.offset for p in placed(scene))


def _shift(exchange: Exchange, turn: Turn) -> int:
    """Return by how many bytes the reply stands too late in a read that is as long as the reply is; 0 where it does not."""
    message = exchange.request.message
    for reply in awaited(message) if message is not None else ():
        at = turn.data.find(reply.head, 1)
        missing = at + reply.size - len(turn.data)
        # The first byte of a CRC, or all of the head and more, is there.
        if at > 0 and len(turn.data) == reply.size and 0 < missing < reply.size - len(reply.head):
            body = turn.data[at:]
            check = reply.link.completed(body[: reply.size - 2])[-2:] if missing == 1 else b""
            if not check or len(check) < 2 or check[0] == body[-1]:
                return at
    return 0


def _split(scene: Scene) -> Iterator[Suspicion]:
    """Suspect requests that are written in parts: none is a frame, and together they are."""
    found: list[tuple[list[Turn], bytes]] = []
    for chain in chains(scene):
        at = 0
        while at < len(chain):
            parts = _parts(scene, chain[at : at + _BYTES])
            requests = [exchange.request for exchange in chain[at : at + parts]]
            if requests:
                found.append((requests, b"".join(request.data for request in requests)))
            at += parts or 1
    if not found:
        return
    parts_, whole = found[0]
    offsets = {turn.offset for turns, _ in found for turn in turns}
    troubles = [t for t in scene.troubles if t.offset in offsets]
    yield Suspicion(
        "split_frame", Confidence.CERTAIN if len(found) > 1 else Confidence.LIKELY,
        troubles or [Trouble("damaged", parts_[0].offset)],
        "One frame is written (or read) in parts, with a pause between them: each part is taken for a frame of its own.",
        f"{' + '.join(shown(turn.data) for turn in parts_)} at byte {parts_[0].offset} is {shown(whole)}; "
        f"{counted(len(found), 'time')}",
        "Write a whole frame by one call; at the receiver, join what comes until the length fits or the line was silent",
        tuple(Shown(turns[0].offset, shown(turns[0].data), shown(data)) for turns, data in found),
    )  # fmt: skip


def _split_replies(scene: Scene) -> Iterator[Suspicion]:
    """Suspect replies that come in several reads where the host then fails: the first part checks, or it asks again."""
    found: list[tuple[Turn, Turn]] = []
    again: list[tuple[Turn, Turn]] = []
    for chain in chains(scene):
        for exchange, after in zip(chain, (*chain[1:], None), strict=True):
            message, reads = exchange.request.message, exchange.received
            if (
                message is None
                or len(reads) < 2
                or not any(a.size == len(exchange.data) and a.stands(exchange.data, 0) for a in awaited(message))
            ):
                continue
            one, other = reads[0], reads[1]._replace(data=b"".join(turn.data for turn in reads[1:]))
            if any(c.ok and len(c.expected) > 1 for c in message.frame.dialect.link.checks(one.data)):
                found.append((one, other))
            elif after is not None and after.request.data == exchange.request.data:
                again.append((one, other))
    found += again if len(again) > 1 else []
    if not found:
        return
    one, other = found[0]
    yield Suspicion(
        "split_frame", Confidence.LIKELY, [Trouble("damaged", one.offset) for one, _ in found],
        "A reply comes in several reads, and the host takes the first for the whole.",
        f"{shown(one.data)} + {shown(other.data)} at byte {one.offset} are one reply; {counted(len(found), 'time')}",
        "Join what is read until the length of the reply is there: its byte count tells it",
        tuple(Shown(a.offset, shown(a.data), shown(a.data + b.data)) for a, b in found),
    )  # fmt: skip


def _in_parts(scene: Scene) -> Iterator[Suspicion]:
    """Suspect frames that are received in several reads, where a log shows that of most of them, or words ask about it."""
    asked = any(ASKS_OF_PARTS.search(words) for words in scene.words)
    waits = _waits(scene.words)
    # The program that wrote the log judges each read alone.
    failed = any(_FAILED.search(words) for words in scene.words)
    asked |= failed
    if not asked and (scene.troubles or not scene.directed):
        return
    at, whole = 0, 0
    found: list[tuple[Piece, list[Read]]] = []
    for piece in scene.pieces:
        while at < len(scene.reads) and scene.reads[at].stop <= piece.offset:
            at += 1
        behind = bisect_left(scene.reads, piece.stop, lo=at, key=lambda read: read.offset)
        parts = list(scene.reads[at:behind])
        received = all(
            read.direction is not Role.REQUEST if asked else read.firm and read.direction is Role.REPLY for read in parts
        )
        if not (piece.sound and parts and received and parts[0].offset == piece.offset and parts[-1].stop == piece.stop):
            continue
        # A log of bytes shows each alone; that a host reads them so, only words tell.
        if len(parts) > 1 and (asked or min(read.stop - read.offset for read in parts[:-1]) > 1):
            found.append((piece, parts))
        else:
            whole += 1
    if len(found) < (1 if asked or waits else _SHIFTED) or (len(found) <= whole and not failed):
        return
    piece, parts = found[0]
    data = [piece.data[read.offset - piece.offset : read.stop - piece.offset] for read in parts]
    yield Suspicion(
        "split_frame", Confidence.LIKELY if asked and not scene.troubles else Confidence.POSSIBLE,
        [Trouble("damaged", p.offset) for p, _ in found],
        "Frames are read in parts: each is whole once its parts are joined.",
        f"{' + '.join(map(shown, data[:_PARTS]))}{' + ...' if len(data) > _PARTS else ''} at byte {piece.offset} is one frame; "
        f"{counted(len(found), 'time')}",
        "Nothing is wrong on the wire: join what is read until the length of the frame is there (a byte count tells it), or "
        "until the line was silent",
        tuple(Shown(p.offset, shown(p.data)) for p, _ in found),
    )  # fmt: skip


#: Words of a program that checks what it has read.
_FAILED = re.compile(
    r"\b(?:bad|wrong|invalid)[ _-]?(?:crc|checksum)\b|\b(?:crc|checksum)[ _-]?(?:error|fail\w*|mismatch)", re.IGNORECASE
)
#: Words of a library that has got a part of a frame, and of one that has joined the parts.
_WAITS = re.compile(r"\bframe\b[^\n]{0,20} not ready\b|\brequest timed out\b", re.IGNORECASE)
_JOINED = re.compile(r"\bgetting frame\b|\bfactory response\b", re.IGNORECASE)


def _waits(said: Sequence[str]) -> bool:
    """Say whether a library waits for the rest of a frame, and does not go on to join its parts."""
    waits = False
    for words in said:
        waits = _WAITS.search(words) is not None or (waits and _JOINED.search(words) is None)
    return waits


#: Words of people who get a frame in parts.
ASKS_OF_PARTS = re.compile(
    r"\b(?:split\w*|chunk(?:s|ed)|fragment\w*|pieces|in parts|partial(?:ly)?|byte by byte|not all at once"
    r"|(?:several|multiple|different|two|\d+) (?:different )?"
    r"(?:pieces?|parts|buffers|reads|events|messages|packets|callbacks|times))\b",
    re.IGNORECASE,
)


def _parts(scene: Scene, chain: Sequence[Exchange]) -> int:
    """Return of how many sendings, none of them a frame, one frame consists; 0 where they are none."""
    data = b""
    long = 0
    bytewise = False
    for number, exchange in enumerate(chain, 1):
        part = exchange.request
        long += len(part.data) >= _SHORTEST
        bytewise |= len(part.data) == 1
        if long > _PARTS or (part.piece is not None and part.piece.sound):
            return 0
        data += part.data
        reading = scene.reader.best(data) if number > 1 else None
        if reading is not None and reading.message.role is not Role.REPLY:
            # A drive answers a host that writes byte by byte and a receiver that shows each byte alone.
            answered = bytewise and any(a.stands(exchange.data, 0) for a in awaited(reading.message))
            return 0 if answered else number
    return 0
