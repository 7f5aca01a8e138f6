"""pcapng for Wireshark: an interface for each bus, times in nanoseconds, the sender in the flags, comments as comments.

    section header (this program's name) | interface: link type, name, resolution 9 | enhanced packet block ...

    CAN     SocketCAN (227): ID and flags, big endian; length; FD flags; data
    serial  USER0 (147): the bytes only; or RTAC serial (250): 4 s, 4 us, event, control lines, 2 footer, bytes

A comment stands at the next packet, or at the last packet if none follows. RTAC has events only for sent and received; an
unknown sender is written as received, and the flags say unknown.
"""

from __future__ import annotations

import struct
from typing import IO

from analyzer import __version__
from analyzer.catalogue import Role
from analyzer.export import Choices, Writer
from analyzer.records import CanFrame, Chunk, Comment
from analyzer.values import SECOND_NS

SOCKETCAN = 227
SERIAL_LINKS = {"user": 147, "rtac": 250}
#: How the section says who wrote it; the reader takes directions from such a file as they are.
APPLICATION = f"servotap {__version__}"

_SECTION = 0x0A0D0D0A
_INTERFACE = 1
_ENHANCED = 6
_BYTE_ORDER = 0x1A2B3C4D
_COMMENT, _FLAGS = 1, 2
_APPLICATION = 4
_NAME, _RESOLUTION = 2, 9
_NANOSECONDS = b"\x09"
#: An option's length has two bytes.
_OPTION_LIMIT = 0xFFFF
_DIRECTIONS = {Role.REPLY: 1, Role.REQUEST: 2}
_RTAC = struct.Struct(">LLBBH")
_RTAC_SENT, _RTAC_RECEIVED = 1, 2
_CAN_HEAD = struct.Struct(">LBBxx")
_EXTENDED, _REMOTE, _ERROR = 0x8000_0000, 0x4000_0000, 0x2000_0000
_FD = 0x04
_PACKET = struct.Struct("<LLLLL")


class PcapngWriter(Writer):
    """Writes a packet for each CAN frame and each piece of serial bytes."""

    def __init__(self, stream: IO[bytes], choices: Choices) -> None:
        super().__init__(stream, choices)
        self._interfaces: dict[tuple[str, int], int] = {}
        self._comments: list[str] = []
        # One packet is held back, so that comments behind the last one have a place.
        self._held: tuple[bytes, list[str], int] | None = None
        head = struct.pack("<LHHq", _BYTE_ORDER, 1, 0, -1)
        self._block(_SECTION, head + _option(_APPLICATION, APPLICATION.encode()) + _END)

    def traffic(self, item: Chunk | CanFrame) -> None:
        assert item.t_ns is not None  # the export makes times up where there are none
        if isinstance(item, CanFrame):
            link, data = SOCKETCAN, _socketcan(item)
        else:
            link = SERIAL_LINKS[self.choices.serial_as]
            data = item.data if link != SERIAL_LINKS["rtac"] else _rtac(item)
        number = self._interface(item.port, link)
        packet = _PACKET.pack(number, item.t_ns >> 32, item.t_ns & 0xFFFF_FFFF, len(data), len(data)) + _padded(data)
        self._release()
        self._held = (packet, self._comments, _DIRECTIONS.get(item.direction, 0))
        self._comments = []

    def comment(self, comment: Comment) -> bool:
        """Keep a comment for the packet that follows."""
        self._comments.append(comment.text)
        return True

    def finish(self) -> int:
        """Write the last packet with the comments that are left; return how many found no packet."""
        if self._held is None:
            return len(self._comments)
        self._held[1].extend(self._comments)
        self._comments = []
        self._release()
        return 0

    def _interface(self, port: str, link: int) -> int:
        number = self._interfaces.get((port, link))
        if number is None:
            self._release()
            number = self._interfaces[port, link] = len(self._interfaces)
            options = _option(_NAME, port.encode()) + _option(_RESOLUTION, _NANOSECONDS) + _END
            self._block(_INTERFACE, struct.pack("<HHL", link, 0, 0) + options)
        return number

    def _release(self) -> None:
        if self._held is None:
            return
        packet, comments, direction = self._held
        self._held = None
        options = b"".join(_option(_COMMENT, text.encode()[:_OPTION_LIMIT]) for text in comments)
        if direction:
            options += _option(_FLAGS, direction.to_bytes(4, "little"))
        self._block(_ENHANCED, packet + (options + _END if options else b""))

    def _block(self, kind: int, body: bytes) -> None:
        size = struct.pack("<L", len(body) + 12)
        self.stream.write(struct.pack("<L", kind) + size + body + size)


def _padded(data: bytes) -> bytes:
    return data + b"\0" * (-len(data) % 4)


def _option(code: int, data: bytes) -> bytes:
    return struct.pack("<HH", code, len(data)) + _padded(data)


_END = _option(0, b"")


def _socketcan(frame: CanFrame) -> bytes:
    bits = frame.id
    if frame.error:
        bits |= _ERROR
    elif frame.extended:
        bits |= _EXTENDED
    if frame.remote:
        bits |= _REMOTE
    return _CAN_HEAD.pack(bits, len(frame.data), _FD if frame.fd else 0) + frame.data


def _rtac(chunk: Chunk) -> bytes:
    assert chunk.t_ns is not None  # as above
    seconds, rest = divmod(chunk.t_ns, SECOND_NS)
    event = _RTAC_SENT if chunk.direction is Role.REQUEST else _RTAC_RECEIVED
    return _RTAC.pack(seconds & 0xFFFF_FFFF, rest // 1000, event, 0, 0) + chunk.data
