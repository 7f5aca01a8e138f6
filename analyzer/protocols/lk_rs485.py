"""Lingkong (LK) motors on RS485: the commands of manual V2.36 as a table.

The wire, the same for requests and replies, all numbers little-endian:

    3E code id length sum | data ... sum
    `----- header -----'    `- only when length > 0

    sum after the header   low byte of 3E + code + id + length
    sum after the data     low byte of the data bytes alone
    length                 counts the data, not its sum

Rules kept here:
- A layout covers the data alone. The header and both sums belong to the link.
- The commands stand in the manual's order; the section is the number of its heading ("25" for 0x95), and `appendix 1`
  is its table of parameters.
- A positive angle or speed is clockwise. The manual says so for reads; the same is assumed for writes.
- MS motors report output power where the others report torque current, in the same bytes. The wire does not
  tell the model. Without a chosen model these bytes are torque current in LSB, since its scale also differs by model.
- The manual prints no frame. Every vector is computed from its tables.

What is not known here:
- A reply has the head of its request. 0x80, 0x81, 0x88, 0x93 and 0x95 are echoed byte by byte, and 0x8C, 0xC0 and 0xC1
  have one length both ways: who sent those is for the open request to say.
- The scale of an MH motor's currents, the units of powers, limits and ramps, and the bits of an encoder.
- Commands for several motors, which the manual's list of baud rates mentions and nothing describes.
"""

from __future__ import annotations

from enum import IntEnum
from fractions import Fraction
from functools import partial

from analyzer.catalogue import Command, Dialect, Form, Motion, MotionKind, Risk, Role, Subject, Vector, Verb, always, when
from analyzer.layout import (
    Effect,
    Field,
    Layout,
    ModelLimits,
    Order,
    StatePart,
    bits,
    fixed,
    i8,
    i16,
    i32,
    reserved,
    sint,
    u8,
    u16,
    u32,
    uint,
)
from analyzer.link import LkLink
from analyzer.protocols.lk_rs485_errata import ERRATA


class MotorState(IntEnum):
    """Whether the motor obeys motion commands (motorState)."""

    ON = 0x00
    OFF = 0x10


class SpinDirection(IntEnum):
    """Which way round a single-turn move goes (spinDirection)."""

    CW = 0
    CCW = 1


class BrakeControl(IntEnum):
    """What 0x8C asks of the brake. Without power the brake holds the shaft."""

    POWER_OFF = 0x00
    RELEASE = 0x01
    READ = 0x10


class BrakeState(IntEnum):
    """What 0x8C reports of the brake. Without power the brake holds the shaft."""

    POWER_OFF = 0x00
    RELEASED = 0x01


class Parameter(IntEnum):
    """The control parameters of appendix 1, by number (controlParamID)."""

    ANGLE_PID = 10
    SPEED_PID = 11
    CURRENT_PID = 12
    TORQUE_LIMIT = 30
    SPEED_LIMIT = 32
    ANGLE_LIMIT = 34
    CURRENT_RAMP = 36
    SPEED_RAMP = 38


CURRENT_MODELS = ("MF", "MG", "MH")  # measure phase currents, so report and obey a torque current
POWER_MODELS = ("MS",)  # measure none, so report and obey a power

HUNDREDTH = Fraction(1, 100)
CURRENT_SCALES = {"MF": ModelLimits(scale=Fraction(33, 4096), unit="A"), "MG": ModelLimits(scale=Fraction(66, 4096), unit="A")}
ENCODER_NOTE = "14, 15 or 16 bits by the encoder's resolution, which the wire does not tell; of 18 bits the upper 16"

u16le = partial(u16, order=Order.LITTLE)
u32le = partial(u32, order=Order.LITTLE)
i16le = partial(i16, order=Order.LITTLE)
i32le = partial(i32, order=Order.LITTLE)
i64le = partial(sint, width=64, order=Order.LITTLE)

# --- data that several commands share ---------------------------------------------------------------------------------

EMPTY = Layout()

TEMPERATURE = i8("temperature", unit="degC", printed="temperature", state=StatePart("temperature", 1.0))

ERROR_BITS = (
    bits("input_lost", 1, printed="errorState bit 7"),
    bits("stalled", 1, printed="errorState bit 6"),
    bits("short_circuit", 1, printed="errorState bit 5"),
    bits("overcurrent", 1, printed="errorState bit 4"),
    bits("motor_hot", 1, printed="errorState bit 3"),
    bits("drive_hot", 1, printed="errorState bit 2"),
    bits("high_voltage", 1, printed="errorState bit 1"),
    bits("low_voltage", 1, printed="errorState bit 0"),
)

STATE_1 = Layout(
    TEMPERATURE,
    i16le("voltage", unit="V", scale=HUNDREDTH, printed="voltage", state=StatePart("voltage", 1.0)),
    i16le("current", unit="A", scale=HUNDREDTH, printed="current", note="of the supply", state=StatePart("current", 1.0)),
    u8("state", choices=MotorState, printed="motorState"),
    *ERROR_BITS,
)

SPEED = i16le("speed", unit="deg/s", printed="speed", state=StatePart("speed", 1 / 6))
ENCODER = u16le("encoder", unit="counts", printed="encoder", note=ENCODER_NOTE)
TORQUE_CURRENT = i16le("torque_current", unit="LSB", printed="iq", models=CURRENT_SCALES)
POWER = i16le("power", minimum=-1000, maximum=1000, unit="LSB", printed="power")

TORQUE_STATE_2 = Layout(TEMPERATURE, TORQUE_CURRENT, SPEED, ENCODER)
POWER_STATE_2 = Layout(TEMPERATURE, POWER, SPEED, ENCODER)
STATE_2 = (
    Form(TORQUE_STATE_2, name="torque_current", models=CURRENT_MODELS),
    Form(POWER_STATE_2, name="power", models=POWER_MODELS),
)

DIRECTION = u8("direction", choices=SpinDirection, printed="spinDirection")
POSITION_TARGET = i64le("position", unit="deg", scale=HUNDREDTH, printed="angleControl")
ANGLE_TARGET = u16le("angle", maximum=35999, unit="deg", scale=HUNDREDTH, printed="angleControl")
DISTANCE = i32le("position", unit="deg", scale=HUNDREDTH, printed="angleIncrement", note="its sign is the direction")
MAX_SPEED = u32le("max_speed", unit="deg/s", scale=HUNDREDTH, printed="maxSpeed")


def _parameter_form(parameter: Parameter, *fields: Field) -> Form:
    number = fixed("parameter", 8, int(parameter), choices=Parameter, printed="controlParamID")
    return Form(Layout(number, *fields), name=parameter.name.lower())


def _gains(loop: str) -> tuple[Field, ...]:
    return tuple(u16le(f"{loop}_{gain}", printed=f"{loop}Pid{gain.title()}") for gain in ("kp", "ki", "kd"))


PARAMETER = u8("parameter", choices=Parameter, printed="controlParamID")
PARAMETER_FORMS = (
    _parameter_form(Parameter.ANGLE_PID, *_gains("angle")),
    _parameter_form(Parameter.SPEED_PID, *_gains("speed")),
    _parameter_form(Parameter.CURRENT_PID, *_gains("current")),
    _parameter_form(
        Parameter.TORQUE_LIMIT,
        reserved(16),
        i16le("torque_limit", unit="LSB", printed="inputTorqueLimit", effect=Effect.CURRENT),
        reserved(16),
    ),
    _parameter_form(Parameter.SPEED_LIMIT, reserved(16), i32le("speed_limit", unit="LSB", printed="inputSpeedLimit")),
    _parameter_form(Parameter.ANGLE_LIMIT, reserved(16), i32le("angle_limit", unit="LSB", printed="inputAngleLimit")),
    _parameter_form(Parameter.CURRENT_RAMP, reserved(16), i32le("current_ramp", unit="LSB", printed="inputCurrentRamp")),
    _parameter_form(Parameter.SPEED_RAMP, reserved(16), i32le("speed_ramp", unit="LSB", printed="inputSpeedRamp")),
    # A number that appendix 1 does not list keeps its bytes, in the order of the wire.
    Form(
        Layout(PARAMETER, uint("parameter_bytes", 48, printed="controlParamByte1 to controlParamByte6")),
        name="unlisted_parameter",
    ),
)
#: The numbers between those of `Parameter`, first and last.
UNLISTED_PARAMETERS = ((0, 9), (13, 29), (31, 31), (33, 33), (35, 35), (37, 37), (39, 255))


def _motion(kind: MotionKind, distance: str = "", *, speed: str = "", direction: str = "", counted_by: str = "") -> Motion:
    return Motion(kind=kind, speed=speed, distance=distance, direction=direction, counted_by=counted_by, stops=("stop",))


HOLD = Motion(kind=MotionKind.HOLD)


def _request(printed: str, models: tuple[str, ...] = (), /, **values: int) -> Vector:
    return Vector(printed, values, Role.REQUEST, computed=True, models=models)


def _reply(printed: str, models: tuple[str, ...] = (), /, **values: int) -> Vector:
    return Vector(printed, values, Role.REPLY, computed=True, models=models)


def _torque_state(printed: str, temperature: int, torque_current: int, speed: int, encoder: int) -> Vector:
    return _reply(printed, CURRENT_MODELS, temperature=temperature, torque_current=torque_current, speed=speed, encoder=encoder)


def _power_state(printed: str, temperature: int, power: int, speed: int, encoder: int) -> Vector:
    return _reply(printed, POWER_MODELS, temperature=temperature, power=power, speed=speed, encoder=encoder)


def _echoed(printed: str, **values: int) -> tuple[Vector, Vector]:
    return _request(printed, **values), _reply(printed, **values)


def _errors(*names: str) -> dict[str, int]:
    return {f.name: int(f.name in names) for f in ERROR_BITS}


# --- the manual's commands, in its order ------------------------------------------------------------------------------

COMMANDS = (
    Command(
        "read_state_1", Verb.READ_STATE_1, 0x9A, "1",
        "Read temperature, supply voltage and current, motor state and error flags.",
        risk=(always(Risk.READ),), request=EMPTY, reply=STATE_1,
        vectors=(
            _request("3E 9A 01 00 D9"),
            _reply(
                "3E 9A 01 07 E0 22 6C 09 DD FF 00 00 73", temperature=34, voltage=2412, current=-35, state=0x00, **_errors()
            ),
            _request("3E 9A 20 00 F8"),
            _reply(
                "3E 9A 20 07 FF F9 9C 04 70 00 10 41 5A",
                temperature=-7, voltage=1180, current=112, state=0x10, **_errors("stalled", "low_voltage"),
            ),
        ),
    ),
    Command(
        "clear_errors", Verb.CLEAR_ERRORS, 0x9B, "2", "Clear the error flags, and read what 0x9A reads.",
        # A motor that was held by an error may go on.
        risk=(always(Risk.SETTING, Risk.MOTION),), request=EMPTY, reply=STATE_1, motion=HOLD,
        notes=("a flag whose cause lasts stays set",),
        vectors=(
            _request("3E 9B 01 00 DA"),
            _reply("3E 9B 01 07 E1 29 5E 09 04 00 00 00 94", temperature=41, voltage=2398, current=4, state=0x00, **_errors()),
            _request("3E 9B 11 00 EA"),
            _reply(
                "3E 9B 11 07 F1 5C 14 0E FF FF 10 8C 18",
                temperature=92, voltage=3604, current=-1, state=0x10, **_errors("input_lost", "motor_hot", "drive_hot"),
            ),
        ),
    ),
    Command(
        "read_state_2", Verb.READ_STATE_2, 0x9C, "3", "Read temperature, torque current (MS: power), speed and encoder.",
        risk=(always(Risk.READ),), request=EMPTY, reply=STATE_2,
        vectors=(
            _request("3E 9C 01 00 DB"),
            _torque_state("3E 9C 01 07 E2 21 64 FE 24 FA FF 3F DF", 33, -412, -1500, 16383),
            _request("3E 9C 09 00 E3"),
            _power_state("3E 9C 09 07 EA 1C 80 FD D0 02 40 9C 47", 28, -640, 720, 40000),
        ),
    ),
    Command(
        "read_state_3", Verb.READ_STATE_3, 0x9D, "4", "Read temperature and the three phase currents; not on MS.",
        risk=(always(Risk.READ),), request=EMPTY,
        reply=Layout(
            TEMPERATURE,
            i16le("phase_a_current", unit="LSB", printed="iA", models=CURRENT_SCALES),
            i16le("phase_b_current", unit="LSB", printed="iB", models=CURRENT_SCALES),
            i16le("phase_c_current", unit="LSB", printed="iC", models=CURRENT_SCALES),
        ),
        models=CURRENT_MODELS,
        vectors=(
            _request("3E 9D 01 00 DC", CURRENT_MODELS),
            _reply(
                "3E 9D 01 07 E3 24 FA 00 7D FF 89 FF 22", CURRENT_MODELS,
                temperature=36, phase_a_current=250, phase_b_current=-131, phase_c_current=-119,
            ),
            _request("3E 9D 1E 00 F9", CURRENT_MODELS),
            _reply(
                "3E 9D 1E 07 00 F4 00 00 00 F8 FF 07 F2", CURRENT_MODELS,
                temperature=-12, phase_a_current=0, phase_b_current=-2048, phase_c_current=2047,
            ),
        ),
    ),
    Command(
        "motor_off", Verb.MOTOR_OFF, 0x80, "5", "Turn the motor off: it still answers, but performs no action.",
        risk=(always(Risk.TORQUE),), request=EMPTY, reply=EMPTY,
        notes=("the motor is on after power-up; its light is steady while on and flashes slowly while off",),
        vectors=(*_echoed("3E 80 01 00 BF"), *_echoed("3E 80 0E 00 CC")),
    ),
    Command(
        "motor_on", Verb.MOTOR_ON, 0x88, "6", "Turn the motor on, so that it obeys motion commands.",
        risk=(always(Risk.MOTION),), request=EMPTY, reply=EMPTY, motion=HOLD,
        vectors=(*_echoed("3E 88 01 00 C7"), *_echoed("3E 88 0E 00 D4")),
    ),
    Command(
        "stop", Verb.STOP, 0x81, "7", "Stop the motor and leave it on; the next motion command moves it again.",
        risk=(always(Risk.MOTION),), request=EMPTY, reply=EMPTY, motion=Motion(kind=MotionKind.STOP),
        vectors=(*_echoed("3E 81 01 00 C0"), *_echoed("3E 81 20 00 DF")),
    ),
    Command(
        "brake", Verb.BRAKE, 0x8C, "8", "Power the brake or take its power away, or read its state.",
        risk=(
            when("brake_control", 0x00, 0x01, Risk.TORQUE),
            when("brake_control", 0x02, 0x0F, Risk.TORQUE, Risk.UNKNOWN),
            when("brake_control", 0x10, None, Risk.READ),
            when("brake_control", 0x11, 0xFF, Risk.TORQUE, Risk.UNKNOWN),
        ),
        request=Layout(u8("brake_control", choices=BrakeControl, note="without power the brake holds the shaft")),
        reply=Layout(u8("brake_state", choices=BrakeState, note="without power the brake holds the shaft")),
        vectors=(
            _request("3E 8C 01 01 CC 00 00", brake_control=0x00),
            _reply("3E 8C 01 01 CC 00 00", brake_state=0x00),
            _request("3E 8C 01 01 CC 01 01", brake_control=0x01),
            _reply("3E 8C 01 01 CC 01 01", brake_state=0x01),
            _request("3E 8C 07 01 D2 10 10", brake_control=0x10),
            _reply("3E 8C 07 01 D2 01 01", brake_state=0x01),
        ),
    ),
    Command(
        "run_open_loop", Verb.RUN_OPEN_LOOP, 0xA0, "9", "Drive an MS motor with a voltage, without feedback.",
        risk=(always(Risk.MOTION, Risk.UNBOUNDED, Risk.TORQUE),),
        request=Layout(i16le("power", minimum=-850, maximum=850, unit="LSB", printed="powerControl", effect=Effect.CURRENT)),
        reply=POWER_STATE_2, motion=_motion(MotionKind.TORQUE), models=POWER_MODELS,
        vectors=(
            _request("3E A0 01 02 E1 78 00 78", POWER_MODELS, power=120),
            _power_state("3E A0 01 07 E6 1E 76 00 54 01 00 02 EB", 30, 118, 340, 512),
            _request("3E A0 05 02 E5 AE FC AA", POWER_MODELS, power=-850),
            _power_state("3E A0 05 07 EA 2F 18 FC B6 F4 FF FF EB", 47, -1000, -2890, 65535),
        ),
    ),
    Command(
        "run_torque", Verb.RUN_TORQUE, 0xA1, "10", "Hold a torque current; MF, MG and MH only.",
        risk=(always(Risk.MOTION, Risk.UNBOUNDED, Risk.TORQUE),),
        request=Layout(
            i16le(
                "torque_current",
                minimum=-2048,
                maximum=2048,
                unit="LSB",
                printed="iqControl",
                note="the limits are 16.5 A of an MF and 33 A of an MG",
                models=CURRENT_SCALES,
                effect=Effect.CURRENT,
            )
        ),
        reply=TORQUE_STATE_2, motion=_motion(MotionKind.TORQUE), models=CURRENT_MODELS,
        vectors=(
            _request("3E A1 01 02 E2 C8 00 C8", CURRENT_MODELS, torque_current=200),
            _torque_state("3E A1 01 07 E7 23 C4 00 5F 00 FF 1F 64", 35, 196, 95, 8191),
            _request("3E A1 15 02 F6 00 F8 F8", CURRENT_MODELS, torque_current=-2048),
            _torque_state("3E A1 15 07 FB 3A 11 F8 FC FF FF 7F BC", 58, -2031, -4, 32767),
        ),
    ),
    Command(
        "run_speed", Verb.RUN_SPEED, 0xA2, "11", "Run at a speed until told otherwise.",
        risk=(
            always(Risk.MOTION),
            when("speed", -0x8000_0000, -1, Risk.UNBOUNDED),
            when("speed", 1, 0x7FFF_FFFF, Risk.UNBOUNDED),
        ),
        request=Layout(i32le("speed", unit="deg/s", scale=HUNDREDTH, printed="speedControl")), reply=STATE_2,
        motion=_motion(MotionKind.RUN, speed="speed"),
        notes=("limited by Max Speed, Max Acceleration and Max Torque Current (MS: Max Power) of the setup program",),
        vectors=(
            _request("3E A2 01 04 E5 A0 8C 00 00 2C", speed=36000),
            _torque_state("3E A2 01 07 E8 1F 57 00 66 01 00 04 E1", 31, 87, 358, 1024),
            _request("3E A2 0C 04 F0 C0 1D FE FF DA", speed=-123456),
            _power_state("3E A2 0C 07 F3 27 29 FF 2E FB 61 EA C3", 39, -215, -1234, 60001),
            _request("3E A2 0C 04 F0 00 00 00 00 00", speed=0),
        ),
    ),
    Command(
        "move_multi_turn", Verb.MOVE_ABSOLUTE_AXIS, 0xA3, "12", "Move to a position counted over all turns.",
        risk=(always(Risk.MOTION),), request=Layout(POSITION_TARGET), reply=STATE_2,
        motion=_motion(MotionKind.MOVE_TO, "position", counted_by="read_position"),
        notes=(
            "the sign of target minus present position is the direction",
            "limited by Max Angle, Max Speed, Max Acceleration and Max Torque Current (MS: Max Power) of the setup program",
        ),
        vectors=(
            _request("3E A3 01 08 EA A0 8C 00 00 00 00 00 00 2C", position=36000),
            _torque_state("3E A3 01 07 E9 1D 40 00 0C 00 00 08 71", 29, 64, 12, 2048),
            _request("3E A3 08 08 F1 00 0E FA D5 FE FF FF FF D8", position=-5000000000),
            _torque_state("3E A3 08 07 F0 2C B6 FE CC F7 00 3E E1", 44, -330, -2100, 15872),
        ),
    ),
    Command(
        "move_multi_turn_limited", Verb.MOVE_ABSOLUTE_AXIS, 0xA4, "13",
        "Move to a position counted over all turns, no faster than a given speed.",
        risk=(always(Risk.MOTION),), request=Layout(POSITION_TARGET, MAX_SPEED), reply=STATE_2,
        motion=_motion(MotionKind.MOVE_TO, "position", speed="max_speed", counted_by="read_position"),
        notes=(
            "limited by Max Angle, Max Acceleration and Max Torque Current (MS: Max Power) of the setup program",
            "max_speed 0 has no meaning of its own in print; a drive was seen to move with it",
        ),
        vectors=(
            _request("3E A4 01 0C EF D8 DC FF FF FF FF FF FF 40 19 01 00 08", position=-9000, max_speed=72000),
            _torque_state("3E A4 01 07 EA 20 8A FF 3F FD B8 0B A8", 32, -118, -705, 3000),
            _request("3E A4 03 0C F1 00 EB 41 00 00 00 00 00 00 00 00 00 2C", position=4320000, max_speed=0),
            _power_state("3E A4 03 07 EC 21 8E 00 8F 02 22 C8 2A", 33, 142, 655, 51234),
        ),
    ),
    Command(
        "move_single_turn", Verb.MOVE_SINGLE_TURN, 0xA5, "14", "Move to an angle within one turn, in a given direction.",
        risk=(always(Risk.MOTION),), request=Layout(DIRECTION, ANGLE_TARGET, reserved(8)), reply=STATE_2,
        motion=_motion(MotionKind.MOVE_IN_TURN, "angle", direction="direction", counted_by="read_single_turn"),
        notes=("limited by Max Speed, Max Acceleration and Max Torque Current (MS: Max Power) of the setup program",),
        vectors=(
            _request("3E A5 01 04 E8 00 28 23 00 4B", direction=0, angle=9000),
            _torque_state("3E A5 01 07 EB 1E 37 00 B4 00 00 10 19", 30, 55, 180, 4096),
            _request("3E A5 1A 04 01 01 9F 8C 00 2C", direction=1, angle=35999),
            _torque_state("3E A5 1A 07 04 25 C3 FF 51 FF FC 3F 72", 37, -61, -175, 16380),
        ),
    ),
    Command(
        "move_single_turn_limited", Verb.MOVE_SINGLE_TURN, 0xA6, "15",
        "Move to an angle within one turn, in a given direction, no faster than a given speed.",
        risk=(always(Risk.MOTION),), request=Layout(DIRECTION, ANGLE_TARGET, reserved(8), MAX_SPEED), reply=STATE_2,
        motion=_motion(
            MotionKind.MOVE_IN_TURN, "angle", speed="max_speed", direction="direction", counted_by="read_single_turn"
        ),
        notes=("limited by Max Acceleration and Max Torque Current (MS: Max Power) of the setup program",),
        vectors=(
            _request("3E A6 01 08 ED 01 50 46 00 A0 8C 00 00 C3", direction=1, angle=18000, max_speed=36000),
            _torque_state("3E A6 01 07 EC 22 B8 FF D5 FE 00 20 CC", 34, -72, -299, 8192),
            _request("3E A6 06 08 F2 00 78 69 00 A0 86 01 00 08", direction=0, angle=27000, max_speed=100000),
            _power_state("3E A6 06 07 F1 23 36 01 E6 03 00 C0 03", 35, 310, 998, 49152),
        ),
    ),
    Command(
        "move_increment", Verb.MOVE_RELATIVE_AXIS, 0xA7, "16", "Move by an angle.",
        risk=(always(Risk.MOTION),), request=Layout(DISTANCE), reply=STATE_2, motion=_motion(MotionKind.MOVE_BY, "position"),
        notes=("limited by Max Speed, Max Acceleration and Max Torque Current (MS: Max Power) of the setup program",),
        vectors=(
            _request("3E A7 01 04 EA 60 73 FF FF D1", position=-36000),
            _torque_state("3E A7 01 07 ED 1E A6 FF EC FF 64 00 12", 30, -90, -20, 100),
            _request("3E A7 13 04 FC 80 FC 0A 00 86", position=720000),
            _torque_state("3E A7 13 07 FF 1E 65 00 21 00 E0 2E B2", 30, 101, 33, 12000),
        ),
    ),
    Command(
        "move_increment_limited", Verb.MOVE_RELATIVE_AXIS, 0xA8, "17", "Move by an angle, no faster than a given speed.",
        risk=(always(Risk.MOTION),), request=Layout(DISTANCE, MAX_SPEED), reply=STATE_2,
        motion=_motion(MotionKind.MOVE_BY, "position", speed="max_speed"),
        notes=("limited by Max Acceleration and Max Torque Current (MS: Max Power) of the setup program",),
        vectors=(
            _request("3E A8 01 08 EF 94 11 00 00 F0 D2 00 00 67", position=4500, max_speed=54000),
            _torque_state("3E A8 01 07 EE 1F 30 00 0A 01 58 1B CD", 31, 48, 266, 7000),
            _request("3E A8 0B 08 F9 79 29 ED FF 78 56 34 12 A2", position=-1234567, max_speed=305419896),
            _power_state("3E A8 0B 07 F8 34 19 FC 20 D1 E8 80 A2", 52, -999, -12000, 33000),
        ),
    ),
    Command(
        "read_parameter", Verb.READ_PARAMETER, 0xC0, "18", "Read a control parameter of appendix 1.",
        risk=(always(Risk.READ),), request=Layout(PARAMETER, reserved(48)), reply=PARAMETER_FORMS,
        notes=("firmware 2.35 was seen not to have it",),
        vectors=(
            _request("3E C0 01 07 06 0A 00 00 00 00 00 00 0A", parameter=10),
            _reply("3E C0 01 07 06 0A 64 00 19 00 00 00 87", parameter=10, angle_kp=100, angle_ki=25, angle_kd=0),
            _request("3E C0 01 07 06 0B 00 00 00 00 00 00 0B", parameter=11),
            _reply("3E C0 01 07 06 0B 32 00 28 00 02 00 67", parameter=11, speed_kp=50, speed_ki=40, speed_kd=2),
            _request("3E C0 01 07 06 0C 00 00 00 00 00 00 0C", parameter=12),
            _reply("3E C0 01 07 06 0C FF FF 2C 01 01 00 38", parameter=12, current_kp=65535, current_ki=300, current_kd=1),
            _request("3E C0 04 07 09 1E 00 00 00 00 00 00 1E", parameter=30),
            _reply("3E C0 04 07 09 1E 00 00 DC 05 00 00 FF", parameter=30, torque_limit=1500),
            _request("3E C0 04 07 09 20 00 00 00 00 00 00 20", parameter=32),
            _reply("3E C0 04 07 09 20 00 00 20 BF 02 00 01", parameter=32, speed_limit=180000),
            _request("3E C0 04 07 09 22 00 00 00 00 00 00 22", parameter=34),
            _reply("3E C0 04 07 09 22 00 00 C0 E6 FE FF C5", parameter=34, angle_limit=-72000),
            _request("3E C0 20 07 25 24 00 00 00 00 00 00 24", parameter=36),
            _reply("3E C0 20 07 25 24 00 00 D0 07 00 00 FB", parameter=36, current_ramp=2000),
            _request("3E C0 20 07 25 26 00 00 00 00 00 00 26", parameter=38),
            _reply("3E C0 20 07 25 26 00 00 40 42 0F 00 B7", parameter=38, speed_ramp=1000000),
        ),
    ),
    Command(
        "write_parameter", Verb.WRITE_PARAMETER, 0xC1, "19", "Write a control parameter of appendix 1, and read it back.",
        risk=(
            always(Risk.SETTING),
            when("parameter", Parameter.ANGLE_PID, Parameter.CURRENT_PID, Risk.TORQUE),
            when("parameter", Parameter.TORQUE_LIMIT, None, Risk.TORQUE),
            *(when("parameter", low, high, Risk.UNKNOWN) for low, high in UNLISTED_PARAMETERS),
        ),
        request=PARAMETER_FORMS, reply=PARAMETER_FORMS,
        notes=("holds at once, and until the power goes: it is written to RAM", "firmware 2.35 was seen not to have it"),
        vectors=(
            *_echoed("3E C1 01 07 07 0A 78 00 1E 00 05 00 A5", parameter=10, angle_kp=120, angle_ki=30, angle_kd=5),
            *_echoed("3E C1 01 07 07 0B 3C 00 00 00 34 12 8D", parameter=11, speed_kp=60, speed_ki=0, speed_kd=4660),
            *_echoed("3E C1 01 07 07 0C C8 00 E8 03 00 00 BF", parameter=12, current_kp=200, current_ki=1000, current_kd=0),
            *_echoed("3E C1 10 07 16 1E 00 00 08 07 00 00 2D", parameter=30, torque_limit=1800),
            *_echoed("3E C1 10 07 16 20 00 00 90 5F 01 00 10", parameter=32, speed_limit=90000),
            *_echoed("3E C1 10 07 16 22 00 00 60 73 FF FF F3", parameter=34, angle_limit=-36000),
            *_echoed("3E C1 1F 07 25 24 00 00 F4 01 00 00 19", parameter=36, current_ramp=500),
            *_echoed("3E C1 1F 07 25 26 00 00 80 84 1E 00 48", parameter=38, speed_ramp=2000000),
        ),
    ),
    Command(
        "read_encoder", Verb.READ_ENCODER, 0x90, "20", "Read the encoder, as it is and counted from its zero.",
        risk=(always(Risk.READ),), request=EMPTY,
        reply=Layout(
            ENCODER,
            u16le("encoder_raw", unit="counts", printed="encoderRaw", note=ENCODER_NOTE),
            u16le("encoder_offset", unit="counts", printed="encoderOffset", note=ENCODER_NOTE),
        ),
        notes=("encoder is encoder_raw less encoder_offset, around the end of the scale",),
        vectors=(
            _request("3E 90 01 00 CF"),
            _reply("3E 90 01 06 D5 34 12 45 23 11 11 D0", encoder=4660, encoder_raw=9029, encoder_offset=4369),
            _request("3E 90 16 00 E4"),
            _reply("3E 90 16 06 EA 9C FF 64 00 C8 00 C7", encoder=65436, encoder_raw=100, encoder_offset=200),
        ),
    ),
    Command(
        "set_zero", Verb.SET_ZERO, 0x19, "21", "Store where the encoder stands as the zero that holds from power-up.",
        risk=(always(Risk.SETTING, Risk.WEAR),), request=EMPTY,
        reply=Layout(u16le("encoder_zero", unit="counts", printed="encoderZero", note=ENCODER_NOTE)),
        notes=("each use wears the drive's flash",),
        vectors=(
            _request("3E 19 01 00 58"),
            _reply("3E 19 01 02 5A 7C 3A B6", encoder_zero=14972),
            _request("3E 19 20 00 77"),
            _reply("3E 19 20 02 79 FF 00 FF", encoder_zero=255),
        ),
    ),
    Command(
        "read_position", Verb.READ_POSITION, 0x92, "22", "Read the position counted over all turns, clockwise up.",
        risk=(always(Risk.READ),), request=EMPTY,
        reply=Layout(i64le("position", unit="deg", scale=HUNDREDTH, printed="motorAngle", state=StatePart("position", 1.0))),
        vectors=(
            _request("3E 92 01 00 D1"),
            _reply("3E 92 01 08 D9 C0 1D FE FF FF FF FF FF D6", position=-123456),
            _request("3E 92 02 00 D2"),
            _reply("3E 92 02 08 DA EF CD AB 89 67 45 23 01 C0", position=81985529216486895),
        ),
    ),
    Command(
        "clear_turns", Verb.CLEAR_TURNS, 0x93, "23", "Forget the counted turns.",
        risk=(always(Risk.SETTING),), request=EMPTY, reply=EMPTY,
        vectors=(*_echoed("3E 93 01 00 D2"), *_echoed("3E 93 0A 00 DB")),
    ),
    Command(
        "read_single_turn", Verb.READ_SINGLE_TURN, 0x94, "24",
        "Read the angle within one turn, from the encoder's zero, clockwise up.",
        risk=(always(Risk.READ),), request=EMPTY,
        reply=Layout(u32le("angle", maximum=35999, unit="deg", scale=HUNDREDTH, printed="circleAngle")),
        vectors=(
            _request("3E 94 01 00 D3"),
            _reply("3E 94 01 04 D7 4F 46 00 00 95", angle=17999),
            _request("3E 94 1D 00 EF"),
            _reply("3E 94 1D 04 F3 9F 8C 00 00 2B", angle=35999),
        ),
    ),
    Command(
        "set_position", Verb.OTHER, 0x95, "25", "Call the present position any angle, counted over all turns.",
        risk=(always(Risk.SETTING),), request=Layout(i32le("position", unit="deg", scale=HUNDREDTH, printed="motorAngle")),
        reply=Layout(i32le("position", unit="deg", scale=HUNDREDTH, printed="motorAngle")),
        notes=("holds until the power goes: it is written to RAM",),
        vectors=(
            *_echoed("3E 95 01 04 D8 28 23 00 00 4B", position=9000),
            *_echoed("3E 95 0D 04 E4 4E 11 C9 FF 27", position=-3600050),
        ),
    ),
)  # fmt: skip

DIALECT = Dialect(
    name="lk-rs485",
    title="Lingkong (LK) motors on RS485",
    manual="Lingkong motor RS485 V2.36",
    bus="serial",
    link=LkLink(),
    commands=COMMANDS,
    errata=ERRATA,
    models=("MF", "MG", "MH", "MS"),
    addresses=(1, 32),
    broadcast=None,
    baud_rates=(115200, 9600, 19200, 38400, 57600, 230400, 460800, 1000000, 2000000, 4000000),
    family="lk",
    sections=dict.fromkeys(Subject, "Single motor command"),
    unlisted_codes=(0x12,),
    said_in="analyzer.protocols.lk_rs485_statements",
)
