"""Whether the logs of a lake are whole: one that has lost its newest commits reads as one that ended before.

`captures` counts the batches of each table, and each table counts its own, as versions of transactions that no reader shows.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, Protocol

from analyzer.errors import UnreadableError

#: The table of all captures.
CAPTURES = "captures"
#: The counter of a table for itself.
BATCHES = "batches"


class Tables(Protocol):
    """What is asked of a lake. `checked`: tables whose logs were found to be whole."""

    checked: set[str]

    def open(self, table: str, /) -> Any: ...
    def seen(self, table: str, transaction: str, /) -> int | None: ...
    def exists(self, table: str, /) -> bool: ...
    def uri(self, table: str, /) -> str: ...
    def pending(self) -> Iterator[tuple[str, Any]]: ...


def of_table(name: str) -> str:
    """Return the counter that `captures` has of a table."""
    return f"{BATCHES} {name}"


def count(lake: Tables, table: str, counter: str) -> int:
    """Return how many batches a counter of a table has seen, as the table was when it was last opened."""
    return lake.seen(table, counter) or 0


def check(lake: Tables, tables: Iterable[str]) -> None:
    """Raise UnreadableError where a log has lost its newest commits: of some tables, or of `captures`.

    A table is looked at once.
    """
    new = set(tables) - lake.checked
    lake.open(CAPTURES)
    told = {each: count(lake, CAPTURES, of_table(each)) for each in new}
    # In this order: what others commit meanwhile is no loss.
    pending = [each for _, journal in lake.pending() for each in journal.files]
    there = [each for each in new if lake.exists(each) and lake.open(each)]
    has = dict.fromkeys(new, 0) | {each: count(lake, each, BATCHES) for each in there}
    lake.open(CAPTURES)
    for each in new:
        ahead = has[each] > count(lake, CAPTURES, of_table(each))
        if ahead or told[each] > has[each] + pending.count(each):
            raise UnreadableError(
                f"{lake.uri(CAPTURES if ahead else each)}: its log has lost its newest commits, and with them rows: "
                "restore it, or ingest into a new lake"
            )
    lake.checked |= new
