"""Counts of a recording for its metadata: of the current part, and in total."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

from analyzer.entries import Entry
from analyzer.records import Comment, Finding, Frame, Junk, Lane

_NAMES = ("bytes", "frames", "frame_bytes", "junk_bytes", "marks")


class RecordingCounts:
    """A sink that counts. `junk_of` gets the port and the number of junk bytes."""

    def __init__(self, junk_of: Callable[[str, int], None]) -> None:
        self._junk_of = junk_of
        #: Bytes received, counted by the owner; all others count what was decoded.
        self.bytes = 0
        self.frames = self.frame_bytes = self.junk_bytes = self.marks = 0
        self.findings: Counter[str] = Counter()
        self._before: dict[str, int] = dict.fromkeys((*_NAMES, "findings"), 0)

    def plain(self, lane: Lane, frame: Frame, sequence: int, latency_ns: int | None, request_sequence: int | None) -> None:
        self.frames += 1
        self.frame_bytes += len(frame.data)

    def entry(self, entry: Entry) -> None:
        self.frames += 1
        self.frame_bytes += len(entry.message.frame.data)

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        self.junk_bytes += len(junk.data)
        self._junk_of(junk.port, len(junk.data))

    def finding(self, found: Finding) -> None:
        self.findings[found.rule] += 1

    def comment(self, comment: Comment) -> None:
        self.marks += 1

    def begin_part(self) -> None:
        self._before = self._now()

    @property
    def part_bytes(self) -> int:
        """Bytes that came in this part."""
        return self.bytes - self._before["bytes"]

    def _now(self) -> dict[str, int]:
        return {name: getattr(self, name) for name in _NAMES} | {"findings": sum(self.findings.values())}

    def about(self) -> dict[str, str]:
        """Return what the metadata of a part says."""
        count = {name: value - self._before[name] for name, value in self._now().items()}
        return {
            "bytes_total": str(count["bytes"]),
            "bytes_in_frames": str(count["frame_bytes"]),
            "bytes_junk": str(count["junk_bytes"]),
            "frames": str(count["frames"]),
            "findings": str(count["findings"]),
        }

    def state(self) -> dict[str, Any]:
        return {**self._now(), "findings": dict(self.findings), "before": dict(self._before)}

    def restore(self, state: Mapping[str, Any]) -> None:
        for name in _NAMES:
            setattr(self, name, state[name])
        self.findings = Counter(state["findings"])
        self._before = dict(state["before"])
