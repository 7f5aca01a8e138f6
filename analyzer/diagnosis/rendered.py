"""What frames become on a line: rendered as levels, and read at each speed.

Frames that are likely, those that stand in the capture, and the beginnings of the replies that were asked for.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from difflib import SequenceMatcher
from functools import cache, lru_cache
from itertools import takewhile
from typing import NamedTuple

from analyzer import dialects as registry
from analyzer.catalogue import Command, Dialect, Role
from analyzer.codec import codec
from analyzer.diagnosis.bits import BEGUN, NEAR, Line, Rows, levels, read
from analyzer.diagnosis.scene import Scene
from analyzer.diagnosis.ways import (
    ALIKE,
    ALMOST_ALL,
    DIFFERENT,
    FEWEST,
    LEAST,
    LINES,
    MOST_READ,
    MOST_STRETCHES,
    Fit,
    Garbled,
    Way,
)

#: Addresses of the frames that are tried, at each speed and on swapped wires.
ADDRESSES, _ADDRESSES = range(1, 17), range(1, 33)
#: Speeds that are in use.
RATES = (9600, 19200, 25000, 38400, 57600, 115200, 256000, 500000, 1000000)
#: A sender's speed over the receiver's, from which on bytes are read otherwise.
_SLOWEST, _FASTEST = 0.15, 7.0
#: Where the middle of a receiver's bit falls on an edge it can see either level: of start bits, and of the others.
_LATE = ((-0.05, -0.05), (0.05, 0.05), (-0.05, 0.05))
#: How many replies must begin differently where their beginnings alone fit.
_DISTINCT = 2
#: Bytes that are sent and bytes that are read: so many must agree before one comes from the other.
_SAME = 5
#: So often bytes must come in one stretch that are fewer.
_AGAIN = 2
#: Searches that are kept: what one hypothesis asks another asks again.
_KEPT = 4
#: Stray bytes that may stand before.
_STRAY = 3
#: Idle cells between bytes: none, or a program that sends byte by byte.
_GAPS = (0, 10)


def of_what_was_sent(scene: Scene, garbled: Sequence[Garbled]) -> Iterator[Way]:
    """Yield the ways in which what the capture shows as sent becomes what it shows as read."""
    known = [r.link.completed(r.head) for each in garbled for r in each.replies if len(r.head) + 2 == r.size]
    # What came spoiled tells nothing of what else came.
    spoiled = {t.offset for t in scene.damaged if t.stretch is not None and t.stretch.direction is not Role.REQUEST}
    whole = (b.data for b in scene.bursts if _SAME <= len(b.data) <= MOST_READ and b.offset not in spoiled)
    sent = list(dict.fromkeys((*known, *whole)))[:MOST_STRETCHES]
    lines = [*LINES, *(("wrong_baud", Line(ratio)) for ratio in _ratios())]
    for cause, line in lines:
        fits = {}
        for frame in sent:
            for gap in _GAPS:
                came = read(levels(frame, line, gap), line)
                if came == frame:
                    continue
                for trouble, data, _ in garbled:
                    # A start that is missing is that of all bytes.
                    at = data.find(came[:ALIKE], 0, ALIKE if line.missed else _STRAY + ALIKE)
                    if at < 0 and line.inverted and came[-_SAME:] in data:
                        # An edge before the first byte shifts those that follow, up to a byte that looks like a pause.
                        at = 0
                    if data != frame and at >= 0 and (same := _common(came, data[at:])):
                        fits[trouble] = Fit(trouble, data[at:], frame, same)
        yield Way(cause, line.ratio, list(fits.values()))


def _common(came: bytes, data: bytes) -> int:
    """Return how many bytes are the same and in the same order, if that is no chance; bytes that a pause adds do no harm."""
    blocks = SequenceMatcher(None, came.decode("latin-1"), data.decode("latin-1"), autojunk=False).get_matching_blocks()
    same = b"".join(data[block.b : block.b + block.size] for block in blocks)
    # Of few bytes almost all must agree.
    least = max(LEAST, ALMOST_ALL * len(data)) if len(data) <= _SAME else max(_SAME, len(data) / 2)
    return len(same) if len(same) >= least and len(set(same)) >= DIFFERENT else 0


@cache
def likely(addresses: range = ADDRESSES) -> tuple[bytes, ...]:
    """Return frames that are sent often: requests without parameters, and replies that have one value."""
    found: dict[bytes, None] = {}
    for dialect in registry.every():
        if dialect.bus == "serial":
            for frame in _of_dialect(dialect, addresses):
                found[frame] = None
    return tuple(found)


@cache
def misframed(parity: int) -> dict[bytes, bytes]:
    """Return the likely frames by what they are with 00 for each byte of the other parity; two such bytes at least."""
    found = {bytes(byte if byte.bit_count() & 1 == parity else 0 for byte in frame): frame for frame in likely()}
    return {came: frame for came, frame in found.items() if sum(a != b for a, b in zip(came, frame, strict=True)) > 1}


def _of_dialect(dialect: Dialect, addresses: range) -> Iterator[bytes]:
    link = dialect.link
    for address in addresses:
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
def _asked() -> dict[bytes, tuple[Dialect, Command, int]]:
    """Return the likely frames that are requests which a drive answers, each with its command and address."""
    found = {}
    for dialect in registry.every():
        for command in dialect.commands if dialect.bus == "serial" else ():
            for form in command.request_forms if command.reply_forms else ():
                if not form.layout.byte_length and not form.layout.open_ended:
                    for address in ADDRESSES:
                        found[dialect.link.build(command, form, address, b"", Role.REQUEST)] = dialect, command, address
    return found


@cache
def _levels() -> tuple[tuple[str, ...], Rows]:
    """Return the levels of the likely frames, one by one and side by side."""
    seen = tuple(map(levels, likely()))
    return seen, Rows(seen)


@cache
def _inverted() -> dict[bytes, bytes]:
    """Return the likely frames by what a receiver reads of them whose lines are swapped."""
    line = Line(inverted=True)
    return {came: frame for frame in likely(_ADDRESSES) if len(came := read(levels(frame, line), line)) >= LEAST}


def of_inverted(garbled: Sequence[Garbled]) -> Iterator[Fit]:
    """Yield what swapped lines explain: a stretch that is a likely frame, or has several, or begins with one as others do."""
    begun = Counter(came for _, data, _ in garbled for came in _inverted() if data.startswith(came))
    for trouble, data, _ in garbled:
        found = [came for came in _inverted() if came in data] if len(data) > LEAST else [data] if data in _inverted() else []
        if data in found or len(found) > 1 or any(begun[came] >= FEWEST and len(set(came)) >= DIFFERENT for came in found):
            yield from (Fit(trouble, data, _inverted()[came], len(came) * data.count(came), came) for came in found)


@cache
def _ratios() -> tuple[float, ...]:
    """Return the ratios of a sender's speed to a receiver's."""
    found: dict[float, tuple[int, int]] = {}
    for sender in RATES:
        for receiver in RATES:
            ratio = round(sender / receiver, 3)
            if sender != receiver and _SLOWEST < ratio < _FASTEST and not 0.95 < ratio < 1.05:
                found.setdefault(ratio, (sender, receiver))
    return tuple(found)


def at_other_speeds(garbled: Sequence[Garbled]) -> Iterator[Way]:
    """Yield what each speed explains: render what is likely to be sent, and look for it."""
    for ratio, found in _at_other_speeds(frozenset(each.data for each in garbled)):
        fits = []
        for trouble, data, _ in garbled:
            own = found.get(data, {})
            # A few bytes are found by chance, in a long stream more than once.
            if data in own or any(len(came) >= LEAST for came in own) or len(own) >= FEWEST:
                fits += [Fit(trouble, data, frame, len(came) * data.count(came), came) for came, frame in own.items()]
        if fits and (max(len(fit.data) for fit in fits) >= LEAST or len({fit.data for fit in fits}) > 1):
            yield Way("wrong_baud", ratio, fits)


def read_otherwise(sent: Sequence[bytes]) -> bool:
    """Say whether bytes that came again and again are a likely frame, read at another speed: a sum may fit all the same."""
    again = frozenset(data for data, times in Counter(sent).items() if times >= _AGAIN and len(data) >= LEAST)
    return bool(again) and any(data in own for _, found in _at_other_speeds(again) for data, own in found.items())


@lru_cache(_KEPT)
def _at_other_speeds(different: frozenset[bytes]) -> list[tuple[float, dict[bytes, dict[bytes, bytes]]]]:
    """Return what each speed finds in each of some bytes: likely frames, by what is read of them."""
    heads = bytes(set().union(*different))
    begins = {data[at : at + size] for data in different for at in range(len(data)) for size in range(1, BEGUN + 1)}
    frames, (seen, rows) = likely(), _levels()
    speeds = []
    for ratio in _ratios():
        found: dict[bytes, dict[bytes, bytes]] = defaultdict(dict)
        line, lates = Line(ratio), _lates(ratio)
        tried = sorted((row, number) for number, late in enumerate(lates) for row in rows.beginning(line, late, heads))
        for row, number in tried:
            came = read(seen[row], line, lates[number], begins)
            if len(set(came)) < 2:
                continue
            for data in different:
                again = _AGAIN if len(came) == LEAST - 1 and len(set(came)) == len(came) else 1
                if came == data or (len(came) > LEAST - again and data.count(came) >= again):
                    found[data][came] = frames[row]
        speeds.append((ratio, dict(found)))
    return speeds


@cache
def _lates(ratio: float) -> tuple[tuple[float, float], ...]:
    """Return where a receiver samples: it matters where the middle of a bit falls on an edge."""
    places = [(bit + 0.5) * ratio for bit in range(9)]
    return _LATE if any(abs(place - round(place)) < NEAR for place in places) else _LATE[:1]


def of_replies(garbled: Sequence[Garbled]) -> Iterator[Way]:
    """Yield the settings with which all that came begins as the replies do that were asked for."""
    asked = [each for each in garbled if each.replies]
    for cause, line in (("inverted_lines", Line(inverted=True)), *(("wrong_baud", Line(ratio)) for ratio in _ratios())):
        fits, different, least = [], set(), FEWEST
        for trouble, data, replies in asked:
            # The edge by which a driver is switched on is low on a line whose wires are swapped.
            heard = data.removeprefix(b"\0") if line.inverted else data
            begun = [(value, r.head, m) for r in replies for value, m in _starts(r.head, line) if _has(heard, value, m)]
            if begun:
                value, head, mask = max(begun)
                fits.append(Fit(trouble, heard, head, len(value)))
                different.add(value)
                # Where no byte is known whole, more must agree.
                least = max(least, FEWEST if 0xFF in mask else 2 * FEWEST)
        # Where only one speed is tried, two fitting bytes are no coincidence.
        sure = line.inverted and any(fit.taken >= ALIKE for fit in fits)
        enough = len(fits) >= max(least, ALMOST_ALL * len(asked)) and len(different) >= _DISTINCT
        if enough or (sure and len(fits) >= ALMOST_ALL * len(asked)):
            yield Way(cause, line.ratio, fits)


def of_exchanges(garbled: Garbled) -> Iterator[Way]:
    """Yield the speeds at which a stream says requests, each with its reply behind it, again and again.

    A slow receiver reads so little of a request that it tells nothing without the beginning of the reply.
    """
    frames, (seen, rows) = likely(), _levels()
    data = garbled.data
    counts = Counter(data[at : at + size] for at in range(len(data)) for size in range(1, BEGUN + 1))
    begins = {value for value, count in counts.items() if count >= FEWEST}
    heads = bytes({value[0] for value in begins})
    for ratio, late in ((r, late) for r in _ratios() if r >= _SKIPS for late in _lates(r)):
        line, found, said = Line(ratio), {}, 0
        for row in rows.beginning(line, late, heads) if heads else ():
            frame, came = frames[row], read(seen[row], line, late, begins)
            if len(came) < ALIKE or frame not in _asked():
                continue
            for value, mask, _ in _replies(frame, line, late):
                whole, known = came + value, b"\xff" * len(came) + mask
                places = [at for at in range(len(data)) if data.startswith(came, at) and _has(data[at:], whole, known)]
                told = sum(map(int.bit_count, known)) >= _TOLD and len(set(whole)) >= DIFFERENT
                if told and len(places) >= FEWEST and whole not in found:
                    found[whole] = Fit(garbled.trouble, data, frame, len(whole), whole)
                    said += len(whole) * len(places)
        if said >= _MUCH * len(data):
            yield Way("wrong_baud", ratio, list(found.values()))


class Heard(NamedTuple):
    """A damaged reply with its request: as it was sent, or empty and what was read of it."""

    sent: bytes
    read: bytes
    reply: Garbled


def of_pairs(pairs: Sequence[Heard]) -> Iterator[Way]:
    """Yield the speeds at which each reply of one drive, however few bytes are read of it, is one to the request before it.

    A slow receiver reads a byte or two of a frame: little alone, but at a wrong speed no such row of them fits.
    """
    different = {(each.sent or each.read, each.reply.data) for each in pairs}
    if len(pairs) < _PAIRS or len(different) < _DIFFERENT_PAIRS:
        return
    frames, (seen, rows) = likely(), _levels()
    heads = bytes({each.read[0] for each in pairs if not each.sent})
    for ratio, late in ((r, late) for r in _ratios() if r >= _SKIPS for late in _lates(r)):
        line = Line(ratio)
        requests: dict[bytes, list[bytes]] = defaultdict(list)
        for row in rows.beginning(line, late, heads) if heads else ():
            requests[read(seen[row], line, late)].append(frames[row])
        told: dict[tuple[str, int], dict[bytes, float]] = defaultdict(dict)
        fits: dict[tuple[str, int], dict[int, Fit]] = defaultdict(dict)
        for number, each in enumerate(pairs):
            for request in (each.sent,) if each.sent else requests[each.read]:
                if request not in _asked():
                    continue
                dialect, _, address = _asked()[request]
                drive = dialect.name, address
                for value, mask, frame in _replies(request, line, late):
                    kept = fits[drive].get(number)
                    if value and _has(each.reply.data, value, mask) and (kept is None or len(value) > kept.taken):
                        more = 0.0 if each.sent else _told(each.read, b"\xff" * len(each.read)) - _AMONG_REQUESTS
                        told[drive][request] = max(told[drive].get(request, 0.0), _told(value, mask) - _AMONG_REPLIES + more)
                        fits[drive][number] = Fit(each.reply.trouble, each.reply.data, frame, len(value))
        for drive, own in fits.items():
            if sum(told[drive].values()) >= _TOLD_BY_PAIRS and len(told[drive]) > 1 and len(own) >= _ALL_PAIRS * len(pairs):
                yield Way("wrong_baud", ratio, list(own.values()))


def _told(value: bytes, mask: bytes) -> float:
    """Return how many bits some bytes tell; all zeros or ones are met often."""
    bits = sum(map(int.bit_count, mask))
    return bits / 2 if set(value) <= {0x00, 0xFF} else bits


#: Replies that tell something together, how many must be different, and how many must fit; bits that they must tell.
_PAIRS, _DIFFERENT_PAIRS, _ALL_PAIRS, _TOLD_BY_PAIRS = 5, 4, 0.9, 7
#: Bits by which one of a drive's requests is chosen, and one of its replies.
_AMONG_REQUESTS, _AMONG_REPLIES = 4, 3


def _replies(request: bytes, line: Line, late: tuple[float, float]) -> Iterator[tuple[bytes, bytes, bytes]]:
    """Yield how replies to a likely request are read: bytes, those of their bits that are known, and what was sent so far.

    A reply of one value is known whole; of a longer one two bytes of a number near zero.
    """
    dialect, command, address = _asked()[request]
    for form in command.reply_forms:
        size = form.layout.byte_length
        for value in range(_VALUES) if size == 1 else (0x00, 0xFF):
            whole = dialect.link.build(command, form, address, bytes((value,)) * size, Role.REPLY)
            known = whole if size == 1 else whole[: dialect.link.parse(whole).start + ALIKE]
            rest = len(whole) - len(known)
            ways = [read(levels(known + tail * rest), line, late) for tail in (b"\0", b"\xff", b"\x55")]
            same = bytes(0xFF & ~((a ^ b) | (a ^ c)) for a, b, c in zip(*ways, strict=False))
            size_known = max((n for n, mask in enumerate(same, 1) if mask), default=0)
            yield bytes(a & m for a, m in zip(ways[0], same, strict=False))[:size_known], same[:size_known], known


#: A sender's speed over the receiver's from which on whole bits are skipped.
_SKIPS = 1.5
#: Bits that an exchange must have in common with a stream, and the share of the stream that has to be such exchanges.
_TOLD, _MUCH = 28, 0.4
#: Values of one byte that replies have.
_VALUES = 8


@cache
def _starts(head: bytes, line: Line) -> frozenset[tuple[bytes, bytes]]:
    """Return how the beginning of a frame is read: bytes, and those of their bits that no later byte changes."""
    found = set()
    for late in _lates(line.ratio):
        pair = [read(levels(head + tail, line), line, late) for tail in (bytes(8), b"\xff" * 8)]
        same = bytes(0xFF & ~(a ^ b) for a, b in zip(*pair, strict=False))
        whole = sum(1 for _ in takewhile(lambda bits: bits == 0xFF, same))
        # A byte that is known but for few bits tells something, too; behind zeros or ones alone it does not.
        more = whole < len(same) and same[whole].bit_count() >= _KNOWN_BITS
        more &= not whole or any(0 < byte < 0xFF for byte in pair[0][:whole])
        for size in {whole, whole + more} - {0}:
            found.add((bytes(a & b for a, b in zip(pair[0], same, strict=False))[:size], same[:size]))
    return frozenset(found)


#: Bits of a byte that tell whose it is.
_KNOWN_BITS = 5


def _has(data: bytes, value: bytes, mask: bytes) -> bool:
    """Say whether bytes begin with a value, in the bits of its mask."""
    return len(data) >= len(value) and all(a & m == b for a, b, m in zip(data, value, mask, strict=False))
