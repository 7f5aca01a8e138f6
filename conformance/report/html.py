"""The report as one page: what failed and why, verdicts, coverage, latencies, ramps, and every claim.

The page contains everything, so it can be mailed and kept.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from analyzer import dialects, page
from analyzer.cli.output import write_whole
from analyzer.page import Line, Plot
from conformance import claims
from conformance.claim import Aspect, Outcome
from conformance.report.bus import line_causes
from conformance.report.terminal import COLUMNS, repeat_command
from conformance.suite.record import RunRecord, VerdictRecord, firmware_of, noise_of

#: What a claim got from a drive that did not answer.
_SILENT = ("nothing", "silence")
#: The worst of several outcomes is shown.
RANK = (Outcome.REFUTED, Outcome.OBSERVED, Outcome.CONFIRMED, Outcome.INCONCLUSIVE, Outcome.NOT_RUN)
#: No verdict, though there are claims; and no claim: it cannot apply to the command, or the manual prints none.
NEVER, NOTHING = "never", "nothing"
Cell = tuple[str, tuple[VerdictRecord, ...]]
#: Ramps that are drawn at most.
_CURVES = 24
#: Outcome -> its colour and its sign.
_LOOKS = {
    Outcome.CONFIRMED: ("good", "✓"), Outcome.REFUTED: ("bad", "✗"), Outcome.OBSERVED: ("seen", "○"),
    Outcome.INCONCLUSIVE: ("doubt", "?"), Outcome.NOT_RUN: ("none", ""), NEVER: ("none", ""), NOTHING: ("none", "–"),
}  # fmt: skip
#: A command's latencies differ if its median is this far from that of all, or its longest.
_MEDIAN_OFF, _LONGEST_OFF = 1.25, 2.0
MS = 1_000_000


def write_html(path: Path, records: Sequence[VerdictRecord], run: RunRecord) -> None:
    """Write the page. Raises UsageError where it cannot be written."""
    # The command of the run may name a file that is no UTF-8.
    write_whole(path, html(records, run).encode(errors="backslashreplace"))


def html(records: Sequence[VerdictRecord], run: RunRecord) -> str:
    """Return the page as text."""
    targets = list(dict.fromkeys(r.target for r in records))
    counts = Counter(r.outcome for r in records)
    return page.render(
        "conformance.report",
        "test.html",
        drives=targets,
        records=records,
        total=len(records),
        counts={o: counts[o] for o, _ in COLUMNS},
        looks=_LOOKS,
        facts=_facts(records, run),
        notes=run.notes,
        line=list(line_causes(records)),
        causes=(found := causes(records)),
        card={id(record): f"cause-{number}" for number, cause in enumerate(found, 1) for record in cause.records},
        repeat=lambda record: repeat_command(record, run),
        row={id(record): f"claim-{number}" for number, record in enumerate(records, 1)},
        themes=_themes(records),
        aspects=[a.value for a in Aspect],
        coverage=[(target, rows, share(rows)) for target in targets if (rows := matrix(records, target))],
        why_none=lambda aspect: "the manual prints none" if aspect == Aspect.EXAMPLE else "does not apply",
        latencies=[_latencies(target, records) for target in targets if _latencies_of(target, records)],
        curves=_curves(records),
        curves_left=max(0, sum(len(r.series) for r in records) - _CURVES),
        measured=_measured,
        id=id,
    )


def _facts(records: Sequence[VerdictRecord], run: RunRecord) -> dict[str, str]:
    facts = {
        "on": ", ".join(dict.fromkeys(run.on)),
        "started": f"{run.started_at}, {run.seconds:.1f} s",
        "allowed": ", ".join(run.allowed) or "everything (emulated drives)",
        "bounds": ", ".join(f"{n} {v}" for n, v in run.bounds.items()),
        "firmware": ", ".join(f"{t}: {v}" for t, v in firmware_of(records).items()),
        "noise": ", ".join(f"{t}: {v}" for t, v in noise_of(records).items()),
        "seed": str(run.seed),
        "version": f"servotap {run.version}",
        "command": run.command,
    }
    return {name: text for name, text in facts.items() if text}


def _themes(records: Iterable[VerdictRecord]) -> dict[tuple[str, str], Counter[str]]:
    counts: dict[tuple[str, str], Counter[str]] = {}
    for record in records:
        counts.setdefault((record.target, record.theme), Counter())[record.outcome] += 1
    return counts


# --- causes -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Cause:
    """What is wrong with a drive, in a few words, and the refuted claims that show it."""

    target: str
    text: str
    records: tuple[VerdictRecord, ...]


def causes(records: Iterable[VerdictRecord]) -> list[Cause]:
    """Return the causes of what is refuted: those that took most claims first."""
    found: dict[tuple[str, str], list[VerdictRecord]] = {}
    for record in records:
        if record.refuted:
            found.setdefault((record.target, _text(record)), []).append(record)
    every = [
        # The words of a claim that stands alone name its command.
        Cause(target, text if len(own) > 1 else own[0].reason or own[0].key, tuple(own))
        for (target, text), own in found.items()
    ]
    return sorted(every, key=lambda cause: -len(cause.records))


def _text(record: VerdictRecord) -> str:
    """Return the key of a refutation without the commands that it names."""
    if record.got in _SILENT and record.expected not in _SILENT:
        return "no answer"
    names = sorted((c.name for c in dialects.get(record.dialect).commands), key=len, reverse=True)
    return re.sub(rf"\b(?:{'|'.join(map(re.escape, names))})\b", "a command", record.key)


# --- coverage ---------------------------------------------------------------------------------------------------------


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


# --- figures ----------------------------------------------------------------------------------------------------------


class Strip(NamedTuple):
    """Latencies of a command in ms, and where they stand on the scale of all strips, in percent."""

    command: str
    replies: int
    shortest: float
    median: float
    longest: float
    left: float
    width: float
    middle: float


class Latencies(NamedTuple):
    """Latencies of a drive: what is alike for most commands, and the commands that differ."""

    target: str
    alike: int
    shortest: float
    median: float
    longest: float
    strips: list[Strip]


def _latencies_of(target: str, records: Iterable[VerdictRecord]) -> dict[str, list[int]]:
    found: dict[str, list[int]] = {}
    for record in records:
        if record.target == target:
            for command, latency_ns in record.latencies:
                found.setdefault(command, []).append(latency_ns)
    return {command: sorted(each) for command, each in sorted(found.items())}


def _latencies(target: str, records: Iterable[VerdictRecord]) -> Latencies:
    """Return the latencies of a drive. Most commands take alike: those that do not are what is looked for."""
    found = _latencies_of(target, records)
    medians = {command: each[len(each) // 2] for command, each in found.items()}
    middle = max(1, sorted(medians.values())[len(medians) // 2])

    def differs(command: str) -> bool:
        off = max(medians[command], 1) / middle
        return not 1 / _MEDIAN_OFF < off < _MEDIAN_OFF or found[command][-1] > _LONGEST_OFF * middle

    other = [command for command in found if differs(command)]
    alike = sorted(ns for command, each in found.items() if command not in other for ns in each)
    scale = max([1, *(found[command][-1] for command in other)]) / 100
    strips = [
        Strip(
            command, len(each), each[0] / MS, medians[command] / MS, each[-1] / MS,
            each[0] / scale, (each[-1] - each[0]) / scale, medians[command] / scale,
        )
        for command in other
        if (each := found[command])
    ]  # fmt: skip
    least, most = (alike[0], alike[-1]) if alike else (0, 0)
    return Latencies(target, len(found) - len(other), least / MS, middle / MS, most / MS, strips)


def _curves(records: Iterable[VerdictRecord]) -> list[tuple[VerdictRecord, Plot]]:
    return [
        (record, Plot("time", "s", name, curve.unit, _lines(name, curve.points, curve.expected)))
        for record in records
        for name, curve in record.series.items()
        if len(curve.points) > 1
    ][:_CURVES]


def _lines(name: str, points: Sequence[tuple[float, float]], expected: Sequence[tuple[float, float]]) -> list[Line]:
    law = [Line("by the manual", expected, dashed=True)] if expected else []
    return [*law, Line(name, points)]


def _measured(record: VerdictRecord) -> str:
    """Return what was measured as text; `ramp_ms` is a ramp in ms."""
    words = [
        f"{name.removesuffix('_ms').replace('_', ' ')} {value:.4g}{' ms' if name.endswith('_ms') else ''}"
        for name, value in record.measured.items()
    ]
    return ", ".join(words)
