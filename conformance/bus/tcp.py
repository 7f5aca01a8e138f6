"""A TCP connection as a line: a terminal server, or emulated drives. `tcp:HOST:PORT[,baud=N]`

The speed of the line behind it cannot be set from here. `baud` gives that speed, for times on the wire.
"""

from __future__ import annotations

import contextlib
import socket
import time

from analyzer.errors import UsageError
from analyzer.live.endpoint import Endpoint
from conformance.bus.stream import READ_SIZE, StreamLine

_CONNECT_S = 5.0
_AGAIN_S = 0.1


class TcpLine(StreamLine):
    """A TCP connection. Raises UsageError where the server does not answer."""

    def __init__(self, endpoint: Endpoint) -> None:
        super().__init__(endpoint)
        try:
            self._socket = _connection(endpoint.host)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:
            raise UsageError(f"{endpoint.place}: cannot connect ({error.strerror or error})") from None
        self._socket.setblocking(False)

    def fileno(self) -> int:
        return self._socket.fileno()

    def _read(self) -> bytes:
        try:
            data = self._socket.recv(READ_SIZE)
        except BlockingIOError:
            return b""
        if not data:
            raise self.lost("the other end has closed the connection")
        return data

    def _put(self, data: bytes) -> int:
        return self._socket.send(data)

    def set_speed(self, bits_per_second: int) -> None:
        """Raise UsageError: the speed of the line behind a connection is set where it is."""
        raise UsageError(f"{self.endpoint.text}: the speed of a line behind TCP cannot be set from here")

    def _shut(self) -> None:
        with contextlib.suppress(OSError):
            self._socket.close()


def _connection(host: tuple[str, int]) -> socket.socket:
    """Connect. A server that has no room resets what it took, for the one before may not have ended. Raises OSError."""
    until = time.monotonic() + _CONNECT_S
    while True:
        try:
            return socket.create_connection(host, timeout=_CONNECT_S)
        except ConnectionResetError:
            if time.monotonic() >= until:
                raise
            time.sleep(_AGAIN_S)
