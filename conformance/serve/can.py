"""A CAN bus of emulated drives behind a python-can interface.

    INTERFACE:CHANNEL[,bitrate=N][,NAME=VALUE...]      udp_multicast:239.74.163.2    slcan:/dev/ttyACM0,bitrate=500000

Rules:

1. The drives' own frames are never taken for requests. An interface that hands them back (`HANDS_BACK`) returns each of
   them once and in order, so what comes back is told from the host's frames by what was sent and has not returned yet.
2. Frames that are no CAN 2.0 data frames with 11 bits are logged and reach no drive.
3. With `bitrate` drives at another rate are not there; without it each drive's rate is right.
"""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import can

from analyzer.catalogue import Role
from analyzer.errors import ServotapError, UsageError
from analyzer.records import CanFrame
from analyzer.values import quote
from conformance.drives.can_bus import CanBus
from conformance.serve.clock import Clock
from conformance.serve.stop import Stop

#: Interfaces of python-can that hand a sender its own frames back, whatever they are told.
HANDS_BACK = frozenset({"udp_multicast"})
#: How long a frame that was sent may take to return.
_RETURN_NS = 500_000_000
#: The longest wait for a frame: how late the wish to end is noticed.
_WAIT_NS = 100_000_000
_IDLE_NS = 200_000_000
#: Frames taken before the bus gets its turn.
_AT_ONCE = 64
#: Failures to receive in a row after which the interface is taken to be gone.
_FAILURES = 20


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
        options[name] = _value(value)
    rate = options.get("bitrate", 1)
    if not isinstance(rate, int) or rate <= 0:
        raise UsageError(f"bitrate: got {quote(str(rate))}, expected bits per second, as in bitrate=500000")
    return interface, channel, options


def _value(text: str) -> int | float | str:
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return text


class CanPort:
    """A python-can bus. Raises UsageError where it cannot be opened."""

    def __init__(self, interface: str, channel: str, **options: Any) -> None:
        self.name = f"{interface}:{channel}"
        self.bitrate: int | None = options.get("bitrate")
        known = can.VALID_INTERFACES
        if interface not in known:
            raise UsageError(f"no CAN interface {quote(interface)} (python-can has {', '.join(sorted(known))})")
        try:
            self._bus = can.Bus(interface=interface, channel=channel, **options)
        # Each interface raises what its library raises.
        except Exception as error:
            raise UsageError(f"cannot open {self.name}: {type(error).__name__}: {error}") from None
        self._own: deque[tuple[int, int, bytes]] = deque()
        self._hands_back = interface in HANDS_BACK or bool(options.get("receive_own_messages"))
        self._failures = 0
        self.lost = 0

    def receive(self, timeout_ns: int) -> CanFrame | None:
        """Return the next frame of the others, None after the timeout.

        Raises ServotapError when the interface is gone.
        """
        try:
            message = self._bus.recv(timeout_ns / 1e9)
        # A line of garbage on an adapter's port raises from deep inside.
        except Exception as error:
            self._failures += 1
            if self._failures >= _FAILURES:
                raise ServotapError(f"{self.name} is gone: {type(error).__name__}: {error}") from None
            time.sleep(0.01)
            return None
        self._failures = 0
        if message is None:
            return None
        frame = CanFrame(
            None,
            self.name,
            message.arbitration_id,
            bytes(message.data or b""),
            Role.REQUEST,
            bool(message.is_extended_id),
            bool(message.is_remote_frame),
            bool(message.is_error_frame),
            bool(message.is_fd),
        )
        return None if not message.is_rx or (self._hands_back and self._returned(frame)) else frame

    def _returned(self, frame: CanFrame) -> bool:
        """Say whether a frame is one of ours that has come back."""
        now_ns = time.monotonic_ns()
        while self._own and now_ns - self._own[0][0] > _RETURN_NS:
            self._own.popleft()
        for index, (_, can_id, data) in enumerate(self._own):
            if can_id == frame.id and data == frame.data:
                del self._own[index]
                return True
        return False

    def send(self, frame: CanFrame) -> None:
        """Send a frame of a drive; one that the interface does not take is lost."""
        message = can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=frame.extended)
        if self._hands_back:
            self._own.append((time.monotonic_ns(), frame.id, frame.data))
        try:
            self._bus.send(message)
        except Exception:
            self.lost += 1
            if self._hands_back:
                self._own.pop()

    def close(self) -> None:
        """Close the interface."""
        with contextlib.suppress(Exception):
            self._bus.shutdown()


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
    while not stop.is_set:
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
