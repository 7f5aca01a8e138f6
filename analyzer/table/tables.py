"""Tables: recorded rows as columns and lines of values.

`Long`: a row a message, all fields side by side. `Wide`: a column for each field of each topic, the last value held; a row at
each change, or at a rate. What a wide table shows passed its checksum.

    /serial/1/read_speed/reply.speed    /serial/1/state.position          columns of a wide table: topic and field
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from fractions import Fraction
from typing import Any

from analyzer.catalogue import Dialect
from analyzer.errors import UsageError
from analyzer.layout import STATE_UNITS
from analyzer.table.columns import HEAD, TAIL, Column, Kind, merged, state_columns, suffix, told_apart, units_of_dialects
from analyzer.table.rows import Recorded, Row, Shape
from analyzer.values import SECOND_NS, counted, near, quote

#: A table at a rate has at most so many rows, and so many more for each message: one whose clock jumps by years has more.
MOST_TICKS, TICKS_PER_MESSAGE = 1_000_000, 200
_SEVERITIES = ("", "info", "warning", "error")
_LATENCY = TAIL[0]
#: What values of several forms become in one column.
_MADE: dict[Kind, Callable[[Any], Any]] = {Kind.TEXT: str, Kind.NUMBER: float}
#: Topic, field and unit: what a column of a wide table is told by.
_Key = tuple[str, str, str]


@dataclass
class Chosen:
    """What a user chose: patterns of topics and of fields; none: all.

    A pattern of topics is the whole topic where it begins with `/`, else any part of it: `read_*`, `1/*/reply`, `state`.
    """

    topics: Sequence[str] = ()
    fields: Sequence[str] = ()
    _used: set[str] = field(default_factory=set)

    def topic(self, topic: str) -> bool:
        whole = [(p, topic, p) if p.startswith("/") else (p, f"{topic}/", f"*/{p}/*") for p in self.topics]
        return self._any(whole)

    def column(self, column: Column) -> bool:
        return self._any([(p, text, p) for p in self.fields for text in (column.field, column.name)])

    def _any(self, tries: list[tuple[str, str, str]]) -> bool:
        found = [given for given, text, pattern in tries if fnmatchcase(text, pattern)]
        self._used.update(found)
        return bool(found) or not tries

    def check_possible(self, dialects: Iterable[Dialect]) -> None:
        """Raise UsageError for a field that no command of the dialects has, before anything is read."""
        units = units_of_dialects(dialects)
        names = {*units, *state_columns(), _LATENCY.field, *(n + suffix(u) for n, each in units.items() for u in each)}
        for pattern in self.fields:
            if not any(fnmatchcase(name, pattern) for name in names):
                raise UsageError(f"no command has a field {quote(pattern)}{near(pattern, names)}")

    def check(self, recorded: Recorded) -> None:
        """Raise UsageError for a pattern that chooses nothing, with the near words."""
        words = {word for shape in recorded.shapes for word in shape.topic.split("/") if word} | {"state"}
        names = {c.field for s in recorded.shapes for c in s.columns} | {
            quantity for s in recorded.shapes for quantity, _, _ in s.state
        }
        for kind, given, known in (("topic", self.topics, words), ("field", self.fields, names)):
            for pattern in given:
                if pattern not in self._used:
                    hint = near(pattern.split("/")[-1], known) or f", there are {_listed(known)}"
                    raise UsageError(f"no {kind} here is {quote(pattern)}{hint}")


def _listed(words: set[str]) -> str:
    ordered = sorted(words)
    return ", ".join(ordered[:12]) + (" ..." if len(ordered) > 12 else "") if ordered else "none"


class Table(ABC):
    """Columns and lines of values, made from recorded rows; it can be read several times."""

    def __init__(self, recorded: Recorded, chosen: Chosen) -> None:
        self.recorded = recorded
        self.chosen = chosen
        self.columns: tuple[Column, ...] = ()

    @abstractmethod
    def lines(self) -> Iterator[list[Any]]:
        """Yield the lines: a value for each column, None where there is none; times in nanoseconds."""

    def _elapsed(self, t_ns: int) -> float:
        return (t_ns - self.recorded.begin_ns) / SECOND_NS


class Long(Table):
    """A row a message, in the order of the capture. With fields chosen, only messages that have one of them."""

    def __init__(self, recorded: Recorded, chosen: Chosen) -> None:
        super().__init__(recorded, chosen)
        units = units_of_dialects(recorded.dialects)
        found: dict[tuple[str, str], list[Column]] = {}
        self._topics = [chosen.topic(shape.topic) for shape in recorded.shapes]
        for shape, wanted in zip(recorded.shapes, self._topics, strict=True):
            for column in recorded.columns_of(shape) if wanted else ():
                found.setdefault((column.field, column.unit), []).append(column)
        every = told_apart([merged(columns) for columns in found.values()], units)
        fields = [c for c in every if chosen.column(c)]
        self._by_latency = bool(chosen.fields) and chosen.column(_LATENCY)
        self.columns = (*HEAD, *fields, *TAIL)
        places = {(c.field, c.unit): (len(HEAD) + n, _MADE.get(c.kind)) for n, c in enumerate(fields)}
        #: Of each shape: for each of its values its place in a line, and what it becomes there.
        self._places = [
            [(n, *places[key]) for n, c in enumerate(shape.columns) if (key := (c.field, c.unit)) in places]
            for shape in recorded.shapes
        ]
        chosen.check(recorded)

    def lines(self) -> Iterator[list[Any]]:
        shapes, topics, every = self.recorded.shapes, self._topics, self._places
        width, some, by_latency = len(self.columns), bool(self.chosen.fields), self._by_latency
        tail = width - len(TAIL)
        for row in self.recorded.rows():
            if not topics[row.shape]:
                continue
            line: list[Any] = [None] * width
            empty = some
            for n, place, made in every[row.shape]:
                value = row.values[n]
                if value is not None:
                    line[place] = value if made is None else made(value)
                    empty = False
            if empty and not (by_latency and row.latency_ns is not None):
                continue
            self._fill(line, row, shapes[row.shape], tail)
            yield line

    def _fill(self, line: list[Any], row: Row, shape: Shape, tail: int) -> None:
        line[: len(HEAD)] = (
            row.t_ns,
            self._elapsed(row.t_ns),
            shape.bus or None,
            shape.dialect or None,
            row.address,
            shape.role,
            shape.command or None,
        )
        line[tail:] = (
            None if row.latency_ns is None else row.latency_ns / 1e6,
            row.checksum_ok,
            row.junk,
            _SEVERITIES[row.severity] or None,
            "; ".join(row.rules) or None,
            "; ".join(row.texts) or None,
            row.raw,
            row.offset,
            row.sequence,
            row.request_sequence,
        )


class Wide(Table):
    """A column for each field of each topic, and a row at each change; with a rate (in Hz) at even steps from the first value.

    Latencies are columns where they were chosen by name. Raises UsageError for a rate that gives more rows than can be meant.
    """

    def __init__(self, recorded: Recorded, chosen: Chosen, rate: Fraction | None = None) -> None:
        super().__init__(recorded, chosen)
        self._rate = rate
        found: dict[_Key, list[Column]] = {}
        for number, shape in enumerate(recorded.shapes):
            for topic, columns in self._fed(shape) if number in recorded.sound else ():
                if chosen.topic(topic):
                    for column in filter(chosen.column, columns):
                        found.setdefault((topic, column.field, column.unit), []).append(column)
        keys = sorted(found, key=_in_order)
        uses = Counter(key[:2] for key in keys)
        places = {key: len(HEAD[:2]) + n for n, key in enumerate(keys)}
        for key in keys:
            topic, name, unit = key
            # Drives of two dialects at one address may have one command in two units.
            end = suffix(unit) if unit and uses[key[:2]] > 1 else ""
            self.columns += (replace(merged(found[key]), name=f"{topic}.{name}{end}"),)
        made = {key: _MADE.get(column.kind) for key, column in zip(keys, self.columns, strict=True)}
        self.columns = (*HEAD[:2], *self.columns)
        self._places = [
            [(n, places[key], made[key]) for n, c in enumerate(s.columns) if (key := (s.topic, c.field, c.unit)) in places]
            for s in recorded.shapes
        ]
        self._latencies = [places.get((s.topic, _LATENCY.field, _LATENCY.unit)) for s in recorded.shapes]
        self._states = [
            [
                (n, factor, place)
                for quantity, n, factor in s.state
                if (place := places.get((_state_topic(s), quantity, STATE_UNITS[quantity]))) is not None
            ]
            for s in recorded.shapes
        ]
        chosen.check(recorded)
        span_ns = recorded.last_ns - recorded.begin_ns
        most = MOST_TICKS + TICKS_PER_MESSAGE * recorded.count
        ticks = 0 if rate is None else int(span_ns * rate / SECOND_NS)
        if ticks > most:
            raise UsageError(
                f"{ticks} rows in {span_ns / SECOND_NS:.0f} s, expected {most} at most for "
                f"{counted(recorded.count, 'message')}; choose a lower rate, or a time range (--since, --until)"
            )

    def _fed(self, shape: Shape) -> Iterator[tuple[str, Iterable[Column]]]:
        """Yield the topics that rows of a shape feed, and the columns there."""
        yield shape.topic, self.recorded.columns_of(shape)
        if shape.state:
            quantities = state_columns()
            yield _state_topic(shape), [quantities[name] for name in dict.fromkeys(q for q, _, _ in shape.state)]
        if shape.role == "reply" and self.chosen.fields:
            yield shape.topic, [_LATENCY]

    def lines(self) -> Iterator[list[Any]]:
        """Yield a line at each change, or at each step."""
        return self._changes() if self._rate is None else self._steps(self._rate)

    def _changes(self) -> Iterator[list[Any]]:
        line: list[Any] = [None] * len(self.columns)
        before: list[Any] | None = None
        for t_ns, row in self._values():
            # What comes at one time is one line.
            if before is not None and t_ns != line[0]:
                if line[2:] != before:
                    yield line.copy()
                before = line[2:]
            elif before is None:
                before = line[2:]
            line[0], line[1] = t_ns, self._elapsed(t_ns)
            self._take(line, row)
        if before is not None and line[2:] != before:
            yield line

    def _steps(self, rate: Fraction) -> Iterator[list[Any]]:
        begin_ns, step = self.recorded.begin_ns, 0
        line: list[Any] = [None] * len(self.columns)
        at_ns: int | None = None
        for t_ns, row in self._values():
            if at_ns is None:
                # The first step is the first value that is shown.
                begin_ns = at_ns = t_ns
            while at_ns < t_ns:
                line[0], line[1] = at_ns, self._elapsed(at_ns)
                yield line.copy()
                step += 1
                at_ns = begin_ns + int(step * SECOND_NS / rate)
            self._take(line, row)
        while at_ns is not None:
            line[0], line[1] = at_ns, self._elapsed(at_ns)
            yield line.copy()
            # The values hold to the end of the capture.
            if at_ns >= self.recorded.last_ns:
                return
            step += 1
            at_ns = begin_ns + int(step * SECOND_NS / rate)

    def points(self, names: Iterable[str]) -> dict[str, tuple[list[float], list[Any]]]:
        """Return by column when its values came, in seconds from the first message, and what they were."""
        places = {column.name: place for place, column in enumerate(self.columns)}
        found: dict[str, tuple[list[float], list[Any]]] = {name: ([], []) for name in names}
        wanted = [(places[name], *lists) for name, lists in found.items()]
        for t_ns, row in self._values():
            line: list[Any] = [None] * len(self.columns)
            self._take(line, row)
            for place, times, values in wanted:
                if line[place] is not None:
                    times.append(self._elapsed(t_ns))
                    values.append(line[place])
        return found

    def _values(self) -> Iterator[tuple[int, Row]]:
        """Yield the rows that change a column, with times that do not decrease."""
        last_ns = self.recorded.begin_ns
        for row in self.recorded.rows():
            feeds = self._places[row.shape] or self._states[row.shape] or self._latencies[row.shape] is not None
            if feeds and row.checksum_ok:
                last_ns = max(last_ns, row.t_ns)
                yield last_ns, row

    def _take(self, line: list[Any], row: Row) -> None:
        values = row.values
        for n, place, made in self._places[row.shape]:
            if values[n] is not None:
                line[place] = values[n] if made is None else made(values[n])
        parts = self._states[row.shape]
        if parts:
            fresh: dict[int, float] = {}
            for n, factor, place in parts:
                fresh[place] = fresh.get(place, 0.0) + values[n] * factor
            for place, total in fresh.items():
                line[place] = total
        latency = self._latencies[row.shape]
        if latency is not None and row.latency_ns is not None:
            line[latency] = row.latency_ns / 1e6


def _state_topic(shape: Shape) -> str:
    """Return the topic of the derived state of the drive that a shape is of."""
    return "/".join(shape.topic.split("/")[:3]) + "/state"


def _in_order(key: _Key) -> tuple[str, int, str, str, str, str]:
    """Order columns by bus, by address as a number, then by what they show, the state first."""
    _, bus, who, *rest = f"{key[0]}//".split("/")
    shows = "" if rest[0] == "state" else "/".join(rest)
    return bus, int(who) if who.isdecimal() else -1, who, shows, key[1], key[2]


#: Endings of a rate -> how many Hz one is; of a step how many there are in a second.
_RATES = {"khz": 1000, "hz": 1}
_STEPS = {"ms": 1000, "us": 1_000_000, "s": 1}


def parse_rate(text: str) -> Fraction:
    """Return a rate in Hz of `100Hz`, `2.5 kHz`, `100` or a step as `10ms`. Raises UsageError for any other text."""
    found = re.fullmatch(r"(\d{1,9}(?:\.\d{1,9})?)(hz|khz|ms|us|s)?", text.strip().lower().replace(" ", ""))
    number = Fraction(found[1]) if found is not None else Fraction(0)
    if found is None or not number:
        raise UsageError(f"{quote(text)} is not a rate, expected 100Hz, 0.5Hz, or a step as 10ms")
    unit = found[2] or "hz"
    return _STEPS[unit] / number if unit in _STEPS else number * _RATES[unit]
