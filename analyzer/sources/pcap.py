"""Classic pcap, with times in micro- or nanoseconds and in either byte order.

    magic, version, zone, accuracy, longest record, link type | seconds, fraction, stored, original, data | ...

A record whose length cannot be true ends the reading: nothing marks where the next one begins. Times are exact.
"""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

from analyzer.columns.block import CanBlock
from analyzer.errors import UnreadableError
from analyzer.sources import magic
from analyzer.sources.links import EXPECTED, LINKS, SOCKETCAN, Line, link_name
from analyzer.sources.source import TOGETHER, Record, Source
from analyzer.values import SECOND_NS, counted

_HEADER_SIZE = 24
_RECORD_SIZE = 16
#: The longest record of any serial or CAN link; what claims more is damage.
_RECORD_LIMIT = 1 << 20
_LINK_MASK = 0x0FFF_FFFF


def read(source: Source) -> Iterator[Record | CanBlock]:
    """Read the records. Raises UnreadableError for a link type that carries neither CAN nor serial bytes."""
    found = magic.PCAP.get(source.head[:4])
    if found is None or len(source.head) < _HEADER_SIZE:
        shown = source.head[:4].hex(" ").upper()
        raise UnreadableError(f"{source.name}: expected a pcap header of {_HEADER_SIZE} bytes, got {shown} ...")
    order, unit = found
    link = struct.unpack_from(order + "L", source.head, 20)[0] & _LINK_MASK
    if link not in LINKS:
        raise UnreadableError(f"{source.name}: link type {link_name(link)} carries no drive traffic, {EXPECTED}")
    source.kind = LINKS[link][0]
    source.time_source = f"capture: exact, in steps of {'1 us' if unit > 1 else '1 ns'}"
    return _records(source, order, unit, link)


class _Range(NamedTuple):
    """Whole records, from a place in the file on; the last one of all may break off."""

    data: bytes
    offset: int


def _ranges(source: Source, order: str) -> Iterator[_Range]:
    """Cut the capture between records."""
    stream, offset, rest = source.stream, _HEADER_SIZE, b""
    stream.exactly(_HEADER_SIZE)
    while more := stream.exactly(TOGETHER) if source.in_blocks else stream.block():
        buffer = rest + more
        end = _end(source, buffer, order)
        if end:
            yield _Range(buffer[:end], offset)
        rest, offset = buffer[end:], offset + end
    if rest:
        yield _Range(rest, offset)


def _end(source: Source, buffer: bytes, order: str) -> int:
    """Return where the last whole record ends; behind a damaged one there are none, so it has the rest."""
    at, end, stored_of = 0, len(buffer), struct.Struct(order + "8xL").unpack_from
    if source.in_blocks:
        from analyzer.sources.pcap_blocks import starts_in

        _, at = starts_in(buffer, at, order)
    while end - at >= _RECORD_SIZE:
        (stored,) = stored_of(buffer, at)
        if stored > _RECORD_LIMIT:
            return end
        if at + _RECORD_SIZE + stored > end:
            break
        at += _RECORD_SIZE + stored
    return at


def _pieces(order: str, unit: int, own: _Range) -> list[tuple[int, int, CanBlock | None]]:
    """Return the stretches of a range."""
    from analyzer.sources.pcap_blocks import pieces

    return list(pieces(own.data, order, unit))


def _records(source: Source, order: str, unit: int, link: int) -> Iterator[Record | CanBlock]:
    line = Line(source, link, source.port(), "little" if order == "<" else "big")
    take = LINKS[link][1]
    unpack = struct.Struct(order + "LLLL").unpack_from
    pay = source.stream.budget.record
    ranges = _ranges(source, order)
    together = source.parsed(partial(_pieces, order, unit), ranges) if link == SOCKETCAN else ((each, None) for each in ranges)
    for (buffer, offset), parts in together:
        at = 0
        for start, stop, block in parts or ((0, len(buffer), None),):
            at = start
            if block is not None:
                pay(len(block))
                yield dataclasses.replace(block, port=line.port)
                at = stop
                continue
            while stop - at >= _RECORD_SIZE:
                seconds, fraction, stored, original = unpack(buffer, at)
                if stored > _RECORD_LIMIT:
                    source.problem(f"a record of {stored} bytes, expected at most {_RECORD_LIMIT}", offset=offset + at)
                    return
                end = at + _RECORD_SIZE + stored
                if end > stop:
                    break
                if stored < original:
                    source.problem(f"a record was cut when it was captured: {stored} of {original} bytes", offset=offset + at)
                taken = take(line, seconds * SECOND_NS + fraction * unit, buffer[at + _RECORD_SIZE : end], None)
                at = end
                pay()
                if taken is not None:
                    yield taken
        if at < len(buffer):
            source.problem(f"the last record breaks off after {counted(len(buffer) - at, 'byte')}", offset=offset + at)
