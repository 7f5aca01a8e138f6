"""Who spoils what: two senders at once, a second host, two drives of one address, or noise that comes anywhere.

An exchange is a request with what came back. Where the damage falls tells the cause: on the replies of one address alone; on
what comes while the host has sent again; on starts whose ends are right; on anything. That a second host is there shows by its
requests: they are among what the host receives.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterator, Sequence
from difflib import SequenceMatcher
from itertools import combinations, pairwise, takewhile
from statistics import median_low
from typing import NamedTuple

from analyzer.catalogue import Role
from analyzer.diagnosis.exchanges import replies_to
from analyzer.diagnosis.meeting import lacks_end, meeting, overlaid
from analyzer.diagnosis.scene import Confidence, Piece, Scene, Shown, Stretch, Suspicion, Trouble, shown
from analyzer.link import modbus_crc
from analyzer.values import counted

#: Damaged replies of one address, and good exchanges of others, that are no chance; the share of its replies.
_REPLIES, _OTHERS, _SHARE = 2, 2, 0.3
#: Damaged replies with sound heads that speak for two drives where no other address is on the bus.
_HEADS, _MOST_OF, _ALMOST_ALL = 4, 0.5, 0.8
#: Bytes at the end of a reply that are right where its start was spoiled.
_TAIL, _LENGTHS = 4, 2
#: Damaged stretches that make noise likely, and how alike they must be to a frame of the bus.
_NOISE, _ALIKE, _MOST_ALIKE = 3, 0.6, 200
#: The share of the bits by which damaged bytes differ from a frame at most, and bytes that noise adds or takes away.
_FLIPPED, _GAINED, _ONE_MORE = 1 / 10, 2, 1
#: Bytes of a request that has fields.
_FORM = 8
#: Frames of a capture in which one damaged reply is what it is about.
_FEW = 4
#: Of so many frames on the bus one must be damaged.
_RARE = 200


class _Spoiled(NamedTuple):
    """Damaged bytes. `asked`: the request right before them, whose reply they should be."""

    trouble: Trouble
    stretch: Stretch
    asked: Piece | None


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the senders."""
    spoiled = [_Spoiled(t, t.stretch, _asked(scene, t.stretch)) for t in scene.spoiled if t.stretch is not None]
    found = [*_two_masters(scene, spoiled)] or [*_two_clocks(scene)]
    spoiled = [each for each in spoiled if each.trouble not in scene.explained]
    if not found and spoiled:
        found = [*_reports_meet(scene, spoiled)] or [*_report_meets(scene, spoiled)]
        found = found or [*_onto_reply(scene, spoiled)] or [*_onto_late_reply(scene, spoiled)]
        found = found or [*_two_drives(scene, spoiled), *_too_early(scene, spoiled), *_late_driver(scene, spoiled)]
    yield from found or _noise(scene, spoiled)


def _asked(scene: Scene, stretch: Stretch) -> Piece | None:
    """Return the request that damaged bytes follow, with nothing between."""
    asked = scene.asked_before(stretch.offset)
    return asked if asked is not None and asked.stop == stretch.offset and stretch.direction is not Role.REQUEST else None


def _of(spoiled: Sequence[_Spoiled]) -> tuple[list[Trouble], tuple[Shown, ...]]:
    return [s.trouble for s in spoiled], tuple(Shown(s.stretch.offset, shown(s.stretch.data)) for s in spoiled)


def _sure(count: int) -> Confidence:
    return Confidence.CERTAIN if count > 2 else Confidence.LIKELY


def _two_masters(scene: Scene, spoiled: Sequence[_Spoiled]) -> Iterator[Suspicion]:
    """Suspect a second host: requests among what the host receives, which it has not sent."""
    own: list[bytes] = []
    others = _of_same_form(scene)
    for piece in scene.pieces:
        direction = scene.direction(piece.offset)
        if piece in others or not _asks(scene, piece, direction):
            continue
        if direction is Role.REQUEST:
            own.append(piece.data)
        elif direction is Role.REPLY and piece.data not in own[-2:]:
            others.append(piece)
    # One that the host sends too may have gone astray.
    if not own or not others or (len(others) == 1 and others[0].data in own):
        return
    first = others[0]
    damage = [s for s in spoiled if s.stretch.direction is Role.REPLY]
    _, frames = _of(damage)
    theirs = {piece.message.address for piece in others if piece.message is not None}
    troubles = [
        t for t in scene.troubles
        if scene.direction(t.offset) is Role.REPLY or (t.piece is not None and t.piece.message is not None
        and t.piece.message.address in theirs) or t.rule == "unanswered"
    ]  # fmt: skip
    yield Suspicion(
        "two_masters", _sure(len(others) + 1), troubles,
        "A second host is on the bus: the host receives requests that it has not sent.",
        f"{shown(first.data)}, received at byte {first.offset}; {counted(len(others), 'time')}"
        + (f"; of what it received {counted(len(damage), 'frame')} came damaged" if damage else ""),
        "Let one host speak alone: disconnect the other, or have it ask through the first",
        (*(Shown(p.offset, shown(p.data)) for p in others), *frames),
    )  # fmt: skip


def _two_clocks(scene: Scene) -> Iterator[Suspicion]:
    """Suspect a second host where a listener hears two requests by clocks of their own, and what fails is where they meet."""
    if scene.directed or not scene.timed or any(piece.can is not None for piece in scene.pieces):
        return
    times: dict[bytes, list[int]] = defaultdict(list)
    for piece in scene.requests:
        times[piece.data].append(piece.t_ns)
    clocks: list[_Clock] = []
    for data, own in times.items():
        if period := _period(own):
            # What one host asks in a loop has one period.
            clock = next((each for each in clocks if abs(each.period - period) < _ALIKE_CLOCKS * period), None)
            if clock is None:
                clocks.append(_Clock(data, period, [own]))
            else:
                clock.times.append(own)
    taken = [came[-1].t_ns - p.t_ns for p in scene.requests if (came := scene.replies.get(p.sequence))]
    for one, other in combinations(clocks[:_CLOCKS], 2):
        if not one.apart(other):
            continue
        met = [t for t in scene.troubles if all(clock.off(_when(t)) < 2 * max(taken, default=0) for clock in (one, other))]
        if len(met) < _REPLIES or len(met) < _ALMOST_ALL * len(scene.troubles):
            continue
        yield Suspicion(
            "two_masters", Confidence.LIKELY, met,
            "Two hosts ask by clocks of their own: what fails is where they meet.",
            f"{shown(one.data)} comes each {one.period / 1e6:.4g} ms and {shown(other.data)} each {other.period / 1e6:.4g} ms; "
            f"{counted(len(met), 'failure')}, the first at byte {met[0].offset}",
            "Let one host speak alone: disconnect the other; if one program does both, have it wait for each reply",
        )  # fmt: skip
        return


class _Clock(NamedTuple):
    """What comes by one clock: its first request, and the times of each of them."""

    data: bytes
    period: int
    times: list[list[int]]

    def off(self, t_ns: int) -> int:
        """Return how far a time is from the nearest tick."""
        return min(min(off % self.period, -off % self.period) for off in (t_ns - _nearest(own, t_ns) for own in self.times))

    def apart(self, other: _Clock) -> bool:
        """Say whether another clock runs by itself: its ticks fall anywhere between the ticks of this one."""
        slow, fast = sorted((self, other), key=lambda clock: -clock.period)
        phases = {_PHASES * ((time - fast.times[0][0]) % fast.period) // fast.period for time in slow.times[0]}
        return len(phases) >= _PHASES // 2


def _nearest(times: Sequence[int], t_ns: int) -> int:
    at = bisect_right(times, t_ns)
    return min(times[max(at - 1, 0) : at + 1], key=lambda time: abs(t_ns - time))


def _period(times: Sequence[int]) -> int:
    """Return the period by which most of some times come, 0 if they come by none; one may be missing here and there."""
    steps = [after - before for before, after in pairwise(times)]
    period = median_low(steps) if len(steps) >= _TICKS else 0
    kept = sum(abs(step - period) <= _JITTER * period for step in steps)
    return period if kept >= _ALMOST_ALL * len(steps) else 0


def _when(trouble: Trouble) -> int:
    where = trouble.piece or trouble.stretch
    return where.t_ns if where is not None else 0


#: Steps of a clock that are no chance, and how far they may be from each other; parts of a period that phases fall into.
_TICKS, _JITTER, _PHASES = 8, 0.03, 10
#: Clocks that are compared, and how near two periods are one.
_CLOCKS, _ALIKE_CLOCKS = 6, 0.005


def _asks(scene: Scene, piece: Piece, direction: Role) -> bool:
    """Say whether a piece is a request, of this host or of another."""
    if piece.can is not None or not piece.is_request:
        # What the host receives is taken for a reply, where the bytes alone do not tell: as one it has a wrong length.
        taken = direction is Role.REPLY and piece.can is None and "wrong_length" in piece.rules
        return piece.is_request or (taken and scene.reader.best(piece.data, role=Role.REQUEST) is not None)
    # A register or a length that the manual does not have makes a request no less one, where a CRC says so.
    return piece.sound or modbus_crc(piece.data) == 0


def _of_same_form(scene: Scene) -> list[Piece]:
    """Return received frames that differ from what the host sends by their unit alone, for units that it did not ask last."""
    forms: set[bytes] = set()
    found: list[Piece] = []
    asked = -1
    for piece in scene.pieces:
        data, direction = piece.data, scene.direction(piece.offset)
        if piece.can is not None or len(data) < _FORM or modbus_crc(data):
            continue
        if direction is Role.REQUEST:
            forms.add(data[1:-2])
            asked = data[0]
        elif direction is Role.REPLY and data[0] != asked:
            found.append(piece)
    same = [piece for piece in found if piece.data[1:-2] in forms]
    return same if len({piece.data[0] for piece in same}) > 1 else []


def _two_drives(scene: Scene, spoiled: Sequence[_Spoiled]) -> Iterator[Suspicion]:
    """Suspect two drives of one address: damage in its replies alone."""
    damaged: dict[int, list[_Spoiled]] = defaultdict(list)
    for each in spoiled:
        if each.asked is None or each.asked.message is None:
            # Damage elsewhere is not of one drive.
            return
        damaged[each.asked.message.address].append(each)
    if len(damaged) != 1:
        yield from _all_doubled(scene, spoiled)
        return
    address, own = damaged.popitem()
    replies = [p.message.address for p in scene.pieces if p.is_reply and p.sound and p.message is not None]
    good, others = replies.count(address), len(replies) - replies.count(address)
    share = len(own) / (len(own) + good)
    heads = sum(_head_is_right(each) for each in own)
    alone = others >= _OTHERS and len(own) >= _REPLIES and share >= _SHARE
    values = not alone and heads == len(own) and _differ_in_value(scene, own)
    if not alone and not (heads == len(own) >= _HEADS and share >= _MOST_OF) and not values:
        return
    troubles, frames = _of(own)
    first = own[0]
    assert first.asked is not None  # kept with its request
    # A second drive answers each request: one that is answered well as often as not may collide with something else.
    sure = _sure(min(len(own), others)) if alone and good < len(own) else Confidence.POSSIBLE
    sure = Confidence.LIKELY if values else sure
    yield Suspicion(
        "duplicate_address", sure, troubles,
        f"Two drives have the address {address} and answer at once.",
        f"{shown(first.stretch.data)} at byte {first.stretch.offset} answers {shown(first.asked.data)}; "
        f"{len(own)} of {len(own) + good} replies of address {address} damaged"
        + (f", none of {others} of others" if others else ", all with sound heads")
        + (", and none of those that say the same each time" if values else ""),
        f"Disconnect one drive after the other and ask address {address} again; give each drive its own address. "
        "If only one has it, look at its wire and its connector",
        frames,
    )  # fmt: skip


def _differ_in_value(scene: Scene, spoiled: Sequence[_Spoiled]) -> bool:
    """Say whether some requests get replies of the right length with damage, and all others always the same whole reply.

    Two drives that answer at once are read as one where they say the same. Noise would hit those replies, too.
    """
    whole: dict[bytes, list[bytes]] = defaultdict(list)
    for request in scene.requests:
        whole[request.data] += [reply.data for reply in scene.replies.get(request.sequence, ()) if reply.sound]
    damaged: dict[bytes, int] = defaultdict(int)
    for each in spoiled:
        if not any(len(each.stretch.data) == reply.size for reply in replies_to(each.asked)) or each.asked is None:
            return False
        damaged[each.asked.data] += 1
    same = [replies for data, replies in whole.items() if data not in damaged and len(replies) > 1]
    often = all(count >= _HEADS and count > len(whole[data]) for data, count in damaged.items())
    return often and all(len(set(replies)) == 1 for replies in same) and sum(map(len, same)) >= max(len(spoiled), 2 * _HEADS)


def _all_doubled(scene: Scene, spoiled: Sequence[_Spoiled]) -> Iterator[Suspicion]:
    """Suspect two drives of each address: replies begin as they should, for both send their heads, and then are damaged."""
    good = sum(piece.is_reply and piece.sound for piece in scene.pieces)
    right = sum(map(_head_is_right, spoiled))
    if right < _HEADS or right < _ALMOST_ALL * len(spoiled) or len(spoiled) < _MOST_OF * (len(spoiled) + good):
        return
    troubles, frames = _of(spoiled)
    addresses = sorted({s.asked.message.address for s in spoiled if s.asked is not None and s.asked.message is not None})
    yield Suspicion(
        "duplicate_address", Confidence.POSSIBLE, troubles,
        f"Two drives answer at each of the addresses {', '.join(map(str, addresses))} at once.",
        f"{frames[0].data} at byte {frames[0].offset}; {len(spoiled)} of {len(spoiled) + good} replies damaged, {right} with "
        "sound heads",
        "Disconnect half of the drives, and ask again; give each drive its own address",
        frames,
    )  # fmt: skip


def _head_is_right(spoiled: _Spoiled) -> bool:
    """Say whether a reply begins as it should, or as two do that begin a little apart."""
    assert spoiled.asked is not None  # of one address
    data = spoiled.stretch.data
    return any(data[:_BEGUN] == reply.head[:_BEGUN] or data[0] in overlaid(reply.head) for reply in replies_to(spoiled.asked))


#: Bytes of a beginning that are compared.
_BEGUN = 2


def _too_early(scene: Scene, spoiled: Sequence[_Spoiled]) -> Iterator[Suspicion]:
    """Suspect a host that sends again while a reply is coming: two sendings in a row, and then damage."""
    bursts = scene.bursts if scene.directed else ()
    hasty = {
        burst.offset
        for before, last, burst in zip(bursts, bursts[1:], bursts[2:], strict=False)
        if (before.direction, last.direction, burst.direction) == (Role.REQUEST, Role.REQUEST, Role.REPLY)
    }
    own = [each for each in spoiled if each.stretch.offset in hasty]
    if len(own) < _REPLIES or len(own) < len(spoiled) / 2:
        return
    troubles, frames = _of(own)
    yield Suspicion(
        "collision", _sure(len(own)), troubles,
        "The host sends its next request while the reply to the one before is still coming: they collide.",
        f"two requests in a row, then {shown(own[0].stretch.data)} at byte {own[0].stretch.offset}; "
        f"{counted(len(own), 'time')}",
        "Wait for the reply, or for the timeout, before sending again",
        frames,
    )  # fmt: skip


def _onto_reply(scene: Scene, spoiled: Sequence[_Spoiled]) -> Iterator[Suspicion]:
    """Suspect a host that sends onto a reply: it comes damaged, and behind it a reply of another drive that none asks for."""
    own: list[tuple[_Spoiled, Piece]] = []
    for each in spoiled:
        behind = scene.behind.get(each.stretch.pieces[-1].sequence)
        if each.asked is None or each.asked.message is None or behind is None or behind.message is None or not behind.sound:
            continue
        other = behind.is_reply and behind.asked_by is None and behind.message.address != each.asked.message.address
        if other and any(abs(reply.size - len(each.stretch.data)) <= _LENGTHS for reply in replies_to(each.asked)):
            own.append((each, behind))
    if len(own) < _REPLIES or len(own) < len(spoiled) / 2:
        return
    troubles, frames = _of([each for each, _ in own])
    first, reply = own[0]
    left = {piece for _, piece in own}
    yield Suspicion(
        "collision", _sure(len(own)), [*troubles, *(t for t in scene.of("unsolicited_reply") if t.piece in left)],
        "The host sends its next request, to another drive, while a reply is still coming: they collide.",
        f"{shown(first.stretch.data)} at byte {first.stretch.offset} is damaged, and {shown(reply.data)} comes behind it, "
        f"which no request before asks for; {counted(len(own), 'time')}",
        "Wait for the reply, or for the timeout, before sending again",
        frames,
    )  # fmt: skip


def _onto_late_reply(scene: Scene, spoiled: Sequence[_Spoiled]) -> Iterator[Suspicion]:
    """Suspect a host that sends by a clock of its own: what comes damaged came late, and what came soon is whole."""
    whole = [came[0].t_ns - p.t_ns for p in scene.requests if (came := scene.replies.get(p.sequence)) and came[0].sound]
    late = [
        each.stretch.t_ns - each.asked.t_ns
        for each in spoiled
        if each.asked is not None
        and any(abs(reply.size - len(each.stretch.data)) <= _LENGTHS for reply in replies_to(each.asked))
    ]
    if not scene.timed or min(len(late), len(whole)) < _NOISE or len(late) < len(spoiled):
        return
    if min(late) < _LATER * max(whole):
        return
    troubles, frames = _of(spoiled)
    yield Suspicion(
        "collision", Confidence.LIKELY, troubles,
        "The host sends its next request while a late reply is coming: they collide.",
        f"{frames[0].data} at byte {spoiled[0].stretch.offset} is damaged and comes after {late[0] / 1e6:.3g} ms, and all "
        f"whole replies come within {max(whole) / 1e6:.3g} ms; {counted(len(late), 'time')}",
        "Wait for the reply, or for the timeout, before sending again, also to another address",
        frames,
    )  # fmt: skip


#: By so much a reply is later than all others.
_LATER = 2


def _late_driver(scene: Scene, spoiled: Sequence[_Spoiled]) -> Iterator[Suspicion]:
    """Suspect a driver that is still on when the reply begins: its start is spoiled, and its end is right."""
    replies = {p.data for p in scene.pieces if p.sound and p.can is None and (p.is_reply or not scene.directed)}
    own = []
    for each in spoiled:
        for reply in (*replies, *(whole for r in replies_to(each.asked) if (whole := r.with_head(each.stretch.data)))):
            same = _same(each.stretch.data[::-1], reply[::-1])
            near = abs(len(each.stretch.data) - len(reply)) <= _LENGTHS
            # More than one byte at the start is spoiled, or one is too many or too few.
            spoiled_start = len(each.stretch.data) - same > 1 or len(each.stretch.data) != len(reply)
            if near and spoiled_start and max(_TAIL, len(reply) / 2) <= same < min(len(each.stretch.data), len(reply)):
                own.append((each, reply))
                break
    if not own or len(own) < len(spoiled) / 2 or any(_same(e.stretch.data, r) for e, r in own):
        return
    # One among many is noise.
    if len(own) < _REPLIES and len(replies) > _FEW:
        return
    troubles, frames = _of([each for each, _ in own])
    first, reply = own[0]
    yield Suspicion(
        "collision", _sure(len(own)), troubles,
        "Two senders collide at the start of the reply: the host's driver is still on when the drive begins.",
        f"{shown(first.stretch.data)} at byte {first.stretch.offset} ends as {shown(reply)} does, and begins otherwise; "
        f"{counted(len(own), 'time')}",
        "Switch the host's driver off (DE low) as soon as its last stop bit is out: wait for the transmitter to be empty, not "
        "for a fixed time",
        frames,
    )  # fmt: skip


def _reports_meet(scene: Scene, spoiled: Sequence[_Spoiled]) -> Iterator[Suspicion]:
    """Suspect two reports of a motion's end that two drives send at once."""
    own = [(each, pair) for each in spoiled if (pair := meeting(scene, each.stretch)) is not None]
    # Two at the same bit are told by every bit of them; what only begins as one and ends as the other has to come again.
    if not any(pair.whole for _, pair in own) and len(own) < _REPLIES:
        return
    troubles, frames = _of([each for each, _ in own])
    first, pair = next((row for row in own if row[1].whole), own[0])
    how = "is what a receiver reads of both" if pair.whole else "begins as one and ends as the other"
    yield Suspicion(
        "collision", _sure(len(own) + 1), troubles,
        "Two drives report the end of their motions at once, and their reports collide.",
        f"{shown(first.stretch.data)} at byte {first.stretch.offset}: {shown(pair.one)} and {shown(pair.other)} are awaited, "
        f"and it {how}; {counted(len(own), 'time')}",
        "Let the motions of drives end at different times, or switch the reports off (active = 0 in 8C) and read the status",
        frames,
    )  # fmt: skip


def _report_meets(scene: Scene, spoiled: Sequence[_Spoiled]) -> Iterator[Suspicion]:
    """Suspect the report of a motion's end, which a drive sends by itself: it never comes, and each time a reply is damaged.

    The reply is that of another drive; or the report meets the request itself, and there is no reply.
    """
    begun = [piece for piece in scene.requests if lacks_end(scene, piece)]
    starts = [piece.offset for piece in begun]
    met = {starts[at - 1] for each in spoiled if (at := bisect_right(starts, each.stretch.offset))}
    # The last motion may have gone on behind the end of the capture.
    # Noise can hit one more.
    more = len(spoiled) - len(met)
    if len(spoiled) < _REPLIES or more > (len(met) >= _NOISE) or len(met) < len(begun) - 1:
        return
    if any(each.asked is None or each.asked in begun for each in spoiled):
        return
    troubles, frames = _of(spoiled)
    yield Suspicion(
        "collision", Confidence.LIKELY if len(spoiled) >= _NOISE and not more else Confidence.POSSIBLE, troubles,
        "Two send at once: a drive reports the end of its motion while the host asks or another drive replies.",
        f"{frames[0].data} at byte {frames[0].offset} is damaged; {counted(len(begun), 'motion')} without a reported end, "
        "and behind each one reply is damaged",
        "Ask no drive while a motion runs, or switch the reports off (active = 0 in 8C) and read the status",
        frames,
    )  # fmt: skip


def _same(one: bytes, other: bytes) -> int:
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(one, other, strict=False)))


def _noise(scene: Scene, spoiled: Sequence[_Spoiled]) -> Iterator[Suspicion]:
    """Suspect noise: frames that resemble sound ones are damaged here and there, and most get through."""
    sound = [p.data for p in scene.pieces if p.sound and p.can is None]
    # One frame of a document is written so.
    if len(spoiled) == 1 and scene.noted and not scene.timed:
        return
    # What never gets through is no noise; what does once in very many is no trouble.
    if not spoiled or len(sound) < len(spoiled) or len(spoiled) * _RARE < scene.frames:
        return
    known = list(dict.fromkeys(sound))[:_MOST_ALIKE]
    # One damaged frame in long traffic must resemble a whole one.
    told = len(sound) <= _FEW or len(spoiled) >= _REPLIES
    alike = [(each, frame) for each in spoiled if (frame := _meant(each, told) or _alike(each, known)) is not None]
    if len(alike) < _ALIKE * len(spoiled):
        return
    # Of what was sent itself all bytes are known.
    yield from _high_bits([(each, frame) for each, frame in alike if each.asked is not None and each.asked.data == frame])
    first, frame = alike[0]
    like = (
        f"resembles {shown(frame)}" if frame != first.stretch.data else "begins as its reply does, and its check does not fit"
    )
    troubles, frames = _of(spoiled)
    places = (
        "one frame is damaged"
        if len(spoiled) == 1
        else f"{len(spoiled)} frames are damaged, here and there, and the others get through"
    )
    yield Suspicion(
        "noise", Confidence.LIKELY if len(spoiled) >= _NOISE else Confidence.POSSIBLE, troubles,
        f"Noise on the line: {places}.",
        f"{shown(first.stretch.data)} at byte {first.stretch.offset} {like}; "
        f"{counted(len(spoiled), 'time')}, {counted(len(sound), 'frame')} near them sound",
        "Check the ground between host and drives, the termination (120 Ohm at both ends only) and the bias; lay the bus away "
        "from motor cables, shield it, and repeat what fails",
        frames,
    )  # fmt: skip


def _high_bits(alike: list[tuple[_Spoiled, bytes]]) -> Iterator[Suspicion]:
    """Suspect the number of data bits where each byte above a limit came changed, and none below it."""
    pairs = [(sent, came) for each, frame in alike for sent, came in zip(frame, each.stretch.data, strict=False)]
    changed = {sent for sent, came in pairs if sent != came}
    kept = {sent for sent, came in pairs if sent == came}
    # Noise hits a byte of a frame; one of each kind it hits by chance.
    each_time = all(
        len(frame) == len(each.stretch.data)
        and sum(sent != came for sent, came in zip(frame, each.stretch.data, strict=True)) >= _REPLIES
        for each, frame in alike
    )
    if not each_time or len(changed) < _REPLIES or len(kept) < _REPLIES or min(changed).bit_length() <= max(kept).bit_length():
        return
    bits = max(kept).bit_length()
    troubles, frames = _of([each for each, _ in alike])
    yield Suspicion(
        "wrong_parity", Confidence.LIKELY if len(changed) > _FEW else Confidence.POSSIBLE, troubles,
        f"Bytes up to {max(kept):02X} come as they were sent, and all above it come changed: a node has fewer data bits, or "
        "reads at another speed.",
        f"{frames[0].data} at byte {frames[0].offset} for {shown(alike[0][1])}",
        f"Set both sides to 8 data bits, no parity, 1 stop bit (8N1): {bits} bits get through; then compare their speeds",
        frames,
    )  # fmt: skip


def _meant(spoiled: _Spoiled, alike: bool) -> bytes | None:
    """Return the beginning of the reply that damaged bytes should be, where the request before tells its head and length.

    Noise has hit its head alone; or, where `alike` is enough, two bytes in a row of the head are there, or most of its bits.
    """
    data = spoiled.stretch.data
    for reply in replies_to(spoiled.asked):
        size = len(reply.head)
        pairs = (reply.head[at : at + 2] for at in range(size - 1))
        begun = data[: size + _GAINED]
        begins = alike and (any(pair in begun for pair in pairs) or _near(reply.head, data[:size]))
        if reply.with_head(data) or (begins and abs(len(data) - reply.size) <= _GAINED):
            return reply.head + data[size:]
    return None


def _near(frame: bytes, data: bytes) -> bool:
    """Say whether bytes are a frame but for few bits."""
    differ = int.from_bytes(frame) ^ int.from_bytes(data)
    return len(frame) == len(data) and differ.bit_count() <= _FLIPPED * 8 * len(frame)


def _alike(spoiled: _Spoiled, known: Sequence[bytes]) -> bytes | None:
    """Return the sound frame that damaged bytes resemble most, if they do."""
    matcher = SequenceMatcher(autojunk=False)
    matcher.set_seq2(spoiled.stretch.data.decode("latin-1"))
    best: tuple[float, bytes] = (_ALIKE, b"")
    for frame in known:
        # Noise changes bytes, and makes one more or less of them.
        if abs(len(frame) - len(spoiled.stretch.data)) > _ONE_MORE:
            continue
        if _near(frame, spoiled.stretch.data):
            return frame
        matcher.set_seq1(frame.decode("latin-1"))
        if matcher.real_quick_ratio() > best[0] and matcher.quick_ratio() > best[0]:
            best = max(best, (matcher.ratio(), frame))
    return best[1] or None
