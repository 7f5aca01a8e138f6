"""Frames in another dress: read or sent as text, or with the header of another transport."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import NamedTuple

from analyzer.diagnosis.reader import Reader
from analyzer.diagnosis.scene import Confidence, Scene, Shown, Suspicion, Trouble, shown
from analyzer.link.modbus import FUNCTIONS, modbus_crc
from analyzer.values import counted

_REPLACED = b"\xef\xbf\xbd"
_HEX = re.compile(rb"(?:0x)?[0-9A-Fa-f]{2}(?:[ ,]*(?:0x)?[0-9A-Fa-f]{2}){2,}[\s,]*")
_HEADER = 6


class Dress(NamedTuple):
    """A way in which a frame is wrapped. `undo`: the frame of some bytes, empty where it is lost, None where none is."""

    cause: str
    undo: Callable[[Reader, bytes], bytes | None]
    say: str
    next: str


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


def _letters(reader: Reader, data: bytes) -> bytes | None:
    if not _HEX.fullmatch(data):
        return None
    frame = bytes.fromhex(re.sub(rb"0x|[\s,]", b"", data).decode())
    return frame if reader.best(frame) is not None or reader.closed(frame) else None


def _tcp(reader: Reader, data: bytes) -> bytes | None:
    if len(data) <= _HEADER + 1 or data[2:5] != b"\0\0\0" or data[5] != len(data) - _HEADER:
        return None
    body = data[_HEADER:]
    return body + modbus_crc(body).to_bytes(2, "little") if body[1] & 0x7F in FUNCTIONS else None


DRESSES = (
    Dress(
        "text_mode", _replaced, "Bytes are read as UTF-8 text: what is no text is replaced by EF BF BD, and lost.",
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
        if not found:
            continue
        first, data, frame = found[0]
        becomes = f" is {shown(frame)}" if frame else ""
        yield Suspicion(
            dress.cause, Confidence.CERTAIN, [t for t, _, _ in found], dress.say,
            f"{shown(data[:32])}{becomes}, at byte {first.offset}; {counted(len(found), 'time')}",
            f"{dress.next}: {shown(frame)}" if frame else dress.next,
            tuple(Shown(t.offset, shown(d), shown(f)) for t, d, f in found),
        )  # fmt: skip
