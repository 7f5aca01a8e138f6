"""Faults of the MKS drives in what they tell and do, in one condition alone: while the shaft turns, after a restart.

Rules kept here:
- A fault holds in its condition, and everywhere else the drive does what the manual says.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

from msgspec.structs import replace

from analyzer.catalogue import Command, Verb
from analyzer.protocols import mks_shared
from analyzer.records import Frame
from conformance.drives.drive import Drive, Outgoing, Request, Values
from conformance.drives.faults.mks_behaviour import (
    MOVES,
    OK,
    as_given,
    backwards,
    before,
    by_laws,
    clinging,
    enclose,
    forgetful,
    hold,
    leave_group,
    mks,
    overridden,
    tuned,
    turns,
    when_home,
    with_state,
    wrapped,
)
from conformance.drives.faults.mks_frames import Whom, deaf_to, for_all, of, package, slots, to_group
from conformance.drives.faults.mks_hearing import answers_enabling_in_slots, lost_if_sent, made_ready_by
from conformance.drives.faults.places import (
    CAN,
    CAN_LONGEST,
    MODBUS,
    NATIVE,
    SERIAL,
    TELLING,
    Change,
    Of,
    Row,
    Rows,
    body_of,
    faults,
    frames,
    having,
    rebuilt,
    request,
    result,
    storing,
)
from conformance.drives.mks.core import MOTIONS, STOPS, Activity, Behaviour, MksCore
from conformance.drives.mks.motion import begin_run
from conformance.drives.mks.paths import Phase
from conformance.drives.mks.state import way_of

Condition = Callable[[MksCore], bool]
#: The method of a drive that tells the end of a motion.
Tell = Callable[[Request, Values], None]
#: Speeds beyond which a fault of a fast shaft holds (rpm).
_FAST, _VERY_FAST = 500, 1000
_VERY_SLOW, _CRAWLS = 5, 30
_BY_COUNTS = frozenset({Verb.MOVE_RELATIVE_AXIS, Verb.MOVE_ABSOLUTE_AXIS})
_ENDS = STOPS | {Verb.EMERGENCY_STOP}
_BITS = 16
#: The highest number of a byte, and by how many counts a count of pulses is off.
_BYTE, _BESIDE = 0xFF, 1000
#: What 32 bits of an empty flash read as.
_EMPTY = 0xFFFF_FFFF


def _rpm(drive: MksCore) -> float:
    return float(drive.motor.speed(drive.now_ns))


def _rises(drive: MksCore) -> bool:
    return drive.motor.phase(drive.now_ns) is Phase.SPEEDING_UP


def _falls(drive: MksCore) -> bool:
    return drive.motor.phase(drive.now_ns) is Phase.SLOWING_DOWN


def _faster(rpm: float) -> Condition:
    return lambda drive: abs(_rpm(drive)) > rpm


def _full_and_fast(drive: MksCore) -> bool:
    return abs(_rpm(drive)) > _FAST and drive.motor.phase(drive.now_ns) is Phase.FULL_SPEED


def _slows_to_a_speed(drive: MksCore) -> bool:
    return drive.memory.run is not None and drive.motor.phase(drive.now_ns) is Phase.SLOWING_DOWN


def _moving_by(of: Verb, when: Condition) -> Condition:
    """Return whether a condition holds on the way of a move by a command."""

    def holds(drive: MksCore) -> bool:
        asked = drive.task.request if drive.task is not None else None
        return asked is not None and asked.command.verb is of and when(drive)

    return holds


def told_when(when: Condition, of: Verb, **values: int) -> Change:
    """Tell something else in a condition."""
    return result(lambda drive, command, sent, found: {**found, **values} if when(mks(drive)) else found, of)


def undone_when(when: Condition, of: Of) -> Change:
    """Say in a condition that it is done, and do nothing."""
    return before(of, lambda drive, request: dict(OK) if when(drive) else None)


def refused_when(when: Condition, of: Of) -> Change:
    """Refuse something in a condition."""
    return before(of, lambda drive, request: drive.refused(request) if when(drive) else None)


def stale_when(when: Condition, of: Verb) -> Change:
    """Tell in a condition what was told before it."""

    def change(drive: MksCore) -> None:
        kept: Values = {}

        def tell(_: Drive, command: Command, sent: Values, found: Values | None) -> Values | None:
            if command.verb is not of or found is None:
                return found
            if not when(drive) or not kept:
                kept.update(found)
            return dict(kept)

        drive.hooks.result.append(tell)

    return tuned(change, having(of))


# --- what it tells ----------------------------------------------------------------------------------------------------


def _whole_turns(drive: Drive, command: Command, sent: Values, found: Values) -> Values:
    return {"angle_error": found["angle_error"] + mks(drive).axis // drive.counts_per_turn * 51_200}


def _respond_and_active(drive: Drive, command: Command, sent: Values, found: Values) -> Values:
    return found | {"respond": found["active"], "active": found["respond"]} if "active" in found else found


def _in_place_on_its_way(drive: Drive, command: Command, sent: Values, found: Values) -> Values:
    task = mks(drive).task
    by_counts = task is not None and task.request is not None and task.request.command.verb in _BY_COUNTS
    return {**found, "pend": 1} if by_counts else found


def _give_ports_back(drive: MksCore, request: Request) -> None:
    drive.memory.alm_mask = drive.memory.pend_mask = 0


def _long_speed(drive: MksCore) -> None:
    """Answer 32 with the most bytes of a frame, once the drive has restarted."""

    def say(_: Drive, command: Command, outgoing: Outgoing) -> tuple[Outgoing]:
        if command.verb is not Verb.READ_SPEED or not restarted:
            return (outgoing,)
        return (rebuilt(drive, outgoing, body_of(drive, outgoing).ljust(CAN_LONGEST - 1, b"\0")),)

    restarted = False
    begin = drive.power_on

    def power_on(core: MksCore) -> None:
        nonlocal restarted
        restarted = restarted or core.now_ns > 0
        begin(core)

    drive.power_on = power_on
    drive.hooks.reply.append(say)


def _zero_check(drive: Drive, command: Command, outgoing: Outgoing) -> tuple[Outgoing]:
    data = outgoing.data
    return (Outgoing(outgoing.at_ns, data[:-1] + b"\1" if data[-1] == 0 else data, outgoing.can_id),)


TOLD: Rows = {
    "order": (Row("respond-behind-active", "00 8C tells active first", result(_respond_and_active, Verb.READ_PARAMETER), CAN),),
    "frozen": (
        Row("carry-frozen-when-fast", "30 stays above 500 rpm", stale_when(_faster(_FAST), Verb.READ_ENCODER_CARRY)),
        Row("pulses-counted-at-rest", "33 counts when the motion is over", stale_when(turns, Verb.READ_PULSES)),
    ),
    "status": (
        Row("fast-status-2", "F1 reads 2 at full speed above 500 rpm", told_when(_full_and_fast, Verb.READ_STATUS, status=2)),
        Row("open-status-0", "F1 reads 0 while the shaft turns in an open mode",
            told_when(lambda drive: "open" in drive.mode and turns(drive), Verb.READ_STATUS, status=0)),
        Row("slower-status-2", "F1 reads 2 while a run goes over to a lower speed",
            told_when(_slows_to_a_speed, Verb.READ_STATUS, status=2)),
        Row("falling-pulses-full", "F1 reads 4 while a move by FE slows down",
            told_when(_moving_by(Verb.MOVE_ABSOLUTE_PULSES, _falls), Verb.READ_STATUS, status=4)),
        Row("rising-pulses-stopped", "F1 reads 1 while a move by FD speeds up",
            told_when(_moving_by(Verb.MOVE_RELATIVE_PULSES, _rises), Verb.READ_STATUS, status=1)),
        Row("in-place-on-its-way", "PEND is 1 on the way of F4 and F5", result(_in_place_on_its_way, Verb.READ_IO), CAN),
        Row("off-while-turning", "3A reads 0 while the shaft turns", told_when(turns, Verb.READ_ENABLED, enabled=0)),
        Row("protected-while-turning", "3E reads 1 while the shaft turns", told_when(turns, Verb.READ_PROTECTION, status=1)),
    ),
    "scale": (
        Row("error-counts-turns", "39 tells the turns made", result(_whole_turns, Verb.READ_ANGLE_ERROR)),
        Row("slow-speed-zero", "32 tells 0 below 5 rpm",
            result(lambda d, c, q, found: {"speed": 0} if abs(found["speed"]) < _VERY_SLOW else found, Verb.READ_SPEED)),
        Row("slow-speed-tenfold", "32 tells tenths of a rpm below 20 rpm",
            result(lambda d, c, q, found: {"speed": found["speed"] * 10} if abs(found["speed"]) < 20 else found,
                Verb.READ_SPEED)),
    ),
    "ports": (Row("ports-given-back-by-moves", "a move gives written ports back", before(MOVES, _give_ports_back), CAN),),
    "reply layout": (
        Row("speed-long-after-restart", "32 is answered with four bytes more after a restart", tuned(_long_speed), CAN),
    ),
    "reply checksum": (Row("zero-check-sent-1", "a checksum that is 0 is sent as 1", frames(_zero_check), NATIVE),),
}  # fmt: skip


# --- what it does -----------------------------------------------------------------------------------------------------


def _latched(drive: MksCore) -> None:
    """Refuse motion after an emergency stop until the motor is enabled."""
    latched = False

    def watch(_: Drive, command: Command, values: Values) -> Values:
        nonlocal latched
        latched = command.verb is Verb.EMERGENCY_STOP or (latched and command.verb is not Verb.ENABLE)
        return values

    drive.hooks.request.append(watch)
    enclose(drive, MOTIONS, lambda obey, core, request: core.refused(request) if latched else obey(core, request))


def _halt_first(drive: MksCore, request: Request) -> None:
    if request.values["enabled"]:
        drive.motor.halt(drive.now_ns)


def _halted(drive: MksCore, request: Request) -> None:
    drive.motor.halt(drive.now_ns)


def _low_word(drive: MksCore, request: Request) -> Values | None:
    """Clear the low 16 bits of the position."""
    drive.memory.zero += drive.axis & (1 << _BITS) - 1
    return dict(OK)


def _beyond(drive: Drive, command: Command, values: Values) -> Values:
    """Go farther than was asked where there is no ramp."""
    name = "pulses" if "pulses" in values else "position"
    return values if values["acceleration"] else values | {name: values[name] + 60}


def _slow_when_fast(drive: Drive, command: Command, values: Values) -> Values:
    """Stop a fast shaft by a ramp where it is to stand at once."""
    fast = _faster(_VERY_FAST)(mks(drive)) and not values["acceleration"]
    return values | {"acceleration": _HALF_BYTE} if fast else values


def _as_sent_at_128(drive: Drive, command: Command, values: Values) -> Values:
    fast = mks(drive).subdivision == _FINE
    return values | {"speed": values["speed"] * _FINE // mks_shared.SUBDIVISION.counted_at} if fast else values


def _back_as(change: Callable[[MksCore], Mapping[str, int]]) -> Change:
    """Go back to the zero at power-on as though some settings were others."""

    def other(power_on: Callable[[MksCore], None], drive: MksCore, _: MksCore) -> None:
        changed = change(drive)
        kept = {name: drive.settings[name] for name in changed}
        drive.settings.update(changed)
        try:
            power_on(drive)
        finally:
            drive.settings.update(kept)

    return overridden("power_on", other, having(Verb.SET_ZERO_MODE))


def _back_with(name: str, change: Callable[[int], int]) -> Change:
    """Go back to the zero at power-on as though a setting was another one."""
    return _back_as(lambda drive: {name: change(drive.settings[name])})


def _way_up(drive: MksCore) -> float:
    """Return how far the kept zero is above the shaft, in turns."""
    turn = mks_shared.COUNTS_PER_TURN
    return float((drive.settings["zero_point"] - drive.motor.position(drive.now_ns)) % turn / turn)


def _near_by_quarters(drive: MksCore) -> Mapping[str, int]:
    """Take the longer way where the shorter one is up and more than a quarter of a turn."""
    long = drive.settings["zero_mode"] == mks_shared.ZeroMode.NEAR and 0.25 < _way_up(drive) <= 0.5
    return {"zero_mode": int(mks_shared.ZeroMode.DIRECTION), "zero_direction": _CLOCKWISE} if long else {}


_CLOCKWISE = int(mks_shared.ConfigDirection.CW)


def _slow_open_home(held: Callable[[], Mapping[str, int]], drive: MksCore) -> Mapping[str, int]:
    return {**held(), "home_speed": held()["home_speed"] // 2} if "open" in drive.mode else held()


def _turned_by_setting(drive: Drive, command: Command, values: Values) -> Values:
    return values | {"position": -values["position"]} if drive.settings["motor_direction"] else values


def _back(drive: Drive, command: Command, values: Values) -> Values:
    """Take pulses for a number with a sign."""
    high = values["pulses"] >> 31
    return values | {"direction": 1 - values["direction"], "pulses": (1 << 32) - values["pulses"]} if high else values


def _after_restart(change: Callable[[MksCore], None]) -> Change:
    """Make a change when the drive restarts."""

    def install(drive: MksCore) -> None:
        power_on, first = drive.power_on, True

        def started(core: MksCore) -> None:
            nonlocal first
            if not first:
                change(core)
            first = False
            power_on(core)

        drive.power_on = started

    return tuned(install)


def _speeds_as_sent(drive: MksCore) -> None:
    drive.real_speed = lambda speed: speed  # type: ignore[method-assign]


def _complete_at_right(drive: MksCore) -> None:
    """Tell a move that the right end limit stops as complete."""
    finish, at_right = drive.finish, False
    stop = drive._limit_stop

    def stopped() -> None:
        nonlocal at_right
        at_right = _rpm(drive) * way_of(drive.settings["home_direction"]) < 0
        stop()

    def finished(status: int | None) -> None:
        told_so = status == mks_shared.RunStatus.LIMIT_STOP and at_right
        finish(mks_shared.RunStatus.COMPLETE if told_so else status)

    drive._limit_stop, drive.finish = stopped, finished  # type: ignore[method-assign]


def _pulses_beside(drive: MksCore) -> None:
    """Count pulses from beside where homing without a switch ended."""
    if drive.home_settings()["home_mode"] == mks_shared.HomeMode.NO_LIMIT:
        drive.memory.pulse_zero += _BESIDE


def _address_unset(drive: MksCore) -> None:
    """Take an address of more than a byte for none."""
    if drive.settings["new_address"] > _BYTE:
        drive.settings["new_address"] = 1
        drive.tune()


def _run_without_direction(drive: MksCore) -> None:
    """Begin a kept run the other way where the setting of the direction turns motion."""
    if drive.settings["motor_direction"]:
        drive.settings["saved_direction"] ^= 1


def _number_unset(drive: MksCore) -> None:
    """Take the highest number for memory that is empty."""
    if drive.settings["user_id"] == _EMPTY:
        drive.settings["user_id"] = 0


def _coarse(drive: MksCore) -> None:
    if drive.subdivision > _HALF_BYTE + 1:
        drive.settings["subdivision"] = _BITS


def _slow_home(drive: MksCore) -> None:
    drive.settings["home_speed"] &= 0xFF


def _runs_round(drive: MksCore) -> None:
    drive.hooks.request.append(
        lambda d, command, values: values | {"direction": 1 - values["direction"]} if command.verb is Verb.RUN_SPEED else values
    )


def _once(power_on: Callable[[MksCore], None], drive: MksCore, _: MksCore) -> None:
    """Forget the saved run when it has begun."""
    power_on(drive)
    if drive.memory.run is not None:
        drive.settings["saved_run"] = 0


def _stored_as(name: str, change: Callable[[int], int]) -> Change:
    return storing(lambda drive, setting, value: (setting, change(value) if setting == name else value), name)


def _in_packages(change: Callable[[Values], Values], of: Verb, slots: Collection[int] = range(1, 6)) -> Change:
    """Change requests that come in some slots of packages, counted among those that are used."""

    def install(drive: MksCore) -> None:
        packed = False

        def note(_: Drive, every: list, chosen: list) -> list:  # type: ignore[type-arg]
            nonlocal packed
            packed = any(every[number - 1] is slot for slot in chosen for number in slots if number <= len(every))
            return chosen

        def apply(_: Drive, command: Command, values: Values) -> Values:
            nonlocal packed
            was, packed = packed, False
            return change(values) if was and command.verb is of else values

        drive.hooks.slots.append(note)
        drive.hooks.request.append(apply)

    return tuned(install, NATIVE)


def _left_elsewhere(way: Callable[[str], int], drive: MksCore, side: str) -> int:
    """Take the left to be clockwise, but for homing."""
    return way(side) if drive.task is not None else -1 if side == "left" else 1


def _limits_passed(when: Callable[[MksCore, str], bool]) -> Change:
    """Have no limit on a side (`left`, `right`) in a condition."""
    return overridden("_limit_time", lambda reached, drive, side: None if when(drive, side) else reached(side))


def _taking_up(drive: MksCore) -> None:
    """Begin the move again that was under way when the motor was switched off."""
    ended: list[Request] = []

    def act(enable: Behaviour, core: MksCore, request: Request) -> Values | None:
        if not request.values["enabled"]:
            ended[:] = [core.task.request] if core.task is not None and core.task.request is not None else []
            return enable(core, request)
        result = enable(core, request)
        if ended and ended[0].command.verb in MOVES:
            core.behaviours[ended[0].command.verb](core, ended.pop())
        return result

    enclose(drive, Verb.ENABLE, act)


def _halted_run_taken_up(drive: MksCore) -> None:
    """Begin the run again that an emergency stop halted when the motor is switched on next."""
    halted: list[tuple[int, int, int]] = []
    halt, enable = drive.behaviours[Verb.EMERGENCY_STOP], drive.behaviours[Verb.ENABLE]

    def halting(core: MksCore, request: Request) -> Values | None:
        halted[:] = [core.memory.run] if core.memory.run and turns(core) else []
        return halt(core, request)

    def enabling(core: MksCore, request: Request) -> Values | None:
        told = enable(core, request)
        if halted and request.values["enabled"] and core.ready and not turns(core):
            begin_run(core, *halted.pop())
        return told

    drive.behaviours |= {Verb.EMERGENCY_STOP: halting, Verb.ENABLE: enabling}


def _axis_turned(drive: MksCore) -> None:
    """Let the setting of the direction turn moves by counts."""
    turned = drive.settings["motor_direction"]

    def ask(_: Drive, command: Command, values: Values) -> Values:
        return values | {"position": -values["position"]} if turned and command.verb is Verb.MOVE_RELATIVE_AXIS else values

    drive.hooks.request.append(ask)


def _turned(drive: MksCore, speed: int) -> int:
    return -speed if drive.settings["motor_direction"] else speed


def _open_enables(change: Behaviour, drive: MksCore, request: Request) -> Values | None:
    result = change(drive, request)
    if "open" in drive.mode:
        hold(drive)
    return result


def _halted_back(drive: MksCore, request: Request) -> None:
    """Halt a shaft at once that a move to a place behind it is to turn round."""
    ahead = (request.values["position"] - drive.pulses) * drive.pulse_counts
    if turns(drive) and ahead * _rpm(drive) < 0:
        drive.motor.halt(drive.now_ns)


def _status_of_before_off(drive: MksCore) -> None:
    """Tell the status that was before the motor was disabled until it is enabled."""
    left: list[Values] = []
    enable, status = drive.behaviours[Verb.ENABLE], drive.behaviours[Verb.READ_STATUS]

    def switch(core: MksCore, request: Request) -> Values | None:
        told = None if request.values["enabled"] or not core.enabled else status(core, request)
        left[:] = [] if told is None else [told]
        return enable(core, request)

    def tell(core: MksCore, request: Request) -> Values | None:
        return dict(left[0]) if left else status(core, request)

    drive.behaviours |= {Verb.ENABLE: switch, Verb.READ_STATUS: tell}


def _disabled_later(drive: MksCore, request: Request) -> Values | None:
    return dict(OK) if not request.values["enabled"] and drive.doing(Activity.MOVE) else None


def _deaf_homing(to: Whom) -> Change:
    """Do not hear these frames while homing."""
    return deaf_to(lambda drive, message: to(drive, message) and drive.doing(Activity.HOME))


def _asked_of(drive: MksCore) -> tuple[int | None, int | None]:
    """Return the speed and the acceleration that the motion under way was asked with, as sent; None where there are none."""
    request = drive.task.request if drive.task is not None else None
    if request is not None:
        return request.values.get("speed"), request.values.get("acceleration")
    return drive.memory.run[1:] if drive.memory.run is not None else (None, None)


def _is_slow(drive: MksCore) -> bool:
    speed, _ = _asked_of(drive)
    return speed is not None and speed < _CRAWLS


def _by_pulses(drive: MksCore) -> bool:
    request = drive.task.request if drive.task is not None else None
    return request is not None and request.command.verb is Verb.MOVE_RELATIVE_PULSES


def _homes_back(drive: MksCore) -> bool:
    """Say whether homing turns the shaft away from home."""
    return drive.doing(Activity.HOME) and _rpm(drive) * way_of(drive.settings["home_direction"]) < 0


def _homes_by_wall(drive: MksCore) -> bool:
    return drive.doing(Activity.HOME) and drive.settings["home_mode"] == mks_shared.HomeMode.NO_LIMIT


def _told_to_all(of: Callable[[Request, Values], bool]) -> Change:
    """Tell the ends of some motions also where several drives were asked."""

    def tell(complete: Tell, drive: MksCore, request: Request, values: Values) -> None:
        request.answered = request.answered or of(request, values)
        complete(request, values)

    return overridden("complete", tell, TELLING)


def _home_silenced(silenced: Callable[[Command], bool], drive: MksCore, command: Command) -> bool:
    """Take the replies of homing for those of a motion, which 8C silences."""
    return silenced(command) or (command.verb is Verb.HOME and not drive.settings["respond"])


def _started(change: Callable[[MksCore, bool], None]) -> Callable[[MksCore], None]:
    """Return what makes a change of a drive that has started. The change is told whether it started by 41, not by its power."""

    def install(drive: MksCore) -> None:
        again, power_on, restarted = drive.behaviours[Verb.RESTART], drive.power_on, False

        def act(core: MksCore, request: Request) -> Values | None:
            nonlocal restarted
            restarted = True
            return again(core, request)

        def started(core: MksCore) -> None:
            nonlocal restarted
            power_on(core)
            change(core, restarted)
            restarted = False

        drive.behaviours[Verb.RESTART], drive.power_on = act, started

    return install


def _lock(drive: MksCore, restarted: bool) -> None:
    """Hold the shaft after a restart; when power comes on, as is set."""
    drive.memory.enabled = drive.memory.enabled or restarted
    drive.grip()


def _way_back_untold(drive: MksCore, restarted: bool) -> None:
    """Tell the way back to zero that begins by a restart as one that is over."""
    if restarted:
        drive.memory.zero_status = mks_shared.ZeroStatus.SUCCESS


def _let_go_ccw(drive: MksCore) -> None:
    if drive.settings["home_direction"] == mks_shared.ConfigDirection.CCW:
        drive.memory.enabled = False
        drive.grip()


def _is_off(drive: MksCore) -> bool:
    return not drive.enabled


def _homed(drive: MksCore) -> bool:
    return bool(drive.settings["limits_homed"])


def _slow_after_homing(drive: MksCore) -> None:
    """Begin the first run after homing no faster than the home speed."""
    homed = False

    def ask(_: Drive, command: Command, values: Values) -> Values:
        nonlocal homed
        capped, homed = homed, command.verb is Verb.HOME or (homed and command.verb is not Verb.RUN_SPEED)
        if capped and command.verb is Verb.RUN_SPEED:
            return {**values, "speed": min(values["speed"], drive.settings["home_speed"])}
        return values

    drive.hooks.request.append(ask)


def _tired(drive: MksCore) -> None:
    """Refuse motion when there were many."""
    begun = 0

    def tire(obey: Behaviour, core: MksCore, request: Request) -> Values | None:
        nonlocal begun
        begun += 1
        return core.refused(request) if begun > _MANY else obey(core, request)

    enclose(drive, MOTIONS, tire)


def _hasty_lost(drive: MksCore) -> None:
    """Lose a setting that comes at once behind another."""
    last_ns = -_HASTE_NS

    def store(_: Drive, name: str, value: int) -> tuple[str, int] | None:
        nonlocal last_ns
        before_ns, last_ns = last_ns, drive.now_ns
        return None if 0 < last_ns - before_ns < _HASTE_NS else (name, value)

    drive.hooks.stored.append(store)


def _zero_not_cleaned(drive: MksCore, request: Request) -> Values | None:
    return dict(OK) if request.values["set_zero"] == mks_shared.ZeroPoint.CLEAN else None


def _home_told(complete: Tell, drive: MksCore, request: Request, values: Values) -> None:
    """Tell the end of homing also where `active` is off."""
    active = drive.settings.get("active", 1)
    drive.settings["active"] = active or request.command.verb is Verb.HOME
    complete(request, values)
    drive.settings["active"] = active


def _of_old_zero(drive: Drive, command: Command, values: Values) -> Values:
    """Count from another zero than that of homing."""
    return values | {"position": values["position"] + 500} if _homed(mks(drive)) else values


def _ccw_home_untold(complete: Tell, drive: MksCore, request: Request, values: Values) -> None:
    """Do not tell the end of homing counter-clockwise."""
    if request.command.verb is not Verb.HOME or drive.settings["home_direction"] != mks_shared.ConfigDirection.CCW:
        complete(request, values)


def _untold(drive: MksCore, request: Request) -> None:
    """Do not tell the end of a homing that is under way."""
    if drive.task is not None and drive.task.kind is Activity.HOME:
        drive.task.request = None


# --- in one condition of two --------------------------------------------------------------------------------------------


def _closed_clockwise(drive: MksCore) -> bool:
    return "close" in drive.mode and _rpm(drive) < 0


def _slow_emergency(drive: MksCore, request: Request) -> Values | None:
    """Slow a clockwise shaft down by a ramp, in a closed mode."""
    if not _closed_clockwise(drive):
        return None
    begin_run(drive, 0, 0, _EASY)
    return dict(OK)


def _turned_open(drive: Drive, command: Command, values: Values) -> Values:
    turned = "open" in mks(drive).mode and drive.settings["motor_direction"]
    return values | {"direction": 1 - values["direction"]} if turned else values


def _deaf_to_direction(drive: MksCore) -> None:
    """Run the same way with either setting of the motor's direction."""
    drive.hooks.request.append(
        lambda d, command, values: (
            values | {"direction": 1 - values["direction"]}
            if command.verb is Verb.RUN_SPEED and d.settings["motor_direction"]
            else values
        )
    )


def _shortened(shorten: Callable[[MksCore, Frame], bytes], wanted: Callable[[Command], bool]) -> Change:
    """Take CAN frames that are too long as what is left of them, where that is a command that is wanted."""

    def taken(take: Callable[[Frame], None], drive: MksCore, frame: Frame) -> None:
        can = frame.can
        if can is not None and len(frame.data) >= _LEAST_LONG:
            data = shorten(drive, frame)
            if data != frame.data and drive.dialect.link.fits(data, can.id):
                shorter = replace(frame, data=data, can=replace(can, data=data), checksum_ok=True)
                message = drive.responder.read(shorter)
                if message.form is not None and message.command is not None and wanted(message.command):
                    frame = shorter
        take(frame)

    return overridden("_take", taken, CAN)


def _byte_behind(drive: MksCore, frame: Frame) -> bytes:
    """Leave out a byte behind the check."""
    return frame.data if frame.checksum_ok or frame.data[-1] else frame.data[:-1]


def _two_bytes_more(drive: MksCore, frame: Frame) -> bytes:
    """Leave out two bytes of the data."""
    assert frame.can is not None  # it is shortened on CAN alone
    return drive.dialect.link.completed(frame.data[:-3], frame.can.id) if frame.checksum_ok else frame.data


def _echo_byte(drive: Drive, command: Command, outgoing: Outgoing) -> tuple[Outgoing]:
    """Lose the high byte of an echoed current."""
    body = bytearray(body_of(drive, outgoing))
    if body[-2] != _REFUSED:
        body[-2] = 0
    return (rebuilt(drive, outgoing, bytes(body)),)


def _exceptions_turning(drive: Drive, command: Command, outgoing: Outgoing) -> tuple[Outgoing]:
    """Tell exception 02 for 01 while the shaft turns."""
    body = body_of(drive, outgoing)
    wrong = len(body) == _EXCEPTION and body[1] & 0x80 and body[2] == 1 and turns(mks(drive))
    return (rebuilt(drive, outgoing, body[:2] + b"\2") if wrong else outgoing,)


#: A fine subdivision.
_FINE = 128
#: Accelerations from the top bit on, a slow one; bytes of a frame that is too long at least, of an exception; of a refusal.
_HALF_BYTE, _EASY, _LEAST_LONG, _EXCEPTION, _REFUSED = 127, 150, 4, 3, 0xFF
#: What wears out: so many motions. Settings within so long are hasty.
_MANY, _HASTE_NS = 14, 12_000_000
_OF_RUN = ("saved_run", "saved_direction", "saved_speed", "saved_acceleration")
_OF_ZERO = ("zero_mode", "zero_kept", "zero_point", "zero_speed")
#: What a restart can lose and a restore can leave, and what shows it: name in the fault, settings.
_STORED: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("home-trigger", ("home_trigger",)),
    ("home-direction", ("home_direction",)),
    ("end-limit", ("end_limit",)),
    ("limit-remap", ("limit_remap",)),
    ("no-limit-home", ("home_mode", "return_angle")),
    ("protection", ("protection",)),
)
_RESTORED = (
    ("respond", ("respond",)),
    ("active", ("active",)),
    ("group-address", ("group_address",)),
    ("home-speed", ("home_speed",)),
    ("saved-run", _OF_RUN),
    ("zero-mode", _OF_ZERO),
)

DOING: Rows = {
    "disabled": (
        Row("disabled-moves-backwards", "motion backwards is obeyed while disabled",
            with_state(MOTIONS, backwards, enabled=True)),
        Row("disabled-moves-fast", "motion above 500 rpm is obeyed while disabled",
            with_state(MOTIONS, lambda values: bool(values["speed"] > _FAST), enabled=True)),
        Row("zero-enables", "92 enables a motor that is off", with_state(Verb.SET_ZERO, enabled=True)),
        Row("protected-moves-backwards", "motion backwards is obeyed while protected",
            with_state(MOTIONS, backwards, protected=False)),
        Row("enabling-takes-up-halted", "F3 01 takes up a run that F7 ended", tuned(_halted_run_taken_up)),
        Row("enabling-takes-up", "F3 01 takes up a move that F3 00 ended", tuned(_taking_up)),
    ),
    "turned": (
        Row("direction-after-restart", "86 turns F4 round from a restart on", _after_restart(_axis_turned), SERIAL),
        Row("lock-in-open", "82 to the open mode enables the motor, whatever 8F says",
            wrapped(Verb.SET_WORK_MODE, _open_enables), CAN),
        Row("direction-turns-speed", "86 turns the speed that 32 tells",
            result(lambda d, c, sent, found: found | {"speed": _turned(mks(d), found["speed"])}, Verb.READ_SPEED), SERIAL),
        Row("close-unlimited-while-turning", "F5 in the close mode turns at up to 3000 rpm where the shaft turns already",
            by_laws(Verb.MOVE_ABSOLUTE_AXIS, lambda drive: "close" in drive.mode and turns(drive), highest_speed=as_given),
            SERIAL),
        Row("back-at-once", "FE back during FE halts the shaft first", before(Verb.MOVE_ABSOLUTE_PULSES, _halted_back)),
    ),
    "restored": tuple(
        Row(f"{name}-kept", f"a restore leaves {name}", clinging(*names), SERIAL)
        for name, names in (*_STORED[:4], _STORED[5], *_RESTORED)
    ),
    "restarted": tuple(
        Row(f"{name}-forgotten", f"a restart forgets {name}", forgetful(*names), SERIAL) for name, names in _STORED
    ),
    "many": (
        Row("tired-of-motion", f"motion is refused when there were {_MANY}", tuned(_tired)),
        Row("hasty-setting-lost", "a setting at once behind another is answered and lost", tuned(_hasty_lost), SERIAL),
    ),
    "power-on": (
        Row("zero-not-cleaned", "9A does not clean the zero", before(Verb.SET_ZERO_MODE, _zero_not_cleaned)),
        Row("zero-direction-turned", "9A goes back the other way", _back_with("zero_direction", lambda v: 1 - v)),
        Row("zero-speed-fixed", "9A goes back at one speed", _back_with("zero_speed", lambda v: 2)),
        Row("zero-off-ignored", "9A goes back in zero mode 0 too",
            _back_with("zero_mode", lambda v: v or int(mks_shared.ZeroMode.NEAR))),
        Row("zero-speed-4-as-3", "9A goes back at speed 4 as at speed 3", _back_with("zero_speed", lambda v: min(v, 3))),
        Row("near-by-quarters", "9A takes the longer way to a zero that is a quarter of a turn above and more",
            _back_as(_near_by_quarters)),
        Row("short-way-down", "9A goes clockwise to a zero that is a little above",
            _back_as(lambda drive: {"zero_direction": _CLOCKWISE} if _way_up(drive) < 1 / 6 else {})),
        Row("homing-always-told", "the end of homing is told with active 0 too", overridden("complete", _home_told), NATIVE),
    ),
    "stop": (
        Row("steep-stop-ignored", "stops with an acceleration of 128 and more do nothing",
            before(STOPS, lambda drive, request: dict(OK) if request.values["acceleration"] > _HALF_BYTE else None)),
        Row("closed-cw-emergency-slow", "F7 is slow in a closed mode, clockwise", before(Verb.EMERGENCY_STOP, _slow_emergency)),
        Row("closed-cw-emergency-ignored", "F7 does nothing in a closed mode, clockwise",
            undone_when(_closed_clockwise, Verb.EMERGENCY_STOP)),
        Row("home-over-motion-undone", "91 says that it begins over a motion, and is lost", undone_when(turns, Verb.HOME)),
        Row("home-over-motion-refused", "91 is refused while the shaft turns", refused_when(turns, Verb.HOME)),
        Row("fast-stop-ignored", "stops are ignored above 1000 rpm", undone_when(_faster(_VERY_FAST), _ENDS)),
        Row("fast-at-once-by-ramp", "stops with acceleration 0 are slow above 1000 rpm", request(_slow_when_fast, STOPS)),
        Row("run-unstopped-by-fd", "the stop of FD does not end a run of F6 that turns clockwise",
            undone_when(lambda drive: drive.memory.run is not None and drive.motor.speed(drive.now_ns) < 0,
                Verb.STOP_RELATIVE_PULSES)),
        Row("rising-stop-ignored", "stops are ignored while the shaft speeds up", undone_when(_rises, _ENDS)),
        Row("falling-emergency-ignored", "F7 does nothing while the shaft slows down",
            undone_when(_falls, Verb.EMERGENCY_STOP)),
        Row("falling-motion-undone", "motion is lost while the shaft slows down", undone_when(_falls, MOTIONS)),
        Row("emergency-latches", "after F7 motion is refused until the motor is enabled", tuned(_latched)),
    ),
    "enable": (
        Row("status-of-before-off", "behind F3 00 F1 tells what the shaft did before it", tuned(_status_of_before_off)),
        Row("locked-keys-refuse-fe", "settings that lock the keys leave FE refused",
            refused_when(lambda drive: bool(drive.settings["key_lock"]), Verb.MOVE_ABSOLUTE_PULSES), SERIAL),
        Row("moves-stay-enabled", "F3 00 does nothing during a move", before(Verb.ENABLE, _disabled_later)),
        Row("enabling-stops", "F3 01 stops a shaft that turns", before(Verb.ENABLE, _halt_first)),
        Row("saving-stops", "FF C8 stops the shaft", before(Verb.SAVE_SPEED, _halted)),
    ),
    "zero": (Row("zero-low-word", "92 clears 16 bits of the position", before(Verb.SET_ZERO, _low_word)),),
    "target": (
        Row("no-ramp-goes-beyond", "FE without a ramp ends 60 pulses beyond", request(_beyond, Verb.MOVE_ABSOLUTE_PULSES)),
        Row("f5-as-sent-at-128", "at 128 subdivisions F5 has its speed as sent",
            request(_as_sent_at_128, Verb.MOVE_ABSOLUTE_AXIS)),
        Row("high-pulses-back", "FD goes back where the top bit of its pulses is set",
            request(_back, Verb.MOVE_RELATIVE_PULSES), SERIAL),
    ),
    "direction": (
        Row("direction-turns-fe", "86 turns moves by FE",
            request(_turned_by_setting, Verb.MOVE_ABSOLUTE_PULSES), SERIAL),
        Row("restart-turns-round", "after a restart F6 turns the other way", _after_restart(_runs_round)),
    ),
    "direction of the motor": (
        Row("direction-turns-open-runs", "86 turns runs in the open mode",
            request(_turned_open, Verb.RUN_SPEED), SERIAL),
        Row("direction-ends-motion", "86 stops the shaft", before(Verb.SET_DIRECTION, _halted), SERIAL),
        Row("direction-lost-by-restart", "after a restart 86 turns no run", _after_restart(_deaf_to_direction), CAN),
    ),
    "frames": (
        Row("long-setting-stored", "settings with a byte behind their check are stored",
            _shortened(_byte_behind, lambda command: command.verb.value.startswith("set_"))),
        Row("long-run-executed", "F6 with two bytes of data too many is executed",
            _shortened(_two_bytes_more, lambda command: command.verb is Verb.RUN_SPEED)),
        Row("long-settings-executed", "settings with two bytes of data too many are stored",
            _shortened(_two_bytes_more, lambda command: command.verb.value.startswith("set_"))),
        Row("current-echo-low-byte", "the echo of 83 has the low byte alone", frames(_echo_byte, Verb.SET_CURRENT), MODBUS),
        Row("exception-2-turning", "an unknown function gets exception 02 while turning", frames(_exceptions_turning), MODBUS),
    ),
    "restart": (
        Row("restart-speed-as-sent", "after a restart no speed is one of the subdivision", _after_restart(_speeds_as_sent)),
        Row("fine-subdivision-lost", "after a restart subdivisions above 128 are 16", _after_restart(_coarse)),
        Row("home-speed-byte", "after a restart the home speed has its low byte alone", _after_restart(_slow_home), SERIAL),
        Row("enable-level-forgotten", "a restart forgets the level of En", forgetful("enable_level"), SERIAL),
        Row("baud-rate-lost", "a restart loses the speed of the line", forgetful("baud_rate"), SERIAL),
        Row("dialect-lost", "a restart loses the dialect", forgetful("modbus"), NATIVE),
        Row("way-back-told-over", "3B reads 1 on the way back to zero behind 41, and 0 when power came on",
            tuned(_started(_way_back_untold), having(Verb.SET_ZERO_MODE))),
        Row("wide-address-lost", "a restart takes an ID above FFh for none", _after_restart(_address_unset), CAN),
        Row("save-speed-without-direction", "a kept run begins as it was sent, without what 86 says",
            _after_restart(_run_without_direction), CAN),
        Row("user-id-unset-lost", "a restart takes the number FFFFFFFFh for none", _after_restart(_number_unset), CAN),
        Row("broadcast-settings-lost", "a restart loses what all drives were set to", lost_if_sent(for_all)),
        Row("group-settings-lost", "a restart loses what the group was set to",
            lost_if_sent(to_group), having(Verb.SET_GROUP_ADDRESS)),
        Row("package-settings-lost", "a restart loses what was set in a package", lost_if_sent(package), NATIVE),
        Row("turning-deaf-to-all-off", "F3 to all drives is not heard while a run turns the shaft",
            deaf_to(lambda drive, message: of(for_all, Verb.ENABLE)(drive, message) and drive.memory.run is not None)),
        Row("tolerance-of-all-lost", "a stall tolerance that was set by a broadcast is lost by a restart",
            lost_if_sent(for_all, "stall_tolerance"), CAN),
        Row("homing-deaf-to-stops-of-all", "the emergency stop to all drives is not heard while homing",
            _deaf_homing(of(for_all, Verb.EMERGENCY_STOP))),
        Row("homing-deaf-to-group-off", "F3 by the group is not heard while homing",
            _deaf_homing(of(to_group, Verb.ENABLE)), having(Verb.SET_GROUP_ADDRESS)),
        Row("group-deaf-while-turning", "a move by the group is not heard while the shaft turns",
            deaf_to(lambda drive, message: of(to_group, *MOVES)(drive, message) and turns(drive)),
            having(Verb.SET_GROUP_ADDRESS)),
        Row("protection-of-all-unheard", "88 to all drives is not heard", deaf_to(of(for_all, Verb.SET_PROTECTION)), SERIAL),
        Row("saved-run-once", "a saved run begins at one power-on alone", overridden("power_on", _once)),
        Row("saved-ramp-lost", "a saved run begins without its ramp", _stored_as("saved_acceleration", lambda v: 0)),
        Row("saved-speed-byte", "a saved run has the low byte of its speed", _stored_as("saved_speed", lambda v: v & 0xFF)),
    ),
    "package": (
        Row("package-without-ramp", "a run in a package has no ramp",
            _in_packages(lambda values: values | {"acceleration": 0}, Verb.RUN_SPEED)),
        Row("package-stop-at-once", "a stop of a run in a package has no ramp",
            _in_packages(lambda values: values | {"acceleration": 0}, Verb.STOP_SPEED)),
        Row("package-speed-byte", "a move by counts in a package has the low byte of its speed",
            _in_packages(lambda values: values | {"speed": values["speed"] & 0xFF}, Verb.MOVE_RELATIVE_AXIS)),
        Row("package-never-disables", "F3 in a package always enables",
            _in_packages(lambda values: values | {"enabled": 1}, Verb.ENABLE)),
        Row("package-late-slots-one-way", "FD behind the first slot of a package turns the shaft CW alone",
            _in_packages(lambda values: values | {"direction": 1}, Verb.MOVE_RELATIVE_PULSES, range(2, 6))),
        Row("package-third-slot-turned", "F6 in the third slot of a package turns the shaft the other way",
            _in_packages(lambda values: values | {"direction": 1 - values["direction"]}, Verb.RUN_SPEED, (3,))),
        Row("package-last-slot-speed-byte", "F6 in the last slot of a package has the low byte of its speed",
            _in_packages(lambda values: values | {"speed": values["speed"] & 0xFF}, Verb.RUN_SPEED, (5,))),
        Row("package-last-slot-pulses-byte", "FD in the last slot of a package has the low byte of its pulses",
            _in_packages(lambda values: values | {"pulses": values["pulses"] & 0xFF}, Verb.MOVE_RELATIVE_PULSES, (5,))),
        Row("package-second-slot-half-way", "F5 in the second slot of a package goes to half of its place",
            _in_packages(lambda values: values | {"position": values["position"] // 2}, Verb.MOVE_ABSOLUTE_AXIS, (2,))),
        Row("package-last-slot-subdivision", "84 in the last slot of a package sets half of what it says",
            _in_packages(lambda values: values | {"subdivision": values["subdivision"] // 2}, Verb.SET_SUBDIVISION, (5,))),
        Row("package-fourth-slot-enables", "F3 in the fourth slot of a package always enables",
            _in_packages(lambda values: values | {"enabled": 1}, Verb.ENABLE, (4,))),
        Row("package-enabling-answered", "F3 in a package is answered", tuned(answers_enabling_in_slots), NATIVE),
        Row(
            "package-last-slot-unstopped",
            "F7 in the last slot of a package is not executed",
            slots(
                lambda own, every, wanted: [
                    s
                    for s in wanted
                    if not (s is every[-1] and len(every) > 1 and s.command and s.command.verb is Verb.EMERGENCY_STOP)
                ]
            ),
        ),
        Row("pulse-mode-obeys-package", "motion in a package is executed in a pulse mode",
            tuned(made_ready_by(package, MOTIONS, lambda drive: drive.heedless.add("work_mode"))), NATIVE),
        Row("package-fourth-slot-unsigned", "F4 in the fourth slot of a package has no sign",
            _in_packages(lambda values: values | {"position": abs(values["position"])}, Verb.MOVE_RELATIVE_AXIS, (4,))),
    ),
    "limit": (
        Row("left-is-clockwise", "the left end limit lies clockwise, however homing goes",
            overridden("side_way", _left_elsewhere)),
        Row("open-without-limits", "end limits do nothing in the open mode",
            _limits_passed(lambda drive, side: "open" in drive.mode)),
        Row("stuck-at-limit", "FD away from a closed end limit is refused",
            refused_when(lambda drive: drive.at_limit(1) or drive.at_limit(-1), Verb.MOVE_RELATIVE_PULSES)),
        Row("right-limit-passed", "FD passes the right end limit",
            _limits_passed(lambda drive, side: side == "right" and _by_pulses(drive))),
        Row("right-limit-passed-slowly", "motion below 30 rpm passes the right end limit",
            _limits_passed(lambda drive, side: side == "right" and _is_slow(drive))),
        Row("right-limit-told-complete", "a move that the right end limit stops is told as complete",
            tuned(_complete_at_right), TELLING),
        Row("limits-passed-at-once", "motion without a ramp passes the end limits",
            _limits_passed(lambda drive, side: _asked_of(drive)[1] == 0)),
    ),
    "set": (
        Row("calibration-goes-on", "F7 says success while the motor calibrates, and does not end it",
            undone_when(lambda drive: drive.doing(Activity.CALIBRATE), Verb.EMERGENCY_STOP)),
        Row("zero-refused-while-off", "92 is refused while the motor is off", refused_when(_is_off, Verb.SET_ZERO)),
        Row("setting-undone-while-off", "84 says success and stores nothing while off",
            undone_when(_is_off, Verb.SET_SUBDIVISION)),
        Row("remap-refused-while-turning", "9E is refused while the shaft turns", refused_when(turns, Verb.SET_LIMIT_REMAP)),
        Row("group-left-by-address", "a new address takes the drive out of its group",
            before(Verb.SET_ADDRESS, leave_group), having(Verb.SET_GROUP_ADDRESS)),
        Row("group-deaf-to-all", "a drive in a group does not hear broadcasts",
            deaf_to(lambda drive, message: for_all(drive, message) and bool(drive.settings.get("group_address"))),
            having(Verb.SET_GROUP_ADDRESS)),
    ),
    "update": (
        Row("update-undone", "F5 while the shaft turns says success and is lost", undone_when(turns, Verb.MOVE_ABSOLUTE_AXIS)),
        Row("current-capped", "currents above 2900 mA are stored as 2900",
            _stored_as("current", lambda value: min(value, 2900)), CAN),
        Row("tolerance-capped", "stall tolerances above 360 degrees hold as that",
            _stored_as("stall_tolerance", lambda v: min(v, 200)), having(Verb.SET_STALL_TOLERANCE)),
    ),
    "homed": (
        Row("slow-run-after-homing", "the first run after 91 has the home speed at most", tuned(_slow_after_homing)),
        Row("open-home-slow", "91 turns at half of its speed in the open mode", overridden("home_settings", _slow_open_home)),
        Row("homing-back-as-stopped", "F1 says stopped on homing's way back",
            told_when(_homes_back, Verb.READ_STATUS, status=1)),
        Row("fe-of-old-zero", "FE behind homing counts from another zero", request(_of_old_zero, Verb.MOVE_ABSOLUTE_PULSES)),
        Row("refusals-need-active", "a motion that is refused is not answered with active 0",
            result(lambda d, c, sent, found: found if found["status"] or mks(d).settings["active"] else None, MOTIONS),
            TELLING),
        Row("homing-untold-behind-setting", "the end of homing is not told when 83 comes on the way",
            before(Verb.SET_CURRENT, _untold), TELLING),
        Row("homing-ccw-untold", "the end of homing counter-clockwise is not told",
            overridden("complete", _ccw_home_untold), TELLING),
        Row("home-zero-at-wall", "homing to an obstacle zeroes the encoder and leaves the count of pulses",
            when_home(_pulses_beside), TELLING),
        Row("homing-ccw-lets-go", "homing counter-clockwise lets the shaft go at its end", when_home(_let_go_ccw)),
        Row("home-by-wall-unstopped", "F7 says success and does not end homing without a switch",
            undone_when(_homes_by_wall, Verb.EMERGENCY_STOP), TELLING),
        Row("home-by-wall-as-stopped", "F1 says stopped while homing without a switch",
            told_when(_homes_by_wall, Verb.READ_STATUS, status=1), TELLING),
        Row("respond-silences-home", "91 is not answered with respond 0", overridden("silenced", _home_silenced, TELLING)),
        Row("lock-by-restart", "41 holds the shaft, whatever 8F says", tuned(_started(_lock), CAN)),
        Row("home-told-by-all", "the end of homing is told though all drives or a group were asked",
            _told_to_all(lambda request, values: request.command.verb is Verb.HOME)),
        Row("failure-told-by-all", "a move that fails says 0 though all drives or a group were asked",
            _told_to_all(lambda request, values: request.command.verb in MOTIONS and not values["status"])),
        Row("limit-told-by-all", "a move that a limit ends says 3 though all drives or a group were asked",
            _told_to_all(lambda request, values: values["status"] == mks_shared.RunStatus.LIMIT_STOP)),
        Row("ramp-told-by-all", "a stop by a ramp tells its end though all drives or a group were asked",
            _told_to_all(lambda request, values: request.command.verb in STOPS and bool(request.values["acceleration"]))),
        Row("zero-status-2-after-homing", "3B reads 2 after homing", told_when(_homed, Verb.READ_ZERO_STATUS, status=2)),
    ),
}  # fmt: skip

FAULTS = faults(TOLD, DOING)
