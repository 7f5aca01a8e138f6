"""CAN: the bus delimits the frames.

identifier 001 | F6 01 40 02 | 3A      of a drive: code, data | sum8 over the identifier and all before it
identifier 18FEF100 | 8 bytes          of another node: the identifier says what the data are
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from analyzer.link.interface import Check, CommandShape, FormShape, Head, Link, Part, Role, Slicer

#: Marks an identifier of 29 bits, as SocketCAN and DBC files do.
EXTENDED_ID = 1 << 31
#: J1939: a group number of this format or above has no destination in its low byte.
_J1939_BROADCAST = 0xF0


@dataclass(frozen=True)
class CanLink(Link):
    """CAN 2.0A: the identifier is the address of the drive, in requests and replies alike; sum8 over ID and data."""

    tells_length = True
    kind = "can"
    deciding_bytes = 1

    #: The fewest data bytes of a frame: a code and a checksum.
    shortest = 2

    def identifier(self, command: CommandShape, address: int) -> int | None:
        return address

    def slicer(self, commands: Sequence[CommandShape], expects: Callable[[int, int], int]) -> Slicer:
        raise TypeError("CAN frames need no slicer: the bus delimits them")

    def parse(self, frame: bytes, can_id: int | None = None) -> Head:
        return Head(can_id or 0, Role.UNKNOWN, frame[0] if frame else None, None, 1, max(1, len(frame) - 1))

    def checks(self, frame: bytes, can_id: int | None = None) -> tuple[Check, ...]:
        expected = bytes((((can_id or 0) + sum(frame[:-1])) & 0xFF,))
        return (Check("checksum", max(0, len(frame) - 1), frame[-1:], expected),)

    def fits(self, frame: bytes, can_id: int | None = None) -> bool:
        return len(frame) > 0 and ((can_id or 0) + sum(frame) - frame[-1]) & 0xFF == frame[-1]

    def build(self, command: CommandShape, form: FormShape, address: int, data: bytes, role: Role) -> bytes:
        code = command.code if form.code is None else form.code
        return self.completed(bytes((code,)) + data, address)

    def completed(self, body: bytes, can_id: int | None = None) -> bytes:
        return body + bytes((((can_id or 0) + sum(body)) & 0xFF,))

    def parts(self, frame: bytes, can_id: int | None = None) -> tuple[Part, ...]:
        return (Part(0, 1, "code", f"0x{frame[0]:02X}"),) if frame else ()


@dataclass(frozen=True)
class MessageLink(Link):
    """Messages by their identifiers, those of 29 bits with `EXTENDED_ID`. All data are the message's own.

    `codes`: of each identifier the code of its message; `groups`: likewise of J1939 group numbers, whoever sends them.
    """

    codes: Mapping[int, int] = field(default_factory=dict)
    groups: Mapping[int, int] = field(default_factory=dict)

    kind = "can"
    checked = False
    by_identifier = True
    tells_length = True

    def claims(self, can_id: int) -> bool:
        return self._code(can_id) is not None

    def _code(self, can_id: int) -> int | None:
        code = self.codes.get(can_id)
        return self.groups.get(j1939_group(can_id)) if code is None and can_id & EXTENDED_ID else code

    def slicer(self, commands: Sequence[CommandShape], expects: Callable[[int, int], int]) -> Slicer:
        raise TypeError("CAN frames need no slicer: the bus delimits them")

    def parse(self, frame: bytes, can_id: int | None = None) -> Head:
        can_id = can_id or 0
        return Head(can_id & ~EXTENDED_ID, Role.MESSAGE, self._code(can_id), None, 0, len(frame))

    def checks(self, frame: bytes, can_id: int | None = None) -> tuple[Check, ...]:
        return ()

    def build(self, command: CommandShape, form: FormShape, address: int, data: bytes, role: Role) -> bytes:
        return data

    def completed(self, body: bytes, can_id: int | None = None) -> bytes:
        return body

    def parts(self, frame: bytes, can_id: int | None = None) -> tuple[Part, ...]:
        return ()


def j1939_group(can_id: int) -> int:
    """Return the group number (PGN) of an identifier of 29 bits: without priority and source, and without a destination."""
    group = can_id >> 8 & 0x3FFFF
    return group if group >> 8 & 0xFF >= _J1939_BROADCAST else group & 0x3FF00
