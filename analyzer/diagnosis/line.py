"""How the bytes left the line: another speed, swapped wires, another format, a start bit that was missed.

Theory. What a receiver reads of a frame follows from the levels on the line alone, so each way of being set up wrongly is tried
on what came. `bits` leads the bytes back to frames, of any device, where the receiver is as fast as the sender or faster. A
slower one skips bits: there frames that are likely, or stand in the capture, are rendered as levels and read at each speed. The
same is done with what the capture shows as sent, whatever it is. The way that gives most of the bytes is the cause.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import takewhile
from typing import NamedTuple

from analyzer import dialects as registry
from analyzer.catalogue import Dialect, Role
from analyzer.codec import codec
from analyzer.diagnosis.bits import Line, levels, read, unread
from analyzer.diagnosis.exchanges import Awaited, replies_to
from analyzer.diagnosis.reader import Reader
from analyzer.diagnosis.scene import Confidence, Scene, Shown, Suspicion, Trouble, shown
from analyzer.values import counted

#: Longer stretches are noise without end.
_READ = 256
#: Bytes that must fit where one stretch alone speaks.
_LEAST = 4
#: Stretches that are looked at, and those of which one must fit.
_MOST_STRETCHES = 12
_TRIED = 3
#: Bytes that are sent for one that is read, at the same speed.
_BYTES_OF_ONE = 1.7
#: Bytes at which a search may begin in vain, of a stretch.
_MOST_STARTS = 2
#: Addresses of the frames that are tried.
_ADDRESSES = range(1, 17)
#: Speeds that are in use.
_RATES = (9600, 19200, 25000, 38400, 57600, 115200, 256000, 500000, 1000000)
#: A sender's speed over the receiver's, from which on bytes are read otherwise.
_SLOWEST, _FASTEST = 0.15, 7.0
#: Where the middle of a receiver's bit falls on an edge it can see either level: of start bits, and of the others.
_LATE = ((-0.05, -0.05), (0.05, 0.05), (-0.05, 0.05))
#: Bytes that are sent and bytes that are read: so many must agree, and be so different, before one comes from the other.
_SAME, _DIFFERENT = 5, 3
#: Idle cells between bytes: none, or a program that sends byte by byte.
_GAPS = (0, 10)
#: The share of a sender's damaged bytes that a way has to explain.
_ENOUGH = 0.4
_BIT_7 = 0x80


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
        "Set both sides to one speed; the ratio fits {}. `servotap record PORT:auto` finds the speed",
    ),
}

#: Ways that leave enough to find the frame, the commonest first.
_LINES = (
    ("inverted_lines", Line(inverted=True)),
    *(("lost_start", Line(missed=cell)) for cell in range(1, 10)),
    ("wrong_parity", Line(parity=1)),
    ("wrong_baud", Line(0.5)),
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


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the line, where no frame explains the bytes."""
    garbled = [
        t
        for t in scene.damaged
        if t not in scene.explained and t.stretch is not None and t.stretch.can_id is None and 1 < len(t.stretch.data) <= _READ
    ]
    for side in dict.fromkeys(t.stretch.direction for t in garbled if t.stretch is not None):
        own = [t for t in garbled if t.stretch is not None and t.stretch.direction is side]
        # A line that is set up wrongly lets nothing through: of each sender if the capture does not tell them apart.
        if _sound(scene, side) <= len(own):
            yield from _side(scene, own[:_MOST_STRETCHES])


def _sound(scene: Scene, side: Role) -> int:
    """Return how many frames of a sender got through."""
    sound = [p.message.role for p in scene.pieces if p.sound and p.message is not None]
    if not scene.directed:
        return min(sound.count(Role.REQUEST), sound.count(Role.REPLY))
    return sum(p.sound and scene.direction(p.offset) is side for p in scene.pieces)


def _side(scene: Scene, garbled: list[Trouble]) -> Iterator[Suspicion]:
    ways = [
        *_of_what_was_sent(scene, garbled),
        *(_back(scene, garbled, cause, line) for cause, line in _LINES),
        _Way("wrong_parity", 1.0, list(_of_seven(scene.reader, garbled))),
    ]
    size = sum(len(t.stretch.data) for t in garbled if t.stretch is not None)
    best = max(ways, key=lambda way: way.taken)
    if best.taken < _ENOUGH * size:
        best = max((best, *_at_other_speeds(garbled)), key=lambda way: way.taken)
    if best.fits:
        yield _said(best, garbled)


def _said(way: _Way, garbled: Sequence[Trouble]) -> Suspicion:
    words, fits = _WORDS[way.cause], way.fits
    first = max(fits, key=lambda fit: fit.taken)
    pairs = [(s, r) for s in _RATES for r in _RATES if abs(s / r - way.ratio) < 0.001 * way.ratio]
    sure = way.different > 1 or first.taken > 2 * _LEAST
    return Suspicion(
        way.cause, Confidence.CERTAIN if sure else Confidence.LIKELY,
        # What spoils different frames spoils the others too, whether or not the way back is found.
        garbled if way.different > 1 else [f.trouble for f in fits],
        words.say.format(way.ratio),
        f"{words.evidence.format(shown(first.data[: first.taken]), shown(first.frame))}, at byte {first.trouble.offset}; "
        f"{counted(len(fits), 'time')}",
        words.next.format(", ".join(f"{s} read at {r}" for s, r in pairs[:4])),
        tuple(Shown(fit.trouble.offset, shown(fit.data), shown(fit.frame)) for fit in fits),
    )  # fmt: skip


# --- back from the bytes ------------------------------------------------------------------------------------------------


def _back(scene: Scene, garbled: Sequence[Trouble], cause: str, line: Line) -> _Way:
    """Return what a way explains, frame after frame of each stretch."""
    fits: list[_Fit] = []
    for number, trouble in enumerate(garbled):
        if number == _TRIED and not fits:
            break
        assert trouble.stretch is not None  # chosen so
        data = trouble.stretch.data
        frames, taken, at, starts = [], 0, 0, 0
        asked = scene.asked_before(trouble.offset) if trouble.stretch.direction is not Role.REQUEST else None
        while at + 2 < len(data) and starts < _MOST_STARTS:
            found = _sent(scene.reader, data[at:], line, replies_to(asked))
            if found is None:
                at, starts = at + 1, starts + 1
                continue
            frames.append(found[0])
            at, taken = at + found[1], taken + found[1]
        if frames and (taken >= _LEAST or fits):
            fits.append(_Fit(trouble, data, frames[0], taken))
    return _Way(cause, line.ratio, fits)


def _sent(reader: Reader, heard: bytes, line: Line, replies: Sequence[Awaited]) -> tuple[bytes, int] | None:
    """Return the frame that became what was heard: one that was asked for, or else any."""

    def whole(sent: bytes) -> bool:
        return reader.best(sent) is not None

    for reply in replies:
        if (found := unread(heard, line, reply.begins, whole)) is not None:
            return found
    most = int(_BYTES_OF_ONE * len(heard) * line.ratio) + 3
    return unread(heard, line, lambda data: reader.begins(data, most), whole)


def _of_seven(reader: Reader, garbled: Sequence[Trouble]) -> Iterator[_Fit]:
    """Yield stretches of frames that lost their bits 7, to a receiver of seven bits or to a sender's parity."""
    read_all = b"".join(t.stretch.data for t in garbled if t.stretch is not None)
    lost = all(byte < _BIT_7 for byte in read_all)
    even = not any(byte.bit_count() & 1 for byte in read_all)
    if not (lost or even) or len(set(read_all)) < _DIFFERENT:
        return
    for trouble in garbled:
        assert trouble.stretch is not None  # chosen so
        data = trouble.stretch.data
        seven = bytes(byte & 0x7F for byte in data)
        frames, taken, at = [], 0, 0
        while at < len(seven):
            whole = next((w for w in _with_high_bits(reader, seven, at) if w != data[at : at + len(w)]), None)
            if whole is not None:
                frames.append(whole)
                taken += len(whole)
            at += len(whole or b"?")
        if frames:
            yield _Fit(trouble, data, frames[0], taken)


def _with_high_bits(reader: Reader, seven: bytes, at: int) -> Iterator[bytes]:
    """Yield the frames at a place that have these lower bits."""
    for sent in _likely():
        if seven.startswith(_lower(sent), at) and any(b & _BIT_7 for b in sent):
            yield sent
    for dialect in reader.dialects:
        for first in dialect.link.first_bytes:
            if first & 0x7F != seven[at]:
                continue
            for stop in range(at + _LEAST, min(at + 16, len(seven)) + 1):
                body = bytes((first,)) + seven[at + 1 : stop - 1]
                for whole in (body, body[:2] + bytes((body[2] | _BIT_7,)) + body[3:]):
                    whole = dialect.link.completed(whole)
                    if whole[-1] & 0x7F == seven[stop - 1] and any(r.listed for r in reader.readings(whole)):
                        yield whole


@cache
def _lower(frame: bytes) -> bytes:
    return bytes(byte & 0x7F for byte in frame)


# --- forward from frames ------------------------------------------------------------------------------------------------


def _of_what_was_sent(scene: Scene, garbled: Sequence[Trouble]) -> Iterator[_Way]:
    """Yield the ways in which what the capture shows as sent becomes what it shows as read."""
    sent = list(dict.fromkeys(b.data for b in scene.bursts if _SAME <= len(b.data) <= _READ))[:_MOST_STRETCHES]
    lines = [*_LINES, *(("wrong_baud", Line(ratio)) for ratio in _ratios())]
    for cause, line in lines:
        fits = {}
        for frame in sent:
            for gap in _GAPS:
                came = read(levels(frame, line, gap), line)
                if came == frame:
                    continue
                for trouble in garbled:
                    assert trouble.stretch is not None  # chosen so
                    data = trouble.stretch.data
                    same = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(came, data, strict=False)))
                    if same >= max(_SAME, len(data) / 2) and len(set(data[:same])) >= _DIFFERENT and data != frame:
                        fits[trouble] = _Fit(trouble, data, frame, same)
        yield _Way(cause, line.ratio, list(fits.values()))


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
def _levels() -> tuple[tuple[bytes, str], ...]:
    """Return the likely frames with their levels."""
    return tuple((frame, levels(frame)) for frame in _likely())


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


def _at_other_speeds(garbled: Sequence[Trouble]) -> Iterator[_Way]:
    """Yield what each speed explains: render what is likely to be sent, and look for it."""
    wanted = [(t, t.stretch.data) for t in garbled if t.stretch is not None]
    heads = bytes(set().union(*(data for _, data in wanted)))
    for ratio in _ratios():
        fits: dict[Trouble, _Fit] = {}
        different: dict[bytes, None] = defaultdict()
        for frame, seen in _levels():
            for late in _LATE:
                came = read(seen, Line(ratio), late, heads)
                if len(set(came)) < 2:
                    continue
                for trouble, data in wanted:
                    if came == data or (len(came) >= _LEAST and came in data):
                        fits[trouble] = _Fit(trouble, data, frame, len(came))
                        different[data] = None
        if fits and (max(map(len, different)) >= _LEAST or len(different) > 1):
            yield _Way("wrong_baud", ratio, list(fits.values()))
