"""CAN frames in lines of text as programs print them: one table of shapes.

    Timestamp: 1709640000.120000    ID: 0001    S Tx    DL:  5    f6 01 40 02 3a    Channel: can0      python-can
    ID: 0x01 Data: F6 01 40 02 3A                                                                      anyone's
    Standard ID: 0x001       DLC: 3  Data: 0xF6 0x01 0xF8                                              Arduino MCP_CAN
    t0015F60140023A                                                                                    slcan
    12:00:00:1200 Tx 1 0x001 s 5 F6 01 40 02 3A                                                        BUSMASTER
    cansend can0 001#F60140023A                                                                        a shell

Rules: a time, tags and a mark may stand before a shape, as in every log (`hexline.py`). `Tx` and words for it say that the
host sent a frame; `Rx` says nothing, for a listener receives everything. Identifiers are hexadecimal; where nothing shows it, a
note says so. Where bytes can only be decimal, all numbers are. A line that has the length of its frame must have as many bytes.
Lines of no shape are comments, unless their beginning is that of a shape: then they are problems.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import msgspec

from analyzer.catalogue import Role
from analyzer.records import CanFrame, Comment
from analyzer.sources import written
from analyzer.sources.can_program import Program
from analyzer.sources.can_shapes import SHAPES, Shape
from analyzer.sources.lines import Lines, fitting, head_lines, is_like
from analyzer.sources.marks import ACTIONS, MATTERS, SIGNS, role_of
from analyzer.sources.prose import role_in_text
from analyzer.sources.source import Source, quote
from analyzer.sources.stamps import ANY, STAMPS, Stamp, StampClock
from analyzer.values import CAN_ID_LIMIT, CAN_ID_MASK, FD_LENGTHS

_words = "|".join(sorted((*ACTIONS, *MATTERS), key=len, reverse=True))
_signs = "|".join(map(re.escape, SIGNS))
_BEFORE = re.compile(
    # A quotation, the number of a line, the time and the tag of an ESP32.
    rf"\s*(?:>\s+)*(?:\d{{1,6}}[.:]?\s+(?=[\[(]))?"
    rf"(?:[VDIWE] \((?P<millis>\d{{1,10}})\)\s*(?:(?!(?:{_words})\b)[A-Za-z]\w*:\s+)?)?"
    rf"(?:[\[(]?\s*(?:{ANY})(?![0-9A-Za-z_.])\s*[\])]?[\s,;|]*)?(?:->\s*)?(?:\[[\w:.]+\]:?\s*)*(?:[$#]\s+)?"
    rf"(?:can\d?\s+(?=[tr]x))?"
    rf"(?:(?P<word>{_words})(?![\w])[\s:>|-]*|(?P<sign>{_signs})\s+)?",
    re.IGNORECASE,
)
_TOKEN = re.compile(r"0[xX][0-9A-Fa-f]+|\d+")
#: A call that goes on in the next lines.
_CALL = re.compile(r".*\bMessage\([^()]*")
_CALL_LINES = 8
_ADAPTER = re.compile(r"(?:[<>=-]{1,3}\s*)?[SsOCLVvNFMmXYZzGHIP][0-9A-Fa-f]{0,8}(?:\\[rn])*")
_ONLY_ID = re.compile(r"(?:.*[^A-Za-z])?id\s*[:=]?\s*0x[0-9A-F]{1,8}\s*(?:and\s+(?:length|dlc)\s+[0-8]\s*)?", re.IGNORECASE)
_ONLY_BYTES = re.compile(r"\s*(?:0x)?[0-9A-F]{1,2}(?:[\s,]+(?:0x)?[0-9A-F]{1,2}){0,7}\s*", re.IGNORECASE)
_MARKS = {"tx": Role.REQUEST, "t": Role.REQUEST, "cansend": Role.REQUEST, "send": Role.REQUEST, "false": Role.REQUEST}
_CAN_BYTES = 8
_LONGEST_LINE = 1000
_BYTE = re.compile(r"[0-9A-Fa-f]{1,2}")
#: Below this a number is the same in both, and with so many digits tools print hexadecimal.
_ALIKE = 10
_PADDED = (3, 4, 8)
#: Digits of an identifier of 29 bits, as SocketCAN's tools write it.
_EXTENDED_DIGITS = 8
_EXTENDED_FLAG, _REMOTE_FLAG, _ERROR_FLAG = 0x8000_0000, 0x4000_0000, 0x2000_0000
_FLAGGED = 0xFFFF_FFFF
_SLCAN_ID = {"t": 3, "T": 8, "r": 3, "R": 8}
_SLCAN_STAMP = 4
_SAMPLE_LINES, _NAMED_LINES = 400, 50
#: Strokes between the columns of a table.
_COLUMNS = range(1, 12)
_LEAST_SHARE = 0.1
#: How sure a text of words, or a program, is in which a frame stands here and there; shapes that nothing else has.
_FEW_SCORE, _SURE_SHAPES = (
    0.34,
    frozenset(("call", "call-id-data", "call-object", "cansend", "hash", "quoted", "candump", "pcan")),
)
_CANDUMP_SCORE = 0.36


class _Line(NamedTuple):
    """A line taken apart. `open_id`: its identifier may be decimal."""

    frame: CanFrame
    stamp: Stamp
    port: str | None
    open_id: bool = False


def score(head: bytes) -> float:
    """Say how sure it is that these bytes are CAN frames in text, 0..1."""
    program = Program()
    lines = [line for line in _joined(head_lines(head)[:_SAMPLE_LINES], program) if not line.startswith(("#", "//", ";"))]
    shape = _shape_of(lines)
    if shape is None:
        return 0.0
    fits = [_either(line, shape) is not None for line in lines]
    taken = [line for line, fit in zip(lines, fits, strict=True) if fit]
    # The lines that fill what a program sends belong to its frames.
    share = max(fitting(lines, fits), min(1.0, (len(taken) + program.parts) / len(lines)) if program.parts else 0.0)
    if not shape.sure and not _fits(shape, lines, taken):
        return 0.0
    if share >= _LEAST_SHARE:
        return 0.5 + 0.45 * share
    # No sentence has an interface, an identifier and the length of the bytes.
    return _CANDUMP_SCORE if shape.name == "candump" else _FEW_SCORE if shape.name in _SURE_SHAPES else 0.0


def _shape_of(lines: list[str]) -> Shape | None:
    counts = Counter(shape.name for shape in SHAPES for line in lines if _either(line, shape) is not None)
    best = max(SHAPES, key=lambda shape: counts[shape.name])
    return best if counts[best.name] else None


def _either(line: str, shape: Shape) -> _Line | None:
    return _take(line, shape) or _take(line, shape, decimal=True)


def _fits(shape: Shape, lines: list[str], taken: list[str]) -> bool:
    """Say whether the lines of a shape that other texts have too can be nothing else: with letters, and all but a heading."""
    heading = len(lines) - len(taken)
    named = heading and re.search(r"\bID\b", " ".join(lines[:heading])) is not None
    letters = any(re.search(r"[A-Fa-f]|\b0x", line) for line in taken)
    return len(taken) > 1 and letters and (heading == 0 or (heading <= 3 and bool(named)))


def read(source: Source) -> Iterator[CanFrame | Comment]:
    """Read the lines one by one."""
    lines = [line for line in _joined(head_lines(source.head)) if not line.startswith(("#", "//", ";"))]
    shape = _shape_of(lines)
    if shape is None:
        source.problem(f"expected lines of CAN frames as {', '.join(each.name for each in SHAPES)} have them, got none")
        return iter(())
    decimal = any(_take(text, shape) is None and _take(text, shape, decimal=True) is not None for text in lines)
    taken = [line for text in lines if (line := _take(text, shape, decimal)) is not None]
    if decimal:
        source.note("identifiers and bytes are decimal numbers: some bytes have three digits")
    clock = StampClock((line.stamp for line in taken), source)
    if (
        not decimal
        and taken
        and all(line.open_id or line.frame.id < _ALIKE for line in taken)
        and any(line.open_id for line in taken)
    ):
        source.note("identifiers without 0x are read as hexadecimal")
    if shape.name == "slcan" and source.time_source != "none":
        source.time_source = "capture: milliseconds of the adapter, which begin again every minute"
    if shape.name == "cansniffer":
        source.note("cansniffer prints the time since a frame of the same identifier: the order of frames is not told")
    named = {line.port for text in lines[:_NAMED_LINES] if (line := _any(text, shape, decimal)) is not None}
    # What a program sends, and does not name the bus of, goes to the only one that is named.
    only = next(iter(named - {None})) if len(named) == 2 and None in named else None
    return _records(source, shape, decimal, clock, only)


def _any(text: str, shape: Shape, decimal: bool) -> _Line | None:
    """Return the frame of a line in the shape of its text, or in another that is sure."""
    others = (each for each in SHAPES if each.sure and each is not shape)
    return _take(text, shape, decimal) or next((line for each in others if (line := _take(text, each)) is not None), None)


def _records(source: Source, shape: Shape, decimal: bool, clock: StampClock, only: str | None) -> Iterator[CanFrame | Comment]:
    lines = Lines(source)
    minutes = _Minutes() if shape.name == "slcan" else int
    taken = ""
    for text in _joined(lines):
        remark = text.startswith("//")
        line = None if remark else _any(text, shape, decimal)
        if line is not None:
            taken = text
            line = line if line.port is not None else line._replace(port=only)
            yield _timed(source, line, lines.number, clock, minutes)
        elif not remark and ((shape.near is not None and shape.near.match(text)) or (taken and is_like(text, taken))):
            source.problem(f"expected a CAN frame, got {quote(text.strip())!r}", line=lines.number)
        elif text.strip() and not (shape.name == "slcan" and _ADAPTER.fullmatch(text.strip())):
            yield source.comment(None, text)


def _timed(source: Source, line: _Line, number: int, clock: StampClock, minutes: Callable[[int], int]) -> CanFrame:
    """Return the frame of a line with its time and its bus."""
    try:
        t_ns = clock(line.stamp)
    except ValueError as error:
        source.problem(f"{error}; the frame is kept", line=number)
        t_ns = None
    if t_ns is not None:
        t_ns = minutes(t_ns)
    frame = source.carried(line.frame, number)
    return msgspec.structs.replace(frame, t_ns=t_ns, port=source.port(can_name(line.port)))


def frame_of(text: str) -> CanFrame | None:
    """Return the frame of a line of a text that has others, too; without its time."""
    line = next((line for shape in SHAPES if shape.sure and (line := _take(text, shape)) is not None), None)
    return None if line is None else msgspec.structs.replace(line.frame, port=can_name(line.port) or "")


def _joined(lines: Iterable[str], program: Program | None = None) -> Iterator[str]:
    """Yield the lines; one that ends in an identifier and one of bytes below it, as Seeed's library prints them, are one."""
    held, call, program = "", list[str](), program or Program()
    for each in lines:
        line = written.unescaped(each)
        if len(line) <= _LONGEST_LINE and (sent := list(program(line))):
            yield from sent
            if said := line.partition("//")[2].strip():
                yield f"// {said}"
            continue
        if call or (len(line) <= _LONGEST_LINE and "Message(" in line and _CALL.fullmatch(line)):
            call.append(line)
            if len(call) < _CALL_LINES and ")" not in line.replace("])", "]"):
                continue
            if _CALL.fullmatch(call[0]) and ")" in line:
                yield program.resolved(" ".join(each.strip() for each in call))
            else:
                yield from call
            call = []
            continue
        if held:
            below = _ONLY_BYTES.fullmatch(line) is not None
            yield f"{held} Data: {line}" if below else held
            held = ""
            if below:
                continue
        if len(line) <= _LONGEST_LINE and _ONLY_ID.fullmatch(line):
            held = line
        else:
            yield from _parted(program.resolved(line) if "Message(" in line and len(line) <= _LONGEST_LINE else line)
    if held:
        yield held
    yield from call


#: A frame inside a line, as tools print it.
_MENTION = re.compile(
    r"(?:(?<!\w)[A-Za-z]{1,8}can\w?\d{1,2}\s+|(?<!\w)can\w?\d{0,2}\s+)?(?<![\w#/.-])"
    r"(?:(?:0x)?(?:[0-9A-F]{3}|[0-9A-F]{8})\s+\[(?P<count>[0-8])\]"
    r"|(?:can[ _-]?)?\bid\s*[:=]?\s*0x[0-9A-F]{1,8}[\s,;]+(?:dlc|dl|len|length)\s*[:=]?\s*(?P<dlc>[0-8])"
    r"[\s,;]+(?:data\s*[:=]|\[)"
    r"|[0-9A-F]{3,8}h\s+(?P<length>[0-8])(?=\s+[0-9A-F]{2}\b))"
    r"\s*(?P<bytes>(?:(?:0x)?[0-9A-F]{2}\b[\s,]*){0,8})",
    re.IGNORECASE,
)
_MENTIONED_BYTE = re.compile(r"(?:0x)?[0-9A-F]{2}\b", re.IGNORECASE)


def _parted(line: str) -> Iterator[str]:
    """Yield the frames that stand among the words of a line, one by one behind who sent them; or the line."""
    found = list(_MENTION.finditer(line)) if len(line) <= _LONGEST_LINE and _HINT.search(line) else []
    around = _MENTION.sub("", line).strip() if found else ""
    if not around or (len(found) == 1 and frame_of(line) is not None):
        yield from _cells(line)
        return
    frames = []
    begin = 0
    for each in found:
        size = int(next(filter(None, (each["count"], each["dlc"], each["length"])), "0"))
        data = _MENTIONED_BYTE.findall(each["bytes"])[:size]
        role = role_in_text(line[begin : each.start()])
        begin = each.end()
        head = line[each.start() : each.start("bytes")].strip()
        frames.append(f"{_SPOKEN[role]}{head} {' '.join(data)}")
    yield f"// {line}"
    yield from frames


_HINT = re.compile(r"\[[0-8]\]|\bid\b|[0-9A-F]h\s", re.IGNORECASE)
_SPOKEN = {Role.REQUEST: "Tx ", Role.REPLY: "Rx ", Role.UNKNOWN: ""}


def _cells(line: str) -> Iterator[str]:
    """Yield the frames of a row of a table that has several, as a column of requests and one of replies; or the line."""
    cells = line.split("|") if line.count("|") in _COLUMNS and len(line) <= _LONGEST_LINE else []
    frames = [cell for cell in cells if frame_of(cell) is not None]
    if len(frames) < 2:
        yield line
        return
    words = " ".join(cell.strip() for cell in cells if cell not in frames)
    yield from (f"// {words}", *frames) if words.strip() else frames


def can_name(name: str | None) -> str | None:
    """Return the name of a bus of which a program prints the number alone."""
    return f"can{name}" if name is not None and name.isdecimal() else name


class _Minutes:
    """Adds a minute each time the milliseconds of an slcan adapter begin again."""

    def __init__(self) -> None:
        self._sum = self._last = 0

    def __call__(self, t_ns: int) -> int:
        if t_ns < self._last:
            self._sum += 60_000_000_000
        self._last = t_ns
        return self._sum + t_ns


def _take(text: str, shape: Shape, decimal: bool = False) -> _Line | None:
    """Return the frame of a line in a shape, None if it has none. `decimal`: its numbers are decimal."""
    text = text.strip()
    if len(text) > _LONGEST_LINE:
        return None
    before = _BEFORE.match(text)
    found = shape.pattern.fullmatch(text, before.end()) if before is not None and before.end() else None
    if before is None or found is None:
        found = shape.pattern.fullmatch(text)
        return None if found is None else _of(found, Stamp(), Role.UNKNOWN, decimal)
    groups = before.groupdict()
    kind = next((name for name in STAMPS if groups[name] is not None), "")
    role = role_of([(groups["word"] or "").lower()], groups["sign"] or "")
    stamp = Stamp(kind, groups[kind]) if kind else Stamp("millis", groups["millis"]) if groups["millis"] else Stamp()
    return _of(found, stamp, role if role is Role.REQUEST else Role.UNKNOWN, decimal)


def _of(found: re.Match[str], stamp: Stamp, role: Role, decimal: bool) -> _Line | None:
    groups = found.groupdict()
    if groups.get("slcan") is not None:
        return _slcan(groups["slcan"], groups["rest"], stamp, role)
    if groups.get("listed") is not None:
        return _called(groups, stamp)
    if groups.get("record") is not None:
        return None if decimal else _record(groups, stamp)
    if decimal and not groups["id"].isdecimal():
        return None
    number = int(groups["id"], 10 if decimal and "0x" not in found[0].lower() else 16)
    if groups.get("literal"):
        data = _data(groups["literal"])
    else:
        data = written.decimal(groups["data"] or "") if decimal else _data(groups["data"] or "")
    length = groups.get("length")
    mark = (groups.get("mark") or "").lower()
    remote, error = bool(groups.get("remote")), bool(groups.get("error"))
    if (
        data is None
        or (len(data) not in FD_LENGTHS and mark != "cansend")
        or number > _FLAGGED
        or (length is not None and int(length) != len(data) and not remote)
    ):
        return None
    if groups.get("before"):
        said = role_of(re.findall(r"\w+", groups["before"].lower()))
        role = said if said is Role.REQUEST else role
    if mark:
        role = _MARKS.get(mark, Role.UNKNOWN)
    if groups.get("micros"):
        stamp = Stamp("units", f"{groups['micros']}us")
    elif groups.get("time"):
        stamp = Stamp("clock" if ":" in groups["time"] else "seconds", groups["time"])
    extended = bool(groups.get("extended")) or number > CAN_ID_LIMIT or "extended" in (groups.get("before") or "").lower()
    # SocketCAN's tools write an identifier of 29 bits with eight digits.
    extended |= f"{groups['id']}#" in found[0] and len(groups["id"]) == _EXTENDED_DIGITS
    if number > CAN_ID_MASK:
        # SocketCAN's own numbers: the three bits above are flags.
        error, remote = bool(number & _ERROR_FLAG), bool(number & _REMOTE_FLAG)
        extended, number = (bool(number & _EXTENDED_FLAG) or number & CAN_ID_MASK > CAN_ID_LIMIT, number & CAN_ID_MASK)
    frame = CanFrame(None, "", number, data, role, extended and not error, remote, error, len(data) > _CAN_BYTES)
    # Two digits, or more than tools pad with zeros: 17 can be 0x17, or 0x11.
    open_id = (
        groups["id"].isdecimal() and number >= _ALIKE and len(groups["id"]) not in _PADDED and "0x" not in found[0].lower()
    )
    return _Line(frame, stamp, groups.get("port"), open_id)


def _data(text: str) -> bytes | None:
    text = text.replace(".", " ").strip(" \t,:")
    if not text:
        return b""
    if _BYTE.fullmatch(text):
        return bytes((int(text, 16),))
    found = written.read(text)
    if found is None or found.radix is written.Radix.DECIMAL:
        # Bytes without leading zeros may all be short.
        tokens = text.split()
        return bytes(int(token, 16) for token in tokens) if all(map(_BYTE.fullmatch, tokens)) else None
    return found.data


def _called(groups: dict[str, str | None], stamp: Stamp) -> _Line | None:
    """Return the frame that a program sends, by its identifier and its bytes."""
    number = _number(groups["id"] or "")
    values = [_number(token) for token in _TOKEN.findall(groups["listed"] or "")] * int(groups.get("times") or 1)
    # A program that asks for 11 bits sends 11 bits, however large its number is.
    extended = bool(groups.get("extended")) or (number > CAN_ID_LIMIT and not groups.get("standard"))
    if number > CAN_ID_MASK or not values or max(values) > 0xFF or len(values) not in FD_LENGTHS:
        return None
    data = bytes(values)
    return _Line(CanFrame(None, "", number, data, Role.REQUEST, extended, fd=len(data) > _CAN_BYTES), stamp, None)


def _record(groups: dict[str, str], stamp: Stamp) -> _Line | None:
    """Return the frame of a record of gs_usb: numbers have their low byte first; what was received has no echo number."""
    own, bits = (int.from_bytes(bytes.fromhex(groups[name]), "little") for name in ("own", "record"))
    data = bytes.fromhex(groups["data"])
    size, flags = int(groups["length"]), bits & ~CAN_ID_MASK
    if (own > _OWN_LAST and own != _RECEIVED) or (not flags and bits > CAN_ID_LIMIT) or any(data[size:]):
        return None
    role = Role.UNKNOWN if own == _RECEIVED else Role.REQUEST
    error, extended = bool(flags & _ERROR_FLAG), bool(flags & _EXTENDED_FLAG)
    number = bits & CAN_ID_MASK
    return _Line(CanFrame(None, "", number, data[:size], role, extended, bool(flags & _REMOTE_FLAG), error), stamp, None)


#: The echo number of what was received, and the last one of what was sent.
_RECEIVED, _OWN_LAST = 0xFFFF_FFFF, 0xFF


def _number(text: str) -> int:
    return int(text, 16 if text[:2].lower() == "0x" else 10)


def _slcan(kind: str, rest: str, stamp: Stamp, role: Role) -> _Line | None:
    digits = _SLCAN_ID[kind]
    length = rest[digits : digits + 1]
    remote = kind in "rR"
    if not length.isdecimal() or int(length) > _CAN_BYTES:
        return None
    size = 0 if remote else 2 * int(length)
    data, behind = rest[digits + 1 :][:size], rest[digits + 1 :][size:]
    if len(data) != size or len(behind) not in (0, _SLCAN_STAMP):
        return None
    number = int(rest[:digits], 16)
    if number > (CAN_ID_LIMIT if digits == 3 else CAN_ID_MASK):
        return None
    if behind and not stamp.kind:
        stamp = Stamp("units", f"{int(behind, 16)}ms")
    return _Line(CanFrame(None, "", number, bytes.fromhex(data), role, digits == 8, remote), stamp, None)
