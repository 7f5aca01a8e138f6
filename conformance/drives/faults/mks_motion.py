"""Faults of motion: ramps, directions, targets, speeds, newer motion, stops, enabling and modes."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

from analyzer.catalogue import Verb
from analyzer.protocols import mks_shared
from conformance.drives.drive import Fault, Values
from conformance.drives.faults.mks_makers import (
    CAN,
    EVERY,
    MOVES,
    SERIAL,
    Install,
    ended,
    given,
    heedless,
    instead,
    lying,
    tuned,
    unstored,
    wrapped,
)
from conformance.drives.mks.core import STOPS, Behaviour, Kind, MksCore, Script
from conformance.drives.mks.motion import TARGETS
from conformance.drives.mks.paths import Number, ramp_step_ns
from conformance.drives.mks.speaker import Order

_COMPLETE, _LIMIT = int(mks_shared.RunStatus.COMPLETE), int(mks_shared.RunStatus.LIMIT_STOP)
_OK: Values = {"status": int(mks_shared.Success.SUCCESS)}
_STARTING: Values = {"status": int(mks_shared.RunStatus.STARTING)}
_PULSE_MOVES = {Verb.MOVE_RELATIVE_PULSES, Verb.MOVE_ABSOLUTE_PULSES}
_AXIS_MOVES = {Verb.MOVE_RELATIVE_AXIS, Verb.MOVE_ABSOLUTE_AXIS}
_RUNS = MOVES | {Verb.RUN_SPEED}
_BEYOND = 1000
_SHORT = 200
_COAST_NS = 2_000_000_000


def _ramp(law: Callable[[int], int]) -> Install:
    """Give the drive another time for one rpm, by the acceleration as sent."""
    return tuned(lambda drive: setattr(drive, "ramp", law))


def _pace(drive: MksCore, order: Order) -> tuple[Number, int]:
    """Return the rpm of a move and its time for one rpm."""
    declared = order.command.request_forms[0].layout.named["speed"].high
    speed = min(int(order.values["speed"]), drive.highest_speed(declared))
    return drive.real_speed(speed), drive.ramp(order.values["acceleration"])


def _as_verb(verb: Verb) -> Callable[[Behaviour], Behaviour]:
    """Do what another command of the same values would do."""
    target = TARGETS[verb]

    def wrap(behaviour: Behaviour) -> Behaviour:
        def act(drive: MksCore, order: Order) -> Values | None:
            aimed, at_ns = target(drive, order), drive.now_ns
            answer = behaviour(drive, order)
            if drive.task is not None and drive.task.order is order and order.values["speed"]:
                drive.motor.move(at_ns, aimed, *_pace(drive, order))
            return answer

        return act

    return wrap


# --- where moves end ----------------------------------------------------------------------------------------


def _beyond(drive: MksCore, order: Order) -> Script:
    """Go beyond the target, and come back before saying that it is done."""
    motor = drive.motor
    target, begin = motor.wanted(motor.settled), motor.wanted(drive.now_ns)
    if order.values["speed"]:
        motor.move(drive.now_ns, target + (_BEYOND if target > begin else -_BEYOND), *_pace(drive, order))
        yield lambda: motor.settled
        motor.move(drive.now_ns, target, *_pace(drive, order))
    yield lambda: motor.settled
    drive.finish(_COMPLETE)


def _short_of(counts: int) -> Install:
    """End moves so many counts from their target, below 0 beyond it."""

    def script(drive: MksCore, order: Order) -> Script:
        motor = drive.motor
        target, begin = motor.wanted(motor.settled), motor.wanted(drive.now_ns)
        if target != begin and order.values["speed"]:
            motor.move(drive.now_ns, target - (counts if target > begin else -counts), *_pace(drive, order))
        yield lambda: motor.settled
        drive.finish(_COMPLETE)

    return ended(script)


def _keeps_going(behaviour: Behaviour) -> Behaviour:
    """Take a newer move for done while an older one is under way, and go on with the older one."""

    def act(drive: MksCore, order: Order) -> Values | None:
        return dict(_STARTING) if drive.doing(Kind.MOVE) else behaviour(drive, order)

    return act


def _stops_first(behaviour: Behaviour) -> Behaviour:
    """Stop the shaft at once before a newer move begins."""

    def act(drive: MksCore, order: Order) -> Values | None:
        if drive.doing(Kind.MOVE):
            drive.motor.halt(drive.now_ns)
        return behaviour(drive, order)

    return act


# --- states that are not looked at ----------------------------------------------------------------------------------


def _as_if(**state: bool) -> Callable[[Behaviour], Behaviour]:
    """Act as if the drive's memory said otherwise."""

    def wrap(behaviour: Behaviour) -> Behaviour:
        def act(drive: MksCore, order: Order) -> Values | None:
            for name, value in state.items():
                setattr(drive.memory, name, value)
            drive.grip()
            return behaviour(drive, order)

        return act

    return wrap


def _ramped_emergency(drive: MksCore, order: Order) -> Values:
    drive.drop()
    drive.memory.run = None
    drive.motor.run(drive.now_ns, 0, ramp_step_ns(200))
    return dict(_OK)


def _coasting(behaviour: Behaviour) -> Behaviour:
    """Answer a stop, and go on for two seconds before it."""

    def act(drive: MksCore, order: Order) -> Values | None:
        rpm = drive.motor.speed(drive.now_ns)
        answer = behaviour(drive, order)
        drive.motor.run(drive.now_ns, rpm, 0)
        drive.begin(Kind.STOP, _coast(drive, order), order)
        return answer

    return act


def _coast(drive: MksCore, order: Order) -> Script:
    end_ns = drive.now_ns + _COAST_NS
    yield lambda: end_ns
    drive.motor.run(drive.now_ns, 0, drive.ramp(order.values["acceleration"]))
    yield lambda: drive.motor.settled
    drive.finish(_COMPLETE)


def _wide(speed: int) -> Callable[[Behaviour], Behaviour]:
    """Refuse a speed above a limit."""

    def wrap(behaviour: Behaviour) -> Behaviour:
        def act(drive: MksCore, order: Order) -> Values | None:
            return drive.refused(order) if order.values["speed"] > speed else behaviour(drive, order)

        return act

    return wrap


def _turn_bus_motion(drive: MksCore) -> None:
    for speaker in drive.speakers:
        speaker.turns_bus_motion = True


FAULTS: tuple[Fault, ...] = (
    # The ramp law
    Fault("ramp-too-fast", EVERY, "ramps take half their time", "ramp", _ramp(lambda a: ramp_step_ns(a) // 2)),
    Fault("ramp-too-slow", EVERY, "ramps take twice their time", "ramp", _ramp(lambda a: 2 * ramp_step_ns(a))),
    Fault("ramp-off-by-one", EVERY, "one rpm takes (255 - acc) x 50 us", "ramp",
          _ramp(lambda a: (255 - a) * 50_000 if a else 0)),
    Fault("ramp-turned-round", EVERY, "the larger the acceleration, the slower the ramp", "ramp",
          _ramp(lambda a: a * 50_000)),
    Fault("acceleration-0-by-formula", EVERY, "acceleration 0 is the slowest ramp", "ramp",
          _ramp(lambda a: (256 - a) * 50_000)),
    Fault("no-ramp", EVERY, "speeds change at once whatever the acceleration", "ramp", _ramp(lambda a: 0)),
    Fault("stop-without-ramp", EVERY, "stops are at once whatever the acceleration", "stop",
          given(STOPS, "acceleration", lambda a: 0)),
    Fault("stop-by-slowest-ramp", EVERY, "stops go by the slowest ramp, also those at once", "stop",
          given(STOPS, "acceleration", lambda a: 1)),
    # Directions and targets
    Fault("run-direction-wrong", EVERY, "F6 turns the other way", "direction",
          given({Verb.RUN_SPEED}, "direction", lambda d: 1 - d)),
    Fault("run-direction-ignored", EVERY, "F6 always turns counter-clockwise", "direction",
          given({Verb.RUN_SPEED}, "direction", lambda d: 0)),
    Fault("relative-pulses-direction-wrong", EVERY, "FD moves the other way", "direction",
          given({Verb.MOVE_RELATIVE_PULSES}, "direction", lambda d: 1 - d)),
    Fault("absolute-pulses-direction-wrong", EVERY, "FE moves to the other side of zero", "direction",
          given({Verb.MOVE_ABSOLUTE_PULSES}, "position", lambda p: -p)),
    Fault("relative-axis-direction-wrong", EVERY, "F4 moves the other way", "direction",
          given({Verb.MOVE_RELATIVE_AXIS}, "position", lambda p: -p)),
    Fault("absolute-axis-direction-wrong", EVERY, "F5 moves to the other side of zero", "direction",
          given({Verb.MOVE_ABSOLUTE_AXIS}, "position", lambda p: -p)),
    Fault("negative-positions-cut", EVERY, "positions below zero are taken for zero", "sign",
          given(MOVES, "position", lambda p: max(p, 0))),
    Fault("position-16-bit", EVERY, "moves by the encoder keep only 16 bits of the position", "width",
          given(_AXIS_MOVES, "position", lambda p: p & 0xFFFF)),
    Fault("pulses-16-bit", EVERY, "FD keeps only 16 bits of the pulses", "width",
          given({Verb.MOVE_RELATIVE_PULSES}, "pulses", lambda p: p & 0xFFFF)),
    Fault("speed-8-bit", EVERY, "speeds keep only their low byte", "width", given(_RUNS, "speed", lambda s: s & 0xFF)),
    Fault("relative-as-absolute", EVERY, "F4 moves to the position instead of by it", "target",
          wrapped({Verb.MOVE_RELATIVE_AXIS}, _as_verb(Verb.MOVE_ABSOLUTE_AXIS))),
    Fault("absolute-as-relative", EVERY, "F5 moves by the position instead of to it", "target",
          wrapped({Verb.MOVE_ABSOLUTE_AXIS}, _as_verb(Verb.MOVE_RELATIVE_AXIS))),
    Fault("absolute-pulses-as-counts", EVERY, "FE takes pulses for encoder counts", "scale",
          wrapped({Verb.MOVE_ABSOLUTE_PULSES}, _as_verb(Verb.MOVE_ABSOLUTE_AXIS))),
    Fault("axis-as-pulses", EVERY, "F5 takes encoder counts for pulses", "scale",
          wrapped({Verb.MOVE_ABSOLUTE_AXIS}, _as_verb(Verb.MOVE_ABSOLUTE_PULSES))),
    Fault("move-pulses-doubled", EVERY, "FD moves by twice the pulses", "scale",
          given({Verb.MOVE_RELATIVE_PULSES}, "pulses", lambda p: 2 * p)),
    Fault("move-ends-short", EVERY, "moves end 200 counts before their target", "target", _short_of(_SHORT)),
    Fault("move-ends-beyond", EVERY, "moves end 200 counts beyond their target", "target", _short_of(-_SHORT)),
    Fault("overshoot", EVERY, "moves go 1000 counts beyond their target and come back", "ramp", ended(_beyond)),
    # Speeds
    Fault("speed-ignores-subdivision", EVERY, "the speed as sent is the real one at every subdivision", "scale",
          tuned(lambda d: setattr(d, "real_speed", lambda speed: speed))),
    Fault("speed-scaled-at-32", EVERY, "at 32 and 64 subdivisions too the speed is reckoned from 16", "scale",
          tuned(lambda d: setattr(d, "real_speed", lambda speed: Fraction(speed * 16, d.subdivision)))),
    Fault("mode-limit-ignored", SERIAL, "every work mode turns up to 3000 rpm", "limit",
          tuned(lambda d: setattr(d, "highest_speed", lambda declared: declared))),
    Fault("speed-unlimited", EVERY, "speeds above 3000 are run", "limit",
          tuned(lambda d: setattr(d, "highest_speed", lambda declared: 0xFFFF))),
    Fault("speed-2900-at-most", EVERY, "3000 rpm is run at 2900", "limit", given(_RUNS, "speed", lambda s: min(s, 2900))),
    Fault("speed-above-3000-refused", EVERY, "speeds above 3000 are refused", "limit", wrapped(_RUNS, _wide(3000))),
    Fault("speed-3000-refused", EVERY, "3000 rpm is refused", "limit", wrapped(_RUNS, _wide(2999))),
    Fault("speed-5-percent-high", EVERY, "F6 turns five per cent too fast", "scale",
          given({Verb.RUN_SPEED}, "speed", lambda s: s * 21 // 20)),
    # Newer motion
    Fault("update-ignored", EVERY, "F5 on the way goes on to the old target", "update",
          wrapped({Verb.MOVE_ABSOLUTE_AXIS}, _keeps_going)),
    Fault("update-stops-first", EVERY, "F5 on the way stops the shaft before it goes on", "update",
          wrapped({Verb.MOVE_ABSOLUTE_AXIS}, _stops_first)),
    Fault("newer-move-ignored", EVERY, "moves are ignored while one is under way", "update", wrapped(MOVES, _keeps_going)),
    # Stops, enabling, modes
    Fault("stop-coasts", EVERY, "a stop begins two seconds late", "stop", wrapped(STOPS, _coasting)),
    Fault("speed-stop-ignored", EVERY, "F6 with speed 0 stops nothing", "stop", lying({Verb.STOP_SPEED})),
    Fault("move-stop-ignored", EVERY, "stops of moves stop nothing", "stop", lying(STOPS - {Verb.STOP_SPEED})),
    Fault("emergency-stop-ignored", EVERY, "F7 stops nothing", "stop", lying({Verb.EMERGENCY_STOP})),
    Fault("emergency-stop-ramps", EVERY, "F7 stops by a ramp", "stop", instead({Verb.EMERGENCY_STOP}, _ramped_emergency)),
    Fault("disable-ignored", EVERY, "F3 00 disables nothing", "enable", lying({Verb.ENABLE})),
    Fault("disabled-moves", EVERY, "a disabled motor moves when told", "enable", wrapped(_RUNS, _as_if(enabled=True))),
    Fault("protected-moves", EVERY, "a protected motor moves when told", "protection",
          wrapped(_RUNS, _as_if(protected=False))),
    Fault("pulse-mode-moves", EVERY, "motion commands work in pulse modes", "mode", heedless("work_mode")),
    # Kept runs, the direction setting
    Fault("clean-ignored", EVERY, "FF CA leaves the run kept for power-on", "stored",
          wrapped({Verb.SAVE_SPEED}, lambda act: lambda d, o: dict(_OK) if o.values["save_state"] == 0xCA else act(d, o))),
    Fault("saved-direction-lost", EVERY, "the run kept for power-on turns counter-clockwise always", "direction",
          unstored("saved_direction")),
    Fault("direction-setting-ignored", (CAN,), "86 does not turn motion by the bus", "direction",
          unstored("motor_direction")),
    Fault("direction-setting-turns-bus", SERIAL, "86 turns motion by the bus", "direction",
          tuned(_turn_bus_motion)),
)  # fmt: skip
