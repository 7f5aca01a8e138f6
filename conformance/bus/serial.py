"""A serial port as a line.

    serial:/dev/ttyUSB0,baud=38400      serial:,serial=A50285BI,baud=115200

Opening disturbs the bus as little as possible. The port is locked for this process, without flow control, and by TIOCEXCL no
other program can open it, root aside. RTS and DTR are active, as in most programs: many RS485 adapters draw their power from
one of them. Adapters with a direction pin switch it by themselves. Adapters with a latency timer are set to their fast mode,
where the system can.
"""

from __future__ import annotations

import contextlib
import errno
import os
import time
from pathlib import Path
from typing import Any

import serial
from serial.tools import list_ports

from analyzer.errors import UsageError
from analyzer.live.endpoint import Endpoint
from analyzer.live.reader_port import Unopened, find_adapter
from analyzer.plugins import close_bounded
from conformance.bus.stream import StreamLine, read_some

try:
    import fcntl
    import termios
except ImportError:  # a system without them
    termios = None  # type: ignore[assignment]

#: How a port that has gone fails. A terminal's own error is no OSError, and pyserial passes it on.
_GONE = (OSError, serial.SerialException, *(() if termios is None else (termios.error,)))

_HAS_SELECT = os.name == "posix"
_MOST_LISTED = 8
_PSEUDO = "/dev/pts/"


class SerialLine(StreamLine):
    """A serial port. Raises UsageError where it cannot be opened, with what to do about it."""

    def __init__(self, endpoint: Endpoint) -> None:
        super().__init__(endpoint)
        self.path = endpoint.place or _path_of(endpoint.adapter)
        self._port: Any = serial.Serial()
        port = self._port
        port.port = self.path
        port.baudrate = endpoint.bits_per_second
        port.bytesize = 8
        port.parity = endpoint.parity
        port.stopbits = endpoint.stop_bits
        port.timeout = 0
        port.exclusive = True if _HAS_SELECT else None
        try:
            port.open()
        except (serial.SerialException, OSError, ValueError) as error:
            raise UsageError(why_not(self.path, error)) from None
        self._take(True)
        # Terminals, and adapters without such a timer, have no such mode.
        with contextlib.suppress(NotImplementedError, AttributeError, OSError, ValueError, serial.SerialException):
            port.set_low_latency_mode(True)

    def _take(self, taken: bool) -> None:
        """Let no other program open the port, where the system can; or let them again.

        A pseudo-terminal would stay taken when this process is killed, and then only root could stop the motor behind it.
        """
        if termios is not None and (os.geteuid() == 0 or not os.path.realpath(self.path).startswith(_PSEUDO)):
            # What is served in place of a port (a pipe, a terminal of another kind) may have no such thing.
            with contextlib.suppress(OSError, termios.error):
                fcntl.ioctl(self.fileno(), termios.TIOCEXCL if taken else termios.TIOCNXCL)

    def fileno(self) -> int:
        return int(self._port.fileno())

    def _read(self) -> bytes:
        if not _HAS_SELECT:
            return bytes(self._port.read(self._port.in_waiting or 1))
        try:
            return read_some(self.fileno())
        except EOFError:
            raise self.lost("the other end has closed") from None

    def _wait(self, timeout_ns: int) -> bool:
        if _HAS_SELECT:
            return super()._wait(timeout_ns)
        # Handles cannot be waited for there: the port is asked, a thousand times a second.
        until_ns = self.now_ns() + timeout_ns
        while not (waiting := bool(self._port.in_waiting)) and self.now_ns() < until_ns:
            time.sleep(0.001)
        return waiting

    def _put(self, data: bytes) -> int:
        if _HAS_SELECT:
            return os.write(self.fileno(), data)
        return int(self._port.write(data) or 0)

    def set_speed(self, bits_per_second: int) -> None:
        """Change the port's baud rate, when all that was written has left; what was heard before is dropped."""
        self._check()
        left_ns = self._free_ns - self.now_ns()
        try:
            if left_ns > 0:
                time.sleep(left_ns / 1e9)
            self._port.flush()
            self._port.baudrate = bits_per_second
            self._port.reset_input_buffer()
        except _GONE as error:
            raise self.lost(str(error)) from None
        except ValueError:
            raise UsageError(f"{self.path} cannot be set to {bits_per_second} baud") from None
        self._ready.clear()
        self.echo.reset()
        self.endpoint = self.endpoint.at(bits_per_second)

    def _shut(self) -> None:
        # A pseudo-terminal keeps it when it is closed.
        with contextlib.suppress(OSError, ValueError, serial.SerialException):
            self._take(False)
        close_bounded(self.path, self._port.close)


def _path_of(number: str) -> str:
    try:
        return find_adapter(number)
    except Unopened as error:
        raise UsageError(str(error)) from None


# --- why a port cannot be opened ----------------------------------------------------------------------------------


def why_not(path: str, error: Exception) -> str:
    """Return why a port cannot be opened, and what to do about it."""
    number = getattr(error, "errno", None)
    text = str(error)
    if number == errno.EACCES or "Permission denied" in text:
        return f"{path}: permission denied. {permission_hint(path)}"
    if number == errno.ENOENT or "No such file" in text:
        names = [p.device for p in list_ports.comports()][:_MOST_LISTED]
        return f"{path} is not there; serial ports here: {', '.join(names) or 'none: is the adapter plugged in?'}"
    if number in (errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK) or "lock" in text or "busy" in text:
        holders = who_has(path)
        who = f" by {', '.join(holders)}" if holders else " by another program"
        return f"{path} is in use{who}: end it, or let it share the port with servotap tap"
    return f"{path} cannot be opened: {text or type(error).__name__}"


def permission_hint(path: str) -> str:
    """Return the command that lets this user use a port."""
    try:
        import grp
        import pwd

        group = grp.getgrgid(Path(path).stat().st_gid).gr_name
        user = pwd.getpwuid(os.getuid()).pw_name
    except (ImportError, OSError, KeyError):
        return "Ports belong to a group, often dialout: sudo usermod -aG dialout $USER, then log in again."
    if group == "root":
        return f"It belongs to root alone: sudo chmod a+rw {path}, or a udev rule that gives it to the group dialout."
    return f"It belongs to the group {group}: sudo usermod -aG {group} {user}, then log in again."


def who_has(path: str) -> list[str]:
    """Return the programs that have a port open, as far as this user may see them."""
    found = []
    real = os.path.realpath(path)
    for entry in Path("/proc").glob("[0-9]*/fd/*"):
        with contextlib.suppress(OSError):
            if os.path.realpath(entry) == real and entry.parts[2] != str(os.getpid()):
                name = Path("/proc", entry.parts[2], "comm").read_text().strip()
                found.append(f"{name} (process {entry.parts[2]})")
    return sorted(set(found))
