"""A line whose port may come back: an adapter that enumerates anew, a server that starts again.

    write, receive          LineLost where the port goes: what was under way ends, as on any line
    the next one of them    opens the port anew, at the speed that it had

Without that, a motor that turns when a cable slips turns on, although the cable is back a second later. While something waits
for the port (`waits`), it is tried for some seconds; once in a row, so that a port that stays away holds up nothing twice.

What was sent to one drive must not reach another: a name as /dev/ttyUSB0 goes to the next adapter that is plugged in. So a port
is opened anew only where it can be told from others (`identity`). Any other stays as it is, and each write tries it again.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator

from serial.tools import list_ports

from analyzer.errors import ServotapError, UsageError
from analyzer.live.endpoint import Endpoint
from analyzer.records import CanFrame, Chunk
from conformance.bus import open_line
from conformance.bus.can_port import Acceptance
from conformance.bus.line import Line, LineLost

#: How long a port that has gone is waited for: an adapter is back after two seconds, a small server after some more.
BACK_SECONDS = 10.0
_PIECE_SECONDS = 0.2


def identity(endpoint: Endpoint) -> str:
    """Return what tells the port at an endpoint from another one that gets its name; nothing where nothing does.

    An address of a server; a serial number that one port has; a USB adapter at its socket, and the port of it; another link
    that a user has set up to mean one port. A number alone tells no port where a name or a link leads to it: adapters of some
    makers all have the same, and so have the four ports of one adapter.
    """
    if endpoint.kind == "tcp":
        return endpoint.place
    if endpoint.kind != "serial":
        return ""
    if endpoint.adapter:
        return endpoint.adapter
    device = os.path.realpath(endpoint.place)
    for port in list_ports.comports():
        if port.device == device and port.vid is not None:
            return f"{port.vid:04x}:{port.pid:04x} {port.serial_number or ''} {port.location or ''}".rstrip()
    return endpoint.place if os.path.islink(endpoint.place) else ""


class LastingLine(Line):
    """A line that is opened anew after its port has gone.

    `waits`: says whether a port that is not back yet is waited for. `lost`: the port has gone, and was not seen again.

    Raises UsageError where it cannot be opened the first time.
    """

    def __init__(self, endpoint: Endpoint, waits: Callable[[], bool]) -> None:
        self._waits = waits
        self._line = open_line(endpoint)
        self._identity = identity(endpoint)
        self.anchor_ns = self._line.anchor_ns
        self.lost = False
        self._why = ""
        self._waited = False

    @property
    def endpoint(self) -> Endpoint:  # type: ignore[override]  # it follows the speed of the line within
        """What the line within was opened from."""
        return self._line.endpoint

    def now_ns(self) -> int:
        return self._line.now_ns()

    def write(self, item: bytes | CanFrame) -> int:
        """Send an item. Only a gate calls this. Raises LineLost."""
        with self._there() as line:
            return line.write(item)

    def receive(self, timeout_ns: int) -> Chunk | CanFrame | None:
        with self._there() as line:
            return line.receive(timeout_ns)

    def set_speed(self, bits_per_second: int) -> None:
        with self._there() as line:
            line.set_speed(bits_per_second)

    def close(self) -> None:
        self._line.close()

    @property
    def acceptance(self) -> Acceptance | None:  # type: ignore[override]  # it belongs to the line within
        """Which frames of a CAN bus are read; such a port is not opened anew, so it stays."""
        return self._line.acceptance

    @property
    def passed(self) -> int:
        """Bytes that came and were not read since the port was opened last."""
        return self._line.passed

    @contextlib.contextmanager
    def _there(self) -> Iterator[Line]:
        if self.lost:
            self._open_anew()
        try:
            yield self._line
        except LineLost as error:
            if self._identity:
                self.lost, self._why = True, str(error)
                self._line.close()
            raise

    def _open_anew(self) -> None:
        """Open the port once more. Raises LineLost where it is not there, and does not come back in time."""
        until = time.monotonic() + BACK_SECONDS * (self._waits() and not self._waited)
        self._waited = True
        while True:
            try:
                self._line = self._opened()
            except ServotapError as error:
                if time.monotonic() >= until:
                    raise LineLost(f"{self._why}, and it is not back: {error}") from None
                time.sleep(_PIECE_SECONDS)
            else:
                self.lost = self._waited = False
                return

    def _opened(self) -> Line:
        """Open what has the port's identity, before and after it was opened. Raises ServotapError."""
        endpoint = self._line.endpoint
        if identity(endpoint) == self._identity:
            line = open_line(endpoint)
            # Another adapter may have got the name in between.
            if identity(endpoint) == self._identity:
                return line
            line.close()
        raise UsageError("no port with its identity is there")
