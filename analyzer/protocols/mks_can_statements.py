"""What the CAN manual V1.0.1 says a drive does, sentence by sentence, in its order.

A statement's claims are those that refute a drive which does the opposite. What the manual says of wiring, menus and host
programs stands here only where it says what a drive does. Where it contradicts itself, the reading is that of
`mks_can_errata`.
"""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.catalogue import Statement
from analyzer.protocols.mks_shared_statements import said, unseen

_DISPLAY = "not visible on the bus: lights"
_ELECTRIC = "not visible on the bus: an electric property"
_PULSES = "the suite sends no pulses: these ports are not on the bus"
_HEAT = "not visible on the bus: a property of the motor"


def _tables(section: str, command: str, sent: str, answered: str) -> Iterator[Statement]:
    """Yield what the two tables of a command say: its request and its reply."""
    yield said(f"{section}/request", f"The request is {sent}.", f"shape/{command}/answered", f"shape/{command}/code")
    yield said(
        f"{section}/reply",
        f"It is answered once, under its own ID and code, with {answered}.",
        *(f"shape/{command}/{part}" for part in ("once", "address", "code", "length", "checksum")),
    )


def _setting(section: str, command: str, sent: str, *fields: str) -> Iterator[Statement]:
    """Yield what the manual says of a setting whose values are listed or limited, and whose replies are 1 and 0."""
    yield from _tables(section, command, sent, "a status of one byte")
    yield said(
        f"{section}/status-1",
        "Status 1 says that it is set.",
        f"read-back/{command}/read",
        *(f"ranges/{command}/{f}/[hil]*" for f in fields),
    )
    yield said(f"{section}/status-0", "Status 0 says that it is not set.", *_refusals(command, *fields))
    yield said(f"{section}/alone", "It sets this and nothing else.", "resilience/settings/*")
    yield said(
        f"{section}/kept",
        "What was set is a stored parameter: a restart and a loss of power leave it.",
        "read-back/settings/restart*",
        f"read-back/{command}/power",
    )


def _refusals(command: str, *fields: str) -> Iterator[str]:
    for field in fields:
        yield f"ranges/{command}/{field}/[abu]*"
    if len(fields) > 1:
        yield f"ranges/{command}/at-corners"


def _move(
    section: str, name: str, sent: str, ranged: str, examples: str, goes: Statement, *more: Statement
) -> Iterator[Statement]:
    """Yield what a section about a move says: where it goes, how fast, within which range, and what is answered."""
    field = "pulses" if name == "move_relative_pulses" else "position"
    told = (f"motion/{name}/crossed-replies",) if "relative" in name else ()
    yield from _tables(section, name, sent, "a status of one byte")
    yield goes
    yield said(f"{section}/ends-there", "It ends there at any speed.", f"motion/{name}/within", f"motion/{name}/crossed-ends")
    yield from more
    yield said(
        f"{section}/speed",
        "It turns at the speed and by the ramp that are sent.",
        f"motion/{name}/crossed-speed",
        f"timing/{name}/takes-*",
        f"ranges/{name}/speed/width",
    )
    width = (f"ranges/{name}/{field}/width", f"motion/{name}/low-word")
    yield said(f"{section}/range", ranged, f"ranges/{name}/{field}/*", *told, *width)
    yield said(f"{section}/examples", examples, f"examples/{name}/*")
    yield said(
        f"{section}/status",
        "Status 1 says that it begins, and 2 that it is done.",
        f"motion/{name}/replies",
        f"motion/{name}/told-when-there",
    )
    yield said(
        f"{section}/status-0", "Status 0 says that it does not run.", f"motion/{name}/disabled", f"motion/{name}/protected"
    )
    yield said(f"{section}/status-3", "Status 3 says that an end limit stopped it.", f"motion/set_home/end-limit-told-{name}")


def _stop(section: str, name: str, sent: str) -> Iterator[Statement]:
    """Yield what a section about the stop of a move says."""
    yield from _tables(section, name, sent, "a status of one byte")
    yield said(
        f"{section}/ramp",
        "With an acceleration the shaft slows down by the ramp and stands.",
        f"motion/{name}/by-ramp",
        f"timing/{name}/told-in-time",
    )
    yield said(f"{section}/at-once", "With acceleration 0 it stands at once.", f"motion/{name}/at-once")
    yield said(f"{section}/stays", "It then stays where it is.", f"motion/{name}/stays-stopped")
    yield said(f"{section}/examples", "The frames of the manual stop the shaft.", f"examples/{name}/*")
    yield said(
        f"{section}/status",
        "Status 1 says that it begins to stop, 2 that it stands, 3 that a limit stopped it.",
        f"motion/{name}/replies",
        f"motion/{name}/told-when-standing",
    )


STATEMENTS: tuple[Statement, ...] = (
    # Part 1: the product
    said(
        "1.1/position-feedback",
        "The drive goes by the position of its encoder, so that no steps are lost.",
        "motion/*/again",
        "motion/read_angle_error/held-*",
    ),
    said(
        "1.2/modes",
        "Pulses or the bus run the motor, in open or closed loop.",
        "ranges/set_work_mode/work_mode/listed",
        "motion/run_speed/highest-*",
        "motion/*/pulse-mode",
    ),
    said("1.2/ramps", "Speeds rise and fall by a ramp.", "timing/run_speed/ramp-*", "timing/stop_speed/ramp-*"),
    unseen(
        "1.2/zeroing-in-a-turn",
        "The drive can go back to a zero within one turn.",
        "no command of this manual does it (mks-can-08)",
    ),
    said("1.2/zeroing", "The drive finds its zero over several turns by an end stop.", "motion/home/finds-switch-*"),
    said("1.2/zero-here", "The present position can be made zero.", "motion/set_zero/*"),
    said(
        "1.2/moves",
        "Positions are relative or absolute.",
        "motion/move_relative_*/distance",
        "motion/move_absolute_*/reads-as-asked",
    ),
    said("1.2/subdivision", "A full step has up to 256 subdivisions.", "motion/set_subdivision/pulses-at-256"),
    unseen("1.2/pulse-frequency", "Pulses come at up to 300 kHz.", _PULSES),
    said("1.2/speed", "The highest speed is 3000 rpm.", "motion/*/crossed-speed", "ranges/*/speed/above"),
    said(
        "1.2/angle-while-free",
        "The angle is kept up to date, whether the motor is enabled or not.",
        "motion/read_position/while-disabled",
    ),
    said(
        "1.2/stall-protection",
        "A stalled motor is protected.",
        "motion/set_protection/lets-go*",
        "motion/release_protection/limp*",
    ),
    said("1.2/restore", "The drive can be put back to the state of its delivery.", "read-back/restore/settings"),
    said("1.2/emergency-stop", "The motor can be stopped at once.", "motion/emergency_stop/ends-*"),
    said(
        "1.2/limits",
        "Limits to the left and to the right can stop the motor.",
        "motion/set_home/end-limit-stops-*",
        "motion/set_limit_remap/right-on",
    ),
    said(
        "1.2/addresses",
        "A drive has an ID of its own, and hears a broadcast ID and a group ID.",
        "addressing/other/*",
        "addressing/broadcast/executed",
        "addressing/group/executed",
    ),
    unseen("1.2/voltage", "The supply is 20 to 60 V.", _ELECTRIC),
    unseen(
        "1.3/loops",
        "The loops of torque, speed and position run at 20, 10 and 10 kHz.",
        "not visible on the bus: faster than frames follow one another",
    ),
    said("1.3/current", "The working current is 0 to 3000 mA on a 42E, 0 to 5200 mA on a 57E.", "ranges/set_current/current/*"),
    said(
        "1.3/subdivisions",
        "The subdivisions are 2, 4, 5, 8, 10, 16, 20, 25, 32, 40, 50, 64, 100, 128, 200 and 256.",
        "ranges/set_subdivision/subdivision/*",
        "motion/set_subdivision/pulses-at-*",
    ),
    said("1.3/speed", "The speed goes up to 3000 rpm.", "motion/*/crossed-speed"),
    unseen("1.3/heat", "The motor runs quietly and stays cool.", _HEAT),
    unseen("1.3/pulse-inputs", "Pulse inputs take 3.3 to 24 V.", _ELECTRIC),
    said("1.3/rates", "The bus runs at 125, 250, 500 or 1000 kbit/s.", "ranges/set_bit_rate/bit_rate/*"),
    said(
        "1.3/addresses",
        "There are one broadcast ID and 2047 IDs of drives.",
        "ranges/set_address/new_address/*",
        "addressing/broadcast/executed",
    ),
    unseen(
        "1.4/alarm-output",
        "The output ALM closes at an alarm.",
        "what raises an alarm is not in the manual's commands; its bit is 3.1.5's",
    ),
    said(
        "1.4/in-position-output",
        "The output PEND tells that the shaft has arrived.",
        "motion/read_io/in-position-at-rest",
        "motion/read_io/not-in-position-while-moving",
    ),
    said(
        "1.4/42e-input",
        "On a 42E, IN is the home switch or left limit.",
        "motion/home/finds-switch-*",
        "motion/set_home/end-limit-stops-*",
    ),
    said(
        "1.4/42e-right-limit",
        "On a 42E, En can be remapped to be the right limit.",
        "read-back/set_limit_remap/effect",
        "motion/set_limit_remap/right-*",
    ),
    unseen("1.4/remap-ends-pulse-control", "With En remapped, pulse control no longer works.", _PULSES),
    said(
        "1.4/57e-inputs",
        "On a 57E, IN2 is the home switch or left limit, and IN1 the right limit.",
        "motion/home/finds-switch-*",
        "motion/set_limit_remap/right-off",
    ),
    unseen("1.5/pulse-inputs", "A falling edge of STP is a step; 3.3 to 28 V, 400 kHz, 2.5 us.", _PULSES),
    unseen("1.5/pulse-kind", "A command sets whether pulses have a direction or two inputs.", _PULSES),
    said(
        "1.5/en-releases",
        "Where En is at the level that disables, the motor is released.",
        "read-back/set_enable_level/effect",
        "read-back/set_enable_level/pin",
    ),
    unseen(
        "1.5/en-clears-alarm",
        "En at the level that disables clears the alarm.",
        "the manual has no command that shows an alarm and its cause",
    ),
    said(
        "1.5/pend",
        "PEND is on when the motion that was asked for is done.",
        "motion/read_io/in-position-at-rest",
        "motion/read_io/not-in-position-while-moving",
    ),
    unseen("1.5/outputs", "Outputs bear 35 V and 50 mA.", _ELECTRIC),
    unseen("1.5/phases", "With phases connected otherwise the motor raises an alarm.", "wiring"),
    unseen(
        "1.6/lights", "Lights tell running, stop, over-current, open phase, voltage, position and encoder errors.", _DISPLAY
    ),
    unseen("2/resistance", "A phase has less than 10 ohms.", "wiring"),
    unseen("2.1/inputs", "Inputs limit their current to 10 mA.", _ELECTRIC),
    # Part 3: parameters
    said("3/default-id", "The ID is 1 by default.", "read-back/restore/link"),
    said(
        "3/check",
        "The last byte of a frame is a check over the ID and all before it.",
        "shape/*/checksum",
        "framing/checksum_bit/*",
        "framing/checksum_value/*",
        "framing/flipped_bit/*",
    ),
    said(
        "3/check-guards-motion",
        "A motion whose check does not fit is not carried out.",
        "framing/run_speed/wrong_check",
        "framing/move_*/wrong_check",
        "framing/checksum_bit/not_executed",
    ),
    *_tables("3.1.1", "read_encoder_carry", "30 without data", "carry (32 bits, signed) and value (16 bits)"),
    said(
        "3.1.1/value",
        "The value lies within a turn, 0 to 3FFFh.",
        "motion/read_encoder_carry/standing",
        "motion/read_encoder_carry/at-the-carry",
        "shape/read_encoder_carry/values",
    ),
    said(
        "3.1.1/carry-up",
        "Beyond 3FFFh the carry rises by one.",
        "motion/read_encoder_carry/standing",
        "motion/read_encoder_carry/at-the-carry",
    ),
    said(
        "3.1.1/carry-down",
        "Below 0 the carry falls by one.",
        "motion/read_encoder_carry/standing",
        "motion/read_encoder_carry/at-the-carry",
    ),
    said(
        "3.1.1/ccw-raises",
        "A turn counter-clockwise raises the carry by one and leaves the value.",
        "motion/read_encoder_carry/standing",
        "motion/run_speed/raises",
    ),
    said("3.1.1/cw-lowers", "A turn clockwise lowers the carry by one, below zero too.", "motion/read_encoder_carry/standing"),
    *_tables("3.1.2", "read_position", "31 without data", "a value of 48 bits, signed"),
    said("3.1.2/turn", "A turn changes the value by 4000h.", "motion/read_position/turn"),
    said(
        "3.1.2/ccw-raises",
        "Counter-clockwise raises the value, and clockwise lowers it.",
        "motion/run_speed/raises",
        "motion/move_*_axis/sign",
    ),
    said(
        "3.1.2/adds-up",
        "The value adds up over all turns, below zero too.",
        "motion/read_position/wide",
        "motion/read_encoder_carry/standing",
    ),
    *_tables("3.1.3", "read_speed", "32 without data", "a speed of 16 bits, signed"),
    said(
        "3.1.3/real-time",
        "It is the speed that the shaft has now, in rpm.",
        "motion/read_speed/crossed",
        "motion/read_speed/standing",
        "motion/run_speed/speed-*",
    ),
    said("3.1.3/sign", "Counter-clockwise it is above zero, clockwise below.", "motion/read_speed/crossed"),
    *_tables("3.1.4", "read_pulses", "33 without data", "a count of 32 bits, signed"),
    said(
        "3.1.4/received",
        "It counts the pulses that were received.",
        "motion/read_pulses/counts-moves",
        "motion/read_pulses/wide",
    ),
    *_tables("3.1.5", "read_io", "34 without data", "a byte of four ports"),
    said("3.1.5/reserved", "Bits 7 to 4 are reserved.", "shape/read_io/reserved", "traffic/reply_reserved"),
    said(
        "3.1.5/pend",
        "PEND is 1 in place and 0 on the way.",
        "motion/read_io/in-position-at-rest",
        "motion/read_io/not-in-position-while-moving",
    ),
    said("3.1.5/alm", "ALM is 1 without an alarm.", "motion/read_io/in-position-at-rest"),
    said("3.1.5/alm-0", "ALM is 0 with an alarm, as that of a locked rotor.", "motion/read_io/stall"),
    said(
        "3.1.5/inputs",
        "IN_1 and IN_2 are the levels of the switches.",
        "motion/read_io/shows-left-switch",
        "read-back/set_limit_remap/effect",
    ),
    said(
        "3.1.5/42e-en", "On a 42E, bit 1 is the level of En.", "motion/read_io/shows-enable-pin", "motion/read_io/is-enable-pin"
    ),
    *_tables("3.1.6", "read_angle_error", "39 without data", "an error of 32 bits, signed"),
    said(
        "3.1.6/wanted-minus-real",
        "It is the wanted angle minus that of the shaft.",
        "motion/read_angle_error/held-*",
        "motion/read_angle_error/standing",
    ),
    said("3.1.6/unit", "51200 are 360 degrees, so that 1 degree is 142.", "motion/read_angle_error/held-*"),
    *_tables("3.1.7", "read_enabled", "3A without data", "a byte"),
    said("3.1.7/values", "1 is enabled and 0 is disabled.", "motion/enable/is-read", "shape/read_enabled/values"),
    *_tables("3.1.8", "release_protection", "3D without data", "a status of one byte"),
    said("3.1.8/releases", "It ends the protection of a locked rotor.", "motion/release_protection/releases"),
    said("3.1.8/status-1", "Status 1 says that the protection is ended.", "motion/release_protection/releases"),
    unseen("3.1.8/status-0", "Status 0 says that it could not be ended.", "the manual names nothing that prevents it"),
    *_tables("3.1.9", "read_protection", "3E without data", "a status of one byte"),
    said("3.1.9/protected", "1 is protected.", "motion/set_protection/lets-go"),
    said("3.1.9/not-protected", "0 is not protected.", "motion/read_protection/at-first", "motion/release_protection/releases"),
    *_tables("3.2.1", "calibrate", "80 with a byte 00", "a status of one byte"),
    said("3.2.1/status-0-and-1", "Status 0 says that it goes on, and 1 that it is done.", "motion/calibrate/replies"),
    said("3.2.1/status-2", "Status 2 says that it failed.", "motion/calibrate/held"),
    unseen(
        "3.2.1/what",
        "It finds which way the bare encoder counts as the motor turns clockwise.",
        "not visible on the bus: the wiring decides it",
    ),
    unseen("3.2.1/not-needed", "With phases as delivered no calibration is needed.", "wiring"),
    *_setting("3.2.2", "set_work_mode", "82 with a mode", "work_mode"),
    said(
        "3.2.2/values",
        "Modes are X0, 02, 03, X4 and 05, where X is 0 with an encoder and 1 without.",
        "ranges/set_work_mode/work_mode/listed",
        "ranges/set_work_mode/work_mode/unlisted",
    ),
    said(
        "3.2.2/pulse-modes",
        "In modes X0, 02 and 03 pulses run the motor, not the bus.",
        "motion/*/pulse-mode",
        "read-back/set_work_mode/effect",
    ),
    said(
        "3.2.2/bus-modes",
        "In modes X4 and 05 the bus runs the motor.",
        "motion/run_speed/highest-*",
        "motion/*/crossed-stops",
        "read-back/set_work_mode/effect",
    ),
    said("3.2.2/default", "Mode 03 is the default.", "read-back/restore/settings"),
    unseen("3.2.2/pulse-frequency", "In pulse modes the frequency is up to 300 kHz.", _PULSES),
    said("3.2.2/bus-speed", "In bus modes the speed is up to 3000 rpm.", "motion/run_speed/highest-*"),
    unseen(
        "3.2.2/no-encoder", "Without an encoder its value cannot be read.", "what is answered in place of the value is not said"
    ),
    *_setting("3.2.3", "set_current", "83 with 16 bits of mA", "current"),
    said(
        "3.2.3/limits",
        "The current goes up to 3000 mA on a 42E and 5200 mA on a 57E.",
        "ranges/set_current/current/highest",
        "read-back/set_current/ends",
        "ranges/set_current/current/above",
    ),
    said("3.2.3/default", "The default is 1600 mA on a 42E and 3200 mA on a 57E.", "read-back/restore/settings"),
    unseen("3.2.3/effect", "The motor works at this current.", "not visible on the bus: a current"),
    *_setting("3.2.4", "set_subdivision", "84 with a byte", "subdivision"),
    said(
        "3.2.4/values",
        "The values are 0, 2, 4, 5, 8, 10, 16, 20, 25, 32, 40, 50, 64, 100, 128 and 200.",
        "ranges/set_subdivision/subdivision/listed",
        "ranges/set_subdivision/subdivision/unlisted",
        "ranges/set_subdivision/subdivision/every",
        "ranges/set_subdivision/subdivision/round",
    ),
    said("3.2.4/256", "0 is 256 subdivisions.", "motion/set_subdivision/pulses-at-256", "motion/set_subdivision/speed-at-256"),
    said("3.2.4/default", "16 is the default.", "read-back/restore/settings"),
    said("3.2.4/pulses", "A turn has so many pulses for each of its 200 full steps.", "motion/set_subdivision/pulses-at-*"),
    *_setting("3.2.5", "set_enable_level", "85 with a byte", "enable_level"),
    said(
        "3.2.5/values",
        "0 is active at the low level, 1 at the high one, 2 is always.",
        "ranges/set_enable_level/enable_level/*",
        "read-back/set_enable_level/effect",
        "read-back/set_enable_level/pin",
    ),
    said("3.2.5/default", "Active at the low level is the default.", "read-back/restore/settings"),
    unseen("3.2.5/100-ms", "Pulses count again 100 ms after the setting.", _PULSES),
    said("3.2.5/pulse-modes-only", "It counts in pulse modes only.", "motion/set_enable_level/not-in-bus-modes"),
    *_setting("3.2.6", "set_direction", "86 with a byte", "motor_direction"),
    said(
        "3.2.6/values",
        "0 is clockwise and 1 counter-clockwise.",
        "ranges/set_direction/motor_direction/*",
        "motion/set_direction/and-the-bus",
    ),
    said("3.2.6/default", "Clockwise is the default.", "read-back/restore/settings"),
    said(
        "3.2.6/bus-too",
        "It turns motion by the bus too.",
        "motion/set_direction/and-the-bus",
        "motion/set_direction/and-move_*",
    ),
    unseen(
        "3.2.6/homing",
        "It may turn homing, which is motion by the bus, or leave it by HmDir.",
        "observed by motion/set_direction/and-home: which of the two is meant is not said",
    ),
    *_setting("3.2.7", "set_pulse_delay", "87 with a byte", "pulse_delay"),
    said("3.2.7/values", "Values are 0 to 3 for 0, 4, 20 and 40 ms.", "ranges/set_pulse_delay/pulse_delay/*"),
    said("3.2.7/default", "20 ms is the default.", "read-back/restore/settings"),
    unseen("3.2.7/delay", "Pulses are delayed by so long.", _PULSES),
    *_setting("3.2.8", "set_protection", "88 with a byte", "protection"),
    said("3.2.8/on", "1 protects a locked rotor.", "motion/set_protection/lets-go*", "motion/release_protection/limp*"),
    said("3.2.8/off", "0 does not.", "motion/set_protection/off-holds-on"),
    said("3.2.8/default", "The protection is on by default.", "read-back/restore/settings"),
    said("3.2.8/ends-by-3d", "3D ends the state of protection.", "motion/release_protection/releases"),
    unseen("3.2.8/ends-by-en", "En at the level that disables ends it too.", "the suite has no hand on the En pin of a drive"),
    *_setting("3.2.9", "set_stall_tolerance", "89 with 16 bits", "stall_tolerance"),
    said("3.2.9/range", "The tolerance is 0 to 7FFFh.", "ranges/set_stall_tolerance/stall_tolerance/*"),
    said("3.2.9/default", "64h is the default.", "read-back/restore/settings"),
    said(
        "3.2.9/lets-go",
        "When the error is beyond it, the protection lets the shaft go.",
        "motion/set_stall_tolerance/angle",
        "motion/set_protection/lets-go",
    ),
    said("3.2.9/unit", "64h is 180 degrees, C8h 360, and so on.", "motion/set_stall_tolerance/angle"),
    *_tables("3.2.10", "set_bit_rate", "8A with a byte", "a status of one byte"),
    said(
        "3.2.10/values",
        "Values are 0 to 3 for 125, 250, 500 and 1000 kbit/s.",
        "ranges/set_bit_rate/bit_rate/1*",
        "ranges/set_bit_rate/bit_rate/250000",
        "ranges/set_bit_rate/bit_rate/500000",
    ),
    said("3.2.10/default", "500 kbit/s is the default.", "read-back/restore/settings", "read-back/restore/link"),
    said(
        "3.2.10/status-0",
        "Status 0 says that it is not set.",
        "ranges/set_bit_rate/bit_rate/unlisted",
        "ranges/set_bit_rate/bit_rate/unchanged",
    ),
    *_tables("3.2.11", "set_address", "8B with 16 bits", "a status of one byte"),
    said(
        "3.2.11/set",
        "The drive is heard at the ID that was set.",
        "addressing/set_address/moves",
        "ranges/set_address/new_address/highest",
    ),
    said(
        "3.2.11/range",
        "The ID goes up to 7FFh.",
        "ranges/set_address/new_address/highest",
        "ranges/set_address/new_address/above",
    ),
    said("3.2.11/default", "1 is the default.", "read-back/restore/link"),
    said(
        "3.2.11/broadcast",
        "ID 0 is that of all drives.",
        "addressing/broadcast/executed",
        "ranges/set_address/new_address/below",
    ),
    said("3.2.11/kept", "A restart leaves the ID.", "read-back/set_address/restart"),
    *_setting("3.2.12", "set_respond", "8C with two bytes, respond and active", "respond", "active"),
    said("3.2.12/default", "Both are on by default.", "read-back/restore/settings"),
    said(
        "3.2.12/no-respond",
        "With respond 0 a motion is carried out and not answered at all.",
        "motion/set_respond/0-silences-*",
    ),
    said(
        "3.2.12/f1-tells",
        "With respond 0, F1 tells what the motor does.",
        "motion/set_respond/0-leaves-reads",
        "motion/set_respond/0-status-follows",
    ),
    said(
        "3.2.12/inactive",
        "With active 0 only the beginning of a motion is answered, by 1 or 0.",
        "motion/set_respond/inactive-*",
    ),
    said(
        "3.2.12/active",
        "With both on, the end of a motion is answered too, by 2, or by 3 at a limit.",
        "motion/*/replies",
        "motion/set_home/end-limit-told-*",
        "motion/set_respond/1-answers-again",
        "addressing/others-asked/ends-told",
    ),
    *_setting("3.2.13", "set_axis_lock", "8F with a byte", "axis_lock"),
    said(
        "3.2.13/locked",
        "With 1 the shaft is held when a bus mode begins.",
        "read-back/set_axis_lock/effect",
        "motion/set_axis_lock/at-power-on-1",
    ),
    said("3.2.13/unlocked", "With 0 it is free then.", "read-back/set_axis_lock/effect", "motion/set_axis_lock/at-power-on-0"),
    said("3.2.13/default", "The shaft is held by default.", "read-back/restore/settings"),
    *_setting("3.2.14", "set_group_address", "8D with 16 bits", "group_address"),
    said(
        "3.2.14/range",
        "A group ID is 1 to 7FFh.",
        "ranges/set_group_address/group_address/*",
        "addressing/set_address/shared-heard",
    ),
    said(
        "3.2.14/broadcast",
        "What is sent to ID 0 turns all drives.",
        "addressing/broadcast/*",
        "examples/move_relative_pulses/to_all_1",
    ),
    said(
        "3.2.14/own-id",
        "What is sent to the ID of one drive turns that one alone.",
        "addressing/*/other_address",
        "addressing/other/not_executed",
        "addressing/group/own",
    ),
    said(
        "3.2.14/group",
        "What is sent to a group ID turns the drives of that group, and no others.",
        "addressing/group/executed",
        "addressing/group/while-turning",
        "addressing/group/other",
        "addressing/group/settings",
        "read-back/settings/restart-group",
        "examples/move_relative_pulses/to_group_*",
    ),
    said(
        "3.2.14/silent",
        "A drive does not answer what is sent to its group.",
        "addressing/group/silent",
        "addressing/group/ends-by-itself/*",
        "addressing/group/read",
    ),
    *_tables("3.3", "write_io", "36 with a byte of masks and levels", "a status of one byte"),
    said(
        "3.3/write",
        "With mask 1 the port has the level that is written.",
        "read-back/write_io/effect",
        "read-back/write_io/each-port",
    ),
    said("3.3/keep", "With mask 2 the port stays as it is.", "read-back/write_io/effect", "read-back/write_io/each-port"),
    said(
        "3.3/give-back", "With mask 0 the port is that of its alarm or in-place signal again.", "read-back/write_io/gives-back"
    ),
    said(
        "3.3/status",
        "Status 1 says that it is written, 0 that it is not.",
        "ranges/write_io/*/listed",
        "ranges/write_io/*_mask/unlisted",
    ),
    *_setting(
        "3.4.1",
        "set_home",
        "90 with level, direction, speed, end limit and mode",
        "home_trigger",
        "home_direction",
        "home_speed",
        "end_limit",
        "home_mode",
    ),
    said(
        "3.4.1/level",
        "HmTrig is the level at which the end stop is closed: 0 low, 1 high.",
        "motion/home/trigger",
        "motion/home/finds-switch-*",
        "motion/home/from-closed-*",
        "motion/set_home/end-limit-*",
        "read-back/set_home/home_trigger",
    ),
    said(
        "3.4.1/direction",
        "HmDir is the way home: 0 clockwise, 1 counter-clockwise.",
        "motion/home/finds-switch-*",
        "motion/home/turns",
    ),
    said(
        "3.4.1/speed",
        "HmSpeed is the speed of homing, 0 to 3000 rpm.",
        "motion/home/speed-*",
        "motion/home/turns",
        "ranges/set_home/home_speed/*",
        "ranges/set_home/at-corners",
    ),
    said(
        "3.4.1/limit-switch",
        "EndLimit 1 lets the end stops limit motion, and 0 does not.",
        "motion/set_home/end-limit-stops-*",
        "motion/set_home/end-limit-off",
    ),
    said("3.4.1/defaults", "Defaults are low, clockwise, 60 rpm, without limit.", "read-back/restore/settings"),
    said(
        "3.4.1/left",
        "With EndLimit 1 and the left limit closed the motor no longer turns to the left.",
        "motion/set_home/end-limit-stops-*",
        "motion/set_home/end-limit-holds-*",
    ),
    said(
        "3.4.1/right",
        "With EndLimit 1 and the right limit closed the motor no longer turns to the right.",
        "motion/set_limit_remap/right-on",
        "motion/set_home/end-limit-stops-*-right",
    ),
    said("3.4.1/back", "It turns away from a limit that is closed.", "motion/set_home/end-limit-lets-back"),
    unseen(
        "3.4.1/needs-homing",
        "A changed limit holds only after homing.",
        "what holds before is not said, so that neither can be refuted",
    ),
    unseen("3.4.1/not-in-pulse-modes", "In pulse modes no limit holds.", _PULSES),
    *_tables("3.4.2", "home", "91 without data", "a status of one byte"),
    said("3.4.2/status", "Status 1 says that it begins, and 2 that home is found.", "motion/home/replies"),
    said("3.4.2/status-0", "Status 0 says that it failed.", "motion/home/disabled", "motion/home/off"),
    said("3.4.2/from-closed", "From a closed end stop the motor first turns the other way.", "motion/home/from-closed-*"),
    said("3.4.2/from-closed-angle", "It turns that way by the return angle of 94.", "motion/home/backs-off-*"),
    *_tables("3.4.3", "set_zero", "92 without data", "a status of one byte"),
    said(
        "3.4.3/zero",
        "The present position becomes zero, as homing does.",
        "motion/set_zero/position",
        "motion/set_zero/pulses",
        "motion/set_zero/carry",
        "motion/set_zero/and-*",
    ),
    said("3.4.3/stands", "The motor does not turn for it.", "motion/set_zero/stands"),
    said("3.4.3/status-1", "Status 1 says that it is done.", "motion/set_zero/position", "examples/set_zero/1"),
    unseen("3.4.3/status-0", "Status 0 says that it is not done.", "the manual names nothing that prevents it"),
    *_setting("3.4.4", "set_no_limit_current", "93 with 16 bits of mA", "home_current"),
    said(
        "3.4.4/limits",
        "The current goes up to 3000 mA on a 42E and 5200 mA on a 57E.",
        "ranges/set_no_limit_current/home_current/highest",
        "ranges/set_no_limit_current/home_current/above",
    ),
    said("3.4.4/default", "The default is 300 mA on a 42E and 600 mA on a 57E.", "read-back/restore/settings"),
    said(
        "3.4.4/obstacle",
        "Without a switch the motor runs into an obstacle, goes back by a way, and that point is zero.",
        "motion/home/without-switch-*",
    ),
    unseen("3.4.4/torque", "It runs at this current then, and only then.", "not visible on the bus: a current"),
    *_tables("3.4.5", "set_no_limit_home", "94 with 32 bits of return angle and 16 bits of mA", "a status of one byte"),
    said(
        "3.4.5/mode",
        "Mode 0 homes by a switch and 1 without one; 0 is the default.",
        "motion/home/finds-switch-*",
        "motion/home/without-switch-*",
    ),
    unseen(
        "3.4.5/trigger",
        "Homing begins by 91, at power-on, or in pulse modes by En.",
        "no byte of the command holds it (mks-can-49)",
    ),
    said("3.4.5/angle", "The return angle is 4000h for 360 degrees.", "motion/home/without-switch-*"),
    said("3.4.5/range", "It is 0 to FFFFFFFFh.", "ranges/set_no_limit_home/return_angle/*"),
    said("3.4.5/default", "2000h is the default.", "read-back/restore/settings"),
    said(
        "3.4.5/status",
        "Status 1 says that it is set, and 0 that it is not.",
        "ranges/set_no_limit_home/*/highest",
        "ranges/set_no_limit_home/home_current/above",
    ),
    said("3.4.5/kept", "What was set is there after a restart.", "read-back/settings/restart"),
    unseen(
        "3.4.5/en-pulse", "In pulse modes 200 ms of the disabling level at En begin homing; 150 to 250 ms are seen.", _PULSES
    ),
    *_setting("3.4.6", "set_limit_remap", "9E with a byte", "limit_remap"),
    said(
        "3.4.6/on",
        "With 1 the En port is the right limit.",
        "motion/set_limit_remap/right-on",
        "read-back/set_limit_remap/effect",
    ),
    said("3.4.6/off", "With 0, the default, it is not.", "motion/set_limit_remap/right-off", "read-back/restore/settings"),
    said("3.4.6/bus-modes", "It is for bus modes only.", "motion/set_limit_remap/pulse-mode"),
    said("3.4.6/57e", "A 57E has a right limit without it.", "motion/set_limit_remap/right-off"),
    *_setting("3.5", "set_pulse_division", "9F with a starting level and 32 bits of a period", "division_level"),
    said(
        "3.5/values",
        "Values are 0 and 1, and any period; both are 0 by default.",
        "ranges/set_pulse_division/*",
        "read-back/restore/settings",
    ),
    said("3.5/flips", "From a period of 100 on PEND flips once for so many pulses.", "motion/set_pulse_division/flips"),
    unseen(
        "3.5/cancel",
        "A period below 100, or 0, gives PEND back to its signal.",
        "observed by motion/set_pulse_division/divides: whether 34 shows the port or the signal of the drive is not said",
    ),
    *_tables("3.6.1", "restore", "3F without data", "a status of one byte"),
    said("3.6.1/defaults", "All parameters have their defaults again.", "read-back/restore/*"),
    said("3.6.1/status", "Status 1 says that it is done.", "examples/restore/1"),
    unseen("3.6.1/status-0", "Status 0 says that it is not done.", "the manual names nothing that prevents it"),
    said("3.6.1/reboots", "The drive starts again then.", "read-back/restore/reboots"),
    *_tables("3.6.2", "restart", "41 without data", "a status of one byte"),
    said("3.6.2/restarts", "The drive starts again.", "motion/restart/ends-motion*", "timing/restart/answers-again"),
    said("3.6.2/keeps", "No parameter changes.", "read-back/*/restart"),
    said("3.6.2/status", "Status 1 says that it is done.", "examples/restart/1"),
    unseen("3.6.2/status-0", "Status 0 says that it is not done.", "the manual names nothing that prevents it"),
    *_tables("3.7", "read_version", "40 without data", "four bytes"),
    said("3.7/series", "Bit 7 is 1 for the E series.", "motion/read_version/names-the-drive"),
    said(
        "3.7/sense",
        "Bits 5 and 4 are 1 where clockwise raises the bare encoder, 2 where it lowers it.",
        "motion/read_version/calibration",
        "shape/read_version/values",
    ),
    said(
        "3.7/hardware", "Bits 3 to 0 are 2 for a 42E with CAN and 4 for a 57E with CAN.", "motion/read_version/names-the-drive"
    ),
    unseen(
        "3.7/firmware",
        "The three bytes are the numbers of the firmware's version.",
        "any version is one: the suite cannot know which a drive has",
    ),
    *_tables("3.8.1", "write_user_id", "42 with 32 bits", "a status of one byte"),
    said(
        "3.8.1/written",
        "Status 1 says that the number is kept.",
        "read-back/write_user_id/read",
        "read-back/write_user_id/restart",
        "ranges/write_user_id/user_id/*",
    ),
    unseen("3.8.1/status-0", "Status 0 says that it is not.", "every number of 32 bits is allowed"),
    *_tables("3.8.2", "read_user_id", "42 without data", "32 bits"),
    said("3.8.2/read", "The number reads as it was written.", "read-back/write_user_id/read"),
    *_tables("3.9", "read_parameter", "00 with the code of a parameter", "the parameter under its own code"),
    said(
        "3.9/code",
        "The reply has the code of the parameter that was asked for.",
        "shape/read_parameter/of/*",
        "shape/read_parameter/code",
    ),
    said("3.9/layout", "The reply has the layout that sets the parameter.", "shape/read_parameter/of/*"),
    said(
        "3.9/value",
        "The value reads as it was set.",
        "read-back/set_*/read",
        "read-back/set_*/ends",
        "addressing/set_address/told",
    ),
    said(
        "3.9/unreadable",
        "A parameter that cannot be read is answered FF FF.",
        "shape/read_parameter/unreadable",
        "resilience/reads/of-what-is-done",
    ),
    # Part 4: motion
    said("4/bus-modes-only", "Motion by the bus needs a bus mode.", "motion/*/pulse-mode"),
    said(
        "4.1/speed-range",
        "A speed is 0 to 3000, and a greater one is faster.",
        "ranges/*/speed/*",
        "motion/run_speed/speed-*",
        "motion/*/crossed-speed",
    ),
    said(
        "4.1/speed-at-16-32-64",
        "At 16, 32 and 64 subdivisions the speed as sent is that of the shaft.",
        "motion/set_subdivision/speed-at-16",
        "motion/set_subdivision/speed-at-32",
        "motion/set_subdivision/speed-at-64",
    ),
    said(
        "4.1/speed-at-others",
        "At other subdivisions a run turns at the speed as sent times 16 by the subdivision.",
        "motion/set_subdivision/speed-at-*",
        "motion/*/parts-of-a-rpm",
    ),
    said(
        "4.1/moves-at-others", "Moves too turn at the speed as sent times 16 by the subdivision.", "motion/move_*/crossed-speed"
    ),
    said("4.1/acceleration-range", "An acceleration is 0 to 255.", "ranges/*/acceleration/*"),
    said(
        "4.1/acceleration-0",
        "0 changes the speed at once.",
        "timing/run_speed/ramp-0",
        "timing/stop_speed/ramp-0",
        "motion/*/at-once",
        "motion/*/own-ramp",
    ),
    said("4.1/ramp-up", "On the way up one rpm takes (256 - acc) x 50 us.", "timing/run_speed/ramp-*", "timing/*/takes-*"),
    said("4.1/ramp-down", "On the way down one rpm takes as long.", "timing/stop_speed/ramp-*", "timing/*/takes-*"),
    said(
        "4.1/even",
        "On a ramp the speed rises evenly, rpm by rpm, and not beyond the speed that was asked for.",
        "motion/*/crossed-course",
    ),
    *_tables("4.2.1", "read_status", "F1 without data", "a status of one byte"),
    said(
        "4.2.1/stopped",
        "1: the motor stands.",
        "motion/read_status/standing",
        "motion/read_status/behind-emergency",
        "motion/read_status/after-a-move",
        "motion/read_status/slow-*",
    ),
    said("4.2.1/up", "2: it speeds up.", "motion/read_status/crossed"),
    said("4.2.1/down", "3: it slows down.", "motion/read_status/slowing-down"),
    said("4.2.1/full", "4: it has its full speed.", "motion/read_status/crossed", "motion/read_status/slow-*"),
    said("4.2.1/homing", "5: it is homing.", "motion/home/status", "motion/home/status-*"),
    said("4.2.1/calibrating", "6: it is calibrating.", "motion/calibrate/status"),
    unseen("4.2.1/fail", "0: the query failed.", "the manual names nothing that makes it fail"),
    unseen("4.2.1/pulse-modes", "In pulse modes only a calibration is told.", "what is answered there instead is not said"),
    said(
        "4.2.2/f3-decides",
        "In bus modes F3 enables the motor, and the level of En does not.",
        "motion/enable/is-read",
        "motion/set_enable_level/not-in-bus-modes",
    ),
    *_tables("4.2.2", "enable", "F3 with a byte", "a status of one byte"),
    said(
        "4.2.2/values",
        "1 enables and 0 disables.",
        "motion/enable/is-read",
        "motion/enable/on-holds-here",
        "ranges/enable/enabled/*",
    ),
    said("4.2.2/off", "A motor that is disabled does not turn.", "motion/*/disabled", "motion/enable/off-ends-mo*"),
    said(
        "4.2.2/status",
        "Status 1 says that it is done, and 0 that it is not.",
        "ranges/enable/enabled/listed",
        "ranges/enable/enabled/unlisted",
    ),
    *_tables("4.3", "emergency_stop", "F7 without data", "a status of one byte"),
    said("4.3/stops", "The motor stops at once.", "motion/emergency_stop/ends-*"),
    said("4.3/status", "Status 1 says that it stops.", "motion/emergency_stop/replies"),
    unseen("4.3/status-0", "Status 0 says that it does not.", "the manual names nothing that prevents it in a bus mode"),
    unseen("4.3/fast", "Above 1000 rpm a stop at once is discouraged.", "advice, and nothing that a drive does"),
    *_tables("4.4.1", "run_speed", "F6 with direction, speed of 12 bits and acceleration", "a status of one byte"),
    said(
        "4.4.1/runs",
        "The shaft turns at the speed, by the ramp, until told otherwise.",
        "motion/run_speed/speed-*",
        "motion/run_speed/lasts",
        "timing/run_speed/ramp-*",
    ),
    said(
        "4.4.1/direction",
        "Direction 0 turns counter-clockwise and 1 clockwise.",
        "motion/run_speed/raises",
        "motion/run_speed/opposite",
    ),
    said(
        "4.4.1/speed",
        "Bits 3 to 0 of byte 2 and byte 3 are the speed together.",
        "ranges/run_speed/speed/width",
        "motion/run_speed/crossed-speed",
    ),
    said("4.4.1/examples", "The two frames of the manual run at 320 rpm, one each way.", "examples/run_speed/*"),
    said("4.4.1/status-1", "Status 1 says that it runs.", "motion/run_speed/crossed-replies"),
    said("4.4.1/status-0", "Status 0 says that it does not.", "motion/run_speed/disabled", "motion/run_speed/protected"),
    *_tables("4.4.2", "stop_speed", "F6 with speed 0", "a status of one byte"),
    said(
        "4.4.2/ramp",
        "With an acceleration the shaft slows down by the ramp and stands.",
        "motion/stop_speed/by-ramp",
        "timing/stop_speed/ramp-*",
    ),
    said("4.4.2/at-once", "With acceleration 0 it stands at once.", "motion/stop_speed/at-once"),
    said("4.4.2/stays", "It then stays where it is.", "motion/stop_speed/stays-stopped"),
    said("4.4.2/examples", "The two frames of the manual stop the shaft.", "examples/stop_speed/*"),
    said(
        "4.4.2/status",
        "Status 1 says that it begins to stop, and 2 that it stands.",
        "motion/stop_speed/replies",
        "motion/stop_speed/told-when-standing",
    ),
    unseen("4.4.2/status-0", "Status 0 says that it does not stop.", "the manual names nothing that prevents it in a bus mode"),
    *_tables("4.4.3", "save_speed", "FF with a byte", "a status of one byte"),
    said(
        "4.4.3/saved",
        "A saved run begins again when power comes on, either way, at its speed.",
        "read-back/save_speed/power",
        "read-back/save_speed/restart",
        "read-back/save_speed/no-sooner",
    ),
    said("4.4.3/cleaned", "A cleaned one does not.", "read-back/save_speed/clean"),
    said(
        "4.4.3/status",
        "Status 1 says that it is done, and 0 that it is not.",
        "ranges/save_speed/save_state/listed",
        "ranges/save_speed/save_state/unlisted",
    ),
    *_move(
        "4.5.1",
        "move_relative_pulses",
        "FD with direction, speed, acceleration and 24 bits of pulses",
        "Pulses are 0 to FFFFFFh.",
        "The frames of the manual turn the shaft 20 times, either way.",
        said(
            "4.5.1/distance",
            "The shaft moves by so many pulses of the subdivision that is set.",
            "motion/move_relative_pulses/distance",
            "motion/move_relative_pulses/behind-ended",
            "motion/set_subdivision/pulses-at-*",
            "motion/move_relative_pulses/again",
        ),
        said(
            "4.5.1/direction",
            "Direction 0 turns counter-clockwise and 1 clockwise, as in a run.",
            "motion/move_relative_pulses/opposite",
            "motion/run_speed/same-sense",
        ),
    ),
    *_stop("4.5.2", "stop_relative_pulses", "FD with speed and pulses 0"),
    *_move(
        "4.6.1",
        "move_absolute_pulses",
        "FE with speed, acceleration and 24 bits, signed",
        "The target is -8388607 to 8388607.",
        "The frames of the manual move to 4000h and to -4000h.",
        said(
            "4.6.1/target",
            "The shaft moves to a count of pulses, wherever it is, and the count reads so then.",
            "motion/move_absolute_pulses/distance",
            "motion/move_absolute_pulses/reads-as-asked",
            "motion/move_absolute_pulses/same-place",
        ),
    ),
    *_stop("4.6.2", "stop_absolute_pulses", "FE with speed and target 0"),
    *_move(
        "4.7.1",
        "move_relative_axis",
        "F4 with speed, acceleration and 24 bits, signed",
        "The way is -8388607 to 8388607.",
        "The frames of the manual move by 4000h and by -4000h.",
        said(
            "4.7.1/distance",
            "The shaft moves by so many counts of the encoder, as 31 reads them.",
            "motion/move_relative_axis/distance",
            "motion/move_relative_axis/behind-ended",
            "motion/move_relative_axis/sign",
            "motion/move_relative_axis/again",
        ),
    ),
    *_stop("4.7.2", "stop_relative_axis", "F4 with speed and way 0"),
    *_move(
        "4.8.1",
        "move_absolute_axis",
        "F5 with speed, acceleration and 24 bits, signed",
        "The target is -8388607 to 8388607.",
        "The frames of the manual move to 4000h and to -4000h.",
        said(
            "4.8.1/target",
            "The shaft moves to a count of the encoder, wherever it is, and 31 reads so then.",
            "motion/move_absolute_axis/distance",
            "motion/move_absolute_axis/reads-as-asked",
            "motion/move_absolute_axis/same-place",
        ),
        said(
            "4.8.1/update",
            "A newer command on the way changes speed and target.",
            "motion/move_absolute_axis/newer-*",
            "motion/move_absolute_axis/update-*",
        ),
    ),
    *_stop("4.8.2", "stop_absolute_axis", "F5 with speed and target 0"),
    # Part 5: examples
    said("5.3/encoder", "30 is answered with carry 1 and value 29EFh.", "examples/read_encoder_carry/2"),
    said("5.4/run", "F6 runs the motor and is answered by 1.", "examples/run_speed/3"),
    said("5.4/save", "FF C8 saves the run and is answered by 1.", "examples/save_speed/1", "read-back/save_speed/power"),
    said("5.4/stop", "F6 with speed 0 stops the motor and is answered by 1.", "examples/stop_speed/3"),
    said("5.4/after-power-on", "The saved run begins again after power comes on.", "read-back/save_speed/power"),
    said("5.5/move", "FD moves by 200 turns and is answered by 1, then 2.", "examples/move_relative_pulses/5"),
    said("5.5/long-move", "FD backwards by 1000 turns is answered by 1 when it begins.", "examples/move_relative_pulses/6"),
    said(
        "5.5/stop",
        "FD with speed 0 on the way stops the motor and is answered by 1, then 2.",
        "examples/stop_relative_pulses/3",
    ),
    unseen("6.1/supply", "The supply is 12 to 24 V; nothing is plugged under power; phases are connected in order.", "wiring"),
)
