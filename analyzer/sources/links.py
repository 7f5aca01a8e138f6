"""What lies inside a pcap or pcapng record, by its link type: CAN frames and serial bytes.

    227  SocketCAN        ID and flags (4, big endian), length, FD flags, 2 reserved, data
    113  Linux cooked     2 packet type, 2 device type, 2 + 8 address, 2 protocol; then as SocketCAN, ID in file order
    276  Linux cooked 2   2 protocol, 2 reserved, 4 interface, 2 device type, packet type, 1 + 8 address; likewise
    147..162  USER0..15   serial bytes, nothing else
    250  RTAC serial      4 s, 4 us, event, control lines, 2 footer, then serial bytes

Who sent a record: the host if the capture says "outgoing" or "transmitted". Received serial bytes are a reply only once
something was transmitted: a listener receives everything. A file that says who sent is believed from its first record.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from analyzer.catalogue import Role
from analyzer.records import CanFrame, Chunk, Comment
from analyzer.sources.source import Source
from analyzer.values import CAN_ID_LIMIT, CAN_ID_MASK

SOCKETCAN = 227
_EXTENDED = 0x8000_0000
_REMOTE = 0x4000_0000
_ERROR = 0x2000_0000
_FD_FLAG = 0x04
_XL_FLAG = 0x80
_FD_SIZE = 72
_CAN_HEADER = 8
_COOKED = {113: (14, 16), 276: (0, 20)}  # link type -> place of the protocol, size of the header
_COOKED_CAN = frozenset({0x000C, 0x000D})
_COOKED_KIND = {113: 1, 276: 10}  # place of the packet type's last byte
_COOKED_OUTGOING = 4
_RTAC_HEADER = 12
#: RTAC events that carry or may carry data: whether the device transmitted.
_RTAC_DATA = {1: True, 2: False, 3: True, 4: False}
_RTAC_EVENTS = {
    0: "status change", 5: "capture data lost", 6: "capture complete", 7: "framing error", 8: "parity error",
    9: "break", 10: "overflow",
}  # fmt: skip


@dataclass
class Line:
    """One interface of a capture.

    `order`: byte order of the file. `sent`: a record of the host was seen. `told`: the flags say who sent, not what a
    listener received.
    """

    source: Source
    link: int
    port: str
    order: str
    sent: bool = False
    told: bool = False

    def serial_role(self, outgoing: bool | None) -> Role:
        """Return who sent serial bytes, from whether the capture calls them outgoing."""
        if outgoing is None:
            return Role.UNKNOWN
        if outgoing:
            self.sent = True
            return Role.REQUEST
        return Role.REPLY if self.sent or self.told else Role.UNKNOWN

    def can_role(self, outgoing: bool | None) -> Role:
        """Return who sent a CAN frame, likewise."""
        if outgoing:
            return Role.REQUEST
        return Role.REPLY if self.told and outgoing is False else Role.UNKNOWN


Taken = CanFrame | Chunk | Comment | None


def _can(line: Line, t_ns: int | None, data: bytes, outgoing: bool | None, order: str = "big") -> Taken:
    if len(data) < _CAN_HEADER or data[5] & _XL_FLAG or data[4] > len(data) - _CAN_HEADER:
        line.source.problem(f"expected a CAN frame (8 bytes and its data), got {data[:12].hex(' ').upper() or 'nothing'}")
        return None
    bits = int.from_bytes(data[:4], "big" if order == "big" else "little")
    length = data[4]
    extended = bool(bits & _EXTENDED)
    taken = CanFrame(
        t_ns,
        line.port,
        bits & (CAN_ID_MASK if extended or bits & _ERROR else CAN_ID_LIMIT),
        data[_CAN_HEADER : _CAN_HEADER + length],
        line.can_role(outgoing),
        extended,
        bool(bits & _REMOTE),
        bool(bits & _ERROR),
        bool(data[5] & _FD_FLAG) or length > 8 or len(data) == _FD_SIZE,
    )
    return line.source.carried(taken) if taken.remote else taken


def _cooked(line: Line, t_ns: int | None, data: bytes, outgoing: bool | None) -> Taken:
    at, size = _COOKED[line.link]
    protocol = int.from_bytes(data[at : at + 2], "big")
    if len(data) < size or protocol not in _COOKED_CAN:
        line.source.note("records other than CAN frames were left out")
        return None
    if data[_COOKED_KIND[line.link]] == _COOKED_OUTGOING:
        outgoing = True
    return _can(line, t_ns, data[size:], outgoing, line.order)


def _serial(line: Line, t_ns: int | None, data: bytes, outgoing: bool | None) -> Taken:
    return Chunk(t_ns, line.port, data, line.serial_role(outgoing), True) if data else None


def _rtac(line: Line, t_ns: int | None, data: bytes, outgoing: bool | None) -> Taken:
    if len(data) < _RTAC_HEADER:
        line.source.problem(f"expected an RTAC header of 12 bytes, got {data.hex(' ').upper() or 'nothing'}")
        return None
    event, body = data[8], data[_RTAC_HEADER:]
    if body:
        sent = outgoing if line.told else _RTAC_DATA.get(event, outgoing)
        return Chunk(t_ns, line.port, body, line.serial_role(sent), True)
    text = _RTAC_EVENTS.get(event)
    return Comment(t_ns, line.port, text) if text is not None else None


#: Link types that are read: kind of the bus, and what takes a record apart.
LINKS: dict[int, tuple[str, Callable[[Line, int | None, bytes, bool | None], Taken]]] = {
    SOCKETCAN: ("can", _can),
    113: ("can", _cooked),
    276: ("can", _cooked),
    250: ("serial", _rtac),
    **dict.fromkeys(range(147, 163), ("serial", _serial)),
}

#: Link types that people meet, for messages.
_NAMES = {1: "Ethernet", 101: "raw IP", 105: "Wi-Fi", 189: "USB", 220: "USB", 249: "USB", 190: "CAN 2.0B (AVAL)"}


def link_name(link: int) -> str:
    """Return a link type for a message."""
    return f"{link} ({_NAMES[link]})" if link in _NAMES else str(link)


EXPECTED = "expected SocketCAN (227), Linux cooked with CAN (113, 276), USER0..15 (147..162) or RTAC serial (250)"
