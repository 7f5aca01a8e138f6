"""Listening to a TCP server that passes a serial line on (ser2net, a terminal server, an emulated drive). Nothing is sent.

The precision of the times depends on the network and on the server, which collects bytes before it sends them. If the line's
speed is given (`baud=N`), the bytes of one delivery are set back by the time they took on the line.
"""

from __future__ import annotations

import errno
import os
import select
import socket
import time

from analyzer.live.endpoint import Endpoint
from analyzer.live.reader_port import DescriptorPort, Lost, Opened, Stop, Unopened
from analyzer.live.reader_store import Store
from analyzer.live.reader_stream import listen_to_stream

CONNECT_S = 5.0
#: A server that is silently gone is noticed after about this many seconds: idle, between probes, probes.
KEEPALIVE = (("TCP_KEEPIDLE", 10), ("TCP_KEEPINTVL", 5), ("TCP_KEEPCNT", 3))
_WAITING = (errno.EINPROGRESS, errno.EAGAIN)


class TcpPort(DescriptorPort):
    """A connection to a TCP server."""

    unit = "bytes"

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint

    def open(self, stop: Stop) -> Opened:
        host, port = self._endpoint.host
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        except OSError as error:
            raise Unopened(f"{host}: no such host ({error.strerror or error})") from None
        reason = ""
        for family, kind, protocol, _, address in found:
            connection = socket.socket(family, kind, protocol)
            connection.setblocking(False)
            reason = _connect(connection, address, stop)
            if not reason:
                for name, value in KEEPALIVE:
                    if hasattr(socket, name):
                        connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
                # From here on it is a descriptor that is read, like a port's.
                self._fd = connection.detach()
                return Opened(_PRECISION)
            connection.close()
        raise Unopened(f"cannot connect to {self._endpoint.place}: {reason}")

    def adopt(self, fd: int) -> Opened:
        self._fd = fd
        return Opened(_PRECISION)

    def listen(self, store: Store, stop: Stop) -> None:
        listen_to_stream(self._fd, store, stop, byte_ns=self._endpoint.byte_ns, ended="the server closed the connection")


_PRECISION = "read as the network delivers it; plus the delays of server and network"


def _connect(connection: socket.socket, address: object, stop: Stop) -> str:
    """Connect within `CONNECT_S`; return why not, or nothing."""
    code = connection.connect_ex(address)  # type: ignore[arg-type]
    until = time.monotonic() + CONNECT_S
    while code in _WAITING:
        left = until - time.monotonic()
        if left <= 0:
            return f"no answer within {CONNECT_S:.0f} s"
        _, writable, _ = select.select([stop.fileno()], [connection], [], left)
        if stop.asked:
            raise Lost(stop.asked)
        if writable:
            code = connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
            break
    return os.strerror(code) if code else ""
