"""A rig with a drive on a real port: the port is a guard's, and what claims change is put back.

After each claim the drive is stopped, if the claim may have moved it, and proved to stand; then its settings are put back,
so that each claim finds the drive as the one before found it.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from analyzer.catalogue import Risk
from analyzer.errors import ServotapError
from analyzer.records import CanFrame
from conformance.allowance import READS, Allowance
from conformance.claim import Claim
from conformance.gate import Gate
from conformance.line import LineLost
from conformance.preflight import check
from conformance.probe import Probe
from conformance.rig import Rig
from conformance.safety import settings
from conformance.safety.bare import bare_probe
from conformance.safety.guarded import GuardedLine
from conformance.safety.journal import Entry, Journal
from conformance.safety.keeper import Keeper
from conformance.safety.messages import Begin, Drive
from conformance.safety.stopping import stop_or_cut
from conformance.target import Target

if TYPE_CHECKING:
    from conformance.suite import Plan

#: Risks that may set a shaft in motion.
_MOVING = frozenset({Risk.MOTION, Risk.UNBOUNDED, Risk.POWER_ON})


class RealRig(Rig):
    """A drive on a real port. Raises UsageError where the port cannot be opened, DriveNotFound where nobody answers."""

    emulated = False

    def __init__(self, plan: Plan, target: Target) -> None:
        assert target.endpoint is not None  # a target without one is emulated
        self.name = f"{target.dialect.name}@{target.address}"
        self.model = target.model
        self.dialect = target.dialect.for_model(target.model) if target.model else target.dialect
        self.address = target.address
        given = plan.allowance or Allowance(READS)
        self._allowance = replace(given, addresses=frozenset({self.address}))
        self.allowed = self._allowance.risks
        self.alone = self._allowance.alone
        self.named = frozenset(plan.claims)
        self._power = plan.cut_power
        known = settings.known(self.dialect, self.name, plan.settings)
        if self._allowance.subdivision is None and "subdivision" in known:
            # What the user says the drive is set to also says how fast a speed is.
            self._allowance = replace(self._allowance, subdivision=known["subdivision"] or 256)
        self._journal = self._open_journal(plan) if Risk.SETTING in self.allowed else None
        try:
            self._line = GuardedLine(target.endpoint, self._begin(target))
        except ServotapError:
            self._end_journal(clean=True)
            raise
        self.gate = Gate(self._line, self._allowance)
        self.byte_ns = target.endpoint.byte_ns
        self.keeper = Keeper(self.gate, self.dialect, self.address, known, self._journal, target.endpoint.text)
        self._moved = False
        self._closed = False
        try:
            self.firmware = check(self.gate, self.dialect, self.address, alone=self.alone)
        except ServotapError:
            self.close()
            raise

    def _begin(self, target: Target) -> Begin:
        allowance = self._allowance
        assert target.endpoint is not None
        return Begin(
            target.endpoint.text,
            (Drive(self.dialect.name, self.model, self.address),),
            tuple(sorted(risk.value for risk in allowance.risks)),
            allowance.speed,
            allowance.turns,
            allowance.acceleration,
            allowance.current,
            allowance.subdivision,
            allowance.alone,
            journal="" if self._journal is None else str(self._journal.path),
            cut_power=self._power,
        )

    def _open_journal(self, plan: Plan) -> Journal:
        path = plan.journal or f"servotap-{self.name.replace('@', '-')}-{time.strftime('%Y%m%d-%H%M%S')}.journal"
        return Journal(Path(path))

    def _end_journal(self, *, clean: bool) -> None:
        if self._journal is None:
            return
        if not clean:
            print(
                f"servotap: {self._journal.path} says what was not put back: servotap restore {self._journal.path}",
                file=sys.stderr,
            )
        self._journal.close(remove=clean)

    # --- claims -------------------------------------------------------------------------------------------------------

    def missing(self, claim: Claim) -> str:
        """Return why a claim cannot run here, or nothing."""
        return super().missing(claim) or self.keeper.why_not(claim.settings)

    def probe(self, claim: Claim) -> Probe:
        """Return a probe of the drive."""
        return Probe(self, claim)

    def before_send(self, item: bytes | CanFrame) -> None:
        """Keep what an item is about to change, and know that it may move the motor."""
        readings = self.gate.judge(item)
        self.keeper.before(readings)
        if any(reading.risks & _MOVING for reading in readings):
            self._moved = True

    def settle(self, probe: Probe) -> str:
        """Stop the motor if the claim may have moved it, and put back what it changed.

        Raises NotStopped, LineLost.
        """
        if self._moved:
            stop_or_cut(self.gate, self.dialect, self.address, self._power)
            self._moved = False
        if self.keeper.changed:
            told = self.keeper.put_back()
            return f"not put back: {told}" if told else ""
        return ""

    def close(self) -> None:
        """Stop, put back, and give the port back. Raises NotStopped."""
        if self._closed:
            return
        self._closed = True
        told = ""
        try:
            told = self.settle(bare_probe(self.dialect, self.address, self.gate, "close"))
        except LineLost as error:
            told = str(error)
        finally:
            self._line.close()
            clean = not told
            if clean and self._journal is not None:
                self._journal.write(Entry(event="end", target=self.name))
            self._end_journal(clean=clean)
        if told:
            print(f"servotap: {told}", file=sys.stderr)
