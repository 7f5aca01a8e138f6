"""What the suite says, kept: every claim, every verdict on conforming drives, and which claims refute which fault.

    python -m tests.conformance.golden [claims|verdicts|faults ...] [--write] [--jobs N] [--every N] [--only PATTERN ...]
                                       [--search] [--full FILE]

A change that means to change nothing leaves these files alone. One that means to change them writes them anew, and the
difference shows what it did. `--only new`: those faults alone whose lines are not kept yet, or of which a name matches; the
other lines stay. `--full FILE` writes the whole table of faults, every claim against each: an hour.

Where none of the likeliest claims refutes a fault, the most telling ones are tried, and those that were found before, until one
does. `--search` tries all claims against such a fault: what is found is kept, and later runs need no search.
"""

from __future__ import annotations

import argparse
import difflib
import json
import sys
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from fnmatch import fnmatch
from pathlib import Path

from conformance.claim import Outcome
from conformance.drives import make
from conformance.suite import engine
from conformance.suite import plan as suite
from conformance.suite.engine import Verdict
from conformance.suite.target import Target, every_emulated
from conformance.tools import mutants

FOLDER = Path(__file__).with_name("golden")
#: Claims that are tried against each fault: those that are likeliest to refute it.
LIKELIEST = 40
#: Claims of each dialect that refute most faults: they are tried where the likeliest ones refute nothing.
TELLING = 60
#: What can hurt: motion with a wrong check, by a wrong address, while disabled, while protected. All claims are tried against
#: such a fault if the likeliest ones do not notice it in two ways.
HURTS = (
    "executes-bad-*", "hears-bad-*", "executes-another-address", "executes-motion-of-another", "answers-another-address",
    "disabled-moves", "protected-moves", "package-any-checksum", "package-every-slot", "package-broadcast-slot",
    "protected-goes-on", "release-takes-up",
    "lk-answers-other-address", "lk-answers-address-0", "lk-obeys-*", "lk-answers-wrong-*-sum", "lk-off-still-moves",
)  # fmt: skip


def claims() -> Iterator[str]:
    """Yield a line for each claim, by id: statement, certainty, risks and what else decides when it runs."""
    for target in every_emulated():
        for claim in sorted(suite.every_claim(target), key=lambda c: c.id):
            flags = [name for name in ("alone", "by_name", "emulated") if getattr(claim, name)]
            fact = {
                "target": target.text,
                "id": claim.id,
                "statement": claim.statement,
                "section": claim.section,
                "certainty": claim.certainty.value,
                "risks": sorted(risk.value for risk in claim.risks),
                "flags": flags,
                "settings": sorted(claim.settings),
                "covers": sorted([command, aspect.value] for command, aspect in claim.covers),
            }
            yield json.dumps(fact, ensure_ascii=False)


def verdicts() -> Iterator[str]:
    """Yield a line for each verdict on a conforming drive that is not confirmed, and the count of those that are."""
    for target in every_emulated():
        plan = suite.Plan((target,))
        rig = suite.open_rig(plan, target)
        found = [engine.run_claim(claim, rig) for claim in sorted(plan.selected(target), key=lambda c: c.id)]
        yield from (unconfirmed(target, verdict) for verdict in found if verdict.outcome is not Outcome.CONFIRMED)
        confirmed = sum(verdict.outcome is Outcome.CONFIRMED for verdict in found)
        yield json.dumps({"target": target.text, "confirmed": confirmed})


def unconfirmed(target: Target, verdict: Verdict) -> str:
    """Return the line of a verdict."""
    fact = {"target": target.text, "id": verdict.claim.id, "outcome": verdict.outcome.value, "reason": verdict.reason}
    return json.dumps(fact, ensure_ascii=False)


def faults(
    every: int = 1, likeliest: int | None = LIKELIEST, jobs: int = 1, *, search: bool = False, only: Collection[str] = ()
) -> Iterator[str]:
    """Yield a line for each fault, or for `only` some: the claims that refute it, of the likeliest ones (None: of all)."""
    targets = mutants.telling_targets(make.KINDS)
    first = list(mutants.mutants(targets, jobs=jobs, full=True, every=every, most=likeliest, only=sorted(only)))
    again = [each for each in first if hurts(each.fault) and not two_ways([claim for claim, _ in each.refuted])]
    wanted = {(each.dialect, each.fault) for each in again}
    every_claim = mutants.mutants(targets, jobs=jobs, full=True, only=[name for _, name in wanted]) if wanted else ()
    alone = {(each.dialect, each.fault) for each in first if likeliest is not None and not each.refuted} - wanted
    names = sorted({name for _, name in alone})
    more = mutants.mutants(targets, jobs=jobs, only=names, among=() if search else telling(alone)) if alone else ()
    again_tried = [each for each in every_claim if (each.dialect, each.fault) in wanted]
    lines = {}
    for mutant in (*first, *again_tried, *(each for each in more if (each.dialect, each.fault) in alone)):
        fact = {"dialect": mutant.dialect, "fault": mutant.fault, "refuted": sorted(c for c, _ in mutant.refuted)}
        lines[mutant.dialect, mutant.fault] = json.dumps(fact)
    yield from (lines[key] for key in sorted(lines))


def telling(alone: Collection[tuple[str, str]]) -> set[str]:
    """Return the claims that refute most of the kept faults, of each dialect, and those that refuted some before."""
    counts: dict[str, Counter[str]] = {}
    found: set[str] = set()
    for row in map(json.loads, kept("faults")):
        counts.setdefault(row["dialect"], Counter()).update(row["refuted"])
        if (row["dialect"], row["fault"]) in alone:
            found.update(row["refuted"])
    return found.union(*([claim for claim, _ in each.most_common(TELLING)] for each in counts.values()))


def hurts(fault: str) -> bool:
    """Say whether a fault, by its name, can hurt."""
    return any(fnmatch(fault, pattern) for pattern in HURTS)


def two_ways(refuted: Iterable[str]) -> bool:
    """Say whether two of some claims refute, one of them without hands on the drive."""
    by_hand = {c["id"] for c in map(json.loads, kept("claims")) if "emulated" in c["flags"]}
    found = set(refuted)
    return len(found) >= 2 and not found <= by_hand


def named(patterns: Iterable[str]) -> set[str]:
    """Return the names of the faults that match a pattern; `new`: of those that have no line."""
    kept_names = {json.loads(line)["fault"] for line in kept("faults")}
    names = {fault.name for fault in make.every_fault()}
    return {name for name in names for p in patterns if (name not in kept_names if p == "new" else fnmatch(name, p))}


def renewed(new: Iterable[str], only: Collection[str]) -> list[str]:
    """Return the kept lines of faults, with new ones in the place of some."""
    lines = {(row["dialect"], row["fault"]): line for line in kept("faults") if (row := json.loads(line))["fault"] not in only}
    lines |= {((row := json.loads(line))["dialect"], row["fault"]): line for line in new}
    return [lines[key] for key in sorted(lines)]


PARTS = {"claims": claims, "verdicts": verdicts, "faults": faults}


def kept(part: str) -> list[str]:
    """Return the lines that are kept of a part."""
    return (FOLDER / f"{part}.jsonl").read_text().splitlines()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"some of {', '.join(PARTS)}; all by default")
    parser.add_argument("--write", action="store_true", help="write the files anew")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--every", type=int, default=1, help="only each so many of the faults")
    parser.add_argument("--only", action="append", default=[], metavar="PATTERN", help="only these faults; new: without a line")
    parser.add_argument("--search", action="store_true", help="try all claims where the likeliest refute nothing: an hour more")
    parser.add_argument("--full", metavar="FILE", help="write the whole table of faults into a file")
    arguments = parser.parse_args()
    if arguments.full:
        Path(arguments.full).write_text("".join(f"{x}\n" for x in faults(arguments.every, None, arguments.jobs)))
        return 0
    different, only = 0, named(arguments.only)
    if arguments.only and not only:
        parser.error(f"no fault is named {' or '.join(arguments.only)}")
    for part in arguments.parts or PARTS:
        if part == "faults":
            new = list(faults(arguments.every, jobs=arguments.jobs, search=arguments.search, only=only))
            new = renewed(new, only) if only else new
        else:
            new = list(PARTS[part]())
        if arguments.write:
            (FOLDER / f"{part}.jsonl").write_text("".join(f"{x}\n" for x in new))
            continue
        old = kept(part)
        if arguments.every > 1 and part == "faults":
            have = {(f["dialect"], f["fault"]) for f in map(json.loads, new)}
            old = [x for x in old if (json.loads(x)["dialect"], json.loads(x)["fault"]) in have]
        lines = list(difflib.unified_diff(old, new, "kept", "now", lineterm="", n=0))
        print(f"{part}: {len(new)} lines, {'the same' if not lines else 'DIFFERENT'}")
        print("\n".join(lines[:200]))
        different += bool(lines)
    return int(bool(different))


if __name__ == "__main__":
    sys.exit(main())
