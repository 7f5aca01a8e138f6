"""What the displays of a recording print, without processes."""

from __future__ import annotations

import errno
import io
import json
import sys
import threading
from types import SimpleNamespace

import pytest

from analyzer.cli.record import record
from analyzer.cli.record_display import Display, JsonDisplay, behind
from analyzer.live.port_status import PortStatus
from analyzer.live.snapshot import BusCounts, Snapshot


class Writes(io.StringIO):
    """Standard output that keeps each write: between two of them another thread can write."""

    def __init__(self):
        super().__init__()
        self.each = []

    def write(self, text):
        if text:
            self.each.append(text)
        return len(text)


def test_a_line_is_one_write_so_that_two_threads_never_share_a_line(monkeypatch):
    out, errors = Writes(), Writes()
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "stderr", errors)
    for display in (JsonDisplay(), Display()):
        display.note("left", "cannot store")
    # What another thread notes waits for the one that prints: a reader that stalls holds up that one alone.
    assert out.each == errors.each == []
    for display in (JsonDisplay(), Display()):
        display.note("left", "cannot store")
        display.tell_notes()
    assert [json.loads(text) for text in out.each] == [{"event": "note", "bus": "left", "text": "cannot store"}]
    assert out.each[0].endswith("}\n")
    assert errors.each == ["left: cannot store\n"]


def test_a_reader_of_the_output_that_has_gone_does_not_end_a_recording(monkeypatch):
    class Gone(io.StringIO):
        def write(self, text):
            raise BrokenPipeError

    monkeypatch.setattr(sys, "stdout", Gone())
    display = JsonDisplay()
    display.note("left", "cannot store")
    display.tell_notes()
    assert isinstance(display.unprinted, BrokenPipeError)
    Display().begin(SimpleNamespace(tallies={}, config=SimpleNamespace(log="x.mcap")))


def finishing():
    return SimpleNamespace(
        snapshot=None, tallies={"1": PortStatus(bus="left", endpoint="", count=7)}, began_ns=1, ended_ns=3, phase="finishing",
        config=SimpleNamespace(raw_only=False, log="x.mcap"),
    )  # fmt: skip


@pytest.mark.parametrize("display", [Display(), JsonDisplay()])
def test_the_first_line_that_could_not_be_printed_is_kept_for_the_end(monkeypatch, display):
    class Full(io.StringIO):
        def write(self, text):
            raise OSError(errno.ENOSPC, "No space left on device")

    display.line(finishing())
    assert display.unprinted is None
    with monkeypatch.context() as full:
        full.setattr(sys, "stdout", Full())
        display.begin(SimpleNamespace(tallies={}, config=SimpleNamespace(log="x.mcap")))
    first = display.unprinted
    assert first.errno == errno.ENOSPC
    display.line(finishing())
    assert display.unprinted is first


def test_a_line_in_which_nothing_has_changed_is_not_printed_again(monkeypatch):
    out = Writes()
    monkeypatch.setattr(sys, "stdout", out)
    display, supervisor = Display(), finishing()
    for _ in range(3):
        display.line(supervisor)
    assert len(out.each) == 1
    supervisor.snapshot = Snapshot(0, 1, buses=[BusCounts("left", frames=1)])
    display.line(supervisor)
    display.line(supervisor)
    assert len(out.each) == 2
    assert "1 frame" in out.each[1]


def test_it_says_by_how_much_decoding_is_behind(monkeypatch):
    """In seconds and frames: of a serial line by the length of those so far, of a CAN bus those that were stored."""
    buses = [BusCounts("left", frames=100, bytes=700, junk_bytes=50), BusCounts("arm", frames=40)]
    snapshot = Snapshot(0, 1, buses=buses, behind_ns=2_500_000_000)
    left = PortStatus(bus="left", endpoint="", count=1450)
    arm = PortStatus(bus="arm", endpoint="", unit="frames", count=70)
    supervisor = SimpleNamespace(
        snapshot=snapshot, tallies={"1": left, "2": arm}, began_ns=0, ended_ns=0, phase="recording",
        config=SimpleNamespace(raw_only=False, log="x.mcap"),
    )  # fmt: skip
    assert behind(supervisor) == (2.5, 130)
    out = Writes()
    monkeypatch.setattr(sys, "stdout", out)
    Display().line(supervisor)
    JsonDisplay().line(supervisor)
    assert "decoding is 2.5 s behind, about 130 frames" in "".join(out.each)
    told = json.loads(out.each[-1])
    assert (told["behind"], told["behind_frames"]) == (2.5, 130)
    supervisor.snapshot = Snapshot(0, 1, buses=buses, behind_ns=900_000_000)
    assert behind(supervisor) == (0.0, 0)


def test_a_recording_runs_before_anything_is_shown_and_all_notes_are_told(monkeypatch, capsys):
    runs = threading.Event()

    class Recorder:
        reason = ""

        def __init__(self, config, on_note, **options):
            self.note = on_note

        def start(self):
            self.note("left", "is slow to open")

        def run(self):
            runs.set()
            self.note("left", "was closed")

        def stop(self, reason):
            pass

    class Shown(Display):
        def begin(self, supervisor):
            # A reader that stalls would hold this up for ever.
            assert runs.wait(60)

        def end(self, summary):
            self._out("the end")

    monkeypatch.setattr("analyzer.live.supervisor.Supervisor", Recorder)
    monkeypatch.setattr("analyzer.cli.record_report.summarize", lambda supervisor: SimpleNamespace(lost=0))
    assert record(None, Shown()) == 0
    told = capsys.readouterr()
    assert told.err == "left: is slow to open\nleft: was closed\n"
    assert told.out == "the end\n"
