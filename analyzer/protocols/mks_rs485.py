"""MKS SERVO42D/57D, native RS485 frames: Parts 4 to 7 of the RS485 manual V1.0.5 as a table.

    request   FA 01 F6 | 01 40 02 | 34        head, address, code | data | sum8 of all before
    reply     FB 01 F6 | 01       | F3
    package   FC | 5 slots of address, code, data and zeros, 10 bytes each | sum8      52 bytes, never answered

Rules kept here:
- Commands stand in the manual's order, but for stops: a stop is its run with zeros everywhere but in the acceleration,
  so it stands directly before that run and is tried first.
- A stop's reply is one only while a stop is open; a stray reply of the code counts as the run's.
- Motion commands answer twice: when they begin, and when they are done (unless `active` is off). `respond` off silences
  only them.
- Address 0 reaches all drives, a group address several; neither is answered.
- If the manual contradicts itself, `mks_rs485_errata` gives the reading taken as true.

Not printed in the manual, so not known here:
- the reply time of a drive, and its reply to an unknown code;
- the defaults of the home speed, the zero speed and the limit remap.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from analyzer.catalogue import Command, Dialect, Risk, RiskRule, Role, Slots, Subject, Trait, Vector, Verb
from analyzer.layout import Effect, Layout, reserved, rest, u8
from analyzer.link import HeadLink, Package, sum8
from analyzer.protocols import mks_shared as mks
from analyzer.protocols.mks_rs485_errata import ERRATA

_SPEED = "the drive limits the speed to that of its work mode: 400, 1500 or 3000 rpm"
_LIMIT = "with the end limit on, the shaft is let go when homing meets the left switch"


_read, _do = mks.read, mks.do
_run = partial(mks.run, modes=mks.SERIAL_MODES, notes=(_SPEED,))
_stop = partial(mks.stop, modes=mks.SERIAL_MODES)


def _bare(printed: str, section: str = "") -> Vector:
    """Declare a request of the manual that has neither data nor a checksum in numbers."""
    return mks.sent(printed, section, checksum=False)


_sent, _answered = mks.sent, mks.answered

# Part 5: parameters ---------------------------------------------------------------------------------------------------

_PARAMETERS = (
    # 5.1 Reading
    _read(
        Verb.READ_ENCODER_CARRY, 0x30, "5.1.1", "Read the encoder as whole turns and the value within the turn.",
        mks.CARRY, mks.ENCODER,
        notes=("the value follows the shaft whether or not the motor is enabled",),
        vectors=(
            _bare("FA 01 30", "5.1.1"),
            _sent("FA 01 30 2B", "7.3"),
            _answered("FB 01 30 FF FF FF FF 22 69 B3", "7.3", carry=-1, encoder=0x2269),
        ),
    ),
    _read(
        Verb.READ_POSITION, 0x31, "5.1.2", "Read the encoder as one running count over all turns.", mks.POSITION,
        vectors=(_bare("FA 01 31", "5.1.2"),),
    ),
    _read(
        Verb.READ_SPEED, 0x32, "5.1.3", "Read the speed of the shaft.", mks.ACTUAL_SPEED,
        vectors=(_bare("FA 01 32", "5.1.3"),),
    ),
    _read(
        Verb.READ_PULSES, 0x33, "5.1.4", "Read how many pulses were received.", mks.PULSE_COUNT,
        vectors=(_bare("FA 01 33", "5.1.4"),),
    ),
    _read(
        Verb.READ_IO, 0x34, "5.1.5", "Read the levels of the ports.",
        reserved(4), *mks.pins("out_2", "out_1", "in_2", "in_1"),
        notes=(
            "only the 57D has in_2, out_1 and out_2; out_1 is 0 while the stall protection holds",
            "with the limits remapped, in_1 is the En pin and in_2 the Dir pin",
        ),
        vectors=(_bare("FA 01 34", "5.1.5"),),
    ),
    _read(
        Verb.READ_ANGLE_ERROR, 0x39, "5.1.6", "Read the wanted angle minus the angle of the shaft.", mks.ANGLE_ERROR,
        vectors=(_bare("FA 01 39", "5.1.6"),),
    ),
    _read(
        Verb.READ_ENABLED, 0x3A, "5.1.7", "Read whether the motor is enabled.", replace(mks.ENABLED, printed="enable"),
        vectors=(_bare("FA 01 3A", "5.1.7"),),
    ),
    _read(
        Verb.READ_ZERO_STATUS, 0x3B, "5.1.8", "Read how the way back to zero at power-on went.",
        mks.status(mks.ZeroStatus),
        vectors=(_bare("FA 01 3B", "5.1.8"),),
    ),
    _do(
        Verb.RELEASE_PROTECTION, 0x3D, "5.1.9", "End the locked-rotor protection, so that the motor holds again.",
        risk=mks.RELEASE_RISK,
        vectors=(_bare("FA 01 3D", "5.1.9"),),
    ),
    _read(
        Verb.READ_PROTECTION, 0x3E, "5.1.10", "Read whether the locked-rotor protection has let the shaft go.",
        mks.status(mks.Protection),
        vectors=(_bare("FA 01 3E", "5.1.10"),),
    ),
    # 5.2 Setting
    _do(
        Verb.CALIBRATE, 0x80, "5.2.1", "Calibrate the encoder; the shaft turns and must carry no load.", reserved(8),
        risk=mks.CALIBRATION_RISK, status=mks.status(mks.CalibrationStatus), replies=mks.CALIBRATION, printed="CAL",
        notes=("here status 0 means that it goes on, not that it failed",),
        vectors=(_sent("FA 01 80 00 7B", "4"), _bare("FA 01 80 00", "5.2.1")),
    ),
    _do(
        Verb.SET_WORK_MODE, 0x82, "5.2.2", "Set who runs the motor, pulses or the bus, and by which control.",
        mks.WORK_MODE, risk=mks.TORQUE_RISK, printed="Mode",
    ),
    _do(
        Verb.SET_CURRENT, 0x83, "5.2.3", "Set the working current; in vFOC it is the most that may flow.", mks.CURRENT,
        risk=mks.TORQUE_RISK, printed="Ma",
    ),
    _do(
        Verb.SET_HOLDING_CURRENT, 0x9B, "5.2.4", "Set the holding current as a part of the working current.",
        mks.HOLDING_CURRENT, risk=mks.TORQUE_RISK, printed="HoldMa",
        notes=("without effect in the vFOC modes",),
    ),
    _do(
        Verb.SET_SUBDIVISION, 0x84, "5.2.5", "Set the pulses of a full step.",
        u8("subdivision", default=16, printed="micstep", note="0 stands for 256", effect=Effect.SUBDIVISION), printed="MStep",
        notes=("at another subdivision than 16, 32 or 64 a speed turns the shaft at speed x 16 / subdivision",),
    ),
    _do(
        Verb.SET_ENABLE_LEVEL, 0x85, "5.2.6", "Set the level of the En pin at which the motor holds.",
        mks.ENABLE_LEVEL, risk=mks.TORQUE_RISK, printed="En",
    ),
    _do(
        Verb.SET_DIRECTION, 0x86, "5.2.7", "Set which way pulses turn the shaft.", mks.MOTOR_DIRECTION, printed="Dir",
        notes=("without effect on motion by the bus",),
    ),
    _do(
        Verb.SET_SCREEN_OFF, 0x87, "5.2.8", "Set whether the display goes dark after about 15 s.", mks.SCREEN_OFF,
        printed="AutoSDD",
    ),
    _do(
        Verb.SET_PROTECTION, 0x88, "5.2.9", "Set whether a locked rotor lets the shaft go.", mks.PROTECTION,
        risk=mks.PROTECTION_RISK, printed="Protect",
    ),
    _do(
        Verb.SET_INTERPOLATION, 0x89, "5.2.10", "Set whether steps are interpolated to 256.", mks.INTERPOLATION,
        printed="MPlyer",
    ),
    _do(
        Verb.SET_BAUD_RATE, 0x8A, "5.2.11", "Set the speed of the serial line.", mks.BAUD_RATE,
        risk=mks.LINK_RISK, printed="UartBaud",
    ),
    _do(
        Verb.SET_ADDRESS, 0x8B, "5.2.12", "Set the address of the drive.", mks.new_address(255),
        risk=mks.LINK_RISK, printed="UartAddr",
    ),
    _do(
        Verb.SET_RESPOND, 0x8C, "5.2.13", "Set whether motion is answered, and whether its end is.",
        mks.RESPOND, mks.ACTIVE, printed="UartRSP",
        notes=("respond 0: no reply to motion commands; active 0: the first reply comes, that of the end does not",),
    ),
    _do(
        Verb.SET_MODBUS, 0x8E, "5.2.14", "Set whether the drive speaks Modbus-RTU instead.", mks.MODBUS,
        risk=mks.LINK_RISK, printed="Mb_RTU",
    ),
    _do(Verb.SET_KEY_LOCK, 0x8F, "5.2.15", "Lock or unlock the keys.", mks.KEY_LOCK),
    _do(
        Verb.SET_GROUP_ADDRESS, 0x8D, "5.2.16", "Set a second address that several drives share.",
        u8("group_address", minimum=1, maximum=255, printed="addr", effect=Effect.GROUP), risk=mks.LINK_RISK,
        notes=("what is sent to a group address is executed and not answered",),
    ),
    # 5.3 Home
    _do(
        Verb.SET_HOME, 0x90, "5.3.1", "Set the end stop's level, the way and the speed of homing, and the end limit.",
        mks.HOME_TRIGGER, mks.HOME_DIRECTION, mks.HOME_SPEED, mks.END_LIMIT,
        risk=mks.SET_HOME_RISK, printed="HmTrig, HmDir, HmSpeed, EndLimit",
        notes=("a changed limit holds only after homing", _LIMIT),
    ),
    _do(
        Verb.HOME, 0x91, "5.3.2", "Run until the end stop, or without one until an obstacle stops the shaft.",
        risk=mks.HOME_RISK, status=mks.status(mks.HomeStatus), replies=mks.HOMING, printed="GoHome",
        notes=("from a closed end stop the shaft first turns the other way until it opens", _LIMIT),
        vectors=(_bare("FA 01 91", "5.3.2"),),
    ),
    _do(
        Verb.SET_ZERO, 0x92, "5.3.3", "Make the present position zero, without a move.",
        vectors=(_bare("FA 01 92", "5.3.3"),),
    ),
    _do(
        Verb.SET_NO_LIMIT_HOME, 0x94, "5.3.4", "Set homing without an end stop: way back, method and current.",
        mks.RETURN_ANGLE, mks.HOME_MODE, mks.HOME_CURRENT, risk=mks.TORQUE_RISK, printed="Hm_Mode, Hm_Ma",
        notes=("the shaft runs at this current into an obstacle, goes back by the angle, and that point is zero",),
    ),
    _do(
        Verb.SET_LIMIT_REMAP, 0x9E, "5.3.5", "Set whether En and Dir serve as left and right limit.", mks.LIMIT_REMAP,
        modes=mks.SERIAL_MODES,
        notes=("gives drives with one limit port a right limit",),
    ),
    # 5.4 to 5.6
    _do(
        Verb.SET_ZERO_MODE, 0x9A, "5.4.1", "Set whether and how the shaft goes back to zero at power-on.",
        mks.ZERO_MODE, mks.SET_ZERO, mks.ZERO_SPEED, mks.ZERO_DIRECTION,
        risk=mks.ZERO_MODE_RISK, printed="0_Mode, Set 0, 0_Speed, 0_Dir",
        notes=("the way back is less than a turn",),
    ),
    _do(
        Verb.RESTORE, 0x3F, "5.5", "Put every parameter back to its default.",
        risk=mks.RESTORE_RISK, printed="Restore",
        notes=("the drive starts again and then wants a calibration",),
        vectors=(_bare("FA 01 3F", "5.5"),),
    ),
    _do(
        Verb.RESTART, 0x41, "5.6", "Start the drive again.", risk=mks.RESTART_RISK,
        vectors=(_bare("FA 01 41", "5.6"),),
    ),
)  # fmt: skip

# Part 6: motion -------------------------------------------------------------------------------------------------------

_MOTION = (
    _read(
        Verb.READ_STATUS, 0xF1, "6.2.1", "Read what the motor is doing.", mks.status(mks.MotorStatus),
        replies=mks.MOTOR_STATUS,
        vectors=(_bare("FA 01 F1", "6.2.1"),),
    ),
    _do(
        Verb.ENABLE, 0xF3, "6.2.2", "Make the motor hold, or let the shaft go.", mks.ENABLED,
        risk=mks.ENABLE_RISK, modes=mks.SERIAL_MODES,
    ),
    _do(
        Verb.EMERGENCY_STOP, 0xF7, "6.3", "Stop at once.", risk=mks.MOTION_RISK, modes=mks.SERIAL_MODES,
        notes=(mks.HALT,),
        vectors=(_bare("FA 01 F7", "6.3"),),
    ),
    # 6.5 Speed. From here on each stop stands before its run: the first form that matches wins.
    _stop(
        Verb.STOP_SPEED, 0xF6, "6.5.2", "Stop a run at a speed.", *mks.speed_body(fixed=0),
        vectors=(
            _sent("FA 01 F6 00 00 02 F3", "6.5.2", direction=0, speed=0, acceleration=2),
            _sent("FA 01 F6 00 00 00 F1", "6.5.2", direction=0, speed=0, acceleration=0),
            _sent("FA 01 F6 00 00 02", "7.4.3", checksum=False, direction=0, speed=0, acceleration=2),
            _answered("FB 01 F6 01 F3", "7.4.3", status=1),
        ),
    ),
    _run(
        Verb.RUN_SPEED, 0xF6, "6.5.1", "Run at a speed until told otherwise.", *mks.speed_body(),
        status=mks.status(), replies=mks.SET, risk=mks.RUN_SPEED_RISK,
        vectors=(
            _sent("FA 01 F6 01 40 02 34", "6.5.1", direction=0, speed=320, acceleration=2),
            _sent("FA 01 F6 81 40 02 B4", "6.5.1", direction=1, speed=320, acceleration=2),
            _sent("FA 01 F6 01 40 02", "7.4.1", checksum=False, direction=0, speed=320, acceleration=2),
            _answered("FB 01 F6 01 F3", "7.4.1", status=1),
        ),
    ),
    _do(
        Verb.SAVE_SPEED, 0xFF, "6.5.3", "Keep the present speed for the next power-on, or forget the kept one.",
        mks.SAVE_STATE, risk=mks.SAVE_RISK, status=mks.status(mks.SaveStatus), replies=mks.SAVING,
        modes=mks.SERIAL_MODES,
        notes=(
            "after saving, the shaft turns as soon as power comes on",
            "one reply with status 1 is expected, as in the worked example; 2, or 1 and then 2, are accepted",
        ),
        vectors=(
            _sent("FA 01 FF C8", "7.4.2", checksum=False, save_state=0xC8),
            _answered("FB 01 FF 01 FC", "7.4.2", status=1),
        ),
    ),
    # 6.6 Position mode 1: relative, in pulses
    _stop(
        Verb.STOP_RELATIVE_PULSES, 0xFD, "6.6.2", "Stop a relative move by pulses.",
        *mks.speed_body(fixed=0), mks.pulses(32, fixed=0),
        vectors=(
            _sent("FA 01 FD 00 00 02 00 00 00 00 FA", "6.6.2", direction=0, speed=0, acceleration=2, pulses=0),
            _sent("FA 01 FD 00 00 00 00 00 00 00 F8", "6.6.2", direction=0, speed=0, acceleration=0, pulses=0),
            _sent(
                "FA 01 FD 00 00 08 00 00 00 00", "7.5.2", checksum=False,
                direction=0, speed=0, acceleration=8, pulses=0,
            ),
            _answered("FB 01 FD 01 FA", "7.5.2", status=1),
            _answered("FB 01 FD 02 FB", "7.5.2", status=2),
        ),
    ),
    _run(
        Verb.MOVE_RELATIVE_PULSES, 0xFD, "6.6.1", "Move by a number of pulses.", *mks.speed_body(), mks.pulses(32),
        vectors=(
            _sent("FA 01 FD 02 80 02 00 00 FA 00 76", "5.2.13", direction=0, speed=640, acceleration=2, pulses=64000),
            _sent("FA 01 FD 01 2C 64 00 00 0C 80 15", "5.2.16", direction=0, speed=300, acceleration=100, pulses=3200),
            _sent("FA 00 FD 01 2C 64 00 00 0C 80 14", "5.2.16", direction=0, speed=300, acceleration=100, pulses=3200),
            _sent("FA 50 FD 01 2C 64 00 00 0C 80 64", "5.2.16", direction=0, speed=300, acceleration=100, pulses=3200),
            _sent("FA 51 FD 01 2C 64 00 00 0C 80 65", "5.2.16", direction=0, speed=300, acceleration=100, pulses=3200),
            _sent("FA 01 FD 01 40 02 00 00 FA 00 35", "6.6.1", direction=0, speed=320, acceleration=2, pulses=64000),
            _sent("FA 01 FD 81 40 02 00 00 FA 00 B5", "6.6.1", direction=1, speed=320, acceleration=2, pulses=64000),
            _sent(
                "FA 01 FD 02 80 05 00 09 C4 00", "7.5.1", checksum=False,
                direction=0, speed=640, acceleration=5, pulses=640000,
            ),
            _answered("FB 01 FD 01 FA", "7.5.1", status=1),
            _answered("FB 01 FD 02 FB", "7.5.1", status=2),
            _sent(
                "FA 01 FD 82 80 08 00 30 D4 00", "7.5.2", checksum=False,
                direction=1, speed=640, acceleration=8, pulses=3200000,
            ),
            _answered("FB 01 FD 01 FA", "7.5.2", status=1),
        ),
    ),
    # 6.7 Position mode 2: absolute, in pulses
    _stop(
        Verb.STOP_ABSOLUTE_PULSES, 0xFE, "6.7.2", "Stop an absolute move by pulses.",
        *mks.position_body(32, "pulses", "absPulses", fixed=0),
        vectors=(
            _sent("FA 01 FE 00 00 04 00 00 00 00 FD", "6.7.2", speed=0, acceleration=4, position=0),
            _sent("FA 01 FE 00 00 00 00 00 00 00 F9", "6.7.2", speed=0, acceleration=0, position=0),
        ),
    ),
    _run(
        Verb.MOVE_ABSOLUTE_PULSES, 0xFE, "6.7.1", "Move to a position counted in pulses.",
        *mks.position_body(32, "pulses", "absPulses"),
        vectors=(
            _sent("FA 01 FE 02 58 02 00 00 40 00 95", "6.7.1", speed=600, acceleration=2, position=0x4000),
            _sent("FA 01 FE 02 58 02 FF FF C0 00 13", "6.7.1", speed=600, acceleration=2, position=-0x4000),
        ),
    ),
    # 6.8 Position mode 3: relative, in encoder counts
    _stop(
        Verb.STOP_RELATIVE_AXIS, 0xF4, "6.8.2", "Stop a relative move by the encoder.",
        *mks.position_body(32, "counts", "relAxis", fixed=0),
        vectors=(
            _sent("FA 01 F4 00 00 04 00 00 00 00 F3", "6.8.2", speed=0, acceleration=4, position=0),
            _sent("FA 01 F4 00 00 00 00 00 00 00 EF", "6.8.2", speed=0, acceleration=0, position=0),
        ),
    ),
    _run(
        Verb.MOVE_RELATIVE_AXIS, 0xF4, "6.8.1", "Move by a number of encoder counts.",
        *mks.position_body(32, "counts", "relAxis"),
        vectors=(
            _sent("FA 01 F4 02 58 02 00 00 40 00 8B", "6.8.1", speed=600, acceleration=2, position=0x4000),
            Vector(
                "FA 01 F4 02 58 02 FF FF C0 00 03",
                {"speed": 600, "acceleration": 2, "position": -0x4000},
                section="6.8.1",
                erratum="mks-rs485-48",
                corrected="FA 01 F4 02 58 02 FF FF C0 00 09",
            ),
        ),
    ),
    # 6.9 Position mode 4: absolute, in encoder counts
    _stop(
        Verb.STOP_ABSOLUTE_AXIS, 0xF5, "6.9.2", "Stop an absolute move by the encoder.",
        *mks.position_body(32, "counts", "absAxis", fixed=0),
        vectors=(
            _sent("FA 01 F5 00 00 04 00 00 00 00 F4", "6.9.2", speed=0, acceleration=4, position=0),
            _sent("FA 01 F5 00 00 00 00 00 00 00 F0", "6.9.2", speed=0, acceleration=0, position=0),
        ),
    ),
    _run(
        Verb.MOVE_ABSOLUTE_AXIS, 0xF5, "6.9.1", "Move to a position counted by the encoder.",
        *mks.position_body(32, "counts", "absAxis"),
        notes=(_SPEED, "a new speed or target may be sent while the shaft is still on its way"),
        vectors=(
            _sent("FA 01 F5 02 58 02 00 00 40 00 8C", "6.9.1", speed=600, acceleration=2, position=0x4000),
            _sent("FA 01 F5 02 58 02 FF FF C0 00 0A", "6.9.1", speed=600, acceleration=2, position=-0x4000),
        ),
    ),
)  # fmt: skip

# 5.7: the package -----------------------------------------------------------------------------------------------------

_SINGLE = (*_PARAMETERS, *_MOTION)

#: A slot can hold any command, and a code that is not in the table.
_PACKAGE_RISK = RiskRule(frozenset({Risk.UNKNOWN}).union(*(c.all_risks for c in _SINGLE)))

_LONG_PACKAGE = Command(
    name=Verb.LONG_PACKAGE.value,
    verb=Verb.LONG_PACKAGE,
    code=0xFC,
    section="5.7",
    summary="Send up to five commands to five drives at once.",
    risk=(_PACKAGE_RISK,),
    request=Layout(rest("slot_bytes")),
    reply=None,
    slots=Slots(5, 10),
    notes=(
        "of two slots for one address only the first is executed; a slot of zeros is unused",
        "the risks are those of everything a slot can hold; what a package does is told by its slots",
    ),
    vectors=(
        Vector(
            "FC 01 F6 00 32 0A 00 00 00 00 00 02 F6 80 64 20 00 00 00 00 00 03 FD 01 2C 02 00 04 E2 00 00"
            " 04 F4 02 58 64 00 19 00 00 00 05 F5 04 B0 C8 00 0C 80 00 00 11",
            section="5.7",
        ),
        Vector(
            "FC 01 F6 00 32 0A 00 00 00 00 02 F6 80 64 20 00 00 00 00 03 FD 01 2C 02"
            " 00 04 E2 00 00 04 F4 02 58 64 00 19 00 00 00 05 F5 04 B0 C8 00 0C 80 00 00 11",
            section="5.7",
            erratum="mks-rs485-30",
            corrected="FC 01 F6 00 32 0A 00 00 00 00 00 02 F6 80 64 20 00 00 00 00 00 03 FD 01 2C 02 00 04 E2 00 00"
            " 04 F4 02 58 64 00 19 00 00 00 05 F5 04 B0 C8 00 0C 80 00 00 11",
        ),
    ),
)

COMMANDS = (*_PARAMETERS, _LONG_PACKAGE, *_MOTION)

DIALECT = Dialect(
    name="mks-rs485",
    title="MKS SERVO42D/57D, native RS485",
    manual="MKS SERVO42D/57D RS485 V1.0.5",
    bus="serial",
    link=HeadLink(heads={0xFA: Role.REQUEST, 0xFB: Role.REPLY}, check=sum8, package=Package(head=0xFC, length=52)),
    commands=COMMANDS,
    errata=ERRATA,
    models=("42D", "57D", "28D", "35D"),
    addresses=(1, 255),
    broadcast=0,
    baud_rates=(38400, 9600, 19200, 25000, 57600, 115200, 256000),
    family="mks",
    siblings=("mks-modbus",),
    chosen_by=mks.Switch.DISABLED,
    sections=dict.fromkeys(Subject, "4"),
    traits=frozenset({Trait.LETS_GO_AT_END_LIMIT, Trait.SEEN_WITHOUT_CHECKSUM}),
    ramp=mks.RAMP,
    subdivision=mks.SUBDIVISION,
    counts_per_turn=mks.COUNTS_PER_TURN,
    mode_speeds=mks.MODE_MAXIMUM_SPEEDS,
    rates=mks.BAUD_RATES,
    said_in="analyzer.protocols.mks_rs485_statements",
)
