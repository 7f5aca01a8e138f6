"""A line with emulated drives on its other end, in virtual time: a wait is a jump, and nothing can break.

    host <- EmulatedLine -> SerialBus or CanBus -> drives

The clock moves only during `receive` and `wait`. Tests and claims act on the drives through `bus`: they press a switch, turn
the shaft, cut the power.
"""

from __future__ import annotations

from collections.abc import Sequence

from analyzer.live.endpoint import Endpoint
from analyzer.records import CanFrame, Chunk
from conformance.bus.line import Line, LineLost
from conformance.drives.can_bits import frame_bits
from conformance.drives.can_bus import CanBus
from conformance.drives.drive import Drive
from conformance.drives.serial_bus import SerialBus
from conformance.drives.wire_faults import WireFaults

_SECOND_NS = 1_000_000_000


class EmulatedLine(Line):
    """A line to emulated drives, all of serial dialects or all of CAN.

    `speed`: the host's bits per second, None: the rate of each drive. `wire_time` False: bytes take no time.
    `echo`: the host hears its own bytes. `faults`: damage on the wire. Raises ValueError for drives of two kinds
    of bus, or none.
    """

    emulated = True

    def __init__(
        self,
        drives: Sequence[Drive],
        *,
        name: str = "emulated",
        speed: int | None = None,
        wire_time: bool = True,
        echo: bool = False,
        faults: WireFaults | None = None,
    ) -> None:
        kinds = {drive.dialect.bus for drive in drives}
        if len(kinds) != 1:
            raise ValueError(f"expected drives of one kind of bus, got {', '.join(sorted(kinds)) or 'no drive'}")
        self.bus: SerialBus | CanBus
        if kinds == {"can"}:
            self.bus = CanBus(drives, name=name, speed=speed, wire_time=wire_time, faults=faults)
        else:
            self.bus = SerialBus(drives, name=name, speed=speed, wire_time=wire_time, echo=echo, faults=faults)
        shown = " ".join(station.name for station in self.bus.stations)
        kind = "can" if kinds == {"can"} else "serial"
        self.endpoint = Endpoint(f"emulated: {shown}", kind, "emulated", name, self._speed)
        self._closed = False

    @property
    def _speed(self) -> int:
        return self.bus.speed or self.bus.stations[0].speed

    def now_ns(self) -> int:
        return self.bus.now_ns

    def write(self, item: bytes | CanFrame) -> int:
        """Put an item on the wire and return when the last of it will be there; time stands still. Only a gate calls this."""
        bus = self.bus
        if self._closed:
            raise LineLost(f"{self.endpoint.name} is closed")
        if isinstance(bus, SerialBus):
            if isinstance(item, CanFrame):
                raise TypeError("expected bytes for a serial line, got a CAN frame")
            return bus.send(item)
        if not isinstance(item, CanFrame):
            raise TypeError("expected a CAN frame for a CAN bus, got bytes")
        before_ns = bus.busy_ns
        bus.put(item)
        if not before_ns:
            return bus.now_ns + bus.busy_ns
        # It waits behind another one; that a lower identifier may go first is left aside.
        bits = frame_bits(item.id, item.data, extended=item.extended)
        return bus.now_ns + before_ns + bits * _SECOND_NS // self._speed

    def receive(self, timeout_ns: int) -> Chunk | CanFrame | None:
        """Return what comes next, letting virtual time pass until it is there; None after the time-out."""
        if self._closed:
            raise LineLost(f"{self.endpoint.name} is closed")
        return self.bus.receive(timeout_ns)

    def set_speed(self, bits_per_second: int) -> None:
        """Change the host's speed: drives at another one hear garbled bytes, on CAN nothing."""
        self.bus.speed = bits_per_second
        self.endpoint = self.endpoint.at(bits_per_second)

    def close(self) -> None:
        self._closed = True
