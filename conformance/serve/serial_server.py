"""A serial bus on the real clock, behind a port with clients.

The loop sleeps until a byte comes or an event of the bus is due. Bytes of a client are on the wire from the time when they
were read, for as long as their bits take.
"""

from __future__ import annotations

import select
from collections.abc import Callable, Sequence
from typing import Protocol

from analyzer.live.reader_port import Stop
from conformance.drives.serial_bus import SerialBus
from conformance.serve.clock import Clock

#: The longest sleep: how late what is done now and then (`tick`) can be.
IDLE_NS = 200_000_000
#: If the line stays busy with a client's bytes for longer, the server stops reading, so that the client's writes block.
BACKLOG_NS = 100_000_000


class SerialPort(Protocol):
    """The port of the clients. `name`: the path or address to open; `lost`: the number of unread bytes."""

    name: str
    lost: int

    def descriptors(self) -> Sequence[int]:
        """Return the descriptors that become readable when there is something to do."""

    def read(self, ready: Sequence[int]) -> bytes:
        """Return what clients have sent; empty if nothing. Never blocks, never raises for what a client does."""

    def write(self, data: bytes) -> None:
        """Send bytes to the clients; bytes that no client takes are lost. Never blocks."""

    def speed(self) -> int | None:
        """Return the clients' line speed in bits per second, None where it is not known."""

    def idle(self) -> None:
        """Do periodic work."""

    def close(self) -> None:
        """Close the port."""


def serve(
    bus: SerialBus,
    port: SerialPort,
    clock: Clock,
    stop: Stop,
    *,
    until_ns: int | None = None,
    tick: Callable[[int], None] | None = None,
) -> None:
    """Run a bus until `stop` or `until_ns`. `tick(now_ns)` is called now and then, at least five times a second."""
    ticked_ns = 0
    while not stop.asked:
        # The client may change its speed between its request and the reply, which then reaches it garbled.
        bus.speed = port.speed()
        now_ns = clock.now_ns()
        bus.run_until(now_ns)
        data = bus.received()
        if data:
            port.write(data)
        if until_ns is not None and now_ns >= until_ns:
            return
        if now_ns - ticked_ns >= IDLE_NS:
            ticked_ns = now_ns
            port.idle()
            if tick is not None:
                tick(now_ns)
        descriptors = [stop.fileno()]
        if bus.busy_ns < BACKLOG_NS:
            descriptors += port.descriptors()
        due_ns = bus.next_ns()
        wake_ns = min(t for t in (due_ns, until_ns, ticked_ns + IDLE_NS) if t is not None)
        ready, _, _ = select.select(descriptors, [], [], max(0, wake_ns - clock.now_ns()) / 1e9)
        ready = [fd for fd in ready if fd != stop.fileno()]
        if ready:
            data = port.read(ready)
            if data:
                bus.run_until(clock.now_ns())
                bus.speed = port.speed()
                bus.send(data)
