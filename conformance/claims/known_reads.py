"""Reads that a drive of any model answers in every state."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from analyzer.catalogue import Command, Dialect, Risk, Verb
from conformance.talk import samples

#: Reads whose reply tells what is stored: motion does not change it.
_STORED = frozenset({Verb.READ_PARAMETER, Verb.READ_USER_ID, Verb.READ_VERSION})


def plain_reads(dialect: Dialect) -> list[Command]:
    """Return the reads of a dialect that need no data, in the manual's order."""
    reads = (c for c in dialect.commands if c.all_risks == {Risk.READ} and c.slots is None)
    fit = (c for c in reads if c.reply_forms and not c.request_forms[0].layout.fields)
    return [c for c in fit if dialect.model or not c.models]


def every_read(dialect: Dialect) -> Iterator[tuple[Command, dict[str, Any]]]:
    """Yield the reads of a dialect with their values: each stored parameter too, and the brake."""
    for command in plain_reads(dialect):
        yield command, {}
    read = dialect.by_verb.get(Verb.READ_PARAMETER)
    if read is not None:
        for value in sorted(read.request_forms[0].layout.named["parameter"].choice_names):
            yield read, {"parameter": value}
    if Verb.BRAKE in dialect.by_verb:
        yield dialect.by_verb[Verb.BRAKE], samples.sample(dialect, dialect.by_verb[Verb.BRAKE])


def is_stored(command: Command) -> bool:
    """Say whether a read tells what is stored, and nothing of the moment."""
    return command.verb in _STORED
