"""What the RS485 manual V1.0.5 of the MKS SERVO42D/57D says a drive does: Part 8, its Modbus-RTU chapter.

In the manual's order, in our words. Parts 1 to 3 and section 6.1, which hold for both links, stand in
`mks_shared_statements`. Part 8 prints requests and replies as tables: that each is answered so is one statement of its section.

Not here: the files for a Modbus tool that the manual names (.mbp).
"""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.catalogue import Statement
from analyzer.protocols.mks_shared_statements import CURRENT_UNSEEN, DISPLAY, RAMPS, SHARED, effects, read, said, unseen


def _write(section: str, name: str, what: str, *more: Statement) -> Iterator[Statement]:
    """Yield what each section about a write of one register says: its value, its echo; then what it does."""
    yield said(f"{section}/value", what, f"ranges/{name}/*", f"shape/{name}/answered")
    yield said(f"{section}/echo", "The reply has the register and the value.", f"shape/{name}/echo", f"shape/{name}/register")
    yield from effects(section, name)
    yield from more


def _write_many(section: str, name: str, what: str, *more: Statement) -> Iterator[Statement]:
    """Yield what each section about a write of several registers says: its values, its reply; then what it does."""
    yield said(f"{section}/values", what, f"ranges/{name}/*", f"shape/{name}/answered")
    yield said(
        f"{section}/reply",
        "The reply has the register and how many there are.",
        f"shape/{name}/register",
        f"shape/{name}/quantity",
    )
    yield from effects(section, name)
    yield from more


def _stop(section: str, name: str, code: str) -> Iterator[Statement]:
    yield said(f"{section}/ramp", f"{code} with speed 0 and an acceleration slows the shaft down.", f"motion/{name}/by-ramp")
    yield said(f"{section}/at-once", f"{code} with speed 0 and acceleration 0 stops at once.", f"motion/{name}/at-once")
    yield said(f"{section}/stays", "The shaft then stands.", f"motion/{name}/stays-stopped")
    yield said(
        f"{section}/reply", "The reply has the register and the quantity.", f"shape/{name}/register", f"shape/{name}/quantity"
    )


def _move(section: str, name: str, code: str, *more: Statement) -> Iterator[Statement]:
    what = f"{code} takes a speed of 0 to 3000 and an acceleration of 0 to 255."
    yield from _write_many(
        section, name, what, said(f"{section}/speed", "The shaft turns at that speed.", f"motion/{name}/crossed-speed")
    )
    yield said(
        f"{section}/ramp", "It takes the ramp of its acceleration.", f"motion/{name}/crossed-course", f"motion/{name}/within"
    )
    yield said(f"{section}/serial", "It needs a serial work mode.", f"motion/{name}/pulse-mode")
    yield from more


_READS = (
    said("8/speaks", "The drive speaks Modbus-RTU when that is switched on.",
        "ranges/set_modbus/modbus/listed", "framing/other_dialect/ignored"),
    said("8/crc", "Frames end in a CRC16.", "framing/checksum_*/ignored", "shape/*/crc16"),
    said("8/crc-motion", "Motion with a wrong CRC is not executed.",
        "framing/checksum_bit/not_executed", "framing/flipped_bit/not_executed", "framing/*/wrong_check"),
    said("8/address", "A drive executes and answers what its own address is sent.", "addressing/other/*", "shape/*/address"),
    said("8/answered", "Every request is answered, once.",
        "shape/*/answered", "shape/*/once", "resilience/*", "traffic/answered"),
    said("8/high-byte-first", "Registers and values have their high byte first.",
        "shape/*/register", "motion/read_position/turn"),
    said("8.1/reads", "Registers are read by function 04.",
        "modbus/function/other_reads", "examples/read_*/1", "resilience/reads/of-what-is-done"),
    said("8.1/quantity", "Each is read with its own number of registers.",
        "modbus/quantity/others", "modbus/quantity/too_many"),
    said("8.1/other-registers", "There are no registers but those.", "modbus/register/between", "modbus/register/high_byte"),
    *read(
        "8.1.1",
        "read_encoder_carry",
        "30h reads the carry in four bytes and the value in two.",
        "motion/read_encoder_carry/standing",
    ),
    said("8.1.1/carries", "Above 3FFFh the carry is one more, below 0 one less.", "motion/read_encoder_carry/*"),
    *read("8.1.2", "read_position", "31h reads the encoder as one signed count of six bytes.", "motion/read_position/wide"),
    *read("8.1.3", "read_speed", "32h reads the speed in rpm, in two signed bytes.", "motion/read_speed/crossed"),
    *read("8.1.4", "read_pulses", "33h reads how many pulses came, in four bytes.", "motion/read_pulses/counts-*"),
    *read("8.1.5", "read_io", "34h reads the ports, one bit each.", "read-back/set_limit_remap/effect", "motion/read_io/*"),
    said("8.1.5/reserved", "The high byte and bits 7 to 4 are reserved.", "shape/read_io/reserved"),
    *read("8.1.6", "read_angle_error", "39h reads the angle error in four signed bytes.", "motion/read_angle_error/*"),
    *read("8.1.7", "read_enabled", "3Ah reads 1 when the motor is enabled and 0 when not.", "motion/enable/is-read"),
    *read("8.1.8", "read_zero_status", "3Bh reads how the way back to zero goes.", "motion/read_zero_status/*"),
    said("8.1.8/going", "0: on its way to zero.", "motion/read_zero_status/tells", "read-back/set_zero_mode/restart"),
    said("8.1.8/success", "1: back at zero.", "motion/read_zero_status/tells", "read-back/set_zero_mode/restart"),
    *read(
        "8.1.9",
        "read_protection",
        "3Eh reads 1 while protected, else 0.",
        "motion/set_protection/lets-go",
        "motion/read_protection/at-first",
    ),
    said("8.1.9/reserved", "The high byte of a value of one byte is 0.", "shape/read_*/reserved"),
    *read(
        "8.1.10",
        "read_status",
        "F1h reads what the motor does.",
        "motion/read_status/follows",
        "motion/read_status/behind-emergency",
    ),
    said("8.1.10/calibrating", "6: it is calibrating.", "motion/calibrate/status"),
)  # fmt: skip

_WRITES = (
    said("8.2/one", "One register is written by function 06 and echoed.",
        "modbus/write_one/echo", "modbus/function/other_write"),
    said("8.2/several", "Several are written by function 10h, answered by their number.", "modbus/write_many/echo"),
    *_write("8.2.1", "release_protection",
         "3Dh with 1 ends the protection of a locked rotor.",
         said("8.2.1/releases", "The motor moves again.", "motion/release_protection/*")),
    *_write("8.2.2", "restore",
         "3Fh with 1 puts every parameter back to its default.",
         said("8.2.2/defaults", "Every parameter is as by default.", "read-back/restore/settings", "read-back/restore/link")),
    *_write(
        "8.2.3",
        "restart",
        "41h with 1 starts the drive again.",
        said("8.2.3/restarts", "The drive starts again.",
            "motion/restart/ends-motion*", "timing/restart/*", "read-back/restart/*"),
    ),
    *_write("8.2.4", "calibrate",
         "80h with 1 calibrates the encoder.", said("8.2.4/calibrates", "The motor is calibrated.", "motion/calibrate/status")),
    *_write(
        "8.2.5",
        "set_work_mode",
        "82h sets the work mode, 0 to 5.",
        said("8.2.5/effect", "In modes 3 to 5 the bus moves the motor, in the others pulses.",
            "read-back/set_work_mode/effect", "motion/*/pulse-mode"),
    ),
    *_write("8.2.6", "set_current", "83h sets the working current in mA."),
    *_write("8.2.7", "set_holding_current",
         "9Bh sets the holding current, 0 to 8.",
         unseen("8.2.7/percent", "0 is 10 percent, each step 10 more, but in vFOC.", CURRENT_UNSEEN)),
    *_write("8.2.8", "set_subdivision", "84h sets the subdivision in two bytes."),
    *_write("8.2.9", "set_enable_level", "85h sets the level of En: low, high, always."),
    *_write("8.2.10", "set_direction", "86h sets the direction: 0 CW, 1 CCW."),
    *_write("8.2.11", "set_screen_off",
         "87h switches the display's going dark off (0) or on (1).",
         unseen("8.2.11/dark", "The display goes dark after 15 seconds; a key wakes it up.", DISPLAY)),
    *_write("8.2.12", "set_protection", "88h switches the rotor's protection off (0) or on (1)."),
    *_write("8.2.13", "set_interpolation", "89h switches interpolation off (0) or on (1)."),
    *_write("8.2.14", "set_baud_rate", "8Ah sets the baud rate, 1 to 7."),
    *_write("8.2.15", "set_address", "8Bh sets the address."),
    *_write("8.2.16", "set_modbus",
         "8Eh switches Modbus-RTU off (0) or on (1).",
         said("8.2.16/speaks", "With 0 the drive speaks its native frames again.", "ranges/set_modbus/modbus/listed")),
    *_write("8.2.17", "set_key_lock", "8Fh unlocks (0) or locks (1) the keys."),
    *_write("8.2.18", "set_zero",
         "92h with 1 makes the present place zero.", said("8.2.18/zero", "The present place is zero.", "motion/set_zero/*"),
         said("8.2.18/stands", "The motor does not move.", "motion/set_zero/stands")),
    *_write(
        "8.2.19",
        "enable",
        "F3h enables (1) or disables (0) the motor.",
        said("8.2.19/off", "With 0 the motor lets go.", "motion/enable/off-ends-mo*", "motion/enable/is-read"),
        said("8.2.19/on", "With 1 it holds.",
            "motion/enable/is-read", "motion/enable/on-holds-here", "read-back/enable/effect"),
        said("8.2.19/serial", "It works in serial modes alone.", "motion/enable/pulse-mode"),
        said("8.2.19/motion", "A disabled motor is not turned by any motion command.", "motion/*/disabled"),
    ),
    *_write_many(
        "8.2.20",
        "set_home",
        "90h sets trigger level, direction, speed and end limit.",
        said("8.2.20/five-bytes", "It is written as three registers in five bytes.", "modbus/byte_count/odd"),
    ),
    *_write("8.2.21", "set_limit_remap", "9Eh switches the remapped ports off (0) or on (1)."),
    *_write_many("8.2.22", "set_zero_mode", "9Ah sets mode, zero, speed and direction of the way back."),
)  # fmt: skip

_MOTION = (
    *_write("8.3.1", "emergency_stop",
         "F7h with 1 stops the motor at once.",
         said("8.3.1/stops", "The motor stops at once.", "motion/emergency_stop/ends-*")),
    *_write("8.3.2", "home",
         "91h with 1 looks for home.",
         said("8.3.2/homes", "Where homing ends is zero.", "motion/home/finds-switch-*", "motion/home/zero")),
    *_write_many(
        "8.3.3.1",
        "run_speed",
        "F6h takes direction, acceleration and a speed of 0 to 3000.",
        said("8.3.3.1/runs", "The shaft turns at a fixed speed and acceleration.",
            "motion/run_speed/speed-*", "motion/run_speed/lasts"),
        said("8.3.3.1/way", "The direction is 0 CCW or 1 CW.", "motion/run_speed/opposite", "motion/run_speed/raises"),
        said("8.3.3.1/serial", "It needs a serial work mode.", "motion/run_speed/pulse-mode"),
    ),
    *_stop("8.3.3.2", "stop_speed", "F6h"),
    *_write(
        "8.3.3.3",
        "save_speed",
        "FFh keeps (C8h) or forgets (CAh) the run.",
        said("8.3.3.3/save", "A kept run begins when power comes on, either way.",
            "read-back/save_speed/power", "read-back/save_speed/restart", "read-back/save_speed/as-it-was",
            "read-back/save_speed/no-sooner"),
        said("8.3.3.3/clean", "A forgotten run does not.", "read-back/save_speed/clean"),
    ),
    *_move(
        "8.3.4.1",
        "move_relative_pulses",
        "FDh",
        said("8.3.4.1/way", "The direction is 0 CCW or 1 CW.",
            "motion/move_relative_pulses/opposite", "motion/run_speed/same-sense"),
    ),
    *_stop("8.3.4.2", "stop_relative_pulses", "FDh"),
    *_move("8.3.5.1", "move_absolute_pulses", "FEh"),
    *_stop("8.3.5.2", "stop_absolute_pulses", "FEh"),
    *_move("8.3.6.1", "move_relative_axis",
         "F4h", said("8.3.6.1/axis", "The axis is the value that 31h reads.", "motion/move_relative_axis/sign")),
    *_stop("8.3.6.2", "stop_relative_axis", "F4h"),
    *_move(
        "8.3.7.1",
        "move_absolute_axis",
        "F5h",
        said("8.3.7.1/axis", "The axis is the value that 31h reads.",
            "motion/move_absolute_axis/sign", "motion/move_absolute_axis/reads-as-asked"),
    ),
    *_stop("8.3.7.2", "stop_absolute_axis", "F5h"),
)  # fmt: skip

STATEMENTS = (*SHARED, *RAMPS, *_READS, *_WRITES, *_MOTION)
