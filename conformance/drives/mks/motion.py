"""Motion of an MKS drive: runs, moves, stops, enabling, homing, calibration, and motion at power-on.

    FD  relative, in pulses     wanted position + pulses        F4  relative, in counts   wanted position + counts
    FE  absolute, in pulses     pulse 0 + pulses                F5  absolute, in counts   the encoder's 0 + counts

Rules kept here:
- A motion is refused while the motor is disabled, protected, without supply or calibrating. A stop is refused only
  while calibrating.
- A newer motion begins at the current speed of the shaft: so mode 4 takes new targets and speeds during a move.
- A move is answered at its begin and when the shaft arrives; in a closed loop a blocked shaft does not arrive. A move at
  speed 0 is a stop. A stop is answered at its begin and when the shaft stands.
- Towards a closed end limit, a run at a speed is refused; a move begins and is stopped at once (status 3). A limit
  reached during motion stops it at once. A run at a speed has no reply for that.
- A locked rotor with its protection on ends a move as failed (0) and releases the shaft.
- Emergency stop and disabling end the current motion without a completion.
- FF stores a run at a speed for power-on; without a stored run nothing turns at power-on.
- Homing with a switch: the shaft runs until the switch is effective and stops at once; that point is zero. If the switch is
  effective at the start, the shaft first leaves it: on RS485 until it opens, on CAN by the return angle.
- Homing without a switch: the shaft runs until it is blocked, then returns by the return angle; that point is zero.
- With the end limit on, homing to a switch releases the shaft at its end (RS485).
- Homing is answered 1 and then 2, or 0 where it cannot begin or a locked rotor ends it. It cannot begin at speed 0, nor
  while the motor is disabled, protected, without supply or calibrating. It works in every mode.
- Calibration turns the shaft once in each direction. It is answered 0 (running) and then 1, or 2 if the shaft is held, the
  encoder fails or the supply is bad.
- At power-on the shaft returns to the stored zero point (9A), by the set direction or the shorter way. Then a stored run
  (FF) begins. 3B reads the result of the return: 2 if no point is stored or the return was interrupted.

The manual does not print these; they are chosen here. The direction bit gives the direction of pulses; 0 raises their count.
Homing, calibration and the return to zero change their speed at once. The return turns at 30 rpm for each step of its
setting, and its end is zero. A restored drive needs no calibration.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from analyzer.catalogue import Verb
from analyzer.protocols import mks_shared as mks
from conformance.drives.drive import Request, Values
from conformance.drives.mks.core import STOPS, Activity, Behaviour, MksCore, Script
from conformance.drives.mks.paths import Number, divided
from conformance.drives.mks.state import way_of

_SUCCESS: Values = {"status": int(mks.Success.SUCCESS)}
_STARTING: Values = {"status": int(mks.RunStatus.STARTING)}
#: The speed of the way back at the slowest setting, and what each step adds.
_RETURN_RPM = 30
_MINUTE_NS = 60_000_000_000


def _speed(drive: MksCore, request: Request) -> int:
    """Return the speed as sent, cut to what the work mode allows."""
    declared = request.command.request_forms[0].layout.named["speed"]
    speed: int = request.values["speed"]
    return min(speed, drive.highest_speed(declared.high))


def _way(direction: int) -> int:
    return 1 if direction == mks.MotionDirection.CCW else -1


def begin_run(drive: MksCore, direction: int, speed: int, acceleration: int) -> None:
    """Turn at a speed as sent."""
    drive.drop()
    rpm = _way(direction) * drive.bus_sense * drive.real_speed(speed)
    drive.motor.run(drive.now_ns, rpm, drive.ramp(acceleration))
    drive.memory.run = (direction, speed, acceleration) if speed else None


def _run(drive: MksCore, request: Request) -> Values:
    values, speed = request.values, _speed(drive, request)
    if not drive.ready or (speed and drive.at_limit(_way(values["direction"]) * drive.bus_sense)):
        return drive.refused(request)
    begin_run(drive, values["direction"], speed, values["acceleration"])
    return dict(_SUCCESS)


# --- moves to a position --------------------------------------------------------------------------------------------


def _by_pulses(drive: MksCore, request: Request) -> Number:
    pulses = _way(request.values["direction"]) * int(request.values["pulses"])
    return drive.motor.wanted(drive.now_ns) + pulses * drive.pulse_counts


#: Where each kind of move ends, in counts of where the shaft is meant to be.
TARGETS: Mapping[Verb, Callable[[MksCore, Request], Number]] = {
    Verb.MOVE_RELATIVE_PULSES: _by_pulses,
    Verb.MOVE_ABSOLUTE_PULSES: lambda drive, request: (
        drive.memory.pulse_zero + int(request.values["position"]) * drive.pulse_counts
    ),
    Verb.MOVE_RELATIVE_AXIS: lambda drive, request: drive.motor.wanted(drive.now_ns) + int(request.values["position"]),
    # What the encoder shows is the shaft; an open loop may have lost steps since.
    Verb.MOVE_ABSOLUTE_AXIS: lambda drive, request: drive.memory.zero + int(request.values["position"]) - drive.motor.lost,
}


def _move(drive: MksCore, request: Request) -> Values:
    if not drive.ready:
        return drive.refused(request)
    rpm, step_ns = drive.real_speed(_speed(drive, request)), drive.ramp(request.values["acceleration"])
    target = TARGETS[request.command.verb](drive, request)
    drive.drop()
    drive.memory.run = None
    if rpm:
        drive.motor.move(drive.now_ns, target, rpm, step_ns)
        drive.begin(Activity.MOVE, _arriving(drive), request)
    else:
        drive.motor.run(drive.now_ns, 0, step_ns)
        drive.begin(Activity.MOVE, _standing(drive), request)
    return dict(_STARTING)


def _arriving(drive: MksCore) -> Script:
    def arrives() -> Number | None:
        settled = drive.motor.settled
        there = not drive.motor.closed_loop or drive.motor.error(max(settled, drive.now_ns)) == 0
        return settled if there else None

    yield arrives
    drive.finish(mks.RunStatus.COMPLETE)


# --- stops ----------------------------------------------------------------------------------------------------------


def _stop(drive: MksCore, request: Request) -> Values:
    if drive.doing(Activity.CALIBRATE):
        return drive.refused(request)
    drive.drop()
    drive.memory.run = None
    drive.motor.run(drive.now_ns, 0, drive.ramp(request.values["acceleration"]))
    drive.begin(Activity.STOP, _standing(drive), request)
    return dict(_STARTING)


def _standing(drive: MksCore) -> Script:
    yield lambda: drive.motor.settled
    drive.finish(mks.RunStatus.COMPLETE)


def _emergency_stop(drive: MksCore, request: Request) -> Values:
    drive.drop()
    drive.memory.run = None
    drive.motor.halt(drive.now_ns)
    return dict(_SUCCESS)


# --- enabling, keeping a run ----------------------------------------------------------------------------------------


def _enable(drive: MksCore, request: Request) -> Values:
    drive.memory.enabled = bool(request.values["enabled"])
    if not drive.memory.enabled:
        drive.drop()
        drive.memory.run = None
    drive.grip()
    return dict(_SUCCESS)


def _release_protection(drive: MksCore, request: Request) -> Values:
    drive.memory.protected = False
    drive.grip()
    return dict(_SUCCESS)


def _save(drive: MksCore, request: Request) -> Values:
    run = drive.memory.run if request.values["save_state"] == mks.SaveState.SAVE else None
    drive.store("saved_run", int(run is not None))
    for name, value in zip(("saved_direction", "saved_speed", "saved_acceleration"), run or (0, 0, 0), strict=True):
        drive.store(name, value)
    return dict(_SUCCESS)


# --- zero -------------------------------------------------------------------------------------------------------------


def set_zero(drive: MksCore) -> None:
    """Make where the shaft is the zero of the encoder and of the pulses."""
    drive.motor.settle(drive.now_ns)
    drive.memory.zero = drive.memory.pulse_zero = drive.motor.position(drive.now_ns)


def _set_zero(drive: MksCore, request: Request) -> Values:
    position, wanted = drive.motor.position(drive.now_ns), drive.motor.wanted(drive.now_ns)
    drive.memory.zero, drive.memory.pulse_zero = position, wanted
    return {"status": int(mks.Success.SUCCESS)}


# --- homing ---------------------------------------------------------------------------------------------------------


def _home(drive: MksCore, request: Request) -> Values:
    settings = drive.home_settings()
    rpm = drive.real_speed(min(settings["home_speed"], drive.highest_speed(settings["home_speed"])))
    way, angle = way_of(settings["home_direction"]), settings["return_angle"]
    if not drive.ready or not rpm:
        return drive.refused(request)
    drive.drop()
    drive.memory.run = None
    by_switch = settings["home_mode"] == mks.HomeMode.LIMIT_SWITCH
    script = _to_switch(drive, way, rpm, angle) if by_switch else _to_obstacle(drive, way, rpm, angle)
    drive.begin(Activity.HOME, script, request)
    return {"status": int(mks.HomeStatus.STARTING)}


def _to_switch(drive: MksCore, way: int, rpm: Number, angle: int) -> Script:
    if drive.effective("left"):
        if drive.responder.backs_off_by_angle:
            yield from _back(drive, way, rpm, angle)
        else:
            drive.motor.run(drive.now_ns, -way * rpm, 0)
            yield lambda: drive.until_effective("left", False)
    drive.motor.run(drive.now_ns, way * rpm, 0)
    yield lambda: drive.until_effective("left", True)
    drive.motor.halt(drive.now_ns)
    _homed(drive)
    if drive.settings["end_limit"] and drive.responder.lets_go_at_home:
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


def _calibrate(drive: MksCore, request: Request) -> Values:
    if drive.memory.protected or not drive.supplied or drive.doing(Activity.CALIBRATE):
        return drive.refused(request)
    drive.drop()
    drive.memory.run = None
    drive.begin(Activity.CALIBRATE, _calibrating(drive), request)
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
            drive.begin(Activity.RETURN, _returning(drive))
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


MOTION: Mapping[Verb, Behaviour] = {
    Verb.RUN_SPEED: _run,
    **dict.fromkeys(TARGETS, _move),
    **dict.fromkeys(STOPS, _stop),
    Verb.EMERGENCY_STOP: _emergency_stop,
    Verb.ENABLE: _enable,
    Verb.RELEASE_PROTECTION: _release_protection,
    Verb.SAVE_SPEED: _save,
    Verb.HOME: _home,
    Verb.SET_ZERO: _set_zero,
    Verb.CALIBRATE: _calibrate,
}
