"""Messages of CAN nodes from a DBC file, or another file that cantools reads (KCD, SYM, ARXML). cantools decodes them.

Rules kept here:
- A message is a command that nobody asks for. Its signals are fields; of multiplexed ones those that are there.
- A value is physical. A signal with choices has a name twin where the file names its value.
- A signal whose name means something else in the log begins with `signal_`.
- J1939: a message stands for its group number (PGN), whatever the priority, the source and the destination.
"""

from __future__ import annotations

import logging
import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analyzer.catalogue import Command, Dialect, Risk, Verb, always
from analyzer.devices.text import Text
from analyzer.layout import RESERVED_NAMES, Field, FieldKind, MisfitError, ReadLayout
from analyzer.link import EXTENDED_ID, MessageLink
from analyzer.link.can import j1939_group
from analyzer.port import topic_name
from analyzer.table.extras import needed
from analyzer.values import printable

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal

#: What cantools reads, by the end of the file's name.
_FORMATS = {".dbc": "dbc", ".kcd": "kcd", ".sym": "sym", ".arxml": "arxml"}
_XML = frozenset({"kcd", "arxml"})
#: The longest message that J1939 carries, in bytes, and as many multiplexer values as anyone numbers.
_LONGEST, _MOST_VALUES = 1785, 1 << 16
#: Multiplexer values of a whole file: each takes memory.
_MOST_NUMBERS = 16 * _MOST_VALUES
#: Numbers that cantools makes as many objects of: what they are, their pattern, the most.
_LIMITS = (
    # White space stands anywhere in a DBC file. A name is short: what has no end is not looked through for each begin.
    ("bytes of a message", r"BO_\s*+\d++\s*+\w{1,300}+\s*+:\s*+(\d++)", _LONGEST),
    ("bits of a signal", r":\s*+\d++\s*+\|\s*+(\d++)", 8 * _LONGEST),
    ("first bit of a signal", r":\s*+(\d++)\s*+\|", 8 * _LONGEST),
    ("length", r"""\b(?:length|offset)\s*=\s*["'](\d+)""", 8 * _LONGEST),
    ("length", r"^[ \t]*(?:Len|DLC|MaxLength)\s*=\s*(\d+)", 8 * _LONGEST),
    ("length", r"<(?:LENGTH|BIT-LENGTH|FRAME-LENGTH|START-POSITION)>\s*(\d+)", 8 * _LONGEST),
)
#: Bits at which cantools looks to check a file: two million in a second. It checks each message twice.
_MOST_LOOKS = 16_000_000


def messages(text: Text, name: str, note: Callable[[str], None]) -> Dialect:
    """Return the dialect of a file's messages. `note`: takes what is left out.

    Raises UnreadableError for a file that cannot be read or contradicts itself.
    """
    format = _FORMATS.get(Path(text.path).suffix.lower(), "dbc")
    _check_size(text, format)
    found = _parsed(text, format)
    contained = [m.name for m in found if m.is_container]
    if contained:
        note(f"{text.path}: containers are not decoded: {printable(', '.join(contained[:5]))}")
    found = [m for m in found if not m.is_container]
    _check_once(text, found)
    if not found:
        raise text.error("expected messages, got none")
    codes = {_identifier(m): number for number, m in enumerate(found)}
    groups = {j1939_group(key): number for key, number in codes.items() if found[number].protocol == "j1939"}
    title = printable(Path(text.path).name)
    return Dialect(
        name=name,
        title=title,
        manual=f"{format.upper()} file {title}",
        bus="can",
        link=MessageLink(codes=codes, groups=groups),
        commands=tuple(_command(text, message, number) for number, message in enumerate(found)),
        addresses=(0, EXTENDED_ID - 1),
        broadcast=None,
        of_drives=False,
    )


def _check_size(text: Text, format: str) -> None:
    """Raise UnreadableError for numbers and declarations that would take all memory."""
    if format in _XML and (found := re.search(r"<!(?:DOCTYPE|ENTITY)", text.text)):
        raise text.error(f"expected no {found[0][2:]} in a file of messages", text.line_at(found.start()))
    for what, pattern, most in _LIMITS:
        for found in re.finditer(pattern, text.text, re.MULTILINE | re.IGNORECASE):
            if len(found[1]) > len(str(most)) or int(found[1]) > most:
                raise text.error(f"{what}: expected {most} at most, got {found[1]}", text.line_at(found.start(1)))
    values_at, numbers = -1, 0
    for mark in re.finditer(r"SG_MUL_VAL_|;", text.text):
        if mark[0] != ";":
            values_at = mark.start() if values_at < 0 else values_at
        elif values_at >= 0:
            numbers += _numbers(text, values_at, mark.start())
            values_at = -1
            if numbers > _MOST_NUMBERS:
                raise text.error(f"multiplexer values: expected {_MOST_NUMBERS} in a file at most", text.line_at(mark.start()))


def _numbers(text: Text, start: int, stop: int) -> int:
    """Return how many multiplexer values stand in a place. Raises UnreadableError for a range longer than anyone has."""
    numbers = 0
    for found in re.finditer(r"(?<!\d)(\d++)\s*+-\s*+(\d++)", text.text[start:stop]):
        if len(found[2]) > len(str(1 << 64)) or int(found[2]) - int(found[1]) > _MOST_VALUES:
            raise text.error(
                f"multiplexer values: expected {_MOST_VALUES} at most, got {found[0]}", text.line_at(start + found.start())
            )
        numbers += max(0, int(found[2]) - int(found[1])) + 1
    return numbers


def _looks(message: Message) -> int:
    """Return at how many bits cantools looks to check a message: each, for each of its signals, in each place of a multiplexer.

    Eight signals, or bits that are copied, count as one bit.
    """
    bits = 8 * message.length
    below: dict[str | None, list[Signal]] = {}
    for signal in message.signals:
        below.setdefault(signal.multiplexer_signal, []).append(signal)

    def of(signals: Sequence[Signal], times: int) -> int:
        looks = 0
        for signal in signals:
            seen = times * len(signal.multiplexer_ids or (0,))
            looks += seen * bits
            if signal.is_multiplexer:
                inner = below.get(signal.name, [])
                values = {each for child in inner for each in child.multiplexer_ids or ()} | set(signal.choices or ())
                looks += seen * len(values) * (len(inner) + bits) // 8 + of(inner, seen)
        return looks

    return of(below.get(None, []), 1)


@contextmanager
def _bounded() -> Iterator[None]:
    """Have cantools refuse a file at whose bits it would look for minutes. All formats come to the same check."""
    kind, left = needed("cantools.database.can.message").Message, _MOST_LOOKS
    check = kind.refresh

    def bounded(message: Message, strict: bool | None = None) -> None:
        nonlocal left
        left -= _looks(message)
        if left < 0:
            raise ValueError(f"expected fewer signals in messages so long, got too many with message {message.name}")
        check(message, strict)

    kind.refresh = bounded
    try:
        yield
    finally:
        kind.refresh = check


@contextmanager
def _quiet() -> Iterator[None]:
    """Let cantools say nothing on the streams: what counts is checked here."""
    logger = logging.getLogger("cantools")
    before, logger.disabled = logger.level, False
    logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        logger.setLevel(before)


def _parsed(text: Text, format: str) -> list[Message]:
    database = needed("cantools.database")
    try:
        with _quiet(), _bounded():
            loaded = database.load_string(text.text, database_format=format, strict=True, sort_signals=None)
    # A parser that files of strangers reach can raise anything.
    except Exception as error:
        raise _refused(text, getattr(error, f"e_{format}", None) or error) from None
    for message in loaded.messages:
        # An attribute that XML leaves out is nothing to cantools.
        if not message.name:
            raise text.error(f"expected a name of the message 0x{message.frame_id:X}, got none")
        if not all(signal.name for signal in message.signals):
            raise text.error(f"expected a name of each signal of {message.name}, got none")
        for signal in message.signals:
            _check_numbers(text, message, signal)
    return list(loaded.messages)


def _check_numbers(text: Text, message: Message, signal: Signal) -> None:
    """Raise UnreadableError for a number that is larger than any float."""
    for what in ("scale", "offset", "minimum", "maximum"):
        number = getattr(signal, what)
        try:
            usable = number is None or math.isfinite(number)
        except OverflowError:
            usable = False
        if not usable:
            line = text.line_of(rf"^\s*SG_ {re.escape(signal.name)}\b")
            raise text.error(f"{message.name}.{signal.name}: expected a {what} that a float can hold, got {number}", line)


def _refused(text: Text, error: Exception) -> Exception:
    """Return what cantools says of a file, with the place where it tells one."""
    said = str(error) or type(error).__name__
    place = re.search(r"at line (\d+), column (\d+)", said)
    if place is not None:
        return text.error(said, int(place[1]))
    named = re.search(r"message (\S+?)\.?$", said)
    line = text.line_of(rf"^BO_ \s*\d+ \s*{re.escape(named[1])}\s*:") if named is not None else None
    if isinstance(error, (LookupError, AttributeError, TypeError, AssertionError, RecursionError)):
        said = f"cantools cannot read it: {type(error).__name__} {said}"
    return text.error(said, line)


def _check_once(text: Text, found: list[Message]) -> None:
    """Raise UnreadableError for two messages of one identifier or name, and two signals of one name."""
    seen: dict[int, Message] = {}
    for message in found:
        other = seen.setdefault(_identifier(message), message)
        if other is not message:
            line = text.line_of(rf"^BO_ \s*\d+ \s*{re.escape(message.name)}\s*:")
            raise text.error(f"{message.name} has the identifier 0x{message.frame_id:X} of {other.name}", line)
        twice = [name for name, n in Counter(_names(message).values()).items() if n > 1]
        if twice:
            line = text.line_of(rf"^BO_ \s*\d+ \s*{re.escape(message.name)}\s*:")
            raise text.error(f"{message.name} has two signals {twice[0]}", line)
    names = Counter(topic_name(m.name) for m in found)
    for name, count in names.items():
        if count > 1:
            raise text.error(f"two messages have the name {name}", text.line_of(rf"^BO_ \s*\d+ \s*{re.escape(name)}\s*:"))


def _identifier(message: Message) -> int:
    return message.frame_id | (EXTENDED_ID if message.is_extended_frame else 0)


def _names(message: Message) -> dict[str, str]:
    """Return the names of a message's signals in the log, by their own."""
    own = [signal.name for signal in message.signals]
    twins = {f"{name}{end}" for name in own for end in ("_name", "_text")}
    taken = RESERVED_NAMES | twins
    result = {}
    for name in own:
        cleaned = re.sub(r"\W", "_", printable(name)) or "_"
        result[name] = f"signal_{cleaned.lstrip('_')}" if cleaned in taken or cleaned[0] in "_0123456789" else cleaned
    return result


def _command(text: Text, message: Message, code: int) -> Command:
    names = _names(message)
    fields = tuple(_field(signal, names[signal.name]) for signal in message.signals)
    return Command(
        name=topic_name(message.name),
        verb=Verb.OTHER,
        code=code,
        section="",
        summary=printable(message.comment or f"message {message.name}"),
        risk=(always(Risk.UNKNOWN),),
        request=ReadLayout(*fields, reader=_reader(message, names), shortest=message.length),
        reply=None,
    )


def _field(signal: Signal, name: str) -> Field:
    note = [printable(signal.comment)] if signal.comment else []
    limits = [f"{limit:g}" if limit is not None else "" for limit in (signal.minimum, signal.maximum)]
    if any(limits):
        note.append(f"range {'..'.join(limits)}")
    choices = {int(v): printable(str(n)) for v, n in signal.choices.items()} if signal.choices else None
    facts: dict[str, Any] = {"name": name, "unit": printable(signal.unit or ""), "choices": choices, "note": "; ".join(note)}
    if signal.is_float or signal.scale != 1 or signal.offset != 0:
        return Field(bit_width=0, kind=FieldKind.NUMBER, **facts)
    return Field(bit_width=signal.length, kind=FieldKind.INT if signal.is_signed else FieldKind.UINT, **facts)


def _reader(message: Message, names: dict[str, str]) -> Callable[[bytes], dict[str, Any]]:
    """Return what decodes the data of a message by cantools."""
    signals: dict[str, tuple[str, Any, Any]]
    signals = {s.name: (names[s.name], s.conversion, s.choices or {}) for s in message.signals}
    failed = needed("cantools").database.DecodeError

    def read(data: bytes) -> dict[str, Any]:
        try:
            sent: Any = message.decode(data, decode_choices=False, scaling=False)
        except failed as error:
            raise MisfitError("unknown_choice", f"{message.name}: {error}") from None
        result: dict[str, Any] = {}
        for own, number in sent.items():
            name, conversion, choices = signals[own]
            result[name] = conversion.raw_to_scaled(number, decode_choices=False)
            if number in choices:
                result[name + "_name"] = printable(str(choices[number]))
        return result

    return read
