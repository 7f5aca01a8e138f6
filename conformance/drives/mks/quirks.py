"""Quirks of the MKS drives: named behaviour of real drives that differs from their manuals, off by default.

Each quirk names its source. Facts that only confirm the manual have no quirk, since all drives here keep them: register 90h
with five bytes, FFFFh for a refused write, `00 82` answered `82 05`. Behaviour of hosts, adapters and buses has no quirk.
"""

from __future__ import annotations

import random
from collections.abc import Iterable

from msgspec.structs import replace

from analyzer.catalogue import Command, Verb
from analyzer.codec import codec
from analyzer.layout import Layout, u16
from analyzer.protocols import mks_rs485, mks_shared
from analyzer.records import Frame, Message
from conformance.drives.drive import Drive, Hooks, Outgoing, Quirk, Values
from conformance.drives.faults.mks_behaviour import mks, tuned, with_law
from conformance.drives.faults.numbers import always, exchanged, renamed
from conformance.drives.faults.places import (
    CAN,
    MKS,
    MODBUS,
    NATIVE,
    SERIAL,
    TELLING,
    asked,
    body_of,
    byte,
    frames,
    rebuilt,
    reply,
    result,
    taken,
    together,
)
from conformance.drives.mks.core import MOTIONS, Activity, MksCore
from conformance.drives.mks.paths import Phase, ramp_step_ns
from conformance.drives.mks.settings import SETTINGS

_SERVO = "riccardi-samuele/mks-servo"
_REPORT = f"{_SERVO}, docs/reports/2026-05-09-test-report.md"
_SERVO_ISSUES = "makerbase-motor/MKS-SERVO42D-57D"
_CAN_NOTES = "TRazDev/servo42es-esp32-can-controller, docs/protocol.md"
_LATER_MANUAL = f"vendor's Modbus manual V1.0.9, {_SERVO_ISSUES}"

_SLOWEST_REPLY_NS = 700_000_000
_WRITE_GAP_NS = 500_000_000
_RESTART_NS = 2_000_000_000
_CALIBRATION_NS = 10_000_000_000
_SECOND_REPLY_NS = 20_000_000
_SETTLING_NS = 100_000_000
_SETTLING_COUNTS = 14
_STATUS_STAYS_NS = 1_000_000_000

#: The head of a native reply; no Modbus address is as high.
_NATIVE_REPLY = b"\xfb"
#: Register 94h of the later manual: quantity 4, byte count 8.
_HOME_94 = Layout(mks_shared.RETURN_ANGLE, u16("home_mode", choices=mks_shared.HomeMode), mks_shared.HOME_CURRENT)
_HOME_94_HEAD = bytes.fromhex("10 00 94 00 04 08")


def _since_settled(drive: MksCore) -> float:
    """Return the ns since the shaft came to its target, infinite while it turns or never turned."""
    path = drive.motor.path
    moved = len(path.segments) > 1 and drive.motor.phase(drive.now_ns) is Phase.STANDING
    return float(drive.now_ns - path.settled) if moved else float("inf")


def _slowing_still(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
    stays = values["status"] == mks_shared.MotorStatus.STOPPED and _since_settled(mks(drive)) < _STATUS_STAYS_NS
    return {"status": int(mks_shared.MotorStatus.SLOWING_DOWN)} if stays else values


def _slow_in_motion(hooks: Hooks) -> None:
    chances: list[random.Random] = []

    def setup(drive: Drive) -> None:
        chances[:] = [random.Random(drive.seed)]

    def say(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        if mks(drive).motor.speed(drive.now_ns):
            yield replace(outgoing, at_ns=outgoing.at_ns + chances[0].randrange(_SLOWEST_REPLY_NS))
        else:
            yield outgoing

    hooks.setup.append(setup)
    hooks.reply.append(say)


def _hasty_writes(hooks: Hooks) -> None:
    last_ns: list[int] = []

    def accept(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        writes = wanted and message.command is not None and message.command.verb in SETTINGS
        if not writes:
            return wanted
        return not last_ns or drive.now_ns - last_ns[0] >= _WRITE_GAP_NS

    def result(drive: Drive, command: Command, asked: Values, values: Values | None) -> Values | None:
        # What is refused writes nothing. Under Modbus the drive has the same statuses, and answers by a form.
        if command.verb in SETTINGS and not (
            values and values.get("status") in mks_rs485.DIALECT.by_verb[command.verb].replies.failed
        ):
            last_ns[:] = [drive.now_ns]
        return values

    hooks.accept.append(accept)
    hooks.result.append(result)


def _second_reply(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
    return (outgoing, replace(outgoing, at_ns=outgoing.at_ns + _SECOND_REPLY_NS))


def _fragments(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
    if frame.dialect.name != drive.dialect.name and frame.checksum_ok:
        at_ns = drive.now_ns + mks(drive).reply_delay_ns
        mks(drive).send(drive.dialect.commands[0], Outgoing(at_ns, frame.data[1:3]))
    return wanted


def _hear_both(drive: MksCore) -> None:
    drive.hears = tuple(responder.dialect for responder in drive.responders)


def _without_check(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
    # The frame tells its dialect: the reply that switches to Modbus is the last native one, which the drive no longer is.
    native = outgoing.data[:1] == _NATIVE_REPLY
    yield replace(outgoing, data=outgoing.data[:-1]) if native else outgoing


def _from_new_address(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
    place = 1 if (drive.dialect.name,) == NATIVE else 0
    yield rebuilt(drive, outgoing, byte(place, lambda _: drive.address)(body_of(drive, outgoing)))


def _register_94(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
    core, body = mks(drive), frame.data[:-2]
    own = frame.checksum_ok and message.address in (drive.address, drive.dialect.broadcast)
    if not own or not body[1:].startswith(_HOME_94_HEAD) or len(body) != 7 + _HOME_94.byte_length:
        return wanted
    data = body[7:]
    good = codec(_HOME_94).valid(data)
    if good:
        for name, value in codec(_HOME_94).wire(data).items():
            core.store(name, value)
    if message.address == drive.address:
        quantity = body[4:6] if good else b"\0\0"
        echo = drive.dialect.link.completed(body[:4] + quantity)
        core.send(drive.dialect.commands[0], Outgoing(drive.now_ns + core.reply_delay_ns, echo))
    return False


def _unsettled(drive: Drive, command: Command, asked: Values, values: Values) -> Values:
    core = mks(drive)
    if _since_settled(core) >= _SETTLING_NS:
        return values
    way = next((s.way for s in reversed(core.motor.path.segments) if s.way), 0)
    return values | {"position": values["position"] - way * _SETTLING_COUNTS}


def _deaf_after_limit(hooks: Hooks) -> None:
    stopped: list[bool] = []

    def result(drive: Drive, command: Command, asked: Values, values: Values | None) -> Values | None:
        if command.verb in MOTIONS and values == {"status": int(mks_shared.RunStatus.LIMIT_STOP)}:
            stopped[:] = [True]
        return values

    def accept(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        if wanted and stopped and message.command is not None and message.command.verb in MOTIONS:
            stopped.clear()
            return False
        return wanted

    hooks.result.append(result)
    hooks.accept.append(accept)


def _calibrates_at_once(hooks: Hooks) -> None:
    """Answer 80 with 1 at once, calibrate for ten seconds, and say nothing at the end."""

    def change(drive: MksCore) -> None:
        before = drive.behaviours[Verb.CALIBRATE]

        def act(drive: MksCore, request: object) -> Values | None:
            answer = before(drive, request)  # type: ignore[arg-type]  # the wrapped behaviour takes the same request
            if drive.doing(Activity.CALIBRATE) and drive.task is not None:
                drive.task.request = None
                return {"status": int(mks_shared.CalibrationStatus.SUCCESS)}
            return answer

        drive.behaviours[Verb.CALIBRATE] = act
        drive.calibration_ns = _CALIBRATION_NS

    tuned(change)(hooks)


QUIRKS: tuple[Quirk, ...] = (
    Quirk("reversed-direction", NATIVE,
        "direction bit 0 of F6 and FD lowers the encoder value (42D, 1.0.6)", _REPORT,
        asked("direction", exchanged(0, 1), (Verb.RUN_SPEED, Verb.MOVE_RELATIVE_PULSES))),
    Quirk("status-stays-slowing", SERIAL,
        "F1 stays at 3 for a second after a move, though the speed reads 0", _REPORT, result(_slowing_still, Verb.READ_STATUS)),
    Quirk("status-stops-early", SERIAL,
        "F1 says 1 while the motor still slows down (57D, 1.0.4)", f"{_SERVO_ISSUES} issue 3",
        reply("status", renamed(mks_shared.MotorStatus.SLOWING_DOWN, mks_shared.MotorStatus.STOPPED), Verb.READ_STATUS)),
    Quirk("slow-replies-in-motion", SERIAL, "replies take up to 700 ms while the motor turns", _SERVO, _slow_in_motion),
    Quirk("hasty-writes-dropped", SERIAL, "a setting less than 500 ms after another one is dropped", _SERVO, _hasty_writes),
    Quirk("slow-restart", SERIAL, "a restart takes two seconds", _SERVO, with_law("start_ns", _RESTART_NS)),
    Quirk("calibration-answers-1", SERIAL,
        "80 answers 1 at once, F1 says 6 for ten seconds, no reply at the end", _SERVO, _calibrates_at_once),
    Quirk("second-reply", NATIVE,
        "settings are answered once more after 20 ms", f"{_SERVO_ISSUES} issue 5", frames(_second_reply, SETTINGS)),
    Quirk("other-dialect-fragments", SERIAL,
        "frames of the other dialect are answered with fragments", f"{_SERVO_ISSUES} issue 13",
        together(tuned(_hear_both), taken(_fragments))),
    Quirk("no-checksum", NATIVE,
        "replies have no checksum (42C, firmware 1.0)", "makerbase-mks/MKS-SERVO42C issue 58", frames(_without_check)),
    Quirk("new-address-answers", SERIAL,
        "8B is answered from the new address", "zauberzeug/lizard PR 199", frames(_from_new_address, Verb.SET_ADDRESS)),
    Quirk("ramp-4-percent-slow", MKS,
        "ramps take four per cent longer than the law", "moves at 3000 rpm, timed by another project (real-hardware.md)",
        with_law("ramp", lambda acceleration: ramp_step_ns(acceleration) * 26 // 25)),
    Quirk("register-94h", MODBUS,
        "there is a register 94h for homing without a switch (quantity 4, byte count 8)", _LATER_MANUAL, taken(_register_94)),
    Quirk("settling", CAN,
        "for 100 ms after a move the position is 14 counts short", _CAN_NOTES, result(_unsettled, Verb.READ_POSITION)),
    Quirk("version-cal-1", CAN,
        "40 says that turning clockwise raises the encoder", _CAN_NOTES, reply("calibration", always(1), Verb.READ_VERSION)),
    Quirk("deaf-after-limit-stop", TELLING,
        "after an end limit the next motion command is ignored (57D)", "kkhyunhho/MKSServo57DCANController", _deaf_after_limit),
)  # fmt: skip
