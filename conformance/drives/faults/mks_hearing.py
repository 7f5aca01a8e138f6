"""Faults of the MKS drives in the frames that they take and answer, in one condition alone: after a motion, to a group.

Rules kept here:
- A fault holds in its condition, and everywhere else the drive does what the manual says.
"""

from __future__ import annotations

from collections.abc import Callable, Collection

from msgspec.structs import replace

from analyzer.catalogue import Command, Verb
from analyzer.link import WRITE_ONE
from analyzer.records import Frame, Message
from conformance.drives.drive import Drive, Hooks, Outgoing, Request, Values
from conformance.drives.faults.mks_behaviour import backwards, hold, mks, overridden, tuned, turns
from conformance.drives.faults.mks_frames import (
    Whom,
    answering,
    deaf_to,
    for_all,
    hearing,
    is_setting,
    of,
    own,
    package,
    to_group,
    to_next,
)
from conformance.drives.faults.places import (
    CAN,
    MODBUS,
    NATIVE,
    SERIAL,
    TELLING,
    Change,
    Of,
    Row,
    Rows,
    every,
    faults,
    frames,
    having,
    keeping,
    taken,
)
from conformance.drives.mks.core import MOTIONS, MksCore
from conformance.drives.mks.motion import begin_run

#: How long a drive is deaf after motion, and the pause after which it loses a request.
_DEAF_NS, _PAUSE_NS = 3_000_000_000, 20_000_000_000
#: The speed at which a run by function 06h begins anew to count (rpm).
_BY_ONE = 1000


def _checked(drive: Drive, frame: Frame) -> tuple[bytes, bytes]:
    """Return the check of a frame as it is and as it should be."""
    check = drive.dialect.link.checks(frame.data, frame.can.id if frame.can else None)[-1]
    return frame.data[check.start : check.start + len(check.expected)], check.expected


def _take(judge: Callable[[bytes, bytes], bool]) -> Change:
    """Take own frames whose wrong check a judge of the check that is there and the right one lets pass."""

    def accept(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        mine = own(mks(drive), message) and mks(drive).responder.understands(message)
        return wanted or (not frame.checksum_ok and mine and judge(*_checked(drive, frame)))

    return taken(accept)


def _unchecked(of: Of, to_all: bool = False) -> Change:
    """Take some requests with any check, also those to all drives."""
    verbs = {of} if isinstance(of, Verb) else of

    def accept(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        to = drive.dialect.broadcast if to_all else drive.address
        meant = message.command is not None and message.command.verb in verbs and message.address == to
        return wanted or (not frame.checksum_ok and meant and mks(drive).responder.understands(message))

    return taken(accept)


def _run_by_one(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
    """Begin a run by a write of its register by function 06h, and answer as the manual says."""
    core, data = mks(drive), frame.data
    mine = frame.checksum_ok and own(core, message) and data[1] in WRITE_ONE
    if mine and data[2:4] == b"\0\xf6" and core.ready and core.by_bus:
        begin_run(core, 0, int.from_bytes(data[4:6], "big") % _BY_ONE, 0)
    return wanted


def _newest_is(drive: MksCore, to: Whom) -> Callable[[], bool]:
    """Return a question: whether the newest request was sent so."""
    so = False

    def accept(_: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        nonlocal so
        so = to(drive, message)
        return wanted

    drive.hooks.accept.append(accept)
    return lambda: so


def _asked_to(to: Whom, of: Of, change: Callable[[Values], Values]) -> Change:
    """Change some requests that were sent so, and no others."""
    verbs = {of} if isinstance(of, Verb) else of

    def install(drive: MksCore) -> None:
        so = _newest_is(drive, to)
        drive.hooks.request.append(lambda _, command, values: change(values) if so() and command.verb in verbs else values)

    return tuned(install)


def _obey_without_check(receive: Callable[..., list[Outgoing]], drive: MksCore, frame: Frame, t_ns: int) -> list[Outgoing]:
    """Halt at a frame of the code of the emergency stop alone."""
    code = drive.dialect.by_verb[Verb.EMERGENCY_STOP].code
    if frame.data == bytes((code,)) and frame.can is not None and frame.can.id == drive.address:
        frame = replace(frame, data=drive.dialect.link.completed(frame.data, frame.can.id), checksum_ok=True)
    return receive(frame, t_ns)


def _deaf_after_motion(drive: MksCore) -> None:
    """Hear nothing for a while after the shaft has turned."""
    turned_ns: int | None = None

    def accept(_: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        nonlocal turned_ns
        if turns(drive):
            turned_ns = drive.now_ns
            return wanted
        return wanted and (turned_ns is None or drive.now_ns - turned_ns > _DEAF_NS)

    drive.hooks.accept.append(accept)


def _deaf_after_refusal(drive: MksCore) -> None:
    """Ignore what comes behind a refusal."""
    refuse, deaf = drive.refused, False

    def refused(request: Request) -> Values:
        nonlocal deaf
        deaf = True
        return refuse(request)

    def accept(_: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        nonlocal deaf
        was, deaf = deaf, False
        return wanted and not was

    drive.refused = refused  # type: ignore[method-assign]
    drive.hooks.accept.append(accept)


def _deaf_after_exception(drive: MksCore) -> None:
    """Ignore what comes behind an exception, or behind a parameter that cannot be read."""
    deaf = False

    def reply(_: Drive, command: Command, outgoing: Outgoing) -> tuple[Outgoing]:
        nonlocal deaf
        modbus = drive.dialect.name in MODBUS
        deaf = bool(outgoing.data[1] & 0x80) if modbus else outgoing.data[1:-1] == b"\xff\xff"
        return (outgoing,)

    def accept(_: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        nonlocal deaf
        was, deaf = deaf, deaf and not wanted
        return wanted and not was

    drive.hooks.reply.append(reply)
    drive.hooks.accept.append(accept)


def lost_if_sent(to: Whom, only: str = "") -> Change:
    """Lose settings by a restart that were sent so, and keep others. `only`: but one."""

    def change(drive: MksCore) -> None:
        sent = _newest_is(drive, to)

        def store(_: Drive, name: str, value: int) -> tuple[str, int]:
            (drive.forgetful.add if sent() and only in ("", name) else drive.forgetful.discard)(name)
            return name, value

        drive.hooks.stored.append(store)

    return tuned(change)


def _to_group(of: Of, change: Callable[[Values], Values]) -> Change:
    return Change(_asked_to(to_group, of, change).install, having(Verb.SET_GROUP_ADDRESS))


def made_ready_by(to: Whom, of: Of, ready: Callable[[MksCore], object]) -> Callable[[MksCore], None]:
    """Let the drive do what is sent so, even where it would refuse."""
    verbs = {of} if isinstance(of, Verb) else of

    def install(drive: MksCore) -> None:
        so, behave = _newest_is(drive, to), drive.behave

        def obey(request: Request) -> Values | None:
            if so() and request.command.verb in verbs:
                ready(drive)
            return behave(request)

        drive.behave = obey  # type: ignore[method-assign]

    return install


def _unprotect(drive: MksCore) -> None:
    drive.memory.protected = False
    drive.grip()


def _guards(to: Whom) -> Callable[[MksCore], None]:
    """Have no protection while a motion is under way that was sent so."""

    def install(drive: MksCore) -> None:
        so = _newest_is(drive, to)

        def note(_: Drive, command: Command, values: Values) -> Values:
            if command.verb in MOTIONS:
                (drive.heedless.add if so() else drive.heedless.discard)("protection")
            return values

        drive.hooks.request.append(note)

    return install


def answers_enabling_in_slots(drive: MksCore) -> None:
    """Answer what enables the motor in a slot of a package."""
    so, obey = _newest_is(drive, package), drive.obey

    def aloud(request: Request) -> None:
        request.answered |= so() and request.command.verb is Verb.ENABLE
        obey(request)

    drive.obey = aloud  # type: ignore[method-assign]


def _heard_by_group(bit: int) -> Change:
    """Hear another group address that differs in one bit."""

    def near(drive: MksCore, message: Message) -> bool:
        group = drive.settings.get("group_address", 0)
        return bool(group) and message.address == group ^ 1 << bit != drive.address

    return Change(hearing(near).install, having(Verb.SET_GROUP_ADDRESS))


def _deaf_to_all_when_moved(drive: MksCore) -> None:
    """Hear all drives' address only at the address that the drive began with."""
    begun = 0

    def accept(_: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        nonlocal begun
        begun = begun or drive.address
        return wanted and (drive.address == begun or not for_all(drive, message))

    drive.hooks.accept.append(accept)
    drive.hooks.powered.append(lambda _: forget())

    def forget() -> None:
        nonlocal begun
        begun = 0


def _still_heard(name: str, verbs: Collection[Verb] = ()) -> Change:
    """Obey at each address that a setting held before, without an answer: all requests, or those of some commands."""

    def install(hooks: Hooks) -> None:
        held: set[int] = set()

        def store(drive: Drive, setting: str, value: int) -> tuple[str, int]:
            if setting == name:
                held.add(drive.settings[name])
            return setting, value

        def accept(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
            core = mks(drive)
            meant = not verbs or (message.command is not None and message.command.verb in verbs)
            before = message.address in held - {core.settings[name], 0}
            return wanted or (before and meant and frame.checksum_ok and core.responder.understands(message))

        hooks.stored.append(store)
        hooks.accept.append(accept)

    return Change(install, keeping(name))


def _group_unheard(group: int) -> Change:
    """Keep a group's address, and do not hear it."""
    deaf = deaf_to(lambda drive, message: to_group(drive, message) and message.address == group)
    return Change(deaf.install, having(Verb.SET_GROUP_ADDRESS))


def _end_untold_behind(to: Whom) -> Change:
    """Forget during a motion who is to be told its end when a frame is sent so."""

    def accept(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        task = mks(drive).task
        if task is not None and task.request is not None and to(mks(drive), message):
            task.request.answered = False
        return wanted

    return taken(accept)


def _deaf_after_a_pause(drive: MksCore) -> None:
    """Lose the first request after a long pause."""
    last_ns = 0

    def accept(_: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        nonlocal last_ns
        before_ns, last_ns = last_ns, drive.now_ns
        return wanted and drive.now_ns - before_ns <= _PAUSE_NS

    drive.hooks.accept.append(accept)


def _silent_when(when: Callable[[MksCore], bool], of: Of) -> Change:
    """Do not answer some commands in a condition."""

    def change(drive: Drive, command: Command, outgoing: Outgoing) -> tuple[Outgoing, ...]:
        return () if when(mks(drive)) else (outgoing,)

    return frames(change, of)


HEARING: Rows = {
    "deaf": (
        Row("deaf-after-motion", "after a motion nothing is heard for three seconds", tuned(_deaf_after_motion)),
        Row("deaf-to-all-when-moved", "a drive that was given another address does not hear all drives' until a restart",
            tuned(_deaf_to_all_when_moved)),
        Row("end-untold-behind-all", "a broadcast in a motion silences the reply at its end",
            _end_untold_behind(for_all), TELLING),
        Row("end-untold-behind-group", "a frame to the group in a motion silences the reply at its end",
            _end_untold_behind(to_group), TELLING),
        Row("end-untold-behind-other", "a frame to another drive in a motion silences the reply at its end",
            _end_untold_behind(lambda drive, message: message.address not in (drive.address, drive.dialect.broadcast)),
            TELLING),
        Row("highest-group-unheard", "the group FF is stored, and not heard", _group_unheard(0xFF), NATIVE),
        Row("highest-group-id-unheard", "the group 7FF is stored, and not heard", _group_unheard(0x7FF), CAN),
        Row("lowest-group-unheard", "the group 1 is stored, and not heard", _group_unheard(1)),
        Row("deaf-after-refusal", "the request behind a refused one is ignored", tuned(_deaf_after_refusal)),
        Row("deaf-after-exception", "the request behind an exception, or behind FF FF for a parameter, is ignored",
            tuned(_deaf_after_exception), MODBUS + CAN),
        Row("deaf-after-long-pause", "the first request after 20 s of silence is lost", tuned(_deaf_after_a_pause)),
        Row("silent-below-zero", "31 is not answered below -2 turns",
            _silent_when(lambda drive: drive.axis < -2 * drive.counts_per_turn, Verb.READ_POSITION)),
        Row("status-silent-with-respond-0", "with respond 0 F1 is not answered while the shaft turns",
            _silent_when(lambda drive: not drive.settings["respond"] and turns(drive), Verb.READ_STATUS), TELLING),
        Row("silent-disabled", "motion is not answered while the motor is off",
            _silent_when(lambda drive: not drive.enabled, MOTIONS), NATIVE),
        Row("every-150th-lost", "every 150th reply is lost", every(150, lambda d, c, o: ())),
    ),
    "checksum": (
        Row("check-ff-passes", "a checksum of FF passes with any frame", _take(lambda got, right: set(got) == {0xFF})),
        Row("check-0-passes", "a checksum of 0 passes with any frame", _take(lambda got, right: not any(got))),
        Row("check-next-passes", "a checksum that is one too high passes", _take(lambda got, right: got[-1] == right[-1] + 1)),
        Row("crc-first-byte", "only the first byte of the CRC counts", _take(lambda got, right: got[0] == right[0]), MODBUS),
        Row("crc-swapped", "a CRC with its bytes swapped passes too", _take(lambda got, right: got == right[::-1]), MODBUS),
        Row("home-unchecked", "91 is executed with any checksum", _unchecked(Verb.HOME)),
        Row("broadcast-counts-halved", "F4 to all drives goes half as far",
            _asked_to(for_all, Verb.MOVE_RELATIVE_AXIS, lambda values: values | {"position": values["position"] // 2})),
        Row("broadcast-move-at-once", "FE to all drives has no ramp",
            _asked_to(for_all, Verb.MOVE_ABSOLUTE_PULSES, lambda values: values | {"acceleration": 0})),
        Row("broadcast-one-way", "F6 to all drives turns the shaft one way alone",
            _asked_to(for_all, Verb.RUN_SPEED, lambda values: values | {"direction": 0})),
        Row("off-obeys-all", "F4 to all drives is executed by a motor that is off",
            tuned(made_ready_by(for_all, Verb.MOVE_RELATIVE_AXIS, hold))),
        Row("protected-obeys-all", "FE to all drives is executed by a motor that is protected",
            tuned(made_ready_by(for_all, Verb.MOVE_ABSOLUTE_PULSES, _unprotect), having(Verb.RELEASE_PROTECTION))),
        Row("unguarded-by-all", "a motion to all drives is not protected against a locked rotor", tuned(_guards(for_all))),
        Row("subdivision-of-all-answered", "84 to all drives is answered",
            answering(of(for_all, Verb.SET_SUBDIVISION)), SERIAL),
        Row("broadcast-unchecked", "motion to all drives is executed with any checksum", _unchecked(MOTIONS, True)),
        Row("stop-unchecked", "F7 is executed with any checksum", _unchecked(Verb.EMERGENCY_STOP)),
    ),
    "address": (Row("sets-for-next", "settings of the next higher address are stored too",
                    hearing(lambda drive, message: to_next(drive, message) and is_setting(message))),),
    "function": (Row("run-by-06", "a write of F6 by 06h begins a run", taken(_run_by_one), MODBUS),),
    "before": (
        Row("old-address-obeyed", "the address before 8B is obeyed, and not answered", _still_heard("new_address")),
        Row("old-address-moves", "moves to the address before 8B are executed, and not answered",
            _still_heard("new_address", MOTIONS)),
        Row("old-group-obeyed", "the group before 8D is obeyed", _still_heard("group_address")),
        Row("old-group-sets", "92 to the group before 8D is executed", _still_heard("group_address", (Verb.SET_ZERO,))),
    ),
    "group": (
        Row("group-without-ramp", "motion to the group has no ramp",
            _to_group(MOTIONS, lambda values: values | {"acceleration": 0})),
        Row("group-pulses-byte", "FD to the group has the low byte of its pulses",
            _to_group(Verb.MOVE_RELATIVE_PULSES, lambda values: values | {"pulses": values["pulses"] & 0xFF})),
        Row("group-speed-byte", "F4 to the group has the low byte of its speed",
            _to_group(Verb.MOVE_RELATIVE_AXIS, lambda values: values | {"speed": values["speed"] & 0xFF})),
        Row("group-answered-backwards", "FD to the group is answered where it turns the shaft clockwise",
            answering(lambda d, m: of(to_group, Verb.MOVE_RELATIVE_PULSES)(d, m) and backwards(m.values)), TELLING),
        Row("hears-bad-group-bit-7", "a group address whose highest bit in a byte differs is obeyed", _heard_by_group(7)),
        Row("hears-bad-group-bit-4", "a group address that differs by 10h is obeyed", _heard_by_group(4)),
        Row("group-motion-answered", "motion to the group is answered", answering(of(to_group, *MOTIONS)), NATIVE),
    ),
    "length": (Row("emergency-without-check", "F7 is obeyed without its check",
                   overridden("receive", _obey_without_check), CAN),),
}  # fmt: skip

FAULTS = faults(HEARING)
