"""Values of requests: out of range, with their bytes swapped, or with a sign where the manual has a bit for the direction.

The ranges and the fields are the catalogue's. What is in range can be odd still: people send round numbers, so of two readings
of the same bytes the rounder one is meant.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

from analyzer.codec import codec
from analyzer.codec import shown as number
from analyzer.diagnosis.scene import Confidence, Piece, Scene, Shown, Suspicion, Trouble, shown
from analyzer.layout import Field, FieldKind, Layout, Order
from analyzer.records import Message
from analyzer.values import counted

#: By so many digits a reading has to be rounder than the other.
_ROUNDER = 2
#: Digits of a round number, by the bytes of its field: most of what people send.
_ROUND = {2: 2, 3: 3, 4: 4, 8: 5}
#: The weight from which on swapped bytes are no chance; a value out of range whose bytes swapped are in it weighs double.
_ENOUGH = 2
#: Digits of a number that is meant even if it is the only one, by the bytes of its field; of two bytes none tells enough.
_FEW_DIGITS = {2: 0, 3: 2, 4: 3, 8: 3}
#: A number of the words that is no chance.
_NUMBER = re.compile(r"(?<![\w.:/-])\d{3,}(?![\w:]|\.\d)")
_RANGE = frozenset(("out_of_range", "unknown_choice"))


class Word(NamedTuple):
    """Bytes that a host packs as one number: a field, or what fills up its bytes with it. `field`: the number itself."""

    start: int
    stop: int
    layout: Layout
    field: Field

    @property
    def size(self) -> int:
        """How many bytes it has."""
        return self.stop - self.start

    def value(self, data: bytes) -> int:
        """Return the number."""
        return int(codec(self.layout).wire(data)[self.field.name])

    def whole(self, data: bytes) -> int:
        """Return all its bits as a number."""
        return int.from_bytes(data, "big" if self.field.order is Order.BIG else "little")

    def allowed(self, data: bytes) -> bool:
        """Say whether the manual allows it, and what fills it up."""
        return not codec(self.layout).broken(data)


class Odd(NamedTuple):
    """A value that is not as the manual has it. `right`: the own data as meant; `sure`: one alone is no chance."""

    piece: Piece
    message: Message
    got: str
    meant: str
    right: bytes
    sure: bool = True


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the values that the host sends."""
    rounder: list[tuple[Piece, Message, Word]] = []
    worded: list[tuple[Piece, Message, Word]] = []
    by_swap: Counter[int] = Counter()
    signed: dict[tuple[str, bytes], Odd] = {}
    kept: Counter[int] = Counter()
    seen: set[tuple[str, bytes]] = set()
    said = {number for words in scene.words for number in _NUMBER.findall(words)}
    sent: list[tuple[Piece, Message]] = []
    for piece in scene.pieces:
        message = piece.message
        if message is None or not piece.is_request or message.form is None or message.command is None:
            continue
        if piece.rules & {"bad_checksum", "wrong_length", "unknown_command"} or message.command.slots is not None:
            continue
        # Of registers that the manual does not list nothing is known, nor of those of any other device.
        if message.command in message.frame.dialect.fallbacks.values() or not message.frame.dialect.of_drives:
            continue
        sent.append((piece, message))
        key = _key(message)
        if key in seen:
            continue
        seen.add(key)
        for word in _words(message.form.layout):
            worded.append((piece, message, word))
            weight = _weight(word, message.data[word.start : word.stop], said)
            if weight > 0:
                by_swap[word.size] += weight
                rounder.append((piece, message, word))
            elif weight:
                kept[word.size] += 1
            if (odd := _signed(piece, message, word)) is not None:
                signed[key] = odd
    # A program packs all numbers of a size in one way.
    sizes = {size for size, weight in by_swap.items() if weight >= _ENOUGH and weight > 2 * kept[size]}
    swapped = {_key(message): _swapped(piece, message, word, sizes) for piece, message, word in rounder if word.size in sizes}
    # All digits of some numbers that are out of range are decimal, and read so they are in it, and round.
    written = [(p, m, word, number) for p, m, word in worded if (number := _by_digits(m, word)) is not None]
    beyond = {_key(m): number for _, m, word, number in written if not word.allowed(m.data[word.start : word.stop])}
    digits = {_key(m): _as_written(p, m, word, n) for p, m, word, n in written if _key(m) in beyond.keys() | swapped.keys()}
    # 1600 is a round number, and 22, which its bytes are the other way round, is none.
    turned = [word.value(m.data[word.start : word.stop][::-1]) for _, m, word in rounder if word.size in sizes]
    rather = bool(beyond and turned) and all(number % 10 for number in turned)
    named = not said.isdisjoint(map(str, beyond.values()))
    if (len(beyond) > 1 or named or rather) and digits.keys() >= swapped.keys():
        swapped = {}
    else:
        digits = {}
    signed = {key: odd for key, odd in signed.items() if key not in swapped}
    if len(signed) == 1 and not next(iter(signed.values())).sure:
        signed = {}
    yield from _said(
        scene, sent, "wrong_byte_order", swapped, "The bytes of the values stand in the wrong order.",
        "Pack the values the other way round",
    )  # fmt: skip
    yield from _said(
        scene, sent, "unit_or_sign", signed,
        "A negative number is sent as two's complement, and the manual has a bit for the direction.",
        "Set the direction bit and send the amount",
    )  # fmt: skip
    yield from _said(
        scene, sent, "decimal_as_hex", digits, "The decimal digits of the values are sent as hexadecimal ones.",
        "Convert the number before it is sent",
    )  # fmt: skip
    told = {**swapped, **signed, **digits}
    yield from _out_of_range(scene, told)
    yield from _beyond_a_model(scene, [(piece, message) for piece, message in sent if _key(message) not in told])


def _key(message: Message) -> tuple[str, bytes]:
    """Return what tells a request of one command from another."""
    return "" if message.command is None else message.command.name, message.data


def _said(
    scene: Scene, sent: list[tuple[Piece, Message]], cause: str, odd: dict[tuple[str, bytes], Odd], say: str, todo: str
) -> Iterator[Suspicion]:
    if not odd:
        return
    first = next(iter(odd.values()))
    troubles, frames = [], []
    for piece, message in sent:
        found = odd.get(_key(message))
        if found is not None:
            troubles += _troubles(scene, piece) or [Trouble(cause, piece.offset, None, piece)]
            frames.append(Shown(piece.offset, shown(piece.data, _id(piece)), shown(_frame(found), _id(piece))))
    yield Suspicion(
        cause, Confidence.CERTAIN if len(odd) > 1 else Confidence.LIKELY, troubles, say,
        f"{shown(first.piece.data, _id(first.piece))} at byte {first.piece.offset} says {first.got}; meant is {first.meant}; "
        f"{counted(len(frames), 'time')}",
        f"{todo}: {shown(_frame(first), _id(first.piece))}",
        tuple(frames),
    )  # fmt: skip


def _out_of_range(scene: Scene, explained: dict[tuple[str, bytes], Odd]) -> Iterator[Suspicion]:
    found: list[tuple[Piece, str]] = []
    troubles: list[Trouble] = []
    for piece in scene.pieces:
        message = piece.message
        if message is None or not piece.is_request or not piece.sound or not piece.rules & _RANGE or message.command is None:
            continue
        if _key(message) in explained:
            continue
        found.append((piece, next(v.text for v in message.violations if v.rule in _RANGE)))
        troubles += _troubles(scene, piece)
    if not found or not troubles:
        return
    piece, text = found[0]
    yield Suspicion(
        "value_out_of_range", Confidence.CERTAIN if len(found) > 1 else Confidence.LIKELY, troubles,
        f"A value is outside the range of the manual: {text}.",
        f"{shown(piece.data, _id(piece))} at byte {piece.offset}; {counted(len(found), 'time')}",
        "Send a value within the range; if it should be in it, look at its unit",
        tuple(Shown(p.offset, shown(p.data, _id(p))) for p, _ in found),
    )  # fmt: skip


def _beyond_a_model(scene: Scene, sent: list[tuple[Piece, Message]]) -> Iterator[Suspicion]:
    """Suspect values that are refused, and are beyond the range of one of the models."""
    refused = {t.piece.asked_by for t in scene.of("failed_status", "refused_write") if t.piece is not None}
    found: list[tuple[Piece, list[str]]] = []
    for piece, message in sent if refused else ():
        limited = message.form is not None and any(field.models for field in message.form.layout.fields)
        if limited and message.form is not None and piece.sequence in scene.replies and not piece.rules & _RANGE:
            layout, every = message.form.layout, message.frame.dialect.models
            models = [model for model in every if codec(layout.for_model(model)).broken(message.data)]
            if models and piece.sequence not in refused:
                # Some drive here takes such a value.
                return
            found += [(piece, models)] if models else []
    if not found:
        return
    piece, models = found[0]
    yield Suspicion(
        "value_out_of_range", Confidence.LIKELY if len(found) > 1 else Confidence.POSSIBLE,
        [trouble for each, _ in found for trouble in _troubles(scene, each)],
        f"The drive refuses a value that is beyond the range of {', '.join(models)}.",
        f"{shown(piece.data, _id(piece))} at byte {piece.offset} is refused; {counted(len(found), 'time')}, and none is taken",
        f"Look up the range of this model: `servotap diagnose --model {models[0]}` says where a value is outside it",
        tuple(Shown(p.offset, shown(p.data, _id(p))) for p, _ in found),
    )  # fmt: skip


def _troubles(scene: Scene, piece: Piece) -> list[Trouble]:
    """Return the troubles of a request and of the replies to it."""
    return [
        t for t in scene.troubles
        if t.piece is not None and (t.piece is piece or (t.piece.asked_by == piece.sequence and t.piece.is_reply))
    ]  # fmt: skip


def _words(layout: Layout) -> tuple[Word, ...]:
    """Return the numbers of more than a byte, each with the bits that fill up its bytes; found once, and kept with it."""
    kept: tuple[Word, ...] | None = layout.__dict__.get("_words")
    if kept is None:
        kept = layout.__dict__["_words"] = tuple(_found_words(layout))
    return kept


def _found_words(layout: Layout) -> Iterator[Word]:
    run: list[Field] = []
    start = 0
    for offset, field in layout:
        if not run:
            start = offset
        run.append(field)
        stop = offset + field.bit_width
        if start % 8 or stop % 8 or not field.bit_width:
            continue
        numbers = [f for f in run if f.bit_width > 8 and f.choices is None and f.kind in (FieldKind.UINT, FieldKind.INT)]
        if len(numbers) == 1 and numbers[0].fixed is None and stop - start in {8 * size for size in _ROUND}:
            yield Word(start // 8, stop // 8, Layout(*run), numbers[0])
        run = []


def _digits(value: int) -> int:
    """Return how many digits of a number are not zeros at its end; a power of two is as round as a power of ten."""
    if value and not abs(value) & (abs(value) - 1):
        return 1
    return len(str(abs(value)).rstrip("0"))


def _weight(word: Word, data: bytes, said: set[str]) -> int:
    """Return how much speaks for swapped bytes; below 0: against. `said`: numbers of the words, which tell what is meant."""
    other = data[::-1]
    if other == data:
        return 0
    named = [str(abs(word.value(each))) in said for each in (data, other)]
    if any(named):
        return -1 if named[0] else _ENOUGH * word.allowed(other)
    sound, sound_swapped = word.allowed(data), word.allowed(other)
    # Reserved bits that are set belong to the number of a program that packs all bits of the word.
    filled = any(each.rule == "reserved_bits" for each in codec(word.layout).broken(data))
    digits, swapped = _digits(word.whole(data) if filled else word.value(data)), _digits(word.value(other))
    if sound and (not sound_swapped or digits + _ROUNDER <= swapped):
        return -1
    rounder = sound_swapped and swapped <= _ROUND[len(data)] and swapped + _ROUNDER <= digits
    # Of four bytes one in ten thousand is so much rounder the other way, one in a million with so few digits.
    much = swapped <= _FEW_DIGITS[len(data)] and swapped + 2 * _ROUNDER <= digits
    return int(rounder) * (2 if not sound or much else 1)


def _swapped(piece: Piece, message: Message, word: Word, sizes: set[int]) -> Odd:
    data = message.data
    right = bytearray(data)
    if message.form is not None:
        for each in _words(message.form.layout):
            part = data[each.start : each.stop]
            if each.size in sizes and each.allowed(part[::-1]):
                right[each.start : each.stop] = part[::-1]
    got = data[word.start : word.stop]
    return Odd(piece, message, _text(word, word.value(got)), _text(word, word.value(got[::-1])), bytes(right))


def _by_digits(message: Message, word: Word) -> int | None:
    """Return the round number in range whose decimal digits are the hexadecimal ones of a value."""
    digits = message.data[word.start : word.stop][:: 1 if word.field.order is Order.BIG else -1].hex()
    meant = int(digits) if digits.isdecimal() else -1
    sound = meant >= 0 and word.allowed(_packed(word, meant)) and _digits(meant) <= _ROUND[word.size]
    return meant if sound else None


def _packed(word: Word, value: int) -> bytes:
    return value.to_bytes(word.size, "big" if word.field.order is Order.BIG else "little")


def _as_written(piece: Piece, message: Message, word: Word, meant: int) -> Odd:
    right = message.data[: word.start] + _packed(word, meant) + message.data[word.stop :]
    got = word.value(message.data[word.start : word.stop])
    return Odd(piece, message, _text(word, got), _text(word, word.value(_packed(word, meant))), right)


def filled(layout: Layout, data: bytes) -> bytes:
    """Return the fields of a request with one number widened by zeros to its own size; empty where no number is the one.

    A program has packed it in fewer bytes than the manual has. Widened at the right place all numbers are the roundest.
    """
    missing = layout.byte_length - len(data)
    words = _words(layout) if not layout.open_ended and missing > 0 else ()
    found: list[tuple[int, bytes]] = []
    for word in words:
        at = word.start if word.field.order is Order.BIG else word.stop - missing
        wide = data[:at] + bytes(missing) + data[at:]
        if word.size > missing and not codec(layout).broken(wide):
            found.append((sum(_digits(each.value(wide[each.start : each.stop])) for each in words), wide))
    found.sort()
    return found[0][1] if len(found) == 1 or (found and found[0][0] + _ROUNDER <= found[1][0]) else b""


def _signed(piece: Piece, message: Message, word: Word) -> Odd | None:
    """Return a number that is negative if its bytes are one of two's complement, where the manual has an unsigned one."""
    field, command = word.field, message.command
    direction = command.motion.direction if command is not None and command.motion is not None else ""
    if field.kind is not FieldKind.UINT or not direction or message.form is None:
        return None
    data = message.data[word.start : word.stop]
    value = int.from_bytes(data, "little" if field.order is Order.LITTLE else "big", signed=True)
    sent = word.value(data)
    fewer = _digits(sent) - _digits(value)
    rounder = len(data) > 2 and fewer >= 2 * _ROUNDER
    # A number that is out of range is a round one, or nearer to the end of the range, where nothing negative was meant.
    beyond = not word.allowed(data) and (fewer, sent - field.high) > (0, -value)
    if not (value < 0 and -value <= field.high and (beyond or rounder)):
        return None
    values = {name: v for name, v in message.values.items() if isinstance(v, int | bytes)}
    for each in _words(message.form.layout):
        part = message.data[each.start : each.stop]
        other = int.from_bytes(part, "little" if each.field.order is Order.LITTLE else "big", signed=True)
        if other < 0 and not each.allowed(part):
            values[each.field.name] = -other
    right = codec(message.form.layout).encode({**values, field.name: -value, direction: 1})
    # About one in a thousand of the allowed values looks like this by chance.
    sure = fewer >= 3 * _ROUNDER or not word.allowed(data)
    return Odd(piece, message, _text(word, sent), _text(word, value), right, sure)


def _text(word: Word, value: int) -> str:
    unit = f" {word.field.unit}" if word.field.unit else ""
    return f"{word.field.name} {number(word.field.physical(value))}{unit}"


def _frame(odd: Odd) -> bytes:
    message = odd.message
    assert message.command is not None
    assert message.form is not None  # a request of a known form
    return message.frame.dialect.link.build(message.command, message.form, message.address, odd.right, message.role)


def _id(piece: Piece) -> int | None:
    return None if piece.can is None else piece.can.id
