"""Where a Modbus frame may begin.

    01 06 00 82 00 05 crc        a write of one register         01 10 00 F6 00 02 04 ... crc     of several

Functions 01h to 04h read. Modbus has no heads: of other functions only 05h, 06h, 0Fh and 10h are read whatever their CRC, for
any two bytes could be a function; the rest only where the CRC fits (`windows`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from analyzer.catalogue import Command, Dialect, Risk
from analyzer.link import READS, WRITE_MANY, WRITE_ONE, ModbusLink, modbus_crc
from conformance.gate.spots import NOTHING, OPEN, Ear, Found, Meaning, Spot, meanings

#: The highest address, and the longest frame.
HIGHEST = 247
LONGEST = 256


class ModbusEar(Ear):
    """Modbus-RTU: reads, writes of one register, writes of several; other functions where their CRC fits."""

    def __init__(self, dialect: Dialect) -> None:
        super().__init__(dialect)
        assert isinstance(dialect.link, ModbusLink)
        self._link = dialect.link
        self._registers: dict[tuple[int, int], tuple[Command, ...]] = {}
        for command in dialect.commands:
            key = (command.function or 0, command.code)
            self._registers[key] = (*self._registers.get(key, ()), command)

    def look(self, buffer: bytes, at: int) -> Found:
        """Return what may begin at `at`, functions that nobody knows aside (`windows`)."""
        if buffer[at] > HIGHEST:
            return NOTHING
        if at + 2 > len(buffer):
            return OPEN
        function = buffer[at + 1]
        if function in READS:
            return self._fixed(buffer, at, function, reads=True)
        if function in WRITE_ONE:
            return self._fixed(buffer, at, function, reads=False)
        if function in WRITE_MANY:
            return self._many(buffer, at, function)
        return NOTHING

    def _spot(self, buffer: bytes, at: int, length: int, function: int, told: tuple[Meaning, ...], note: str = "") -> Found:
        end = len(buffer)
        stop = at + length
        complete = stop <= end
        sound = complete and modbus_crc(buffer[at:stop]) == 0
        known = bool(told)
        code = int.from_bytes(buffer[at + 2 : at + 4], "big")
        fallback = self.dialect.fallbacks.get(function)
        if not told and fallback is not None:
            told = (Meaning(fallback, None, {}, fallback.risks({})),)
            # What only reads is known for that, whichever register it is.
            known = function in READS
            note = f"register 0x{code:04X}"
        spot = Spot(
            self.dialect, at, min(stop, end), buffer[at], code, at + 3, end, known, sound, complete, told,
            only_first=not known, note=note,
        )  # fmt: skip
        return Found((spot,), not complete)

    def _fixed(self, buffer: bytes, at: int, function: int, *, reads: bool) -> Found:
        if at + 4 > len(buffer):
            return OPEN
        commands = self._registers.get((function, int.from_bytes(buffer[at + 2 : at + 4], "big")), ())
        size = 0 if reads else 2
        told = meanings(commands, buffer[at + 4 : at + 4 + size], size) if commands else ()
        return self._spot(buffer, at, 8, function, told)

    def _many(self, buffer: bytes, at: int, function: int) -> Found:
        end = len(buffer)
        if at + 4 > end:
            return OPEN
        register = int.from_bytes(buffer[at + 2 : at + 4], "big")
        commands = self._registers.get((function, register), ())
        count = buffer[at + 6] if at + 6 < end else None
        length = 9 if count is None else 9 + count
        if not commands:
            return self._spot(buffer, at, length, function, ())
        quantity = int.from_bytes(buffer[at + 4 : at + 6], "big") if at + 6 <= end else commands[0].quantity
        size = self._link.byte_count(function, register, commands[0].quantity)
        if quantity != commands[0].quantity or count not in (None, size):
            # Registers beside the command's own, of which nothing is known.
            worst = tuple(Meaning(c, None, {}, c.risks({}) | {Risk.UNKNOWN}) for c in commands)
            note = f"{quantity} registers in {'?' if count is None else count} bytes, expected {commands[0].quantity}"
            return self._spot(buffer, at, length, function, worst, note)
        told = meanings(commands, buffer[at + 7 : at + 7 + size], size)
        return self._spot(buffer, at, 9 + size, function, told)

    def windows(self, buffer: bytes, starts: Sequence[int], new: int) -> Iterator[Spot]:
        """Yield the stretches that check as frames of a function that is neither known nor an exception's."""
        end = len(buffer)
        for at in starts:
            if at + 4 > end or buffer[at] > HIGHEST:
                continue
            function = buffer[at + 1]
            if not 0 < function < 0x80 or function in READS or function in WRITE_ONE or function in WRITE_MANY:
                continue
            for stop in range(max(at + 4, new + 1), min(end, at + LONGEST) + 1):
                if modbus_crc(buffer[at:stop]) == 0:
                    yield Spot(
                        self.dialect, at, stop, buffer[at], function, at + 1, stop, False, True, True, (),
                        note=f"Modbus function 0x{function:02X}",
                    )  # fmt: skip
