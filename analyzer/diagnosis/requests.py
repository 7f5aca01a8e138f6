"""Requests whose check is right and whose content no drive takes: an unknown code or register, a wrong function."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from typing import NamedTuple

from analyzer.catalogue import Dialect, Role
from analyzer.diagnosis.rendered import read_otherwise
from analyzer.diagnosis.scene import Confidence, Piece, Scene, Shown, Suspicion, Trouble, shown
from analyzer.diagnosis.values import filled
from analyzer.link import FUNCTIONS, REGISTER_READS, WRITE_MANY, WRITE_ONE, modbus_crc
from analyzer.values import counted

_LOOK_UP = "Look the command up: `servotap catalogue` lists what the manual has"
#: What each exception of the standard says is wrong, by its code.
EXCEPTIONS = {
    0x01: ("wrong_function", "it does not have this function", "Look up which function the register has (03, 04, 06 or 10)"),
    0x02: (
        "wrong_register", "there is no such register, or the quantity reaches over the last one",
        "Look the register up: many manuals count from 1, from 40001, or in hexadecimal",
    ),
    0x03: ("value_out_of_range", "a value or quantity is not allowed", "Look up the range of the register and the quantity"),
    0x05: ("too_fast", "it has taken the request and needs longer", "Wait, and ask again later"),
    0x06: ("too_fast", "it is busy with the request before", "Wait for the end of what runs, then ask again"),
    0x0A: ("no_reply", "the gateway has no path to the unit", "Set the gateway's serial side up, and its unit identifiers"),
    0x0B: ("no_reply", "the unit behind the gateway does not answer", "Check the unit's address, speed, wires and power"),
}  # fmt: skip
#: Requests of a capture in which one refusal is what it is about.
_FEW = 4
#: The exception of a register that is not there.
_NO_REGISTER = 0x02
#: Bytes of a CAN frame.
_LONGEST = 8
#: First registers of each kind in the numbering of old controllers.
_NUMBERED = (10001, 30001, 40001)


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect what the requests ask for."""
    found: dict[tuple[str, str], list[_Wrong]] = {}
    asked_of = {p.sequence: p.data for p in scene.pieces if p.is_request}
    answers = {
        p.asked_by for p in scene.pieces
        if p.is_reply and not _refuses(p) and not _is_long(p) and not _is_of_other(asked_of.get(p.asked_by or 0, b""), p.data)
    }  # fmt: skip
    answered = {p.data for p in scene.pieces if p.is_request and p.sequence in answers}
    for troubles, piece, refusal in _failing(scene):
        if refusal is None and piece.sequence in answers:
            continue
        # The same bytes met with a good reply, so the device has this function and this register.
        if refusal not in (None, piece) and piece.data in answered and _about_register(refusal):
            continue
        why = _why(scene, piece, refusal)
        if why is not None:
            key = (why.cause, why.say if why.by_exception else "")
            found.setdefault(key, []).append(_Wrong(troubles, piece, refusal, why))
    asked = sum(piece.is_request for piece in scene.pieces)
    # A document shows examples, which may never have been sent.
    examples = scene.noted and not scene.timed and sum(piece.sound for piece in scene.pieces) > _FEW // 2
    for (cause, _), rows in found.items():
        first = rows[0]
        example = examples and len(rows) == 1 and first.refusal in (None, first.piece)
        # Among others that are right, one is miswritten.
        if example and (cause != "wrong_length" or not _among_its_own(scene, first.piece)):
            continue
        # One refusal in long traffic is an answer like any other.
        if first.why.by_exception and len(rows) == 1 and asked > _FEW:
            continue
        can_id = None if first.piece.can is None else first.piece.can.id
        if cause == "unknown_command" and can_id is None and read_otherwise([w.piece.data for w in rows]):
            continue
        met = ", with no good reply" if first.refusal is None else f", answered {shown(first.refusal.data)}"
        met = "" if first.refusal is first.piece else met
        right = first.why.right
        yield Suspicion(
            cause, Confidence.POSSIBLE if example else Confidence.CERTAIN if len(rows) > 1 else Confidence.LIKELY,
            [t for w in rows for t in w.troubles],
            first.why.say,
            f"{shown(first.piece.data, can_id)} at byte {first.piece.offset}{met}; {counted(len(rows), 'time')}",
            first.why.next or (f"Send {shown(right, can_id)}" if right else _LOOK_UP),
            tuple(
                Shown(w.piece.offset, shown(w.piece.data, can_id), shown(w.why.right, can_id) if w.why.right else "")
                for w in rows
            ),
        )  # fmt: skip


def _is_of_other(asked: bytes, came: bytes) -> bool:
    """Say whether registers came that are not as many as a Modbus read has asked for: they answer another."""
    reads = len(asked) == _READ and asked[1] in REGISTER_READS and asked[:2] == came[:2] and not modbus_crc(asked)
    return reads and came[2] != 2 * int.from_bytes(asked[4:6], "big")


#: The size of a Modbus read.
_READ = 8


def _among_its_own(scene: Scene, piece: Piece) -> bool:
    """Say whether a frame stands among several of its dialect that are right."""
    dialect = piece.message.frame.dialect if piece.message is not None else None
    return sum(p.sound and p.message is not None and p.message.frame.dialect is dialect for p in scene.pieces) >= _FEW


class _Why(NamedTuple):
    """What is wrong with a request. `by_exception`: the drive says so itself, so that one sentence is for one of its codes."""

    cause: str
    say: str
    right: bytes = b""
    next: str = ""
    by_exception: bool = False


class _Wrong(NamedTuple):
    """A request that failed. `refusal`: the exception that answers it."""

    troubles: list[Trouble]
    piece: Piece
    refusal: Piece | None
    why: _Why


def _failing(scene: Scene) -> Iterator[tuple[list[Trouble], Piece, Piece | None]]:
    """Yield the requests whose bytes are sound as far as their check goes, and which met with no good reply."""
    own: dict[int, list[Trouble]] = defaultdict(list)
    for trouble in scene.troubles:
        pieces = trouble.stretch.pieces[:1] if trouble.stretch is not None else (trouble.piece,)
        for piece in pieces:
            if piece is not None:
                own[piece.sequence].append(trouble)
    refusals = {p.asked_by: p for p in scene.pieces if p.asked_by is not None and "modbus_exception" in p.rules}
    # Bit 7 that is lost makes other codes of all, and their sums may fit.
    known = any(piece.is_reply and piece.sound for piece in scene.pieces)
    for piece in scene.pieces:
        refusal = refusals.get(piece.sequence)
        message = piece.message
        # What an exception answers is a request; a write of one register and its reply look alike.
        asks = piece.is_request or refusal is not None or _is_long(piece)
        # What is found unanswered was taken for a request, as a write of one register is, which its reply looks like.
        asks |= "unanswered" in piece.rules
        asks |= known and (_asks_nothing_known(piece) or _is_unprompted(scene, piece))
        if message is None or not asks or not message.frame.checksum_ok:
            if piece.is_reply and piece.asked_by is None and piece.sound and "modbus_exception" in piece.rules:
                yield own[piece.sequence], piece, piece
            continue
        troubles = own[piece.sequence] + (own[refusal.sequence] if refusal is not None else [])
        if troubles:
            yield troubles, piece, refusal


def _asks_nothing_known(piece: Piece) -> bool:
    """Say whether a frame of an unknown code has no fields. It is a request then, for a reply has some."""
    message = piece.message
    if message is None or message.role is not Role.UNKNOWN or "unknown_command" not in piece.rules:
        return False
    head = message.frame.dialect.link.parse(piece.data, None if piece.can is None else piece.can.id)
    return head.start == head.stop


def _is_unprompted(scene: Scene, piece: Piece) -> bool:
    """Say whether a frame on CAN of an unknown code comes where no reply is awaited: all its drive was asked is answered."""
    if piece.can is None or piece.message is None or "unknown_command" not in piece.rules:
        return False
    before = scene.asked_before(piece.offset)
    return before is None or before.sequence in scene.replies


def _is_long(piece: Piece) -> bool:
    """Say whether a frame has more than any reply of its code: without a mark it is a request, of a wrong length."""
    message = piece.message
    if message is None or piece.can is None or piece.is_request or message.command is None or "wrong_length" not in piece.rules:
        return False
    return len(message.data) > max((form.layout.byte_length for form in message.command.reply_forms), default=_LONGEST)


def _why(scene: Scene, piece: Piece, refusal: Piece | None) -> _Why | None:
    """Return what is wrong with a request that no drive has answered well."""
    message = piece.message
    assert message is not None  # a request
    if piece is refusal:
        return _refused(scene, None, piece)
    following = scene.behind.get(piece.sequence)
    replies = scene.replies.get(piece.sequence, [])
    if not replies and following is not None and following.is_reply and following.message is not None:
        replies = [following] if following.message.address == message.address else []
    if any(not _refuses(p) and not _is_long(p) for p in replies):
        return None
    dialect, data = message.frame.dialect, piece.data
    head = dialect.link.parse(data, None if piece.can is None else piece.can.id)
    if "wrong_length" in piece.rules:
        command = message.command
        reads = command is not None and command.code >= 0 and head.function in REGISTER_READS
        right = b""
        if command is not None and reads:
            right = dialect.link.build(command, command.request_forms[0], message.address, b"", Role.REQUEST)
        forms = command.request_forms if command is not None and not reads and dialect.of_drives else ()
        if command is not None and len(forms) == 1 and (wide := filled(forms[0].layout, message.data)):
            right = dialect.link.build(command, forms[0], message.address, wide, Role.REQUEST)
        text = next((v.text for v in message.violations if v.rule == "wrong_length"), "")
        if reads and refusal is not None and refusal.message and refusal.message.values.get("exception") == _NO_REGISTER:
            return _Why("wrong_register", f"The device has no value of so many registers there: {text}.", right)
        return _Why("wrong_length", f"A request of code {head.code or 0:02X} has not the length of the manual: {text}.", right)
    if "unknown_command" in piece.rules:
        if head.function is None:
            return _Why("unknown_command", f"The manual does not list the code {head.code or 0:02X}.")
        if head.function in FUNCTIONS and head.code is not None and _about_register(refusal):
            found = _register(dialect, data, head.function, head.code)
            if found is not None:
                return found
            if refusal is None and message.address in _answering(scene, dialect):
                what = f"The manual does not list the register {head.code:04X} under function {head.function:02X}."
                return _Why("unknown_command", what)
    if refusal is not None:
        return _refused(scene, piece, refusal)
    return _silent_function(scene, piece) if head.function in REGISTER_READS else None


def _answering(scene: Scene, dialect: Dialect) -> set[int]:
    """Return the addresses at which a drive answers what its manual lists: another device has other registers."""
    others = (None, *dialect.fallbacks.values())
    answered = (p.message for p in scene.pieces if p.is_reply and p.sound and p.message and dialect.of_drives)
    return {message.address for message in answered if message.command not in others}


def _refused(scene: Scene, piece: Piece | None, refusal: Piece) -> _Why | None:
    """Return what the drive itself says is wrong: the code of its exception. `piece`: the request, if it is known."""
    assert refusal.message is not None  # an exception
    code = refusal.message.values.get("exception", 0)
    if code not in EXCEPTIONS:
        return None
    cause, say, todo = EXCEPTIONS[code]
    right = b""
    if piece is not None and len(piece.data) == 8:
        function, register = piece.data[1], int.from_bytes(piece.data[2:4], "big")
        if cause == "wrong_function" and function in REGISTER_READS:
            right = _with(refusal.message.frame.dialect, piece.data, sum(REGISTER_READS) - function, register)
        elif cause == "wrong_register" and register:
            first = max((n for n in _NUMBERED if n <= register), default=1)
            right = _with(refusal.message.frame.dialect, piece.data, function, register - first)
    asked = f" to {shown(piece.data)}" if piece is not None else ""
    return _Why(
        cause, f"The device refuses by exception {code:02X}: {say}.", right,
        f"{todo}{f': try {shown(right)}' if right else ''}{'' if asked else '; the request itself is not in the capture'}",
        True,
    )  # fmt: skip


def _about_register(refusal: Piece | None) -> bool:
    """Say whether a refusal, if there is one, is of the function or the register."""
    return refusal is None or refusal.message is None or refusal.message.values.get("exception") in (0x01, 0x02)


def _silent_function(scene: Scene, piece: Piece) -> _Why | None:
    """Suspect the function where the same address answers the other one that reads, and never this."""
    message = piece.message
    assert message is not None  # a request
    answered = {p.asked_by for p in scene.pieces if p.is_reply and not _refuses(p)}
    asked = [p for p in scene.pieces if p.is_request and p.data[:1] == piece.data[:1] and len(p.data) == 8]
    function = piece.data[1]
    good = {p.data[1] for p in asked if p.sequence in answered}
    if function in good or sum(REGISTER_READS) - function not in good:
        return None
    other = sum(REGISTER_READS) - function
    right = _with(message.frame.dialect, piece.data, other, int.from_bytes(piece.data[2:4], "big"))
    return _Why("wrong_function", f"Function {function:02X} is never answered, and {other:02X} is.", right)


def _with(dialect: Dialect, data: bytes, function: int, register: int) -> bytes:
    """Return a request of a standard function with another function and register."""
    return dialect.link.completed(bytes((data[0], function)) + register.to_bytes(2, "big") + data[4:-2])


def _refuses(piece: Piece) -> bool:
    return bool(piece.rules & {"modbus_exception", "refused_write", "failed_status"})


def _register(dialect: Dialect, data: bytes, function: int, register: int) -> _Why | None:
    """Return what is wrong with a register that the function does not know."""
    known = {(c.function, c.code): c.name for c in dialect.commands}
    for other in WRITE_ONE | WRITE_MANY if function in WRITE_ONE | WRITE_MANY else ():
        if other != function and (other, register) in known:
            return _Why(
                "wrong_function", f"Register {register:04X} is written by function {other:02X}, not {function:02X}.",
                next=f"Write it by function {other:02X}: `servotap catalogue {known[other, register]}` has the frame",
            )  # fmt: skip
    for other in REGISTER_READS:
        if function in REGISTER_READS and other != function and (other, register) in known:
            say = f"Register {register:04X} is read by function {other:02X}, not {function:02X}."
            return _Why("wrong_function", say, _with(dialect, data, other, register))
    turned, count = register >> 8 | (register & 0xFF) << 8, data[4:6]
    if function in REGISTER_READS and (function, turned) in known and count[0] and not count[1]:
        right = dialect.link.completed(data[:2] + turned.to_bytes(2, "big") + count[::-1])
        say = f"Register {register:04X} is {turned:04X} with its bytes in the wrong order, and so is the quantity."
        return _Why("wrong_byte_order", say, right)
    meant = int(str(register), 16) if len(str(register)) <= 4 else 0
    if register > 9 and (function, meant) in known:
        say = f"The register {register:04X} is {register} in decimal: meant is {meant:04X}, in hexadecimal."
        return _Why("decimal_as_hex", say, _with(dialect, data, function, meant))
    # Numbers of old controllers begin at 30001 and 40001; some count them from 30000 and 40000.
    first = max((n - less for n in _NUMBERED for less in (0, 1) if (function, register - n + less) in known), default=0)
    if first:
        say = f"Register {register:04X} is {register} in decimal, a number of old controllers: meant is {register - first:04X}."
        return _Why("wrong_register", say, _with(dialect, data, function, register - first))
    for meant, where in ((register - 1, "above"), (register + 1, "below")):
        if register and (function, meant) in known:
            say = f"Register {register:04X} is one {where} {meant:04X}."
            return _Why("wrong_register", say, _with(dialect, data, function, meant))
    return None
