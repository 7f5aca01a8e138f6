"""What the MKS dialects share: enumerations, fields, reply meanings and risks that native RS485, Modbus and CAN repeat.

Each dialect declares its own frames; here are only the data inside a command:

    speed body      direction:1 reserved:3 speed:12 | acceleration:8                    F6 and, with pulses, FD
    position body   speed:16 | acceleration:8 | position:32 (CAN: 24)                   FE, F4, F5 (Modbus: other order)
    setting         one field, answered by one status

Rules kept here:
- A field has one name in every dialect where its meaning is the same, and another name where it is not.
- Fields are big-endian. The encoder has 16384 counts a turn and counter-clockwise raises it.
- The direction bit of motion commands is 0 = CCW, 1 = CW; configuration fields are 0 = CW, 1 = CCW. Both as printed.
- A builder takes the options of `layout.Field`, which override the values here; `fixed=0` makes the field of a stop.
- A risk rule never leaves a value without a risk.

Not known here: codes, frames, models of the CAN drives, and whether a real drive turns the way its bits say.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from fractions import Fraction
from typing import Any

from analyzer.catalogue import (
    Command,
    Form,
    Motion,
    MotionKind,
    Ramp,
    Replies,
    Risk,
    RiskRule,
    Role,
    Subdivision,
    Vector,
    Verb,
    always,
    when,
)
from analyzer.layout import Effect, Field, Layout, ModelLimits, StatePart, bits, i16, reserved, sint, u8, u16, u32, uint

#: Encoder counts of one turn of the shaft.
COUNTS_PER_TURN = 16384

#: Work modes, by the names of `WorkMode`, in which the bus runs the motor.
SERIAL_MODES = ("sr_open", "sr_close", "sr_vfoc")

#: The highest speed of each work mode, rpm.
MODE_MAXIMUM_SPEEDS: Mapping[str, int] = {
    "cr_open": 400,
    "cr_close": 1500,
    "cr_vfoc": 3000,
    "sr_open": 400,
    "sr_close": 1500,
    "sr_vfoc": 3000,
}

#: The law of every ramp, and what a subdivision does.
RAMP = Ramp(unit_ns=50_000, steps=256)
SUBDIVISION = Subdivision(full_steps=200, counted_at=16, plain=frozenset({16, 32, 64}), largest=256)

#: Bits per second of each member of `BaudRate`.
BAUD_RATES: Mapping[int, int] = {1: 9600, 2: 19200, 3: 25000, 4: 38400, 5: 57600, 6: 115200, 7: 256000}


def _motion(kind: MotionKind, *names: str, stop: str = "", tells_end: bool = True, counted_by: str = "") -> Motion:
    """Declare a motion whose fields have the names of their roles, but for the distance, which is given behind them."""
    known = {name: name for name in ("speed", "direction", "acceleration") if name in names}
    distance = next((name for name in names if name not in known), "")
    stops = (stop, "emergency_stop") if stop else ("emergency_stop",)
    return Motion(kind=kind, distance=distance, stops=stops, tells_end=tells_end, counted_by=counted_by, **known)


_RAMPED_STOP = Motion(kind=MotionKind.STOP, acceleration="acceleration", tells_end=True)
_HOLD = Motion(kind=MotionKind.HOLD)
#: What each motion command does, on every link; a link that does not tell the end of a motion says so.
MOTIONS: Mapping[Verb, Motion] = {
    Verb.RELEASE_PROTECTION: _HOLD,
    Verb.ENABLE: _HOLD,
    Verb.CALIBRATE: _motion(MotionKind.CALIBRATE),
    Verb.HOME: _motion(MotionKind.HOME),
    Verb.EMERGENCY_STOP: Motion(kind=MotionKind.STOP),
    Verb.RUN_SPEED: _motion(MotionKind.RUN, "direction", "speed", "acceleration", stop="stop_speed", tells_end=False),
    Verb.MOVE_RELATIVE_PULSES: _motion(
        MotionKind.MOVE_BY, "direction", "speed", "acceleration", "pulses", stop="stop_relative_pulses"
    ),
    Verb.MOVE_ABSOLUTE_PULSES: _motion(
        MotionKind.MOVE_TO, "speed", "acceleration", "position", stop="stop_absolute_pulses", counted_by="read_pulses"
    ),
    Verb.MOVE_RELATIVE_AXIS: _motion(MotionKind.MOVE_BY, "speed", "acceleration", "position", stop="stop_relative_axis"),
    Verb.MOVE_ABSOLUTE_AXIS: _motion(
        MotionKind.MOVE_TO, "speed", "acceleration", "position", stop="stop_absolute_axis", counted_by="read_position"
    ),
    Verb.STOP_SPEED: _RAMPED_STOP,
    Verb.STOP_RELATIVE_PULSES: _RAMPED_STOP,
    Verb.STOP_ABSOLUTE_PULSES: _RAMPED_STOP,
    Verb.STOP_RELATIVE_AXIS: _RAMPED_STOP,
    Verb.STOP_ABSOLUTE_AXIS: _RAMPED_STOP,
}

#: The names of the commands that run at a speed or to a position, and of those that stop such a run.
RUNS = tuple(v.value for v, m in MOTIONS.items() if m.kind in (MotionKind.RUN, MotionKind.MOVE_BY, MotionKind.MOVE_TO))
STOPS = tuple(v.value for v, m in MOTIONS.items() if m is _RAMPED_STOP)


# ---- What the numbers of a field mean


class Success(IntEnum):
    """The answer to a setting, and to a run at a speed."""

    FAILED = 0
    SUCCESS = 1


class Switch(IntEnum):
    """A function that is off or on."""

    DISABLED = 0
    ENABLED = 1


class MotionDirection(IntEnum):
    """The direction bit of motion commands."""

    CCW = 0
    CW = 1


class ConfigDirection(IntEnum):
    """A direction in a setting."""

    CW = 0
    CCW = 1


class Level(IntEnum):
    """The level of a pin."""

    LOW = 0
    HIGH = 1


class EnableLevel(IntEnum):
    """The level of the En pin at which the motor holds."""

    ACTIVE_LOW = 0
    ACTIVE_HIGH = 1
    ALWAYS = 2


class WorkMode(IntEnum):
    """The work mode of the RS485 drives: CR takes pulses, SR takes the bus."""

    CR_OPEN = 0
    CR_CLOSE = 1
    CR_VFOC = 2
    SR_OPEN = 3
    SR_CLOSE = 4
    SR_VFOC = 5


class HoldingCurrent(IntEnum):
    """The holding current as a part of the working current."""

    PERCENT_10 = 0
    PERCENT_20 = 1
    PERCENT_30 = 2
    PERCENT_40 = 3
    PERCENT_50 = 4
    PERCENT_60 = 5
    PERCENT_70 = 6
    PERCENT_80 = 7
    PERCENT_90 = 8


class BaudRate(IntEnum):
    """The speed of the serial line."""

    BAUD_9600 = 1
    BAUD_19200 = 2
    BAUD_25000 = 3
    BAUD_38400 = 4
    BAUD_57600 = 5
    BAUD_115200 = 6
    BAUD_256000 = 7


class Lock(IntEnum):
    """Whether something is locked: the keys at the display, or the shaft when a bus mode begins."""

    UNLOCKED = 0
    LOCKED = 1


class HomeMode(IntEnum):
    """How the drive finds home."""

    LIMIT_SWITCH = 0
    NO_LIMIT = 1


class ZeroMode(IntEnum):
    """What the drive does about its zero point when power comes on."""

    DISABLED = 0
    DIRECTION = 1
    NEAR = 2


class ZeroPoint(IntEnum):
    """What a zero-mode setting does to the stored zero point."""

    CLEAN = 0
    SET = 1


class SaveState(IntEnum):
    """What happens to the speed that is kept for the next power-on."""

    SAVE = 0xC8
    CLEAN = 0xCA


class RunStatus(IntEnum):
    """The answers to a move to a position, and to a stop."""

    FAILED = 0
    STARTING = 1
    COMPLETE = 2
    LIMIT_STOP = 3


class SaveStatus(IntEnum):
    """The answers to saving or cleaning the speed for power-on."""

    FAILED = 0
    STARTING = 1
    SUCCESS = 2


class HomeStatus(IntEnum):
    """The answers to going home."""

    FAILED = 0
    STARTING = 1
    SUCCESS = 2


class CalibrationStatus(IntEnum):
    """The answers to a calibration; unlike all others, 0 is not a failure."""

    CALIBRATING = 0
    SUCCESS = 1
    FAILED = 2


class ZeroStatus(IntEnum):
    """How the way back to zero at power-on went."""

    GOING = 0
    SUCCESS = 1
    FAILED = 2


class MotorStatus(IntEnum):
    """What the motor is doing."""

    READ_FAILED = 0
    STOPPED = 1
    SPEEDING_UP = 2
    SLOWING_DOWN = 3
    FULL_SPEED = 4
    HOMING = 5
    CALIBRATING = 6


class Protection(IntEnum):
    """Whether the locked-rotor protection has let the shaft go."""

    UNPROTECTED = 0
    PROTECTED = 1


# ---- Fields of motion commands


def direction(**options: Any) -> Field:
    """Declare the direction bit of a motion command."""
    return bits("direction", 1, **{"choices": MotionDirection, "printed": "dir"} | options)


_SPEED: dict[str, Any] = {"maximum": 3000, "unit": "rpm", "printed": "speed"}


def speed12(**options: Any) -> Field:
    """Declare the 12-bit speed of a motion command."""
    return bits("speed", 12, **_SPEED | options)


def speed16(**options: Any) -> Field:
    """Declare the 16-bit speed of a motion command."""
    return u16("speed", **_SPEED | options)


def acceleration(**options: Any) -> Field:
    """Declare the acceleration: 0 at once, otherwise (256 - n) * 50 us for each rpm."""
    return u8("acceleration", **{"printed": "acc"} | options)


def pulses(width: int, **options: Any) -> Field:
    """Declare the length of a move, in pulses at the current subdivision."""
    return uint("pulses", width, **{"unit": "pulses", "printed": "pulses"} | options)


def position(width: int, unit: str, **options: Any) -> Field:
    """Declare the signed distance or target of a move, in `unit` (pulses or counts)."""
    return sint("position", width, **{"unit": unit} | options)


def speed_body(**options: Any) -> tuple[Field, ...]:
    """Declare direction, speed and acceleration in three bytes; options go to direction and speed."""
    return (direction(**options), reserved(3), speed12(**options), acceleration())


def position_body(width: int, unit: str, printed: str, **options: Any) -> tuple[Field, ...]:
    """Declare speed, acceleration and a signed position; options go to speed and position."""
    return (speed16(**options), acceleration(), position(width, unit, printed=printed, **options))


# ---- Fields of replies


def status(choices: type[IntEnum] = Success, **options: Any) -> Field:
    """Declare a status byte."""
    return u8("status", **dict[str, Any](choices=choices, printed="status") | options)


def pins(*names: str) -> tuple[Field, ...]:
    """Declare one bit for each pin, the highest bit first."""
    return tuple(bits(name, 1, choices=Level, printed=name.upper()) for name in names)


CARRY = sint("carry", 32, unit="turns", printed="carry", state=StatePart("position", 360.0))
ENCODER = u16(
    "encoder", maximum=COUNTS_PER_TURN - 1, unit="counts", printed="value", state=StatePart("position", 360.0 / COUNTS_PER_TURN)
)
POSITION = position(48, "counts", printed="value", state=StatePart("position", 360.0 / COUNTS_PER_TURN))
ACTUAL_SPEED = i16("speed", unit="rpm", printed="speed", note="counter-clockwise is positive", state=StatePart("speed", 1.0))
PULSE_COUNT = sint("pulses", 32, unit="pulses", printed="pulses")
ANGLE_ERROR = sint("angle_error", 32, unit="deg", scale=Fraction(360, 51200), printed="error")


# ---- Fields of settings

WORK_MODE = u8("work_mode", choices=WorkMode, default=WorkMode.CR_VFOC, printed="mode", effect=Effect.WORK_MODE)
CURRENT = u16(
    "current",
    maximum=5200,
    unit="mA",
    printed="Current",
    effect=Effect.CURRENT,
    models={
        "42D": ModelLimits(maximum=3000, default=1600),
        "57D": ModelLimits(maximum=5200, default=3200),
        "28D": ModelLimits(maximum=3000, default=600),
        "35D": ModelLimits(maximum=3000, default=800),
    },
)
HOLDING_CURRENT = u8(
    "holding_current", choices=HoldingCurrent, default=HoldingCurrent.PERCENT_50, printed="holdMa", effect=Effect.CURRENT
)
ENABLE_LEVEL = u8("enable_level", choices=EnableLevel, default=EnableLevel.ACTIVE_LOW, printed="enable")
MOTOR_DIRECTION = u8("motor_direction", choices=ConfigDirection, default=ConfigDirection.CW, printed="dir")
SCREEN_OFF = u8("screen_off", choices=Switch, default=Switch.DISABLED, printed="enable")
PROTECTION = u8("protection", choices=Switch, default=Switch.DISABLED, printed="enable")
INTERPOLATION = u8("interpolation", choices=Switch, default=Switch.ENABLED, printed="enable")
BAUD_RATE = u8("baud_rate", choices=BaudRate, default=BaudRate.BAUD_38400, printed="baud", effect=Effect.BAUD_RATE)
RESPOND = u8("respond", choices=Switch, default=Switch.ENABLED, printed="respon", effect=Effect.RESPOND)
ACTIVE = u8("active", choices=Switch, default=Switch.ENABLED, printed="active", effect=Effect.ACTIVE)
MODBUS = u8("modbus", choices=Switch, default=Switch.DISABLED, printed="enable", effect=Effect.DIALECT)
KEY_LOCK = u8("key_lock", choices=Lock, printed="enable")
LIMIT_REMAP = u8("limit_remap", choices=Switch, printed="enable")
ENABLED = u8("enabled", choices=Switch, printed="en")

HOME_TRIGGER = u8("home_trigger", choices=Level, default=Level.LOW, printed="HmTrig")
HOME_DIRECTION = u8("home_direction", choices=ConfigDirection, default=ConfigDirection.CW, printed="HmDir")
HOME_SPEED = u16("home_speed", maximum=3000, unit="rpm", printed="HmSpeed", effect=Effect.HOME_SPEED)
END_LIMIT = u8("end_limit", choices=Switch, default=Switch.DISABLED, printed="EndLimit")

RETURN_ANGLE = u32("return_angle", unit="counts", default=0x2000, printed="retValue", note="0x4000 is a whole turn")
HOME_MODE = u8("home_mode", choices=HomeMode, default=HomeMode.LIMIT_SWITCH, printed="mode")
HOME_CURRENT = u16(
    "home_current",
    maximum=5200,
    unit="mA",
    printed="ma",
    effect=Effect.CURRENT,
    models={
        "42D": ModelLimits(maximum=3000, default=800),
        "57D": ModelLimits(maximum=5200, default=400),
        "28D": ModelLimits(maximum=3000, default=200),
        "35D": ModelLimits(maximum=3000, default=200),
    },
)

ZERO_MODE = u8("zero_mode", choices=ZeroMode, default=ZeroMode.DISABLED, printed="0_Mode")
SET_ZERO = u8("set_zero", choices=ZeroPoint, printed="Set 0")
ZERO_SPEED = u8("zero_speed", maximum=4, printed="0_Speed", note="0 is the slowest, 4 the fastest")
ZERO_DIRECTION = u8("zero_direction", choices=ConfigDirection, default=ConfigDirection.CW, printed="0_Dir")

SAVE_STATE = u8("save_state", choices=SaveState, printed="state")


def new_address(maximum: int, **options: Any) -> Field:
    """Declare the address a drive is to take, 1..`maximum`; 0 is that of all drives and is refused."""
    facts: dict[str, Any] = {"minimum": 1, "maximum": maximum, "default": 1, "printed": "addr", "effect": Effect.ADDRESS}
    return u8("new_address", **facts | options)


# ---- What a status means

SET = Replies(final={1}, failed={0})
MOVE = Replies(interim={1}, final={2, 3}, failed={0})
CALIBRATION = Replies(interim={0}, final={1}, failed={2})
HOMING = Replies(interim={1}, final={2}, failed={0})
SAVING = Replies(final={1, 2}, failed={0})
MOTOR_STATUS = Replies(final={1, 2, 3, 4, 5, 6}, failed={0})

# ---- Printed frames


def sent(printed: str, section: str = "", *, checksum: bool = True, **values: int) -> Vector:
    """Declare a request as the manual prints it; `values` are integers as sent."""
    return Vector(printed, values, Role.REQUEST, section, checksum)


def answered(printed: str, section: str = "", *, checksum: bool = True, **values: int) -> Vector:
    """Declare a reply as the manual prints it; `values` are integers as sent."""
    return Vector(printed, values, Role.REPLY, section, checksum)


# ---- What a command risks

Rules = tuple[RiskRule, ...]

READ_RISK: Rules = (always(Risk.READ),)
SETTING_RISK: Rules = (always(Risk.SETTING),)
TORQUE_RISK: Rules = (always(Risk.SETTING, Risk.TORQUE),)
LINK_RISK: Rules = (always(Risk.SETTING, Risk.LINK),)
MOTION_RISK: Rules = (always(Risk.MOTION),)
PROTECTION_RISK: Rules = (always(Risk.SETTING), when("protection", 1, 0xFF, Risk.TORQUE))
RELEASE_RISK: Rules = (always(Risk.SETTING, Risk.MOTION),)
CALIBRATION_RISK: Rules = (always(Risk.MOTION, Risk.UNBOUNDED, Risk.TORQUE),)
SET_HOME_RISK: Rules = (always(Risk.SETTING), when("end_limit", 1, 0xFF, Risk.TORQUE))
HOME_RISK: Rules = (always(Risk.MOTION, Risk.UNBOUNDED, Risk.TORQUE),)
ZERO_MODE_RISK: Rules = (always(Risk.SETTING), when("zero_mode", 1, 0xFF, Risk.POWER_ON))
RESTORE_RISK: Rules = (always(Risk.DESTRUCTIVE, Risk.LINK, Risk.TORQUE, Risk.POWER_ON),)
RESTART_RISK: Rules = (always(Risk.TORQUE, Risk.POWER_ON),)
RUN_SPEED_RISK: Rules = (always(Risk.MOTION), when("speed", 1, 0xFFFF, Risk.UNBOUNDED))
ENABLE_RISK: Rules = (
    when("enabled", 0, None, Risk.TORQUE),
    when("enabled", 1, None, Risk.MOTION),
    when("enabled", 2, 0xFF, Risk.TORQUE, Risk.MOTION, Risk.UNKNOWN),
)
_ANY_SAVE = (Risk.SETTING, Risk.POWER_ON, Risk.UNKNOWN)
SAVE_RISK: Rules = (
    always(Risk.WEAR),
    when("save_state", SaveState.SAVE, None, Risk.POWER_ON),
    when("save_state", SaveState.CLEAN, None, Risk.SETTING),
    when("save_state", 0, 0xC7, *_ANY_SAVE),
    when("save_state", 0xC9, None, *_ANY_SAVE),
    when("save_state", 0xCB, 0xFF, *_ANY_SAVE),
)

# ---- Commands of the links that carry a code

_STATUS, _RUN_STATUS = status(), status(RunStatus)
HALT = "above 1000 rpm a stop without a ramp is discouraged"


def read(verb: Verb, code: int, section: str, summary: str, *fields: Field, **options: Any) -> Command:
    """Declare a command without data that is answered with `fields`."""
    facts: dict[str, Any] = {"risk": READ_RISK, "request": Layout(), "reply": Layout(*fields)}
    return Command(name=verb.value, verb=verb, code=code, section=section, summary=summary, **facts | options)


def do(verb: Verb, code: int, section: str, summary: str, *fields: Field, status: Field = _STATUS, **options: Any) -> Command:
    """Declare a command with `fields` as data that is answered with a status; `printed` is its name on the display."""
    facts: dict[str, Any] = {
        "risk": SETTING_RISK,
        "replies": SET,
        "request": Layout(*fields),
        "reply": Layout(status),
        "motion": MOTIONS.get(verb),
    }
    return Command(name=verb.value, verb=verb, code=code, section=section, summary=summary, **facts | options)


def run(verb: Verb, code: int, section: str, summary: str, *fields: Field, **options: Any) -> Command:
    """Declare a motion, whose replies `respond` off silences; `modes` are those in which the bus runs the motor."""
    facts: dict[str, Any] = {"risk": MOTION_RISK, "status": _RUN_STATUS, "replies": MOVE, "silenced": True}
    return do(verb, code, section, summary, *fields, **facts | options)


def stop(verb: Verb, code: int, section: str, summary: str, *fields: Field, **options: Any) -> Command:
    """Declare a stop: a run of zeros, whose replies only an open stop tells from those of its run."""
    facts: dict[str, Any] = {"reply": (Form(Layout(_RUN_STATUS), needs_request=True),), "notes": (HALT,)}
    return run(verb, code, section, summary, *fields, **facts | options)
