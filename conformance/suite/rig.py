"""A rig on which claims run: a drive under test, and what may be done to it.

An emulated drive is made anew for each claim, on a line in virtual time; a real one stays, and what a claim changed is
put back behind it (`conformance.safety`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Hashable, Iterator, Mapping
from contextlib import contextmanager

from analyzer.catalogue import Dialect, Risk
from conformance.claim import Claim
from conformance.talk.noise import Noise
from conformance.talk.probe import Probe, Rig


def lacking(
    claim: Claim, model: str, allowed: Collection[Risk], *, alone: bool, named: Collection[str], emulated: bool = False
) -> str:
    """Return what a claim needs that a drive of this model and a user's options do not give, or nothing."""
    if claim.models and model not in claim.models:
        known = f"the drive is a {model}" if model else "the model of the drive was not given"
        return f"it is about {' and '.join(claim.models)}, and {known}"
    if claim.emulated and not emulated:
        return "it needs to act on the drive itself, which only an emulated one lets it"
    if claim.by_name and claim.id not in named and not emulated:
        return f"it wears or wipes the drive: name it with --claim {claim.id}"
    if claim.alone and not alone:
        return "it sends to other addresses or changes the link: it needs --alone"
    risks = sorted(risk.value for risk in claim.risks.difference(allowed, {Risk.READ}))
    return f"it needs --allow {','.join(risks)}" if risks else ""


class ClaimRig(Rig, ABC):
    """One drive under test. `firmware`: as the drive reported it. `alone`: no other drive is on the bus, says the user.

    `named`: claims that the user named. `began_ns`: when its line was opened. `shown`: known quirks that the drive has shown,
    by name; `looked_for`: quirks that the run tested for in addition to the claims. `loses`: its line was seen to damage or
    lose something. `searched`: for how long (s) it searched for emulated drives that fail alike. `set_alike`: ideal drives, by
    the settings that this one has or may have. `untold`: settings, by field, that neither the drive nor the user tells.
    """

    name: str
    firmware: str = ""
    alone: bool
    began_ns: int = 0
    named: frozenset[str] = frozenset()
    untold: frozenset[str] = frozenset()

    def __init__(self, dialect: Dialect, address: int) -> None:
        super().__init__(dialect, address)
        self._in_motion: Noise | None = None
        self.shown: set[str] = set()
        self.looked_for: set[str] = set()
        self.searched = 0.0
        self.loses = False
        self.set_alike: dict[Hashable, ClaimRig] = {}

    @property
    @abstractmethod
    def _at_rest(self) -> Noise:
        """What the drive and its line show at rest, by reads alone."""

    @property
    def noise(self) -> Noise:
        """What they show at rest, and in motion where a claim needed that."""
        return self._at_rest if self._in_motion is None else self._in_motion

    def missing(self, claim: Claim) -> str:
        """Return why a claim cannot run here, or nothing."""
        return lacking(claim, self.model, self.allowed, alone=self.alone, named=self.named, emulated=self.emulated)

    @contextmanager
    def trying_again(self, attempt: int) -> Iterator[None]:
        """Try a claim again: what a real drive and its line do by chance falls otherwise by itself."""
        yield

    def drop_write_gap(self) -> None:
        """Send settings one after the other without a gap from now on: the drive executes them."""

    def forbid_motion(self, reason: str) -> None:
        """Refuse every request from now on that may move the drive."""

    @property
    @abstractmethod
    def held(self) -> Mapping[str, int]:
        """The settings of the drive before the run, as sent, by field: those that it or the user tells."""

    @abstractmethod
    def probe(self, claim: Claim) -> Probe:
        """Return a probe for one claim; an emulated drive is new."""

    @abstractmethod
    def settle(self, probe: Probe) -> str:
        """End a claim: stop what moves, put back what it changed. Return what could not be done, or nothing."""

    def still_there(self) -> None:
        """Raise RigFault where the drive has fallen silent for good."""

    @abstractmethod
    def close(self) -> None:
        """End the run: everything stopped, put back and closed."""
