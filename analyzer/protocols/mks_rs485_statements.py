"""What the RS485 manual V1.0.5 of the MKS SERVO42D/57D says a drive does: Parts 4 to 7, native frames.

In the manual's order, in our words, as `mks_rs485_errata` reads it where it contradicts itself. What the manual says of both
links stands in `mks_shared_statements`. What a remark repeats for each command of a kind is said there once for each.

Not here: what the manual says about wiring, keys, host software and its figures, where a drive does nothing by it.
"""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.catalogue import Statement
from analyzer.protocols.mks_shared_statements import (
    CURRENT_UNSEEN,
    DISPLAY,
    KEYS,
    RAMPS,
    RUNS,
    SHARED,
    each,
    effects,
    read,
    said,
    unseen,
)


def setting(section: str, name: str, what: str, *more: Statement) -> Iterator[Statement]:
    """Yield what each setting's section says: its values, its two answers; then what it does."""
    yield said(f"{section}/values", what, f"ranges/{name}/*")
    yield said(
        f"{section}/done", "Status 1: it was set.", f"shape/{name}/status", f"shape/{name}/answered", f"shape/{name}/once"
    )
    yield said(f"{section}/refused", "Status 0: it was not set, and nothing changed.", f"ranges/{name}/*")
    yield from effects(section, name)
    yield from more


_LONG_READS = (
    *read(
        "5.1.1",
        "read_encoder_carry",
        "30 reads the carry in four bytes and the value in two.",
        "motion/read_encoder_carry/standing",
    ),
    said("5.1.1/carries-up", "Above 3FFFh the carry is one more.", "motion/read_encoder_carry/*"),
    said("5.1.1/carries-down", "Below 0 the carry is one less.", "motion/read_encoder_carry/*"),
    *read("5.1.2", "read_position", "31 reads the encoder as one signed count of six bytes.", "motion/read_position/wide"),
    said("5.1.2/below-zero", "It goes on below zero.",
        "motion/read_encoder_carry/standing", "motion/move_absolute_axis/reads-as-asked"),
    *read("5.1.3", "read_speed", "32 reads the speed in rpm, in two signed bytes.", "motion/read_speed/crossed"),
    said("5.1.3/code", "Its reply carries code 32.", "shape/read_speed/code"),
    *read("5.1.4", "read_pulses", "33 reads how many pulses came, in four signed bytes.", "motion/read_pulses/counts-*"),
    *read("5.1.5", "read_io", "34 reads the ports, one bit each.", "read-back/set_limit_remap/effect", "motion/read_io/*"),
    said("5.1.5/reserved", "Bits 7 to 4 are reserved.", "shape/read_io/reserved"),
    said("5.1.5/in-1", "Bit 0 is the level of IN_1.", "motion/read_io/in_1"),
    *read("5.1.6", "read_angle_error", "39 reads the angle error in four signed bytes.", "motion/read_angle_error/*"),
    *read("5.1.7", "read_enabled", "3A reads 1 when the motor is enabled and 0 when not.", "motion/enable/is-read"),
    *read("5.1.8", "read_zero_status", "3B reads how the way back to zero goes.", "motion/read_zero_status/*"),
    said("5.1.8/going", "0: on its way to zero.", "motion/read_zero_status/tells", "read-back/set_zero_mode/restart"),
    said("5.1.8/success", "1: back at zero.", "motion/read_zero_status/tells", "read-back/set_zero_mode/restart"),
    said("5.1.9/releases", "3D ends the protection of a locked rotor.", "motion/release_protection/*"),
    said("5.1.9/status", "It is answered by 1, or by 0 when that fails.", "shape/release_protection/status"),
    *read(
        "5.1.10",
        "read_protection",
        "3E reads 1 while protected, else 0.",
        "motion/set_protection/lets-go",
        "motion/read_protection/at-first",
    ),
)  # fmt: skip

_SETTINGS = (
    said("5.2.1/calibrates", "80 with data 00 calibrates the encoder.", "motion/calibrate/status", "ranges/calibrate/reserved"),
    said("5.2.1/begins", "Status 0: the calibration goes on.", "motion/calibrate/replies"),
    said("5.2.1/done", "Status 1: the calibration is done.", "motion/calibrate/replies"),
    said("5.2.1/fails", "Status 2: the calibration failed, as under a load.", "motion/calibrate/held"),
    *setting(
        "5.2.2",
        "set_work_mode",
        "82 sets the work mode, 0 to 5.",
        said("5.2.2/serial", "In modes 3 to 5 the bus moves the motor.", "read-back/set_work_mode/effect"),
        said("5.2.2/pulses", "In modes 0 to 2 pulses do.", "motion/*/pulse-mode"),
        said("5.2.2/maximum", "A mode has its own highest speed.", "motion/run_speed/highest-sr_*", "motion/*/mode-limit"),
        unseen("5.2.2/current", "A mode sets whether the current is fixed or adapts.", CURRENT_UNSEEN),
    ),
    *setting("5.2.3", "set_current", "83 sets the working current in mA, in two bytes."),
    *setting(
        "5.2.4",
        "set_holding_current",
        "9B sets the holding current, 0 to 8.",
        unseen("5.2.4/percent", "0 is 10 percent, each step 10 more.", CURRENT_UNSEEN),
        unseen("5.2.4/not-vfoc", "It counts in open and close modes only.", CURRENT_UNSEEN),
    ),
    *setting(
        "5.2.5",
        "set_subdivision",
        "84 sets the subdivision in one byte, 0 being 256.",
        said("5.2.5/256", "Value 0 means 256 subdivisions.", "motion/set_subdivision/pulses-at-256"),
        unseen("5.2.5/shown", "The display shows the new subdivision.", DISPLAY),
    ),
    *setting("5.2.6", "set_enable_level", "85 sets the level of En: low, high, always."),
    *setting("5.2.7", "set_direction", "86 sets the direction: 0 CW, 1 CCW."),
    *setting(
        "5.2.8",
        "set_screen_off",
        "87 switches the display's going dark off (0) or on (1).",
        unseen("5.2.8/dark", "The display goes dark after 15 seconds.", DISPLAY),
    ),
    *setting("5.2.9", "set_protection", "88 switches the rotor's protection off (0) or on (1)."),
    *setting("5.2.10", "set_interpolation", "89 switches interpolation off (0) or on (1)."),
    *setting("5.2.11", "set_baud_rate", "8A sets the baud rate, 1 to 7."),
    *setting("5.2.12", "set_address", "8B sets the address, up to FFh."),
    *setting(
        "5.2.13",
        "set_respond",
        "8C sets respond and active, 0 or 1 each.",
        said("5.2.13/default", "Both are 1 by default.", "read-back/restore/settings"),
        said("5.2.13/silent", "With respond 0 motion is executed and not answered.", "motion/set_respond/0-silences-*"),
        said("5.2.13/read", "With respond 0 the status F1 is still answered.", "motion/set_respond/0-leaves-reads"),
        said("5.2.13/passive", "With active 0 the beginning is answered and the end is not.", "motion/set_respond/inactive-*"),
        said("5.2.13/end", "With both 1 the end is answered by 2, or 3 at an end limit.",
            "motion/*/replies", "motion/set_home/end-limit-told-*", "motion/set_respond/1-answers-again",
            "addressing/others-asked/ends-told"),
        said("5.2.13/start", "Motion is answered at once by 1, or by 0 when it fails.",
            "timing/*/answered-soon", "motion/*/disabled"),
    ),
    *setting(
        "5.2.14",
        "set_modbus",
        "8E switches Modbus-RTU off (0) or on (1).",
        said("5.2.14/speaks", "With 1 the drive speaks Modbus-RTU instead.", "ranges/set_modbus/modbus/listed"),
    ),
    *setting("5.2.15", "set_key_lock", "8F unlocks (0) or locks (1) the keys."),
    *setting(
        "5.2.16",
        "set_group_address",
        "8D sets the group address, 1 to FFh.",
        said("5.2.16/own", "A drive of a group executes what its own address is sent.",
            "addressing/group/own", "examples/move_relative_pulses/*"),
        said("5.2.16/all", "What address 0 is sent, every drive executes.",
            "addressing/broadcast/executed", "examples/*/to_all_1"),
        said("5.2.16/group", "What the group address is sent, the group's drives execute.",
            "addressing/group/*_*/*", "addressing/group/executed", "addressing/group/while-turning",
            "read-back/settings/restart-group", "read-back/*/restart-group-*", "examples/*/to_group_*"),
        said("5.2.16/others", "What another group is sent, a drive does not execute.",
            "addressing/group/other", "addressing/group/*_*/*"),
        said("5.2.16/silent", "What a group is sent is not answered.",
            "addressing/group/silent", "addressing/group/ends-by-itself/*", "addressing/group/read", "addressing/group/set_*",
            "addressing/group/outcomes"),
    ),
    # 5.3 Home
    *setting("5.3.1", "set_home", "90 sets trigger level, direction, speed and end limit."),
    said("5.3.2/homes", "91 looks for home.", "motion/home/finds-switch-*", "motion/home/zero"),
    *effects("5.3.2", "home"),
    said("5.3.2/fails", "Status 0: homing failed.", "motion/home/disabled", "motion/home/off"),
    said("5.3.2/starts", "Status 1: homing starts.", "motion/home/replies"),
    said("5.3.2/done", "Status 2: home is found.", "motion/home/replies", "motion/home/told-though"),
    said("5.3.3/zero", "92 makes the present place zero.", "motion/set_zero/*"),
    said("5.3.3/stands", "92 does not move the motor.", "motion/set_zero/stands"),
    said("5.3.3/status", "It is answered by 1, or by 0 when that fails.", "shape/set_zero/status"),
    *setting(
        "5.3.4",
        "set_no_limit_home",
        "94 sets the way back, the method and the current of homing.",
        said("5.3.4/obstacle", "Method 1 homes against an obstacle, without a switch.", "motion/home/without-switch-*"),
        said("5.3.4/method-0", "Method 0 homes by the switch.", "motion/home/finds-switch-*"),
        said("5.3.4/back", "From the obstacle the shaft goes back by the angle: 4000h is a turn.",
            "motion/home/without-switch-*"),
        said("5.3.4/zero", "Where it ends is zero.", "motion/home/without-switch-*"),
        said("5.3.4/default", "By default the way back is 2000h.", "read-back/restore/settings"),
        unseen("5.3.4/current", "The shaft pushes with this current and no more.", CURRENT_UNSEEN),
        unseen("5.3.4/defaults", "Default currents: 42D 800, 57D 400, others 200 mA.", CURRENT_UNSEEN),
    ),
    *setting("5.3.5", "set_limit_remap", "9E switches the remapped ports off (0) or on (1)."),
    # 5.4 to 5.6
    *setting("5.4.1", "set_zero_mode", "9A sets mode, zero, speed and direction of the way back."),
    said("5.5/defaults", "3F puts every parameter back to its default.",
        "read-back/restore/settings", "read-back/restore/link"),
    said("5.5/status", "It is answered by 1, or by 0 when that fails.", "shape/restore/status"),
    said("5.5/reboots", "Then the drive starts again.", "read-back/restore/reboots"),
    unseen("5.5/uncalibrated", "Then the motor needs a calibration.", "no command tells whether the motor is calibrated"),
    unseen("5.5/key", "A key held at power-on restores the defaults.", KEYS),
    said("5.6/restarts", "41 starts the drive again.",
        "motion/restart/ends-motion*", "timing/restart/*", "read-back/restart/*"),
    said("5.6/status", "It is answered by 1, or by 0 when that fails.", "shape/restart/status"),
    # 5.7 Packages
    said("5.7/five", "A package holds up to five commands; each drive takes its own by the address.",
        "addressing/package/move_*", "addressing/package/run_speed", "addressing/package/own_slot",
        "addressing/package/last_of_five"),
    said("5.7/slots", "Each of the five slots is executed.",
        "addressing/package/*/every-slot", *(f"addressing/package/slot_{n}" for n in range(1, 6))),
    said("5.7/settings", "A slot holds any ordinary command, without head and checksum.",
        "addressing/package/enable", "addressing/package/home", "addressing/package/set_*", "addressing/package/as-sent",
        "read-back/settings/restart-package", "read-back/*/restart-package-*", "read-back/save_speed/package"),
    said("5.7/length", "A package has 52 bytes.", "addressing/package/length", "addressing/package/broken_off"),
    said("5.7/zeros", "A short command is filled up with zeros to ten bytes.",
        "addressing/package/own_slot", "addressing/package/slot_*"),
    said("5.7/checksum", "A package ends in its checksum.", "addressing/package/checksum", "addressing/package/damaged"),
    said("5.7/first", "Of two commands for one drive only the first is executed.", "addressing/package/first_of_two"),
    said("5.7/silent", "A package is not answered.", "addressing/package/silent", "addressing/package/ends-by-itself/*"),
    said("5.7/others", "Slots of other drives are not executed.", "addressing/package/others"),
    said("5.7/example", "The printed package moves five motors in five ways.", "examples/long_package/1"),
)  # fmt: skip

_FRAMES = (
    said("4/heads", "Requests begin with FA, replies with FB.", "framing/head/*", "shape/*/head"),
    said("4/address", "A drive executes and answers what its own address is sent.", "addressing/other/*", "shape/*/address"),
    said("4/addresses", "Addresses are 0 to 255; the default is 1.",
        "ranges/set_address/new_address/*", "read-back/restore/link"),
    said("4/broadcast", "Address 0 reaches every drive.",
        "addressing/broadcast/*_*/*", "addressing/broadcast/executed", "addressing/broadcast/while-turning",
        "addressing/broadcast/protection", "addressing/broadcast/set_*", "read-back/settings/restart-broadcast",
        "read-back/*/restart-broadcast-*"),
    said("4/broadcast-silent", "What address 0 is sent is not answered.",
        "addressing/broadcast/read", "addressing/broadcast/silent", "addressing/broadcast/ends-by-itself/*"),
    said("4/code", "The code says which command is executed, and the reply repeats it.",
        "shape/*/code", "framing/unknown_code/ignored"),
    said("4/check", "The check is the low byte of the sum of all bytes before.",
        "framing/checksum_*/ignored", "shape/*/checksum"),
    said("4/check-motion", "Motion with a wrong check is not executed.",
        "framing/checksum_bit/not_executed", "framing/flipped_bit/not_executed", "framing/*/wrong_check"),
    said("4/other-motion", "Motion for another address is not executed.",
        "addressing/*/other_address", "addressing/other/set_subdivision", "addressing/other/not_executed",
        "addressing/group/other"),
    said("4/answered", "Every request is answered, once.",
        "shape/*/answered", "shape/*/once", "resilience/*", "traffic/answered"),
    said("4/unasked", "A drive that is asked nothing says nothing.", "shape/unasked", "traffic/asked_for"),
)  # fmt: skip


def _stop(section: str, name: str, code: str) -> Iterator[Statement]:
    yield said(f"{section}/ramp", f"{code} with speed 0 and an acceleration slows the shaft down.", f"motion/{name}/by-ramp")
    yield said(f"{section}/at-once", f"{code} with speed 0 and acceleration 0 stops at once.", f"motion/{name}/at-once")
    yield said(f"{section}/stays", "The shaft then stands.", f"motion/{name}/stays-stopped")
    yield said(f"{section}/starts", "Status 1: it begins to stop.", f"motion/{name}/replies")
    yield said(f"{section}/done", "Status 2: the shaft stands.", f"motion/{name}/replies", f"motion/{name}/told-when-standing")
    yield said(f"{section}/fails", "Status 0: the stop failed.", f"motion/{name}/pulse-mode", f"shape/{name}/status")
    yield said(f"{section}/silent", "Its answers can be switched off by 8C.", f"motion/set_respond/0-silences-{name}")


def _move(section: str, name: str, code: str, *more: Statement) -> Iterator[Statement]:
    yield said(
        f"{section}/speed",
        f"{code} turns the shaft at the speed, 0 to 3000.",
        f"motion/{name}/crossed-speed",
        f"ranges/{name}/speed/*",
    )
    yield said(
        f"{section}/acceleration",
        "It takes the ramp of its acceleration, up and down.",
        f"timing/{name}/takes-*",
        f"motion/{name}/crossed-course",
        f"motion/{name}/within",
    )
    yield from effects(section, name)
    yield from more
    yield said(
        f"{section}/fails",
        "Status 0: it was not executed.",
        f"motion/{name}/disabled",
        f"motion/{name}/protected",
        "motion/release_protection/limp",
    )
    yield said(f"{section}/starts", "Status 1: it begins.", f"motion/{name}/replies")
    yield said(f"{section}/complete", "Status 2: it is complete.", f"motion/{name}/*replies", f"motion/{name}/told-when-there")
    yield said(f"{section}/limit", "Status 3: an end limit stopped it.", f"motion/set_home/end-limit-told-{name}")
    yield said(f"{section}/silent", "Its answers can be switched off by 8C.", f"motion/set_respond/0-silences-{name}")


_MOTION = (
    said("6/serial", "Motion commands need a serial work mode.", "motion/*/crossed-taken", "motion/*/pulse-mode"),
    *RAMPS,
    said("6.2.1/answered", "F1 reads what the motor does.", "shape/read_status/answered", "motion/read_status/follows"),
    *effects("6.2.1", "read_status"),
    said("6.2.1/calibrating", "6 (printed 5): it is calibrating.", "motion/calibrate/status"),
    said("6.2.2/off", "F3 with 0 lets the motor go.", "motion/enable/off-ends-mo*", "motion/enable/is-read"),
    said("6.2.2/on", "F3 with 1 makes it hold.",
        "motion/enable/is-read", "motion/enable/on-holds-here", "read-back/enable/effect"),
    said("6.2.2/status", "It is answered by 1, or by 0 when that fails.", "shape/enable/status", "ranges/enable/enabled/*"),
    said("6.2.2/disabled-motion", "A disabled motor is not turned by any motion command.",
        *each(RUNS, "motion/{}/disabled"), "motion/*/disabled", "motion/home/disabled"),
    said("6.3/stops", "F7 stops the motor at once.", "motion/emergency_stop/ends-*", "motion/calibrate/halted"),
    said("6.3/status", "It is answered by 1, or by 0 when that fails.", "motion/emergency_stop/replies"),
    said("6.4/broadcast", "By address 0 all motors execute the same.",
        "addressing/broadcast/*_*/*", "addressing/broadcast/executed", "read-back/save_speed/broadcast"),
    said("6.4/group", "By group addresses the motors of each group execute the same.",
        "addressing/group/*_*/*", "addressing/group/executed", "read-back/save_speed/group"),
    said("6.4/package", "By a package each motor executes its own.", "addressing/package/own_slot"),
    # 6.5 Speed
    said("6.5.1/runs", "F6 turns the shaft at a fixed speed and acceleration.",
        "motion/run_speed/speed-*", "motion/run_speed/lasts"),
    said("6.5.1/way", "The highest bit of byte 4 is the direction: 0 CCW, 1 CW.",
        "motion/run_speed/opposite", "motion/run_speed/raises"),
    said("6.5.1/speed", "The speed has 12 bits, in bytes 4 and 5.", "ranges/run_speed/speed/*"),
    said("6.5.1/acceleration", "The acceleration is 0 to 255.", "ranges/run_speed/acceleration/*", "timing/run_speed/ramp-*"),
    said("6.5.1/reserved", "Bits 6 to 4 of byte 4 are reserved.", "ranges/run_speed/reserved"),
    said("6.5.1/forward", "01 40 02 turns it forward at 320 rpm.", "examples/run_speed/1"),
    said("6.5.1/reverse", "81 40 02 turns it backward at 320 rpm.", "examples/run_speed/2"),
    said("6.5.1/status", "It is answered by 1, or by 0 when that fails.",
        "motion/run_speed/crossed-replies", "motion/run_speed/disabled"),
    said("6.5.1/silent", "Its answers can be switched off by 8C.", "motion/set_respond/0-silences-run_speed"),
    *_stop("6.5.2", "stop_speed", "F6"),
    said("6.5.3/save", "FF with C8 keeps the present run.",
        "read-back/save_speed/power", "read-back/save_speed/restart", "read-back/save_speed/as-it-was"),
    said("6.5.3/clean", "FF with CA forgets the kept run.", "read-back/save_speed/clean"),
    said("6.5.3/status", "It is answered by 1 or 2, or by 0 when that fails.",
        "shape/save_speed/status", "examples/save_speed/1"),
    said("6.5.3/power-on", "With a kept run the motor turns when power comes on, either way.",
        "read-back/save_speed/power", "read-back/save_speed/no-sooner"),
    # 6.6 to 6.9 Positions
    *_move(
        "6.6.1",
        "move_relative_pulses",
        "FD",
        said("6.6.1/way", "The highest bit of byte 4 is the direction.",
            "motion/move_relative_pulses/opposite", "motion/run_speed/same-sense"),
        said("6.6.1/reserved", "Bits 6 to 4 of byte 4 are reserved.", "ranges/move_relative_pulses/reserved"),
        said("6.6.1/20-turns", "FA00h pulses are 20 turns at 16 subdivisions.",
            "examples/move_relative_pulses/*", "motion/move_relative_pulses/distance",
            "motion/move_relative_pulses/behind-ended"),
        said("6.6.1/subdivision", "A turn has 3200 pulses at 16 subdivisions.", "motion/set_subdivision/pulses-at-16"),
    ),
    *_stop("6.6.2", "stop_relative_pulses", "FD"),
    *_move(
        "6.7.1",
        "move_absolute_pulses",
        "FE",
        said("6.7.1/anywhere", "It goes there from any place.",
            "motion/move_absolute_pulses/again", "motion/move_absolute_pulses/same-place"),
        said("6.7.1/below-zero", "FFFFC000h is -4000h.",
            "motion/move_absolute_pulses/reads-as-asked", "examples/move_absolute_pulses/2"),
    ),
    *_stop("6.7.2", "stop_absolute_pulses", "FE"),
    *_move(
        "6.8.1",
        "move_relative_axis",
        "F4",
        said("6.8.1/axis", "The axis is the value that 31 reads.", "motion/move_relative_axis/sign"),
        said("6.8.1/forward", "From 8000h by 4000h it ends at C000h.",
            "examples/move_relative_axis/1", "motion/move_relative_axis/sign"),
        said("6.8.1/back", "From 8000h by -4000h it ends at 4000h.",
            "examples/move_relative_axis/2", "motion/move_relative_axis/opposite"),
    ),
    *_stop("6.8.2", "stop_relative_axis", "F4"),
    *_move(
        "6.9.1",
        "move_absolute_axis",
        "F5",
        said("6.9.1/axis", "The axis is the value that 31 reads.",
            "motion/move_absolute_axis/sign", "motion/move_absolute_axis/reads-as-asked"),
        said("6.9.1/anywhere", "It goes there from any place.",
            "motion/move_absolute_axis/again", "motion/move_absolute_axis/same-place"),
        said("6.9.1/below-zero", "FFFFC000h is -4000h.",
            "motion/move_absolute_axis/reads-as-asked", "examples/move_absolute_axis/2"),
    ),
    *_stop("6.9.2", "stop_absolute_axis", "F5"),
    # Part 7
    said("7.3/read", "FA 01 30 2B reads carry -1 and value 2269h in six bytes.", "examples/read_encoder_carry/*"),
    said("7.4/run", "FA 01 F6 01 40 02 is answered by status 1.", "examples/run_speed/*"),
    said("7.4/save", "FA 01 FF C8 is answered by status 1.", "examples/save_speed/1"),
    said("7.4/stop", "FA 01 F6 00 00 02 stops the motor.", "examples/stop_speed/*"),
    said("7.4/power-on", "Then the motor turns as was kept when power comes on.", "read-back/save_speed/power"),
    said("7.5/200-turns", "9C400h pulses are 200 turns, told by 1 and then by 2.",
        "examples/move_relative_pulses/*", "motion/move_relative_pulses/replies"),
    said("7.5/1000-turns", "30D400h pulses the other way are 1000 turns.",
        "examples/move_relative_pulses/*", "motion/move_relative_pulses/opposite"),
    said("7.5/stop", "A stop under way is told by 1 and then by 2.",
        "motion/stop_relative_pulses/replies", "examples/stop_relative_pulses/*"),
)  # fmt: skip

_NO_SWITCH = (
    said("3.13/silent", "UartRSP silences the answers of speed and position commands.", "motion/set_respond/0-silences-*"),
    said("3.13/status", "F1 still tells what the motor does.", "motion/set_respond/0-leaves-reads"),
    said("3.22/no-limit", "With noLimit the shaft turns until an obstacle stops it.", "motion/home/without-switch-*"),
    said("3.22/back", "Then it goes back by the set angle, and that point is zero.", "motion/home/without-switch-*"),
    unseen("3.23/current", "Hm_Ma is the current of homing without a switch.", CURRENT_UNSEEN),
    said("3.25/zero", "Where homing ends is zero.", "motion/home/zero"),
)

STATEMENTS = (*SHARED, *_NO_SWITCH, *_FRAMES, *_LONG_READS, *_SETTINGS, *_MOTION)
