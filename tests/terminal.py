"""A command at a terminal of its own, as a person has it."""

from __future__ import annotations

import fcntl
import os
import re
import select
import signal
import struct
import sys
import termios
import threading

from tests import ROOT
from tests.conformance.drives.served import wait_for


class Terminal:
    """Python in a pseudo-terminal. `seen`: all that it has drawn; `shown`: the same without what moves the cursor."""

    def __init__(self, *words, rows=24, columns=80):
        self.pid, self.fd = os.forkpty()
        if self.pid == 0:
            os.chdir(ROOT)
            os.environ.update(TERM="xterm-256color", COLUMNS=str(columns), LINES=str(rows))
            os.execv(sys.executable, [sys.executable, *words])
        fcntl.ioctl(self.fd, termios.TIOCSWINSZ, struct.pack("4H", rows, columns, 0, 0))
        self.seen = b""
        self._status = None
        self._gone = threading.Event()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self):
        while not self._gone.is_set():
            if select.select([self.fd], [], [], 0.05)[0]:
                try:
                    data = os.read(self.fd, 1 << 16)
                except OSError:
                    return
                if not data:
                    return
                self.seen += data

    @property
    def shown(self):
        return re.sub(r"\x1b(\[[0-9;?<>=]*[A-Za-z]|\][^\x07]*\x07|[()][A-Z0-9]|[=>])", "", self.seen.decode(errors="replace"))

    def press(self, keys):
        os.write(self.fd, keys.encode())

    def until(self, text):
        """Wait until something was drawn, as it stands in `seen` or in `shown`."""
        assert wait_for(lambda: text.encode() in self.seen or text in self.shown, 20), self.shown[-3000:]

    def hang_up(self):
        """Take the terminal away."""
        self._gone.set()
        self._thread.join(5)
        os.close(self.fd)
        self.fd = -1

    def _ended(self):
        pid, status = os.waitpid(self.pid, os.WNOHANG)
        if pid:
            self._status = os.waitstatus_to_exitcode(status)
        return bool(pid)

    def end(self):
        """Wait for the end of the command; return its exit status."""
        assert wait_for(self._ended, 20), f"still running: {self.shown[-3000:]}"
        # What it drew last may still be on its way here; the end of it is an error of reading.
        self._thread.join(5)
        return self._status

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        if self._status is None:
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)
        if self.fd >= 0:
            self.hang_up()
