"""A CAN bus behind an interface of python-can.

With `receive_own_messages` an interface returns each sent frame to its sender, once and in order. So sent frames are
remembered until they return. The identifier alone is not enough: MKS replies have the identifier of their request, and may have
the same bytes.

Lines that python-can itself passes over (of an unknown letter) are not seen here.
"""

from __future__ import annotations

import contextlib
import operator
import os
import socket
import time
from collections import deque
from typing import Any

from analyzer.catalogue import Role
from analyzer.errors import ServotapError, UsageError
from analyzer.live.reader_can_library import flags_of
from analyzer.live.reader_can_socket import dissect_kernel, with_room
from analyzer.live.spool import MOST_BYTES
from analyzer.plugins import close_bounded, is_failure, passed_over, reason
from analyzer.records import CanFrame
from analyzer.system.own_process import without
from analyzer.values import quote
from conformance.bus.can_port import CanPort
from conformance.bus.can_socket import ROOM, Frames

with without("asammdf"):
    import can

#: How long a frame that was sent may take to return.
_RETURN_NS = 500_000_000
#: Failures to receive in a row after which the interface is taken to be gone.
_FAILURES = 20
#: What is slept where an interface does not wait itself: looking again at once would take a whole core.
_PAUSE_NS = 1_000_000
#: Bytes that the kernel may keep for a socket: a tenth of a second of a full bus. More would be out of date when read.
_ROOM = 1 << 20
#: Bytes of the longest frame of the kernel.
_KERNEL_FRAME = 72


def socket_of(bus: can.BusABC) -> socket.socket:
    """Return the socket behind an interface, as one that is closed by itself. Raises OSError where it is none."""
    number = os.dup(bus.fileno())
    try:
        return socket.socket(fileno=number)
    except OSError:
        os.close(number)
        raise


def _dissected(message: can.Message) -> tuple[int, int, bytes, str]:
    """Return identifier, flags and data of a message, and why it is no frame, or nothing. Raises what no message raises."""
    data, flags = bytes(message.data or b""), flags_of(message)
    can_id = operator.index(message.arbitration_id)
    why = ""
    if not 0 <= can_id < 1 << 32:
        why = f"a frame has the identifier {can_id}"
    elif len(data) > MOST_BYTES:
        why = f"a frame has {len(data)} bytes"
    # CAN FD has lengths that python-can rounds; a remote frame has a length and no data.
    elif not message.is_remote_frame and not message.is_fd and len(data) != message.dlc:
        why = f"a frame of length {message.dlc} has {len(data)} bytes"
    return can_id, flags, data, why


class LibraryPort(CanPort):
    """A bus of python-can. Raises UsageError where it cannot be opened."""

    def __init__(self, interface: str, channel: str, *, heard_as: Role = Role.REQUEST, **options: Any) -> None:
        super().__init__(f"{interface}:{channel}", heard_as, options.get("bitrate"))
        known = can.VALID_INTERFACES
        if interface not in known:
            raise UsageError(f"no CAN interface {quote(interface)} (python-can has {', '.join(sorted(known))})")
        try:
            self._bus = can.Bus(interface=interface, channel=channel, **options)
        # Each interface raises what its library raises, and some leave the program.
        except BaseException as error:
            if not is_failure(error):
                raise
            raise UsageError(f"cannot open {self.name}: {reason(error)}") from None
        # The kernel keeps frames while this process does not run. Most interfaces have no file, or one that is no socket.
        with passed_over(), contextlib.closing(socket_of(self._bus)) as made:
            with_room(made, _ROOM)
        self._own: deque[tuple[int, int, bytes]] = deque()
        self._hands_back = bool(options.get("receive_own_messages"))
        self._failures = 0

    def receive(self, timeout_ns: int) -> CanFrame | None:
        from_ns = time.monotonic_ns()
        try:
            message = self._bus.recv(timeout_ns / 1e9)
            got = None if message is None else _dissected(message)
        # A line of garbage on an adapter's port raises from deep inside, and an interface may give anything.
        except BaseException as error:
            if not is_failure(error):
                raise
            self._failures += 1
            self._not_read(reason(error))
            if self._failures >= _FAILURES:
                raise ServotapError(f"{self.name} is gone: {self._why}") from None
            # python-can keeps a line that is no text, and every later one would fail with it.
            getattr(self._bus, "_buffer", bytearray()).clear()
            time.sleep(0.01)
            return None
        self._failures = 0
        if message is None or got is None:
            pause_ns = min(timeout_ns, _PAUSE_NS)
            if time.monotonic_ns() - from_ns < pause_ns:
                time.sleep(pause_ns / 1e9)
            return None
        can_id, flags, data, why = got
        if why:
            self._not_read(why)
            return None
        if not self.acceptance.takes(can_id, flags, len(data)):
            return None
        frame = self._frame(can_id, flags, data)
        # Some interfaces mark what is handed back, others do not; either way it has come back once.
        returned = self._hands_back and self._returned(frame)
        return None if returned or not message.is_rx else frame

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

    def put(self, frame: CanFrame) -> None:
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
        # As in receiving.
        except BaseException as error:
            if self._hands_back:
                self._own.pop()
            if not is_failure(error):
                raise
            raise ServotapError(f"{self.name} does not send: {reason(error)}") from None

    def close(self) -> None:
        super().close()
        close_bounded(self.name, self._bus.shutdown)


class SocketCanPort(LibraryPort):
    """A bus of SocketCAN. Frames of other programs on this machine are read, too."""

    def __init__(self, channel: str, *, heard_as: Role = Role.REQUEST, **options: Any) -> None:
        super().__init__("socketcan", channel, heard_as=heard_as, **options)
        made = self._made = socket_of(self._bus)
        with_room(made, ROOM)

        def read() -> tuple[bytes, bool]:
            data, _, flags, _ = made.recvmsg(_KERNEL_FRAME, 0, socket.MSG_DONTWAIT)
            return data, bool(flags & socket.MSG_CONFIRM)

        self._frames = Frames(self, made, read, dissect_kernel)

    def receive(self, timeout_ns: int) -> CanFrame | None:
        got = self._frames.next(timeout_ns)
        return None if got is None else self._frame(*got)

    def close(self) -> None:
        self._made.close()
        super().close()
