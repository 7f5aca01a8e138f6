"""A pseudo-terminal as the serial port of emulated drives. Clients open it like an adapter.

    client  <->  /dev/pts/5 (or a link to it)  |kernel|  master  <->  bus

Rules:

1. This process keeps the terminal open too, so it survives clients that come and go.
2. The line speed is read with each request, so a client at the wrong speed reads garbled bytes, as on a wire.
3. If a client locks the terminal (TIOCEXCL), it is free again for the next client.
4. When the terminal is full, unread bytes are lost, as on a wire.
5. A link belongs to the terminal that it leads to, as long as that is there: it goes with its process. Then it is taken over.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import termios
import tty
from collections.abc import Sequence
from pathlib import Path

from analyzer.errors import UsageError
from conformance.serve.line_speed import line_speed, set_line_speed

_READ_SIZE = 4096


class PtyPort:
    """A pseudo-terminal. `link`: a path to make a symbolic link to it at; `speed`: the line speed at first.

    `name` is what clients open. Raises UsageError where it cannot be made.
    """

    def __init__(self, link: str = "", *, speed: int | None = None) -> None:
        try:
            self._master, self._slave = os.openpty()
        except OSError as error:
            raise UsageError(f"cannot make a pseudo-terminal: {error.strerror}") from None
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        if speed is not None:
            set_line_speed(self._slave, speed)
        self.path = os.ttyname(self._slave)
        self.name = link or self.path
        self.lost = 0
        self._link = Path(link) if link else None
        if self._link is not None:
            try:
                self._make_link(self._link)
            except UsageError:
                self._shut()
                raise

    def _make_link(self, link: Path) -> None:
        if link.is_symlink() and (not link.exists() or str(link.readlink()).startswith("/dev/")):
            if link.exists() and str(link.readlink()).startswith("/dev/pts/"):
                raise UsageError(
                    f"{link} leads to {link.readlink()}, which is in use: end the program that serves it, or remove the link"
                )
            link.unlink()
        try:
            link.symlink_to(self.path)
        except OSError as error:
            raise UsageError(f"cannot make the link {link}: {error.strerror}") from None

    def descriptors(self) -> Sequence[int]:
        return (self._master,)

    @property
    def slave(self) -> int:
        """The descriptor of the clients' end that is held here."""
        return self._slave

    def read(self, ready: Sequence[int]) -> bytes:
        try:
            data = os.read(self._master, _READ_SIZE)
        except OSError:
            # EAGAIN: nothing there; EIO: no slave open, which cannot last while we hold one.
            return b""
        self.idle()
        return data

    def write(self, data: bytes) -> None:
        """Write to the client, as far as the terminal takes it."""
        try:
            written = os.write(self._master, data)
        except OSError:
            written = 0
        self.lost += len(data) - written

    def speed(self) -> int | None:
        return line_speed(self._slave)

    def idle(self) -> None:
        """Let the next client in, should one have locked the terminal."""
        with contextlib.suppress(OSError):
            fcntl.ioctl(self._slave, termios.TIOCNXCL)

    def close(self) -> None:
        """Close the terminal and remove the link, if it still leads here."""
        if self._link is not None:
            with contextlib.suppress(OSError):
                if self._link.is_symlink() and str(self._link.readlink()) == self.path:
                    self._link.unlink()
        self._shut()

    def _shut(self) -> None:
        os.close(self._slave)
        os.close(self._master)
