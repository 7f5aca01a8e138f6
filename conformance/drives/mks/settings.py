"""What an MKS drive does with a setting: it keeps it by name, and `AFTER` says what else follows.

Rules kept here:
- All settings are one behaviour: their fields are stored, status 1 is answered. Values outside the manual's never come
  here (see `mks_core`).
- The reply to what changes the link goes out by the old setting; the new one holds from then on.
- Another work mode ends motion at once. A bus mode begins with the shaft held; on CAN `axis_lock` says whether.
- Another subdivision or pulse direction leaves the counts as they are.
- Changed limit settings hold only after the next homing.

Not emulated: what settings without an effect on a bus do (screen, keys, interpolation, currents, pulse delay).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from analyzer.catalogue import Command, Verb
from analyzer.protocols import mks_can, mks_modbus, mks_rs485
from analyzer.protocols import mks_shared as mks
from conformance.drives.drive import Values
from conformance.drives.mks.core import Behaviour, MksCore
from conformance.drives.mks.speaker import Order
from conformance.drives.mks.store import is_setting


def put(drive: MksCore, name: str, value: int) -> None:
    """Store a setting."""
    stored: tuple[str, int] | None = (name, value)
    for change in drive.hooks.stored:
        stored = None if stored is None else change(drive, *stored)
    if stored is not None:
        drive.settings[stored[0]] = stored[1]


def _store(drive: MksCore, order: Order) -> Values:
    before, pulses = dict(drive.settings), drive.pulses
    for name, value in order.values.items():
        put(drive, name, value)
    after = AFTER.get(order.command.verb)
    if after is not None and (drive.settings != before or after is _keep_zero):
        after(drive, pulses)
    return {"status": int(mks.Success.SUCCESS)}


def _change_mode(drive: MksCore, pulses: int) -> None:
    drive.drop()
    drive.motor.halt(drive.now_ns)
    drive.memory.run = None
    drive.memory.enabled = bool(drive.settings.get("axis_lock", 1))
    drive.tune()
    drive.grip()


def _keep_pulses(drive: MksCore, pulses: int) -> None:
    drive.memory.pulse_zero = drive.motor.wanted(drive.now_ns) - pulses * drive.pulse_counts


def _change_level(drive: MksCore, pulses: int) -> None:
    drive.grip()


def _change_link(drive: MksCore, pulses: int) -> None:
    drive.tune()


def _change_limits(drive: MksCore, pulses: int) -> None:
    drive.settings["limits_homed"] = 0


def _keep_zero(drive: MksCore, pulses: int) -> None:
    kept = drive.settings["set_zero"] == mks.ZeroPoint.SET
    drive.settings["zero_kept"] = int(kept)
    if kept:
        drive.settings["zero_point"] = round(drive.motor.position(drive.now_ns)) % mks.COUNTS_PER_TURN


#: What follows when settings have changed (a zero point is kept anew each time); the count of pulses is that of before.
AFTER: Mapping[Verb, Callable[[MksCore, int], None]] = {
    Verb.SET_WORK_MODE: _change_mode,
    Verb.SET_SUBDIVISION: _keep_pulses,
    Verb.SET_DIRECTION: _keep_pulses,
    Verb.SET_ENABLE_LEVEL: _change_level,
    Verb.SET_ADDRESS: _change_link,
    Verb.SET_MODBUS: _change_link,
    Verb.SET_HOME: _change_limits,
    Verb.SET_LIMIT_REMAP: _change_limits,
    Verb.SET_ZERO_MODE: _keep_zero,
}


def _every_setting() -> list[Command]:
    dialects = (mks_rs485.DIALECT, mks_modbus.DIALECT, mks_can.DIALECT)
    return [command for dialect in dialects for command in dialect.commands if is_setting(command)]


SETTINGS: Mapping[Verb, Behaviour] = {command.verb: _store for command in _every_setting()}
