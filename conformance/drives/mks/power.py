"""What survives in an MKS drive, and what does not: restart, restore, power.

Rules kept here:
- A restart keeps what is stored and forgets the rest: motion, whether the motor was enabled, protection, zero, turns.
  The encoder knows its place within the turn. It takes `start_ns`, in which the drive hears nothing.
- A restore puts everything that is stored to its default, address, baud rate and dialect too, and restarts.
- Both are answered by the settings of before.
"""

from __future__ import annotations

from collections.abc import Mapping

from analyzer.catalogue import Verb
from analyzer.protocols import mks_shared as mks
from conformance.drives.drive import Values
from conformance.drives.mks.core import Behaviour, Kind, MksCore, Script
from conformance.drives.mks.speaker import Order
from conformance.drives.mks.store import Memory


def restart(drive: MksCore) -> None:
    """Forget what is in RAM and start anew."""
    for name in drive.forgetful:
        drive.settings[name] = drive.factory[name]
    drive.motor.release(drive.now_ns)
    position = drive.motor.position(drive.now_ns)
    zero = position // mks.COUNTS_PER_TURN * mks.COUNTS_PER_TURN
    drive.memory = Memory(enabled=False, zero=zero, pulse_zero=position)
    drive.tune()
    drive.starting = True
    drive.begin(Kind.START, _starting(drive))


def _starting(drive: MksCore) -> Script:
    end_ns = drive.now_ns + drive.start_ns
    yield lambda: end_ns
    drive.starting = False
    drive.drop()
    drive.power_on(drive)


def _restart(drive: MksCore, order: Order) -> Values:
    restart(drive)
    return {"status": int(mks.Success.SUCCESS)}


def _restore(drive: MksCore, order: Order) -> Values:
    kept = {name: drive.settings[name] for name in drive.clinging}
    drive.settings.clear()
    drive.settings.update({**drive.factory, **kept})
    restart(drive)
    return {"status": int(mks.Success.SUCCESS)}


POWER: Mapping[Verb, Behaviour] = {Verb.RESTART: _restart, Verb.RESTORE: _restore}
