"""Requests whose bytes are right but for their check: forgotten, or computed by another rule.

A rule is named where it gives the checks of two different requests, or one check of 16 bits. One sum of 8 bits counts where
its sender got no other right.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections import Counter, defaultdict
from collections.abc import Iterator

from msgspec.structs import replace

from analyzer.catalogue import Role
from analyzer.diagnosis.check_rules import ORDER, RULES, Rule
from analyzer.diagnosis.exchanges import awaited, reported
from analyzer.diagnosis.failing import READ_SIZE, Failing, failing_by_check, is_plain, is_write
from analyzer.diagnosis.reader import Reader
from analyzer.diagnosis.scene import Confidence, Piece, Scene, Shown, Suspicion, Trouble, shown
from analyzer.link import LAST_UNIT, REGISTER_READS, modbus_crc
from analyzer.values import counted

#: A frame that differs from a right one by fewer bits may be that one, damaged; and right ones that are compared.
_LEAST_BITS = 2
_LOOKED_AT = 200
#: Head, address and code, of which no field can lack.
_HEAD = 4
#: Different replies that a rule must fit.
_RULED = 2
#: A frame of CAN with a sum and no field.
_SHORT_CAN = 2
#: How programs print the number of bytes they sent.
_WRITTEN = re.compile(r"\b(?:written|wrote|sent|write)\b\D{0,12}?(\d{1,3}) bytes?\b", re.IGNORECASE)


def look(scene: Scene) -> Iterator[Suspicion]:
    """Suspect the host's checks."""
    failing = [found for t in scene.damaged if t.stretch is not None and (found := failing_by_check(scene, t, t.stretch))]
    # What a library logs bare is sent with its check.
    bare = {sent.offset for sent, _ in reported(scene)}
    # What comes back with its check was sent with it.
    whole = {p.data for p in scene.pieces if p.sound}
    missing = [
        each for each in failing
        if each.size == 0 and each.trouble.offset not in bare and each.right not in whole
    ]  # fmt: skip
    # A drive answers no request without its check: one that is answered shows that the log leaves the checks out. So does a
    # log that counts more bytes than it prints.
    sizes = {int(found) for words in scene.words for found in _WRITTEN.findall(words)}
    if any(_answered(scene, each) or len(each.right) in sizes - {len(each.data)} for each in missing):
        replied = any(p.is_reply and p.sound for p in scene.pieces)
        scene.explained.update(
            t for t in scene.damaged if t.stretch is not None and not replied and scene.reader.bare(t.stretch.data)
        )
        scene.explained.update(each.trouble for each in missing)
        missing = []
    wrong = [each for each in failing if each.size]
    # A write of any register could be anything by itself: two of one unit, or one that answers, are no chance.
    writes = {each.right for each in wrong if is_write(each.right)}
    units = Counter(right[0] for right in writes)
    there = {p.message.address for p in scene.pieces if p.is_reply and p.sound and p.message is not None}
    wrong = [f for f in wrong if f.rules or f.right not in writes or units[f.right[0]] > 1 or f.right[0] in there]
    # One that is right shows that the host can: what fails then is a damaged frame, unless a rule says how.
    sound = [
        p for p in scene.pieces
        if p.is_request and p.sound and "bad_checksum" not in p.rules and scene.direction(p.offset) is not Role.REPLY
    ]  # fmt: skip
    sent = [f for f in wrong if f.trouble.stretch is not None and f.trouble.stretch.direction is Role.REQUEST]
    # Noise hits something else, too, or a frame like those that got through.
    alone = len(wrong) == len(scene.damaged)
    unsure, of_program = False, wrong == sent and (alone or not scene.timed)
    if (of_program or alone) and not _resemble(wrong, sound):
        # What a program or its log shows as sent was sent so: no line has damaged it.
        unsure, sound = bool(sound) and not of_program, []
    kept = _deliberate([each for each in missing if not _summed(each)], sound)
    # No chance takes the same byte of different requests, and no line takes one of those that a program shows as sent.
    whole_but_sum = [each for each in missing if each.is_counted or (_is_sent(each) and not _summed(each))]
    kept = whole_but_sum if not kept and len({each.right for each in whole_but_sum}) > 1 else kept
    if short := [each for each in missing if each not in kept and (_summed(each) or _sent_short(each))]:
        first = short[0]
        yield Suspicion(
            "wrong_length", Confidence.LIKELY, [each.trouble for each in short],
            f"The host's request {first.name} is a byte short: a field is not whole"
            + (", and its sum is there." if _summed(first) else ", or its sum is missing."),
            f"{shown(first.data)} at byte {first.trouble.offset} has {counted(len(first.data), 'byte')}, and the manual "
            f"{len(first.right)}; {counted(len(short), 'time')}",
            f"Send all fields of the command: `servotap catalogue {first.name}` lists them",
            tuple(Shown(each.trouble.offset, shown(each.data)) for each in short),
        )  # fmt: skip
    # One that is short lacks a field or its sum.
    if missing := kept or [each for each in short if not _summed(each)]:
        confidence = Confidence.POSSIBLE if not kept else Confidence.CERTAIN if len(missing) > 1 else Confidence.LIKELY
        half = missing[0].trouble.stretch is not None and len(missing[0].trouble.stretch.data) + 1 == len(missing[0].right)
        what = "the last byte of its checksum" if half and len(missing[0].right) > READ_SIZE - 1 else "its checksum"
        yield _said("missing_checksum", confidence, missing, f"is sent without {what}", "Put the whole checksum behind it")
    named = _named(wrong, bool(sound))
    for rule, each in named.items():
        sure = len({f.right for f in each}) > 1 or rule.strong
        confidence = Confidence.CERTAIN if sure else Confidence.LIKELY
        todo = "Set both sides to 8N1" if rule.cause == "wrong_parity" else "Compute the check as the manual says"
        yield _said(rule.cause, confidence, each, f"carries {rule.name}", todo)
    taken = {f.trouble for each in named.values() for f in each}
    if rest := _deliberate([f for f in wrong if f.trouble not in taken], sound):
        again = len(rest) > len({f.right for f in rest})
        yield _said(
            "wrong_checksum", Confidence.LIKELY if again or not (sound or unsure) else Confidence.POSSIBLE, rest,
            "has a checksum that is not the manual's", "Replace the check",
        )  # fmt: skip
    yield from _of_replies(scene)
    yield from _again_without_end(scene)


def of_program(scene: Scene) -> Iterator[Suspicion]:
    """Suspect whole frames in the text of a program: one without a check, or with a place for it, gets it before it is sent."""
    for each in look(scene):
        wrong = each.cause in _OF_WHOLE and any(frame.data[-2:] not in _PLACES for frame in each.frames)
        if wrong:
            yield replace(each, confidence=Confidence.POSSIBLE if each.cause == "wrong_checksum" else Confidence.LIKELY)


#: Causes of frames that have a check, and the bytes that keep a place for one.
_OF_WHOLE, _PLACES = ("wrong_checksum", "wrong_checksum_rule", "crc_swapped"), ("00", "FF")


def _again_without_end(scene: Scene) -> Iterator[Suspicion]:
    """Suspect a request to read that comes again and again in one piece, each time without the last byte of its CRC."""
    for trouble in scene.damaged:
        data = trouble.stretch.data if trouble.stretch is not None and trouble not in scene.explained else b""
        size = READ_SIZE - 1
        if len(data) < 2 * size or data[size:] != data[:-size]:
            continue
        for at in range(size):
            body = data[at : at + size - 1]
            right = body + modbus_crc(body).to_bytes(2, "little")
            if right[:-1] == data[at : at + size] and 0 < right[0] <= LAST_UNIT and is_plain(right):
                yield Suspicion(
                    "missing_checksum", Confidence.LIKELY, [trouble],
                    "The request is sent again and again without the last byte of its CRC.",
                    f"{shown(right[:-1])} at byte {trouble.offset + at}; {counted((len(data) - at) // size, 'time')} in a row",
                    f"Send all {READ_SIZE} bytes of the request: {shown(right)}",
                    (Shown(trouble.offset + at, shown(right[:-1]), shown(right)),),
                )  # fmt: skip
                return


def _of_replies(scene: Scene) -> Iterator[Suspicion]:
    """Suspect a device whose replies carry a check of another rule.

    The CRC high byte first is 16 bits that fit, which is no chance. Any other rule must fit two different replies.
    """
    found: dict[Rule, list[tuple[Trouble, bytes, bytes]]] = defaultdict(list)
    came = 0
    for trouble in scene.damaged:
        stretch = trouble.stretch
        if stretch is None or stretch.direction is not Role.REPLY or stretch.can_id is not None or trouble in scene.explained:
            continue
        came += 1
        rule, right = _rule_of(scene.reader, stretch.data) if stretch.opens and stretch.ends else (None, b"")
        if rule is not None:
            found[rule].append((trouble, stretch.data, right))
    for rule, rows in found.items():
        turned = rule.cause == "crc_swapped"
        if not turned and (len({data for _, data, _ in rows}) < _RULED or 2 * len(rows) < came):
            continue
        first, data, right = rows[0]
        yield Suspicion(
            rule.cause if turned else "firmware_quirk", Confidence.CERTAIN if len(rows) > 1 else Confidence.LIKELY,
            [t for t, _, _ in rows],
            f"The reply carries {rule.name}: the device itself makes it so.",
            f"{shown(data)} at byte {first.offset}; right is {shown(right)}; {counted(len(rows), 'time')}",
            "Look for newer firmware of the device; until then let the host take both checks from this device alone",
            tuple(Shown(t.offset, shown(d), shown(r)) for t, d, r in rows),
        )  # fmt: skip


def _rule_of(reader: Reader, data: bytes) -> tuple[Rule | None, bytes]:
    """Return the rule by which the check of a whole reply was made, and the reply with the right one."""
    for rule in RULES:
        size = len(rule.of(data, 0))
        body = data[:-size]
        if len(body) <= size or rule.cause == "wrong_parity" or rule.of(body, 0) != data[-size:]:
            continue
        if rule.cause == "crc_swapped":
            return rule, body + data[: -size - 1 : -1]
        for dialect in reader.dialects:
            right = dialect.link.completed(body)
            reading = reader.best(right, role=Role.REPLY) if right != data else None
            if reading is not None and reading.listed:
                return rule, right
    return None, b""


def _summed(failing: Failing) -> bool:
    """Say whether the last byte is the sum of those before: then the sum is there, and a byte of the fields is not."""
    data, stretch = failing.data, failing.trouble.stretch
    can_id = stretch.can_id if stretch is not None else None
    # A frame of CAN is not cut on its way; its sum is that of its identifier, too. So with a log where each has its line.
    alone = stretch is not None and stretch.opens and stretch.ends
    short = alone and _is_short(failing) if can_id is None else len(failing.right) == len(data) + 1 > _SHORT_CAN
    return short and (sum(data[:-1]) + (can_id or 0)) & 0xFF == data[-1]


def _sent_short(failing: Failing) -> bool:
    """Say whether the host has sent a serial request that is a byte short, and has fields."""
    stretch = failing.trouble.stretch
    return stretch is not None and stretch.can_id is None and stretch.direction is Role.REQUEST and _is_short(failing)


def _is_sent(failing: Failing) -> bool:
    """Say whether the capture shows a serial request as the host has sent it, in one piece."""
    stretch = failing.trouble.stretch
    return stretch is not None and stretch.direction is Role.REQUEST and stretch.opens and stretch.ends


def _is_short(failing: Failing) -> bool:
    """Say whether a request with fields lacks a byte, which its head does not tell to be the sum."""
    data = failing.data
    return len(failing.right) == len(data) + 1 and len(data) > _HEAD and not failing.is_counted


def _answered(scene: Scene, failing: Failing) -> bool:
    """Say whether the drive answers a request without its check: by the right reply, also without its check, or otherwise."""
    reading, stretch = scene.reader.best(failing.right), failing.trouble.stretch
    at = bisect_left(scene.bursts, stretch.stop, key=lambda burst: burst.offset) if stretch is not None else len(scene.bursts)
    behind = scene.bursts[at] if at < len(scene.bursts) else None
    if reading is None or behind is None or behind.direction is Role.REQUEST:
        return False
    # A reply that begins as the right one is an answer, too.
    begun = behind.direction is Role.REPLY and len(behind.data) > _HEAD and behind.data[1] in REGISTER_READS
    if begun and any(reply.begins(behind.data) for reply in awaited(reading.message)):
        return True
    if any(
        reply.stands(each, 0) for reply in awaited(reading.message) for each in (behind.data, reply.link.completed(behind.data))
    ):
        return True
    came = scene.reader.best(behind.data, role=Role.REPLY)
    return came is not None and came.message.address == reading.message.address


def _deliberate(failing: list[Failing], sound: list[Piece]) -> list[Failing]:
    """Return the frames that fail by design and not by chance.

    That is all of them, one that fails again and is never right, or several that keep the check of one frame.
    """
    if not sound:
        return failing
    right = {piece.data for piece in sound}
    again = Counter(f.right for f in failing)
    kept = Counter(_kept(f) for f in {f.right: f for f in failing}.values())
    noise = any(_bits(piece.data, f.right) < _LEAST_BITS for f in failing for piece in sound[:_LOOKED_AT])
    return [
        f for f in failing
        if f.right not in right and (again[f.right] > 1 or (f.size and kept[_kept(f)] > 1 and not noise))
    ]  # fmt: skip


def _resemble(failing: list[Failing], sound: list[Piece]) -> bool:
    """Say whether most requests are right, and those that fail differ from one of them by few bits: a listener's log."""
    known = {piece.data for piece in sound[:_LOOKED_AT]}
    return len(sound) > len(failing) and all(any(_bits(f.data, each) <= _LEAST_BITS for each in known) for f in failing)


def _kept(failing: Failing) -> tuple[bytes, bytes]:
    """Return head, address and code of a frame, and the check that it has."""
    data = failing.data
    return failing.right[:3], data[len(data) - failing.size :]


def _bits(one: bytes, other: bytes) -> int:
    """Return how many bits two frames differ in, apart from their last byte; many where their lengths differ."""
    if len(one) != len(other):
        return 8 * len(one)
    return sum((a ^ b).bit_count() for a, b in zip(one[:-1], other[:-1], strict=True))


def _named(wrong: list[Failing], some_right: bool) -> dict[Rule, list[Failing]]:
    fitting: dict[Rule, list[Failing]] = defaultdict(list)
    for failing in wrong:
        for rule in failing.rules:
            fitting[rule].append(failing)
    named: dict[Rule, list[Failing]] = {}
    kept = Counter(_kept(f) for f in {f.right: f for f in wrong}.values())
    left = {id(f) for f in wrong}
    for rule in sorted(fitting, key=lambda r: (-len(fitting[r]), ORDER[r])):
        own = [f for f in fitting[rule] if id(f) in left]
        different = len({f.right for f in own})
        # A check that other frames have as well was not computed.
        stale = different == 1 and not rule.strong and kept[_kept(own[0])] > 1
        if different > 1 or (own and not stale and (rule.strong or not some_right or len(own) > 2)):
            named[rule] = own
            left -= {id(f) for f in own}
    return named


def _said(cause: str, confidence: Confidence, failing: list[Failing], what: str, todo: str) -> Suspicion:
    first = failing[0]
    stretch = first.trouble.stretch
    assert stretch is not None  # only damaged bytes fail by their check
    got, right = shown(stretch.data, stretch.can_id), shown(first.right, stretch.can_id)
    frames = tuple(
        Shown(f.trouble.offset, shown(f.trouble.stretch.data, stretch.can_id), shown(f.right, f.trouble.stretch.can_id))
        for f in failing
        if f.trouble.stretch is not None
    )
    names = ", ".join(dict.fromkeys(f.name for f in failing))
    return Suspicion(
        cause, confidence, [f.trouble for f in failing],
        f"The host's request {names} {what}, so no drive takes it.",
        f"{got} at byte {first.trouble.offset}; right is {right}; {counted(len(failing), 'time')}",
        f"{todo}: send {right}",
        frames,
    )  # fmt: skip
