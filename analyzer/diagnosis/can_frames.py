"""Frames of a CAN bus that are of other identifiers, makes or lengths than the drives'."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from analyzer.catalogue import Dialect, Role
from analyzer.diagnosis.other_makers import CODES_RMD
from analyzer.diagnosis.reader import Reader
from analyzer.diagnosis.scene import Confidence, Piece, Scene, Shown, Suspicion, Trouble, shown, whole
from analyzer.records import CanFrame
from analyzer.values import counted, identifier

#: Identifiers of RMD motors: requests, and replies.
_RMD = (range(0x141, 0x161), range(0x241, 0x261))
#: What CANopen adds to the number of a node.
_CANOPEN = (0x180, 0x200, 0x280, 0x300, 0x380, 0x400, 0x480, 0x500, 0x580, 0x600, 0x700)
_NODES = range(1, 0x80)
#: The last byte of what switches a motor of the MIT protocol: on, off, zero.
_MIT = (0xFC, 0xFD, 0xFE)
_LEAST = 2
_LONGEST, _FD_SIZES = 8, (12, 16, 20, 24, 32, 48, 64)
#: The last identifier of 11 bits.
_STANDARD = 0x7FF
#: The head of a request on RS485.
_HEAD = b"\xfa"
#: Bytes behind a request among which two may be no zeros.
_TAIL = 4


def serial_requests(scene: Scene, frames: list[tuple[Piece, CanFrame]]) -> Iterator[Suspicion]:
    """Suspect requests of the RS485 manual in CAN frames."""
    serial = Reader.of_bus("serial")
    readings = [(p, serial.best(can.data, role=Role.REQUEST)) for p, can in frames if can.data.startswith(_HEAD)]
    found = [piece for piece, reading in readings if reading is not None and reading.listed]
    if len(found) < _LEAST or 2 * len(found) <= len(frames):
        return
    own = {trouble.offset: trouble for trouble in scene.troubles}
    yield Suspicion(
        "wrong_dialect", Confidence.CERTAIN, [own.get(p.offset) or Trouble("damaged", p.offset, None, p) for p in found],
        "These are frames of the RS485 manual in CAN frames: head, address, and the sum over both.",
        f"{whole(found[0])} at byte {found[0].offset}; {counted(len(found), 'time')}",
        "Begin with the code: the identifier stands for head and address, and counts in the sum instead of them",
        tuple(Shown(piece.offset, whole(piece)) for piece in found),
    )  # fmt: skip


def strangers(scene: Scene, frames: list[tuple[Piece, CanFrame]], dialects: list[Dialect]) -> Iterator[Suspicion]:
    """Suspect who the frames are for, where no drive says anything."""
    checked = [d for d in dialects if d.link.checked]
    extended = [
        (p, can)
        for p, can in frames
        if can.extended and any(len(p.data) > 1 and d.link.fits(p.data, can.id & 0x7FF) for d in checked)
    ]
    # One alone must be a known request of that drive.
    known = len(extended) == len(frames) == 1 and any(
        (r := scene.reader.best(p.data, can.id & 0x7FF, Role.REQUEST)) is not None and r.listed for p, can in extended
    )
    if known or (len(extended) > 1 and len(extended) * 2 > len(frames)):
        yield _extended(extended, _wrong(scene, extended))
        return
    standard = [(p, can) for p, can in frames if not can.extended and not can.remote]
    yield from _too_long(frames)
    yield from _without_flag(scene, frames, standard)
    yield from _too_large(frames)
    # Two sums of the drives are no chance among frames of other makers.
    if wrong := list(_wrong_identifier(scene, standard, checked)):
        yield from wrong
        return
    switches = [(p, can) for p, can in standard if can.data[:-1] == b"\xff" * 7 and can.data[-1] in _MIT]
    if switches:
        piece, can = switches[0]
        yield Suspicion(
            "unsupported_dialect", Confidence.LIKELY, _wrong(scene, switches),
            "These are frames of a motor with the MIT protocol (T-Motor, Damiao, CyberGear), a dialect that is not known here.",
            f"{shown(piece.data, can.id)}: seven bytes FF, then what enables (FC), disables (FD) or sets the zero (FE)",
            "Use the manual of the motor's maker; MKS drives take a code first, and the sum as their last byte",
            tuple(Shown(p.offset, shown(p.data, c.id)) for p, c in switches[:4]),
        )  # fmt: skip
        return
    motors = [
        (p, can)
        for p, can in frames
        if not can.remote
        and any(can.id in ids for ids in _RMD)
        and can.data
        and not any(d.link.fits(p.data, can.id) for d in checked)
    ]
    # One alone must be a known request, of full length.
    alone = len(motors) == 1 and len(motors[0][1].data) == _LONGEST and motors[0][1].data[0] in CODES_RMD
    if (len(motors) > 1 or alone) and len(motors) * 2 > len(frames):
        piece, can = motors[0]
        short = "" if len(can.data) == _LONGEST else ", and shorter than theirs, which have eight bytes each"
        yield Suspicion(
            "unsupported_dialect", Confidence.LIKELY, _wrong(scene, motors),
            f"These are frames of RMD and LK motors on CAN, a dialect that is not known here{short}.",
            f"identifier {identifier(can.id)} with {counted(len(can.data), 'byte')}: {shown(piece.data)}; "
            f"{counted(len(motors), 'frame')}",
            "Use the manual of the motor's maker; MKS drives answer at identifiers 1 to 7FF with a sum as their last byte",
            tuple(Shown(p.offset, shown(p.data, c.id)) for p, c in motors[:4]),
        )  # fmt: skip
        return
    # Who is asked for a service object also sends its values by itself.
    asked = {can.id - base for _, can in standard if _is_canopen(can) for base in _OBJECTS if can.id - base in _NODES}
    objects = {can.id for _, can in standard if _is_canopen(can)}
    if any(objects.issuperset(node + base for base in _OBJECTS) for node in asked):
        # A master that asks one node and is answered has others, too.
        asked = set(_NODES)
    open_frames = [
        (p, can)
        for p, can in standard
        if (_is_canopen(can) or any(can.id - base in asked for base in _CANOPEN))
        and not any(d.link.fits(p.data, can.id) for d in checked)
    ]
    told = [(p, can) for p, can in open_frames if can.id - _OBJECTS[0] in _NODES or can.id - _OBJECTS[1] in _NODES]
    if (len(open_frames) > 1 or told) and len(open_frames) * 2 >= len(frames):
        piece, can = (told or open_frames)[0]
        yield Suspicion(
            "unsupported_dialect", Confidence.LIKELY, _wrong(scene, open_frames),
            "These are frames of CANopen, a protocol that these drives do not speak.",
            f"{shown(piece.data, can.id)} at byte {piece.offset}; {counted(len(open_frames), 'frame')} like it",
            "Use a CANopen master with the EDS file of the drive's maker; MKS drives take a code first, at their own address, "
            "and the sum as their last byte",
            tuple(Shown(p.offset, shown(p.data, c.id)) for p, c in open_frames[:4]),
        )  # fmt: skip
        return
    yield from _padded(scene, standard, checked)
    yield from _with_identifier(scene, standard)
    yield from _other_length(scene, standard, checked)


def _wrong(scene: Scene, found: list[tuple[Piece, CanFrame]]) -> Sequence[Trouble]:
    """Return the troubles of a bus; where there are none, each frame that no drive takes is one."""
    return scene.troubles or [Trouble("foreign_can_frame", piece.offset, None, piece) for piece, _ in found]


def _extended(found: list[tuple[Piece, CanFrame]], troubles: Sequence[Trouble]) -> Suspicion:
    piece, can = found[0]
    right = shown(piece.data, can.id & _STANDARD)
    return Suspicion(
        "can_extended_id", Confidence.CERTAIN, troubles,
        "The frames have identifiers of 29 bits; the drives take 11 bits.",
        f"{identifier(can.id, extended=True)} {shown(piece.data)}; {counted(len(found), 'frame')}",
        f"Send standard frames: {right}",
        (Shown(piece.offset, shown(piece.data), right),),
    )  # fmt: skip


def extended_requests(scene: Scene, frames: list[tuple[Piece, CanFrame]], dialects: list[Dialect]) -> Iterator[Suspicion]:
    """Suspect requests with identifiers of 29 bits beside frames of a drive: they are of its numbers, codes and sums."""
    low = [(p, can) for p, can in frames if can.extended and can.id <= _STANDARD and not can.remote]
    asked = [
        (p, can)
        for p, can in low
        if any(d.link.fits(p.data, can.id) for d in dialects if d.link.checked)
        and (reading := scene.reader.best(p.data, can.id, Role.REQUEST)) is not None and reading.listed
    ]  # fmt: skip
    # Another protocol has other frames, too; and one sum fits by chance.
    if len(asked) == len(low) and len({(can.id, p.data) for p, can in asked}) >= _LEAST:
        own = {p for p, _ in asked}
        yield _extended(asked, [t for t in scene.troubles if t.piece in own])


def unanswered_objects(frames: list[tuple[Piece, CanFrame]], dialects: list[Dialect]) -> Iterator[Suspicion]:
    """Suspect requests of CANopen beside frames of a drive, where no node answers any of them."""
    request, others = max(_OBJECTS), (min(_OBJECTS), _STATE_OF)
    found = [
        (p, can)
        for p, can in frames
        if can.id - request in _NODES and _is_canopen(can)
        and not any(d.link.fits(p.data, can.id) for d in dialects if d.link.checked)
    ]  # fmt: skip
    if len(found) < _LEAST or any(can.id - base in _NODES for _, can in frames for base in others):
        return
    piece, can = found[0]
    yield Suspicion(
        "unsupported_dialect", Confidence.LIKELY, [],
        "The host asks for objects of CANopen, and no node answers: the drives on this bus do not speak it.",
        f"{shown(piece.data, can.id)} at byte {piece.offset}; {counted(len(found), 'frame')} like it",
        f"Ask the drive at its address, with a code and the sum: `servotap catalogue --dialect {dialects[0].name}` lists them",
        tuple(Shown(p.offset, shown(p.data, c.id)) for p, c in found[:4]),
    )  # fmt: skip


def _too_long(frames: list[tuple[Piece, CanFrame]]) -> Iterator[Suspicion]:
    """Suspect frames of more bytes than a frame can have."""
    found = [(p, can) for p, can in frames if len(can.data) > _LONGEST and len(can.data) not in _FD_SIZES]
    if found:
        piece, can = found[0]
        yield Suspicion(
            "wrong_length", Confidence.CERTAIN, [Trouble("wrong_length", p.offset, None, p) for p, _ in found],
            f"A frame is to be sent with {counted(len(can.data), 'byte')}: classic CAN has {_LONGEST} at most.",
            f"{shown(piece.data, can.id)} at byte {piece.offset}; {counted(len(found), 'time')}",
            "Send eight bytes or fewer: look up the length of the command, and drop what is too much",
            tuple(Shown(p.offset, shown(p.data, c.id)) for p, c in found),
        )  # fmt: skip


def _without_flag(
    scene: Scene, frames: list[tuple[Piece, CanFrame]], standard: list[tuple[Piece, CanFrame]]
) -> Iterator[Suspicion]:
    """Suspect identifiers of 29 bits of which the low 11 alone reach the bus: with the same data, or of a call in the text."""
    seen = {(can.id, can.data) for _, can in standard if can.direction is not Role.REQUEST and can.data}
    found = [(p, can) for p, can in frames if can.id > _STANDARD and can.direction is Role.REQUEST
             and (can.id & _STANDARD, can.data) in seen]  # fmt: skip
    if found:
        piece, can = found[0]
        yield Suspicion(
            "can_extended_id", Confidence.CERTAIN, [Trouble("foreign_can_frame", p.offset, None, p) for p, _ in found],
            f"The identifier {identifier(can.id, extended=True)} has 29 bits, and its low 11 bits alone go out: "
            f"{identifier(can.id & _STANDARD)}.",
            f"{shown(piece.data, can.id)} was sent, and {shown(piece.data, can.id & _STANDARD)} is on the bus",
            "Set the flag for extended frames (ext: true, is_extended_id=True, CAN_EFF_FLAG), or take an identifier up to 7FF",
            (Shown(piece.offset, shown(piece.data, can.id)),),
        )  # fmt: skip
        return
    given = {int(call[1], 16) for words in scene.words for call in _SENDS.finditer(words)}
    cut = [(p, can, n) for p, can in standard for n in given if n > _STANDARD and n & _STANDARD == can.id]
    if cut:
        piece, can, number = cut[0]
        yield Suspicion(
            "can_extended_id", Confidence.LIKELY, [Trouble("foreign_can_frame", p.offset, None, p) for p, _, _ in cut],
            f"The program sends to 0x{number:X}, and its low 11 bits alone are on the bus: {identifier(can.id)}.",
            f"0x{number:X} in the text; {shown(piece.data, can.id)} at byte {piece.offset}",
            "Give an identifier of 29 bits at most, and set the flag for extended frames as the library has it: an argument, "
            "or bit 31 of the number",
            (Shown(piece.offset, shown(piece.data, can.id)),),
        )  # fmt: skip


#: A call that sends to an identifier of more than 11 bits.
_SENDS = re.compile(r"\b(?:\w*[sS]end|\w*[wW]rite|beginPacket)\w*\(\s*0[xX]([0-9A-Fa-f]{4,9})\b")


def _too_large(frames: list[tuple[Piece, CanFrame]]) -> Iterator[Suspicion]:
    """Suspect identifiers that a program sends as standard ones, and which have more than 11 bits."""
    found = [(p, can) for p, can in frames if can.id > _STANDARD and not can.extended and not can.error]
    if found:
        piece, can = found[0]
        yield Suspicion(
            "can_extended_id", Confidence.CERTAIN, [Trouble("foreign_can_frame", p.offset, None, p) for p, _ in found],
            f"The identifier {identifier(can.id, extended=True)} is sent as a standard one, which has 11 bits at most.",
            f"{shown(piece.data, can.id)} at byte {piece.offset}; {counted(len(found), 'frame')}",
            "Take an identifier up to 7FF (the drive's own address), or set the flag for extended frames (is_extended_id=True)",
            tuple(Shown(p.offset, shown(p.data, c.id)) for p, c in found),
        )  # fmt: skip


def _is_canopen(can: CanFrame) -> bool:
    """Say whether a frame is one of CANopen: a service data object, the state of a node, or a word to all."""
    data, size = can.data, len(can.data)
    if can.id - _OBJECTS[0] in _NODES or can.id - _OBJECTS[1] in _NODES:
        return size == _LONGEST and data[0] in _ACCESS
    if can.id - _STATE_OF in _NODES:
        return size == 1 and data[0] in _STATES
    if can.id == 0:
        return size == 2 and data[0] in _COMMANDS and data[1] in (0, *_NODES)
    return can.id == _SYNC and size <= 1


#: Identifiers and contents of CANopen: service data objects (request, reply), heartbeats, commands to all, the sync.
_OBJECTS, _STATE_OF, _SYNC = (0x600, 0x580), 0x700, 0x80
_ACCESS = frozenset(bytes.fromhex("40 22 23 27 2B 2F 42 43 47 4B 4F 60 80"))
_STATES, _COMMANDS = (0x00, 0x04, 0x05, 0x7F), (0x01, 0x02, 0x80, 0x81, 0x82)


def _wrong_identifier(scene: Scene, frames: list[tuple[Piece, CanFrame]], dialects: list[Dialect]) -> Iterator[Suspicion]:
    """Suspect requests that go to a number which CANopen makes of an address, or whose sums are those of another."""
    own = [(p, can) for p, can in frames if can.direction is not Role.REPLY and len(p.data) > 1]
    again = sent_again(scene)
    fitting = [(p, can) for p, can in own if (p.is_request or p in again) and p.sound]
    for group, meant in ((fitting, _node), (own, _summed)):
        for dialect in dialects:
            found = [(p, can, node) for p, can in group if (node := meant(scene, p, can, dialect)) is not None]
            # One sum fits some number always: two different frames must agree.
            agree = len({(can.id, node) for _, can, node in found}) == 1 and len({p.data for p, _, _ in found}) >= _LEAST
            if not agree or len(found) < len(own):
                continue
            piece, can, node = found[0]
            why = (
                f"it is {node} + {can.id - node:X} (hex), a number of CANopen; these drives listen to their address alone."
                if group is fitting
                else f"the sums of the frames are those of identifier {identifier(node)}."
            )
            right = [shown(dialect.link.completed(p.data[:-1], node), node) for p, _, _ in found]
            yield Suspicion(
                "can_wrong_id", Confidence.LIKELY, scene.of("damaged", "unanswered", "silent_address", "late_reply"),
                f"No drive answers at identifier {identifier(can.id)}: {why}",
                f"{shown(piece.data, can.id)} at byte {piece.offset}; {counted(len(found), 'frame')}, no reply",
                f"Send to the drive's address (1 by default): {right[0]}",
                tuple(Shown(p.offset, shown(p.data, c.id), r) for (p, c, _), r in zip(found, right, strict=True)),
            )  # fmt: skip
            return


def _node(scene: Scene, piece: Piece, can: CanFrame, dialect: Dialect) -> int | None:
    """Return the node that CANopen makes an identifier of."""
    return next((can.id - base for base in _CANOPEN if can.id - base in _NODES), None)


def _summed(scene: Scene, piece: Piece, can: CanFrame, dialect: Dialect) -> int | None:
    """Return the identifier that the last byte is the sum with, where it is another and the rest is a request."""
    body = piece.data[:-1]
    node = (piece.data[-1] - dialect.link.completed(body, 0)[-1]) & 0xFF
    if not node or node == can.id & 0xFF:
        return None
    reading = scene.reader.best(piece.data, node, Role.REQUEST)
    return node if reading is not None and reading.listed else None


def _padded(scene: Scene, frames: list[tuple[Piece, CanFrame]], dialects: list[Dialect]) -> Iterator[Suspicion]:
    """Suspect requests that are filled up to eight bytes: a drive of such a dialect takes its own lengths alone."""
    found = [
        (p, can, right, name)
        for p, can in frames
        if len(p.data) == _LONGEST and can.direction is not Role.REPLY and not p.is_reply
        for right, name in _shorter(scene, p.data, can.id, dialects)
    ]
    if not found or len(found) * 2 < len(frames):
        return
    piece, can, right, name = found[0]
    sent = can.direction is Role.REQUEST or len(found) >= _LEAST
    yield Suspicion(
        "wrong_length", Confidence.LIKELY if sent else Confidence.POSSIBLE, scene.of("damaged", "unanswered", "silent_address"),
        f"{name} is filled up to eight bytes; on CAN it has {len(right)}, the last one its sum.",
        f"{shown(piece.data, can.id)} at byte {piece.offset}; {counted(len(found), 'frame')}",
        f"Send {shown(right, can.id)}",
        tuple(Shown(p.offset, shown(p.data, c.id), shown(r, c.id)) for p, c, r, _ in found),
    )  # fmt: skip


def _with_identifier(scene: Scene, frames: list[tuple[Piece, CanFrame]]) -> Iterator[Suspicion]:
    """Suspect requests that have the identifier once more as their first byte, as the manual writes its examples."""
    found = [
        (p, can) for p, can in frames
        if len(p.data) > _LEAST and p.data[0] == can.id & 0xFF and not p.is_reply
        and (reading := scene.reader.best(p.data[1:], can.id, Role.REQUEST)) is not None and reading.listed
    ]  # fmt: skip
    if len(found) < _LEAST or len(found) * 2 < len(frames):
        return
    piece, can = found[0]
    yield Suspicion(
        "wrong_length", Confidence.CERTAIN, scene.of("damaged", "unanswered", "silent_address"),
        "The data begin with the identifier, which a frame on CAN carries already: they are a byte too long.",
        f"{shown(piece.data, can.id)} at byte {piece.offset}; {counted(len(found), 'frame')}",
        f"Send the code first: {shown(piece.data[1:], can.id)}",
        tuple(Shown(p.offset, shown(p.data, c.id), shown(p.data[1:], c.id)) for p, c in found),
    )  # fmt: skip


def _other_length(scene: Scene, frames: list[tuple[Piece, CanFrame]], dialects: list[Dialect]) -> Iterator[Suspicion]:
    """Suspect what a host sends with a known code, and with a length and a sum that are none of its command."""
    for dialect in dialects:
        link = dialect.link
        found: list[tuple[Piece, CanFrame, str, bytes]] = []
        for piece, can in frames:
            if can.direction is not Role.REQUEST or len(piece.data) < _LEAST or link.fits(piece.data, can.id):
                continue
            commands = dialect.by_code.get(piece.data[0], ())
            rights = [
                link.build(c, form, can.id, bytes(form.layout.byte_length), Role.REQUEST)
                for c in commands
                for form in c.request_forms
            ]
            # One byte less is a sum that was forgotten.
            if rights and all(len(piece.data) not in (len(right), len(right) - 1, _LONGEST) for right in rights):
                found.append((piece, can, " or ".join(c.name for c in commands), rights[0]))
        if not found or len(found) * 2 < len(frames):
            continue
        piece, can, names, right = found[0]
        yield Suspicion(
            # The code alone tells whose command it is.
            "wrong_length", Confidence.POSSIBLE, [Trouble("wrong_length", p.offset, None, p) for p, _, _, _ in found],
            f"{names} is sent with {counted(len(piece.data), 'byte')}; on CAN it has {len(right)}, the last one its sum.",
            f"{shown(piece.data, can.id)} at byte {piece.offset}; {counted(len(found), 'frame')}",
            f"Send as many bytes as the command has, with the values that you mean, as {shown(right, can.id)}",
            tuple(Shown(p.offset, shown(p.data, c.id)) for p, c, _, _ in found),
        )  # fmt: skip
        return


def _shorter(scene: Scene, data: bytes, can_id: int, dialects: list[Dialect]) -> Iterator[tuple[bytes, str]]:
    """Yield the request that eight bytes begin with, where zeros stand behind it, but for what is meant as a check."""
    for dialect in dialects:
        if dialect.link.fits(data, can_id):
            continue
        for size in range(len(data) - 1, 1, -1):
            right = dialect.link.completed(data[: size - 1], can_id)
            reading = scene.reader.best(right, can_id, Role.REQUEST)
            zeros = data[size:-1] if size > len(data) - _TAIL else data[size - 1 : -2]
            if reading is not None and reading.listed and not any(zeros):
                yield right, reading.name
                return


def sent_again(scene: Scene) -> list[Piece]:
    """Return requests that were taken for the late reply to the same request before: they are its very bytes."""
    late = {p.asked_by: p for p in scene.pieces if "late_reply" in p.rules and p.is_reply and p.can is not None}
    return [late[p.sequence] for p in scene.pieces if p.sequence in late and p.data == late[p.sequence].data]
