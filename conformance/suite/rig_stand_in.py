"""A rig by the rules of a real drive, on a line to an emulated one in virtual time, without a guard and a journal.

It is the whole run on an emulated line: the search for the drive and its neighbours, each setting read, changed and put
back, each stop with its proof, and each wait. So the frames of a run are known without a port, and its time without a wait.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from conformance.bus.emulated import EmulatedLine
from conformance.bus.line import Line
from conformance.drives import make
from conformance.suite.rig_real import RealRig

if TYPE_CHECKING:
    from conformance.drives.make import Specification
    from conformance.safety.journal import Journal
    from conformance.suite.plan import Plan
    from conformance.suite.target import Target


class StandInRig(RealRig):
    """`specification`: the emulated drive in place of the target's; one as the manual has it by default."""

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
