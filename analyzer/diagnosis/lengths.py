"""Frames whose length is not that of their command, or not the one that they tell: short, filled up, or with a wrong count."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice, pairwise

from analyzer.catalogue import Role
from analyzer.diagnosis.exchanges import replies_to
from analyzer.diagnosis.scene import Confidence, Scene, Shown, Stretch, Suspicion, Trouble, shown
from analyzer.link import LAST_UNIT, READS, REGISTER_READS, modbus_crc
from analyzer.values import counted

#: Zeros behind a frame that are no glitch.
_PADDING = 4
#: Where functions have their count of bytes, in a request or in a reply; and the size of their frames that have none.
_COUNTS = {**dict.fromkeys((0x0F, 0x10), (6,)), 0x11: (2,), 0x0C: (2,), 0x17: (2, 10)}
_UNCOUNTED = {**dict.fromkeys((0x0F, 0x10), 8), **dict.fromkeys((0x0C, 0x11), 4)}
#: What answers a write, a request of nothing but its function, the shortest frame and the longest.
_ANSWER, _BARE, _SHORTEST, _LONGEST = 8, 4, 5, 256


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect lengths and counts."""
    yield from islice(_short(scene), 1)
    yield from _padded(scene)
    yield from _promised(scene)
    yield from _miscounted(scene)
    yield from _other_quantity(scene)


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
    reads = [
        p for p in scene.pieces if p.is_request and p.can is None and len(p.data) == _ANSWER and p.data[1] in REGISTER_READS
    ]
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
    if modbus_crc(data) == 0 and modbus_crc(data[:-1]) != 0 and data[0] <= LAST_UNIT:
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
