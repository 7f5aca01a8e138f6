"""Running the claims of one theme against emulated drives, for the tests of themes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from conformance import claims
from conformance.claim import Claim, Outcome, Theme, Verdict
from conformance.drives import make
from conformance.drives.drive import Fault
from conformance.suite import engine
from conformance.suite.rig_emulated import EmulatedRig

#: One drive of each dialect, with the model that has most commands.
DRIVES = ("mks-rs485@1,model=42D", "mks-modbus@1,model=42D", "mks-can@1,model=42E", "lk-rs485@1,model=MF")
#: Other models, and addresses at the edges.
OTHERS = ("mks-rs485@255,model=57D", "mks-modbus@247,model=28D", "mks-can@0x7ff,model=57E", "lk-rs485@32,model=MS")


def claims_of(theme: Theme, rig: EmulatedRig, wanted: Iterable[str] = ("",)) -> list[Claim]:
    """Return the claims of a theme whose names (without dialect and theme) begin with one of these."""
    every = [c for c in claims.every(rig.dialect) if c.theme is theme]
    found = [c for c in every if c.id.split("/", 2)[2].startswith(tuple(wanted))]
    assert len({c.id for c in found}) == len(found)
    return found


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


def not_confirmed(theme: Theme, drive: str) -> dict[str, str]:
    """Return the claims that a drive does not confirm, with why."""
    verdicts = run(theme, drive)
    assert verdicts, f"no claims about {drive}"
    return {n: f"{v.outcome}: {v.reason}" for n, v in verdicts.items() if v.outcome is not Outcome.CONFIRMED}
