"""The adapter's end of a tap: a serial port opened for both ways, or a TCP connection.

RTS and DTR stay as the kernel sets them at opening, unless the user says otherwise. The tap replaces the program, so an adapter
that needs RTS to send needs it here too (`rs485`: the kernel raises RTS while sending).
"""

from __future__ import annotations

import fcntl
import os
import socket
import struct
import termios
from abc import ABC, abstractmethod
from dataclasses import dataclass

from analyzer.live.endpoint import Endpoint
from analyzer.live.reader_port import Opened, Stop, Unopened, find_adapter
from analyzer.live.reader_serial import holders, precision, refused, set_raw
from analyzer.live.reader_tcp import TcpPort
from conformance.tap.settings import LineSettings

_TIOCSRS485 = 0x542F
_RS485_ENABLED, _RTS_ON_SEND = 1, 2
#: flags, delay before, delay after, five words of padding.
_RS485 = struct.Struct("<8I")
_LINES = struct.Struct("<I")


@dataclass(frozen=True)
class Wiring:
    """What a user says of the control lines. `rts`, `dtr`: None: left alone. `rs485`: RTS is raised while sending."""

    rts: bool | None = None
    dtr: bool | None = None
    rs485: bool = False


class Adapter(ABC):
    """One end, open or not. `fd`: its descriptor, -1 while it is closed; reading and writing never block."""

    #: Whether the speed can be set.
    has_line = False

    def __init__(self, endpoint: Endpoint) -> None:
        self.endpoint = endpoint
        self.fd = -1

    @abstractmethod
    def open(self, stop: Stop, settings: LineSettings) -> Opened:
        """Open it with these settings. Raises Unopened with the reason."""

    def adopt(self, fd: int) -> None:
        """Take a descriptor over that another process had opened."""
        os.set_blocking(fd, False)
        self.fd = fd

    @abstractmethod
    def set(self, settings: LineSettings) -> None:
        """Set the line up. Raises OSError where the driver refuses; does nothing where there is no line."""

    def close(self) -> None:
        """Close it; it may be done twice."""
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1


class SerialAdapter(Adapter):
    """A serial port, or a pseudo-terminal."""

    has_line = True

    def __init__(self, endpoint: Endpoint, wiring: Wiring) -> None:
        super().__init__(endpoint)
        self._wiring = wiring

    def open(self, stop: Stop, settings: LineSettings) -> Opened:
        """Open the port, raw, locked against others that lock."""
        number = self.endpoint.adapter
        path = find_adapter(number) if number else self.endpoint.place
        try:
            fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            raise Unopened(refused(path, error)) from None
        try:
            notes = self._set_up(fd, path, settings)
        except BaseException:
            os.close(fd)
            raise
        self.fd = fd
        return Opened(precision(os.ttyname(fd)), tuple(notes))

    def _set_up(self, fd: int, path: str, settings: LineSettings) -> list[str]:
        if not os.isatty(fd):
            raise Unopened(f"{path} is not a serial port")
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise Unopened(f"{path} is locked by another program") from None
        try:
            set_raw(fd, settings.speed, settings.parity, settings.stop_bits)
        except OSError as error:
            raise Unopened(f"{path} does not take {settings}: {error.strerror}") from None
        self._wire(fd, path)
        others = [] if os.ttyname(fd).startswith("/dev/pts/") else holders(fd)
        if not others:
            return []
        who = ", ".join(others)
        return [f"also opened by {who}: each byte reaches only one; the program has to open the tap's link instead"]

    def _wire(self, fd: int, path: str) -> None:
        wiring = self._wiring
        try:
            for bit, wanted in ((termios.TIOCM_RTS, wiring.rts), (termios.TIOCM_DTR, wiring.dtr)):
                if wanted is not None:
                    fcntl.ioctl(fd, termios.TIOCMBIS if wanted else termios.TIOCMBIC, _LINES.pack(bit))
        except OSError as error:
            raise Unopened(f"{path} has no RTS and DTR to set: {error.strerror}") from None
        if wiring.rs485:
            try:
                fcntl.ioctl(fd, _TIOCSRS485, _RS485.pack(_RS485_ENABLED | _RTS_ON_SEND, *[0] * 7))
            except OSError as error:
                reason = error.strerror
                raise Unopened(f"{path}: its driver cannot raise RTS while it sends (RS485 mode): {reason}") from None

    def set(self, settings: LineSettings) -> None:
        set_raw(self.fd, settings.speed, settings.parity, settings.stop_bits)


class TcpAdapter(Adapter):
    """A connection to a serial server."""

    def open(self, stop: Stop, settings: LineSettings) -> Opened:
        port = TcpPort(self.endpoint)
        opened = port.open(stop)
        descriptor = port.descriptor()
        assert descriptor is not None  # it was opened
        self.adopt(descriptor)
        with socket.socket(fileno=os.dup(descriptor)) as connection:
            # A request of a few bytes waits for nothing.
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return opened

    def set(self, settings: LineSettings) -> None:
        """Do nothing: the line is the server's."""


def adapter_of(endpoint: Endpoint, wiring: Wiring) -> Adapter:
    """Return the adapter of an endpoint, not yet open. Raises ValueError for CAN."""
    if endpoint.kind == "serial":
        return SerialAdapter(endpoint, wiring)
    if endpoint.kind == "tcp":
        return TcpAdapter(endpoint)
    raise ValueError(f"expected a serial or TCP endpoint, got {endpoint.kind}")
