"""Frames in another dress: read or sent as text, or with the header of another transport."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from itertools import pairwise, product
from math import prod
from typing import NamedTuple

from analyzer.catalogue import Role
from analyzer.diagnosis.exchanges import replies_to
from analyzer.diagnosis.pace import ASKS_OF_PARTS
from analyzer.diagnosis.reader import Reader
from analyzer.diagnosis.reports import NOTHING_CAME
from analyzer.diagnosis.requests import EXCEPTIONS
from analyzer.diagnosis.scene import SILENT, Confidence, Scene, Shown, Stretch, Suspicion, Trouble, shown
from analyzer.link import FUNCTIONS, READS, modbus_crc
from analyzer.values import counted

_REPLACED = b"\xef\xbf\xbd"
#: Numbers of which one has three digits, and is no byte in hexadecimal.
_DECIMAL, _LARGEST = re.compile(rb"(?=.*\b\d{3}\b)\d{1,3}(?:[ \t]+\d{1,3}){3,}\s*", re.DOTALL), 0xFF
_HEX = re.compile(rb"(?:0x|\\x)?[0-9A-Fa-f]{2}(?:[\s,;:-]*(?:0x|\\x)?[0-9A-Fa-f]{2}){2,}[\s,;]*")
_HEADER = 6
_LEAST_COUNT = 3
_MOSTLY = 0.6
#: Bytes in a row that flow control takes out of a frame.
_TAKEN = 3
#: Bytes of a frame of a serial dialect, at least and at most, where many stand in a row.
_SHORTEST, _LONGEST = 4, 16


class Dress(NamedTuple):
    """A way in which a frame is wrapped. `undo`: the frame of some bytes, empty where it is lost, None where none is.

    `least`: so many times, and so mostly, that it is no chance. `sure`: how sure it is then. `by_none`: what answers such
    frames is another device, whose frames they are.
    """

    cause: str
    undo: Callable[[Reader, bytes], bytes | None]
    say: str
    next: str
    least: int = 1
    sure: Confidence = Confidence.CERTAIN
    by_none: bool = False


def _replaced(reader: Reader, data: bytes) -> bytes | None:
    return b"" if _REPLACED in data else None


def _encoded(reader: Reader, data: bytes) -> bytes | None:
    try:
        frame = data.decode().encode("latin-1")
    except (UnicodeDecodeError, UnicodeEncodeError):
        return None
    return frame if frame != data and reader.best(frame) is not None else None


def _line_ends(reader: Reader, data: bytes) -> bytes | None:
    frame = data.replace(b"\r\n", b"\n")
    return frame if frame != data and reader.best(frame) is not None else None


def _turned_ends(reader: Reader, data: bytes) -> bytes | None:
    """Put the ends of lines back that a port has turned into the other one: of some of them the check says that they were."""
    came, was = (b"\n", b"\r") if b"\r" not in data else (b"\r", b"\n")
    count = data.count(came)
    if not 0 < count <= _MOST_ENDS or was in data or reader.best(data) is not None:
        return None
    parts = data.split(came)
    for ends in sorted(product((came, was), repeat=count), key=lambda ends: ends.count(was)):
        frame = parts[0] + b"".join(end + part for end, part in zip(ends, parts[1:], strict=True))
        if (reading := reader.best(frame)) is not None and reading.listed:
            return frame
    return None


#: Ends of lines in one frame that are tried.
_MOST_ENDS = 5


def _flow_control(reader: Reader, data: bytes) -> bytes | None:
    """Put bytes back that software flow control takes away."""
    if not 2 < len(data) <= _LONGEST or reader.best(data) is not None:
        return None
    for size in range(1, _TAKEN + 1):
        for lost in map(bytes, product(b"\x11\x13", repeat=size)):
            for at in range(2, len(data)):
                frame = data[:at] + lost + data[at:]
                if (reading := reader.best(frame)) is not None and reading.listed:
                    return frame
    return None


def _question_marks(reader: Reader, data: bytes) -> bytes | None:
    """Put bytes from 80 on back for which an encoding without them has put question marks: heads, codes, and checks."""
    if not 2 < len(data) <= _LONGEST or _MARK not in data or not data.isascii():
        return None
    for dialect in reader.dialects:
        size = len(dialect.link.completed(data)) - len(data)
        heads = [first for first in dialect.link.first_bytes if first > _ASCII]
        codes = [command.code for command in dialect.commands if _ASCII < command.code <= 0xFF]
        ways = [[byte] if byte != _MARK[0] else heads if not at else codes for at, byte in enumerate(data[:-size])]
        # A head and a code at most: text with question marks is no frame.
        if prod(map(len, ways)) > _MOST_WAYS:
            continue
        for body in map(bytes, product(*ways)):
            frame = dialect.link.completed(body)
            marked = bytes(byte if byte <= _ASCII else _MARK[0] for byte in frame)
            if marked == data and (reading := reader.best(frame)) is not None and reading.listed:
                return frame
    return None


#: What an encoding puts for what it has not, and its last byte.
_MARK, _ASCII = b"?", 0x7F
_MOST_WAYS = 300


def _of_can(reader: Reader, data: bytes) -> bytes | None:
    """Return the native frame where bytes are an identifier and the data of a frame on CAN, with the sum over both."""
    # A low identifier: E0 and up are the heads of another product.
    can = 2 < len(data) <= _LONGEST and data[0] <= _ASCII
    reading = Reader.of_bus("can").best(data[1:], data[0], Role.REQUEST) if can else None
    if reading is None or not reading.listed or reader.best(data) is not None:
        return None
    native = next((d.link.completed(_HEAD + data[:-1]) for d in reader.dialects if _HEAD[0] in d.link.first_bytes), b"")
    return native if reader.best(native) is not None else b""


#: The head of a request of the native dialect.
_HEAD = b"\xfa"


def _letters(reader: Reader, data: bytes) -> bytes | None:
    if _DECIMAL.fullmatch(data):
        frame = bytes(value for value in map(int, data.split()) if value <= _LARGEST)
    elif _HEX.fullmatch(data):
        frame = bytes.fromhex(re.sub(rb"0x|\\x|[^0-9A-Fa-f]", b"", data).decode())
    else:
        return None
    known = reader.best(frame) is not None or reader.closed(frame) or _frames(reader, frame) * 2 > len(frame)
    return frame if known else None


def _frames(reader: Reader, data: bytes) -> int:
    """Return how many bytes are frames that stand one behind the other."""
    at = found = 0
    while at < len(data):
        sizes = range(_SHORTEST, min(_LONGEST, len(data) - at) + 1)
        size = next((n for n in sizes if reader.best(data[at : at + n]) is not None), 0)
        found += size
        at += size or 1
    return found


def _tcp(reader: Reader, data: bytes) -> bytes | None:
    """Take off headers of Modbus TCP: of some the count is not that of the bytes."""
    at, bodies = 0, []
    while len(data) >= at + _HEADER + 2 and data[at + 2 : at + 5] == b"\0\0\0":
        count = data[at + 5]
        body = data[at + _HEADER : at + _HEADER + count]
        last = at + _HEADER + count >= len(data)
        if len(body) < 2 or body[1] & 0x7F not in FUNCTIONS or not count >= _LEAST_COUNT or abs(count - len(body)) > 1:
            return None
        bodies.append(body)
        at += _HEADER + (len(body) if last else count)
    if not bodies or at != len(data):
        return None
    # Of some the CRC stands behind the header, too.
    return b"".join(body if modbus_crc(body) == 0 else body + modbus_crc(body).to_bytes(2, "little") for body in bodies)


_LINE_ENDS = Dress(
    "text_mode", _line_ends, "A port in text mode changes line ends: it puts 0D before each 0A, or takes it away.",
    "Open the port raw: no conversion of line ends (stty raw, -onlcr)",
)  # fmt: skip
_FLOW_CONTROL = Dress(
    "text_mode", _flow_control, "Bytes 11 and 13 are missing: software flow control (XON/XOFF) takes them away.",
    "Switch software flow control off (stty raw -ixon -ixoff; xonxoff=False)", 3,
)  # fmt: skip
DRESSES = (
    Dress(
        "text_mode", _replaced, "Bytes are read as UTF-8 text: all that are not valid text are replaced by EF BF BD.",
        "Read and write bytes, not strings: no decoding, no text mode of the port",
    ),
    Dress(
        "text_mode", _letters, "The frame is sent as letters: the digits of its hex text instead of its bytes.",
        "Send bytes: in a terminal switch to hex, in Python write bytes.fromhex(...)",
    ),
    Dress(
        "text_mode", _encoded, "Bytes from 80 on are encoded as UTF-8 text: each becomes two.",
        "Write bytes, not strings",
    ),
    Dress(
        "text_mode", _question_marks, "Bytes are encoded as ASCII text: each from 80 on becomes 3F, a question mark.",
        "Write and read bytes, not strings", 2,
    ),
    _LINE_ENDS,
    Dress(
        "text_mode", _turned_ends, "A port in text mode turns one end of a line into the other: 0D into 0A, or the reverse.",
        "Open the port raw: no conversion of line ends (stty raw -icrnl -inlcr)", 2,
    ),
    _FLOW_CONTROL,
    Dress(
        "wrong_dialect", _of_can, "These are frames of the CAN manual on a serial line: identifier, data, and their sum.",
        "Send the frames of the RS485 manual, which begin with FA and count it in their sum", 2,
        Confidence.LIKELY, by_none=True,
    ),
    Dress(
        "tcp_framing", _tcp, "The frame has the header of Modbus TCP and no CRC: an RTU drive does not take it.",
        "Switch the program or the gateway to Modbus RTU (over TCP: to RTU conversion)",
    ),
)  # fmt: skip


class _Header(NamedTuple):
    """A header of Modbus TCP with what stands behind it: its number, the bytes that it promises, and those that are there."""

    burst: Stretch
    number: int
    promised: int
    body: bytes


def _headers(scene: Scene) -> Iterator[_Header]:
    """Yield the headers of Modbus TCP: several may stand in one read."""
    for burst in scene.bursts:
        data, at = burst.data, 0
        while burst.can_id is None and len(data) >= at + _HEADER + 2 and data[at + 2 : at + 5] == b"\0\0\0":
            count = data[at + 5]
            body = data[at + _HEADER : at + _HEADER + count]
            if len(body) < 2 or body[1] & 0x7F not in FUNCTIONS or count < _LEAST_COUNT:
                break
            yield _Header(burst, int.from_bytes(data[at : at + 2], "big"), count, body)
            at += _HEADER + count


def _of_header(scene: Scene) -> Iterator[Suspicion]:
    """Suspect what the headers of Modbus TCP tell: a number of an earlier request, or a count that is not that of the bytes."""
    asked: list[int] = []
    late: list[_Header] = []
    wrong: list[_Header] = []
    for header in _headers(scene):
        burst, body = header.burst, header.body
        if burst.direction is Role.REQUEST:
            asked.append(header.number)
        elif asked and 0 < (asked[-1] - header.number) & 0xFFFF <= _BACK:
            late.append(header)
        # Its own count of bytes says that it is whole.
        whole = body[1] in READS and len(body) > _LEAST_COUNT and len(body) == _LEAST_COUNT + body[2]
        if asked and whole and len(body) < header.promised and burst.opens and burst.ends:
            wrong.append(header)
    for found, cause, say, todo in (
        (
            late,
            "late_reply",
            "The reply has the number of an earlier request: it came when the host had asked again.",
            "Wait longer for each reply, drop replies of another number, and read what is left before the next request",
        ),
        (
            wrong,
            "wrong_length",
            "The header of Modbus TCP promises more bytes than follow, and the reply in it is whole.",
            "Let the device put the number of bytes behind the count into it: unit, function and data",
        ),
    ):
        if found:
            first = found[0].burst
            troubles = [t for t in scene.troubles if t.stretch is not None and any(t.offset == h.burst.offset for h in found)]
            yield Suspicion(
                cause, Confidence.LIKELY, scene.troubles if 2 * len(found) >= len(asked) else troubles, say,
                f"{shown(first.data[:24])} at byte {first.offset}; {counted(len(found), 'time')}", todo,
                tuple(Shown(h.burst.offset, shown(h.burst.data)) for h in found),
            )  # fmt: skip


def _split_headers(scene: Scene) -> Iterator[Suspicion]:
    """Suspect reads that end within a reply of Modbus TCP: what is read next has as many bytes as its header still promises."""
    found: list[tuple[Stretch, Stretch]] = []
    behind = {one.offset: other for one, other in pairwise(scene.bursts)}
    for header in _headers(scene):
        rest = behind.get(header.burst.offset)
        if rest is None or rest.direction is not header.burst.direction or header.burst.direction is Role.REQUEST:
            continue
        if 0 < len(rest.data) == header.promised - len(header.body):
            found.append((header.burst, rest))
    if not found:
        yield from _half(scene)
        return
    one, other = found[0]
    parts = {part.offset for pair in found for part in pair}
    yield Suspicion(
        "split_frame", Confidence.CERTAIN if len(found) > 1 else Confidence.LIKELY,
        [t for t in scene.troubles if t.offset in parts] or [Trouble("damaged", one.offset)],
        "A reply of Modbus TCP comes in several reads: TCP carries a stream of bytes, and no frames.",
        f"{shown(one.data)} + {shown(other.data)} at byte {one.offset} are one reply; {counted(len(found), 'time')}",
        "Join what is read until as many bytes are there as the header promises: its bytes 4 and 5 are the length of the rest",
        tuple(Shown(a.offset, shown(a.data), shown(a.data + b.data)) for a, b in found),
    )  # fmt: skip


def _half(scene: Scene) -> Iterator[Suspicion]:
    """Suspect a read that ends within a reply of Modbus TCP where words ask about parts, and show no more of it."""
    cut = [
        h for h in _headers(scene)
        if h.burst.direction is not Role.REQUEST and h.burst.ends and _LEAST_COUNT <= len(h.body) < h.promised
        and h.body[1] in READS and h.promised == _LEAST_COUNT + h.body[2]
    ]  # fmt: skip
    if not cut or not any(ASKS_OF_PARTS.search(words) for words in scene.words):
        return
    burst, read = cut[0].burst, counted(len(cut[0].body), "byte")
    yield Suspicion(
        "split_frame", Confidence.LIKELY, [t for t in scene.troubles if any(t.offset == h.burst.offset for h in cut)],
        "A reply of Modbus TCP comes in parts: TCP carries a stream of bytes, and no frames.",
        f"{shown(burst.data)} at byte {burst.offset} has {read} of {cut[0].promised} behind its header",
        "Join what is read until as many bytes are there as the header promises: its bytes 4 and 5 are the length of the rest",
        tuple(Shown(h.burst.offset, shown(h.burst.data)) for h in cut),
    )  # fmt: skip


#: Requests back that a late reply can be of.
_BACK = 8
#: Words of a program that speaks Modbus TCP itself.
_SPEAKS_TCP = re.compile(r"\bmodbus\w*?[-_ ]?tcp|\btransaction[_ ]?id|\bmbap\b|\btcp-(?:client|response)", re.IGNORECASE)


def _before_crc(scene: Scene) -> Iterator[Suspicion]:
    """Suspect headers of Modbus TCP before frames that have their CRC as well: a drive reads them as the beginning."""
    at = {piece.offset: piece for piece in scene.pieces if piece.sound and piece.can is None}
    found = [
        (t, t.stretch.data, frame) for t in scene.damaged
        if t.stretch is not None and len(t.stretch.data) == _HEADER and t.stretch.data[2:5] == b"\0\0\0"
        and (frame := at.get(t.stretch.stop)) is not None and modbus_crc(frame.data) == 0
        and len(frame.data) - t.stretch.data[5] in (0, 2)
    ]  # fmt: skip
    if not found:
        return
    first, header, frame = found[0]
    own = {frame for _, _, frame in found}
    yield Suspicion(
        "tcp_framing", Confidence.CERTAIN if len(found) > 1 else Confidence.LIKELY,
        [*(t for t, _, _ in found), *(t for t in scene.of(*SILENT) if t.piece in own)],
        "The frame has the header of Modbus TCP, and its CRC: a drive takes the header for the beginning of a frame.",
        f"{shown(header + frame.data)} at byte {first.offset}; {counted(len(found), 'time')}",
        f"Switch the program or the gateway to Modbus RTU: {shown(frame.data)}",
        tuple(Shown(t.offset, shown(h + f.data), shown(f.data)) for t, h, f in found),
    )  # fmt: skip


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the dress."""
    yield from _of_header(scene)
    yield from _before_crc(scene)
    yield from _split_headers(scene)
    yield from _told_twice(scene)
    yield from _marked_replies(scene)
    yield from _as_lines(scene)
    for dress in DRESSES:
        found: list[tuple[Trouble, bytes, bytes]] = []
        for trouble in scene.damaged:
            stretch = trouble.stretch
            if stretch is None or stretch.can_id is not None or trouble in scene.explained:
                continue
            frame = dress.undo(scene.reader, stretch.data)
            if frame is not None:
                found.append((trouble, stretch.data, frame))
        if len(found) < dress.least or (dress.least > 1 and len(found) < _MOSTLY * len(scene.damaged)):
            continue
        offsets = {trouble.offset for trouble, _, _ in found}
        if dress.by_none and any(a.offset in offsets and b.direction is Role.REPLY for a, b in pairwise(scene.bursts)):
            continue
        if _all_answered(scene, dress):
            # Who answers takes the header; what it says is another matter.
            scene.explained.update(t for t, _, _ in found)
            yield from _refused(found)
            continue
        first, data, frame = found[0]
        becomes = f" is {shown(frame)}" if frame else ""
        yield Suspicion(
            dress.cause, dress.sure, [t for t, _, _ in found], dress.say,
            f"{shown(data[:32])}{becomes}, at byte {first.offset}; {counted(len(found), 'time')}",
            f"{dress.next}: {shown(frame)}" if frame else dress.next,
            tuple(Shown(t.offset, shown(d), shown(f)) for t, d, f in found),
        )  # fmt: skip


def _as_lines(scene: Scene) -> Iterator[Suspicion]:
    """Suspect a program that ends each request as a line of text."""
    asked = {piece.stop: piece for piece in scene.requests}
    ends = [t for t in scene.damaged if t.stretch is not None and t.stretch.data in _ENDS and t.offset in asked]
    if len(ends) < _AGAIN or len(ends) < _MOSTLY * len(scene.damaged):
        return
    own = {asked[trouble.offset] for trouble in ends}
    first = asked[ends[0].offset].data
    yield Suspicion(
        "text_mode", Confidence.CERTAIN, [*ends, *(t for t in scene.of(*SILENT) if t.piece in own)],
        "The program writes each request as a line of text: an end of line stands behind it.",
        f"{shown(_bytes(ends[0]))} stands behind {shown(first)} at byte {ends[0].offset}; {counted(len(ends), 'time')}",
        f"Write the bytes alone: write instead of println, no end of line in the terminal: {shown(first)}",
        tuple(Shown(t.offset, shown(asked[t.offset].data + _bytes(t)), shown(asked[t.offset].data)) for t in ends),
    )  # fmt: skip


def _bytes(trouble: Trouble) -> bytes:
    return b"" if trouble.stretch is None else trouble.stretch.data


#: Ends of lines, and how many are no chance.
_ENDS, _AGAIN = (b"\r\n", b"\n", b"\r"), 2


def _marked_replies(scene: Scene) -> Iterator[Suspicion]:
    """Suspect an encoding where replies have the right length and head, no byte from 80 on, and question marks instead."""
    found: list[tuple[Trouble, bytes]] = []
    for trouble in scene.damaged:
        stretch = trouble.stretch
        if stretch is None or stretch.direction is Role.REQUEST or _MARK not in stretch.data or not stretch.data.isascii():
            continue
        for reply in replies_to(scene.asked_before(stretch.offset)):
            heads = zip(stretch.data, reply.head, strict=False)
            if len(stretch.data) == reply.size and all(
                was == came or (was > _ASCII and came == _MARK[0]) for came, was in heads
            ):
                found.append((trouble, stretch.data))
                break
    if len(found) < _MARKED or len(found) < _MOSTLY * len(scene.damaged):
        return
    first, data = found[0]
    yield Suspicion(
        "text_mode", Confidence.LIKELY, [t for t, _ in found],
        "Replies are read as ASCII text: no byte is 80 or more, and 3F, a question mark, stands where checks do not fit.",
        f"{shown(data)} at byte {first.offset}; {counted(len(found), 'time')}",
        "Read bytes, not strings: no encoding, no decoding",
        tuple(Shown(t.offset, shown(d)) for t, d in found),
    )  # fmt: skip


#: Replies with question marks that are no chance.
_MARKED = 2


def _told_twice(scene: Scene) -> Iterator[Suspicion]:
    """Suspect a port that is not raw where the same bytes stand twice, and one time some that such a port takes are missing."""
    long = [t for t in scene.damaged if t.stretch is not None and len(t.stretch.data) >= _SHORTEST * 2][:_MOST_COMPARED]
    whole = {t.stretch.data: t for t in long if t.stretch is not None}
    for taken, dress in ((b"\x11\x13", _FLOW_CONTROL), (b"\r", _LINE_ENDS)):
        for data, trouble in whole.items():
            rest = data.translate(None, taken)
            if rest == data or rest not in whole:
                continue
            other = whole[rest]
            yield Suspicion(
                dress.cause, Confidence.LIKELY, [trouble, other], dress.say,
                f"{shown(rest)} at byte {other.offset} is {shown(data)} without {shown(taken)}", dress.next,
                (Shown(other.offset, shown(rest), shown(data)),),
            )  # fmt: skip
            return


#: Stretches that are compared with each other.
_MOST_COMPARED = 200


def _refused(found: list[tuple[Trouble, bytes, bytes]]) -> Iterator[Suspicion]:
    """Suspect what a unit behind Modbus TCP names by its exceptions."""
    refusals = [(t, data, frame[2]) for t, data, frame in found if len(frame) == _REFUSAL and frame[1] ^ 0x80 in FUNCTIONS]
    for code in sorted({code for _, _, code in refusals} & set(EXCEPTIONS)):
        cause, say, todo = EXCEPTIONS[code]
        own = [(t, data) for t, data, other in refusals if other == code]
        first, data = own[0]
        # Where all is refused, that is what all of it is about.
        told = found if 2 * len(own) >= len(found) else own
        yield Suspicion(
            cause, Confidence.LIKELY, [row[0] for row in told], f"The device refuses by exception {code:02X}: {say}.",
            f"{shown(data)} at byte {first.offset}; {counted(len(own), 'time')}", todo,
            tuple(Shown(t.offset, shown(d)) for t, d in own),
        )  # fmt: skip


#: Bytes of the number of a request and of the protocol behind it.
_NUMBERED = 4
#: The size of an exception with its CRC; of a request without one, and the last function of those.
_REFUSAL, _REQUEST, _WRITES_ONE = 5, 6, 6


def _all_answered(scene: Scene, dress: Dress) -> bool:
    """Say whether the wrapped requests have wrapped replies, all but one: then who answers takes the header."""
    if dress.undo is not _tcp:
        return False
    words = "\n".join(scene.words)
    # A program that speaks it and gets nothing has a drive that does not take it.
    silent = NOTHING_CAME.search(words) is not None and all(_is_request(header.body) for header in _headers(scene))
    if _SPEAKS_TCP.search(words) is not None and not scene.shows_sent and not silent:
        return True
    sent, came = (
        {(header.number, header.body[0]) for header in _headers(scene) if header.burst.direction is role}
        for role in (Role.REQUEST, Role.REPLY)
    )
    # A log that is cut may begin with a reply and end with a request.
    begun = bool(sent) and bool(came) and len(came) + 1 >= len(sent)
    return (bool(sent) and sent <= came) or begun or _numbers_return(scene) or _replies_alone(scene)


def _is_request(body: bytes) -> bool:
    """Say whether what stands behind a header is as long as a request to read, or to write one register."""
    return len(body) == _REQUEST and body[1] <= _WRITES_ONE


def _replies_alone(scene: Scene) -> bool:
    """Say whether whole replies with a header were received, and nothing shows requests: the device has put it there."""
    replies = [
        h for h in _headers(scene)
        if h.burst.direction is Role.REPLY and h.body[1] in READS and h.promised == _LEAST_COUNT + h.body[2]
    ]  # fmt: skip
    return bool(replies) and not scene.shows_sent and not scene.requests


def _numbers_return(scene: Scene) -> bool:
    """Say whether what is received begins with the number of a request and its protocol, and is not that request itself."""
    sent = [burst.data for burst in scene.bursts if burst.direction is Role.REQUEST]
    numbers = {data[:_NUMBERED] for data in sent}
    return any(
        len(b.data) > _HEADER and b.data[:_NUMBERED] in numbers and b.data[2:_NUMBERED] == b"\0\0"
        and not any(data[:len(b.data)] == b.data[:len(data)] for data in sent)
        for b in scene.bursts if b.direction is Role.REPLY
    )  # fmt: skip
