"""The pseudo-terminal of a tap, and whether a program has it open.

The tap holds both ends, so that programs can come and go. The kernel reports every opening and closing (inotify). Bytes of the
drive are dropped while no program has the port open, as on a real port. Without inotify the port counts as always open.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import os
import struct
import termios
from collections.abc import Callable

_OPENED = 0x20
_CLOSED = 0x08 | 0x10
_NONBLOCK = os.O_NONBLOCK | os.O_CLOEXEC
_EVENT = struct.Struct("iIII")


class Terminal:
    """Both ends of a pseudo-terminal. `attended`: a program has it open.

    `others`: says whether a program has it open already.
    """

    def __init__(self, master: int, slave: int, *, others: Callable[[], bool] = lambda: False) -> None:
        self.master = master
        self.slave = slave
        self.path = os.ttyname(slave)
        os.set_blocking(master, False)
        self.watch = _watch(self.path)
        self._users = 0
        # Of who came before there is nothing to count; he is there until one more has gone than have come.
        self._assumed = False
        self.attended = False
        # Asked with the watch standing: none can open it in between.
        present = self.watch is None or others()
        self.look()
        # Who came in between is seen twice.
        self._assumed = present and not self._users
        self.attended = self._assumed or self._users > 0

    def look(self) -> bool:
        """Take what the kernel tells of openings and closings; say whether `attended` has changed."""
        if self.watch is None:
            return False
        before = self.attended
        came = False
        with contextlib.suppress(BlockingIOError):
            data = os.read(self.watch, 1 << 14)
            at = 0
            while at + _EVENT.size <= len(data):
                _, mask, _, length = _EVENT.unpack_from(data, at)
                at += _EVENT.size + length
                if mask & _OPENED:
                    self._users += 1
                    came = True
                elif mask & _CLOSED:
                    if self._users == 0:
                        self._assumed = False
                    self._users = max(0, self._users - 1)
        self.attended = self._users > 0 or self._assumed
        if before and not self.attended:
            self._free()
        elif came and self.attended and self._users == 1:
            # It shall not hear what was said before it came.
            self.flush()
        return self.attended != before

    def _free(self) -> None:
        """Let the next program in, should the last one have locked the terminal; drop what it did not read."""
        with contextlib.suppress(OSError):
            fcntl.ioctl(self.slave, termios.TIOCNXCL)
        self.flush()

    def flush(self) -> None:
        """Drop what waits for the program."""
        with contextlib.suppress(termios.error):
            termios.tcflush(self.slave, termios.TCIFLUSH)

    def close(self) -> None:
        if self.watch is not None:
            os.close(self.watch)
        os.close(self.master)
        os.close(self.slave)


def _watch(path: str) -> int | None:
    """Return a descriptor that tells of openings and closings of a file, None where there is no such thing."""
    try:
        library = ctypes.CDLL(None, use_errno=True)
        descriptor: int = library.inotify_init1(_NONBLOCK)
        if descriptor < 0:
            return None
        if library.inotify_add_watch(descriptor, os.fsencode(path), _OPENED | _CLOSED) < 0:
            os.close(descriptor)
            return None
    except (OSError, AttributeError):
        return None
    return descriptor
