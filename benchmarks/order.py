"""Makes the tables of the order in which claims run on a real line (`conformance/suite/telling/DIALECT.json`), by measurement.

    python -m benchmarks.order [--dialect D] [--known FILE] [--search ROUNDS] [--new PATTERN]

First the seconds of each claim, and of each motion that several claims judge, by the rules of a real drive, on an ideal one.
Then, again and again, the claim that adds most for a second: known faults that no claim before it refutes, commands and aspects
that no claim before it looks at. Claims that judge the same recordings are weighed together. A short run leaves out a claim
whose faults those after it refute, too.

`--known`: which claims refute which fault, a line each; `faults.jsonl` and `order.jsonl` of `tests/conformance/golden` by
default. It may be given again, and what the files say of a fault is put together. The first of these files knows the likeliest
claims of a fault alone. So `--search` tries the claims of a short run against each fault that none of them is known to refute.
From the second round on it also tries those that share recordings against what one claim alone is known to refute. It keeps
what is found in the second file, and chooses again. `--new`: claims that are tried too, for nothing is known of them yet.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import sys
from collections import Counter, defaultdict
from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from fnmatch import fnmatch
from pathlib import Path
from statistics import median
from typing import NamedTuple

import msgspec

from analyzer.records import CanFrame, Chunk
from benchmarks.run_time import TARGETS, everything, in_a_group, real, specification, timed
from conformance.claim import Claim, Outcome
from conformance.drives.can_bits import frame_bits
from conformance.gate.gate import Gate
from conformance.model import story
from conformance.motion import resting
from conformance.suite import engine, order
from conformance.suite.dry_run import StandInRig
from conformance.suite.order import Cost
from conformance.suite.rig_emulated import EmulatedRig
from conformance.suite.target import Target
from conformance.talk.probe import Recording

FOLDER = Path(order.__file__).with_name("telling")
GOLDEN = Path(__file__).parents[1] / "tests" / "conformance" / "golden" / "faults.jsonl"
#: What was searched for beside it.
SEARCHED = GOLDEN.with_name("order.jsonl")
#: The claims that refute each fault of a dialect.
Refuted = dict[str, set[str]]
#: What a command and an aspect that were not looked at yet are worth, beside a fault: more of it crowds faults out.
_NEW_PAIR = 0.03
#: How long the list is, in seconds: more than a short run, for those that may send less or have a slower line.
_LIST_SECONDS = 400.0
#: What each claim costs beside its measured time, so that none is for nothing.
_LEAST = 0.1
#: When the last claim of a short run has to be over.
_UNTIL = order.SHORT_SECONDS - order.ENDING_SECONDS
#: How often claims of a short run are left out by chance, and how many at once.
_CHANCES, _LEFT_OUT = 400, (1, 2, 3, 5, 8)
#: Seconds in which a drive is found.
_FINDING = 0.2


class Measured(NamedTuple):
    """A claim and what it cost in its place. `parts`: the seconds of the recordings that it judges; `rest`: what else it does.

    `behind`: the claims before it that made those recordings.
    """

    claim: Claim
    own: Cost
    rest: float
    parts: Mapping[Hashable, float]
    behind: tuple[str, ...]


class _Watched(dict[Hashable, Recording]):
    """Recordings of a rig that know how long each took, who made it, and which of them a claim asked for."""

    def __init__(self, gate: Gate) -> None:
        super().__init__()
        self._gate = gate
        self.seconds: dict[Hashable, float] = {}
        self.makers: dict[Hashable, str] = {}
        self.asked: list[Hashable] = []
        self._begun: list[int] = []

    def get(self, key: Hashable, default: object = None) -> Recording | None:  # type: ignore[override]
        self.asked.append(key)
        if key not in self:
            self._begun.append(self._gate.now_ns())
        return super().get(key)

    def __setitem__(self, key: Hashable, value: Recording) -> None:
        self.seconds[key] = (self._gate.now_ns() - self._begun.pop()) / 1e9
        super().__setitem__(key, value)

    def of(self, claim: Claim) -> tuple[dict[Hashable, float], tuple[str, ...], float]:
        """Return what a claim that has just run asked for, who else made it, and the seconds of what it made itself."""
        parts = {key: self.seconds[key] for key in self.asked if key in self}
        own = sum(seconds for key, seconds in parts.items() if self.makers.setdefault(key, claim.id) == claim.id)
        others = tuple(dict.fromkeys(self.makers[key] for key in parts if self.makers[key] != claim.id))
        self.asked, self._begun = [], []
        return parts, others, own


def measured(target: Target) -> tuple[Cost, Cost, dict[str, Measured]]:
    """Return what it costs to begin, to look for others, and each claim that runs."""
    plan = everything(target, more=in_a_group(target))
    rig = StandInRig(plan, target, specification(target, in_a_group(target)))
    bits = [0]

    def count(item: Chunk | CanFrame) -> None:
        can = isinstance(item, CanFrame)
        bits[0] += frame_bits(item.id, item.data) if can else len(item.data) * target.endpoint.bits_per_byte  # type: ignore

    rig.gate.log = count
    scanned = rig.gate.now_ns() / 1e9
    _ = rig.noise
    # The first claim that moves the shaft waits for this, so it belongs to the start.
    if mover := next((c for c in plan.selected(target) if resting.can_turn(rig.dialect, c)), None):
        rig.settle(rig.probe(mover))
    started = rig.gate.now_ns() / 1e9 - scanned
    before = bits[0]
    found: dict[str, Measured] = {}
    rig.recordings = watched = _Watched(rig.gate)
    for claim, verdict, seconds in timed(plan, target, rig):
        own, before = bits[0] - before, bits[0]
        if verdict.outcome is Outcome.NOT_RUN:
            continue
        parts, behind, made = watched.of(claim)
        cost = Cost(round(max(0.0, seconds - own / target.rate), 3), own)
        found[claim.id] = Measured(claim, cost, max(0.0, seconds - made), parts, behind)
    return Cost(round(started + _FINDING, 2), 0), Cost(round(scanned, 2), 0), found


def chosen(costs: Mapping[str, Measured], refuted_by: Mapping[str, set[str]], before: float) -> list[str]:
    """Return claims in the order of what they add for a second; those of a short run find the most that was found for its time.

    Some of them are left out again and again, by chance, and others fill the time.
    """
    every, chance = greedy(costs, refuted_by, before), random.Random(0)
    best = _Found(costs, _news(costs, refuted_by), before)
    best.fill(chance)
    for _ in range(_CHANCES):
        other = best.copy()
        for name in chance.sample(other.names, min(len(other.names), chance.choice(_LEFT_OUT))):
            other.remove(name)
        other.fill(chance)
        if other.worth >= best.worth:
            best = other
    short = greedy({name: costs[name] for name in best.names}, refuted_by, before)
    return [*short, *(name for name in every if name not in short)]


def _news(costs: Mapping[str, Measured], refuted_by: Mapping[str, set[str]]) -> dict[str, set[Hashable]]:
    """Return what each claim finds."""
    news: dict[str, set[Hashable]] = {name: set(each.claim.covers) for name, each in sorted(costs.items())}
    for fault, claims in refuted_by.items():
        for claim in claims & news.keys():
            news[claim].add(fault)
    return news


def greedy(
    costs: Mapping[str, Measured], refuted_by: Mapping[str, set[str]], before: float = 0.0, until: float = _LIST_SECONDS
) -> list[str]:
    """Return claims in the order of what they add for a second, of a run whose first one begins after so many seconds.

    `until`: for how many seconds of the run.
    """
    found = _Found(costs, _news(costs, refuted_by), before)
    while found.passed < until:
        names, rate = found.best()
        if not names:
            break
        for name in names:
            found.add(name)
        if found.short:
            found.leave_out(rate)
    return found.names


def _worth(news: Iterable[Hashable]) -> float:
    """Return what is worth finding, in faults: news are faults by name, and pairs of a command and an aspect."""
    return sum(1.0 if isinstance(new, str) else _NEW_PAIR for new in news)


class _Found:
    """Claims that are chosen, in order, and what they find. `passed`: the seconds until the last one has ended."""

    def __init__(self, costs: Mapping[str, Measured], news: Mapping[str, set[Hashable]], before: float) -> None:
        self.names: list[str] = []
        self.passed = before
        self._costs, self._news = costs, news
        self._seconds = {key: seconds for each in costs.values() for key, seconds in each.parts.items()}
        self._longest = order.LONGEST * (order.SHORT_SECONDS - before)
        self._waiting = {name: set(own) for name, own in news.items()}
        self._finders: Counter[Hashable] = Counter()
        self._users: Counter[Hashable] = Counter()
        self._left_out: set[str] = set()

    @property
    def short(self) -> bool:
        """Whether a short run is not full yet."""
        return self.passed < order.SHORT_SECONDS

    @property
    def worth(self) -> float:
        """What is found."""
        return _worth(new for new, count in self._finders.items() if count)

    def copy(self) -> _Found:
        """Return the same, which goes on by itself."""
        other = _Found(self._costs, self._news, self.passed)
        other._longest = self._longest
        other.names = list(self.names)
        other._waiting = {name: set(new) for name, new in self._waiting.items()}
        other._finders, other._users = self._finders.copy(), self._users.copy()
        return other

    def fill(self, chance: random.Random) -> None:
        """Choose what adds most for a second, or by chance what adds a little less, as long as it fits into a short run."""
        while True:
            names, _ = self.best(_UNTIL - self.passed, chance)
            if not names:
                return
            for name in names:
                self.add(name)

    def best(self, within: float = math.inf, chance: random.Random | None = None) -> tuple[list[str], float]:
        """Return the claims that add most for a second, and how much: one, or several that judge the same recordings.

        A short run leaves out what would take much of it. `within`: the seconds that there are. `chance`: one of those that
        add nearly as much.
        """
        useful = {name: new for name, new in self._waiting.items() if new}
        best: tuple[list[str], float] = [], 0.0
        for parts in {frozenset(self._costs[name].parts): None for name in useful}:
            seconds = self._recording(parts)
            if (not self.short or seconds <= self._longest) and seconds <= within:
                behind = {name: new for name, new in useful.items() if self._judges(name, parts)}
                fitting = {name: new for name, new in behind.items() if seconds + self._costs[name].rest <= within}
                names, rate = self._together(fitting, seconds, within)
                best = max(best, (names, rate * (chance.uniform(0.8, 1) if chance else 1)), key=lambda found: found[1])
        return best

    def _judges(self, name: str, parts: frozenset[Hashable]) -> bool:
        own = self._costs[name].parts
        return parts.issuperset(own) and bool(own) == bool(parts)

    def _recording(self, parts: Iterable[Hashable]) -> float:
        return sum(self._seconds[key] for key in parts if not self._users[key])

    def _together(self, behind: Mapping[str, set[Hashable]], seconds: float, within: float) -> tuple[list[str], float]:
        """Return those of some claims that raise what is found for a second, and that, with the seconds of the recordings."""
        names: list[str] = []
        found: set[Hashable] = set()
        highest = 0.0
        left = dict(behind)
        while left:
            name = max(left, key=lambda name: _worth(left[name] - found) / (self._costs[name].rest + _LEAST))
            seconds += self._costs[name].rest + _LEAST
            rate = _worth(found | left[name]) / seconds
            if rate <= highest or seconds > within + _LEAST or (self.short and self._costs[name].rest > self._longest):
                break
            highest = rate
            names.append(name)
            found |= left.pop(name)
        return names, highest

    def add(self, name: str) -> None:
        """Choose a claim as the next."""
        cost, own = self._costs[name], self._news[name]
        self.names.append(name)
        self.passed += cost.rest + self._recording(cost.parts)
        self._users.update(cost.parts)
        self._finders.update(own)
        del self._waiting[name]
        for new in self._waiting.values():
            new -= own

    def leave_out(self, rate: float) -> None:
        """Let claims wait that find less alone for a second than what was chosen last finds; each once."""
        for name in [name for name in self.names if name not in self._left_out]:
            cost = self._costs[name]
            alone = {new for new in self._news[name] if self._finders[new] == 1}
            freed = cost.rest + sum(self._seconds[key] for key in cost.parts if self._users[key] == 1)
            if _worth(alone) / (freed + _LEAST) < rate:
                self._left_out.add(name)
                self.remove(name)

    def remove(self, name: str) -> None:
        """Let a claim wait, and what it alone finds be news again."""
        cost, own = self._costs[name], self._news[name]
        self.names.remove(name)
        self._users.subtract(cost.parts)
        self.passed -= cost.rest + self._recording(cost.parts)
        self._finders.subtract(own)
        lost = {new for new in own if not self._finders[new]}
        for other, new in self._waiting.items():
            new |= self._news[other] & lost
        self._waiting[name] = lost


def make(target: Target, refuted_by: Refuted, rounds: int, new: Sequence[str]) -> dict[str, Cost]:
    """Write the table of a target's dialect, after so many searches; return the claims that come first."""
    start, alone, costs = measured(target)
    plain = {name: each for name, each in costs.items() if not each.claim.emulated and not each.claim.by_name}
    before = start.waits + alone.waits
    unknown = [name for name in plain if any(fnmatch(name, pattern) for pattern in new)]
    for again in range(rounds):
        short = greedy(plain, refuted_by, before, order.SHORT_SECONDS)
        shared = [name for name in short if plain[name].parts]
        finders = {f: len(claims.intersection(short)) for f, claims in refuted_by.items() if claims & plain.keys()}
        for names, count in (((*short, *unknown), 0), ((*shared, *unknown), 1))[: 1 + bool(again)]:
            claims = [plain[name].claim for name in dict.fromkeys(names)]
            _try(target, claims, refuted_by, [fault for fault, found in finders.items() if found == count])
    first = chosen(plain, refuted_by, before)
    write(target, start, alone, first, costs)
    # What a claim costs depends on those before it, so it is measured again where it stands now.
    _, _, costs = measured(target)
    write(target, start, alone, first, costs)
    return {name: costs[name].own for name in first}


def _try(target: Target, claims: Sequence[Claim], refuted_by: Refuted, faults: Iterable[str]) -> None:
    """Try claims against faults; keep which refute which."""
    # What is refuted counts, not by how few steps.
    story.SHORTER = 0
    rows = {(dialect, fault): refuted for dialect, fault, refuted in map(_row, _lines(SEARCHED))}
    for fault in faults:
        rig = EmulatedRig(specification(target, f"{in_a_group(target)},fault={fault}"))
        found = {v.claim.id for v in engine.run(claims, rig) if v.outcome is Outcome.REFUTED}
        refuted_by[fault] |= found
        rows[target.dialect.name, fault] = found | rows.get((target.dialect.name, fault), set())
    facts = ({"dialect": d, "fault": f, "refuted": sorted(refuted)} for (d, f), refuted in sorted(rows.items()) if refuted)
    SEARCHED.write_text("".join(f"{json.dumps(fact)}\n" for fact in facts))


def _lines(file: Path) -> list[str]:
    return file.read_text().splitlines() if file.is_file() else []


def _row(line: str) -> tuple[str, str, set[str]]:
    row = json.loads(line)
    return row["dialect"], row["fault"], set(row["refuted"])


def known(files: Iterable[Path]) -> dict[str, Refuted]:
    """Return which claims refute which fault, by dialect, as files have it together."""
    found: dict[str, Refuted] = defaultdict(lambda: defaultdict(set))
    for dialect, fault, refuted in (_row(line) for file in files for line in _lines(file)):
        found[dialect][fault] |= refuted
    return found


def write(target: Target, start: Cost, alone: Cost, first: Collection[str], costs: Mapping[str, Measured]) -> None:
    """Write a table as JSON, a row to a line."""
    # What runs before the order begins, to prove the reads, is behind nothing.
    names = {name: [_short(other) for other in costs[name].behind if other in first] for name in first}
    kinds: dict[str, list[Cost]] = defaultdict(list)
    for each in costs.values():
        kinds[order.kind(each.claim)].append(each.own)
    table: dict[str, object] = {
        "start": start,
        "alone": alone,
        "first": {_short(name): costs[name].own for name in first},
        "behind": {_short(name): others for name, others in names.items() if others},
        "kinds": {name: _middle(found) for name, found in sorted(kinds.items())},
    }
    FOLDER.mkdir(exist_ok=True)
    (FOLDER / f"{target.dialect.name}.json").write_text(as_text(table))
    order.table.cache_clear()


def _short(name: str) -> str:
    return name.split("/", 1)[1]


def _middle(costs: list[Cost]) -> Cost:
    return Cost(round(median(c.waits for c in costs), 2), round(median(c.bits for c in costs)))


def as_text(table: Mapping[str, object]) -> str:
    """Return a table as JSON, a row to a line."""

    def text(value: object) -> str:
        return msgspec.json.encode(value).decode()

    parts = []
    for name, value in table.items():
        rows = ",\n".join(f"  {text(row)}: {text(cost)}" for row, cost in value.items()) if isinstance(value, dict) else ""
        parts.append(f"{text(name)}: " + (f"{{\n{rows}\n}}" if rows else text(value)))
    return "{\n" + ",\n".join(parts) + "\n}\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dialect", help="only this one")
    parser.add_argument("--known", action="append", type=Path, default=[], help=f"default {GOLDEN.name}, {SEARCHED.name}")
    parser.add_argument("--search", type=int, default=0, metavar="ROUNDS")
    parser.add_argument("--new", action="append", default=[], metavar="PATTERN")
    arguments = parser.parse_args()
    refuted_by = known(arguments.known or (GOLDEN, SEARCHED))
    for text in TARGETS:
        target = real(text)
        if arguments.dialect in (None, target.dialect.name):
            first = make(target, refuted_by[target.dialect.name], arguments.search, arguments.new)
            seconds = sum(cost.seconds(target.rate) for cost in first.values())
            print(f"{target.dialect.name}: {len(first)} claims in {seconds:.0f} s come first", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
