"""What is kept of a log for a page, within bounds: values over time, marks of commands and findings, counts.

A track that becomes long keeps the least and the greatest value of each stretch, so that no peak is lost. Of marks that become
many each so many-th is kept. `traffic` fills all of it from a log.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analyzer.records import Severity
from analyzer.sinks.summary import Latencies
from analyzer.sources.mcap_scan import fields_of
from analyzer.values import fields_text

Integers = NDArray[np.int64]
Numbers = NDArray[np.float64]


class Track:
    """Points in growing time: when (ns), which message, and what; columns of one length."""

    def __init__(self) -> None:
        self._parts: list[tuple[Integers, Integers, Numbers]] = []
        self.count = 0

    def add(self, t_ns: Integers, sequence: Integers, values: Numbers) -> None:
        """Add points; those without a value are left out."""
        there = np.isfinite(values)
        if not there.all():
            t_ns, sequence, values = t_ns[there], sequence[there], values[there]
        if len(values):
            self._parts.append((t_ns, sequence, values))
            self.count += len(values)

    def columns(self) -> tuple[Integers, Integers, Numbers]:
        if not self._parts:
            return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)
        t_ns, sequence, values = (np.concatenate(each) for each in zip(*self._parts, strict=True))
        self._parts = [(t_ns, sequence, values)]
        return t_ns, sequence, values

    def thin(self, most: int) -> None:
        """Keep at most so many points: the least and the greatest of each stretch."""
        t_ns, sequence, values = self.columns()
        kept = extremes(values, most)
        self._parts = [(t_ns[kept], sequence[kept], values[kept])]
        self.count = len(kept)


def extremes(values: Numbers, most: int) -> Integers:
    """Return the places of at most `most` values, 4 at least: the ends, and the least and the greatest of each stretch.

    Stretches have equally many values. So a burst between long pauses keeps its shape.
    """
    count = len(values)
    if count <= most:
        return np.arange(count)
    size = -(-count // ((most - 2) // 2))
    whole = count // size
    rows = values[: whole * size].reshape(whole, size)
    firsts = np.arange(whole) * size
    kept = [firsts + rows.argmin(axis=1), firsts + rows.argmax(axis=1), np.array([0, count - 1])]
    if rest := values[whole * size :].tolist():
        kept.append(whole * size + np.array([rest.index(min(rest)), rest.index(max(rest))]))
    return np.unique(np.concatenate(kept))


@dataclass
class Marks:
    """Times of one command of a drive, or of the breaches of one rule: all, or if they are many each so many-th of them.

    `said`: what each says, as it was logged or in words. `count`: of all.
    """

    kind: str
    label: str
    units: Mapping[str, str] = field(default_factory=dict)
    count: int = 0
    t_ns: list[int] = field(default_factory=list)
    sequence: list[int] = field(default_factory=list)
    said: list[bytes | str] = field(default_factory=list)
    _stride: int = 1

    def add(self, t_ns: Sequence[int], sequence: Sequence[int], said: Sequence[bytes | str], most: int) -> None:
        """Add marks; keep at most so many."""
        kept = slice(-self.count % self._stride, None, self._stride)
        self.count += len(t_ns)
        self.t_ns += t_ns[kept]
        self.sequence += sequence[kept]
        self.said += said[kept]
        while len(self.t_ns) > most:
            self._stride *= 2
            self.t_ns, self.sequence, self.said = self.t_ns[::2], self.sequence[::2], self.said[::2]

    def text(self, number: int) -> str:
        """Return what one of those that were kept says."""
        said = self.said[number]
        return said if isinstance(said, str) else fields_text(own_fields(fields_of(said)), self.units)


@dataclass
class Drive:
    """An address of a bus: a drive, or another device that a file describes.

    `address`: as topics have it; `who`: as people read it; `bytes`: in its frames, of both sides. `answers`: sound replies to
    commands of drives. `states`: values over time, with their `units`: of a drive the quantities of its state, of another
    device its fields.
    """

    bus: str
    address: str
    who: str = ""
    dialects: dict[str, None] = field(default_factory=dict)
    requests: int = 0
    replies: int = 0
    answers: int = 0
    messages: int = 0
    unknown: int = 0
    bytes: int = 0
    severities: Counter[Severity] = field(default_factory=Counter)
    states: dict[str, Track] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    marks: dict[str, Marks] = field(default_factory=dict)

    @property
    def frames(self) -> int:
        """How many frames it sent or was sent."""
        return self.requests + self.replies + self.messages + self.unknown

    @property
    def order(self) -> tuple[str, int, str]:
        """Its place in a list: by bus and by address as a number."""
        return self.bus, number_of(self.address), self.address


@dataclass
class Talk:
    """One command of a bus, all drives together."""

    bus: str
    command: str
    requests: int = 0
    replies: int = 0
    latencies: Latencies = field(default_factory=Latencies)


@dataclass
class Bus:
    """A bus, second by second: bus load (0..1), frames, errors and warnings; and bytes that belong to no frame.

    `second_ns`: a time in the second whose counts come next.
    """

    load: Track = field(default_factory=Track)
    frames: Track = field(default_factory=Track)
    errors: Track = field(default_factory=Track)
    warnings: Track = field(default_factory=Track)
    junk_bytes: Counter[str] = field(default_factory=Counter)
    second_ns: int | None = None


class Example(NamedTuple):
    """A finding with its frame, as far as that was found: bytes as hex, and fields in words."""

    t_ns: int
    sequence: int
    topic: str
    offset: int
    text: str
    section: str
    raw: str = ""
    fields: str = ""


@dataclass
class Breaches:
    """What is known of one rule."""

    rule: str
    severity: Severity
    count: int = 0
    first: list[Example] = field(default_factory=list)


class Told(NamedTuple):
    """A comment, or an event of the recording."""

    t_ns: int
    bus: str
    text: str


def properties_of(schema: bytes) -> dict[str, dict[str, Any]]:
    """Return what a schema says of each field; of one of another program, which can be anything, maybe nothing."""
    found = fields_of(schema).get("properties")
    return {name: about for name, about in found.items() if isinstance(about, dict)} if isinstance(found, dict) else {}


def own_fields(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of the command alone; slots only as a package has them."""
    slots = fields.get("slots")
    odd = not isinstance(slots, list) or not all(isinstance(slot, dict) and "slots" not in slot for slot in slots)
    return {name: value for name, value in fields.items() if not (name.startswith("_") or (name == "slots" and odd))}


def number_of(address: str) -> int:
    """Return an address of a topic as a number, -1 for any other text."""
    return int(address) if address.isdecimal() and len(address) < 12 else -1


def busiest(drives: Sequence[Drive]) -> list[Drive]:
    """Return drives, those with the most frames first."""
    return sorted(drives, key=lambda drive: (-drive.frames, drive.order))
