"""A rig: one drive under test, with the line it is on and what may be done to it. Claims get a probe of it.

An emulated drive is made anew for each claim, on a line in virtual time; a real one stays, and what a claim changed is
put back behind it (`conformance.safety`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

from analyzer.catalogue import Dialect, Risk
from analyzer.errors import ServotapError
from conformance.claim import Claim
from conformance.talk.probe import Probe, Until

if TYPE_CHECKING:
    from analyzer.records import CanFrame
    from conformance.gate.gate import Gate

MS = 1_000_000
SECOND_NS = 1_000_000_000


class RigFault(ServotapError):
    """The rig is at fault, not the drive: nobody answers, a port does not work."""


class NotStopped(ServotapError):
    """The drive could not be brought to a verified stop."""


class Rig(ABC):
    """One drive under test.

    `firmware`: as far as the drive told it. `dialect`: as its model speaks it. `allowed`: risks that the user opened.
    `alone`: no other drive is on the bus, and the user said so. `byte_ns`: time of a byte on the line. `late_ns`: a reply
    later than this counts as none. `quiet_ns`: how long to listen after an answer for a second one. `silence_ns`: how long
    nothing must come before it is called silence. `done_ns`: how long a command may take to its last reply.
    `write_gap_ns`: between settings.
    """

    name: str
    firmware: str = ""
    dialect: Dialect
    address: int
    model: str
    emulated: bool
    gate: Gate
    allowed: frozenset[Risk]
    alone: bool
    named: frozenset[str]
    byte_ns: int
    late_ns: int = SECOND_NS
    quiet_ns: int = 30 * MS
    silence_ns: int = 300 * MS
    done_ns: int = 20 * SECOND_NS
    write_gap_ns: int = 500 * MS

    def timeout_ns(self, until: Until) -> int:
        """Return how long to listen by default."""
        return {Until.REPLY: self.late_ns, Until.DONE: self.done_ns, Until.TIMEOUT: self.silence_ns}[until]

    def missing(self, claim: Claim) -> str:
        """Return why a claim cannot run here, or nothing."""
        if claim.models and self.model and self.model not in claim.models:
            return f"it is about {' and '.join(claim.models)}, and the drive is a {self.model}"
        if claim.emulated and not self.emulated:
            return "it needs to act on the drive itself, which only an emulated one lets it"
        if claim.by_name and claim.id not in self.named and not self.emulated:
            return f"it wears or wipes the drive: name it with --claim {claim.id}"
        if claim.alone and not self.alone:
            return "it sends to other addresses or changes the link: it needs --alone"
        lacking = sorted(risk.value for risk in claim.risks - self.allowed - {Risk.READ})
        if lacking:
            return f"it needs --allow {','.join(lacking)}"
        return ""

    @abstractmethod
    def probe(self, claim: Claim) -> Probe:
        """Return a probe for one claim; an emulated drive is new."""

    def before_send(self, item: bytes | CanFrame) -> None:  # noqa: B027  # an emulated drive is made anew anyway
        """Take note of what is about to leave; a rig that puts things back looks here at what is changed."""

    @abstractmethod
    def settle(self, probe: Probe) -> str:
        """End a claim: stop what moves, put back what it changed. Return what could not be done, or nothing."""

    @abstractmethod
    def close(self) -> None:
        """End the run: everything stopped, put back and closed."""
