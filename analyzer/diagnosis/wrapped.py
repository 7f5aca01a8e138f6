"""Frames in another dress: read or sent as text, or with the header of another transport."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import NamedTuple

from analyzer.catalogue import Role
from analyzer.diagnosis.reader import Reader
from analyzer.diagnosis.scene import Confidence, Scene, Shown, Suspicion, Trouble, shown
from analyzer.link.modbus import FUNCTIONS, modbus_crc
from analyzer.values import counted

_REPLACED = b"\xef\xbf\xbd"
_HEX = re.compile(rb"(?:0x|\\x)?[0-9A-Fa-f]{2}(?:[\s,;:-]*(?:0x|\\x)?[0-9A-Fa-f]{2}){2,}[\s,;]*")
_HEADER = 6
_LEAST_COUNT = 3
_MOSTLY = 0.6
#: Bytes of a frame of a serial dialect, at least and at most, where many stand in a row.
_SHORTEST, _LONGEST = 4, 16


class Dress(NamedTuple):
    """A way in which a frame is wrapped. `undo`: the frame of some bytes, empty where it is lost, None where none is.

    `least`: so many times, and so mostly, that it is no chance.
    """

    cause: str
    undo: Callable[[Reader, bytes], bytes | None]
    say: str
    next: str
    least: int = 1


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


def _flow_control(reader: Reader, data: bytes) -> bytes | None:
    """Put a byte back that software flow control takes away."""
    if not 2 < len(data) <= _LONGEST or reader.best(data) is not None:
        return None
    for at in range(2, len(data)):
        for lost in (b"\x11", b"\x13"):
            frame = data[:at] + lost + data[at:]
            if (reading := reader.best(frame)) is not None and reading.listed:
                return frame
    return None


def _letters(reader: Reader, data: bytes) -> bytes | None:
    if not _HEX.fullmatch(data):
        return None
    frame = bytes.fromhex(re.sub(rb"0x|\\x|[^0-9A-Fa-f]", b"", data).decode())
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
    return b"".join(body + modbus_crc(body).to_bytes(2, "little") for body in bodies)


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
        "text_mode", _line_ends, "A port in text mode puts 0D before each 0A.",
        "Open the port raw: no conversion of line ends (stty raw, -onlcr)",
    ),
    Dress(
        "text_mode", _flow_control, "Bytes 11 and 13 are missing: software flow control (XON/XOFF) takes them away.",
        "Switch software flow control off (stty raw -ixon -ixoff; xonxoff=False)", 3,
    ),
    Dress(
        "tcp_framing", _tcp, "The frame has the header of Modbus TCP and no CRC: an RTU drive does not take it.",
        "Switch the program or the gateway to Modbus RTU (over TCP: to RTU conversion)",
    ),
)  # fmt: skip


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the dress."""
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
        first, data, frame = found[0]
        becomes = f" is {shown(frame)}" if frame else ""
        yield Suspicion(
            dress.cause, Confidence.POSSIBLE if _all_answered(scene, dress) else Confidence.CERTAIN, [t for t, _, _ in found],
            dress.say,
            f"{shown(data[:32])}{becomes}, at byte {first.offset}; {counted(len(found), 'time')}",
            f"{dress.next}: {shown(frame)}" if frame else dress.next,
            tuple(Shown(t.offset, shown(d), shown(f)) for t, d, f in found),
        )  # fmt: skip


def _all_answered(scene: Scene, dress: Dress) -> bool:
    """Say whether each wrapped request has a reply of its number and unit: then who answers takes the header."""
    if dress.undo is not _tcp or not scene.directed:
        return False
    sent, came = (
        [burst.data[:2] + burst.data[_HEADER : _HEADER + 1] for burst in scene.bursts if burst.direction is role]
        for role in (Role.REQUEST, Role.REPLY)
    )
    return bool(sent) and set(sent) <= set(came)
