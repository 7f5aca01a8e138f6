"""Restoring: what a journal says was changed and not put back is put back."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import msgspec

from analyzer import dialects
from analyzer.catalogue import Dialect
from conformance.gate import Gate
from conformance.safety import journal as journals
from conformance.safety.bare import bare_probe
from conformance.safety.journal import Entry
from conformance.safety.keeper import put_back


def restore(path: Path, gate: Gate, known: Mapping[int, Dialect] | None = None) -> str:
    """Put back what is open in a journal and write into it what was; return what could not be, or nothing.

    `known`: dialects by address, for a model that the journal does not name. Raises UnreadableError, LineLost, Refused.
    """
    failed, done = [], []
    for entry in journals.open_changes(journals.read(path)):
        dialect = (known or {}).get(entry.address) or dialect_of(entry)
        probe = bare_probe(dialect, entry.address, gate, "restore")
        told = put_back(probe, probe.command(entry.command), entry.values)
        if told:
            failed.append(told)
        else:
            done.append(entry)
        probe.wait(500_000_000)
    _note(path, done, all_done=not failed)
    return "; ".join(failed)


def dialect_of(entry: Entry) -> Dialect:
    """Return the dialect that a journal's line names, for its model."""
    head, *parts = entry.target.split(",")
    found = dialects.get(head.partition("@")[0])
    model = next((p.removeprefix("model=") for p in parts if p.startswith("model=")), "")
    return found.for_model(model) if model else found


def _note(path: Path, done: list[Entry], *, all_done: bool) -> None:
    told = "restored from the journal"
    lines = [Entry(event="back", target=e.target, command=e.command, address=e.address, text=told) for e in done]
    lines += [Entry(event="end", text="all was put back")] * all_done
    with path.open("ab") as stream:
        stream.write(b"".join(msgspec.json.encode(line) + b"\n" for line in lines))
