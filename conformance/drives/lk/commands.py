"""What an LK drive does with each command, and where the fields of its replies come from. Tables; no bytes.

    ACTS      command name -> what it does; a command that is not there only reads
    ANSWERS   command name -> the values of its reply, where they are no readings of the moment
    PHYSICAL  field name -> its reading in the field's unit
    SENT      field name -> its reading as sent

The rules that these follow stand at the head of `lk_rs485`. A command of motion does nothing unless the drive obeys.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from analyzer.catalogue import MotionKind
from analyzer.protocols.lk_rs485 import DIALECT, ERROR_BITS, BrakeControl, BrakeState, MotorState, SpinDirection
from conformance.drives.drive import Request, Values
from conformance.drives.lk.motor import LkMotor, Speed, Torque

if TYPE_CHECKING:
    from conformance.drives.lk.drive import LkDrive

#: Supply current of a drive that does nothing (A), and of each LSB of torque at full speed.
IDLE_CURRENT, CURRENT_SHARE = 0.04, 0.006


Act = Callable[["LkDrive", Request], None]
Answer = Callable[["LkDrive", Request], "Values | None"]
Move = Callable[[LkMotor, Request], None]

# --- motion -------------------------------------------------------------------------------------------------------


def _torque(motor: LkMotor, request: Request) -> None:
    (torque,) = request.values.values()
    motor.go(Torque(torque))


def _run(motor: LkMotor, request: Request) -> None:
    motor.go(Speed(request.physical["speed"]))


def _to(motor: LkMotor, request: Request) -> None:
    motor.move_to(request.physical["position"], request.physical.get("max_speed"))


def _to_in_turn(motor: LkMotor, request: Request) -> None:
    clockwise = request.values["direction"] == SpinDirection.CW
    motor.turn_to(request.physical["angle"], clockwise=clockwise, top=request.physical.get("max_speed"))


def _by(motor: LkMotor, request: Request) -> None:
    motor.move_by(request.physical["position"], request.physical.get("max_speed"))


_KINDS: Mapping[MotionKind, Move] = {
    MotionKind.TORQUE: _torque,
    MotionKind.RUN: _run,
    MotionKind.MOVE_TO: _to,
    MotionKind.MOVE_IN_TURN: _to_in_turn,
    MotionKind.MOVE_BY: _by,
}
#: Commands of motion: command name -> what it asks of the motor.
MOVES: Mapping[str, Move] = {c.name: _KINDS[c.motion.kind] for c in DIALECT.motions(*_KINDS) if c.motion is not None}


def obeying(move: Move) -> Act:
    """Return the act of a motion command: the move, if the drive obeys."""

    def act(drive: LkDrive, request: Request) -> None:
        if drive.obeys:
            move(drive.motor, request)

    return act


# --- all else -----------------------------------------------------------------------------------------------------


def _stop(drive: LkDrive, request: Request) -> None:
    if drive.obeys:
        drive.motor.stop()


def _brake(drive: LkDrive, request: Request) -> None:
    control = request.values["brake_control"]
    if control != BrakeControl.READ:
        drive.motor.hold(braked=control == BrakeControl.POWER_OFF)


def _write_parameter(drive: LkDrive, request: Request) -> None:
    for name, value in request.values.items():
        if name in drive.parameters:
            drive.store(name, value)


def _set_zero(drive: LkDrive, request: Request) -> None:
    drive.store("encoder_zero", drive.motor.encoder_raw)


ACTS: Mapping[str, Act] = {
    "clear_errors": lambda drive, request: drive.clear_errors(),
    "motor_off": lambda drive, request: drive.motor.turn_off(),
    "motor_on": lambda drive, request: drive.motor.turn_on(),
    "stop": _stop,
    "brake": _brake,
    **{name: obeying(move) for name, move in MOVES.items()},
    "write_parameter": _write_parameter,
    "set_zero": _set_zero,
    "clear_turns": lambda drive, request: drive.motor.clear_turns(),
    "set_position": lambda drive, request: drive.motor.set_position(request.physical["position"]),
}

# --- replies ------------------------------------------------------------------------------------------------------


def _parameter(drive: LkDrive, request: Request) -> Values | None:
    """Answer with what the drive holds, after writing too; with nothing for a number that is not listed."""
    for form in request.command.reply_forms:
        fields = form.layout.named
        if fields["parameter"].fixed == request.values["parameter"]:
            return {n: drive.reading(f) if f.fixed is None else f.fixed for n, f in fields.items()}
    return None


def _echo(drive: LkDrive, request: Request) -> Values:
    return dict(request.values)


ANSWERS: Mapping[str, Answer] = {"read_parameter": _parameter, "write_parameter": _parameter, "set_position": _echo}


def _supply_current(drive: LkDrive) -> float:
    motor = drive.motor
    return IDLE_CURRENT + CURRENT_SHARE * abs(motor.torque * motor.motion.speed) / motor.build.top_speed


PHYSICAL: Mapping[str, Callable[[LkDrive], float]] = {
    "temperature": lambda drive: drive.temperature,
    "voltage": lambda drive: drive.volts,
    "current": _supply_current,
    "speed": lambda drive: drive.motor.motion.speed,
    "position": lambda drive: drive.motor.position,
    "angle": lambda drive: drive.motor.within_turn,
}


def _phase(number: int) -> Callable[[LkDrive], int]:
    """Return the reading of a phase current: the torque current, turned by the electrical angle."""

    def reading(drive: LkDrive) -> int:
        motor = drive.motor
        electrical = math.radians(motor.motion.angle * motor.build.pole_pairs - 120.0 * number)
        return round(motor.torque * math.cos(electrical))

    return reading


def _flag(name: str) -> Callable[[LkDrive], int]:
    return lambda drive: int(name in drive.errors)


SENT: Mapping[str, Callable[[LkDrive], int]] = {
    "state": lambda drive: MotorState.ON if drive.motor.on else MotorState.OFF,
    **{field.name: _flag(field.name) for field in ERROR_BITS},
    "torque_current": lambda drive: round(drive.motor.torque),
    "power": lambda drive: round(drive.motor.torque),
    "phase_a_current": _phase(0),
    "phase_b_current": _phase(1),
    "phase_c_current": _phase(2),
    "encoder": lambda drive: drive.motor.encoder,
    "encoder_raw": lambda drive: drive.motor.encoder_raw,
    "encoder_offset": lambda drive: drive.motor.encoder_zero,
    "encoder_zero": lambda drive: drive.motor.encoder_raw,
    "brake_state": lambda drive: BrakeState.POWER_OFF if drive.motor.braked else BrakeState.RELEASED,
}
