"""`servotap view` as a command: real terminals, no terminal, wrong use, a terminal that goes."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import signal
import struct
import subprocess
import sys
import termios
import time

import pytest

from tests import CAPTURES

LOG = CAPTURES / "mks_rs485.log"
pytestmark = pytest.mark.skipif(not hasattr(os, "openpty"), reason="needs a pseudo-terminal")


class Terminal:
    """A command in a pseudo-terminal of its own."""

    def __init__(self, *words: str, before: tuple[str, ...] = ("-m", "analyzer")) -> None:
        self.seen = b""
        self.pid, self.fd = pty.fork()
        if self.pid == 0:
            os.environ.update(TERM="xterm-256color", COLUMNS="80", LINES="24")
            os.execv(sys.executable, [sys.executable, *before, *words])
        fcntl.ioctl(self.fd, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))

    def until(self, text: str) -> None:
        """Wait until something was drawn."""
        late = time.monotonic() + 20
        while text.encode() not in self.seen:
            assert time.monotonic() < late, self.seen[-2000:]
            self._read(0.5)

    def _read(self, seconds: float) -> None:
        if select.select([self.fd], [], [], seconds)[0]:
            try:
                self.seen += os.read(self.fd, 1 << 16)
            except OSError:
                return

    def press(self, keys: str) -> None:
        """Type something."""
        os.write(self.fd, keys.encode())

    def end(self) -> int:
        """Return how it ended."""
        late = time.monotonic() + 20
        while time.monotonic() < late:
            done, status = os.waitpid(self.pid, os.WNOHANG)
            if self.fd >= 0:
                self._read(0.05)
            if done:
                if self.fd >= 0:
                    os.close(self.fd)
                return os.waitstatus_to_exitcode(status)
            time.sleep(0.02)
        os.kill(self.pid, signal.SIGKILL)
        os.waitpid(self.pid, 0)
        pytest.fail(f"it did not end: {self.seen[-500:]!r}")

    def hang_up(self) -> None:
        """Take the terminal away."""
        os.close(self.fd)
        self.fd = -1


def test_it_draws_takes_keys_and_leaves_the_terminal_as_it_was():
    terminal = Terminal("view", str(LOG))
    terminal.until("run_speed")
    terminal.press("3")
    terminal.until("out_of_range 1")
    terminal.press("q")
    assert terminal.end() == 0
    assert b"\x1b[?1049l" in terminal.seen
    assert b"Traceback" not in terminal.seen


@pytest.mark.parametrize("drawn", ["\x1b[?1049h", "run_speed"], ids=["while it starts", "while it runs"])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_it_in_order(number, drawn):
    terminal = Terminal("view", str(LOG))
    terminal.until(drawn)
    os.kill(terminal.pid, number)
    assert terminal.end() == 0
    assert b"\x1b[?1049l" in terminal.seen


def test_it_ends_when_its_terminal_goes():
    terminal = Terminal("view", str(LOG))
    terminal.until("run_speed")
    terminal.hang_up()
    assert isinstance(terminal.end(), int)


LIVE = """
import signal, sys, threading, time
from analyzer.live.snapshot_sink import SnapshotSink
from analyzer.view import run_live
from analyzer.view.live import SnapshotQueue
signal.signal(signal.SIGHUP, signal.SIG_IGN)
snapshots, feed = SnapshotQueue(), SnapshotSink()
def go_on():
    while True:
        feed.event(time.time_ns(), "left", "note", "still here")
        snapshots.offer(feed.snapshot(time.time_ns()))
        time.sleep(0.05)
threading.Thread(target=go_on, daemon=True).start()
why = run_live(snapshots, mark=str, log="week.mcap")
sys.exit(7 if why == "its terminal has gone" else 1)
"""


def test_a_recording_outlives_the_terminal_of_its_view():
    terminal = Terminal(before=("-c", LIVE))
    terminal.until("still here")
    terminal.hang_up()
    assert terminal.end() == 7


def test_without_a_terminal_it_says_so():
    command = [sys.executable, "-m", "analyzer", "view", str(LOG)]
    done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, timeout=30)
    assert done.returncode == 2
    assert "needs a terminal" in done.stderr
    assert "servotap show" in done.stderr
    assert not done.stdout


def test_standard_input_is_no_file_to_view(cli):
    assert "servotap show -" in cli("view", "-", status=2).err


def test_without_textual_it_says_what_to_install():
    code = "import sys; sys.modules['textual'] = None; from analyzer.cli import main; sys.exit(main(sys.argv[1:]))"
    terminal = Terminal("view", str(LOG), before=("-c", code))
    assert terminal.end() == 2
    assert b"pip install textual" in terminal.seen


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["nowhere.log"], "nowhere.log"),
        ([str(LOG), "--filter", "spede > 1"], "no field 'spede'"),
        ([str(LOG), "--dialect", "mks-can"], "mks-can is a dialect of can"),
    ],
)
def test_wrong_use_is_told_before_the_view_opens(words, text):
    terminal = Terminal("view", *words)
    assert terminal.end() == 2
    assert text.encode() in terminal.seen
    assert b"\x1b[?1049h" not in terminal.seen


def test_what_is_not_used_is_not_imported():
    code = "import sys, analyzer.cli.view, analyzer.cli.record; print('textual' in sys.modules, 'foxglove' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=30)
    assert done.stdout == "False False\n"
