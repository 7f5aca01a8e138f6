"""A source: a capture that is being read, the same for every format.

A format module offers `read(source) -> Iterator[Record]`, and one of text also `score(head) -> float`. The score, 0..1, says
how sure the module is that a capture with these first bytes has its format. Everything else is here: ports, times, problems,
errors of libraries.

Rules:

1. Reading a source raises nothing but errors of this program; what a library raises becomes a problem where something
   was read before, and an UnreadableError where nothing was.
2. Times are given on as the capture has them. Backward steps and impossible times are noted, not mended; a record
   without a time among others that have one takes the time before it; what stands before all others takes the first.
3. Problems and notes are bounded, however bad the capture.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Protocol, TypeVar, cast

import msgspec

from analyzer.columns.block import ByteBlock, CanBlock
from analyzer.errors import ServotapError, UnreadableError
from analyzer.records import CanFrame, Chunk, Comment, Event, Silence
from analyzer.sources.stream import Stream
from analyzer.sources.tail import Follow
from analyzer.sources.times import Clock
from analyzer.values import SECOND_NS, counted

Record = Chunk | CanFrame | Comment | Silence | Event

#: Problems kept in full; the others are counted.
KEPT_PROBLEMS = 20
#: Problems named in a note.
SHOWN_PROBLEMS = 3
#: Notes kept.
KEPT_NOTES = 50
#: Characters of a comment, and of a capture's text inside a message.
COMMENT_LIMIT = 2000
QUOTE_LIMIT = 60
#: Ports of one capture; a capture with more is damaged or hostile.
PORT_LIMIT = 64
#: Comments before the first traffic that are held back until its time is known.
_HEAD_LIMIT = 1000
#: As many chunks or frames wait for it.
_HEAD_TRAFFIC = 20

#: Bytes that are read together where records become blocks.
TOGETHER = 3 << 19
#: Records that are joined to a block at most, their bytes, and the fewest bytes for which that is worth it.
_RECORDS, JOINED, SHORTEST_BLOCK = 3 << 14, 1 << 20, 512
#: 2100-01-01: what lies behind it is noted.
FAR_NS = 4_102_444_800 * SECOND_NS
#: The greatest time that every part of the program can hold.
LATEST_NS = (1 << 63) - 1

_DEFAULT_PORTS = {"can": "can", "serial": "serial", "log": "bus"}
_UNFIT = re.compile(r"[^A-Za-z0-9_.-]+")


T = TypeVar("T")
R = TypeVar("R")


class Workers(Protocol):
    """Other processes that have a share of the work."""

    def parsed(self, function: Callable[[T], R], ranges: Iterator[T]) -> Iterator[tuple[T, R]]:
        """Yield ranges with what a function makes of each, in their order; a few are looked at ahead."""


class Problem(msgspec.Struct, frozen=True):
    """A place that could not be read. `line` counts from 1; `offset` is in bytes of the unpacked capture."""

    text: str
    line: int | None = None
    offset: int | None = None

    def __str__(self) -> str:
        if self.line is not None:
            return f"line {self.line}: {self.text}"
        if self.offset is not None:
            return f"byte {self.offset}: {self.text}"
        return self.text


class Source:
    """A capture open for reading. Iterate it once for its records; it closes its file at `close`.

    `path` as given, `name` to show, `format` by its name in the table of formats. `kind`: "serial", "can", or "log"
    for a log of this program, which can hold both. `channels`, `inverted`, `uart` (`8E1`): of a logic analyzer, as the user
    says; empty: they are found. `time_source`: what the times are and how exact, in words, or
    "none". `size`: bytes on disk, None for a pipe.
    """

    def __init__(
        self,
        path: str,
        *,
        baud: int | None = None,
        bus: str | None = None,
        channels: Sequence[str] = (),
        inverted: bool = False,
        uart: str = "",
    ) -> None:
        self.path = path
        self.baud = baud
        self.bus = bus
        self.channels = channels
        self.inverted = inverted
        self.uart = uart
        #: How bytes stand on the channels that are read (`8E1`); known with the first record, empty where no levels are.
        self.uarts: set[str] = set()
        self.problems: list[Problem] = []
        self.problem_count = 0
        self._notes: list[str] = []
        self.stream = Stream(path, self.problem)
        self.name = self.stream.name
        self.size = self.stream.size
        self.format = ""
        self.title = ""
        self.kind = "serial"
        self.time_source = "none"
        #: What the times are, for those who show them; known with the first record.
        self.clock = Clock.UTC
        #: Give many records as one block. It may be set at any time, but not together with what follows here.
        self.in_blocks = False
        #: Processes that make blocks of ranges ahead of the reading. Set with `in_blocks`.
        self.workers: Workers | None = None
        #: Of a decoded log: give each frame as one piece with the role it was found to have, and raw bytes only where
        #: they were never decoded. Set before the first record is taken.
        self.framed = False
        #: Of a log: what lies before this time is passed over, but what was said of the buses. Set likewise.
        self.skip_before_ns: int | None = None
        #: Of a log that is still being written: how to wait for more. Set likewise. `rewound`: some of it came twice.
        self.follow: Follow | None = None
        self.rewound = False
        self._parts: list[Path] = []
        self._passed = 0
        self.head = b""
        self._records: Iterator[Record | CanBlock | ByteBlock] = iter(())
        self._ports: dict[tuple[str | None, str], str] = {}
        self._backward = 0
        self._backward_ns = 0
        self._far = 0
        self._impossible = 0
        self._negative = False
        self._untimed = 0
        self._given = False
        self._last_ns: int | None = None

    # --- for those who read it ------------------------------------------------------------------------------------

    def __iter__(self) -> Iterator[Record]:
        # Blocks come only to those who set `in_blocks`, and they use `items`.
        return cast(Iterator[Record], self._records)

    def items(self) -> Iterator[Record | CanBlock | ByteBlock]:
        """Return what iterating yields, with blocks once they are wanted."""
        return self._records

    def position(self) -> int:
        """Return how many bytes of the file have been read; it never goes back."""
        return self._passed + self.stream.position

    @property
    def sha256(self) -> str | None:
        """SHA-256 of the whole file in hex; None before all of it was read, and for a capture of several files."""
        return self.stream.sha256 if not self._passed and not self._parts else None

    def continues_with(self, parts: Sequence[Path]) -> None:
        """Say which files follow the first one: parts of one log."""
        self._parts = list(parts)
        if self.size is not None:
            self.size += sum(path.stat().st_size for path in parts)

    @property
    def files(self) -> list[Path]:
        """The files that are to be read, the present one first."""
        return [Path(self.stream.path), *self._parts]

    def next_part(self) -> bool:
        """Go over to the next file; say whether there was one."""
        if not self._parts:
            return False
        self.stream.drain()
        self.stream.check()
        self._passed += self.stream.position
        self.stream.close()
        self.stream = Stream(str(self._parts.pop(0)), self.problem)
        return True

    def take_parts(self) -> list[Path]:
        """Return the files that follow; the caller then reads them itself."""
        taken, self._parts = self._parts, []
        return taken

    @property
    def notes(self) -> list[str]:
        """What the user should know of the capture; complete once it was read to the end."""
        return [*self._notes, *self._time_notes(), *self._problem_notes()]

    def close(self) -> None:
        """Close the file. Closing twice is fine."""
        close = getattr(self._records, "close", None)
        if close is not None:
            close()
        self.stream.close()

    def __enter__(self) -> Source:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    # --- for format modules ---------------------------------------------------------------------------------------

    def note(self, text: str) -> None:
        """Say something about the capture; the same text counts once."""
        if text not in self._notes and len(self._notes) < KEPT_NOTES:
            self._notes.append(text)

    def problem(self, text: str, line: int | None = None, offset: int | None = None) -> None:
        """Say that a place could not be read."""
        self.problem_count += 1
        if len(self.problems) < KEPT_PROBLEMS:
            self.problems.append(Problem(text, line, offset))

    def carried(self, frame: CanFrame, line: int | None = None) -> CanFrame:
        """Return a frame with what it carries: a remote one carries nothing, and data that stands there is told."""
        if not frame.remote or not frame.data:
            return frame
        # Formats that always print or keep eight bytes fill them with zeros.
        if any(frame.data):
            self.problem(f"a remote frame carries no data, got {quote(frame.data.hex(' ').upper())}, which is left out", line)
        return msgspec.structs.replace(frame, data=b"")

    def port(self, name: str | None = None, kind: str = "") -> str:
        """Return the port for a capture's own name of a line, or for the only line of a capture that names none.

        A name given by the user takes the place of the first line's; further lines are told apart by their own names. `kind`:
        serial or can, where a capture can have both: under one name they are two ports.
        """
        known = self._ports.get((name, kind))
        if known is not None:
            return known
        cleaned = clean_port(name) if name else ""
        port = cleaned or _DEFAULT_PORTS[self.kind]
        if self.bus is not None:
            port = self.bus if not self._ports else f"{self.bus}_{port}"
        if len(self._ports) >= PORT_LIMIT:
            self.note(f"more than {PORT_LIMIT} lines: the others are taken as one")
            port = next((p for (_, k), p in self._ports.items() if k == kind), f"{port}_{kind}")
        others = {p for (_, k), p in self._ports.items() if k not in ("", kind)}
        if kind and port in others:
            self.note(f"{port} has serial bytes and CAN frames: they are kept apart as {port} and {port}_{kind}")
            while port in others:
                port += f"_{kind}"
        if len(self._ports) < 2 * PORT_LIMIT:
            self._ports[name, kind] = port
        return port

    def comment(self, t_ns: int | None, text: str) -> Comment:
        """Return a comment of bounded length, on the capture's first line."""
        port = next(iter(self._ports.values()), None) or self.bus or _DEFAULT_PORTS[self.kind]
        text = text.strip()
        return Comment(t_ns, port, text if len(text) <= COMMENT_LIMIT else text[:COMMENT_LIMIT] + "...")

    def parsed(self, function: Callable[[T], R], ranges: Iterator[T]) -> Iterator[tuple[T, R | None]]:
        """Yield ranges of the capture, in their order, with what a function makes of each; None until blocks are wanted.

        A range says all that the function needs, and begins where a record does. So any process can take it. What depends on
        ranges before it (numbers of lines, names of buses, odd records) is for the caller, who gets them in their order.
        """
        while not self.in_blocks:
            own = next(ranges, None)
            if own is None:
                return
            yield own, None
        if self.workers is None or self.stream.compression or self.size is None:
            # What may break off as it is unpacked, or waits for more, is not read ahead.
            yield from ((own, function(own)) for own in ranges)
        else:
            yield from self.workers.parsed(function, ranges)

    def begin(self, records: Iterator[Record | CanBlock]) -> None:
        """Set what iterating yields."""
        self._records = self._run(records)

    # --- reading --------------------------------------------------------------------------------------------------

    def _run(self, records: Iterator[Record | CanBlock]) -> Iterator[Record | CanBlock | ByteBlock]:
        try:
            yield from _larger(self._joined(self._timed(self._headed(records))))
        except ServotapError:
            raise
        # A damaged file can make a library's parser raise any exception.
        except Exception as error:
            what = describe(error)
            if not self._given:
                raise UnreadableError(f"{self.name}: cannot be read as {self.title}: {what}") from error
            self.problem(f"the capture breaks off: {what}", offset=self.stream.position)
        finally:
            closing = getattr(records, "close", None)
            if closing is not None:
                closing()
        self.stream.check()
        # A pipe whose reading broke off may go on for ever.
        if self.size is not None or not self.problem_count:
            self.stream.drain()
            self.stream.check()
        if not self._given:
            if self.problem_count:
                raise UnreadableError(f"{self.name}: cannot be read as {self.title}: {self.problems[0]}")
            self.note("the capture holds no traffic")

    def _headed(self, records: Iterator[Record | CanBlock]) -> Iterator[Record | CanBlock]:
        """Give what has no time before the first time that one: without it, a log would begin in 1970.

        Comments wait for a time; of a file, which ends by itself, some traffic does, too.
        """
        head: list[Record] = []
        for record in records:
            if isinstance(record, CanBlock):
                first_ns: int | None = int(record.t_ns[0])
            else:
                first_ns = record.t_ns
                limit = _HEAD_LIMIT if isinstance(record, Comment) else _HEAD_TRAFFIC * (self.size is not None)
                if first_ns is None and len(head) < limit:
                    head.append(record)
                    continue
            if first_ns is not None:
                self._untimed += sum(isinstance(each, (Chunk, CanFrame)) for each in head)
            yield from (msgspec.structs.replace(each, t_ns=first_ns) for each in head)
            yield record
            break
        else:
            yield from head
        yield from records

    def _timed(self, records: Iterator[Record | CanBlock]) -> Iterator[Record | CanBlock]:
        """Yield records with times that are possible, and blocks whose times never decrease."""
        last_ns = self._last_ns
        for record in records:
            if isinstance(record, CanBlock):
                if (last_ns or 0) <= record.t_ns[0] and record.t_ns[-1] < FAR_NS:
                    last_ns = int(record.t_ns[-1])
                    self._given = True
                    yield record
                    continue
                # It lies before what was, or too far off.
                self._last_ns = last_ns
                yield from self._timed(record.frames())
                last_ns = self._last_ns
                continue
            t_ns = record.t_ns
            if t_ns is None:
                if last_ns is not None:
                    self._untimed += isinstance(record, (Chunk, CanFrame))
                    record = msgspec.structs.replace(record, t_ns=last_ns)
            elif last_ns is None or last_ns <= t_ns < FAR_NS:
                if not 0 <= t_ns < FAR_NS:
                    record = self._odd_time(record, t_ns, last_ns)
                last_ns = record.t_ns
            else:
                record = self._odd_time(record, t_ns, last_ns)
                last_ns = record.t_ns
            self._given = True
            yield record
        self._last_ns = last_ns

    def _joined(self, records: Iterator[Record | CanBlock]) -> Iterator[Record | CanBlock | ByteBlock]:
        """Yield chunks and CAN frames that follow each other on one line as blocks, once those are wanted."""
        held: list[Chunk | CanFrame] = []
        size = 0
        try:
            for record in records:
                joins = self.in_blocks and _joins(record)
                if held and not (joins and size < JOINED and len(held) < _RECORDS and _follows(held[-1], record)):
                    yield from _block_of(held)
                    held, size = [], 0
                if joins:
                    assert isinstance(record, (Chunk, CanFrame))
                    held.append(record)
                    size += len(record.data)
                else:
                    yield record
        except Exception:
            # What came before the fault is given first.
            yield from _block_of(held)
            raise
        yield from _block_of(held)

    def _odd_time(self, record: Record, t_ns: int, last_ns: int | None) -> Record:
        if abs(t_ns) > LATEST_NS:
            self._impossible += 1
            return msgspec.structs.replace(record, t_ns=last_ns or 0 if isinstance(record, Event | Silence) else last_ns)
        self._negative |= t_ns < 0
        self._far += t_ns >= FAR_NS
        if last_ns is not None and t_ns < last_ns:
            self._backward += 1
            self._backward_ns = max(self._backward_ns, last_ns - t_ns)
        return record

    def _time_notes(self) -> Iterator[str]:
        if self._backward:
            steps = "once" if self._backward == 1 else f"{counted(self._backward, 'time')}"
            yield f"times run backwards {steps}, by {self._backward_ns / SECOND_NS:g} s at most"
        if self._negative:
            yield "times before zero"
        if self._far:
            yield f"{counted(self._far, 'time')} after the year 2100: the clock of the capture is wrong"
        if self._impossible:
            yield f"{counted(self._impossible, 'time')} beyond any calendar: the time before each is used"
        if self._untimed:
            yield f"{counted(self._untimed, 'record')} without a time: the time before each is used, or the first"

    def _problem_notes(self) -> Iterator[str]:
        if self.problem_count == 0:
            return
        shown = "; ".join(str(p) for p in self.problems[:SHOWN_PROBLEMS])
        left = self.problem_count - SHOWN_PROBLEMS
        places = "1 problem" if self.problem_count == 1 else f"{self.problem_count} problems"
        yield f"{places}: {shown}" + (f"; and {left} more" if left > 0 else "")


def _larger(records: Iterator[Record | CanBlock | ByteBlock]) -> Iterator[Record | CanBlock | ByteBlock]:
    """Yield records; small blocks of CAN frames that follow each other on one bus as larger ones."""
    held: list[CanBlock] = []
    rows = 0
    try:
        for record in records:
            block = record if isinstance(record, CanBlock) else None
            if held and not (block is not None and rows + len(block) <= _RECORDS and held[-1].leads_to(block)):
                yield CanBlock.joined(held)
                held, rows = [], 0
            if block is None:
                yield record
                continue
            held.append(block)
            rows += len(block)
            if rows >= _RECORDS // 2:
                yield CanBlock.joined(held)
                held, rows = [], 0
    except Exception:
        # What came before the fault is given first.
        if held:
            yield CanBlock.joined(held)
        raise
    if held:
        yield CanBlock.joined(held)


def _joins(record: Record | CanBlock) -> bool:
    """Say whether a record can stand in a block."""
    if isinstance(record, CanFrame):
        return CanBlock.takes(record) and 0 <= (record.t_ns or 0) < FAR_NS
    return isinstance(record, Chunk) and bool(record.data) and not record.torn


def _follows(held: Chunk | CanFrame, other: Record | CanBlock) -> bool:
    """Say whether a record can stand in a block behind another."""
    if not isinstance(other, type(held)) or other.port != held.port or (held.t_ns is None) is not (other.t_ns is None):
        return False
    return held.t_ns is None or other.t_ns is None or held.t_ns <= other.t_ns


def _block_of(held: Sequence[Chunk | CanFrame]) -> Iterator[Record | CanBlock | ByteBlock]:
    if sum(len(record.data) for record in held) < SHORTEST_BLOCK:
        yield from held
    elif isinstance(held[0], Chunk):
        yield ByteBlock.of(cast("Sequence[Chunk]", held))
    else:
        yield CanBlock.of(cast("Sequence[CanFrame]", held))


def clean_port(name: str) -> str:
    """Return a capture's name of a line as a port: letters, digits, `_`, `.`, `-`; a device is cut to its last part."""
    last = name[len("/dev/") :] if name.startswith("/dev/") else name
    return _UNFIT.sub("_", last).strip("_.")[:40]


def describe(error: BaseException) -> str:
    """Return an error of a library in words."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {quote(text, 200)}" if text else type(error).__name__


def quote(text: str, limit: int = QUOTE_LIMIT) -> str:
    """Return a piece of a capture's text for a message: bounded, without control characters."""
    shown = "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in text[:limit])
    return shown + ("..." if len(text) > limit else "")
