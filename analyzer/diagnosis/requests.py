"""Requests whose check is right and whose content no drive takes: an unknown code or register, a wrong function or length."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from itertools import islice, pairwise
from typing import NamedTuple

from analyzer.catalogue import Dialect, Role
from analyzer.diagnosis.exchanges import replies_to
from analyzer.diagnosis.scene import Confidence, Piece, Scene, Shown, Stretch, Suspicion, Trouble, shown
from analyzer.link import FUNCTIONS, READS, modbus_crc
from analyzer.values import counted

_READS = (0x03, 0x04)
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
#: Zeros behind a frame that are no glitch.
_PADDING = 4
#: Where functions have their count of bytes, in a request or in a reply; and the size of their frames that have none.
_COUNTS = {**dict.fromkeys((0x0F, 0x10), (6,)), 0x11: (2,), 0x0C: (2,), 0x17: (2, 10)}
_UNCOUNTED = {**dict.fromkeys((0x0F, 0x10), 8), **dict.fromkeys((0x0C, 0x11), 4)}
#: What answers a write, a request of nothing but its function, the shortest frame and the longest, and the last address.
_ANSWER, _BARE, _SHORTEST, _LONGEST, _LAST_UNIT = 8, 4, 5, 256, 247
#: The exception of a register that is not there.
_NO_REGISTER = 0x02
#: First registers of each kind in the numbering of old controllers.
_NUMBERED = (10001, 30001, 40001)


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect what the requests ask for."""
    yield from islice(_short(scene), 1)
    yield from _padded(scene)
    yield from _promised(scene)
    yield from _miscounted(scene)
    yield from _other_quantity(scene)
    found: dict[tuple[str, str], list[_Wrong]] = {}
    answers = {p.asked_by for p in scene.pieces if p.is_reply and not _refuses(p)}
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
        if message is None or not (piece.is_request or (known and _asks_nothing_known(piece))) or not message.frame.checksum_ok:
            if piece.is_reply and piece.asked_by is None and piece.sound and "modbus_exception" in piece.rules:
                yield own[piece.sequence], piece, piece
            continue
        troubles = own[piece.sequence] + (own[refusal.sequence] if refusal is not None else [])
        if troubles:
            yield troubles, piece, refusal


def _asks_nothing_known(piece: Piece) -> bool:
    """Say whether a frame of an unknown code has no fields: a reply has some, so it is a request, whoever has logged it."""
    message = piece.message
    if message is None or message.role is not Role.UNKNOWN or "unknown_command" not in piece.rules:
        return False
    head = message.frame.dialect.link.parse(piece.data, None if piece.can is None else piece.can.id)
    return head.start == head.stop


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


def _padded(scene: Scene) -> Iterator[Suspicion]:
    """Suspect requests that are filled up with zeros."""
    before = {p.stop: p for p in scene.pieces if p.is_request and p.sound and p.can is None}
    found: list[tuple[Trouble, bytes, bytes]] = []
    for trouble in scene.damaged:
        stretch = trouble.stretch
        if stretch is None or stretch.direction is Role.REPLY or stretch.can_id is not None:
            continue
        request = before.get(stretch.offset)
        if request is not None and not any(stretch.data) and not stretch.opens:
            found.append((trouble, request.data + stretch.data, request.data))
    sizes = {len(data) for _, data, _ in found}
    zeros = max((len(data) - len(right) for _, data, right in found), default=0)
    # A glitch behind a frame reads as few zeros, in frames of any length.
    sure = zeros >= _PADDING or len({len(right) for _, _, right in found}) > 1
    if not found or len(sizes) > 1 or not sure:
        return
    first, data, right = found[0]
    yield Suspicion(
        "wrong_length", Confidence.CERTAIN if len(found) > 1 else Confidence.LIKELY, [t for t, _, _ in found],
        f"The request is filled up to {counted(len(data), 'byte')}; the manual has {len(right)}.",
        f"{shown(data)} at byte {first.offset}; {counted(len(found), 'time')}",
        f"Send as many bytes as the command has: {shown(right)}",
        tuple(Shown(t.offset, shown(d), shown(r)) for t, d, r in found),
    )  # fmt: skip


def _promised(scene: Scene) -> Iterator[Suspicion]:
    """Suspect requests whose head is sound, and whose length is none of the command's."""
    found: list[tuple[Trouble, bytes, bytes, str]] = []
    for trouble in scene.damaged:
        stretch = trouble.stretch
        if stretch is None or stretch.direction is Role.REPLY or not (stretch.opens and stretch.ends):
            continue
        for dialect in scene.reader.dialects:
            link, data = dialect.link, stretch.data
            if not link.tells_length or stretch.can_id is not None or data[0] not in link.first_bytes:
                continue
            head = link.parse(data)
            commands = dialect.by_code.get(head.code or 0, ())
            rights = [link.build(c, f, head.address, bytes(f.layout.byte_length), Role.REQUEST) for c in commands
                      for f in c.request_forms]  # fmt: skip
            start = head.start
            listed = any(len(r) - 1 <= len(data) <= len(r) and data[:start] == r[:start] for r in rights)
            if stretch.direction is Role.UNKNOWN:
                # It may be a reply, damaged behind its head.
                listed |= any(
                    link.build(c, f, head.address, bytes(f.layout.byte_length), Role.REPLY)[:start] == data[:start]
                    for c in commands for f in c.reply_forms
                )  # fmt: skip
            if rights and link.checks(data)[0].ok and not listed:
                found.append((trouble, data, rights[0], commands[0].name))
    if not found:
        return
    first, data, right, name = found[0]
    yield Suspicion(
        "wrong_length", Confidence.CERTAIN if len(found) > 1 else Confidence.LIKELY, [t for t, _, _, _ in found],
        f"{name} is sent with a length that is not the manual's: a drive waits for what its head promises.",
        f"{shown(data)} at byte {first.offset}; {counted(len(found), 'time')}",
        f"Send {shown(right)}" + (", with the values that you mean" if len(right) > len(data) else ""),
        tuple(Shown(t.offset, shown(d), shown(r)) for t, d, r, _ in found),
    )  # fmt: skip


def _miscounted(scene: Scene) -> Iterator[Suspicion]:
    """Suspect Modbus frames whose count of bytes is not that of the bytes: the CRC fits, or a reply has another shape."""
    found: dict[str, list[tuple[Trouble, bytes, str]]] = {"wrong_length": [], "firmware_quirk": []}
    for burst in scene.bursts:
        data = burst.data
        if burst.can_id is not None or not (burst.opens and burst.ends) or not _BARE <= len(data) <= _LONGEST:
            continue
        own = [t for t in scene.troubles if burst.offset <= t.offset < burst.stop and t not in scene.explained]
        trouble = own[0] if own else None
        if not own and modbus_crc(data) == 0 and (burst.direction is Role.REQUEST or _without_code(scene, burst)):
            # Its drive may have taken it as it is.
            trouble = Trouble("wrong_length", burst.offset, burst)
        if trouble is not None and (said := _other_count(scene, burst)):
            found["firmware_quirk" if _of_device(scene, burst) else "wrong_length"].append((trouble, data, said))
    for cause, rows in found.items():
        if not rows:
            continue
        first, data, said = rows[0]
        # Without a CRC that fits it may be damaged.
        checked = [row for row in rows if modbus_crc(row[1]) == 0]
        if not checked and 2 * len(rows) < len(scene.spoiled):
            # Most others are damaged otherwise: so is this one.
            continue
        one = Confidence.CERTAIN if len(checked) > 1 else Confidence.LIKELY if checked else Confidence.POSSIBLE
        yield Suspicion(
            cause, one, [t for t, _, _ in rows],
            f"A Modbus {'reply' if cause == 'firmware_quirk' else 'frame'} has not the length that it tells: {said}.",
            f"{shown(data)} at byte {first.offset}; {counted(len(rows), 'time')}",
            "Let the sender count its data in bytes, put that count where the function has it, and compute the CRC over all "
            "of it",
            tuple(Shown(t.offset, shown(data)) for t, data, _ in rows),
        )  # fmt: skip


def _of_device(scene: Scene, burst: Stretch) -> bool:
    """Say whether bytes answer a request and their CRC fits: then their device has made them so."""
    asked = scene.asked_before(burst.offset)
    head = bytes((burst.data[0], burst.data[1] & 0x7F))
    answers = asked is not None and asked.stop == burst.offset and asked.data[:2] == head
    return modbus_crc(burst.data) == 0 and burst.direction is not Role.REQUEST and (burst.direction is Role.REPLY or answers)


def _other_quantity(scene: Scene) -> Iterator[Suspicion]:
    """Suspect a device that answers a read of registers with another number of them, in a frame that is sound."""
    reads = [p for p in scene.pieces if p.is_request and p.can is None and len(p.data) == _ANSWER and p.data[1] in _READS]
    asked = {(piece.data[:2], 2 * int.from_bytes(piece.data[4:6], "big")) for piece in reads}
    odd = []
    for one, other in pairwise(scene.pieces):
        reply = other.data
        if one not in reads or other.can is not None or one.stop != other.offset or reply[:2] != one.data[:2]:
            continue
        known = one.message is not None and one.message.command is not None and one.message.command.code >= 0
        whole = len(reply) > _SHORTEST and reply[2] == len(reply) - _SHORTEST and modbus_crc(reply) == 0
        # That of a request before comes too late.
        if whole and not known and (reply[:2], reply[2]) not in asked:
            odd.append((one, other))
    if not odd:
        return
    one, other = odd[0]
    found = [other for _, other in odd]
    yield Suspicion(
        "wrong_length", Confidence.CERTAIN if len(odd) > 1 else Confidence.LIKELY,
        [t for t in scene.troubles if t.piece in found] or [Trouble("wrong_length", p.offset, None, p) for p in found],
        f"A reply has {other.data[2] // 2} registers, and {int.from_bytes(one.data[4:6], 'big')} were asked for.",
        f"{shown(other.data)} at byte {other.offset} answers {shown(one.data)}; {counted(len(odd), 'time')}",
        "Take as many bytes as the reply counts; look up how many registers the value has, and ask for these",
        tuple(Shown(p.offset, shown(p.data)) for p in found),
    )  # fmt: skip


def _without_code(scene: Scene, burst: Stretch) -> bool:
    """Say whether a burst refuses the request before it, and does not say why."""
    data, asked = burst.data, scene.asked_before(burst.offset)
    refused = asked is not None and asked.stop == burst.offset and data[:2] == bytes((asked.data[0], asked.data[1] | 0x80))
    return refused and len(data) == _BARE and modbus_crc(data) == 0


def _other_count(scene: Scene, burst: Stretch) -> str:
    """Return what is wrong with the count of a burst; empty where it is right, or the bytes are damaged."""
    data, function = burst.data, burst.data[1]
    if _without_code(scene, burst):
        return f"an exception has {_SHORTEST} bytes, and this {len(data)}: its code is missing"
    before = scene.asked_before(burst.offset)
    if before is not None and before.stop == burst.offset and before.data[:2] == data[:2] and data[2] == len(data) - _SHORTEST:
        # The log of a device: what it sends are replies.
        return ""
    if modbus_crc(data) == 0 and function in READS and burst.direction is Role.REQUEST and len(data) < _ANSWER:
        if data[2] == len(data) - _SHORTEST:
            # It is a whole reply, also if the host sent it.
            return ""
        return f"a request to read has {_ANSWER} bytes, and this {len(data)}"
    if modbus_crc(data) == 0 and modbus_crc(data[:-1]) != 0 and data[0] <= _LAST_UNIT:
        places = _COUNTS.get(function)
        if (
            not places
            or len(data) == _UNCOUNTED.get(function)
            or any(n < len(data) and data[n] + n + 3 == len(data) for n in places)
        ):
            return ""
        at = places[-1]
        return f"{data[at]} bytes by its count, and {len(data) - at - 3} follow" if at < len(data) - 2 else "it has no count"
    asked = scene.asked_before(burst.offset)
    if burst.direction is not Role.REPLY or asked is None or asked.stop != burst.offset or asked.data[:2] != data[:2]:
        return ""
    wanted = [r for r in replies_to(asked) if function in READS]
    # One of the right length is damaged, among others or in its head alone; one that begins so is cut, or has more behind it.
    among = len(scene.damaged) > 1
    whole = any(p.sound for p in burst.pieces) or any(
        r.begins(data[: r.size]) or (among and r.size == len(data)) or bool(r.with_head(data)) for r in wanted
    )
    # The request itself is no reply, also if its check came damaged.
    if not wanted or whole or asked.data.startswith(data[: _ANSWER - 2]):
        return ""
    return f"the reply to {shown(asked.data)} has {data[2]} as its count, and {wanted[0].size - 5} were asked for"


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
    if refusal is not None:
        return _refused(scene, piece, refusal)
    return _silent_function(scene, piece) if head.function in _READS else None


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
        if cause == "wrong_function" and function in _READS:
            right = _with(refusal.message.frame.dialect, piece.data, sum(_READS) - function, register)
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
    if function in good or sum(_READS) - function not in good:
        return None
    other = sum(_READS) - function
    right = _with(message.frame.dialect, piece.data, other, int.from_bytes(piece.data[2:4], "big"))
    return _Why("wrong_function", f"Function {function:02X} is never answered, and {other:02X} is.", right)


def _with(dialect: Dialect, data: bytes, function: int, register: int) -> bytes:
    """Return a request of a standard function with another function and register."""
    return dialect.link.completed(bytes((data[0], function)) + register.to_bytes(2, "big") + data[4:-2])


def _refuses(piece: Piece) -> bool:
    return bool(piece.rules & {"modbus_exception", "refused_write", "failed_status"})


def _register(dialect: Dialect, data: bytes, function: int, register: int) -> _Why | None:
    """Return what is wrong with a register that the function does not know."""
    known = {(c.function, c.code) for c in dialect.commands}
    for other in _READS:
        if function in _READS and other != function and (other, register) in known:
            say = f"Register {register:04X} is read by function {other:02X}, not {function:02X}."
            return _Why("wrong_function", say, _with(dialect, data, other, register))
    meant = int(str(register), 16) if len(str(register)) <= 4 else 0
    if register > 9 and (function, meant) in known:
        say = f"The register {register:04X} is {register} in decimal: meant is {meant:04X}, in hexadecimal."
        return _Why("decimal_as_hex", say, _with(dialect, data, function, meant))
    if register and (function, register - 1) in known:
        say = f"Register {register:04X} is one above {register - 1:04X}."
        return _Why("wrong_register", say, _with(dialect, data, function, register - 1))
    return None
