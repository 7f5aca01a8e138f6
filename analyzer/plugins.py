"""What other packages add by entry points: dialects, claims, commands.

One that fails is named on standard error and left out: a recording does not end because some package is broken.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from importlib.metadata import EntryPoint, entry_points
from typing import Any, TypeVar

from analyzer.values import printable

T = TypeVar("T")


def points(group: str) -> list[EntryPoint]:
    """Return the entry points of a group."""
    return list(entry_points(group=group))


def attempt(what: str, call: Callable[[], T]) -> T | None:
    """Return what a call into another package returns; None where it fails, which is said."""
    try:
        return call()
    # A module that is imported can do anything, and end the program, too.
    except (Exception, SystemExit) as error:
        why = printable(f"{type(error).__name__}: {error}")
        print(f"servotap: {printable(what)} failed and is left out: {why}", file=sys.stderr)
        return None


def loaded(group: str) -> Iterator[tuple[str, Any]]:
    """Yield what the entry points of a group name, by their names, without those that cannot be loaded."""
    for point in points(group):
        found = attempt(f"{point.name} ({point.value}) of {group}", point.load)
        if found is not None:
            yield point.name, found
