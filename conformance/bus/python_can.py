"""A python-can interface, for emulated drives and for lines to real drives.

Rule: `receive` gives only frames of other senders. Some interfaces (`HANDS_BACK`) return each sent frame to its sender, once
and in order. So sent frames are remembered until they return. The identifier alone is not enough: MKS replies have the
identifier of their request, and may have the same bytes.

What an adapter says that cannot be read is counted, and told on standard error: the first at once, the count at the end.
Lines that python-can itself passes over (of an unknown letter) are not seen here.
"""

from __future__ import annotations

import contextlib
import os
import socket
import sys
import time
from collections import deque
from typing import Any

import can

from analyzer.catalogue import Role
from analyzer.errors import ServotapError, UsageError
from analyzer.live.reader_can_socket import with_room
from analyzer.records import CanFrame
from analyzer.values import printable, quote

#: Interfaces of python-can that return frames to their sender, even if told not to.
HANDS_BACK = frozenset({"udp_multicast"})
#: How long a frame that was sent may take to return.
_RETURN_NS = 500_000_000
#: Failures to receive in a row after which the interface is taken to be gone.
_FAILURES = 20
#: What is slept where an interface does not wait itself: looking again at once would take a whole core.
_PAUSE_NS = 1_000_000
#: Bytes that the kernel may keep for a socket: a tenth of a second of a full bus. More would be out of date when read.
_ROOM = 1 << 20


def _give_room(bus: can.BusABC) -> None:
    """Let the kernel keep frames while this process does not run, where an interface is a socket."""
    # Most interfaces have no file, or one that is no socket.
    with contextlib.suppress(NotImplementedError, OSError):
        number = os.dup(bus.fileno())
        try:
            with_room(same := socket.socket(fileno=number), _ROOM)
            same.detach()
        finally:
            os.close(number)


class CanPort:
    """A python-can bus. `heard_as`: the role of those on the other end. Raises UsageError where it cannot be opened."""

    def __init__(self, interface: str, channel: str, *, heard_as: Role = Role.REQUEST, **options: Any) -> None:
        self._heard_as = heard_as
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
        _give_room(self._bus)
        self._own: deque[tuple[int, int, bytes]] = deque()
        self._hands_back = interface in HANDS_BACK or bool(options.get("receive_own_messages"))
        self._failures = 0
        self.lost = 0
        #: What the adapter said that could not be read, and why the last of it could not.
        self.unread, self._why = 0, ""

    def receive(self, timeout_ns: int) -> CanFrame | None:
        """Return the next frame of the others, None after the timeout.

        Raises ServotapError when the interface is gone.
        """
        from_ns = time.monotonic_ns()
        try:
            message = self._bus.recv(timeout_ns / 1e9)
        # A line of garbage on an adapter's port raises from deep inside.
        except Exception as error:
            self._failures += 1
            self._not_read(f"{type(error).__name__}: {error}")
            if self._failures >= _FAILURES:
                raise ServotapError(f"{self.name} is gone: {self._why}") from None
            # python-can keeps a line that is no text, and every later one would fail with it.
            getattr(self._bus, "_buffer", bytearray()).clear()
            time.sleep(0.01)
            return None
        self._failures = 0
        if message is None:
            pause_ns = min(timeout_ns, _PAUSE_NS)
            if time.monotonic_ns() - from_ns < pause_ns:
                time.sleep(pause_ns / 1e9)
            return None
        # CAN FD has lengths that python-can rounds; a remote frame has a length and no data.
        if not message.is_remote_frame and not message.is_fd and len(message.data or b"") != message.dlc:
            self._not_read(f"a frame of length {message.dlc} has {len(message.data or b'')} bytes")
            return None
        frame = CanFrame(
            None,
            self.name,
            message.arbitration_id,
            bytes(message.data or b""),
            self._heard_as,
            bool(message.is_extended_id),
            bool(message.is_remote_frame),
            bool(message.is_error_frame),
            bool(message.is_fd),
        )
        # Some interfaces mark what is handed back, others do not; either way it has come back once.
        returned = self._hands_back and self._returned(frame)
        return None if returned or not message.is_rx else frame

    def _not_read(self, why: str) -> None:
        self.unread, self._why = self.unread + 1, why
        if self.unread == 1:
            print(f"servotap: {self.name} said what cannot be read: {printable(why)}", file=sys.stderr, flush=True)

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
        try:
            self.put(frame)
        except ServotapError:
            self.lost += 1

    def put(self, frame: CanFrame) -> None:
        """Send a frame of any kind.

        Raises ServotapError for one that the interface does not take.
        """
        message = can.Message(
            arbitration_id=frame.id,
            data=frame.data,
            is_extended_id=frame.extended,
            is_remote_frame=frame.remote,
            is_error_frame=frame.error,
            is_fd=frame.fd,
        )
        if self._hands_back:
            self._own.append((time.monotonic_ns(), frame.id, frame.data))
        try:
            self._bus.send(message)
        # Each interface raises what its library raises.
        except Exception as error:
            if self._hands_back:
                self._own.pop()
            raise ServotapError(f"{self.name} does not send: {type(error).__name__}: {error}") from None

    def close(self) -> None:
        """Close the interface; it may be done twice."""
        if self.unread > 1:
            text = f"servotap: {self.name} said {self.unread} things that cannot be read, the last: {printable(self._why)}"
            print(text, file=sys.stderr, flush=True)
        self.unread = 0
        with contextlib.suppress(Exception):
            self._bus.shutdown()
