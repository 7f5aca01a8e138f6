"""Links with a head byte, an address and a code, and packages of several commands.

    FA 01 F6 | 01 40 02 | 34        head, address, code | data | 8-bit check over all before it
    FC | 5 slots of 10 bytes | 34   a package: 52 bytes, an address and a code in each slot

The head gives the role. Lengths come from the layouts of the catalogue, by head and code.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Any

from analyzer.link.interface import (
    MORE,
    NO_CANDIDATES,
    TIE,
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
    from analyzer.link.arrays import Bytes, Found, Integers, Sums


@dataclass(frozen=True)
class Package:
    """A frame of one head and a fixed length that carries several commands."""

    head: int
    length: int


@dataclass(frozen=True)
class HeadLink(Link):
    """Frames of a head byte that tells the role, an address, a code, data and an 8-bit check over all before it."""

    heads: Mapping[int, Role]
    check: Callable[[bytes], int] = sum8
    package: Package | None = None
    deciding_bytes = 3

    @property
    def first_bytes(self) -> frozenset[int]:
        return frozenset(self.heads) | ({self.package.head} if self.package is not None else frozenset())

    def finder(self, commands: Sequence[CommandShape]) -> Finder:
        return _HeadFinder(self, commands)

    def slicer(self, commands: Sequence[CommandShape], expects: Callable[[int, int], int]) -> Slicer:
        # It keeps nothing of what it slices, so one is enough for all lines; the commands are kept with it, for their id.
        kept: dict[int, tuple[Sequence[CommandShape], _HeadSlicer]] = self.__dict__.setdefault("_slicers", {})
        if id(commands) not in kept:
            kept[id(commands)] = commands, _HeadSlicer(self, commands)
        return kept[id(commands)][1]

    def parse(self, frame: bytes, can_id: int | None = None) -> Head:
        if self.package is not None and frame[:1] == bytes((self.package.head,)):
            return Head(0, Role.REQUEST, self.package.head, None, 1, max(1, len(frame) - 1))
        padded = frame[:3].ljust(3, b"\0")
        role = self.heads.get(padded[0], Role.UNKNOWN)
        return Head(padded[1], role, padded[2], None, 3, max(3, len(frame) - 1))

    def checks(self, frame: bytes, can_id: int | None = None) -> tuple[Check, ...]:
        return (Check("checksum", len(frame) - 1, frame[-1:], bytes((self.check(frame[:-1]),))),)

    def build(self, command: CommandShape, form: FormShape, address: int, data: bytes, role: Role) -> bytes:
        if self.package is not None and command.code == self.package.head:
            return self.completed(bytes((self.package.head,)) + data)
        head = next(h for h, r in self.heads.items() if r is role)
        code = command.code if form.code is None else form.code
        return self.completed(bytes((head, address, code)) + data)

    def completed(self, body: bytes, can_id: int | None = None) -> bytes:
        return body + bytes((self.check(body),))

    def parts(self, frame: bytes, can_id: int | None = None) -> tuple[Part, ...]:
        if self.package is not None and frame[0] == self.package.head:
            return (Part(0, 1, "head", "package to several drives"),)
        role = self.heads.get(frame[0])
        return (
            Part(0, 1, "head", f"a {role}" if role else "not a head of this dialect"),
            Part(1, 2, "address", str(frame[1]) if len(frame) > 1 else ""),
            Part(2, 3, "code", f"0x{frame[2]:02X}" if len(frame) > 2 else ""),
        )


#: In the table of lengths: several lengths have this head and code.
_SEVERAL = -1
_NO_CODES = (0,) * 256


class _HeadSlicer(Slicer):
    """A table of head and code gives the length: 0 unknown, `_SEVERAL` where `_choices` lists them."""

    def __init__(self, link: HeadLink, commands: Sequence[CommandShape]) -> None:
        # `sum` itself saves a call for each frame; the low byte is taken where it is compared.
        self._total: Callable[[bytes], int] = sum if link.check is sum8 else link.check
        self._package = link.package
        self._choices: dict[tuple[int, int], tuple[int, ...]] = {}
        self._table: list[tuple[int, ...]] = [_NO_CODES] * 256
        self._known: set[int] = set()
        longest = 4
        for head, role in link.heads.items():
            row = [0] * 256
            for code, sizes in data_lengths(commands, role).items():
                if 0 <= code <= 0xFF:
                    lengths = tuple(sorted(n + 4 for n in sizes))
                    self._choices[head, code] = lengths
                    row[code] = lengths[0] if len(lengths) == 1 else _SEVERAL
                    longest = max(longest, lengths[-1])
                    if role is Role.REQUEST:
                        self._known.add(code)
            self._table[head] = tuple(row)
        self.heads = bytes(link.heads)
        if link.package is not None:
            self._table[link.package.head] = (link.package.length,) * 256
            self.heads = bytes({*self.heads, link.package.head})
            longest = max(longest, link.package.length)
        self.longest = longest
        self.starts = b"[" + re.escape(self.heads) + b"]"

    def look(self, buffer: bytes, at: int, end: int, closed: bool) -> int:
        row = self._table[buffer[at]]
        if row is _NO_CODES:
            return 0
        if at + 3 > end:
            return 0 if closed else MORE
        length = row[buffer[at + 2]]
        if length > 0:
            last = at + length - 1
            if last >= end:
                return 0 if closed else MORE
            return length if self._total(buffer[at:last]) & 0xFF == buffer[last] else 0
        if length == 0:
            return 0
        found = self.lengths(buffer, at, end)
        if len(found) > 1 and found[1] == found[0] + 1:
            return TIE
        if not found or (found[0] == MORE and closed):
            return 0
        if len(found) > 1 and found[1] == MORE and not closed and self._adjoining(buffer, at, end, found[0]):
            return MORE
        return found[0]

    def _adjoining(self, buffer: bytes, at: int, end: int, length: int) -> bool:
        """Say whether one byte more could make a tie."""
        return at + length >= end and length + 1 in self._choices[buffer[at], buffer[at + 2]]

    def _sizes(self, buffer: bytes, at: int, end: int) -> tuple[int, ...]:
        package = self._package
        if package is not None and buffer[at] == package.head:
            return (package.length,)
        return self._choices.get((buffer[at], buffer[at + 2]), ()) if at + 3 <= end else ()

    def lengths(self, buffer: bytes, at: int, end: int) -> list[int]:
        result: list[int] = []
        if buffer[at] in self.heads and at + 3 > end:
            return [MORE]
        for length in self._sizes(buffer, at, end):
            last = at + length - 1
            if last >= end:
                return [*result, MORE]
            if self._total(buffer[at:last]) & 0xFF == buffer[last]:
                result.append(length)
        return result

    def damaged(self, buffer: bytes, at: int, end: int) -> list[int]:
        if buffer[at] in self.heads and at + 3 > end:
            return [MORE]
        lengths = self._sizes(buffer, at, end)
        complete = [n for n in lengths if at + n <= end]
        return complete if len(complete) == len(lengths) else [*complete, MORE]

    def foreign(self, buffer: bytes, at: int) -> bool:
        return buffer[at] in self.heads and at + 2 < len(buffer) and self._table[buffer[at]][buffer[at + 2]] == 0

    def whole(self, data: bytes) -> bool:
        if len(data) < 4 or data[0] not in self.heads or self._total(data[:-1]) & 0xFF != data[-1]:
            return False
        return self._package is None or data[0] != self._package.head or len(data) <= self._package.length

    def shortened(self, buffer: bytes, at: int, end: int) -> list[int]:
        package = self._package
        if package is None or buffer[at] != package.head or end - at < 4:
            return []
        # A slot holds a command that is known; what else begins so is noise.
        if buffer[at + 2] not in self._known:
            return []
        if self._total is not sum:
            sums = [self._total(buffer[at : at + n]) for n in range(min(package.length - 1, end - at))]
        else:
            sums = [0, *accumulate(buffer[at : min(at + package.length - 2, end)])]
        return [n for n in range(4, min(package.length, end - at + 1)) if sums[n - 1] & 0xFF == buffer[at + n - 1]]

    @cached_property
    def _lengths_by_head(self) -> Any:
        """The table as one array, by head and code."""
        import numpy as np

        return np.array(self._table, dtype=np.int64).reshape(-1)

    def scan(self, codes: Bytes) -> Found | None:
        if self._total is not sum:
            return None
        import numpy as np

        from analyzer.link.arrays import Found, Sums, places_of

        sums = Sums(codes)
        starts = places_of(codes, self.heads, 3)
        kinds = codes.take(starts).astype("u2") << 8 | codes[2:].take(starts)
        sizes = self._lengths_by_head.take(kinds)
        unsure = [starts[:0]]
        for (head, code), lengths in self._choices.items():
            if len(lengths) > 1:
                rows = (kinds == head << 8 | code).nonzero()[0]
                sizes[rows] = self._chosen(sums, starts[rows], lengths)
                unsure.append(starts[rows])
        known = (sizes > 0) & (starts + sizes <= len(codes))
        starts, sizes = starts[known], sizes[known]
        good = sums.fit(starts, starts + sizes - 1)
        starts, sizes = starts[good], sizes[good]
        looks = sizes
        for (head, code), lengths in self._choices.items():
            if any(other == one + 1 for one, other in pairwise(lengths)):
                # The byte behind could make a tie.
                own = (codes.take(starts) == head) & (codes[2:].take(starts) == code)
                looks = looks + (own & np.isin(sizes + 1, lengths))
        return Found(starts, sizes, looks, np.sort(np.concatenate(unsure)))

    @staticmethod
    def _chosen(sums: Sums, starts: Integers, lengths: Sequence[int]) -> Integers:
        """Return of several lengths the shortest that checks; 0 for none, for a tie and where that is open."""
        chosen = starts * 0
        if not len(starts):
            return chosen
        inside = starts + lengths[-1] <= len(sums.codes)
        there = starts[inside]
        fits = [sums.fit(there, there + length - 1) for length in lengths]
        found = chosen[inside]
        for length, own in reversed(list(zip(lengths, fits, strict=True))):
            found[own] = length
        for (first, one), (second, other) in pairwise(zip(lengths, fits, strict=True)):
            found[one & other & (found == first) & (second == first + 1)] = 0
        chosen[inside] = found
        return chosen


#: The longest frame of an unknown code that is looked for behind a head.
_UNKNOWN_LONGEST = 52
#: Where the code of a command stands in a slot: behind its address.
_SLOT_CODE = 1


class _HeadFinder(Finder):
    """Requests behind a head, and those in the slots of a package."""

    def __init__(self, link: HeadLink, commands: Sequence[CommandShape]) -> None:
        self._check = link.check
        self._package = link.package
        self._heads = link.first_bytes
        self._slots = next((c.slots for c in commands if c.slots is not None), None)
        self._sizes = request_sizes(commands)
        sizes = [n + 4 for each in self._sizes.values() for n in each]
        self.longest = max(_UNKNOWN_LONGEST, link.package.length if link.package else 0, *sizes)

    def at(self, buffer: bytes, start: int, can_id: int | None = None) -> Candidates:
        head, end = buffer[start], len(buffer)
        if head not in self._heads:
            return NO_CANDIDATES
        if self._package is not None and head == self._package.head:
            return self._packed(buffer, start, self._package)
        if start + 3 > end:
            return Candidates(open=True)
        address, code = buffer[start + 1], buffer[start + 2]
        sizes = self._sizes.get(code)
        if not sizes:
            return Candidates((self._unknown(buffer, start, address, code),))
        found = []
        for size in sizes:
            stop = start + 4 + size
            complete = stop <= end
            fits = complete and self._check(buffer[start : stop - 1]) == buffer[stop - 1]
            data = buffer[start + 3 : start + 3 + size]
            found.append(
                Candidate(start, min(stop, end), end, address, None, code, start + 2, True, fits, complete, data, (size,))
            )
        return Candidates(tuple(found), any(not c.complete for c in found))

    def _unknown(self, buffer: bytes, start: int, address: int, code: int) -> Candidate:
        """Return the candidate of an unknown code: the shortest frame whose check fits, else all that is there."""
        end = len(buffer)
        lasts = range(start + 3, min(end, start + _UNKNOWN_LONGEST))
        stop = next((last + 1 for last in lasts if self._check(buffer[start:last]) == buffer[last]), 0)
        fits = stop > 0
        # A head where a code is expected is that of the next frame.
        weak = code in self._heads
        return Candidate(start, stop or end, start + 3, address, None, code, start + 2, False, fits, fits, weak=weak)

    def _packed(self, buffer: bytes, start: int, package: Package) -> Candidates:
        end = len(buffer)
        stop = start + package.length
        complete = stop <= end
        if self._slots is None:
            return Candidates(open=not complete)
        fits = complete and self._check(buffer[start : stop - 1]) == buffer[stop - 1]
        stop = min(stop, end)
        found = []
        for number in range(1, self._slots.count + 1):
            first = start + 1 + (number - 1) * self._slots.size
            slot = buffer[first : first + self._slots.size]
            if len(slot) <= _SLOT_CODE or not any(slot):
                continue
            address, code, code_at = slot[0], slot[_SLOT_CODE], first + _SLOT_CODE
            sizes = self._sizes.get(code)
            found.append(Candidate(
                start, stop, stop if fits else code_at + 1, address, None, code, code_at, bool(sizes), fits, complete,
                slot[_SLOT_CODE + 1 :], sizes or (), weak=not sizes and code in self._heads, slot=number,
            ))  # fmt: skip
        good = fits and all(candidate.known for candidate in found)
        found.append(Candidate(start, stop, stop, None, None, package.head, start, True, good, complete))
        return Candidates(tuple(found), not complete)
