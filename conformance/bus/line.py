"""A line: the host's end of a bus. Real lines run on the real clock, emulated lines on a virtual clock.

Only a gate (`conformance.gate.gate`) may call `write`, where bytes leave. All other code sends through a gate.

Times are nanoseconds of the line's own clock, which begins anywhere and never goes back; `anchor_ns` is UTC at its zero.
The clock of an emulated line moves only during waits, so waiting takes no real time.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

from analyzer.live.endpoint import Endpoint
from analyzer.records import CanFrame, Chunk
from conformance.bus.can_port import Acceptance
from conformance.claim import RigFault


class LineLost(RigFault):
    """The port has gone: unplugged, closed by the other end, or failing."""


class Line(ABC):
    """The host's end of one bus.

    `endpoint`: what it was opened from. `emulated`: no real drive is on the other end, nothing can break.
    """

    endpoint: Endpoint
    emulated: bool = False
    anchor_ns: int = 0
    #: Which frames of a CAN bus are read.
    acceptance: Acceptance | None = None
    #: When a setting was last written, on this line's clock; None: none was. Hasty writes are dropped by real drives.
    setting_ns: int | None = None

    @property
    def is_can(self) -> bool:
        """Whether frames of CAN are sent, else bytes of a serial line."""
        return self.endpoint.bus_kind == "can"

    @property
    def passed(self) -> int:
        """Bytes that came and were not read: CAN frames of others, and what came faster than any line."""
        return 0 if self.acceptance is None else self.acceptance.passed

    @property
    def byte_ns(self) -> int:
        """Time of one byte on a serial line; 0 on CAN, and where no line speed is known."""
        return self.endpoint.byte_ns

    @property
    def brings(self) -> int:
        """Bytes that a serial line brings in a second, at the usual speed where none is known."""
        return self.endpoint.bits_per_second // self.endpoint.bits_per_byte

    @abstractmethod
    def now_ns(self) -> int:
        """Return the time of this line's clock."""

    @abstractmethod
    def write(self, item: bytes | CanFrame) -> int:
        """Send bytes (serial) or one frame (CAN) and return the time at which the last of it is on the wire.

        Only a gate calls this. Raises ServotapError (`LineLost`) when the port is gone.
        """

    @abstractmethod
    def receive(self, timeout_ns: int) -> Chunk | CanFrame | None:
        """Return what comes next, with its time, or None when `timeout_ns` have passed without anything.

        The host's own bytes never come back here, even if the adapter or interface echoes.
        Raises ServotapError (`LineLost`) when the port is gone.
        """

    def wait(self, duration_ns: int) -> list[Chunk | CanFrame]:
        """Let time pass and return what came meanwhile."""
        until_ns = self.now_ns() + duration_ns
        got = []
        while (left_ns := until_ns - self.now_ns()) > 0:
            item = self.receive(left_ns)
            if item is not None:
                got.append(item)
        return got

    @abstractmethod
    def set_speed(self, bits_per_second: int) -> None:
        """Change this end's speed (baud or bit rate). Raises UsageError where it cannot be changed (TCP)."""

    @abstractmethod
    def close(self) -> None:
        """Give the port back; it may be done twice."""
