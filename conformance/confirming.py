"""A refutation on a real drive is repeated before it is told, and a long one shortened.

First the claim runs once more: a drive that fails once of two times is refuted too, and the reason says so. Where the claim
was a sequence of steps (a state machine), an emulated drive is given the same steps; where they refute it in the same way,
they are shortened there, which costs no motion, and what is left is confirmed on the real drive.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from conformance.claim import Claim, Inconclusive, Outcome, Refuted, Verdict
from conformance.drives import make
from conformance.rig import Rig

Once = Callable[[Claim, Rig], Verdict]


def confirmed(claim: Claim, rig: Rig, verdict: Verdict, once: Once) -> Verdict:
    """Return the verdict of a refuted claim after it was repeated. `once` runs a claim and settles the rig."""
    again = once(claim, rig)
    if again.outcome is not Outcome.REFUTED:
        return replace(verdict, reason=f"{verdict.reason} (1 of 2 times; the other time {again.outcome}: {again.reason})")
    shorter = _shortened(claim, rig, verdict) if verdict.steps else None
    if shorter is not None:
        return replace(shorter, reason=f"{shorter.reason} (2 of 2 times; {len(shorter.steps)} of {len(verdict.steps)} steps)")
    return replace(verdict, reason=f"{verdict.reason} (2 of 2 times)")


def _shortened(claim: Claim, rig: Rig, verdict: Verdict) -> Verdict | None:
    """Return the verdict of the shortest steps that refute both drives alike, None where there are none."""
    from conformance import machine
    from conformance.rig_emulated import EmulatedRig

    model = f",model={rig.model}" if rig.model else ""
    emulated = EmulatedRig(make.parse(f"{rig.dialect.name}@{rig.address}{model}"))
    steps, found = machine.shortened(emulated.probe(claim), verdict.steps, verdict.key)
    if found is None or len(steps) >= len(verdict.steps):
        return None
    probe = rig.probe(claim)
    try:
        error = machine.replay(probe, steps)
    except Inconclusive:
        return None
    finally:
        rig.settle(probe)
    return _of(verdict, error, tuple(steps)) if error is not None and error.key == verdict.key else None


def _of(verdict: Verdict, error: Refuted, steps: tuple[object, ...]) -> Verdict:
    return replace(verdict, reason=error.text, expected=error.expected, got=error.got, exchange=error.exchange, steps=steps)
