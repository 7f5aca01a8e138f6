"""What a drive does that no manual says: a second reply, a byte count that lies, a command that it never answers."""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.catalogue import Role
from analyzer.diagnosis.scene import Confidence, Piece, Scene, Shown, Suspicion, Trouble, shown
from analyzer.link import READS, modbus_crc
from analyzer.values import counted

#: So often something has to happen to be a habit.
_HABIT = 2
#: A Modbus read asks for so many registers at most.
_MOST_REGISTERS = 125
_REQUEST = 8
_MODBUS_LAST = 247
_SHORTEST = 7


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the firmware."""
    for part in (_second_reply, _byte_count, _never_answered):
        yield from part(scene)


def _second_reply(scene: Scene) -> Iterator[Suspicion]:
    """Suspect replies that follow a good one to the same request, where other commands are answered once."""
    found: list[Trouble] = []
    once: set[str] = set()
    again: set[str] = set()
    troubles = {t.piece: t for t in scene.of("duplicate_reply", "unsolicited_reply") if t.piece is not None}
    last: Piece | None = None
    for piece in scene.pieces:
        message = piece.message
        if message is None or message.command is None:
            continue
        if piece.is_request:
            last = None
        elif last is not None and last.message is not None and piece in troubles and last.message.command is message.command:
            found.append(troubles[piece])
            again.add(message.command.name)
        elif piece.asked_by is not None:
            last = piece
            once.add(message.command.name)
    if len(found) < _HABIT or not once - again:
        return
    names = ", ".join(sorted(again))
    yield _said(
        Confidence.LIKELY, found, f"The drive answers {names} twice, which its manual does not say.", " comes behind the reply",
        "Let the program drop a second reply of the same code; look for other firmware",
    )  # fmt: skip


def _said(confidence: Confidence, troubles: list[Trouble], say: str, where: str, todo: str) -> Suspicion:
    frames = tuple(Shown(t.offset, shown(b"" if t.piece is None else t.piece.data)) for t in troubles)
    evidence = f"{frames[0].data} at byte {frames[0].offset}{where}; {counted(len(troubles), 'time')}"
    return Suspicion("firmware_quirk", confidence, troubles, say, evidence, todo, frames)


def _byte_count(scene: Scene) -> Iterator[Suspicion]:
    """Suspect reads whose CRC fits, and whose byte count is not that of the bytes."""
    for piece in scene.pieces:
        data, size = piece.data, len(piece.data)
        if piece.can is not None or size < _SHORTEST or data[1] not in READS or modbus_crc(data):
            continue
        # A CRC that fits still does with a 00 behind it.
        if data[0] > _MODBUS_LAST or modbus_crc(data[:-1]) == 0:
            continue
        count, quantity = int.from_bytes(data[2:4], "big"), int.from_bytes(data[4:6], "big")
        asks = size == _REQUEST and 1 <= quantity <= _MOST_REGISTERS
        if asks or size == data[2] + 5:
            continue
        own = [t for t in scene.troubles if t.piece is piece or (t.stretch is not None and t.stretch.offset == piece.offset)]
        what = "has 16 bits" if count == size - 6 else f"is {data[2]}, and {counted(size - 5, 'byte')} follow"
        yield Suspicion(
            "firmware_quirk", Confidence.LIKELY, own or [Trouble("wrong_length", piece.offset, None, piece)],
            f"The byte count of a reply {what}: its CRC fits, so the device itself sends it so.",
            f"{shown(data)} at byte {piece.offset}",
            "Ask the maker for other firmware, or read this device by a length of its own",
            (Shown(piece.offset, shown(data)),),
        )  # fmt: skip
        return


def _never_answered(scene: Scene) -> Iterator[Suspicion]:
    """Suspect a firmware without a command that is never answered, where all others are."""
    if any(s.direction is not Role.REQUEST for s in scene.stretches):
        # Damaged bytes may be its replies.
        return
    silent: dict[str, list[Trouble]] = {}
    for trouble in scene.of("unanswered"):
        if trouble in scene.explained or trouble.piece is None or trouble.piece.message is None:
            continue
        command = trouble.piece.message.command
        if command is not None and command.code >= 0:
            silent.setdefault(command.name, []).append(trouble)
    answered = {
        p.message.command.name for p in scene.pieces if p.is_reply and p.message is not None and p.message.command is not None
    }
    for name, troubles in silent.items():
        if name in answered or len(troubles) < _HABIT or len(answered) < _HABIT or len(silent) > len(answered):
            continue
        yield _said(
            Confidence.POSSIBLE, troubles,
            f"The drive never answers {name}, and answers other commands: its firmware may not have it.", "",
            "Read the version of the firmware, and compare it with that of the manual",
        )  # fmt: skip
