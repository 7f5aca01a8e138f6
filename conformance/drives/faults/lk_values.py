"""Faults of an LK drive in its values: byte order, sign, width, scale, ranges, and what its readings say."""

from __future__ import annotations

from collections.abc import Callable

from analyzer.catalogue import Command
from analyzer.layout import Field
from analyzer.protocols.lk_rs485 import ERROR_BITS, BrakeControl, BrakeState, MotorState, SpinDirection
from conformance.drives.drive import Fault, Hooks, Values
from conformance.drives.lk.drive import LkDrive
from conformance.drives.lk.places import (
    INCREMENTS,
    MULTI_TURN,
    PARAMETER_COMMANDS,
    SINGLE_TURN,
    STATE_1,
    STATE_2,
    Install,
    on_allow,
    on_asked,
    on_field,
    on_request,
    on_result,
    swapped,
    wrapped,
)

_FLAGS = tuple(field.name for field in ERROR_BITS)


def _fault(name: str, text: str, breaks: str, install: Install) -> Fault:
    return Fault(name, ("lk-rs485",), text, breaks, install)


def _reads(field: str, change: Callable[[int], int], *only: str) -> Install:
    return on_field(field, lambda drive, value: change(value), only)


def _torque_field(values: Values) -> str:
    return "power" if "power" in values else "torque_current"


def _torque(change: Callable[[int], int]) -> Install:
    def result(drive: LkDrive, command: Command, asked: Values, values: Values) -> Values:
        name = _torque_field(values)
        return values | {name: change(values[name])}

    return on_result(result, STATE_2)


def _shift_flags(drive: LkDrive, command: Command, asked: Values, values: Values) -> Values:
    return values | {name: values[before] for name, before in zip(_FLAGS, _FLAGS[1:] + _FLAGS[:1], strict=True)}


def _hide_flags(drive: LkDrive, command: Command, asked: Values, values: Values) -> Values:
    return values | dict.fromkeys(_FLAGS, 0)


def _freeze_flags(hooks: Hooks) -> None:
    seen: set[str] = set()

    def result(drive: LkDrive, command: Command, asked: Values, values: Values) -> Values:
        seen.update(name for name in _FLAGS if values[name])
        return values | dict.fromkeys(seen, 1)

    on_result(result, STATE_1)(hooks)


def _swap_state_1(drive: LkDrive, command: Command, asked: Values, values: Values) -> Values:
    return values | {"voltage": values["current"], "current": values["voltage"]}


def _other_parameter(drive: LkDrive, command: Command, asked: Values, values: Values) -> Values | None:
    """Answer for the parameter after the one asked for."""
    numbers = [f.layout.named["parameter"].fixed for f in command.reply_forms]
    listed = [n for n in numbers if n is not None]
    wanted = listed[(listed.index(values["parameter"]) + 1) % len(listed)]
    form = command.reply_forms[numbers.index(wanted)]
    return {n: drive.reading(f) if f.fixed is None else f.fixed for n, f in form.layout.named.items()}


def _gains_swapped(drive: LkDrive, command: Command, asked: Values, values: Values) -> Values:
    pairs = [(n, n.replace("_kp", "_ki")) for n in values if n.endswith("_kp")]
    return values | {a: values[b] for p in pairs for a, b in (p, p[::-1])}


def _zeros(drive: LkDrive, command: Command, asked: Values, values: Values) -> Values:
    return {n: v if n == "parameter" else 0 for n, v in values.items()}


def _runs_on(drive: LkDrive, angle: int) -> int:
    field = drive.dialect.by_name["read_position"].reply_forms[0].layout.named["position"]
    return field.wire(drive.motor.motion.angle - drive.motor.zero) % (1 << 32)


def _single(drive: LkDrive, position: int) -> int:
    field = drive.dialect.by_name["read_single_turn"].reply_forms[0].layout.named["angle"]
    return drive.reading(field)


def _refusing(name: str, refused: Callable[[int, Field], bool]) -> Install:
    """Refuse values of a field that the manual allows."""

    def allow(command: Command, values: Values, wanted: bool) -> bool:
        field = next((f.layout.named[name] for f in command.request_forms if name in f.layout.named), None)
        return wanted and not (field is not None and refused(values[name], field))

    return on_allow(allow)


def _obeying(name: str, also: Callable[[int, Field], bool] = lambda value, field: True) -> Install:
    """Obey values of a field that the manual forbids, if the other fields are allowed."""

    def allow(command: Command, values: Values, wanted: bool) -> bool:
        form = next((f for f in command.request_forms if f.layout.named.keys() == values.keys()), None)
        if form is None or name not in values:
            return wanted
        fields = form.layout.named
        if not fields[name].allows(values[name]) and not also(values[name], fields[name]):
            return False
        return all(field.allows(values[n]) for n, field in fields.items() if n != name)

    return on_allow(allow)


def _highest(value: int, field: Field) -> bool:
    return value == field.high


def _lowest(value: int, field: Field) -> bool:
    return value == field.low


def _above(value: int, field: Field) -> bool:
    return value == field.high + 1


def _below(value: int, field: Field) -> bool:
    return value == field.low - 1


def _is_ccw(value: int, field: Field) -> bool:
    return value == SpinDirection.CCW


def _read_releases(drive: LkDrive, command: Command, values: Values) -> Values:
    asked = values["brake_control"]
    return {"brake_control": BrakeControl.RELEASE if asked == BrakeControl.READ else asked}


FAULTS: tuple[Fault, ...] = (
    # --- byte order, sign, width ----------------------------------------------------------------------------------
    _fault(
        "lk-speed-bytes-swapped",
        "replies have the speed high byte first",
        "byte order",
        _reads("speed", lambda v: swapped(v, 16), *STATE_2),
    ),
    _fault(
        "lk-angle-bytes-swapped",
        "0x94 answers the angle high byte first",
        "byte order",
        _reads("angle", lambda v: swapped(v, 32) % (1 << 32), "read_single_turn"),
    ),
    _fault(
        "lk-voltage-bytes-swapped",
        "the voltage of 0x9A and 0x9B has its high byte first",
        "byte order",
        _reads("voltage", lambda v: swapped(v, 16), *STATE_1),
    ),
    _fault(
        "lk-asked-speed-swapped",
        "0xA2 takes the speed high byte first",
        "byte order",
        on_asked("speed", lambda v: swapped(v, 32), ("run_speed",)),
    ),
    _fault(
        "lk-asked-angle-swapped",
        "0xA5 and 0xA6 take the angle high byte first",
        "byte order",
        on_asked("angle", lambda v: swapped(v, 16) % (1 << 16), SINGLE_TURN),
    ),
    _fault("lk-speed-sign-lost", "replies have the speed without its sign", "sign", _reads("speed", abs, *STATE_2)),
    _fault(
        "lk-position-sign-lost", "0x92 answers the angle without its sign", "sign", _reads("position", abs, "read_position")
    ),
    _fault("lk-torque-sign-lost", "replies have the torque current without its sign", "sign", _torque(abs)),
    _fault("lk-asked-speed-sign-lost", "0xA2 runs clockwise whatever the sign", "sign", on_asked("speed", abs)),
    _fault(
        "lk-increment-sign-lost", "0xA7 and 0xA8 go clockwise whatever the sign", "sign", on_asked("position", abs, INCREMENTS)
    ),
    _fault(
        "lk-temperature-unsigned",
        "temperatures below zero are answered as 0",
        "sign",
        _reads("temperature", lambda v: max(0, v)),
    ),
    _fault(
        "lk-position-int32",
        "0x92 answers only the lower 32 bits of the angle",
        "width",
        _reads("position", lambda v: wrapped(v, 32), "read_position"),
    ),
    _fault(
        "lk-target-int32",
        "0xA3 and 0xA4 take only the lower 32 bits of the angle",
        "width",
        on_asked("position", lambda v: wrapped(v, 32), MULTI_TURN),
    ),
    _fault(
        "lk-asked-speed-int16",
        "0xA2 takes only the lower 16 bits of the speed",
        "width",
        on_asked("speed", lambda v: wrapped(v, 16), ("run_speed",)),
    ),
    _fault(
        "lk-parameter-int16",
        "0xC1 takes only the lower 16 bits of limits and ramps",
        "width",
        on_request(
            lambda drive, command, values: (
                {n: v if n == "parameter" else wrapped(v, 16) % (1 << 16) for n, v in values.items()}
                if any(n.endswith(("_ramp", "speed_limit", "angle_limit")) for n in values)
                else values
            ),
            ("write_parameter",),
        ),
    ),
    # --- scale ----------------------------------------------------------------------------------------------------
    _fault("lk-asked-speed-tenfold", "0xA2 takes the speed in 0.1 deg/s", "scale", on_asked("speed", lambda v: 10 * v)),
    _fault("lk-speed-tenth", "replies have the speed in 10 deg/s", "scale", _reads("speed", lambda v: round(v / 10), *STATE_2)),
    _fault(
        "lk-position-tenth",
        "0x92 answers the angle in 0.1 deg",
        "scale",
        _reads("position", lambda v: round(v / 10), "read_position"),
    ),
    _fault(
        "lk-target-tenfold",
        "0xA3 and 0xA4 take the angle in 0.1 deg",
        "scale",
        on_asked("position", lambda v: 10 * v, MULTI_TURN),
    ),
    _fault("lk-voltage-tenth", "the voltage is answered in 0.1 V", "scale", _reads("voltage", lambda v: round(v / 10))),
    _fault("lk-torque-half", "replies have half the torque current", "scale", _torque(lambda v: round(v / 2))),
    _fault(
        "lk-max-speed-tenfold",
        "max_speed is taken in 0.1 deg/s",
        "scale",
        on_asked("max_speed", lambda v: min(10 * v, (1 << 32) - 1)),
    ),
    # --- ranges ---------------------------------------------------------------------------------------------------
    _fault("lk-torque-any", "0xA1 obeys torque currents beyond 2048", "range", _obeying("torque_current")),
    _fault("lk-power-any", "0xA0 obeys powers beyond 850", "range", _obeying("power")),
    _fault("lk-torque-short", "0xA1 does not obey its highest torque current", "range", _refusing("torque_current", _highest)),
    _fault("lk-power-short", "0xA0 does not obey its highest power", "range", _refusing("power", _highest)),
    _fault("lk-angle-any", "0xA5 and 0xA6 obey angles beyond 359.99 degrees", "range", _obeying("angle")),
    _fault("lk-angle-short", "0xA5 and 0xA6 do not obey 359.99 degrees", "range", _refusing("angle", _highest)),
    _fault(
        "lk-direction-any", "0xA5 and 0xA6 take any direction but 0 for counter-clockwise", "choices", _obeying("direction")
    ),
    _fault(
        "lk-torque-short-below", "0xA1 does not obey its lowest torque current", "range", _refusing("torque_current", _lowest)
    ),
    _fault("lk-torque-one-more", "0xA1 obeys one torque current too many above", "range", _obeying("torque_current", _above)),
    _fault("lk-torque-one-less", "0xA1 obeys one torque current too many below", "range", _obeying("torque_current", _below)),
    _fault("lk-power-short-below", "0xA0 does not obey its lowest power", "range", _refusing("power", _lowest)),
    _fault("lk-power-one-more", "0xA0 obeys one power too many above", "range", _obeying("power", _above)),
    _fault("lk-power-one-less", "0xA0 obeys one power too many below", "range", _obeying("power", _below)),
    _fault("lk-angle-one-more", "0xA5 and 0xA6 obey 360 degrees", "range", _obeying("angle", _above)),
    _fault("lk-angle-not-0", "0xA5 and 0xA6 do not obey 0 degrees", "range", _refusing("angle", _lowest)),
    _fault("lk-direction-not-1", "0xA5 and 0xA6 do not obey counter-clockwise", "choices", _refusing("direction", _is_ccw)),
    # --- readings -------------------------------------------------------------------------------------------------
    _fault(
        "lk-state-1-swapped",
        "0x9A and 0x9B answer current and voltage in each other's place",
        "reply layout",
        on_result(_swap_state_1, STATE_1),
    ),
    _fault("lk-state-always-on", "the motor is reported on while it is off", "off", _reads("state", lambda v: MotorState.ON)),
    _fault(
        "lk-error-bits-shifted", "each error flag is shown one bit too high", "error flags", on_result(_shift_flags, STATE_1)
    ),
    _fault("lk-error-bits-hidden", "error flags are never shown", "error flags", on_result(_hide_flags, STATE_1)),
    _fault("lk-error-bits-frozen", "an error flag that was shown once is shown for ever", "error flags", _freeze_flags),
    _fault(
        "lk-encoder-not-offset",
        "0x90 answers the raw value in place of the difference",
        "encoder",
        on_field("encoder", lambda drive, v: drive.motor.encoder_raw, ("read_encoder",)),
    ),
    _fault(
        "lk-encoder-offset-added",
        "0x90 adds the offset instead of taking it away",
        "encoder",
        on_field(
            "encoder",
            lambda drive, v: (drive.motor.encoder_raw + drive.motor.encoder_zero) % drive.motor.encoder_scale,
            ("read_encoder",),
        ),
    ),
    _fault(
        "lk-encoder-coarse",
        "motion commands and 0x9C answer the encoder with two bits fewer",
        "encoder",
        _reads("encoder", lambda v: v >> 2, *STATE_2),
    ),
    _fault(
        "lk-single-turn-runs-on",
        "0x94 counts on past 359.99 degrees",
        "range",
        on_field("angle", _runs_on, ("read_single_turn",)),
    ),
    _fault(
        "lk-position-single-turn",
        "0x92 answers the angle within the turn",
        "position",
        on_field("position", _single, ("read_position",)),
    ),
    _fault(
        "lk-phases-in-step",
        "0x9D answers the same current for all phases",
        "phase currents",
        on_result(
            lambda drive, command, asked, values: (
                values | dict.fromkeys(("phase_b_current", "phase_c_current"), values["phase_a_current"])
            ),
            ("read_state_3",),
        ),
    ),
    _fault(
        "lk-zero-not-raw",
        "0x19 answers the encoder counted from the old zero",
        "zero",
        on_field("encoder_zero", lambda drive, v: drive.motor.encoder),
    ),
    # --- parameters -----------------------------------------------------------------------------------------------
    _fault(
        "lk-parameter-other",
        "0xC0 answers for the next parameter of the table",
        "parameters",
        on_result(_other_parameter, ("read_parameter",)),
    ),
    _fault(
        "lk-gains-swapped",
        "0xC0 and 0xC1 answer kp and ki in each other's place",
        "parameters",
        on_result(_gains_swapped, PARAMETER_COMMANDS),
    ),
    _fault(
        "lk-parameter-write-zeros",
        "0xC1 answers zeros instead of the values after writing",
        "parameters",
        on_result(_zeros, ("write_parameter",)),
    ),
    # --- brake ----------------------------------------------------------------------------------------------------
    _fault(
        "lk-brake-state-inverted",
        "0x8C answers the opposite of the brake's state",
        "brake",
        _reads("brake_state", lambda v: BrakeState.RELEASED if v == BrakeState.POWER_OFF else BrakeState.POWER_OFF),
    ),
    _fault("lk-brake-read-releases", "reading the brake's state releases it", "brake", on_request(_read_releases, ("brake",))),
)
