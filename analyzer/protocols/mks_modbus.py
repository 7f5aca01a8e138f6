"""MKS SERVO42D/57D as a Modbus-RTU slave: Part 8 of the RS485 manual V1.0.5 as a table.

    read    01 04 00 32 00 01 | crc16                  ->  01 04 02 | speed | crc16
    write   01 06 | 00 82 00 05 | crc16                ->  the same, or FF FF in place of the value
    write   01 10 00 F6 00 02 04 | 4 bytes | crc16     ->  01 10 00 F6 00 02 | crc16, or a quantity of 0

    registers and values: high byte first; crc16: low byte first

Rules kept here:
- Registers are the codes of the native commands, and so are summaries, risks and notes: they are taken from there.
- The data of a command: the registers of a read reply, the value of 06h, the bytes after the byte count of 10h, the quantity
  of a 10h reply.
- Registers do not adjoin: each start address is its own command, with its own quantity.
- A stop is its run with zeros everywhere but in the acceleration, stands before it, and owns a reply only while it is
  open.
- Commands stand in the manual's order, but for stops. What Part 8 leaves out (8Ch, 8Dh, 94h, packages) is left out.

Not known here: how a drive refuses (the two forms above come from the vendor's later manual), and whether `respond` silences
Modbus. Nor the end of a move: a write is answered once, and the host must read status F1h.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from analyzer.catalogue import Command, Dialect, Form, Replies, Subject, Trait, Vector, Verb
from analyzer.layout import Effect, Field, Layout, fixed, reserved, u8, u16
from analyzer.link import ModbusLink
from analyzer.protocols import mks_rs485
from analyzer.protocols import mks_shared as mks
from analyzer.protocols.mks_modbus_errata import ERRATA
from analyzer.protocols.modbus import EXCEPTION, FALLBACKS

_NATIVE = mks_rs485.DIALECT.by_verb
#: The high byte of a register that holds one byte.
_BYTE = reserved(8)
_ENABLED = replace(mks.ENABLED, printed="enable")
#: What a command without a value is given by.
_EXECUTE = u16("execute", minimum=1, maximum=1, default=1)
_REFUSED = Replies(failed_forms={"refused"})


def _command(verb: Verb, code: int, function: int, quantity: int, section: str, options: dict[str, Any]) -> Command:
    """Declare a command; what the options do not say is as in the native command."""
    native = _NATIVE[verb]
    facts: dict[str, Any] = {
        "summary": native.summary,
        "risk": native.risk,
        "modes": native.modes,
        "printed": native.printed,
        "notes": native.notes,
        # A write is answered once.
        "motion": native.motion and replace(native.motion, tells_end=False),
    }
    return Command(
        name=verb.value, verb=verb, code=code, function=function, quantity=quantity, section=section, **facts | options
    )


def _read(verb: Verb, code: int, quantity: int, section: str, *fields: Field, **options: Any) -> Command:
    """Declare a read of registers whose values are `fields`."""
    facts: dict[str, Any] = {"request": Layout(), "reply": Layout(*fields)}
    return _command(verb, code, 0x04, quantity, section, facts | options)


def _write(verb: Verb, code: int, section: str, *fields: Field, **options: Any) -> Command:
    """Declare a write of one register, which is echoed."""
    refused, echo = Layout(fixed("refused", 16, 0xFFFF)), Layout(*fields)
    facts: dict[str, Any] = {
        "request": Layout(*fields),
        "reply": (Form(refused, "refused"), Form(echo, "reply")),
        "replies": _REFUSED,
    }
    return _command(verb, code, 0x06, 1, section, facts | options)


def _do(verb: Verb, code: int, section: str, frame: str, **options: Any) -> Command:
    """Declare a command that is given by writing 1; request and reply are the same printed frame."""
    vectors = (mks.sent(frame, section, execute=1), mks.answered(frame, section, execute=1))
    return _write(verb, code, section, _EXECUTE, **{"vectors": vectors} | options)


def _write_many(verb: Verb, code: int, quantity: int, section: str, frame: str, *fields: Field, **options: Any) -> Command:
    """Declare a write of several registers; `frame` is the printed reply, which repeats the quantity.

    A frame of six bytes is one that is printed without its CRC.
    """
    stop = any(f.fixed is not None for f in fields)
    replies = ((0, "refused"), (quantity, "reply"))
    whole = len(bytes.fromhex(frame)) == 8
    facts: dict[str, Any] = {
        "request": Layout(*fields),
        "reply": tuple(Form(Layout(fixed("quantity", 16, n)), name, needs_request=stop) for n, name in replies),
        "replies": _REFUSED,
        "vectors": (mks.answered(frame, section, checksum=whole, quantity=quantity),),
    }
    return _command(verb, code, 0x10, quantity, section, facts | options)


def _asked(frame: str, section: str) -> tuple[Vector]:
    """Declare the printed request of a read."""
    return (mks.sent(frame, section),)


def _speed_body(**options: Any) -> tuple[Field, ...]:
    """Declare direction, acceleration and speed; options go to direction and speed."""
    way = u8("direction", choices=mks.MotionDirection, printed="dir", **options)
    return (way, mks.acceleration(), mks.speed16(**options))


def _position_body(unit: str, printed: str, **options: Any) -> tuple[Field, ...]:
    """Declare acceleration, speed and a signed position; options go to speed and position."""
    wide = u16("acceleration", maximum=255, printed="acc")
    return (wide, mks.speed16(**options), mks.position(32, unit, printed=printed, **options))


COMMANDS = (
    # 8.1 Reading
    _read(
        Verb.READ_ENCODER_CARRY, 0x0030, 3, "8.1.1", mks.CARRY, mks.ENCODER,
        vectors=_asked("01 04 00 30 00 03 B0 04", "8.1.1"),
    ),
    _read(
        Verb.READ_POSITION, 0x0031, 3, "8.1.2", mks.POSITION,
        vectors=_asked("01 04 00 31 00 03 E1 C4", "8.1.2"),
    ),
    _read(
        Verb.READ_SPEED, 0x0032, 1, "8.1.3", mks.ACTUAL_SPEED,
        vectors=(
            Vector(
                "01 04 00 32 00 01 E1 C4",
                section="8.1.3",
                erratum="mks-modbus-07",
                corrected="01 04 00 32 00 01 90 05",
            ),
        ),
    ),
    _read(
        Verb.READ_PULSES, 0x0033, 2, "8.1.4", mks.PULSE_COUNT,
        vectors=_asked("01 04 00 33 00 02 81 C4", "8.1.4"),
    ),
    _read(
        Verb.READ_IO, 0x0034, 1, "8.1.5", _BYTE, reserved(4), *mks.pins("out_2", "out_1", "in_2", "in_1"),
        vectors=_asked("01 04 00 34 00 01 70 04", "8.1.5"),
    ),
    _read(
        Verb.READ_ANGLE_ERROR, 0x0039, 2, "8.1.6", mks.ANGLE_ERROR,
        vectors=_asked("01 04 00 39 00 02 A1 C6", "8.1.6"),
    ),
    _read(
        Verb.READ_ENABLED, 0x003A, 1, "8.1.7", _BYTE, _ENABLED,
        vectors=_asked("01 04 00 3A 00 01 11 C7", "8.1.7"),
    ),
    _read(
        Verb.READ_ZERO_STATUS, 0x003B, 1, "8.1.8", _BYTE, mks.status(mks.ZeroStatus),
        vectors=_asked("01 04 00 3B 00 01 40 07", "8.1.8"),
    ),
    _read(
        Verb.READ_PROTECTION, 0x003E, 1, "8.1.9", _BYTE, mks.status(mks.Protection),
        vectors=_asked("01 04 00 3E 00 01 50 06", "8.1.9"),
    ),
    _read(
        Verb.READ_STATUS, 0x00F1, 1, "8.1.10", _BYTE, mks.status(mks.MotorStatus), replies=mks.MOTOR_STATUS,
        vectors=_asked("01 04 00 F1 00 01 60 39", "8.1.10"),
    ),
    # 8.2 Writing
    _do(Verb.RELEASE_PROTECTION, 0x003D, "8.2.1", "01 06 00 3D 00 01 D9 C6"),
    _do(Verb.RESTORE, 0x003F, "8.2.2", "01 06 00 3F 00 01 78 06"),
    _do(Verb.RESTART, 0x0041, "8.2.3", "01 06 00 41 00 01 18 1E"),
    _do(
        Verb.CALIBRATE, 0x0080, "8.2.4", "01 06 00 80 00 01 49 E2",
        notes=("the echo says that it was accepted; how it goes is told by the motor status",),
    ),
    _write(Verb.SET_WORK_MODE, 0x0082, "8.2.5", _BYTE, mks.WORK_MODE),
    _write(Verb.SET_CURRENT, 0x0083, "8.2.6", mks.CURRENT),
    _write(Verb.SET_HOLDING_CURRENT, 0x009B, "8.2.7", _BYTE, mks.HOLDING_CURRENT),
    _write(
        Verb.SET_SUBDIVISION, 0x0084, "8.2.8",
        u16("subdivision", maximum=256, default=16, printed="micstep", note="0 is taken as 256", effect=Effect.SUBDIVISION),
    ),
    _write(Verb.SET_ENABLE_LEVEL, 0x0085, "8.2.9", _BYTE, mks.ENABLE_LEVEL),
    _write(Verb.SET_DIRECTION, 0x0086, "8.2.10", _BYTE, mks.MOTOR_DIRECTION),
    _write(Verb.SET_SCREEN_OFF, 0x0087, "8.2.11", _BYTE, mks.SCREEN_OFF),
    _write(Verb.SET_PROTECTION, 0x0088, "8.2.12", _BYTE, mks.PROTECTION),
    _write(Verb.SET_INTERPOLATION, 0x0089, "8.2.13", _BYTE, mks.INTERPOLATION),
    _write(Verb.SET_BAUD_RATE, 0x008A, "8.2.14", _BYTE, mks.BAUD_RATE),
    _write(Verb.SET_ADDRESS, 0x008B, "8.2.15", _BYTE, mks.new_address(247)),
    _write(
        Verb.SET_MODBUS, 0x008E, "8.2.16", _BYTE, mks.MODBUS,
        summary="Set whether the drive speaks Modbus-RTU or goes back to its native frames.",
    ),
    _write(Verb.SET_KEY_LOCK, 0x008F, "8.2.17", _BYTE, mks.KEY_LOCK),
    _do(Verb.SET_ZERO, 0x0092, "8.2.18", "01 06 00 92 00 01 E9 E7"),
    _write(Verb.ENABLE, 0x00F3, "8.2.19", _BYTE, _ENABLED),
    _write_many(
        Verb.SET_HOME, 0x0090, 3, "8.2.20", "01 10 00 90 00 03 80 25",
        mks.HOME_TRIGGER, mks.HOME_DIRECTION, mks.HOME_SPEED, mks.END_LIMIT,
        notes=(*_NATIVE[Verb.SET_HOME].notes, "three registers, and yet five bytes"),
    ),
    _write(Verb.SET_LIMIT_REMAP, 0x009E, "8.2.21", _BYTE, mks.LIMIT_REMAP),
    _write_many(
        Verb.SET_ZERO_MODE, 0x009A, 2, "8.2.22", "01 10 00 9A 00 02 61 E7",
        mks.ZERO_MODE, mks.SET_ZERO, mks.ZERO_SPEED, mks.ZERO_DIRECTION,
    ),
    # 8.3 Motion
    _do(Verb.EMERGENCY_STOP, 0x00F7, "8.3.1", "01 06 00 F7 00 01 F9 F8"),
    _do(Verb.HOME, 0x0091, "8.3.2", "01 06 00 91 00 01 19 E7"),
    # From here on each stop stands before its run: the first form that matches wins.
    _write_many(Verb.STOP_SPEED, 0x00F6, 2, "8.3.3.2", "01 10 00 F6 00 02 A1 FA", *_speed_body(fixed=0)),
    _write_many(Verb.RUN_SPEED, 0x00F6, 2, "8.3.3.1", "01 10 00 F6 00 02 A1 FA", *_speed_body()),
    _write(
        Verb.SAVE_SPEED, 0x00FF, "8.3.3.3", _BYTE, replace(mks.SAVE_STATE, printed="flag"),
        notes=("after saving, the shaft turns as soon as power comes on",),
    ),
    _write_many(
        Verb.STOP_RELATIVE_PULSES, 0x00FD, 4, "8.3.4.2", "01 10 00 FD 00 04 50 3A",
        *_speed_body(fixed=0), mks.pulses(32, fixed=0),
    ),
    _write_many(
        Verb.MOVE_RELATIVE_PULSES, 0x00FD, 4, "8.3.4.1", "01 10 00 FD 00 04 50 3A", *_speed_body(), mks.pulses(32),
    ),
    _write_many(
        Verb.STOP_ABSOLUTE_PULSES, 0x00FE, 4, "8.3.5.2", "01 10 00 FE 00 04",
        *_position_body("pulses", "absPulses", fixed=0),
    ),
    _write_many(
        Verb.MOVE_ABSOLUTE_PULSES, 0x00FE, 4, "8.3.5.1", "01 10 00 FE 00 04", *_position_body("pulses", "absPulses"),
    ),
    _write_many(
        Verb.STOP_RELATIVE_AXIS, 0x00F4, 4, "8.3.6.2", "01 10 00 F4 00 04 80 38",
        *_position_body("counts", "relAxis", fixed=0),
    ),
    _write_many(
        Verb.MOVE_RELATIVE_AXIS, 0x00F4, 4, "8.3.6.1", "01 10 00 F4 00 04 80 38", *_position_body("counts", "relAxis"),
    ),
    _write_many(
        Verb.STOP_ABSOLUTE_AXIS, 0x00F5, 4, "8.3.7.2", "01 10 00 F5 00 04 D1 F8",
        *_position_body("counts", "absAxis", fixed=0),
    ),
    _write_many(
        Verb.MOVE_ABSOLUTE_AXIS, 0x00F5, 4, "8.3.7.1", "01 10 00 F5 00 04 D1 F8", *_position_body("counts", "absAxis"),
    ),
)  # fmt: skip

DIALECT = Dialect(
    name="mks-modbus",
    title="MKS SERVO42D/57D, Modbus-RTU",
    manual="MKS SERVO42D/57D RS485 V1.0.5",
    bus="serial",
    link=ModbusLink(odd_counts={0x0090: 5}),
    commands=COMMANDS,
    errata=ERRATA,
    models=("42D", "57D", "28D", "35D"),
    addresses=(1, 247),
    broadcast=0,
    baud_rates=(38400, 9600, 19200, 25000, 57600, 115200, 256000),
    fallbacks=FALLBACKS,
    exception=EXCEPTION,
    family="mks",
    siblings=("mks-rs485",),
    chosen_by=mks.Switch.ENABLED,
    sections=dict.fromkeys(Subject, "8"),
    traits=frozenset({Trait.LETS_GO_AT_END_LIMIT}),
    ramp=mks.RAMP,
    subdivision=mks.SUBDIVISION,
    counts_per_turn=mks.COUNTS_PER_TURN,
    mode_speeds=mks.MODE_MAXIMUM_SPEEDS,
    rates=mks.BAUD_RATES,
    said_in="analyzer.protocols.mks_modbus_statements",
)
