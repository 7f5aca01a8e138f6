"""A TCP port as the serial port of emulated drives, for pyserial's `socket://HOST:PORT` and for terminal servers.

Clients come and go. Several clients share the line like several hosts: each hears all replies. There is no line speed, so
it is always right. A client too many is refused: its connection is closed at once, and the others go on.
"""

from __future__ import annotations

import contextlib
import errno
import re
import socket
from collections.abc import Callable, Sequence

from analyzer.errors import UsageError
from analyzer.values import is_host, quote

LOOPBACK = "127.0.0.1"
_ENDPOINT = re.compile(r"(?:(?P<host>\[[0-9A-Fa-f:.%]+\]|[^:\[\]]*):)?(?P<port>\d{1,5})")
_READ_SIZE = 4096
#: Bytes that may wait for each client.
_WAITING = 1 << 14
#: Clients at one time.
CLIENTS = 64
#: `select` takes descriptors below this. `poll` would take all, but it wakes up to 1 ms late, and replies are due sooner.
_SELECTABLE = 1024


def parse_endpoint(text: str) -> tuple[str, int]:
    """Return host and port of `HOST:PORT`, `:PORT` or `PORT`; without a host, loopback.

    Raises UsageError for anything else.
    """
    match = _ENDPOINT.fullmatch(text.strip())
    if match is None or int(match["port"]) > 0xFFFF or not is_host(match["host"] or ""):
        raise UsageError(f"got {quote(text)}, expected HOST:PORT with a port 0..65535")
    return (match["host"] or "").strip("[]") or LOOPBACK, int(match["port"])


class TcpPort:
    """A listening TCP port; port 0 takes a free one. Raises UsageError where it cannot listen.

    `tell` is called with a text when clients are not taken: once, until a client leaves.
    """

    def __init__(self, host: str, port: int, tell: Callable[[str], None] = lambda text: None) -> None:
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
            self._listener = socket.create_server(found[4][:2], family=found[0], backlog=8)
            # By itself the system keeps megabytes for each client, which take an hour of the line after it has gone.
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _WAITING)
        except OSError as error:
            raise UsageError(f"cannot listen on {host}:{port}: {error.strerror or error}") from None
        self._listener.setblocking(False)
        self.host, self.port = self._listener.getsockname()[:2]
        self.name = f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"
        self.lost = 0
        self._clients: dict[int, socket.socket] = {}
        self._tell = tell
        self._told = False
        #: No client is taken until the next idle time.
        self._deaf = False

    def descriptors(self) -> Sequence[int]:
        return [*self._clients] if self._deaf else [self._listener.fileno(), *self._clients]

    def read(self, ready: Sequence[int]) -> bytes:
        """Take new clients, let go those that have left, and return what the others sent."""
        data = b""
        for descriptor in ready:
            if descriptor == self._listener.fileno():
                self._accept()
            elif descriptor in self._clients:
                data += self._read(descriptor)
        return data

    def _accept(self) -> None:
        try:
            client, _ = self._listener.accept()
        except OSError as error:
            if error.errno in (errno.EMFILE, errno.ENFILE):
                # A client that waits for ever would wake the loop for ever.
                self._deaf = True
                self._refused("the system has no more descriptors for this process; they wait")
            return
        if len(self._clients) >= CLIENTS or client.fileno() >= _SELECTABLE:
            client.close()
            self._refused(f"{len(self._clients)} have the line")
            return
        with contextlib.suppress(OSError):
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._clients[client.fileno()] = client

    def _refused(self, why: str) -> None:
        if not self._told:
            self._tell(f"{self.name}: clients are not taken: {why}")
        self._told = True

    def _read(self, descriptor: int) -> bytes:
        try:
            data = self._clients[descriptor].recv(_READ_SIZE)
        except (BlockingIOError, InterruptedError):
            return b""
        except OSError:
            data = b""
        if not data:
            self._clients.pop(descriptor).close()
            self._told = False
        return data

    def write(self, data: bytes) -> None:
        """Send to every client; one that does not read loses what does not fit."""
        for client in self._clients.values():
            try:
                self.lost += len(data) - client.send(data)
            except OSError:
                # A client that has gone is noticed when it is read.
                self.lost += len(data)

    def speed(self) -> int | None:
        """Return None: there is no line speed, every drive's is right."""
        return None

    def idle(self) -> None:
        """Look for clients again."""
        self._deaf = False

    def close(self) -> None:
        for client in self._clients.values():
            client.close()
        self._clients.clear()
        self._listener.close()
