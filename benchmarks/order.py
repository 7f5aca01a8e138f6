"""Makes the tables of the order in which claims run on a real line (`conformance/suite/telling/DIALECT.json`), by measurement.

    python -m benchmarks.order [--dialect D] [--known FILE]

First the seconds of each claim, by the rules of a real drive, on an ideal one. Then, again and again, the claim that adds most
for a second: known faults that no claim before it refutes, commands and aspects that no claim before it looks at. `--known`:
which claims refute which fault, a line each as in `tests/conformance/golden/faults.jsonl` (the default); may be given again.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path
from statistics import median
from typing import NamedTuple

import msgspec

from analyzer.records import CanFrame, Chunk
from benchmarks.run_time import TARGETS, everything, in_a_group, real, specification, timed
from conformance.claim import Claim, Outcome
from conformance.drives.can_bits import frame_bits
from conformance.suite import order
from conformance.suite.order import Cost
from conformance.suite.rig_stand_in import StandInRig
from conformance.suite.target import Target

FOLDER = Path(order.__file__).with_name("telling")
GOLDEN = Path(__file__).parents[1] / "tests" / "conformance" / "golden" / "faults.jsonl"
#: What a command and an aspect that were not looked at yet are worth, beside a fault: more of it crowds faults out.
_NEW_PAIR = 0.03
#: How long the list is, in seconds: more than a short run, for those that may send less or have a slower line.
_LIST_SECONDS = 400.0
#: What each claim costs beside its measured time, so that none is for nothing.
_LEAST = 0.1
#: Seconds in which a drive is found.
_FINDING = 0.2
_FREE = Cost(0.0, 0)


class Measured(NamedTuple):
    """A claim, what it cost, what it costs where no other one has asked the same, and whose exchange it judges."""

    claim: Claim
    own: Cost
    cost: Cost
    asked_by: str


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
    started = rig.gate.now_ns() / 1e9 - scanned
    before = bits[0]
    found: dict[str, Measured] = {}
    asked: dict[object, Measured] = {}
    for claim, verdict, seconds in timed(plan, target, rig):
        own, before = bits[0] - before, bits[0]
        if verdict.outcome is Outcome.NOT_RUN:
            continue
        subject, cost = (claim.theme, claim.commands), Cost(round(max(0.0, seconds - own / target.rate), 3), own)
        if own or subject not in asked:
            asked[subject] = Measured(claim, cost, cost, claim.id)
        found[claim.id] = Measured(claim, cost, asked[subject].cost, asked[subject].asked_by)
    return Cost(round(started + _FINDING, 2), 0), Cost(round(scanned, 2), 0), found


def greedy(costs: Mapping[str, Measured], refuted_by: Mapping[str, set[str]], rate: int) -> dict[str, Cost]:
    """Return claims in the order of what they add for a second, with what each costs there."""
    catches: dict[str, set[str]] = defaultdict(set)
    for fault, claims in refuted_by.items():
        for claim in claims:
            catches[claim].add(fault)
    new = {name: (catches[name], set(each.claim.covers)) for name, each in sorted(costs.items())}
    found: dict[str, Cost] = {}
    asked: set[str] = set()

    def price(name: str) -> Cost:
        return _FREE if costs[name].asked_by in asked else costs[name].cost

    passed = 0.0
    while new and passed < _LIST_SECONDS:
        worth = {
            name: (len(faults) + _NEW_PAIR * len(pairs)) / (price(name).seconds(rate) + _LEAST)
            for name, (faults, pairs) in new.items()
        }
        best = max(worth, key=lambda name: worth[name])
        if not worth[best]:
            break
        found[best] = price(best)
        passed += price(best).seconds(rate)
        asked.add(costs[best].asked_by)
        faults, pairs = new.pop(best)
        new = {n: (own - faults, looks - pairs) for n, (own, looks) in new.items()}
    return found


def make(target: Target, known: Iterable[Mapping[str, object]]) -> dict[str, Cost]:
    """Write the table of a target's dialect; return the claims that come first."""
    start, alone, costs = measured(target)
    ids = {name for name, each in costs.items() if not each.claim.emulated and not each.claim.by_name}
    refuted_by: dict[str, set[str]] = defaultdict(set)
    for row in known:
        if row["dialect"] == target.dialect.name:
            refuted_by[str(row["fault"])] |= ids.intersection(row["refuted"])  # type: ignore[arg-type]
    first = greedy({name: costs[name] for name in ids}, refuted_by, target.rate)
    write(target, start, alone, first, costs)
    # What a claim costs depends on those before it, so it is measured again where it stands now.
    _, _, costs = measured(target)
    first = {name: costs[name].own for name in first}
    write(target, start, alone, first, costs)
    return first


def write(target: Target, start: Cost, alone: Cost, first: Mapping[str, Cost], costs: Mapping[str, Measured]) -> None:
    """Write a table as JSON, a row to a line."""
    kinds: dict[str, list[Cost]] = defaultdict(list)
    for each in costs.values():
        kinds[order.kind(each.claim)].append(each.own)
    table: dict[str, object] = {
        "start": start,
        "alone": alone,
        "first": {name.split("/", 1)[1]: cost for name, cost in first.items()},
        "kinds": {name: _middle(found) for name, found in sorted(kinds.items())},
    }
    FOLDER.mkdir(exist_ok=True)
    (FOLDER / f"{target.dialect.name}.json").write_text(as_text(table))
    order.table.cache_clear()


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
    parser.add_argument("--known", action="append", type=Path, default=[], help=f"default {GOLDEN.name}")
    arguments = parser.parse_args()
    known = [json.loads(line) for file in arguments.known or [GOLDEN] for line in file.read_text().splitlines()]
    for text in TARGETS:
        target = real(text)
        if arguments.dialect in (None, target.dialect.name):
            first = make(target, known)
            seconds = sum(cost.seconds(target.rate) for cost in first.values())
            print(f"{target.dialect.name}: {len(first)} claims in {seconds:.0f} s come first", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
