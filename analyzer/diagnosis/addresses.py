"""Requests to all units, to none, and to one that is given another address."""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.catalogue import Risk, Role
from analyzer.diagnosis.reports import NOTHING_CAME
from analyzer.diagnosis.scene import Confidence, Piece, Scene, Shown, Suspicion, Trouble, shown, whole
from analyzer.encoder import build
from analyzer.layout import Effect
from analyzer.link import FUNCTIONS, LAST_UNIT, modbus_crc
from analyzer.records import Message
from analyzer.values import counted

#: Who answers at these addresses as well as at its own.
_GENERAL = {0xF8: "Some meters (PZEM)", 0xFE: "Some sensors and relays", 0xFF: "Some relays and chargers"}
_MODBUS_SHORTEST = 5
_WRITE_ONE = 8
_WRITES = 0x06


def addressed(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the address to which a host sends."""
    yield from _from_new(scene)
    yield from _to_all(scene)
    yield from _waited_on(scene)
    yield from _to_none(scene)


def _to_all(scene: Scene) -> Iterator[Suspicion]:
    """Suspect reads that are sent to all, or to a group: no drive may answer them."""
    groups = _groups(scene)
    sent = [
        piece
        for piece in scene.pieces
        if (m := piece.message) is not None and piece.is_request and piece.sound and m.command is not None
        and m.command.reply_forms
        and (
            (m.address == m.frame.dialect.broadcast and (_reads(m) or _only_to_all(scene, m)))
            or (_drive(m) in groups and _reads(m))
        )
    ]  # fmt: skip
    # Requests that a unit answered under its own address have another cause already.
    if not sent or {at for piece in sent for at in (piece.offset, piece.stop)} & {t.offset for t in scene.explained}:
        return
    message = sent[0].message
    assert message is not None
    assert message.command is not None  # chosen so above
    dialect = message.frame.dialect
    one = groups.get(_drive(message), dialect.addresses[0])
    whom = "all drives" if message.address == dialect.broadcast else "a group of drives"
    if message.command in dialect.commands:
        right = build(dialect, message.command, one)
    else:
        # A register that the catalogue does not have: the same request, to one unit.
        right = dialect.link.completed(bytes((one,)) + message.frame.data[1 : dialect.link.parse(message.frame.data).stop])
    yield Suspicion(
        "broadcast_no_reply", Confidence.CERTAIN if _reads(message) else Confidence.LIKELY,
        [t for t in scene.troubles if t.piece in sent or t.rule in ("unanswered", "unsolicited_reply")],
        f"{message.command.name} is sent to address {message.who}, which is {whom}: by the manual none answers.",
        f"{whole(sent[0])} at byte {sent[0].offset}; {counted(len(sent), 'time')}",
        f"Ask one drive: {shown(right, dialect.link.identifier(message.command, one))}",
        tuple(Shown(p.offset, whole(p)) for p in sent),
    )  # fmt: skip


def _waited_on(scene: Scene) -> Iterator[Suspicion]:
    """Suspect motion commands to a group whose replies a host waits for: words say so, and it sends them again.

    So it is where words miss a reply as often as none came.
    """
    missed = sum(NOTHING_CAME.search(words) is not None for words in scene.words)
    if not missed:
        return
    silent = sum(piece.sequence not in scene.replies for piece in scene.requests)
    groups = _groups(scene)
    known = {_drive(p.message) for p in scene.pieces if p.is_reply and p.message is not None}
    # An address that is asked for no read may be a group that was set before.
    read = {_drive(p.message) for p in scene.pieces if p.is_request and p.message is not None and _is_read(p.message)}
    sent: dict[tuple[str, int], list[Piece]] = {}
    for piece in scene.requests:
        message = piece.message
        if message is None or message.command is None or not message.command.moves:
            continue
        drive = _drive(message)
        if message.address == message.frame.dialect.broadcast or drive in groups or (known and drive not in known | read):
            sent.setdefault(drive, []).append(piece)
    for drive, pieces in sent.items():
        message = pieces[0].message
        again = not scene.noted and len(pieces) > len({piece.data for piece in pieces})
        if message is None or not (again or missed >= silent >= _TWICE):
            continue
        sure = drive in groups or message.address == message.frame.dialect.broadcast
        yield Suspicion(
            "broadcast_no_reply", Confidence.LIKELY if sure else Confidence.POSSIBLE,
            [t for t in scene.troubles if t.piece in set(pieces)],
            f"The host waits for a reply of address {message.who}, which {'is' if sure else 'may be'} that of several drives: "
            "by the manual none answers there.",
            f"{whole(pieces[0])} at byte {pieces[0].offset}, {counted(len(pieces), 'time')}; the text tells of waiting",
            "Wait for no reply there; to see what the drives do, ask each at its own address"
            + ("" if sure else ". If no group has this address, it is wrong, or respond is off there"),
            tuple(Shown(p.offset, whole(p)) for p in pieces),
        )  # fmt: skip


#: One word of waiting may speak of anything.
_TWICE = 2


def _groups(scene: Scene) -> dict[tuple[str, int], int]:
    """Return the addresses of groups that the capture sets, each with the address of a drive in it."""
    found: dict[tuple[str, int], int] = {}
    for piece in scene.requests:
        message = piece.message
        field = message.command.sets(Effect.GROUP) if message is not None and message.command is not None else None
        if message is not None and field is not None and (value := message.values.get(field)) is not None:
            found[message.frame.dialect.name, value] = message.address
    # Who answers at the address is a drive of its own.
    for piece in scene.pieces if found else ():
        if piece.is_reply and piece.message is not None:
            found.pop(_drive(piece.message), None)
    return found


def _drive(message: Message) -> tuple[str, int]:
    return message.frame.dialect.name, message.address


def _is_read(message: Message) -> bool:
    return message.command is not None and _reads(message)


def _only_to_all(scene: Scene, message: Message) -> bool:
    """Say whether an unknown register is written and all requests are broadcasts: a real broadcast has others beside it."""
    unknown = message.command in message.frame.dialect.fallbacks.values()
    return unknown and all(p.message is not None and p.message.address == message.address for p in scene.requests)


def _to_none(scene: Scene) -> Iterator[Suspicion]:
    """Suspect Modbus frames to an address that no unit can have."""
    troubles = [
        t for t in scene.damaged
        if t.stretch is not None and t.stretch.can_id is None and t.stretch.direction is not Role.REPLY
        and _beyond(t.stretch.data)
    ]  # fmt: skip
    if not troubles or troubles[0].stretch is None:
        return
    data = troubles[0].stretch.data
    asked = {t.stretch.data for t in troubles if t.stretch is not None}
    if any(b.direction is not Role.REQUEST and b.data[:2] == data[:2] and b.data not in asked for b in scene.bursts):
        # Who answers at it has it.
        return
    general = _GENERAL.get(data[0], "")
    likely = Confidence.CERTAIN if len(troubles) > 1 else Confidence.LIKELY
    yield Suspicion(
        "wrong_address", Confidence.POSSIBLE if general else likely, troubles,
        f"Address {data[0]} is none of a Modbus unit: those end at {LAST_UNIT}."
        + (f" {general} answer at it where they are alone on the bus." if general else ""),
        f"{shown(data)} at byte {troubles[0].offset}; {counted(len(troubles), 'time')}",
        f"Ask at the unit's own address: for 1 send {shown(_at_one(data))}",
        tuple(Shown(t.offset, shown(t.stretch.data), shown(_at_one(t.stretch.data))) for t in troubles if t.stretch),
    )  # fmt: skip


def _from_new(scene: Scene) -> Iterator[Suspicion]:
    """Suspect a new address where the reply to a write of one register comes from the address that it writes."""
    before: Piece | None = None
    for piece in scene.pieces:
        data, message = piece.data, piece.message
        written, before = before, piece
        if message is None or len(data) != _WRITE_ONE or piece.can is not None or not message.frame.checksum_ok:
            continue
        unknown = message.command in message.frame.dialect.fallbacks.values()
        if not unknown or data[1] != _WRITES or int.from_bytes(data[4:6], "big") != data[0] or data[0] == 1:
            continue
        asked = written is not None and written.data[0] != data[0] and (
            written.data[1:6] == data[1:6]
            # The reply to a write to all may name another register.
            or (not written.data[0] and (written.data[1], written.data[4:6]) == (data[1], data[4:6]))
        )  # fmt: skip
        if not asked and len(scene.pieces) > 1:
            continue
        pair = (piece, written) if asked else (piece,)
        yield Suspicion(
            "address_changed", Confidence.LIKELY if asked else Confidence.POSSIBLE,
            [t for t in scene.troubles if t.piece in pair] or [Trouble("unsolicited_reply", piece.offset, None, piece)],
            f"The unit was given the address {data[0]}, and answers from it at once.",
            f"{shown(data)} at byte {piece.offset} writes {data[0]}, and comes from {data[0]}",
            f"Ask at address {data[0]} from here on: the write is done, also where a library reports an error",
            (Shown(piece.offset, shown(data)),),
        )  # fmt: skip
        return


def _beyond(data: bytes) -> bool:
    known = len(data) > _MODBUS_SHORTEST and data[0] > LAST_UNIT and data[1] in FUNCTIONS
    # A CRC that fits still does with a 00 behind it.
    return known and modbus_crc(data) == 0 and modbus_crc(data[:-1]) != 0


def _at_one(data: bytes) -> bytes:
    body = b"\1" + data[1:-2]
    return body + modbus_crc(body).to_bytes(2, "little")


def _reads(message: Message) -> bool:
    assert message.command is not None  # asked of known commands
    return message.command.risks(message.values) == frozenset((Risk.READ,))
