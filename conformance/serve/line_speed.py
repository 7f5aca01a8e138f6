"""The line speed of a terminal, also a non-standard rate (25000, 256000 baud).

Standard rates are codes in the terminal's attributes; others stand in them as numbers (`BOTHER`), which only Linux's
second version of the attributes (termios2) tells.
"""

from __future__ import annotations

import contextlib
import fcntl
import termios

from analyzer.live.reader_serial import TCGETS2, TERMIOS2

_CODES = {getattr(termios, name): int(name[1:]) for name in dir(termios) if name[0] == "B" and name[1:].isdigit()}


def line_speed(descriptor: int) -> int | None:
    """Return the output speed of a terminal in bits per second, None where it has none or does not say."""
    with contextlib.suppress(OSError):
        return int(TERMIOS2.unpack(fcntl.ioctl(descriptor, TCGETS2, bytes(TERMIOS2.size)))[-1]) or None
    # Not Linux, or one where that call has another number.
    with contextlib.suppress(OSError, termios.error):
        return _CODES.get(termios.tcgetattr(descriptor)[5]) or None
    return None


def set_line_speed(descriptor: int, speed: int) -> None:
    """Set the speed of a terminal, where it is a standard one."""
    code = next((code for code, baud in _CODES.items() if baud == speed), None)
    if code is not None:
        attributes = termios.tcgetattr(descriptor)
        attributes[4] = attributes[5] = code
        termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
