"""What a drive does that no manual says: a second reply, a byte count that lies, a command that it never answers."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator

from analyzer.catalogue import Risk, Role, Verb
from analyzer.diagnosis.exchanges import Turn, awaited, chains
from analyzer.diagnosis.scene import Confidence, Piece, Scene, Shown, Suspicion, Trouble, shown
from analyzer.layout import Effect
from analyzer.link import FUNCTIONS, LAST_EXCEPTION, LAST_UNIT, MOST_REGISTERS, READS, HeadLink, modbus_crc
from analyzer.protocols.mks_shared import MotorStatus
from analyzer.values import counted

#: So often something has to happen to be a habit.
_HABIT = 2
_REQUEST = 8
_SHORTEST = 7
#: Risks of what is set once, and not read again and again.
_SETTINGS = frozenset((Risk.SETTING, Risk.LINK))
#: The size of an exception.
_EXCEPTION = 5


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the firmware."""
    for part in (_second_reply, _other_code, _byte_count, _no_check, _no_end, _slowing_still, _never_answered):
        yield from part(scene)


def _second_reply(scene: Scene) -> Iterator[Suspicion]:
    """Suspect replies that follow a good one to the same request, where other commands are answered once."""
    found: list[Trouble] = []
    once: set[str] = set()
    again: set[str] = set()
    unasked = scene.of("duplicate_reply", "unsolicited_reply")
    troubles = {t.piece: t for t in unasked if t.piece is not None and t not in scene.explained}
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
    # Reads that are all answered twice are answered by two drives.
    settings = all(t.piece.message.command.all_risks & _SETTINGS for t in found
                   if t.piece is not None and t.piece.message is not None and t.piece.message.command is not None)  # fmt: skip
    if len(found) < _HABIT or not (once - again or (settings and (scene.directed or scene.pieces[0].can is not None))):
        return
    names = ", ".join(sorted(again))
    yield _said(
        Confidence.LIKELY, found, f"The drive answers {names} twice, which its manual does not say.", " comes behind the reply",
        "Let the program drop a second reply of the same code; look for other firmware",
    )  # fmt: skip


def _other_code(scene: Scene) -> Iterator[Suspicion]:
    """Suspect replies that are right but for their code: each reply to one command has that of another."""
    found: dict[tuple[str, int], list[Turn]] = {}
    right: set[str] = set()
    for exchange in (exchange for chain in chains(scene) for exchange in chain):
        message, data = exchange.request.message, exchange.data
        if message is None or message.command is None or not isinstance(message.frame.dialect.link, HeadLink):
            continue
        for reply in awaited(message):
            at = len(reply.head) - 1
            if reply.stands(data, 0):
                right.add(message.command.name)
            elif len(data) == reply.size and data[:at] == reply.head[:at] and reply.link.fits(data):
                turn = exchange.received[0]
                # A sound one may be the reply to another request.
                if turn.piece is not None and not turn.piece.sound:
                    found.setdefault((message.command.name, data[at]), []).append(turn)
    for (name, code), turns in found.items():
        if len(turns) < _HABIT or name in right:
            continue
        offsets = {turn.offset for turn in turns}
        first = turns[0]
        yield Suspicion(
            "firmware_quirk", Confidence.LIKELY,
            [t for t in scene.troubles if t.offset in offsets] or [Trouble("wrong_length", n, None) for n in offsets],
            f"The drive answers {name} under the code {code:02X}, which is that of another command: its sum and length fit.",
            f"{shown(first.data)} at byte {first.offset}; {counted(len(turns), 'time')}, and never otherwise",
            "Let the program take this reply by its length and address too; look for other firmware",
            tuple(Shown(turn.offset, shown(turn.data)) for turn in turns),
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
        if data[0] > LAST_UNIT or modbus_crc(data[:-1]) == 0:
            continue
        count, quantity = int.from_bytes(data[2:4], "big"), int.from_bytes(data[4:6], "big")
        asks = size == _REQUEST and 1 <= quantity <= MOST_REGISTERS
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


def _no_check(scene: Scene) -> Iterator[Suspicion]:
    """Suspect exceptions whose check is 00 00: no line makes two such bytes of a CRC."""
    found = [
        t for t in scene.damaged
        if t.stretch is not None and t.stretch.can_id is None and t.stretch.direction is not Role.REQUEST
        and t.stretch.opens and t.stretch.ends and _is_unchecked(t.stretch.data)
    ]  # fmt: skip
    if not found:
        return
    first = found[0].stretch
    assert first is not None  # chosen so
    yield Suspicion(
        "firmware_quirk", Confidence.LIKELY, found,
        "The device sends exceptions with 00 00 for their CRC.",
        f"{shown(first.data)} at byte {first.offset}; right is {shown(first.data[:-2])} "
        f"{shown(modbus_crc(first.data[:-2]).to_bytes(2, 'little'))}; {counted(len(found), 'time')}",
        "Take an exception of this device without its check, or ask the maker for other firmware; then see why it refuses",
        tuple(Shown(t.offset, shown(t.stretch.data)) for t in found if t.stretch is not None),
    )  # fmt: skip


def _is_unchecked(data: bytes) -> bool:
    """Say whether bytes are an exception of Modbus whose check is 00 00."""
    return (
        len(data) == _EXCEPTION and data[1] ^ 0x80 in FUNCTIONS and 0 < data[2] <= LAST_EXCEPTION and data[3:] == b"\0\0"
        and 0 < data[0] <= LAST_UNIT and modbus_crc(data) != 0
    )  # fmt: skip


def _no_end(scene: Scene) -> Iterator[Suspicion]:
    """Suspect motions that began and of whose end no reply came: it stands, or words say so."""
    begun: list[Piece] = []
    told = passive = False
    for piece in scene.requests:
        command = None if piece.message is None else piece.message.command
        if command is not None and piece.message is not None:
            passive |= piece.message.values.get(command.sets(Effect.ACTIVE)) == 0
        if command is None or command.motion is None or not command.motion.tells_end:
            continue
        last = [r.message.values.get(command.replies.status) for r in scene.replies.get(piece.sequence, ()) if r.message][-1:]
        begun += [piece] if command.replies.interim.issuperset(last) and last else []
        told |= bool(last) and command.replies.final.issuperset(last)
    said = next((found[0] for words in scene.words if (found := _NO_END.search(words)) is not None), "")
    shows = f" ({said!r} in the text)" if said else ", and the motor stands"
    own = begun[-1:] if said else [piece for piece in begun if told and _stands(scene, piece) >= _HABIT]
    # A setting from before the capture may have switched the report off: only who still waits for it misses it.
    waits = bool(begun) and not (own or told or passive) and _stands(scene, begun[-1], alone=True) >= _WAITED
    if not (own := begun[-1:] if waits else own):
        return
    yield _said(
        Confidence.POSSIBLE if waits else Confidence.LIKELY, [Trouble("no_end", piece.offset, None, piece) for piece in own],
        "A motion began, and the drive never reports its end.",
        f" was answered by its start alone{shows}",
        "Read the status (F1) or the position until the motor stands, and wait for no report; see whether 8C has switched "
        "replies or this report off, and look for other firmware",
    )  # fmt: skip


#: A drive that stands is asked so often for its status alone by a host that waits.
_WAITED = 4


def _stands(scene: Scene, motion: Piece, *, alone: bool = False) -> int:
    """Return how often a drive tells that it stands, before it is asked for anything but readings.

    `alone`: 0 where the host asks for anything but the status.
    """
    standing = 0
    for piece in scene.requests[bisect_right(scene.requests, motion.offset, key=lambda p: p.offset) :]:
        message = piece.message
        if message is None or message.command is None or motion.message is None or message.address != motion.message.address:
            continue
        if message.command.all_risks != {Risk.READ}:
            break
        if message.command.verb is Verb.READ_STATUS:
            replies = [r.message.values for r in scene.replies.get(piece.sequence, ()) if r.message is not None]
            standing += any(values.get("status") == MotorStatus.STOPPED for values in replies)
        elif alone:
            return 0
    return standing


def _slowing_still(scene: Scene) -> Iterator[Suspicion]:
    """Suspect a status that says "slowing down" of a shaft whose speed reads 0, one time after the other."""
    slowing: dict[tuple[str, int], Piece] = {}
    still: dict[tuple[str, int], list[Piece]] = {}
    for piece in scene.pieces:
        message = piece.message
        if message is None or message.command is None or not (piece.is_reply and piece.sound):
            continue
        drive, verb = (message.frame.dialect.name, message.address), message.command.verb
        if verb is Verb.READ_STATUS and message.values.get("status") == MotorStatus.SLOWING_DOWN:
            slowing[drive] = piece
        elif verb is Verb.READ_SPEED and message.values.get("speed") == 0:
            still.setdefault(drive, []).extend([slowing.pop(drive)] if drive in slowing else [])
        elif verb in (Verb.READ_STATUS, Verb.READ_SPEED):
            # It goes on: who has slowed down for long is told by what came until here.
            slowing.pop(drive, None)
            if len(still.get(drive, ())) < _STILL:
                still.pop(drive, None)
    own = next((pieces for pieces in still.values() if len(pieces) >= _STILL), [])
    if own:
        yield _said(
            Confidence.LIKELY, [Trouble("no_end", piece.offset, None, piece) for piece in own],
            "The status says that the motor slows down, and its speed reads 0: some firmware stays so after a move.",
            " comes where the speed reads 0",
            "Wait for the speed or the position to stand, for a limited time, and not for this status; look for other firmware",
        )  # fmt: skip


#: Times in a row that are no last moment of a ramp.
_STILL = 3
#: How people write that the report of an end is missing.
_NO_END = re.compile(
    r"\b(?:not|n't|never|no)\b[^.\n]{0,30}\b(?:run[ _-]complete|complet\w+|finish\w*|arriv\w+|done)\b[^.\n]{0,12}"
    r"\b(?:stat\w+|response|reply|message|report|feedback)|\b(?:not|n't|never)\b[^.\n]{0,12}\b(?:send|sent|report|return|get|got)\w*\b"
    r"[^.\n]{0,20}\b(?:run[ _-]complete|complet\w+|finish\w*)",
    re.IGNORECASE,
)


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
