"""Quirks of the LK drive: behaviour of real drives that manual V2.36 does not print or contradicts. All are off by default.

Facts and sources are those of the project's notes on real hardware. A fact has no quirk if the conforming drive behaves so
already: the manual says it too, or leaves it open. Such facts are:

- 0x80 and 0x88 are echoed exactly; 0x80 drops the current motion.
- 0x19 takes effect at the next power-up. 0x92 counts up clockwise.
- The encoder of 0x90 is the raw value less the offset.

Firmware 2.35 speaks four codes that the manual does not have. They are declared here as `Command`s, from traffic of that
firmware; the analyzer does not know them. The two halves of an angle limit (0x9B, 0x9C) by its 0x40 and 0x42 are left out,
since no traffic shows them.
"""

from __future__ import annotations

import random
from collections.abc import Callable

from analyzer.catalogue import Command, Form, Risk, Verb, always
from analyzer.layout import Field, Layout, fixed, reserved, u8, uint
from analyzer.protocols.lk_rs485 import EMPTY, PARAMETER_FORMS, Parameter, u16le
from conformance.drives.drive import Drive, Hooks, Outgoing, Quirk, Request, Values
from conformance.drives.faults.lk_behaviour import acting, lk, tuned
from conformance.drives.faults.places import LK, request, result
from conformance.drives.lk.drive import LkDrive, told_parameter, write_parameter

_TAXFROMDK = "taxfromdk/lkmotor, MS4015 with driver DS40R7, firmware 2.35"
_VENDOR_CAN = "vendor's CAN manual V2.36, in han-xudong/pyLKMotor docs"

#: Share of 0xA4 replies whose data sum is off, and by how much at most.
BAD_SUM_SHARE, BAD_SUM_OFF = 0.01, 4
#: The soonest reply of a drive that answers within 0.25 ms.
SOONEST_NS = 50_000


def _seeded(what: str) -> Callable[[Drive], random.Random]:
    """Return where one quirk of one drive gets its random numbers from; the same for the same seed and address."""
    made: list[random.Random] = []

    def draw(drive: Drive) -> random.Random:
        if not made:
            made.append(random.Random(f"{drive.seed} {drive.address} {what}"))
        return made[0]

    return draw


def _off_sums(hooks: Hooks) -> None:
    draw = _seeded("sum")

    def reply(drive: Drive, command: Command, outgoing: Outgoing) -> tuple[Outgoing, ...]:
        chance, data = draw(drive), outgoing.data
        if command.name == "move_multi_turn_limited" and chance.random() < BAD_SUM_SHARE:
            off = chance.choice((-1, 1)) * chance.randint(1, BAD_SUM_OFF)
            data = data[:-1] + bytes(((data[-1] + off) & 0xFF,))
        return (Outgoing(outgoing.at_ns, data),)

    hooks.reply.append(reply)


def _soon(hooks: Hooks) -> None:
    draw = _seeded("delay")

    def reply(drive: Drive, command: Command, outgoing: Outgoing) -> tuple[Outgoing, ...]:
        longest = lk(drive).reply_delay_ns
        delay_ns = draw(drive).randint(min(SOONEST_NS, longest), longest)
        return (Outgoing(outgoing.at_ns - longest + delay_ns, outgoing.data),)

    hooks.reply.append(reply)


def _no_limit(drive: Drive, command: Command, values: Values) -> Values:
    limited = values.get("max_speed", 1)
    return values if limited else values | {"max_speed": abs(lk(drive).parameters["speed_limit"])}


def _wide_difference(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
    motor = lk(drive).motor
    return values | {"encoder": (motor.encoder_raw - motor.encoder_zero) % (1 << 16)}


# --- firmware 2.35 ------------------------------------------------------------------------------------------------

#: The numbers that 0x40 and 0x42 have for the parameters of appendix 1.
_NUMBERS = {
    Parameter.ANGLE_PID: 0x96,
    Parameter.SPEED_PID: 0x97,
    Parameter.CURRENT_PID: 0x98,
    Parameter.TORQUE_LIMIT: 0x99,
    Parameter.SPEED_LIMIT: 0x9A,
    Parameter.CURRENT_RAMP: 0x9D,
    Parameter.SPEED_RAMP: 0x9E,
}


def _values_first(form: Form) -> tuple[Field, ...]:
    """Return the fields of a parameter of appendix 1 as firmware 2.35 has them: six bytes, values first."""
    fields = tuple(f for f in form.layout.named.values() if f.fixed is None)
    spare = 48 - sum(f.bit_width for f in fields)
    return (*fields, reserved(spare)) if spare else fields


_FORMS = tuple(
    Form(Layout(fixed("parameter", 8, _NUMBERS[Parameter(number)]), *_values_first(form)), name=form.name)
    for form in PARAMETER_FORMS
    if (number := form.layout.named["parameter"].fixed) is not None and number in _NUMBERS
)
_UNLISTED = Form(Layout(u8("parameter"), uint("parameter_bytes", 48)), name="unlisted_parameter")
_PRODUCT: Values = {
    "driver_name": int.from_bytes(b"DS40R7".ljust(20, b"\0"), "big"),
    "motor_name": int.from_bytes(b"MS4015".ljust(20, b"\0"), "big"),
    "motor_id": int.from_bytes(b"EMULATED".ljust(12, b"\0"), "big"),
    "hardware_version": 300,
    "motor_version": 200,
    "firmware_version": 235,
}

READ_PRODUCT = Command(
    name="read_product",
    verb=Verb.READ_VERSION,
    code=0x12,
    section="firmware 2.35",
    summary="Read the names, the number and the versions of drive and motor: 58 bytes.",
    risk=(always(Risk.READ),),
    request=EMPTY,
    reply=Layout(
        uint("driver_name", 160),
        uint("motor_name", 160),
        uint("motor_id", 96),
        u16le("hardware_version"),
        u16le("motor_version"),
        u16le("firmware_version"),
    ),
)
READ_RAM = Command(
    name="read_ram_parameter",
    verb=Verb.READ_PARAMETER,
    code=0x40,
    section="firmware 2.35",
    summary="Read a control parameter.",
    risk=(always(Risk.READ),),
    request=Layout(reserved(8), u8("parameter")),
    reply=(*_FORMS, _UNLISTED),
)
WRITE_RAM = Command(
    name="write_ram_parameter",
    verb=Verb.WRITE_PARAMETER,
    code=0x42,
    section="firmware 2.35",
    summary="Write a control parameter to RAM; status 0 is done, 1 is refused.",
    risk=(always(Risk.SETTING),),
    request=(*_FORMS, _UNLISTED),
    reply=Layout(u8("parameter"), u8("status")),
)
REBOOT = Command(
    name="reboot",
    verb=Verb.RESTART,
    code=0x07,
    section="firmware 2.35",
    summary="Restart the drive; not answered.",
    risk=(always(Risk.POWER_ON),),
    request=EMPTY,
    reply=None,
)


def _read_ram(drive: LkDrive, request: Request) -> Values:
    return told_parameter(drive, request) or {"parameter": request.values["parameter"], "parameter_bytes": 0}


def _written(drive: LkDrive, request: Request) -> Values:
    return {"parameter": request.values["parameter"], "status": int(request.form.name == _UNLISTED.name)}


def _firmware(drive: LkDrive) -> None:
    drive.forget("read_parameter", "write_parameter")
    drive.learn(READ_PRODUCT, answer=lambda drive, request: dict(_PRODUCT))
    drive.learn(READ_RAM, answer=_read_ram)
    drive.learn(WRITE_RAM, write_parameter, _written)
    drive.learn(REBOOT, lambda drive, request: drive.power_cycle(drive.now_ns))


QUIRKS: tuple[Quirk, ...] = (
    Quirk("lk-off-sum", LK,
        "about 1 % of the replies to 0xA4 carry a data sum that is off by up to 4 either way (by the seed)",
        f"{_TAXFROMDK}, log.txt and readme.txt", _off_sums),
    Quirk("lk-zero-speed-moves", LK,
        "0xA4, 0xA6 and 0xA8 with max_speed 0 move, at the speed limit, as though no limit were given",
        f"{_TAXFROMDK}: 0xA4 with maxSpeed 0 at 600 to 800 deg/s", request(_no_limit)),
    Quirk("lk-off-clears-turns", LK,
        "0x80 also drops the counted turns", _VENDOR_CAN,
        acting("motor_off", lambda drive, request: drive.motor.clear_turns(), after=True)),
    Quirk("lk-reply-within", LK,
        "replies come after 0.05 to 0.25 ms (by the seed) instead of exactly 0.25 ms", _VENDOR_CAN, _soon),
    Quirk("lk-encoder-wide-difference", LK,
        "0x90 takes raw less offset on a 16-bit scale also where the encoder has fewer bits", f"{_TAXFROMDK}, motor.cpp",
        result(_wide_difference, Verb.READ_ENCODER)),
    Quirk("lk-firmware-235", LK,
        "0x12 (product data), 0x40 and 0x42 (parameters) and 0x07 (restart, no reply) exist, 0xC0 and 0xC1 do not",
        f"{_TAXFROMDK}, lkmotor.h and log.txt", tuned(_firmware)),
)  # fmt: skip
