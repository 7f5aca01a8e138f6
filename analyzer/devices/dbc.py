"""Messages of CAN nodes from a DBC file, or another file that cantools reads (KCD, SYM, ARXML). cantools decodes them.

Rules kept here:
- A message is a command that nobody asks for. Its signals are fields; of multiplexed ones those that are there.
- A value is physical. A signal with choices has a name twin where the file names its value.
- A signal whose name means something else in the log begins with `signal_`.
- J1939: a message stands for its group number (PGN), whatever the priority, the source and the destination.
"""

from __future__ import annotations

import contextlib
import math
import pickle
import re
import subprocess
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analyzer.catalogue import Command, Dialect, Risk, Verb, always
from analyzer.devices.dbc_child import MOST_ANSWERED, Answer, MessageFacts, SignalFacts, TooMuchError, begin_of
from analyzer.devices.text import Text
from analyzer.layout import RESERVED_NAMES, Field, FieldKind, MisfitError, ReadLayout
from analyzer.link import EXTENDED_ID, MessageLink
from analyzer.link.can import j1939_group
from analyzer.port import topic_name
from analyzer.system import bounded, sized
from analyzer.system.own_process import without
from analyzer.values import printable

if TYPE_CHECKING:
    from cantools.database.can import Message

#: What cantools reads, by the end of the file's name.
_FORMATS = {".dbc": "dbc", ".kcd": "kcd", ".sym": "sym", ".arxml": "arxml"}
#: Of the process that parses a file: MiB of memory and seconds of CPU time, and more for each MiB of the file. Files of
#: 4 MiB, the longest, that tools write take 160 MiB and 2 s. By the clock it may take longer: others use the processor, too.
_MEMORY, _MEMORY_PER_MIB, _SECONDS, _SECONDS_PER_MIB, _CLOCK = 200, 50, 4, 5, 10


def messages(text: Text, name: str, note: Callable[[str], None]) -> Dialect:
    """Return the dialect of a file's messages. `note`: takes what is left out.

    Raises UnreadableError for a file that cannot be read or contradicts itself.
    """
    format = _FORMATS.get(Path(text.path).suffix.lower(), "dbc")
    found = _parsed(text.path, text.data, format)
    contained = [m.name for m in found if m.is_container]
    if contained:
        note(f"{text.path}: containers are not decoded: {printable(', '.join(contained[:5]))}")
    found = [m for m in found if not m.is_container]
    _check_once(text, found)
    if not found:
        raise text.error("expected messages, got none")
    codes = {_identifier(m): number for number, m in enumerate(found)}
    groups = {j1939_group(key): number for key, number in codes.items() if found[number].is_j1939}
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


#: Captures of a folder are decoded with the same files, one after the other.
@lru_cache(maxsize=4)
def _parsed(path: str, data: bytes, format: str) -> list[MessageFacts]:
    """Return the messages of a file. Another process parses it, which ends with this function however it ends.

    Raises UnreadableError for a file that cannot be read, or takes too much memory or time; UsageError without cantools.
    """
    text = Text(path, data)
    memory, seconds = (
        free + math.ceil(more * len(data) / (1 << 20))
        for free, more in ((_MEMORY, _MEMORY_PER_MIB), (_SECONDS, _SECONDS_PER_MIB))
    )
    answered = _answered(data, bounded.command("analyzer.devices.dbc_child", path, format, memory << 20, seconds), seconds)
    answer: Answer = pickle.loads(answered) if answered else TooMuchError()
    if isinstance(answer, TooMuchError):
        raise text.error(
            f"reading it takes more memory or time than a device file may: {memory} MiB, {seconds} s; "
            "expected no lengths or ranges so large"
        )
    if isinstance(answer, Exception):
        raise answer
    return answer


def _answered(data: bytes, command: Sequence[str], seconds: int) -> bytes:
    """Return what a process answers to a file, nothing where it was ended."""
    child = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        # Ctrl-C in a terminal is for this process alone, which ends the other, or goes on to record.
        start_new_session=True,
    )
    deadline = threading.Timer(_CLOCK * seconds, child.kill)
    deadline.start()
    try:
        assert child.stdin is not None
        assert child.stdout is not None
        # A process that has ended takes no more, and its answer is short.
        with contextlib.suppress(OSError):
            sized.put(child.stdin, data)
        answered = child.stdout.read(MOST_ANSWERED)
        return answered if child.wait() == 0 else b""
    finally:
        deadline.cancel()
        deadline.join()
        child.kill()
        # It reads no more: what was not written yet is of no use.
        with contextlib.suppress(OSError), child:
            pass


def _check_once(text: Text, found: list[MessageFacts]) -> None:
    """Raise UnreadableError for two messages of one identifier or name, and two signals of one name."""
    seen: dict[int, MessageFacts] = {}
    for message in found:
        other = seen.setdefault(_identifier(message), message)
        if other is not message:
            line = text.line_of(begin_of(message.name))
            raise text.error(f"{message.name} has the identifier 0x{message.frame_id:X} of {other.name}", line)
        twice = [name for name, n in Counter(_names(message).values()).items() if n > 1]
        if twice:
            line = text.line_of(begin_of(message.name))
            raise text.error(f"{message.name} has two signals {twice[0]}", line)
    names = Counter(topic_name(m.name) for m in found)
    for name, count in names.items():
        if count > 1:
            raise text.error(f"two messages have the name {name}", text.line_of(begin_of(name)))


def _identifier(message: MessageFacts) -> int:
    return message.frame_id | (EXTENDED_ID if message.is_extended else 0)


def _names(message: MessageFacts) -> dict[str, str]:
    """Return the names of a message's signals in the log, by their own."""
    own = [signal.name for signal in message.signals]
    twins = {f"{name}{end}" for name in own for end in ("_name", "_text")}
    taken = RESERVED_NAMES | twins
    result = {}
    for name in own:
        cleaned = re.sub(r"\W", "_", printable(name)) or "_"
        result[name] = f"signal_{cleaned.lstrip('_')}" if cleaned in taken or cleaned[0] in "_0123456789" else cleaned
    return result


def _command(text: Text, message: MessageFacts, code: int) -> Command:
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


def _field(signal: SignalFacts, name: str) -> Field:
    note = [printable(signal.comment)] if signal.comment else []
    limits = [f"{limit:g}" if limit is not None else "" for limit in (signal.minimum, signal.maximum)]
    if any(limits):
        note.append(f"range {'..'.join(limits)}")
    choices = {value: printable(label) for value, label in signal.choices.items()} if signal.choices else None
    facts: dict[str, Any] = {"name": name, "unit": printable(signal.unit), "choices": choices, "note": "; ".join(note)}
    if signal.is_scaled:
        return Field(bit_width=0, kind=FieldKind.NUMBER, **facts)
    return Field(bit_width=signal.length, kind=FieldKind.INT if signal.is_signed else FieldKind.UINT, **facts)


def _reader(facts: MessageFacts, names: dict[str, str]) -> Callable[[bytes], dict[str, Any]]:
    """Return what decodes the data of a message by cantools, which is loaded for the first message."""

    @cache
    def loaded() -> tuple[Message, dict[str, tuple[str, Any, Any]], type[Exception]]:
        with without("asammdf"):
            from cantools.database import DecodeError

            message: Message = pickle.loads(facts.decoder)
        return message, {s.name: (names[s.name], s.conversion, s.choices or {}) for s in message.signals}, DecodeError

    def read(data: bytes) -> dict[str, Any]:
        message, signals, failed = loaded()
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
