"""A request to stop, from a signal or another thread; it wakes all waiting threads."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator
from types import FrameType

from analyzer.cli.signals import handled


class Stop:
    """A flag with a descriptor that becomes readable once it is set: a socket, which every system can wait for."""

    def __init__(self) -> None:
        self._reader, self._writer = socket.socketpair()
        self._writer.setblocking(False)
        self.is_set = False

    def fileno(self) -> int:
        """Return the descriptor to wait for."""
        return self._reader.fileno()

    def set(self) -> None:
        """Ask for the end; from any thread, any number of times."""
        self.is_set = True
        with contextlib.suppress(OSError):
            self._writer.send(b"\0")

    def close(self) -> None:
        """Give the descriptors back."""
        self._reader.close()
        self._writer.close()


@contextlib.contextmanager
def on_signals(stop: Stop) -> Iterator[None]:
    """Set `stop` on Ctrl-C and the signals that end a process, instead of raising wherever the program is."""

    def handle(number: int, frame: FrameType | None) -> None:
        stop.set()

    with handled(handle):
        yield
