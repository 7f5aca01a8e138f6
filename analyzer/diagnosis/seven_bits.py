"""Frames that lost their bits 7: to a receiver of seven data bits, or to a sender's parity."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import product

from analyzer import dialects as registry
from analyzer.catalogue import Role
from analyzer.diagnosis.exchanges import Awaited
from analyzer.diagnosis.rendered import ADDRESSES, likely
from analyzer.diagnosis.ways import DIFFERENT, Fit, Garbled

_BIT_7 = 0x80
#: Bytes of a reply whose bits 7 are tried both ways.
_HIGH_BITS = 8


def of_seven(garbled: Sequence[Garbled]) -> Iterator[Fit]:
    """Yield stretches of frames that lost their bits 7, to a receiver of seven bits or to a sender's parity."""
    read_all = b"".join(each.data for each in garbled)
    lost = all(byte < _BIT_7 for byte in read_all)
    parities = {byte.bit_count() & 1 for byte in read_all}
    if not (lost or len(parities) == 1) or len(set(read_all)) < DIFFERENT:
        return
    for trouble, data, replies in garbled:
        seven = bytes(byte & 0x7F for byte in data)
        if (reply := _of_lower(seven, replies)) is not None and reply != data:
            yield Fit(trouble, data, reply, len(data))
            continue
        frames, taken, at = [], 0, 0
        while at < len(seven):
            whole = next((w for w in _with_high_bits(seven, at) if w != data[at : at + len(w)]), None)
            if whole is not None:
                frames.append(whole)
                taken += len(whole)
            at += len(whole or b"?")
        if frames:
            yield Fit(trouble, data, frames[0], taken)


def _of_lower(seven: bytes, replies: Sequence[Awaited]) -> bytes | None:
    """Return a reply that was asked for and has these lower bits, if its check can fit."""
    for reply in replies:
        size = len(reply.head)
        if len(seven) != reply.size or not seven.startswith(_lower(reply.head)):
            continue
        body = reply.head + seven[size : -len(reply.link.checks(seven)[-1].expected)]
        # A sum fits or not whatever the high bits are; of a CRC these are tried, as long as they are few.
        for high in range(1 << min(len(body) - size, _HIGH_BITS)):
            bits = bytes((high >> at & 1) << 7 for at in range(min(len(body) - size, _HIGH_BITS))).ljust(
                len(body) - size, b"\0"
            )
            whole = reply.link.completed(reply.head + bytes(a | b for a, b in zip(body[size:], bits, strict=True)))
            if _lower(whole) == seven:
                return whole
    return None


def all_of_seven(garbled: Sequence[Garbled]) -> bool:
    """Say whether all that came, of several frames, lost its bits 7: alone of what a line does a right sum can outlast that."""
    fits = list(of_seven(garbled))
    return len(fits) == len(garbled) and len({fit.frame for fit in fits}) > 1


def _with_high_bits(seven: bytes, at: int) -> Iterator[bytes]:
    """Yield the frames at a place that have these lower bits."""
    for sent in likely():
        if seven.startswith(_lower(sent), at) and any(b & _BIT_7 for b in sent):
            yield sent
    for frame in _by_lower_head().get(seven[at : at + _KEY], ()):
        if (whole := _of_lower(seven[at : at + frame.size], (frame,))) is not None:
            yield whole


#: First bytes by which frames are looked up.
_KEY = 2


@cache
def _by_lower_head() -> dict[bytes, list[Awaited]]:
    """Return how the frames of the catalogue begin, by the lower bits of their first bytes."""
    found: dict[bytes, list[Awaited]] = defaultdict(list)
    for dialect in registry.every():
        if dialect.bus == "can":
            continue
        link = dialect.link
        forms = [
            (command, form, role)
            for command in dialect.commands
            for role, own in ((Role.REQUEST, command.request_forms), (Role.REPLY, command.reply_forms))
            for form in own
            if not form.layout.open_ended
        ]
        for (command, form, role), address in product(forms, ADDRESSES):
            whole = link.build(command, form, address, bytes(form.layout.byte_length), role)
            found[_lower(whole[:_KEY])].append(Awaited(whole[: link.parse(whole).start], len(whole), link))
    return found


@cache
def _lower(frame: bytes) -> bytes:
    return bytes(byte & 0x7F for byte in frame)
