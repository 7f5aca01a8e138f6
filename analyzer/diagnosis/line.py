"""How the bytes left the line: another speed, swapped wires, another format, a start bit that was missed.

Theory. What a receiver reads follows from the levels on the line alone. So each wrong setting is tried on what came. `bits`
leads the bytes back to frames of any device, where the receiver is as fast as the sender or faster. A slower one skips bits.
There frames that are likely, or stand in the capture, are rendered as levels and read at each speed. The same is done with all
that the capture shows as sent. The setting that explains most of the bytes is the cause.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from difflib import SequenceMatcher
from functools import cache, reduce
from itertools import pairwise, product, takewhile
from typing import NamedTuple

from analyzer import dialects as registry
from analyzer.catalogue import Dialect, Role
from analyzer.codec import codec
from analyzer.diagnosis.bits import BEGUN, Line, Rows, levels, read, unread
from analyzer.diagnosis.exchanges import Awaited, replies_to
from analyzer.diagnosis.reader import Reader
from analyzer.diagnosis.scene import Confidence, Scene, Shown, Stretch, Suspicion, Trouble, shown
from analyzer.link.modbus import modbus_crc
from analyzer.values import counted

#: Longer stretches are noise without end.
_READ = 256
#: Bytes that must fit where one stretch alone speaks.
_LEAST = 4
#: Stretches that are looked at, and those of which one must fit.
_MOST_STRETCHES = 12
_TRIED = 5
#: Bytes that are sent for one that is read, at the same speed.
_BYTES_OF_ONE = 1.7
#: Bytes at which a search may begin in vain, of a stretch.
_MOST_STARTS = 3
#: And where it did not begin in vain before; bytes of which it makes one frame.
_STARTS_AFTER, _AT_ONCE = 10, 20
#: Addresses of the frames that are tried.
_ADDRESSES = range(1, 17)
#: Speeds that are in use.
_RATES = (9600, 19200, 25000, 38400, 57600, 115200, 256000, 500000, 1000000)
#: A sender's speed over the receiver's, from which on bytes are read otherwise.
_SLOWEST, _FASTEST = 0.15, 7.0
#: Where the middle of a receiver's bit falls on an edge it can see either level: of start bits, and of the others.
_LATE = ((-0.05, -0.05), (0.05, 0.05), (-0.05, 0.05))
#: So near to an edge a middle is on it.
_NEAR = 0.06
#: Replies that begin as those that were asked for, their share, and how many must begin differently.
_FEWEST, _ALMOST_ALL, _DISTINCT = 3, 0.8, 2
#: Bytes that are sent and bytes that are read: so many must agree, and be so different, before one comes from the other.
_SAME, _DIFFERENT = 5, 4
#: So many bytes begin alike before more is compared, and so many stand before them.
_ALIKE, _STRAY = 2, 3
#: Bytes of which one in so many differs from the others; and bits that are high in what noise makes of an idle line.
_MANY, _IDLE_BITS = 5, 6
#: Idle cells between bytes: none, or a program that sends byte by byte.
_GAPS = (0, 10)
#: The share of a sender's damaged bytes that a way has to explain.
_ENOUGH = 0.4
_BIT_7 = 0x80
#: Different bytes of which all have one parity by no chance.
_ONE_PARITY = 14
#: Bytes of a reply whose bits 7 are tried both ways.
_HIGH_BITS = 8
#: Where frames repeat, so many of what is read begin with the same byte; and so many checks fit where it is a protocol.
_BEGIN_ALIKE, _CHECKED = 0.6, 0.5
#: Characters of bytes that are text with a head or a tail.
_READABLE = 0.6
_WORD = re.compile(rb"[A-Za-z]{4}")
_PRINTED = frozenset(b"\t\n\r") | frozenset(range(0x20, 0x7F))
#: Checks that many protocols have.
_CHECKS: tuple[Callable[[bytes], bool], ...] = (
    lambda data: sum(data[:-1]) & 0xFF == data[-1],
    lambda data: sum(data[1:-1]) & 0xFF == data[-1],
    lambda data: not reduce(int.__xor__, data),
    lambda data: modbus_crc(data) == 0,
)


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
        "The sender's speed is {:g} times the receiver's.",
        "{} is {} read so",
        "Set both sides to one speed; the ratio fits {}. `servotap record serial:PORT,baud=auto` finds the speed",
    ),
}

#: Ways that leave enough to find the frame, the commonest first.
_LINES = (
    ("inverted_lines", Line(inverted=True)),
    *(("lost_start", Line(missed=cell)) for cell in range(1, 10)),
    ("wrong_parity", Line(parity=1)),
    ("wrong_baud", Line(0.5)),
    ("wrong_baud", Line(0.25)),
    *(("wrong_baud", Line(2 / 3, late=late)) for late in (-0.05, 0.05)),
)


class _Fit(NamedTuple):
    """A stretch explained: the frame that was sent first, by how many of its bytes, and how many different frames."""

    trouble: Trouble
    data: bytes
    frame: bytes
    taken: int


class _Way(NamedTuple):
    """A cause with the stretches that it explains."""

    cause: str
    ratio: float
    fits: list[_Fit]

    @property
    def taken(self) -> int:
        return sum(fit.taken for fit in self.fits)

    @property
    def different(self) -> int:
        return len({fit.frame for fit in self.fits})


class _Garbled(NamedTuple):
    """Damaged bytes, or the first of them. `replies`: what was asked for right before them."""

    trouble: Trouble
    data: bytes
    replies: Sequence[Awaited]


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the line, where no frame explains the bytes."""
    yield from _of_one_parity(scene)
    sides: dict[Role, list[_Garbled]] = defaultdict(list)
    for trouble in scene.of("damaged"):
        stretch = trouble.stretch
        if stretch is None or trouble in scene.explained or stretch.can_id is not None:
            continue
        reading = scene.reader.best(stretch.data)
        if reading is not None and reading.listed:
            # A frame of a dialect that the rest of the capture is not in came through the line as it is.
            continue
        asked = scene.asked_before(stretch.offset) if stretch.direction is not Role.REQUEST else None
        sides[stretch.direction].append(_Garbled(trouble, stretch.data[:_READ], replies_to(asked)))
    for side, came in sides.items():
        garbled = came if _all_of_seven(came) else [each for each in came if each.trouble in scene.spoiled]
        # A line that is set up wrongly lets nothing through: of each sender if the capture does not tell them apart.
        if garbled and _sound(scene, side) <= len(garbled):
            yield from _side(scene, side, garbled)


def _of_one_parity(scene: Scene) -> Iterator[Suspicion]:
    """Suspect a sender of seven bits and a parity where every byte of it has one parity: of many bytes that is no chance."""
    sides: dict[Role, list[Stretch]] = defaultdict(list)
    for burst in scene.bursts:
        if burst.can_id is None:
            sides[burst.direction].append(burst)
    for side, bursts in sides.items():
        garbled = [t for t in scene.damaged if t.stretch is not None and t.stretch.direction is side]
        different = {byte for burst in bursts for byte in burst.data}
        if not garbled or len(different) < _ONE_PARITY or len({byte.bit_count() & 1 for byte in different}) > 1:
            continue
        first = garbled[0].stretch
        assert first is not None  # chosen so
        yield Suspicion(
            "wrong_parity", Confidence.CERTAIN, [t for t in scene.troubles if scene.direction(t.offset) is side],
            _WORDS["wrong_parity"].say,
            f"{shown(first.data)} at byte {first.offset}, and all that comes, has bytes of one parity alone: "
            f"{len(different)} different ones",
            _WORDS["wrong_parity"].next,
            tuple(Shown(t.offset, shown(t.stretch.data)) for t in garbled if t.stretch is not None),
        )  # fmt: skip


def _sound(scene: Scene, side: Role) -> int:
    """Return how many frames of a sender got through."""
    sound = [p.message.role for p in scene.pieces if p.sound and p.message is not None]
    if not scene.directed:
        return min(sound.count(Role.REQUEST), sound.count(Role.REPLY))
    return sum(p.sound and scene.direction(p.offset) is side for p in scene.pieces)


def _side(scene: Scene, side: Role, all_garbled: list[_Garbled]) -> Iterator[Suspicion]:
    garbled = _most_met(all_garbled) if side is Role.UNKNOWN else all_garbled[:_MOST_STRETCHES]
    ways = [
        _Way("wrong_parity", 1.0, list(_of_seven(garbled))),
        _Way(
            "inverted_lines",
            1.0,
            [_Fit(*each[:2], frame, len(each.data)) for each in garbled if (frame := _inverted().get(each.data))],
        ),
        *_of_what_was_sent(scene, garbled),
        *(_back(scene.reader, garbled, cause, line) for cause, line in _LINES),
    ]
    best = max(ways, key=lambda way: way.taken)
    if best.taken < _ENOUGH * sum(len(each.data) for each in garbled):
        best = max((best, *_at_other_speeds(garbled), *_of_replies(garbled)), key=lambda way: way.taken)
    if best.fits and _is_told(best):
        yield _said(best, [each.trouble for each in all_garbled])
    elif _heard(scene, side) and not _sound(scene, side) and (_same_line_noise(garbled) or _no_reply_at_all(garbled)):
        yield _unknown(garbled)


def _is_told(way: _Way) -> bool:
    """Say whether a way explains several stretches, or almost all of one: at some of many speeds a check fits by chance."""
    return (
        way.cause != "wrong_baud"
        or max(way.different, len(way.fits)) > 1
        or any(fit.taken >= _ALMOST_ALL * len(fit.data) for fit in way.fits)
    )


def _heard(scene: Scene, side: Role) -> bool:
    """Say whether bytes came over the line, in answer to a host that speaks a protocol known here, if it is shown."""
    return side is not Role.REQUEST and (not scene.shows_sent or _sound(scene, Role.REQUEST) > 0)


def _most_met(garbled: list[_Garbled]) -> list[_Garbled]:
    """Return stretches that are met most often: to a listener those are requests, which say the same each time."""
    different = {each.data: each for each in reversed(garbled)}
    counts = Counter(each.data for each in garbled)
    chosen = [different[data] for data, _ in counts.most_common(_MOST_STRETCHES)]
    return sorted(chosen, key=lambda each: each.trouble.offset)


def _said(way: _Way, garbled: Sequence[Trouble]) -> Suspicion:
    words, fits = _WORDS[way.cause], way.fits
    first = max(fits, key=lambda fit: fit.taken)
    pairs = [(s, r) for s in _RATES for r in _RATES if abs(s / r - way.ratio) < 0.001 * way.ratio]
    short = max(len(fit.data) for fit in fits) < _LEAST
    sure = (way.different > 1 and not short) or first.taken > 2 * _LEAST
    weak = way.cause == "lost_start" and len(fits) == 1
    return Suspicion(
        way.cause, Confidence.CERTAIN if sure and not weak else Confidence.POSSIBLE if weak else Confidence.LIKELY,
        # What spoils different frames spoils the others too, whether or not the way back is found.
        garbled if way.different > 1 else [f.trouble for f in fits],
        words.say.format(way.ratio),
        f"{words.evidence.format(shown(first.data[: first.taken]), shown(first.frame))}, at byte {first.trouble.offset}; "
        f"{counted(len(fits), 'time')}",
        words.next.format(", ".join(f"{s} read at {r}" for s, r in pairs[:4])),
        tuple(Shown(fit.trouble.offset, shown(fit.data), shown(fit.frame)) for fit in fits),
    )  # fmt: skip


def _same_line_noise(garbled: Sequence[_Garbled]) -> bool:
    """Say whether bytes come from frames on a wrong line, though none is found: they repeat, and are no other protocol."""
    stretches = [each.data for each in garbled]
    if all(byte in _PRINTED for data in stretches for byte in data):
        return False
    if any(data[0] == reply.head[0] for _, data, replies in garbled for reply in replies):
        return False
    if _of_few_bytes(b"".join(stretches)):
        return True
    stretches = [data for data in stretches if len(data) > _ALIKE]
    if len(stretches) < _FEWEST or _framed(stretches):
        return False
    most = Counter(data[0] for data in stretches).most_common(1)[0][1]
    return most >= max(_FEWEST, _BEGIN_ALIKE * len(stretches)) and not any(
        sum(len(data) > 2 and check(data) for data in stretches) >= _CHECKED * len(stretches) for check in _CHECKS
    )


def _framed(stretches: Sequence[bytes]) -> bool:
    """Say whether different bytes have one head and one tail, or readable text: a protocol that is read as it was sent."""
    distinct = set(stretches)
    first, last = {data[:1] for data in distinct}, {data[-1:] for data in distinct}
    text = sum(byte in _PRINTED for data in distinct for byte in data)
    one_frame = len(distinct) > 1 and len(first) == len(last) == 1 and min(map(len, distinct)) > _DIFFERENT
    words = sum(_WORD.search(data) is not None for data in distinct)
    # Frames of one command, whose values differ: so much of their beginnings no two requests of a host have in common.
    by_size = [[data for data in distinct if len(data) == size] for size in set(map(len, distinct))]
    alike = any(len(rows) > 1 and len(set(_common_beginning(rows))) > _DIFFERENT for rows in by_size)
    return one_frame or alike or words > len(distinct) / 2 or text >= _READABLE * sum(map(len, distinct))


def _common_beginning(rows: Sequence[bytes]) -> bytes:
    """Return the bytes with which all rows begin."""
    return bytes(column[0] for column in takewhile(lambda column: len(set(column)) == 1, zip(*rows, strict=True)))


def _no_reply_at_all(garbled: Sequence[_Garbled]) -> bool:
    """Say whether what comes at once behind each request has nothing of a reply: none of its bytes, no letters, no check."""
    return all(
        len(data) >= _FEWEST
        and bool(replies)
        and not any(byte in data for reply in replies for byte in reply.head[:_ALIKE])
        and not all(byte in _PRINTED for byte in data)
        and not all(byte.bit_count() >= _IDLE_BITS for byte in data)
        and not any(check(data) for check in _CHECKS)
        for _, data, replies in garbled
    )


def _of_few_bytes(data: bytes) -> bool:
    """Say whether many bytes are the same few, which are not those of an idle line."""
    different = set(data)
    idle = sum(byte.bit_count() >= _IDLE_BITS for byte in data) > len(data) / 2
    return len(data) >= _MANY and _MANY * len(different) <= len(data) and not idle


def _unknown(garbled: Sequence[_Garbled]) -> Suspicion:
    first = garbled[0]
    return Suspicion(
        "wrong_baud", Confidence.POSSIBLE, [each.trouble for each in garbled],
        "Nothing that comes is a frame, or has a byte of one: the receiver is set up otherwise than the sender, most likely "
        "to another speed.",
        f"{shown(first.data)} at byte {first.trouble.offset}; {counted(len(garbled), 'time')}, and no whole frame",
        "The bytes cannot tell which; try in this order: the speed (`servotap record serial:PORT,baud=auto` finds it), A and B "
        "swapped, then parity and data bits (8N1)",
        tuple(Shown(each.trouble.offset, shown(each.data)) for each in garbled),
    )  # fmt: skip


# --- back from the bytes ------------------------------------------------------------------------------------------------


def _back(reader: Reader, garbled: Sequence[_Garbled], cause: str, line: Line) -> _Way:
    """Return what a way explains, frame after frame of each stretch."""
    fits: list[_Fit] = []
    for number, each in enumerate(garbled):
        if number == _TRIED and not fits:
            break
        frames: list[bytes] = []
        taken = at = missed = 0
        for start in _places(each.data):
            if start < at or missed >= (_STARTS_AFTER if frames else _MOST_STARTS):
                continue
            found = _sent(reader, each.data[start : start + _AT_ONCE], line, each.replies)
            if found is None:
                missed += 1
                continue
            frames.append(found[0])
            at, taken = start + found[1], taken + found[1]
        if frames and (taken >= _LEAST or fits):
            fits.append(_Fit(each.trouble, each.data, frames[0], taken))
    return _Way(cause, line.ratio, fits)


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


def _of_seven(garbled: Sequence[_Garbled]) -> Iterator[_Fit]:
    """Yield stretches of frames that lost their bits 7, to a receiver of seven bits or to a sender's parity."""
    read_all = b"".join(each.data for each in garbled)
    lost = all(byte < _BIT_7 for byte in read_all)
    parities = {byte.bit_count() & 1 for byte in read_all}
    if not (lost or len(parities) == 1) or len(set(read_all)) < _DIFFERENT:
        return
    for trouble, data, replies in garbled:
        seven = bytes(byte & 0x7F for byte in data)
        if (reply := _of_lower(seven, replies)) is not None and reply != data:
            yield _Fit(trouble, data, reply, len(data))
            continue
        frames, taken, at = [], 0, 0
        while at < len(seven):
            whole = next((w for w in _with_high_bits(seven, at) if w != data[at : at + len(w)]), None)
            if whole is not None:
                frames.append(whole)
                taken += len(whole)
            at += len(whole or b"?")
        if frames:
            yield _Fit(trouble, data, frames[0], taken)


def _of_lower(seven: bytes, replies: Sequence[Awaited]) -> bytes | None:
    """Return a reply that was asked for and has these lower bits, if its check can fit."""
    for reply in replies:
        size = len(reply.head)
        if len(seven) != reply.size or not seven.startswith(_lower(reply.head)):
            continue
        body = reply.head + seven[size : -len(reply.link.checks(seven)[-1].expected)]
        # A sum fits or not whatever the high bits are; of a CRC these are tried, as long as they are few.
        for high in range(1 << min(len(body) - size, _HIGH_BITS)):
            bits = bytes((high >> at & 1) << 7 for at in range(min(len(body) - size, _HIGH_BITS))).ljust(
                len(body) - size, b"\0"
            )
            whole = reply.link.completed(reply.head + bytes(a | b for a, b in zip(body[size:], bits, strict=True)))
            if _lower(whole) == seven:
                return whole
    return None


def _all_of_seven(garbled: Sequence[_Garbled]) -> bool:
    """Say whether all that came, of several frames, lost its bits 7: alone of what a line does a right sum can outlast that."""
    fits = list(_of_seven(garbled))
    return len(fits) == len(garbled) and len({fit.frame for fit in fits}) > 1


def _with_high_bits(seven: bytes, at: int) -> Iterator[bytes]:
    """Yield the frames at a place that have these lower bits."""
    for sent in _likely():
        if seven.startswith(_lower(sent), at) and any(b & _BIT_7 for b in sent):
            yield sent
    for frame in _by_lower_head().get(seven[at : at + _KEY], ()):
        if (whole := _of_lower(seven[at : at + frame.size], (frame,))) is not None:
            yield whole


#: First bytes by which frames are looked up.
_KEY = 2


@cache
def _by_lower_head() -> dict[bytes, list[Awaited]]:
    """Return how the frames of the catalogue begin, by the lower bits of their first bytes."""
    found: dict[bytes, list[Awaited]] = defaultdict(list)
    for dialect in registry.every():
        if dialect.bus == "can":
            continue
        link = dialect.link
        forms = [
            (command, form, role)
            for command in dialect.commands
            for role, own in ((Role.REQUEST, command.request_forms), (Role.REPLY, command.reply_forms))
            for form in own
            if not form.layout.open_ended
        ]
        for (command, form, role), address in product(forms, _ADDRESSES):
            whole = link.build(command, form, address, bytes(form.layout.byte_length), role)
            found[_lower(whole[:_KEY])].append(Awaited(whole[: link.parse(whole).start], len(whole), link))
    return found


@cache
def _lower(frame: bytes) -> bytes:
    return bytes(byte & 0x7F for byte in frame)


# --- forward from frames ------------------------------------------------------------------------------------------------


def _of_what_was_sent(scene: Scene, garbled: Sequence[_Garbled]) -> Iterator[_Way]:
    """Yield the ways in which what the capture shows as sent becomes what it shows as read."""
    known = [r.link.completed(r.head) for each in garbled for r in each.replies if len(r.head) + 2 == r.size]
    # What came spoiled tells nothing of what else came.
    spoiled = {t.offset for t in scene.damaged if t.stretch is not None and t.stretch.direction is not Role.REQUEST}
    whole = (b.data for b in scene.bursts if _SAME <= len(b.data) <= _READ and b.offset not in spoiled)
    sent = list(dict.fromkeys((*known, *whole)))[:_MOST_STRETCHES]
    lines = [*_LINES, *(("wrong_baud", Line(ratio)) for ratio in _ratios())]
    for cause, line in lines:
        fits = {}
        for frame in sent:
            for gap in _GAPS:
                came = read(levels(frame, line, gap), line)
                if came == frame:
                    continue
                for trouble, data, _ in garbled:
                    # A start that is missing is that of all bytes.
                    at = data.find(came[:_ALIKE], 0, _ALIKE if line.missed else _STRAY + _ALIKE)
                    if data != frame and at >= 0 and (same := _common(came, data[at:])):
                        fits[trouble] = _Fit(trouble, data[at:], frame, same)
        yield _Way(cause, line.ratio, list(fits.values()))


def _common(came: bytes, data: bytes) -> int:
    """Return how many bytes are the same and in the same order, if that is no chance; bytes that a pause adds do no harm."""
    blocks = SequenceMatcher(None, came.decode("latin-1"), data.decode("latin-1"), autojunk=False).get_matching_blocks()
    same = b"".join(data[block.b : block.b + block.size] for block in blocks)
    # Of few bytes almost all must agree.
    least = max(_LEAST, _ALMOST_ALL * len(data)) if len(data) <= _SAME else max(_SAME, len(data) / 2)
    return len(same) if len(same) >= least and len(set(same)) >= _DIFFERENT else 0


@cache
def _likely() -> tuple[bytes, ...]:
    """Return frames that are sent often: requests without parameters, and replies that have one value."""
    found: dict[bytes, None] = {}
    for dialect in registry.every():
        if dialect.bus == "serial":
            for frame in _of_dialect(dialect):
                found[frame] = None
    return tuple(found)


def _of_dialect(dialect: Dialect) -> Iterator[bytes]:
    link = dialect.link
    for address in _ADDRESSES:
        for command in dialect.commands:
            for form in command.request_forms:
                if not form.layout.byte_length and not form.layout.open_ended:
                    yield link.build(command, form, address, b"", Role.REQUEST)
            for form in command.reply_forms:
                size = form.layout.byte_length
                if size == 1 and command.judged:
                    for value in (0, 1, 2):
                        if codec(form.layout).matches(data := bytes((value,))):
                            yield link.build(command, form, address, data, Role.REPLY)


@cache
def _levels() -> tuple[tuple[str, ...], Rows]:
    """Return the levels of the likely frames, one by one and side by side."""
    seen = tuple(map(levels, _likely()))
    return seen, Rows(seen)


@cache
def _inverted() -> dict[bytes, bytes]:
    """Return the likely frames by what a receiver reads of them whose lines are swapped."""
    line = Line(inverted=True)
    return {came: frame for frame in _likely() if len(came := read(levels(frame, line), line)) >= _LEAST}


@cache
def _ratios() -> tuple[float, ...]:
    """Return the ratios of a sender's speed to a receiver's."""
    found: dict[float, tuple[int, int]] = {}
    for sender in _RATES:
        for receiver in _RATES:
            ratio = round(sender / receiver, 3)
            if sender != receiver and _SLOWEST < ratio < _FASTEST and not 0.95 < ratio < 1.05:
                found.setdefault(ratio, (sender, receiver))
    return tuple(found)


def _at_other_speeds(garbled: Sequence[_Garbled]) -> Iterator[_Way]:
    """Yield what each speed explains: render what is likely to be sent, and look for it."""
    heads = bytes(set().union(*(each.data for each in garbled)))
    begins = {each.data[at : at + size] for each in garbled for at in range(len(each.data)) for size in range(1, BEGUN + 1)}
    likely, (seen, rows) = _likely(), _levels()
    for ratio in _ratios():
        found: dict[Trouble, dict[bytes, bytes]] = defaultdict(dict)
        line, lates = Line(ratio), _lates(ratio)
        tried = sorted((row, number) for number, late in enumerate(lates) for row in rows.beginning(line, late, heads))
        for row, number in tried:
            came = read(seen[row], line, lates[number], begins)
            if len(set(came)) < 2:
                continue
            for trouble, data, _ in garbled:
                if came == data or (len(came) >= _LEAST and came in data):
                    found[trouble][came] = likely[row]
        fits = []
        for trouble, data, _ in garbled:
            if own := found.get(trouble):
                taken = sum(len(came) * data.count(came) for came in own)
                fits.append(_Fit(trouble, data, next(iter(own.values())), min(taken, len(data))))
        if fits and (max(len(fit.data) for fit in fits) >= _LEAST or len({fit.data for fit in fits}) > 1):
            yield _Way("wrong_baud", ratio, fits)


@cache
def _lates(ratio: float) -> tuple[tuple[float, float], ...]:
    """Return where a receiver samples: it matters where the middle of a bit falls on an edge."""
    places = [(bit + 0.5) * ratio for bit in range(9)]
    return _LATE if any(abs(place - round(place)) < _NEAR for place in places) else _LATE[:1]


def _of_replies(garbled: Sequence[_Garbled]) -> Iterator[_Way]:
    """Yield the settings with which all that came begins as the replies do that were asked for."""
    asked = [each for each in garbled if each.replies]
    for cause, line in (("inverted_lines", Line(inverted=True)), *(("wrong_baud", Line(ratio)) for ratio in _ratios())):
        fits, different, least = [], set(), _FEWEST
        for trouble, data, replies in asked:
            # The edge by which a driver is switched on is low on a line whose wires are swapped.
            heard = data.removeprefix(b"\0") if line.inverted else data
            begun = [(value, r.head, m) for r in replies for value, m in _starts(r.head, line) if _has(heard, value, m)]
            if begun:
                value, head, mask = max(begun)
                fits.append(_Fit(trouble, heard, head, len(value)))
                different.add(value)
                # Of some bits of a byte more must agree.
                least = max(least, _FEWEST if mask.count(0xFF) == len(mask) else 2 * _FEWEST)
        # Where only one speed is tried, two fitting bytes are no coincidence.
        sure = line.inverted and any(fit.taken >= _ALIKE for fit in fits)
        enough = len(fits) >= max(least, _ALMOST_ALL * len(asked)) and len(different) >= _DISTINCT
        if enough or (sure and len(fits) >= _ALMOST_ALL * len(asked)):
            yield _Way(cause, line.ratio, fits)


@cache
def _starts(head: bytes, line: Line) -> frozenset[tuple[bytes, bytes]]:
    """Return what is read of the beginning of a frame, whatever follows: bytes, and their known bits."""
    found = set()
    for late in _lates(line.ratio):
        pair = [read(levels(head + tail, line), line, late) for tail in (bytes(8), b"\xff" * 8)]
        same = bytes(0xFF & ~(a ^ b) for a, b in zip(*pair, strict=False))
        whole = sum(1 for _ in takewhile(lambda bits: bits == 0xFF, same))
        # A first byte that is known but for few bits tells something, too.
        size = whole or (1 if same and same[0].bit_count() >= _KNOWN_BITS else 0)
        if size:
            found.add((bytes(a & b for a, b in zip(pair[0], same, strict=False))[:size], same[:size]))
    return frozenset(found)


#: Bits of a first byte that tell whose it is.
_KNOWN_BITS = 5


def _has(data: bytes, value: bytes, mask: bytes) -> bool:
    """Say whether bytes begin with a value, in the bits of its mask."""
    return len(data) >= len(value) and all(a & m == b for a, b, m in zip(data, value, mask, strict=False))
