"""A CAN bus on which frames fail; where no drive answers, can_frames says whose frames they are.

The identifier of an error frame has SocketCAN's classes. Its data say where and how a frame failed, and how high the counters
of errors stood. Files that keep no classes (ASC, BLF, TRC) show only that there were errors.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

from analyzer.catalogue import Role, Verb
from analyzer.diagnosis.can_frames import extended_requests, sent_again, serial_requests, strangers, unanswered_objects
from analyzer.diagnosis.scene import Confidence, Piece, Scene, Suspicion, Trouble, shown, whole
from analyzer.records import CanFrame
from analyzer.values import counted

#: Classes of error frames as SocketCAN has them.
_CONTROLLER, _PROTOCOL, _NO_ACK, _BUS_OFF, _BUS_ERROR = 0x04, 0x08, 0x20, 0x40, 0x80
#: Where their data say what happened.
_STATE, _TYPE, _PLACE, _SENT_COUNTER, _RECEIVED_COUNTER = 1, 2, 3, 6, 7
_ACK_PLACES = (0x19, 0x1B)
#: Kinds of errors in the form or the stuffing of a frame.
_FORM_OR_STUFF = 0x02 | 0x04
_KINDS = {0x01: "single bit", 0x02: "form", 0x04: "stuff", 0x08: "dominant bit", 0x10: "recessive bit"}
#: A sender that no node acknowledges counts by eight until it is passive, and then no further.
_PASSIVE = range(128, 137)
_SENDER_PASSIVE, _RECEIVER_PASSIVE, _OVERFLOW = 0x20, 0x10, 0x02
#: A counter of errors at the warning or above, for a sender or a receiver.
_STRAINED = 0x3C
#: From here on a counter of errors is a warning.
_WARNING = 96
_LEAST, _LONGEST = 2, 8
#: Errors in a row that no bus outlasts whose nodes understand each other.
_MANY = 8


class _Errors(NamedTuple):
    """Error frames by what they say."""

    #: No node acknowledged.
    silent: list[Piece]
    #: A frame was destroyed.
    garbled: list[Piece]
    #: The adapter gave up.
    off: list[Piece]
    #: Nothing but that there was an error.
    bare: list[Piece]
    #: The sender's counter stands where it does without an acknowledge.
    stuck: list[Piece]
    #: The receiver's counter stands high.
    deaf: list[Piece]
    #: What was to be sent waits, and nothing goes out.
    waiting: list[Piece]
    #: A counter of errors falls: that is what frames that get through do.
    recovering: bool


#: The bit of a state that is error-active once more.
_ACTIVE = 0x40


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the bus, and who is on it."""
    frames = [(p, p.can) for p in scene.pieces if p.can is not None]
    if not frames:
        return
    errors = [(p, can) for p, can in frames if can.error]
    data = [(p, can) for p, can in frames if not can.error]
    again = sent_again(scene)
    # What came from others shows that speed and wires are right; what the adapter sent itself shows nothing.
    heard = [
        p for p, can in data
        if p not in again and (p.is_reply or (can.direction is not Role.REQUEST and not p.is_request))
    ]  # fmt: skip
    if errors:
        changed = _changed(scene)
        if changed is not None and all(p.sequence > changed.sequence for p, _ in errors):
            # What came before at the old bit rate shows nothing of the new one.
            heard = [p for p in heard if p.sequence > changed.sequence]
        else:
            changed = None
        yield from _errors(scene, _sorted(errors), heard, changed)
    yield from serial_requests(scene, data)
    # A reply whose sum is wrong may be the frame of another make.
    replies = [p for p, _ in data if p.is_reply and p not in again]
    dialects = [d for d in scene.reader.dialects if d.bus == "can"]
    if any(p.sound and p.message is not None and p.message.command is not None for p in replies):
        yield from extended_requests(scene, data, dialects)
        yield from unanswered_objects(data, dialects)
    else:
        yield from strangers(scene, data, dialects)


def _changed(scene: Scene) -> Piece | None:
    """Return the last reply by which a drive acknowledges another bit rate."""
    for piece in reversed(scene.pieces):
        message = piece.message
        if message is None or message.command is None or not (piece.is_reply and piece.sound):
            continue
        if message.command.verb is Verb.SET_BIT_RATE and message.values.get("status") == 1:
            return piece
    return None


def _sorted(errors: list[tuple[Piece, CanFrame]]) -> _Errors:
    found = _Errors([], [], [], [], [], [], [], _recovers(errors))
    for piece, can in errors:
        at = dict(enumerate(can.data))
        # SocketCAN's have eight bytes always.
        if len(can.data) < _LONGEST:
            found.bare.append(piece)
        elif can.id & _BUS_OFF:
            found.off.append(piece)
        elif can.id & _NO_ACK or (
            can.id & _PROTOCOL and at.get(_PLACE) in _ACK_PLACES and not at.get(_TYPE, 0) & _FORM_OR_STUFF
        ):
            found.silent.append(piece)
        elif can.id & _PROTOCOL and at.get(_TYPE):
            found.garbled.append(piece)
        elif can.id & _CONTROLLER and at.get(_STATE, 0) & _SENDER_PASSIVE and at.get(_SENT_COUNTER) in _PASSIVE:
            found.stuck.append(piece)
        elif can.id & _CONTROLLER and at.get(_STATE, 0) & _RECEIVER_PASSIVE and at.get(_RECEIVED_COUNTER, 0) >= _WARNING:
            found.deaf.append(piece)
        elif can.id & _CONTROLLER and at.get(_STATE, 0) & _OVERFLOW:
            found.waiting.append(piece)
        elif can.id & _BUS_ERROR or (can.id & _CONTROLLER and at.get(_STATE, 0) & _STRAINED):
            found.bare.append(piece)
    return found


def _recovers(errors: list[tuple[Piece, CanFrame]]) -> bool:
    """Say whether the counters of an adapter fall, or its state turns back to active: not where all begins anew.

    Drivers read the counters of a change of state and those of an error at other times, so that each have their own row.
    """
    before: dict[tuple[str, int], tuple[int, int]] = {}
    for _, can in errors:
        row = can.port, can.id & _CONTROLLER
        if can.id & _BUS_OFF or len(can.data) < _LONGEST:
            before = {other: counters for other, counters in before.items() if other[0] != can.port}
            continue
        counters = can.data[_SENT_COUNTER], can.data[_RECEIVED_COUNTER]
        if not any(counters):
            continue
        last = before.get(row, (0, 0))
        if (can.id & _CONTROLLER and can.data[_STATE] & _ACTIVE) or any(a < b for a, b in zip(counters, last, strict=True)):
            return True
        before[row] = counters
    return False


def _errors(scene: Scene, errors: _Errors, heard: list[Piece], changed: Piece | None) -> Iterator[Suspicion]:
    """`changed`: the reply to a change of the bit rate before all errors; `heard` came behind it."""
    all_errors = scene.of("can_error_frame")
    unanswered = scene.of("unanswered", "silent_address")
    kinds = Counter(p.data[_TYPE] for p in errors.garbled)
    on_sending = bool(kinds) and not any(kind & _FORM_OR_STUFF for kind in kinds)
    certain = Confidence.CERTAIN
    # Beside frames that get through one error is nothing.
    garbled = len(errors.garbled) >= (_LEAST if heard else 1)
    sure = certain if len(errors.garbled) >= _LEAST else Confidence.LIKELY
    if errors.off:
        yield _suspicion(
            "can_bus_off", certain, [*all_errors, *unanswered], errors.off, heard,
            "The adapter has switched itself off the bus after too many errors: nothing is sent or received any more.",
            "Mend what makes the errors: first the bit rate (500 kbit/s is the drive's default), then CAN_H and CAN_L, then "
            "120 Ohm at both ends. Then restart the interface: `ip link set can0 down`, and up with restart-ms 100",
        )  # fmt: skip
    if errors.silent and not heard and not garbled and not errors.off:
        yield _suspicion(
            "can_no_ack", certain if len(errors.silent) >= _LEAST else Confidence.LIKELY, [*all_errors, *unanswered],
            errors.silent, heard, "No node acknowledges: the adapter is alone on the bus, as far as it can tell.", _ALONE,
        )  # fmt: skip
    elif errors.silent and heard and len(errors.silent) >= _LEAST:
        own = _of(all_errors, errors.silent)
        yield _suspicion(
            "can_no_ack", Confidence.LIKELY, own, errors.silent, heard,
            "For a time no node acknowledged: all others were off the bus or without power.", _ALONE,
        )  # fmt: skip
    elif errors.stuck and not heard and not garbled and not errors.off:
        yield _suspicion(
            "can_no_ack", Confidence.LIKELY, [*all_errors, *unanswered], errors.stuck, heard,
            "The counter of the sender's errors stands where it does if no node acknowledges: at 128, or little above.", _ALONE,
        )  # fmt: skip
    if garbled and not heard and not on_sending and not errors.recovering:
        yield _suspicion(
            "can_wrong_bitrate", sure if _strained(errors) else Confidence.LIKELY,
            [*_of(all_errors, errors.garbled), *unanswered], errors.garbled, heard,
            "No frame gets through, and stuff, form or bit errors come: the nodes run at different bit rates.",
            "Set the adapter to the drive's bit rate (500 kbit/s is the default), with the same sample point"
            if changed is None
            else f"Set the adapter to the bit rate that the drive acknowledged by {whole(changed)}",
        )  # fmt: skip
    elif garbled:
        say = (
            "Bits that the adapter sends come back changed: another node drives the line, or it is short or open."
            if on_sending
            else "Frames get through, and others are destroyed on the line."
            if heard
            else "Frames are destroyed on the line; a counter of errors falls, as it does where others get through."
        )
        yield _suspicion(
            "can_bit_errors", sure, _of(all_errors, errors.garbled), errors.garbled, heard, say,
            "Look at the termination (60 Ohm between CAN_H and CAN_L without power), the length of stubs, the common ground "
            "and the shield; then compare bit rates and sample points",
        )  # fmt: skip
    # Beside frames of others a sender's counter shows nothing alone.
    alone = bool(errors.stuck) and not heard
    if errors.deaf and not (errors.silent or garbled or errors.off or alone):
        yield _suspicion(
            "can_bit_errors", Confidence.LIKELY, [*all_errors, *unanswered], errors.deaf, heard,
            "The counter of errors in what is received stands high: frames of others arrive destroyed.",
            "Where no frame is received at all, set the bit rate of the others. Else look at the termination (60 Ohm between "
            "CAN_H and CAN_L without power), stubs and the common ground; then compare sample points",
        )  # fmt: skip
    if errors.waiting and not (errors.silent or garbled or errors.off or errors.stuck or errors.deaf):
        yield _suspicion(
            "can_no_ack", Confidence.POSSIBLE if heard else Confidence.LIKELY, [*all_errors, *unanswered],
            errors.waiting, heard,
            "Frames wait in the adapter's queue and none goes out, as where no node acknowledges.",
            f"{_ALONE}; `ip -details -statistics link show can0` shows the state",
        )  # fmt: skip
    # One is enough where nothing else is on the bus.
    alone = len(errors.bare) == len(scene.pieces)
    others = errors.silent or garbled or errors.off or errors.stuck or errors.deaf
    if len(errors.bare) >= (1 if alone else _LEAST) and not others:
        cause, say = (
            ("can_bit_errors", "Frames get through, and others are destroyed on the line.")
            if heard
            else ("can_no_ack", "Only errors come: no node acknowledges, or the nodes run at different bit rates.")
        )
        yield _suspicion(
            cause, Confidence.LIKELY if heard else Confidence.POSSIBLE, all_errors, errors.bare, heard, say,
            f"{_ALONE}; `candump -e any,0:0,#FFFFFFFF` shows what kind of errors they are",
        )  # fmt: skip


def _strained(errors: _Errors) -> bool:
    """Say whether an adapter shows that errors go on: many come, or a counter stands high. It counts each at another speed."""
    counters = (n for p in errors.garbled for n in p.data[_SENT_COUNTER : _RECEIVED_COUNTER + 1])
    many = len(errors.garbled) >= _MANY or errors.deaf or errors.stuck
    return not errors.off and (bool(many) or any(n >= _WARNING for n in counters))


_ALONE = "Look at the drive's power, CAN_H and CAN_L (not swapped), 120 Ohm at both ends, and the drive's bit rate"


def _of(troubles: list[Trouble], pieces: list[Piece]) -> list[Trouble]:
    return [trouble for trouble in troubles if trouble.piece in pieces]


def _suspicion(
    cause: str, confidence: Confidence, troubles: list[Trouble], errors: list[Piece], heard: list[Piece], say: str, todo: str
) -> Suspicion:
    first, last = errors[0], errors[-1]
    kinds = sorted({name for p in errors for bit, name in _KINDS.items() if p.data[_TYPE : _TYPE + 1] and p.data[_TYPE] & bit})
    counters = last.data[_SENT_COUNTER : _RECEIVED_COUNTER + 1]
    told = f" ({', '.join(kinds)} errors)" if kinds else ""
    told += f"; counters of errors at the end: {counters[0]} sent, {counters[1]} received" if any(counters) else ""
    return Suspicion(
        cause, confidence, troubles, say,
        f"error frame of class 0x{first.can.id if first.can else 0:X}, data {shown(first.data) or 'none'}{told}; "
        f"{counted(len(errors), 'time')}; frames of others: {len(heard)}",
        todo,
    )  # fmt: skip
