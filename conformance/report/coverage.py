"""Coverage: the tested aspects of each command, and their outcomes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from analyzer import dialects
from conformance import claims
from conformance.claim import Aspect, Outcome
from conformance.suite.record import VerdictRecord

#: The worst of several outcomes is shown.
RANK = (Outcome.REFUTED, Outcome.OBSERVED, Outcome.CONFIRMED, Outcome.INCONCLUSIVE, Outcome.NOT_RUN)
#: No verdict, though there are claims; and no claim: it cannot apply to the command, or the manual prints none.
NEVER, NOTHING = "never", "nothing"
Cell = tuple[str, tuple[VerdictRecord, ...]]


def matrix(records: Sequence[VerdictRecord], target: str) -> dict[str, dict[str, Cell]]:
    """Return for each command and aspect of a target the worst outcome and its verdicts, in the manual's order."""
    own = [r for r in records if r.target == target]
    if not own:
        return {}
    found: dict[tuple[str, str], list[VerdictRecord]] = {}
    for record in own:
        blamed = record.asked if record.refuted and record.asked in {command for command, _ in record.covers} else ""
        for command, aspect in record.covers:
            # A claim about many commands is refuted by one of them; of the others it says nothing then.
            if not blamed or command == blamed:
                found.setdefault((command, aspect), []).append(record)
    model = next((part.removeprefix("model=").upper() for part in target.split(",") if part.startswith("model=")), "")
    dialect = dialects.get(own[0].dialect)
    dialect = dialect.for_model(model) if model else dialect
    claimed = {pair for claim in claims.every(dialect) for pair in claim.covers}
    return {
        c.name: {a.value: _worst(found.get((c.name, a.value), [])) if (c.name, a) in claimed else (NOTHING, ()) for a in Aspect}
        for c in dialect.commands
    }


def _worst(records: Sequence[VerdictRecord]) -> Cell:
    for outcome in RANK:
        worst = tuple(r for r in records if r.outcome == outcome)
        if worst:
            return outcome.value, worst
    return NEVER, ()


def share(rows: Mapping[str, Mapping[str, Cell]]) -> dict[str, tuple[int, int]]:
    """Return for each aspect how many commands have a verdict, of those that can have one."""
    unjudged = (NEVER, Outcome.NOT_RUN, Outcome.INCONCLUSIVE)
    return {
        a.value: (
            sum(row[a.value][0] not in (*unjudged, NOTHING) for row in rows.values()),
            sum(row[a.value][0] != NOTHING for row in rows.values()),
        )
        for a in Aspect
    }
