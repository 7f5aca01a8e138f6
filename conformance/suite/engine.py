"""The engine: runs claims on a rig and returns the verdict of each.

It knows no report and no pytest: it yields verdicts, and its callers show them.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from analyzer.catalogue import Certainty
from conformance.claim import Claim, Inconclusive, NotRun, NotStopped, Observed, Outcome, Refuted, RigFault, Verdict
from conformance.gate.gate import Refused
from conformance.suite.confirming import confirmed
from conformance.suite.rig import ClaimRig
from conformance.talk.probe import Probe


def run_claim(claim: Claim, rig: ClaimRig) -> Verdict:
    """Run one claim on a rig and return its verdict.

    Raises LineLost when the port is gone, NotStopped (of `conformance.safety`) when the drive cannot be stopped.
    """
    missing = rig.missing(claim)
    if missing:
        return Verdict(claim, Outcome.NOT_RUN, missing)
    verdict = _once(claim, rig)
    if verdict.outcome is Outcome.REFUTED and not rig.emulated:
        return confirmed(claim, rig, verdict, _once)
    return verdict


def _once(claim: Claim, rig: ClaimRig) -> Verdict:
    probe = rig.probe(claim)
    try:
        verdict = _judge(claim, probe)
    finally:
        # Also when a Ctrl-C breaks in: the end of the run stops and puts back once more, so a second one does no harm.
        left = rig.settle(probe)
    if left and verdict.outcome is Outcome.CONFIRMED:
        return _verdict(claim, probe, Outcome.INCONCLUSIVE, left)
    if left:
        return replace(verdict, reason=f"{verdict.reason} ({left})")
    return verdict


def run(claims: Iterable[Claim], rig: ClaimRig) -> Iterator[Verdict]:
    """Run claims one after the other."""
    for claim in claims:
        yield run_claim(claim, rig)


def _judge(claim: Claim, probe: Probe) -> Verdict:
    try:
        claim.check(probe)
    except Refuted as error:
        outcome = Outcome.OBSERVED if claim.certainty is Certainty.OPEN else Outcome.REFUTED
        return _verdict(claim, probe, outcome, error.text, error)
    except Observed as error:
        return _verdict(claim, probe, Outcome.OBSERVED, str(error))
    except Inconclusive as error:
        return _verdict(claim, probe, Outcome.INCONCLUSIVE, str(error))
    except Refused as error:
        return _verdict(claim, probe, Outcome.NOT_RUN, f"the gate does not let it through: {error}")
    except NotRun as error:
        return _verdict(claim, probe, Outcome.NOT_RUN, str(error))
    except (NotStopped, RigFault):
        raise
    # A claim is code too, perhaps of another package, and a drive may answer what it was not written for.
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        failure = f"a fault of the claim itself: {type(error).__name__}: {error} ({Path(place.filename).name}:{place.lineno})"
        return _verdict(claim, probe, Outcome.INCONCLUSIVE, failure)
    if probe.quirks:
        return _verdict(claim, probe, Outcome.OBSERVED, f"as real drives were seen to do: {', '.join(probe.quirks)}")
    return _verdict(claim, probe, Outcome.CONFIRMED, "")


def _verdict(claim: Claim, probe: Probe, outcome: Outcome, reason: str, error: Refuted | None = None) -> Verdict:
    return Verdict(
        claim,
        outcome,
        reason,
        error.expected if error is not None else "",
        error.got if error is not None else "",
        error.key if error is not None else "",
        error.exchange if error is not None else None,
        tuple(probe.raw),
        tuple(probe.quirks),
        probe.first_ns,
        probe.gate.now_ns(),
        dict(probe.measured),
        {name: tuple(points) for name, points in probe.series.items()},
        tuple(probe.latencies),
        error.steps if error is not None else (),
    )
