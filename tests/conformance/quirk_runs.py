"""Which claims change their verdict when a quirk is installed, and which name it: for the tests of quirks.

python -m tests.conformance.quirk_runs [DIALECT [QUIRK]]      all claims, all quirks: what differs from what should
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

from conformance import claims as registry
from conformance.claim import Claim, Outcome
from conformance.drives import make
from conformance.suite import engine
from conformance.suite.rig_emulated import EmulatedRig
from conformance.talk.probe import ALL_QUIRKS

DIALECTS = ("mks-rs485", "mks-modbus", "mks-can", "lk-rs485")
#: Of the drives with quirks: other ones than those have by which the engine looks what a quirk explains. The first tries
#: each claim; a quirk whose delays are drawn may miss one there, so the others try what it left as it was.
SEED, MORE_SEEDS = 24, (25, 26, 27)
#: Quirks that a listener cannot tell from what the manual has, in these dialects: Modbus echoes a calibration anyway.
UNSEEN = {("mks-modbus", "calibration-answers-1")}


@dataclass
class Changes:
    """What a quirk did: ids of claims that were refuted or inconclusive, and that changed or not against what they name."""

    refuted: list[str] = field(default_factory=list)
    inconclusive: list[str] = field(default_factory=list)
    unnamed: list[str] = field(default_factory=list)
    unmoved: list[str] = field(default_factory=list)
    observed: int = 0

    def __bool__(self) -> bool:
        """Say whether anything is not as it should be."""
        return bool(self.refuted or self.inconclusive or self.unnamed or self.unmoved)


def pairs(dialect: str = "") -> Iterator[tuple[str, str]]:
    """Yield dialect and quirk."""
    for quirk in make.every_quirk():
        for name in quirk.dialects:
            if dialect in ("", name):
                yield name, quirk.name


def run(
    specification: str, wanted: Iterable[Claim] | None = None, accepted: str = ALL_QUIRKS, seed: int = 0
) -> dict[str, engine.Verdict]:
    """Run claims (all, where none are given) on an emulated drive whose quirks are accepted; return the verdicts by id."""
    rig = EmulatedRig(make.parse(specification), seed=seed)
    rig.accepted = frozenset({accepted})
    chosen = registry.every(rig.dialect) if wanted is None else tuple(wanted)
    return {verdict.claim.id: verdict for verdict in engine.run(chosen, rig)}


def changes(dialect: str, quirk: str, wanted: Iterable[Claim], before: Callable[[engine.Verdict], Outcome]) -> Changes:
    """Run claims on a drive with a quirk, and compare each verdict with what its claim comes to `before`, on one without."""
    found = Changes()
    drive = f"{dialect}@1,quirk={quirk}"
    for claim_id, verdict in run(drive, wanted, seed=SEED).items():
        was = before(verdict)
        # A claim that does not name it may meet it all the same: the engine says so, by an emulated drive with the quirk.
        named = quirk in verdict.claim.quirks
        if verdict.outcome is Outcome.REFUTED:
            found.refuted.append(f"{claim_id}: {verdict.reason}")
        elif verdict.outcome is Outcome.INCONCLUSIVE and was is not Outcome.INCONCLUSIVE:
            found.inconclusive.append(f"{claim_id}: {verdict.reason}")
        elif not named and quirk not in verdict.quirks and verdict.outcome is not was:
            found.unnamed.append(f"{claim_id}: {was} before, {verdict.outcome} now: {verdict.reason}")
        elif named and verdict.outcome is not Outcome.OBSERVED and was is not Outcome.NOT_RUN:
            more = (run(drive, [verdict.claim], seed=seed)[claim_id].outcome for seed in MORE_SEEDS)
            if Outcome.OBSERVED not in more:
                found.unmoved.append(f"{claim_id}: {verdict.outcome}")
        found.observed += named and verdict.outcome is Outcome.OBSERVED
    if (dialect, quirk) in UNSEEN:
        found.unmoved.clear()
    return found


def main(arguments: list[str]) -> int:
    """Run everything, and print what differs."""
    dialect, quirk = (*arguments, "", "")[:2]
    wrong = 0
    for name in DIALECTS:
        if dialect not in ("", name):
            continue
        before = run(f"{name}@1")
        for one, each in pairs(name):
            if quirk in ("", each):
                every = [verdict.claim for verdict in before.values()]
                found = changes(one, each, every, lambda verdict, known=before: known[verdict.claim.id].outcome)
                wrong += bool(found)
                print(f"{one} {each}: {found.observed} observed" + (", WRONG" if found else ""), flush=True)
                for word in ("refuted", "inconclusive", "unnamed", "unmoved"):
                    for line in getattr(found, word):
                        print(f"    {word}: {line}")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
