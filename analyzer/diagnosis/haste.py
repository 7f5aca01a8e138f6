"""Requests that come too soon: behind a reply, or before the one before is answered."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise, takewhile

from analyzer.catalogue import Risk, Role, Verb
from analyzer.diagnosis.can_frames import sent_again
from analyzer.diagnosis.exchanges import Exchange, Turn, awaited, chains
from analyzer.diagnosis.scene import Confidence, Piece, Scene, Shown, Suspicion, Trouble, shown, whole
from analyzer.link import FUNCTIONS, modbus_crc
from analyzer.records import Message
from analyzer.values import counted

#: Commands behind which a drive is away for a while.
_RESTARTS = frozenset((Verb.RESTART, Verb.RESTORE, Verb.CALIBRATE))
#: Requests from which on it is no chance; those of the shortest row.
_OFTEN = _PAIR = 2
#: How many requests that are sent alone may come to one that is answered.
_MOSTLY = 1.2
#: A pause before a request that any drive stands; and one that only a drive that stores a setting needs.
_SHORT_NS = 20_000_000
_LONG_NS = 1_000_000_000


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect requests that come too soon."""
    yield from _while_restarting(scene)
    # Error frames destroy requests and replies, whatever the pace.
    if scene.of("can_error_frame"):
        return
    yield from _at_once(scene)
    yield from _too_fast(scene)
    yield from _some_of_row(scene)
    yield from _none_of_row(scene)


def _none_of_row(scene: Scene) -> Iterator[Suspicion]:
    """Suspect requests that follow each other sooner than any reply comes: none is answered, and those sent alone are.

    A unit of Modbus takes what comes without a silence of 3.5 characters between for one frame.
    """
    latencies = [came[0].t_ns - p.t_ns for p in scene.requests if (came := scene.replies.get(p.sequence))]
    rows: list[list[Piece]] = []
    for piece in scene.requests if scene.timed and latencies else ():
        if rows and piece.t_ns - rows[-1][-1].t_ns < min(latencies):
            rows[-1].append(piece)
        else:
            rows.append([piece])
    alone = [row[0] for row in rows if len(row) == 1]
    good = [piece for piece in alone if piece.sequence in scene.replies]
    there = {_asked_for(piece.message)[0] for piece in good}
    rows = [row for row in rows if len(row) > 1]
    hasty = [
        row for row in rows
        if len({piece.data for piece in row}) == len(row) and all("unanswered" in piece.rules for piece in row)
        and there.issuperset(_asked_for(piece.message)[0] for piece in row)
    ]  # fmt: skip
    if min(len(hasty), len(good)) < _OFTEN or 2 * len(hasty) <= len(rows) or len(alone) > _MOSTLY * len(good):
        return
    one, other = hasty[0][:2]
    failing = {piece for row in hasty for piece in row}
    yield Suspicion(
        "too_fast", Confidence.LIKELY, [t for t in scene.of("unanswered") if t.piece in failing],
        "The host sends the next request before the reply to the one before can come: none of them is answered.",
        f"{whole(other)} at byte {other.offset} begins {(other.t_ns - one.t_ns) / 1e6:.3g} ms after {whole(one)} does, and no "
        f"reply has come sooner than after {min(latencies) / 1e6:.3g} ms; {counted(len(hasty), 'time')}, and "
        f"{counted(len(good), 'request')} sent alone {'are' if len(good) > 1 else 'is'} answered",
        "Send one request, wait for its reply or the timeout, then send the next; Modbus needs 3.5 characters of silence",
        tuple(Shown(p.offset, whole(p)) for row in hasty for p in row),
    )  # fmt: skip


def _some_of_row(scene: Scene) -> Iterator[Suspicion]:
    """Suspect a host that sends several requests before anything comes, where fewer replies come for each such row.

    Where it is not that of the last, the host has not waited for it, whatever the times; nor where the next request follows
    sooner than any reply comes. Alone the same requests are answered, or those of the same kind.
    Several replies tell something of one drive: of several drives one may be absent.
    """
    rows = list(_piece_rows(scene))
    quickest = min((replies[0].t_ns - asked[-1].t_ns for asked, replies in rows if _answers(replies[0], asked[-1])), default=0)
    hasty: list[tuple[list[Piece], list[Piece]]] = []
    answered: set[tuple[int, str]] = set()
    sooner = waited = True
    for asked, replies in rows:
        came = {_asked_for(reply.message) for reply in replies}
        own = [p for p in asked if _asked_for(p.message) in came or (len(replies) == 1 and _answers(replies[0], p))]
        answered |= {_asked_for(piece.message) for piece in own}
        if len(asked) == 1 and not own:
            # One that is sent alone is not answered, either.
            return
        # Who gives a request up, and sends on, gets no reply to it behind the others.
        soon = scene.timed and (asked[-1].t_ns - asked[0].t_ns < _SOON_NS or (len(asked) > _PAIR and own[:1] == asked[:1]))
        waited &= own[-1:] == asked[-1:]
        few = len(own) == 1 or len({_asked_for(piece.message)[0] for piece in asked}) == 1
        if few and len(own) == len(replies) < len(asked) and (soon or not scene.timed):
            hasty.append((asked, [piece for piece in asked if piece not in own]))
            sooner &= scene.timed and all(other.t_ns - one.t_ns < quickest for one, other in pairwise(asked))
    failing = [piece for _, left in hasty for piece in left]
    if waited and not scene.timed:
        # Each drive may have had its time: a read of one that answers elsewhere came too soon; a motion may be silent by a
        # setting.
        drives = {address for address, _ in answered}
        failing = [piece for piece in failing if _asked_for(piece.message)[0] in drives and _reads(piece)]
        answered |= {_asked_for(piece.message) for piece in failing}
    if not (alone := any(_asked_for(p.message) in answered for p in failing)):
        # What no drive ever answers may be silent by its setting, but for reads.
        names = {name for _, name in answered}
        failing = [piece for piece in failing if sooner and (_asked_for(piece.message)[1] in names or _reads(piece))]
    if len(hasty) < _OFTEN or 2 * len(hasty) <= sum(len(asked) > 1 for asked, _ in rows):
        return
    if not alone and len(failing) < 2 * _OFTEN:
        return
    (one, other, *_), _ = hasty[0]
    addresses = {piece.message.address for piece in failing if piece.message is not None}
    pause = f" after {(other.t_ns - one.t_ns) / 1e6:.3g} ms," if scene.timed else ""
    yield Suspicion(
        "too_fast", Confidence.LIKELY,
        [t for t in scene.of("unanswered", "silent_address", "late_reply", "unsolicited_reply")
         if t.piece is not None and t.piece.message is not None and t.piece.message.address in addresses]
        or [Trouble("unanswered", piece.offset, None, piece) for piece in failing],
        "The host sends several requests without waiting for their replies: few of them are answered.",
        f"{whole(other)} at byte {other.offset} follows {whole(one)}{pause} before anything comes; "
        f"{counted(len(failing), 'request')} without a reply in {counted(len(hasty), 'row')}",
        "Send one request, wait for its reply or the timeout, then send the next, also to another address",
        tuple(Shown(piece.offset, whole(piece)) for piece in failing),
    )  # fmt: skip


def _sets(message: Message | None) -> bool:
    command = message.command if message is not None else None
    return command is not None and Risk.SETTING in command.all_risks and command.motion is None


def _reads(piece: Piece) -> bool:
    command = piece.message.command if piece.message is not None else None
    return command is not None and command.all_risks == {Risk.READ}


def _piece_rows(scene: Scene) -> Iterator[tuple[list[Piece], list[Piece]]]:
    """Yield different requests that follow each other before anything comes, and the replies that come before the next one."""
    asked: list[Piece] = []
    replies: list[Piece] = []
    for piece in scene.pieces:
        if not piece.sound or not (piece.is_request or piece.is_reply):
            asked.clear()
        elif piece.is_reply:
            replies.append(piece)
        else:
            if replies:
                if asked and len({_asked_for(p.message) for p in asked}) == len(asked):
                    yield asked, replies
                asked, replies = [], []
            asked.append(piece)
    if asked and replies and len({_asked_for(p.message) for p in asked}) == len(asked):
        yield asked, replies


def _too_fast(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the pace where the requests that fail are those that came soonest after what was before them."""
    if not scene.timed:
        return
    troubles = scene.of("unanswered", "silent_address", "late_reply")
    silent = {_asked_for(t.piece.message) for t in troubles if t.piece is not None and t.piece.is_request}
    failing: list[tuple[int, Turn]] = []
    good: list[int] = []
    known: set[tuple[int, str]] = set()
    for pause, request, answered in (
        ((pause, exchange.request, answered) for chain in chains(scene) for pause, exchange, answered in _paused(chain))
        if not any(p.can for p in scene.requests)
        else _paused_on_can(scene)
    ):
        message = request.message
        if message is None or message.command is None or not (awaited(message) or _is_awaited_on_can(message)):
            continue
        if answered:
            good.append(pause)
            known.add(_asked_for(request.message))
        else:
            failing.append((pause, request))
    failing = [(pause, r) for pause, r in failing if _asked_for(r.message) in known | silent]
    if len(failing) < _OFTEN or len(good) < _OFTEN:
        return
    longest = max(pause for pause, _ in failing)
    # A drive answers each setting: no other setting silences that.
    same = all(_asked_for(request.message) in known or _sets(request.message) for _, request in failing)
    if min(good) <= longest or min(good) < 2 * longest or longest > (_LONG_NS if same else _SHORT_NS):
        return
    pause, request = failing[0]
    yield Suspicion(
        "too_fast", Confidence.LIKELY,
        # Replies are told as those of other requests where some fail.
        troubles or [Trouble("unanswered", r.offset, None, r.piece) for _, r in failing],
        "The host sends the next request too soon: only those that come after a pause are answered.",
        f"{shown(request.data)} at byte {request.offset} comes {pause / 1e6:.3g} ms after what was before it and has no reply; "
        f"{counted(len(failing), 'request')} like it, none later than {longest / 1e6:.3g} ms; those that are answered come "
        f"after {min(good) / 1e6:.3g} ms or more",
        f"Wait for each reply, and then {2 * longest / 1e6:.3g} ms, before the next request",
        tuple(Shown(r.offset, shown(r.data)) for _, r in failing),
    )  # fmt: skip


def _while_restarting(scene: Scene) -> Iterator[Suspicion]:
    """Suspect requests behind a restart, of which a drive answers none for a while, and then all again."""
    again = sent_again(scene)
    for at, piece in enumerate(scene.pieces):
        message = piece.message
        if (
            message is None
            or message.command is None
            or message.command.verb not in _RESTARTS
            or piece.sequence not in scene.replies
        ):
            continue
        behind = [p for p in scene.pieces[at + 1 :] if p.message is not None and p.message.address == message.address]
        behind = behind[1:] if behind and behind[0].is_reply else behind
        silent = list(takewhile(lambda p: p.is_request or p in again, behind))
        # The last of them is answered.
        if len(silent) <= _OFTEN or len(silent) == len(behind):
            continue
        failing = silent[:-1]
        troubles = [
            t for t in scene.of("unanswered", "silent_address", "late_reply", "unsolicited_reply")
            if t.piece in failing or (t.piece in behind and t.rule != "unanswered")
        ]  # fmt: skip
        yield Suspicion(
            "too_fast", Confidence.LIKELY, troubles or [Trouble("unanswered", p.offset, None, p) for p in failing],
            f"The drive restarts, and is asked before it is there again: {counted(len(failing), 'request')} have no reply.",
            f"{whole(piece)} at byte {piece.offset} restarts it; {whole(failing[0])} at byte {failing[0].offset} has none, and "
            f"{whole(silent[-1])} at byte {silent[-1].offset} has a reply",
            "Wait after a restart until the drive answers, some two seconds, before the next command",
            tuple(Shown(p.offset, whole(p)) for p in failing),
        )  # fmt: skip
        return


def _asked_for(message: Message | None) -> tuple[int, str]:
    """Return what tells one request to a drive from another, apart from its values."""
    return (-1, "") if message is None or message.command is None else (message.address, message.command.name)


def _is_awaited_on_can(message: Message) -> bool:
    """Say whether a request on CAN is answered by the drive that it is for."""
    one = message.frame.can is not None and message.address != message.frame.dialect.broadcast
    return one and message.command is not None and bool(message.command.reply_forms)


def _paused_on_can(scene: Scene) -> Iterator[tuple[int, Turn, bool]]:
    """Yield each request on CAN but the first with the pause since the drive's frame before it, and whether it is answered."""
    last: dict[tuple[int, str], int] = {}
    for piece in scene.pieces:
        message = piece.message
        if message is None or piece.can is None:
            continue
        before = last.get(drive := (piece.can.id, piece.can.port))
        last[drive] = piece.t_ns
        if piece.is_request and before is not None:
            turn = Turn(piece.offset, piece.data, piece.t_ns, Role.REQUEST, message, piece)
            yield piece.t_ns - before, turn, piece.sequence in scene.replies


def _paused(chain: Sequence[Exchange]) -> Iterator[tuple[int, Exchange, bool]]:
    """Yield each request but the first with the pause before it, and whether what comes next is its reply.

    Requests can follow each other before anything comes: each reply is that of the first of them that it can answer. One that
    is sent again was given up.
    """
    left: list[tuple[int, Exchange]] = []
    for number, exchange in enumerate(chain):
        before = chain[number - 1] if number else exchange
        last = before.received[-1] if number and before.received else before.request
        pause = exchange.request.t_ns - last.t_ns
        # Nothing more comes for the others.
        closed = (
            left if before.received or pause > _SOON_NS else [r for r in left if r[1].request.data == exchange.request.data]
        )
        yield from ((early, each, False) for early, each in closed if each is not chain[0])
        left = [row for row in left if row not in closed]
        left.append((pause, exchange))
        # A reply can come in several reads. Where nothing came, none of those that wait is asked about it.
        whole = dict.fromkeys((*(turn.data for turn in exchange.received), exchange.data)) if exchange.received else ()
        for data in whole:
            own = next((row for row in left if _can_be(data, row[1].request)), None)
            if own is not None:
                left.remove(own)
                if own[1] is not chain[0]:
                    yield (*own, True)


def _can_be(data: bytes, request: Turn) -> bool:
    """Say whether bytes are a reply to a request."""
    return request.message is not None and any(each.stands(data, 0) for each in awaited(request.message))


def _at_once(scene: Scene) -> Iterator[Suspicion]:
    """Suspect requests of Modbus that go out before the one before is answered: two in one read, or soon behind each other."""
    found = [*_glued(scene), *_overtaken(scene)]
    if len({first.offset for first, _ in found}) < (1 if scene.directed and scene.timed else _OFTEN):
        return
    first, second = found[0]
    troubles = [t for t in scene.of("unanswered", "silent_address") if any(t.piece is one for pair in found for one in pair)]
    yield Suspicion(
        "too_fast", Confidence.LIKELY, troubles or [Trouble("unanswered", one.offset, None, one) for one, _ in found],
        "The host sends the next request before the reply to the one before has come.",
        f"{shown(second.data)} follows {shown(first.data)} at byte {first.offset}; {counted(len(found), 'time')}",
        "Send one request, wait for its reply or the timeout, then send the next: one queue for all that use the bus",
        tuple(Shown(one.offset, shown(one.data)) for pair in found for one in pair),
    )  # fmt: skip


def _glued(scene: Scene) -> Iterator[tuple[Piece, Piece]]:
    """Yield frames to one unit that stand in one read, of which none can be the reply to the one before it."""
    before = {other.sequence: one for one, other in pairwise(scene.pieces)}
    for burst in scene.bursts:
        for one, other in pairwise(burst.pieces):
            same_unit = one.data != other.data and one.data[:2] == other.data[:2] and _is_asked(one) and _is_asked(other)
            if same_unit and not _answers(other, one) and not _answers(one, before.get(one.sequence)):
                yield one, other


def _answers(piece: Piece, asked: Piece | None) -> bool:
    """Say whether a frame can be the reply to another, which may be a request."""
    return asked is not None and asked.message is not None and any(a.stands(piece.data, 0) for a in awaited(asked.message))


def _overtaken(scene: Scene) -> Iterator[tuple[Piece, Piece]]:
    """Yield requests to one unit with the next that comes soon behind: the reply that then comes answers only this."""
    for chain in chains(scene) if scene.timed else ():
        for before, exchange in pairwise(chain):
            one, other = before.request, exchange.request
            if one.piece is None or other.piece is None or before.received or not all(map(_is_asked, (one.piece, other.piece))):
                continue
            soon = one.data[:2] == other.data[:2] and one.data != other.data and 0 <= other.t_ns - one.t_ns < _SOON_NS
            ways = [awaited(m) if m is not None else [] for m in (one.message, other.message)]
            if soon and [any(a.stands(exchange.data, 0) for a in way) for way in ways] == [False, True]:
                yield one.piece, other.piece


#: No library gives a reply up so soon.
_SOON_NS = 150_000_000


def _is_asked(piece: Piece) -> bool:
    """Say whether a piece is a sound frame of Modbus to one unit that can be a request: eight bytes, as most have."""
    data = piece.data
    return (
        piece.sound
        and piece.can is None
        and len(data) == _REQUEST
        and data[0] > 0
        and data[1] in FUNCTIONS
        and not modbus_crc(data)
    )


_REQUEST = 8
