"""Exports: the raw bytes of a capture in files for other programs.

    source -> item (chunk, CAN frame, comment) -> writer -> stream

A format is one module with a writer, imported only on demand. Items that a format cannot hold are left out and counted by
bus. Nothing is decoded here.

Times: exact to 1 ns unless a writer's `digits` say less. If a format needs times and a capture has none, they are
estimated from the line speed. A time before zero becomes zero. Both are noted.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, field
from importlib import import_module
from typing import IO, NamedTuple

import msgspec

from analyzer.errors import UsageError
from analyzer.pipeline import CAN_OVERHEAD_BITS
from analyzer.records import CanFrame, Chunk, Comment
from analyzer.values import SECOND_NS

BITS_PER_BYTE = 10
CAN = "can"
SERIAL = "serial"


class Format(NamedTuple):
    """A format to export to. `holds`: kinds of buses; `binary`: nothing for a terminal; `module`, `writer`: what writes it."""

    module: str
    writer: str
    summary: str
    ending: str
    holds: tuple[str, ...]
    binary: bool = False


FORMATS: dict[str, Format] = {
    "candump": Format(
        "candump", "CandumpWriter",
        "the log form of can-utils (candump -L), CAN alone", ".candump.log", (CAN,),
    ),
    "pcapng": Format(
        "pcapng", "PcapngWriter",
        "for Wireshark: CAN as SocketCAN, serial as USER0 or RTAC", ".pcapng", (CAN, SERIAL), True,
    ),
    "hex": Format(
        "hextext", "HexTextWriter",
        "a line of time, mark and hex bytes for each piece, serial alone", ".hex.txt", (SERIAL,),
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Choices:
    """What a user can choose. `serial_as`: `user` or `rtac`; `digits`: of a second, 6 or 9, in candump."""

    serial_as: str = "user"
    digits: int = 6


class Writer(ABC):
    """Writes one format to a stream open for binary writing, which stays open.

    `needs_times`: an item without a time cannot be written.
    """

    needs_times = True

    def __init__(self, stream: IO[bytes], choices: Choices) -> None:
        self.stream = stream
        self.choices = choices

    @abstractmethod
    def traffic(self, item: Chunk | CanFrame) -> None:
        """Write bytes or a frame of a kind that the format holds."""

    def comment(self, comment: Comment) -> bool:
        """Write a comment; return False if the format has no place for one."""
        return False

    def finish(self) -> int:
        """Write what is held back; return the number of comments that found no place after all."""
        return 0


def writer(name: str, stream: IO[bytes], choices: Choices) -> Writer:
    """Return the writer of a format. Raises UsageError for a format there is none of."""
    if name not in FORMATS:
        raise UsageError(f"no format {name!r} to export to, expected {', '.join(FORMATS)}")
    chosen = FORMATS[name]
    made: Writer = getattr(import_module(f"{__name__}.{chosen.module}"), chosen.writer)(stream, choices)
    return made


@dataclass
class Count:
    """What one bus had. `pieces`: CAN frames, or stretches of serial bytes."""

    kind: str
    pieces: int = 0
    bytes: int = 0
    written: bool = True


@dataclass
class ExportResult:
    """What was exported and what was not, by bus. `comments` and `lost_comments`: written, left out."""

    buses: dict[str, Count] = field(default_factory=dict)
    comments: int = 0
    lost_comments: int = 0
    made_up: int = 0
    negative: int = 0

    @property
    def written(self) -> list[tuple[str, Count]]:
        return [(name, count) for name, count in self.buses.items() if count.written]

    @property
    def left_out(self) -> list[tuple[str, Count]]:
        """The buses that the format does not hold."""
        return [(name, count) for name, count in self.buses.items() if not count.written]


class Export:
    """Feeds a capture's items to a writer and counts them. `speed`: bits per second, for a capture without times."""

    def __init__(self, target: Writer, holds: tuple[str, ...], speed: int) -> None:
        self._target = target
        self._holds = holds
        self._bit_ns = SECOND_NS // speed
        self._clocks: dict[str, int] = {}
        self.outcome = ExportResult()

    def run(self, items: Iterable[Chunk | CanFrame | Comment]) -> None:
        """Write all items. Raises OSError when a write fails."""
        outcome, target, holds = self.outcome, self._target, self._holds
        buses, needs_times = outcome.buses, target.needs_times
        for item in items:
            if isinstance(item, Comment):
                self._comment(item)
                continue
            kind = CAN if isinstance(item, CanFrame) else SERIAL
            count = buses.get(item.port)
            if count is None:
                count = buses[item.port] = Count(kind, written=kind in holds)
            count.pieces += 1
            count.bytes += len(item.data)
            if not count.written:
                continue
            t_ns = item.t_ns
            if t_ns is None:
                if needs_times:
                    item = self._timed(item)
            elif t_ns < 0:
                outcome.negative += 1
                item = msgspec.structs.replace(item, t_ns=0)
            target.traffic(item)

    def finish(self) -> ExportResult:
        """Write what is held back and return the counts."""
        lost = self._target.finish()
        self.outcome.comments -= lost
        self.outcome.lost_comments += lost
        return self.outcome

    def _comment(self, comment: Comment) -> None:
        if comment.t_ns is not None and comment.t_ns < 0:
            comment = msgspec.structs.replace(comment, t_ns=0)
        if self._target.comment(comment):
            self.outcome.comments += 1
        else:
            self.outcome.lost_comments += 1

    def _timed(self, item: Chunk | CanFrame) -> Chunk | CanFrame:
        size = len(item.data)
        bits = CAN_OVERHEAD_BITS + 8 * size if isinstance(item, CanFrame) else BITS_PER_BYTE * size
        t_ns = self._clocks[item.port] = self._clocks.get(item.port, 0) + bits * self._bit_ns
        self.outcome.made_up += 1
        return msgspec.structs.replace(item, t_ns=t_ns)
