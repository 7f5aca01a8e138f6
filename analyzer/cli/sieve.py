"""A filter over the plain frames of a block: which rows it wants. `Filter` itself says so, asked as seldom as can be.

    rows of a lane -> what all of them share decides? -> else the columns that the filter names, row by row

Only rows that are wanted become messages.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from analyzer.cli.filter import OWN, Filter, bytes_text
from analyzer.columns.codec import Integers, column
from analyzer.columns.groups import groups, taken
from analyzer.columns.plain import Plain
from analyzer.columns.rows import physical_column
from analyzer.entries import Entry
from analyzer.layout import Field
from analyzer.records import Lane

_SECOND, _MS = 1e9, 1e6
#: Plain frames have no findings.
_OWN = OWN - {"findings"}


class Run:
    """Plain exchanges in some rows of a block. `start`: the first, whose message has the number `sequence`."""

    def __init__(self, plain: Plain, start: int, stop: int, sequence: int) -> None:
        self.plain, self.start, self.stop = plain, start, stop
        #: What has to be added to a row's number to have that of its message.
        self.number = sequence - start

    def entry(self, row: int) -> Entry:
        plain, sequence = self.plain, self.number + row
        lane = plain.lanes[plain.lane[row]]
        latency_ns = int(plain.latencies[row])
        asked_by = None if lane.is_request else sequence - int(plain.behind[row])
        message = lane.message(plain.frame(row))
        return Entry(message, sequence, lane.topic, (), latency_ns if latency_ns > 0 else None, asked_by, not lane.is_request)


class Sieve:
    """Finds the rows that a filter wants. `names_of`: what the filter can name of a message."""

    def __init__(self, wanted: Filter, names_of: Callable[[Entry], Mapping[str, Any]]) -> None:
        self._wanted = wanted
        self._names_of = names_of
        #: Of each lane: the answer for all its messages; or the names that they share, and what else has to be looked at.
        self._lanes: dict[Lane, bool | tuple[dict[str, Any], dict[str, Field | None]]] = {}

    def rows(self, run: Run) -> list[int]:
        """Return the rows of a run that are wanted, rising."""
        chosen: list[Integers] = []
        for number, rows in groups(run.plain.lane[run.start : run.stop] + 1):
            lane, rows = run.plain.lanes[number - 1], rows + run.start
            known = self._lanes.get(lane)
            if known is None:
                known = self._lanes[lane] = self._of_lane(lane, run.entry(int(rows[0])))
            if known is not False:
                chosen.append(rows if known is True else rows[self._tried(run, lane, rows, *known)])
        return np.sort(np.concatenate(chosen)).tolist() if chosen else []

    def _of_lane(self, lane: Lane, first: Entry) -> bool | tuple[dict[str, Any], dict[str, Field | None]]:
        fields = lane.form.layout.named
        differing: dict[str, Field | None] = dict.fromkeys(_OWN)
        for name, field in fields.items():
            differing |= {name: field, f"{name}_name": field}
        names = self._names_of(first)
        answer = self._wanted.settled(names, differing)
        if answer is not None:
            return answer
        shared = {name: value for name, value in names.items() if name in self._wanted.used and name not in differing}
        return shared, {name: field for name, field in differing.items() if name in self._wanted.used}

    def _tried(
        self, run: Run, lane: Lane, rows: Integers, shared: dict[str, Any], looked_at: dict[str, Field | None]
    ) -> list[bool]:
        """Say of each row of a lane whether it is wanted."""
        columns = [
            _MADE[name](run, rows) if field is None else _values(run, lane, rows, name, field)
            for name, field in looked_at.items()
        ]
        wanted, keys = self._wanted, tuple(looked_at)
        return [
            wanted(shared | {key: value for key, value in zip(keys, values, strict=True) if value is not None})
            for values in zip(*columns, strict=True)
        ]


def _values(run: Run, lane: Lane, rows: Integers, name: str, field: Field) -> list[Any]:
    """Return a field of each row in its unit, or the name of its choice; None where it has none."""
    offset = next(offset for offset, each in lane.form.layout if each is field)
    wire = column(taken(run.plain.block.data, rows), 8 * lane.start + offset, field)
    if name == field.name:
        shown: list[Any] = physical_column(wire, field).tolist()
        return shown
    return [field.choice_names.get(value) for value in wire.tolist()]


#: What differs from message to message, besides fields: of each row; None where it has none.
_MADE: dict[str, Callable[[Run, Integers], list[Any]]] = {
    "time": lambda run, rows: (run.plain.block.t_ns[rows] / _SECOND).tolist(),
    "raw": lambda run, rows: [bytes_text(run.plain.frame(row)) for row in rows.tolist()],
    "offset": lambda run, rows: run.plain.offsets[rows].tolist(),
    "sequence": lambda run, rows: (run.number + rows).tolist(),
    "latency": lambda run, rows: [ns / _MS if ns > 0 else None for ns in run.plain.latencies[rows].tolist()],
}
