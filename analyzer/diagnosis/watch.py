"""A sink that keeps what stands near trouble, so that a diagnosis can look at it once the capture has ended."""

from __future__ import annotations

import re
from collections import Counter, deque
from collections.abc import Sequence
from itertools import repeat
from typing import TYPE_CHECKING, NamedTuple

from msgspec.structs import replace

from analyzer.catalogue import Dialect
from analyzer.columns.block import ByteBlock, CanBlock
from analyzer.diagnosis.repeats import SOON_NS, told_apart
from analyzer.diagnosis.scene import SILENT, Piece, Read, Scene
from analyzer.entries import Entry
from analyzer.pipeline import Item
from analyzer.records import Chunk, Comment, Finding, Frame, Junk, Lane, Message

if TYPE_CHECKING:
    from analyzer.columns.plain import Plain

#: Frames and reads that are kept before and behind a trouble.
_NEAR = 128
#: Chunks that are looked at together.
_AT_ONCE = 64
#: Frames with what stands near them, and findings, of which more would show nothing new.
_MOST_KEPT = 20_000
_MOST_FINDINGS = 5_000
#: Frames near late replies that are kept.
_MOST_LATE = 2_000
#: Bytes of junk that are kept of what came first, and again each time as much has come as before.
_MUCH_JUNK = 32_768
#: Comments that are kept, and how much of each.
_MOST_SAID, _LONGEST_SAID = 200, 1000

#: Words by which people say that something is wrong, or ask.
_ASKS = re.compile(
    # A field of a library's line may have no value.
    r"(?<!=)\b(?:not?|nothing|never|nobody|none|cannot|can't|\w+n't|without|fail\w*|silent|silence|time[ds]?[ -]?out\w*|"
    r"problem\w*|trouble\w*|wrong|help|why|unable|stuck|unanswered|nicht\w*|kein\w*|nie|pas|rien|aucune?|нет|не)\b|\w\?(?:[\s)]|$)|[不没沒无無？]",
    re.IGNORECASE,
)

#: What came: a decoded frame, or a plain one with its lane, or junk; with its number, and that of the request it answers.
_Kept = Entry | tuple[Lane | None, Frame | Junk, int, int | None]


class _Rows(NamedTuple):
    """Rows of a block. `more`: their sequence numbers are so much greater than they."""

    rows: range
    more: int


class _KeptRead(NamedTuple):
    """A read of a bus. `torn`: the reader of the capture lost bytes there."""

    port: str
    torn: bool
    read: Read


class Watch:
    """Keeps what stands near trouble. Feed it the items of the source by `take`, before the pipeline gets them."""

    def __init__(self) -> None:
        #: What came last: frames, and rows of the present block.
        self._near: deque[_Kept | _Rows] = deque(maxlen=_NEAR)
        self._kept: list[_Kept] = []
        self._reads_near: deque[tuple[Chunk, int]] = deque(maxlen=2 * _NEAR)
        #: Chunks that came since the last numbering.
        self._chunks: list[Chunk] = []
        #: The reads that are kept, without their bytes.
        self._reads: list[_KeptRead] = []
        #: The last block of bytes: where it begins on its bus, and how many of its chunks are among the reads that are near.
        self._block: ByteBlock | None = None
        self._block_offset = self._block_read = 0
        self._block_timed = False
        self._offsets: dict[str, int] = {}
        self._findings: list[Finding] = []
        self._said: list[str] = []
        self._plain: Plain
        #: Bytes of junk that came on each bus since the last forgetting, and those of them that are kept.
        self._junk: Counter[str] = Counter()
        self._junk_kept: Counter[str] = Counter()
        #: Frames and findings that came by, kept or not.
        self.frames = self.found = 0
        self.timed = self._words = self._asks = self._late = False
        #: How bytes stand on the line, as `8E1`; empty where levels do not tell.
        self.uarts: frozenset[str] = frozenset()

    def take(self, item: Item, offset: int | None = None) -> None:
        """Take an item of the source. `offset`: its first byte on its bus; None: it follows the item before."""
        # Each item of a capture comes by here: what is usual costs least.
        if item.__class__ is Chunk and offset is None and self._block is None:
            self._chunks.append(item)
            if len(self._chunks) >= _AT_ONCE:
                self._number()
            return
        self._number()
        if isinstance(item, (Chunk, ByteBlock)):
            if self._block is not None:
                self._read_block(len(self._block))
                self._block = None
            port = item.port
            if offset is None:
                offset = self._offsets.get(port, 0)
            self._offsets[port] = offset + len(item.data)
            if isinstance(item, Chunk):
                self._reads_near.append((item, offset))
            else:
                self._block, self._block_offset, self._block_read = item, offset, 0
                self._block_timed = item.t_ns is not None
        if not self.timed and item.t_ns is not None:
            self.timed = True

    def _number(self) -> None:
        """Give the chunks that came their places on their buses."""
        offsets, chunks = self._offsets, self._chunks
        for chunk in chunks:
            port = chunk.port
            offset = offsets.get(port, 0)
            offsets[port] = offset + len(chunk.data)
            self._reads_near.append((chunk, offset))
        if not self.timed:
            self.timed = any(chunk.t_ns is not None for chunk in chunks)
        chunks.clear()

    def _read_block(self, chunks: int) -> None:
        """Put the chunks of the present block that were needed so far among the reads."""
        block = self._block
        assert block is not None  # asked where there is one
        for number in range(max(self._block_read, chunks - 2 * _NEAR), chunks):
            chunk = block.chunk(number)
            if not self._block_timed:
                chunk = replace(chunk, t_ns=None)
            self._reads_near.append((chunk, self._block_offset + int(block.stops[number]) - len(chunk.data)))
        self._block_read = max(chunks, self._block_read)

    def plain(self, lane: Lane, frame: Frame, sequence: int, latency_ns: int | None, request_sequence: int | None) -> None:
        """Take a frame that is in order."""
        self._near.append((lane, frame, sequence, request_sequence))
        self.frames += 1
        if latency_ns is not None and latency_ns > SOON_NS and frame.can is not None:
            self._look_back()

    def begin(self, plain: Plain) -> None:
        """Take the next block of frames."""
        self._spread()
        self._plain = plain

    def run(self, start: int, stop: int, sequence: int) -> None:
        """Take plain exchanges: the last of them may stand near trouble, as those before a late reply do."""
        self.frames += stop - start
        more = sequence - start
        if isinstance(self._plain.block, CanBlock):
            for late in (self._plain.latencies[start:stop] > SOON_NS).nonzero()[0][:_MOST_LATE].tolist():
                after = sequence - more + late + 1
                self._near.append(_Rows(range(max(start, after - _NEAR), after), more))
                self._look_back()
                start = after
        self._near.append(_Rows(range(max(start, stop - _NEAR), stop), more))

    def _look_back(self) -> None:
        """Keep what stands near a late reply on CAN, as far as there is room: it may be a request that is sent again."""
        self._late = True
        if len(self._kept) < _MOST_LATE:
            self._keep()

    def _spread(self) -> None:
        """Put frames in the place of the rows that are near."""
        newest: list[_Kept] = []
        while self._near and len(newest) < _NEAR:
            each = self._near.pop()
            newest.extend(map(self._row, reversed(each.rows), repeat(each.more)) if isinstance(each, _Rows) else (each,))
        self._near = deque(reversed(newest[:_NEAR]), maxlen=_NEAR)

    def _row(self, row: int, more: int) -> _Kept:
        plain = self._plain
        lane = plain.lanes[plain.lane[row]]
        sequence = row + more
        return lane, plain.frame(row), sequence, None if lane.is_request else sequence - int(plain.behind[row])

    def entry(self, entry: Entry) -> None:
        """Take a decoded frame."""
        self._near.append(entry)
        self.frames += 1
        latency_ns = entry.latency_ns
        if latency_ns is not None and latency_ns > SOON_NS and entry.message.frame.can is not None:
            self._look_back()

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        """Take bytes that are no frame."""
        port, size = junk.port, len(junk.data)
        # Junk without end is looked at in samples, one more as often as it doubles.
        if self._junk_kept[port] < _MUCH_JUNK * (1 + (self._junk[port] // _MUCH_JUNK).bit_length()):
            self._near.append((None, junk, sequence, None))
            self._junk_kept[port] += size
        self._junk[port] += size

    def finding(self, found: Finding) -> None:
        """Take a finding: what stands near it is kept."""
        self.found += 1
        if len(self._findings) < _MOST_FINDINGS:
            self._findings.append(found)
            self._keep()

    def comment(self, comment: Comment) -> None:
        """Take a comment: of words only whether they say that something is wrong."""
        self._words = True
        if len(self._said) < _MOST_SAID:
            self._said.append(comment.text[:_LONGEST_SAID])
            self._asks |= _ASKS.search(comment.text) is not None

    @property
    def full(self) -> bool:
        """Whether nothing more is kept."""
        return len(self._kept) >= _MOST_KEPT or len(self._findings) >= _MOST_FINDINGS

    @property
    def quiet(self) -> bool:
        """Whether all came in order, what came last frame by frame, and no words: then there is nothing to explain."""
        self._spread()
        heard = self.found or self._words or self._late
        return not heard and not any(isinstance(each, Entry) or each[0] is None for each in self._near)

    def forget(self) -> None:
        """Make room for what comes."""
        self._kept.clear()
        self._reads.clear()
        self._findings.clear()
        self._junk.clear()
        self._junk_kept.clear()

    def _keep(self) -> None:
        self._number()
        if self._block is not None:
            self._read_block(self._block.taken)
        if not self._near:
            # What was found is junk that is passed over. The next frame may stand in what was read.
            return
        if len(self._kept) < _MOST_KEPT:
            self._spread()
            self._kept.extend(each for each in self._near if not isinstance(each, _Rows))
            self._reads.extend(
                _KeptRead(c.port, c.torn, Read(offset, offset + len(c.data), c.t_ns, c.direction, c.burst))
                for c, offset in self._reads_near
            )
        self._near.clear()
        self._reads_near.clear()

    def scenes(self, dialects: Sequence[Dialect]) -> list[Scene]:
        """Return the buses, as far as they were kept."""
        self._keep()
        rules: dict[int, set[str]] = {}
        for found in self._findings:
            rules.setdefault(found.sequence, set()).add(found.rule)
        pieces: dict[str, list[Piece]] = {}
        for kept in self._kept:
            message: Message | None = None
            where: Frame | Junk
            if isinstance(kept, Entry):
                message, sequence, asked_by = kept.message, kept.sequence, kept.request_sequence
                where = message.frame
            else:
                lane, where, sequence, asked_by = kept
                if lane is not None and isinstance(where, Frame):
                    message = lane.message(where)
            own = frozenset(rules.get(sequence, ()))
            piece = Piece(where.offset, where.data, where.first_ns, sequence, message, asked_by, own)
            pieces.setdefault(where.port, []).append(piece)
        if not pieces and self._said and not self.found:
            # Words alone may tell what went wrong.
            pieces["serial"] = []
        return [self._scene(bus, found, tuple(dialects)) for bus, found in pieces.items()]

    def _scene(self, bus: str, pieces: list[Piece], dialects: tuple[Dialect, ...]) -> Scene:
        """Return a bus without what rests on bytes that the reader of the capture could not read."""
        reads = [each for each in self._reads if each.port == bus]
        torn = [(each.read.offset, each.read.stop) for each in reads if each.torn]
        kept = [p for p in pieces if p.sound or not any(p.offset < stop and p.stop >= start for start, stop in torn)]
        # The reply to what was asked before may be among what is missing.
        asked = {max((p.sequence for p in kept if p.is_request and p.stop <= start), default=-1) for start, _ in torn}
        lost = {p.sequence for p in pieces} - {p.sequence for p in kept} | asked
        kept, findings = told_apart(kept, [f for f in self._findings if f.port == bus])
        told = [f for f in findings if f.sequence not in lost or (f.sequence in asked and f.rule not in SILENT)]
        return Scene(
            bus, dialects, kept,
            [each.read for each in reads],
            told, self.frames, self.timed, self._words and not self._asks, tuple(self._said), len(findings) - len(told),
            self.uarts,
        )  # fmt: skip
