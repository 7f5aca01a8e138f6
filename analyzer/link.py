"""Links: how a dialect delimits and checks its frames, and what stands in their heads.

    head link   FA 01 F6 | 01 40 02 | 34        head, address, code | data | sum8 of all before
    package     FC | 5 slots of 10 bytes | sum8  52 bytes
    Modbus-RTU  01 10 00 F6 00 02 04 | data | CRC16, low byte first
    LK          3E A2 01 04 E5 | data | sum8     head, code, address, length, sum8 of the head | data | sum8 of the data
    CAN         ID | F6 01 40 02 | 3A            ID, code, data, sum8 of ID and all before

A link knows bytes and lengths, no command: a `Slicer` is a link that has been told which lengths the codes of one
dialect have. `Slicer.look` answers with the length of a frame that is complete and whose check fits, 0 for none, `MORE`
while that is open, and `TIE` where two lengths check. It never raises, whatever the bytes.

Rules kept here:
- An answer that is not `MORE` rests on bytes that have come and does not change with those that follow, so that it does
  not matter where the bytes were cut into reads.
- Of several lengths at one place the shortest that checks is the answer; what follows a frame can still speak for
  another (`Slicer.lengths`). Only lengths one apart are a `TIE`: a Modbus frame whose CRC ends in 00 checks one byte
  short too.
- Heads above 0xF7 are never taken for Modbus addresses. The length of an LK frame is believed only behind a fitting
  head sum.

Not known here: whether bytes that check are a frame. Where that is doubtful, `analyzer.framer` weighs it.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from typing import TYPE_CHECKING, NamedTuple

from fastcrc import crc16 as _crc16

from analyzer.catalogue import Role

if TYPE_CHECKING:
    from analyzer.catalogue import Command, Dialect, Form

#: `Slicer.look`: a frame that may begin here is still arriving.
MORE = -1
#: `Slicer.look`: frames of two lengths begin here, one byte apart, and both check.
TIE = -2

modbus_crc: Callable[[bytes], int] = _crc16.modbus


def sum8(data: bytes) -> int:
    """Return the low byte of the sum of `data`."""
    return sum(data) & 0xFF


class Head(NamedTuple):
    """What a frame says of itself, before any command is known.

    `code` None: the frame does not carry it (a Modbus read reply, an exception). `start`, `stop`: the own data.
    """

    address: int
    role: Role
    code: int | None
    function: int | None
    start: int
    stop: int
    quantity: int | None = None
    exception: int | None = None


class Check(NamedTuple):
    """One check of a frame: where it stands, what it says and what it should say."""

    name: str
    start: int
    got: bytes
    expected: bytes

    @property
    def ok(self) -> bool:
        """Whether the check fits."""
        return self.got == self.expected


class Part(NamedTuple):
    """A stretch of a frame's head and what it is, for people."""

    start: int
    stop: int
    name: str
    text: str


class Slicer(ABC):
    """Finds the frames of one dialect in a stream of bytes. One instance per port.

    `heads`: values of the first byte of a frame. `starts`: a regular expression for places where a frame may begin.
    `strong_head`: a frame begins with a byte that is rare elsewhere. `strong_check`: bytes that are no frame check so
    seldom (one in 65536) that a fitting check is believed against what follows. `longest`: bytes of the longest frame.
    """

    heads: bytes = bytes(range(256))
    starts: bytes = b"."
    strong_head = True
    strong_check = False
    longest = 64

    @abstractmethod
    def look(self, buffer: bytes, at: int, end: int, closed: bool) -> int:
        """Return the length of the frame at `at` whose check fits, 0 for none, `MORE` if bytes are wanting, or `TIE`.

        `end`: where the bytes end; `closed`: no more will follow.
        """

    @abstractmethod
    def lengths(self, buffer: bytes, at: int, end: int) -> list[int]:
        """Return all lengths at which a frame at `at` checks, in ascending order, then `MORE` if bytes are wanting."""

    def preferred(self, buffer: bytes, at: int, lengths: Sequence[int]) -> int:
        """Return which of several lengths that check an open request awaits, 0 if none does."""
        return 0

    def damaged(self, buffer: bytes, at: int, end: int) -> list[int]:
        """Return the lengths of known frames at `at` whose check alone is wrong, then `MORE` if bytes are wanting."""
        return []

    def foreign(self, buffer: bytes, at: int) -> bool:
        """Say whether what begins at `at` has the head of this dialect and a code that is not in the catalogue."""
        return False

    def whole(self, data: bytes) -> bool:
        """Say whether a burst is one frame, of whatever code and length: its head and its check fit."""
        return False

    def shortened(self, buffer: bytes, at: int, end: int) -> list[int]:
        """Return the lengths at which a package that lost zeros would check, in ascending order."""
        return []


class Link(ABC):
    """How frames of a dialect are delimited and checked. Subclasses are immutable."""

    kind = "serial"
    #: Bytes at the beginning that, with the length, tell address and code; 0 where the bytes alone never do.
    deciding_bytes = 0

    @abstractmethod
    def slicer(self, dialect: Dialect, expects: Callable[[int, int], int]) -> Slicer:
        """Return a slicer for the commands of `dialect`.

        `expects(address, function)`: data bytes of the reply that an open request awaits, 0 for none.
        """

    @abstractmethod
    def parse(self, frame: bytes, can_id: int | None = None) -> Head:
        """Return the head of a complete frame."""

    @abstractmethod
    def checks(self, frame: bytes, can_id: int | None = None) -> tuple[Check, ...]:
        """Return the checks of a complete frame, in the order in which they stand."""

    def fits(self, frame: bytes, can_id: int | None = None) -> bool:
        """Say whether every check of a complete frame fits."""
        return all(check.ok for check in self.checks(frame, can_id))

    @abstractmethod
    def build(self, command: Command, form: Form, address: int, data: bytes, role: Role) -> bytes:
        """Return the bytes of a frame; on CAN its data bytes."""

    @abstractmethod
    def parts(self, frame: bytes, can_id: int | None = None) -> tuple[Part, ...]:
        """Return what the bytes of the head are."""

    @abstractmethod
    def completed(self, body: bytes, can_id: int | None = None) -> bytes:
        """Return a frame that lacks its last check with that check added."""


def _codes(dialect: Dialect, role: Role) -> dict[int, set[int]]:
    """Return the data lengths of each code for one role; an open-ended layout has none to go by."""
    result: dict[int, set[int]] = {}
    for command in dialect.commands:
        for form in command.request_forms if role is Role.REQUEST else command.reply_forms:
            if not form.layout.open_ended:
                code = command.code if form.code is None else form.code
                result.setdefault(code, set()).add(form.layout.byte_length)
    return result


# --- head, address, code, data, sum -------------------------------------------------------------------------------


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

    def slicer(self, dialect: Dialect, expects: Callable[[int, int], int]) -> Slicer:
        """Return a slicer; lengths come from the dialect's layouts."""
        return _HeadSlicer(self, dialect)

    def parse(self, frame: bytes, can_id: int | None = None) -> Head:
        """Return the head; a package is addressed to all (0) and has its head as code."""
        if self.package is not None and frame[:1] == bytes((self.package.head,)):
            return Head(0, Role.REQUEST, self.package.head, None, 1, max(1, len(frame) - 1))
        padded = frame[:3].ljust(3, b"\0")
        role = self.heads.get(padded[0], Role.UNKNOWN)
        return Head(padded[1], role, padded[2], None, 3, max(3, len(frame) - 1))

    def checks(self, frame: bytes, can_id: int | None = None) -> tuple[Check, ...]:
        """Return the one check at the end."""
        return (Check("checksum", len(frame) - 1, frame[-1:], bytes((self.check(frame[:-1]),))),)

    def build(self, command: Command, form: Form, address: int, data: bytes, role: Role) -> bytes:
        """Return the frame of a command."""
        if self.package is not None and command.code == self.package.head:
            return self.completed(bytes((self.package.head,)) + data)
        head = next(h for h, r in self.heads.items() if r is role)
        code = command.code if form.code is None else form.code
        return self.completed(bytes((head, address, code)) + data)

    def completed(self, body: bytes, can_id: int | None = None) -> bytes:
        """Return the body with its check."""
        return body + bytes((self.check(body),))

    def parts(self, frame: bytes, can_id: int | None = None) -> tuple[Part, ...]:
        """Return head, address and code."""
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

    def __init__(self, link: HeadLink, dialect: Dialect) -> None:
        # `sum` itself saves a call for each frame; the low byte is taken where it is compared.
        self._total: Callable[[bytes], int] = sum if link.check is sum8 else link.check
        self._package = link.package
        self._choices: dict[tuple[int, int], tuple[int, ...]] = {}
        self._table: list[tuple[int, ...]] = [_NO_CODES] * 256
        self._known: set[int] = set()
        longest = 4
        for head, role in link.heads.items():
            row = [0] * 256
            for code, sizes in _codes(dialect, role).items():
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


# --- Modbus-RTU ---------------------------------------------------------------------------------------------------

READS = frozenset({0x01, 0x02, 0x03, 0x04})
WRITE_ONE = frozenset({0x05, 0x06})
WRITE_MANY = frozenset({0x0F, 0x10})
FUNCTIONS = READS | WRITE_ONE | WRITE_MANY
#: The highest address, and the last exception code, that Modbus has.
_MODBUS_HIGHEST = 247
_MODBUS_LAST_EXCEPTION = 11


@dataclass(frozen=True)
class ModbusLink(Link):
    """Modbus-RTU. `odd_counts`: registers whose write has another byte count than twice its quantity."""

    odd_counts: Mapping[int, int] = field(default_factory=dict)

    def slicer(self, dialect: Dialect, expects: Callable[[int, int], int]) -> Slicer:
        """Return a slicer; lengths come from the Modbus functions, catalogued or not."""
        return _ModbusSlicer(self, expects)

    def byte_count(self, function: int, register: int, quantity: int) -> int:
        """Return the byte count that a write of several registers or coils must have."""
        if function == 0x0F:
            return (quantity + 7) // 8
        return self.odd_counts.get(register, 2 * quantity)

    def parse(self, frame: bytes, can_id: int | None = None) -> Head:
        """Return the head; a read's role is told from its length, since a reply's byte count fills it exactly."""
        frame = frame or b"\0"
        address, function = frame[0], frame[1] if len(frame) > 1 else 0
        size = len(frame)
        end = max(2, size - 2)
        if function & 0x80:
            return Head(address, Role.REPLY, None, function & 0x7F, 2, end, exception=frame[2] if size > 2 else 0)
        if function in READS:
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
        """Return the CRC, low byte first."""
        return (Check("CRC16", len(frame) - 2, frame[-2:], modbus_crc(frame[:-2]).to_bytes(2, "little")),)

    def build(self, command: Command, form: Form, address: int, data: bytes, role: Role) -> bytes:
        """Return the frame of a command."""
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
        """Return the body with its CRC."""
        return body + modbus_crc(body).to_bytes(2, "little")

    def parts(self, frame: bytes, can_id: int | None = None) -> tuple[Part, ...]:
        """Return address, function and what stands before the own data."""
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


def _u16(data: bytes, at: int) -> int:
    return int.from_bytes(data[at : at + 2], "big")


class _ModbusSlicer(Slicer):
    """Lengths by function: a read has 8 bytes, or 5 and its byte count; a write of several 8, or 9 and its count."""

    heads = bytes(range(_MODBUS_HIGHEST + 1))
    # Address, then a function or an exception of one; a look-ahead keeps the search at the address.
    starts = rb"[\x00-\xf7](?=[\x01-\x06\x0f\x10\x81-\x86\x8f\x90]|\Z)"
    strong_head = False
    strong_check = True
    longest = 256

    def __init__(self, link: ModbusLink, expects: Callable[[int, int], int]) -> None:
        self._link = link
        self._expects = expects

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
            is_request = 1 <= quantity <= (2000 if function < 3 else 125)
            if 1 <= count <= 250 and (function < 3 or count % 2 == 0) and buffer[at] != 0:
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
            return (5,) if 1 <= buffer[at + 2] <= _MODBUS_LAST_EXCEPTION else ()
        return ()

    def look(self, buffer: bytes, at: int, end: int, closed: bool) -> int:
        if buffer[at] > _MODBUS_HIGHEST:
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
        if buffer[at] > _MODBUS_HIGHEST:
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
        if buffer[at] > _MODBUS_HIGHEST:
            return result
        for length in self._sizes(buffer, at, end):
            if length == MORE or at + length > end:
                return [*result, MORE]
            result.append(length)
        return result

    def foreign(self, buffer: bytes, at: int) -> bool:
        known = at + 1 >= len(buffer) or buffer[at + 1] in FUNCTIONS or buffer[at + 1] ^ 0x80 in FUNCTIONS
        return buffer[at] <= _MODBUS_HIGHEST and not known

    def whole(self, data: bytes) -> bool:
        size = len(data)
        if not 4 <= size <= self.longest or data[0] > _MODBUS_HIGHEST:
            return False
        if modbus_crc(data[:-2]) != data[-2] | data[-1] << 8:
            return False
        # A frame that lost the 00 at its end checks too.
        return self.look(data + b"\0", 0, size + 1, True) != size + 1


# --- Lingkong -----------------------------------------------------------------------------------------------------

_LK_HEAD = 0x3E
_LK_LONGEST = 100


@dataclass(frozen=True)
class LkLink(Link):
    """Lingkong: the head carries the length and its own sum; data, where there is any, has another."""

    deciding_bytes = 3

    def slicer(self, dialect: Dialect, expects: Callable[[int, int], int]) -> Slicer:
        """Return a slicer; frames carry their length, codes matter only where there are no data."""
        return _LkSlicer(dialect)

    def parse(self, frame: bytes, can_id: int | None = None) -> Head:
        """Return the head; who sent a frame is not in it."""
        padded = frame[:4].ljust(4, b"\0")
        end = max(5, len(frame) - 1) if len(frame) > 5 else 5
        return Head(padded[2], Role.UNKNOWN, padded[1], None, 5, end)

    def checks(self, frame: bytes, can_id: int | None = None) -> tuple[Check, ...]:
        """Return the sum of the head and, where there are data, theirs."""
        head = Check("head checksum", 4, frame[4:5], bytes((sum8(frame[:4]),)))
        if len(frame) <= 5:
            return (head,)
        return (head, Check("data checksum", len(frame) - 1, frame[-1:], bytes((sum8(frame[5:-1]),))))

    def build(self, command: Command, form: Form, address: int, data: bytes, role: Role) -> bytes:
        """Return the frame of a command."""
        code = command.code if form.code is None else form.code
        head = bytes((_LK_HEAD, code, address, len(data)))
        frame = head + bytes((sum8(head),))
        return frame + data + bytes((sum8(data),)) if data else frame

    def completed(self, body: bytes, can_id: int | None = None) -> bytes:
        """Return the body with its last sum: the head's, or the data's where there are any."""
        return body + bytes((sum8(body if len(body) <= 4 else body[5:]),))

    def parts(self, frame: bytes, can_id: int | None = None) -> tuple[Part, ...]:
        """Return head, code, address and length."""
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

    def __init__(self, dialect: Dialect) -> None:
        self._known: dict[int, set[int]] = {}
        for role in (Role.REQUEST, Role.REPLY):
            for code, sizes in _codes(dialect, role).items():
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


# --- CAN ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class CanLink(Link):
    """CAN 2.0A: the identifier is the address of the drive, in requests and replies alike; sum8 over ID and data."""

    kind = "can"
    deciding_bytes = 1

    def slicer(self, dialect: Dialect, expects: Callable[[int, int], int]) -> Slicer:
        """Raise: a CAN bus delimits its frames itself."""
        raise TypeError(f"{dialect.name} is a CAN dialect; CAN frames need no slicer")

    def parse(self, frame: bytes, can_id: int | None = None) -> Head:
        """Return the head; who sent a frame is not in it."""
        return Head(can_id or 0, Role.UNKNOWN, frame[0] if frame else None, None, 1, max(1, len(frame) - 1))

    def checks(self, frame: bytes, can_id: int | None = None) -> tuple[Check, ...]:
        """Return the sum over the whole ID and the data."""
        expected = bytes((((can_id or 0) + sum(frame[:-1])) & 0xFF,))
        return (Check("checksum", max(0, len(frame) - 1), frame[-1:], expected),)

    def fits(self, frame: bytes, can_id: int | None = None) -> bool:
        """Say whether the sum over the whole ID and the data fits."""
        return len(frame) > 0 and ((can_id or 0) + sum(frame) - frame[-1]) & 0xFF == frame[-1]

    def build(self, command: Command, form: Form, address: int, data: bytes, role: Role) -> bytes:
        """Return the data bytes of a frame."""
        code = command.code if form.code is None else form.code
        return self.completed(bytes((code,)) + data, address)

    def completed(self, body: bytes, can_id: int | None = None) -> bytes:
        """Return the data bytes with their checksum."""
        return body + bytes((((can_id or 0) + sum(body)) & 0xFF,))

    def parts(self, frame: bytes, can_id: int | None = None) -> tuple[Part, ...]:
        """Return the code; the ID stands beside the data."""
        return (Part(0, 1, "code", f"0x{frame[0]:02X}"),) if frame else ()
