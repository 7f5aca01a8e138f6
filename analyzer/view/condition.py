"""A filter on lines. It knows the names that it uses, so only these are made, and only where they can matter.

Most frames of a long capture belong to a few lanes (one head and length). Where what all frames of a lane share decides, one
frame answers for the lane.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from analyzer.cli.filter import OWN, Filter, Meaning
from analyzer.findings import RULES
from analyzer.live.snapshot import FOREIGN, FrameLine
from analyzer.values import SECOND_NS
from analyzer.view.lines import MS, bytes_text

#: Name in a filter -> how it is made of a line; None: the line has no such thing.
_NAMES: dict[str, Callable[[FrameLine], Any]] = {
    "time": lambda line: line.t_ns / SECOND_NS,
    "bus": lambda line: line.bus,
    "dialect": lambda line: line.dialect if line.role != FOREIGN else "",
    "address": lambda line: line.address,
    "role": lambda line: line.role,
    "command": lambda line: "unknown" if line.command.startswith("unknown") else line.command,
    "checksum_ok": lambda line: line.checksum_ok,
    "findings": lambda line: [*line.rules, line.severity, *(RULES[r].severity for r in line.rules if r in RULES)],
    "raw": bytes_text,
    "offset": lambda line: line.offset,
    "sequence": lambda line: line.sequence,
    "section": lambda line: line.section,
    "latency": lambda line: None if line.latency_ns is None else line.latency_ns / MS,
}


class Condition:
    """A filter, to be called with a line. Raises UsageError as `Filter` does."""

    def __init__(self, text: str, known: Mapping[str, Meaning]) -> None:
        self._filter = Filter(text, known)
        self.text = text
        self._made = tuple((name, _NAMES[name]) for name in self._filter.used if name in _NAMES)
        self._fields = tuple(name for name in self._filter.used if name not in _NAMES)

    def __call__(self, line: FrameLine) -> bool:
        return self._filter(self._names(line))

    def of_lane(self, line: FrameLine) -> bool | None:
        """Return the answer for all frames of a lane, of which this is one; None where it is not the same for all."""
        # A value without a name has none; the next one may.
        return self._filter.settled(self._names(line), OWN | {n for name in line.values for n in (name, f"{name}_name")})

    def _names(self, line: FrameLine) -> dict[str, Any]:
        names: dict[str, Any] = {}
        for name, make in self._made:
            value = make(line)
            if value is not None:
                names[name] = value
        values = line.values
        for name in self._fields:
            if name in values:
                names[name] = values[name]
        return names
