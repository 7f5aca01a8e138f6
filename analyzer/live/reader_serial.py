"""Reading a serial port of Linux without ever writing to it: opened read-only, raw, RTS and DTR inactive.

Order of opening, and why:

1. `open` read-only: the kernel itself refuses every write. It also raises RTS and DTR, which cannot be prevented.
2. raw, at once: until then the terminal's default echo would send back what arrives.
3. RTS and DTR inactive: RTS may key a transmitter. How long they were active is measured and told.
4. `flock`: other programs that lock their ports are refused, as we are by them.

Any rate is set as a number (`BOTHER` of termios2), so that 25000 and 256000 baud are rates like all others. Bytes with
parity errors and breaks pass as they came, a break as 00; the kernel's counters (TIOCGICOUNT) say how many there were, where
the driver keeps them. Nothing is flushed: what the kernel holds when the port is opened belongs to the recording.
"""

from __future__ import annotations

import fcntl
import os
import struct
import termios
import time
from collections.abc import Mapping
from pathlib import Path

from analyzer.live.endpoint import Endpoint
from analyzer.live.reader_port import DescriptorPort, Opened, Stop, Unopened, find_adapter
from analyzer.live.reader_store import Store
from analyzer.live.reader_stream import listen_to_stream

# The numbers of most machines (x86, ARM, RISC-V); MIPS, PowerPC and SPARC have others and take standard rates alone.
TCGETS2 = 0x802C542A
TCSETS2 = 0x402C542B
TIOCGICOUNT = 0x545D
#: c_iflag, c_oflag, c_cflag, c_lflag, c_line, c_cc[19], c_ispeed, c_ospeed
TERMIOS2 = struct.Struct("<4IB19s2I")
BOTHER = 0o010000
_LINES = struct.pack("<I", termios.TIOCM_RTS | termios.TIOCM_DTR)
#: cts, dsr, rng, dcd, rx, tx, frame, overrun, parity, brk, buf_overrun and nine that are reserved.
COUNTERS = struct.Struct("<20i")
COUNTED = ("frame", "overrun", "parity", "brk", "buf_overrun")
_FIRST_COUNTED = 6
#: A rate further off than this share is told.
RATE_TOLERANCE = 0.02


class SerialPort(DescriptorPort):
    """A serial port, or a pseudo-terminal."""

    unit = "bytes"

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._counters: Mapping[str, int] | None = None
        self._counted_ns = 0
        self._adopted = False

    # --- opening --------------------------------------------------------------------------------------------------

    def open(self, stop: Stop) -> Opened:
        path = self._path()
        self._adopted = False
        before_ns = time.monotonic_ns()
        try:
            fd = os.open(path, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            raise Unopened(refused(path, error)) from None
        try:
            return self._set_up(fd, path, before_ns)
        except BaseException:
            os.close(fd)
            raise

    def adopt(self, fd: int) -> Opened:
        """Take over the descriptor of another reader: the port is set up, and what has come since waits in it."""
        if not os.isatty(fd):
            raise Unopened("the descriptor is not a serial port")
        self._fd = fd
        self._begin_counting()
        self._adopted = True
        return Opened(precision(os.ttyname(fd)))

    def _path(self) -> str:
        number = self._endpoint.adapter
        return find_adapter(number) if number else self._endpoint.place

    def _set_up(self, fd: int, path: str, before_ns: int) -> Opened:
        speed = self._endpoint.bits_per_second
        try:
            # Before anything is asked: until then what arrives is echoed.
            actual = set_raw(fd, speed, self._endpoint.parity, self._endpoint.stop_bits)
        except OSError as error:
            if not os.isatty(fd):
                raise Unopened(f"{path} is not a serial port") from None
            raise Unopened(f"{path} does not take {speed} baud: {error.strerror}") from None
        device = os.ttyname(fd)
        emulated = device.startswith("/dev/pts/")
        notes = []
        try:
            fcntl.ioctl(fd, termios.TIOCMBIC, _LINES)
            active_ms = (time.monotonic_ns() - before_ns) / 1e6
            notes.append(f"the kernel raised RTS and DTR as it opened the port; they were lowered within {active_ms:.1f} ms")
        except OSError:
            # A pseudo-terminal has no such lines, and nothing hangs on them.
            if not emulated:
                notes.append("the port has no RTS and DTR lines to lower")
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise Unopened(f"{path} is locked by another program; two readers would share the bytes") from None
        if actual and abs(actual - speed) > RATE_TOLERANCE * speed:
            notes.append(f"the port runs at {actual} baud instead of {speed}")
        # The maker of a pseudo-terminal holds it open, too, and reads nothing from it.
        others = [] if emulated else holders(fd)
        if others:
            notes.append(f"also opened by {', '.join(others)}: each byte reaches only one of the readers; see servotap tap")
        self._fd = fd
        if not self._begin_counting():
            notes.append("the driver counts no overruns: bytes that it loses go unnoticed")
        return Opened(precision(device), tuple(notes))

    # --- listening ------------------------------------------------------------------------------------------------

    def listen(self, store: Store, stop: Stop) -> None:
        """Store what comes. Raises Lost when the port hangs up: unplugged, or the other end of a pseudo-terminal closed."""

        def count(now_ns: int) -> None:
            self._count(store, now_ns)

        if self._counters is not None:
            told = store.kernel_counts([*self._counters.values()], adopted=self._adopted)
            self._counters = dict(zip(COUNTED, told, strict=True))
            self._counted_ns = store.last_ns if self._adopted else self._counted_ns
        byte_ns = self._endpoint.byte_ns
        listen_to_stream(self._fd, store, stop, byte_ns=byte_ns, ended="the port disconnected (unplugged?)", tick=count)

    def _begin_counting(self) -> bool:
        self._counted_ns = time.monotonic_ns()
        self._counters = counters(self._fd)
        return self._counters is not None

    def _count(self, store: Store, now_ns: int) -> None:
        """Tell what the kernel has counted since the last time."""
        before, since_ns = self._counters, self._counted_ns
        if before is None:
            return
        self._counters, self._counted_ns = counters(self._fd), now_ns
        if self._counters is None:
            return
        risen = {name: n - before[name] for name, n in self._counters.items() if n > before[name]}
        if risen:
            store.event("overrun", from_ns=since_ns, **risen)
            store.told_counts([*self._counters.values()])


def set_raw(fd: int, speed: int, parity: str, stop_bits: int) -> int:
    """Set a terminal to raw bytes at any speed, without flow control; return the speed it has taken, 0 if it does not say.

    `parity`: N, E or O. Raises OSError where the driver refuses.
    """
    control = termios.CS8 | termios.CREAD | termios.CLOCAL
    control |= {"N": 0, "E": termios.PARENB, "O": termios.PARENB | termios.PARODD}[parity]
    if stop_bits == 2:
        control |= termios.CSTOPB
    try:
        before = TERMIOS2.unpack(fcntl.ioctl(fd, TCGETS2, bytes(TERMIOS2.size)))
    except OSError:
        return _set_raw_standard(fd, speed, control)
    # HUPCL stays as it was: closing lowers the lines, where they are by now.
    control |= before[2] & termios.HUPCL
    characters = bytearray(before[5])
    # A read returns what is there and says when nothing is; its empty answer then means that the port hung up.
    characters[termios.VMIN], characters[termios.VTIME] = 1, 0
    fcntl.ioctl(fd, TCSETS2, TERMIOS2.pack(0, 0, control | BOTHER, 0, before[4], bytes(characters), speed, speed))
    return int(TERMIOS2.unpack(fcntl.ioctl(fd, TCGETS2, bytes(TERMIOS2.size)))[-1])


def _set_raw_standard(fd: int, speed: int, control: int) -> int:
    code = getattr(termios, f"B{speed}", None)
    if code is None:
        raise OSError(22, "this machine accepts only standard rates")
    try:
        attributes = termios.tcgetattr(fd)
        attributes[6][termios.VMIN], attributes[6][termios.VTIME] = 1, 0
        termios.tcsetattr(fd, termios.TCSANOW, [0, 0, control, 0, code, code, attributes[6]])
    except termios.error as error:
        raise OSError(*error.args) from None
    return speed


def counters(fd: int) -> dict[str, int] | None:
    """Return the kernel's counts of what went wrong on a port, by name; None where the driver keeps none."""
    try:
        values = COUNTERS.unpack(fcntl.ioctl(fd, TIOCGICOUNT, bytes(COUNTERS.size)))
    except OSError:
        return None
    return dict(zip(COUNTED, values[_FIRST_COUNTED:], strict=False))


def holders(fd: int) -> list[str]:
    """Return which other processes have the device of `fd` open, as far as this user may see."""
    device = os.fstat(fd).st_rdev
    found = []
    for process in Path("/proc").iterdir():
        if not process.name.isdigit() or int(process.name) == os.getpid():
            continue
        try:
            if any(os.stat(entry.path).st_rdev == device for entry in os.scandir(process / "fd")):
                found.append(f"{(process / 'comm').read_text().strip()} (process {process.name})")
        except OSError:
            # Another user's process, or one that ended meanwhile.
            continue
    return found


def refused(path: str, error: OSError) -> str:
    """Return why a port could not be opened, and what may help."""
    if isinstance(error, FileNotFoundError):
        return f"{path} is not there (servotap ports lists the ports)"
    if isinstance(error, PermissionError):
        return f"no permission for {path}: join its group, on most systems: sudo usermod -a -G dialout $USER"
    return f"cannot open {path}: {error.strerror}"


def precision(path: str) -> str:
    """Return what the times of a port are worth."""
    name = path.rsplit("/", 1)[-1]
    if path.startswith("/dev/pts/"):
        return "read as it arrives at a pseudo-terminal"
    try:
        timer = int(Path(f"/sys/bus/usb-serial/devices/{name}/latency_timer").read_text())
    except (OSError, ValueError):
        return "read as the kernel delivers it, mostly within 0.1 ms; plus the delay of the adapter"
    return f"read as the kernel delivers it, mostly within 0.1 ms; the adapter holds bytes back for up to {timer} ms"
