"""Faults of an LK drive in its frames: sums, heads, lengths, which requests it answers, and when."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import msgspec

from analyzer.catalogue import Command
from analyzer.link import sum8
from analyzer.records import Frame, Message
from conformance.drives.drive import Drive, Fault, Hooks, Outgoing, Values
from conformance.drives.lk.commands import MOVES
from conformance.drives.lk.places import ECHOED, PARAMETER_COMMANDS, Install, lk, on_reply, on_result, reframed

_HEAD = 5
_LATE_NS = 20_000_000
_LOST = 4


def _fault(name: str, text: str, breaks: str, install: Install) -> Fault:
    return Fault(name, ("lk-rs485",), text, breaks, install)


def _with_data(change: Callable[[bytes], bytes]) -> Install:
    return on_reply(lambda drive, command, frame: change(frame) if len(frame) > _HEAD else frame)


def _without_data(change: Callable[[bytes], bytes]) -> Install:
    return on_reply(lambda drive, command, frame: frame if len(frame) > _HEAD else change(frame))


def _byte(frame: bytes, at: int, value: int) -> bytes:
    changed = bytearray(frame)
    changed[at] = value & 0xFF
    return bytes(changed)


def _head_sum_of(frame: bytes, at: int, value: int) -> bytes:
    """Return a frame with another byte in its head, and the head's sum made to fit."""
    changed = _byte(frame, at, value)
    return _byte(changed, _HEAD - 1, sum8(changed[: _HEAD - 1]))


def _shift(drive: Drive, command: Command, frame: bytes) -> bytes:
    data = frame[_HEAD:-1]
    return reframed(frame, data=data[:1] + data[2:] + b"\0")


def _timed(change: Callable[[Outgoing], Iterable[Outgoing]]) -> Install:
    return lambda hooks: hooks.reply.append(lambda drive, command, outgoing: change(outgoing))


def _lose(hooks: Hooks) -> None:
    count = 0

    def reply(drive: Drive, command: Command, outgoing: Outgoing) -> tuple[Outgoing, ...]:
        nonlocal count
        count += 1
        return () if count % _LOST == 0 else (outgoing,)

    hooks.reply.append(reply)


def _cut(outgoing: Outgoing) -> tuple[Outgoing, ...]:
    return (msgspec.structs.replace(outgoing, data=outgoing.data[:-2]),)


def _accepting(also: Callable[[Drive, Frame, Message], bool]) -> Install:
    return lambda hooks: hooks.accept.append(
        lambda drive, frame, message, wanted: wanted or (message.form is not None and also(drive, frame, message))
    )


def _accept_unknown(hooks: Hooks) -> None:
    def accept(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        return wanted or (frame.checksum_ok and message.address == drive.address and message.command is None)

    hooks.accept.append(accept)


def _accept_wrong_length(hooks: Hooks) -> None:
    def accept(drive: Drive, frame: Frame, message: Message, wanted: bool) -> bool:
        known = message.command is not None and message.form is None
        return wanted or (frame.checksum_ok and message.address == drive.address and known)

    hooks.accept.append(accept)


def _broken_sum(which: int) -> Callable[[Drive, Frame, Message], bool]:
    """Say of frames to this drive whose one sum is wrong, the head's (0) or the data's (1), that they are taken."""

    def also(drive: Drive, frame: Frame, message: Message) -> bool:
        wrong = [i for i, check in enumerate(frame.dialect.link.checks(frame.data)) if not check.ok]
        return message.address == drive.address and wrong == [which]

    return also


def _silent_while_off(drive: Drive, command: Command, asked: Values, values: Values) -> Values | None:
    return values if lk(drive).motor.on else None


FAULTS: tuple[Fault, ...] = (
    # --- sums -----------------------------------------------------------------------------------------------------
    _fault(
        "lk-data-sum-wrong",
        "the sum of a reply's data is one too high",
        "checksum",
        _with_data(lambda frame: _byte(frame, -1, frame[-1] + 1)),
    ),
    _fault(
        "lk-head-sum-wrong",
        "the sum of a reply's head is one too high",
        "checksum",
        on_reply(lambda drive, command, frame: _byte(frame, _HEAD - 1, frame[_HEAD - 1] + 1)),
    ),
    _fault("lk-data-sum-missing", "replies with data have no sum behind them", "checksum", _with_data(lambda f: f[:-1])),
    _fault(
        "lk-data-sum-of-nothing",
        "replies without data carry a data sum of 00",
        "checksum",
        _without_data(lambda frame: frame + b"\0"),
    ),
    _fault(
        "lk-data-sum-with-head",
        "the sum of the data takes in the head",
        "checksum",
        _with_data(lambda frame: _byte(frame, -1, sum8(frame[:-1]))),
    ),
    _fault(
        "lk-head-sum-without-start",
        "the sum of the head leaves out the 3E",
        "checksum",
        on_reply(lambda drive, command, frame: _byte(frame, _HEAD - 1, sum8(frame[1 : _HEAD - 1]))),
    ),
    # --- head -----------------------------------------------------------------------------------------------------
    _fault(
        "lk-reply-start-wrong",
        "replies begin with 3D",
        "reply head",
        on_reply(lambda drive, command, frame: _head_sum_of(frame, 0, frame[0] - 1)),
    ),
    _fault(
        "lk-reply-code-wrong",
        "motion commands are answered with the code of 0x9C instead of their own",
        "reply code",
        on_reply(lambda drive, command, frame: reframed(frame, code=drive.dialect.by_name["read_state_2"].code), MOVES),
    ),
    _fault(
        "lk-echo-code-wrong",
        "0x80, 0x81, 0x88, 0x93 and 0x95 are answered with the next higher code",
        "reply code",
        on_reply(lambda drive, command, frame: reframed(frame, code=command.code + 1), ECHOED),
    ),
    _fault(
        "lk-reply-address-wrong",
        "replies carry the next higher address",
        "reply address",
        on_reply(lambda drive, command, frame: reframed(frame, address=drive.address + 1)),
    ),
    _fault(
        "lk-reply-length-wrong",
        "the length of a reply counts the data sum too",
        "reply length",
        _with_data(lambda frame: _head_sum_of(frame, 3, frame[3] + 1)),
    ),
    _fault(
        "lk-reply-short",
        "replies to motion commands lack the last byte of their data",
        "reply length",
        on_reply(lambda drive, command, frame: reframed(frame, data=frame[_HEAD:-2]), MOVES),
    ),
    _fault(
        "lk-motion-reply-empty",
        "motion commands are answered with a head alone, without the state",
        "reply layout",
        on_reply(lambda drive, command, frame: reframed(frame, data=b""), MOVES),
    ),
    _fault(
        "lk-set-position-reply-empty",
        "0x95 is answered with a head alone instead of an echo",
        "reply layout",
        on_reply(lambda drive, command, frame: reframed(frame, data=b""), ("set_position",)),
    ),
    _fault(
        "lk-echo-with-status",
        "0x80, 0x81, 0x88 and 0x93 are answered with a data byte 00 instead of an echo",
        "reply layout",
        _without_data(lambda frame: reframed(frame, data=b"\0")),
    ),
    _fault(
        "lk-parameter-bytes-shifted",
        "the values that 0xC0 and 0xC1 answer stand one byte too early",
        "reply layout",
        on_reply(_shift, PARAMETER_COMMANDS),
    ),
    # --- what is answered -----------------------------------------------------------------------------------------
    _fault(
        "lk-answers-other-address",
        "requests to any address are obeyed and answered",
        "addressing",
        _accepting(lambda drive, frame, message: frame.checksum_ok),
    ),
    _fault(
        "lk-answers-address-0",
        "address 0 is taken for a broadcast, obeyed and answered",
        "addressing",
        _accepting(lambda drive, frame, message: frame.checksum_ok and message.address == 0),
    ),
    _fault(
        "lk-answers-wrong-data-sum",
        "requests are obeyed and answered although the sum of their data is wrong",
        "checksum",
        _accepting(_broken_sum(1)),
    ),
    _fault(
        "lk-answers-wrong-head-sum",
        "requests are obeyed and answered although the sum of their head is wrong",
        "checksum",
        _accepting(_broken_sum(0)),
    ),
    _fault("lk-answers-unknown-code", "a code that no command has is echoed", "unknown code", _accept_unknown),
    _fault("lk-answers-wrong-length", "a known code with a wrong length is echoed", "length", _accept_wrong_length),
    _fault(
        "lk-silent-while-off",
        "motion commands are not answered while the motor is off",
        "off",
        on_result(_silent_while_off, MOVES),
    ),
    # --- when and how often ---------------------------------------------------------------------------------------
    _fault(
        "lk-reply-late",
        "replies come 20 ms after the request",
        "timing",
        _timed(lambda o: (msgspec.structs.replace(o, at_ns=o.at_ns + _LATE_NS),)),
    ),
    _fault("lk-reply-lost", "each fourth reply is lost", "reply", _lose),
    _fault("lk-reply-twice", "replies come twice", "reply", _timed(lambda outgoing: (outgoing, outgoing))),
    _fault("lk-reply-cut", "replies break off two bytes before their end", "reply", _timed(_cut)),
    _fault(
        "lk-reply-noise", "a byte 00 comes before each reply", "reply", on_reply(lambda drive, command, frame: b"\0" + frame)
    ),
)
