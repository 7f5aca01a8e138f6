"""Why bytes are junk: the noise of a line, the beginning of a frame that was cut off, or two senders at once.

    7F 3A 00 | FA 01 F6 01      noise | truncated: a frame begins here that the junk does not end

It follows from the bytes alone. So the framer and the columns tell the same.
"""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.link import MORE, places_in
from analyzer.records import JunkReason
from analyzer.slicers import Slicers

#: Junk is passed on in pieces of at most this many bytes, so that noise without end does not pile up.
JUNK_PIECE = 4096


class Reasons:
    """Says why bytes of a line are junk."""

    def __init__(self, slicers: Slicers) -> None:
        self._links = [dialect.link for dialect in slicers.dialects]
        self._slicers = slicers
        self._strong = any(slicer.strong_head for slicer in slicers.each)

    def parts(self, data: bytes) -> Iterator[tuple[bytes, JunkReason]]:
        """Yield the parts of some junk, one behind the other, and why each is junk."""
        size = self._broken_off(data)
        if size:
            yield data[:size], self._reason(data[:size])
        if size < len(data):
            yield data[size:], JunkReason.TRUNCATED

    def _broken_off(self, data: bytes) -> int:
        """Return where the beginning of a known frame stands that the end of the junk cuts off."""
        size = len(data)
        if size >= JUNK_PIECE:
            return size
        for at in self._begins(data, max(0, size - self._slicers.longest)):
            for slicer in self._slicers.knowing[data[at]]:
                if at and not (slicer.strong_head and size - at > 2):
                    continue
                if slicer.look(data, at, size, False) == MORE:
                    return at
        return size

    def _reason(self, data: bytes) -> JunkReason:
        """Say why bytes are junk: where several known frames begin and none is whole, two senders spoke at once."""
        for link in self._links:
            if link.left_out:
                return JunkReason.LEFT_OUT
        size = len(data)
        heads = 0
        if size <= 2 * self._slicers.longest:
            for at in self._begins(data, 0):
                known = self._slicers.knowing[data[at]]
                heads += size - at > 2 and any(s.strong_head and s.damaged(data, at, size) for s in known)
        return JunkReason.COLLISION if heads > 1 else JunkReason.NOISE

    def _begins(self, data: bytes, first: int) -> Iterator[int]:
        """Yield where frames may begin, from one place on. Where no head is rare, those behind the first byte say nothing."""
        return places_in(self._slicers.starts, data, first, len(data) if self._strong else 1)
