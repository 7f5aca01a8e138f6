"""What a receiver reads of the levels on a line when it is set up otherwise than the sender, and the way back.

    sender      0 dddddddd 1 0 dddddddd 1     ten cells a byte, without pauses, high when idle
    receiver        0 dddddddd 1 1 1 0 dddd   an edge begins a byte wherever it comes, each bit is sampled in its middle

The way back: the bytes that were read say which cells were high, all but a few (stop bits, parities, what an edge skips). Cells
are set one after the other, both ways where nothing says which, and a way ends as soon as the receiver would read otherwise.
What is left are very few rows of cells, and fewer whose bytes are a frame with the right check.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Sequence
from math import ceil
from typing import NamedTuple

#: Cells that a byte has: start, eight bits, stop.
CELLS = 10
#: So near to an edge the middle of a bit is on it.
NEAR = 0.06
#: By so many first bytes `read` can be told what is looked for.
BEGUN = 3
#: Cells that are set in one search, before it is given up.
_MOST_STEPS = 12_000
#: Steps after which what was found is good enough.
_STEPS = 1500


class Line(NamedTuple):
    """A receiver against a sender of 8N1.

    `ratio`: the sender's speed over its own. `parity`: it takes one bit more for a parity. `missed`: it listens only from
    this cell on, and a low level then looks like a start bit. `loose`: a bit that it samples on an edge is read either way.
    """

    ratio: float = 1.0
    inverted: bool = False
    parity: int = 0
    missed: int = 0
    loose: bool = False


#: A receiver that is set up as the sender.
AS_SENT = Line()
_TURNED = str.maketrans("01", "10")


#: Cells stand in bytes, each by its level.
_LOW, _HIGH = b"\0", b"\1"
#: A receiver on its way: `edge` -1 where it waits for one from `at` on; else `bit` is the next that it samples; bytes read.
_Ear = tuple[int, float, int, int]


def _listen(line: Line, cells: bytes, ear: _Ear, wanted: bytes) -> _Ear | None:
    """Return the receiver after the cells so far; None where it has read something else than `wanted`."""
    edge, at, bit, read = ear
    high = 0 if line.inverted else 1
    while True:
        if edge < 0:
            place = max(ceil(at), 1)
            while place < len(cells) and not (
                cells[place] != high and (cells[place - 1] == high or (place == line.missed and read == 0))
            ):
                place += 1
            if place >= len(cells):
                return -1, place, 0, read
            edge, bit = place, 0
        middle = edge + (bit + 0.5) * line.ratio
        place = round(middle) if line.loose and abs(middle - round(middle)) < NEAR else int(middle)
        if place >= len(cells):
            return edge, at, bit, read
        seen = cells[place] == high
        if bit and line.loose and place > middle - NEAR and cells[place - 1] != cells[place] and read < len(wanted):
            seen = bool(wanted[read] >> (bit - 1) & 1)
        if bit == 0:
            if seen:
                edge, at = -1, edge + 1
                continue
            if read == len(wanted):
                return None
        elif seen != bool(wanted[read] >> (bit - 1) & 1):
            return None
        bit += 1
        if bit == 9:
            at = edge + (8 + line.parity + 1.5) * line.ratio
            edge, read = -1, read + 1


def levels(data: bytes, line: Line = AS_SENT, gap: int = 0) -> str:
    """Return the levels of bytes as a receiver sees them, a character a cell, behind an idle line.

    `gap`: idle cells between bytes.
    """
    cells = "1" + "".join("0" + f"{byte:08b}"[::-1] + "1" + "1" * gap for byte in data)
    seen = "1" * (1 + line.missed) + cells[1 + line.missed :]
    return seen.translate(_TURNED) if line.inverted else seen


class Rows:
    """Levels of many frames side by side, each behind one idle cell: a column of cells is a number, a row one bit of it."""

    def __init__(self, rows: Sequence[str]) -> None:
        width = max(map(len, rows))
        self._columns = [
            int("".join(cells), 2) for cells in zip(*(row.ljust(width, "1") for row in reversed(rows)), strict=True)
        ]
        self._all = (1 << len(rows)) - 1

    def _column(self, place: float) -> int:
        return self._columns[int(place)] if place < len(self._columns) else self._all

    def beginning(self, line: Line, late: tuple[float, float], heads: bytes) -> Iterator[int]:
        """Yield the rows of which a receiver may read one of `heads` first. All begin with their start bit, in cell 1."""
        # Where it sees no start bit in the first one, only `read` tells where the byte begins.
        found = self._column(1 + line.ratio / 2 + late[0])
        begun = [(0, self._all & ~found)]
        for bit in range(8):
            high = self._column(1 + (bit + 1.5) * line.ratio + late[1])
            grown = [each for byte, rows in begun for each in ((byte, rows & ~high), (byte | 1 << bit, rows & high))]
            begun = [(byte, rows) for byte, rows in grown if rows]
        for byte, rows in begun:
            found |= rows if byte in heads else 0
        while found:
            lowest = found & -found
            yield lowest.bit_length() - 1
            found ^= lowest


def read(seen: str, line: Line, late: tuple[float, float] = (0.0, 0.0), begins: Container[bytes] | None = None) -> bytes:
    """Return what a receiver reads of levels; behind them the line is idle.

    `late`: how far behind the middle of start bits, and of others, it samples, in cells. `begins`: nothing is looked for
    whose first bytes, up to `BEGUN` of them, are none of these.
    """
    ratio, last = line.ratio, len(seen)
    idle = seen + ("0" if line.inverted else "1") * (int(10 * ratio) + 2)
    found = bytearray()
    places = [(bit + 1.5) * ratio + late[1] for bit in range(8)]
    middle = ratio / 2 + late[0]
    at = 1.0
    while (edge := seen.find("10", ceil(at) - 1, last) + 1) > 0:
        if idle[int(edge + middle)] == "1":
            # Too short for a start bit.
            at = edge + 1
            continue
        byte = 0
        for bit, place in enumerate(places):
            if idle[int(edge + place)] == "1":
                byte |= 1 << bit
        found.append(byte)
        if begins is not None and len(found) <= BEGUN and bytes(found) not in begins:
            return b""
        at = edge + (8 + line.parity + 1.5) * ratio
    return bytes(found)


def at_once(one: bytes, other: bytes, late: int) -> Iterator[bytes]:
    """Yield what is read of two frames at once, the other from 0 up to `late` cells behind: a low level wins."""
    first, second = ("".join(cell * _PARTS for cell in levels(frame)) for frame in (one, other))
    idle = "1" * max(len(first), late * _PARTS + len(second))
    for behind in range(late * _PARTS):
        yield read("".join(map(min, first + idle, idle[:behind] + second + idle)), Line(_PARTS))


#: Parts of a cell by which two senders are apart.
_PARTS = 4


def unread(
    heard: bytes, line: Line, begins: Callable[[bytes], bool], whole: Callable[[bytes], bool]
) -> tuple[bytes, int] | None:
    """Return the frame that was sent where a receiver reads `heard` or its beginning, and how many bytes of it were read.

    `begins`: whether bytes can begin a frame. Of several frames it is the longest in what was read.
    """
    best: tuple[bytes, int] | None = None
    for sent, taken, steps in _ways(heard, line, begins):
        if best is not None and steps > _STEPS:
            break
        if (best is None or taken > best[1]) and sent != heard[:taken] and whole(sent):
            best = sent, taken
            if taken == len(heard):
                break
    return best


def _ways(heard: bytes, line: Line, begins: Callable[[bytes], bool]) -> Iterator[tuple[bytes, int, int]]:
    """Yield each row of whole bytes that is read as `heard` or its beginning, how much of it, and the steps so far."""
    # Cell 0 is the idle line before the frame; a receiver that wakes up late misses what comes before.
    idle = _HIGH * (int(12 * line.ratio) + 2)
    begin: _Ear = (-1, 1 + line.missed, 0, 0)
    waiting = [(_HIGH, begin, b"")]
    line = line._replace(missed=line.missed + 1 if line.missed else 0)
    steps = 0
    while waiting:
        cells, ear, data = waiting.pop()
        steps += 1
        if steps > _MOST_STEPS:
            return
        sent, place = divmod(len(cells) - 1, CELLS)
        if place == 0 and sent:
            data += bytes((sum(cell << bit for bit, cell in enumerate(cells[-9:-1])),))
            if sent > 1 and not begins(data):
                continue
            if sent > 3 and ear[3]:
                rest = _listen(line, cells + idle, ear, heard)
                if rest is not None and rest[0] < 0:
                    yield data, rest[3], steps
        choice = (_LOW,) if place == 0 else (_HIGH,) if place == CELLS - 1 else (_LOW, _HIGH)
        # What brings the next edge soonest is tried first: that is the last in the list.
        if ear[0] < 0 and (cells[-1] == 1) is line.inverted:
            choice = choice[::-1]
        for cell in choice:
            grown = cells + cell
            after = _listen(line, grown, ear, heard)
            if after is not None:
                waiting.append((grown, after, data))
