"""What stands between two rows of frames on a serial line: damage of the usual kinds, told without the framer.

    FA 01 31 2C | FA 01 31 2F | FA 01 31 2C | FA 01 ..      a frame whose check is wrong
    FA 01 31 2C | 01 31 2C | FA 01 31 2C | FA 01 ..         bytes that are none

Nearly all damage is so: the framer has nothing to weigh. No frame begins inside the last one of a row, nor in what follows up
to the next row, whose first frame another one follows. The search for all frames of a block has told that already. All that the
framer would look at came in one chunk, so it would decide in it, too.
"""

from __future__ import annotations

from typing import NamedTuple

from analyzer.framer import Framer
from analyzer.link import places_in
from analyzer.link.interface import Slicer
from analyzer.records import JunkReason


class Gap(NamedTuple):
    """Where a gap is. `chunk`: number of the one that it came in. `unsure`: where a frame may begin that would change all."""

    chunk: int
    start: int
    stop: int
    unsure: list[int]


class Piece(NamedTuple):
    """Some bytes between two rows. `reason` None: they are a frame whose check is wrong."""

    start: int
    stop: int
    reason: JunkReason | None


class GapReader:
    """Reads the gaps between the rows of a line with one dialect. `whole`: the bytes in which they stand."""

    def __init__(self, framer: Framer, slicer: Slicer, whole: bytes) -> None:
        self._slicer, self._whole = slicer, whole
        self._starts, self._reasons = framer.starts, framer.reasons

    def pieces(self, gap: Gap) -> list[Piece] | None:
        """Return what stands in a gap; None where the framer has to weigh it after all."""
        whole, end = self._whole, len(self._whole)
        if gap.unsure and any(self._slicer.look(whole, place, end, False) for place in gap.unsure):
            return None
        wrecked = self._wrecked(gap.start, gap.stop)
        if wrecked is None:
            return None
        found, at = [], gap.start
        if at < wrecked:
            for data, reason in self._reasons.parts(whole[at:wrecked]):
                found.append(Piece(at, at + len(data), reason))
                at += len(data)
        if wrecked < gap.stop:
            found.append(Piece(wrecked, gap.stop, None))
        return found

    def _wrecked(self, start: int, stop: int) -> int | None:
        """Return where a frame begins whose check alone is wrong, and that ends with the gap: the end of the gap if none does.

        None: a package may stand there that lost zeros.
        """
        slicer, whole = self._slicer, self._whole
        end, places = len(whole), [start]
        if slicer.strong_head:
            places += places_in(self._starts, whole, start + 1, stop)
        for place in places:
            if whole[place] in slicer.heads:
                if stop - place in slicer.damaged(whole, place, end):
                    return place
                if slicer.shortened(whole, place, end):
                    return None
        return stop
