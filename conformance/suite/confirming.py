"""A refutation on a real drive is repeated before it is reported, and a long one shortened.

First the claim runs once more: a drive that fails once of two times is refuted too, and the reason says so. Where the claim
was a sequence of steps (a state machine), emulated drives are given the same steps: one as the manual has it, and one with
each known fault. Where the steps refute one of them in the same way, they are shortened there, which costs no motion, and
what is left is confirmed on the real drive.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

from conformance.claim import Claim, Inconclusive, Outcome, Refuted, Verdict
from conformance.drives import make
from conformance.suite.rig import ClaimRig

#: How long emulated drives are looked for that fail alike.
_SEARCH_SECONDS = 20.0

Once = Callable[[Claim, ClaimRig], Verdict]


def confirmed(claim: Claim, rig: ClaimRig, verdict: Verdict, once: Once) -> Verdict:
    """Return the verdict of a refuted claim after it was repeated. `once` runs a claim and settles the rig."""
    again = once(claim, rig)
    if again.outcome is not Outcome.REFUTED:
        return replace(verdict, reason=f"{verdict.reason} (1 of 2 times; the other time {again.outcome}: {again.reason})")
    shorter = _shortened(claim, rig, verdict) if verdict.steps else None
    if shorter is not None:
        return replace(shorter, reason=f"{shorter.reason} (2 of 2 times; {len(shorter.steps)} of {len(verdict.steps)} steps)")
    return replace(verdict, reason=f"{verdict.reason} (2 of 2 times)")


def _shortened(claim: Claim, rig: ClaimRig, verdict: Verdict) -> Verdict | None:
    """Return the verdict of the shortest steps that refute both drives alike, None where there are none."""
    from conformance.model import machine

    steps = list(verdict.steps)
    for emulated in _alike(rig):
        steps, found = machine.shortened(emulated.probe(claim), verdict.steps, verdict.key)
        if found is not None:
            break
    if len(steps) >= len(verdict.steps):
        return None
    probe = rig.probe(claim)
    try:
        error = machine.replay(probe, steps)
    except Inconclusive:
        return None
    finally:
        rig.settle(probe)
    return _of(verdict, error, tuple(steps)) if error is not None and error.key == verdict.key else None


def _alike(rig: ClaimRig) -> Iterator[ClaimRig]:
    """Return emulated drives that may fail as the real one does, for as long as there is time for it."""
    if rig.dialect.name not in make.KINDS:
        return
    from conformance.suite.rig_emulated import EmulatedRig

    until = time.monotonic() + _SEARCH_SECONDS
    model = f",model={rig.model}" if rig.model else ""
    plain = make.parse(f"{rig.dialect.name}@{rig.address}{model}")
    yield EmulatedRig(plain)
    for fault in make.every_fault():
        if time.monotonic() > until:
            return
        if fault.dialects and rig.dialect.name in fault.dialects:
            yield EmulatedRig(replace(plain, faults=(fault,)))


def _of(verdict: Verdict, error: Refuted, steps: tuple[object, ...]) -> Verdict:
    return replace(verdict, reason=error.text, expected=error.expected, got=error.got, exchange=error.exchange, steps=steps)
