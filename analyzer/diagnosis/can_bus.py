"""A CAN bus on which frames fail, or whose frames are of other identifiers than the drives'."""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.catalogue import Dialect
from analyzer.diagnosis.scene import Confidence, Piece, Scene, Shown, Suspicion, shown
from analyzer.records import CanFrame
from analyzer.values import counted, identifier

#: Classes of error frames as SocketCAN has them, and what of their data says where and how a frame failed.
_PROTOCOL, _NO_ACK, _BUS_OFF = 0x08, 0x20, 0x40
_BIT_ERRORS = 0x01 | 0x02 | 0x04 | 0x08 | 0x10
_TYPE, _PLACE = 2, 3
_ACK_SLOT = 0x19
#: Identifiers of RMD motors: requests, and replies.
_RMD = (range(0x141, 0x161), range(0x241, 0x261))
_LEAST = 2


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the bus, and who is on it."""
    frames = [(p, p.can) for p in scene.pieces if p.can is not None]
    if not frames:
        return
    errors = [(p, can) for p, can in frames if can.error]
    # What the adapter received shows that speed and wires are right; what it sent itself shows nothing.
    heard = [p for p in scene.pieces if p.can is not None and not p.can.error and p.is_reply]
    if len(errors) >= _LEAST:
        yield from _errors(scene, errors, heard)
    dialects = [d for d in scene.reader.dialects if d.bus == "can"]
    known = [p for p, can in frames if not can.error and p.message is not None and p.message.command is not None]
    if not known:
        yield from _others([(p, can) for p, can in frames if not can.error], dialects)


def _errors(scene: Scene, errors: list[tuple[Piece, CanFrame]], heard: list[Piece]) -> Iterator[Suspicion]:
    silent = [p for p, can in errors if can.id & _NO_ACK or (can.id & _PROTOCOL and can.data[_PLACE : _PLACE + 1] == b"\x19")]
    garbled = [p for p, can in errors if can.id & _PROTOCOL and p not in silent and any(can.data[_TYPE : _TYPE + 1])]
    off = [p for p, can in errors if can.id & _BUS_OFF]
    rows = (
        (
            "can_no_ack", [] if heard or garbled else silent,
            "Nobody acknowledges: the adapter is alone on the bus, as far as it can tell.",
            "Look at the drive's power, CAN_H and CAN_L (not swapped), 120 Ohm at both ends, and the drive's bit rate",
        ),
        (
            "can_wrong_bitrate", [] if heard else garbled,
            "No frame gets through, and stuff, form or bit errors come: the nodes run at different bit rates.",
            "Set the adapter to the drive's bit rate (500 kbit/s is the default), with the same sample point",
        ),
        (
            "can_bit_errors", garbled if heard else [],
            "Frames get through, and others are destroyed on the line.",
            "Look at the termination (60 Ohm between CAN_H and CAN_L), the length of stubs, the common ground and the shield",
        ),
        (
            "can_bus_off", off,
            "The adapter has switched itself off the bus after too many errors.",
            "Mend what makes the errors, then restart the interface: `ip link set can0 down`, and up with restart-ms 100",
        ),
    )  # fmt: skip
    troubles = {t.piece: t for t in scene.of("can_error_frame") if t.piece is not None}
    others = {t.piece: t for t in scene.of("unanswered") if t.piece is not None}
    for cause, found, say, todo in rows:
        if not found or (cause == "can_bit_errors" and len(found) < _LEAST):
            continue
        own = [troubles[p] for p in found if p in troubles]
        if cause in ("can_no_ack", "can_wrong_bitrate"):
            own += others.values()
        first = found[0]
        yield Suspicion(
            cause, Confidence.CERTAIN if len(found) > 1 or cause == "can_bus_off" else Confidence.LIKELY, own, say,
            f"error frame of class 0x{first.can.id if first.can else 0:X}, data {shown(first.data)}; "
            f"{counted(len(found), 'time')}; replies: {len(heard)}",
            todo,
        )  # fmt: skip


def _others(frames: list[tuple[Piece, CanFrame]], dialects: list[Dialect]) -> Iterator[Suspicion]:
    extended = [
        (p, can)
        for p, can in frames
        if can.extended and any(d.link.checked and len(p.data) > 1 and d.link.fits(p.data, can.id & 0x7FF) for d in dialects)
    ]
    if len(extended) > 1 and len(extended) * 2 > len(frames):
        piece, can = extended[0]
        right = shown(piece.data, can.id & 0x7FF)
        yield Suspicion(
            "can_extended_id", Confidence.CERTAIN, (), "The frames have identifiers of 29 bits; the drives take 11 bits.",
            f"{identifier(can.id, extended=True)} {shown(piece.data)}; {counted(len(extended), 'frame')}",
            f"Send standard frames: {right}",
            (Shown(piece.offset, shown(piece.data), right),),
        )  # fmt: skip
    motors = [(p, can) for p, can in frames if any(can.id in ids for ids in _RMD) and len(can.data) == 8 and not can.extended]
    if len(motors) > 1 and len(motors) * 2 > len(frames):
        piece, can = motors[0]
        yield Suspicion(
            "unsupported_dialect", Confidence.LIKELY, (),
            "These are frames of RMD motors on CAN, a dialect that is not known here.",
            f"identifier {identifier(can.id)} with 8 bytes: {shown(piece.data)}; {counted(len(motors), 'frame')}",
            "Use the manual of the motor's maker; MKS drives answer at identifiers 1 to 7FF with a sum as their last byte",
            tuple(Shown(p.offset, shown(p.data, c.id)) for p, c in motors[:4]),
        )  # fmt: skip
