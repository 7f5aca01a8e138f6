"""How the machines of a fleet are, and what got worse: a page over a lake.

Each drive has quantities by day: the shares of its requests that had no reply, failed or came damaged; the latency of replies;
temperature and current. Each machine has the share of its bytes that was junk. The last days are compared with the weeks
before by the median and the median absolute deviation, so one bad day changes neither side. A share of requests is reported
only if ten more requests were affected: one of sixty is 1.7 %, and proves nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import quote

import numpy as np

from analyzer.errors import UnreadableError
from analyzer.fleet.ask import Question
from analyzer.page import Chart, render

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: Days that count as now, and days before them that they are compared with.
RECENT, BEFORE = 7, 28
#: Days with values that a comparison needs, now and before.
_LEAST_NOW, _LEAST_BEFORE = 2, 5
#: A change is told from so many deviations on; a deviation of a normal distribution is 1.4826 median absolute ones.
DEVIATIONS, _NORMAL = 4.0, 1.4826
#: How many more requests than before must be affected, in the last days together.
EVENTS = 10
#: Changes, drives, captures and lines that are shown.
SHOWN, _LINES = 100, 8
_DAY = 86_400.0


class Quantity(NamedTuple):
    """What is watched. `query`: rows of machine, bus, address, date, value, count; `least`: the smallest change that matters.

    `factor`: by how much it must change besides; `table`: what it needs.
    """

    name: str
    unit: str
    table: str
    query: str
    least: float
    factor: float


def _share(outcome: str) -> str:
    return f"""select machine, bus, address, date, 100.0 * count(*) filter (outcome = '{outcome}') / count(*) as value,
        count(*) as count
        from transactions group by all having count(*) >= 10"""


def _of_latency(share: float) -> str:
    return f"""select machine, bus, address, date, quantile_cont(latency, {share}) * 1000 as value, count(*) as count
        from transactions where latency is not null group by all having count(*) >= 10"""


def _of_state(name: str) -> str:
    return f"""select machine, bus, address, date, quantile_cont(abs({name}), 0.95) as value, count(*) as count
        from states where {name} is not null group by all having count(*) >= 3"""


QUANTITIES = (
    Quantity("unanswered", "%", "transactions", _share("unanswered"), 0.1, 1.5),
    Quantity("failed", "%", "transactions", _share("failed"), 0.1, 1.5),
    Quantity("damaged replies", "%", "transactions", _share("damaged"), 0.05, 1.5),
    Quantity("latency, median", "ms", "transactions", _of_latency(0.5), 0.2, 1.2),
    Quantity("latency, 99 %", "ms", "transactions", _of_latency(0.99), 0.5, 1.3),
    Quantity("temperature, 95 %", "°C", "states", _of_state("temperature"), 5.0, 1.05),
    Quantity("current, 95 %", "A", "states", _of_state("current"), 0.05, 1.2),
    Quantity(
        "junk", "‰ of bytes", "captures",
        """select machine, null as bus, null as address, date, sum(frame_bytes + junk_bytes) as count,
        1000.0 * sum(junk_bytes) / count as value from captures where frame_bytes + junk_bytes > 0 group by all""", 0.5, 1.5,
    ),
)  # fmt: skip


class Who(NamedTuple):
    """A drive, or with no bus a whole machine."""

    machine: str
    bus: str
    address: int | None

    @property
    def drive(self) -> str:
        """The drive on its machine."""
        return "" if self.address is None else f"{self.bus} {self.address}"

    def __str__(self) -> str:
        return " ".join(part for part in (self.machine or "(no machine)", self.drive) if part)


class History(NamedTuple):
    """A quantity by day. `days`: since 1970; `values`; `counts`: of what each value is made."""

    days: NDArray[np.float64]
    values: NDArray[np.float64]
    counts: NDArray[np.float64]

    def within(self, after: float, until: float) -> History:
        """Return the days after one and until another."""
        chosen = (self.days > after) & (self.days <= until)
        return History(*(column[chosen] for column in self))

    def line(self, first: int, last: int, wide: float, high: float) -> str:
        """Return the points of a line in a box, as SVG has them. The box begins at 0."""
        top = max(float(self.values.max()), 1e-9)
        x, y = (self.days - first) / (last - first) * wide, high - self.values / top * high
        return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))


@dataclass(frozen=True)
class Change:
    """A quantity that changed. `before`, `now`: medians; `spread`: the median absolute deviation before.

    `days`: with values, before and now; `deviations`: how far off, up is worse; `history`: of all these days.
    """

    who: Who
    quantity: Quantity
    before: float
    spread: float
    now: float
    days: tuple[int, int]
    deviations: float
    history: History

    @property
    def worse(self) -> bool:
        """Whether it went up: all that is watched is better when it is less."""
        return self.now > self.before


@dataclass
class Health:
    """What a page shows. `values`: quantity -> drive -> its history; `last`: the last day.

    `silent`: machines without a capture in the last days, with the day of their last one.
    """

    place: str
    last: date
    totals: Mapping[str, Any]
    values: dict[str, dict[Who, History]] = field(default_factory=dict)
    changes: list[Change] = field(default_factory=list)
    captures: Sequence[Mapping[str, Any]] = ()
    silent: Sequence[Mapping[str, Any]] = ()

    def worse(self) -> list[str]:
        """Return the machines of which something got worse, the worst first."""
        return list(dict.fromkeys(each.who.machine or "(no machine)" for each in self.changes if each.worse))

    def days(self) -> tuple[float, float]:
        """Return the first and the last day with values, in days since 1970."""
        every = [history.days for each in self.values.values() for history in each.values()]
        return (min(map(np.min, every)), max(map(np.max, every))) if every else (0.0, 0.0)

    def drives(self) -> list[tuple[Who, list[tuple[str, bool]]]]:
        """Return the drives with the medians of their last days, and whether each got worse; the most trouble first.

        The share of junk is that of the machine.
        """
        worse = {(each.who, each.quantity.name) for each in self.changes if each.worse}
        every = {who for each in self.values.values() for who in each}
        with_drives = {who.machine for who in every if who.drive}
        rows = []
        for who in sorted(every, key=str):
            if not who.drive and who.machine in with_drives:
                continue
            cells, trouble = [], 0.0
            for quantity in QUANTITIES:
                of = who if who in self.values.get(quantity.name, {}) else Who(who.machine, "", None)
                history = self.values.get(quantity.name, {}).get(of)
                recent = None if history is None else history.within(_days(self.last) - RECENT, _days(self.last))
                now = None if recent is None or not len(recent.days) else float(np.median(recent.values))
                cells.append(("" if now is None else shown(now), (of, quantity.name) in worse))
                if quantity.unit == "%":
                    trouble += now or 0.0
            rows.append((sum(bad for _, bad in cells), trouble, who, cells))
        return [(who, cells) for _, _, who, cells in sorted(rows, key=lambda row: (-row[0], -row[1]))]

    def chart(self, quantity: Quantity) -> Chart | None:
        """Return a quantity over the days, for the drives with the greatest values; None where all are 0."""
        every = {who: each for who, each in self.values.get(quantity.name, {}).items() if each.values.any()}
        chosen = sorted(every, key=lambda who: -float(every[who].values.max()))[:_LINES]
        if not chosen:
            return None
        x = np.unique(np.concatenate([every[who].days for who in chosen]))
        lines = {}
        for who in chosen:
            column = np.full(len(x), np.nan)
            column[np.searchsorted(x, every[who].days)] = every[who].values
            lines[str(who)] = column
        return Chart(x * _DAY, lines, quantity.name, quantity.unit, "clock", group="fleet")


def shown(value: float) -> str:
    """Return a value with three digits that count."""
    return "0" if value == 0 else f"{value:#.3g}".rstrip(".")


def _days(day: date) -> int:
    return (day - date(1970, 1, 1)).days


def health(question: Question) -> Health:
    """Look at a lake. Raises UnreadableError for one without captures that were read."""
    (totals,) = _rows(
        question,
        """select count(*) as captures, count(*) filter (status not in ('decoded', 'incomplete')) as unread,
        count(distinct machine) as machines, min(date) as first, max(date) as last, sum(frames)::bigint as frames,
        sum(size)::bigint as size, sum(errors)::bigint as errors from captures""",
    )
    if totals["last"] is None:
        raise UnreadableError(f"{question.lake.place.url} has no capture that could be read")
    found = Health(question.lake.place.url, totals["last"], totals)
    for quantity in QUANTITIES:
        if quantity.table in question.tables:
            found.values[quantity.name] = _by_drive(question, quantity.query)
            for who, history in found.values[quantity.name].items():
                change = compared(who, quantity, history, _days(found.last))
                if change is not None:
                    found.changes.append(change)
    found.changes.sort(key=lambda each: (not each.worse, -abs(each.deviations)))
    since = found.last - timedelta(days=RECENT)
    found.captures = _rows(
        question,
        f"""select machine, date, source, name, status, reason, errors, frames, junk_bytes, causes from captures
        where (errors > 0 or status not in ('decoded', 'incomplete')) and (date is null or date > '{since}')
        order by errors desc nulls first, name limit {SHOWN}""",
    )
    found.silent = _rows(
        question,
        f"""select machine, max(date) as last from captures
        where status in ('decoded', 'incomplete') and machine is not null
        group by machine having max(date) <= '{since}' order by last desc, machine limit {SHOWN}""",
    )
    return found


def _rows(question: Question, query: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = question.sql(query).to_arrow_table().to_pylist()
    return found


def _by_drive(question: Question, query: str) -> dict[Who, History]:
    grouped: dict[Who, list[tuple[float, float, float]]] = {}
    for row in _rows(question, f"select * from ({query}) where date is not null and value is not null order by date"):
        who = Who(row["machine"] or "", row["bus"] or "", row["address"])
        grouped.setdefault(who, []).append((_days(row["date"]), row["value"], row["count"]))
    return {who: History(*np.array(days, dtype=np.float64).T) for who, days in grouped.items()}


def compared(who: Who, quantity: Quantity, history: History, last: int) -> Change | None:
    """Return what changed in the last days against the weeks before; None where nothing did, or too little is known."""
    recent, whole = history.within(last - RECENT, last), history.within(last - RECENT - BEFORE, last)
    now, past = recent.values, history.within(last - RECENT - BEFORE, last - RECENT).values
    if len(now) < _LEAST_NOW or len(past) < _LEAST_BEFORE:
        return None
    before, after = float(np.median(past)), float(np.median(now))
    spread = float(np.median(np.abs(past - before)))
    # Where nothing varied at all, the smallest change that matters is just large enough to be reported.
    deviations = (after - before) / max(_NORMAL * spread, quantity.least / DEVIATIONS)
    low, high = sorted((before, after))
    if abs(deviations) < DEVIATIONS or (low > 0 and high / low < quantity.factor):
        return None
    if quantity.unit == "%" and abs(after - before) / 100 * recent.counts.sum() < EVENTS:
        return None
    return Change(who, quantity, before, spread, after, (len(past), len(now)), deviations, whole)


def link(source: str, name: str) -> str:
    """Return where a browser finds a capture, "" where it cannot: links lead to local files and https alone."""
    if source.startswith("https://"):
        return f"{source.rstrip('/')}/{quote(name)}"
    path = Path(source) / name
    return "" if "://" in source else (path if path.exists() else Path(source)).absolute().as_uri()


def html(found: Health) -> str:
    """Return the page."""
    charts = [(quantity, chart) for quantity in QUANTITIES if (chart := found.chart(quantity)) is not None]
    return render(
        "analyzer.fleet", "fleet.html", health=found, quantities=QUANTITIES, charts=charts, link=link, number=shown,
        shown=SHOWN, recent=RECENT, before=BEFORE, deviations=DEVIATIONS, events=EVENTS, last=_days(found.last),
        whole=[day * _DAY for day in found.days()],
    )  # fmt: skip
