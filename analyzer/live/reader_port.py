"""A port as its reader process uses it: opening, the loop that listens, the end, and the request to end.

A port is opened, listened to until it is lost or the reader is to end, closed, and opened again. It has no way to send;
`tests/test_passive.py` holds that.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import FrameType
from typing import Protocol

from analyzer.live.reader_store import Store

#: Without traffic for this long an IDLE is stored. Longer than the framer's silence by far more than a byte takes.
IDLE_NS = 50_000_000
#: Time between two looks at counters, and between two attempts to store held records.
TICK_NS = 1_000_000_000
#: Standard input of a reader: the supervisor holds the other end. Its end requests the end.
LEASH = 0


class Unopened(Exception):
    """A port cannot be opened; the text says why, and what may help."""


class Lost(Exception):
    """A port that was open is gone; the text says how."""


@dataclass(frozen=True)
class Opened:
    """How a port was opened. `precision`: what its times are worth; `notes`: what cannot be guaranteed."""

    precision: str
    notes: tuple[str, ...] = ()


class Stop:
    """The request to end: SIGTERM, or the end of standard input, when the supervisor has died.

    `asked`: why, empty until then. `fileno` is readable from then on. `gone`: why, in words, where the supervisor has died.
    """

    def __init__(self, gone: str = "the supervisor has gone") -> None:
        self.asked = ""
        self._gone = gone
        self._woken, self._waker = socket.socketpair()
        self._waker.setblocking(False)

    def on_signals(self) -> None:
        """Take SIGTERM as the request to end, and no other signal: Ctrl-C and hang-ups are the supervisor's."""
        for name in ("SIGINT", "SIGHUP"):
            if hasattr(signal, name):
                signal.signal(getattr(signal, name), signal.SIG_IGN)
        # The byte that a signal leaves here ends a wait.
        signal.set_wakeup_fd(self._waker.fileno(), warn_on_full_buffer=False)
        signal.signal(signal.SIGTERM, self._signalled)

    def _signalled(self, number: int, frame: FrameType | None) -> None:
        self.asked = self.asked or "asked to end"

    def on_leash(self, fd: int = LEASH) -> None:
        """Take the end of a descriptor as the request, too."""
        threading.Thread(target=self._hold, args=(fd,), daemon=True).start()

    def _hold(self, fd: int) -> None:
        # Nothing is ever sent on it, so an error means the same as its end. A thread, because not every system can wait for it
        # together with a port.
        with contextlib.suppress(OSError):
            while os.read(fd, 64):
                pass
        self.ask(self._gone)

    def ask(self, reason: str) -> None:
        self.asked = self.asked or reason
        # The end of the stream ends every wait, now and later.
        self._woken.shutdown(socket.SHUT_RD)

    def fileno(self) -> int:
        return self._woken.fileno()

    def wait(self, seconds: float) -> bool:
        """Wait that long or until the end is requested; say which."""
        if not self.asked:
            select.select([self._woken], [], [], seconds)
        return bool(self.asked)

    def close(self) -> None:
        self._woken.close()
        self._waker.close()


class Port(Protocol):
    """One port, as its reader process uses it."""

    #: What `Store.count` counts: `bytes` or `frames`.
    unit: str

    def open(self, stop: Stop) -> Opened:
        """Open it. Raises Unopened with the reason."""

    def adopt(self, fd: int) -> Opened:
        """Take a descriptor over that another reader had opened, with what has waited in it. Raises Unopened."""

    def descriptor(self) -> int | None:
        """Return the descriptor that holds what arrives; None where it is not one."""

    def listen(self, store: Store, stop: Stop) -> None:
        """Store what comes until the end is requested, then what had come by then. Raises Lost."""

    def close(self) -> None:
        """Close it; it may be done twice."""


class DescriptorPort:
    """A port that is one descriptor: the reader's successor can adopt it."""

    _fd = -1

    def descriptor(self) -> int | None:
        return self._fd if self._fd >= 0 else None

    def close(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


class LibraryPort:
    """A port that a library has opened: more than a descriptor, so no successor can adopt it."""

    library: str

    def adopt(self, fd: int) -> Opened:
        raise Unopened(f"{self.library}'s ports cannot be handed over")

    def descriptor(self) -> int | None:
        return None


def find_adapter(number: str) -> str:
    """Return the port of the USB adapter with a serial number.

    Raises Unopened with the numbers that are there, and where several ports have this one: cheap adapters share a number, and
    so do the ports of an adapter that has four.
    """
    from serial.tools.list_ports import comports

    ports = [p for p in comports() if p.serial_number]
    found = [str(p.device) for p in ports if p.serial_number == number]
    if len(found) == 1:
        return found[0]
    if found:
        raise Unopened(f"{len(found)} ports have the serial number {number}: {', '.join(found)}; name one of them")
    there = ", ".join(f"{p.serial_number} at {p.device}" for p in ports) or "none with a serial number"
    raise Unopened(f"no adapter with serial number {number} (there is {there})")


# --- listening ----------------------------------------------------------------------------------------------------------


def readable(fd: int, stop: Stop) -> Callable[[int], bool]:
    """Return a wait for `fd`: it ends with something to read, the request to end, or after so many nanoseconds."""
    waiting = select.poll()
    waiting.register(fd, select.POLLIN)
    waiting.register(stop.fileno(), select.POLLIN)

    def wait(longest_ns: int) -> bool:
        ready = waiting.poll(max(0, -(-longest_ns // 1_000_000)))
        return any(number == fd for number, _ in ready)

    return wait


def listen(
    store: Store,
    stop: Stop,
    take: Callable[[bool], int],
    *,
    wait: Callable[[int], bool] | None = None,
    idle_ns: int = IDLE_NS,
    tick: Callable[[int], None] | None = None,
) -> None:
    """Store what comes until the end is requested, IDLE after each pause, and call `tick` about once a second.

    `take` stores what is there and returns the time of the last of it, 0 for nothing. It is told whether there is something to
    read: always so without `wait`, where it waits itself.
    """
    ticked_ns = quiet_since_ns = time.monotonic_ns()
    while not stop.asked:
        left_ns = TICK_NS if store.idle else quiet_since_ns + idle_ns - time.monotonic_ns()
        ready = wait is None or wait(left_ns)
        # Before the look: nothing that comes later can bear an earlier time.
        seen_ns = time.monotonic_ns()
        last_ns = take(ready) if ready or not store.idle else 0
        if last_ns:
            quiet_since_ns = last_ns
        elif not store.idle and seen_ns - quiet_since_ns >= idle_ns:
            store.quiet(seen_ns)
        store.flush()
        if seen_ns - ticked_ns >= TICK_NS:
            ticked_ns = seen_ns
            store.tick()
            if tick is not None:
                tick(seen_ns)


class BadCount:
    """Counts what a CAN interface delivered that is no frame. `tell` stores the count as an event."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        self.count = 0
        self._since_ns = time.monotonic_ns()

    def tell(self, store: Store, now_ns: int) -> None:
        """Store the count since the last call, if it is not 0."""
        if self.count:
            store.event("bus_error", reason=self.reason, from_ns=self._since_ns, count=self.count)
        self.count, self._since_ns = 0, now_ns
