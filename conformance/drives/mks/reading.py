"""Reads of an MKS drive: measured values by the names of the catalogue's fields.

Rules kept here:
- A behaviour returns all values; the layout of the reply selects its fields.
- Measured values are the nearest whole number. The speed stays within its bits; counters wrap.
- Ports: a closed switch is a low pin. RS485: in_2 exists on the 57D or with the ports remapped, the outputs on the 57D
  alone. CAN: on the 42E in_2 is the En pin (or the right limit, remapped), on the 57E in_2 is the left and in_1 the right
  limit.
- In pulse modes the status shows only a calibration. The CAN manual says so; RS485 drives have no other status then.
- 3B reads 1 if there was no return to zero since power-on.

Not emulated: out_2, which the manual reserves.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction

from analyzer.catalogue import Verb
from analyzer.protocols import mks_can
from analyzer.protocols import mks_shared as mks
from conformance.drives.drive import Request, Values
from conformance.drives.mks.core import Activity, Behaviour, MksCore
from conformance.drives.mks.paths import Phase

_STATUS: Mapping[Phase, mks.MotorStatus] = {
    Phase.STANDING: mks.MotorStatus.STOPPED,
    Phase.SPEEDING_UP: mks.MotorStatus.SPEEDING_UP,
    Phase.FULL_SPEED: mks.MotorStatus.FULL_SPEED,
    Phase.SLOWING_DOWN: mks.MotorStatus.SLOWING_DOWN,
}
_ERROR_UNIT = Fraction(mks.COUNTS_PER_TURN, 360) * mks.ANGLE_ERROR.scale
_HARDWARE: Mapping[str, mks_can.Hardware] = {"57E": mks_can.Hardware.S57E_CAN}
#: The firmware of the manual.
_FIRMWARE = (1, 0, 1)
#: Below so many pulses the in-position port does not divide them.
_SHORTEST_DIVISION = 100


def _carry(drive: MksCore, request: Request) -> Values:
    carry, encoder = divmod(drive.axis, mks.COUNTS_PER_TURN)
    return {"carry": carry, "encoder": encoder}


def _speed(drive: MksCore, request: Request) -> Values:
    field = mks.ACTUAL_SPEED
    return {"speed": min(max(round(drive.motor.speed(drive.now_ns)), field.low), field.high)}


def _status(drive: MksCore, request: Request) -> Values:
    if drive.doing(Activity.CALIBRATE):
        return {"status": int(mks.MotorStatus.CALIBRATING)}
    if not drive.by_bus:
        return {"status": int(mks.MotorStatus.STOPPED)}
    if drive.doing(Activity.HOME):
        return {"status": int(mks.MotorStatus.HOMING)}
    return {"status": int(_STATUS[drive.motor.phase(drive.now_ns)])}


def _io(drive: MksCore, request: Request) -> Values:
    left, right, large = drive.level("left"), drive.level("right"), drive.model.startswith("57")
    if drive.dialect.bus != "can":
        stalled = drive.memory.protected
        second = right if drive.side_wired("right") else 0
        return {"in_1": left, "in_2": second, "out_1": int(large and not stalled), "out_2": 0}
    if large:
        first, second = right, left
    else:
        first, second = left, right if drive.settings["limit_remap"] else drive.enable_pin
    return {"in_1": first, "in_2": second, "alm": _alarm(drive), "pend": _in_position(drive)}


def _alarm(drive: MksCore) -> int:
    """Return the level of the ALM port: as written, else 0 while something is wrong."""
    memory = drive.memory
    return memory.alm if memory.alm_mask == mks_can.PortMask.WRITE else int(drive.healthy)


def _in_position(drive: MksCore) -> int:
    """Return the level of the PEND port: as written, else the divided pulses, else 1 while the shaft is in place."""
    memory, settings = drive.memory, drive.settings
    if memory.pend_mask == mks_can.PortMask.WRITE:
        return memory.pend
    period = settings["division_period"]
    if period >= _SHORTEST_DIVISION:
        return settings["division_level"] ^ (abs(drive.pulses) // period & 1)
    return int(drive.motor.phase(drive.now_ns) is Phase.STANDING)


def _write_io(drive: MksCore, request: Request) -> Values:
    memory, values = drive.memory, request.values
    if values["alm_mask"] != mks_can.PortMask.KEEP:
        memory.alm_mask, memory.alm = values["alm_mask"], values["alm"]
    if values["pend_mask"] != mks_can.PortMask.KEEP:
        memory.pend_mask, memory.pend = values["pend_mask"], values["pend"]
    return {"status": int(mks.Success.SUCCESS)}


def _version(drive: MksCore, request: Request) -> Values:
    major, minor, patch = _FIRMWARE
    return {
        "series": int(mks_can.Series.E),
        "calibration": int(mks_can.EncoderSense.CW_LOWERS),
        "hardware": int(_HARDWARE.get(drive.model, mks_can.Hardware.S42E_CAN)),
        "firmware_major": major,
        "firmware_minor": minor,
        "firmware_patch": patch,
    }


def _parameter(drive: MksCore, request: Request) -> Values:
    """Return the stored values of a setting by its code, or that it cannot be read."""
    for command in drive.dialect.by_code.get(request.values["parameter"], ()):
        if command.readable:
            return {name: drive.settings[name] for name in command.request_forms[0].layout.named}
    return {"unreadable": 0xFFFF}


READING: Mapping[Verb, Behaviour] = {
    Verb.READ_ENCODER_CARRY: _carry,
    Verb.READ_POSITION: lambda drive, request: {"position": drive.axis},
    Verb.READ_SPEED: _speed,
    Verb.READ_PULSES: lambda drive, request: {"pulses": drive.pulses},
    Verb.READ_IO: _io,
    Verb.READ_ANGLE_ERROR: lambda drive, request: {"angle_error": round(drive.motor.error(drive.now_ns) / _ERROR_UNIT)},
    Verb.READ_ENABLED: lambda drive, request: {"enabled": int(drive.enabled)},
    Verb.READ_ZERO_STATUS: lambda drive, request: {"status": drive.memory.zero_status},
    Verb.READ_PROTECTION: lambda drive, request: {"status": int(drive.memory.protected)},
    Verb.READ_STATUS: _status,
    Verb.READ_VERSION: _version,
    Verb.READ_USER_ID: lambda drive, request: {"user_id": drive.settings["user_id"]},
    Verb.READ_PARAMETER: _parameter,
    Verb.WRITE_IO: _write_io,
}
