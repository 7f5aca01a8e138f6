"""What libraries and people write next to the bytes: the maker of a motor, a code of a library, a mismatch."""

from __future__ import annotations

import re
from collections.abc import Iterator

from analyzer.catalogue import Role
from analyzer.diagnosis.reports import MISFIT, Checks, checks, reports
from analyzer.diagnosis.scene import Confidence, Piece, Scene, Shown, Suspicion, Trouble, shown
from analyzer.layout import Field
from analyzer.link import READS, modbus_crc
from analyzer.values import counted

#: Makers and protocols that are not known here, as people write them.
_OTHERS = re.compile(
    r"\b(odrive|my ?actuator|rmd[- ]?x\w*|robstride|cybergear|dynamixel|feetech|vesc|pylontech|canopen|damiao|unitree)", re.I
)
#: Causes that a list of all exceptions has, as documentation and programs have one.
_EXCEPTIONS = frozenset(("wrong_function", "wrong_register", "value_out_of_range"))


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect what the words say, where the bytes do not contradict it."""
    words = "\n".join(scene.words)
    if not words:
        return
    troubles = scene.troubles
    if (misfit := MISFIT.search(words)) is not None:
        yield from _misfit(scene, misfit[0])
    yield from _as_string(scene, words)
    yield from _as_digits(scene, words)
    yield from _without_scale(scene, words)
    yield from _reported(scene, words)
    ours = any(p.sound and p.message is not None and p.message.command is not None for p in scene.pieces)
    if not ours and (other := _OTHERS.search(words)) is not None and (troubles or scene.pieces):
        # A dialect on CAN has no look of its own: what else is suspected of it is by chance.
        on_can = scene.pieces and scene.pieces[0].can is not None
        sure = Confidence.POSSIBLE if scene.program else Confidence.CERTAIN if on_can else Confidence.LIKELY
        yield Suspicion(
            "unsupported_dialect", sure, troubles,
            f"The text speaks of {other[0]}, and no frame is of a dialect that is known here.",
            f"{other[0]!r} in the text; {shown(scene.pieces[0].data)} at byte {scene.pieces[0].offset}",
            "Use the manual of its maker; the dialects known here are those of `servotap catalogue`",
        )  # fmt: skip


def _without_scale(scene: Scene, words: str) -> Iterator[Suspicion]:
    """Suspect numbers that are sent in the unit itself where the manual counts in parts of it.

    Words have these numbers with the unit, or say by how much the drive does less.
    """
    less = {int(number) for found in _LESS.finditer(words) for number in found.groups() if number}
    numbers = set(_NUMBER.findall(words))
    found: dict[int, tuple[Piece, Field]] = {}
    for piece in scene.requests:
        message = piece.message
        if message is None or message.form is None or message.command is None or message.command.motion is None:
            continue
        for name in (message.command.motion.speed, message.command.motion.distance):
            field, value = message.form.layout.named.get(name), message.values.get(name)
            if field is None or not isinstance(value, int) or not value or field.scale.numerator != 1 or field.scale == 1:
                continue
            said = rf"(?<![\w.]){abs(value)}(?![\d.])\D{{0,12}}?{_UNITS.get(field.unit, re.escape(field.unit))}"
            named = str(abs(value)) in numbers and re.search(said, words, re.IGNORECASE) is not None
            if named or field.scale.denominator in less:
                found.setdefault(value, (piece, field))
    if len(found) <= (not less):
        return
    piece, field = next(iter(found.values()))
    value, parts = next(iter(found)), field.scale.denominator
    pieces = [p for p in scene.requests if p.message is not None and p.message.values.get(field.name) in found]
    yield Suspicion(
        "unit_or_sign", Confidence.LIKELY, [Trouble("unit_or_sign", p.offset, None, p) for p in pieces],
        f"The {field.name} is sent in {field.unit}, and the manual counts it in steps of {field.physical(1):g} {field.unit}.",
        f"{shown(piece.data)} at byte {piece.offset} says {value}, which is {field.physical(value):g} {field.unit}; "
        f"{counted(len(pieces), 'time')}",
        f"Multiply by {parts} before it is sent",
        tuple(Shown(p.offset, shown(p.data)) for p in pieces),
    )  # fmt: skip


_NUMBER = re.compile(r"\d+")
#: Units as people write them.
_UNITS = {"deg/s": r"(?:(?:deg\w*|°|grad)\s*(?:/|per|pro)\s*s|dps\b)", "deg": r"(?:deg|°|grad)"}
#: By how much a drive does less than was asked.
_LESS = re.compile(
    r"\b(\d+)(?: ?x| times|[- ]?fold|[- ]?fach) (?:too )?(?:slow|less|small|few|short|langsam|zu (?:langsam|klein|wenig))"
    r"|(?:\b1 ?/ ?(\d+)\b|\bfactor (?:of )?(\d+)\b)(?=[^.!?\n]{0,40}(?:slow|less|small|short|expected|asked|wanted))",
    re.IGNORECASE,
)


def _as_string(scene: Scene, words: str) -> Iterator[Suspicion]:
    """Suspect a program that handles its frames as strings, where some have a 00 that is not their last byte."""
    sent = {name for call in _SENDS.finditer(words) for name in _NAME.findall(call[1])} - {"sizeof"}
    found = next((call for call in _STRINGS.finditer(words) if not sent.isdisjoint(_NAME.findall(call[1]))), None)
    cut = [p for p in scene.pieces if p.can is None and b"\0" in p.data[:-1] and not p.is_reply]
    if found is None or not cut:
        return
    data = cut[0].data
    yield _as_text(
        scene,
        cut,
        "The program handles frames as strings: a string ends at its first 00, and the rest is not sent.",
        f"{found[0].strip(' )')!r} in the text; {shown(data)} at byte {cut[0].offset} ends as {shown(data[: data.index(0)])}",
        "Give the number of bytes to what copies and sends: sizeof of the array, memcpy, write(data, length)",
    )


def _as_digits(scene: Scene, words: str) -> Iterator[Suspicion]:
    """Suspect a program that prints its bytes, as digits, to the port from which it reads replies, and writes none to it."""
    words = _REMARK.sub("", words)
    written = {call[1] for call in _WRITES.finditer(words)}
    heard = {call[1] for call in _HEARS.finditer(words)}
    found = next((call for call in _PRINTS.finditer(words) if call[1] in heard - written), None)
    sent = [p for p in scene.pieces if p.can is None and p.is_request]
    if found is None or not sent or any(p.is_reply for p in scene.pieces):
        return
    data = sent[0].data
    yield _as_text(
        scene,
        sent,
        "The program prints its bytes as digits: letters go out in their place.",
        f"{found[0].strip()!r} in the text; {shown(data)} at byte {sent[0].offset}",
        f"Write the bytes themselves: {found[1]}.write(data, length)",
    )


def _as_text(scene: Scene, pieces: list[Piece], say: str, evidence: str, todo: str) -> Suspicion:
    """Return the suspicion that a program takes these pieces for text."""
    troubles = scene.troubles or [Trouble("damaged", pieces[0].offset, None, pieces[0])]
    frames = tuple(Shown(p.offset, shown(p.data)) for p in pieces)
    return Suspicion("text_mode", Confidence.LIKELY, troubles, say, evidence, todo, frames)


#: Calls of Arduino on a port: what prints an element of an array as digits, what writes, what hears; and remarks.
_PRINTS = re.compile(r"\b(\w+)\.print(?:ln)?\(\s*\w+\s*\[\w+\]\s*(?:,\s*(?:HEX|DEC|BIN|OCT)\s*)?\)")
_WRITES, _HEARS = re.compile(r"\b(\w+)\.write\("), re.compile(r"\b(\w+)\.(?:read\w*|available|peek)\(")
_REMARK = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)

#: Functions of C that take bytes as a string, and calls that send; each with what it is given.
_STRINGS = re.compile(r"\b(?:sn?printf\s*\((?=[^;\n]*\"%s\")|str(?:len|n?cpy|n?cat)\s*\()([^;\n]*)")
_NAME = re.compile(r"[A-Za-z_]\w*")
_SENDS = re.compile(r"\b\w*(?:write|send|transmit|print)(?:_?bytes|buffer)?\s*\(([^;\n]*)", re.IGNORECASE)


def _reported(scene: Scene, words: str) -> Iterator[Suspicion]:
    """Suspect what a library reports; bytes that are there tell more than its words."""
    found = list(reports(words))
    if {report.cause for report, _, _ in found} >= _EXCEPTIONS:
        return
    # Silence follows from any cause; what a bus shows besides it has a cause of its own.
    by_bytes = any(t.rule not in _SILENCE for t in scene.explained)
    left = [t for t in scene.troubles if t not in scene.explained] if by_bytes else []
    replied = any(p.is_reply and p.sound for p in scene.pieces)
    silent = not replied or scene.damaged or any(t.rule in _SILENCE for t in scene.troubles)
    came_damaged = [
        t for t in scene.damaged
        if not scene.directed or (t.stretch is not None and t.stretch.direction is not Role.UNKNOWN)
    ]  # fmt: skip
    for report, text, times in found:
        # Where each request has its reply, the program has lost it, and no drive is silent.
        if report.cause == "no_reply" and not silent:
            continue
        if report.cause in _OF_LINE and not came_damaged and (replied or _misread(scene, checks(words))):
            continue
        yield Suspicion(
            report.cause, Confidence.POSSIBLE if by_bytes else Confidence.LIKELY, left or scene.troubles,
            f"The library reports that {report.what}.",
            f"{text.strip()!r} in the text; {counted(times, 'time')}",
            report.next,
            by_words=by_bytes,
        )  # fmt: skip


def _misread(scene: Scene, compared: list[Checks]) -> bool:
    """Say whether all checks that failed are of the start of a sound frame: the library took it for a shorter one."""
    starts = {
        (modbus_crc(piece.data[:size]), int.from_bytes(piece.data[size : size + 2], "little"))
        for piece in scene.pieces if piece.sound and piece.can is None
        for size in range(2, len(piece.data) - 2)
    }  # fmt: skip
    return bool(compared) and starts.issuperset((each.meant, each.got) for each in compared)


#: Rules of findings that say that no reply came; causes of damaged replies.
_SILENCE, _OF_LINE = frozenset(("unanswered", "silent_address")), frozenset(("noise", "reply_cut"))


def _misfit(scene: Scene, said: str) -> Iterator[Suspicion]:
    """Suspect whose frame came instead of the reply: a request is that of another host, a reply that of a request before."""
    sound = [p for p in scene.pieces if p.message is not None and p.message.frame.checksum_ok and p.can is None]
    if len(sound) != 1 or len(scene.pieces) > 1:
        return
    piece = sound[0]
    troubles = [t for t in scene.troubles if t.piece is piece] or [Trouble("unsolicited_reply", piece.offset, None, piece)]
    where = f"{shown(piece.data)} at byte {piece.offset}; {said!r} in the text"
    if piece.is_request:
        yield Suspicion(
            "two_masters", Confidence.LIKELY, troubles, "What the host received is a request of another host.", where,
            "Let one host speak alone: disconnect the other, or have it ask through the first",
        )  # fmt: skip
    elif piece.is_reply and piece.data[1] in READS:
        yield Suspicion(
            "late_reply", Confidence.LIKELY, troubles, "The reply is sound, and answers another request than the last.", where,
            "Clear the input before each request and wait longer for a reply; see that no other program is at the port",
        )  # fmt: skip
