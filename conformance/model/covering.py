"""Covering arrays: few rows in which any two levels of two factors that are allowed together meet at least once.

    rows({"mode": (0, 1, 2), "way": (1, -1), "speed": (10, 3000)}, lambda mode, speed: mode or speed < 400)
        ({"mode": 0, "way": 1, "speed": 10}, {"mode": 1, "way": -1, "speed": 3000}, ...)

A bug that needs two conditions at once shows in one of the rows. What needs three is asked for by `together`.

Rules kept here:
- A rule names the factors that it is about by its parameters, and says whether their levels are allowed together.
- Every row keeps all rules. A pair that no whole row can have is left out.
- The same factors and rules make the same rows. Of levels that serve as well the first one is taken: the cheapest first.
- Where the cost of a row is told, rows that the others make needless go, and what only fills a row becomes the cheapest.
"""

from __future__ import annotations

import inspect
from collections import Counter, defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from itertools import combinations, product
from typing import Any, TypeVar

One = TypeVar("One", bound=Hashable)
Row = dict[str, Any]
Rule = Callable[..., object]
#: A factor and the place of one of its levels.
_Level = tuple[str, int]
#: The levels that have yet to meet, by each factor: the place of its level, and the other levels.
_Missing = dict[str, list[tuple[int, frozenset[_Level]]]]


def rows(
    factors: Mapping[str, Sequence[Any]],
    *rules: Rule,
    together: Iterable[Sequence[str]] = (),
    strength: int = 2,
    cost: Callable[..., float] | None = None,
) -> tuple[Row, ...]:
    """Return rows with a level of each factor, so that all that is allowed together meets.

    `together`: groups of factors all of whose levels meet, beside any `strength` factors. `cost`: of a row, by its levels.
    """
    table = _Table(factors, rules)
    groups = {*combinations(factors, min(strength, len(factors))), *map(tuple, together)}
    found = table.rows(groups)
    return tuple(map(table.named, found if cost is None else table.cheaper(found, groups, cost)))


def _by_factor(missing: Iterable[frozenset[_Level]]) -> _Missing:
    found: _Missing = defaultdict(list)
    for met in missing:
        for level in met:
            found[level[0]].append((level[1], met - {level}))
    return found


class _Table:
    def __init__(self, factors: Mapping[str, Sequence[Any]], rules: Iterable[Rule]) -> None:
        self._factors = factors
        self._places = {name: place for place, name in enumerate(factors)}
        self._rules = [(frozenset(inspect.signature(rule).parameters), rule) for rule in rules]
        for names, rule in self._rules:
            if not names <= factors.keys():
                raise ValueError(
                    f"a rule about {', '.join(sorted(names - factors.keys()))}, expected {', '.join(factors)}: {rule}"
                )

    def named(self, row: Mapping[str, int]) -> Row:
        """Return a row with its levels in place of where they stand."""
        return {name: levels[row[name]] for name, levels in self._factors.items()}

    def rows(self, groups: Iterable[Sequence[str]]) -> list[dict[str, int]]:
        # Those that more factors meet in come first: their rows have most of the others.
        ordered = sorted(groups, key=lambda group: (-len(group), [self._places[name] for name in group]))
        missing = dict.fromkeys(
            frozenset(zip(group, places, strict=True))
            for group in ordered
            for places in product(*(range(len(self._factors[name])) for name in group))
        )
        found = []
        while missing:
            wanted = next(iter(missing))
            row = self._filled(dict(wanted), _by_factor(missing)) if self._kept(dict(wanted)) else None
            if row is None:
                del missing[wanted]
                continue
            levels = frozenset(row.items())
            missing = dict.fromkeys(met for met in missing if not met <= levels)
            found.append(row)
        return found

    def cheaper(
        self, found: Iterable[dict[str, int]], groups: Iterable[Sequence[str]], cost: Callable[..., float]
    ) -> list[dict[str, int]]:
        """Return rows in which all meets that met in those found, the dearest looked at first."""
        every = [tuple(group) for group in groups]

        def meetings(row: Mapping[str, int]) -> list[tuple[tuple[str, ...], tuple[int, ...]]]:
            return [(group, tuple(row[name] for name in group)) for group in every]

        kept = list(found)
        met = Counter(meeting for row in kept for meeting in meetings(row))
        for row in sorted(found, key=lambda row: -cost(**self.named(row))):
            met.subtract(meetings(row))
            # What meets in this row alone stays.
            own = {
                name: place
                for group, places in meetings(row)
                if not met[group, places]
                for name, place in zip(group, places, strict=True)
            }
            place = kept.index(row)
            if not own:
                del kept[place]
                continue
            kept[place] = min((row, *self._whole(own)), key=lambda other: cost(**self.named(other)))
            met.update(meetings(kept[place]))
        return kept

    def _whole(self, row: dict[str, int]) -> Iterator[dict[str, int]]:
        """Yield all whole rows with these levels that keep the rules."""
        name = next((name for name in self._factors if name not in row), None)
        if name is None:
            yield row
            return
        for place in range(len(self._factors[name])):
            if self._kept(tried := {**row, name: place}, name):
                yield from self._whole(tried)

    def _filled(self, row: dict[str, int], missing: _Missing) -> dict[str, int] | None:
        """Return a whole row that keeps all rules and has most of what is missing, None where there is none."""
        name = next((name for name in self._factors if name not in row), None)
        if name is None:
            return row
        levels = frozenset(row.items())
        # What can still meet in this row: each level of a factor counts by what it would add.
        gains = [0] * len(self._factors[name])
        for place, others in missing[name]:
            gains[place] += others <= levels
        for place in sorted(range(len(gains)), key=lambda place: -gains[place]):
            tried = {**row, name: place}
            if self._kept(tried, name) and (whole := self._filled(tried, missing)) is not None:
                return whole
        return None

    def _kept(self, row: Mapping[str, int], newest: str = "") -> bool:
        """Say whether a row, or a part of one, keeps the rules; with `newest` those that are about this factor."""
        return all(
            rule(**{name: self._factors[name][row[name]] for name in names})
            for names, rule in self._rules
            if names <= row.keys() and (not newest or newest in names)
        )


def few(every: Iterable[One], shows: Callable[[One], set[Any]], cost: Callable[[One], float]) -> tuple[One, ...]:
    """Return some of these, in their order, that show all that any of them shows: first what adds most for its cost."""
    known = {row: (shows(row), cost(row)) for row in every}
    missing: set[Any] = set().union(*(shown for shown, _ in known.values()))
    found = set()
    while missing:
        best = max(known, key=lambda row: len(known[row][0] & missing) / known[row][1])
        found.add(best)
        missing -= known[best][0]
    return tuple(row for row in known if row in found)
