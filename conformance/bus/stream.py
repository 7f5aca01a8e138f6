"""Lines of bytes on a descriptor: what serial ports and TCP connections share.

    receive: wait for the descriptor, read what there is, stamp it at once; leave out what no line can bring (`Intake`)

The waiting thread takes the stamp right after the wait; a separate thread would be delayed by Python's lock. Bytes that come
while the caller does other work are stamped late. Exchanges wait for their reply, so their stamps are right.
"""

from __future__ import annotations

import os
import select
import time
from abc import abstractmethod
from collections import deque

from analyzer.catalogue import Role
from analyzer.live.endpoint import Endpoint
from analyzer.records import CanFrame, Chunk
from conformance.bus.echo import EchoFilter
from conformance.bus.line import Line, LineLost

SECOND_NS = 1_000_000_000
#: Bytes a second that no line brings, but one of more than 1 Mbit/s.
FLOOD = 100_000
#: How long a port may take no bytes before it is taken to be stuck.
_STUCK_NS = 5 * SECOND_NS
#: Read at one go, and passed on at one go: what a line brings in 10 ms at 4 Mbit/s, for to decode more takes time.
READ_SIZE, _PIECE = 1 << 16, 4096
#: Between two looks at what is sent faster than any line: to read all of it would take all the time there is.
_FLOODED_SECONDS = 0.01


class Intake:
    """What is read of what comes: no more than a line can bring. `left_out`: bytes that were not.

    A server on a network, or a program behind a terminal, can send hundreds of megabytes a second. To decode them takes all the
    time that a stop and a time-out have. As long as more comes than any line brings, the rest is read at the rate of the line.

    What may come is far more than the rate of the line, for emulated drives may answer at once, without a wire. No program that
    asks and waits gets near it.
    """

    def __init__(self) -> None:
        self.left_out = 0
        self._room = 0.0
        self._last_ns: int | None = None
        #: When more came than a line can bring, for the last time; None: it did not, or long ago.
        self._flooded_ns: int | None = None

    def take(self, t_ns: int, count: int, brings: int) -> int:
        """Return how many of `count` bytes that have come are to be read; the others are left out.

        `brings`: bytes that the line brings in a second.
        """
        rate = max(FLOOD, brings) if self._flooded_ns is None else brings
        elapsed_ns = SECOND_NS if self._last_ns is None else t_ns - self._last_ns
        self._last_ns = t_ns
        # At most what comes in a second: a process may stand still so long, and a network too.
        self._room = min(rate, self._room + elapsed_ns * rate / SECOND_NS)
        taken = min(count, int(self._room))
        self._room -= taken
        if taken < count:
            self.left_out += count - taken
            self._flooded_ns = t_ns
        elif self._flooded_ns is not None and t_ns - self._flooded_ns >= SECOND_NS:
            self._flooded_ns = None
        return taken


class StreamLine(Line):
    """A line of bytes. Its clock is the system's monotonic one, so that lines of several processes have one time."""

    def __init__(self, endpoint: Endpoint) -> None:
        self.endpoint = endpoint
        self.anchor_ns = time.time_ns() - time.monotonic_ns()
        self.echo = EchoFilter()
        self._intake = Intake()
        self._ready: deque[Chunk] = deque()
        self._free_ns = 0
        self._closed = False

    @property
    def passed(self) -> int:
        """Bytes that came faster than any line and were not read."""
        return self._intake.left_out

    def now_ns(self) -> int:
        return time.monotonic_ns()

    # --- what a kind of stream differs in -------------------------------------------------------------------------

    @abstractmethod
    def fileno(self) -> int:
        """Return the descriptor to wait for."""

    @abstractmethod
    def _read(self) -> bytes:
        """Return what is there, b"" for nothing. Raises LineLost, OSError."""

    @abstractmethod
    def _put(self, data: bytes) -> int:
        """Write what the port takes and return how many bytes that was. Raises OSError."""

    @abstractmethod
    def _shut(self) -> None:
        """Close the port. May raise OSError."""

    # --- the line -------------------------------------------------------------------------------------------------

    def write(self, item: bytes | CanFrame) -> int:
        """Send bytes and return when the last of them is on the wire, as its speed tells. Only a gate calls this."""
        if isinstance(item, CanFrame):
            raise TypeError("expected bytes for a serial line, got a CAN frame")
        self._check()
        now_ns = self.now_ns()
        self._free_ns = max(now_ns, self._free_ns) + len(item) * self.byte_ns
        self.echo.sent(item, self._free_ns)
        rest = memoryview(item)
        deadline_ns = now_ns + _STUCK_NS
        try:
            while rest:
                written = self._put_some(rest)
                rest = rest[written:]
                if not written and self.now_ns() > deadline_ns:
                    raise self.lost("it takes no more bytes")
        except OSError as error:
            raise self.lost(error.strerror or str(error)) from None
        return self._free_ns

    def _put_some(self, rest: memoryview) -> int:
        try:
            return self._put(bytes(rest))
        except BlockingIOError:
            select.select([], [self.fileno()], [], 0.1)
            return 0

    def receive(self, timeout_ns: int) -> Chunk | None:
        """Return the next bytes that are not this host's own, None when the time is over."""
        self._check()
        deadline_ns = self.now_ns() + timeout_ns
        while not self._ready:
            left_ns = deadline_ns - self.now_ns()
            if self.echo.holds:
                held = self.echo.late(self.now_ns())
                if held:
                    return self._chunk(held, self.now_ns())
            if not self._wait(max(0, min(left_ns, 20_000_000) if self.echo.holds else left_ns)):
                if left_ns <= 0:
                    return None
                continue
            t_ns = self.now_ns()
            try:
                data = self._read()
            except OSError as error:
                raise self.lost(error.strerror or str(error)) from None
            taken = self._intake.take(t_ns, len(data), self.brings)
            for begin in range(0, taken, _PIECE):
                self._ready.extend(self.echo.heard(self._chunk(data[begin : min(taken, begin + _PIECE)], t_ns)))
            if taken < len(data) and not self._ready:
                if left_ns <= 0:
                    return None
                self._pause(min(left_ns / SECOND_NS, _FLOODED_SECONDS))
        return self._ready.popleft()

    def _pause(self, seconds: float) -> None:
        time.sleep(seconds)

    def _wait(self, timeout_ns: int) -> bool:
        try:
            return bool(select.select([self.fileno()], [], [], timeout_ns / SECOND_NS)[0])
        except (OSError, ValueError) as error:
            raise self.lost(str(error)) from None

    def _chunk(self, data: bytes, t_ns: int) -> Chunk:
        return Chunk(t_ns, self.endpoint.name, data, Role.REPLY)

    def _check(self) -> None:
        if self._closed:
            raise self.lost("it was closed")

    def lost(self, why: str) -> LineLost:
        """Return the error that the port has gone."""
        return LineLost(f"{self.endpoint.place or self.endpoint.text} is gone: {why}")

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._shut()


def read_some(descriptor: int) -> bytes:
    """Return what a descriptor that does not block has, b"" for nothing, with an end. Raises OSError, EOFError."""
    parts: list[bytes] = []
    # A terminal gives no more than its own 4 KiB at one go.
    for _ in range(READ_SIZE // _PIECE):
        try:
            part = os.read(descriptor, _PIECE)
        except BlockingIOError:
            break
        if not part:
            if parts:
                break
            raise EOFError
        parts.append(part)
        if len(part) < _PIECE:
            break
    return b"".join(parts)
