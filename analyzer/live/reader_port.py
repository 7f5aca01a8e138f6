"""What every kind of port has in common for its reader process: how it is opened, how it ends, and the wish to end.

A port is opened, listened to until it is lost or the reader is to end, closed, and opened again. It has no way to send:
see `tests/test_layers.py` for what holds that.
"""

from __future__ import annotations

import os
import select
import signal
import socket
import threading
import time
from dataclasses import dataclass
from types import FrameType
from typing import Protocol

from analyzer.live.reader_store import Store

#: Without traffic for this long an IDLE is stored. Longer than the framer's silence by far more than a byte takes.
IDLE_NS = 50_000_000
#: How often counters are looked at and held records tried again.
TICK_NS = 1_000_000_000
#: Standard input of a reader: the supervisor holds the other end. Its end is the wish to end.
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
    """The wish to end: SIGTERM, or the end of standard input, which is when the supervisor has died.

    `asked`: why, empty until then. `fileno` is readable from then on.
    """

    def __init__(self) -> None:
        self.asked = ""
        self._woken, self._waker = socket.socketpair()
        self._waker.setblocking(False)

    def on_signals(self) -> None:
        """Take SIGTERM as the wish, and nothing else: Ctrl-C and hang-ups are the supervisor's."""
        for name in ("SIGINT", "SIGHUP"):
            if hasattr(signal, name):
                signal.signal(getattr(signal, name), signal.SIG_IGN)
        # The byte that a signal leaves here ends a wait.
        signal.set_wakeup_fd(self._waker.fileno(), warn_on_full_buffer=False)
        signal.signal(signal.SIGTERM, self._signalled)

    def _signalled(self, number: int, frame: FrameType | None) -> None:
        self.asked = self.asked or "asked to end"

    def on_leash(self, fd: int = LEASH) -> None:
        """Take the end of a descriptor as the wish, too."""
        threading.Thread(target=self._hold, args=(fd,), daemon=True).start()

    def _hold(self, fd: int) -> None:
        # Nothing is ever said on it; a thread because not every system can wait for it beside a port.
        try:
            while os.read(fd, 64):
                pass
        except OSError:
            # As good as its end.
            self.ask("the supervisor has gone")
            return
        self.ask("the supervisor has gone")

    def ask(self, reason: str) -> None:
        """Wish to end."""
        self.asked = self.asked or reason
        # The end of the stream wakes whoever waits, now and ever after.
        self._woken.shutdown(socket.SHUT_RD)

    def fileno(self) -> int:
        """Return the descriptor to wait for."""
        return self._woken.fileno()

    def wait(self, seconds: float) -> bool:
        """Wait that long or until the end is wished; say which."""
        if not self.asked:
            select.select([self._woken], [], [], seconds)
        return bool(self.asked)

    def close(self) -> None:
        """Give the descriptors back."""
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
        """Store what comes until the end is wished, then what has come by then. Raises Lost."""

    def close(self) -> None:
        """Close it; it may be done twice."""


class Ticks:
    """Says when the next second has come."""

    def __init__(self) -> None:
        self._last_ns = time.monotonic_ns()

    def due(self, now_ns: int) -> bool:
        """Say whether a second has passed since this was last true."""
        if now_ns - self._last_ns < TICK_NS:
            return False
        self._last_ns = now_ns
        return True
