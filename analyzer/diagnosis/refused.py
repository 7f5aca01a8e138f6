"""Drives that answer and refuse to move: the mode in which they work."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

from analyzer.catalogue import Command, Verb
from analyzer.diagnosis.scene import Confidence, Scene, Shown, Suspicion, Trouble, shown, whole
from analyzer.encoder import build
from analyzer.layout import Effect
from analyzer.values import counted


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the work mode where every motion command of a drive is refused."""
    refused: dict[tuple[str, int], list[Trouble]] = defaultdict(list)
    done: set[tuple[str, int]] = set()
    asked = {p.sequence: p for p in scene.pieces if p.is_request}
    failed = {t.piece.sequence: t for t in scene.of("failed_status", "refused_write") if t.piece is not None}
    for piece in scene.pieces:
        if not piece.is_reply or piece.message is None or piece.message.command is None:
            continue
        message = piece.message
        request = asked.get(piece.asked_by or 0)
        command = request.message.command if request is not None and request.message is not None else message.command
        if command is None or not _needs_mode(command):
            continue
        drive = (message.frame.dialect.name, message.address)
        if piece.sequence in failed:
            refused[drive].append(failed[piece.sequence])
        else:
            done.add(drive)
    for drive, troubles in refused.items():
        if drive in done or (len(troubles) == 1 and len(scene.pieces) > 4):
            continue
        first = troubles[0].piece
        assert first is not None
        assert first.message is not None
        assert first.message.command is not None  # a reply of a known command
        dialect, address = first.message.frame.dialect, first.message.address
        changed = dialect.effect(Effect.WORK_MODE)
        if changed is None:
            continue
        setter, field = changed
        mode = next((m for m in reversed(first.message.command.modes) if m in field.choice_names.values()), "")
        value = next((v for v, name in field.choice_names.items() if name == mode), None)
        if value is None:
            continue
        frame = shown(build(dialect, setter, address, {field.name: value}), dialect.link.identifier(setter, address))
        yield Suspicion(
            "refused_mode", Confidence.LIKELY, troubles,
            f"Address {first.message.who} refuses motion while it answers: it is in a mode that takes pulses, not the bus.",
            f"{whole(first)} at byte {first.offset} reports a refusal; {counted(len(troubles), 'time')}, and none succeeds",
            f"Change the work mode to {mode}: send {frame}; then enable the motor and move. If it is in that mode, ask for a "
            f"stall: `{Verb.READ_PROTECTION}`",
            tuple(Shown(t.offset, whole(t.piece)) for t in troubles if t.piece is not None),
        )  # fmt: skip


def _needs_mode(command: Command) -> bool:
    return bool(command.modes) and (command.moves or command.verb is Verb.ENABLE)
