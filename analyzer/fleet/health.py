"""How the machines of a fleet are, and what got worse: a page over a lake.

Each drive has quantities by day: the shares of its requests that had no reply, failed or came damaged; the latency of replies;
temperature and current. Each machine has the share of its bytes that was junk. The last days are compared with the weeks
before by the median and the median absolute deviation, so a single bad day counts neither way.
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
#: Changes, drives, captures and lines that are shown.
SHOWN, _LINES = 100, 8
_DAY = 86_400.0


class Quantity(NamedTuple):
    """What is watched. `query`: rows of machine, bus, address, date, value; `least`: the smallest change that matters.

    `factor`: by how much it must change besides; `table`: what it needs.
    """

    name: str
    unit: str
    table: str
    query: str
    least: float
    factor: float


def _share(outcome: str) -> str:
    return f"""select machine, bus, address, date, 100.0 * count(*) filter (outcome = '{outcome}') / count(*) as value
        from transactions group by all having count(*) >= 10"""


def _of_latency(share: float) -> str:
    return f"""select machine, bus, address, date, quantile_cont(latency, {share}) * 1000 as value
        from transactions where latency is not null group by all having count(*) >= 10"""


def _of_state(name: str, share: float) -> str:
    return f"""select machine, bus, address, date, quantile_cont(abs({name}), {share}) as value
        from states where {name} is not null group by all having count(*) >= 3"""


QUANTITIES = (
    Quantity("unanswered", "%", "transactions", _share("unanswered"), 0.1, 1.5),
    Quantity("failed", "%", "transactions", _share("failed"), 0.1, 1.5),
    Quantity("damaged replies", "%", "transactions", _share("damaged"), 0.05, 1.5),
    Quantity("latency, median", "ms", "transactions", _of_latency(0.5), 0.2, 1.2),
    Quantity("latency, 99 %", "ms", "transactions", _of_latency(0.99), 0.5, 1.3),
    Quantity("temperature, 95 %", "°C", "states", _of_state("temperature", 0.95), 3.0, 1.05),
    Quantity("current, 95 %", "A", "states", _of_state("current", 0.95), 0.05, 1.2),
    Quantity(
        "junk", "‰ of bytes", "captures",
        """select machine, null as bus, null as address, date, 1000.0 * sum(junk_bytes) / sum(frame_bytes + junk_bytes) as value
        from captures where frame_bytes + junk_bytes > 0 group by all""", 0.5, 1.5,
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


@dataclass(frozen=True)
class Change:
    """A quantity that changed. `before`, `now`: medians; `spread`: the median absolute deviation before.

    `days`: with values, before and now; `deviations`: how far off, up is worse.
    """

    who: Who
    quantity: Quantity
    before: float
    spread: float
    now: float
    days: tuple[int, int]
    deviations: float

    @property
    def worse(self) -> bool:
        """Whether it went up: all that is watched is better when it is less."""
        return self.now > self.before


@dataclass
class Health:
    """What a page shows. `values`: quantity -> drive -> days since 1970 and values; `last`: the last day."""

    place: str
    last: date
    totals: Mapping[str, Any]
    values: dict[str, dict[Who, tuple[NDArray[np.float64], NDArray[np.float64]]]] = field(default_factory=dict)
    changes: list[Change] = field(default_factory=list)
    captures: Sequence[Mapping[str, Any]] = ()

    def days(self) -> tuple[float, float]:
        """Return the first and the last day with values, in days since 1970."""
        every = [days for each in self.values.values() for days, _ in each.values()]
        return (min(map(np.min, every)), max(map(np.max, every))) if every else (0.0, 0.0)

    def drives(self) -> list[tuple[Who, list[str]]]:
        """Return the drives with the medians of their last days, those with the most trouble first."""
        rows = []
        for who in sorted({who for each in self.values.values() for who in each}, key=str):
            cells, trouble = [], 0.0
            for quantity in QUANTITIES:
                days, values = self.values.get(quantity.name, {}).get(who, (np.zeros(0), np.zeros(0)))
                recent = values[days > _days(self.last) - RECENT]
                cells.append(f"{np.median(recent):.3g}" if len(recent) else "")
                if quantity.unit == "%" and len(recent):
                    trouble += float(np.median(recent))
            rows.append((trouble, who, cells))
        return [(who, cells) for _, who, cells in sorted(rows, key=lambda row: -row[0])]

    def chart(self, quantity: Quantity) -> Chart | None:
        """Return a quantity over the days, for the drives with the greatest values; None where all are 0."""
        every = {who: each for who, each in self.values.get(quantity.name, {}).items() if each[1].any()}
        chosen = sorted(every, key=lambda who: -float(every[who][1].max()))[:_LINES]
        if not chosen:
            return None
        x = np.unique(np.concatenate([every[who][0] for who in chosen]))
        lines = {}
        for who in chosen:
            column = np.full(len(x), np.nan)
            column[np.searchsorted(x, every[who][0])] = every[who][1]
            lines[str(who)] = column
        return Chart(x * _DAY, lines, quantity.name, quantity.unit, "clock", group="fleet")


def _days(day: date) -> int:
    return (day - date(1970, 1, 1)).days


def health(question: Question) -> Health:
    """Look at a lake. Raises UnreadableError for one without captures that were read."""
    totals = (
        question.sql(
            """select count(*) as captures, count(*) filter (status not in ('decoded', 'incomplete')) as unread,
        count(distinct machine) as machines, min(date) as first, max(date) as last, sum(frames)::bigint as frames,
        sum(size)::bigint as size, sum(errors)::bigint as errors from captures"""
        )
        .to_arrow_table()
        .to_pylist()[0]
    )
    if totals["last"] is None:
        raise UnreadableError(f"{question.lake.place.url} has no capture that could be read")
    found = Health(question.lake.place.url, totals["last"], totals)
    for quantity in QUANTITIES:
        if quantity.table in question.tables:
            found.values[quantity.name] = _by_drive(question, quantity.query)
            for who, (days, values) in found.values[quantity.name].items():
                change = compared(who, quantity, days, values, _days(found.last))
                if change is not None:
                    found.changes.append(change)
    found.changes.sort(key=lambda each: (not each.worse, -abs(each.deviations)))
    since = found.last - timedelta(days=RECENT)
    found.captures = (
        question.sql(
            f"""select machine, date, source, name, status, reason, errors, frames, junk_bytes, causes from captures
        where (errors > 0 or status not in ('decoded', 'incomplete')) and (date is null or date > '{since}')
        order by errors desc nulls first, name limit {SHOWN}"""
        )
        .to_arrow_table()
        .to_pylist()
    )
    return found


def _by_drive(question: Question, query: str) -> dict[Who, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    rows = question.sql(f"select * from ({query}) where date is not null and value is not null order by date").to_arrow_table()
    grouped: dict[Who, tuple[list[float], list[float]]] = {}
    for row in rows.to_pylist():
        days, values = grouped.setdefault(Who(row["machine"] or "", row["bus"] or "", row["address"]), ([], []))
        days.append(_days(row["date"]))
        values.append(row["value"])
    return {who: (np.array(days, dtype=np.float64), np.array(values)) for who, (days, values) in grouped.items()}


def compared(who: Who, quantity: Quantity, days: NDArray[np.float64], values: NDArray[np.float64], last: int) -> Change | None:
    """Return what changed in the last days against the weeks before; None where nothing did, or too little is known."""
    now = values[days > last - RECENT]
    past = values[(days <= last - RECENT) & (days > last - RECENT - BEFORE)]
    if len(now) < _LEAST_NOW or len(past) < _LEAST_BEFORE:
        return None
    before, after = float(np.median(past)), float(np.median(now))
    spread = float(np.median(np.abs(past - before)))
    # Where nothing varied at all, the smallest change that matters is one deviation.
    deviations = (after - before) / max(_NORMAL * spread, quantity.least)
    low, high = sorted((before, after))
    if abs(deviations) < DEVIATIONS or (low > 0 and high / low < quantity.factor):
        return None
    return Change(who, quantity, before, spread, after, (len(past), len(now)), deviations)


def link(source: str, name: str) -> str:
    """Return where a browser finds a capture, "" where it cannot: links lead to local files and https alone."""
    if source.startswith("https://"):
        return f"{source.rstrip('/')}/{quote(name)}"
    path = Path(source) / name
    return "" if "://" in source else (path if path.exists() else Path(source)).absolute().as_uri()


def html(found: Health) -> str:
    """Return the page."""
    charts = [(quantity, chart) for quantity in QUANTITIES if (chart := found.chart(quantity)) is not None]
    return render("analyzer.fleet", "fleet.html", health=found, quantities=QUANTITIES, charts=charts, link=link, shown=SHOWN,
                  recent=RECENT, before=BEFORE, deviations=DEVIATIONS, whole=[day * _DAY for day in found.days()])  # fmt: skip
