"""The test bench around an emulated drive: end stops, obstacles, a hand on the shaft, power.

    left_switch(probe, -3000)       an end stop 3000 counts below the shaft, closed there and beyond
    left_switch(probe, -3000, 1)    one for home_trigger 1, open there and beyond
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


#: How far a hand turns the shaft, in counts: no protection takes that for a locked rotor.
_BY_HAND = 400


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


def left_switch(probe: Probe, counts: int, trigger: int = 0) -> None:
    """Mount the left end stop `counts` from the shaft: closed from there on, on the side of the sign.

    `trigger`: the level of its pin from there on; 1: it is closed before, and opens there.
    """
    _mount(probe, "left", counts, trigger)


def right_switch(probe: Probe, counts: int, trigger: int = 0) -> None:
    """Mount the right end stop, as `left_switch` does."""
    _mount(probe, "right", counts, trigger)


def _mount(probe: Probe, side: str, counts: int, trigger: int) -> None:
    _place(probe, side, 1 if counts > 0 else -1, round(shaft(probe)) + counts, trigger)


def _place(probe: Probe, side: str, way: int, place: int, trigger: int) -> None:
    drive = drive_of(probe)
    drive.switches[side] = Switch(-way if trigger else way, place - way * trigger)
    drive.changed()


def switch_here(probe: Probe, way: int, counts: int, trigger: int = 0) -> None:
    """Mount the left end stop so that the shaft stands at it, and leaves it `counts` behind.

    `way`: the side of the switch, 1 where counts rise. `trigger`: as `left_switch` takes it.
    """
    _place(probe, "left", way, round(shaft(probe)) - way * counts, trigger)


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


def gives_way(probe: Probe) -> bool:
    """Turn the shaft by hand and say whether it stays there: a motor that holds it in a closed loop turns it back."""
    before = shaft(probe)
    drive_of(probe).turn_shaft(_BY_HAND)
    return abs(shaft(probe) - before) > _BY_HAND / 2


def expect_hold(probe: Probe, held: bool, when: str) -> None:
    """Refute unless the motor holds the shaft, or lets a hand turn it, as it should.

    An open loop gives way to a hand either way: it is not refuted.
    """
    if held and not drive_of(probe).motor.closed_loop:
        return
    words = ("a shaft that a hand turns", "a shaft that is held")
    is_held = not gives_way(probe)
    text = f"{when} the motor {'holds' if is_held else 'does not hold'} the shaft"
    probe.expect(words[is_held], equal=words[held], refutes=text)


def power_cycle(probe: Probe) -> None:
    """Switch the drive off and on. It hears nothing while it starts."""
    drive_of(probe).power_cycle(probe.gate.now_ns())
