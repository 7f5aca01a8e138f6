"""A filter on lines. It knows the names that it uses, so only these are made, and only where they can matter.

Most frames of a long capture belong to a few lanes (one head and length). If a filter uses only facts that all frames of a lane
share, one frame answers for the lane.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

from analyzer.cli.filter import Filter, Meaning
from analyzer.findings import RULES
from analyzer.live.snapshot import FOREIGN, FrameLine
from analyzer.view.lines import MS, SECOND, bytes_text

#: Name in a filter -> how it is made of a line; None: the line has no such thing.
_NAMES: dict[str, Callable[[FrameLine], Any]] = {
    "time": lambda line: line.t_ns / SECOND,
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
#: Those that differ from frame to frame of one lane.
_OWN = frozenset(("time", "findings", "raw", "offset", "sequence", "latency"))


class Condition:
    """A filter, to be called with a line. Raises UsageError as `Filter` does."""

    def __init__(self, text: str, known: Mapping[str, Meaning]) -> None:
        self._filter = Filter(text, known)
        self.text = text
        # A unit is of the dialect and the command; a choice is compared by its name.
        self._used = self._filter.used | {"dialect", "command"} | {f"{name}_name" for name in self._filter.used}
        self._made = tuple((name, _NAMES[name]) for name in self._used if name in _NAMES)
        self._fields = tuple(name for name in self._used if name not in _NAMES)

    def __call__(self, line: FrameLine) -> bool:
        """Say whether a line is wanted."""
        names: dict[str, Any] = {}
        for name, make in self._made:
            value = make(line)
            if value is not None:
                names[name] = value
        values = line.values
        for name in self._fields:
            if name in values:
                names[name] = values[name]
        return self._filter(names)

    def same_for(self, fields: Collection[str]) -> bool:
        """Say whether the answer is the same for all frames of a lane that has these fields."""
        return not self._used & _OWN and not any(name in fields for name in self._fields)
