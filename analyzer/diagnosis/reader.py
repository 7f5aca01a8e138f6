"""Whether bytes are a frame of the catalogue: asked of bytes that were changed, to see whether the change makes them one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from typing import NamedTuple

from analyzer import dialects as registry
from analyzer.catalogue import Dialect, Role
from analyzer.decoder import Decoder
from analyzer.link import MORE, READS, Slicer
from analyzer.records import CanFrame, Frame, Message


class Reading(NamedTuple):
    """Bytes as a frame of a dialect. `listed`: its command and values are those of the manual."""

    dialect: Dialect
    message: Message
    listed: bool

    @property
    def name(self) -> str:
        """The command, for people."""
        return "a frame" if self.message.command is None else self.message.command.name


class Reader:
    """Reads single frames in any of its dialects; what is open on the bus plays no part."""

    def __init__(self, dialects: Sequence[Dialect]) -> None:
        self.dialects = tuple(dialects)
        #: First bytes that are a head of their own.
        self.heads = frozenset().union(*(d.link.first_bytes for d in dialects))
        self._decoders = {d.name: Decoder(d) for d in dialects}
        self._slicers: dict[str, Slicer] = {
            d.name: d.link.slicer(d.commands, lambda a, f: 0) for d in dialects if d.bus == "serial"
        }

    @staticmethod
    @cache
    def of_bus(kind: str) -> Reader:
        """Return the reader of all dialects of a kind of bus."""
        return Reader([d for d in registry.every() if d.bus == kind])

    def readings(self, data: bytes, can_id: int | None = None, role: Role = Role.UNKNOWN) -> Iterator[Reading]:
        """Yield each dialect in which bytes are exactly one frame whose checks fit."""
        for dialect in self.dialects:
            slicer = self._slicers.get(dialect.name)
            if slicer is None:
                fits = can_id is not None and len(data) >= dialect.link.shortest and dialect.link.fits(data, can_id)
            else:
                fits = len(data) > 1 and data[0] in slicer.heads and len(data) in slicer.lengths(data, 0, len(data))
            if fits:
                yield self._read(dialect, data, can_id, role)

    def begins(self, data: bytes, most: int) -> bool:
        """Say whether bytes can be a frame of so many bytes at most, or its beginning, as far as heads and lengths tell."""
        return any(
            data[0] in slicer.heads and any(size in (MORE, len(data)) for size in slicer.damaged(data, 0, len(data)))
            for slicer in self._slicers.values()
            if not slicer.strong_check or _short(data, most)
        )

    def within(self, data: bytes, role: Role = Role.UNKNOWN) -> Iterator[tuple[int, Reading]]:
        """Yield the frames that stand in bytes, each with its place, from left to right."""
        at = 0
        while at + _SHORTEST <= len(data):
            stops = {
                at + size
                for slicer in self._slicers.values()
                if data[at] in slicer.heads
                for size in slicer.lengths(data, at, len(data))
                if size >= _SHORTEST
            }
            found = next((r for stop in sorted(stops, reverse=True) if (r := self.best(data[at:stop], role=role))), None)
            if found is not None:
                yield at, found
            at += len(found.message.frame.data) if found is not None else 1

    def laid(self, data: bytes) -> list[int]:
        """Return where the frames of the catalogue end of which bytes consist, whatever their checks; empty where they do not.

        The checks may be missing, then of all of them.
        """
        for dialect in self.dialects:
            slicer = self._slicers.get(dialect.name)
            check = len(dialect.link.completed(data)) - len(data)
            for lacking in (0, check):
                if slicer is not None and (stops := _laid(slicer, data + bytes(lacking), lacking)):
                    return stops
        return []

    def bare(self, data: bytes) -> bool:
        """Say whether bytes are a frame, listed or not, that lacks its check."""
        return any(True for d in self.dialects if len(data) > 2 for _ in self.readings(d.link.completed(data)))

    def closed(self, data: bytes) -> bool:
        """Say whether bytes are a frame of the catalogue that lacks its check."""
        return any(reading.listed for d in self.dialects if len(data) > 2 for reading in self.readings(d.link.completed(data)))

    def _read(self, dialect: Dialect, data: bytes, can_id: int | None, role: Role) -> Reading:
        can = None if can_id is None else CanFrame(None, "", can_id, data, role)
        message, _ = self._decoders[dialect.name].decode(Frame("", 0, 0, 0, data, dialect, role, True, can))
        fallback = message.command in dialect.fallbacks.values()
        return Reading(dialect, message, message.form is not None and not message.violations and not fallback)

    def best(self, data: bytes, can_id: int | None = None, role: Role = Role.UNKNOWN) -> Reading | None:
        """Return the reading that the catalogue lists, or one whose check leaves no doubt; None where there is none."""
        found = None
        for reading in self.readings(data, can_id, role):
            if role is not Role.UNKNOWN and reading.message.role not in (role, Role.UNKNOWN):
                continue
            if reading.listed:
                return reading
            slicer = self._slicers.get(reading.dialect.name)
            if slicer is not None and slicer.strong_check:
                found = found or reading
        return found


def _laid(slicer: Slicer, longer: bytes, lacking: int) -> list[int]:
    """Return where frames end that all lack so many bytes of their check; of several lengths that which leads to the end."""
    last = len(longer) - lacking
    ways: list[list[int]] = [[]]
    seen: set[int] = set()
    while ways:
        stops = ways.pop()
        at = stops[-1] if stops else 0
        if at == last:
            return stops
        if at not in seen and longer[at] in slicer.heads:
            seen.add(at)
            sizes = (size - lacking for size in slicer.damaged(longer, at, len(longer)) if size > lacking)
            ways += [[*stops, at + size] for size in sizes if at + size <= last]
    return []


def _short(data: bytes, most: int) -> bool:
    """Say whether a frame of Modbus can be so short: a reply tells its length, and a request asks for little."""
    if len(data) < 3 or data[1] not in READS or 5 + data[2] <= most:
        return True
    return len(data) < 5 or (data[4] == 0 and len(data) <= _MODBUS_REQUEST)


_MODBUS_REQUEST = 8
#: No frame is shorter.
_SHORTEST = 4
