"""A dry run: all that a run would send, without a port. An emulated drive stands in for the real one.

A real drive's answers may lead a claim elsewhere, so what is listed is what would be sent to a drive as the manual has it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from analyzer.catalogue import Risk, Role
from analyzer.records import CanFrame, Chunk
from conformance import engine
from conformance.allowance import READS, Allowance
from conformance.claim import Claim
from conformance.drives import make
from conformance.exchange import hex_of
from conformance.gate import Judge
from conformance.rig_emulated import EmulatedRig
from conformance.safety import settings
from conformance.safety.keeper import Keeper
from conformance.target import Target

if TYPE_CHECKING:
    from conformance.suite import Plan


class _StandIn(EmulatedRig):
    """An emulated drive under the rules of a real one."""

    def __init__(self, plan: Plan, target: Target) -> None:
        given = plan.allowance or Allowance(READS)
        name = ",".join([f"{target.dialect.name}@{target.address}"] + [f"model={target.model}"] * bool(target.model))
        super().__init__(
            make.parse(name), seed=plan.seed, allowance=replace(given, addresses=frozenset({target.address}))
        )
        self.emulated = target.emulated
        self.named = frozenset(plan.claims)
        self._known = settings.known(self.dialect, self.name, plan.settings)

    def missing(self, claim: Claim) -> str:
        """Return why a claim would not run."""
        told = super().missing(claim)
        if told or self.emulated:
            return told
        self.probe(claim)
        return Keeper(self.gate, self.dialect, self.address, self._known, None).why_not(claim.settings)


def dry_run(plan: Plan) -> int:
    """Print what would be sent, claim by claim; return 0."""
    for target in plan.targets:
        rig = _StandIn(plan, target)
        judge = Judge(Allowance(frozenset(Risk), alone=True))
        ran = skipped = frames = 0
        print(f"{target.text} on {target.on}: what would be sent (to a drive as the manual has it)")
        for claim in plan.selected(target):
            missing = rig.missing(claim)
            if missing:
                skipped += 1
                print(f"{claim.id}: not run: {missing}")
                continue
            verdict = engine.run_claim(claim, rig)
            sent = [item for item in verdict.traffic if item.direction is Role.REQUEST]
            ran += 1
            frames += len(sent)
            print(f"{claim.id}: {len(sent)} frames")
            for item in sent:
                print(f"    {_shown(judge, item)}")
        print(f"{target.text}: {ran} claims would send {frames} frames; {skipped} would not run")
    return 0


def _shown(judge: Judge, item: Chunk | CanFrame) -> str:
    leaving = item if isinstance(item, CanFrame) else item.data
    readings = judge.read(leaving)
    risks = sorted({risk.value for reading in readings for risk in reading.risks})
    names = dict.fromkeys(r.command.name if r.command is not None else "unknown" for r in readings if r.sound)
    return f"{hex_of(leaving)}   {' '.join(names)}  [{','.join(risks) or 'nothing that can be read'}]"


