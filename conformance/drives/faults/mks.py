"""Faults of the MKS drives: defects in what they hear, store, do and tell.

Rules kept here:
- A fault changes what can be seen on the bus in each dialect that it names, and nothing that the manual leaves open.
- A command is named by its native code, as in "83 refuses 0 mA". Modbus has the same numbers as registers.
"""

from __future__ import annotations

from fractions import Fraction

from analyzer.catalogue import Verb
from analyzer.link import READS, WRITE_MANY, WRITE_ONE
from conformance.drives.faults import mks_behaviour as mks
from conformance.drives.faults import mks_frames
from conformance.drives.faults.mks_behaviour import (
    MOVES,
    afterwards,
    before,
    clinging,
    completing,
    forgetful,
    half_way,
    heedless,
    homing_by,
    instead,
    landing,
    lying,
    read_back,
    tuned,
    unless,
    unsaid,
    when_home,
    with_law,
    with_state,
    wrapped,
)
from conformance.drives.faults.mks_frames import (
    answering,
    deaf_to,
    done,
    hearing,
    not_done,
    of_functions,
    silent_to,
    slots,
    translated,
)
from conformance.drives.faults.numbers import accepts, always, exchanged, negated, renamed
from conformance.drives.faults.places import (
    CAN,
    MODBUS,
    NATIVE,
    SERIAL,
    TELLING,
    Change,
    Row,
    Rows,
    asked,
    bodies,
    byte,
    faults,
    frames,
    having,
    limit,
    reply,
    request,
    result,
    stored_as,
    taken,
    together,
    unstored,
)
from conformance.drives.mks.core import MOTIONS, STOPS, Activity
from conformance.drives.mks.paths import ramp_step_ns
from conformance.drives.mks.settings import SETTINGS

WRITES = WRITE_ONE | WRITE_MANY
REQUESTS = READS | WRITES
MEASURES = (Verb.READ_ENCODER_CARRY, Verb.READ_POSITION, Verb.READ_SPEED, Verb.READ_PULSES, Verb.READ_ANGLE_ERROR)
#: Commands by their native codes.
F1, F4, F5 = Verb.READ_STATUS, Verb.MOVE_RELATIVE_AXIS, Verb.MOVE_ABSOLUTE_AXIS
F6, FD, FE = Verb.RUN_SPEED, Verb.MOVE_RELATIVE_PULSES, Verb.MOVE_ABSOLUTE_PULSES
CARRY = Verb.READ_ENCODER_CARRY
PARAMETER = Verb.READ_PARAMETER

# --- what it hears and answers ---------------------------------------------------------------------------------------

HEARING: Rows = {
    "checksum": (
        Row("hears-bad-checksum", "frames with a wrong checksum are executed and answered",
            taken(mks_frames.take_bad_checksum)),
        Row("executes-bad-checksum", "frames with a wrong checksum are executed and not answered",
            together(taken(mks_frames.take_bad_checksum), silent_to(lambda d, m: not m.frame.checksum_ok))),
        Row("executes-bad-motion", "motion with a wrong checksum is executed and not answered",
            together(taken(mks_frames.take_bad_motion), silent_to(lambda d, m: not m.frame.checksum_ok))),
        Row("deaf-after-bad-frame", "after a frame with a wrong checksum the next good one is not heard",
            Change(mks_frames.startle)),
    ),
    "head": (
        Row("hears-reply-head", "frames with the head of a reply are taken for requests",
            taken(mks_frames.take_reply_head), NATIVE),
    ),
    "unknown": (
        Row("answers-unknown-code", "unknown codes are answered with status 0", taken(mks_frames.answer_unknown), TELLING),
    ),
    "address": (
        Row("answers-another-address", "requests to any address are executed and answered",
            together(hearing(lambda d, m: True), answering(mks_frames.to_one))),
        Row("executes-another-address", "requests to any address are executed, without an answer", hearing(lambda d, m: True)),
        Row("executes-motion-of-another", "motion to any address is executed, and not answered",
            hearing(mks_frames.motion_of_another), CAN),
        Row("answers-next-address", "requests to the next higher address are answered too",
            together(hearing(mks_frames.to_next), answering(mks_frames.to_next))),
        Row("address-low-byte-only", "only the low byte of an ID is looked at",
            together(hearing(mks_frames.same_low_byte), answering(mks_frames.same_low_byte)), CAN),
    ),
    "broadcast": (
        Row("answers-broadcast", "broadcasts are answered", answering(mks_frames.to_all)),
        Row("answers-broadcast-reads", "reads by broadcast are answered", answering(mks_frames.read_of_all)),
        Row("broadcast-stops-ignored", "a stop by broadcast is not executed", deaf_to(mks_frames.stop_of_all)),
        Row("ignores-broadcast", "broadcasts are not executed", deaf_to(mks_frames.to_all)),
        Row("broadcast-run-not-kept", "FF by broadcast is not executed",
            deaf_to(mks_frames.of(mks_frames.to_all, Verb.SAVE_SPEED))),
        Row("broadcast-mode-ignored", "82 by broadcast is not executed",
            deaf_to(mks_frames.of(mks_frames.to_all, Verb.SET_WORK_MODE))),
        Row("broadcast-address-ignored", "8B by broadcast is not executed",
            deaf_to(mks_frames.of(mks_frames.to_all, Verb.SET_ADDRESS))),
        Row("broadcast-speed-ignored", "8A by broadcast is not executed",
            deaf_to(mks_frames.of(mks_frames.to_all, Verb.SET_BAUD_RATE, Verb.SET_BIT_RATE))),
        Row("broadcast-group-ignored", "8D by broadcast is not executed",
            deaf_to(mks_frames.of(mks_frames.to_all, Verb.SET_GROUP_ADDRESS)), having(Verb.SET_GROUP_ADDRESS)),
        Row("broadcast-zero-ignored", "9A by broadcast is not executed",
            deaf_to(mks_frames.of(mks_frames.to_all, Verb.SET_ZERO_MODE)), having(Verb.SET_ZERO_MODE)),
    ),
    "group": (
        Row("answers-group", "requests to the group address are answered", answering(mks_frames.to_group), TELLING),
        Row("ignores-group-stops", "stops to the group address are not executed",
            deaf_to(lambda d, m: mks_frames.to_group(d, m) and mks_frames.stops(m)), TELLING),
        Row("group-address-ignored", "8B to the group address is not executed",
            deaf_to(mks_frames.of(mks_frames.to_group, Verb.SET_ADDRESS)), having(Verb.SET_GROUP_ADDRESS)),
        Row("group-restart-ignored", "41 to the group address is not executed",
            deaf_to(mks_frames.of(mks_frames.to_group, Verb.RESTART)), TELLING),
        Row("group-ports-ignored", "36 to the group address is not executed",
            deaf_to(mks_frames.of(mks_frames.to_group, Verb.WRITE_IO)), CAN),
        Row("group-homing-ignored", "90 to the group address is not executed",
            deaf_to(mks_frames.of(mks_frames.to_group, Verb.SET_HOME)), NATIVE),
        Row("ignores-group", "requests to the group address are not executed", deaf_to(mks_frames.to_group), TELLING),
        Row("group-replaces-address", "a drive in a group no longer hears its own address",
            deaf_to(mks_frames.grouped), TELLING),
    ),
    "package": (
        Row("package-answered", "packages are answered", answering(mks_frames.package), NATIVE),
        Row("package-ignored", "packages are not executed", deaf_to(mks_frames.package), NATIVE),
        Row("package-any-length", "packages shorter than 52 bytes are executed", taken(mks_frames.take_short_package), NATIVE),
        Row("package-any-checksum", "packages are executed with any checksum", taken(mks_frames.take_bad_package), NATIVE),
        Row("package-both-slots", "all slots for an address are executed",
            slots(lambda own, all_, w: mks_frames.mine(own, all_))),
        Row("package-last-slot", "of two slots for an address the last is executed",
            slots(lambda own, all_, w: mks_frames.mine(own, all_)[-1:])),
        Row("package-compares-with-first", "all slots for an address are executed that is not that of the first slot",
            slots(lambda own, all_, w: mks_frames.mine(own, all_[:1]) or mks_frames.mine(own, all_))),
        Row("package-compares-neighbours", "a slot is executed if the one before it is for another drive",
            slots(mks_frames.behind_others)),
        Row("package-next-slot", "the slot behind the own one is executed", slots(mks_frames.behind_mine)),
        Row("package-first-slot-only", "only the first slot is looked at",
            slots(lambda own, all_, w: mks_frames.mine(own, all_[:1]))),
        Row("package-of-three-commands", "commands behind three others in a package are not executed",
            slots(lambda own, all_, w: [s for s in w if s in all_[:3]])),
        Row("package-every-slot", "the slots of all addresses are executed", slots(lambda own, all_, w: all_)),
        Row("package-without-stops", "a stop of a run at a speed, or of a move, is not executed in a package",
            slots(lambda own, all_, w: [s for s in w if s.command is None or s.command.verb not in STOPS])),
        Row("package-without-emergency-stop", "F7 is not executed in a package", mks_frames.without(Verb.EMERGENCY_STOP)),
        Row("package-without-address", "8B is not executed in a package", mks_frames.without(Verb.SET_ADDRESS)),
        Row("package-without-homing", "91 is not executed in a package", mks_frames.without(Verb.HOME)),
        Row("package-without-run-kept", "FF is not executed in a package", mks_frames.without(Verb.SAVE_SPEED)),
        Row("package-motion-only", "a slot that is no motion is not executed",
            slots(lambda own, all_, w: [s for s in w if s.command is not None and s.command.motion is not None])),
        Row("package-broadcast-slot", "a slot for address 0 is executed",
            slots(lambda own, all_, w: w or mks_frames.mine(0, all_)[:1])),
    ),
    "exception": (
        Row("modbus-no-exceptions", "what calls for an exception is not answered",
            silent_to(lambda d, m: d.responder.exception(m) is not None), MODBUS),
    ),
}  # fmt: skip

# --- what replies say ------------------------------------------------------------------------------------------------

REPLIES: Rows = {
    "code": (
        Row("speed-reply-code-31", "32 is answered under the code 31, as a table of the manual has it",
            bodies(lambda b: b.replace(b"\x32", b"\x31", 1), Verb.READ_SPEED), TELLING),
        Row("parameter-under-code-0", "a parameter read is answered under the code 00",
            bodies(byte(0, lambda _: 0), PARAMETER)),
    ),
    "length": (
        Row("status-of-two-bytes", "the answer to a setting has a status of two bytes",
            bodies(lambda b: b[:-1] + b"\0" + b[-1:], SETTINGS), TELLING),
    ),
    "sign": (Row("carry-cut-to-zero", "30 cuts negative positions towards zero", result(mks.carry_to_zero, CARRY)),),
    "width": (
        Row("carry-too-late", "30 carries only every second turn", result(mks.carry_late, CARRY)),
        Row("pulses-of-16-bits", "33 is not as wide as its field when pulses are read: 16 bits",
            result(mks.short_count, Verb.READ_PULSES)),
    ),
    "range": (
        Row("speed-read-up-to-2000", "32 says at most 2000 rpm, either way",
            reply("speed", lambda value, field: min(max(value, -2000), 2000), Verb.READ_SPEED)),
    ),
    "boundary": (Row("carry-a-count-late", "30 says 4000h before the carry counts", result(mks.carry_a_count_late, CARRY)),),
    "byte order": (
        Row("carry-before-value", "30 sends the value before the carry", bodies(lambda b: b[:-6] + b[-2:] + b[-6:-2], CARRY)),
        Row("parameter-little-endian", "a parameter read sends its bytes in reverse",
            bodies(lambda b: b[:1] + b[:0:-1], PARAMETER)),
    ),
    "status": (
        Row("status-inverted", "settings answer 0 for success and 1 for failure", reply("status", exchanged(0, 1), SETTINGS)),
        Row("refusal-says-success", "a refused setting answers as if it had been done", reply("status", always(1), SETTINGS)),
        Row("status-up-and-down-swapped", "F1 mixes up speeding up and slowing down", reply("status", exchanged(2, 3), F1)),
        Row("calibrating-as-homing", "F1 says 5 while calibrating, as the manual's list has it",
            reply("status", renamed(6, 5), F1)),
        Row("homing-as-running", "F1 says full speed while homing", reply("status", renamed(5, 4), F1)),
        Row("status-slow-is-stopped", "F1 says below 30 rpm that the motor stands", result(mks.slow_as_stopped, F1)),
        Row("status-silent-is-stopped", "with respond 0 F1 says that the motor stands",
            result(mks.silent_as_stopped, F1), TELLING),
        Row("in-position-inverted", "34 says 0 in place", reply("pend", exchanged(0, 1), Verb.READ_IO), CAN),
        Row("in-position-always", "34 always says that the shaft is in place", reply("pend", always(1), Verb.READ_IO), CAN),
        Row("switch-not-shown", "34 shows no left switch", reply(("in_1", "in_2"), always(1), Verb.READ_IO), CAN),
        Row("alarm-inverted", "34 is read with ALM at 0, at rest too", reply("alm", exchanged(0, 1), Verb.READ_IO), CAN),
        Row("hardware-of-another", "40 names a drive of another size", reply("hardware", always(6), Verb.READ_VERSION), CAN),
        Row("series-of-another", "40 names the D series", reply("series", always(0), Verb.READ_VERSION), CAN),
        Row("enabled-by-pin", "3A goes by the level of En in a bus mode", result(mks.by_pin, Verb.READ_ENABLED), CAN),
        Row("status-outside-list", "F1 says 7 for a motor that stands", reply("status", renamed(1, 7), F1)),
        Row("enabled-inverted", "3A says enabled for disabled", reply("enabled", exchanged(0, 1), Verb.READ_ENABLED)),
        Row("protection-inverted", "3E says protected for not protected",
            reply("status", exchanged(0, 1), Verb.READ_PROTECTION)),
        Row("setting-status-2", "settings answer 2 for success", reply("status", renamed(1, 2), SETTINGS), TELLING),
        Row("run-status-2", "a run at a speed is answered 2", reply("status", renamed(1, 2), F6), TELLING),
    ),
    "frozen": (
        Row("status-frozen", "F1 always says that the motor stands", reply("status", always(1), F1)),
        Row("status-stale", "F1 says what it said the time before", mks.stale(F1)),
        Row("position-frozen-while-free", "31 stays while the motor is disabled", mks.while_enabled(Verb.READ_POSITION)),
        Row("speed-frozen", "32 always says 0", reply("speed", always(0), Verb.READ_SPEED)),
        Row("position-frozen", "31 always says 0", reply("position", always(0), Verb.READ_POSITION)),
        Row("io-in-1-frozen", "a read of the ports always says that IN_1 is high",
            reply("in_1", always(1), Verb.READ_IO), SERIAL),
        Row("pulses-frozen", "33 always says 0", reply("pulses", always(0), Verb.READ_PULSES)),
        Row("enabled-frozen", "3A always says enabled", reply("enabled", always(1), Verb.READ_ENABLED)),
        Row("protection-hidden", "3E never says protected", reply("status", always(0), Verb.READ_PROTECTION)),
        Row("zero-status-frozen", "3B always says success", reply("status", always(1), Verb.READ_ZERO_STATUS)),
    ),
    "reserved": (Row("reserved-bits-set", "34 sets its reserved bits", bodies(byte(-1, lambda v: v | 0xF0), Verb.READ_IO)),),
    "lost": (
        Row("unanswered-reads", "reads of measured numbers are not answered while the motor turns",
            unless(lambda d, c: bool(d.motor.speed(d.now_ns)), MEASURES)),
        Row("unreadable-unanswered", "a code that cannot be read is not answered",
            result(lambda drive, command, asked, values: None if "unreadable" in values else values, PARAMETER)),
    ),
    "read-back": (
        Row("parameter-bytes-shifted", "a parameter read mixes the fields up", read_back(mks.shifted)),
        Row("parameter-off-by-one", "a parameter read is one too high in its first field", read_back(mks.first_one_up)),
        Row("parameter-defaults", "a parameter read answers with the defaults", read_back(mks.defaults)),
        Row("subdivision-25-read-as-24", "84 reads 25 subdivisions as 24", read_back(mks.near_subdivision), CAN),
        Row("subdivision-unreadable", "84 cannot be read back", read_back(mks.no_subdivision)),
        Row("unreadable-as-zero", "a code that cannot be read is answered 00 00",
            bodies(lambda b: b.replace(b"\xff\xff", b"\0\0"), PARAMETER)),
    ),
}  # fmt: skip

# --- what it stores --------------------------------------------------------------------------------------------------

SETTING: Rows = {
    "stored": (
        Row("subdivision-250-accepted", "84 accepts 250", limit("subdivision", accepts(250)), CAN),
        Row("subdivision-any-odd", "84 accepts 7 and 99", limit("subdivision", accepts(7, 99)), CAN),
        Row("ports-written-together", "each write of ALM by 36 is one of the port PEND too",
            before(Verb.WRITE_IO, mks.both_ports)),
        Row("ports-not-given-back", "a write by 36 with mask 0 gives no port back", before(Verb.WRITE_IO, mks.keep_ports)),
        Row("subdivision-not-stored", "84 says success and changes nothing", unstored("subdivision")),
        Row("work-mode-not-stored", "82 says success and changes nothing", unstored("work_mode")),
        Row("home-speed-not-stored", "90 says success and keeps the old speed", unstored("home_speed")),
        Row("home-direction-not-stored", "90 says success and keeps the old direction", unstored("home_direction")),
        Row("address-not-stored", "8B says success and keeps the old address", unstored("new_address")),
        Row("group-not-stored", "8D says success and joins no group", unstored("group_address")),
        Row("user-id-not-stored", "42 says success and keeps the old number", unstored("user_id")),
        Row("saved-run-not-stored", "FF says success and keeps nothing for power-on", unstored("saved_run", "saved_speed")),
        Row("respond-stored-as-active", "8C stores respond as active", stored_as("respond", "active")),
        Row("group-stored-as-address", "8D stores the group as the drive's own address",
            together(stored_as("group_address", "new_address"), mks.retuned(Verb.SET_GROUP_ADDRESS))),
        Row("stored-before-judged", "a setting that is refused is stored all the same",
            Change(lambda hooks: hooks.allow.append(mks.store_refused))),
        Row("settings-refused", "every setting is refused", Change(lambda hooks: hooks.allow.append(mks.refuse_settings))),
        Row("clean-ignored", "FF CA leaves the run kept for power-on", before(Verb.SAVE_SPEED, mks.ignore_clean)),
        Row("current-not-stored", "83 says success and keeps the old current", unstored("current"), CAN),
        Row("current-stored-as-home-current", "83 stores the home current", stored_as("current", "home_current"), CAN),
    ),
    "restart": (
        Row("work-mode-lost", "a restart puts the work mode back to its default", forgetful("work_mode")),
        Row("subdivision-lost", "a restart puts the subdivision back to 16", forgetful("subdivision")),
        Row("home-speed-lost", "a restart forgets the home settings", forgetful("home_speed", "home_direction")),
        Row("group-lost", "a restart forgets the group", forgetful("group_address")),
        Row("respond-lost", "a restart forgets respond and active", forgetful("respond", "active")),
        Row("address-lost", "a restart puts the address back to 1", forgetful("new_address")),
        Row("user-id-lost", "a restart forgets the user's number", forgetful("user_id")),
        Row("saved-run-lost", "a restart forgets the run kept for power-on", forgetful("saved_run")),
        Row("restart-lies", "41 says success and restarts nothing", lying(Verb.RESTART)),
        Row("restart-unanswered", "41 restarts without a reply", unless(lambda d, c: True, Verb.RESTART)),
        Row("current-lost", "a restart puts the current back to its default", forgetful("current"), CAN),
    ),
    "restore": (
        Row("work-mode-kept", "a restore leaves the work mode", clinging("work_mode")),
        Row("subdivision-kept", "a restore leaves the subdivision", clinging("subdivision")),
        Row("address-kept", "a restore leaves the address", clinging("new_address")),
        Row("restore-lies", "3F says success and restores nothing", lying(Verb.RESTORE)),
        Row("restore-without-restart", "3F restores and does not start again", instead(Verb.RESTORE, mks.restore_running)),
        Row("current-kept", "a restore leaves the current", clinging("current"), CAN),
        Row("group-id-kept", "a restore leaves the group ID", clinging("group_address"), CAN),
        Row("dialect-kept", "a restore leaves Modbus on", clinging("modbus"), MODBUS),
    ),
}  # fmt: skip

# --- how it moves ----------------------------------------------------------------------------------------------------

MOTION: Rows = {
    "ramp": (
        Row("ramp-too-fast", "ramps take half their time", with_law("ramp", lambda a: ramp_step_ns(a) // 2)),
        Row("ramp-too-slow", "ramps take twice their time", with_law("ramp", lambda a: 2 * ramp_step_ns(a))),
        Row("ramp-off-by-one", "one rpm takes (255 - acc) x 50 us", with_law("ramp", lambda a: (255 - a) * 50_000 if a else 0)),
        Row("ramp-turned-round", "the larger the acceleration, the slower the ramp", with_law("ramp", lambda a: a * 50_000)),
        Row("acceleration-0-by-formula", "acceleration 0 is the slowest ramp", with_law("ramp", lambda a: (256 - a) * 50_000)),
        Row("no-ramp", "speeds change at once, at any acceleration", with_law("ramp", lambda a: 0)),
        Row("overshoot", "moves go 1000 counts beyond their target and come back", landing(1000, 0)),
    ),
    "direction": (
        Row("run-direction-wrong", "F6 turns the other way", asked("direction", exchanged(0, 1), F6)),
        Row("run-direction-ignored", "F6 always turns counter-clockwise", asked("direction", always(0), F6)),
        Row("relative-pulses-direction-wrong", "FD moves the other way", asked("direction", exchanged(0, 1), FD)),
        Row("absolute-pulses-direction-wrong", "FE moves to the other side of zero", asked("position", negated, FE)),
        Row("relative-axis-direction-wrong", "F4 moves the other way", asked("position", negated, F4)),
        Row("absolute-axis-direction-wrong", "F5 moves to the other side of zero", asked("position", negated, F5)),
        Row("saved-direction-lost", "the run kept for power-on turns counter-clockwise always", unstored("saved_direction")),
        Row("direction-setting-ignored", "86 does not turn motion by the bus", unstored("motor_direction"), CAN),
        Row("direction-setting-of-runs", "86 turns runs and no moves", wrapped(MOVES, mks.without_sense), CAN),
        Row("direction-setting-turns-bus", "86 turns motion by the bus", tuned(mks.turn_bus_motion), SERIAL),
        Row("zero-direction-ignored", "the way back at power-on is always clockwise", unstored("zero_direction")),
    ),
    "target": (
        Row("relative-as-absolute", "F4 moves to the position instead of by it", wrapped(F4, mks.as_command(F5))),
        Row("absolute-as-relative", "F5 moves by the position instead of to it", wrapped(F5, mks.as_command(F4))),
        Row("move-of-25-as-20", "with 25 set for the subdivision pulses of FD go as far as at 20, and at others as they should",
            request(mks.coarse, FD)),
        Row("relative-axis-short-up", "F4 by a positive number ends a count short",
            asked("position", lambda value, field: value - (value > 0), F4)),
        Row("relative-axis-short-down", "F4 by a negative number ends a count short",
            asked("position", lambda value, field: value + (value < 0), F4)),
        Row("moves-end-a-count-short", "moves end a count before their target", landing(-1)),
        Row("move-ends-short", "moves end 200 counts before their target", landing(-200)),
        Row("fast-move-ends-beyond", "moves above 1500 rpm end 60 counts beyond their target", mks.landing_above(1500, 60)),
        Row("move-ends-beyond", "moves end 200 counts beyond their target", landing(200)),
    ),
    "scale": (
        Row("absolute-pulses-as-counts", "FE takes pulses for encoder counts", wrapped(FE, mks.as_command(F5))),
        Row("axis-as-pulses", "F5 takes encoder counts for pulses", wrapped(F5, mks.as_command(FE))),
        Row("speed-ignores-subdivision", "the speed as sent is the real one at every subdivision",
            with_law("real_speed", lambda speed: speed)),
        Row("move-speed-ignores-subdivision", "moves turn at the speed as sent", mks.by_laws(MOVES, real_speed=mks.as_given)),
        Row("speed-scaled-at-32", "at 32 and 64 subdivisions too the speed is reckoned from 16",
            tuned(lambda d: setattr(d, "real_speed", lambda speed: Fraction(speed * 16, d.subdivision)))),
    ),
    "limit": (
        Row("mode-limit-ignored", "every work mode turns up to 3000 rpm",
            with_law("highest_speed", lambda declared: declared), SERIAL),
        Row("mode-limit-ignored-by-moves", "every work mode moves at up to 3000 rpm",
            mks.by_laws(MOVES, highest_speed=mks.as_given), SERIAL),
        Row("speed-unlimited", "speeds above 3000 are run", with_law("highest_speed", lambda declared: 0xFFFF)),
        Row("speed-above-3000-refused", "speeds above 3000 are refused", before(MOTIONS, mks.refuse_above(3000))),
        Row("speed-3000-refused", "3000 rpm is refused", before(MOTIONS, mks.refuse_above(2999))),
        Row("end-limit-ignored", "the end limit stops nothing", heedless("end_limit")),
        Row("limit-remap-ignored", "9E remaps nothing", unstored("limit_remap")),
    ),
    "update": (
        Row("update-ignored", "F5 on the way goes on to the old target", before(F5, mks.keep_going)),
        Row("update-stops-first", "F5 on the way stops the shaft before it goes on", before(F5, mks.stop_first)),
        Row("newer-move-ignored", "moves are ignored while one is under way", before(MOVES, mks.keep_going)),
    ),
    "stop": (
        Row("stop-without-ramp", "stops are at once, at any acceleration", asked("acceleration", always(0), STOPS)),
        Row("stop-by-slowest-ramp", "stops go by the slowest ramp, also those at once",
            asked("acceleration", always(1), STOPS)),
        Row("open-mode-stops-ignored", "stops in SR_OPEN stop nothing",
            before(STOPS | {Verb.EMERGENCY_STOP}, mks.ignore_in("sr_open")), SERIAL),
        Row("stop-coasts", "a stop begins two seconds late", wrapped(STOPS, mks.coasting)),
        Row("speed-stop-ignored", "F6 with speed 0 stops nothing", lying(Verb.STOP_SPEED)),
        Row("move-stop-ignored", "stops of moves stop nothing", lying(STOPS - {Verb.STOP_SPEED})),
        Row("emergency-stop-ignored", "F7 stops nothing", lying(Verb.EMERGENCY_STOP)),
        Row("emergency-stop-of-runs", "F7 ends no relative move by pulses", before(Verb.EMERGENCY_STOP, mks.only_runs)),
        Row("emergency-stop-ramps", "F7 stops by a ramp", instead(Verb.EMERGENCY_STOP, mks.emergency_ramp)),
    ),
    "enable": (
        Row("disable-ignored", "F3 00 disables nothing", lying(Verb.ENABLE)),
        Row("disabled-moves", "a disabled motor moves when told", with_state(MOTIONS, enabled=True)),
    ),
    "protection": (
        Row("protected-moves", "a protected motor moves when told", with_state(MOTIONS, protected=False)),
        Row("protection-ignored", "a locked rotor is never let go", heedless("protection")),
        Row("release-ignored", "3D ends no protection", lying(Verb.RELEASE_PROTECTION)),
        Row("stall-tolerance-ignored", "the stall tolerance is 180 degrees always", unstored("stall_tolerance")),
    ),
    "mode": (
        Row("pulse-mode-moves", "motion commands work in pulse modes", heedless("work_mode")),
        Row("open-loop-refuses-moves", "moves are refused in the open loop modes", before(MOVES, mks.refuse_in_open_loop)),
    ),
    "zero": (
        Row("set-zero-ignored", "92 sets no zero", lying(Verb.SET_ZERO)),
        Row("set-zero-pulses-only", "92 sets the zero of the pulses alone", instead(Verb.SET_ZERO, mks.zero_pulses)),
        Row("zero-mode-ignored", "9A brings nothing back at power-on", unstored("zero_mode")),
    ),
    "homing": (
        Row("home-lies", "91 says that home was found and turns nothing", instead(Verb.HOME, mks.home_at_once)),
        Row("home-sets-no-zero", "home is found and not made zero", when_home(mks.lose_zero)),
        Row("home-wrong-way", "homing goes the other way", homing_by(lambda s: {"home_direction": 1 - s["home_direction"]})),
        Row("home-speed-ignored", "homing turns at 30 rpm always", homing_by(lambda s: {"home_speed": 30})),
        Row("home-speed-as-sent", "homing turns at home_speed at every subdivision",
            mks.by_laws(Verb.HOME, real_speed=mks.as_given)),
        Row("home-trigger-not-stored", "90 keeps the old level of the end stop", unstored("home_trigger")),
        Row("home-return-ignored", "without a switch homing stays at the obstacle",
            homing_by(lambda s: {"return_angle": 0}), TELLING),
        Row("home-mode-ignored", "homing always looks for a switch", homing_by(lambda s: {"home_mode": 0}), TELLING),
        Row("home-keeps-the-shaft", "with the end limit on homing does not let the shaft go", when_home(mks.hold), SERIAL),
    ),
}  # fmt: skip

# --- what it tells of motion -----------------------------------------------------------------------------------------

COMPLETION: Rows = {
    "completion": (
        Row("completion-missing", "the end of a move is not told", completing()),
        Row("completion-missing-at-zero", "the end of a move by nothing is not told",
            wrapped(MOVES, mks.endless_at_zero), TELLING),
        Row("completion-doubled", "the end of a move is told twice", completing(2, 2)),
        Row("completion-too-early", "the end of a move is told half-way", completing(2, at=half_way)),
        Row("completion-too-late", "the end of a move is told two seconds late", completing(2, at=afterwards)),
        Row("completion-says-1", "the end of a move is told by status 1", completing(1)),
        Row("completion-says-3", "the end of a move is told as an end limit", completing(3)),
        Row("completion-says-0", "the end of a move is told as a failure", completing(0)),
        Row("stop-completion-missing", "the end of a stop is not told", completing(of=STOPS)),
        Row("stop-completion-early", "the end of a stop is told half-way", completing(2, at=half_way, of=STOPS)),
        Row("interim-missing", "the beginning of a move is not told", unsaid(MOVES, 1)),
        Row("interim-doubled", "the beginning of a move is told twice", Change(mks.begin_twice), TELLING),
        Row("interim-and-completion-swapped", "a move begins with 2 and ends with 1",
            reply("status", exchanged(1, 2), MOVES), TELLING),
        Row("superseded-completes-too", "a move whose place a newer one took is told as done",
            before(MOTIONS, mks.complete_older), TELLING),
        Row("limit-stop-says-2", "a move stopped by an end limit is told as complete",
            reply("status", renamed(mks.LIMIT_STOP, mks.COMPLETE), MOVES), TELLING),
        Row("home-completion-missing", "the end of homing is not told", unsaid(Verb.HOME, 2)),
        Row("home-begins-with-2", "homing begins with status 2", reply("status", renamed(1, 2), Verb.HOME), TELLING),
        Row("calibration-without-interim", "80 is not answered when it begins", unsaid(Verb.CALIBRATE, 0)),
        Row("modbus-completions", "the end of a move is told by a second echo",
            frames(mks_frames.echo_at_end, (F4, F5)), MODBUS),
    ),
    "respond": (
        Row("respond-ignored", "respond 0 silences nothing", heedless("respond"), TELLING),
        Row("respond-silences-all", "respond 0 silences every reply",
            unless(lambda d, c: not d.settings["respond"] and c.verb is not Verb.SET_RESPOND), TELLING),
        Row("respond-silences-emergency", "respond 0 silences the reply of the emergency stop",
            unless(lambda d, c: not d.settings["respond"], Verb.EMERGENCY_STOP), TELLING),
        Row("active-ignored", "active 0 leaves completions as they are", heedless("active"), TELLING),
        Row("respond-silences-settings", "respond 0 silences the replies of settings",
            unless(lambda d, c: not d.settings["respond"] and c.verb in SETTINGS and c.verb is not Verb.SET_RESPOND), TELLING),
        Row("active-silences-first", "active 0 silences the first reply to motion too",
            unless(lambda d, c: not d.settings["active"], MOTIONS | STOPS), TELLING),
    ),
}  # fmt: skip

# --- what it does in one state, and not in others ---------------------------------------------------------------------

STATES: Rows = {
    "silence": (
        Row("reads-silent-while-off", "39 and 3E are not answered while the motor is disabled",
            unless(lambda drive, command: not drive.enabled, (Verb.READ_ANGLE_ERROR, Verb.READ_PROTECTION))),
        Row("reads-silent-while-homing", "33 and 3A are not answered while the drive is homing",
            unless(lambda drive, command: drive.doing(Activity.HOME), (Verb.READ_PULSES, Verb.READ_ENABLED))),
        Row("parameters-unreadable-while-turning", "no parameter can be read while the shaft turns",
            read_back(mks.unreadable_while_turning)),
    ),
    "status": (
        Row("status-turned-about-clockwise", "F1 tells 2 and 3 in each other's place while the encoder falls",
            result(mks.turned_about, F1)),
    ),
    "checksum": (
        Row("homes-on-bad-checksum", "91 with a wrong checksum is executed", mks_frames.take_bad(Verb.HOME)),
        Row("disables-on-bad-checksum", "F3 with a wrong checksum is executed", mks_frames.take_bad(Verb.ENABLE)),
        Row("stores-on-bad-checksum", "settings with a wrong checksum are stored", mks_frames.take_bad(*SETTINGS), CAN),
    ),
    "group": (
        Row("group-deaf-to-settings", "settings by the group are not stored", deaf_to(mks_frames.setting_of_group), CAN),
        Row("group-low-byte-only", "only the low byte of a group address is looked at",
            hearing(mks_frames.low_byte_of_group), CAN),
    ),
    "motion": (
        Row("newer-target-refused", "F5 is refused while a move is under way", before(F5, mks.refuse_newer)),
        Row("pulses-signed", "FD takes the upper half of its pulses as negative",
            asked("pulses", lambda value, field: value - (1 << field.bit_width) if value >> field.bit_width - 1 else value,
                FD)),
        Row("off-refused-while-turning", "F3 is refused while the shaft turns",
            before(Verb.ENABLE, mks.refuse_off_while_turning)),
        Row("zero-ignored-while-turning", "92 does nothing while the shaft turns",
            before(Verb.SET_ZERO, mks.say_while_turning)),
    ),
    "port": (
        Row("alarm-never", "ALM never tells an alarm", reply("alm", always(1))),
        Row("in-2-dead", "in_2 stays 0", reply("in_2", always(0)), CAN),
    ),
}  # fmt: skip

# --- Modbus ----------------------------------------------------------------------------------------------------------

FUNCTIONS: Rows = {
    "byte count": (
        Row("read-byte-count-in-registers", "reads count registers instead of bytes",
            of_functions(READS, byte(mks_frames.COUNT, lambda n: n // mks_frames.WORD))),
        Row("read-byte-count-off-by-one", "the byte count of reads is one too high",
            of_functions(READS, byte(mks_frames.COUNT, lambda n: n + 1))),
        Row("home-takes-six-bytes", "90h is taken with six bytes", translated(mks_frames.six_bytes)),
    ),
    "byte order": (
        Row("read-words-swapped", "numbers of several registers come low register first",
            of_functions(READS, mks_frames.low_word_first)),
    ),
    "shape": (
        Row("read-repeats-register", "a read is answered with its register before the data",
            of_functions(READS, lambda b: b[: mks_frames.COUNT + 1] + b"\0\x31" + b[mks_frames.COUNT + 1 :])),
    ),
    "echo": (
        Row("write-echo-zero", "06h is echoed with the value 0",
            of_functions(WRITE_ONE, done(lambda b: b[: mks_frames.VALUE] + b"\0\0"))),
        Row("write-echo-next-register", "writes are echoed with the next register",
            of_functions(WRITES, byte(mks_frames.REGISTER + 1, lambda r: r + 1))),
        Row("write-many-echoes-all", "10h is answered with the whole request", Change(mks_frames.echo_write), MODBUS),
        Row("refusal-echoes-value", "a refused 06h is echoed with 0",
            of_functions(WRITE_ONE, not_done(lambda b: b[: mks_frames.VALUE] + b"\0\0"))),
    ),
    "quantity": (
        Row("write-many-quantity-in-bytes", "10h is echoed with the byte count",
            of_functions(WRITE_MANY, done(byte(mks_frames.VALUE + 1, lambda q: 2 * q)))),
        Row("write-many-quantity-off-by-one", "10h is echoed with a quantity one too low",
            of_functions(WRITE_MANY, done(byte(mks_frames.VALUE + 1, lambda q: q - 1)))),
        Row("refusal-echoes-quantity", "a refused 10h is echoed with its quantity",
            of_functions(WRITE_MANY, not_done(byte(mks_frames.VALUE + 1, lambda _: 4)))),
        Row("any-quantity-reads", "a read of any quantity is answered with the register's own",
            translated(mks_frames.own_quantity)),
    ),
    "code": (
        Row("write-one-as-many", "06h is answered under function 10h",
            of_functions(WRITE_ONE, byte(mks_frames.FUNCTION, lambda _: 0x10))),
    ),
    "exception": (
        Row("refused-by-exception", "refused writes are answered with exception 03",
            of_functions(WRITES, not_done(lambda b: bytes((b[0], b[mks_frames.FUNCTION] | 0x80, 3))))),
        Row("exception-always-04", "every exception is 04", of_functions(REQUESTS, byte(2, lambda _: 4), exceptions=True)),
        Row("exception-while-turning", "reads are answered by exception 04 while the shaft turns",
            frames(mks_frames.busy_while_turning), MODBUS),
        Row("exceptions-mixed-up", "exceptions 02 and 03 stand for each other",
            of_functions(REQUESTS, byte(2, lambda c: {2: 3, 3: 2}.get(c, c)), exceptions=True)),
        Row("exception-without-bit", "exceptions lack the high bit of the function",
            of_functions(REQUESTS, byte(mks_frames.FUNCTION, lambda f: f & 0x7F), exceptions=True)),
    ),
    "function": (Row("function-03-reads", "03h reads as 04h does", translated(mks_frames.as_04)),),
    "address": (
        Row("register-low-byte-only", "only the low byte of a register is looked at", translated(mks_frames.low_byte_register)),
    ),
}  # fmt: skip

FAULTS = faults(HEARING, REPLIES, SETTING, MOTION, COMPLETION, STATES, FUNCTIONS)
