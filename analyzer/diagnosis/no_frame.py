"""Bytes of which nothing is a frame: whether a wrong setting of the receiver made them, or another protocol."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from functools import reduce
from itertools import dropwhile, takewhile

from analyzer.diagnosis.scene import Confidence, Shown, Suspicion, shown
from analyzer.diagnosis.ways import ALIKE, DIFFERENT, FEWEST, Garbled
from analyzer.link.modbus import modbus_crc
from analyzer.values import counted

#: Bytes of which one in so many differs from the others, and the most different ones: a protocol whose frames repeat has more.
_MANY, _MOST_DIFFERENT = 5, 12
#: Bits that are high in what noise makes of an idle line.
_IDLE_BITS = 6
#: Where frames repeat, so many of what is read begin with the same byte; and so many checks fit where it is a protocol.
_BEGIN_ALIKE, _CHECKED = 0.6, 0.5
#: Characters of bytes that are text with a head or a tail.
_READABLE = 0.6
_WORD = re.compile(rb"[A-Za-z]{4}")
_PRINTED = frozenset(b"\t\n\r") | frozenset(range(0x20, 0x7F))
#: Checks that many protocols have.
_CHECKS: tuple[Callable[[bytes], bool], ...] = (
    lambda data: sum(data[:-1]) & 0xFF == data[-1],
    lambda data: sum(data[1:-1]) & 0xFF == data[-1],
    lambda data: not reduce(int.__xor__, data),
    lambda data: modbus_crc(data) == 0,
)


def same_line_noise(garbled: Sequence[Garbled], *, repeats: bool) -> bool:
    """Say whether bytes come from frames on a wrong line, though none is found: they repeat, and are no other protocol."""
    stretches = [each.data for each in garbled]
    if all(byte in _PRINTED for data in stretches for byte in data):
        return False
    if any(data[0] == reply.head[0] or reply.with_head(data) for _, data, replies in garbled for reply in replies):
        return False
    if _of_few_bytes(b"".join(stretches)):
        return True
    stretches = [data for data in stretches if len(data) > ALIKE]
    # The same frame becomes the same bytes each time.
    if not repeats or len(stretches) < FEWEST or _framed(stretches):
        return False
    most = Counter(data[0] for data in stretches).most_common(1)[0][1]
    # A wake-up may stand before the frame, and an end behind its check.
    awake = [data.lstrip(b"\xfe\xff") for data in stretches]
    ways = (stretches, awake, [data[:-1] for data in awake])
    return most >= max(FEWEST, _BEGIN_ALIKE * len(stretches)) and not any(
        sum(len(data) > ALIKE and check(data) for data in way) >= _CHECKED * len(stretches) for way in ways for check in _CHECKS
    )


def _framed(stretches: Sequence[bytes]) -> bool:
    """Say whether different bytes have one head and one tail, or readable text: a protocol that is read as it was sent."""
    distinct = set(stretches)
    first, last = {data[:1] for data in distinct}, {data[-1:] for data in distinct}
    text = sum(byte in _PRINTED for data in distinct for byte in data)
    one_frame = len(distinct) > 1 and len(first) == len(last) == 1 and min(map(len, distinct)) > DIFFERENT
    words = sum(_WORD.search(data) is not None for data in distinct)
    # Frames of one command, whose values differ: so much of their beginnings no two requests of a host have in common.
    by_size = [[data for data in distinct if len(data) == size] for size in set(map(len, distinct))]
    alike = any(len(rows) > 1 and len(set(_common_beginning(rows))) > DIFFERENT for rows in by_size)
    counted_up = any(len(rows) >= FEWEST and _fixed_behind_changing(rows) for rows in by_size)
    return one_frame or alike or counted_up or words > len(distinct) / 2 or text >= _READABLE * sum(map(len, distinct))


def _fixed_behind_changing(rows: Sequence[bytes]) -> bool:
    """Say whether bytes differ at a place and are the same at places behind it, as the fields of whole frames are."""
    fixed = [len(set(column)) == 1 for column in zip(*rows, strict=True)]
    return sum(dropwhile(bool, fixed)) > ALIKE


def _common_beginning(rows: Sequence[bytes]) -> bytes:
    """Return the bytes with which all rows begin."""
    return bytes(column[0] for column in takewhile(lambda column: len(set(column)) == 1, zip(*rows, strict=True)))


def no_reply_at_all(garbled: Sequence[Garbled]) -> bool:
    """Say whether what comes at once behind each request has nothing of a reply: no byte of its head, no letters, no check."""
    return all(
        len(data) >= FEWEST
        and bool(replies)
        and not any(byte in data for reply in replies for byte in reply.head[:ALIKE])
        and not any(reply.with_head(data) for reply in replies)
        and not all(byte in _PRINTED for byte in data)
        and not all(byte.bit_count() >= _IDLE_BITS for byte in data)
        and not any(check(data) for check in _CHECKS)
        for _, data, replies in garbled
    )


def _of_few_bytes(data: bytes) -> bool:
    """Say whether many bytes are the same few, which are not those of an idle line."""
    different = set(data)
    idle = sum(byte.bit_count() >= _IDLE_BITS for byte in data) > len(data) / 2
    return len(data) >= _MANY and _MANY * len(different) <= len(data) and len(different) <= _MOST_DIFFERENT and not idle


def unknown(garbled: Sequence[Garbled]) -> Suspicion:
    """Return the suspicion of a wrong setting where the bytes cannot tell which."""
    first = garbled[0]
    return Suspicion(
        "wrong_baud", Confidence.POSSIBLE, [each.trouble for each in garbled],
        "Nothing that comes is a frame, or has a byte of one: the receiver is set up otherwise than the sender, most likely "
        "to another speed.",
        f"{shown(first.data)} at byte {first.trouble.offset}; {counted(len(garbled), 'time')}, and no whole frame",
        "The bytes cannot tell which; try in this order: the speed (`servotap record serial:PORT,baud=auto` finds it), A and B "
        "swapped, then parity and data bits (8N1)",
        tuple(Shown(each.trouble.offset, shown(each.data)) for each in garbled),
    )  # fmt: skip
