"""Lingkong: frames that carry their length.

    3E A2 01 04 E5 | 10 27 00 00 | 37      head, code, address, length, sum8 of the head | data | sum8 of the data

Frames without data have 5 bytes and one sum. The length counts only if the sum of the head fits.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from analyzer.link.interface import (
    MORE,
    NO_CANDIDATES,
    Candidate,
    Candidates,
    Check,
    CommandShape,
    Finder,
    FormShape,
    Head,
    Link,
    Part,
    Role,
    Slicer,
    data_lengths,
    request_sizes,
    sum8,
)

if TYPE_CHECKING:
    from analyzer.link.arrays import Bytes, Found

_LK_HEAD = 0x3E
_LK_LONGEST = 100


@dataclass(frozen=True)
class LkLink(Link):
    """Lingkong: the head carries the length and its own sum; data, where there is any, has another."""

    tells_length = True
    deciding_bytes = 3

    @property
    def first_bytes(self) -> frozenset[int]:
        return frozenset({_LK_HEAD})

    def finder(self, commands: Sequence[CommandShape]) -> Finder:
        return _LkFinder(commands)

    def slicer(self, commands: Sequence[CommandShape], expects: Callable[[int, int], int]) -> Slicer:
        return _LkSlicer(commands)

    def parse(self, frame: bytes, can_id: int | None = None) -> Head:
        padded = frame[:4].ljust(4, b"\0")
        end = max(5, len(frame) - 1) if len(frame) > 5 else 5
        return Head(padded[2], Role.UNKNOWN, padded[1], None, 5, end)

    def checks(self, frame: bytes, can_id: int | None = None) -> tuple[Check, ...]:
        head = Check("head checksum", 4, frame[4:5], bytes((sum8(frame[:4]),)))
        if len(frame) <= 5:
            return (head,)
        return (head, Check("data checksum", len(frame) - 1, frame[-1:], bytes((sum8(frame[5:-1]),))))

    def build(self, command: CommandShape, form: FormShape, address: int, data: bytes, role: Role) -> bytes:
        code = command.code if form.code is None else form.code
        head = bytes((_LK_HEAD, code, address, len(data)))
        frame = head + bytes((sum8(head),))
        return frame + data + bytes((sum8(data),)) if data else frame

    def completed(self, body: bytes, can_id: int | None = None) -> bytes:
        return body + bytes((sum8(body if len(body) <= 4 else body[5:]),))

    def parts(self, frame: bytes, can_id: int | None = None) -> tuple[Part, ...]:
        padded = frame[:5].ljust(5, b"\0")
        return (
            Part(0, 1, "head", "" if padded[0] == _LK_HEAD else "not the head 0x3E"),
            Part(1, 2, "code", f"0x{padded[1]:02X}"),
            Part(2, 3, "address", str(padded[2])),
            Part(3, 4, "length", str(padded[3])),
        )


class _LkSlicer(Slicer):
    heads = bytes((_LK_HEAD,))
    starts = re.escape(heads)
    longest = _LK_LONGEST + 6

    def __init__(self, commands: Sequence[CommandShape]) -> None:
        self._known: dict[int, set[int]] = {}
        for role in (Role.REQUEST, Role.REPLY):
            for code, sizes in data_lengths(commands, role).items():
                self._known.setdefault(code, set()).update(sizes)
        # Five bytes with one sum are weak evidence: only a code that can come without data is enough.
        self._bare = frozenset(code for code, sizes in self._known.items() if 0 in sizes)

    def look(self, buffer: bytes, at: int, end: int, closed: bool) -> int:
        if buffer[at] != _LK_HEAD:
            return 0
        if at + 5 > end:
            return 0 if closed else MORE
        head, code, address, size, check = buffer[at : at + 5]
        if (head + code + address + size) & 0xFF != check:
            return 0
        if size == 0:
            return 5 if code in self._bare else 0
        if size > _LK_LONGEST:
            return 0
        last = at + 5 + size
        if last >= end:
            return 0 if closed else MORE
        return 6 + size if sum(buffer[at + 5 : last]) & 0xFF == buffer[last] else 0

    def lengths(self, buffer: bytes, at: int, end: int) -> list[int]:
        found = self.look(buffer, at, end, False)
        return [found] if found else []

    def damaged(self, buffer: bytes, at: int, end: int) -> list[int]:
        if buffer[at] != _LK_HEAD:
            return []
        if at + 4 > end:
            return [MORE] if at + 2 > end or buffer[at + 1] in self._known else []
        size = buffer[at + 3]
        if size not in self._known.get(buffer[at + 1], ()):
            return []
        if size == 0:
            return [5] if at + 5 <= end else [MORE]
        stop = at + 6 + size
        if stop > end:
            return [MORE]
        # Of its two sums one is wrong; where neither fits, nothing says that this is a head.
        head_fits = sum(buffer[at : at + 4]) & 0xFF == buffer[at + 4]
        return [6 + size] if head_fits or sum(buffer[at + 5 : stop - 1]) & 0xFF == buffer[stop - 1] else []

    def foreign(self, buffer: bytes, at: int) -> bool:
        return buffer[at] == _LK_HEAD and at + 1 < len(buffer) and buffer[at + 1] not in self._known

    def whole(self, data: bytes) -> bool:
        if len(data) < 5 or data[0] != _LK_HEAD or sum(data[:4]) & 0xFF != data[4]:
            return False
        if data[3] == 0:
            return len(data) == 5
        return len(data) == data[3] + 6 and sum(data[5:-1]) & 0xFF == data[-1]

    def scan(self, codes: Bytes) -> Found | None:
        import numpy as np

        from analyzer.link.arrays import Found, Sums, places_of

        sums = Sums(codes)
        starts = places_of(codes, self.heads, 5)
        starts = starts[sums.fit(starts, starts + 4)]
        own = codes[3:].take(starts).astype("i8")
        bare = np.isin(np.arange(256), list(self._bare))
        known = np.where(own > 0, own <= _LK_LONGEST, bare.take(codes[1:].take(starts)))
        sizes = own + 5 + (own > 0)
        known &= starts + sizes <= len(codes)
        starts, sizes = starts[known], sizes[known]
        good = (sizes == 5) | sums.fit(starts + 5, starts + sizes - 1)
        starts, sizes = starts[good], sizes[good]
        return Found(starts, sizes, sizes, starts[:0])


class _LkFinder(Finder):
    """Requests whose length may have come or not, and may be that of their code or not."""

    longest = 6 + 255

    def __init__(self, commands: Sequence[CommandShape]) -> None:
        self._sizes = request_sizes(commands)

    def at(self, buffer: bytes, start: int, can_id: int | None = None) -> Candidates:
        if buffer[start] != _LK_HEAD:
            return NO_CANDIDATES
        end = len(buffer)
        if start + 2 > end:
            return Candidates(open=True)
        code = buffer[start + 1]
        address = buffer[start + 2] if start + 2 < end else None
        size = buffer[start + 3] if start + 3 < end else None
        sizes = self._sizes.get(code)
        head_fits = start + 5 <= end and sum8(buffer[start : start + 4]) == buffer[start + 4]
        if sizes is not None and (size is None or size in sizes):
            stop = start + (6 + size if size else 5)
            complete = size is not None and stop <= end
            fits = complete and head_fits and (not size or sum8(buffer[start + 5 : stop - 1]) == buffer[stop - 1])
            candidate =Candidate(
                start, min(stop, end), end, address, None, code, start + 1, True, fits, complete,
                buffer[start + 5 : start + 5 + (size or 0)], () if size is None else (size,),
            )  # fmt: skip
            return Candidates((candidate,), not complete)
        # Of another length or an unknown code: the head says all that can be known.
        stop = min(start + 5, end)
        if sizes is not None:
            note = f"{size} bytes of data, expected {' or '.join(str(n) for n in sizes)}"
            candidate = Candidate(
                start, stop, start + 5, address, None, code, start + 1, True, False, False, misfit=True, note=note
            )
        else:
            # The head of this dialect is a code of another (3E reads the protection of MKS drives). So an unknown code needs
            # more than the byte before it: the sum of the head, or the beginning of a sending.
            candidate =Candidate(
                start, stop, start + 5, address, None, code, start + 1, False, False, start + 5 <= end,
                first_only=not head_fits, weak=not head_fits and code == _LK_HEAD,
            )  # fmt: skip
        return Candidates((candidate,), start + 5 > end)
