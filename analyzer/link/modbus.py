"""Modbus-RTU.

    01 06 00 82 | 00 05 | 28 21              address, function, register | value | CRC16, low byte first
    01 10 00 F6 00 02 04 | data | CRC16      ... quantity, byte count | data

Lengths follow the standard functions, whether or not the register is in the catalogue.

Rules kept here:
- First bytes above 0xF7 are never addresses.
- A frame whose CRC ends in 00 also checks one byte short: that is a `TIE`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from fastcrc import crc16 as _crc16

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
)

if TYPE_CHECKING:
    from analyzer.link.arrays import Bytes, Flags, Found

modbus_crc: Callable[[bytes], int] = _crc16.modbus

BIT_READS = frozenset({0x01, 0x02})
REGISTER_READS = frozenset({0x03, 0x04})
READS = BIT_READS | REGISTER_READS
WRITE_ONE = frozenset({0x05, 0x06})
WRITE_MANY = frozenset({0x0F, 0x10})
FUNCTIONS = READS | WRITE_ONE | WRITE_MANY
_EXCEPTIONS = frozenset(function | 0x80 for function in FUNCTIONS)
#: The highest address, and the last exception code, that Modbus has.
LAST_UNIT = 247
LAST_EXCEPTION = 11
#: Registers that one request reads at most.
MOST_REGISTERS = 125
#: Coils that one request reads at most.
_MOST_COILS = 2000
#: Characters of silence between frames, and the silence above a baud rate.
_SILENT_CHARACTERS = 3.5
_FAST_BAUD, _FAST_SILENCE_NS = 19200, 1_750_000
#: Bytes that a read reply counts at most.
_MOST_COUNTED = 250
#: Longer frames are found one by one: bytes inside others begin some of every length, and each length is a search.
_LONGEST_SCANNED = 40


def read_bytes(function: int, quantity: int) -> int:
    """Return the bytes of so many registers, or of so many coils, in a read reply."""
    return (quantity + 7) // 8 if function in BIT_READS else 2 * quantity


@dataclass(frozen=True)
class ModbusLink(Link):
    """Modbus-RTU. `odd_counts`: registers whose write has another byte count than twice its quantity."""

    odd_counts: Mapping[int, int] = field(default_factory=dict)

    def deciding(self, frame: bytes) -> int:
        function, size = frame[1] if len(frame) > 2 else 0, len(frame)
        if function in READS and (size == 8) is not (size == 5 + frame[2]):
            return 6 if size == 8 else 3
        # A write of one register is answered by itself: which is which, the requests tell.
        return (4 if size == 8 else 7) if function in WRITE_MANY else 0

    def silence_ns(self, byte_ns: int) -> int:
        fast = byte_ns < 10_000_000_000 // _FAST_BAUD
        return _FAST_SILENCE_NS if fast else int(_SILENT_CHARACTERS * byte_ns)

    def finder(self, commands: Sequence[CommandShape]) -> Finder:
        return _ModbusFinder(self, commands)

    def slicer(self, commands: Sequence[CommandShape], expects: Callable[[int, int], int]) -> Slicer:
        return _ModbusSlicer(self, expects)

    def byte_count(self, function: int, register: int, quantity: int) -> int:
        """Return the byte count that a write of several registers or coils must have."""
        if function == 0x0F:
            return (quantity + 7) // 8
        return self.odd_counts.get(register, 2 * quantity)

    def parse(self, frame: bytes, can_id: int | None = None) -> Head:
        frame = frame or b"\0"
        address, function = frame[0], frame[1] if len(frame) > 1 else 0
        size = len(frame)
        end = max(2, size - 2)
        if function & 0x80:
            return Head(address, Role.REPLY, None, function & 0x7F, 2, end, exception=frame[2] if size > 2 else 0)
        if function in READS:
            # A reply's byte count fills the frame exactly.
            is_reply = size > 3 and size == 5 + frame[2]
            is_request = size == 8
            if is_reply and not is_request:
                return Head(address, Role.REPLY, None, function, 3, end)
            role = Role.REQUEST if is_request and not is_reply else Role.UNKNOWN
            return Head(address, role, _u16(frame, 2), function, min(6, end), end, _u16(frame, 4))
        if function in WRITE_MANY:
            register, quantity = _u16(frame, 2), _u16(frame, 4)
            if size == 8:
                return Head(address, Role.REPLY, register, function, 4, end, quantity)
            return Head(address, Role.REQUEST, register, function, min(7, end), end, quantity)
        if function in WRITE_ONE:
            return Head(address, Role.UNKNOWN, _u16(frame, 2), function, min(4, end), end, 1)
        return Head(address, Role.UNKNOWN, None, function, 2, end)

    def checks(self, frame: bytes, can_id: int | None = None) -> tuple[Check, ...]:
        return (Check("CRC16", len(frame) - 2, frame[-2:], modbus_crc(frame[:-2]).to_bytes(2, "little")),)

    def build(self, command: CommandShape, form: FormShape, address: int, data: bytes, role: Role) -> bytes:
        function = command.function or 0
        head = bytes((address, function))
        register = command.code.to_bytes(2, "big")
        quantity = command.quantity.to_bytes(2, "big")
        if function in READS:
            body = head + (register + quantity if role is Role.REQUEST else bytes((len(data),)) + data)
        elif function in WRITE_MANY and role is Role.REQUEST:
            body = head + register + quantity + bytes((len(data),)) + data
        else:
            body = head + register + data
        return self.completed(body)

    def completed(self, body: bytes, can_id: int | None = None) -> bytes:
        return body + modbus_crc(body).to_bytes(2, "little")

    def parts(self, frame: bytes, can_id: int | None = None) -> tuple[Part, ...]:
        head = self.parse(frame)
        parts = [Part(0, 1, "address", str(frame[0])), Part(1, 2, "function", f"0x{frame[1]:02X}")]
        if head.exception is not None:
            parts.append(Part(2, 3, "exception", f"0x{head.exception:02X}"))
        elif head.code is None and head.function in READS:
            parts.append(Part(2, 3, "byte count", str(frame[2])))
        elif head.code is not None and len(frame) >= 6:
            parts.append(Part(2, 4, "register", f"0x{head.code:04X}"))
            if head.start >= 6:
                parts.append(Part(4, 6, "quantity", str(head.quantity)))
            if head.start >= 7:
                parts.append(Part(6, 7, "byte count", str(frame[6])))
        return tuple(parts)


@dataclass(frozen=True)
class ModbusSlaveLink(ModbusLink):
    """Modbus-RTU of slaves without a list of commands: a command is a function with any registers.

    All that follows the function is its own data. `units`: the only addresses that there are; empty: any.
    """

    units: frozenset[int] = frozenset()

    # A reply tells what it is only together with its request, of which there are too many kinds to keep.
    deciding = Link.deciding

    def slicer(self, commands: Sequence[CommandShape], expects: Callable[[int, int], int]) -> Slicer:
        return _ModbusSlicer(self, expects, self.units)

    def parse(self, frame: bytes, can_id: int | None = None) -> Head:
        head = super().parse(frame, can_id)
        known = head.exception is None and head.function in FUNCTIONS
        return head._replace(code=0, start=2, quantity=None) if known else head

    def build(self, command: CommandShape, form: FormShape, address: int, data: bytes, role: Role) -> bytes:
        function = command.function or 0
        # The data of a read reply begin with those of its request.
        own = data[4:] if role is Role.REPLY and function in READS else data
        return self.completed(bytes((address, function)) + own)

    def parts(self, frame: bytes, can_id: int | None = None) -> tuple[Part, ...]:
        return super().parts(frame, can_id)[: 2 if len(frame) > 1 and not frame[1] & 0x80 else 3]


def _u16(data: bytes, at: int) -> int:
    return int.from_bytes(data[at : at + 2], "big")


_ANY_UNIT = rb"[\x00-\xf7]"
#: Address, then a function or an exception of one; a look-ahead keeps the search at the address.
_STARTS = _ANY_UNIT + rb"(?=[\x01-\x06\x0f\x10\x81-\x86\x8f\x90]|\Z)"


class _ModbusSlicer(Slicer):
    """Lengths by function: a read has 8 bytes, or 5 and its byte count; a write of several 8, or 9 and its count."""

    heads = bytes(range(LAST_UNIT + 1))
    starts = _STARTS
    strong_head = False
    strong_check = True
    longest = 256

    def __init__(self, link: ModbusLink, expects: Callable[[int, int], int], units: frozenset[int] = frozenset()) -> None:
        self._link = link
        self._expects = expects
        #: By first byte, whether it is an address; empty where each is that Modbus has.
        self._addresses = bytes(byte in units for byte in range(256)) if units else b""
        if units:
            self.heads = bytes(sorted(units))
            self.starts = b"[" + b"".join(rb"\x%02x" % unit for unit in self.heads) + b"]" + _STARTS[len(_ANY_UNIT) :]

    def _sizes(self, buffer: bytes, at: int, end: int) -> tuple[int, ...]:
        """Return the lengths that a frame at `at` can have, ascending, or `MORE` while that cannot be told."""
        have = end - at
        if have < 2:
            return (MORE,)
        function = buffer[at + 1]
        if function in READS:
            if have < 6:
                # The quantity is not there yet: a request is 8 bytes, and a shorter reply may come before it.
                return (MORE,)
            count = buffer[at + 2]
            quantity = buffer[at + 4] << 8 | buffer[at + 5]
            is_request = 1 <= quantity <= (_MOST_COILS if function < 3 else 125)
            if 1 <= count <= _MOST_COUNTED and (function < 3 or count % 2 == 0) and buffer[at] != 0:
                if not is_request or count == 3:
                    return (5 + count,)
                return (5 + count, 8) if count < 3 else (8, 5 + count)
            return (8,) if is_request else ()
        if function in WRITE_ONE:
            return (8,)
        if function in WRITE_MANY:
            if have < 7:
                return (MORE,)
            quantity = buffer[at + 4] << 8 | buffer[at + 5]
            count = buffer[at + 6]
            if quantity and count == self._link.byte_count(function, buffer[at + 2] << 8 | buffer[at + 3], quantity):
                return (8, 9 + count)
            return (8,)
        if function & 0x80 and function & 0x7F in FUNCTIONS:
            if have < 3:
                return (MORE,)
            return (5,) if 1 <= buffer[at + 2] <= LAST_EXCEPTION else ()
        return ()

    def look(self, buffer: bytes, at: int, end: int, closed: bool) -> int:
        if buffer[at] > LAST_UNIT:
            return 0
        found = 0
        for length in self._sizes(buffer, at, end):
            if found and length != found + 1:
                break
            stop = at + length
            if length == MORE or stop > end:
                return found if closed else MORE
            if modbus_crc(buffer[at : stop - 2]) == buffer[stop - 2] | buffer[stop - 1] << 8:
                if found:
                    return TIE
                found = length
        return found

    def lengths(self, buffer: bytes, at: int, end: int) -> list[int]:
        result: list[int] = []
        if buffer[at] > LAST_UNIT:
            return result
        for length in self._sizes(buffer, at, end):
            stop = at + length
            if length == MORE or stop > end:
                return [*result, MORE]
            if modbus_crc(buffer[at : stop - 2]) == buffer[stop - 2] | buffer[stop - 1] << 8:
                result.append(length)
        return result

    def preferred(self, buffer: bytes, at: int, lengths: Sequence[int]) -> int:
        awaited = self._expects(buffer[at], buffer[at + 1])
        return 5 + awaited if awaited and 5 + awaited in lengths else 0

    def damaged(self, buffer: bytes, at: int, end: int) -> list[int]:
        result: list[int] = []
        if buffer[at] > LAST_UNIT:
            return result
        for length in self._sizes(buffer, at, end):
            if length == MORE or at + length > end:
                return [*result, MORE]
            result.append(length)
        return result

    def foreign(self, buffer: bytes, at: int) -> bool:
        known = at + 1 >= len(buffer) or buffer[at + 1] in FUNCTIONS or buffer[at + 1] ^ 0x80 in FUNCTIONS
        return buffer[at] <= LAST_UNIT and not known

    def whole(self, data: bytes) -> bool:
        size = len(data)
        if not 4 <= size <= self.longest or data[0] > LAST_UNIT:
            return False
        if modbus_crc(data[:-2]) != data[-2] | data[-1] << 8:
            return False
        if data[1] in READS and size not in (8, 5 + data[2]) and size < 5 + data[2]:
            return False
        # A frame that lost the 00 at its end checks too.
        return self.look(data + b"\0", 0, size + 1, True) != size + 1

    def scan(self, codes: Bytes) -> Found | None:
        import numpy as np

        from analyzer.link.arrays import Crc16, Found, windows

        room = max(0, len(codes) - _LONGEST_SCANNED)
        # A table of bytes is looked up in faster than arrays do it.
        kinds = np.frombuffer(codes[1 : room + 1].tobytes().translate(_KINDS), dtype=np.uint8)
        if self._addresses:
            kinds = kinds * np.frombuffer(codes[:room].tobytes().translate(self._addresses), dtype=np.bool_)
        else:
            kinds = kinds * (codes[:room] <= LAST_UNIT)
        reads, writes_one, writes_many, exceptions = (kinds == kind for kind in range(1, 1 + len(_FUNCTIONS_OF_KIND)))
        # Of each place: whether a frame of 8 bytes can begin there, and the other length that one can have, 0 for none. To
        # reckon it at all places is faster than to pick out first where a read can begin.
        asks, other = self._of_reads([codes[place : room + place] for place in range(6)])
        eight = (asks & reads) | writes_one | writes_many
        other = other * reads + (codes[2 : room + 2] - 1 < LAST_EXCEPTION) * exceptions * np.uint8(5)
        # Flags are searched several times as fast as numbers; all else is done for the places that are left.
        places = np.flatnonzero(eight | (other != 0))
        eight, other = eight.take(places), other.take(places)
        own = np.flatnonzero(writes_many.take(places))
        other[own] = self._of_writes(windows(codes, places.take(own), 8))
        long = np.flatnonzero(other > _LONGEST_SCANNED)
        other[long] = 0
        crc, sizes = Crc16(codes, _LONGEST_SCANNED), np.zeros(len(places), dtype=np.uint8)
        own = np.flatnonzero(other != 0)
        own = own.take(np.flatnonzero(crc.fit_each(places.take(own), other.take(own))))
        sizes[own] = other.take(own)
        own = np.flatnonzero(eight)
        own = own.take(np.flatnonzero(crc.fit(places.take(own), 8)))
        # Of two lengths the shorter counts; where they are one apart, it is a tie.
        beside = sizes.take(own)
        unsure = places.take(np.concatenate((long, own.compress(beside > 0))))
        sizes[own] = np.where((beside == 7) | (beside == 9), 0, np.where((beside > 0) & (beside < 8), beside, 8))
        own = np.flatnonzero(sizes != 0)
        found = sizes.take(own)
        # Where two lengths are one apart, the longer was looked at, too.
        more = ((found == 7) & eight.take(own)) | ((found == 8) & (other.take(own) == 9))
        return Found(places.take(own), found.astype(np.int64), (found + more).astype(np.int64), np.sort(unsure))

    @staticmethod
    def _of_reads(columns: Sequence[Bytes]) -> tuple[Flags, Bytes]:
        """Say of places whether a request to read can begin there, which has 8 bytes, and how long a reply is; 0: none, or 8.

        `columns`: the first bytes that would be theirs.
        """
        address, function, count, _, high, low = columns
        few = function < 3
        asks = (high == 0) & (low > 0) & ((low <= MOST_REGISTERS) | few)
        most = _MOST_COILS >> 8
        asks |= few & (high > 0) & ((high < most) | ((high == most) & (low <= _MOST_COILS & 0xFF)))
        tells = (count > 0) & (count <= _MOST_COUNTED) & ((count & 1 == 0) | few) & (address > 0)
        sizes = tells * (count + 5)
        return asks | (sizes == 8), sizes * (sizes != 8)

    def _of_writes(self, rows: Bytes) -> Bytes:
        """Return how long a write of several registers or coils is, by its first 8 bytes; 0: it is none. At most 255."""
        import numpy as np

        _, function, *registers, count, _ = rows.T
        register, quantity = (high.astype("i8") << 8 | low for high, low in (registers[:2], registers[2:]))
        wanted = quantity * 2
        for number, odd in self._link.odd_counts.items():
            wanted[register == number] = odd
        coils = function == 0x0F
        wanted[coils] = (quantity[coils] + 7) // 8
        sizes: Bytes = ((quantity > 0) & (count == wanted)) * (np.minimum(count, 0xFF - 9) + 9)
        return sizes


#: How frames of these functions are told apart, and the place of its kind, from 1, by each function.
_FUNCTIONS_OF_KIND = (READS, WRITE_ONE, WRITE_MANY, _EXCEPTIONS)
_KINDS = bytes(next((kind for kind, own in enumerate(_FUNCTIONS_OF_KIND, 1) if function in own), 0) for function in range(256))


class _ModbusFinder(Finder):
    """Requests of the functions that read and write registers; those of other functions where they check."""

    longest = _ModbusSlicer.longest
    headless = True

    def __init__(self, link: ModbusLink, commands: Sequence[CommandShape]) -> None:
        self._link = link
        self._quantities: dict[tuple[int, int], int] = {}
        for command in commands:
            self._quantities.setdefault((command.function or 0, command.code), command.quantity)

    def at(self, buffer: bytes, start: int, can_id: int | None = None) -> Candidates:
        end = len(buffer)
        if buffer[start] > LAST_UNIT:
            return NO_CANDIDATES
        if start + 2 > end:
            return Candidates(open=True)
        function = buffer[start + 1]
        if function not in FUNCTIONS:
            return NO_CANDIDATES
        if start + 4 > end:
            return Candidates(open=True)
        register = _u16(buffer, start + 2)
        quantity = self._quantities.get((function, register))
        misfit, note, size = False, "", 0 if function in READS else 2
        stop, data_at = start + 8, start + 4
        if function in WRITE_MANY:
            count = buffer[start + 6] if start + 6 < end else None
            stop, data_at = start + 9 + (count or 0), start + 7
            if quantity is not None:
                size = self._link.byte_count(function, register, quantity)
                asked = _u16(buffer, start + 4) if start + 6 <= end else quantity
                misfit = asked != quantity or count not in (None, size)
                if misfit:
                    note = f"{asked} registers in {'?' if count is None else count} bytes, expected {quantity}"
                else:
                    stop = start + 9 + size
        if quantity is None:
            note = f"register 0x{register:04X}"
        complete = stop <= end
        candidate =Candidate(
            start, min(stop, end), end, buffer[start], function, register, start + 3, quantity is not None,
            complete and modbus_crc(buffer[start:stop]) == 0, complete, buffer[data_at : data_at + size], (size,), misfit,
            first_only=quantity is None, note=note,
        )  # fmt: skip
        return Candidates((candidate,), not complete)

    def checked(self, buffer: bytes, start: int, stop: int) -> Iterator[Candidate]:
        end = len(buffer)
        if start + 4 > end or buffer[start] > LAST_UNIT:
            return
        function = buffer[start + 1]
        if not 0 < function < 0x80 or function in FUNCTIONS:
            return
        note = f"Modbus function 0x{function:02X}"
        for last in range(max(start + 4, stop), min(end, start + self.longest) + 1):
            if modbus_crc(buffer[start:last]) == 0:
                yield Candidate(start, last, last, buffer[start], None, function, start + 1, False, True, True, note=note)
