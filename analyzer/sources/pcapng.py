"""pcapng: sections, interfaces, and records with times in each interface's own resolution.

    type, length, body, length | ...
    section header: byte order      interface: link type, name, resolution      enhanced, simple, old packet blocks

Times are exact. An interface's name becomes the port; comments of records and sections are given on; who sent a record
comes from its flags. A section that this program exported says who sent as it is, where others only say what came in.
Blocks of other types are passed over.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial

from analyzer.columns.block import CanBlock
from analyzer.errors import UnreadableError
from analyzer.records import Comment
from analyzer.sources import magic
from analyzer.sources.links import EXPECTED, LINKS, SOCKETCAN, Line, link_name
from analyzer.sources.source import TOGETHER, Record, Source
from analyzer.sources.stream import Stream
from analyzer.values import SECOND_NS, counted

_SECTION = 0x0A0D0D0A
_INTERFACE = 1
_OLD = 2
_SIMPLE = 3
_ENHANCED = 6
#: Blocks that carry no traffic: names, statistics, journal, secrets, custom ones; and the bit of local types.
_OTHERS = frozenset({4, 5, 9, 10, 0x0BAD, 0x4000_0BAD})
_LOCAL = 0x8000_0000
#: No block of a CAN or serial capture comes near; what claims more is damage.
_BLOCK_LIMIT = 16 << 20
_LEAST_BLOCK = 12
_COMMENT = 1
#: Comments of one block that are kept.
_COMMENTS = 1000
_APPLICATION = 4
_OWN = b"servotap "
_NAME = 2
_RESOLUTION = 9
_OFFSET = 14
_FLAGS = 2
_OUTGOING = {1: False, 2: True}
#: Bytes that are read block by block where no records stand that can be taken together, before they are looked for again.
_APART = 4096
#: Bits of a resolution exponent that are of use: 10 ** 18 and 2 ** 60 are finer than any clock.
_FINEST = 60


@dataclass
class _Interface:
    line: Line | None
    take: Callable[..., Record | None] | None
    ticks: int = 1_000_000
    start_ns: int = 0
    longest: int = 0

    def t_ns(self, high: int, low: int) -> int:
        """Return the time of a record."""
        return self.start_ns + ((high << 32) | low) * SECOND_NS // self.ticks


@dataclass
class _Section:
    order: str = "<"
    interfaces: list[_Interface] = field(default_factory=list)
    own: bool = False

    def interface(self, number: int) -> _Interface | None:
        """Return an interface by number, None if the section does not declare it."""
        return self.interfaces[number] if number < len(self.interfaces) else None


def read(source: Source) -> Iterator[Record | CanBlock]:
    """Read the records."""
    if not magic.of_pcapng(source.head):
        shown = source.head[:12].hex(" ").upper()
        raise UnreadableError(f"{source.name}: expected a pcapng section header (0A 0D 0D 0A ...), got {shown}")
    source.time_source = "capture: exact, in the steps of each interface"
    source.kind = _first_kind(source.head, magic.PCAPNG_ORDERS[source.head[8:12]]) or "serial"
    return _records(source)


def _first_kind(head: bytes, order: str) -> str | None:
    """Return the kind of the first interface that a head declares."""
    at = 0
    while at + _LEAST_BLOCK <= len(head):
        kind, length = struct.unpack_from(order + "LL", head, at)
        if kind == _INTERFACE and at + 10 <= len(head):
            link = struct.unpack_from(order + "H", head, at + 8)[0]
            if link in LINKS:
                return LINKS[link][0]
        if length < _LEAST_BLOCK:
            break
        at += length
    return None


class _Ahead:
    """The bytes of a stream, of which some may be looked at ahead."""

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._data = b""
        self._at = 0

    def exactly(self, count: int) -> bytes:
        """Return `count` bytes, fewer only at the end."""
        end = self._at + count
        if end > len(self._data):
            self._data = self._data[self._at :] + self._stream.exactly(end - len(self._data))
            self._at, end = 0, count
        taken = self._data[self._at : end]
        self._at = end
        return taken

    def look(self) -> bytes:
        """Return many of the bytes that come."""
        left = self._data[self._at :]
        self._data, self._at = left + self._stream.exactly(TOGETHER - len(left)), 0
        return self._data


def _blocks(source: Source, section: _Section) -> Iterator[tuple[int, bytes] | CanBlock]:
    """Yield (type, body) of each block, or many frames at once; keeps the byte order of the section."""
    stream = _Ahead(source.stream)
    #: `singly`: up to here blocks are read one by one. `apart`: how far, after looks that found nothing.
    offset = singly = apart = 0
    while True:
        while source.in_blocks and offset >= singly:
            before = offset
            for size, block in _pieces(stream.look(), section):
                if block is None:
                    singly = offset + size
                    break
                stream.exactly(size)
                yield block
                offset += size
            apart = min(2 * apart + 64, _APART) if offset == before else 0
            singly = max(singly, offset + apart)
        head = stream.exactly(_LEAST_BLOCK)
        if not head:
            return
        if head[:4] == magic.PCAPNG:
            section.order = magic.PCAPNG_ORDERS.get(head[8:12], section.order)
        if len(head) < _LEAST_BLOCK:
            source.problem(f"the last block breaks off after {counted(len(head), 'byte')}", offset=offset)
            return
        kind, length = struct.unpack_from(section.order + "LL", head)
        if not _LEAST_BLOCK <= length <= _BLOCK_LIMIT:
            source.problem(f"a block of {length} bytes, expected {_LEAST_BLOCK}..{_BLOCK_LIMIT}", offset=offset)
            return
        # Some writers leave out the padding in the length.
        padded = length + -length % 4
        rest = stream.exactly(padded - _LEAST_BLOCK)
        if len(rest) < padded - _LEAST_BLOCK:
            source.problem(f"the last block breaks off after {len(head) + len(rest)} of {length} bytes", offset=offset)
            return
        again = struct.unpack_from(section.order + "L", (head + rest)[-4:])[0]
        if again not in (length, padded):
            source.problem(f"a block says at its end that it has {again} bytes, expected {length}", offset=offset)
        yield kind, (head[8:] + rest)[: length - _LEAST_BLOCK]
        offset += padded


def _pieces(buffer: bytes, section: _Section) -> Iterator[tuple[int, CanBlock | None]]:
    from analyzer.sources.pcapng_blocks import CanInterface, pieces

    interfaces = [
        CanInterface(each.line.port, SECOND_NS // each.ticks, each.start_ns)
        if each.line is not None and each.line.link == SOCKETCAN and not SECOND_NS % each.ticks and _near(each.start_ns)
        else None
        for each in section.interfaces
    ]
    return pieces(buffer, section.order, interfaces)


def _near(t_ns: int) -> bool:
    """Say whether times that begin here fit into columns."""
    return abs(t_ns) < 1 << 61


def _options(section: _Section, data: bytes) -> dict[int, bytes]:
    """Return a block's options, the first of each code; of comments, which may be several, the first ones in lines."""
    found: dict[int, bytes] = {}
    comments: list[bytes] = []
    at = 0
    while at + 4 <= len(data):
        code, length = struct.unpack_from(section.order + "HH", data, at)
        if code == 0:
            break
        if code == _COMMENT and len(comments) < _COMMENTS:
            comments.append(data[at + 4 : at + 4 + length])
        elif code not in found:
            found[code] = data[at + 4 : at + 4 + length]
        at += 4 + length + -length % 4
    if comments:
        found[_COMMENT] = b"\n".join(comments)
    return found


def _records(source: Source) -> Iterator[Record | CanBlock]:
    section = _Section()
    unknown = 0
    for each in _blocks(source, section):
        if isinstance(each, CanBlock):
            source.stream.budget.record(len(each))
            yield each
            continue
        kind, body = each
        source.stream.budget.record()
        handler = _HANDLERS.get(kind)
        if handler is None:
            unknown += kind not in _OTHERS and not kind & _LOCAL
            continue
        try:
            yield from handler(source, section, body)
        except struct.error:
            source.problem(f"a block of type {kind} is too short: {counted(len(body), 'byte')}")
    if unknown:
        source.note(f"{counted(unknown, 'block')} of types that pcapng does not have passed over")


def _begin_section(source: Source, section: _Section, body: bytes) -> Iterator[Record]:
    section.interfaces.clear()
    options = _options(section, body[16:])
    section.own = options.get(_APPLICATION, b"").startswith(_OWN)
    text = options.get(_COMMENT)
    if text:
        yield source.comment(None, text.decode("utf-8", "replace"))


def _begin_interface(source: Source, section: _Section, body: bytes) -> Iterator[Record]:
    link, _, longest = struct.unpack_from(section.order + "HHL", body)
    options = _options(section, body[8:])
    if link not in LINKS:
        source.problem(f"an interface of link type {link_name(link)} carries no drive traffic, {EXPECTED}")
        section.interfaces.append(_Interface(None, None))
        return
    kind, take = LINKS[link]
    name = options.get(_NAME, b"").decode("utf-8", "replace").strip("\0 ")
    if not name and section.interfaces:
        name = f"{kind}{len(section.interfaces)}"
    order = "little" if section.order == "<" else "big"
    line = Line(source, link, source.port(name or None, kind), order, told=section.own)
    resolution = options.get(_RESOLUTION, b"\x06")[:1] or b"\x06"
    base, exponent = (2 if resolution[0] & 0x80 else 10), min(resolution[0] & 0x7F, _FINEST)
    seconds = int.from_bytes(options.get(_OFFSET, b""), "little" if section.order == "<" else "big", signed=True)
    section.interfaces.append(_Interface(line, take, base**exponent, seconds * SECOND_NS, longest))
    yield from ()


def _give(
    source: Source,
    interface: _Interface | None,
    number: int,
    t_ns: int | None,
    data: bytes,
    options: dict[int, bytes],
    order: str,
) -> Iterator[Record]:
    if interface is None:
        source.problem(f"a record of interface {number}, which the section does not declare")
        return
    if interface.line is None or interface.take is None:
        return
    text = options.get(_COMMENT)
    if text:
        yield Comment(t_ns, interface.line.port, source.comment(None, text.decode("utf-8", "replace")).text)
    flags = int.from_bytes(options.get(_FLAGS, b"")[:4], "little" if order == "<" else "big")
    taken = interface.take(interface.line, t_ns, data, _OUTGOING.get(flags & 3))
    if taken is not None:
        yield taken


def _of_interface(source: Source, section: _Section, body: bytes, *, old: bool = False) -> Iterator[Record]:
    """Yield what an enhanced packet holds, or one of the kind before it, whose count of drops and options are passed over."""
    head = struct.unpack_from(section.order + ("HHLLLL" if old else "LLLLL"), body)
    number, (high, low, stored, original) = head[0], head[-4:]
    _tell_cut(source, stored, original)
    interface = section.interface(number)
    if stored > len(body) - 20:
        source.problem(f"a record of {stored} bytes in a block that has {len(body) - 20}")
        return
    options = _options(section, body[20 + stored + -stored % 4 :]) if not old and len(body) > 20 + stored + 3 else {}
    t_ns = interface.t_ns(high, low) if interface is not None else None
    yield from _give(source, interface, number, t_ns, body[20 : 20 + stored], options, section.order)


def _simple(source: Source, section: _Section, body: bytes) -> Iterator[Record]:
    original = struct.unpack_from(section.order + "L", body)[0]
    interface = section.interface(0)
    longest = interface.longest if interface is not None and interface.longest else original
    stored = min(original, longest)
    _tell_cut(source, min(stored, len(body) - 4), original)
    yield from _give(source, interface, 0, None, body[4 : 4 + stored], {}, section.order)


def _tell_cut(source: Source, stored: int, original: int) -> None:
    if stored < original:
        source.problem(f"a record was cut when it was captured: {stored} of {original} bytes")


_HANDLERS: dict[int, Callable[[Source, _Section, bytes], Iterator[Record]]] = {
    _SECTION: _begin_section,
    _INTERFACE: _begin_interface,
    _ENHANCED: _of_interface,
    _SIMPLE: _simple,
    _OLD: partial(_of_interface, old=True),
}
