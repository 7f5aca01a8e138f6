"""The process that parses a file of CAN messages: cantools can take all memory, or minutes, for a small file of a stranger.

    parent --> a message, the file        child --> pickled Answer

The parent holds standard input open while it waits. The process ends where that ends, so none is left behind.
"""

from __future__ import annotations

import logging
import math
import os
import pickle
import re
import sys
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Any

from analyzer.devices.text import Text
from analyzer.errors import ServotapError
from analyzer.system import bounded, sized
from analyzer.system.own_process import without
from analyzer.table.extras import needed

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal

#: Bytes of an answer. A file of the largest size that tools write takes half of it; the parent holds it in memory.
MOST_ANSWERED = 16 << 20
#: Bits of an integer that tables have a type for.
_MOST_BITS = 64
#: The longest message that J1939 carries, in bytes.
_LONGEST = 1785


@dataclass(frozen=True)
class SignalFacts:
    """What a file says of a signal. `length`: in bits. `is_scaled`: its values are no integers of 64 bits."""

    name: str
    length: int
    is_signed: bool
    is_scaled: bool
    minimum: float | None
    maximum: float | None
    unit: str
    comment: str
    choices: dict[int, str] | None


@dataclass(frozen=True)
class MessageFacts:
    """What a file says of a message. `length`: in bytes. `decoder`: cantools' own message, pickled."""

    name: str
    frame_id: int
    is_extended: bool
    is_j1939: bool
    is_container: bool
    length: int
    comment: str
    signals: list[SignalFacts]
    decoder: bytes


class TooMuchError(Exception):
    """A file takes more memory or time than it may."""


#: Messages, or what was raised instead.
Answer = list[MessageFacts] | Exception


def main(out: IO[bytes], path: str, format: str, memory: str, seconds: str) -> None:
    """Write the answer to `out`, within so many bytes of memory and seconds of CPU time."""
    stream = sys.stdin.buffer
    data = bytes(sized.take(stream))
    threading.Thread(target=_end_with, args=(stream.fileno(),), daemon=True).start()
    bounded.limit(int(memory), int(seconds))
    answer: Answer
    try:
        answer = parsed(Text(path, data), format)
        answered = pickle.dumps(answer, pickle.HIGHEST_PROTOCOL)
        if len(answered) > MOST_ANSWERED:
            raise TooMuchError
    except (ServotapError, TooMuchError) as error:
        answered = pickle.dumps(error)
    except MemoryError:
        answered = pickle.dumps(TooMuchError())
    except Exception:
        answered = pickle.dumps(RuntimeError(traceback.format_exc()))
    out.write(answered)
    out.flush()


def _end_with(stream: int) -> None:
    """End this process when its parent has ended, or waits no longer."""
    while os.read(stream, 1):
        pass
    os._exit(1)


def parsed(text: Text, format: str) -> list[MessageFacts]:
    """Return the messages of a file.

    Raises UnreadableError for one that cannot be read, UsageError without cantools, TooMuchError for too little memory.
    """
    with without("asammdf"):
        database = needed("cantools.database")
    try:
        with _quiet():
            loaded = database.load_string(text.text, database_format=format, strict=True, sort_signals=None)
    # A parser that files of strangers reach can raise anything.
    except Exception as error:
        raise _refused(text, getattr(error, f"e_{format}", None) or error) from None
    found, size = [], 0
    for message in loaded.messages:
        _check(text, message)
        try:
            facts = _facts(message)
        except RecursionError:
            raise text.error(f"{message.name}: expected fewer multiplexers in each other") from None
        size += len(facts.decoder)
        if size > MOST_ANSWERED:
            raise TooMuchError
        found.append(facts)
    return found


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


def _refused(text: Text, error: Exception) -> Exception:
    """Return what cantools says of a file, with the place where it tells one."""
    if isinstance(error, MemoryError):
        return TooMuchError()
    said = str(error) or type(error).__name__
    place = re.search(r"at line (\d+), column (\d+)", said)
    if place is not None:
        return text.error(said, int(place[1]))
    named = re.search(r"message (\S+?)\.?$", said)
    line = text.line_of(begin_of(named[1])) if named is not None else None
    if isinstance(error, (LookupError, AttributeError, TypeError, AssertionError, RecursionError)):
        said = f"cantools cannot read it: {type(error).__name__} {said}"
    return text.error(said, line)


def begin_of(message: str) -> str:
    """Return the pattern of a message's first line in a DBC file."""
    return rf"^BO_ \s*\d+ \s*{re.escape(message)}\s*:"


def _check(text: Text, message: Message) -> None:
    """Raise UnreadableError for a message without names, one that is too long, and numbers that are larger than any float."""
    # An attribute that XML leaves out is nothing to cantools.
    if not message.name:
        raise text.error(f"expected a name of the message 0x{message.frame_id:X}, got none")
    if not all(signal.name for signal in message.signals):
        raise text.error(f"expected a name of each signal of {message.name}, got none")
    if message.length > _LONGEST:
        raise text.error(
            f"{message.name}: expected {_LONGEST} bytes at most, got {message.length}", text.line_of(begin_of(message.name))
        )
    for signal in message.signals:
        for what in ("scale", "offset", "minimum", "maximum"):
            number = getattr(signal, what)
            try:
                usable = number is None or math.isfinite(number)
            except OverflowError:
                usable = False
            if not usable:
                line = text.line_of(rf"^\s*SG_ {re.escape(signal.name)}\b")
                raise text.error(f"{message.name}.{signal.name}: expected a {what} that a float can hold, got {number}", line)


def _facts(message: Message) -> MessageFacts:
    signals = [_signal_facts(signal) for signal in message.signals]
    return MessageFacts(
        name=message.name,
        frame_id=message.frame_id,
        is_extended=message.is_extended_frame,
        is_j1939=message.protocol == "j1939",
        is_container=message.is_container,
        length=message.length,
        comment=message.comment or "",
        signals=signals,
        decoder=_decoder(message),
    )


def _signal_facts(signal: Signal) -> SignalFacts:
    return SignalFacts(
        name=signal.name,
        length=signal.length,
        is_signed=signal.is_signed,
        is_scaled=signal.is_float or signal.scale != 1 or signal.offset != 0 or signal.length > _MOST_BITS,
        minimum=signal.minimum,
        maximum=signal.maximum,
        unit=signal.unit or "",
        comment=signal.comment or "",
        choices={int(value): str(name) for value, name in signal.choices.items()} if signal.choices else None,
    )


def _decoder(message: Message) -> bytes:
    """Return a message, pickled, without what all messages of its file share, and without comments."""
    if message.is_container:
        return b""
    bare: Any = message
    bare.dbc = bare.autosar = bare.comments = None
    for signal in bare.signals:
        signal.dbc = signal.comments = None
    return pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
