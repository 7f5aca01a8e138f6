"""Settings that a drive under test holds or may hold, which an ideal drive is given to see whether a claim refutes that too.

A user's drive rarely has its factory settings. A claim that refutes an ideal drive that is set as the one under test
says nothing about either.

Rules kept here:
- What the drive tells or the user told is known. A drive set so is refuted for its settings, whatever the claim says of it.
- What neither tells may be anything: one setting at a time differs, and what belongs together in a few rows.
- The address, the speed of the line and the dialect are known, for the drive answers.
- A run that is kept for power-on is no such setting: the rig has the drive forget it first.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

from analyzer import dialects as registry
from analyzer.catalogue import Verb, all_fields
from analyzer.layout import Field
from conformance.drives import make
from conformance.safety import settings
from conformance.talk.settings import changes_link

if TYPE_CHECKING:
    from analyzer.catalogue import Dialect
    from conformance.suite.rig import ClaimRig

#: What is kept for power-on: a way to a zero, and each way there.
TOGETHER: tuple[Mapping[str, int], ...] = tuple(
    {"zero_mode": mode, "zero_kept": 1, "zero_point": point, "zero_direction": direction}
    for mode, direction in ((1, 0), (1, 1), (2, 0))
    for point in (5000, 12000)
)


class Held(NamedTuple):
    """Settings of an ideal drive, as sent. `known`: the drive under test has them, for it or the user told so."""

    values: tuple[tuple[str, int], ...]
    known: bool

    def __str__(self) -> str:
        """Return them for people."""
        return ", ".join(f"{name} {value}" for name, value in self.values)


def every(rig: ClaimRig) -> Iterator[Held]:
    """Yield what the drive of a rig holds, where that differs from its defaults, and then what it may hold besides."""
    if rig.dialect.name not in make.KINDS:
        return
    usual = make.plain_drive(rig.dialect.name, rig.model).settings.held
    fields = names(rig.dialect)
    # A drive may tell what no drive can be set to: that is judged by claims, and no ideal drive has it.
    told = {n: v for n, v in rig.held.items() if n not in fields or fields[n].allows(v)}
    known = {n: v for n, v in told.items() if n in usual and usual[n] != v}
    if known:
        yield Held(tuple(known.items()), known=True)
    for each in _may_hold(rig.dialect, rig.untold, usual):
        yield Held(tuple({**known, **each}.items()), known=False)


def names(dialect: Dialect) -> dict[str, Field]:
    """Return what a drive of a dialect stores, by field, but for the settings of the link.

    What it was told in another dialect that it speaks too is stored as well.
    """
    found: dict[str, Field] = {}
    siblings = map(registry.get, dialect.siblings)
    for command in chain(
        dialect.commands,
        *(sibling.for_model(dialect.model).commands if dialect.model else sibling.commands for sibling in siblings),
    ):
        if settings.changes(command) and command.verb is not Verb.SAVE_SPEED and not changes_link(command):
            own = {name: field for name, field in all_fields(command.request_forms).items() if field.fixed is None}
            found = own | found
    return found


def unreadable(dialect: Dialect) -> frozenset[str]:
    """Return the settings that a drive of a dialect does not tell, by field."""
    told = {
        name
        for command in dialect.commands
        if settings.readable(dialect, command)
        for name in all_fields(command.request_forms)
    }
    return frozenset(names(dialect).keys() - told)


def _may_hold(dialect: Dialect, untold: frozenset[str], usual: Mapping[str, int]) -> Iterator[Mapping[str, int]]:
    for row in TOGETHER:
        if untold and row.keys() <= usual.keys() and not row.keys() & names(dialect).keys() - untold:
            yield row
    for name, field in names(dialect).items():
        if name in untold and name in usual:
            yield from ({name: value} for value in others(field) if value != usual[name])


def others(field: Field) -> tuple[int, ...]:
    """Return values that a stored setting may have: all choices, or the ends of a range and some between."""
    choices = tuple(field.choice_names or field.values or ())
    if choices:
        return choices
    low, high = field.low, field.high
    return tuple(dict.fromkeys((low, low + (high - low) // 7, low + (high - low) // 2, high)))
