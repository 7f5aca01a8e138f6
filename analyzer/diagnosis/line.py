"""How the bytes left the line: another speed, swapped wires, another format, a start bit that was missed.

Theory. What a receiver reads follows from the levels on the line alone. So each wrong setting is tried on what came. `bits`
leads the bytes back to frames of any device, where the receiver is as fast as the sender or faster. A slower one skips bits.
There frames that are likely, or stand in the capture, are rendered as levels and read at each speed. The same is done with all
that the capture shows as sent. The setting that explains most of the bytes is the cause.
"""

from __future__ import annotations

from collections import Counter, defaultdict, deque
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

from analyzer.catalogue import Role
from analyzer.diagnosis.bits import Line, unread
from analyzer.diagnosis.exchanges import Awaited, replies_to
from analyzer.diagnosis.no_frame import no_reply_at_all, same_line_noise, unknown
from analyzer.diagnosis.reader import Reader
from analyzer.diagnosis.rendered import (
    RATES,
    Heard,
    at_other_speeds,
    misframed,
    of_exchanges,
    of_inverted,
    of_pairs,
    of_replies,
    of_what_was_sent,
    read_otherwise,
)
from analyzer.diagnosis.scene import SILENT, Confidence, Scene, Shown, Stretch, Suspicion, Trouble, shown, whole
from analyzer.diagnosis.seven_bits import all_of_seven, of_seven
from analyzer.diagnosis.ways import ALMOST_ALL, FEWEST, LEAST, LINES, MOST_READ, MOST_STRETCHES, Fit, Garbled, Way
from analyzer.link import FUNCTIONS, ModbusLink
from analyzer.values import counted

#: Stretches of which one must fit.
_TRIED = 5
#: Bytes that are sent for one that is read, at the same speed.
_BYTES_OF_ONE = 1.7
#: Bytes at which a search may begin in vain, of a stretch.
_MOST_STARTS = 3
#: And where it did not begin in vain before; bytes of which it makes one frame.
_STARTS_AFTER, _AT_ONCE = 10, 20
#: Different bytes of what a stream says again and again.
_DISTINCT = 3
#: Stretches that may be streams without pauses.
_STREAMS = 2
#: The share of a sender's damaged bytes that a way has to explain.
_ENOUGH = 0.4
#: Bytes of which one has its bit 7, whatever is sent.
_SEVENS = 40
#: Different bytes of which all have one parity by no chance.
_ONE_PARITY = 14
#: Stretches that are paired.
_MOST_PAIRED = 60
#: Different frames with 00 for each byte of one parity that are no chance.
_MISFRAMED = 2
#: The link of units whose reply begins as its request does, and a length that a short reply has.
_MODBUS, _SHORT = ModbusLink(), 8


class _Words(NamedTuple):
    say: str
    evidence: str
    next: str


_WORDS = {
    "inverted_lines": _Words(
        "The line is inverted: A and B are swapped.",
        "{} is {} with every level turned round",
        "Swap the wires A and B at the adapter (D+ and D-), or switch off the inversion of the UART",
    ),
    "lost_start": _Words(
        "The receiver misses the first start bit, and reads the frame from its next low level on.",
        "{} is {} without its first start bit",
        "Switch the receiver on before the sender begins, and the driver a bit time before the first start bit; bias the line",
    ),
    "wrong_parity": _Words(
        "One side uses a parity or seven data bits, the other eight without.",
        "{} is {} to a receiver of another format",
        "Set both sides to 8 data bits, no parity, 1 stop bit (8N1)",
    ),
    "wrong_baud": _Words(
        "The sender's speed is {:.3g} times the receiver's.",
        "{} is {} read so",
        "Set both sides to one speed; the ratio fits {}. `servotap record serial:PORT,baud=auto` finds the speed",
    ),
}


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the line, where no frame explains the bytes."""
    yield from _of_one_parity(scene)
    yield from _of_format(scene)
    yield from _of_analyzer(scene)
    sides: dict[Role, list[Garbled]] = defaultdict(list)
    for trouble in scene.of("damaged"):
        stretch = trouble.stretch
        if stretch is None or trouble in scene.explained or stretch.can_id is not None:
            continue
        reading = scene.reader.best(stretch.data)
        if reading is not None and reading.listed:
            # A frame of a dialect that the rest of the capture is not in came through the line as it is.
            continue
        asked = scene.asked_before(stretch.offset) if stretch.direction is not Role.REQUEST else None
        replies = replies_to(asked) or _begun(scene, stretch)
        # A recording that knows no pause is one stretch; its beginning tells enough.
        sides[stretch.direction].append(Garbled(trouble, stretch.data[:MOST_READ], replies))
    for side, came in sides.items():
        checked = [each.data for each in came if each.trouble.stretch is not None and each.trouble.stretch.checked]
        # Bits that shift alike leave a sum that fits.
        whole = all_of_seven(came) or (checked and read_otherwise(checked))
        garbled = came if whole else [each for each in came if not _is_checked(each)]
        # A line that is set up wrongly lets nothing through: of each sender if the capture does not tell them apart.
        seven = [] if _sound(scene, side) <= len(garbled) else _only_seven(scene, side, garbled)
        if seven:
            yield _said(Way("wrong_parity", 1.0, seven), garbled)
        elif garbled and _sound(scene, side) <= len(garbled):
            found = list(_side(scene, side, garbled))
            parts = [] if found else [part for each in garbled for part in _periods(each)]
            if len(parts) > len(garbled):
                found = [each for each in _side(scene, side, parts) if each.confidence is not Confidence.POSSIBLE]
            yield from found


def _only_seven(scene: Scene, side: Role, garbled: Sequence[Garbled]) -> list[Fit]:
    """Return what seven data bits explain where frames get through that have no byte from 80 on: no byte of the side has."""
    came = b"".join(burst.data for burst in scene.bursts if burst.direction is side and burst.can_id is None)
    fits = list(of_seven(garbled)) if garbled and len(came) >= _SEVENS and came.isascii() else []
    return fits if len({fit.trouble for fit in fits}) == len(garbled) else []


def _is_checked(garbled: Garbled) -> bool:
    return garbled.trouble.stretch is not None and garbled.trouble.stretch.checked


def _periods(garbled: Garbled) -> list[Garbled]:
    """Return a stream that says the same again and again, without pauses, as what begins so each time."""
    data = garbled.data
    grams = Counter(data[at : at + LEAST] for at in range(len(data) - LEAST + 1))
    most = max((g for g in grams if len(set(g)) >= _DISTINCT), key=lambda g: grams[g], default=b"")
    if not most or grams[most] < FEWEST:
        return [garbled]
    places = [at for at in range(len(data)) if data.startswith(most, at)]
    # What stands before it each time belongs to it.
    while places[0] > 0 and len({data[at - 1] for at in places}) == 1:
        places = [at - 1 for at in places]
    return [garbled._replace(data=data[at:stop]) for at, stop in pairwise((0, *places, len(data))) if at < stop]


def _begun(scene: Scene, stretch: Stretch) -> list[Awaited]:
    """Return how a reply begins to what was sent right before, whose check does not fit: with its address and function."""
    sent = scene.ending.get(stretch.offset)
    if sent is None or sent.direction is not Role.REQUEST or stretch.direction is not Role.REPLY:
        return []
    return [Awaited(sent.data[:2], _SHORT, _MODBUS)] if sent.data[1:2] and sent.data[1] in FUNCTIONS else []


def _of_format(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the host's parity where levels show one, and no drive answers: the manuals have none."""
    silent = [t for t in scene.of(*SILENT) if t.piece is not None and t.piece.message is not None
              and t.piece.message.command not in (None, *t.piece.message.frame.dialect.fallbacks.values())]  # fmt: skip
    with_parity = [word for word in scene.uarts if "N" not in word]
    if (
        not silent
        or len(with_parity) < len(scene.uarts)
        or not with_parity
        or any(p.is_reply and p.sound for p in scene.pieces)
    ):
        return
    first = silent[0].piece
    yield Suspicion(
        "wrong_parity", Confidence.LIKELY, silent, _WORDS["wrong_parity"].say,
        f"{whole(first)} at byte {silent[0].offset} stands on the line as {', '.join(with_parity)}; "
        f"{counted(len(silent), 'request')} unanswered",
        _WORDS["wrong_parity"].next, tuple(Shown(t.offset, whole(t.piece)) for t in silent),
    )  # fmt: skip


def _of_analyzer(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the analyzer's parity where it marks each byte as wrong whose ninth bit would be low: that is the stop bit."""
    for word in scene.uarts:
        line, _, setting = word.partition(" read as ")
        if setting and scene.pieces:
            yield Suspicion(
                "wrong_parity", Confidence.CERTAIN, scene.damaged or [Trouble("wrong_parity", scene.pieces[0].offset)],
                f"The analyzer is set to {setting}, and the line has {line}: its errors are none of the line.",
                f"a parity error stands at each byte whose ninth bit would be low by {setting}, and at no other",
                f"Set the analyzer to {line}, and decode the recording again",
            )  # fmt: skip


def _of_one_parity(scene: Scene) -> Iterator[Suspicion]:
    """Suspect a sender's parity where every byte of it has one parity: of many bytes that is no chance.

    Seven bits with a parity have it. Of eight bits the receiver takes the parity for a stop bit: bytes where it is low are
    misframed, and a system reads them as 00.
    """
    sides: dict[Role, list[Stretch]] = defaultdict(list)
    for burst in scene.bursts:
        if burst.can_id is None:
            sides[burst.direction].append(burst)
    for side, bursts in sides.items():
        garbled = [t for t in scene.damaged if t.stretch is not None and t.stretch.direction is side]
        different = {byte for burst in bursts for byte in burst.data}
        parities = {byte.bit_count() & 1 for byte in different - {0}}
        if not garbled or len(parities) > 1:
            continue
        first = garbled[0].stretch
        assert first is not None  # chosen so
        evidence = f"has bytes of one parity alone: {len(different)} different ones"
        if len(different) < _ONE_PARITY or len({byte.bit_count() & 1 for byte in different}) > 1:
            frames = misframed(*parities) if parities else {}
            found = {burst.data: frames[burst.data] for burst in bursts if burst.data in frames}
            if len(found) < _MISFRAMED or 2 * len(found) < len({burst.data for burst in bursts}):
                continue
            evidence = (
                f"is as {shown(frames[first.data]) if first.data in frames else 'a frame'} with 00 for each byte of one parity"
            )
        yield Suspicion(
            "wrong_parity", Confidence.CERTAIN, [t for t in scene.troubles if scene.direction(t.offset) is side],
            _WORDS["wrong_parity"].say,
            f"{shown(first.data)} at byte {first.offset}, and all that comes, {evidence}",
            _WORDS["wrong_parity"].next,
            tuple(Shown(t.offset, shown(t.stretch.data)) for t in garbled if t.stretch is not None),
        )  # fmt: skip


def _sound(scene: Scene, side: Role) -> int:
    """Return how many frames of a sender got through."""
    sound = [p.message.role for p in scene.pieces if p.sound and p.message is not None]
    if not scene.directed:
        return min(sound.count(Role.REQUEST), sound.count(Role.REPLY))
    return sum(p.sound and scene.direction(p.offset) is side for p in scene.pieces)


def _side(scene: Scene, side: Role, all_garbled: list[Garbled]) -> Iterator[Suspicion]:
    garbled = _most_met(all_garbled) if side is Role.UNKNOWN else all_garbled[:MOST_STRETCHES]
    # The edge by which a driver is switched on is low on a line whose wires are swapped.
    switched = [each._replace(data=each.data[1:]) for each in garbled if each.data.startswith(b"\0")]
    switched = switched if len(switched) == len(garbled) else []
    ways = [
        Way("wrong_parity", 1.0, list(of_seven(garbled))),
        *(Way("inverted_lines", 1.0, list(of_inverted(rows))) for rows in (garbled, switched)),
        Way("inverted_lines", 1.0, list(_turned_bits(scene.reader, garbled))),
        *(_back(scene.reader, switched, cause, line) for cause, line in LINES if line.inverted),
        # What a host has sent stands in its log as it was before the line.
        *(of_what_was_sent(scene, garbled) if side is not Role.REQUEST else ()),
        *(_back(scene.reader, garbled, cause, line) for cause, line in LINES),
    ]
    best = max(ways, key=lambda way: way.taken)
    if best.taken < _ENOUGH * sum(len(each.data) for each in garbled):
        best = max((best, *at_other_speeds(garbled), *of_replies(garbled)), key=lambda way: (_is_told(way), way.taken))
    told = bool(best.fits) and _is_told(best)
    if side is Role.UNKNOWN and not told and len(garbled) <= _STREAMS:
        said = list(of_exchanges(max(garbled, key=lambda each: len(each.data))))
        best, told = max(said, key=lambda way: way.taken, default=best), bool(said)
    if not told and not _sound(scene, side):
        found = max(_by_pairs(scene, side, all_garbled), key=lambda way: way.taken, default=None)
        best, told = (found, True) if found is not None else (best, told)
    if told and (side is Role.UNKNOWN or _is_met(scene, best, garbled)):
        yield _said(best, all_garbled)
    elif _heard(scene, side) and not _sound(scene, side) and all(each.trouble in scene.damaged for each in garbled):
        repeats = len({each.data for each in all_garbled}) < len(all_garbled)
        if same_line_noise(garbled, repeats=repeats) or no_reply_at_all(garbled):
            yield unknown(garbled)


def _by_pairs(scene: Scene, side: Role, garbled: Sequence[Garbled]) -> Iterator[Way]:
    """Yield the speeds at which short replies fit their requests: those that the host shows, or what a listener has read."""
    garbled = garbled[:_MOST_PAIRED]
    if side is Role.UNKNOWN:
        for rows in (garbled, garbled[1:]):
            yield from of_pairs([Heard(b"", one.data, other) for one, other in zip(rows[::2], rows[1::2], strict=False)])
    elif side is Role.REPLY:
        asked = [(scene.asked_before(each.trouble.offset), each) for each in garbled]
        yield from of_pairs([Heard(request.data, b"", each) for request, each in asked if request is not None])


def _turned_bits(reader: Reader, garbled: Sequence[Garbled]) -> Iterator[Fit]:
    """Yield what a UART explains that turns the data bits round alone, or a program that does."""
    for trouble, data, replies in garbled:
        turned = bytes(byte ^ 0xFF for byte in data)
        reading = reader.best(turned)
        if any(reply.stands(turned, 0) for reply in replies) or (reading is not None and reading.listed):
            yield Fit(trouble, data, turned, len(data))


def _is_told(way: Way) -> bool:
    """Say whether a way explains several stretches, or almost all of one: at some of many speeds a check fits by chance."""
    return (
        way.cause != "wrong_baud"
        or max(way.different, len(way.fits)) > 1
        or any(fit.taken >= ALMOST_ALL * len(fit.data) for fit in way.fits)
    )


def _is_met(scene: Scene, way: Way, garbled: list[Garbled]) -> bool:
    """Say whether a way explains most reads of a host: of a protocol that is not known here it explains some by chance.

    Of what comes at another speed only frames that are likely can be found.
    """
    if way.cause == "wrong_baud" or any(piece.sound for piece in scene.pieces):
        return True
    return len({fit.trouble for fit in way.fits}) > len(garbled) / 2


def _heard(scene: Scene, side: Role) -> bool:
    """Say whether bytes came over the line, in answer to a host that speaks a protocol known here, if it is shown."""
    return side is not Role.REQUEST and (not scene.shows_sent or _sound(scene, Role.REQUEST) > 0)


def _most_met(garbled: list[Garbled]) -> list[Garbled]:
    """Return stretches that are met most often: to a listener those are requests, which say the same each time."""
    different = {each.data: each for each in reversed(garbled)}
    counts = Counter(each.data for each in garbled)
    chosen = [different[data] for data, _ in counts.most_common(MOST_STRETCHES)]
    return sorted(chosen, key=lambda each: each.trouble.offset)


def _said(way: Way, garbled: Sequence[Garbled]) -> Suspicion:
    words, fits = _WORDS[way.cause], way.fits
    # The same bytes come from the same frame each time.
    explained = {fit.data for fit in fits}, {fit.trouble for fit in fits}
    alike = [each for each in garbled if each.data in explained[0] or each.trouble in explained[1]]
    first = max(fits, key=lambda fit: fit.taken)
    heard = first.came or first.data[: first.taken]
    pairs = [(s, r) for s in RATES for r in RATES if abs(s / r - way.ratio) < 0.001 * way.ratio]
    short = max(len(fit.data) for fit in fits) < LEAST
    sure = (way.different > 1 and not short) or first.taken > 2 * LEAST
    weak = way.cause == "lost_start" and len(fits) == 1
    return Suspicion(
        way.cause, Confidence.CERTAIN if sure and not weak else Confidence.POSSIBLE if weak else Confidence.LIKELY,
        # What spoils different frames spoils the others too, whether or not the way back is found.
        list(dict.fromkeys(each.trouble for each in (garbled if way.different > 1 else alike))),
        words.say.format(way.ratio),
        f"{words.evidence.format(shown(heard), shown(first.frame))}, at byte {first.trouble.offset}; "
        f"{counted(max(len(fits), len(alike)), 'time')}",
        words.next.format(", ".join(f"{s} read at {r}" for s, r in pairs[:4])),
        tuple(Shown(fit.trouble.offset, shown(fit.data), shown(fit.frame)) for fit in fits),
    )  # fmt: skip


def _back(reader: Reader, garbled: Sequence[Garbled], cause: str, line: Line) -> Way:
    """Return what a way explains, frame after frame of each stretch."""
    fits: list[Fit] = []
    # What is short tells something only beside another frame.
    short: list[Fit] = []
    tried: set[bytes] = set()
    for each in garbled:
        tried.add(each.data)
        if len(tried) > _TRIED and not fits:
            break
        frames: Counter[bytes] = Counter()
        came: dict[bytes, bytes] = {}
        at = missed = 0
        places = deque(_places(each.data))
        while places:
            start = places.popleft()
            if start < at or missed >= (_STARTS_AFTER if frames else _MOST_STARTS):
                continue
            found = _sent(reader, each.data[start : start + _AT_ONCE], line, each.replies)
            if found is None:
                missed += 1
                continue
            frames[found[0]] += found[1]
            at = start + found[1]
            came.setdefault(found[0], each.data[start:at])
            # A frame can begin where another ends.
            places.appendleft(at)
        own = [Fit(each.trouble, each.data, frame, taken, came[frame]) for frame, taken in frames.items()]
        if fits or frames.total() >= LEAST:
            fits += own
        elif frames.total() == len(each.data):
            short += own
    return Way(cause, line.ratio, [*short, *fits] if fits else [])


def _places(data: bytes) -> Iterator[int]:
    """Yield the places where a frame can begin: each, or in a long stream those in the pair of bytes that is met most."""
    if len(data) <= _AT_ONCE:
        yield from range(len(data) - 2)
        return
    pairs = Counter(pair for pair in pairwise(data) if pair[0] != pair[1])
    most = bytes(pairs.most_common(1)[0][0]) if pairs else data[:2]
    yield from (at for at in range(len(data) - 2) if not at or data.startswith(most, at) or data.startswith(most, at - 1))


def _sent(reader: Reader, heard: bytes, line: Line, replies: Sequence[Awaited]) -> tuple[bytes, int] | None:
    """Return the frame that became what was heard: one that was asked for, or else any."""

    def whole(sent: bytes) -> bool:
        return reader.best(sent) is not None

    for reply in replies:
        if (found := unread(heard, line, reply.begins, whole)) is not None:
            return found
    most = int(_BYTES_OF_ONE * len(heard) * line.ratio) + 3
    return unread(heard, line, lambda data: reader.begins(data, most), whole)
