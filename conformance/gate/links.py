"""Where a frame may begin, link by link: what a gate looks for in what is to leave.

    buffer, start -> spots: known or unknown code, whole or cut off, its checks right or wrong

Rules kept here:
- A code that can be read is enough for a spot; values that have not come yet are missing, and stand for the worst.
- A frame with the head of a reply is read as the request of its code: a careless drive may not look.
- A link of another package is read by its own slicer.
"""

from __future__ import annotations

from analyzer.catalogue import Command, Dialect, Risk
from analyzer.link import HeadLink, LkLink, ModbusLink, Package, sum8
from conformance.gate.modbus import ModbusEar
from conformance.gate.spots import NOTHING, OPEN, Ear, Found, Meaning, Spot, meanings, sizes_of

#: The longest frame that any of the links has, and so the most that a frame begun earlier can still need.
LONGEST = 262
_LK_HEAD = 0x3E
_SLOT_CODE = 1
#: The longest frame of an uncatalogued code that is looked for behind a head.
_UNKNOWN_LONGEST = 52


class HeadEar(Ear):
    """Frames of a head, an address, a code, data and an 8-bit check; and packages of them."""

    def __init__(self, dialect: Dialect) -> None:
        super().__init__(dialect)
        assert isinstance(dialect.link, HeadLink)
        self._check = dialect.link.check
        self._package: Package | None = dialect.link.package
        self._heads = frozenset(dialect.link.heads)
        self._all_heads = self._heads | ({self._package.head} if self._package else frozenset())
        self._carrier = next((c for c in dialect.commands if c.slots is not None), None)
        self._codes = {
            code: (commands, sizes_of(commands)) for code, commands in dialect.by_code.items() if commands[0].slots is None
        }

    def look(self, buffer: bytes, at: int) -> Found:
        """Return what may begin at `at`."""
        head = buffer[at]
        if head not in self._all_heads:
            return NOTHING
        if self._package is not None and head == self._package.head:
            return self._look_package(buffer, at, self._package)
        end = len(buffer)
        if at + 3 > end:
            return OPEN
        address, code = buffer[at + 1], buffer[at + 2]
        known = self._codes.get(code)
        if known is None:
            return Found((self._unknown(buffer, at, address, code),), False)
        commands, sizes = known
        spots, is_open = [], False
        for size in sizes:
            stop = at + 4 + size
            complete = stop <= end
            is_open = is_open or not complete
            sound = complete and self._check(buffer[at : stop - 1]) == buffer[stop - 1]
            told = meanings(commands, buffer[at + 3 : at + 3 + size], size)
            spots.append(Spot(self.dialect, at, min(stop, end), address, code, at + 2, end, True, sound, complete, told))
        return Found(tuple(spots), is_open)

    def _unknown(self, buffer: bytes, at: int, address: int, code: int) -> Spot:
        """Return the spot of a code that is not in the catalogue: the shortest length at which its check fits, if any."""
        end = len(buffer)
        total = 0
        plain = self._check is sum8
        stop = end
        sound = False
        for last in range(at + 3, min(end, at + _UNKNOWN_LONGEST)):
            total = sum(buffer[at:last]) & 0xFF if plain else self._check(buffer[at:last])
            if total == buffer[last]:
                stop, sound = last + 1, True
                break
        # A head where a code is expected is the next frame.
        weak = code in self._all_heads
        return Spot(self.dialect, at, stop, address, code, at + 2, at + 3, False, sound, sound, (), weak=weak)

    def _look_package(self, buffer: bytes, at: int, package: Package) -> Found:
        carrier, end = self._carrier, len(buffer)
        stop = at + package.length
        complete = stop <= end
        if carrier is None or carrier.slots is None:
            return Found((), not complete)
        sound = complete and self._check(buffer[at : stop - 1]) == buffer[stop - 1]
        stop = min(stop, end)
        spots: list[Spot] = []
        count, size = carrier.slots.count, carrier.slots.size
        for number in range(1, count + 1):
            first = at + 1 + (number - 1) * size
            slot = buffer[first : first + size]
            if len(slot) <= _SLOT_CODE or not any(slot):
                continue
            address, code = slot[0], slot[_SLOT_CODE]
            known = self._codes.get(code)
            told: tuple[Meaning, ...] = ()
            if known is not None:
                # A slot has room for more than its command; how long that is, the catalogue says.
                for length in known[1]:
                    told += meanings(known[0], slot[2 : 2 + length], length)
            code_at = first + _SLOT_CODE
            until = stop if sound else code_at + 1
            weak = known is None and code in self._all_heads
            spots.append(
                Spot(
                    self.dialect, at, stop, address, code, code_at, until, known is not None, sound, complete, told,
                    slot=number, weak=weak,
                )
            )  # fmt: skip
        # The package itself does nothing; what it does stands in its slots.
        whole = (Meaning(carrier, None, {}, frozenset({Risk.READ})),)
        good = sound and all(spot.known for spot in spots)
        spots.append(Spot(self.dialect, at, stop, None, package.head, at, stop, True, good, complete, whole))
        return Found(tuple(spots), not complete)


class LkEar(Ear):
    """Frames that carry their length: head, code, address, length, sum | data, sum."""

    def __init__(self, dialect: Dialect) -> None:
        super().__init__(dialect)
        self._codes = {code: (commands, sizes_of(commands)) for code, commands in dialect.by_code.items()}

    def look(self, buffer: bytes, at: int) -> Found:
        """Return what may begin at `at`."""
        if buffer[at] != _LK_HEAD:
            return NOTHING
        end = len(buffer)
        if at + 2 > end:
            return OPEN
        code = buffer[at + 1]
        address = buffer[at + 2] if at + 2 < end else None
        size = buffer[at + 3] if at + 3 < end else None
        commands, sizes = self._codes.get(code, ((), ()))
        head_fits = at + 5 <= end and sum8(buffer[at : at + 4]) == buffer[at + 4]
        if commands and (size is None or size in sizes):
            stop = at + (6 + size if size else 5)
            complete = size is not None and stop <= end
            sound = complete and head_fits and (not size or sum8(buffer[at + 5 : stop - 1]) == buffer[stop - 1])
            told = meanings(commands, buffer[at + 5 : at + 5 + (size or 0)], size)
            spot = Spot(self.dialect, at, min(stop, end), address, code, at + 1, end, True, sound, complete, told)
            return Found((spot,), not complete)
        # Of another length, or of a code that nobody knows: its head says all that can be known.
        stop = min(at + 5, end)
        if commands:
            worst = tuple(Meaning(c, None, {}, c.risks({})) for c in commands)
            expected = " or ".join(str(n) for n in sizes)
            spot = Spot(
                self.dialect, at, stop, address, code, at + 1, at + 5, True, False, False, worst,
                note=f"{size} bytes of data, expected {expected}",
            )  # fmt: skip
            return Found((spot,), at + 5 > end)
        # The head of one dialect is a code of another (3E reads the protection of MKS drives), so a code that nobody knows
        # needs more than the byte before it: the sum of the head, or the beginning of a sending.
        spot = Spot(
            self.dialect, at, stop, address, code, at + 1, at + 5, False, False, at + 5 <= end, (),
            only_first=not head_fits, weak=not head_fits and code == _LK_HEAD,
        )  # fmt: skip
        return Found((spot,), at + 5 > end)


class SlicerEar(Ear):
    """Any other link, through its own slicer: frames whose checks fit, and known ones whose check alone is wrong."""

    def __init__(self, dialect: Dialect) -> None:
        super().__init__(dialect)
        self._slicer = dialect.link.slicer(dialect, lambda address, function: 0)
        self._commands: dict[tuple[int | None, int], tuple[Command, ...]] = {}
        for command in dialect.commands:
            key = (command.function, command.code)
            self._commands[key] = (*self._commands.get(key, ()), command)

    def look(self, buffer: bytes, at: int) -> Found:
        """Return what may begin at `at`."""
        if buffer[at] not in self._slicer.heads:
            return NOTHING
        end = len(buffer)
        sound = {n for n in self._slicer.lengths(buffer, at, end) if n > 0}
        lengths = self._slicer.damaged(buffer, at, end)
        every = sorted(sound | {n for n in lengths if n > 0})
        spots = [self._read(buffer[at : at + n], at, n in sound) for n in every]
        if self._slicer.foreign(buffer, at):
            spots.append(Spot(self.dialect, at, end, None, -1, at, end, False, False, False, ()))
        return Found(tuple(spots), end - at < self._slicer.longest)

    def _read(self, frame: bytes, at: int, sound: bool) -> Spot:
        head = self.dialect.link.parse(frame)
        code = -1 if head.code is None else head.code
        commands = self._commands.get((head.function, code), ())
        data = frame[head.start : head.stop]
        told = meanings(commands, data, len(data)) if commands else ()
        stop = at + len(frame)
        return Spot(
            self.dialect, at, stop, head.address, code, at + max(0, head.start - 1), stop, bool(told), sound, True, told
        )


def ear(dialect: Dialect) -> Ear:
    """Return what reads frames of a serial dialect."""
    for kind, made in _EARS:
        if isinstance(dialect.link, kind):
            return made(dialect)
    return SlicerEar(dialect)


_EARS: tuple[tuple[type, type[Ear]], ...] = ((HeadLink, HeadEar), (LkLink, LkEar), (ModbusLink, ModbusEar))
