"""Faults of LK drives that show in one condition alone: in a change of a motion, on a part of a ramp, of one error flag.

Rules kept here:
- A fault holds in its condition, and everywhere else the drive does what the manual says.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from analyzer.catalogue import Command, Verb
from analyzer.protocols.lk_rs485 import ERROR_BITS, MotorState
from conformance.drives.drive import Drive, Hooks, Request, Values
from conformance.drives.faults.lk_behaviour import INCREMENTS, MULTI_TURN, SINGLE_TURN, lk, moving, replaced, tuned
from conformance.drives.faults.places import LK, Change, Row, Rows, faults, result, together
from conformance.drives.lk.drive import Act, LkDrive
from conformance.drives.lk.motor import Goal, Limits, Position, Speed
from conformance.drives.lk.paths import Motion, Ramps, Stretch

_FLAGS = tuple(field.name for field in ERROR_BITS)
_STATE_1 = frozenset({Verb.READ_STATE_1, Verb.CLEAR_ERRORS})
_MOVES = (*MULTI_TURN, *SINGLE_TURN, *INCREMENTS)


# --- ramps ------------------------------------------------------------------------------------------------------------


def _steeper(names: tuple[str, ...], times: float, when: Callable[[LkDrive], bool]) -> Change:
    """Let motion commands begin by another ramp in a condition."""

    def act(old: Act, drive: LkDrive, request: Request) -> None:
        motor, kept = drive.motor, drive.motor.limits
        if when(drive):
            motor.limits = replace(kept, acceleration=kept.acceleration * times)
        old(drive, request)
        motor.limits = kept

    return replaced(names, act)


def _turning(drive: LkDrive) -> bool:
    return bool(drive.motor.motion.speed)


def _bent(ramps: Ramps, first: float, last: float, which: Callable[[float, float], bool]) -> Ramps:
    """Return a path whose ramps begin and end by other slopes, with the place of its end; `which` ramps, by their speeds."""
    speed, found, cruise = ramps.speed, list[Stretch](), -1
    for stretch in ramps.stretches:
        change = stretch.acceleration * stretch.seconds
        if change and which(speed, speed + change):
            for share in (first, last):
                slope = stretch.acceleration * share
                found.append(Stretch(change / 2 / slope, slope))
        else:
            cruise = len(found) if not change else cruise
            found.append(stretch)
        speed += change
    bent = replace(ramps, stretches=tuple(found))
    if ramps.rest is None or cruise < 0:
        return replace(bent, rest=None)
    # What the ramps go farther, the way between them goes less.
    top = sum((s.acceleration * s.seconds for s in found[:cruise]), ramps.speed)
    missing = ramps.end - replace(bent, rest=None).end
    lasts = found[cruise].seconds + missing / top
    if lasts < 0:
        return ramps
    return replace(bent, stretches=(*found[:cruise], Stretch(lasts, 0.0), *found[cruise + 1 :]))


def _bending(
    kind: type[Position] | type[Speed], first: float, last: float, which: Callable[[float, float], bool]
) -> Callable[[LkDrive], None]:
    def change(drive: LkDrive) -> None:
        motor = drive.motor
        plan = motor._plan

        def bend(now: Motion) -> None:
            plan(now)
            path = motor._path
            if isinstance(motor.goal, kind) and isinstance(path, Ramps):
                motor._path = _bent(path, first, last, which)

        motor._plan = bend  # type: ignore[method-assign]

    return change


def _rises(before: float, after: float) -> bool:
    return abs(after) > abs(before)


def _falls(before: float, after: float) -> bool:
    return math.isclose(after, 0.0, abs_tol=1e-9) and abs(before) > 0


def _keeps_faster(drive: LkDrive) -> None:
    """Turn on at the speed of the older motion where the top of a newer one is lower."""
    go = drive.motor.go

    def faster(goal: Goal) -> None:
        older = drive.motor.goal
        if _turning(drive) and isinstance(goal, Position) and isinstance(older, Position) and older.top and goal.top:
            goal = replace(goal, top=max(goal.top, older.top))
        elif _turning(drive) and isinstance(goal, Speed) and isinstance(older, Speed) and goal.speed:
            goal = replace(goal, speed=math.copysign(max(abs(goal.speed), abs(older.speed)), goal.speed))
        go(goal)

    drive.motor.go = faster  # type: ignore[method-assign]


# --- what is told -----------------------------------------------------------------------------------------------------


def _install_off_forgotten(hooks: Hooks) -> None:
    turned: list[bool] = []

    def tell(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
        stands = turned and abs(lk(drive).motor.motion.speed) < 1
        return values | {"state": int(MotorState.ON)} if stands else values

    def switch(old: Act, drive: LkDrive, request: Request) -> None:
        turned[:] = [True] if request.command.name == "motor_off" and _turning(drive) else []
        old(drive, request)

    together(replaced(("motor_off", "motor_on"), switch), result(tell, _STATE_1))(hooks)


_off_forgotten = Change(_install_off_forgotten, LK)


def _on_while_it_turns(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
    """Tell a motor that is off as on while its shaft runs out."""
    return values | {"state": int(MotorState.ON)} if _turning(lk(drive)) and "state" in values else values


def _offset_of_next(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
    """Tell the stored offset, although the drive uses the older one until power comes on again."""
    return values | {"encoder_offset": drive.settings["encoder_zero"]}


def _raw_of_before(drive: LkDrive) -> None:
    """Answer 0x19 with the raw value that 0x90 told last."""
    last = 0

    def tell(_: Drive, command: Command, asked: Values, values: Values | None) -> Values | None:
        nonlocal last
        if values is not None and command.verb is Verb.READ_ENCODER:
            last = values["encoder_raw"]
        return values | {"encoder_zero": last} if values is not None and command.verb is Verb.SET_ZERO else values

    drive.hooks.result.append(tell)


# --- error flags ------------------------------------------------------------------------------------------------------


def _clearing(change: Callable[[LkDrive, set[str]], set[str]]) -> Change:
    """Let 0x9B leave other flags; `change` is given those of before."""

    def act(old: Act, drive: LkDrive, request: Request) -> None:
        before = set(drive.errors)
        old(drive, request)
        drive.errors = change(drive, before)

    return replaced("clear_errors", act)


def _lowest_alone(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
    """Tell the lowest flag that is set, and no other."""
    told = [name for name in reversed(_FLAGS) if values.get(name)]
    return values | dict.fromkeys(told[1:], 0)


def _silent_with(flag: str) -> Change:
    """Answer nothing but 0x9A and 0x9B with a flag."""
    exempt = ("read_state_1", "clear_errors")
    told = result(
        lambda drive, command, asked, values: values if flag not in lk(drive).errors or command.name in exempt else None
    )
    return Change(told.install, LK)


def _limits(change: Callable[[Limits], Limits]) -> Change:
    """Give the motor other limits than the parameters say."""

    def tune(drive: LkDrive) -> None:
        limit = drive.motor.limit
        drive.motor.limit = lambda limits: limit(change(limits))  # type: ignore[method-assign]

    return tuned(tune)


def _speed_of_16_bits(drive: Drive, command: Command, sent: Values, values: Values) -> Values:
    """Tell a speed that was kept in 16 bits of 0.1 deg/s."""
    if not {"speed", "encoder"} <= values.keys():
        return values
    tenths = (values["speed"] * 10 + 0x8000 & 0xFFFF) - 0x8000
    return values | {"speed": int(tenths / 10)}


def _held_in_new_count(old: Act, drive: LkDrive, request: Request) -> None:
    """Let a shaft at rest go to the number of the place that it holds, in the count that 95 sets."""
    motor = drive.motor
    goal, before = motor.goal, motor.origin
    old(drive, request)
    if isinstance(goal, Position) and drive.obeys and not motor.motion.speed:
        motor.go(replace(goal, angle=goal.angle + motor.origin - before))


def _named_less(when: Callable[[LkDrive], bool]) -> Change:
    """Call a place by a hundredth of a degree less in a condition, where that is below zero."""

    def act(old: Act, drive: LkDrive, request: Request) -> None:
        old(drive, request)
        if when(drive) and request.physical["position"] < 0:
            drive.motor.origin += 0.01

    return replaced("set_position", act)


CONDITIONS: Rows = {
    "within a range": (
        Row("lk-high-speed-limits-ignored", "a speed limit above 30 rpm has no effect",
            _limits(lambda limits: replace(limits, speed=limits.speed if limits.speed <= 180 else 720.0))),
        Row("lk-wide-angle-limits-ignored", "an angle limit of more than a turn has no effect",
            _limits(lambda limits: replace(limits, angle=limits.angle if limits.angle <= 360 else 1e9))),
    ),
    "brake": tuple(
        Row(f"lk-{kind}-release-brake", f"{text} releases a brake that holds",
            moving(names, lambda drive, request: drive.motor.hold(braked=False), after=True))
        for kind, text, names in (
            ("runs", "a run at a speed", ("run_speed",)),
            ("moves", "a move over several turns", MULTI_TURN),
            ("increments", "an increment", INCREMENTS),
        )
    ),
    "what is told": (
        Row("lk-off-at-rest-told-on", "0x9A tells a motor as on that was switched off as it turned, once it stands",
            _off_forgotten),
        Row("lk-speed-of-16-bits", "speeds above 3276 deg/s are told with the other sign", result(_speed_of_16_bits)),
        Row("lk-on-while-turning", "0x9A tells a motor that is off as on while it turns", result(_on_while_it_turns, _STATE_1)),
        Row("lk-offset-of-next", "0x90 tells the offset of 0x19 before it is used", result(_offset_of_next, Verb.READ_ENCODER)),
        Row("lk-zero-raw-stale", "0x19 is answered with the raw value that 0x90 told last", tuned(_raw_of_before)),
    ),
    "new count": (
        Row("lk-held-in-new-count", "0x95 turns a shaft that holds a place to the place of that number",
            replaced("set_position", _held_in_new_count)),
        Row("lk-named-less-while-off", "0x95 with an angle below zero sets 0.01 degrees less while the motor is off",
            _named_less(lambda drive: not drive.motor.on)),
        Row("lk-named-less-when-stopped", "0x95 with an angle below zero sets 0.01 degrees less behind 0x81",
            _named_less(lambda drive: drive.motor.goal == Speed(0.0))),
    ),
    "clear errors": (
        Row("lk-short-circuit-stays", "0x9B never clears the short circuit",
            _clearing(lambda d, b: d.errors | b & {"short_circuit"})),
        Row("lk-high-voltage-cleared", "0x9B clears the high voltage that lasts",
            _clearing(lambda drive, before: drive.errors - {"high_voltage"})),
        Row("lk-several-stay", "0x9B clears nothing where several flags are set",
            _clearing(lambda drive, before: before if len(before) > 1 else drive.errors)),
        Row("lk-lowest-flag-alone", "of several flags the lowest is told", result(_lowest_alone, _STATE_1)),
        Row("lk-silent-when-stalled", "a stalled motor answers 0x9A and 0x9B alone", _silent_with("stalled")),
    ),
    "ramp": (Row("lk-newer-keeps-faster", "a motion that takes over from a faster one keeps its speed", tuned(_keeps_faster)),),
    "one slope": (
        Row("lk-changed-move-steep", "a move that changes another motion has twice the ramp", _steeper(_MOVES, 2.0, _turning)),
        Row("lk-changed-run-flat", "a run that changes another motion has half of the ramp",
            _steeper(("run_speed",), 0.5, _turning)),
        Row("lk-moves-bend", "in the second half of its rise the speed of a move rises twice as fast",
            tuned(_bending(Position, 0.7, 1.75, _rises))),
        Row("lk-runs-bend", "in the second half of its rise the speed of a run rises slowly",
            tuned(_bending(Speed, 1.2, 0.6, _rises))),
        Row("lk-moves-end-soft", "a move comes to its end by a third of the ramp", tuned(_bending(Position, 1.0, 0.3, _falls))),
    ),
}  # fmt: skip

FAULTS = faults(CONDITIONS)
