"""How many lies a short run finds: drives with a known fault, by the rules of a real drive, in virtual time.

    python -m benchmarks.short [--dialect D] [--every 5] [--at 0] [--jobs 2] [--allow all|read|RISKS] [--missed]

It prints for each dialect how many faults a short run refutes, and how long the first refutation takes. It counts only faults
that show on hardware without hands on the drive, as `benchmarks.order` knows them. `--every N` takes each Nth fault, `--at K`
those that begin with another one; `--every 1` takes some minutes for each dialect.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator
from dataclasses import replace
from multiprocessing import get_context
from statistics import median
from typing import NamedTuple

from analyzer.catalogue import Risk
from benchmarks.order import GOLDEN, SEARCHED, known
from benchmarks.run_time import TARGETS, everything, in_a_group, real, specification, timed
from conformance.claim import NotStopped, Outcome, RigFault
from conformance.gate.permissions import parse_allow
from conformance.suite import plan as suite
from conformance.suite.dry_run import StandInRig


class Tried(NamedTuple):
    """What came of a fault: the claim that refuted it first, or nothing, and after how many seconds."""

    fault: str
    refuted: str
    seconds: float


def tried(given: tuple[str, str, frozenset[Risk]]) -> Tried:
    """Run a short run on a drive with a fault until the first refutation."""
    text, fault, risks = given
    target = real(text)
    group = in_a_group(target)
    plan = replace(everything(target, risks, group), short=True)
    name, seconds = "", 0.0
    try:
        rig = StandInRig(plan, target, specification(target, f"{group},fault={fault}"))
        # The steps of a walk are not shortened.
        rig.searched = math.inf
        for claim, verdict, _ in timed(plan, target, rig):
            seconds = rig.gate.now_ns() / 1e9
            if verdict.outcome is Outcome.REFUTED:
                name = claim.id
                break
    except (RigFault, NotStopped) as error:
        # A run also ends at a drive that it does not find or cannot stop; anything else that is raised is a fault of the suite.
        name = f"{type(error).__name__}: {error}"[:80]
    return Tried(fault, name, seconds)


def on_hardware(dialect: str) -> list[str]:
    """Return the faults of a dialect that a claim without hands refutes."""
    target = next(real(text) for text in TARGETS if text.startswith(dialect))
    plain = {c.id for c in suite.every_claim(target) if not c.emulated and not c.by_name}
    return [fault for fault, refuted in known((GOLDEN, SEARCHED))[dialect].items() if plain & refuted]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dialect", help="only this one")
    parser.add_argument("--every", type=int, default=5, help="only each so many of the faults")
    parser.add_argument("--at", type=int, default=0, help="which of them is the first")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--allow", default="all")
    parser.add_argument("--missed", action="store_true", help="list the faults that are not refuted")
    arguments = parser.parse_args()
    risks = frozenset(Risk) if arguments.allow == "all" else parse_allow(arguments.allow)
    with get_context("spawn").Pool(arguments.jobs) as pool:
        for text in TARGETS:
            dialect = text.partition("@")[0]
            if arguments.dialect in (None, dialect):
                found = list(
                    pool.imap_unordered(tried, _cases(text, dialect, slice(arguments.at, None, arguments.every), risks))
                )
                _show(dialect, found, arguments.missed)
    return 0


def _cases(text: str, dialect: str, chosen: slice, risks: frozenset[Risk]) -> Iterator[tuple[str, str, frozenset[Risk]]]:
    for fault in on_hardware(dialect)[chosen]:
        yield text, fault, risks


def _show(dialect: str, found: list[Tried], missed: bool) -> None:
    hits = [each for each in found if each.refuted]
    middle = median([each.seconds for each in hits] or [0.0])
    apart = [each for each in hits if "/" not in each.refuted]
    shown = f"{len(hits)} of {len(found)} faults found ({100 * len(hits) / len(found):.0f} %)"
    shown += f", {len(apart)} of them not by a claim" if apart else ""
    print(f"{dialect}: {shown}, half of them within {middle:.0f} s", flush=True)
    if missed:
        print("    missed:", *sorted(each.fault for each in found if not each.refuted))
        print("    not by a claim:", *sorted(f"{e.fault}: {e.refuted}" for e in apart), sep="\n        ")


if __name__ == "__main__":
    sys.exit(main())
