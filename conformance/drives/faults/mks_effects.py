"""Faults of MKS drives that tell one thing and do another: a shaft let go that is held, a limit without its level.

Rules kept here:
- Each reply is the one of the manual; the shaft, a switch or a port does otherwise.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

from msgspec.structs import replace

from analyzer.catalogue import Command, Verb
from analyzer.link import READS
from analyzer.protocols import mks_shared
from analyzer.records import Frame, Message
from conformance.drives.drive import Drive, Outgoing, Request, Values
from conformance.drives.faults.mks_behaviour import before, enclose, homing_by, mks, overridden, tuned, wrapped
from conformance.drives.faults.numbers import swap_bytes
from conformance.drives.faults.places import (
    CAN,
    MODBUS,
    NATIVE,
    SERIAL,
    Change,
    Row,
    Rows,
    faults,
    having,
    request,
    result,
    stored,
    storing,
    taken,
    together,
)
from conformance.drives.mks.core import MOTIONS, Activity, Behaviour, MksCore
from conformance.drives.mks.motion import begin_run, set_zero
from conformance.drives.mks.paths import Number
from conformance.drives.mks.settings import restart

# --- reads that act ---------------------------------------------------------------------------------------------------


def _reading(verb: Verb, act: Callable[[MksCore], None]) -> Change:
    """Do something when what a command does is read: 00 with its code on CAN, 04h of its register by Modbus."""

    def install(drive: MksCore) -> None:
        code = drive.dialect.by_verb[verb].code

        def accept(_: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
            if wanted and _read_code(frame) == code:
                act(drive)
            return wanted

        drive.hooks.accept.append(accept)

    return tuned(install, tuple(name for name in having(verb) if name in (*CAN, *MODBUS)))


def _read_code(frame: Frame) -> int | None:
    """Return the code of what is read."""
    if frame.can is not None:
        return frame.data[1] if frame.data[0] == 0 else None
    _, function, *register = frame.data[:4]
    return int.from_bytes(bytes(register), "big") if function in READS else None


def _told_by_nine_bits(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
    return values | {name: value & 0x1FF for name, value in values.items() if name == "new_address"}


def _halt(drive: MksCore) -> None:
    drive.drop()
    drive.memory.run = None
    drive.motor.halt(drive.now_ns)


def _turn_home(drive: MksCore) -> None:
    if drive.ready and drive.memory.run is None:
        begin_run(drive, drive.settings["home_direction"], drive.settings["home_speed"], 0)


# --- a run that a restart does not end --------------------------------------------------------------------------------


def _taking_up_run(drive: MksCore) -> None:
    """Begin the run again behind a restart that was under way in the closed mode."""
    power_on, restarting, run = drive.power_on, drive.behaviours[Verb.RESTART], None

    def restarted(core: MksCore, request: Request) -> Values | None:
        nonlocal run
        run = core.memory.run if "close" in core.mode else None
        return restarting(core, request)

    def started(core: MksCore) -> None:
        nonlocal run
        power_on(core)
        again, run = run, None
        if again is not None and core.ready:
            begin_run(core, *again)

    drive.behaviours[Verb.RESTART] = restarted
    drive.power_on = started


# --- a shaft that is let go -------------------------------------------------------------------------------------------


def _keeping_torque(_: object, drive: MksCore) -> None:
    """End what is under way, say that the drive is protected, and hold the shaft."""
    drive.memory.protected = True
    drive.motor.settle(drive.now_ns)
    drive.memory.run = None
    drive.finish(None)


def _going_on(_: object, drive: MksCore) -> None:
    """Say that the drive is protected, and drive the shaft on."""
    drive.memory.protected = True
    drive.heedless.add("protection")
    drive.finish(None)


def _taking_up(drive: MksCore) -> None:
    """Turn on to where the shaft was going when 3D ends the protection."""
    wanted: list[Number] = []
    protect = drive.protect

    def protect_later() -> None:
        wanted[:] = [drive.motor.wanted(drive.motor.settled)]
        protect()

    def act(release: Behaviour, core: MksCore, request: Request) -> Values | None:
        answer = release(core, request)
        if wanted and core.ready:
            core.motor.move(core.now_ns, wanted.pop(), 120, 0)
        return answer

    drive.protect = protect_later  # type: ignore[method-assign]
    enclose(drive, Verb.RELEASE_PROTECTION, act)


def _gripping(of: Callable[[MksCore], bool]) -> Change:
    """Let a drive that tells a motor as disabled hold its shaft, in a condition."""

    def held(grip: Callable[[], None], drive: MksCore) -> None:
        grip()
        if not drive.enabled and of(drive):
            drive.motor.hold(drive.now_ns)

    return overridden("grip", held)


# --- end limits -------------------------------------------------------------------------------------------------------


def _limits_by_low_pins(effective: Callable[[str], bool], drive: MksCore, side: str) -> bool:
    """Take a low pin for the end stop at both levels of home_trigger, except while homing."""
    return effective(side) if drive.doing(Activity.HOME) else drive.side_wired(side) and drive.level(side) == 0


def _closed_start_by_low_pins(home: Behaviour, drive: MksCore, request: Request) -> Values | None:
    """Take a low pin for the end stop at both levels of home_trigger, where homing begins at it."""
    effective = drive.effective
    drive.effective = lambda side: drive.level(side) == 0  # type: ignore[method-assign]
    try:
        return home(drive, request)
    finally:
        drive.effective = effective  # type: ignore[method-assign]


# --- a threshold within a range ---------------------------------------------------------------------------------------


def _division(change: Callable[[int], int], counted: Callable[[int], int] = abs) -> Change:
    """Divide the pulses, or what is `counted` of them, by another period than was set; what is read back is what was set."""

    def tell(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
        settings, core = drive.settings, mks(drive)
        period = change(settings["division_period"])
        if core.memory.pend_mask:
            return values
        level = (
            settings["division_level"] ^ (counted(core.pulses) // period & 1)
            if period
            else int(core.motor.speed(core.now_ns) == 0)
        )
        return values | {"pend": level}

    return Change(result(tell, Verb.READ_IO).install, having(Verb.SET_PULSE_DIVISION))


def _in_steps(drive: Drive, name: str, value: int) -> tuple[str, int]:
    return name, 256 if name == "current" and 256 <= value < 1024 else value


def _tolerance(degrees: int, either: Callable[[Number, Number], Number]) -> Change:
    """Let the shaft go at another lag than was set, on one side of some degrees."""

    def change(drive: MksCore) -> None:
        strays, limit = drive.motor.strays, Fraction(degrees * drive.motor.counts_per_turn, 360)
        drive.motor.strays = lambda counts, after: strays(either(counts, limit), after)  # type: ignore[method-assign]

    return tuned(change, having(Verb.SET_STALL_TOLERANCE))


def _deaf_to_high_groups(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
    group = drive.settings.get("group_address", 0)
    return wanted and not (message.address == group != drive.address and group > 0x7F)


# --- the end of a motion ----------------------------------------------------------------------------------------------


def _last_words(change: Callable[[bytes], bytes]) -> Change:
    """Change the bytes by which the end of a motion is told."""

    def tune(drive: MksCore) -> None:
        complete, ends = drive.complete, False

        def told(request: Request, values: Values) -> None:
            nonlocal ends
            ends = True
            complete(request, values)
            ends = False

        def say(_: Drive, command: Command, outgoing: Outgoing) -> tuple[Outgoing]:
            return (replace(outgoing, data=change(outgoing.data)) if ends else outgoing,)

        drive.complete = told  # type: ignore[method-assign]
        drive.hooks.reply.append(say)

    return tuned(tune, NATIVE)


def _unwatched(when: Callable[[MksCore, Command], bool]) -> Change:
    """Watch no motion for a locked rotor of which this is so."""

    def ask(drive: Drive, command: Command, values: Values) -> Values:
        if command.verb in MOTIONS:
            core = mks(drive)
            (core.heedless.add if when(core, command) else core.heedless.discard)("protection")
        return values

    return Change(lambda hooks: hooks.request.append(ask), having(Verb.SET_PROTECTION))


def _far_above(drive: Drive, command: Command, values: Values) -> Values:
    """Take a place in the lower half of what its field holds below 0 for one above."""
    half = 1 << command.request_forms[0].layout.named["position"].bit_width - 2
    return values | {"position": values["position"] + 2 * half} if values["position"] < -half else values


def _waiting_for_enable(drive: MksCore) -> None:
    """Refuse motion behind 3D until the motor is enabled, which 3A tells that it is."""
    waits = False

    def let_wait(release: Behaviour, core: MksCore, request: Request) -> Values | None:
        nonlocal waits
        waits = waits or core.memory.protected
        return release(core, request)

    def end_wait(enable: Behaviour, core: MksCore, request: Request) -> Values | None:
        nonlocal waits
        waits = waits and not request.values["enabled"]
        return enable(core, request)

    enclose(drive, MOTIONS, lambda begin, core, request: core.refused(request) if waits else begin(core, request))
    enclose(drive, Verb.RELEASE_PROTECTION, let_wait)
    enclose(drive, Verb.ENABLE, end_wait)


def _turning_back(drive: MksCore) -> None:
    """Turn the shaft back to where it was disabled when it is enabled."""
    left: list[Number] = []

    def act(enable: Behaviour, core: MksCore, request: Request) -> Values | None:
        if not request.values["enabled"]:
            left[:] = [core.motor.position(core.now_ns)]
        answer = enable(core, request)
        if request.values["enabled"] and left:
            core.motor.jump(core.now_ns, left.pop() - core.motor.position(core.now_ns))
        return answer

    enclose(drive, Verb.ENABLE, act)


EFFECTS: Rows = {
    "reads": (
        Row("read-of-restart-restarts", "a read of 41 restarts the drive", _reading(Verb.RESTART, restart)),
        Row("read-of-zero-sets-zero", "a read of 92 sets the zero", _reading(Verb.SET_ZERO, set_zero)),
        Row("read-of-stop-stops", "a read of F7 stops the motor", _reading(Verb.EMERGENCY_STOP, _halt)),
        Row("read-of-home-turns", "a read of 91 turns the shaft", _reading(Verb.HOME, _turn_home)),
        Row("address-told-by-9-bits", "00 8B tells the low 9 bits of the address",
            result(_told_by_nine_bits, Verb.READ_PARAMETER), CAN),
    ),
    "restart": (
        Row("closed-run-taken-up", "a run in the closed mode begins again behind a restart", tuned(_taking_up_run, SERIAL)),
    ),
    "completion": (
        Row("completion-cut", "what tells the end of a motion lacks its last two bytes",
            _last_words(lambda data: data[:-2]), NATIVE),
        Row("completion-of-noise", "the end of a motion is told by noise",
            _last_words(lambda data: bytes(b ^ 0x55 for b in data)), NATIVE),
    ),
    "within a range": (
        Row("division-from-50", "PEND divides the pulses from a period of 50 on", _division(lambda n: n if n >= 50 else 0)),
        Row("division-not-above-5000", "PEND divides no pulses by more than 5000",
            _division(lambda n: n if 100 <= n <= 5000 else 0)),
        Row("division-of-16-bits", "PEND divides pulses by 16 bits of the period",
            _division(lambda n: n & 0xFFFF if n >= 100 else 0)),
        Row("division-above-100", "PEND divides no pulses by 100", _division(lambda n: n if n > 100 else 0)),
        Row("division-of-positive", "PEND divides the pulses of one way alone",
            _division(lambda n: n if n >= 100 else 0, lambda pulses: max(pulses, 0))),
        Row("current-of-steps", "currents of 256 to 1023 mA are stored as 256",
            storing(_in_steps, "current"), CAN),
        Row("slow-homing-capped", "91 turns at the home speed, but at 1000 rpm at most",
            homing_by(lambda settings: {"home_speed": min(settings["home_speed"], 1000)})),
        Row("home-backs-off-half-a-turn", "from a closed end stop homing goes back half a turn, whatever the return angle is",
            homing_by(lambda s: {} if s["home_mode"] else {"return_angle": mks_shared.COUNTS_PER_TURN // 2}), CAN),
        Row("home-backs-off-16-bits", "from a closed end stop homing goes back by the low 16 bits of the return angle",
            homing_by(lambda s: {} if s["home_mode"] else {"return_angle": s["return_angle"] & 0xFFFF}), CAN),
        Row("small-tolerance-coarse", "stall tolerances below 72 degrees hold as that", _tolerance(72, max)),
        Row("great-tolerance-capped", "stall tolerances above 1800 degrees hold as that", _tolerance(1800, min)),
        Row("widest-below-is-above", "absolute moves take a place that is widest below 0 for one above",
            request(_far_above, (Verb.MOVE_ABSOLUTE_PULSES, Verb.MOVE_ABSOLUTE_AXIS))),
        Row("home-speed-low-first", "90 stores the speed low byte first, where that is within its range",
            stored("home_speed", lambda value, field: turned if field.allows(turned := swap_bytes(value, field)) else value)),
        Row("high-groups-deaf", "a group above 7Fh is not heard", taken(_deaf_to_high_groups), having(Verb.SET_GROUP_ADDRESS)),
    ),
    "limits": (
        Row("limits-by-low-pins", "end limits hold where a pin is low, at any home_trigger",
            overridden("effective", _limits_by_low_pins)),
        Row("closed-start-by-low-pin", "homing leaves an end stop first whose pin is low, at any home_trigger",
            wrapped(Verb.HOME, _closed_start_by_low_pins)),
    ),
    "let go": (
        Row("protected-keeps-torque", "3E reads 1 and the motor holds the shaft", overridden("protect", _keeping_torque)),
        Row("protected-goes-on", "3E reads 1 and the motor turns the shaft on",
            together(overridden("protect", _going_on),
                before((Verb.RELEASE_PROTECTION, Verb.SET_PROTECTION), lambda drive, _: drive.heedless.discard("protection")))),
        Row("fe-unwatched", "the protection does not watch FE",
            _unwatched(lambda drive, command: command.verb is Verb.MOVE_ABSOLUTE_PULSES)),
        Row("close-unwatched", "the protection does not watch in SR_CLOSE",
            _unwatched(lambda drive, command: drive.mode == "sr_close"), SERIAL),
        Row("enabling-turns-back", "F3 01 turns the shaft back to where F3 00 let it go", tuned(_turning_back)),
        Row("release-needs-enabling", "behind 3D motion is refused until F3 01, though 3A reads 1", tuned(_waiting_for_enable)),
        Row("release-takes-up", "3D takes up the motion that the protection ended", tuned(_taking_up)),
        Row("disabled-keeps-torque", "3A reads 0 and the motor holds the shaft", _gripping(lambda drive: drive.by_bus)),
        Row("en-pin-keeps-torque", "3A reads 0 and the motor holds the shaft at the En pin's other level",
            _gripping(lambda drive: not drive.by_bus)),
    ),
}  # fmt: skip

FAULTS = faults(EFFECTS)
