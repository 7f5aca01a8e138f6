"""A baseline: known and accepted deviations of a drive, so that only new deviations fail a run.

A JSON file with one object for each deviation: the claim's id, its parameters, and the key of the refutation. A claim refuted
with another key is new. A claim that holds now is reported as fixed. A claim that no longer runs fails: an untested
deviation is not accepted.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from analyzer.cli.output import write_whole
from analyzer.errors import UnreadableError
from analyzer.system.decoding import UNDECODABLE
from analyzer.system.whole_file import read_whole
from conformance.claim import Outcome
from conformance.suite.record import RunRecord, VerdictRecord


class Deviation(msgspec.Struct, frozen=True, kw_only=True):
    """A known deviation. `got`: what the drive did, as the verdict said it."""

    claim: str
    target: str
    parameters: dict[str, Any] = {}
    key: str = ""
    got: str = ""

    def matches(self, record: VerdictRecord) -> bool:
        """Say whether a refuted claim is this deviation again."""
        return self.concerns(record) and (self.key, self.got) == (record.key, record.got)

    def concerns(self, record: VerdictRecord) -> bool:
        """Say whether a verdict is about the same claim and drive."""
        return (self.claim, self.target, self.parameters) == (record.id, _drive(record.target), record.parameters)


class Compared(msgspec.Struct, frozen=True):
    """A run beside its baseline: deviations that are new, known, fixed, and no longer looked at."""

    new: tuple[VerdictRecord, ...]
    known: tuple[VerdictRecord, ...]
    fixed: tuple[Deviation, ...]
    missing: tuple[Deviation, ...]

    @property
    def fails(self) -> bool:
        return bool(self.new or self.missing)


def _drive(target: str) -> str:
    """Return a target without faults and the like: DIALECT@ADDRESS and its model."""
    head, *parts = target.split(",")
    return ",".join([head, *(part for part in parts if part.startswith("model="))])


def load(path: Path) -> list[Deviation]:
    """Return the deviations of a file. Raises UnreadableError that says what was expected."""
    try:
        return msgspec.json.decode(read_whole(path), type=list[Deviation])
    except UNDECODABLE as error:
        raise UnreadableError(f"{path}: expected a list of deviations as --write-baseline writes it, got: {error}") from None


def save(path: Path, records: Iterable[VerdictRecord], run: RunRecord | None = None) -> None:
    """Write what is refuted as the new baseline. Raises UsageError where it cannot be written."""
    deviations = [
        Deviation(claim=r.id, target=_drive(r.target), parameters=r.parameters, key=r.key, got=r.got)
        for r in records
        if r.refuted
    ]
    write_whole(path, msgspec.json.format(msgspec.json.encode(deviations), indent=1) + b"\n")


def compare(records: Sequence[VerdictRecord], deviations: Sequence[Deviation]) -> Compared:
    """Return a run beside its baseline."""
    new: list[VerdictRecord] = []
    known: list[VerdictRecord] = []
    for record in records:
        if record.refuted:
            (known if any(d.matches(record) for d in deviations) else new).append(record)
    judged = (Outcome.CONFIRMED, Outcome.OBSERVED)
    fixed: list[Deviation] = []
    missing: list[Deviation] = []
    for deviation in deviations:
        found = next((r for r in records if deviation.concerns(r)), None)
        if found is None or found.outcome in (Outcome.NOT_RUN, Outcome.INCONCLUSIVE):
            missing.append(deviation)
        elif found.outcome in judged:
            fixed.append(deviation)
    return Compared(tuple(new), tuple(known), tuple(fixed), tuple(missing))
