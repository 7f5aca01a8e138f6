"""The test bench around an emulated drive: end stops, obstacles, a hand on the shaft, power.

    left_switch(probe, -3000)       an end stop 3000 counts below the shaft, closed there and beyond
    wall(probe, 3000)               an obstacle 3000 counts above the shaft
    power_cycle(probe)              off, and on again
    shaft(probe)                    the true position of the shaft, in counts

Rules kept here:
- On the bench, counts always rise counter-clockwise; settings of the drive do not change that. So a drive that turns the
  wrong way misses its switch.
- Positions are relative to the shaft.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from conformance.claim import NotRun
from conformance.drives.lk.drive import LkDrive
from conformance.drives.mks.drive import MksDrive
from conformance.drives.mks.motor import Switch

if TYPE_CHECKING:
    from conformance.talk.probe import Probe


def drive_of(probe: Probe) -> MksDrive:
    """Return the emulated MKS drive. Raises NotRun for any other drive."""
    if not isinstance(probe.drive, MksDrive):
        raise NotRun("it needs to act on an emulated MKS drive")
    return probe.drive


def lk_drive(probe: Probe) -> LkDrive:
    """Return the emulated LK drive. Raises NotRun for any other drive."""
    if not isinstance(probe.drive, LkDrive):
        raise NotRun("it needs to act on an emulated LK drive")
    return probe.drive


def shaft(probe: Probe) -> float:
    """Return the true position of the shaft, in counts from its first position."""
    drive = drive_of(probe)
    return float(drive.motor.position(drive.now_ns))


def left_switch(probe: Probe, counts: int) -> None:
    """Mount the left end stop `counts` from the shaft: closed from there on, on the side of the sign."""
    _mount(probe, "left", counts)


def right_switch(probe: Probe, counts: int) -> None:
    """Mount the right end stop `counts` from the shaft: closed from there on, on the side of the sign."""
    _mount(probe, "right", counts)


def _mount(probe: Probe, side: str, counts: int) -> None:
    drive = drive_of(probe)
    drive.switches[side] = Switch(1 if counts > 0 else -1, round(shaft(probe)) + counts)
    drive.changed()


def switch_here(probe: Probe, way: int, counts: int) -> None:
    """Mount the left end stop so that it is closed at the shaft, and opens `counts` behind it.

    `way`: the side of the switch, 1 where counts rise.
    """
    drive = drive_of(probe)
    drive.switches["left"] = Switch(way, round(shaft(probe)) - way * counts)
    drive.changed()


def press(probe: Probe, pressed: bool = True) -> None:
    """Press the left end stop by hand, or let it go."""
    drive_of(probe).limit_switch("left", pressed)


def enable_pin(probe: Probe, level: int) -> None:
    """Set the level of the En pin."""
    drive_of(probe).set_enable_pin(level)


def wall(probe: Probe, counts: int | None) -> None:
    """Put an obstacle `counts` from the shaft, on the side of the sign; None: remove all obstacles."""
    drive = drive_of(probe)
    if counts is None:
        for way in (1, -1):
            drive.motor.obstruct(drive.now_ns, way, None)
    else:
        drive.motor.obstruct(drive.now_ns, 1 if counts > 0 else -1, round(shaft(probe)) + counts)
    drive.changed()


def hold(probe: Probe, held: bool = True) -> None:
    """Hold the shaft by hand, or let it go."""
    drive_of(probe).block(held)


def power_cycle(probe: Probe) -> None:
    """Switch the drive off and on. It hears nothing while it starts."""
    drive_of(probe).power_cycle(probe.gate.now_ns())
