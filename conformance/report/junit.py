"""Verdicts as JUnit XML, for CI: a suite a drive, a case a claim, with claim id, certainty and section as properties."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

from analyzer.cli.output import write_whole
from conformance.claim import Outcome
from conformance.suite.record import RunRecord, VerdictRecord, firmware_of

_SKIPPED = (Outcome.INCONCLUSIVE, Outcome.NOT_RUN)


def write_junit(path: Path, records: Sequence[VerdictRecord], run: RunRecord) -> None:
    """Write the file. Raises UsageError where it cannot be written."""
    root = ElementTree.Element("testsuites", name="servotap", time=f"{run.seconds:.3f}")
    for target in dict.fromkeys(r.target for r in records):
        own = [r for r in records if r.target == target]
        suite = ElementTree.SubElement(
            root,
            "testsuite",
            name=target,
            timestamp=run.started_at.rstrip("Z"),
            tests=str(len(own)),
            failures=str(sum(r.refuted for r in own)),
            errors="0",
            skipped=str(sum(r.outcome in _SKIPPED for r in own)),
        )
        about = {"seed": str(run.seed), "version": run.version, "allowed": ",".join(run.allowed)}
        about |= {f"bound {name}": value for name, value in run.bounds.items()}
        firmware = firmware_of(own).get(target)
        if firmware:
            about["firmware"] = firmware
        _properties(suite, about)
        for record in own:
            _case(suite, record)
    tree = ElementTree.ElementTree(root)
    ElementTree.indent(tree)
    write_whole(path, ElementTree.tostring(root, encoding="utf-8", xml_declaration=True))


def _case(suite: ElementTree.Element, record: VerdictRecord) -> None:
    seconds = max(0, record.last_ns - record.first_ns) / 1e9
    name = f"{record.dialect}.{record.theme}"
    case = ElementTree.SubElement(suite, "testcase", classname=name, name=record.id, time=f"{seconds:.3f}")
    about = {"claim": record.id, "certainty": record.certainty, "section": record.section, "outcome": record.outcome}
    _properties(case, about | {f"measured {n}": f"{v:.9g}" for n, v in record.measured.items()})
    if record.refuted:
        failure = ElementTree.SubElement(case, "failure", message=_clean(record.reason), type="refuted")
        failure.text = _clean(
            "\n".join([record.statement, f"expected: {record.expected}", f"got: {record.got}", *record.lines])
        )
    elif record.outcome in _SKIPPED:
        ElementTree.SubElement(case, "skipped", message=_clean(f"{record.outcome}: {record.reason}"))
    elif record.reason:
        ElementTree.SubElement(case, "system-out").text = _clean(record.reason)


def _properties(parent: ElementTree.Element, values: dict[str, str]) -> None:
    properties = ElementTree.SubElement(parent, "properties")
    for name, value in values.items():
        ElementTree.SubElement(properties, "property", name=name, value=_clean(value))


def _clean(text: str) -> str:
    """Return a text without what XML cannot hold."""
    return "".join(c if c in "\n\t" or c.isprintable() else "?" for c in text)
