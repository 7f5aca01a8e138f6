"""Which quirks a claim may meet: those that drives of its dialect were seen to have.

    quirks=known(dialect, SETTLING)           ("settling",) on CAN, () elsewhere
    @claim(..., quirks=may_meet(SETTLING))    the same for a claim that is declared for all dialects

The quirks, with where each was seen, are declared with the emulated drives (`servotap emulate --list-quirks`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from analyzer.catalogue import Dialect
from conformance.claims.declare import Case
from conformance.drives.make import every_quirk

#: Quirks that claims of several modules may meet.
LATE, HASTY, NO_CHECKSUM, SETTLING = "slow-replies-in-motion", "hasty-writes-dropped", "no-checksum", "settling"


@cache
def _dialects() -> dict[str, tuple[str, ...]]:
    return {quirk.name: quirk.dialects for quirk in every_quirk()}


def known(dialect: Dialect, *names: str) -> tuple[str, ...]:
    """Return those of these quirks that drives of a dialect were seen to have. Raises KeyError for a name that is none."""
    return tuple(name for name in names if dialect.name in _dialects()[name])


def may_meet(*names: str) -> Callable[[Case], tuple[str, ...]]:
    """Return what tells the quirks of a case: those of these that drives of its dialect were seen to have."""
    return lambda case: known(case.dialect, *names)
