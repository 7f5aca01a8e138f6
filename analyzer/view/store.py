"""All frames of a capture, by their numbers, in little memory.

    block: 256 records, compressed         record: P | lane u32 | sequence ... | data    a frame of a lane
                                                   L | length u32 | msgpack              any other line

A frame of a lane is stored as its bytes and decoded again when it is shown; blocks beyond `MEMORY` go to a temporary file
that vanishes with the process. One thread adds, any may read.
"""

from __future__ import annotations

import struct
import tempfile
import threading
from array import array
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Iterator
from typing import IO, NamedTuple

import msgspec
import zstandard

from analyzer.catalogue import Dialect, Role
from analyzer.entries import Entry
from analyzer.live.snapshot import FrameLine
from analyzer.live.snapshot_lines import frame_line
from analyzer.records import CanFrame, Frame, Lane

BLOCK = 256
#: Compressed bytes that stay in memory.
MEMORY = 64 << 20
#: Findings that came after their frame was stored and are shown with it; all are counted elsewhere.
LATE = 200_000
_CACHED = 8
_PLAIN = struct.Struct("<BIQqqQqqI")
_LINE = struct.Struct("<BI")
_to_msgpack = msgspec.msgpack.Encoder().encode
_from_msgpack = msgspec.msgpack.Decoder(FrameLine).decode


class _Sequence(msgspec.Struct):
    """As much of a line as tells its sequence."""

    sequence: int


_sequence_of = msgspec.msgpack.Decoder(_Sequence).decode


class LaneKey(NamedTuple):
    """What frames of a lane share beside their lane."""

    lane: Lane
    dialect: Dialect
    port: str
    can_id: int | None


class Record(NamedTuple):
    """A record of a block: of a lane (`lane` and what stands in its head), or a line."""

    lane: LaneKey | None
    head: tuple[int, ...]
    data: bytes

    @property
    def sequence(self) -> int:
        """The sequence, 0 of a comment."""
        return _sequence_of(self.data).sequence if self.lane is None else self.head[0]

    def line(self) -> FrameLine:
        if self.lane is None:
            return _from_msgpack(self.data)
        sequence, first_ns, last_ns, offset, latency, request = self.head
        lane, dialect, port, can_id = self.lane
        can = None if can_id is None else CanFrame(None, port, can_id, self.data)
        frame = Frame(port, first_ns, last_ns, offset, self.data, dialect, Role.UNKNOWN, True, can)
        first = not lane.is_request
        return frame_line(
            Entry(
                lane.message(frame), sequence, lane.topic, (),
                None if latency < 0 else latency, None if request < 0 else request, first,
            )
        )  # fmt: skip


class FrameStore:
    """Frames, junk and comments in the order in which they came."""

    first = 0

    def __init__(self, memory: int = MEMORY) -> None:
        self._lock = threading.Lock()
        self._memory = memory
        self._lanes: list[LaneKey] = []
        self._lane_numbers: dict[int, int] = {}
        self._parts: list[bytes] = []
        self._open: list[Record] = []
        self._blocks: list[bytes] = []
        self._size = 0
        self._file: IO[bytes] | None = None
        self._ends = array("Q")
        #: By block: time and sequence of its first record, and whether it has findings.
        self._times = array("q")
        self._firsts = array("Q")
        self._flags = bytearray()
        self._sequence = 0
        self._late: dict[int, str] = {}
        self._cache: OrderedDict[int, list[Record]] = OrderedDict()
        self._pack = zstandard.ZstdCompressor(level=1)
        self._unpack = zstandard.ZstdDecompressor()
        self._stop = 0

    # --- adding ---------------------------------------------------------------------------------------------------

    def add_plain(self, lane: Lane, frame: Frame, sequence: int, latency_ns: int | None, request: int | None) -> None:
        number = self._lane_numbers.get(id(lane))
        if number is None:
            number = self._lane_numbers[id(lane)] = len(self._lanes)
            self._lanes.append(LaneKey(lane, frame.dialect, frame.port, None if frame.can is None else frame.can.id))
        data = frame.data
        self._sequence = sequence
        head = (
            sequence, frame.first_ns, frame.last_ns, frame.offset,
            -1 if latency_ns is None else latency_ns, -1 if request is None else request,
        )  # fmt: skip
        self._parts += (_PLAIN.pack(80, number, *head, len(data)), data)
        self._add(Record(self._lanes[number], head, data), frame.last_ns)

    def add_line(self, line: FrameLine) -> None:
        data = _to_msgpack(line)
        # A comment has no sequence: it stands behind what came before it.
        self._sequence = line.sequence or self._sequence
        self._parts += (_LINE.pack(76, len(data)), data)
        self._add(Record(None, (), data), line.t_ns, bool(line.rules))

    def _add(self, record: Record, t_ns: int, flag: bool = False) -> None:
        if not self._open:
            self._times.append(t_ns)
            self._firsts.append(self._sequence)
            self._flags.append(0)
        if flag:
            self._flags[-1] = 1
        self._open.append(record)
        self._stop += 1
        if len(self._open) == BLOCK:
            # A copy: what the compressor returns keeps the room it had asked for.
            packed = bytes(memoryview(self._pack.compress(b"".join(self._parts))))
            with self._lock:
                self._keep(packed)
                self._open = []
            self._parts = []

    def _keep(self, packed: bytes) -> None:
        if self._size + len(packed) <= self._memory and self._file is None:
            self._blocks.append(packed)
            self._size += len(packed)
            return
        if self._file is None:
            self._file = tempfile.TemporaryFile(prefix="servotap-view-")  # noqa: SIM115 (it lives as long as the store)
        start = self._ends[-1] if self._ends else 0
        self._file.seek(start)
        self._file.write(packed)
        self._ends.append(start + len(packed))

    def late(self, sequence: int, rule: str) -> None:
        """Note a finding about a frame that may be stored already."""
        if sequence not in self._late and len(self._late) >= LATE:
            return
        block = bisect_right(self._firsts, sequence) - 1
        if block >= 0:
            self._flags[block] = 1
            known = self._late.get(sequence)
            self._late[sequence] = rule if known is None else f"{known} {rule}"

    # --- looking --------------------------------------------------------------------------------------------------

    @property
    def stop(self) -> int:
        return self._stop

    @property
    def spilled(self) -> int:
        """Bytes in the temporary file."""
        return self._ends[-1] if self._ends else 0

    def line(self, number: int) -> FrameLine:
        if not 0 <= number < self._stop:
            raise IndexError(number)
        line = self.records(number // BLOCK)[number % BLOCK].line()
        late = self._late.get(line.sequence)
        if late is not None and line.sequence:
            missing = tuple(rule for rule in late.split(" ") if rule not in line.rules)
            if missing:
                line = msgspec.structs.replace(line, rules=line.rules + missing, severity=line.severity or "warning")
        return line

    def records(self, block: int) -> list[Record]:
        with self._lock:
            if block >= len(self._blocks) + len(self._ends):
                return self._open
            known = self._cache.get(block)
            if known is not None:
                self._cache.move_to_end(block)
                return known
            packed = self._packed(block)
        records = list(self._split(self._unpack.decompress(packed)))
        with self._lock:
            self._cache[block] = records
            while len(self._cache) > _CACHED:
                self._cache.popitem(last=False)
        return records

    def _packed(self, block: int) -> bytes:
        if block < len(self._blocks):
            return self._blocks[block]
        at = block - len(self._blocks)
        start = self._ends[at - 1] if at else 0
        assert self._file is not None
        self._file.seek(start)
        return self._file.read(self._ends[at] - start)

    def _split(self, data: bytes) -> Iterator[Record]:
        at = 0
        while at < len(data):
            if data[at] == 80:
                _, number, *head, length = _PLAIN.unpack_from(data, at)
                at += _PLAIN.size
                yield Record(self._lanes[number], tuple(head), data[at : at + length])
            else:
                _, length = _LINE.unpack_from(data, at)
                at += _LINE.size
                yield Record(None, (), data[at : at + length])
            at += length

    def number_of(self, sequence: int) -> int | None:
        """Return the number of the frame with a sequence, None where there is none. Sequences grow, with gaps."""
        block = bisect_right(self._firsts, sequence) - 1
        # A comment at the beginning of a block has the sequence before it, which may end the block before.
        for each in (block, block - 1):
            for place, record in enumerate(self.records(each) if each >= 0 else ()):
                if record.sequence == sequence:
                    return each * BLOCK + place
        return None

    def hop(self, number: int, step: int) -> int:
        """Return the next number, this one included, whose block has findings; going backwards where `step` is -1."""
        while 0 <= number < self._stop and not self._flags[number // BLOCK]:
            block = number // BLOCK + step
            number = block * BLOCK if step > 0 else (block + 1) * BLOCK - 1
        return number

    def block_of(self, t_ns: int) -> int:
        """Return the block in which a time lies, as far as times grow."""
        return max(0, bisect_right(self._times, t_ns) - 1)

    @property
    def blocks(self) -> int:
        """How many blocks there are, the one under way included."""
        return len(self._times)

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
