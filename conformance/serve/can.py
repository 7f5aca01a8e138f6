"""A CAN bus of emulated drives behind a python-can interface.

    INTERFACE:CHANNEL[,bitrate=N][,NAME=VALUE...]      udp_multicast:239.74.163.2    slcan:/dev/ttyACM0,bitrate=500000

Rules:

1. The drives' own frames never count as requests (`conformance.bus.can_port`).
2. Only CAN 2.0 data frames with 11 bits reach a drive; all others are only logged.
3. With `bitrate`, drives at another rate receive nothing; without it each drive's rate is right.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from analyzer.errors import UsageError
from analyzer.live.endpoint import value_of
from analyzer.live.reader_port import Stop
from analyzer.values import quote
from conformance.bus.can_port import CanPort
from conformance.drives.can_bus import CanBus
from conformance.serve.clock import Clock

#: The longest wait for a frame: how late the wish to end is noticed.
_WAIT_NS = 100_000_000
_IDLE_NS = 200_000_000
#: Frames taken before the bus gets its turn.
_AT_ONCE = 64


def parse_endpoint(text: str) -> tuple[str, str, dict[str, Any]]:
    """Return interface, channel and options of `INTERFACE:CHANNEL[,NAME=VALUE...]`.

    Raises UsageError for anything else.
    """
    place, *parts = text.split(",")
    interface, colon, channel = place.partition(":")
    if not colon or not interface or not channel:
        raise UsageError(f"got {quote(text)}, expected INTERFACE:CHANNEL[,bitrate=N], as in udp_multicast:239.74.163.2")
    options: dict[str, Any] = {}
    for part in parts:
        name, equals, value = part.partition("=")
        if not equals or not name.isidentifier():
            raise UsageError(f"got {quote(part)} after {quote(place)}, expected NAME=VALUE, as in bitrate=500000")
        options[name] = value_of(value)
    rate = options.get("bitrate", 1)
    if not isinstance(rate, int) or rate <= 0:
        raise UsageError(f"bitrate: got {quote(str(rate))}, expected bits per second, as in bitrate=500000")
    return interface, channel, options


def serve(
    bus: CanBus,
    port: CanPort,
    clock: Clock,
    stop: Stop,
    *,
    until_ns: int | None = None,
    tick: Callable[[int], None] | None = None,
) -> None:
    """Run a bus until `stop` or `until_ns`. `tick(now_ns)` is called now and then, at least five times a second."""
    ticked_ns = 0
    while not stop.asked:
        now_ns = clock.now_ns()
        bus.run_until(now_ns)
        for frame in bus.received():
            port.send(frame)
        if until_ns is not None and now_ns >= until_ns:
            return
        if tick is not None and now_ns - ticked_ns >= _IDLE_NS:
            ticked_ns = now_ns
            tick(now_ns)
        now_ns = clock.now_ns()
        wake_ns = min(t for t in (bus.next_ns(), until_ns, now_ns + _WAIT_NS) if t is not None)
        got = port.receive(max(0, wake_ns - now_ns))
        for _ in range(_AT_ONCE):
            if got is None:
                break
            bus.run_until(clock.now_ns())
            bus.put(got)
            got = port.receive(0)
