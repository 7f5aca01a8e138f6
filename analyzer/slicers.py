"""What the dialects on one wire say of bytes: where a frame may begin, at which lengths it checks, whose it is, and whether the
manual allows its values.

It rests on the bytes and on what the open requests expect, never on when bytes came: that is the framer's.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from analyzer.catalogue import Command, Dialect, Role
from analyzer.codec import Codec, codec
from analyzer.link import MORE, TIE, Slicer

_Look = Callable[[bytes, int, int, bool], int]


class Slicers:
    """The slicers of all dialects on a wire. `expects`: what the open requests do, as a link's `slicer` takes it."""

    def __init__(self, dialects: Sequence[Dialect], expects: Callable[[int, int], int]) -> None:
        self.dialects = tuple(dialects)
        #: One for each dialect, in their order.
        self.each: tuple[Slicer, ...] = tuple(d.link.slicer(d.commands, expects) for d in dialects)
        self._judges = [_Judge(d) for d in dialects]
        #: Where a frame may begin.
        self.starts = re.compile(b"|".join(s.starts for s in self.each), re.DOTALL)
        self.longest = max(s.longest for s in self.each)
        #: By first byte: the slicers that know it, what looks there, and whose frame it is if that is sure.
        self.knowing: list[tuple[Slicer, ...]] = [()] * 256
        self._by_head: list[tuple[int, ...]] = [()] * 256
        self.looks: list[_Look] = [_nothing] * 256
        self.owners: list[Dialect | None] = [None] * 256
        for head in set().union(*(s.heads for s in self.each)):
            known = self._by_head[head] = tuple(i for i, s in enumerate(self.each) if head in s.heads)
            self.knowing[head] = tuple(self.each[i] for i in known)
            only = len(known) == 1
            self.looks[head] = self.each[known[0]].look if only else self._look_at_several
            self.owners[head] = self.dialects[known[0]] if only else None

    def _look_at_several(self, buffer: bytes, at: int, end: int, closed: bool) -> int:
        """Look where frames of several dialects may begin: the longest that checks, when all have answered."""
        answers = [slicer.look(buffer, at, end, closed) for slicer in self.knowing[buffer[at]]]
        if MORE in answers:
            return MORE
        return TIE if TIE in answers else max(answers)

    def owner(self, data: bytes) -> int:
        """Return which dialect's frame this is, as an index; the first wins where several could."""
        size = len(data)
        known = self._by_head[data[0]]
        for index in known if len(known) > 1 else ():
            if size in self.each[index].lengths(data, 0, size):
                return index
        for index in known if len(known) > 1 else ():
            slicer = self.each[index]
            if slicer.whole(data) or size in slicer.damaged(data, 0, size):
                return index
        return known[0]

    def plausible(self, frame: bytes, index: int) -> bool:
        """Say whether a complete frame is one that the manual of a dialect allows."""
        return self._judges[index].plausible(frame)


class _Judge:
    """Says whether a frame is one that the manual allows: a known code, every value in its range."""

    def __init__(self, dialect: Dialect) -> None:
        self._link = dialect.link
        self._forms: dict[tuple[int | None, int], list[tuple[Role, Codec]]] = {}
        self._packages: dict[int, Command] = {}
        for command in dialect.commands:
            if command.slots is not None:
                self._packages[command.code] = command
                continue
            for role, forms in ((Role.REQUEST, command.request_forms), (Role.REPLY, command.reply_forms)):
                for form in forms:
                    code = command.code if form.code is None else form.code
                    self._forms.setdefault((command.function, code), []).append((role, codec(form.layout)))

    def plausible(self, frame: bytes) -> bool:
        """Say whether the manual allows a complete frame."""
        head = self._link.parse(frame)
        if head.code is None:
            return True
        data = frame[head.start : head.stop]
        package = self._packages.get(head.code)
        if package is None or package.slots is None:
            return self._allowed(head.role, head.function, head.code, data)
        size = package.slots.size
        slots = [data[n : n + size] for n in range(0, len(data), size)]
        return all(self._slot_allowed(slot) for slot in slots if any(slot))

    def _allowed(self, role: Role, function: int | None, code: int, data: bytes) -> bool:
        """Say whether some form of the code has these data."""
        return any(
            role in (Role.UNKNOWN, wanted) and coder.matches(data) and not coder.broken(data)
            for wanted, coder in self._forms.get((function, code), ())
        )

    def _slot_allowed(self, slot: bytes) -> bool:
        """Say whether a slot of a package holds a request and zeros behind it."""
        for role, coder in self._forms.get((None, slot[1]), ()) if len(slot) > 1 else ():
            stop = 2 + coder.layout.byte_length
            data = slot[2:stop]
            if role is Role.REQUEST and coder.matches(data) and not coder.broken(data) and not any(slot[stop:]):
                return True
        return False


def _nothing(buffer: bytes, at: int, end: int, closed: bool) -> int:
    return 0
