"""MKS SERVO42E/57E, CAN 2.0A: the CAN manual V1.0.1 as a table.

    request   ID 01 | F6 | 01 40 02 | 3A      code | data | low byte of the sum of ID and all before
    reply     ID 01 | F6 | 01       | F8      the same ID and, for all but the parameter read, the same code
    read      ID 01 | 00 | 82       | 83      parameter 82 is asked for
              ID 01 | 82 | 05       | 88      ... and answered under its own code, in the layout that sets it
              ID 01 | 82 | FF FF    | 81      ... or with FF FF where it cannot be read

Rules kept here:
- Commands stand in the manual's order, but for stops: a stop is its run with zeros everywhere but in the acceleration,
  so it stands directly before that run and is tried first.
- Fields are big-endian; a frame has at most eight bytes, so distances and targets have 24 bits.
- A stop's reply is one only while a stop is open; a stray reply of the code counts as the run's.
- Motion commands answer twice: when they begin, and when they are done (unless `active` is off). `respond` off silences
  only them.
- ID 0 reaches all drives, a group ID several; neither is answered.
- The replies of the parameter read are made from the settings, without further declarations.
- If the manual contradicts itself, `mks_can_errata` gives the reading taken as true.

Not known here: who sent a frame. `80 00`, and `42` with four bytes, can be a request or a reply. The reply to a parameter
read equals the request that sets it. Only the order of frames tells. Nor: which settings can be read back, whether 94 carries a
current, and which byte makes homing start at power-on.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from enum import IntEnum
from fractions import Fraction
from functools import partial
from typing import Any

from analyzer.catalogue import Command, Dialect, Form, Replies, Risk, Subject, Trait, Vector, Verb, always, when
from analyzer.layout import Effect, Field, Layout, ModelLimits, bits, fixed, reserved, u8, u16, u32
from analyzer.link import CanLink
from analyzer.protocols import mks_shared as mks
from analyzer.protocols.mks_can_errata import ERRATA

#: Work modes, by the names of `WorkMode`, in which the bus runs the motor.
BUS_MODES = ("bus_open", "bus_open_no_encoder", "bus_closed")

#: Bits per second of each member of `BitRate`.
BIT_RATES: Mapping[int, int] = {0: 125_000, 1: 250_000, 2: 500_000, 3: 1_000_000}

#: The largest distance of 24 signed bits; its negative is the smallest, so -8388608 is out of range.
LONGEST = 8388607

#: What the byte of the subdivision can be.
SUBDIVISIONS = frozenset({0, 2, 4, 8, 16, 32, 64, 128, 5, 10, 20, 25, 40, 50, 100, 200})


# ---- What the numbers of a field mean


class WorkMode(IntEnum):
    """What drives the motor, pulses or the bus, and whether the encoder closes the loop."""

    PULSE_PULSE_OPEN = 0x00
    PULSE_PULSE_OPEN_NO_ENCODER = 0x10
    PULSE_PULSE_CLOSED = 0x02
    PULSE_DIRECTION_CLOSED = 0x03
    BUS_OPEN = 0x04
    BUS_OPEN_NO_ENCODER = 0x14
    BUS_CLOSED = 0x05


class PulseDelay(IntEnum):
    """How long pulses are delayed."""

    MS_0 = 0
    MS_4 = 1
    MS_20 = 2
    MS_40 = 3


class BitRate(IntEnum):
    """The speed of the CAN bus."""

    BIT_RATE_125K = 0
    BIT_RATE_250K = 1
    BIT_RATE_500K = 2
    BIT_RATE_1M = 3


class Alarm(IntEnum):
    """The level of the alarm port."""

    ALARM = 0
    NO_ALARM = 1


class InPosition(IntEnum):
    """The level of the in-position port."""

    NOT_IN_POSITION = 0
    IN_POSITION = 1


class PortMask(IntEnum):
    """What a write does to an output port."""

    DEFAULT_SIGNAL = 0
    WRITE = 1
    KEEP = 2


class Series(IntEnum):
    """The family of the drive."""

    D = 0
    E = 1


class EncoderSense(IntEnum):
    """What calibration found: which way the bare encoder counts when the shaft turns clockwise."""

    CW_RAISES = 1
    CW_LOWERS = 2


class Hardware(IntEnum):
    """The size of the drive and its bus."""

    S42E_RS485 = 1
    S42E_CAN = 2
    S57E_RS485 = 3
    S57E_CAN = 4
    S28E_RS485 = 5
    S28E_CAN = 6
    S35E_RS485 = 7
    S35E_CAN = 8


# ---- Fields that only this manual has, or has otherwise

_WORK_MODE = u8("work_mode", choices=WorkMode, default=WorkMode.PULSE_DIRECTION_CLOSED, printed="mode", effect=Effect.WORK_MODE)
_CURRENT = replace(
    mks.CURRENT,
    printed="ma",
    models={"42E": ModelLimits(maximum=3000, default=1600), "57E": ModelLimits(maximum=5200, default=3200)},
)
_SUBDIVISION = u8(
    "subdivision", values=SUBDIVISIONS, default=16, printed="micstep", note="0 stands for 256", effect=Effect.SUBDIVISION
)
_PULSE_DELAY = u8("pulse_delay", choices=PulseDelay, default=PulseDelay.MS_20, printed="delay")
_PROTECTION = replace(mks.PROTECTION, default=mks.Switch.ENABLED)
_STALL_TOLERANCE = u16("stall_tolerance", maximum=0x7FFF, default=0x64, unit="deg", scale=Fraction(9, 5), printed="value")
_BIT_RATE = u8("bit_rate", choices=BitRate, default=BitRate.BIT_RATE_500K, printed="bitRate", effect=Effect.BAUD_RATE)
_NEW_ADDRESS = u16("new_address", minimum=1, maximum=0x7FF, default=1, printed="ID", effect=Effect.ADDRESS)
_GROUP_ADDRESS = u16("group_address", minimum=1, maximum=0x7FF, printed="ID", effect=Effect.GROUP)
_AXIS_LOCK = u8("axis_lock", choices=mks.Lock, default=mks.Lock.LOCKED, printed="enable")
_HOME_SPEED = replace(mks.HOME_SPEED, default=60)
_HOME_CURRENT = replace(
    mks.HOME_CURRENT, models={"42E": ModelLimits(maximum=3000, default=300), "57E": ModelLimits(maximum=5200, default=600)}
)
_LIMIT_REMAP = replace(mks.LIMIT_REMAP, default=mks.Switch.DISABLED, printed="reMap")
_DIVISION_LEVEL = u8("division_level", choices=mks.Level, default=mks.Level.LOW, printed="divLevel")
_DIVISION_PERIOD = u32("division_period", unit="pulses", default=0, printed="divPeriod", note="below 100: no output")
_USER_ID = u32("user_id", printed="ID")

_RISK_AXIS_LOCK = (always(Risk.SETTING), when("axis_lock", 0, None, Risk.TORQUE))
#: The power-on trigger of homing has no byte of its own in the manual; it may be one of these. So may the current.
_RISK_NO_LIMIT_HOME = (always(Risk.SETTING, Risk.TORQUE, Risk.POWER_ON),)
_SPEED = "at another subdivision than 16, 32 or 64 the shaft turns at speed x 16 / subdivision"


def _position_body(unit: str, printed: str) -> tuple[Field, ...]:
    """Declare speed, acceleration and a position of 24 bits whose range is symmetrical."""
    position = mks.position(24, unit, printed=printed, minimum=-LONGEST, maximum=LONGEST)
    return (mks.speed16(), mks.acceleration(), position)


def _set(verb: Verb, code: int, section: str, summary: str, *fields: Field, **options: Any) -> Command:
    """Declare a setting whose stored value the parameter read returns."""
    return mks.do(verb, code, section, summary, *fields, readable=True, **options)


_read, _do = mks.read, mks.do
_run = partial(mks.run, modes=BUS_MODES, notes=(_SPEED,))
_stop = partial(mks.stop, modes=BUS_MODES)
_sent, _answered = mks.sent, mks.answered


def _bare(printed: str, section: str) -> Vector:
    """Declare a request of the manual without data whose checksum is not printed."""
    return _sent(printed, section, checksum=False)


def _twice(printed: str, section: str) -> tuple[Vector, ...]:
    """Declare a request that stands in a heading without its checksum and in the table below with it."""
    return (_bare(printed[:-3], section), _sent(printed, section))


# Part 3: parameters ---------------------------------------------------------------------------------------------------

_PARAMETERS = (
    # 3.1 Reading
    _read(
        Verb.READ_ENCODER_CARRY, 0x30, "3.1.1", "Read the encoder as whole turns and the value within the turn.",
        mks.CARRY, mks.ENCODER,
        vectors=(
            *_twice("01 30 31", "3.1.1"),
            _sent("01 30 31", "5.3"),
            _answered("01 30 00 00 00 01 29 EF 4A", "5.3", carry=1, encoder=0x29EF),
        ),
    ),
    _read(
        Verb.READ_POSITION, 0x31, "3.1.2", "Read the encoder as one running count over all turns.", mks.POSITION,
        vectors=_twice("01 31 32", "3.1.2"),
    ),
    _read(
        Verb.READ_SPEED, 0x32, "3.1.3", "Read the speed of the shaft.", mks.ACTUAL_SPEED,
        vectors=_twice("01 32 33", "3.1.3"),
    ),
    _read(
        Verb.READ_PULSES, 0x33, "3.1.4", "Read how many pulses were received.", mks.PULSE_COUNT,
        vectors=_twice("01 33 34", "3.1.4"),
    ),
    _read(
        Verb.READ_IO, 0x34, "3.1.5", "Read the levels of the ports.",
        reserved(4), bits("alm", 1, choices=Alarm, printed="ALM"),
        bits("pend", 1, choices=InPosition, printed="PEND"), *mks.pins("in_2", "in_1"),
        notes=("the 42E has no IN_2; its bit is the level of the En port",),
        vectors=(
            _bare("01 34", "3.1.5"),
            Vector("01 34 3B", section="3.1.5", erratum="mks-can-23", corrected="01 34 35"),
        ),
    ),
    _read(
        Verb.READ_ANGLE_ERROR, 0x39, "3.1.6", "Read the wanted angle minus the angle of the shaft.", mks.ANGLE_ERROR,
        vectors=_twice("01 39 3A", "3.1.6"),
    ),
    _read(
        Verb.READ_ENABLED, 0x3A, "3.1.7", "Read whether the motor is enabled.", replace(mks.ENABLED, printed="enable"),
        vectors=_twice("01 3A 3B", "3.1.7"),
    ),
    _do(
        Verb.RELEASE_PROTECTION, 0x3D, "3.1.8", "End the locked-rotor protection, so that the motor holds again.",
        risk=mks.RELEASE_RISK,
        vectors=_twice("01 3D 3E", "3.1.8"),
    ),
    _read(
        Verb.READ_PROTECTION, 0x3E, "3.1.9", "Read whether the locked-rotor protection has let the shaft go.",
        mks.status(mks.Protection),
        vectors=(
            Vector("FA 01 3E", section="3.1.9", checksum=False, erratum="mks-can-29", corrected="01 3E 3F"),
            _sent("01 3E 3F", "3.1.9"),
        ),
    ),
    # 3.2 Setting
    _do(
        Verb.CALIBRATE, 0x80, "3.2.1", "Calibrate which way the encoder counts as the motor turns.", reserved(8),
        risk=mks.CALIBRATION_RISK, status=mks.status(mks.CalibrationStatus), replies=mks.CALIBRATION,
        notes=(
            "here status 0 means that it goes on, not that it failed",
            "not needed while the phases are wired as the drive was delivered",
        ),
        vectors=(_sent("01 80 00 81", "3.2.1"),),
    ),
    _set(
        Verb.SET_WORK_MODE, 0x82, "3.2.2", "Set who runs the motor, pulses or the bus, and by which loop.", _WORK_MODE,
        risk=mks.TORQUE_RISK,
        notes=("without an encoder its value cannot be read", "pulses: up to 300 kHz; bus: up to 3000 rpm"),
    ),
    _set(Verb.SET_CURRENT, 0x83, "3.2.3", "Set the working current.", _CURRENT, risk=mks.TORQUE_RISK),
    _set(
        Verb.SET_SUBDIVISION, 0x84, "3.2.4", "Set the pulses of a full step.", _SUBDIVISION,
        notes=(_SPEED,),
    ),
    _set(
        Verb.SET_ENABLE_LEVEL, 0x85, "3.2.5", "Set the level of the En pin at which the motor holds.", mks.ENABLE_LEVEL,
        risk=mks.TORQUE_RISK,
        notes=("without effect in bus modes", "pulses count again only 100 ms after the setting"),
    ),
    _set(
        Verb.SET_DIRECTION, 0x86, "3.2.6", "Set which way the shaft turns.", mks.MOTOR_DIRECTION,
        notes=("turns motion by the bus too",),
    ),
    _set(Verb.SET_PULSE_DELAY, 0x87, "3.2.7", "Set how long pulses are delayed.", _PULSE_DELAY),
    _set(
        Verb.SET_PROTECTION, 0x88, "3.2.8", "Set whether a locked rotor lets the shaft go.", _PROTECTION,
        risk=mks.PROTECTION_RISK,
        notes=("3D ends the protection, as does the En pin at the level that disables",),
    ),
    _set(
        Verb.SET_STALL_TOLERANCE, 0x89, "3.2.9", "Set the angle error at which a locked rotor lets the shaft go.",
        _STALL_TOLERANCE, risk=mks.TORQUE_RISK,
    ),
    _set(Verb.SET_BIT_RATE, 0x8A, "3.2.10", "Set the speed of the bus.", _BIT_RATE, risk=mks.LINK_RISK),
    _set(Verb.SET_ADDRESS, 0x8B, "3.2.11", "Set the ID of the drive.", _NEW_ADDRESS, risk=mks.LINK_RISK),
    _set(
        Verb.SET_RESPOND, 0x8C, "3.2.12", "Set whether motion is answered, and whether its end is.",
        mks.RESPOND, mks.ACTIVE,
        notes=(
            "respond 0: no reply to motion commands; active 0: the first reply comes, that of the end does not",
            "F1 tells what the motor does all the same",
        ),
    ),
    _set(
        Verb.SET_AXIS_LOCK, 0x8F, "3.2.13", "Set whether the motor holds its shaft when a bus mode begins.", _AXIS_LOCK,
        risk=_RISK_AXIS_LOCK,
    ),
    _set(
        Verb.SET_GROUP_ADDRESS, 0x8D, "3.2.14", "Set a second ID that several drives share.", _GROUP_ADDRESS,
        risk=mks.LINK_RISK,
        notes=("what is sent to a group ID is executed and not answered",),
    ),
    # 3.3 Writing to ports
    _do(
        Verb.WRITE_IO, 0x36, "3.3", "Set the output ports, or give them back to their signals.",
        bits("alm_mask", 2, choices=PortMask, printed="alm_mask"),
        bits("pend_mask", 2, choices=PortMask, printed="pend_mask"),
        bits("alm", 1, choices=mks.Level, printed="ALM"),
        bits("pend", 1, choices=mks.Level, printed="PEND"),
        reserved(2),
    ),
    # 3.4 Home
    _set(
        Verb.SET_HOME, 0x90, "3.4.1", "Set the end stop's level, the way, speed and method of homing, and the limit.",
        mks.HOME_TRIGGER, mks.HOME_DIRECTION, _HOME_SPEED, mks.END_LIMIT, mks.HOME_MODE,
        risk=mks.SET_HOME_RISK, printed="HmTrig, HmDir, HmSpeed, EndLimit, hmMode",
        notes=(
            "with the end limit on, the shaft no longer runs to the side whose limit is closed, in bus modes only",
            "a changed limit holds only after homing",
        ),
    ),
    _do(
        Verb.HOME, 0x91, "3.4.2", "Run until the end stop, or without one until an obstacle stops the shaft.",
        risk=mks.HOME_RISK, status=mks.status(mks.HomeStatus), replies=mks.HOMING,
        notes=("from a closed end stop the shaft first turns the other way, by the return_angle of 94 as it is taken",),
        vectors=(_sent("01 91 92", "3.4.2"),),
    ),
    _do(
        Verb.SET_ZERO, 0x92, "3.4.3", "Make the present position zero, without a move.",
        vectors=(_sent("01 92 93", "3.4.3"),),
    ),
    _set(
        Verb.SET_NO_LIMIT_CURRENT, 0x93, "3.4.4", "Set the current of homing without an end stop.", _HOME_CURRENT,
        risk=mks.TORQUE_RISK, printed="nullHmMa",
        notes=("the shaft runs at this current into an obstacle; a small one spares the motor",),
    ),
    _set(
        Verb.SET_NO_LIMIT_HOME, 0x94, "3.4.5", "Set homing without an end stop: way back and current.",
        request=(
            Form(Layout(mks.RETURN_ANGLE, _HOME_CURRENT)),
            Form(Layout(mks.RETURN_ANGLE), name="short"),
        ),
        risk=_RISK_NO_LIMIT_HOME,
        notes=(
            "the shaft goes back from the obstacle by the angle, and that point is zero",
            "homing starts by 91, at power-on, or in pulse control by 200 ms of the disabling level at En; which byte"
            " chooses is not printed, so this command counts as one that makes it start at power-on",
        ),
    ),
    _set(
        Verb.SET_LIMIT_REMAP, 0x9E, "3.4.6", "Set whether the En port serves as the right limit.", _LIMIT_REMAP,
        modes=BUS_MODES, models=("42E",),
    ),
    # 3.5 to 3.8
    _set(
        Verb.SET_PULSE_DIVISION, 0x9F, "3.5", "Set the PEND port to flip once for a number of pulses.",
        _DIVISION_LEVEL, _DIVISION_PERIOD,
        notes=("a period of 0 gives the port back",),
    ),
    _do(
        Verb.RESTORE, 0x3F, "3.6.1", "Put every parameter back to its default.", risk=mks.RESTORE_RISK,
        notes=("the drive starts again",),
        vectors=(_sent("01 3F 40", "3.6.1"),),
    ),
    _do(
        Verb.RESTART, 0x41, "3.6.2", "Start the drive again; its parameters stay.", risk=mks.RESTART_RISK,
        vectors=(_bare("01 41", "3.6.2"),),
    ),
    _read(
        Verb.READ_VERSION, 0x40, "3.7", "Read the series, the calibration and the versions.",
        bits("series", 1, choices=Series, printed="series"), reserved(1),
        bits("calibration", 2, choices=EncoderSense, printed="cal"),
        bits("hardware", 4, choices=Hardware, printed="hardVer"),
        u8("firmware_major", printed="firmVer[0]"),
        u8("firmware_minor", printed="firmVer[1]"),
        u8("firmware_patch", printed="firmVer[2]"),
        notes=("the types are those of the whole E series; a drive of this manual is S42E_CAN or S57E_CAN",),
        vectors=(_bare("01 40", "3.7"),),
    ),
    _do(Verb.WRITE_USER_ID, 0x42, "3.8.1", "Keep a number of the user's choice in the drive.", _USER_ID),
    _read(
        Verb.READ_USER_ID, 0x42, "3.8.2", "Read the number that the user keeps in the drive.", _USER_ID,
        vectors=(_bare("01 42", "3.8.2"),),
    ),
)  # fmt: skip

# Part 4: motion -------------------------------------------------------------------------------------------------------

_MOTION = (
    _read(
        Verb.READ_STATUS, 0xF1, "4.2.1", "Read what the motor is doing.", mks.status(mks.MotorStatus),
        replies=mks.MOTOR_STATUS,
        notes=("in pulse control only the status of a calibration counts",),
        vectors=(_sent("01 F1 F2", "4.2.1"),),
    ),
    _do(
        Verb.ENABLE, 0xF3, "4.2.2", "Make the motor hold, or let the shaft go.", mks.ENABLED,
        risk=mks.ENABLE_RISK, modes=BUS_MODES,
        notes=("in bus modes it takes the place of the En pin",),
    ),
    _do(
        Verb.EMERGENCY_STOP, 0xF7, "4.3", "Stop at once.", risk=mks.MOTION_RISK, modes=BUS_MODES,
        notes=(mks.HALT,),
        vectors=(_bare("01 F7", "4.3"),),
    ),
    # 4.4 Speed. From here on each stop stands before its run: the first form that matches wins.
    _stop(
        Verb.STOP_SPEED, 0xF6, "4.4.2", "Stop a run at a speed.", *mks.speed_body(fixed=0),
        vectors=(
            _sent("01 F6 00 00 02 F9", "4.4.2", direction=0, speed=0, acceleration=2),
            _sent("01 F6 00 00 00 F7", "4.4.2", direction=0, speed=0, acceleration=0),
            _sent("01 F6 00 00 02 F9", "5.4", direction=0, speed=0, acceleration=2),
            _answered("01 F6 01 F8", "5.4", status=1),
        ),
    ),
    _run(
        Verb.RUN_SPEED, 0xF6, "4.4.1", "Run at a speed until told otherwise.", *mks.speed_body(),
        status=mks.status(), replies=mks.SET, risk=mks.RUN_SPEED_RISK,
        vectors=(
            _sent("01 F6 01 40 02 3A", "4.4.1", direction=0, speed=320, acceleration=2),
            _sent("01 F6 81 40 02 BA", "4.4.1", direction=1, speed=320, acceleration=2),
            _sent("01 F6 01 40 02 3A", "5.4", direction=0, speed=320, acceleration=2),
            _answered("01 F6 01 F8", "5.4", status=1),
        ),
    ),
    _do(
        Verb.SAVE_SPEED, 0xFF, "4.4.3", "Keep the present speed for the next power-on, or forget the kept one.",
        mks.SAVE_STATE, risk=mks.SAVE_RISK, modes=BUS_MODES,
        notes=("after saving, the shaft turns as soon as power comes on",),
        vectors=(
            _sent("01 FF C8 C8", "5.4", save_state=0xC8),
            _answered("01 FF 01 01", "5.4", status=1),
        ),
    ),
    # 4.5 Position mode 1: relative, in pulses
    _stop(
        Verb.STOP_RELATIVE_PULSES, 0xFD, "4.5.2", "Stop a relative move by pulses.",
        *mks.speed_body(fixed=0), mks.pulses(24, fixed=0),
        vectors=(
            _sent("01 FD 00 00 04 00 00 00 02", "4.5.2", direction=0, speed=0, acceleration=4, pulses=0),
            _sent("01 FD 00 00 00 00 00 00 FE", "4.5.2", direction=0, speed=0, acceleration=0, pulses=0),
            _sent("01 FD 00 00 01 00 00 00 FF", "5.5", direction=0, speed=0, acceleration=1, pulses=0),
            _answered("01 FD 01 FF", "5.5", status=1),
            _answered("01 FD 02 00", "5.5", status=2),
        ),
    ),
    _run(
        Verb.MOVE_RELATIVE_PULSES, 0xFD, "4.5.1", "Move by a number of pulses.", *mks.speed_body(), mks.pulses(24),
        vectors=(
            _sent("01 FD 02 80 02 00 FA 00 7C", "3.2.12", direction=0, speed=640, acceleration=2, pulses=64000),
            _sent("01 FD 01 2C 64 00 0C 80 1B", "3.2.14", direction=0, speed=300, acceleration=100, pulses=3200),
            _sent("00 FD 01 2C 64 00 0C 80 1A", "3.2.14", direction=0, speed=300, acceleration=100, pulses=3200),
            _sent("50 FD 01 2C 64 00 0C 80 6A", "3.2.14", direction=0, speed=300, acceleration=100, pulses=3200),
            _sent("51 FD 01 2C 64 00 0C 80 6B", "3.2.14", direction=0, speed=300, acceleration=100, pulses=3200),
            _sent("01 FD 01 40 02 00 FA 00 3B", "4.5.1", direction=0, speed=320, acceleration=2, pulses=64000),
            _sent("01 FD 81 40 02 00 FA 00 BB", "4.5.1", direction=1, speed=320, acceleration=2, pulses=64000),
            _sent("01 FD 01 40 05 09 C4 00 11", "5.5", direction=0, speed=320, acceleration=5, pulses=640000),
            _answered("01 FD 01 FF", "5.5", status=1),
            _answered("01 FD 02 00", "5.5", status=2),
            _sent("01 FD 81 40 08 30 D4 00 CB", "5.5", direction=1, speed=320, acceleration=8, pulses=3200000),
            _answered("01 FD 01 FF", "5.5", status=1),
        ),
    ),
    # 4.6 Position mode 2: absolute, in pulses
    _stop(
        Verb.STOP_ABSOLUTE_PULSES, 0xFE, "4.6.2", "Stop an absolute move by pulses.",
        *mks.position_body(24, "pulses", "absPulses", fixed=0),
        vectors=(
            _sent("01 FE 00 00 04 00 00 00 03", "4.6.2", speed=0, acceleration=4, position=0),
            _sent("01 FE 00 00 00 00 00 00 FF", "4.6.2", speed=0, acceleration=0, position=0),
        ),
    ),
    _run(
        Verb.MOVE_ABSOLUTE_PULSES, 0xFE, "4.6.1", "Move to a position counted in pulses.",
        *_position_body("pulses", "absPulses"),
        vectors=(
            _sent("01 FE 02 58 02 00 40 00 9B", "4.6.1", speed=600, acceleration=2, position=0x4000),
            _sent("01 FE 02 58 02 FF C0 00 1A", "4.6.1", speed=600, acceleration=2, position=-0x4000),
        ),
    ),
    # 4.7 Position mode 3: relative, in encoder counts
    _stop(
        Verb.STOP_RELATIVE_AXIS, 0xF4, "4.7.2", "Stop a relative move by the encoder.",
        *mks.position_body(24, "counts", "relAxis", fixed=0),
        vectors=(
            _sent("01 F4 00 00 04 00 00 00 F9", "4.7.2", speed=0, acceleration=4, position=0),
            _sent("01 F4 00 00 00 00 00 00 F5", "4.7.2", speed=0, acceleration=0, position=0),
        ),
    ),
    _run(
        Verb.MOVE_RELATIVE_AXIS, 0xF4, "4.7.1", "Move by a number of encoder counts.",
        *_position_body("counts", "relAxis"),
        vectors=(
            _sent("01 F4 02 58 02 00 40 00 91", "4.7.1", speed=600, acceleration=2, position=0x4000),
            Vector(
                "01 F4 02 58 02 FF C0 00 09",
                {"speed": 600, "acceleration": 2, "position": -0x4000},
                section="4.7.1",
                erratum="mks-can-72",
                corrected="01 F4 02 58 02 FF C0 00 10",
            ),
        ),
    ),
    # 4.8 Position mode 4: absolute, in encoder counts
    _stop(
        Verb.STOP_ABSOLUTE_AXIS, 0xF5, "4.8.2", "Stop an absolute move by the encoder.",
        *mks.position_body(24, "counts", "absAxis", fixed=0),
        vectors=(
            _sent("01 F5 00 00 04 00 00 00 FA", "4.8.2", speed=0, acceleration=4, position=0),
            _sent("01 F5 00 00 00 00 00 00 F6", "4.8.2", speed=0, acceleration=0, position=0),
        ),
    ),
    _run(
        Verb.MOVE_ABSOLUTE_AXIS, 0xF5, "4.8.1", "Move to a position counted by the encoder.",
        *_position_body("counts", "absAxis"),
        notes=(_SPEED, "a new speed or target may be sent while the shaft is still on its way"),
        vectors=(
            _sent("01 F5 02 58 02 00 40 00 92", "4.8.1", speed=600, acceleration=2, position=0x4000),
            _sent("01 F5 02 58 02 FF C0 00 11", "4.8.1", speed=600, acceleration=2, position=-0x4000),
        ),
    ),
)  # fmt: skip

# 3.9: the parameter read, made from the settings ----------------------------------------------------------------------

_READ_PARAMETER_CODE = 0x00
_UNREADABLE = Layout(fixed("unreadable", 16, 0xFFFF, printed="FFH FFH"))
_READABLE = tuple(c for c in _PARAMETERS if c.readable)


def _choices(settings: Iterable[Command]) -> type[IntEnum]:
    """Return the codes of settings by the settings' names."""
    members = {c.name.removeprefix("set_").upper(): c.code for c in settings}
    return IntEnum("Parameter", members)  # type: ignore[return-value]  # the functional form makes a class


def _parameter_replies(commands: Iterable[Command]) -> tuple[Form, ...]:
    """Return what a parameter read is answered with, under the code asked for.

    FF FF comes first: no setting of two bytes can have that value. A setting's own layouts follow it. Every code of the
    catalogue has the first form, for a host may ask for any.
    """
    readable = {c.code: c for c in commands if c.readable}
    forms = []
    for code in dict.fromkeys((*(c.code for c in commands), _READ_PARAMETER_CODE)):
        asked = {"parameter": code}
        forms.append(Form(_UNREADABLE, "unreadable", code, needs_request=True, request_values=asked))
        setting = readable.get(code)
        if setting is not None:
            forms += [
                Form(f.layout, "reply", code, setting.models, needs_request=True, request_values=asked)
                for f in setting.request_forms
            ]
    return tuple(forms)


Parameter = _choices(_READABLE)

_READ_PARAMETER = Command(
    name=Verb.READ_PARAMETER.value,
    verb=Verb.READ_PARAMETER,
    code=_READ_PARAMETER_CODE,
    section="3.9",
    summary="Read a setting back.",
    risk=mks.READ_RISK,
    request=Layout(u8("parameter", choices=Parameter, printed="code")),
    reply=_parameter_replies((*_PARAMETERS, *_MOTION)),
    replies=Replies(failed_forms={"unreadable"}),
    notes=("the reply has the code of the setting and the layout that sets it; FF FF: it cannot be read",),
)

COMMANDS = (*_PARAMETERS, _READ_PARAMETER, *_MOTION)

DIALECT = Dialect(
    name="mks-can",
    title="MKS SERVO42E/57E, CAN",
    manual="MKS SERVO42E/57E CAN V1.0.1",
    bus="can",
    link=CanLink(),
    commands=COMMANDS,
    errata=ERRATA,
    models=("42E", "57E"),
    addresses=(1, 0x7FF),
    broadcast=0,
    baud_rates=(500_000, 125_000, 250_000, 1_000_000),
    family="mks",
    sections=dict.fromkeys(Subject, "3"),
    traits=frozenset({Trait.DIRECTION_TURNS_BUS_MOTION, Trait.BACKS_OFF_BY_ANGLE}),
    ramp=mks.RAMP,
    subdivision=mks.SUBDIVISION,
    counts_per_turn=mks.COUNTS_PER_TURN,
    rates=BIT_RATES,
    said_in="analyzer.protocols.mks_can_statements",
)
