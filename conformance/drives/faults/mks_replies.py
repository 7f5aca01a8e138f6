"""Faults of replies: head, address, code, length, byte order, sign, width and scale of what an MKS drive answers.

All of these have a good checksum: nothing but the reply's meaning is wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from msgspec.structs import replace

from analyzer.catalogue import Command, Verb
from analyzer.protocols import mks_shared
from conformance.drives.drive import Drive, Fault, Outgoing, Values
from conformance.drives.faults.mks_makers import (
    CAN,
    CAN_LONGEST,
    EVERY,
    MODBUS,
    NATIVE,
    TELLING,
    Install,
    answered,
    bodies,
    body_of,
    byte,
    changed,
    frozen,
    rebuilt,
    said,
)
from conformance.drives.mks.core import MksCore
from conformance.drives.mks.settings import SETTINGS

#: Where the code stands in a body, by dialect: Modbus has a function there.
_CODE = {NATIVE: 2, MODBUS: 1, CAN: 0}
_READS_OF_NUMBERS = {
    Verb.READ_ENCODER_CARRY, Verb.READ_POSITION, Verb.READ_SPEED, Verb.READ_PULSES, Verb.READ_ANGLE_ERROR,
}  # fmt: skip
_COUNTS = mks_shared.COUNTS_PER_TURN
_MEASURES = (
    (Verb.READ_POSITION, "position", "31", 48), (Verb.READ_SPEED, "speed", "32", 16),
    (Verb.READ_PULSES, "pulses", "33", 32), (Verb.READ_ANGLE_ERROR, "angle_error", "39", 32),
)  # fmt: skip


def _at_code(change: Callable[[int], int]) -> Install:
    """Change the code of every reply."""

    def say(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        place = _CODE[drive.dialect.name]
        yield rebuilt(drive, outgoing, byte(place, change)(body_of(drive, outgoing)))

    return said(say)


def _from_id(change: Callable[[int], int]) -> Install:
    """Answer under another identifier, with the checksum that fits it."""

    def say(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
        moved = replace(outgoing, can_id=change(outgoing.can_id or 0))
        yield rebuilt(drive, moved, body_of(drive, outgoing))

    return said(say)


def _padded(drive: Drive, command: Command, outgoing: Outgoing) -> Iterable[Outgoing]:
    yield replace(outgoing, data=outgoing.data.ljust(CAN_LONGEST, b"\0"))


def _swapped(bits: int) -> Callable[[int], int]:
    """Return a change that sends a number low byte first."""

    def apply(value: int) -> int:
        size = bits // 8
        return int.from_bytes((value % (1 << bits)).to_bytes(size, "big"), "little")

    return apply


def _narrow(bits: int) -> Callable[[int], int]:
    """Return a change that keeps only the low bits of a number, without its sign."""
    return lambda value: value & ((1 << bits) - 1)


def _status(change: Callable[[MksCore, int], int], verbs: Iterable[Verb] | None = None) -> Install:
    def apply(drive: MksCore, command: Command, asked: Values, values: Values) -> Values:
        return values | {"status": change(drive, values["status"])} if "status" in values else values

    return answered(None if verbs is None else frozenset(verbs), apply)


def _carried(drive: MksCore, command: Command, asked: Values, values: Values) -> Values:
    """Cut the turns towards zero: below zero the value within the turn would have to be negative."""
    axis = drive.axis
    carry = int(axis / _COUNTS)
    return values | {"carry": carry, "encoder": axis - carry * _COUNTS}


def _uncarried(drive: MksCore, command: Command, asked: Values, values: Values) -> Values:
    """Let the value run to two turns before it carries."""
    if not values["carry"] % 2:
        return values
    return values | {"carry": values["carry"] - 1, "encoder": values["encoder"] + _COUNTS}


def _measures(name: str, theme: str, text: str, change: Callable[[int], Callable[[int], int]]) -> tuple[Fault, ...]:
    """Return one fault of a kind for each measured number; `change` is given the bits of the number."""
    return tuple(
        Fault(f"{field.replace('_', '-')}-{name}", EVERY, f"{code}: {field.replace('_', ' ')} {text}", theme,
              changed(verb, field, change(bits)))
        for verb, field, code, bits in _MEASURES
    )  # fmt: skip


FAULTS: tuple[Fault, ...] = (
    # Head, address, code, length
    Fault("wrong-reply-code", EVERY, "replies carry a code (Modbus: function) one too high", "code", _at_code(lambda c: c + 1)),
    Fault("speed-reply-code-31", TELLING, "32 is answered under the code 31, as a table of the manual has it", "code",
          bodies(lambda b: b.replace(b"\x32", b"\x31", 1), {Verb.READ_SPEED})),
    Fault("wrong-reply-head", (NATIVE,), "replies begin with FA", "head", bodies(byte(0, lambda _: 0xFA))),
    Fault("unknown-reply-head", (NATIVE,), "replies begin with FD", "head", bodies(byte(0, lambda _: 0xFD))),
    Fault("wrong-reply-address", (NATIVE, MODBUS), "replies carry an address one too high", "address",
          bodies(lambda b: byte(1 if b[0] == 0xFB else 0, lambda a: a + 1)(b))),
    Fault("wrong-reply-id", (CAN,), "replies carry an ID one too high", "address", _from_id(lambda i: i + 1)),
    Fault("reply-under-id-0", (CAN,), "replies carry the ID 0", "address", _from_id(lambda i: 0)),
    Fault("reply-too-short", EVERY, "replies lack their last byte of data", "length", bodies(lambda b: b[:-1])),
    Fault("reply-too-long", EVERY, "replies have a byte of data more", "length", bodies(lambda b: b + b"\0")),
    Fault("reply-padded", (CAN,), "replies are filled up to eight bytes behind their checksum", "length", said(_padded)),
    Fault("status-of-two-bytes", TELLING, "the answer to a setting has a status of two bytes", "length",
          bodies(lambda b: b[:-1] + b"\0" + b[-1:], frozenset(SETTINGS))),
    # Numbers
    *_measures("low-byte-first", "byte order", "is sent low byte first", _swapped),
    *_measures("sign-turned", "sign", "has the wrong sign", lambda bits: lambda v: -v),
    *_measures("without-sign", "sign", "is sent without its sign", lambda bits: abs),
    *_measures("half-width", "width", "has half its bits", lambda bits: _narrow(bits // 2)),
    *_measures("doubled", "scale", "is twice what it should be", lambda bits: lambda v: 2 * v),
    Fault("angle-error-in-counts", EVERY, "the angle error is in counts of the encoder", "scale",
          changed(Verb.READ_ANGLE_ERROR, "angle_error", lambda v: v * _COUNTS // 51200)),
    Fault("position-in-pulses", EVERY, "31 shows pulses of 3200 a turn", "scale",
          changed(Verb.READ_POSITION, "position", lambda v: v * 3200 // _COUNTS)),
    Fault("position-offset", EVERY, "31 shows 100 counts too many", "scale",
          changed(Verb.READ_POSITION, "position", lambda v: v + 100)),
    Fault("carry-cut-to-zero", EVERY, "30 cuts negative positions towards zero", "sign",
          answered({Verb.READ_ENCODER_CARRY}, _carried)),
    Fault("carry-too-late", EVERY, "30 carries only every second turn", "width",
          answered({Verb.READ_ENCODER_CARRY}, _uncarried)),
    Fault("carry-before-value", EVERY, "30 sends the value before the carry", "byte order",
          bodies(lambda b: b[:-6] + b[-2:] + b[-6:-2], {Verb.READ_ENCODER_CARRY})),
    # Statuses and what stands still
    Fault("status-inverted", EVERY, "settings answer 0 for success and 1 for failure", "status",
          _status(lambda d, s: 1 - s, SETTINGS)),
    Fault("setting-status-2", TELLING, "settings answer 2 for success", "status",
          _status(lambda d, s: 2 if s == 1 else s, SETTINGS)),
    Fault("refusal-says-success", EVERY, "a refused setting answers as if it had been done", "status",
          _status(lambda d, s: 1, SETTINGS)),
    Fault("run-status-2", TELLING, "a run at a speed is answered 2", "status",
          _status(lambda d, s: 2 if s == 1 else s, {Verb.RUN_SPEED})),
    Fault("status-frozen", EVERY, "F1 always says that the motor stands", "frozen", frozen(Verb.READ_STATUS, "status", 1)),
    Fault("status-stale", EVERY, "F1 says what it said the time before", "frozen",
          lambda hooks: hooks.result.append(_stale(Verb.READ_STATUS))),
    Fault("status-up-and-down-swapped", EVERY, "F1 mixes up speeding up and slowing down", "status",
          changed(Verb.READ_STATUS, "status", lambda s: {2: 3, 3: 2}.get(s, s))),
    Fault("calibrating-as-homing", EVERY, "F1 says 5 while calibrating, as the manual's list has it", "status",
          changed(Verb.READ_STATUS, "status", lambda s: 5 if s == 6 else s)),
    Fault("homing-as-running", EVERY, "F1 says full speed while homing", "status",
          changed(Verb.READ_STATUS, "status", lambda s: 4 if s == 5 else s)),
    Fault("status-outside-list", EVERY, "F1 says 7 for a motor that stands", "status",
          changed(Verb.READ_STATUS, "status", lambda s: 7 if s == 1 else s)),
    Fault("speed-frozen", EVERY, "32 always says 0", "frozen", frozen(Verb.READ_SPEED, "speed", 0)),
    Fault("position-frozen", EVERY, "31 always says 0", "frozen", frozen(Verb.READ_POSITION, "position", 0)),
    Fault("pulses-frozen", EVERY, "33 always says 0", "frozen", frozen(Verb.READ_PULSES, "pulses", 0)),
    Fault("enabled-frozen", EVERY, "3A always says enabled", "frozen", frozen(Verb.READ_ENABLED, "enabled", 1)),
    Fault("enabled-inverted", EVERY, "3A says enabled for disabled", "status",
          changed(Verb.READ_ENABLED, "enabled", lambda v: 1 - v)),
    Fault("protection-hidden", EVERY, "3E never says protected", "frozen", frozen(Verb.READ_PROTECTION, "status", 0)),
    Fault("protection-inverted", EVERY, "3E says protected for not protected", "status",
          changed(Verb.READ_PROTECTION, "status", lambda v: 1 - v)),
    Fault("reserved-bits-set", EVERY, "34 sets its reserved bits", "reserved",
          bodies(lambda b: byte(len(b) - 1, lambda v: v | 0xF0)(b), {Verb.READ_IO})),
    Fault("unanswered-reads", EVERY, "reads of measured numbers are not answered while the motor turns", "lost",
          answered(_READS_OF_NUMBERS, lambda d, c, a, v: None if d.motor.speed(d.now_ns) else v)),
)  # fmt: skip


def _stale(verb: Verb) -> Callable[[Drive, Command, Values, Values | None], Values | None]:
    before: list[Values] = []

    def result(drive: Drive, command: Command, asked: Values, values: Values | None) -> Values | None:
        if command.verb is not verb or values is None:
            return values
        before.append(values)
        return before.pop(0) if len(before) > 1 else values

    return result
