"""Settings of an MKS drive: stored by name, kept or lost in a restart and a restore.

Rules kept here:
- One behaviour serves all settings: it stores their fields and answers status 1; `AFTER` lists further effects. Values that
  the manual does not allow are refused before.
- The reply to a change of the link still uses the old setting; then the new setting holds.
- Another work mode ends motion at once. A bus mode begins with the shaft held; on CAN `axis_lock` says whether.
- Another subdivision or pulse direction leaves the counts as they are.
- Changed limit settings hold only after the next homing.
- A restart keeps stored settings and forgets all else: motion, enabling, protection, zero, turns. The encoder keeps its
  position within the turn. A restart takes `start_ns`, in which the drive hears nothing.
- A restore sets all stored values to their defaults, also address, baud rate and dialect, and restarts.
- Replies to both still use the earlier settings.

Not emulated: settings without an effect on a bus (screen, keys, interpolation, currents beyond none, pulse delay).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from analyzer.catalogue import Verb
from analyzer.protocols import mks_can, mks_modbus, mks_rs485
from analyzer.protocols import mks_shared as mks
from conformance.drives.drive import Request, Values
from conformance.drives.mks.core import Activity, Behaviour, MksCore, Script
from conformance.drives.mks.state import Memory, is_setting


def _store(drive: MksCore, request: Request) -> Values:
    before, pulses = dict(drive.settings), drive.pulses
    for name, value in request.values.items():
        drive.store(name, value)
    after = AFTER.get(request.command.verb)
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
    Verb.SET_ENABLE_LEVEL: lambda drive, pulses: drive.grip(),
    **dict.fromkeys((Verb.SET_ADDRESS, Verb.SET_CURRENT, Verb.SET_MODBUS), lambda drive, pulses: drive.tune()),
    Verb.SET_HOME: _change_limits,
    Verb.SET_LIMIT_REMAP: _change_limits,
    Verb.SET_ZERO_MODE: _keep_zero,
}


SETTINGS: Mapping[Verb, Behaviour] = {
    command.verb: _store
    for dialect in (mks_rs485.DIALECT, mks_modbus.DIALECT, mks_can.DIALECT)
    for command in dialect.commands
    if is_setting(command)
}

# --- restart and restore ----------------------------------------------------------------------------------------------


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
    drive.begin(Activity.START, _starting(drive))


def _starting(drive: MksCore) -> Script:
    end_ns = drive.now_ns + drive.start_ns
    yield lambda: end_ns
    drive.starting = False
    drive.drop()
    drive.power_on(drive)


def _restart(drive: MksCore, request: Request) -> Values:
    restart(drive)
    return {"status": int(mks.Success.SUCCESS)}


def _restore(drive: MksCore, request: Request) -> Values:
    kept = {name: drive.settings[name] for name in drive.clinging}
    drive.settings.clear()
    drive.settings.update({**drive.factory, **kept})
    restart(drive)
    return {"status": int(mks.Success.SUCCESS)}


POWER: Mapping[Verb, Behaviour] = {Verb.RESTART: _restart, Verb.RESTORE: _restore}
