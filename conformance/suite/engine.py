"""The engine: runs claims on a rig and returns the verdict of each. Its callers show them.

A refutation on a real drive is repeated before it is reported: a drive that fails once of two times is refuted too, and the
reason says so. Where the claim was a sequence of steps (a walk), emulated drives are given the same steps: one as the
manual has it, and one with each known fault. Where the steps refute one of them in the same way, they are shortened there,
which costs no motion. What is left is confirmed on the real drive.

A line may damage what it carries, and what a claim then takes for the drive's doing. So a claim that comes to nothing is tried
again. So is one that refutes while something came damaged or was not answered, also on an emulated drive: its refutation counts
where it comes again without damage, or each time alike. Once a line has been seen to lose something, each refutation has to
come alike as often: nothing tells whether a request to all drives came.

A user's settings may spoil a claim that was written for others. A claim that refutes a drive is therefore tried on ideal
drives. These have the drive's settings where they are known, and likely ones where not. If the claim refutes an ideal drive
too, it is inconclusive and says what to set.

A known quirk may spoil a claim that does not name it. So the claim is tried on emulated drives that follow the manual except
for the quirks that the real drive has shown. If it refutes one of them in the same way, the quirk is named as the reason.
"""

from __future__ import annotations

import re
import time
import traceback
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from analyzer.catalogue import Certainty, Risk
from analyzer.plugins import is_failure, reason
from conformance import claims as registry
from conformance.claim import Claim, Inconclusive, NotRun, NotStopped, Observed, Outcome, Refuted, RigFault, Theme, Verdict
from conformance.claims.known_quirks import LATE
from conformance.drives import make
from conformance.drives.drive import Quirk
from conformance.gate.gate import Refused
from conformance.safety.stopping import MAY_MOVE
from conformance.suite import set_otherwise
from conformance.suite.rig import ClaimRig
from conformance.talk.probe import Probe, Rig

#: How long a run may search for emulated drives that fail alike, all refutations together: a user waits meanwhile.
_SEARCH_SECONDS = 30.0
#: Claims that judge the bytes of replies alone, not the shaft.
_OF_BYTES = (Theme.SHAPE, Theme.FRAMING, Theme.TRAFFIC)
#: A quirk that spoils claims which do not name it, the claim that shows it, and the least delay that it causes.
_SHOWS_LATE, _LATE_NS = "timing/read_speed/while-moving", 100_000_000
#: How many emulated drives with a quirk are tried: what a quirk does may depend on chance.
_SEEDS = 6
#: How often a refutation has to come alike where the line damaged something each time, or loses requests.
_ALIKE = 3
#: What is tried again where the line damaged something.
_AGAIN = (Outcome.REFUTED, Outcome.INCONCLUSIVE)
#: What is said of a refutation that did not come again.
ONCE = "1 of 2 times"


def run_claim(claim: Claim, rig: ClaimRig) -> Verdict:
    """Run one claim on a rig and return its verdict.

    Raises LineLost when the port is gone, NotStopped when the drive cannot be stopped.
    """
    missing = rig.missing(claim)
    if missing:
        return Verdict(claim, Outcome.NOT_RUN, missing)
    verdict = _unless_damaged(claim, rig, _once(claim, rig))
    if verdict.outcome is Outcome.REFUTED and not rig.emulated:
        verdict = _confirmed(claim, rig, verdict)
    if claim.hasty and verdict.outcome is Outcome.CONFIRMED:
        rig.drop_write_gap()
    rig.shown |= set(verdict.quirks)
    return _unless_set_otherwise(claim, rig, _explained(claim, rig, verdict))


def _once(claim: Claim, rig: ClaimRig) -> Verdict:
    try:
        probe = rig.probe(claim)
    except NotRun as error:
        return Verdict(claim, Outcome.NOT_RUN, str(error))
    try:
        verdict = _judge(claim, probe)
    finally:
        # Also when a Ctrl-C breaks in: the end of the run stops and puts back once more, so a second one does no harm.
        left = rig.settle(probe)
    rig.still_there()
    if left and verdict.outcome is Outcome.CONFIRMED:
        return _verdict(claim, probe, Outcome.INCONCLUSIVE, left)
    if left:
        return replace(verdict, reason=f"{verdict.reason} ({left})")
    return verdict


def run(claims: Iterable[Claim], rig: ClaimRig) -> Iterator[Verdict]:
    """Run claims one after the other."""
    for claim in claims:
        yield run_claim(claim, rig)


def prove_reads(claims: Iterable[Claim], rig: ClaimRig) -> Iterator[Verdict]:
    """Run the claims about the reads on which safety rests; where one is refuted, nothing that moves is sent afterwards.

    Without these reads no stop could be proved, and the drive's fault would show as a motor that does not stop.
    """
    for claim in claims:
        verdict = run_claim(claim, rig)
        if verdict.outcome is Outcome.REFUTED and ONCE not in verdict.reason:
            rig.forbid_motion(f"{claim.id} is refuted, and by that read a shaft is proved to stand")
        yield verdict


def _judge(claim: Claim, probe: Probe) -> Verdict:
    if probe.noise.hindrance and claim.risks & MAY_MOVE and claim.theme not in _OF_BYTES:
        return _verdict(claim, probe, Outcome.INCONCLUSIVE, probe.noise.hindrance)
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
    except BaseException as error:
        # A run that a claim ends would have no verdict, and perhaps the status of one that did well.
        if isinstance(error, KeyboardInterrupt) or not is_failure(error):
            raise
        place = traceback.extract_tb(error.__traceback__)[-1]
        failure = f"a fault of the claim itself: {reason(error)} ({Path(place.filename).name}:{place.lineno})"
        return _verdict(claim, probe, Outcome.INCONCLUSIVE, failure)
    confirmed = _verdict(claim, probe, Outcome.CONFIRMED, "")
    return _of_quirks(confirmed, probe.rig, probe.quirks) if probe.quirks else confirmed


def _of_quirks(verdict: Verdict, rig: Rig, quirks: Sequence[str]) -> Verdict:
    """Return the verdict of a claim that met known quirks: they are deviations from the manual, unless all are accepted."""
    claim = verdict.claim
    named = "; ".join(f"{q.name} ({q.text})" for q in make.every_quirk() if q.name in quirks)
    accepted = rig.accepts(quirks)
    outcome = Outcome.OBSERVED if accepted or claim.certainty is Certainty.OPEN else Outcome.REFUTED
    text = f"{'accepted' if accepted else 'known'} quirk of real drives: {named}"
    if outcome is Outcome.OBSERVED:
        return replace(_not_refuted(verdict, outcome, text), quirks=tuple(quirks))
    expected, got = verdict.expected or claim.statement, verdict.got or named
    key, quirks = " ".join(quirks), tuple(quirks)
    return replace(verdict, outcome=outcome, reason=text, expected=expected, got=got, key=key, quirks=quirks)


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
        probe.last_ns,
        dict(probe.measured),
        dict(probe.series),
        tuple(probe.latencies),
        error.steps if error is not None else (),
        any(exchange.damaged or probe.rig.has_lost(exchange) for exchange in probe.traffic),
    )


def _not_refuted(verdict: Verdict, outcome: Outcome, reason: str) -> Verdict:
    """Return a verdict whose refutation counts for nothing."""
    return replace(verdict, outcome=outcome, reason=reason, expected="", got="", key="", exchange=None, steps=())


# --- a refutation on a line that damages replies ----------------------------------------------------------------------


def _times(rig: ClaimRig, verdict: Verdict) -> int:
    """Return how often a claim is begun that has come to a verdict."""
    rig.loses = rig.loses or verdict.damaged
    # A request to which no reply is due may have been lost unseen.
    again = _AGAIN if verdict.damaged else (Outcome.REFUTED,) if rig.loses else ()
    return _ALIKE if verdict.outcome in again else 1


def _unless_damaged(claim: Claim, rig: ClaimRig, verdict: Verdict) -> Verdict:
    """Return the verdict of a claim, tried again where it refutes or comes to nothing and the line damaged something."""
    tried = [verdict]
    while not claim.of_line and len(tried) < _times(rig, verdict):
        # It is done again, not looked at again.
        rig.recordings.clear()
        with rig.trying_again(len(tried)):
            verdict = _once(claim, rig)
        verdict = replace(verdict, measured={**verdict.measured, "attempts": len(tried) + 1})
        if verdict.outcome is Outcome.REFUTED and any(each.key != verdict.key for each in tried if each.key):
            break
        tried.append(verdict)
    if verdict.outcome is Outcome.REFUTED and verdict.damaged and any(each.key != verdict.key for each in tried):
        seen = "; ".join(dict.fromkeys(each.reason for each in (*tried, verdict)))
        text = f"the line damages replies, and each time something else is seen: {seen}"
        return _not_refuted(verdict, Outcome.INCONCLUSIVE, text)
    return verdict


# --- a refutation on a real drive -------------------------------------------------------------------------------------


def _confirmed(claim: Claim, rig: ClaimRig, verdict: Verdict) -> Verdict:
    """Return the verdict of a refuted claim after it was repeated."""
    # It is done again, not looked at again.
    rig.recordings.clear()
    again = _once(claim, rig)
    if again.outcome is not Outcome.REFUTED:
        return replace(verdict, reason=f"{verdict.reason} ({ONCE}; the other time {again.outcome}: {again.reason})")
    shorter = _shortened(claim, rig, verdict) if verdict.steps else None
    if shorter is not None:
        return replace(shorter, reason=f"{shorter.reason} (2 of 2 times; {len(shorter.steps)} of {len(verdict.steps)} steps)")
    return replace(verdict, reason=f"{verdict.reason} (2 of 2 times)")


def _shortened(claim: Claim, rig: ClaimRig, verdict: Verdict) -> Verdict | None:
    """Return the verdict of the shortest steps that refute both drives alike, None where there are none."""
    from conformance.model import story

    steps, begun = list(verdict.steps), time.monotonic()
    until = begun + _SEARCH_SECONDS - rig.searched
    for emulated in _alike(rig, verdict.key, until):
        steps, found = story.shortened(emulated.probe(claim), verdict.steps, verdict.key, until)
        if found is not None:
            break
    rig.searched += time.monotonic() - begun
    if len(steps) >= len(verdict.steps):
        return None
    probe = rig.probe(claim)
    try:
        error = story.replay(probe, steps)
    except Inconclusive:
        return None
    finally:
        rig.settle(probe)
    return _of(verdict, error, tuple(steps)) if error is not None and error.key == verdict.key else None


def _alike(rig: ClaimRig, key: str, until: float) -> Iterator[ClaimRig]:
    """Yield emulated drives that may fail as the real one does, until a time.

    Those whose fault has words of the failure come first.
    """
    if rig.dialect.name not in make.KINDS:
        return
    from conformance.suite.rig_emulated import EmulatedRig

    plain = _as_the_manual(rig)
    if time.monotonic() < until:
        yield EmulatedRig(plain)
    words = set(re.findall("[a-z0-9]+", key))
    for fault in sorted(make.every_fault(), key=lambda fault: -len(words & set(fault.name.split("-")))):
        if time.monotonic() > until:
            return
        if fault.dialects and rig.dialect.name in fault.dialects:
            yield EmulatedRig(replace(plain, faults=(fault,)))


def _as_the_manual(rig: ClaimRig) -> make.Specification:
    """Return the emulated drive that is like the one of a rig and has no faults."""
    model = f",model={rig.model}" if rig.model else ""
    return make.parse(f"{rig.dialect.name}@{rig.address}{model}")


def _of(verdict: Verdict, error: Refuted, steps: tuple[object, ...]) -> Verdict:
    return replace(verdict, reason=error.text, expected=error.expected, got=error.got, exchange=error.exchange, steps=steps)


# --- what the drive's settings explain --------------------------------------------------------------------------------


def _unless_set_otherwise(claim: Claim, rig: ClaimRig, verdict: Verdict) -> Verdict:
    """Return the verdict of a claim; where it refutes an ideal drive with the same settings too, an inconclusive one."""
    if verdict.outcome is not Outcome.REFUTED or verdict.quirks:
        return verdict
    from conformance.suite.rig_emulated import EmulatedRig

    begun = time.monotonic()
    for held in set_otherwise.every(rig):
        searched = 0.0 if rig.emulated else rig.searched + time.monotonic() - begun
        if not held.known and (claim.risks <= {Risk.READ} or searched > _SEARCH_SECONDS):
            # What is only read of a shaft at rest does not depend on what else is stored.
            break
        if held not in rig.set_alike:
            rig.set_alike[held] = EmulatedRig(_as_the_manual(rig), seed=rig.seed, settings=dict(held.values))
        found = _once(claim, rig.set_alike[held])
        if found.outcome is Outcome.REFUTED and (held.known or found.key == verdict.key):
            text = (
                f"the drive is set to {held}, and this claim refutes an ideal drive that is set so"
                if held.known
                else f"a drive with {held} does so too: say in --settings FILE what it is set to"
            )
            verdict = _not_refuted(verdict, Outcome.INCONCLUSIVE, f"{text} ({verdict.reason})")
            break
    rig.searched += time.monotonic() - begun
    return verdict


# --- what a known quirk explains --------------------------------------------------------------------------------------


def _explained(claim: Claim, rig: ClaimRig, verdict: Verdict) -> Verdict:
    """Return the verdict of a claim; where only a quirk that the drive has shown is to blame, the verdict of that quirk.

    A claim that comes to nothing is one of the quirk where the user accepts it, and stays inconclusive where not.
    """
    settled = verdict.quirks or verdict.outcome not in (Outcome.REFUTED, Outcome.INCONCLUSIVE)
    if settled or rig.dialect.name not in make.KINDS:
        return verdict
    if any(ns > _LATE_NS for _, ns in verdict.latencies):
        _look_whether_late(claim, rig)
    shown = [quirk for quirk in make.every_quirk() if quirk.name in rig.shown and rig.dialect.name in quirk.dialects]
    every = [(quirk,) for quirk in shown] + [tuple(shown)] * (len(shown) > 1)
    for quirks in every:
        names = [quirk.name for quirk in quirks]
        if verdict.outcome is Outcome.INCONCLUSIVE and not rig.accepts(names):
            continue
        if _come_to_the_same(claim, rig, verdict, quirks):
            return _of_quirks(verdict, rig, names)
    return verdict


def _look_whether_late(claim: Claim, rig: ClaimRig) -> None:
    """Run the claim that shows whether replies are late while the motor turns, once in a run."""
    shows = next((c for c in registry.every(rig.dialect) if c.id.endswith(_SHOWS_LATE)), None)
    if shows is not None and shows is not claim and LATE not in rig.looked_for:
        rig.looked_for.add(LATE)
        run_claim(shows, rig)


def _come_to_the_same(claim: Claim, rig: ClaimRig, verdict: Verdict, quirks: tuple[Quirk, ...]) -> bool:
    """Say whether a claim gives the same verdict on a drive that has these quirks alone."""
    from conformance.suite.rig_emulated import EmulatedRig

    specification = replace(_as_the_manual(rig), quirks=quirks)
    found = (_once(claim, EmulatedRig(specification, seed=seed)) for seed in range(_SEEDS))
    return any(each.outcome is verdict.outcome and each.key == verdict.key for each in found)
