"""CAN frames as columns: data frames with identifiers of 11 bits, in order of time, on one bus."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from analyzer.catalogue import Role
from analyzer.records import CanFrame

if TYPE_CHECKING:
    # NumPy is there wherever a block is; what only asks for one does not bring it.
    from analyzer.columns.codec import Bytes, Integers

#: Who sent a frame, as the capture marks it, by its number in a block.
DIRECTIONS = (Role.UNKNOWN, Role.REQUEST, Role.REPLY)


@dataclass(frozen=True, slots=True)
class CanBlock:
    """Frames of one bus. All arrays have one entry a frame.

    `t_ns`: times that never decrease. `data`: shape (frames, 8), zeros behind the `sizes` bytes that a frame has.
    `directions`: numbers in `DIRECTIONS`.
    """

    port: str
    t_ns: Integers
    ids: Integers
    sizes: Integers
    data: Bytes
    directions: Integers

    def __len__(self) -> int:
        return len(self.t_ns)

    @property
    def bytes(self) -> int:
        """Data bytes of all frames."""
        return int(self.sizes.sum())

    def part(self, rows: slice) -> CanBlock:
        """Return some frames as a block."""
        t_ns, ids, sizes, directions = (column[rows] for column in (self.t_ns, self.ids, self.sizes, self.directions))
        return CanBlock(self.port, t_ns, ids, sizes, self.data[rows], directions)

    def frame(self, row: int) -> CanFrame:
        """Return one frame."""
        data = self.data[row, : self.sizes[row]].tobytes()
        return CanFrame(int(self.t_ns[row]), self.port, int(self.ids[row]), data, DIRECTIONS[self.directions[row]])

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[CanFrame]:
        """Yield frames from one row to another, usually all."""
        own = slice(start, stop)
        data, at = self.data[own].tobytes(), 0
        columns = (self.t_ns, self.ids, self.sizes, self.directions)
        for t_ns, number, size, direction in zip(*(column[own].tolist() for column in columns), strict=True):
            yield CanFrame(t_ns, self.port, number, data[at : at + size], DIRECTIONS[direction])
            at += self.data.shape[1]
