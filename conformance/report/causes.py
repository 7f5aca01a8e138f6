"""Causes: refuted claims that say the same of a drive are one cause, with the claims that it took."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from analyzer import dialects
from conformance.suite.record import VerdictRecord

#: What a claim got from a drive that did not answer.
_SILENT = ("nothing", "silence")


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
