"""Faults of the LK drives: defects in motion. Some show only on the model that has the command."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace as replaced_limits

from analyzer.catalogue import Verb
from analyzer.codec import codec
from analyzer.protocols.lk_rs485 import CURRENT_MODELS, DIALECT, HUNDREDTH, POWER_MODELS, BrakeControl, SpinDirection
from analyzer.records import Frame, Message
from conformance.drives.drive import Drive, Hooks, Request
from conformance.drives.faults.lk_behaviour import (
    INCREMENTS,
    MULTI_TURN,
    SINGLE_TURN,
    acting,
    at_power_up,
    backwards,
    learning,
    limited_one_way,
    moving,
    nothing,
    rebuilt,
    replaced,
    told_as_limited,
    tuned,
    turns,
    undone,
)
from conformance.drives.faults.numbers import exchanged, negated, renamed
from conformance.drives.faults.places import LK, Change, Row, Rows, asked, faults, together
from conformance.drives.lk.drive import MOVES, Act, LkDrive
from conformance.drives.lk.motor import Goal, Position, Speed, Torque

#: Degrees by which a faulty move overshoots, or stops short.
OVERSHOOT, SHORT = 3.0, 0.5

# --- where a motion goes ---------------------------------------------------------------------------------------------


def _as_absolute(drive: LkDrive, request: Request) -> None:
    drive.motor.move_to(request.physical["position"], request.physical.get("max_speed"))


def _as_relative(drive: LkDrive, request: Request) -> None:
    drive.motor.move_by(request.physical["position"], request.physical.get("max_speed"))


def _less_by_a_digit(way: int) -> Act:
    """Return what moves by a hundredth of a degree less one way."""

    def act(drive: LkDrive, request: Request) -> None:
        by = request.physical["position"]
        drive.motor.move_by(by - way / 100 if by * way > 0 else by, request.physical.get("max_speed"))

    return act


def _shortest(drive: LkDrive, request: Request) -> None:
    way = (request.physical["angle"] - drive.motor.within_turn + 180.0) % 360.0 - 180.0
    drive.motor.move_by(way, request.physical.get("max_speed"))


def _past_angle_limit(drive: LkDrive, request: Request) -> None:
    motor = drive.motor
    motor.go(Position(motor.origin + request.physical["position"], request.physical.get("max_speed")))


def _past_limit_below(drive: LkDrive, request: Request) -> None:
    if request.values["position"] < 0:
        _past_angle_limit(drive, request)
    else:
        drive.motor.move_to(request.physical["position"], request.physical.get("max_speed"))


def _land_short(drive: LkDrive, request: Request) -> None:
    goal = drive.motor.goal
    if isinstance(goal, Position):
        side = 1.0 if goal.angle > drive.motor.motion.angle else -1.0
        drive.motor.go(Position(goal.angle - side * SHORT, goal.top))


def _whole_turns_ignored(drive: LkDrive, request: Request) -> None:
    if request.physical["position"] % 360 or not request.physical["position"]:
        _as_relative(drive, request)


def _fast_long(drive: LkDrive, request: Request) -> None:
    goal = drive.motor.goal
    if (
        isinstance(goal, Position)
        and goal.top is not None
        and goal.top > 600
        and abs(goal.angle - drive.motor.motion.angle) > 180
    ):
        drive.motor.go(Position(goal.angle + (1.0 if goal.angle > drive.motor.motion.angle else -1.0), goal.top))


def _from_the_origin(drive: LkDrive, request: Request) -> None:
    """Turn to an angle from where the position is 0, not from the zero of the encoder."""
    motor, zero = drive.motor, drive.motor.zero
    motor.zero = motor.origin
    motor.turn_to(request.physical["angle"], clockwise=request.values["direction"] == SpinDirection.CW)
    motor.zero = zero


#: In degrees: the least way that is nearly a turn, the longest that is a few degrees, and how near two places count as one.
_NEARLY_A_TURN, _FEW_DEGREES, _SAME = 340, 10, 0.1


def _left(drive: LkDrive, request: Request) -> tuple[bool, float]:
    """Return whether a move within the turn is told to go clockwise, and how far that is."""
    clockwise = request.values["direction"] == SpinDirection.CW
    return clockwise, (request.physical["angle"] - drive.motor.within_turn) * (1 if clockwise else -1) % 360


def _short_of_a_turn(drive: LkDrive, request: Request) -> None:
    clockwise, left = _left(drive, request)
    other = _NEARLY_A_TURN < left < 360 - _SAME
    drive.motor.turn_to(request.physical["angle"], clockwise=clockwise != other, top=request.physical["max_speed"])


def _round_across_zero(drive: LkDrive, request: Request) -> None:
    clockwise, left = _left(drive, request)
    crosses = (request.physical["angle"] < drive.motor.within_turn) is clockwise
    other = _SAME < left < _FEW_DEGREES and crosses
    drive.motor.turn_to(request.physical["angle"], clockwise=clockwise != other)


def _from_given_up(hooks: Hooks) -> None:
    given_up: list[float] = []

    def stop(old: Act, drive: LkDrive, request: Request) -> None:
        given_up[:] = [drive.motor.goal.angle] if isinstance(drive.motor.goal, Position) and turns(drive) else []
        old(drive, request)

    def move(drive: LkDrive, request: Request) -> None:
        begin = given_up.pop() if given_up else drive.motor.motion.angle
        drive.motor.go(Position(begin + request.physical["position"]))

    replaced("stop", stop).install(hooks)
    moving(("move_increment",), move).install(hooks)


def _repeating(drive: LkDrive) -> None:
    """Run once more as before where 0xA2 comes without its data."""
    run, last = DIALECT.by_verb[Verb.RUN_SPEED], [0.0]

    def accept(_: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        if wanted and message.command is not None and message.command.verb is Verb.RUN_SPEED:
            last[0] = codec(run.request_forms[0].layout).wire(message.data)["speed"] * HUNDREDTH
        head = bytes((frame.data[0], run.code, drive.address, 0))
        if frame.data == head + bytes((sum(head) & 0xFF,)) and drive.obeys:
            drive.motor.go(Speed(float(last[0])))
        return wanted

    drive.hooks.accept.append(accept)


# --- how fast --------------------------------------------------------------------------------------------------------


def _without_effect(name: str) -> Change:
    """Let a limit of the control parameters have no effect: the motor keeps the one of power-up."""

    def act(drive: LkDrive, request: Request) -> None:
        written = dict(drive.parameters)
        drive.parameters[name] = drive.settings[name]
        drive.motor.limit(drive.limits)
        drive.parameters.update(written)

    return acting("write_parameter", act, after=True)


def _late_ramp(hooks: Hooks) -> None:
    """Keep to the acceleration of before until a motion begins from rest."""

    def write(old: Act, drive: LkDrive, request: Request) -> None:
        before = drive.motor.limits.acceleration
        old(drive, request)
        if turns(drive):
            drive.motor.limit(replaced_limits(drive.limits, acceleration=before))

    def run(old: Act, drive: LkDrive, request: Request) -> None:
        if not turns(drive):
            drive.motor.limit(drive.limits)
        old(drive, request)

    together(replaced("write_parameter", write), replaced("run_speed", run))(hooks)


def _late_limit(name: str) -> Change:
    """Keep to a limit of before while the shaft turns."""

    def write(old: Act, drive: LkDrive, request: Request) -> None:
        before = getattr(drive.motor.limits, name)
        old(drive, request)
        if turns(drive):
            drive.motor.limit(replaced_limits(drive.limits, **{name: before}))

    return replaced("write_parameter", write)


def _without(name: str, limit: str, when: Callable[[LkDrive, Request], bool] = lambda drive, request: True) -> Change:
    """Let a motion be carried out beyond a limit of the motor, in a condition."""

    def act(old: Act, drive: LkDrive, request: Request) -> None:
        motor, kept = drive.motor, drive.motor.limits
        if when(drive, request):
            motor.limits = replaced_limits(kept, **{limit: 2048.0 if limit == "torque" else 4 * kept.acceleration})
        old(drive, request)
        motor.limits = kept

    return replaced(name, act)


def _turned_round(drive: LkDrive, request: Request) -> bool:
    return request.physical["speed"] * drive.motor.motion.speed < 0


def _slowed(drive: LkDrive, request: Request) -> bool:
    speed = drive.motor.motion.speed
    return request.physical["speed"] * speed > 0 and abs(request.physical["speed"]) < abs(speed)


def _faster_below(drive: LkDrive, request: Request) -> bool:
    return drive.obeys and request.physical["speed"] < drive.motor.motion.speed < 0


def _half_as_fast_below(drive: LkDrive, request: Request) -> None:
    position, top = request.physical["position"], request.physical["max_speed"]
    drive.motor.move_to(position, top / 2 if position < 0 else top)


def _unlimited_run_below(drive: LkDrive, request: Request) -> None:
    """Run counter-clockwise past the speed limit."""
    kept = drive.motor.limits
    if request.physical["speed"] < 0:
        drive.motor.limits = replaced_limits(kept, speed=drive.motor.build.top_speed)
    drive.motor.go(Speed(request.physical["speed"]))
    drive.motor.limits = kept


def _unlimited_clockwise(drive: LkDrive, request: Request) -> None:
    """Turn by an increment, clockwise as fast as the motor can."""
    distance = request.physical["position"]
    drive.motor.move_by(distance, drive.motor.build.top_speed if distance > 0 else None)


def _keeping_speed(hooks: Hooks) -> None:
    """Let the speed of a limited increment hold for the move to a position behind it."""
    tops: list[float] = []

    def limited(drive: LkDrive, request: Request) -> None:
        tops[:] = [request.physical["max_speed"]]

    def move(drive: LkDrive, request: Request) -> None:
        drive.motor.move_to(request.physical["position"], tops.pop() if tops else None)

    together(acting("move_increment_limited", limited, after=True), moving(("move_multi_turn",), move))(hooks)


# --- what begins and ends it -----------------------------------------------------------------------------------------


def _disobedient(drive: LkDrive) -> None:
    """Let motion commands be obeyed while the motor is off."""
    for name, move in MOVES.items():
        drive.acts[name] = lambda drive, request, move=move: move(drive.motor, request)  # type: ignore[misc]


def _disobedient_back(drive: LkDrive) -> None:
    """Let motion commands of a negative number be obeyed while the motor is off."""
    kept = dict(drive.acts)

    def act(drive: LkDrive, request: Request) -> None:
        back = any(value < 0 for value in request.values.values())
        name = request.command.name
        if back and not drive.motor.on:
            MOVES[name](drive.motor, request)
        else:
            kept[name](drive, request)

    drive.acts.update(dict.fromkeys(MOVES, act))


def _keep_running(drive: LkDrive, request: Request) -> None:
    drive.motor.on = False


def _second_time(hooks: Hooks) -> None:
    count = 0

    def is_first(drive: LkDrive, request: Request) -> bool:
        nonlocal count
        count += 1
        return count % 2 == 1

    undone("motor_on", is_first).install(hooks)


def _resuming(hooks: Hooks) -> None:
    dropped: list[Goal] = []

    def off(drive: LkDrive, request: Request) -> None:
        dropped.append(drive.motor.goal)
        drive.motor.turn_off()

    def on(drive: LkDrive, request: Request) -> None:
        drive.motor.go(dropped.pop() if dropped else drive.motor.goal)

    together(acting("motor_off", off), acting("motor_on", on, after=True))(hooks)


def _turned_on(old: Act, drive: LkDrive, request: Request) -> None:
    """Turn a motor on that is off, and do no more."""
    if drive.motor.on:
        old(drive, request)
    drive.motor.on = True


def _stopping(drive: LkDrive, of: type[Goal]) -> None:
    """Let 0x81 leave motion of one kind alone."""
    if not isinstance(drive.motor.goal, of):
        drive.motor.stop()


def _off_unless_torque(drive: LkDrive, request: Request) -> None:
    """Let 0x80 leave a torque as it is."""
    if isinstance(drive.motor.goal, Torque):
        drive.motor.on = False
    else:
        drive.motor.turn_off()


def _dead_after_stop(hooks: Hooks) -> None:
    stopped: list[bool] = []
    together(
        acting("stop", lambda drive, request: stopped.append(True), after=True),
        acting("motor_on", lambda drive, request: stopped.clear(), after=True),
        undone((*MULTI_TURN, *SINGLE_TURN, *INCREMENTS), lambda drive, request: bool(stopped)),
    )(hooks)


def _lost_during(names: Iterable[str], goal: type[Goal], when: Callable[[LkDrive], bool]) -> Change:
    """Answer motion commands that come during a motion of one kind, and do nothing."""
    return undone(tuple(names), lambda drive, request: isinstance(drive.motor.goal, goal) and when(drive))


def _brake_backwards(drive: LkDrive, request: Request) -> None:
    control = request.values["brake_control"]
    if control != BrakeControl.READ:
        drive.motor.hold(braked=control == BrakeControl.RELEASE)


def _read_off(old: Act, drive: LkDrive, request: Request) -> None:
    """Release the brake when it is read while the motor is off."""
    if request.values["brake_control"] == BrakeControl.READ and not drive.motor.on:
        drive.motor.hold(braked=False)
    else:
        old(drive, request)


ROWS: Rows = {
    "off": (
        Row("lk-off-still-moves", "motion commands are obeyed while the motor is off", tuned(_disobedient)),
        Row("lk-while-off-backwards", "motion of a negative number is obeyed while the motor is off", tuned(_disobedient_back)),
        Row("lk-off-keeps-running", "0x80 does not end a motion under way", acting("motor_off", _keep_running)),
        Row("lk-off-keeps-torque", "0x80 does not end a torque or an open loop", acting("motor_off", _off_unless_torque)),
        Row("lk-off-ignored", "0x80 is answered and does nothing", acting("motor_off", nothing)),
    ),
    "position": (
        Row("lk-stops-short", "moves end half a degree before their position",
            moving((*MULTI_TURN, *SINGLE_TURN, *INCREMENTS), _land_short, after=True)),
    ),
    "move lengths": (
        *(
            Row(f"lk-increment-short-{name}", f"0xA7 and 0xA8 {name} end 0.01 degrees short",
                moving(INCREMENTS, _less_by_a_digit(way)))
            for name, way in (("up", 1), ("down", -1))
        ),
        Row("lk-whole-turns-ignored", "0xA7 and 0xA8 by whole turns do nothing", moving(INCREMENTS, _whole_turns_ignored)),
        Row("lk-fast-moves-long", "moves above 600 deg/s end a degree beyond",
            moving((*MULTI_TURN, *INCREMENTS), _fast_long, after=True)),
    ),
    "brake": (
        Row("lk-brake-read-releases", "reading the brake's state releases it",
            asked("brake_control", renamed(BrakeControl.READ, BrakeControl.RELEASE))),
        Row("lk-brake-read-releases-off", "reading the brake of a motor that is off releases it", replaced("brake", _read_off)),
        Row("lk-brake-without-effect", "the brake does not hold the shaft", rebuilt(brake=False)),
        Row("lk-brake-backwards", "0x8C releases the brake for 00 and holds for 01", acting("brake", _brake_backwards)),
    ),
    "direction": (
        Row("lk-single-turn-inverted", "0xA5 and 0xA6 turn in the other direction",
            asked("direction", exchanged(SpinDirection.CW, SpinDirection.CCW))),
        Row("lk-single-turn-shortest", "0xA5 and 0xA6 take the shortest way, for both directions",
            moving(SINGLE_TURN, _shortest)),
        Row("lk-speed-inverted", "0xA2 runs in the other direction", asked("speed", negated)),
    ),
    "relative and absolute": (
        Row("lk-increment-absolute", "0xA7 and 0xA8 move to a position instead of by a distance",
            moving(INCREMENTS, _as_absolute)),
        Row("lk-multi-turn-relative", "0xA3 and 0xA4 move by a distance instead of to a position",
            moving(MULTI_TURN, _as_relative)),
    ),
    "limits": (
        Row("lk-max-speed-ignored", "max_speed of 0xA4, 0xA6 and 0xA8 is not kept",
            asked("max_speed", lambda value, field: field.high)),
        Row("lk-speed-limit-ignored", "the speed limit of 0xC1 has no effect", _without_effect("speed_limit")),
        Row("lk-speed-ramp-ignored", "the speed ramp of 0xC1 has no effect", _without_effect("speed_ramp")),
        Row("lk-torque-limit-of-runs-alone", "the torque limit has no effect on 0xA7",
            _without("move_increment", "torque")),
        Row("lk-torque-half-range", "0xA1 gives 1024 at most",
            asked("torque_current", lambda value, field: max(-1024, min(1024, value)))),
        Row("lk-max-speed-kept", "the max_speed of 0xA8 limits the next 0xA3", Change(_keeping_speed, LK)),
        Row("lk-torque-limit-one-way", "the torque limit does not hold for a torque below 0", tuned(limited_one_way)),
        Row("lk-torque-limit-told-one-way", "the torque limit does not hold for a torque below 0, which 0x9C tells as limited",
            tuned(told_as_limited)),
        Row("lk-torque-limit-ignored", "the torque limit of 0xC1 has no effect", _without_effect("torque_limit")),
        Row("lk-angle-limit-ignored", "0xA3 and 0xA4 go beyond the angle limit", moving(MULTI_TURN, _past_angle_limit)),
    ),
    "ramp": (
        Row("lk-ramp-fast", "accelerations are twice the ramp", rebuilt(ramp_error=2.0)),
        Row("lk-ramp-slow", "accelerations are half the ramp", rebuilt(ramp_error=0.5)),
        Row("lk-ramp-steep-turning-round", "0xA2 turns the shaft round by four times the ramp",
            _without("run_speed", "acceleration", _turned_round)),
        Row("lk-ramp-steep-slowing", "0xA2 slows the shaft down by four times the ramp",
            _without("run_speed", "acceleration", _slowed)),
        Row("lk-overshoot", "moves overshoot by 3 degrees and come back", rebuilt(overshoot=OVERSHOOT)),
    ),
    "stop": (
        Row("lk-stop-is-off", "0x81 turns the motor off", acting("stop", lambda drive, request: drive.motor.turn_off())),
        Row("lk-stop-coasts", "0x81 takes the torque away and lets the shaft run out",
            acting("stop", lambda drive, request: drive.motor.release())),
        Row("lk-stop-ignored", "0x81 is answered and does nothing", acting("stop", nothing)),
        Row("lk-stop-keeps-torque", "0x81 does not end a torque or an open loop",
            acting("stop", lambda drive, request: _stopping(drive, Torque))),
        Row("lk-stop-keeps-moves", "0x81 does not end a move",
            acting("stop", lambda drive, request: _stopping(drive, Position))),
        Row("lk-stop-needs-on", "after 0x81 moves need 0x88 first", Change(_dead_after_stop, LK)),
        Row("lk-stop-clears-turns", "0x81 drops the counted turns",
            acting("stop", lambda drive, request: drive.motor.clear_turns(), after=True)),
    ),
    "on": (
        Row("lk-on-needed-twice", "only each second 0x88 turns the motor on", Change(_second_time, LK)),
        Row("lk-on-ends-run", "0x88 ends the motion of a motor that is on",
            acting("motor_on", lambda drive, request: drive.motor.stop())),
        Row("lk-increment-turns-on", "0xA7 turns on a motor that is off, and moves nothing",
            replaced("move_increment", _turned_on)),
        Row("lk-on-resumes", "0x88 takes up the motion that 0x80 ended", Change(_resuming, LK)),
        Row("lk-off-at-power-up", "the motor is off after power-up",
            together(tuned(lambda drive: drive.motor.turn_off()), at_power_up(lambda drive: drive.motor.turn_off()))),
    ),
    "state": (
        Row("lk-stop-ignored-backwards", "0x81 is ignored while the shaft turns counter-clockwise",
            undone("stop", lambda drive, _: backwards(drive))),
        Row("lk-brake-lost-while-turning", "0x8C 00 does not brake a shaft that turns",
            undone("brake", lambda drive, request: turns(drive) and request.values["brake_control"] == BrakeControl.POWER_OFF)),
        Row("lk-clear-errors-turns-off", "0x9B turns the motor off",
            acting("clear_errors", lambda drive, request: drive.motor.turn_off(), after=True)),
        Row("lk-increment-lost-in-a-run", "0xA7 and 0xA8 are answered and lost while the shaft runs",
            _lost_during(INCREMENTS, Speed, turns)),
        Row("lk-run-lost-in-a-move", "0xA2 is answered and lost during a move", _lost_during(("run_speed",), Position, turns)),
        Row("lk-move-lost-in-a-torque", "0xA3 and 0xA4 are answered and lost while a torque turns the shaft",
            _lost_during(MULTI_TURN, Torque, turns)),
        Row("lk-single-turn-lost-backwards", "0xA5 and 0xA6 are answered and lost while the shaft turns counter-clockwise",
            _lost_during(SINGLE_TURN, Speed, backwards)),
        Row("lk-slow-runs-stand", "0xA2 below 1 deg/s turns nothing",
            asked("speed", lambda value, field: value if abs(value) >= 100 else 0, Verb.RUN_SPEED)),
        Row("lk-single-turn-by-position", "0xA5 counts from where 0x95 set the position",
            moving(SINGLE_TURN[:1], _from_the_origin)),
        Row("lk-nearly-a-turn-round", "0xA6 by nearly a turn goes the short way, the other way round",
            moving(SINGLE_TURN[1:], _short_of_a_turn)),
        Row("lk-few-degrees-round", "0xA5 by few degrees across zero goes the long way, the other way round",
            moving(SINGLE_TURN[:1], _round_across_zero)),
        Row("lk-increment-of-stopped-move", "after 0x81 0xA7 counts from the target of before", Change(_from_given_up, LK)),
        Row("lk-ramp-when-standing", "a ramp that is written while the shaft turns waits until it stands",
            Change(_late_ramp, LK)),
        Row("lk-no-torque-ignored", "0xA1 with 0 leaves the torque of before",
            undone("run_torque",
                lambda drive, request: isinstance(drive.motor.goal, Torque) and not request.values["torque_current"])),
        Row("lk-run-without-data-repeats", "0xA2 without data runs as the one before", tuned(_repeating)),
        Row("lk-run-no-faster-below", "0xA2 speeds up no shaft that turns counter-clockwise",
            undone("run_speed", _faster_below)),
        Row("lk-max-speed-half-below", "0xA4 to a position below zero goes half as fast",
            moving(("move_multi_turn_limited",), _half_as_fast_below)),
        Row("lk-ramp-steep-below", "0xA8 counter-clockwise speeds up four times as fast",
            _without("move_increment_limited", "acceleration", lambda drive, request: request.values["position"] < 0)),
        Row("lk-speed-limit-below-only", "0xA7 clockwise ignores the speed limit",
            moving(("move_increment",), _unlimited_clockwise)),
        Row("lk-run-limit-clockwise-only", "0xA2 counter-clockwise ignores the speed limit",
            moving(("run_speed",), _unlimited_run_below)),
        Row("lk-torque-limit-late",
            "a torque limit that is written while the shaft turns has no effect on the motion under way",
            _late_limit("torque")),
        Row("lk-speed-limit-late", "a speed limit that is written while the shaft turns has no effect on the motion under way",
            _late_limit("speed")),
        Row("lk-speed-ramp-late",
            "a speed ramp that is written while the shaft turns has no effect until it is written at rest",
            _late_limit("acceleration")),
        Row("lk-angle-limit-above-only", "positions below zero go beyond the angle limit",
            moving(MULTI_TURN, _past_limit_below)),
    ),
    "models": (
        Row("lk-ms-runs-torque", "an MS obeys and answers 0xA1", learning("run_torque", CURRENT_MODELS)),
        Row("lk-runs-open-loop", "an MF, MG or MH obeys and answers 0xA0", learning("run_open_loop", POWER_MODELS)),
    ),
}  # fmt: skip

FAULTS = faults(ROWS)
