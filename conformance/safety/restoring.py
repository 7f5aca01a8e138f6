"""Restoring: what a journal says was changed and not put back is put back."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby
from pathlib import Path

from analyzer import dialects
from analyzer.catalogue import Dialect
from conformance.gate.gate import Gate
from conformance.safety import journal as journals
from conformance.safety.journal import Entry, Journal
from conformance.safety.keeper import Keeper


def restore(path: Path, gate: Gate, known: Mapping[int, Dialect] | None = None, *, link_only: bool = False) -> str:
    """Put back what is open in a journal and write into it what was; return what could not be, or nothing.

    `known`: dialects by address, for a model that the journal does not name. `link_only`: only where the drive is reached.
    Raises UnreadableError, LineLost, Refused.
    """
    changes = journals.open_changes(journals.read(path))
    if not changes:
        return ""
    failed = []
    journal = Journal(path, again=True)
    try:
        for (_, address), entries in groupby(sorted(changes, key=_drive), key=_drive):
            own = list(entries)
            dialect = (known or {}).get(address) or dialect_of(own[0])
            keeper = Keeper(gate, dialect, address, {}, journal, named=own[0].target)
            keeper.take(own)
            told = keeper.put_back(link_only=link_only)
            if told:
                failed.append(told)
        if not failed and not link_only:
            journal.write(Entry(event="end", text="all was put back from the journal"))
    finally:
        journal.close(remove=False)
    return "; ".join(failed)


def _drive(entry: Entry) -> tuple[str, int]:
    return entry.target, entry.address


def moved_away(path: Path) -> bool:
    """Say whether a journal's drives may answer elsewhere than they did. Raises UnreadableError."""
    return any(entry.sent and entry.command in LINKS for entry in journals.open_changes(journals.read(path)))


#: Commands that change how a drive is reached.
LINKS = frozenset({"set_address", "set_baud_rate", "set_bit_rate", "set_modbus"})


def dialect_of(entry: Entry) -> Dialect:
    """Return the dialect that a journal's line names, for its model."""
    head, *parts = entry.target.split(",")
    found = dialects.get(head.partition("@")[0])
    model = next((p.removeprefix("model=") for p in parts if p.startswith("model=")), "")
    return found.for_model(model) if model else found
