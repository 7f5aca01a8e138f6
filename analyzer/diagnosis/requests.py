"""Requests whose check is right and whose content no drive takes: an unknown code or register, a wrong function or length."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice, pairwise

from analyzer.catalogue import Dialect, Role
from analyzer.diagnosis.scene import Confidence, Piece, Scene, Shown, Suspicion, Trouble, shown
from analyzer.link.modbus import FUNCTIONS
from analyzer.values import counted

_READS = (0x03, 0x04)


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect what the requests ask for."""
    yield from islice(_short(scene), 1)
    found: dict[str, list[tuple[Trouble, Piece, str, bytes]]] = {}
    for trouble in scene.damaged:
        piece = trouble.stretch.pieces[0] if trouble.stretch is not None else None
        if (
            piece is None
            or piece.message is None
            or piece.message.role is not Role.REQUEST
            or not piece.message.frame.checksum_ok
        ):
            continue
        if (why := _why(scene, piece)) is not None:
            found.setdefault(why[0], []).append((trouble, piece, *why[1:]))
    for cause, rows in found.items():
        first, piece, say, right = rows[0]
        can_id = None if piece.can is None else piece.can.id
        yield Suspicion(
            cause, Confidence.CERTAIN if len(rows) > 1 else Confidence.LIKELY, [t for t, _, _, _ in rows], say,
            f"{shown(piece.data, can_id)} at byte {first.offset}, with no good reply; {counted(len(rows), 'time')}",
            f"Send {shown(right, can_id)}" if right else "Look the command up: `servotap catalogue` lists what the manual has",
            tuple(
                Shown(t.offset, shown(p.data, can_id), shown(r, can_id) if r else "") for t, p, _, r in rows
            ),
        )  # fmt: skip


def _short(scene: Scene) -> Iterator[Suspicion]:
    """Suspect a request that lacks a field where it then looks like its own reply, as on CAN: two of those in a row."""
    unasked = {t.piece: t for t in scene.of("unsolicited_reply", "duplicate_reply") if t.piece is not None}
    for one, other in pairwise(scene.pieces):
        asked, message = one.message, other.message
        if one not in unasked or other not in unasked or asked is None or message is None or asked.command is None:
            continue
        link = asked.frame.dialect.link
        if asked.address != message.address or asked.command is not message.command or link.kind != "can":
            continue
        form = asked.command.request_forms[0]
        lacking = form.layout.byte_length - len(asked.data)
        # A command that is answered twice shows two replies in a row by itself.
        if lacking <= 0 or asked.command.replies.interim:
            continue
        right = link.build(asked.command, form, asked.address, asked.data + bytes(lacking), Role.REQUEST)
        yield Suspicion(
            "wrong_length", Confidence.LIKELY, [unasked[one], unasked[other]],
            f"{asked.command.name} is sent with {counted(len(asked.data), 'byte')} of data; the manual has "
            f"{form.layout.byte_length}.",
            f"{shown(one.data, asked.address)} and {shown(other.data, asked.address)} follow each other at byte {one.offset}",
            f"Send {shown(right, asked.address)}, with the values that you mean",
            (Shown(one.offset, shown(one.data, asked.address), shown(right, asked.address)),),
        )  # fmt: skip


def _why(scene: Scene, piece: Piece) -> tuple[str, str, bytes] | None:
    """Return a cause, what is wrong, and the right frame, for a request that no drive has answered well."""
    message = piece.message
    assert message is not None  # a request
    at = scene.pieces.index(piece)
    replies = [p for p in scene.pieces[at + 1 :] if p.asked_by == piece.sequence] or [
        p
        for p in scene.pieces[at + 1 : at + 2]
        if p.is_reply and p.message is not None and p.message.address == message.address
    ]
    if any(not _refuses(p) for p in replies):
        return None
    dialect, data = message.frame.dialect, piece.data
    head = dialect.link.parse(data, None if piece.can is None else piece.can.id)
    if "wrong_length" in piece.rules:
        command = message.command
        reads = command is not None and command.code >= 0 and head.function in _READS
        right = b""
        if command is not None and reads:
            right = dialect.link.build(command, command.request_forms[0], message.address, b"", Role.REQUEST)
        what = "quantity" if reads else "length"
        return "wrong_length", f"A request of code {head.code or 0:02X} has another {what} than the manual's.", right
    if "unknown_command" not in piece.rules:
        return None
    if head.function is None:
        return "unknown_command", f"The manual does not list the code {head.code or 0:02X}.", b""
    if head.function not in FUNCTIONS or head.code is None:
        return None
    return _register(dialect, data, head.function, head.code)


def _refuses(piece: Piece) -> bool:
    return bool(piece.rules & {"modbus_exception", "refused_write", "failed_status"})


def _register(dialect: Dialect, data: bytes, function: int, register: int) -> tuple[str, str, bytes] | None:
    """Return what is wrong with a register that the function does not know."""
    known = {(c.function, c.code) for c in dialect.commands}

    def frame(other_function: int, other: int) -> bytes:
        return dialect.link.completed(bytes((data[0], other_function)) + other.to_bytes(2, "big") + data[4:-2])

    for other in _READS:
        if function in _READS and other != function and (other, register) in known:
            say = f"Register {register:04X} is read by function {other:02X}, not {function:02X}."
            return "wrong_function", say, frame(other, register)
    meant = int(str(register), 16) if len(str(register)) <= 4 else 0
    if register > 9 and (function, meant) in known:
        say = f"The register {register:04X} is {register} in decimal: meant is {meant:04X}, in hexadecimal."
        return "decimal_as_hex", say, frame(function, meant)
    if register and (function, register - 1) in known:
        return "wrong_register", f"Register {register:04X} is one above {register - 1:04X}.", frame(function, register - 1)
    return None
