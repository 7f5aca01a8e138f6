"""CAN 2.0A: the bus delimits the frames.

identifier 001 | F6 01 40 02 | 3A      code, data | sum8 over the identifier and all before it
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from analyzer.link.interface import Check, CommandShape, FormShape, Head, Link, Part, Role, Slicer


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
