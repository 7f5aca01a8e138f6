"""Faults of an LK drive in what it does: motion, on and off, stop, brake, errors, what it keeps and for how long."""

from __future__ import annotations

from analyzer.catalogue import Command
from analyzer.protocols.lk_rs485 import CURRENT_MODELS, DIALECT, POWER_MODELS, BrakeControl, SpinDirection
from conformance.drives.drive import Fault, Hooks, Values
from conformance.drives.lk.commands import ACTS, MOVES, Act, Move, Request
from conformance.drives.lk.drive import LkDrive
from conformance.drives.lk.motor import Goal, Position
from conformance.drives.lk.places import (
    INCREMENTS,
    LIMITED,
    MULTI_TURN,
    SINGLE_TURN,
    Install,
    followed_by,
    instead,
    lk,
    nothing,
    on_act,
    on_asked,
    on_request,
    on_setup,
    on_store,
    together,
)

#: Degrees by which a faulty move overshoots, or stops short.
OVERSHOOT, SHORT = 3.0, 0.5


def _fault(name: str, text: str, breaks: str, install: Install) -> Fault:
    return Fault(name, ("lk-rs485",), text, breaks, install)


# --- motion -------------------------------------------------------------------------------------------------------


def _moves(names: tuple[str, ...], act: Act) -> Install:
    """Replace the act of motion commands, which obey as before only when the drive does."""

    def obedient(drive: LkDrive, request: Request) -> None:
        if drive.obeys:
            act(drive, request)

    return together(*(on_act(name, instead(obedient)) for name in names))


def _as_absolute(drive: LkDrive, request: Request) -> None:
    drive.motor.move_to(request.physical["position"], request.physical.get("max_speed"))


def _as_relative(drive: LkDrive, request: Request) -> None:
    drive.motor.move_by(request.physical["position"], request.physical.get("max_speed"))


def _shortest(drive: LkDrive, request: Request) -> None:
    way = (request.physical["angle"] - drive.motor.within_turn + 180.0) % 360.0 - 180.0
    drive.motor.move_by(way, request.physical.get("max_speed"))


def _past_angle_limit(drive: LkDrive, request: Request) -> None:
    motor = drive.motor
    motor.go(Position(motor.origin + request.physical["position"], request.physical.get("max_speed")))


def _unlimited(drive: LkDrive, command: Command, values: Values) -> Values:
    return values | {"max_speed": (1 << 32) - 1}


def _invert(direction: int) -> int:
    others: dict[int, int] = {SpinDirection.CW: SpinDirection.CCW, SpinDirection.CCW: SpinDirection.CW}
    return others.get(direction, direction)


def _rebuilt(**changes: float) -> Install:
    return on_setup(lambda drive: drive.motor.rebuilt(**changes))


def _land_short(drive: LkDrive, request: Request) -> None:
    goal = drive.motor.goal
    if isinstance(goal, Position):
        side = 1.0 if goal.angle > drive.motor.motion.angle else -1.0
        drive.motor.go(Position(goal.angle - side * SHORT, goal.top))


def _unheld_limit(*names: str) -> Install:
    """Let a limit of the control parameters have no effect: the motor keeps the one of power-up."""

    def make(old: Act) -> Act:
        def act(drive: LkDrive, request: Request) -> None:
            old(drive, request)
            written = dict(drive.parameters)
            drive.parameters.update({n: drive.settings[n] for n in names})
            drive.motor.limit(drive.limits)
            drive.parameters.update(written)

        return act

    return on_act("write_parameter", make)


# --- on, off, stop ------------------------------------------------------------------------------------------------


def _whatever(move: Move) -> Act:
    return lambda drive, request: move(drive.motor, request)


def _disobedient(drive: LkDrive) -> None:
    """Let motion commands be obeyed while the motor is off."""
    drive.acts |= {name: _whatever(move) for name, move in MOVES.items()}


def _keep_running(drive: LkDrive, request: Request) -> None:
    drive.motor.on = False


def _second_time(old: Act) -> Act:
    count = 0

    def act(drive: LkDrive, request: Request) -> None:
        nonlocal count
        count += 1
        if count % 2 == 0:
            old(drive, request)

    return act


def _resume(hooks: Hooks) -> None:
    dropped: list[Goal] = []

    def off(old: Act) -> Act:
        def act(drive: LkDrive, request: Request) -> None:
            dropped.append(drive.motor.goal)
            old(drive, request)

        return act

    def resume(drive: LkDrive, request: Request) -> None:
        drive.motor.go(dropped.pop() if dropped else drive.motor.goal)

    together(on_act("motor_off", off), on_act("motor_on", followed_by(resume)))(hooks)


def _clear_turns(drive: LkDrive, request: Request) -> None:
    drive.motor.clear_turns()


def _turn_off(drive: LkDrive, request: Request) -> None:
    drive.motor.turn_off()


def _clear_all(drive: LkDrive, request: Request) -> None:
    drive.errors.clear()


def _off_at_power_up(hooks: Hooks) -> None:
    on_setup(lambda drive: drive.motor.turn_off())(hooks)
    hooks.powered.append(lambda drive: lk(drive).motor.turn_off())


def _brake_backwards(drive: LkDrive, request: Request) -> None:
    control = request.sent["brake_control"]
    if control != BrakeControl.READ:
        drive.motor.hold(braked=control == BrakeControl.RELEASE)


# --- what is kept -------------------------------------------------------------------------------------------------


def _parameter_lost(drive: LkDrive, name: str, value: int) -> tuple[str, int] | None:
    return None if name in drive.parameters else (name, value)


def _parameter_elsewhere(drive: LkDrive, name: str, value: int) -> tuple[str, int]:
    names = list(drive.parameters)
    return (names[(names.index(name) + 1) % len(names)], value) if name in names else (name, value)


def _parameter_kept(drive: LkDrive, name: str, value: int) -> tuple[str, int]:
    drive.settings[name] = value
    return name, value


def _zero_lost(drive: LkDrive, name: str, value: int) -> tuple[str, int] | None:
    return None if name == "encoder_zero" else (name, value)


def _zero_now(drive: LkDrive, request: Request) -> None:
    drive.motor.encoder_zero = drive.settings["encoder_zero"]
    drive.motor.set_position(drive.motor.within_turn)


def _position_kept(hooks: Hooks) -> None:
    origins: list[float] = []

    def remember(drive: LkDrive, request: Request) -> None:
        origins[:] = [drive.motor.origin]

    def powered(drive: LkDrive) -> None:
        if origins:
            drive.motor.origin = origins[0]

    on_act("set_position", followed_by(remember))(hooks)
    hooks.powered.append(lambda drive: powered(lk(drive)))


def _other_model(name: str, models: tuple[str, ...]) -> Install:
    """Let the models that lack a command have it."""

    def setup(drive: LkDrive) -> None:
        if drive.dialect.model not in models:
            drive.learn(DIALECT.by_name[name], ACTS[name])

    return on_setup(setup)


FAULTS: tuple[Fault, ...] = (
    # --- motion ---------------------------------------------------------------------------------------------------
    _fault(
        "lk-single-turn-inverted",
        "0xA5 and 0xA6 turn in the other direction",
        "direction",
        on_asked("direction", _invert, SINGLE_TURN),
    ),
    _fault(
        "lk-single-turn-shortest",
        "0xA5 and 0xA6 take the shortest way whatever the direction",
        "direction",
        _moves(SINGLE_TURN, _shortest),
    ),
    _fault("lk-speed-inverted", "0xA2 runs in the other direction", "direction", on_asked("speed", lambda v: -v)),
    _fault(
        "lk-increment-absolute",
        "0xA7 and 0xA8 move to a position instead of by a distance",
        "relative and absolute",
        _moves(INCREMENTS, _as_absolute),
    ),
    _fault(
        "lk-multi-turn-relative",
        "0xA3 and 0xA4 move by a distance instead of to a position",
        "relative and absolute",
        _moves(MULTI_TURN, _as_relative),
    ),
    _fault("lk-max-speed-ignored", "max_speed of 0xA4, 0xA6 and 0xA8 is not kept", "limits", on_request(_unlimited, LIMITED)),
    _fault("lk-speed-limit-ignored", "the speed limit of 0xC1 has no effect", "limits", _unheld_limit("speed_limit")),
    _fault("lk-speed-ramp-ignored", "the speed ramp of 0xC1 has no effect", "limits", _unheld_limit("speed_ramp")),
    _fault("lk-torque-limit-ignored", "the torque limit of 0xC1 has no effect", "limits", _unheld_limit("torque_limit")),
    _fault(
        "lk-angle-limit-ignored", "0xA3 and 0xA4 go beyond the angle limit", "limits", _moves(MULTI_TURN, _past_angle_limit)
    ),
    _fault("lk-ramp-fast", "accelerations are twice the ramp", "ramp", _rebuilt(ramp_error=2.0)),
    _fault("lk-ramp-slow", "accelerations are half the ramp", "ramp", _rebuilt(ramp_error=0.5)),
    _fault("lk-overshoot", "moves overshoot by 3 degrees and come back", "ramp", _rebuilt(overshoot=OVERSHOOT)),
    _fault(
        "lk-stops-short",
        "moves end half a degree before their position",
        "position",
        together(*(on_act(name, followed_by(_land_short)) for name in (*MULTI_TURN, *SINGLE_TURN, *INCREMENTS))),
    ),
    # --- on, off, stop --------------------------------------------------------------------------------------------
    _fault("lk-stop-is-off", "0x81 turns the motor off", "stop", on_act("stop", instead(_turn_off))),
    _fault(
        "lk-stop-coasts",
        "0x81 takes the torque away and lets the shaft run out",
        "stop",
        on_act("stop", instead(lambda drive, request: drive.motor.release())),
    ),
    _fault("lk-stop-ignored", "0x81 is answered and does nothing", "stop", on_act("stop", instead(nothing))),
    _fault("lk-stop-clears-turns", "0x81 drops the counted turns", "stop", on_act("stop", followed_by(_clear_turns))),
    _fault("lk-off-still-moves", "motion commands are obeyed while the motor is off", "off", on_setup(_disobedient)),
    _fault("lk-off-keeps-running", "0x80 does not end a motion under way", "off", on_act("motor_off", instead(_keep_running))),
    _fault("lk-off-ignored", "0x80 is answered and does nothing", "off", on_act("motor_off", instead(nothing))),
    _fault("lk-on-needed-twice", "only each second 0x88 turns the motor on", "on", on_act("motor_on", _second_time)),
    _fault("lk-on-resumes", "0x88 takes up the motion that 0x80 ended", "on", _resume),
    _fault("lk-off-at-power-up", "the motor is off after power-up", "on", _off_at_power_up),
    # --- brake and errors -----------------------------------------------------------------------------------------
    _fault("lk-brake-without-effect", "the brake does not hold the shaft", "brake", _rebuilt(brake=False)),
    _fault(
        "lk-brake-backwards",
        "0x8C releases the brake for 00 and holds for 01",
        "brake",
        on_act("brake", instead(_brake_backwards)),
    ),
    _fault(
        "lk-clear-errors-always",
        "0x9B clears flags whose cause lasts",
        "error flags",
        on_act("clear_errors", followed_by(_clear_all)),
    ),
    _fault("lk-clear-errors-never", "0x9B clears nothing", "error flags", on_act("clear_errors", instead(nothing))),
    # --- positions ------------------------------------------------------------------------------------------------
    _fault("lk-set-position-ignored", "0x95 is echoed and does nothing", "position", on_act("set_position", instead(nothing))),
    _fault("lk-set-position-kept", "what 0x95 set survives the power", "power", _position_kept),
    _fault("lk-clear-turns-ignored", "0x93 is echoed and does nothing", "position", on_act("clear_turns", instead(nothing))),
    _fault("lk-zero-at-once", "0x19 moves the zero at once", "zero", on_act("set_zero", followed_by(_zero_now))),
    _fault("lk-zero-lost", "the zero of 0x19 is not there after power-up", "zero", on_store(_zero_lost)),
    # --- parameters -----------------------------------------------------------------------------------------------
    _fault("lk-parameter-not-stored", "0xC1 answers the old values and keeps them", "parameters", on_store(_parameter_lost)),
    _fault(
        "lk-parameter-elsewhere", "0xC1 stores each value in the next one's place", "parameters", on_store(_parameter_elsewhere)
    ),
    _fault("lk-parameter-survives", "what 0xC1 wrote survives the power", "power", on_store(_parameter_kept)),
    # --- models ---------------------------------------------------------------------------------------------------
    _fault("lk-ms-runs-torque", "an MS obeys and answers 0xA1", "models", _other_model("run_torque", CURRENT_MODELS)),
    _fault(
        "lk-runs-open-loop", "an MF, MG or MH obeys and answers 0xA0", "models", _other_model("run_open_loop", POWER_MODELS)
    ),
)
