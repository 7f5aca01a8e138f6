"""`servotap record` at a terminal: the live table, and the view driven by keys."""

from __future__ import annotations

import fcntl
import json
import os
import re
import select
import signal
import struct
import sys
import termios
import threading
import time

import pytest

from tests import ROOT
from tests.conformance.drives.served import wait_for
from tests.live.recorded import pty_pair
from tests.live.test_record import POLL, events, messages, raw
from tests.live.test_record_faults import Talker


class Terminal:
    """The command at a terminal of its own. `shown`: all that it has drawn, without what moves the cursor."""

    def __init__(self, *words):
        self.pid, self.fd = os.forkpty()
        if self.pid == 0:
            os.chdir(ROOT)
            os.environ.update(TERM="xterm-256color", COLUMNS="120", LINES="40")
            os.execv(sys.executable, [sys.executable, "-m", "analyzer", "record", *words])
        fcntl.ioctl(self.fd, termios.TIOCSWINSZ, struct.pack("4H", 40, 120, 0, 0))
        self._drawn = b""
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self):
        while True:
            try:
                data = os.read(self.fd, 1 << 16)
            except OSError:
                return
            if not data:
                return
            self._drawn += data

    @property
    def shown(self):
        return re.sub(r"\x1b(\[[0-9;?<>=]*[A-Za-z]|\][^\x07]*\x07|[()][A-Z0-9]|[=>])", "", self._drawn.decode(errors="replace"))

    def press(self, keys):
        os.write(self.fd, keys.encode())

    def wait_shown(self, text, seconds=20.0):
        assert wait_for(lambda: text in self.shown, seconds), self.shown[-3000:]

    def wait(self, seconds=20.0):
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.pid = 0
                # What it drew last may still be on its way here; the end of it is an error of reading.
                self._thread.join(seconds)
                return os.waitstatus_to_exitcode(status)
            select.select([], [], [], 0.02)
        raise AssertionError(f"still running: {self.shown[-3000:]}")

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        if self.pid:
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)
        os.close(self.fd)
        self._thread.join(5)


def test_a_live_table_and_ctrl_c(tmp_path):
    log = tmp_path / "a.mcap"
    with pty_pair() as (master, path), Terminal(f"left=serial:{path},baud=115200", "-o", str(log)) as terminal:
        terminal.wait_shown("Ctrl-C ends it")
        os.write(master, POLL * 10)
        terminal.wait_shown("140 bytes")
        assert "listening" in terminal.shown
        terminal.press("\x03")
        assert terminal.wait() == 0
        assert "(Ctrl-C)" in terminal.shown
        assert f"wrote {log}" in terminal.shown
        assert "Traceback" not in terminal.shown
    assert raw(log) == {"left": POLL * 10}


def test_the_view_marks_and_ends_the_recording_by_keys(tmp_path):
    pytest.importorskip("textual")
    log = tmp_path / "a.mcap"
    with (
        pty_pair() as (master, path),
        Terminal(f"left=serial:{path},baud=115200", "-o", str(log), "--view", "--dialect", "mks-rs485") as terminal,
        Talker(master, 0.02),
    ):
        terminal.wait_shown("left")
        terminal.wait_shown("Quit")
        terminal.press("m")
        terminal.wait_shown("mark:")
        terminal.press("it jerked\r")
        terminal.wait_shown("marked: ")
        terminal.press("q")
        terminal.wait_shown("End the recording?")
        terminal.press("y")
        assert terminal.wait() == 0
        assert f"wrote {log}" in terminal.shown
        assert "Traceback" not in terminal.shown
    everything = messages(log, leave_out=("/raw",))
    assert any("it jerked" in json.dumps(body) for _, _, body in everything)


def test_sigterm_ends_the_view_and_gives_the_terminal_back(tmp_path):
    pytest.importorskip("textual")
    log = tmp_path / "a.mcap"
    with pty_pair() as (_, path), Terminal(f"left=serial:{path},baud=115200", "-o", str(log), "--view") as terminal:
        terminal.wait_shown("Quit")
        os.kill(terminal.pid, signal.SIGTERM)
        assert terminal.wait() == 0
        assert "(SIGTERM)" in terminal.shown
        assert events(log)[-1]["reason"] == "SIGTERM"


def test_the_view_needs_a_terminal(tmp_path):
    from tests.live.test_record import servotap

    done = servotap("record", "serial:/dev/none", "--view", "-o", str(tmp_path / "a.mcap"), stdin=-3)
    assert done.returncode == 2
    assert "needs a terminal" in done.stderr
