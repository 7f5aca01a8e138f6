"""A UART receiver over edges: start bit, data bits with the lowest first, parity, stop bit.

    idle  start  0  1  2  3  4  5  6  7  (parity)  stop  idle        high is idle and 1
    ‾‾‾‾‾‾|_____|‾‾|_____|‾‾|__|‾‾‾‾‾|____|‾‾‾‾‾‾‾‾|‾‾‾‾‾‾‾‾

Rules: a byte begins at an edge to low that is still low half a bit later. A bit is the level that fills most of its middle,
so a glitch does no harm. Where the other edges of a byte agree that it began otherwise, they are believed. The next byte
begins at the first such edge behind the middle of the stop bit. A byte with a low stop bit or a wrong parity is given on and
marked. So is one with a doubtful bit: its level changes near its middle, or a glitch takes much of it.

What it cannot know: a second stop bit, which looks like an idle line; a glitch as long as a bit, where a bit could stand.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analyzer.columns.codec import Bytes, Flags, Integers
from analyzer.logic.levels import Levels

#: How far from the border of a bit an edge may stand, in bits.
EDGE_ALIGNED = 0.3
#: Part of a bit that is looked at. A bit is doubtful that has both levels for more than this share of it, or an edge so far
#: from its borders, in bits.
_MIDDLE, _MIXED, _ASTRAY = 0.7, 0.3, 0.35
#: A byte begins otherwise than its edge says, where the others agree so well that it is so far off, in bits.
_AGREE, _OFF, _LATEST = 0.7, 0.15, 0.35


class Format(NamedTuple):
    """How a byte stands on the line. `parity`: N, E or O. `bit_ns`: how long a bit is."""

    bit_ns: float
    data_bits: int = 8
    parity: str = "N"
    inverted: bool = False

    @property
    def bits(self) -> int:
        """Bits of a whole byte, with start, parity and one stop bit."""
        return 2 + self.data_bits + (self.parity != "N")

    @property
    def word(self) -> str:
        """The format in the usual letters: 8N1."""
        return f"{self.data_bits}{self.parity}1"


@dataclass
class Read:
    """The bytes of a stretch, an entry each: where it starts and ends in ns, its value, and what is wrong with it.

    `doubtful`: a bit of it could as well be the other one. `rest`: the stretch from the first edge on that belongs to no byte
    yet.
    """

    starts: Integers
    ends: Integers
    values: Bytes
    bad_stop: Flags
    bad_parity: Flags
    doubtful: Flags
    rest: Levels

    def __len__(self) -> int:
        return len(self.values)

    @property
    def bad(self) -> int:
        return int((self.bad_stop | self.bad_parity).sum())


def read(levels: Levels, form: Format, *, final: bool = True) -> Read:
    """Read the bytes of a stretch. `final`: nothing follows, so a byte whose stop bit is cut off by the end is left out."""
    line = levels.inverted() if form.inverted else levels
    clean = line.without_glitches(form.bit_ns)
    bit, edges = form.bit_ns, clean.edges
    falls = edges[1 - clean.first :: 2]
    rises = edges[2 - clean.first :: 2]
    held = np.append(rises, clean.end_ns + bit)[: len(falls)] - falls
    begins = falls[held >= bit / 2]
    chosen = _one_after_the_other(begins, (form.bits - 0.5) * bit)
    edges_down = begins[chosen]
    ends = np.rint(edges_down + form.bits * bit).astype(np.int64)
    # The end of a capture may cut the last stop bit short behind its middle.
    whole = edges_down + (form.bits - 0.5) * bit <= clean.end_ns if final else ends <= clean.end_ns
    count = int(whole.sum())
    starts = edges_down[:count] + _phase(edges_down[:count], clean.edges, form)
    ends = np.rint(starts + form.bits * bit).astype(np.int64)
    high = [line.high(starts + (number + (1 - _MIDDLE) / 2) * bit, _MIDDLE * bit) for number in range(form.bits)]
    bits = [share > 0.5 for share in high[1:]]
    owner, since = _inside(starts, clean.edges, form)
    doubtful = np.bincount(owner[np.abs(since - np.rint(since)) > _ASTRAY], minlength=count).astype(bool)
    for share in high:
        doubtful |= np.abs(share - 0.5) < 0.5 - _MIXED
    values = np.zeros(count, dtype=np.uint8)
    ones = np.zeros(count, dtype=np.uint8)
    for number, one in enumerate(bits[: form.data_bits]):
        values |= one.astype(np.uint8) << number
        ones ^= one
    bad_parity = np.zeros(count, dtype=bool)
    if form.parity != "N":
        bad_parity = (ones ^ bits[form.data_bits] ^ (form.parity == "O")).astype(bool)
    # The edges that stay are counted in what came, where glitches still stand.
    after = chosen[count] if count < len(chosen) else -1
    place = int(np.searchsorted(line.edges, begins[after])) if after >= 0 else len(line.edges)
    return Read(np.rint(starts).astype(np.int64), ends, values, ~bits[-1], bad_parity, doubtful, levels.since(place))


def _phase(starts: Integers, edges: Integers, form: Format) -> NDArray[np.float64]:
    """Return by how much each byte begins otherwise than at its edge, in ns: where its other edges agree that it does."""
    owner, since = _inside(starts, edges, form, 0.5)
    turns = np.exp(2j * np.pi * since)
    count = len(starts)
    together = np.bincount(owner, turns.real, count) + 1j * np.bincount(owner, turns.imag, count)
    number = np.bincount(owner, minlength=count)
    phase = np.angle(together) / (2 * np.pi)
    # A glitch can stand before an edge: half a bit off, the byte begins later.
    phase[phase < -_LATEST] += 1
    sure = (number > 1) & (np.abs(together) > _AGREE * number) & (np.abs(phase) > _OFF)
    return np.where(sure, phase, 0.0) * form.bit_ns


def _inside(
    starts: NDArray[np.floating[Any]] | Integers, edges: Integers, form: Format, after: float = 0.0
) -> tuple[Integers, NDArray[np.float64]]:
    """Return, of each edge inside of a byte, the place of that byte and the bits since its start.

    `after`: the first of these bits that counts; the last is the middle of the stop bit.
    """
    if not len(starts):
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    owner = np.searchsorted(starts, edges, side="right").astype(np.int64) - 1
    since: NDArray[np.float64] = np.asarray((edges - starts[np.maximum(owner, 0)]) / form.bit_ns, dtype=np.float64)
    inside = (owner >= 0) & (since > after) & (since < form.bits - 0.5)
    return owner[inside], since[inside]


def _one_after_the_other(begins: Integers, length: float) -> Integers:
    """Return the places of those that begin when the one before is over."""
    following = np.searchsorted(begins, begins + length).tolist()
    chosen = []
    place, count = 0, len(begins)
    while place < count:
        chosen.append(place)
        place = following[place]
    return np.array(chosen, dtype=np.int64)


def aligned(levels: Levels, form: Format, found: Read) -> float:
    """Return the share of the edges inside of bytes that stand near the border of a bit, 0..1; noise has 0.6."""
    _, since = _inside(found.starts, levels.without_glitches(form.bit_ns).edges, form)
    if not len(since):
        return 1.0
    return float((np.abs(since - np.rint(since)) < EDGE_ALIGNED).mean())
