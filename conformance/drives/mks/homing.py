"""How an MKS drive finds a zero: homing with and without a switch, set zero, the way back at power-on, calibration.

Rules kept here:
- With a switch: run until it is effective, stop at once, that point is zero. From an effective one the shaft first goes
  the other way: on RS485 until the switch opens, on CAN by the return angle.
- Without: run until something holds the shaft, then go back by the return angle; that point is zero.
- With the end limit on, homing to a switch ends with the shaft let go (RS485).
- Homing is answered 1 and then 2, or 0 where it cannot begin or a locked rotor ends it. It cannot begin at speed 0, nor
  while the motor is disabled, protected, without supply or calibrating. It works in every mode.
- Calibration turns the shaft once to and fro and is answered 0 (it goes on) and then 1, or 2 where the shaft is held, the
  encoder fails or the supply is bad.
- At power-on: the way back to the kept zero point (9A), by the direction set or the shorter way, then a kept run (FF).
  3B tells how the former went: 2 where no point is kept or something came between.

Decided, since nothing is printed: homing, calibration and the way back change their speed at once; the way back turns at
30 rpm a step of its setting, its end is zero; a restored drive needs no calibration.
"""

from __future__ import annotations

from collections.abc import Mapping

from analyzer.catalogue import Verb
from analyzer.protocols import mks_shared as mks
from conformance.drives.drive import Values
from conformance.drives.mks.core import Behaviour, Kind, MksCore, Script
from conformance.drives.mks.motion import begin_run
from conformance.drives.mks.paths import Number, divided
from conformance.drives.mks.speaker import Order
from conformance.drives.mks.state import way_of

#: The speed of the way back at the slowest setting, and what each step adds.
_RETURN_RPM = 30
_MINUTE_NS = 60_000_000_000


def set_zero(drive: MksCore) -> None:
    """Make where the shaft is the zero of the encoder and of the pulses."""
    drive.motor.settle(drive.now_ns)
    drive.memory.zero = drive.memory.pulse_zero = drive.motor.position(drive.now_ns)


def _set_zero(drive: MksCore, order: Order) -> Values:
    position, wanted = drive.motor.position(drive.now_ns), drive.motor.wanted(drive.now_ns)
    drive.memory.zero, drive.memory.pulse_zero = position, wanted
    return {"status": int(mks.Success.SUCCESS)}


# --- homing ---------------------------------------------------------------------------------------------------------


def _home(drive: MksCore, order: Order) -> Values:
    settings = drive.home_settings()
    rpm = drive.real_speed(min(settings["home_speed"], drive.highest_speed(settings["home_speed"])))
    way, angle = way_of(settings["home_direction"]), settings["return_angle"]
    if not drive.ready or not rpm:
        return drive.refused(order)
    drive.drop()
    drive.memory.run = None
    by_switch = settings["home_mode"] == mks.HomeMode.LIMIT_SWITCH
    script = _to_switch(drive, way, rpm, angle) if by_switch else _to_obstacle(drive, way, rpm, angle)
    drive.begin(Kind.HOME, script, order)
    return {"status": int(mks.HomeStatus.STARTING)}


def _to_switch(drive: MksCore, way: int, rpm: Number, angle: int) -> Script:
    if drive.effective("left"):
        if drive.speaker.backs_off_by_angle:
            yield from _back(drive, way, rpm, angle)
        else:
            drive.motor.run(drive.now_ns, -way * rpm, 0)
            yield lambda: drive.until_effective("left", False)
    drive.motor.run(drive.now_ns, way * rpm, 0)
    yield lambda: drive.until_effective("left", True)
    drive.motor.halt(drive.now_ns)
    _homed(drive)
    if drive.settings["end_limit"] and drive.speaker.lets_go_at_home:
        drive.memory.enabled = False
        drive.grip()
    drive.finish(mks.HomeStatus.SUCCESS)


def _to_obstacle(drive: MksCore, way: int, rpm: Number, angle: int) -> Script:
    drive.motor.run(drive.now_ns, way * rpm, 0)
    yield lambda: drive.motor.touches(way, drive.now_ns)
    drive.motor.settle(drive.now_ns)
    yield from _back(drive, way, rpm, angle)
    _homed(drive)
    drive.finish(mks.HomeStatus.SUCCESS)


def _back(drive: MksCore, way: int, rpm: Number, angle: int) -> Script:
    """Go back by the return angle."""
    target = drive.motor.wanted(drive.now_ns) - way * angle
    drive.motor.move(drive.now_ns, target, rpm, 0)
    yield lambda: drive.motor.settled


def _homed(drive: MksCore) -> None:
    set_zero(drive)
    drive.settings["limits_homed"] = 1


# --- calibration ----------------------------------------------------------------------------------------------------


def _calibrate(drive: MksCore, order: Order) -> Values:
    if drive.memory.protected or not drive.supplied or drive.doing(Kind.CALIBRATE):
        return drive.refused(order)
    drive.drop()
    drive.memory.run = None
    drive.begin(Kind.CALIBRATE, _calibrating(drive), order)
    return {"status": int(mks.CalibrationStatus.CALIBRATING)}


def _calibrating(drive: MksCore) -> Script:
    motor, half_ns = drive.motor, drive.calibration_ns // 2
    begin_ns, start = drive.now_ns, motor.wanted(drive.now_ns)
    rpm = divided(_MINUTE_NS, half_ns)
    motor.hold(begin_ns)
    motor.move(begin_ns, start + mks.COUNTS_PER_TURN, rpm, 0)
    yield lambda: begin_ns + half_ns
    good = motor.error(drive.now_ns) == 0
    motor.move(drive.now_ns, start, rpm, 0)
    yield lambda: begin_ns + 2 * half_ns
    good = good and motor.error(drive.now_ns) == 0 and not motor.encoder_fails
    motor.halt(drive.now_ns)
    drive.finish(mks.CalibrationStatus.SUCCESS if good else None)
    drive.grip()


# --- power-on -------------------------------------------------------------------------------------------------------


def power_on(drive: MksCore) -> None:
    """Do what a drive does when power has come on."""
    drive.memory.enabled = bool(drive.settings.get("axis_lock", 1))
    drive.motor.settle(drive.now_ns)
    drive.grip()
    if drive.settings.get("zero_mode", 0):
        if drive.settings["zero_kept"] and drive.ready:
            drive.begin(Kind.RETURN, _returning(drive))
            return
        drive.memory.zero_status = int(mks.ZeroStatus.FAILED)
    _run_again(drive)


def _returning(drive: MksCore) -> Script:
    settings, turn = drive.settings, mks.COUNTS_PER_TURN
    drive.memory.zero_status = int(mks.ZeroStatus.GOING)
    position = drive.motor.wanted(drive.now_ns)
    forward = (settings["zero_point"] - position) % turn  # the way that raises the encoder
    if settings["zero_mode"] == mks.ZeroMode.DIRECTION:
        clockwise = settings["zero_direction"] == mks.ConfigDirection.CW
        distance = (forward - turn if forward else forward) if clockwise else forward
    else:
        distance = forward if 2 * forward <= turn else forward - turn
    rpm = _RETURN_RPM * (settings["zero_speed"] + 1)
    drive.motor.move(drive.now_ns, position + distance, rpm, 0)
    yield lambda: drive.motor.settled
    drive.memory.zero_status = int(mks.ZeroStatus.SUCCESS)
    set_zero(drive)
    drive.finish(None)
    _run_again(drive)


def _run_again(drive: MksCore) -> None:
    """Turn at the speed that was kept for power-on."""
    settings = drive.settings
    if settings["saved_run"] and drive.by_bus and drive.ready:
        begin_run(drive, settings["saved_direction"], settings["saved_speed"], settings["saved_acceleration"])


HOMING: Mapping[Verb, Behaviour] = {Verb.HOME: _home, Verb.SET_ZERO: _set_zero, Verb.CALIBRATE: _calibrate}
