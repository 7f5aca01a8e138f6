"""Ways in which bytes can leave a line, and what each explains of the bytes that came."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from analyzer.diagnosis.bits import Line
from analyzer.diagnosis.exchanges import Awaited
from analyzer.diagnosis.scene import Trouble

#: Longer stretches are noise without end.
MOST_READ = 256
#: Bytes that must fit where one stretch alone speaks, and bytes that must be different.
LEAST, DIFFERENT = 4, 4
#: Stretches that are looked at.
MOST_STRETCHES = 12
#: Stretches that are no chance, and the share that is almost all.
FEWEST, ALMOST_ALL = 3, 0.8
#: So many bytes begin alike before more is compared.
ALIKE = 2

#: Ways that leave enough to find the frame, the commonest first.
LINES = (
    ("inverted_lines", Line(inverted=True)),
    *(("lost_start", Line(missed=cell)) for cell in range(1, 10)),
    ("wrong_parity", Line(parity=1)),
    ("wrong_baud", Line(0.5)),
    ("wrong_baud", Line(0.25)),
    ("wrong_baud", Line(2 / 3, loose=True)),
)


class Fit(NamedTuple):
    """A stretch explained by a frame that was sent: how many bytes come from it, and what was read of it each time."""

    trouble: Trouble
    data: bytes
    frame: bytes
    taken: int
    came: bytes = b""


class Way(NamedTuple):
    """A cause with the stretches that it explains."""

    cause: str
    ratio: float
    fits: list[Fit]

    @property
    def taken(self) -> int:
        """How many bytes it explains."""
        return sum(fit.taken for fit in self.fits)

    @property
    def different(self) -> int:
        """How many different frames it finds."""
        return len({fit.frame for fit in self.fits})


class Garbled(NamedTuple):
    """Damaged bytes, or the first of them. `replies`: what was asked for right before them."""

    trouble: Trouble
    data: bytes
    replies: Sequence[Awaited]
