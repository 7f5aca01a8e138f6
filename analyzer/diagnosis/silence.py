"""No drive answers: which address is asked, in which dialect, and what was set before."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from msgspec.structs import replace

from analyzer.catalogue import Dialect, Risk, Role
from analyzer.diagnosis.addresses import addressed
from analyzer.diagnosis.can_frames import sent_again
from analyzer.diagnosis.exchanges import fragments, reported
from analyzer.diagnosis.reports import NOTHING_CAME, last_bytes
from analyzer.diagnosis.scene import Confidence, Piece, Scene, Shown, Stretch, Suspicion, Trouble, shown, whole
from analyzer.dialects import drive_name
from analyzer.encoder import build
from analyzer.layout import Effect
from analyzer.records import Message
from analyzer.values import counted, identifier

#: Requests without a reply, and their share, from which on a drive that answers others has fallen silent.
_AGAIN = 2
_OFTEN = 0.2
#: Requests without a reply behind all that came, of however many.
_STOPPED = 4
#: Silent addresses that are a search, and those that are named.
_SEARCHED, _SHOWN = 3, 8
#: Causes that several addresses have alike.
_ALIKE = frozenset(("no_reply", "wrong_address"))
#: Motion commands of which none is answered by no chance.
_NEVER = 3
#: Findings of a reply that refuses.
_FAILED = frozenset(("failed_status", "refused_write", "modbus_exception"))


class _Asked(NamedTuple):
    """The requests to one drive that were not answered."""

    dialect: Dialect
    address: int
    troubles: list[Trouble]


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect whom the host asks, and what the drive is set to."""
    answering: dict[int, str] = {}
    for piece in scene.pieces:
        if piece.message is not None and piece.message.role is Role.REPLY and "bad_checksum" not in piece.rules:
            answering.setdefault(piece.message.address, piece.message.frame.dialect.name)
    every = list(_unanswered(scene))
    yield from _together(
        (_who(a.dialect, a.address), each) for a in every for each in _unanswered_by_all(scene, a, answering, len(every) == 1)
    )
    if not answering:
        yield from _searched(scene, every)
    yield from _in_other_dialect(scene, answering)
    yield from _in_fragments(scene)
    for part in (_of_others, _reported, addressed, _respond, _switched_off):
        yield from part(scene)


def _who(dialect: Dialect, address: int) -> str:
    return identifier(address) if dialect.bus == "can" else str(address)


def _together(found: Iterable[tuple[str, Suspicion]]) -> Iterator[Suspicion]:
    """Yield one suspicion for all addresses that are silent for the same cause, as surely."""
    alike: dict[tuple[str, str], list[tuple[str, Suspicion]]] = defaultdict(list)
    for who, each in found:
        # What a setting has done is told of each drive by itself.
        alike[each.cause, each.confidence if each.cause in _ALIKE else who].append((who, each))
    for (_, first), *others in alike.values():
        if not others:
            yield first
            continue
        every = [first, *(each for _, each in others)]
        troubles = list(dict.fromkeys(trouble for each in every for trouble in each.troubles))
        also = ", ".join(who for who, _ in others[:_SHOWN]) + (" and more" if len(others) > _SHOWN else "")
        yield replace(
            first, troubles=troubles, say=f"{first.say} The same holds for {also}.",
            evidence=f"{first.evidence}; with those to {also}: {counted(len(troubles), 'request')}",
            frames=tuple(frame for each in every for frame in each.frames),
        )  # fmt: skip


def _in_other_dialect(scene: Scene, answering: dict[int, str]) -> Iterator[Suspicion]:
    """Suspect requests to a drive in a dialect in which the capture has so little that it was not chosen."""
    found: list[tuple[Trouble, Message]] = []
    for trouble in scene.damaged:
        stretch = trouble.stretch
        if stretch is None or stretch.can_id is not None or stretch.direction is Role.REPLY or trouble in scene.explained:
            continue
        reading = scene.reader.best(stretch.data, role=Role.REQUEST) if stretch.opens and stretch.ends else None
        asked = reading.message if reading is not None and reading.listed and reading.dialect not in scene.dialects else None
        if asked is not None and asked.role is Role.REQUEST and asked.address in answering:
            found.append((trouble, asked))
    # A document shows one of each.
    if len(found) < (_AGAIN if scene.noted and not scene.timed else 1):
        return
    trouble, asked = found[0]
    spoken, other = answering[asked.address], asked.frame.dialect.name
    yield Suspicion(
        "wrong_dialect", Confidence.CERTAIN if len(found) > 1 else Confidence.LIKELY, [t for t, _ in found],
        f"The host speaks {other} to address {asked.address}, and the drive speaks {spoken}.",
        f"{shown(asked.frame.data)} at byte {trouble.offset}; {counted(len(found), 'request')} without a reply",
        f"Speak {spoken} to it, or switch the drive over",
        tuple(Shown(t.offset, shown(m.frame.data)) for t, m in found),
    )  # fmt: skip


def _in_fragments(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the dialect where each request is answered by some of its own bytes, as by a drive in the other mode."""
    found = fragments(scene)
    if not found:
        return
    exchange, asked = found[0]
    dialect, came = asked.frame.dialect, exchange.data
    parts = {turn.offset for each, _ in found for turn in (each.request, *each.received)}
    yield Suspicion(
        "wrong_dialect", Confidence.LIKELY, [t for t in scene.troubles if t.offset in parts],
        f"The host speaks {dialect.name}, and some bytes of each request come back: the drive is in another mode.",
        f"{shown(came)} answers {shown(exchange.request.data)} at byte {exchange.request.offset}; "
        f"{counted(len(found), 'request')}, and nothing else comes",
        f"Ask the drive in {' or '.join(dialect.siblings) or 'another dialect'}, or switch it over in its menu; "
        "else look whether the adapter gives the host its own bytes",
        tuple(Shown(each.request.offset, shown(each.request.data)) for each, _ in found),
    )  # fmt: skip


def _unanswered(scene: Scene) -> Iterator[_Asked]:
    found: dict[tuple[str, int], _Asked] = {}
    for trouble in [*scene.of("unanswered", "other_dialect", "silent_address"), *scene.repeated]:
        message = trouble.piece.message if trouble.piece is not None else None
        if message is None:
            continue
        dialect = message.frame.dialect
        asked = found.setdefault((dialect.name, message.address), _Asked(dialect, message.address, []))
        asked.troubles.append(trouble)
    yield from found.values()


def _unanswered_by_all(scene: Scene, asked: _Asked, answering: dict[int, str], alone: bool) -> Iterator[Suspicion]:
    """Suspect what keeps an address silent. `alone`: no other is."""
    dialect, address = asked.dialect, asked.address
    who = _who(dialect, address)
    first = asked.troubles[0]
    assert first.piece is not None  # kept with its piece
    evidence = f"{whole(first.piece)} at byte {first.offset}; {counted(len(asked.troubles), 'request')} unanswered"
    frames = tuple(Shown(t.offset, whole(t.piece)) for t in asked.troubles if t.piece is not None)
    switched = _switched(scene, dialect, address)
    if switched is not None:
        setting, cause, what, todo = switched
        later = [t for t in asked.troubles if t.offset >= setting.offset]
        yield Suspicion(
            cause, Confidence.CERTAIN, later,
            f"The drive was {what} as before.",
            f"{whole(setting)} at byte {setting.offset} sets it; "
            f"{counted(len({t.offset for t in later}), 'request')} after it unanswered",
            todo,
            (Shown(setting.offset, whole(setting)), *frames),
        )  # fmt: skip
        return
    if address in answering:
        if answering[address] != dialect.name:
            yield Suspicion(
                "wrong_dialect", Confidence.CERTAIN, asked.troubles,
                f"The host speaks {dialect.name} to address {who}, and the drive speaks {answering[address]}.",
                f"{evidence}; its replies are {answering[address]}",
                f"Speak {answering[address]} to it, or switch the drive over",
                frames,
            )  # fmt: skip
        else:
            yield from _falls_silent(scene, asked, who)
        return
    # Damaged bytes may be the replies: what they come from says why none is read.
    if any(s.direction is not Role.REQUEST for s in scene.stretches):
        return
    # Where requests are damaged, too, and the cause is known, the silence follows from it.
    if sum(t.stretch is not None for t in scene.explained) >= _OFTEN * len(asked.troubles):
        return
    others = sorted(a for a, name in answering.items() if name == dialect.name)
    once = len(asked.troubles) == 1
    command = first.piece.message.command if first.piece.message is not None else None
    reads = command is not None and command.all_risks == {Risk.READ}
    shown_sent = scene.directed or first.piece.can is not None
    # A group, which is moved and never read, is silent by the manual.
    if others and ((once and not (alone and reads and shown_sent)) or scene.explained.issuperset(asked.troubles)):
        # Asked once, as a search for drives does; or so that no reply can come.
        return
    if others:
        there = ", ".join(identifier(a) if dialect.bus == "can" else str(a) for a in others[:4])
        # The same digits, read as hexadecimal and as decimal.
        digits = next((a for a in others if dialect.bus == "can" and f"{address:x}" == str(a)), None)
        if digits is not None:
            yield Suspicion(
                "can_wrong_id", Confidence.LIKELY, asked.troubles,
                f"No drive answers at identifier {who}; {there} does, which is {digits} in decimal digits.",
                f"{evidence}; replies come from {there}",
                f"Write identifiers in one way: {digits} is {identifier(digits)}, not {who}",
                frames,
            )  # fmt: skip
            return
        yield Suspicion(
            "wrong_address", Confidence.POSSIBLE if once else Confidence.LIKELY, asked.troubles,
            f"No drive answers at address {who}; {there} does.",
            f"{evidence}; replies come from {there}",
            f"Look up the address in the drive's menu, or ask {drive_name(dialect, others[0])}; if two drives are there, "
            f"check the wiring and the power of the silent one",
            frames,
        )  # fmt: skip
        return
    again = len(asked.troubles) > 1 and not _is_quoted(scene)
    if again and 2 * _unread(scene) >= len(asked.troubles):
        # Who sent what stands there cannot be told: it may be the replies.
        return
    if (again and not scene.listed) or (_is_one(scene) and _missed(scene)):
        yield Suspicion(
            "no_reply", Confidence.LIKELY if again else Confidence.POSSIBLE, asked.troubles,
            f"The requests to address {who} are right, and no drive answers.",
            evidence,
            _order(dialect, ours=any(t.piece is not None and _is_listed(t.piece) for t in asked.troubles)),
            frames,
        )  # fmt: skip


def _unread(scene: Scene) -> int:
    """Return how many lines of words have bytes that are none of those which were read."""
    known = b"".join(piece.data for piece in scene.pieces)
    return sum(bool(data := last_bytes(words)) and data not in known for words in scene.words)


def _searched(scene: Scene, every: list[_Asked]) -> Iterator[Suspicion]:
    """Suspect what keeps all drives silent where several addresses are asked once each, and words say that none answers."""
    if len(every) < _SEARCHED or any(len(asked.troubles) > 1 for asked in every) or len({a.dialect.name for a in every}) > 1:
        return
    damaged = any(s.direction is not Role.REQUEST for s in scene.stretches)
    if damaged or scene.explained or not (scene.shows_sent and scene.words and _missed(scene)):
        return
    dialect = every[0].dialect
    troubles = [trouble for asked in every for trouble in asked.troubles]
    addresses = ", ".join(identifier(a.address) if dialect.bus == "can" else str(a.address) for a in every[:_SHOWN])
    yield Suspicion(
        "no_reply", Confidence.LIKELY, troubles,
        f"{counted(len(every), 'address', 'addresses')} are asked, and no drive answers at any.",
        f"{whole(troubles[0].piece)} at byte {troubles[0].offset}; addresses {addresses}"
        + (" and more" if len(every) > _SHOWN else ""),
        _order(dialect, ours=any(t.piece is not None and _is_listed(t.piece) for t in troubles)),
        tuple(Shown(t.offset, whole(t.piece)) for t in troubles),
    )  # fmt: skip


def _of_others(scene: Scene) -> Iterator[Suspicion]:
    """Suspect what keeps a device of another protocol silent: one frame is sent again and again, and words miss its reply."""
    if not scene.words or not _missed(scene) or any(read.direction is Role.REPLY for read in scene.reads):
        return
    sent = [t for t in scene.damaged if t.stretch is not None and t.stretch.direction is Role.REQUEST]
    data, count = Counter(t.stretch.data for t in sent if t.stretch is not None).most_common(1)[0] if sent else (b"", 0)
    if count < _SEARCHED or len(sent) < len(scene.troubles):
        return
    first = next(t for t in sent if t.stretch is not None and t.stretch.data == data)
    yield Suspicion(
        "no_reply", Confidence.POSSIBLE, sent,
        "One frame, of a protocol that is not known here, is sent again and again, and nothing comes back.",
        f"{shown(data)} at byte {first.offset}; {counted(count, 'time')}",
        _order(scene.dialects[0], ours=False),
        tuple(Shown(t.offset, shown(t.stretch.data)) for t in sent if t.stretch is not None),
    )  # fmt: skip


def _is_quoted(scene: Scene) -> bool:
    """Say whether one frame stands twice among words, without a time: a text, or a program that prints it as text too."""
    return bool(scene.words) and not scene.timed and len(scene.pieces) <= _AGAIN and _is_one(scene)


def _is_one(scene: Scene) -> bool:
    """Say whether all that is there is one frame."""
    return len({piece.data for piece in scene.pieces}) == 1


#: Words of people who miss a reply.
_MISSED = re.compile(
    r"\b(?:no|not|never|nobody|none|cannot|without|zero|\w+n't)\b[^.!?\n]{0,60}?\b(?:re(?:spon|pl|act|ceiv|ad|turn|sult)\w*|"
    r"answer\w*|mov\w+|work\w*|communicat\w*|connect\w*|get\w*|data|happen\w*|turn\w*|back|luck|success)|"
    r"nothing(?! (?:changes|changed|else|special|wrong))|time[ds]?[ -]?out|fail|unanswered|\bsilen(?:ce|t(?! interval))|"
    r"stuck|unable|"
    r"nicht|kein|\bpas\b|[不没沒无無]|нет|\bне\b",
    re.IGNORECASE,
)
#: A case that is only thought of.
_SUPPOSED = re.compile(r"\beven if\b[^.!?\n]*", re.IGNORECASE)


def _missed(scene: Scene) -> bool:
    """Say whether a request that is all there is was sent, and its reply missed: bare bytes say that, or words beside them.

    A recording of the line may end there.
    """
    bare = not scene.words and (scene.shows_sent or not scene.timed)
    return bare or any(pattern.search(_SUPPOSED.sub("", words)) for words in scene.words for pattern in (_MISSED, NOTHING_CAME))


def _falls_silent(scene: Scene, asked: _Asked, who: str) -> Iterator[Suspicion]:
    """Suspect the line or the power where a drive answers at times; or its firmware, where it never answers one command."""
    if any(s.direction is not Role.REQUEST for s in scene.stretches):
        return
    left = [t for t in asked.troubles if t not in scene.explained and t.rule == "unanswered"]
    of_drive = [
        p for p in scene.pieces
        if p.is_request and p.message is not None and p.message.address == asked.address
        and p.message.frame.dialect is asked.dialect
    ]  # fmt: skip
    replies = [p.offset for p in scene.pieces if p.is_reply and p.message is not None and p.message.address == asked.address]
    stops = bool(replies) and bool(left) and max(replies) < left[0].offset
    if len(left) < _AGAIN or len(left) < min(_OFTEN * len(of_drive), _STOPPED if stops else len(of_drive)):
        return
    silent = {t.piece.sequence for t in left if t.piece is not None}
    good = {p.data for p in of_drive if p.sequence not in silent}
    first = left[0]
    yield Suspicion(
        "no_reply", Confidence.LIKELY if stops else Confidence.POSSIBLE, left,
        f"Address {who} has answered, and then stops." if stops else f"Address {who} answers at times, and at times not.",
        f"{whole(first.piece)} at byte {first.offset} has no reply; {counted(len(left), 'request')} of {len(of_drive)}"
        + ("" if stops or first.piece is None or first.piece.data not in good else ", and the same request is answered, too"),
        "Look for what changed: power, a loose wire, a stall or a restart of the drive, another program at the port; then wait "
        "longer for replies and between requests",
        tuple(Shown(t.offset, whole(t.piece)) for t in left),
    )  # fmt: skip


def _switched(scene: Scene, dialect: Dialect, address: int) -> tuple[Piece, str, str, str] | None:
    """Return the setting after which a drive answers no more as it was asked: its cause, what it did, and what to do."""
    again = sent_again(scene)
    replies = {p.asked_by: p for p in scene.pieces if p.is_reply and p.asked_by is not None and p not in again}
    for at in range(len(scene.pieces) - 1, -1, -1):
        piece = scene.pieces[at]
        message = piece.message
        if message is None or message.command is None or not piece.is_request or not message.command.effects:
            continue
        own = replies.get(piece.sequence)
        if message.address != address or message.frame.dialect is not dialect or (own is not None and own.rules & _FAILED):
            continue
        after = [
            p for p in scene.pieces[at + 1 :]
            if p is not own and p.message is not None and p.message.address == address and p.message.frame.dialect is dialect
        ]  # fmt: skip
        # One that is not answered itself counts where the drive has answered before.
        before = own is not None or any(p.is_reply and p.message and p.message.address == address for p in scene.pieces[:at])
        if not before or any(p.is_reply and p not in again for p in after) or not any(p.is_request for p in after):
            continue
        for effect, name in message.command.effects.items():
            found = _effect(dialect, effect, message.values.get(name), _who(dialect, address))
            if found is not None and not (effect is Effect.ADDRESS and message.values.get(name) == address):
                return piece, *found
    return None


def _effect(dialect: Dialect, effect: Effect, value: int | None, who: str) -> tuple[str, str, str] | None:
    """Return what a setting does to who answers: the cause of the silence, what was done, and what to do."""
    if value is None:
        return None
    if effect is Effect.ADDRESS:
        return "address_changed", f"given the address {value}, and is still asked at {who}", f"Ask {drive_name(dialect, value)}"
    if effect is Effect.DIALECT and (other := dialect.switched(value)) != dialect.name:
        return "wrong_dialect", f"switched to {other}, and is still asked in {dialect.name}", f"Speak {other} to it"
    if effect is Effect.BAUD_RATE and value in dialect.rates:
        rate = dialect.rates[value]
        cause = "can_wrong_bitrate" if dialect.bus == "can" else "wrong_baud"
        return cause, f"set to {rate} bit/s, and is still asked at another speed,", f"Open the port at {rate} bit/s"
    return None


def _is_listed(piece: Piece) -> bool:
    """Say whether a request is of a command that the manual of the drives has."""
    message = piece.message
    return message is not None and message.command not in (None, *message.frame.dialect.fallbacks.values())


def _order(dialect: Dialect, *, ours: bool) -> str:
    """Return what to try where the bytes cannot tell, in this order. `ours`: nothing asked for is foreign to the manual."""
    if not ours:
        return (
            "Try in this order: the device's power, and a common ground, then A and B swapped, then the speed, the format and "
            "the address that its manual names; `servotap scan PORT` tries speeds and addresses by itself"
        )
    tried = ["the drive's power, and a common ground"]
    if dialect.bus == "can":
        tried += ["CAN_H and CAN_L swapped, and 120 Ohm at both ends", "the bit rate in the drive's menu"]
    else:
        tried += ["A and B swapped", f"the baud rate in the drive's menu (the default is {dialect.baud_rates[0]})"]
    tried.append("the address in the drive's menu")
    if dialect.siblings:
        tried.append(f"the dialect: the drive may be set to {' or '.join(dialect.siblings)}")
    return f"Try in this order: {', then '.join(tried)}; `servotap scan PORT` tries speeds, addresses and dialects by itself"


#: The codes of a library's report, with the cause that each stands for.
_REPORTS = {
    0xE0: ("no_reply", "no reply came in time"),
    0xE1: ("wrong_address", "the reply came from another address"),
    0xE2: ("noise", "the CRC of the reply was wrong"),
    0xE3: ("late_reply", "the reply was of another function"),
    0xE4: ("wrong_address", "the reply came from another address"),
    0xE5: ("reply_cut", "the reply had another length"),
}


def _reported(scene: Scene) -> Iterator[Suspicion]:
    """Suspect what a library reports: it logs requests without their CRC, and a code where the reply should stand."""
    found: dict[int, list[tuple[Stretch, Stretch]]] = defaultdict(list)
    for sent, came in reported(scene):
        found[came.data[0]].append((sent, came))
    for code, every in found.items():
        # The bytes that came tell more than the library's code for them.
        pairs = [(a, b) for a, b in every if not any(a.stop <= t.offset < b.offset for t in scene.explained)]
        if not pairs:
            continue
        cause, what = _REPORTS[code]
        sent, came = pairs[0]
        limits = [(one.offset, other.stop) for one, other in pairs]
        yield Suspicion(
            cause, Confidence.LIKELY, [t for t in scene.troubles if any(a <= t.offset < b for a, b in limits)],
            f"The host's library reports {code:02X}: {what}. Its log leaves the CRC out.",
            f"{shown(came.data)} behind {shown(sent.data)} at byte {sent.offset}; {counted(len(pairs), 'time')}",
            "Try in this order: A and B swapped, speed and parity, the unit's address, its power; a log of the raw bytes "
            "(LOG_LEVEL_VERBOSE) shows more",
            tuple(Shown(one.offset, shown(one.data)) for one, _ in pairs),
        )  # fmt: skip


def _respond(scene: Scene) -> Iterator[Suspicion]:
    # A document shows requests without their replies.
    if scene.noted and not scene.timed:
        return
    answering = {p.message.address for p in scene.pieces if p.is_reply and p.message is not None}
    troubles = [t for t in scene.of("silent_address") if t.piece is not None] or list(_silenced(scene))
    for trouble in troubles:
        message = trouble.piece.message if trouble.piece is not None else None
        if message is None or trouble.piece is None:
            continue
        dialect, address = message.frame.dialect, message.address
        setting = dialect.effect(Effect.RESPOND)
        if address not in answering or setting is None:
            continue
        command, field = setting
        active = command.sets(Effect.ACTIVE)
        right = build(dialect, command, address, {field.name: 1, **({active: 1} if active else {})})
        frame = shown(right, dialect.link.identifier(command, address))
        yield Suspicion(
            "respond_off", Confidence.LIKELY, [trouble],
            f"Address {message.who} answers reads and no motion command: respond is off.",
            f"{whole(trouble.piece)} at byte {trouble.offset} has no reply, and reads do",
            f"Switch replies on: send {frame}; if it is a group address, no reply is right (--group {address})",
            (Shown(trouble.offset, whole(trouble.piece), frame),),
        )  # fmt: skip


def _switched_off(scene: Scene) -> Iterator[Suspicion]:
    """Suspect replies that are switched off where the capture has little more than the setting that does it.

    On CAN the request without its second value looks like a reply, so that both are taken.
    """
    if len(scene.pieces) > _FEW or scene.noted:
        return
    for piece in scene.pieces:
        message = piece.message
        if message is None or message.command is None or piece.asked_by is not None or "bad_checksum" in piece.rules:
            continue
        dialect, command = message.frame.dialect, message.command
        setting = dialect.effect(Effect.RESPOND)
        if setting is None or setting[0] is not command:
            continue
        looks_like_reply = dialect.bus == "can" and len(message.data) == 1
        if message.values.get(setting[1].name, message.data[0] if looks_like_reply else 1):
            continue
        active = command.sets(Effect.ACTIVE)
        right = build(dialect, command, message.address, {setting[1].name: 1, **({active: 1} if active else {})})
        frame = shown(right, dialect.link.identifier(command, message.address))
        yield Suspicion(
            # The frame shows the setting. That replies are missed, only words can show.
            "respond_off", Confidence.CERTAIN if scene.words else Confidence.LIKELY,
            [t for t in scene.troubles if t.offset >= piece.offset],
            f"Address {message.who} is told to answer no motion command: respond is set to 0.",
            f"{whole(piece)} at byte {piece.offset}",
            f"Switch replies on: send {frame}",
            (Shown(piece.offset, whole(piece), frame),),
        )  # fmt: skip
        return


#: Frames of a capture that is about one of them.
_FEW = 4


def _silenced(scene: Scene) -> Iterator[Trouble]:
    """Yield the first motion command without a reply behind a setting that switches replies off: the pipeline expects that.

    Or the first to a drive of which none is ever answered. No drive takes one that is wrong itself.
    """
    off: set[tuple[str, int]] = set()
    answered = {piece.asked_by for piece in scene.pieces if piece.is_reply}
    sent: dict[tuple[str, int], list[Piece]] = defaultdict(list)
    for piece in scene.pieces:
        message = piece.message
        if message is None or message.command is None or not (piece.is_request and piece.sound):
            continue
        drive = (message.frame.dialect.name, message.address)
        if message.command.silenced:
            sent[drive].append(piece)
        value = message.values.get(message.command.sets(Effect.RESPOND))
        if value is not None and piece.sequence in answered:
            (off.discard if value else off.add)(drive)
        elif drive in off and message.command.silenced and piece.sequence not in answered:
            yield Trouble("silent_address", piece.offset, None, piece)
            return
    # Without times each closes the one before it.
    never = (pieces[0] for pieces in sent.values() if len(pieces) >= _NEVER and all(p.sequence not in answered for p in pieces))
    for piece in never:
        yield Trouble("silent_address", piece.offset, None, piece)
