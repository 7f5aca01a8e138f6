"""A rig with an emulated drive: made anew for each claim, on a line in virtual time."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import TYPE_CHECKING

from analyzer.catalogue import Risk
from conformance.bus.emulated import EmulatedLine
from conformance.claim import Claim, Inconclusive
from conformance.drives import make
from conformance.drives.make import Specification
from conformance.gate.budget import Budget
from conformance.gate.gate import Gate, Refused
from conformance.gate.permissions import Allowance
from conformance.motion import answering, declared, resting
from conformance.safety.stopping import MAY_MOVE
from conformance.suite import set_otherwise
from conformance.suite.rig import ClaimRig
from conformance.talk.noise import Noise
from conformance.talk.probe import MS, SECOND_NS, Probe, plain_probe

if TYPE_CHECKING:
    from conformance.drives.drive import Drive

EVERYTHING = frozenset(Risk)
#: An emulated flash does not wear.
UNLIMITED = 1 << 60

#: How long power has been on when a claim begins, of a drive that turns by itself since.
_POWERED_NS = 3 * SECOND_NS

#: What ideal drives show at rest, by dialect, address, model and speed.
_quiet: dict[tuple[str, int, str, int | None], Noise] = {}


class EmulatedRig(ClaimRig):
    """A rig that makes the drive of a specification for each claim. Nothing can break, so everything is allowed.

    `allowance`: what may be sent all the same, to try a bounded run; by default everything. Waits cost nothing and are long.
    `settings`: what the drive holds, as sent; the specification's own win over them. `told`: settings that the user tells,
    where the rig is not to know the others that its drive cannot tell; None: it knows all.
    """

    emulated = True

    def __init__(
        self,
        specification: Specification,
        *,
        seed: int = 0,
        allowance: Allowance | None = None,
        settings: Mapping[str, int] | None = None,
        told: Mapping[str, int] | None = None,
    ) -> None:
        dialect = specification.dialect
        super().__init__(dialect.for_model(specification.model) if specification.model else dialect, specification.address)
        self.specification = specification
        self.name = specification.name
        self.model = specification.model
        self.seed, self._attempt = seed, 0
        #: Whether its drive answers motion only after it is set to.
        self._to_set = False
        given, self._settings = specification, settings or {}
        self._held = make.settings_of(specification, self._settings)
        if told is not None:
            named = set_otherwise.names(self.dialect)
            self.untold = set_otherwise.unreadable(self.dialect) - told.keys()
            self._held = {n: v for n, v in self._held.items() if n in named and n not in self.untold}
        #: Whether it is as the manual has it in everything, so that a motion shows no noise.
        self._ideal = not (given.realism or given.faults or given.quirks or given.settings or self._settings)
        self._allowance = allowance or Allowance(EVERYTHING, alone=True, budget=Budget(wear=UNLIMITED))
        self.allowed = self._allowance.risks
        self.alone = self._allowance.alone
        self.quiet_ns = 100 * MS
        self.silence_ns = 3 * SECOND_NS
        self.done_ns = 120 * SECOND_NS

    def make_drive(self) -> Drive:
        """Return a new drive of the specification."""
        return make.make(self.specification, settings=self._settings, seed=self.seed + self._attempt)

    @contextlib.contextmanager
    def trying_again(self, attempt: int) -> Iterator[None]:
        """Let chance fall otherwise for the drives of a claim that is tried again."""
        self._attempt = attempt
        try:
            yield
        finally:
            self._attempt = 0

    @property
    def held(self) -> Mapping[str, int]:
        return self._held

    @cached_property
    def group(self) -> int | None:
        drive = self.make_drive()
        return drive.settings.get(drive.group_setting)

    @cached_property
    def _at_rest(self) -> Noise:
        if not self._ideal:
            return resting.measure(self._plain_probe())
        # Reads of a drive as the manual has it show the same in each rig.
        given = self.specification
        key = given.dialect.name, given.address, given.model, given.speed
        if key not in _quiet:
            _quiet[key] = resting.measure(self._plain_probe())
        return _quiet[key]

    def _plain_probe(self) -> Probe:
        return plain_probe(self.dialect, self.address, self._gate_to(self.make_drive()), alone=True)

    def _gate_to(self, drive: Drive) -> Gate:
        """Return the gate of a line to a drive; what it does or keeps for power-on is ended first, as on a bench."""
        gate = Gate(EmulatedLine([drive]), self._allowance)
        probe = plain_probe(self.dialect, self.address, gate, alone=True)
        # A shaft that turns on is judged by the claims about stops; a stop may also need more than was allowed.
        with contextlib.suppress(Inconclusive, Refused):
            if drive.rest.since_ns < 0:
                gate.wait(_POWERED_NS)
                resting.let_stand(probe)
            elif drive.settings.get("saved_run"):
                resting.forget_run(probe, drive.settings["work_mode"])
        return gate

    def probe(self, claim: Claim) -> Probe:
        if not self._ideal and self._in_motion is None and claim.risks & MAY_MOVE and declared.can_move(self.dialect):
            self._to_set = self._answers_once_set()
            measuring = self._plain_probe()
            if self._to_set:
                answering.set_loud(measuring)
            measuring.noise = self._at_rest
            self._in_motion = resting.in_motion(measuring)
        drive = self.make_drive()
        self.gate = self._gate_to(drive)
        if self._to_set and claim.risks & MAY_MOVE:
            answering.set_loud(plain_probe(self.dialect, self.address, self.gate, alone=True))
        return Probe(self, claim, drive)

    def _answers_once_set(self) -> bool:
        """Say whether the drive does not answer motion as by default, and does so once it is set to."""
        probe = self._plain_probe()
        try:
            return not answering.is_loud(probe) and answering.set_loud(probe) and answering.is_loud(probe)
        except (Inconclusive, Refused):
            return False

    def recorder(self, probe: Probe) -> Probe:
        """Return a probe of a new drive: what a recording shows does not depend on the claim that asked first."""
        return self.probe(probe.claim)

    def settle(self, probe: Probe) -> str:
        """Do nothing: the next claim gets a new drive."""
        probe.gate.close()
        return ""

    def close(self) -> None:
        """Do nothing: there is no port."""
