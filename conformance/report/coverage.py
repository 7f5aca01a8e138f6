"""Coverage: the tested aspects of each command, and their outcomes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from analyzer import dialects
from conformance.claim import Aspect, Outcome
from conformance.suite.record import VerdictRecord

#: The worst of several outcomes is shown; an untested command is `never`.
RANK = (Outcome.REFUTED, Outcome.OBSERVED, Outcome.CONFIRMED, Outcome.INCONCLUSIVE, Outcome.NOT_RUN)
NEVER = "never"


def matrix(records: Sequence[VerdictRecord], target: str) -> dict[str, dict[str, str]]:
    """Return the outcome of each command and aspect for a target, in the manual's order; `never` where none was run."""
    own = [r for r in records if r.target == target]
    if not own:
        return {}
    found: dict[tuple[str, str], list[str]] = {}
    for record in own:
        blamed = record.asked if record.refuted and record.asked in {command for command, _ in record.covers} else ""
        for command, aspect in record.covers:
            # A claim about many commands is refuted by one of them; of the others it says nothing then.
            if not blamed or command == blamed:
                found.setdefault((command, aspect), []).append(record.outcome)
    commands = [c.name for c in dialects.get(own[0].dialect).commands]
    return {c: {a.value: _worst(found.get((c, a.value), [])) for a in Aspect} for c in commands}


def _worst(outcomes: Sequence[str]) -> str:
    for outcome in RANK[:3]:
        if outcome in outcomes:
            return outcome.value
    return NEVER


def share(rows: Mapping[str, Mapping[str, str]]) -> dict[str, tuple[int, int]]:
    """Return for each aspect how many commands were looked at, of how many."""
    return {a.value: (sum(row[a.value] != NEVER for row in rows.values()), len(rows)) for a in Aspect}
