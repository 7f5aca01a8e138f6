"""Faults of the MKS drives: defects in what they hear, store, do and tell.

Rules kept here:
- A fault changes what can be seen on the bus in each dialect that it names, and nothing that the manual leaves open.
- A command is named by its native code, as in "83 refuses 0 mA". Modbus has the same numbers as registers.
"""

from __future__ import annotations

from fractions import Fraction

from analyzer.catalogue import Verb
from analyzer.link import READS, WRITE_MANY, WRITE_ONE
from conformance.drives.drive import Fault
from conformance.drives.faults import mks_behaviour as mks
from conformance.drives.faults.mks_behaviour import (
    MOVES,
    RUNS,
    afterwards,
    answering,
    before,
    clinging,
    completing,
    deaf_to,
    done,
    forgetful,
    half_way,
    hearing,
    heedless,
    homing_by,
    instead,
    landing,
    lying,
    not_done,
    of_functions,
    read_back,
    silent_to,
    slots,
    translated,
    tuned,
    unless,
    unsaid,
    when_home,
    with_law,
    with_state,
    wrapped,
)
from conformance.drives.faults.numbers import always, exchanged, negated, renamed
from conformance.drives.faults.places import (
    CAN,
    MODBUS,
    NATIVE,
    SERIAL,
    TELLING,
    Change,
    asked,
    bodies,
    byte,
    fault,
    frames,
    reply,
    result,
    stored_as,
    taken,
    together,
    unstored,
)
from conformance.drives.mks.core import STOPS
from conformance.drives.mks.paths import ramp_step_ns
from conformance.drives.mks.settings import SETTINGS

WRITES = WRITE_ONE | WRITE_MANY
REQUESTS = READS | WRITES
MEASURES = (Verb.READ_ENCODER_CARRY, Verb.READ_POSITION, Verb.READ_SPEED, Verb.READ_PULSES, Verb.READ_ANGLE_ERROR)
CARRY = Verb.READ_ENCODER_CARRY
PARAMETER = Verb.READ_PARAMETER
AXIS_MOVES = (Verb.MOVE_RELATIVE_AXIS, Verb.MOVE_ABSOLUTE_AXIS)

# --- what it hears and answers ---------------------------------------------------------------------------------------

HEARING: tuple[Fault, ...] = (
    fault(
        "hears-bad-checksum", "checksum", "frames with a wrong checksum are executed and answered", taken(mks.take_bad_checksum)
    ),
    fault(
        "executes-bad-checksum",
        "checksum",
        "frames with a wrong checksum are executed and not answered",
        together(taken(mks.take_bad_checksum), silent_to(lambda drive, message: not message.frame.checksum_ok)),
    ),
    fault(
        "deaf-after-bad-frame",
        "checksum",
        "after a frame with a wrong checksum the next good one is not heard",
        Change(mks.startle),
    ),
    fault(
        "hears-reply-head", "head", "frames with the head of a reply are taken for requests", taken(mks.take_reply_head), NATIVE
    ),
    fault("answers-unknown-code", "unknown", "unknown codes are answered with status 0", taken(mks.answer_unknown), TELLING),
    fault(
        "answers-another-address",
        "address",
        "requests to any address are executed and answered",
        together(hearing(lambda drive, message: True), answering(mks.to_one)),
    ),
    fault(
        "executes-another-address",
        "address",
        "requests to any address are executed, without an answer",
        hearing(lambda drive, message: True),
    ),
    fault(
        "answers-next-address",
        "address",
        "requests to the next higher address are answered too",
        together(hearing(mks.to_next), answering(mks.to_next)),
    ),
    fault(
        "address-low-byte-only",
        "address",
        "only the low byte of an ID is looked at",
        together(hearing(mks.same_low_byte), answering(mks.same_low_byte)),
        CAN,
    ),
    fault("answers-broadcast", "broadcast", "broadcasts are answered", answering(mks.to_all)),
    fault("answers-broadcast-reads", "broadcast", "reads by broadcast are answered", answering(mks.read_of_all)),
    fault("ignores-broadcast", "broadcast", "broadcasts are not executed", deaf_to(mks.to_all)),
    fault("answers-group", "group", "requests to the group address are answered", answering(mks.to_group), TELLING),
    fault("ignores-group", "group", "requests to the group address are not executed", deaf_to(mks.to_group), TELLING),
    fault(
        "group-replaces-address", "group", "a drive in a group no longer hears its own address", deaf_to(mks.grouped), TELLING
    ),
    fault("package-answered", "package", "packages are answered", answering(mks.package), NATIVE),
    fault("package-ignored", "package", "packages are not executed", deaf_to(mks.package), NATIVE),
    fault(
        "package-any-length", "package", "packages shorter than 52 bytes are executed", taken(mks.take_short_package), NATIVE
    ),
    fault(
        "package-both-slots",
        "package",
        "all slots for an address are executed",
        slots(lambda own, all_, w: mks.mine(own, all_)),
        NATIVE,
    ),
    fault(
        "package-last-slot",
        "package",
        "of two slots for an address the last is executed",
        slots(lambda own, all_, w: mks.mine(own, all_)[-1:]),
        NATIVE,
    ),
    fault("package-next-slot", "package", "the slot behind the own one is executed", slots(mks.behind_mine), NATIVE),
    fault(
        "package-first-slot-only",
        "package",
        "only the first slot is looked at",
        slots(lambda own, all_, w: mks.mine(own, all_[:1])),
        NATIVE,
    ),
    fault("package-every-slot", "package", "the slots of all addresses are executed", slots(lambda own, all_, w: all_), NATIVE),
    fault(
        "package-broadcast-slot",
        "package",
        "a slot for address 0 is executed",
        slots(lambda own, all_, w: w or mks.mine(0, all_)[:1]),
        NATIVE,
    ),
    fault(
        "modbus-no-exceptions",
        "exception",
        "what calls for an exception is not answered",
        silent_to(lambda drive, message: drive.responder.exception(message) is not None),
        MODBUS,
    ),
)

# --- what replies say ------------------------------------------------------------------------------------------------

REPLIES: tuple[Fault, ...] = (
    fault(
        "speed-reply-code-31",
        "code",
        "32 is answered under the code 31, as a table of the manual has it",
        bodies(lambda b: b.replace(b"\x32", b"\x31", 1), Verb.READ_SPEED),
        TELLING,
    ),
    fault(
        "status-of-two-bytes",
        "length",
        "the answer to a setting has a status of two bytes",
        bodies(lambda b: b[:-1] + b"\0" + b[-1:], SETTINGS),
        TELLING,
    ),
    fault("carry-cut-to-zero", "sign", "30 cuts negative positions towards zero", result(mks.carry_to_zero, CARRY)),
    fault("carry-too-late", "width", "30 carries only every second turn", result(mks.carry_late, CARRY)),
    fault(
        "carry-before-value",
        "byte order",
        "30 sends the value before the carry",
        bodies(lambda b: b[:-6] + b[-2:] + b[-6:-2], CARRY),
    ),
    fault(
        "status-inverted",
        "status",
        "settings answer 0 for success and 1 for failure",
        reply("status", exchanged(0, 1), SETTINGS),
    ),
    fault(
        "refusal-says-success",
        "status",
        "a refused setting answers as if it had been done",
        reply("status", always(1), SETTINGS),
    ),
    fault(
        "status-up-and-down-swapped",
        "status",
        "F1 mixes up speeding up and slowing down",
        reply("status", exchanged(2, 3), Verb.READ_STATUS),
    ),
    fault(
        "calibrating-as-homing",
        "status",
        "F1 says 5 while calibrating, as the manual's list has it",
        reply("status", renamed(6, 5), Verb.READ_STATUS),
    ),
    fault("homing-as-running", "status", "F1 says full speed while homing", reply("status", renamed(5, 4), Verb.READ_STATUS)),
    fault(
        "status-outside-list", "status", "F1 says 7 for a motor that stands", reply("status", renamed(1, 7), Verb.READ_STATUS)
    ),
    fault("enabled-inverted", "status", "3A says enabled for disabled", reply("enabled", exchanged(0, 1), Verb.READ_ENABLED)),
    fault(
        "protection-inverted",
        "status",
        "3E says protected for not protected",
        reply("status", exchanged(0, 1), Verb.READ_PROTECTION),
    ),
    fault("setting-status-2", "status", "settings answer 2 for success", reply("status", renamed(1, 2), SETTINGS), TELLING),
    fault("run-status-2", "status", "a run at a speed is answered 2", reply("status", renamed(1, 2), Verb.RUN_SPEED), TELLING),
    fault("status-frozen", "frozen", "F1 always says that the motor stands", reply("status", always(1), Verb.READ_STATUS)),
    fault("status-stale", "frozen", "F1 says what it said the time before", mks.stale(Verb.READ_STATUS)),
    fault("speed-frozen", "frozen", "32 always says 0", reply("speed", always(0), Verb.READ_SPEED)),
    fault("position-frozen", "frozen", "31 always says 0", reply("position", always(0), Verb.READ_POSITION)),
    fault("pulses-frozen", "frozen", "33 always says 0", reply("pulses", always(0), Verb.READ_PULSES)),
    fault("enabled-frozen", "frozen", "3A always says enabled", reply("enabled", always(1), Verb.READ_ENABLED)),
    fault("protection-hidden", "frozen", "3E never says protected", reply("status", always(0), Verb.READ_PROTECTION)),
    fault("zero-status-frozen", "frozen", "3B always says success", reply("status", always(1), Verb.READ_ZERO_STATUS)),
    fault("reserved-bits-set", "reserved", "34 sets its reserved bits", bodies(byte(-1, lambda v: v | 0xF0), Verb.READ_IO)),
    fault(
        "unanswered-reads",
        "lost",
        "reads of measured numbers are not answered while the motor turns",
        unless(lambda drive, command: bool(drive.motor.speed(drive.now_ns)), MEASURES),
    ),
    fault("parameter-bytes-shifted", "read-back", "a parameter read mixes the fields up", read_back(mks.shifted), CAN),
    fault(
        "parameter-off-by-one",
        "read-back",
        "a parameter read is one too high in its first field",
        read_back(mks.first_one_up),
        CAN,
    ),
    fault("parameter-defaults", "read-back", "a parameter read answers with the defaults", read_back(mks.defaults), CAN),
    fault("subdivision-unreadable", "read-back", "84 cannot be read back", read_back(mks.no_subdivision), CAN),
    fault(
        "unreadable-as-zero",
        "read-back",
        "a code that cannot be read is answered 00 00",
        bodies(lambda b: b.replace(b"\xff\xff", b"\0\0"), PARAMETER),
        CAN,
    ),
    fault(
        "parameter-under-code-0",
        "code",
        "a parameter read is answered under the code 00",
        bodies(byte(0, lambda _: 0), PARAMETER),
        CAN,
    ),
    fault(
        "unreadable-unanswered",
        "lost",
        "a code that cannot be read is not answered",
        result(lambda drive, command, asked, values: None if "unreadable" in values else values, PARAMETER),
        CAN,
    ),
    fault(
        "parameter-little-endian",
        "byte order",
        "a parameter read sends its bytes in reverse",
        bodies(lambda b: b[:1] + b[:0:-1], PARAMETER),
        CAN,
    ),
)

# --- what it stores --------------------------------------------------------------------------------------------------

SETTING: tuple[Fault, ...] = (
    fault("subdivision-not-stored", "stored", "84 says success and changes nothing", unstored("subdivision")),
    fault("work-mode-not-stored", "stored", "82 says success and changes nothing", unstored("work_mode")),
    fault("home-speed-not-stored", "stored", "90 says success and keeps the old speed", unstored("home_speed")),
    fault("home-direction-not-stored", "stored", "90 says success and keeps the old direction", unstored("home_direction")),
    fault("address-not-stored", "stored", "8B says success and keeps the old address", unstored("new_address")),
    fault("group-not-stored", "stored", "8D says success and joins no group", unstored("group_address")),
    fault("user-id-not-stored", "stored", "42 says success and keeps the old number", unstored("user_id")),
    fault(
        "saved-run-not-stored", "stored", "FF says success and keeps nothing for power-on", unstored("saved_run", "saved_speed")
    ),
    fault("respond-stored-as-active", "stored", "8C stores respond as active", stored_as("respond", "active")),
    fault(
        "group-stored-as-address",
        "stored",
        "8D stores the group as the drive's own address",
        together(stored_as("group_address", "new_address"), mks.retuned(Verb.SET_GROUP_ADDRESS)),
    ),
    fault(
        "stored-before-judged",
        "stored",
        "a setting that is refused is stored all the same",
        Change(lambda hooks: hooks.allow.append(mks.store_refused)),
    ),
    fault("clean-ignored", "stored", "FF CA leaves the run kept for power-on", before(Verb.SAVE_SPEED, mks.ignore_clean)),
    fault("current-not-stored", "stored", "83 says success and keeps the old current", unstored("current"), CAN),
    fault("current-stored-as-home-current", "stored", "83 stores the home current", stored_as("current", "home_current"), CAN),
    fault("work-mode-lost", "restart", "a restart puts the work mode back to its default", forgetful("work_mode")),
    fault("subdivision-lost", "restart", "a restart puts the subdivision back to 16", forgetful("subdivision")),
    fault("home-speed-lost", "restart", "a restart forgets the home settings", forgetful("home_speed", "home_direction")),
    fault("group-lost", "restart", "a restart forgets the group", forgetful("group_address")),
    fault("respond-lost", "restart", "a restart forgets respond and active", forgetful("respond", "active")),
    fault("address-lost", "restart", "a restart puts the address back to 1", forgetful("new_address")),
    fault("user-id-lost", "restart", "a restart forgets the user's number", forgetful("user_id")),
    fault("saved-run-lost", "restart", "a restart forgets the run kept for power-on", forgetful("saved_run")),
    fault("restart-lies", "restart", "41 says success and restarts nothing", lying(Verb.RESTART)),
    fault("restart-unanswered", "restart", "41 restarts without a reply", unless(lambda drive, command: True, Verb.RESTART)),
    fault("current-lost", "restart", "a restart puts the current back to its default", forgetful("current"), CAN),
    fault("work-mode-kept", "restore", "a restore leaves the work mode", clinging("work_mode")),
    fault("subdivision-kept", "restore", "a restore leaves the subdivision", clinging("subdivision")),
    fault("address-kept", "restore", "a restore leaves the address", clinging("new_address")),
    fault("restore-lies", "restore", "3F says success and restores nothing", lying(Verb.RESTORE)),
    fault("current-kept", "restore", "a restore leaves the current", clinging("current"), CAN),
    fault("dialect-kept", "restore", "a restore leaves Modbus on", clinging("modbus"), MODBUS),
)

# --- how it moves ----------------------------------------------------------------------------------------------------

MOTION: tuple[Fault, ...] = (
    fault("ramp-too-fast", "ramp", "ramps take half their time", with_law("ramp", lambda a: ramp_step_ns(a) // 2)),
    fault("ramp-too-slow", "ramp", "ramps take twice their time", with_law("ramp", lambda a: 2 * ramp_step_ns(a))),
    fault(
        "ramp-off-by-one",
        "ramp",
        "one rpm takes (255 - acc) x 50 us",
        with_law("ramp", lambda a: (255 - a) * 50_000 if a else 0),
    ),
    fault(
        "ramp-turned-round", "ramp", "the larger the acceleration, the slower the ramp", with_law("ramp", lambda a: a * 50_000)
    ),
    fault(
        "acceleration-0-by-formula",
        "ramp",
        "acceleration 0 is the slowest ramp",
        with_law("ramp", lambda a: (256 - a) * 50_000),
    ),
    fault("no-ramp", "ramp", "speeds change at once whatever the acceleration", with_law("ramp", lambda a: 0)),
    fault("overshoot", "ramp", "moves go 1000 counts beyond their target and come back", landing(1000, 0)),
    fault("run-direction-wrong", "direction", "F6 turns the other way", asked("direction", exchanged(0, 1), Verb.RUN_SPEED)),
    fault(
        "run-direction-ignored", "direction", "F6 always turns counter-clockwise", asked("direction", always(0), Verb.RUN_SPEED)
    ),
    fault(
        "relative-pulses-direction-wrong",
        "direction",
        "FD moves the other way",
        asked("direction", exchanged(0, 1), Verb.MOVE_RELATIVE_PULSES),
    ),
    fault(
        "absolute-pulses-direction-wrong",
        "direction",
        "FE moves to the other side of zero",
        asked("position", negated, Verb.MOVE_ABSOLUTE_PULSES),
    ),
    fault(
        "relative-axis-direction-wrong",
        "direction",
        "F4 moves the other way",
        asked("position", negated, Verb.MOVE_RELATIVE_AXIS),
    ),
    fault(
        "absolute-axis-direction-wrong",
        "direction",
        "F5 moves to the other side of zero",
        asked("position", negated, Verb.MOVE_ABSOLUTE_AXIS),
    ),
    fault(
        "saved-direction-lost",
        "direction",
        "the run kept for power-on turns counter-clockwise always",
        unstored("saved_direction"),
    ),
    fault("direction-setting-ignored", "direction", "86 does not turn motion by the bus", unstored("motor_direction"), CAN),
    fault("direction-setting-turns-bus", "direction", "86 turns motion by the bus", tuned(mks.turn_bus_motion), SERIAL),
    fault(
        "zero-direction-ignored",
        "direction",
        "the way back at power-on is always clockwise",
        unstored("zero_direction"),
        SERIAL,
    ),
    fault(
        "relative-as-absolute",
        "target",
        "F4 moves to the position instead of by it",
        wrapped(Verb.MOVE_RELATIVE_AXIS, mks.as_command(Verb.MOVE_ABSOLUTE_AXIS)),
    ),
    fault(
        "absolute-as-relative",
        "target",
        "F5 moves by the position instead of to it",
        wrapped(Verb.MOVE_ABSOLUTE_AXIS, mks.as_command(Verb.MOVE_RELATIVE_AXIS)),
    ),
    fault("move-ends-short", "target", "moves end 200 counts before their target", landing(-200)),
    fault("move-ends-beyond", "target", "moves end 200 counts beyond their target", landing(200)),
    fault(
        "absolute-pulses-as-counts",
        "scale",
        "FE takes pulses for encoder counts",
        wrapped(Verb.MOVE_ABSOLUTE_PULSES, mks.as_command(Verb.MOVE_ABSOLUTE_AXIS)),
    ),
    fault(
        "axis-as-pulses",
        "scale",
        "F5 takes encoder counts for pulses",
        wrapped(Verb.MOVE_ABSOLUTE_AXIS, mks.as_command(Verb.MOVE_ABSOLUTE_PULSES)),
    ),
    fault(
        "speed-ignores-subdivision",
        "scale",
        "the speed as sent is the real one at every subdivision",
        with_law("real_speed", lambda speed: speed),
    ),
    fault(
        "speed-scaled-at-32",
        "scale",
        "at 32 and 64 subdivisions too the speed is reckoned from 16",
        tuned(lambda d: setattr(d, "real_speed", lambda speed: Fraction(speed * 16, d.subdivision))),
    ),
    fault(
        "mode-limit-ignored",
        "limit",
        "every work mode turns up to 3000 rpm",
        with_law("highest_speed", lambda declared: declared),
        SERIAL,
    ),
    fault("speed-unlimited", "limit", "speeds above 3000 are run", with_law("highest_speed", lambda declared: 0xFFFF)),
    fault("speed-above-3000-refused", "limit", "speeds above 3000 are refused", before(RUNS, mks.refuse_above(3000))),
    fault("speed-3000-refused", "limit", "3000 rpm is refused", before(RUNS, mks.refuse_above(2999))),
    fault("end-limit-ignored", "limit", "the end limit stops nothing", heedless("end_limit")),
    fault("limit-remap-ignored", "limit", "9E remaps nothing", unstored("limit_remap")),
    fault(
        "update-ignored", "update", "F5 on the way goes on to the old target", before(Verb.MOVE_ABSOLUTE_AXIS, mks.keep_going)
    ),
    fault(
        "update-stops-first",
        "update",
        "F5 on the way stops the shaft before it goes on",
        before(Verb.MOVE_ABSOLUTE_AXIS, mks.stop_first),
    ),
    fault("newer-move-ignored", "update", "moves are ignored while one is under way", before(MOVES, mks.keep_going)),
    fault("stop-without-ramp", "stop", "stops are at once whatever the acceleration", asked("acceleration", always(0), STOPS)),
    fault(
        "stop-by-slowest-ramp",
        "stop",
        "stops go by the slowest ramp, also those at once",
        asked("acceleration", always(1), STOPS),
    ),
    fault("stop-coasts", "stop", "a stop begins two seconds late", wrapped(STOPS, mks.coasting)),
    fault("speed-stop-ignored", "stop", "F6 with speed 0 stops nothing", lying(Verb.STOP_SPEED)),
    fault("move-stop-ignored", "stop", "stops of moves stop nothing", lying(STOPS - {Verb.STOP_SPEED})),
    fault("emergency-stop-ignored", "stop", "F7 stops nothing", lying(Verb.EMERGENCY_STOP)),
    fault("emergency-stop-ramps", "stop", "F7 stops by a ramp", instead(Verb.EMERGENCY_STOP, mks.emergency_ramp)),
    fault("disable-ignored", "enable", "F3 00 disables nothing", lying(Verb.ENABLE)),
    fault("disabled-moves", "enable", "a disabled motor moves when told", with_state(RUNS, enabled=True)),
    fault("protected-moves", "protection", "a protected motor moves when told", with_state(RUNS, protected=False)),
    fault("protection-ignored", "protection", "a locked rotor is never let go", heedless("protection")),
    fault("release-ignored", "protection", "3D ends no protection", lying(Verb.RELEASE_PROTECTION)),
    fault("stall-tolerance-ignored", "protection", "the stall tolerance is 180 degrees always", unstored("stall_tolerance")),
    fault("pulse-mode-moves", "mode", "motion commands work in pulse modes", heedless("work_mode")),
    fault("set-zero-ignored", "zero", "92 sets no zero", lying(Verb.SET_ZERO)),
    fault("set-zero-pulses-only", "zero", "92 sets the zero of the pulses alone", instead(Verb.SET_ZERO, mks.zero_pulses)),
    fault("zero-mode-ignored", "zero", "9A brings nothing back at power-on", unstored("zero_mode")),
    fault("home-lies", "homing", "91 says that home was found and turns nothing", instead(Verb.HOME, mks.home_at_once)),
    fault("home-sets-no-zero", "homing", "home is found and not made zero", when_home(mks.lose_zero)),
    fault(
        "home-wrong-way",
        "homing",
        "homing goes the other way",
        homing_by(lambda s: {"home_direction": 1 - s["home_direction"]}),
    ),
    fault("home-speed-ignored", "homing", "homing turns at 30 rpm always", homing_by(lambda s: {"home_speed": 30})),
    fault("home-trigger-not-stored", "homing", "90 keeps the old level of the end stop", unstored("home_trigger")),
    fault(
        "home-return-ignored",
        "homing",
        "without a switch homing stays at the obstacle",
        homing_by(lambda s: {"return_angle": 0}),
        TELLING,
    ),
    fault("home-mode-ignored", "homing", "homing always looks for a switch", homing_by(lambda s: {"home_mode": 0}), TELLING),
    fault(
        "home-keeps-the-shaft", "homing", "with the end limit on homing does not let the shaft go", when_home(mks.hold), SERIAL
    ),
)

# --- what it tells of motion -----------------------------------------------------------------------------------------

COMPLETION: tuple[Fault, ...] = (
    fault("completion-missing", "completion", "the end of a move is not told", completing(), TELLING),
    fault("completion-doubled", "completion", "the end of a move is told twice", completing(2, 2), TELLING),
    fault("completion-too-early", "completion", "the end of a move is told half-way", completing(2, at=half_way), TELLING),
    fault(
        "completion-too-late", "completion", "the end of a move is told two seconds late", completing(2, at=afterwards), TELLING
    ),
    fault("completion-says-1", "completion", "the end of a move is told by status 1", completing(1), TELLING),
    fault("completion-says-3", "completion", "the end of a move is told as an end limit", completing(3), TELLING),
    fault("completion-says-0", "completion", "the end of a move is told as a failure", completing(0), TELLING),
    fault("stop-completion-missing", "completion", "the end of a stop is not told", completing(of=STOPS), TELLING),
    fault(
        "stop-completion-early",
        "completion",
        "the end of a stop is told half-way",
        completing(2, at=half_way, of=STOPS),
        TELLING,
    ),
    fault("interim-missing", "completion", "the beginning of a move is not told", unsaid(MOVES, 1), TELLING),
    fault("interim-doubled", "completion", "the beginning of a move is told twice", Change(mks.begin_twice), TELLING),
    fault(
        "interim-and-completion-swapped",
        "completion",
        "a move begins with 2 and ends with 1",
        reply("status", exchanged(1, 2), MOVES),
        TELLING,
    ),
    fault(
        "superseded-completes-too",
        "completion",
        "a move whose place a newer one took is told as done",
        before(RUNS, mks.complete_older),
        TELLING,
    ),
    fault(
        "limit-stop-says-2",
        "completion",
        "a move stopped by an end limit is told as complete",
        reply("status", renamed(mks.LIMIT_STOP, mks.COMPLETE), MOVES),
        TELLING,
    ),
    fault("home-completion-missing", "completion", "the end of homing is not told", unsaid(Verb.HOME, 2), TELLING),
    fault(
        "home-begins-with-2", "completion", "homing begins with status 2", reply("status", renamed(1, 2), Verb.HOME), TELLING
    ),
    fault("calibration-without-interim", "completion", "80 is not answered when it begins", unsaid(Verb.CALIBRATE, 0), TELLING),
    fault("respond-ignored", "respond", "respond 0 silences nothing", heedless("respond"), TELLING),
    fault(
        "respond-silences-all",
        "respond",
        "respond 0 silences every reply",
        unless(lambda drive, command: not drive.settings["respond"] and command.verb is not Verb.SET_RESPOND),
        TELLING,
    ),
    fault("active-ignored", "respond", "active 0 leaves completions as they are", heedless("active"), TELLING),
    fault(
        "active-silences-first",
        "respond",
        "active 0 silences the first reply to motion too",
        unless(lambda drive, command: not drive.settings["active"], RUNS | STOPS),
        TELLING,
    ),
    fault(
        "modbus-completions",
        "completion",
        "the end of a move is told by a second echo",
        frames(mks.echo_at_end, AXIS_MOVES),
        MODBUS,
    ),
)

# --- Modbus ----------------------------------------------------------------------------------------------------------

FUNCTIONS: tuple[Fault, ...] = (
    fault(
        "read-byte-count-in-registers",
        "byte count",
        "reads count registers instead of bytes",
        of_functions(READS, byte(mks.COUNT, lambda n: n // mks.WORD)),
        MODBUS,
    ),
    fault(
        "read-byte-count-off-by-one",
        "byte count",
        "the byte count of reads is one too high",
        of_functions(READS, byte(mks.COUNT, lambda n: n + 1)),
        MODBUS,
    ),
    fault("home-takes-six-bytes", "byte count", "90h is taken with six bytes", translated(mks.six_bytes), MODBUS),
    fault(
        "read-words-swapped",
        "byte order",
        "numbers of several registers come low register first",
        of_functions(READS, mks.low_word_first),
        MODBUS,
    ),
    fault(
        "read-repeats-register",
        "shape",
        "a read is answered with its register before the data",
        of_functions(READS, lambda b: b[: mks.COUNT + 1] + b"\0\x31" + b[mks.COUNT + 1 :]),
        MODBUS,
    ),
    fault(
        "write-echo-zero",
        "echo",
        "06h is echoed with the value 0",
        of_functions(WRITE_ONE, done(lambda b: b[: mks.VALUE] + b"\0\0")),
        MODBUS,
    ),
    fault(
        "write-echo-next-register",
        "echo",
        "writes are echoed with the next register",
        of_functions(WRITES, byte(mks.REGISTER + 1, lambda r: r + 1)),
        MODBUS,
    ),
    fault("write-many-echoes-all", "echo", "10h is answered with the whole request", Change(mks.echo_write), MODBUS),
    fault(
        "refusal-echoes-value",
        "echo",
        "a refused 06h is echoed with 0",
        of_functions(WRITE_ONE, not_done(lambda b: b[: mks.VALUE] + b"\0\0")),
        MODBUS,
    ),
    fault(
        "write-many-quantity-in-bytes",
        "quantity",
        "10h is echoed with the byte count",
        of_functions(WRITE_MANY, done(byte(mks.VALUE + 1, lambda q: 2 * q))),
        MODBUS,
    ),
    fault(
        "write-many-quantity-off-by-one",
        "quantity",
        "10h is echoed with a quantity one too low",
        of_functions(WRITE_MANY, done(byte(mks.VALUE + 1, lambda q: q - 1))),
        MODBUS,
    ),
    fault(
        "refusal-echoes-quantity",
        "quantity",
        "a refused 10h is echoed with its quantity",
        of_functions(WRITE_MANY, not_done(byte(mks.VALUE + 1, lambda _: 4))),
        MODBUS,
    ),
    fault(
        "any-quantity-reads",
        "quantity",
        "a read of any quantity is answered with the register's own",
        translated(mks.own_quantity),
        MODBUS,
    ),
    fault(
        "write-one-as-many",
        "code",
        "06h is answered under function 10h",
        of_functions(WRITE_ONE, byte(mks.FUNCTION, lambda _: 0x10)),
        MODBUS,
    ),
    fault(
        "refused-by-exception",
        "exception",
        "refused writes are answered with exception 03",
        of_functions(WRITES, not_done(lambda b: bytes((b[0], b[mks.FUNCTION] | 0x80, 3)))),
        MODBUS,
    ),
    fault(
        "exception-always-04",
        "exception",
        "every exception is 04",
        of_functions(REQUESTS, byte(2, lambda _: 4), exceptions=True),
        MODBUS,
    ),
    fault(
        "exceptions-mixed-up",
        "exception",
        "exceptions 02 and 03 stand for each other",
        of_functions(REQUESTS, byte(2, lambda c: {2: 3, 3: 2}.get(c, c)), exceptions=True),
        MODBUS,
    ),
    fault(
        "exception-without-bit",
        "exception",
        "exceptions lack the high bit of the function",
        of_functions(REQUESTS, byte(mks.FUNCTION, lambda f: f & 0x7F), exceptions=True),
        MODBUS,
    ),
    fault("function-03-reads", "function", "03h reads as 04h does", translated(mks.as_04), MODBUS),
    fault(
        "register-low-byte-only",
        "address",
        "only the low byte of a register is looked at",
        translated(mks.low_byte_register),
        MODBUS,
    ),
)

FAULTS: tuple[Fault, ...] = (*HEARING, *REPLIES, *SETTING, *MOTION, *COMPLETION, *FUNCTIONS)
