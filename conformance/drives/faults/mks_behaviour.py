"""How an MKS drive can misbehave: makers of changes to what it does, keeps and tells.

    wrapped(of, act), before(of, act)   what the drive does with some commands
    overridden("complete", act)         what a method of the drive does
    completing(2, at=half_way)          how and when a move ends

Rules kept here:
- A behaviour does what the manual says and something more, less or else. It never packs a frame.
- An acceleration, a speed or a position is the integer as sent; motor positions are encoder counts.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from fractions import Fraction
from functools import partial
from typing import Any

from analyzer.catalogue import Command, Verb
from analyzer.protocols import mks_shared
from conformance.drives.drive import Drive, Hooks, Outgoing, Request, Values
from conformance.drives.faults.places import TELLING, Change, Of, having, keeping, result
from conformance.drives.mks.core import MOTIONS, Activity, Behaviour, MksCore, Script, Task
from conformance.drives.mks.motion import TARGETS
from conformance.drives.mks.paths import Number, ramp_step_ns, size
from conformance.drives.mks.responders import MksResponder
from conformance.drives.mks.settings import SETTINGS

#: What is done round a behaviour of the manual: it gets that behaviour, the drive and the request.
Around = Callable[[Behaviour, MksCore, Request], Values | None]
#: The moves to a position.
MOVES = MOTIONS - {Verb.RUN_SPEED}
OK: Values = {"status": int(mks_shared.Success.SUCCESS)}
FAILED: Values = {"status": int(mks_shared.Success.FAILED)}
STARTING: Values = {"status": int(mks_shared.RunStatus.STARTING)}
COMPLETE, LIMIT_STOP = int(mks_shared.RunStatus.COMPLETE), int(mks_shared.RunStatus.LIMIT_STOP)
COUNTS = mks_shared.COUNTS_PER_TURN
SUBDIVISION_CODE = 0x84
SLOW_RPM = 30
LATE_NS = COAST_NS = 2_000_000_000


def mks(drive: Drive) -> MksCore:
    """Return a drive as the MKS drive that it is."""
    assert isinstance(drive, MksCore)
    return drive


# --- the drive itself ------------------------------------------------------------------------------------------------


def tuned(change: Callable[[MksCore], None], dialects: tuple[str, ...] = having(())) -> Change:
    """Change the drive itself, once."""
    return Change(lambda hooks: hooks.setup.append(lambda drive: change(mks(drive))), dialects)


def with_law(name: str, law: Any) -> Change:
    """Give the drive another law or time: an attribute of `MksState`."""
    return tuned(lambda drive: setattr(drive, name, law))


def heedless(name: str) -> Change:
    """Store a setting, and do as if it were not there."""
    return tuned(lambda drive: drive.heedless.add(name), keeping(name))


def forgetful(*names: str) -> Change:
    """Lose settings when the drive restarts."""
    return tuned(lambda drive: drive.forgetful.update(names), keeping(*names))


def clinging(*names: str) -> Change:
    """Keep settings when the drive is restored."""
    return tuned(lambda drive: drive.clinging.update(names), keeping(*names))


def turn_bus_motion(drive: MksCore) -> None:
    """Let the direction setting turn motion by the bus."""
    for responder in drive.responders:
        if isinstance(responder, MksResponder):
            responder.turns_bus_motion = True


# --- what it does ----------------------------------------------------------------------------------------------------


def wrapped(of: Of, act: Around) -> Change:
    """Do something round what the manual says for these commands."""
    return tuned(lambda drive: enclose(drive, of, act), having(of))


def enclose(drive: MksCore, of: Of, act: Around) -> None:
    """Put something round what a drive does for these commands, where it has them."""
    for verb in {of} if isinstance(of, Verb) else of:
        if verb in drive.behaviours:
            drive.behaviours[verb] = partial(act, drive.behaviours[verb])


def overridden(method: str, act: Callable[..., Any], dialects: tuple[str, ...] = having(())) -> Change:
    """Do something round a method of the drive. `act` gets the method, the drive, and what the method is called with."""
    return tuned(lambda drive: setattr(drive, method, partial(act, getattr(drive, method), drive)), dialects)


def instead(of: Of, behaviour: Behaviour) -> Change:
    """Do something else for these commands."""
    return wrapped(of, lambda _, drive, request: behaviour(drive, request))


def backwards(values: Values) -> bool:
    """Say whether a motion of direction 1, or of a negative number, is asked for."""
    return values.get("direction") == mks_shared.MotionDirection.CW or values.get("position", 0) < 0


def lying(of: Of) -> Change:
    """Say that it is done, and do nothing."""
    return instead(of, lambda drive, request: dict(OK))


def before(of: Of, act: Callable[[MksCore, Request], Values | None]) -> Change:
    """Do something before what the manual says; an answer stands in for the manual's behaviour."""

    def both(behaviour: Behaviour, drive: MksCore, request: Request) -> Values | None:
        early = act(drive, request)
        return behaviour(drive, request) if early is None else early

    return wrapped(of, both)


def with_state(of: Of, when: Callable[[Values], bool] = lambda values: True, **state: bool) -> Change:
    """Act as if the drive's memory said otherwise, where the values of the request are such."""

    def act(drive: MksCore, request: Request) -> None:
        if when(request.values):
            for name, value in state.items():
                setattr(drive.memory, name, value)
            drive.grip()

    return before(of, act)


def ended(script: Callable[[MksCore, Request], Script], of: Collection[Verb] = MOVES) -> Change:
    """Let moves (or stops) that have begun go on by another script."""

    def act(behaviour: Behaviour, drive: MksCore, request: Request) -> Values | None:
        answer = behaviour(drive, request)
        if drive.task is not None and drive.task.request is request:
            drive.begin(Activity.MOVE if request.command.verb in MOVES else Activity.STOP, script(drive, request), request)
        return answer

    return wrapped(of, act)


# --- where moves end -------------------------------------------------------------------------------------------------


def _pace(drive: MksCore, request: Request) -> tuple[Number, int]:
    """Return the rpm of a move and its time for one rpm."""
    declared = request.command.request_forms[0].layout.named["speed"].high
    speed = min(int(request.values["speed"]), drive.highest_speed(declared))
    return drive.real_speed(speed), drive.ramp(request.values["acceleration"])


def as_command(verb: Verb) -> Around:
    """Move to where another command of the same values would."""

    def act(behaviour: Behaviour, drive: MksCore, request: Request) -> Values | None:
        aimed, at_ns = TARGETS[verb](drive, request), drive.now_ns
        answer = behaviour(drive, request)
        if drive.task is not None and drive.task.request is request and request.values["speed"]:
            drive.motor.move(at_ns, aimed, *_pace(drive, request))
        return answer

    return act


def landing(*offsets: int) -> Change:
    """Go so many counts beyond the target (below 0, short of it), one place after the other, before moves complete."""

    def script(drive: MksCore, request: Request) -> Script:
        motor = drive.motor
        target, begin = motor.wanted(motor.settled), motor.wanted(drive.now_ns)
        for offset in offsets:
            if target != begin and request.values["speed"]:
                motor.move(drive.now_ns, target + (offset if target > begin else -offset), *_pace(drive, request))
            yield lambda: motor.settled
        drive.finish(COMPLETE)

    return ended(script)


def landing_above(speed: int, offset: int) -> Change:
    """Let moves above a speed as sent end so many counts beyond their target."""

    def script(drive: MksCore, request: Request) -> Script:
        motor = drive.motor
        target, begin = motor.wanted(motor.settled), motor.wanted(drive.now_ns)
        yield lambda: motor.settled
        if request.values["speed"] > speed and target != begin:
            motor.jump(drive.now_ns, offset if target > begin else -offset)
        drive.finish(COMPLETE)

    return ended(script)


def without_sense(behaviour: Behaviour, drive: MksCore, request: Request) -> Values | None:
    """Move as if the direction were not turned by its setting."""
    setting = drive.settings["motor_direction"]
    drive.settings["motor_direction"] = int(mks_shared.ConfigDirection.CW)
    answer = behaviour(drive, request)
    drive.settings["motor_direction"] = setting
    return answer


def refuse_in_open_loop(drive: MksCore, request: Request) -> Values | None:
    """Refuse what needs no closed loop."""
    return None if drive.motor.closed_loop else drive.refused(request)


def endless_at_zero(behaviour: Behaviour, drive: MksCore, request: Request) -> Values | None:
    """Tell no end of a move by nothing."""
    answer = behaviour(drive, request)
    if drive.motor.settled <= drive.now_ns:
        drive.drop()
    return answer


def only_runs(drive: MksCore, request: Request) -> Values | None:
    """Let the emergency stop end no move by pulses."""
    task = drive.task
    by_pulses = task is not None and task.request is not None and "pulses" in task.request.values
    return dict(OK) if by_pulses else None


def coarse(drive: Drive, command: Command, values: Values) -> Values:
    """Take 25 subdivisions for 20."""
    is_25 = mks(drive).settings["subdivision"] == 25
    return values | {"pulses": values["pulses"] * 5 // 4} if is_25 else values


def as_given(value: int) -> int:
    """Return a speed, or a highest one, as it was given: a law that changes nothing."""
    return value


def by_laws(of: Of, when: Callable[[MksCore], bool] = lambda drive: True, **laws: Any) -> Change:
    """Do some commands by other laws than all else, where a condition holds: attributes of `MksState`."""

    def act(behaviour: Behaviour, drive: MksCore, request: Request) -> Values | None:
        kept = {name: getattr(drive, name) for name in laws} if when(drive) else {}
        for name in kept:
            setattr(drive, name, laws[name])
        try:
            return behaviour(drive, request)
        finally:
            for name, law in kept.items():
                setattr(drive, name, law)

    return wrapped(of, act)


def refuse_newer(drive: MksCore, request: Request) -> Values | None:
    """Refuse what comes while a move is under way."""
    return dict(FAILED) if drive.doing(Activity.MOVE) else None


def refuse_off_while_turning(drive: MksCore, request: Request) -> Values | None:
    """Refuse to be disabled while the shaft turns."""
    return dict(FAILED) if turns(drive) and not request.values["enabled"] else None


def say_while_turning(drive: MksCore, request: Request) -> Values | None:
    """Answer that it is done, and do nothing, while the shaft turns."""
    return dict(OK) if turns(drive) else None


def keep_going(drive: MksCore, request: Request) -> Values | None:
    """Answer a newer move while an older one is under way, and go on with the older one."""
    return dict(STARTING) if drive.doing(Activity.MOVE) else None


def stop_first(drive: MksCore, request: Request) -> None:
    """Stop the shaft at once before a newer move begins."""
    if drive.doing(Activity.MOVE):
        drive.motor.halt(drive.now_ns)


def refuse_above(speed: int) -> Callable[[MksCore, Request], Values | None]:
    """Refuse a speed above a limit."""
    return lambda drive, request: drive.refused(request) if request.values["speed"] > speed else None


def ignore_in(mode: str) -> Callable[[MksCore, Request], Values | None]:
    """Say in a work mode that it is done, and do nothing."""
    return lambda drive, request: dict(OK) if drive.mode == mode else None


def emergency_ramp(drive: MksCore, request: Request) -> Values:
    """Stop by a ramp."""
    drive.drop()
    drive.memory.run = None
    drive.motor.run(drive.now_ns, 0, ramp_step_ns(200))
    return dict(OK)


def coasting(behaviour: Behaviour, drive: MksCore, request: Request) -> Values | None:
    """Answer a stop, and go on for two seconds before it."""

    def coast() -> Script:
        end_ns = drive.now_ns + COAST_NS
        yield lambda: end_ns
        drive.motor.run(drive.now_ns, 0, drive.ramp(request.values["acceleration"]))
        yield lambda: drive.motor.settled
        drive.finish(COMPLETE)

    rpm = drive.motor.speed(drive.now_ns)
    answer = behaviour(drive, request)
    drive.motor.run(drive.now_ns, rpm, 0)
    drive.begin(Activity.STOP, coast(), request)
    return answer


def ignore_clean(drive: MksCore, request: Request) -> Values | None:
    """Leave the kept run as it is."""
    return dict(OK) if request.values["save_state"] == mks_shared.SaveState.CLEAN else None


# --- what it tells of motion -----------------------------------------------------------------------------------------


def completing(
    *statuses: int, at: Callable[[int, Number], Number] = lambda begin_ns, settled: settled, of: Collection[Verb] = MOVES
) -> Change:
    """End moves by replies of these statuses (none: silently), at a time between their beginning and their end."""

    def script(drive: MksCore, request: Request) -> Script:
        begin_ns = drive.now_ns
        yield lambda: at(begin_ns, drive.motor.settled)
        for status in statuses[:-1]:
            drive.complete(request, {"status": status})
        if statuses:
            drive.finish(statuses[-1])
        else:
            drive.drop()

    return Change(ended(script, of).install, TELLING)


def half_way(begin_ns: int, settled: Number) -> Number:
    """Return the middle of a move."""
    return begin_ns + Fraction(settled - begin_ns) / 2


def afterwards(begin_ns: int, settled: Number) -> Number:
    """Return two seconds after a move."""
    return settled + LATE_NS


def complete_older(drive: MksCore, request: Request) -> None:
    """Complete the older move when a newer one takes its place."""
    older = drive.task.request if drive.task is not None and drive.doing(Activity.MOVE) else None
    if older is not None:
        drive.complete(older, {"status": COMPLETE})


def unsaid(of: Of, *statuses: int) -> Change:
    """Do not send replies of these statuses."""
    change = result(lambda drive, command, asked, values: None if values.get("status") in statuses else values, of)
    return Change(change.install, TELLING)


def unless(silent: Callable[[MksCore, Command], bool], of: Of = ()) -> Change:
    """Do not reply while something holds."""
    return result(lambda drive, command, asked, values: None if silent(mks(drive), command) else values, of)


def begin_twice(hooks: Hooks) -> None:
    """Send the first reply to a move twice."""
    last: list[Values] = []

    def remember(drive: Drive, command: Command, asked: Values, values: Values | None) -> Values | None:
        last[:] = [values] if values is not None else []
        return values

    def say(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        begins = command.verb in MOVES and last == [STARTING]
        return (outgoing, outgoing) if begins else (outgoing,)

    hooks.result.append(remember)
    hooks.reply.append(say)


# --- homing and zero -------------------------------------------------------------------------------------------------


def home_at_once(drive: MksCore, request: Request) -> Values:
    """Say that home was found where the shaft is."""

    def found() -> Script:
        now_ns = drive.now_ns
        yield lambda: now_ns
        drive.finish(mks_shared.HomeStatus.SUCCESS)

    drive.begin(Activity.HOME, found(), request)
    return {"status": int(mks_shared.HomeStatus.STARTING)}


def homing_by(change: Callable[[Mapping[str, int]], Mapping[str, int]]) -> Change:
    """Home by other settings than those that are stored."""

    def tune(drive: MksCore) -> None:
        drive.home_settings = lambda: {**drive.settings, **change(drive.settings)}

    return tuned(tune)


def when_home(after: Callable[[MksCore], None]) -> Change:
    """Do something more when home is found."""

    def script(drive: MksCore, task: Task) -> Script:
        yield task.wait
        yield from task.script
        after(drive)

    def act(behaviour: Behaviour, drive: MksCore, request: Request) -> Values | None:
        answer = behaviour(drive, request)
        task = drive.task
        if task is not None and task.request is request:
            drive.begin(Activity.HOME, script(drive, task), request)
        return answer

    return wrapped(Verb.HOME, act)


def lose_zero(drive: MksCore) -> None:
    """Shift the zero."""
    drive.memory.zero += 500


def hold(drive: MksCore) -> None:
    """Hold the shaft."""
    drive.memory.enabled = True
    drive.grip()


def zero_pulses(drive: MksCore, request: Request) -> Values:
    """Set the zero of the pulses alone."""
    drive.memory.pulse_zero = drive.motor.wanted(drive.now_ns)
    return dict(OK)


# --- readings --------------------------------------------------------------------------------------------------------


def carry_to_zero(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
    """Cut the turns towards zero: below zero the value within the turn would have to be negative."""
    axis = mks(drive).axis
    carry = int(axis / COUNTS)
    return values | {"carry": carry, "encoder": axis - carry * COUNTS}


def carry_late(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
    """Let the value run to two turns before it carries."""
    if not values["carry"] % 2:
        return values
    return values | {"carry": values["carry"] - 1, "encoder": values["encoder"] + COUNTS}


def carry_a_count_late(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
    """Let the value be a whole turn for one count before it carries."""
    return values if values["encoder"] else values | {"carry": values["carry"] - 1, "encoder": COUNTS}


def short_count(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
    """Count pulses in 16 bits."""
    return values | {"pulses": (values["pulses"] + 0x8000) % 0x10000 - 0x8000}


def slow_as_stopped(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
    """Say of a shaft below 30 rpm that it stands."""
    slow = 0 < size(mks(drive).motor.speed(drive.now_ns)) < SLOW_RPM
    return values | {"status": int(mks_shared.MotorStatus.STOPPED)} if slow else values


def turns(drive: MksCore) -> bool:
    """Say whether the shaft turns."""
    return bool(drive.motor.speed(drive.now_ns))


def turned_about(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
    """Say slowing down for speeding up and the other way round while the encoder falls."""
    falls = mks(drive).motor.speed(drive.now_ns) < 0
    return values | {"status": {2: 3, 3: 2}.get(values["status"], values["status"])} if falls else values


def unreadable_while_turning(drive: MksCore, code: int, values: Values) -> Values:
    """Say that a parameter cannot be read while the shaft turns."""
    return {"unreadable": 0xFFFF} if turns(drive) else values


def silent_as_stopped(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
    """Say with respond 0 that the shaft stands."""
    return values if mks(drive).settings["respond"] else values | {"status": int(mks_shared.MotorStatus.STOPPED)}


def by_pin(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
    """Say in a bus mode too that a motor is disabled whose pin would have to be high."""
    return values | {"enabled": 0} if mks(drive).settings["enable_level"] == mks_shared.Level.HIGH else values


def while_enabled(verb: Verb) -> Change:
    """Answer what was read last while the motor was enabled."""

    def install(hooks: Hooks) -> None:
        last: Values = {}

        def hook(drive: Drive, command: Command, asked: Values, values: Values | None) -> Values | None:
            nonlocal last
            if command.verb is not verb or values is None:
                return values
            if mks(drive).enabled or not last:
                last = values
            return last

        hooks.result.append(hook)

    return Change(install, having(verb))


def stale(verb: Verb) -> Change:
    """Answer with the values of the reply before."""

    def install(hooks: Hooks) -> None:
        last: list[Values] = []

        def hook(drive: Drive, command: Command, asked: Values, values: Values | None) -> Values | None:
            if command.verb is not verb or values is None:
                return values
            last.append(values)
            return last.pop(0) if len(last) > 1 else values

        hooks.result.append(hook)

    return Change(install, having(verb))


def read_back(change: Callable[[MksCore, int, Values], Values | None]) -> Change:
    """Change the values of a parameter that can be read: `change(drive, code, values)`."""

    def apply(drive: Drive, command: Command, asked: Values, values: Values) -> Values | None:
        return values if "unreadable" in values else change(mks(drive), asked["parameter"], values)

    return result(apply, Verb.READ_PARAMETER)


def shifted(drive: MksCore, code: int, values: Values) -> Values:
    """Give each field the value of the next one."""
    names, numbers = list(values), list(values.values())
    return dict(zip(names, numbers[1:] + numbers[:1], strict=True))


def first_one_up(drive: MksCore, code: int, values: Values) -> Values:
    """Add one to the first field."""
    return values | {n: v + 1 for n, v in list(values.items())[:1]}


def defaults(drive: MksCore, code: int, values: Values) -> Values:
    """Answer with the defaults."""
    return {name: drive.factory.get(name, value) for name, value in values.items()}


def near_subdivision(drive: MksCore, code: int, values: Values) -> Values:
    """Tell 24 subdivisions in the place of 25."""
    return {"subdivision": 24} if code == SUBDIVISION_CODE and values["subdivision"] == 25 else values


def no_subdivision(drive: MksCore, code: int, values: Values) -> Values:
    """Say that the subdivision cannot be read."""
    return {"unreadable": 0xFFFF} if code == SUBDIVISION_CODE else values


# --- storing ---------------------------------------------------------------------------------------------------------


def retuned(verb: Verb) -> Change:
    """Let a setting change what the drive listens to."""

    def act(behaviour: Behaviour, drive: MksCore, request: Request) -> Values | None:
        answer = behaviour(drive, request)
        drive.tune()
        return answer

    return wrapped(verb, act)


def restore_running(drive: MksCore, request: Request) -> Values:
    """Put the settings back, and go on as before."""
    drive.settings.update(drive.factory)
    drive.tune()
    return dict(OK)


def both_ports(drive: MksCore, request: Request) -> None:
    """Write the PEND port whenever the ALM port is written."""
    if request.values["alm_mask"] == 1:
        drive.memory.pend_mask, drive.memory.pend = 1, request.values["pend"]


def keep_ports(drive: MksCore, request: Request) -> Values | None:
    """Leave written ports as they are when they are given back."""
    return None if request.values["alm_mask"] or request.values["pend_mask"] else dict(OK)


def leave_group(drive: MksCore, request: Request) -> None:
    """Take the drive out of its group."""
    drive.settings["group_address"] = 0


def store_refused(drive: Drive, command: Command, values: Values, wanted: bool) -> bool:
    """Store what is allowed of a setting that is refused."""
    if not wanted and command.verb is Verb.SET_HOME:
        for name, value in values.items():
            if mks(drive).fields[name].allows(value):
                mks(drive).store(name, value)
    return wanted


def refuse_settings(drive: Drive, command: Command, values: Values, wanted: bool) -> bool:
    """Refuse each setting that a drive stores."""
    return wanted and command.verb not in SETTINGS
