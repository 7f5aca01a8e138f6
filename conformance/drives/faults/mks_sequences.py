"""Faults of the MKS drives that show behind something else alone: behind a stop, another update, a setting that is undone.

Also those that need a value that few send: a step of a few units, a frame in the data of another one.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial

from msgspec.structs import replace

from analyzer.catalogue import Command, Verb
from analyzer.decoder import Slot
from analyzer.protocols import mks_can, mks_rs485, mks_shared
from analyzer.records import Frame, Message
from conformance.drives.drive import Drive, Request, Values
from conformance.drives.faults import numbers
from conformance.drives.faults.mks_behaviour import (
    OK,
    Around,
    as_given,
    before,
    by_laws,
    enclose,
    hold,
    homing_by,
    leave_group,
    mks,
    overridden,
    tuned,
    wrapped,
)
from conformance.drives.faults.mks_conditions import Tell, refused_when, undone_when
from conformance.drives.faults.mks_frames import mine, slots
from conformance.drives.faults.places import (
    CAN,
    NATIVE,
    SERIAL,
    TELLING,
    Change,
    Row,
    Rows,
    faults,
    having,
    limit,
    request,
    result,
    storing,
)
from conformance.drives.mks.core import MOTIONS, STOPS, Activity, Behaviour, MksCore, Script
from conformance.drives.mks.motion import TARGETS, begin_run
from conformance.drives.mks.paths import Number, divided
from conformance.drives.mks.state import SUBDIVISION

#: Steps that are too short for a drive; updates that it takes; pulses that it loses behind a stop.
_SHORTEST, _UPDATES, _LOST = 6, 2, 40
_BITS_11, _LOW_WORD, _SIGN_24 = 0x7FF, 0xFFFF, 0x80_0000
_SCALED, _SAFE_RPM, _FASTEST_BACK = 32, 1200, 4
_TO_PLACES = (Verb.MOVE_ABSOLUTE_PULSES, Verb.MOVE_ABSOLUTE_AXIS)
#: The highest subdivision at which the speed is what is sent.
_PLAIN_MOST = max(SUBDIVISION.plain)
_MOTION_CODES = frozenset(command.code for command in mks_rs485.DIALECT.commands if command.verb in MOTIONS)


def _short(drive: Drive, command: Command, values: Values) -> Values:
    name = "pulses" if "pulses" in values else "position"
    return values | {name: 0} if abs(values[name]) < _SHORTEST else values


def _from_axis_of_24_bits(drive: Drive, command: Command, values: Values) -> Values:
    """Take a target as if the axis had 24 bits."""
    axis = mks(drive).axis
    narrow = (axis + _SIGN_24 & 2 * _SIGN_24 - 1) - _SIGN_24
    return values | {"position": values["position"] + axis - narrow} if values["speed"] else values


def _stopped_by_low_word(drive: Drive, command: Command, values: Values) -> Values:
    """Take a target for 0, and the motion for a stop, whose low bits are 0."""
    number = values["pulses" if "pulses" in values else "position"]
    return values | {"speed": 0} if number and not number & _LOW_WORD else values


def _sets(slot: Slot) -> bool:
    return slot.command is not None and slot.command.verb.value.startswith("set_")


def _loses_pulses(drive: MksCore, request: Request) -> None:
    if drive.motor.speed(drive.now_ns):
        drive.memory.pulse_zero += _LOST * drive.pulse_counts


def _target_kept(protected: bool) -> Callable[[MksCore], None]:
    """Add to the next move by counts what was left of the move that the protection, or the emergency stop, ended."""

    def change(drive: MksCore) -> None:
        left = 0
        stop, protect, move = drive.behaviours[Verb.EMERGENCY_STOP], drive.protect, drive.behaviours[Verb.MOVE_RELATIVE_AXIS]

        def keep() -> None:
            nonlocal left
            target = drive.motor.wanted(drive.motor.settled)
            left = round(target - drive.motor.position(drive.now_ns)) if drive.doing(Activity.MOVE) else 0

        def stopped(core: MksCore, request: Request) -> Values | None:
            keep()
            return stop(core, request)

        def let_go() -> None:
            keep()
            protect()

        def moved(core: MksCore, request: Request) -> Values | None:
            nonlocal left
            if not core.memory.protected:
                request.values["position"] += left
                left = 0
            return move(core, request)

        drive.behaviours[Verb.MOVE_RELATIVE_AXIS] = moved
        if protected:
            drive.protect = let_go  # type: ignore[method-assign]
        else:
            drive.behaviours[Verb.EMERGENCY_STOP] = stopped

    return change


def _scaled_moves(obey: Behaviour, drive: MksCore, request: Request) -> Values | None:
    """Reckon the speed of moves by a subdivision at which it is what is sent."""
    plain = drive.real_speed
    if drive.subdivision == _SCALED:
        drive.real_speed = lambda speed: divided(speed * 16, _SCALED)  # type: ignore[method-assign]
    try:
        return obey(drive, request)
    finally:
        drive.real_speed = plain  # type: ignore[method-assign]


def _as_sent_at_odd(plain: Callable[[int], Number], drive: MksCore, speed: int) -> Number:
    """Turn at the speed as sent at odd subdivisions above 64."""
    return speed if drive.subdivision > _PLAIN_MOST and drive.subdivision % 2 else plain(speed)


def _of_11_bits(real: Callable[[int], Number], drive: MksCore, speed: int) -> Number:
    """Keep 11 bits of a speed that is more than was sent."""
    return min(real(speed), max(speed, _BITS_11))


def _few_updates(verb: Verb) -> Change:
    """Take so many moves that take over from one another, and no more."""

    def change(drive: MksCore) -> None:
        taken = 0

        def behave(obey: Behaviour, core: MksCore, asked: Request) -> Values | None:
            nonlocal taken
            taken = taken + 1 if core.doing(Activity.MOVE) and core.motor.speed(core.now_ns) else 0
            return dict(OK) if taken > _UPDATES else obey(core, asked)

        enclose(drive, verb, behave)

    return tuned(change, having(verb))


def _by_code(address: int, every: list[Slot], wanted: list[Slot]) -> list[Slot]:
    """Return the first slot of each code."""
    return list({slot.code: slot for slot in reversed(mine(address, every))}.values())[::-1]


def _first_motion(address: int, every: list[Slot], wanted: list[Slot]) -> list[Slot]:
    """Return the first slot that is a motion, and the first slot where none is."""
    own = mine(address, every)
    return [slot for slot in own if slot.code in _MOTION_CODES][:1] or own[:1]


def _kept_at_rest(drive: MksCore, request: Request) -> Values | None:
    """Say that the run is cleaned, and keep it, where the shaft stands."""
    cleans = request.values["save_state"] == mks_shared.SaveState.CLEAN
    return dict(OK) if cleans and not drive.motor.speed(drive.now_ns) else None


def _begins_kept(ready: Callable[[Request], bool]) -> Around:
    """Begin a kept run where a command makes the motor ready."""

    def act(behaviour: Behaviour, drive: MksCore, request: Request) -> Values | None:
        found, settings = behaviour(drive, request), drive.settings
        if settings["saved_run"] and drive.ready and ready(request):
            begin_run(drive, settings["saved_direction"], settings["saved_speed"], settings["saved_acceleration"])
        return found

    return act


def _kept_goes_on(drive: MksCore, of: Verb) -> None:
    """Let the emergency stop, or disabling, end no run that began by itself."""
    begun, power_on, end = False, drive.power_on, drive.behaviours[of]

    def start(_: MksCore) -> None:
        nonlocal begun
        power_on(drive)
        begun = drive.memory.run is not None

    def note(_: Drive, command: Command, values: Values) -> Values:
        nonlocal begun
        begun = begun and command.verb not in MOTIONS
        return values

    drive.power_on = start
    drive.hooks.request.append(note)
    drive.behaviours[of] = lambda _, request: (
        dict(OK) if begun and drive.memory.run and not request.values.get("enabled") else end(drive, request)
    )


def _saves_older(drive: MksCore) -> None:
    """Save the run that came before the present one."""
    runs: list[tuple[int, int, int] | None] = []
    run, save = drive.behaviours[Verb.RUN_SPEED], drive.behaviours[Verb.SAVE_SPEED]

    def begin(_: MksCore, request: Request) -> Values | None:
        runs.append(drive.memory.run)
        return run(drive, request)

    def keep(_: MksCore, request: Request) -> Values | None:
        newest = drive.memory.run
        older = runs[-1] if runs else None
        drive.memory.run = (older or newest) if newest else None
        found = save(drive, request)
        drive.memory.run = newest
        return found

    drive.behaviours |= {Verb.RUN_SPEED: begin, Verb.SAVE_SPEED: keep}


def _forgets_newest(drive: MksCore) -> None:
    """Forget a run alone that was kept since the drive began."""
    memory = None

    def act(save: Behaviour, core: MksCore, request: Request) -> Values | None:
        nonlocal memory
        if request.values["save_state"] == mks_shared.SaveState.SAVE:
            memory = core.memory
        elif memory is not core.memory:
            return dict(OK)
        return save(core, request)

    enclose(drive, Verb.SAVE_SPEED, act)


def _released_once(drive: MksCore) -> None:
    """Release one protection alone until a restart."""
    memory = None

    def act(release: Behaviour, core: MksCore, request: Request) -> Values | None:
        nonlocal memory
        if memory is core.memory:
            return dict(OK)
        memory = core.memory if core.memory.protected else memory
        return release(core, request)

    enclose(drive, Verb.RELEASE_PROTECTION, act)


def _current_not_put_back(drive: MksCore) -> None:
    """Store no current that is the one before the last."""
    sent: list[int] = []

    def store(_: Drive, name: str, value: int) -> tuple[str, int] | None:
        if name != "current":
            return name, value
        sent.append(value)
        return None if len(sent) > 2 and sent[-3] == value != sent[-2] else (name, value)

    drive.hooks.stored.append(store)


def _alm_beside_pend(drive: Drive, command: Command, values: Values) -> Values:
    """Write ALM with PEND, though its mask keeps it."""
    return values | {"alm_mask": 1} if values["pend_mask"] == 1 and values["alm_mask"] == mks_can.PortMask.KEEP else values


def _move_told_turned(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
    core = mks(drive)
    turned = core.doing(Activity.MOVE) and core.settings["motor_direction"]
    return values | {"speed": -values["speed"]} if turned else values


_homing_turned = Change(
    homing_by(lambda settings: {"home_direction": settings["home_direction"] ^ settings["motor_direction"]}).install, SERIAL
)


def _taking_ramp_of_last(verb: Verb, takes: Callable[[int, int], bool]) -> Callable[[MksCore], None]:
    """Let a motion take the acceleration of the one before; `takes(its own, that)` says when."""

    def change(drive: MksCore) -> None:
        last: int | None = None

        def act(behaviour: Behaviour, core: MksCore, request: Request) -> Values | None:
            nonlocal last
            own = request.values["acceleration"]
            if request.command.verb is verb and last is not None and takes(own, last):
                request.values = request.values | {"acceleration": last}
            last = own
            return behaviour(core, request)

        enclose(drive, MOTIONS, act)

    return change


def _slower_back(direction: int) -> Callable[[Drive, Command, Values], Values]:
    """Turn the scale of the speed round for the way back by a direction."""

    def ask(drive: Drive, command: Command, values: Values) -> Values:
        if values["zero_mode"] == mks_shared.ZeroMode.DIRECTION and values["zero_direction"] == direction:
            return values | {"zero_speed": _FASTEST_BACK - values["zero_speed"]}
        return values

    return ask


def _end_run(drive: MksCore, request: Request) -> None:
    """Stop the shaft where a run is forgotten."""
    if request.values["save_state"] == mks_shared.SaveState.CLEAN:
        drive.motor.run(drive.now_ns, 0, 0)


def _only_ccw_stops(drive: MksCore, request: Request) -> Values | None:
    """Say that a run at speed 0 stops the shaft, and let it go on where the direction is clockwise."""
    clockwise = request.values["direction"] == mks_shared.MotionDirection.CW
    return dict(OK) if clockwise and not request.values["speed"] else None


def _inner_requests(take: Callable[[Frame], None], drive: MksCore, frame: Frame) -> None:
    """Find a request to the drive anywhere in a frame that is for another one."""
    link, data = drive.dialect.link, frame.data
    if frame.can is None and link.parse(data).address != drive.address:
        ends = ((first, last) for first in range(2, len(data)) for last in range(first + 4, len(data)))
        pieces = (data[first:last] for first, last in ends)
        inner = next((p for p in pieces if link.fits(p) and link.parse(p).address == drive.address), None)
        frame = frame if inner is None else replace(frame, data=inner, checksum_ok=True)
    take(frame)


def _silent_if_active(silenced: Callable[[Command], bool], drive: MksCore, command: Command) -> bool:
    """Take `respond` 0 for 1 where `active` is 0 too."""
    return silenced(command) and bool(drive.settings["active"])


def _refuses_aloud(
    answer: Callable[..., None], drive: MksCore, request: Request, result: Values | None, answered: bool, *to: int
) -> None:
    """Answer a refusal although `respond` is 0."""
    answer(request, result, answered or (request.answered and result == drive.refused(request)), *to)


def _tells_ends(aloud: Callable[[Request, Values], bool]) -> Change:
    """Tell some ends of moves although `respond` is 0."""

    def tell(complete: Tell, drive: MksCore, request: Request, values: Values) -> None:
        respond = drive.settings["respond"]
        drive.settings["respond"] = int(respond or aloud(request, values))
        complete(request, values)
        drive.settings["respond"] = respond

    return overridden("complete", tell, TELLING)


def _lets_go_once_limited(drive: MksCore) -> None:
    """Let the shaft go at the end of homing where the end limit was on once."""
    limited = 0
    finish = drive.finish

    def note(_: Drive, command: Command, values: Values) -> Values:
        nonlocal limited
        limited |= values.get("end_limit", 0)
        return values

    def finished(status: int | None) -> None:
        homed = drive.doing(Activity.HOME) and status == mks_shared.HomeStatus.SUCCESS
        finish(status)
        if homed and limited:
            drive.memory.enabled = False
            drive.grip()

    drive.hooks.request.append(note)
    drive.finish = finished  # type: ignore[method-assign]


def _keeps_ramp(drive: MksCore) -> None:
    """Change the speed of a shaft that turns by the acceleration that it was set going with."""
    first = 0

    def ask(_: Drive, command: Command, values: Values) -> Values:
        nonlocal first
        if command.verb not in MOTIONS:
            return values
        if not drive.motor.speed(drive.now_ns):
            first = values["acceleration"]
        return values | {"acceleration": first}

    drive.hooks.request.append(ask)


def _keeps_faster(drive: MksCore) -> None:
    """Turn on at the speed of the older motion where that of a newer one is lower; a stop has none."""
    older = 0

    def ask(_: Drive, command: Command, values: Values) -> Values:
        nonlocal older
        if command.verb in MOTIONS and values["speed"]:
            older = max(values["speed"], older if drive.motor.speed(drive.now_ns) else 0)
            return values | {"speed": older}
        return values

    drive.hooks.request.append(ask)


def _speeds_as_before(drive: MksCore) -> None:
    """Reckon speeds by the subdivision of before where one is set while the shaft turns, until the next one at rest."""
    used, real = 0, drive.real_speed

    def obeys(obey: Behaviour, core: MksCore, request: Request) -> Values | None:
        nonlocal used
        used = (used or core.settings["subdivision"]) if core.motor.speed(core.now_ns) else 0
        return obey(core, request)

    def as_before(speed: int) -> Number:
        if not used:
            return real(speed)
        return speed if used in SUBDIVISION.plain else divided(speed * SUBDIVISION.counted_at, used)

    enclose(drive, Verb.SET_SUBDIVISION, obeys)
    drive.real_speed = as_before  # type: ignore[method-assign]


def _told_behind(settings: bool, verb: Verb, **told: int) -> Change:
    """Tell something else behind a setting, or a newer motion, that came while the shaft turned, until the next one at rest."""

    def change(drive: MksCore) -> None:
        wrong = False

        def watch(_: Drive, command: Command, values: Values) -> Values:
            nonlocal wrong
            if command.verb.value.startswith("set_") if settings else command.verb in MOTIONS:
                wrong = bool(drive.motor.speed(drive.now_ns))
            return values

        drive.hooks.request.append(watch)
        drive.hooks.result.append(
            lambda _, command, asked, values: values | told if wrong and values and command.verb is verb else values
        )

    return tuned(change, having(verb))


def _stops_of_all(change: Callable[[int, int], int]) -> Callable[[MksCore], None]:
    """Stop by another acceleration where a stop is for all drives. `change` gets the acceleration sent and the motion's."""

    def install(drive: MksCore) -> None:
        shared, moved = False, 0

        def note(_: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
            nonlocal shared
            shared = message.address == drive.dialect.broadcast
            return wanted

        def stop(_: Drive, command: Command, values: Values) -> Values:
            nonlocal moved
            if command.verb in MOTIONS:
                moved = values["acceleration"]
            if shared and command.verb in STOPS:
                return values | {"acceleration": change(values["acceleration"], moved)}
            return values

        drive.hooks.accept.append(note)
        drive.hooks.request.append(stop)

    return install


def _emergency_completes(kind: Activity, status: int, verbs: Collection[Verb]) -> Change:
    """Tell what the emergency stop ended as done when it would have been: a move, or homing at once."""

    def act(stop: Behaviour, drive: MksCore, request: Request) -> Values | None:
        task, until = drive.task, drive.motor.settled if kind is Activity.MOVE else drive.now_ns
        result = stop(drive, request)
        if task is not None and task.kind is kind and task.request is not None and task.request.command.verb in verbs:
            drive.begin(kind, _told_later(drive, until, status), task.request)
        return result

    return Change(wrapped(Verb.EMERGENCY_STOP, act).install, TELLING)


def _complete_open(drive: MksCore, request: Request) -> None:
    """Tell a move in the open mode as complete."""
    if "open" in drive.mode and drive.doing(Activity.MOVE):
        drive.finish(mks_shared.RunStatus.COMPLETE)


def _told_later(drive: MksCore, until: Number, status: int) -> Script:
    yield lambda: until
    drive.finish(status)


def _status_of_before(wanted: Collection[int]) -> Callable[[MksCore], None]:
    """Tell on behind an emergency stop the status that it ended, one of these, until the next motion."""

    def change(drive: MksCore) -> None:
        kept: Values | None = None

        def act(behaviour: Behaviour, core: MksCore, request: Request) -> Values | None:
            nonlocal kept
            before = core.behaviours[Verb.READ_STATUS](core, request)
            kept = before if request.command.verb is Verb.EMERGENCY_STOP and before and before["status"] in wanted else None
            return behaviour(core, request)

        enclose(drive, {Verb.EMERGENCY_STOP, Verb.HOME, *MOTIONS}, act)
        drive.hooks.result.append(
            lambda _, command, asked, values: kept if kept and command.verb is Verb.READ_STATUS else values
        )

    return change


def _slow_if_protected(highest: Callable[[int], int], drive: MksCore, declared: int) -> int:
    """Turn no faster than a limit while the protection is on."""
    return min(highest(declared), _SAFE_RPM) if drive.settings["protection"] else highest(declared)


def _way_back(drive: Drive, command: Command, sent: Values, found: Values) -> Values:
    by_direction = drive.settings["zero_mode"] == mks_shared.ZeroMode.DIRECTION
    return found if found["status"] or not by_direction else {"status": int(mks_shared.ZeroStatus.SUCCESS)}


SEQUENCES: Rows = {
    "behind a stop": (
        Row("stops-lose-pulses", f"33 loses {_LOST} pulses at each stop of a turning shaft", before(STOPS, _loses_pulses)),
        Row("target-kept", "F4 behind F7 goes on to the target of the move that F7 ended, too", tuned(_target_kept(False))),
        Row("target-kept-protected", "F4 behind 3D goes on to the target of the move that the protection ended, too",
            tuned(_target_kept(True))),
        Row("homing-unstopped", "F7 says success and does not end homing",
            undone_when(lambda drive: drive.doing(Activity.HOME), Verb.EMERGENCY_STOP)),
        Row("emergency-completes-pulses", "a move by pulses that F7 ended is told as complete when it would have been",
            _emergency_completes(Activity.MOVE, mks_shared.RunStatus.COMPLETE, (Verb.MOVE_RELATIVE_PULSES,))),
        Row("emergency-completes-open", "a move in the open mode that F7 ends is told as complete",
            before(Verb.EMERGENCY_STOP, _complete_open), TELLING),
        Row("emergency-completes-home", "homing that F7 ended is told as success",
            _emergency_completes(Activity.HOME, mks_shared.HomeStatus.SUCCESS, (Verb.HOME,))),
        Row("status-behind-emergency-ramp", "behind F7 on a ramp F1 reads the ramp on",
            tuned(_status_of_before((mks_shared.MotorStatus.SPEEDING_UP, mks_shared.MotorStatus.SLOWING_DOWN)))),
        Row("status-behind-emergency-home", "behind F7 while homing F1 reads homing on",
            tuned(_status_of_before((mks_shared.MotorStatus.HOMING,)), having(Verb.HOME))),
        Row("speed-0-cw-goes-on", "F6 with speed 0 and direction 1 stops nothing",
            before(Verb.RUN_SPEED, _only_ccw_stops), SERIAL),
        Row("cleaning-stops", "FF CA stops the shaft", before(Verb.SAVE_SPEED, _end_run)),
        Row("cleaned-turning-alone", "FF CA cleans the kept run while the shaft turns alone",
            before(Verb.SAVE_SPEED, _kept_at_rest)),
    ),
    "behind what came on the way": (
        Row("newer-keeps-ramp", "a motion that takes over from another one keeps its acceleration", tuned(_keeps_ramp)),
        Row("newer-keeps-faster", "a motion that takes over from a faster one keeps its speed", tuned(_keeps_faster)),
        Row("speeds-as-before", "84 while the shaft turns changes the length of moves, and no speed", tuned(_speeds_as_before)),
        Row("off-behind-settings", "3A reads 0 behind a setting that came while the shaft turned",
            _told_behind(True, Verb.READ_ENABLED, enabled=0)),
        Row("protected-behind-motions", "3E reads 1 behind a motion that took over from another one",
            _told_behind(False, Verb.READ_PROTECTION, status=1)),
    ),
    "one of many": (
        Row("third-target-lost", "of targets that follow one another the third is lost", _few_updates(Verb.MOVE_ABSOLUTE_AXIS)),
        Row("package-first-motion", "of the own slots of a package the first motion is executed", slots(_first_motion)),
        Row("package-late-slots-unset", "a setting in the last two slots of a package is not stored",
            slots(lambda own, every, wanted: [slot for slot in wanted if slot in every[:3] or not _sets(slot)])),
        Row("package-of-two-codes", "of the own slots of a package the first of each code is executed", slots(_by_code)),
    ),
    "by the ramp of before": (
        Row("at-once-by-ramp-of-before", "F5 with acceleration 0 takes the ramp of the motion before",
            tuned(_taking_ramp_of_last(Verb.MOVE_ABSOLUTE_AXIS, lambda own, last: not own))),
        Row("at-once-behind-at-once", "FE behind a motion with acceleration 0 is at once too",
            tuned(_taking_ramp_of_last(Verb.MOVE_ABSOLUTE_PULSES, lambda own, last: not last))),
    ),
    "sooner": (
        Row("release-enables", "3D enables a motor that is off and was not protected",
            before(Verb.RELEASE_PROTECTION, lambda drive, _: hold(drive))),
        *(
            Row(name, f"{code} does not end a run that began at power-on", tuned(partial(_kept_goes_on, of=of), having(of)))
            for name, code, of in (
                ("kept-run-unstopped", "F7", Verb.EMERGENCY_STOP),
                ("kept-run-not-disabled", "F3", Verb.ENABLE),
            )
        ),
        Row("saves-older-run", "FF keeps the run before the newest one", tuned(_saves_older, having(Verb.SAVE_SPEED))),
        Row("forgets-newest-run", "FF CA forgets a run alone that was kept since power-on",
            tuned(_forgets_newest, having(Verb.SAVE_SPEED))),
        Row("released-once", "3D releases the protection once until a restart",
            tuned(_released_once, having(Verb.RELEASE_PROTECTION))),
        Row("current-not-put-back", "83 does not set a current back to the one before",
            tuned(_current_not_put_back, having(Verb.SET_CURRENT))),
        Row("alm-beside-pend", "a write of PEND writes ALM with mask 2, too", request(_alm_beside_pend, Verb.WRITE_IO), CAN),
        Row("save-speed-begun-by-mode", "the kept run begins when 82 sets a mode by the bus",
            wrapped(Verb.SET_WORK_MODE, _begins_kept(lambda request: True))),
        Row("save-speed-begun-by-enabling", "the kept run begins when F3 enables the motor",
            wrapped(Verb.ENABLE, _begins_kept(lambda request: bool(request.values["enabled"])))),
    ),
    "undone": (
        Row("lets-go-once-limited", "90 with the end limit off leaves it on for homing", tuned(_lets_go_once_limited)),
        Row("protection-stays", "88 00 is answered, and the protection acts on",
            storing(lambda drive, name, value: None if name == "protection" and not value else (name, value), "protection")),
        Row("group-left-by-speed", "8A takes the drive out of its group",
            before(Verb.SET_BAUD_RATE, leave_group), having(Verb.SET_GROUP_ADDRESS)),
    ),
    "with another setting": (
        Row("respond-0-needs-active", "respond 0 silences nothing with active 0",
            overridden("silenced", _silent_if_active), NATIVE),
        Row("ends-told-aloud", "with respond 0 the end of FE and F5 is told",
            _tells_ends(lambda request, values: request.command.verb in _TO_PLACES)),
        Row("limit-told-aloud", "with respond 0 a move that an end limit stops is told",
            _tells_ends(lambda request, values: values["status"] == mks_shared.RunStatus.LIMIT_STOP)),
        Row("refused-aloud", "with respond 0 a refusal is answered", overridden("answer", _refuses_aloud), TELLING),
        Row("direction-turns-speed-of-moves", "with 86 on CCW the speed of a move is told the other way",
            result(_move_told_turned, Verb.READ_SPEED)),
        Row("direction-turns-home", "with 86 on CCW homing turns the other way round", _homing_turned),
        Row("protection-slows", f"with the protection on nothing turns faster than {_SAFE_RPM} rpm",
            overridden("highest_speed", _slow_if_protected)),
        *(
            Row(f"way-back-slower-{name}", f"a higher 0_Speed brings the shaft back {name} more slowly",
                request(_slower_back(direction), Verb.SET_ZERO_MODE), SERIAL)
            for name, direction in (("cw", mks_shared.ConfigDirection.CW), ("ccw", mks_shared.ConfigDirection.CCW))
        ),
        Row("way-back-untold", "3B reads 1 on the way back by a direction", result(_way_back, Verb.READ_ZERO_STATUS), SERIAL),
    ),
    "in one mode": (
        Row("homing-above-mode", "homing turns at the speed that is set, above that of the work mode",
            by_laws(Verb.HOME, highest_speed=as_given), SERIAL),
        Row("holding-refused-open", "9B is refused in an open mode",
            refused_when(lambda drive: "open" in drive.mode, Verb.SET_HOLDING_CURRENT), SERIAL),
    ),
    "few send it": (
        Row("address-fa-refused", "the address FA is refused", limit("new_address", numbers.refuses(0xFA)), NATIVE),
        Row("stops-of-all-at-once", "stops by broadcast are at once, at any acceleration",
            tuned(_stops_of_all(lambda sent, moved: 0))),
        Row("stops-of-all-by-ramp", "a stop by broadcast with acceleration 0 slows the shaft down by the ramp of its motion",
            tuned(_stops_of_all(lambda sent, moved: sent or moved))),
        Row("short-moves-undone", f"moves by fewer than {_SHORTEST} units turn nothing",
            request(_short, (Verb.MOVE_RELATIVE_PULSES, Verb.MOVE_RELATIVE_AXIS))),
        *(
            Row(f"low-word-stops-{name}", f"{name.upper()} by a number whose low word is 0 stops",
                request(_stopped_by_low_word, verb))
            for name, verb in (
                ("fd", Verb.MOVE_RELATIVE_PULSES),
                ("fe", Verb.MOVE_ABSOLUTE_PULSES),
                ("f4", Verb.MOVE_RELATIVE_AXIS),
                ("f5", Verb.MOVE_ABSOLUTE_AXIS),
            )
        ),
        Row("axis-of-24-bits", "F5 reckons with 24 bits of the axis", request(_from_axis_of_24_bits, Verb.MOVE_ABSOLUTE_AXIS)),
        Row("as-sent-at-odd", f"at odd subdivisions above {_PLAIN_MOST} the speed is the one that is sent",
            overridden("real_speed", _as_sent_at_odd), SERIAL),
        Row("scaled-speed-of-11-bits", f"a speed that is more than was sent is {_BITS_11} at most",
            overridden("real_speed", _of_11_bits)),
        Row("speeds-in-whole-rpm", "speeds of other subdivisions are rounded to whole rpm",
            overridden("real_speed", lambda real, drive, speed: round(real(speed)))),
        Row("speed-0-of-moves-goes-on", "F4 with speed 0 and a distance is answered, and the shaft goes on",
            before(Verb.MOVE_RELATIVE_AXIS, lambda drive, request: None if request.values["speed"] else dict(OK)), SERIAL),
        Row("moves-scaled-at-32", "at 32 subdivisions moves go at half their speed", wrapped(TARGETS, _scaled_moves)),
        Row("inner-request-obeyed", "a request in the data of another drive's is obeyed",
            overridden("_take", _inner_requests), NATIVE),
    ),
}  # fmt: skip

FAULTS = faults(SEQUENCES)
