"""How the bytes left the line: another speed, swapped wires, another format, a start bit that was missed.

Theory. What a receiver reads of a known frame follows from the levels on the line alone. So frames that hosts and drives are
likely to send are rendered as levels and sampled as a receiver does that is wrong in one way; where that gives the very bytes
that came, the way is found. Where the receiver runs at the sender's speed, no such list is needed: the bytes that came give the
levels but for the pauses between them, and few pauses make whole bytes, and fewer a frame whose check fits.

    sender    0 dddddddd 1 0 dddddddd 1        ten bits a byte, without pauses
    receiver    0 dddddddd 1 1 1 0 dddd...     the same levels, begun at another edge; between bytes the line may stay high
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import cache
from math import ceil
from typing import NamedTuple

from analyzer import dialects as registry
from analyzer.catalogue import Dialect, Role
from analyzer.codec import codec
from analyzer.diagnosis.reader import Reader
from analyzer.diagnosis.scene import Confidence, Scene, Shown, Suspicion, Trouble, shown
from analyzer.link.modbus import FUNCTIONS, modbus_crc
from analyzer.values import counted

_BITS = 10
#: Longer stretches are noise without end.
_READ = 256
#: Bytes that must fit where one stretch alone speaks.
_LEAST = 4
#: Or so many different ones.
_DISTINCT = 2
#: Longer stretches are no single frame, and more of them would say the same.
_LONGEST = 40
_MOST_STRETCHES = 12
#: Addresses of the frames that are tried, and the steps of a search through pauses.
_ADDRESSES = range(1, 17)
_MOST_STEPS = 600
#: Speeds that are in use.
_RATES = (9600, 19200, 25000, 38400, 57600, 115200, 256000, 500000, 1000000)
#: A sender's speed over the receiver's, from which on bytes are read otherwise.
_SLOWEST, _FASTEST = 0.15, 7.0
#: Where the middle of a receiver's bit falls on an edge it can see either level: of start bits, and of the others.
_LATE = ((-0.05, -0.05), (0.05, 0.05), (-0.05, 0.05))


class _Fit(NamedTuple):
    """A stretch explained: the frame that was sent, and by what."""

    trouble: Trouble
    frame: bytes


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the line, where no frame explains the bytes."""
    left = [t for t in scene.damaged if t not in scene.explained]
    garbled = [t for t in left if t.stretch is not None and t.stretch.can_id is None and 1 < len(t.stretch.data) <= _READ]
    garbled = garbled[:_MOST_STRETCHES]
    sound = sum(p.sound for p in scene.pieces)
    # A line that is set up wrongly lets nothing through.
    if not garbled or sound > len(garbled):
        return
    reader = scene.reader
    found = [
        *_said(_fits(garbled, lambda data: _unshifted(reader, data, inverted=True)), "inverted_lines", _INVERTED),
        *_said(_fits(garbled, lambda data: _unshifted(reader, data, inverted=False)), "lost_start", _LOST),
        *_said(_fits(garbled, lambda data: _of_seven(reader, data)), "wrong_parity", _PARITY),
    ]
    yield from found or _wrong_parity(garbled) or _wrong_baud(garbled)


def _fits(garbled: list[Trouble], mend: Callable[[bytes], bytes | None]) -> list[_Fit]:
    found = []
    for trouble in garbled:
        assert trouble.stretch is not None  # chosen so
        data = trouble.stretch.data
        frame = mend(data) if _LEAST <= len(data) <= _LONGEST else None
        if frame is not None:
            found.append(_Fit(trouble, frame))
    return found


class _Words(NamedTuple):
    say: str
    evidence: str
    next: str


_INVERTED = _Words(
    "The line is inverted: A and B are swapped.",
    "{} is {} with every level turned round",
    "Swap the wires A and B at the adapter (D+ and D-), or switch off the inversion of the UART",
)
_LOST = _Words(
    "The receiver misses the first start bit, and reads the frame from its next low level on.",
    "{} is {} without its first start bit",
    "Switch the receiver on before the sender begins, and the driver a bit time before the first start bit; bias the line",
)
_PARITY = _Words(
    "One side uses seven data bits with parity, the other eight without.",
    "{} is {} to a receiver of another format",
    "Set both sides to 8 data bits, no parity, 1 stop bit (8N1)",
)


def _said(fits: list[_Fit], cause: str, words: _Words) -> Iterator[Suspicion]:
    if not fits:
        return
    first = fits[0]
    assert first.trouble.stretch is not None  # damaged bytes
    text = words.evidence.format(shown(first.trouble.stretch.data), shown(first.frame))
    yield Suspicion(
        cause, Confidence.CERTAIN if len({f.frame for f in fits}) > 1 else Confidence.LIKELY, [f.trouble for f in fits],
        words.say,
        f"{text}, at byte {first.trouble.offset}; {counted(len(fits), 'time')}",
        words.next,
        _frames(fits),
    )  # fmt: skip


def _frames(fits: list[_Fit]) -> tuple[Shown, ...]:
    read = [(f, f.trouble.stretch.data) for f in fits if f.trouble.stretch is not None]
    return tuple(Shown(fit.trouble.offset, shown(data), shown(fit.frame)) for fit, data in read)


# --- the same speed: levels from bytes -----------------------------------------------------------------------------------


def _unshifted(reader: Reader, data: bytes, *, inverted: bool) -> bytes | None:
    """Return the frame whose levels, begun at another edge, or turned round, a receiver reads as `data`.

    Levels are kept as the sender means them: where the line is inverted the receiver's ones are its zeros.
    """
    high = 0 if inverted else 1
    low = 1 - high
    heard = [[low, *((byte >> i & 1) ^ inverted for i in range(8))] for byte in data]
    steps = 0

    def grow(levels: list[int], number: int) -> Iterator[list[int]]:
        nonlocal steps
        steps += 1
        if steps > _MOST_STEPS:
            return
        more = levels + heard[number]
        if number == len(heard) - 1:
            # It may reach into the idle line behind the frame, so what stands there is looked at later.
            yield more
            return
        if not _framed(more, len(levels)) or not _begins(reader, more):
            return
        # A low stop bit is a framing error, and the byte is passed on all the same; then the line has to go high again.
        for lows in range(_BITS):
            begun = more + [low] * lows
            if not _framed(begun, len(more)):
                break
            for highs in range(1, _BITS + 1):
                waited = begun + [high] * highs
                if not _framed(waited, len(begun)):
                    break
                yield from grow(waited, number + 1)

    for before in range(_BITS):
        begin = [high] * before if inverted else [0] + [1] * before
        if not _framed(begin, 0):
            break
        for levels in grow(begin, 0):
            for whole in _ended(levels, high):
                if _framed(whole, 0) and _is_frame(reader, frame := _bytes(whole)) and frame != data:
                    return frame
    return None


def _begins(reader: Reader, levels: list[int]) -> bool:
    """Say whether the first two bytes of levels can begin a frame, as far as they are there."""
    if len(levels) < 2 * _BITS:
        return True
    first, second = _bytes(levels[: 2 * _BITS])
    return first in reader.heads or (first < 248 and second & 0x7F in FUNCTIONS)


def _ended(levels: list[int], high: int) -> Iterator[list[int]]:
    """Yield levels in whole bytes: without what is idle behind the last one, or with what was not heard of it."""
    stop = len(levels) - len(levels) % _BITS
    while stop and all(levels[stop:]):
        yield levels[:stop]
        stop -= _BITS
    if rest := -len(levels) % _BITS:
        for lows in range(rest):
            yield levels + [1 - high] * lows + [high] * (rest - 1 - lows) + [1]


def _framed(levels: list[int], first: int) -> bool:
    """Say whether start and stop bits stand where ten bits a byte put them, from a place on."""
    for at in range(first, len(levels)):
        place = at % _BITS
        if (place == 0 and levels[at]) or (place == _BITS - 1 and not levels[at]):
            return False
    return True


def _bytes(levels: list[int]) -> bytes:
    return bytes(sum(levels[at + 1 + i] << i for i in range(8)) for at in range(0, len(levels), _BITS))


def _is_frame(reader: Reader, data: bytes) -> bool:
    """Say whether bytes are a frame: of the catalogue, or any of Modbus that has a function of the standard."""
    if len(data) < _LEAST:
        return False
    if any(reading.listed for reading in reader.readings(data)):
        return True
    return data[1] & 0x7F in FUNCTIONS and modbus_crc(data[:-2]) == data[-2] | data[-1] << 8 and 0 < data[0] < 248


# --- seven bits ----------------------------------------------------------------------------------------------------------


def _of_seven(reader: Reader, data: bytes) -> bytes | None:
    """Return the frame that lost its bits 7, to a receiver of seven bits or to a sender's parity."""
    seven = bytes(byte & 0x7F for byte in data)
    if any(data) and data != seven and any((byte.bit_count() & 1) for byte in data):
        return None
    return next((whole for whole in _with_high_bits(reader, seven) if whole != data), None)


def _with_high_bits(reader: Reader, seven: bytes) -> Iterator[bytes]:
    """Yield the frames of the catalogue that have these lower bits, short ones only: each bit doubles them."""
    for sent in _likely():
        if len(sent) == len(seven) and any(b & 0x80 for b in sent) and bytes(b & 0x7F for b in sent) == seven:
            yield sent
    for dialect in reader.dialects:
        for first in dialect.link.first_bytes:
            if first & 0x7F != seven[0]:
                continue
            for code in (seven[2:3], bytes((seven[2] | 0x80,))):
                body = bytes((first,)) + seven[1:2] + code + seven[3:-1]
                whole = dialect.link.completed(body)
                if whole[-1] & 0x7F == seven[-1] and any(r.listed for r in reader.readings(whole)):
                    yield whole


# --- another speed: bytes from levels ------------------------------------------------------------------------------------


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
def _ratios() -> tuple[float, ...]:
    """Return the ratios of a sender's speed to a receiver's."""
    found: dict[float, tuple[int, int]] = {}
    for sender in _RATES:
        for receiver in _RATES:
            ratio = round(sender / receiver, 3)
            if sender != receiver and _SLOWEST < ratio < _FASTEST and not 0.95 < ratio < 1.05:
                found.setdefault(ratio, (sender, receiver))
    return tuple(found)


def _wrong_parity(garbled: list[Trouble]) -> list[Suspicion]:
    """Suspect a receiver that takes a parity bit where there is none: bytes without a pause run into each other."""
    wanted = {t.stretch.data: t for t in garbled if t.stretch is not None and len(t.stretch.data) >= _LEAST - 1}
    fits = {read: frame for frame, levels in _levels() if (read := sampled(levels, 1.0, bits=9)) in wanted and read != frame}
    if len(fits) < _DISTINCT:
        return []
    return list(_said([_Fit(wanted[read], frame) for read, frame in fits.items()], "wrong_parity", _PARITY))


def _wrong_baud(garbled: list[Trouble]) -> Iterator[Suspicion]:
    """Suspect the speed: render what is likely to be sent at each, and look for it."""
    by_ratio: dict[float, list[_Fit]] = defaultdict(list)
    wanted = [(t, t.stretch.data) for t in garbled if t.stretch is not None]
    heads = bytes(set().union(*(data for _, data in wanted)))
    for ratio in _ratios():
        for frame, levels in _levels():
            for late in _LATE:
                read = sampled(levels, ratio, late, heads)
                if len(set(read)) < 2:
                    continue
                for trouble, data in wanted:
                    if read == data or (len(read) >= _LEAST and read in data):
                        by_ratio[ratio].append(_Fit(trouble, frame))
    best: tuple[tuple[int, int], float, list[_Fit]] | None = None
    for ratio, fits in by_ratio.items():
        taken = {f.trouble: f for f in fits}
        different = {f.trouble.stretch.data for f in fits if f.trouble.stretch is not None}
        size = max(len(data) for data in different)
        if size < _LEAST and len(different) < 2:
            continue
        weight = (len(taken), size)
        if best is None or weight > best[0]:
            best = (weight, ratio, list(taken.values()))
    if best is None:
        return
    _, ratio, fits = best
    pairs = [(s, r) for s in _RATES for r in _RATES if abs(s / r - ratio) < 0.001 * ratio]
    several = ", ".join(f"{s} read at {r}" for s, r in pairs[:4])
    first = fits[0]
    assert first.trouble.stretch is not None  # damaged bytes
    different = {f.trouble.stretch.data for f in fits if f.trouble.stretch is not None}
    sure = len(different) > 1 or len(first.trouble.stretch.data) > 2 * _LEAST
    yield Suspicion(
        "wrong_baud", Confidence.CERTAIN if sure else Confidence.LIKELY, [f.trouble for f in fits],
        f"The sender's speed is {ratio:g} times the receiver's.",
        f"{shown(first.trouble.stretch.data)} is {shown(first.frame)} read so, at byte {first.trouble.offset}; "
        f"{counted(len(fits), 'time')}",
        f"Set both sides to one speed; the ratio fits {several}. `servotap record PORT:auto` finds the speed",
        _frames(fits),
    )  # fmt: skip


@cache
def _levels() -> tuple[tuple[bytes, str], ...]:
    """Return the likely frames with their levels, a character a bit, after an idle line."""
    characters = ["0" + f"{byte:08b}"[::-1] + "1" for byte in range(256)]
    return tuple((frame, "1" + "".join(characters[byte] for byte in frame)) for frame in _likely())


def sampled(levels: str, ratio: float, late: tuple[float, float] = (0.0, 0.0), heads: bytes = b"", bits: int = 8) -> bytes:
    """Return what a receiver reads of levels whose sender is `ratio` times as fast; after them the line is idle.

    `late`: how far behind the middle of start bits, and of others, it samples, in bits of the sender. `heads`: nothing that
    begins otherwise is looked for. `bits`: of a byte, with a parity.
    """
    last = len(levels)
    idle = levels + "1" * (int(10 * ratio) + 2)
    found = bytearray()
    places = [(bit + 1.5) * ratio + late[1] for bit in range(8)]
    middle = ratio / 2 + late[0]
    at = 1.0
    while (edge := levels.find("10", ceil(at) - 1, last) + 1) > 0:
        if idle[int(edge + middle)] == "1":
            # Too short for a start bit.
            at = edge + 1
            continue
        byte = 0
        for bit, place in enumerate(places):
            if idle[int(edge + place)] == "1":
                byte |= 1 << bit
        if not found and heads and byte not in heads:
            return b""
        found.append(byte)
        at = edge + (bits + 1.5) * ratio
    return bytes(found)
