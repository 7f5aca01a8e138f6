"""The serial side of CAN adapters: frames of an adapter's own, with CAN frames inside, where a drive's bytes should be."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import NamedTuple

from analyzer.catalogue import Role
from analyzer.diagnosis.scene import Confidence, Scene, Shown, Suspicion, shown
from analyzer.values import counted

_MOST_DATA = 8
#: The share of the bytes that an adapter's frames have to be.
_SHARE = 0.8
_ENOUGH = 2
#: Bytes of a stretch that are looked at: more of the same shows nothing new.
_LOOKED = 6000


class Carried(NamedTuple):
    """A frame of an adapter: its bytes, and the CAN frame in it; an identifier of -1: a word to the adapter itself."""

    size: int
    id: int = -1
    data: bytes = b""


_SLCAN = re.compile(rb"(?:t([0-9A-Fa-f]{3})|T([0-9A-Fa-f]{8}))([0-8])((?:[0-9A-Fa-f]{2})*)[0-9A-Fa-f]{0,4}\r")
_SLCAN_WORD = re.compile(rb"(?:S[0-8]|s[0-9A-Fa-f]{4,6}|Z[01]|[OLCVNF])\r")


def _slcan(data: bytes, at: int) -> Carried | None:
    found = _SLCAN.match(data, at)
    if found is None:
        word = _SLCAN_WORD.match(data, at)
        return None if word is None else Carried(word.end() - at)
    count = 2 * int(found[3])
    payload = found[4][:count].decode()
    if len(payload) < count:
        return None
    return Carried(found.end() - at, int(found[1] or found[2], 16), bytes.fromhex(payload))


def _at(data: bytes, at: int) -> Carried | None:
    """Read `AT`, an identifier moved to the left, a count, data, and the end of a line."""
    if not data.startswith(b"AT", at) or len(data) < at + 9 or data[at + 6] > _MOST_DATA:
        return None
    stop = at + 7 + data[at + 6]
    identifier = int.from_bytes(data[at + 2 : at + 6], "big")
    # The lowest bits say whether it has 29 bits, and whether it is a remote frame.
    number = identifier >> 3 if identifier & 0x04 else identifier >> 21
    return Carried(stop + 2 - at, number, data[at + 7 : stop]) if data.startswith(b"\r\n", stop) else None


def _marked(data: bytes, at: int) -> Carried | None:
    """Read `AA`, a type with a count, an identifier with the low byte first, data, and `55`."""
    if not data.startswith(b"\xaa", at) or len(data) < at + 5:
        return None
    if data[at + 1] & 0xC0 != 0xC0 or data[at + 1] & 0x0F > _MOST_DATA:
        return None
    wide = 4 if data[at + 1] & 0x20 else 2
    stop = at + 2 + wide + (data[at + 1] & 0x0F)
    identifier = int.from_bytes(data[at + 2 : at + 2 + wide], "little")
    return Carried(stop + 1 - at, identifier, data[at + 2 + wide : stop]) if data.startswith(b"\x55", stop) else None


def _thirteen(data: bytes, at: int) -> Carried | None:
    """Read thirteen bytes: a count, an identifier of four bytes, and eight of data, zeros behind those that count."""
    if len(data) < at + 13 or data[at] & 0x3F > _MOST_DATA or not data[at] & 0x3F:
        return None
    identifier = int.from_bytes(data[at + 1 : at + 5], "big")
    payload, rest = data[at + 5 : at + 5 + (data[at] & 0x0F)], data[at + 5 + (data[at] & 0x0F) : at + 13]
    small = identifier <= (0x1FFFFFFF if data[at] & 0x80 else 0x7FF)
    return Carried(13, identifier, payload) if small and not any(rest) else None


def _twenty(data: bytes, at: int) -> Carried | None:
    """Read `AA 55 01`, two kinds, an identifier with the low byte first, a count, eight bytes of data, `00`, and the sum."""
    frame = data[at : at + 20]
    if len(frame) < 20 or not frame.startswith(b"\xaa\x55\x01") or frame[9] > _MOST_DATA:
        return None
    fits = sum(frame[2:-1]) & 0xFF == frame[-1]
    return Carried(20, int.from_bytes(frame[5:9], "little"), frame[10 : 10 + frame[9]]) if fits else None


def _gvret(data: bytes, at: int) -> Carried | None:
    """Read `F1 00`, an identifier with the low byte first, the bus, a count, and data."""
    if not data.startswith(b"\xf1\x00", at) or len(data) < at + 8 or data[at + 7] > _MOST_DATA or data[at + 6] > 2:
        return None
    stop = at + 8 + data[at + 7]
    identifier = int.from_bytes(data[at + 2 : at + 6], "little") & 0x1FFFFFFF
    return Carried(stop + 1 - at, identifier, data[at + 8 : stop]) if stop < len(data) else None


class Adapter(NamedTuple):
    """An adapter, and how its frames are read. `plain`: they have a mark at both ends, so that one is evidence."""

    name: str
    read: Callable[[bytes, int], Carried | None]
    plain: bool


ADAPTERS = (
    Adapter("a USB-CAN stick (AT ... CR LF)", _at, True),
    Adapter("a USB-CAN adapter that speaks slcan (Lawicel)", _slcan, True),
    Adapter("a USB-CAN adapter (AA ... 55)", _marked, True),
    Adapter("a USB-CAN adapter (AA 55, 20 bytes a frame)", _twenty, True),
    Adapter("a USB-CAN adapter that speaks GVRET", _gvret, False),
    Adapter("a serial or Ethernet CAN gateway (13 bytes a frame)", _thirteen, False),
)


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect an adapter."""
    troubles = [t for t in scene.troubles if t.stretch is not None and t.stretch.can_id is None and t not in scene.explained]
    for adapter in ADAPTERS:
        found = []
        for trouble in troubles:
            assert trouble.stretch is not None  # chosen so above
            looked = trouble.stretch.data[:_LOOKED]
            frames = _frames(adapter, looked)
            if sum(f.size for f in frames) >= _SHARE * len(looked):
                found.append((trouble, frames))
        carried = [frame for _, frames in found for frame in frames]
        different = {(f.id, f.data) for f in carried}
        if not carried or (not adapter.plain and len(different) < _ENOUGH) or (len(carried) < _ENOUGH and carried[0].id < 0):
            continue
        first = found[0][0]
        assert first.stretch is not None  # chosen so above
        inner = next((f for f in carried if f.id >= 0), None)
        inside = f", in it {shown(inner.data, inner.id)}" if inner is not None else ""
        asks = any(t.stretch is not None and t.stretch.direction is Role.REQUEST for t, _ in found)
        yield Suspicion(
            "adapter_framing", Confidence.CERTAIN if len(carried) >= _ENOUGH else Confidence.LIKELY, [t for t, _ in found],
            f"The bytes are the frames of {adapter.name}, not those of a drive.",
            f"{shown(first.stretch.data[:24])} at byte {first.offset}{inside}; {counted(len(carried), 'frame')}",
            "Open the adapter as CAN (python-can, `servotap record` with its CAN driver), or capture behind it"
            + ("; a drive on RS485 does not take these frames" if asks else ""),
            tuple(Shown(t.offset, shown(t.stretch.data[:32])) for t, _ in found if t.stretch is not None),
        )  # fmt: skip
        return


def _frames(adapter: Adapter, data: bytes) -> list[Carried]:
    """Return an adapter's frames, as far as they can still be enough."""
    found: list[Carried] = []
    at = between = 0
    while at < len(data) and between <= (1 - _SHARE) * len(data):
        frame = adapter.read(data, at)
        if frame is not None:
            found.append(frame)
        between += frame is None
        at += 1 if frame is None else frame.size
    return found
