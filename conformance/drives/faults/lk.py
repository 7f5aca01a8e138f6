"""Faults of the LK drives: defects in what they hear, tell and keep. Those of motion stand in `lk_motion`."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from msgspec.structs import replace

from analyzer.catalogue import Command, Verb
from analyzer.protocols.lk_rs485 import ERROR_BITS, BrakeControl, BrakeState, MotorState
from analyzer.records import Frame, Message
from conformance.drives.drive import Drive, Hooks, Outgoing, Request, Values
from conformance.drives.faults.generic import LK_MOTIONS
from conformance.drives.faults.lk_behaviour import acting, at_power_up, backwards, lk, nothing, replaced, turns, undone
from conformance.drives.faults.numbers import always, exchanged, swap_bytes
from conformance.drives.faults.places import (
    LK,
    Change,
    Row,
    Rows,
    answered,
    faults,
    frames,
    reply,
    result,
    storing,
    taken,
    together,
    unstored,
)
from conformance.drives.lk.drive import MOVES, Act, LkDrive
from conformance.drives.lk.motor import Torque

STATE_1 = (Verb.READ_STATE_1, Verb.CLEAR_ERRORS)
PARAMETERS = (Verb.READ_PARAMETER, Verb.WRITE_PARAMETER)
#: Reads of values that change with the motion.
LK_READS = (
    Verb.READ_STATE_1,
    Verb.READ_STATE_2,
    Verb.READ_STATE_3,
    Verb.READ_ENCODER,
    Verb.READ_POSITION,
    Verb.READ_SINGLE_TURN,
    Verb.READ_PARAMETER,
)
FLAGS = tuple(field.name for field in ERROR_BITS)

# --- which requests it takes -----------------------------------------------------------------------------------------


def _hearing(also: Callable[[Drive, Frame, Message], bool]) -> Change:
    return taken(lambda drive, frame, message, wanted: wanted or also(drive, frame, message))


def _unanswered(change: Change) -> Change:
    """Let what the drive takes wrongly be obeyed and not be answered."""
    return together(
        change, answered(lambda drive, message, wanted: wanted and message.frame.checksum_ok and _own(drive, message))
    )


def _own(drive: Drive, message: Message) -> bool:
    return message.address == drive.address


def _broken(number: int) -> Change:
    """Take requests of which one sum alone is wrong: that of the head (0) or of the data (1)."""

    def also(drive: Drive, frame: Frame, message: Message) -> bool:
        wrong = [n for n, check in enumerate(frame.dialect.link.checks(frame.data)) if not check.ok]
        return message.form is not None and _own(drive, message) and wrong == [number]

    return _hearing(also)


def _unchecked(number: int, *names: str) -> Change:
    """Take some commands of which one sum is wrong, and answer nothing."""

    def also(drive: Drive, frame: Frame, message: Message) -> bool:
        wrong = [n for n, check in enumerate(frame.dialect.link.checks(frame.data)) if not check.ok]
        known = message.command is not None and message.command.name in names
        return message.form is not None and known and _own(drive, message) and wrong == [number]

    return _unanswered(_hearing(also))


# --- what replies say ------------------------------------------------------------------------------------------------


def _read(change: Callable[[LkDrive, Values], Values], *of: Verb) -> Change:
    """Put other values into the replies to some commands."""
    return result(lambda drive, command, asked, values: values | change(lk(drive), values), of)


def _shown_for_ever(hooks: Hooks) -> None:
    seen: set[str] = set()

    def show(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
        seen.update(name for name in FLAGS if values[name])
        return values | dict.fromkeys(seen, 1)

    result(show, STATE_1)(hooks)


def _other_parameter(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
    """Answer for the parameter after the one asked for."""
    numbers = [f.layout.named["parameter"].fixed for f in command.reply_forms]
    listed = [n for n in numbers if n is not None]
    wanted = listed[(listed.index(values["parameter"]) + 1) % len(listed)]
    form = command.reply_forms[numbers.index(wanted)]
    return {n: lk(drive).reading(f) if f.fixed is None else f.fixed for n, f in form.layout.named.items()}


def _gains_exchanged(drive: LkDrive, values: Values) -> Values:
    pairs = [(n, n.replace("_kp", "_ki")) for n in values if n.endswith("_kp")]
    return {a: values[b] for p in pairs for a, b in (p, p[::-1])}


def _whole_turn_told(drive: LkDrive, values: Values) -> Values:
    turned = abs(drive.motor.motion.angle - drive.motor.zero) >= 360
    return {"angle": values["angle"] or 36_000 * turned}


def _running_on(drive: LkDrive, values: Values) -> Values:
    field = drive.dialect.by_name["read_position"].reply_forms[0].layout.named["position"]
    return {"angle": field.wire(drive.motor.motion.angle - drive.motor.zero) % (1 << 32)}


def _within_turn(drive: LkDrive, values: Values) -> Values:
    return {"position": drive.reading(drive.dialect.by_name["read_single_turn"].reply_forms[0].layout.named["angle"])}


def _offset_added(drive: LkDrive, values: Values) -> Values:
    motor = drive.motor
    return {"encoder": (motor.encoder_raw + motor.encoder_zero) % motor.encoder_scale}


def _head_alone_moving(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
    """Answer with a head without data while the shaft turns."""
    data = outgoing.data
    head = bytes((*data[:3], 0))
    yield replace(outgoing, data=head + bytes((sum(head) & 0xFF,))) if lk(drive).motor.motion.speed else outgoing


def _silent(when: Callable[[LkDrive], bool], *of: Verb) -> Change:
    return result(lambda drive, command, asked, values: None if when(lk(drive)) else values, of)


def _stale(verb: Verb, when: Callable[[LkDrive], bool]) -> Change:
    """Tell in a condition what was told before it."""

    def install(hooks: Hooks) -> None:
        kept: dict[str, int] = {}

        def tell(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
            if not when(lk(drive)) or not kept:
                kept.update(values)
            return dict(kept)

        result(tell, verb)(hooks)

    return Change(install, LK)


def _told_of_rest(name: str) -> Change:
    """Let motion commands to a turning shaft tell a value as it was when the shaft stood."""

    def install(hooks: Hooks) -> None:
        kept: dict[str, int] = {}

        def tell(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
            if name in values and not turns(lk(drive)):
                kept[name] = values[name]
            return values | kept if name in values and command.verb in LK_MOTIONS else values

        result(tell)(hooks)

    return Change(install, LK)


def _first_temperature(hooks: Hooks) -> None:
    """Let motion commands tell the temperature that they told first."""
    kept: list[int] = []

    def tell(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
        kept.append(values["temperature"])
        return values | {"temperature": kept[0]}

    result(tell, LK_MOTIONS)(hooks)


def _capped(name: str, most: int, *of: Verb) -> Change:
    return result(lambda drive, command, asked, values: values | {name: min(most, values[name])}, of)


def _flags_read_away(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
    lk(drive).clear_errors()
    return values


def _telling_cleared_flags(hooks: Hooks) -> None:
    flags: set[str] = set()

    def clear(old: Act, drive: LkDrive, request: Request) -> None:
        flags.clear()
        flags.update(drive.errors)
        old(drive, request)

    replaced("clear_errors", clear).install(hooks)
    told = _read(lambda drive, values: values | {name: 1 for name in flags if name in values}, Verb.CLEAR_ERRORS)
    told.install(hooks)


def _motion_tells_last_read(hooks: Hooks) -> None:
    last: dict[str, int] = {}

    def tell(drive: Drive, command: Command, asked: Values, values: Values | None) -> Values | None:
        if values is not None and command.verb is Verb.READ_STATE_2:
            last.update({name: values[name] for name in ("speed", "encoder")})
        told = values is not None and command.name in MOVES
        return {**values, **{n: v for n, v in last.items() if n in values}} if told and values is not None else values

    hooks.result.append(tell)


def _brake_told_on(hooks: Hooks) -> None:
    moved = False

    def watch(drive: Drive, command: Command, values: Values) -> Values:
        nonlocal moved
        moved = command.name in MOVES or (moved and values.get("brake_control") in (None, BrakeControl.READ))
        return values

    hooks.request.append(watch)
    _read(lambda drive, values: values | {"brake_state": int(BrakeState.POWER_OFF)} if moved else values, Verb.BRAKE).install(
        hooks
    )


def _torque_told_on(hooks: Hooks) -> None:
    told: list[int] = []

    def stop(old: Act, drive: LkDrive, request: Request) -> None:
        told[:] = [round(drive.motor.torque)] if isinstance(drive.motor.goal, Torque) else told
        old(drive, request)

    def watch(drive: Drive, command: Command, values: Values) -> Values:
        if command.name in MOVES:
            told.clear()
        return values

    replaced("stop", stop).install(hooks)
    hooks.request.append(watch)
    name = "torque_current"
    tell = _read(lambda drive, values: values | {name: told[0]} if told and name in values else values, Verb.READ_STATE_2)
    tell.install(hooks)


def _phases_doubled(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
    return {name: 2 * value if name.startswith("phase_") else value for name, value in values.items()}


def _late(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
    yield replace(outgoing, at_ns=outgoing.at_ns + (30_000_000 if turns(lk(drive)) else 0))


# --- what it keeps ---------------------------------------------------------------------------------------------------


def _clear_upward(drive: LkDrive, request: Request) -> None:
    if drive.motor.position > 0:
        drive.motor.clear_turns()


def _next_parameter(drive: Drive, name: str, value: int) -> tuple[str, int]:
    names = list(lk(drive).parameters)
    return (names[(names.index(name) + 1) % len(names)], value) if name in names else (name, value)


def _kept_parameter(drive: Drive, name: str, value: int) -> tuple[str, int]:
    drive.settings[name] = value
    return name, value


def _zero_now(drive: LkDrive, request: Request) -> None:
    drive.motor.encoder_zero = drive.settings["encoder_zero"]
    drive.motor.set_position(drive.motor.within_turn)


def _position_kept(hooks: Hooks) -> None:
    origins: list[float] = []

    def remember(drive: LkDrive, request: Request) -> None:
        origins[:] = [drive.motor.origin]

    def powered(drive: LkDrive) -> None:
        if origins:
            drive.motor.origin = origins[0]

    together(acting("set_position", remember, after=True), at_power_up(powered))(hooks)


def _dropping_turns(old: Act, drive: LkDrive, request: Request) -> None:
    if turns(drive):
        drive.motor.clear_turns()
    old(drive, request)


def _forgetting(name: str, **values: int) -> Change:
    return acting(name, lambda drive, request: drive.parameters.update(values), after=True)


ROWS: Rows = {
    "addressing": (
        Row("lk-answers-other-address", "requests to any address are obeyed and answered",
            _hearing(lambda d, f, m: f.checksum_ok and m.form is not None)),
        Row("lk-answers-address-0", "address 0 is taken for a broadcast, obeyed and answered",
            _hearing(lambda d, f, m: f.checksum_ok and m.form is not None and m.address == 0)),
        Row("lk-obeys-other-address", "requests to any address are obeyed, and its own alone are answered",
            _unanswered(_hearing(lambda d, f, m: f.checksum_ok and m.form is not None))),
    ),
    "checksum": (
        Row("lk-answers-wrong-data-sum", "requests are obeyed and answered although the sum of their data is wrong",
            _broken(1)),
        Row("lk-answers-wrong-head-sum", "requests are obeyed and answered although the sum of their head is wrong",
            _broken(0)),
        Row("lk-obeys-wrong-data-sum", "requests are obeyed, and not answered, although the sum of their data is wrong",
            _unanswered(_broken(1))),
        Row("lk-obeys-wrong-head-sum", "requests are obeyed, and not answered, although the sum of their head is wrong",
            _unanswered(_broken(0))),
    ),
    "checksum of one": (
        Row("lk-stop-unchecked", "0x81 is obeyed although the sum of its head is wrong", _unchecked(0, "stop")),
        Row("lk-clear-turns-unchecked", "0x93 is obeyed although the sum of its head is wrong", _unchecked(0, "clear_turns")),
        Row("lk-clear-errors-unchecked", "0x9B is obeyed although the sum of its head is wrong", _unchecked(0, "clear_errors")),
    ),
    "unknown code": (
        Row("lk-answers-unknown-code", "a code that no command has is echoed",
            _hearing(lambda d, f, m: f.checksum_ok and _own(d, m) and m.command is None)),
    ),
    "length": (
        Row("lk-answers-wrong-length", "a known code with a wrong length is echoed",
            _hearing(lambda d, f, m: f.checksum_ok and _own(d, m) and m.command is not None and m.form is None)),
    ),
    "off": (
        Row("lk-silent-while-off", "motion commands are not answered while the motor is off",
            result(lambda drive, command, asked, values: values if lk(drive).motor.on else None, LK_MOTIONS)),
        Row("lk-state-always-on", "the motor is reported on while it is off", reply("state", always(MotorState.ON))),
    ),
    "reply layout": (
        Row("lk-state-1-swapped", "0x9A and 0x9B answer current and voltage in each other's place",
            _read(lambda d, v: {"voltage": v["current"], "current": v["voltage"]}, *STATE_1)),
        Row("lk-state-2-cold", "0x9C tells the temperature 0", reply("temperature", always(0), Verb.READ_STATE_2)),
        Row("lk-state-3-cold", "0x9D tells the temperature 0", reply("temperature", always(0), Verb.READ_STATE_3)),
        Row("lk-motion-cold", "motion commands tell the temperature 0", reply("temperature", always(0), LK_MOTIONS)),
        Row("lk-motion-temperature-first", "motion commands tell the temperature of the first one",
            Change(_first_temperature, LK)),
        Row("lk-motion-encoder-stale", "motion commands to a turning shaft tell the encoder value where it stood",
            _told_of_rest("encoder")),
        Row("lk-motion-current-stale", "motion commands to a turning shaft tell the torque current that it had when it stood",
            _told_of_rest("torque_current")),
        Row("lk-motion-speed-0", "motion commands tell the speed 0", reply("speed", always(0), LK_MOTIONS)),
        Row("lk-motion-encoder-raw", "motion commands tell the encoder half a turn on",
            _read(lambda d, v: {"encoder": (v["encoder"] + d.motor.encoder_scale // 2) % d.motor.encoder_scale}, *LK_MOTIONS)),
        Row("lk-cleared-no-voltage", "0x9B tells the voltage 0", reply("voltage", always(0), Verb.CLEAR_ERRORS)),
        Row("lk-supply-current-swapped", "0x9A tells the current high byte first", reply("current", swap_bytes, STATE_1)),
    ),
    "error flags": (
        Row("lk-error-bits-shifted", "each error flag is shown one bit too high",
            _read(lambda d, v: {name: v[low] for name, low in zip(FLAGS, FLAGS[1:] + FLAGS[:1], strict=True)}, *STATE_1)),
        Row("lk-error-bits-hidden", "error flags are never shown", reply(FLAGS, always(0), STATE_1)),
        Row("lk-error-bits-frozen", "an error flag that was shown once is shown for ever", Change(_shown_for_ever, LK)),
        Row("lk-clear-errors-always", "0x9B clears flags whose cause lasts",
            acting("clear_errors", lambda drive, request: drive.errors.clear(), after=True)),
        Row("lk-clear-errors-never", "0x9B clears nothing", acting("clear_errors", nothing)),
    ),
    "encoder": (
        Row("lk-encoder-not-offset", "0x90 answers the raw value in place of the difference",
            _read(lambda d, v: {"encoder": d.motor.encoder_raw}, Verb.READ_ENCODER)),
        Row("lk-encoder-offset-added", "0x90 adds the offset instead of taking it away",
            _read(_offset_added, Verb.READ_ENCODER)),
        Row("lk-encoder-coarse", "motion commands and 0x9C answer the encoder with two bits fewer",
            reply("encoder", lambda v, field: v >> 2, (Verb.READ_STATE_2, *LK_MOTIONS))),
    ),
    "range": (
        Row("lk-single-turn-36000", "0x94 tells 36000 in place of 0",
            _read(lambda d, v: {"angle": v["angle"] or 36_000}, Verb.READ_SINGLE_TURN)),
        Row("lk-single-turn-36000-turned", "0x94 tells 36000 in place of 0 where the shaft has made turns",
            _read(_whole_turn_told, Verb.READ_SINGLE_TURN)),
        Row("lk-single-turn-runs-on", "0x94 counts on past 359.99 degrees", _read(_running_on, Verb.READ_SINGLE_TURN)),
        Row("lk-single-turn-shifted", "0x94 tells an angle a quarter of a turn on",
            _read(lambda d, v: {"angle": (v["angle"] + 9_000) % 36_000}, Verb.READ_SINGLE_TURN)),
    ),
    "position": (
        Row("lk-position-single-turn", "0x92 answers the angle within the turn", _read(_within_turn, Verb.READ_POSITION)),
        Row("lk-set-position-ignored", "0x95 is echoed and does nothing", acting("set_position", nothing)),
        Row("lk-clear-turns-upward", "0x93 drops positive turns alone", acting("clear_turns", _clear_upward)),
        Row("lk-clear-turns-ignored", "0x93 is echoed and does nothing", acting("clear_turns", nothing)),
    ),
    "read state 1": (
        Row("lk-off-while-turning", "0x9A tells a motor that turns as off",
            _read(lambda d, v: {"state": MotorState.OFF} if d.motor.motion.speed else {}, *STATE_1)),
        Row("lk-stalled-while-turning", "0x9A tells a motor that turns as stalled",
            _read(lambda d, v: {"stalled": 1} if d.motor.motion.speed else {}, *STATE_1)),
    ),
    "moving": (
        Row("lk-reads-silent-moving", "reads are not answered while the shaft turns",
            result(lambda drive, command, asked, values: None if lk(drive).motor.motion.speed else values, LK_READS)),
        Row("lk-reads-unfit-moving", "reads are answered by a head alone while the shaft turns",
            frames(_head_alone_moving, LK_READS)),
    ),
    "phase currents": (
        Row("lk-phases-in-step", "0x9D answers the same current for all phases",
            _read(lambda d, v: dict.fromkeys(("phase_b_current", "phase_c_current"), v["phase_a_current"]), Verb.READ_STATE_3)),
    ),
    "zero": (
        Row("lk-zero-not-raw", "0x19 answers the encoder counted from the old zero",
            _read(lambda d, v: {"encoder_zero": d.motor.encoder}, Verb.SET_ZERO)),
        Row("lk-zero-at-once", "0x19 moves the zero at once", acting("set_zero", _zero_now, after=True)),
        Row("lk-zero-not-told", "0x90 always tells the offset 0", reply("encoder_offset", always(0))),
        Row("lk-zero-lost", "the zero of 0x19 is not there after power-up", unstored("encoder_zero")),
    ),
    "parameters": (
        Row("lk-parameter-other", "0xC0 answers for the next parameter of the table",
            result(_other_parameter, Verb.READ_PARAMETER)),
        Row("lk-gains-swapped", "0xC0 and 0xC1 answer kp and ki in each other's place", _read(_gains_exchanged, *PARAMETERS)),
        Row("lk-parameter-write-zeros", "0xC1 answers zeros instead of the values after writing",
            _read(lambda d, v: dict.fromkeys(v.keys() - {"parameter"}, 0), Verb.WRITE_PARAMETER)),
        Row("lk-parameter-not-stored", "0xC1 answers the old values and keeps them",
            storing(lambda drive, name, value: None if name in lk(drive).parameters else (name, value))),
        Row("lk-parameter-elsewhere", "0xC1 stores each value in the next one's place", storing(_next_parameter)),
    ),
    "brake": (
        Row("lk-brake-state-inverted", "0x8C answers the opposite of the brake's state",
            reply("brake_state", exchanged(BrakeState.POWER_OFF, BrakeState.RELEASED))),
        Row("lk-brake-state-unlisted", "0x8C answers a state of the brake that is not listed", reply("brake_state", always(5))),
    ),
    "limits": (
        Row("lk-torque-without-sign", "0x9C tells the torque, or the power, without its sign",
            reply(("torque_current", "power"), lambda value, field: abs(value), Verb.READ_STATE_2)),
    ),
    "power": (
        Row("lk-set-position-kept", "what 0x95 set survives the power", Change(_position_kept, LK)),
        Row("lk-zero-short", "the zero that 0x19 stores lacks its highest bit",
            storing(lambda drive, name, value: (name, value & 0x1FFF) if name == "encoder_zero" else (name, value))),
        Row("lk-parameter-survives", "what 0xC1 wrote survives the power", storing(_kept_parameter)),
    ),
    "state": (
        Row("lk-reads-silent-while-off", "0x92 and 0x94 are not answered while the motor is off",
            _silent(lambda drive: not drive.motor.on, Verb.READ_POSITION, Verb.READ_SINGLE_TURN)),
        Row("lk-parameters-silent-while-turning", "0xC0 is not answered while the shaft turns",
            _silent(turns, Verb.READ_PARAMETER)),
        Row("lk-reads-silent-in-error", "0x90 is not answered while an error flag is set",
            _silent(lambda drive: bool(drive.errors), Verb.READ_ENCODER)),
        Row("lk-stop-drops-turns-of-a-run", "0x81 drops the counted turns while the shaft turns",
            replaced("stop", _dropping_turns)),
        Row("lk-off-drops-turns-of-a-run", "0x80 drops the counted turns while the shaft turns",
            replaced("motor_off", _dropping_turns)),
        Row("lk-turns-kept-while-turning", "0x93 does nothing while the shaft turns",
            undone("clear_turns", lambda drive, _: turns(drive))),
        Row("lk-late-while-turning", "replies come 30 ms late while the shaft turns",
            Change(lambda hooks: hooks.reply.append(_late), LK)),
        Row("lk-errors-kept-while-off", "0x9B clears nothing while the motor is off",
            undone("clear_errors", lambda drive, _: not drive.motor.on)),
        Row("lk-cleared-state-always-on", "0x9B tells the state 00h of a motor that is off",
            reply("state", always(MotorState.ON), Verb.CLEAR_ERRORS)),
        Row("lk-single-turn-frozen-backwards", "0x94 stays while the shaft turns counter-clockwise",
            _stale(Verb.READ_SINGLE_TURN, backwards)),
        Row("lk-encoder-frozen-turning", "0x90 stays while the shaft turns", _stale(Verb.READ_ENCODER, turns)),
        Row("lk-gains-lost-by-stop", "0x81 sets the speed gains back", _forgetting("stop", speed_kp=50, speed_ki=20)),
        Row("lk-gains-lost-by-off", "0x80 sets the angle gains back", _forgetting("motor_off", angle_kp=100, angle_ki=20)),
        Row("lk-limit-lost-by-clearing", "0x9B sets the speed limit back", _forgetting("clear_errors", speed_limit=72_000)),
        Row("lk-cleared-flags-told", "0x9B is answered with the flags that it has cleared", Change(_telling_cleared_flags, LK)),
        Row("lk-motion-tells-last-read", "motions are answered with the speed and the encoder value that 0x9C told last",
            Change(_motion_tells_last_read, LK)),
        Row("lk-brake-reads-on-after-motion", "after a motion 0x8C tells a brake that holds", Change(_brake_told_on, LK)),
        Row("lk-torque-told-after-stop", "after 0x81 0x9C tells the torque of before", Change(_torque_told_on, LK)),
        Row("lk-phases-told-while-off", "off, 0x9D tells the currents of before",
            _stale(Verb.READ_STATE_3, lambda d: not d.motor.on)),
        Row("lk-voltage-capped", "0x9A tells 25 V at most", _capped("voltage", 2_500, Verb.READ_STATE_1)),
        Row("lk-temperature-capped", "0x9C tells 63 degrees at most", _capped("temperature", 63, Verb.READ_STATE_2)),
        Row("lk-flags-read-away", "0x9A clears the flags that it tells", result(_flags_read_away, Verb.READ_STATE_1)),
        Row("lk-clear-turns-to-zero", "0x93 sets the position to 0",
            acting("clear_turns", lambda drive, request: drive.motor.set_position(0.0))),
        Row("lk-phases-doubled", "0x9D tells phase currents in half the unit", result(_phases_doubled, Verb.READ_STATE_3)),
    ),
}  # fmt: skip

FAULTS = faults(ROWS)
