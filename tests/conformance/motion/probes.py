"""A probe for tests of motion, without a claim that says anything."""

from __future__ import annotations

from conformance.claim import Claim, Theme
from conformance.drives import make
from conformance.suite.rig_emulated import EmulatedRig
from conformance.talk.probe import Probe


def probe_of(drive: str) -> Probe:
    """Return a probe of a new drive."""
    rig = EmulatedRig(make.parse(drive))
    name = rig.dialect.name
    return rig.probe(Claim(f"{name}/motion/test", Theme.MOTION, name, "It moves.", "1", "no motion", lambda probe: None))
