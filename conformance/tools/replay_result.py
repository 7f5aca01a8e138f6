"""What a replay did, and how the replies compare with those of the recording.

Commands, forms and statuses have to be the same as then. What a read returns may differ: it was measured.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from conformance.tools.replay_plan import Step, Told


class Match(StrEnum):
    """A request's replies beside those of the recording."""

    SAME = "same bytes"
    VALUES = "other values"
    DIFFERENT = "different"
    MISSING = "missing"
    MORE = "more"
    SILENT = "silent, as then"


#: What of these is a deviation.
DEVIATIONS = frozenset({Match.DIFFERENT, Match.MISSING, Match.MORE})


@dataclass(slots=True)
class Sent:
    """A step as it was sent. `late_ns`: behind its time; `held`: it waited for a reply."""

    step: Step
    late_ns: int
    held: bool
    replies: list[Told] = field(default_factory=list)

    @property
    def match(self) -> Match:
        """What came back beside what came then."""
        return compare(self.step.replies, self.replies)


@dataclass
class Result:
    """What a replay did.

    `matches`: by command and match, how often; `examples`: the first deviation of each kind of them; `late_ns`: of the steps
    that nothing held back. `stopped`: why it did not go to its end, or nothing; `left_moving`: drives of which nobody can say
    that they stand, and why. `junk`, `others`: pieces that were no frame, and frames that answered no step.
    """

    sent: int = 0
    held: int = 0
    matches: Counter[tuple[str, Match]] = field(default_factory=Counter)
    examples: dict[tuple[str, Match], Sent] = field(default_factory=dict)
    late_ns: array[int] = field(default_factory=lambda: array("q"))
    stopped: str = ""
    left_moving: list[str] = field(default_factory=list)
    junk: int = 0
    others: int = 0

    @property
    def deviations(self) -> int:
        """Requests that were answered otherwise than then."""
        return sum(count for (_, match), count in self.matches.items() if match in DEVIATIONS)

    def lateness_ns(self, share: float) -> int:
        """Return how late the steps left that nothing held back: the value that this share of them does not exceed."""
        late = sorted(self.late_ns)
        return late[min(len(late) - 1, int(share * len(late)))] if late else 0

    def settle(self, sent: Sent) -> None:
        """Count a step whose replies have come."""
        key = (sent.step.name, sent.match)
        self.matches[key] += 1
        if sent.match in DEVIATIONS:
            self.examples.setdefault(key, sent)


def compare(then: Sequence[Told], now: Sequence[Told]) -> Match:
    """Compare the replies to a request: commands, forms and statuses have to be the same; what is read may differ."""
    if not then and not now:
        return Match.SILENT
    if len(now) < len(then):
        return Match.MISSING
    if len(now) > len(then):
        return Match.MORE
    if [t.kind for t in then] != [t.kind for t in now]:
        return Match.DIFFERENT
    if all(a.data == b.data for a, b in zip(then, now, strict=True)):
        return Match.SAME
    return Match.VALUES if all(t.reads or t.status is None for t in now) else Match.SAME
