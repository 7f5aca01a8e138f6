"""Mutants: the suite held against every drive that is known to be wrong, so that the suite itself is proved.

Each named fault is put into an emulated drive of each dialect that can have it; a claim must refute it. A fault that no
claim refutes has survived: a hole in the suite. Claims that no fault refutes are listed too: perhaps they cannot fail.

In a hurry (`full` False) the claims are tried in an order that puts those first which are about what the fault is
said to break, and the first refutation ends a mutant. In full every claim is run, and all that refute are told.
"""

from __future__ import annotations

import multiprocessing
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import msgspec

from analyzer.catalogue import Dialect
from conformance import engine, suite
from conformance.claim import Claim, Outcome
from conformance.drives import make
from conformance.drives.drive import Fault
from conformance.rig_emulated import EmulatedRig
from conformance.target import EMULATED, Target, parse

if TYPE_CHECKING:
    from conformance.suite import Plan


class Mutant(msgspec.Struct, frozen=True, kw_only=True):
    """What came of one fault in one dialect. `refuted`: ids of the claims that refuted it, with their reasons."""

    fault: str
    dialect: str
    text: str
    breaks: str
    refuted: tuple[tuple[str, str], ...]
    observed: tuple[str, ...] = ()
    inconclusive: int = 0
    seconds: float = 0.0

    @property
    def survived(self) -> bool:
        """Whether no claim refuted it."""
        return not self.refuted


def faults_of(dialect: Dialect) -> list[Fault]:
    """Return the faults that a dialect's drive can have."""
    return [fault for fault in make.every_fault() if dialect.name in fault.dialects]


def judge(target: Target, fault: Fault, claims: Sequence[Claim], *, full: bool = False, seed: int = 0) -> Mutant:
    """Run claims against a drive with a fault, until one refutes it (with `full`: all of them)."""
    assert target.specification is not None  # mutants are emulated
    started = time.perf_counter()
    specification = with_fault(target, fault)
    rig = EmulatedRig(specification, seed=seed)
    refuted, observed, inconclusive = [], [], 0
    for claim in claims if full else _likely_first(claims, fault):
        verdict = engine.run_claim(claim, rig)
        if verdict.outcome is Outcome.REFUTED:
            refuted.append((claim.id, verdict.reason))
            if not full:
                break
        elif verdict.outcome is Outcome.OBSERVED:
            observed.append(claim.id)
        elif verdict.outcome is Outcome.INCONCLUSIVE:
            inconclusive += 1
    return Mutant(
        fault=fault.name,
        dialect=target.dialect.name,
        text=fault.text,
        breaks=fault.breaks,
        refuted=tuple(refuted),
        observed=tuple(observed),
        inconclusive=inconclusive,
        seconds=round(time.perf_counter() - started, 3),
    )


def with_fault(target: Target, fault: Fault) -> make.Specification:
    """Return a target's specification with a fault more."""
    assert target.specification is not None
    return replace(target.specification, faults=(*target.specification.faults, fault))


def _likely_first(claims: Iterable[Claim], fault: Fault) -> list[Claim]:
    """Return claims with those first whose words are those of the fault; the order of the others stays."""
    words = set(fault.name.replace("-", " ").split()) | set(fault.text.lower().split()) | set(fault.breaks.lower().split())

    def distance(claim: Claim) -> int:
        own = set(claim.id.replace("/", " ").replace("_", " ").replace("-", " ").split())
        return -len(own & words)

    return sorted(claims, key=distance)


# --- the command ------------------------------------------------------------------------------------------------------

_work: tuple[tuple[Target, ...], int, bool] | None = None


def _begin(targets: tuple[Target, ...], seed: int, full: bool) -> None:
    global _work
    _work = (targets, seed, full)


def _one(task: tuple[int, str]) -> Mutant:
    assert _work is not None  # every worker begins with `_begin`
    targets, seed, full = _work
    target = targets[task[0]]
    fault = next(f for f in faults_of(target.dialect) if f.name == task[1])
    return judge(target, fault, suite.every_claim(target), full=full, seed=seed)


def mutants(
    targets: Sequence[Target], *, jobs: int = 1, seed: int = 0, full: bool = False, every: int = 1
) -> Iterator[Mutant]:
    """Run every `every`-th fault of the targets' dialects and yield what came of each."""
    tasks = [(i, f.name) for i, target in enumerate(targets) for f in faults_of(target.dialect)][::every]
    if jobs == 1:
        _begin(tuple(targets), seed, full)
        yield from map(_one, tasks)
        return
    methods = multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("fork" if "fork" in methods else "spawn")
    # The claims are made before the workers are forked, so that each has them.
    for target in targets:
        suite.every_claim(target)
    with context.Pool(jobs, _begin, (tuple(targets), seed, full)) as pool:
        yield from pool.imap_unordered(_one, tasks)


def run_mutants(plan: Plan, *, jobs: int = 1, as_json: bool = False, full: bool = False) -> int:
    """Run all mutants of a plan's dialects and print the table; return 1 if one survived."""
    dialects = list(dict.fromkeys(t.dialect.name for t in plan.targets))
    targets = [parse(f"{name}@1", EMULATED) for name in dialects]
    found = []
    total = sum(len(faults_of(t.dialect)) for t in targets)
    for mutant in mutants(targets, jobs=jobs, seed=plan.seed, full=full):
        found.append(mutant)
        if as_json:
            print(msgspec.json.encode(mutant).decode(), flush=True)
        elif sys.stderr.isatty():
            print(f"\r{len(found)} of {total} mutants", end="", file=sys.stderr, flush=True)
    if not as_json:
        _print(found, targets, full)
    return int(any(m.survived for m in found))


def _print(found: Sequence[Mutant], targets: Sequence[Target], full: bool) -> None:
    for target in targets:
        own = [m for m in found if m.dialect == target.dialect.name]
        killed = [m for m in own if not m.survived]
        for mutant in sorted(own, key=lambda m: m.fault):
            first = mutant.refuted[0] if mutant.refuted else None
            more = f" (and {len(mutant.refuted) - 1} more)" if len(mutant.refuted) > 1 else ""
            verdict = f"refuted by {first[0]}{more}: {first[1]}" if first else "SURVIVED"
            print(f"{mutant.dialect}  {mutant.fault}: {verdict}")
        percent = 100 * len(killed) / max(1, len(own))
        print(f"{target.dialect.name}: {len(killed)} of {len(own)} faults refuted ({percent:.1f} %)")
    if full:
        counts = Counter(claim for m in found for claim, _ in m.refuted)
        idle = [c.id for t in targets for c in suite.every_claim(t) if not counts[c.id]]
        print(f"{len(idle)} claims that no fault refutes:")
        for claim in idle:
            print(f"  {claim}")
