"""A dry run: all that a run would send, without a port. An emulated drive in virtual time stands in for the real one.

Other answers can lead to other requests. The list therefore holds for a drive that follows the manual, with a person at hand
and no other drive on the bus.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from analyzer.catalogue import Risk, Role
from analyzer.errors import UsageError
from analyzer.records import CanFrame, Chunk
from analyzer.values import counted
from conformance.bus.emulated import EmulatedLine
from conformance.bus.line import Line
from conformance.claim import Outcome
from conformance.drives import make
from conformance.gate.gate import Gate, Judge
from conformance.gate.permissions import Allowance
from conformance.suite import engine
from conformance.suite import plan as suite
from conformance.suite.rig import ClaimRig
from conformance.suite.rig_real import RealRig
from conformance.suite.target import Target
from conformance.talk.exchange import hex_of

if TYPE_CHECKING:
    from conformance.drives.make import Specification
    from conformance.safety.journal import Journal
    from conformance.suite.plan import Plan

Item = bytes | CanFrame
_texts: dict[bytes | tuple[int, bytes], str] = {}


class StandInRig(RealRig):
    """A rig by the rules of a real drive, on a line to an emulated one, without a guard and a journal.

    It is the whole run: the search for the drive and its neighbours, each setting read, changed and put back, each stop with
    its proof, and each wait. `specification`: the emulated drive in place of the target's; one as the manual has it by default.
    """

    def __init__(self, plan: Plan, target: Target, specification: Specification | None = None) -> None:
        model = f",model={target.model}" if target.model else ""
        self._specification = specification or make.parse(f"{target.dialect.name}@{target.address}{model}")
        super().__init__(plan, target)

    def _open_line(self) -> Line:
        line = EmulatedLine([make.make(self._specification)])
        # Its flash counts as one that wears.
        line.emulated = False
        return line

    def _open_journal(self) -> Journal | None:
        return None


class _Listed(StandInRig):
    """A rig that stands in for the real one. `left`: what left since it was last taken."""

    def __init__(self, plan: Plan, target: Target) -> None:
        self.left: list[Item] = []
        super().__init__(plan, target)

    def _open_gate(self) -> Gate:
        gate = super()._open_gate()
        gate.on_sent.append(lambda t_ns, item: self.left.append(item))
        return gate

    def taken(self) -> list[Item]:
        """Return what left, and forget it."""
        left, self.left[:] = list(self.left), []
        return left


def dry_run(plan: Plan) -> int:
    """Print what would be sent, claim by claim; return 0. Raises UsageError where no emulated drive can stand in."""
    for target in plan.targets:
        name = target.dialect.name
        if not target.emulated and name not in make.KINDS:
            raise UsageError(f"a dry run needs an emulated drive in place of the real one, and no emulated drive speaks {name}")
    for target in plan.targets:
        print(f"{target.text} on {target.on}: what would be sent (to a drive as the manual has it)")
        rig = suite.open_rig(plan, target) if target.emulated else _Listed(plan, target)
        try:
            ran, skipped, frames = _claims(plan, target, rig)
        finally:
            rig.close()
        print(f"{target.text}: {ran} claims would send {frames} frames; {skipped} would not run")
    return 0


def _claims(plan: Plan, target: Target, rig: ClaimRig) -> tuple[int, int, int]:
    judge = Judge(Allowance(frozenset(Risk), alone=True))
    ran = skipped = frames = 0
    #: What came by already: claims share exchanges, which a run makes once. It is kept, for an id is one while it lives.
    listed: dict[int, Chunk | CanFrame] = {}
    asked: set[int] = set()
    if isinstance(rig, _Listed):
        frames += _list("before the first claim", rig.taken(), judge)
    for claim in plan.selected(target):
        verdict = engine.run_claim(claim, rig)
        # Hundreds of claims can share the traffic of as many.
        ids = set(map(id, verdict.traffic))
        shared, new = len(ids & asked), ids - listed.keys()
        fresh = {id(item): item for item in verdict.traffic if id(item) in new} if new else {}
        listed |= fresh
        traffic = [item for item in fresh.values() if item.direction is Role.REQUEST]
        asked.update(map(id, traffic))
        sent = rig.taken() if isinstance(rig, _Listed) else [i if isinstance(i, CanFrame) else i.data for i in traffic]
        if verdict.outcome is Outcome.NOT_RUN and not sent:
            skipped += 1
            print(f"{claim.id}: not run: {verdict.reason}")
            continue
        ran += 1
        frames += _list(claim.id, sent, judge)
        if shared:
            print(f"    and {counted(shared, 'frame')} of claims above, sent once for all of them")
        if verdict.outcome is Outcome.NOT_RUN:
            print(f"    and then no more: {verdict.reason}")
    return ran, skipped, frames


def _list(what: str, sent: list[Item], judge: Judge) -> int:
    print(f"{what}: {len(sent)} frames")
    for item in sent:
        print(f"    {_shown(judge, item)}")
    return len(sent)


def _shown(judge: Judge, item: Item) -> str:
    """Return a frame, what it is and what it may do; most frames of a run are the same few."""
    key = (item.id, item.data) if isinstance(item, CanFrame) else item
    if key not in _texts:
        _texts[key] = _text(judge, item)
    return _texts[key]


def _text(judge: Judge, item: Item) -> str:
    readings = judge.interpret(item)
    risks = sorted({risk.value for reading in readings for risk in reading.risks})
    names = dict.fromkeys(r.command.name if r.command is not None else "unknown" for r in readings if r.fits)
    return f"{hex_of(item)}   {' '.join(names)}  [{','.join(risks) or 'nothing that can be read'}]"
