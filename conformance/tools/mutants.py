"""Mutants: the suite runs against every known faulty drive, which tests the suite itself.

Each named fault is put into an emulated drive of each dialect that can have it. As few models are used as have all commands.
At least one claim must refute it. A fault that survives is a hole in the suite. Claims that refute no fault are listed too:
perhaps they cannot fail.

A short run (`full` False) tries the likely claims first, by the words of the fault, and the first refutation ends a mutant. A
full run tries every claim and reports all refutations.
"""

from __future__ import annotations

import re
import sys
import time
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import msgspec

from analyzer import dialects as registry
from analyzer.catalogue import Dialect
from conformance.claim import Claim, Outcome
from conformance.drives import make
from conformance.drives.drive import Fault
from conformance.suite import engine, order
from conformance.suite import plan as suite
from conformance.suite.processes import spread
from conformance.suite.rig_emulated import EmulatedRig
from conformance.suite.target import EMULATED, Target, parse, telling_models

if TYPE_CHECKING:
    from conformance.suite.plan import Plan


class Mutant(msgspec.Struct, frozen=True, kw_only=True):
    """What came of one fault in one dialect.

    `refuted`: ids of the claims that refuted it, with their reasons; `on_hardware`: those of them that need no hands on the
    emulated drive. `seen`: those that observed what they do not observe on
    a drive without it: the manual leaves open what the fault changes, or real drives were seen to do so.
    """

    fault: str
    dialect: str
    text: str
    breaks: str
    refuted: tuple[tuple[str, str], ...]
    on_hardware: tuple[str, ...] = ()
    seen: tuple[tuple[str, str], ...] = ()
    inconclusive: int = 0
    seconds: float = 0.0

    @property
    def survived(self) -> bool:
        return not self.refuted and not self.seen


def faults_of(dialect: Dialect) -> list[Fault]:
    """Return the faults that a dialect's drive can have."""
    return [fault for fault in make.every_fault() if dialect.name in fault.dialects]


def judge(
    target: Target, fault: Fault, claims: Sequence[Claim], *, full: bool = False, seed: int = 0, most: int | None = None
) -> Mutant:
    """Run claims against a drive with a fault, until one refutes it (with `full`: all of them).

    `most`: only so many of the claims, those that are likeliest to refute it.
    """
    assert target.specification is not None  # mutants are emulated
    started = time.perf_counter()
    specification = with_fault(target, fault)
    rig = EmulatedRig(specification, seed=seed)
    refuted: list[tuple[str, str]] = []
    on_hardware: list[str] = []
    observed: list[tuple[Claim, str]] = []
    inconclusive = 0
    for claim in claims if full and most is None else _likely_first(claims, fault)[:most]:
        verdict = engine.run_claim(claim, rig)
        if verdict.outcome is Outcome.REFUTED:
            refuted.append((claim.id, verdict.reason))
            on_hardware += [claim.id] * (not claim.emulated)
            if not full:
                break
        elif verdict.outcome is Outcome.OBSERVED:
            observed.append((claim, verdict.reason))
        elif verdict.outcome is Outcome.INCONCLUSIVE:
            inconclusive += 1
    return Mutant(
        fault=fault.name,
        dialect=target.dialect.name,
        text=fault.text,
        breaks=fault.breaks,
        refuted=tuple(refuted),
        on_hardware=tuple(on_hardware),
        seen=() if refuted else tuple(_news(target, observed, seed)),
        inconclusive=inconclusive,
        seconds=round(time.perf_counter() - started, 3),
    )


def _news(target: Target, observed: Iterable[tuple[Claim, str]], seed: int) -> Iterator[tuple[str, str]]:
    """Yield what was observed and is not, on a drive without the fault."""
    assert target.specification is not None
    rig = EmulatedRig(target.specification, seed=seed)
    for claim, reason in observed:
        plain = engine.run_claim(claim, rig)
        if (plain.outcome, plain.reason) != (Outcome.OBSERVED, reason):
            yield claim.id, reason


def with_fault(target: Target, fault: Fault) -> make.Specification:
    """Return a target's specification with a fault more."""
    assert target.specification is not None
    return replace(target.specification, faults=(*target.specification.faults, fault))


def _likely_first(claims: Iterable[Claim], fault: Fault) -> list[Claim]:
    """Return claims with those first whose words are those of the fault; of those alike one of each kind, by id, then a second.

    Claims of one kind often see the same: without turns they would crowd out the others.
    """
    words = set(fault.name.replace("-", " ").split()) | set(fault.text.lower().split()) | set(fault.breaks.lower().split())
    met: Counter[tuple[int, str]] = Counter()
    keys: dict[str, tuple[int, int, str]] = {}
    for claim in sorted(claims, key=lambda claim: claim.id):
        alike = len(words.intersection(re.split("[ /_-]", claim.id)))
        kind = (alike, order.kind(claim))
        met[kind] += 1
        keys[claim.id] = (-alike, met[kind], claim.id)
    return sorted(claims, key=lambda claim: keys[claim.id])


# --- the command ------------------------------------------------------------------------------------------------------

_work: tuple[tuple[Target, ...], int, bool, int | None, frozenset[str]] | None = None


def _begin(targets: tuple[Target, ...], seed: int, full: bool, most: int | None, among: frozenset[str]) -> None:
    global _work
    _work = (targets, seed, full, most, among)


def _one(task: tuple[str, str]) -> Mutant:
    assert _work is not None  # every worker begins with `_begin`
    targets, seed, full, most, among = _work
    found: list[Mutant] = []
    for target in targets:
        if target.dialect.name != task[0]:
            continue
        fault = next(f for f in faults_of(target.dialect) if f.name == task[1])
        claims = [claim for claim in suite.every_claim(target) if not among or claim.id in among]
        found.append(judge(target, fault, claims, full=full, seed=seed, most=most))
        if not full and found[-1].refuted:
            break
    return _together(found)


def _together(found: Sequence[Mutant]) -> Mutant:
    """Return what came of a fault on several models as one."""
    refuted = dict(pair for mutant in reversed(found) for pair in mutant.refuted)
    return msgspec.structs.replace(
        found[0],
        refuted=tuple(refuted.items()),
        on_hardware=tuple(dict.fromkeys(claim for mutant in found for claim in mutant.on_hardware)),
        seen=() if refuted else tuple(dict(pair for mutant in found for pair in mutant.seen).items()),
        inconclusive=sum(m.inconclusive for m in found),
        seconds=round(sum(m.seconds for m in found), 3),
    )


def telling_targets(dialects: Iterable[str]) -> list[Target]:
    """Return a target for each model that is needed to try all commands of some dialects."""
    found = []
    for name in dialects:
        for model in telling_models(registry.get(name)):
            found.append(parse(f"{name}@1" + (f",model={model}" if model else ""), EMULATED))
    return found


def mutants(
    targets: Sequence[Target],
    *,
    jobs: int = 1,
    seed: int = 0,
    full: bool = False,
    every: int = 1,
    only: Sequence[str] = (),
    most: int | None = None,
    among: Collection[str] = (),
) -> Iterator[Mutant]:
    """Run every `every`-th fault of the targets' dialects (or `only` some) and yield what came of each.

    `among`: the ids of the claims that are tried, empty: all.
    """
    names = dict.fromkeys(target.dialect.name for target in targets)
    tasks = [(name, f.name) for name in names for f in faults_of(registry.get(name)) if not only or f.name in only][::every]
    if jobs == 1:
        _begin(tuple(targets), seed, full, most, frozenset(among))
        yield from map(_one, tasks)
        return
    # The claims are made before the workers are forked, so that each has them.
    for target in targets:
        suite.every_claim(target)
    yield from spread(tasks, _one, jobs, _begin, tuple(targets), seed, full, most, frozenset(among))


def run_mutants(plan: Plan, *, jobs: int = 1, as_json: bool = False, full: bool = False) -> int:
    """Run all mutants of a plan's dialects and print the table; return 1 if one survived."""
    from rich.console import Console
    from rich.live import Live

    dialects = list(dict.fromkeys(t.dialect.name for t in plan.targets))
    targets = telling_targets(dialects)
    found: list[Mutant] = []
    total = sum(len(faults_of(registry.get(name))) for name in dialects)
    with Live(
        console=Console(stderr=True, quiet=as_json or not sys.stderr.isatty()), auto_refresh=False, transient=True
    ) as shown:
        for mutant in mutants(targets, jobs=jobs, seed=plan.seed, full=full):
            found.append(mutant)
            shown.update(f"{len(found)} of {total} mutants", refresh=True)
            if as_json:
                print(msgspec.json.encode(mutant).decode(), flush=True)
    if not as_json:
        _print(found, dialects, full=full)
        if full:
            _print_idle(found, targets)
    return int(any(m.survived for m in found))


def _print(found: Sequence[Mutant], dialects: Iterable[str], *, full: bool) -> None:
    for name in dialects:
        own = sorted((m for m in found if m.dialect == name), key=lambda m: m.fault)
        for mutant in own:
            print(f"{mutant.dialect}  {mutant.fault}: {_verdict(mutant, full=full)}")
        refuted, survived = sum(bool(m.refuted) for m in own), sum(m.survived for m in own)
        percent = 100 * refuted / max(1, len(own))
        seen = len(own) - refuted - survived
        print(f"{name}: {refuted} of {len(own)} faults refuted ({percent:.1f} %), {seen} observed, {survived} survived")
        if full:
            twice, on_hardware = sum(len(m.refuted) > 1 for m in own), sum(bool(m.on_hardware) for m in own)
            print(f"{name}: {twice} refuted by two claims or more, {on_hardware} by one that runs on hardware")


def _verdict(mutant: Mutant, *, full: bool) -> str:
    """Return what came of a fault; with `full` every claim was tried, so that their number says something."""
    noticed = mutant.refuted or mutant.seen
    if not noticed:
        return "SURVIVED"
    (claim, reason), more = noticed[0], len(noticed) - 1
    if full and mutant.refuted:
        hands = f"{len(mutant.on_hardware)} on hardware" if mutant.on_hardware else "none on hardware"
        return f"refuted by {len(mutant.refuted)} claims, {hands}; by {claim}: {reason}"
    word = "refuted" if mutant.refuted else "observed (the manual leaves it open, or real drives were seen so)"
    return f"{word} by {claim}{f' (and {more} more)' if more else ''}: {reason}"


def _print_idle(found: Sequence[Mutant], targets: Sequence[Target]) -> None:
    counts = Counter(claim for m in found for claim, _ in m.refuted)
    idle = dict.fromkeys(c.id for t in targets for c in suite.every_claim(t) if not counts[c.id])
    print(f"{len(idle)} claims that no fault refutes:")
    for claim in idle:
        print(f"  {claim}")
