"""CAN buses that are sockets, without python-can on the way of a received frame: it takes several times as long for one.

    udp_multicast   a datagram of MessagePack, as python-can's interface of that name sends it; two sockets
    socketcan       a frame of the kernel; `conformance.bus.python_can` opens the socket and sends

All that waits is read at one go. So the queue of the kernel stays short, and what is read is not out of date.

Own frames: multicast brings each datagram back to its sender. It is told by its source, for the sending socket has a port of
its own. SocketCAN brings own frames back where the user wishes so, and marks them.
"""

from __future__ import annotations

import contextlib
import select
import socket
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import msgspec

from analyzer.catalogue import Role
from analyzer.errors import ServotapError, UsageError
from analyzer.live.reader_can_socket import MULTICAST_PORT, Dissect, dissect_multicast, open_multicast, with_room
from analyzer.records import CanFrame
from analyzer.system.decoding import UNDECODABLE
from conformance.bus.can_port import CanPort

#: Frames that are read at one go, before the time is looked at.
_AT_ONCE = 256
_LONGEST = 4096
#: Bytes that the kernel may keep for a socket: about half a second of a full bus, which is passed over in a few hundredths.
ROOM = 4 << 20
#: Options of `udp_multicast`. Its bit rate is that of the emulated bus behind it.
_OPTIONS = ("port", "hop_limit", "bitrate")


class _Datagram(msgspec.Struct):
    """What python-can's `udp_multicast` makes of a message; the receiver stamps it."""

    arbitration_id: int
    data: bytes
    dlc: int
    is_extended_id: bool
    is_remote_frame: bool
    is_error_frame: bool
    is_fd: bool
    timestamp: float = 0.0


_pack = msgspec.msgpack.Encoder().encode
#: Returns what waits on a socket, and whether it was sent here. Raises BlockingIOError where nothing waits, OSError.
_Read = Callable[[], tuple[bytes, bool]]


class Frames:
    """The frames that come on a socket, many at a time."""

    def __init__(self, port: CanPort, made: socket.socket, read: _Read, dissect: Dissect) -> None:
        self._port = port
        self._socket = made
        self._read = read
        self._dissect = dissect
        self._came: deque[tuple[int, int, bytes]] = deque()

    def next(self, timeout_ns: int) -> tuple[int, int, bytes] | None:
        """Return identifier, flags and payload of the next frame, None after the time-out. Raises ServotapError."""
        if self._came:
            return self._came.popleft()
        until_ns = time.monotonic_ns() + timeout_ns
        while True:
            try:
                more = self._take()
                if self._came:
                    return self._came.popleft()
                left_ns = until_ns - time.monotonic_ns()
                if left_ns <= 0:
                    return None
                if not more:
                    select.select([self._socket], [], [], left_ns / 1e9)
            except OSError as error:
                raise ServotapError(f"{self._port.name} is gone: {error.strerror or error}") from None

    def _take(self) -> bool:
        """Take what waits, and return whether there may be more."""
        read, dissect, takes, came = self._read, self._dissect, self._port.acceptance.takes, self._came
        for _ in range(_AT_ONCE):
            try:
                data, own = read()
            except BlockingIOError:
                return False
            if own:
                continue
            try:
                can_id, flags, payload = dissect(data)
            except UNDECODABLE as error:
                self._port._not_read(str(error))
                continue
            if takes(can_id, flags, len(payload)):
                came.append((can_id, flags, payload))
        return True


class MulticastPort(CanPort):
    """A bus of `udp_multicast`. Raises UsageError where it cannot be opened."""

    def __init__(self, channel: str, *, heard_as: Role = Role.REQUEST, **options: Any) -> None:
        super().__init__(f"udp_multicast:{channel}", heard_as, options.get("bitrate"))
        unknown = [name for name in options if name not in _OPTIONS]
        if unknown:
            raise UsageError(f"{self.name}: no option {', '.join(unknown)} (it has {', '.join(_OPTIONS)})")
        with contextlib.ExitStack() as opened:
            try:
                group = int(options.get("port", MULTICAST_PORT))
                made = opened.enter_context(open_multicast(channel, group))
                made.setblocking(False)
                with_room(made, ROOM)
                sender = opened.enter_context(socket.socket(made.family, socket.SOCK_DGRAM))
                if "hop_limit" in options:
                    _set_hops(sender, int(options["hop_limit"]))
                sender.connect((channel, group))
                own = sender.getsockname()[:2]
            except (OSError, OverflowError, ValueError, TypeError) as error:
                why = getattr(error, "strerror", None) or error
                raise UsageError(f"cannot open {self.name}: {why}") from None
            self._opened = opened.pop_all()
        self._sender = sender

        def read() -> tuple[bytes, bool]:
            data, sent_by = made.recvfrom(_LONGEST)
            return data, sent_by[:2] == own

        self._frames = Frames(self, made, read, dissect_multicast)

    def receive(self, timeout_ns: int) -> CanFrame | None:
        got = self._frames.next(timeout_ns)
        return None if got is None else self._frame(*got)

    def put(self, frame: CanFrame) -> None:
        try:
            self._sender.send(_pack(_datagram(frame)))
        except OSError as error:
            raise ServotapError(f"{self.name} does not send: {error.strerror or error}") from None

    def close(self) -> None:
        super().close()
        self._opened.close()


def _datagram(frame: CanFrame) -> _Datagram:
    data, size = frame.data, len(frame.data)
    return _Datagram(frame.id, data, size, frame.extended, frame.remote, frame.error, frame.fd)


def _set_hops(sender: socket.socket, hops: int) -> None:
    if sender.family == socket.AF_INET:
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, hops)
    else:
        sender.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, hops)
