"""The story of a walk: its steps one after the other, and the shortest ones that refute a drive.

    check(probe, steps)             the check of a claim: walk, and refute with the shortest steps that show it
    replay(probe, steps)            the same steps again, on any drive
    shortened(probe, steps, key)    fewer of them that refute a new emulated drive in the same way; both until a time

On an emulated drive a story is shortened here: first its end alone is tried, then steps are taken out, each time on a new
drive. A real drive is not told the same again and again: what it failed by is tried on emulated ones (`suite.engine`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import inf
from time import monotonic
from typing import TYPE_CHECKING

from conformance.claim import Inconclusive, NotRun, Refuted
from conformance.model.steps import Step
from conformance.model.walk import Walk

if TYPE_CHECKING:
    from conformance.talk.probe import Probe

#: How many shorter stories are tried at most; 0: none, where only counts what is refuted.
SHORTER = 40


def replay(probe: Probe, steps: Iterable[Step], until: float = inf) -> Refuted | None:
    """Do steps from the beginning; return what refutes the drive, None where nothing does.

    `until`: seconds on `time.monotonic`. Raises Inconclusive, also where that time is over.
    """
    walk: Walk | None = None
    try:
        walk = Walk(probe)
        for step in steps:
            if monotonic() > until:
                raise Inconclusive("there is no time for more steps")
            walk.do(step)
    except Refuted as error:
        error.steps = tuple(walk.steps) if walk is not None else ()
        return error
    probe.measured["steps"] = len(walk.steps)
    return None


def shortened(probe: Probe, steps: Sequence[Step], key: str, until: float = inf) -> tuple[list[Step], Refuted | None]:
    """Return the shortest steps found, until a time, that refute a new emulated drive alike, and how; None: none does."""
    budget = SHORTER

    def fails(candidate: Sequence[Step]) -> Refuted | None:
        nonlocal budget
        budget -= 1
        fresh = probe.rig.probe(probe.claim)
        try:
            error = replay(fresh, candidate, until)
        except Inconclusive:
            return None  # without the steps that were taken out it cannot be done, or there is no time
        finally:
            probe.rig.settle(fresh)
        return error if error is not None and error.key == key else None

    best, error = list(steps), fails(steps)
    if error is None:
        return best, None
    for size in (1, 4, 16, 64):
        if size < len(best) and (shorter := fails(best[-size:])) is not None:
            best, error = best[-size:], shorter
            break
    size = max(1, len(best) // 2)
    while size and budget > 0 and monotonic() < until:
        at = 0
        while at < len(best) - 1 and budget > 0 and monotonic() < until:
            candidate = best[:at] + best[min(at + size, len(best) - 1) :]
            shorter = fails(candidate) if len(candidate) < len(best) else None
            if shorter is None:
                at += size
            else:
                best, error = candidate, shorter
        size //= 2
    return best, error


def check(probe: Probe, steps: Iterable[Step]) -> None:
    """Walk on a drive. Raises Refuted, if it can with the shortest steps; Inconclusive; NotRun where nothing may be sent."""
    error = replay(probe, steps)
    if error is None:
        if not probe.measured["steps"]:
            raise NotRun("no step may be sent")
        return
    if probe.drive is not None and error.steps and SHORTER:
        found, shorter = shortened(probe, error.steps, error.key)
        if shorter is not None:
            shorter.steps = tuple(found)
            raise shorter from None
    raise error
