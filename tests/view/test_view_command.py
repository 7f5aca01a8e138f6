"""`servotap view` as a command: real terminals, no terminal, wrong use, a terminal that goes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from tests import CAPTURES
from tests.terminal import Terminal

LOG = CAPTURES / "mks_rs485.log"
VIEW = ("-m", "analyzer", "view")
pytestmark = pytest.mark.skipif(not hasattr(os, "openpty"), reason="needs a pseudo-terminal")


def test_it_draws_takes_keys_and_leaves_the_terminal_as_it_was():
    with Terminal(*VIEW, str(LOG)) as terminal:
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
    with Terminal(*VIEW, str(LOG)) as terminal:
        terminal.until(drawn)
        os.kill(terminal.pid, number)
        assert terminal.end() == 0
        assert b"\x1b[?1049l" in terminal.seen


def test_it_ends_when_its_terminal_goes():
    with Terminal(*VIEW, str(LOG)) as terminal:
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
    with Terminal("-c", LIVE) as terminal:
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
    with Terminal("-c", code, "view", str(LOG)) as terminal:
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
    with Terminal(*VIEW, *words) as terminal:
        assert terminal.end() == 2
        assert text.encode() in terminal.seen
        assert b"\x1b[?1049h" not in terminal.seen


def test_what_is_not_used_is_not_imported():
    code = "import sys, analyzer.cli.view, analyzer.cli.record; print('textual' in sys.modules, 'foxglove' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=30)
    assert done.stdout == "False False\n"
