"""CAN 2.0A: the bus delimits the frames.

identifier 001 | F6 01 40 02 | 3A      code, data | sum8 over the identifier and all before it
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from analyzer.catalogue import Role
from analyzer.link.interface import Check, Head, Link, Part, Slicer

if TYPE_CHECKING:
    from analyzer.catalogue import Command, Dialect, Form


@dataclass(frozen=True)
class CanLink(Link):
    """CAN 2.0A: the identifier is the address of the drive, in requests and replies alike; sum8 over ID and data."""

    kind = "can"
    deciding_bytes = 1

    def identifier(self, command: Command, address: int) -> int | None:
        return address

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
