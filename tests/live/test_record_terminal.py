"""`servotap record` at a terminal: the live table, and the view driven by keys."""

from __future__ import annotations

import json
import os
import signal

import pytest

from tests.live.recorded import pty_pair
from tests.live.test_record import POLL, events, messages, raw
from tests.live.test_record_faults import Talker
from tests.terminal import Terminal


def recording(*words):
    return Terminal("-m", "analyzer", "record", *words, rows=40, columns=120)


def test_a_live_table_and_ctrl_c(tmp_path):
    log = tmp_path / "a.mcap"
    with pty_pair() as (master, path), recording(f"left=serial:{path},baud=115200", "-o", str(log)) as terminal:
        terminal.until("Ctrl-C ends it")
        os.write(master, POLL * 10)
        terminal.until("140 bytes")
        assert "listening" in terminal.shown
        terminal.press("\x03")
        assert terminal.end() == 0
        assert "(Ctrl-C)" in terminal.shown
        assert f"wrote {log}" in terminal.shown
        assert "Traceback" not in terminal.shown
    assert raw(log) == {"left": POLL * 10}


def test_the_view_marks_and_ends_the_recording_by_keys(tmp_path):
    pytest.importorskip("textual")
    log = tmp_path / "a.mcap"
    with (
        pty_pair() as (master, path),
        recording(f"left=serial:{path},baud=115200", "-o", str(log), "--view", "--dialect", "mks-rs485") as terminal,
        Talker(master, 0.02),
    ):
        terminal.until("left")
        terminal.until("Quit")
        terminal.press("m")
        terminal.until("mark:")
        terminal.press("it jerked\r")
        terminal.until("marked: ")
        terminal.press("q")
        terminal.until("End the recording?")
        terminal.press("y")
        assert terminal.end() == 0
        assert f"wrote {log}" in terminal.shown
        assert "Traceback" not in terminal.shown
    everything = messages(log, leave_out=("/raw",))
    assert any("it jerked" in json.dumps(body) for _, _, body in everything)


def test_sigterm_ends_the_view_and_gives_the_terminal_back(tmp_path):
    pytest.importorskip("textual")
    log = tmp_path / "a.mcap"
    with pty_pair() as (_, path), recording(f"left=serial:{path},baud=115200", "-o", str(log), "--view") as terminal:
        terminal.until("Quit")
        os.kill(terminal.pid, signal.SIGTERM)
        assert terminal.end() == 0
        assert "(SIGTERM)" in terminal.shown
        assert events(log)[-1]["reason"] == "SIGTERM"


def test_the_view_needs_a_terminal(tmp_path):
    from tests.live.test_record import servotap

    done = servotap("record", "serial:/dev/none", "--view", "-o", str(tmp_path / "a.mcap"), stdin=-3)
    assert done.returncode == 2
    assert "needs a terminal" in done.stderr
