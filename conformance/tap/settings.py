"""The program's port settings: read from the pseudo-terminal and set on the adapter.

For a pseudo-terminal Linux keeps the speed, the stop bits and the mark of odd parity. It removes the mark of any parity, and
seven data bits (`pty_set_termios`). So odd parity is visible, but even parity looks like none: the endpoint must name it.
"""

from __future__ import annotations

import fcntl
import struct
import termios
from dataclasses import dataclass

from analyzer.live.endpoint import Endpoint
from analyzer.live.reader_serial import TCGETS2, TERMIOS2, set_raw
from conformance.serve.line_speed import line_speed

_OUTPUT = struct.Struct("<i")


@dataclass(frozen=True)
class LineSettings:
    """Speed in bits per second; parity N, E or O; 1 or 2 stop bits."""

    speed: int
    parity: str
    stop_bits: int

    @property
    def byte_ns(self) -> int:
        """Time of one byte on the line, in nanoseconds."""
        return (9 + self.stop_bits + (self.parity != "N")) * 1_000_000_000 // self.speed

    def __str__(self) -> str:
        return f"{self.speed} baud, 8{self.parity}{self.stop_bits}"


def of_endpoint(endpoint: Endpoint) -> LineSettings:
    """Return the settings that an endpoint names."""
    return LineSettings(endpoint.bits_per_second, endpoint.parity, endpoint.stop_bits)


def of_terminal(terminal: int, named: LineSettings) -> LineSettings:
    """Return how a program has set a pseudo-terminal up. `named`: of the endpoint, for what the terminal does not tell."""
    try:
        _, _, control, _, _, _, _, speed = TERMIOS2.unpack(fcntl.ioctl(terminal, TCGETS2, bytes(TERMIOS2.size)))
    except OSError:
        # A system without that call.
        control, speed = termios.tcgetattr(terminal)[2], line_speed(terminal)
    parity = "O" if control & termios.PARODD else "E" if control & termios.PARENB or named.parity == "E" else "N"
    # Speed 0 means to hang up, which no pseudo-terminal can; a program that does so will set another one.
    return LineSettings(speed or named.speed, parity, 2 if control & termios.CSTOPB else 1)


def set_terminal(terminal: int, settings: LineSettings) -> None:
    """Set a pseudo-terminal up as a port with these settings; a program finds them there. Raises OSError."""
    set_raw(terminal, settings.speed, settings.parity, settings.stop_bits)


def unsent(adapter: int) -> int:
    """Return how many bytes an adapter has not sent yet, as far as its driver says; 0 where it does not."""
    try:
        found: int = _OUTPUT.unpack(fcntl.ioctl(adapter, termios.TIOCOUTQ, bytes(_OUTPUT.size)))[0]
    except OSError:
        return 0
    return found
