"""Faults of settings: limits and choices, what is stored where, what a restart and a restore leave, reading back."""

from __future__ import annotations

from collections.abc import Callable

from analyzer.catalogue import Command, Verb
from conformance.drives.drive import Drive, Fault, Values
from conformance.drives.faults.mks_makers import (
    CAN,
    EVERY,
    MODBUS,
    SERIAL,
    TELLING,
    Install,
    accepting,
    allowed,
    answered,
    at_high,
    bodies,
    byte,
    clinging,
    forgetful,
    instead,
    mks,
    refusing,
    several,
    stored,
    stored_as,
    tuned,
    unstored,
)
from conformance.drives.mks.core import MksCore
from conformance.drives.mks.settings import put
from conformance.drives.mks.speaker import Order


def _highest_refused(field: str) -> Install:
    return at_high(field, 0, False)


def _one_more_accepted(field: str) -> Install:
    return at_high(field, 1, True)


def _clipped(field: str) -> Install:
    """Accept values above the limit and store the limit."""

    def clip(drive: Drive, name: str, value: int) -> tuple[str, int]:
        return name, min(value, mks(drive).fields[field].high) if name == field else value

    return several(allowed(field, lambda v: True), lambda hooks: hooks.stored.append(clip))


def _success(drive: MksCore) -> Values:
    return {"status": 1}


def _read_back(change: Callable[[Values], Values]) -> Install:
    def apply(drive: MksCore, command: Command, asked: Values, values: Values) -> Values:
        return values if "unreadable" in values else change(values)

    return answered({Verb.READ_PARAMETER}, apply)


def _of_defaults(drive: MksCore, command: Command, asked: Values, values: Values) -> Values:
    return {name: drive.factory.get(name, value) for name, value in values.items()}


def _unreadable(drive: MksCore, command: Command, asked: Values, values: Values) -> Values:
    return {"unreadable": 0xFFFF} if asked["parameter"] == _SUBDIVISION_CODE else values


def _turned(values: Values) -> Values:
    """Hand the values round among their fields."""
    names, numbers = list(values), list(values.values())
    return dict(zip(names, numbers[1:] + numbers[:1], strict=True))


_SUBDIVISION_CODE = 0x84

FAULTS: tuple[Fault, ...] = (
    # Limits
    Fault("current-highest-refused", EVERY, "83 refuses the highest current", "limit", _highest_refused("current")),
    Fault("current-one-more", EVERY, "83 accepts one mA more than the highest", "limit", _one_more_accepted("current")),
    Fault("current-zero-refused", EVERY, "83 refuses 0 mA", "limit", refusing("current", 0)),
    Fault("current-unlimited", EVERY, "83 accepts any current", "limit", allowed("current", lambda v: True)),
    Fault("current-clipped", EVERY, "83 cuts a current that is too high and says success", "limit", _clipped("current")),
    Fault("home-speed-one-more", EVERY, "90 accepts 3001 rpm", "limit", _one_more_accepted("home_speed")),
    Fault("home-speed-highest-refused", EVERY, "90 refuses 3000 rpm", "limit", _highest_refused("home_speed")),
    Fault("home-current-unlimited", TELLING, "94 (CAN: 93) accepts any current", "limit",
          allowed("home_current", lambda v: True)),
    Fault("zero-speed-5", SERIAL, "9A accepts the speed 5", "limit", accepting("zero_speed", 5)),
    Fault("zero-speed-4-refused", SERIAL, "9A refuses the speed 4", "limit", refusing("zero_speed", 4)),
    Fault("stall-tolerance-one-more", (CAN,), "89 accepts 8000h", "limit", _one_more_accepted("stall_tolerance")),
    Fault("stall-tolerance-highest-refused", (CAN,), "89 refuses 7FFFh", "limit", _highest_refused("stall_tolerance")),
    Fault("address-0-accepted", EVERY, "8B accepts the address of all drives", "limit", accepting("new_address", 0)),
    Fault("address-highest-refused", TELLING, "8B refuses the highest address", "limit", _highest_refused("new_address")),
    Fault("address-248-accepted", (MODBUS,), "8B accepts an address that Modbus reserves", "limit",
          accepting("new_address", 248)),
    Fault("address-beyond-7ff", (CAN,), "8B accepts 800h", "limit", accepting("new_address", 0x800)),
    Fault("group-0-accepted", TELLING, "8D accepts the address of all drives", "limit", accepting("group_address", 0)),
    Fault("lowest-position-accepted", (CAN,), "moves accept -8388608", "limit", accepting("position", -8388608)),
    Fault("acceleration-256-accepted", (MODBUS,), "moves accept an acceleration of 256 and take it for 0", "limit",
          several(accepting("acceleration", 256), lambda hooks: hooks.request.append(
              lambda d, c, v: v | {"acceleration": v["acceleration"] & 0xFF} if "acceleration" in v else v))),
    # Choices
    Fault("work-mode-6-accepted", EVERY, "82 accepts a mode that is not listed", "choice", accepting("work_mode", 6)),
    Fault("close-mode-refused", SERIAL, "82 refuses SR_CLOSE", "choice", refusing("work_mode", 4)),
    Fault("open-mode-refused", (CAN,), "82 refuses the open loop without an encoder", "choice", refusing("work_mode", 0x14)),
    Fault("holding-current-0-refused", SERIAL, "9B refuses 0 (10 %), as the manual's head has it", "choice",
          refusing("holding_current", 0)),
    Fault("holding-current-8-refused", SERIAL, "9B refuses 8 (90 %)", "choice", refusing("holding_current", 8)),
    Fault("holding-current-9-accepted", SERIAL, "9B accepts 9", "choice", accepting("holding_current", 9)),
    Fault("enable-always-refused", EVERY, "85 refuses 2 (always)", "choice", refusing("enable_level", 2)),
    Fault("enable-3-accepted", EVERY, "85 accepts 3", "choice", accepting("enable_level", 3)),
    Fault("baud-256000-refused", SERIAL, "8A refuses 7 (256000)", "choice", refusing("baud_rate", 7)),
    Fault("baud-0-accepted", SERIAL, "8A accepts 0", "choice", accepting("baud_rate", 0)),
    Fault("bit-rate-0-refused", (CAN,), "8A refuses 0 (125 kbit/s)", "choice", refusing("bit_rate", 0)),
    Fault("bit-rate-4-accepted", (CAN,), "8A accepts 4", "choice", accepting("bit_rate", 4)),
    Fault("subdivision-256-refused", EVERY, "84 refuses 256 (0 on serial lines and CAN)", "choice",
          refusing("subdivision", 0, 256)),
    Fault("subdivision-3-accepted", (CAN,), "84 accepts a subdivision that is not listed", "choice",
          accepting("subdivision", 3)),
    Fault("subdivision-25-refused", (CAN,), "84 refuses 25", "choice", refusing("subdivision", 25)),
    Fault("subdivision-257-accepted", (MODBUS,), "84 accepts 257", "choice", accepting("subdivision", 257)),
    Fault("home-direction-2-accepted", EVERY, "90 accepts a third direction", "choice", accepting("home_direction", 2)),
    Fault("respond-2-accepted", TELLING, "8C accepts 2", "choice", accepting("respond", 2)),
    Fault("save-any-state", EVERY, "FF accepts any state", "choice", allowed("save_state", lambda v: True)),
    Fault("pulse-delay-3-refused", (CAN,), "87 refuses 3 (40 ms)", "choice", refusing("pulse_delay", 3)),
    # Storing
    Fault("subdivision-not-stored", EVERY, "84 says success and changes nothing", "stored", unstored("subdivision")),
    Fault("work-mode-not-stored", EVERY, "82 says success and changes nothing", "stored", unstored("work_mode")),
    Fault("home-speed-not-stored", EVERY, "90 says success and keeps the old speed", "stored", unstored("home_speed")),
    Fault("home-direction-not-stored", EVERY, "90 says success and keeps the old direction", "stored",
          unstored("home_direction")),
    Fault("address-not-stored", EVERY, "8B says success and keeps the old address", "stored", unstored("new_address")),
    Fault("group-not-stored", TELLING, "8D says success and joins no group", "stored", unstored("group_address")),
    Fault("current-not-stored", (CAN,), "83 says success and keeps the old current", "stored", unstored("current")),
    Fault("user-id-not-stored", (CAN,), "42 says success and keeps the old number", "stored", unstored("user_id")),
    Fault("saved-run-not-stored", EVERY, "FF says success and keeps nothing for power-on", "stored",
          unstored("saved_run", "saved_speed")),
    Fault("respond-stored-as-active", TELLING, "8C stores respond as active", "stored", stored_as("respond", "active")),
    Fault("group-stored-as-address", TELLING, "8D stores the group as the drive's own address", "stored",
          several(stored_as("group_address", "new_address"), tuned(lambda drive: _retuned(drive, Verb.SET_GROUP_ADDRESS)))),
    Fault("current-stored-as-home-current", (CAN,), "83 stores the home current", "stored",
          stored_as("current", "home_current")),
    Fault("home-speed-low-byte", EVERY, "90 stores only the low byte of the speed", "width",
          stored(lambda n, v: (n, v & 0xFF) if n == "home_speed" else (n, v))),
    Fault("current-bytes-swapped", (CAN,), "83 stores the current low byte first", "byte order",
          stored(lambda n, v: (n, (v & 0xFF) << 8 | v >> 8) if n == "current" else (n, v))),
    Fault("stored-before-judged", EVERY, "a setting that is refused is stored all the same", "stored",
          lambda hooks: hooks.allow.append(_stores_first)),
    # Restart and restore
    Fault("work-mode-lost", EVERY, "a restart puts the work mode back to its default", "restart", forgetful("work_mode")),
    Fault("subdivision-lost", EVERY, "a restart puts the subdivision back to 16", "restart", forgetful("subdivision")),
    Fault("home-speed-lost", EVERY, "a restart forgets the home settings", "restart",
          forgetful("home_speed", "home_direction")),
    Fault("group-lost", TELLING, "a restart forgets the group", "restart", forgetful("group_address")),
    Fault("respond-lost", TELLING, "a restart forgets respond and active", "restart", forgetful("respond", "active")),
    Fault("address-lost", EVERY, "a restart puts the address back to 1", "restart", forgetful("new_address")),
    Fault("current-lost", (CAN,), "a restart puts the current back to its default", "restart", forgetful("current")),
    Fault("user-id-lost", (CAN,), "a restart forgets the user's number", "restart", forgetful("user_id")),
    Fault("saved-run-lost", EVERY, "a restart forgets the run kept for power-on", "restart", forgetful("saved_run")),
    Fault("work-mode-kept", EVERY, "a restore leaves the work mode", "restore", clinging("work_mode")),
    Fault("subdivision-kept", EVERY, "a restore leaves the subdivision", "restore", clinging("subdivision")),
    Fault("address-kept", EVERY, "a restore leaves the address", "restore", clinging("new_address")),
    Fault("current-kept", (CAN,), "a restore leaves the current", "restore", clinging("current")),
    Fault("dialect-kept", (MODBUS,), "a restore leaves Modbus on", "restore", clinging("modbus")),
    Fault("restart-lies", EVERY, "41 says success and restarts nothing", "restart",
          instead({Verb.RESTART}, lambda drive, order: _success(drive))),
    Fault("restore-lies", EVERY, "3F says success and restores nothing", "restore",
          instead({Verb.RESTORE}, lambda drive, order: _success(drive))),
    Fault("restart-unanswered", EVERY, "41 restarts without a reply", "restart",
          answered({Verb.RESTART}, lambda d, c, a, v: None)),
    # Reading back
    Fault("parameter-bytes-shifted", (CAN,), "a parameter read mixes the fields up", "read-back", _read_back(_turned)),
    Fault("parameter-off-by-one", (CAN,), "a parameter read is one too high in its first field", "read-back",
          _read_back(lambda values: values | {n: v + 1 for n, v in list(values.items())[:1]})),
    Fault("parameter-defaults", (CAN,), "a parameter read answers with the defaults", "read-back",
          answered({Verb.READ_PARAMETER}, _of_defaults)),
    Fault("parameter-under-code-0", (CAN,), "a parameter read is answered under the code 00", "code",
          bodies(byte(0, lambda _: 0), {Verb.READ_PARAMETER})),
    Fault("subdivision-unreadable", (CAN,), "84 cannot be read back", "read-back",
          answered({Verb.READ_PARAMETER}, _unreadable)),
    Fault("unreadable-as-zero", (CAN,), "a code that cannot be read is answered 00 00", "read-back",
          bodies(lambda b: b.replace(b"\xff\xff", b"\0\0"), {Verb.READ_PARAMETER})),
    Fault("unreadable-unanswered", (CAN,), "a code that cannot be read is not answered", "lost",
          answered({Verb.READ_PARAMETER}, lambda d, c, a, v: None if "unreadable" in v else v)),
    Fault("parameter-little-endian", (CAN,), "a parameter read sends its bytes in reverse", "byte order",
          bodies(lambda b: b[:1] + b[:0:-1], {Verb.READ_PARAMETER})),
)  # fmt: skip


def _retuned(drive: MksCore, verb: Verb) -> None:
    """Let a setting change what the drive listens to."""
    before = drive.behaviours[verb]

    def act(drive: MksCore, order: Order) -> Values | None:
        answer = before(drive, order)
        drive.tune()
        return answer

    drive.behaviours[verb] = act


def _stores_first(drive: Drive, command: Command, values: Values, wanted: bool) -> bool:
    if not wanted and command.verb is Verb.SET_HOME:
        for name, value in values.items():
            if mks(drive).fields[name].allows(value):
                put(mks(drive), name, value)
    return wanted
