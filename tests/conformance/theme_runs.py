"""Running claims, one or those of a theme, against emulated drives."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from fnmatch import fnmatch

from conformance import claims
from conformance.claim import Claim, Outcome, Theme, Verdict
from conformance.drives import make
from conformance.drives.drive import Fault
from conformance.suite import engine
from conformance.suite.rig_emulated import EmulatedRig


def claims_of(theme: Theme, rig: EmulatedRig, wanted: Iterable[str] = ("",)) -> list[Claim]:
    """Return the claims of a theme whose names (without dialect and theme) begin with one of these."""
    every = [c for c in claims.every(rig.dialect) if c.theme is theme]
    found = [c for c in every if c.id.split("/", 2)[2].startswith(tuple(wanted))]
    assert len({c.id for c in found}) == len(found)
    return found


def judge(drive: str, wanted: str) -> Verdict | None:
    """Run the first claim about an emulated drive whose id, without its dialect, is such; None where there is none."""
    rig = EmulatedRig(make.parse(drive))
    found = next((c for c in claims.every(rig.dialect) if fnmatch(c.id.partition("/")[2], wanted)), None)
    return engine.run_claim(found, rig) if found else None


def run(theme: Theme, drive: str, *wanted: str, fault: Fault | None = None) -> dict[str, Verdict]:
    """Run claims of a theme on an emulated drive; return the verdicts by name."""
    specification = make.parse(drive)
    if fault is not None:
        specification = replace(specification, faults=(fault,))
    rig = EmulatedRig(specification)
    verdicts = engine.run(claims_of(theme, rig, wanted or ("",)), rig)
    return {v.claim.id.split("/", 2)[2]: v for v in verdicts}


def refuted(theme: Theme, drive: str, *wanted: str, fault: Fault | None = None) -> set[str]:
    """Return the names of the claims that are refuted."""
    return {n for n, v in run(theme, drive, *wanted, fault=fault).items() if v.outcome is Outcome.REFUTED}
