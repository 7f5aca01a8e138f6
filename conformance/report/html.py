"""The report as one page: verdicts, coverage, latencies, curves, and each refuted claim with its exchange.

The page contains everything, so it can be mailed and kept. Text from the wire is escaped and cannot act as markup.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

from analyzer.errors import UsageError
from conformance.claim import Aspect, Outcome
from conformance.report import svg
from conformance.report.coverage import matrix, share
from conformance.report.terminal import COLUMNS, repeat_command
from conformance.suite.record import RunRecord, VerdictRecord, firmware_of, noise_of

#: Curves that are drawn at most.
_CURVES = 24
_STYLE = """
:root { --ok: #1a7f37; --bad: #b42318; --seen: #0969da; --doubt: #9a6700; --none: #6e7781; --line: #d0d7de; --ground: #fff;
  --text: #1f2328; --soft: #f6f8fa; }
@media (prefers-color-scheme: dark) { :root { --ok: #3fb950; --bad: #ff7b72; --seen: #58a6ff; --doubt: #d29922; --none: #8d96a0;
  --line: #3d444d; --ground: #0d1117; --text: #e6edf3; --soft: #161b22; } }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--text); background: var(--ground); max-width: 1080px;
  margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.2rem; margin-top: 2.2rem; border-bottom: 1px solid var(--line); }
table { border-collapse: collapse; margin: .6rem 0; } th, td { padding: .15rem .6rem; text-align: left; vertical-align: top; }
th { border-bottom: 1px solid var(--line); font-weight: 600; } td.n { text-align: right; font-variant-numeric: tabular-nums; }
.wide { overflow-x: auto; } pre { background: var(--soft); padding: .6rem; overflow-x: auto; font-size: 13px; }
code { font-size: 13px; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .1rem 1rem; } dt { color: var(--none); }
dd { margin: 0; overflow-wrap: anywhere; }
.confirmed { color: var(--ok); } .refuted { color: var(--bad); font-weight: 600; } .observed { color: var(--seen); }
.inconclusive { color: var(--doubt); } .not-run, .never { color: var(--none); }
article { border-left: 4px solid var(--bad); padding-left: .9rem; margin: 1.2rem 0; }
svg text { font: 12px system-ui, sans-serif; fill: var(--text); } svg { max-width: 100%; height: auto; }
.grid { stroke: var(--line); } .range { stroke: var(--seen); stroke-width: 3; }
.median { stroke: var(--text); stroke-width: 2; }
.curve { fill: none; stroke: var(--seen); stroke-width: 1.5; }
label { margin-right: 1rem; } input[type=search] { padding: .2rem .5rem; width: 20rem; }
"""
_SCRIPT = """
const rows = [...document.querySelectorAll('#claims tbody tr')], search = document.getElementById('search');
const boxes = [...document.querySelectorAll('#outcomes input')];
function filter() {
  const on = new Set(boxes.filter(b => b.checked).map(b => b.value)), word = search.value.toLowerCase();
  for (const r of rows) r.hidden = !on.has(r.dataset.outcome) || !r.textContent.toLowerCase().includes(word);
}
for (const each of [...boxes, search]) each.addEventListener('input', filter);
"""
_MARKS = {
    "confirmed": "✓", "refuted": "✗", "observed": "o", "inconclusive": "?", "never": "–",
}  # fmt: skip


def write_html(path: Path, records: Sequence[VerdictRecord], run: RunRecord) -> None:
    """Write the page. Raises UsageError where it cannot be written."""
    try:
        path.write_text(page(records, run), encoding="utf-8")
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror or error}") from None


def page(records: Sequence[VerdictRecord], run: RunRecord) -> str:
    """Return the page as text."""
    targets = list(dict.fromkeys(r.target for r in records))
    title = f"Servotap: {', '.join(targets) or 'no drive'}"
    parts = [
        f"<h1>{escape(title)}</h1>", _about(records, run), _totals(records), _refuted(records, run),
        *(_coverage(records, target) for target in targets), _latencies(records), _curves(records), _claims(records),
    ]  # fmt: skip
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{_STYLE}</style></head>\n<body>'
        + "\n".join(part for part in parts if part)
        + f"<script>{_SCRIPT}</script></body></html>\n"
    )


def _about(records: Sequence[VerdictRecord], run: RunRecord) -> str:
    facts = {
        "on": ", ".join(dict.fromkeys(run.on)),
        "started": f"{run.started_at}, {run.seconds:.1f} s",
        "claims": ", ".join(f"{n} {Outcome(o).word}" for o, n in Counter(r.outcome for r in records).items()),
        "allowed": ", ".join(run.allowed) or "everything (emulated drives)",
        "bounds": ", ".join(f"{n} {v}" for n, v in run.bounds.items()),
        "firmware": ", ".join(f"{t}: {v}" for t, v in firmware_of(records).items()),
        "noise": ", ".join(f"{t}: {v}" for t, v in noise_of(records).items()),
        "seed": str(run.seed),
        "version": f"servotap {run.version}",
        "command": run.command,
        "notes": "; ".join(run.notes),
    }
    rows = "".join(f"<dt>{name}</dt><dd>{escape(text)}</dd>" for name, text in facts.items() if text)
    return f"<dl>{rows}</dl>"


def _totals(records: Sequence[VerdictRecord]) -> str:
    counts: dict[tuple[str, str], Counter[str]] = {}
    for record in records:
        counts.setdefault((record.target, record.theme), Counter())[record.outcome] += 1
    rows = [
        [target, theme, *(_count(counted[o.value], o.value) for o, _ in COLUMNS)] for (target, theme), counted in counts.items()
    ]
    head = ["drive", "theme", *(o.word for o, _ in COLUMNS)]
    return "<h2>Verdicts</h2>" + _table(head, rows, numbers_from=2)


def _count(number: int, outcome: str) -> str:
    return f'<span class="{_kind(outcome)}">{number}</span>' if number else ""


def _kind(outcome: str) -> str:
    return outcome.replace(" ", "-")


def _refuted(records: Sequence[VerdictRecord], run: RunRecord) -> str:
    refuted = [r for r in records if r.refuted]
    if not refuted:
        return "<h2>Refuted claims</h2><p>None.</p>"
    return "<h2>Refuted claims</h2>" + "".join(_article(r, run) for r in refuted)


def _article(record: VerdictRecord, run: RunRecord) -> str:
    facts = {
        "drive": record.target,
        "manual": f"{record.section} ({record.certainty})",
        "what": record.reason,
        "expected": record.expected,
        "got": record.got,
        "repeat": repeat_command(record, run),
    }
    rows = "".join(f"<dt>{n}</dt><dd>{escape(t)}</dd>" for n, t in facts.items() if t)
    exchange = f"<pre>{escape(chr(10).join(record.lines))}</pre>" if record.lines else ""
    return (
        f'<article id="{escape(record.id)}"><strong>{escape(record.id)}</strong><br>{escape(record.statement)}'
        f"<dl>{rows}</dl>{exchange}</article>"
    )


def _coverage(records: Sequence[VerdictRecord], target: str) -> str:
    rows = matrix(records, target)
    if not rows:
        return ""
    shown = [
        [f"<code>{escape(command)}</code>", *(f'<span class="{row[a.value]}">{_MARKS[row[a.value]]}</span>' for a in Aspect)]
        for command, row in rows.items()
    ]
    total = ["looked at", *(f"{done} of {count}" for done, count in share(rows).values())]
    return f"<h2>Coverage of {escape(target)}</h2>" + _table(["command", *(a.value for a in Aspect)], [*shown, total])


def _latencies(records: Sequence[VerdictRecord]) -> str:
    parts = []
    for target in dict.fromkeys(r.target for r in records):
        by_command: dict[str, list[int]] = {}
        for record in records:
            if record.target == target:
                for command, latency_ns in record.latencies:
                    by_command.setdefault(command, []).append(latency_ns)
        if by_command:
            parts.append(f"<h3>{escape(target)}</h3>{svg.latencies(dict(sorted(by_command.items())))}")
    if not parts:
        return ""
    told = "<p>From the end of a request to the beginning of its first reply, as the host saw them: shortest to longest, "
    return "<h2>Latency</h2>" + told + "the median marked and given.</p>" + "".join(parts)


def _curves(records: Sequence[VerdictRecord]) -> str:
    found = [(r, n, p) for r in records for n, p in r.series.items() if len(p) > 1]
    if not found:
        return ""
    more = f"<p>{len(found) - _CURVES} more curves are not drawn.</p>" if len(found) > _CURVES else ""
    drawn = "".join(f"<h3>{escape(r.target)}: {escape(r.id)}</h3>{svg.curve(p, 's', n)}" for r, n, p in found[:_CURVES])
    return f"<h2>Ramps</h2>{drawn}{more}"


def _claims(records: Sequence[VerdictRecord]) -> str:
    boxes = "".join(f'<label><input type="checkbox" value="{_kind(o.value)}" checked> {o.word}</label>' for o in Outcome)
    rows = "".join(
        f'<tr data-outcome="{_kind(r.outcome)}"><td class="{_kind(r.outcome)}">{escape(r.outcome)}</td>'
        f"<td><code>{escape(r.id)}</code><br>{escape(r.statement)}</td><td>{escape(r.section)}</td>"
        f"<td>{escape(r.certainty)}</td><td>{escape(r.reason)}{_measured(r)}</td></tr>"
        for r in records
    )
    head = "".join(f"<th>{name}</th>" for name in ("outcome", "claim", "section", "certainty", "what came of it"))
    return (
        f'<h2>All claims</h2><p id="outcomes">{boxes} <input type="search" id="search" placeholder="words"></p>'
        f'<div class="wide"><table id="claims"><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>'
    )


def _measured(record: VerdictRecord) -> str:
    text = ", ".join(f"{name} {value:.4g}" for name, value in record.measured.items())
    return f"<br><small>{escape(text)}</small>" if text else ""


def _table(head: Iterable[str], rows: Iterable[Sequence[str]], numbers_from: int = 99) -> str:
    top = "".join(f"<th>{name}</th>" for name in head)
    body = "".join(
        "<tr>" + "".join(f"<td{' class=n' if i >= numbers_from else ''}>{cell}</td>" for i, cell in enumerate(row)) + "</tr>"
        for row in rows
    )
    return f'<div class="wide"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'
