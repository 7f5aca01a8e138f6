"""A bare rig: a drive on a gate that is open already, for what has to talk to it beside the claims: stop it, put back."""

from __future__ import annotations

from analyzer.catalogue import Certainty, Dialect, Risk
from conformance.claim import Claim, Theme
from conformance.gate.gate import Gate
from conformance.suite.rig import Rig
from conformance.talk.probe import Probe


class BareRig(Rig):
    """A drive as a dialect, an address and a gate; nothing is put back here."""

    emulated = False

    def __init__(self, dialect: Dialect, address: int, gate: Gate) -> None:
        self.name = f"{dialect.name}@{address}"
        self.dialect = dialect
        self.model = dialect.model
        self.address = address
        self.gate = gate
        self.allowed = frozenset(Risk)
        self.alone = True
        self.named = frozenset()
        self.byte_ns = gate.line.endpoint.byte_ns

    def probe(self, claim: Claim) -> Probe:
        """Return a probe."""
        return Probe(self, claim)

    def settle(self, probe: Probe) -> str:
        """Do nothing."""
        return ""

    def close(self) -> None:
        """Do nothing: the gate is somebody else's."""


def bare_probe(dialect: Dialect, address: int, gate: Gate, what: str) -> Probe:
    """Return a probe that serves no claim; `what` it is for, in a word."""
    name = f"{dialect.name}/{Theme.STATE}/{what}"
    claim = Claim(name, Theme.STATE, dialect.name, what, "", "nothing", lambda probe: None, Certainty.OPEN)
    return BareRig(dialect, address, gate).probe(claim)
