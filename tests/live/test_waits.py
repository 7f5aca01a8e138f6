"""Every loop of a recording that waits ends: on a full disk, with its folder gone, after a signal.

`WAITS` lists these loops, what ends each, and the test that shows it; a loop that is not listed is a failure.
"""

from __future__ import annotations

import ast
import errno
import os
import re
import shutil
import signal
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import pytest

from analyzer.cli import main
from analyzer.cli.record import record
from analyzer.live import recorder, supervisor
from analyzer.live.config import WHOLE
from analyzer.live.recorder import LAST_TRIES_NS, QUIET_NS, Recorder, Stalled
from analyzer.live.recording import Recording
from analyzer.live.supervisor import END_S, SILENT_S, Supervisor, Taken
from tests import ROOT
from tests.collect import sum8
from tests.conformance.drives.served import wait_for
from tests.live.recorded import Recorded, pty_pair, small_disk
from tests.live.spooled import Spools, port
from tests.live.test_record import raw, servotap
from tests.live.test_record_faults import flood

S = 1_000_000_000
#: Calls that wait.
WAITING = {"sleep", "wait", "poll", "get", "select", "read", "recv", "recv_fds", "_turn"}
#: Module and function -> what ends its loop, and the test of that.
WAITS = {
    "autobaud_ports.listen": ("its time", "test_a_quiet_line_is_said_to_be_quiet"),
    "children._keep": ("the end of the leash", "test_after_the_death_of_the_supervisor_the_others_finish_the_log_and_end"),
    "passing._left_by_program": ("_LEFT_WITHIN_S", "test_what_a_blocked_adapter_did_not_take_is_told_at_the_end"),
    "passing._run": ("the tap's end", "test_an_adapter_that_is_unplugged_comes_back_under_the_programs_feet"),
    "passing.run": ("the end, at a full disk 3 s later", "test_what_cannot_be_stored_in_the_end_is_told"),
    "reader._open": ("the end", "test_a_port_that_stays_away_is_told_at_the_end"),
    "reader_port._hold": ("the end of the leash", "test_the_end_of_the_leash_is_a_wish"),
    "reader_port.listen": ("the end", "test_what_had_come_when_the_end_is_wished_is_stored"),
    "reader_store.finish": ("LAST_TRIES_NS", "test_what_cannot_be_stored_in_the_end_is_told"),
    "reader_stream.drain": ("DRAIN_LIMIT", "test_a_lot_arrives_whole_and_in_order"),
    "reader_tcp._connect": (
        "CONNECT_S, the end",
        "test_a_server_that_does_not_answer_is_given_up_and_the_wish_to_end_ends_the_wait",
    ),
    "recorder._patiently": ("LAST_TRIES_NS after the end", "test_decoding_that_cannot_write_ends_soon_after_it_is_asked_to"),
    "recorder.run": ("the end, or QUIET_NS without a reader", "test_decoding_ends_though_no_reader_says_that_it_has"),
    "spool.read": ("what is there", "test_what_was_written_is_read_whatever_the_segments_and_the_portions"),
    "storing._run": ("its last piece of work", "test_what_cannot_be_stored_in_the_end_is_told"),
    "supervisor._await_open": ("OPEN_S, the end", "test_no_process_is_left_when_the_command_is_ended_while_it_starts"),
    "supervisor._end": ("END_S", "test_a_supervisor_waits_for_no_process_for_ever"),
    "supervisor._finish": ("SILENT_S, LAST_DEATHS", "test_a_supervisor_waits_for_no_process_for_ever"),
    "supervisor.run": ("the end", "test_a_full_disk_and_ctrl_c"),
}


def waiting_loops():
    for folder in ("analyzer/live", "conformance/tap"):
        for path in sorted((ROOT / folder).glob("*.py")):
            for function in ast.walk(ast.parse(path.read_text())):
                if not isinstance(function, ast.FunctionDef):
                    continue
                for loop in ast.walk(function):
                    if isinstance(loop, ast.While):
                        called = {ast.unparse(c.func).rpartition(".")[2] for c in ast.walk(loop) if isinstance(c, ast.Call)}
                        if called & WAITING:
                            yield f"{path.stem}.{function.name}"


def test_each_loop_that_waits_is_known_and_has_a_test():
    assert set(waiting_loops()) == set(WAITS)
    written = "\n".join(p.read_text() + p.stem for p in (ROOT / "tests").rglob("test_*.py") if p != Path(__file__))
    written += re.sub(r"WAITS = \{.*?^\}", "", Path(__file__).read_text(), flags=re.DOTALL | re.MULTILINE)
    for loop, (_, test) in WAITS.items():
        assert re.search(rf"\b{test}\b", written), f"{loop}: there is no {test}"


# --- without processes, on a clock of their own ---------------------------------------------------------------------------


class Clock:
    """A clock that only a sleep moves on. `asked`: the end is requested from `asked_s` on."""

    def __init__(self, asked_s=5.0):
        self.now_ns = 1000 * S
        self.asked_ns = self.now_ns + int(asked_s * S)

    def monotonic_ns(self):
        return self.now_ns

    def monotonic(self):
        return self.now_ns / S

    def sleep(self, seconds):
        self.now_ns += int(seconds * S)
        assert self.now_ns < self.asked_ns + 600 * S, "it does not end"

    def asked(self):
        return "asked to end" if self.now_ns >= self.asked_ns else ""


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(recorder, "time", clock)
    monkeypatch.setattr(supervisor, "time", clock)
    return clock


def spooled(tmp_path, **about):
    spools = Spools(tmp_path, port("1-left", "left"), **about)
    for n in range(20):
        spools.data("1-left", n, sum8("FA 01 32"))
    return spools


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.ENOENT, errno.EIO])
@pytest.mark.parametrize("step", ["_save_beginning", "flush", "rotate", "finish"])
def test_decoding_that_cannot_write_ends_soon_after_it_is_asked_to(tmp_path, monkeypatch, clock, step, number):
    spools = spooled(tmp_path, rotate_bytes=1 if step == "rotate" else 0)
    if step == "finish":
        spools.end(30)
    spools.close()

    def fails(*_):
        raise OSError(number, os.strerror(number))

    def rotate(self, patiently):
        patiently(fails)

    monkeypatch.setattr(Recording, step, rotate if step in ("rotate", "finish") else fails)
    said = []
    with pytest.raises(Stalled, match="servotap recover"):
        Recorder(spools.folder, asked=clock.asked, say=said.append).run()
    # With an end in the spools it need not be asked.
    asked_ns = 1000 * S if step == "finish" else clock.asked_ns
    assert clock.now_ns - asked_ns <= LAST_TRIES_NS + S
    assert any("cannot write" in text for text in said)
    assert spools.folder.exists()


def test_decoding_ends_though_no_reader_says_that_it_has(tmp_path, clock):
    spools = spooled(tmp_path)
    spools.close()
    assert Recorder(spools.folder, asked=clock.asked, say=print).run()
    assert clock.now_ns - clock.asked_ns <= QUIET_NS + S
    assert not spools.folder.exists()


class Mute:
    """A process that neither says anything nor ends."""

    alive, pid, due, killed, slipped = True, 1, None, False, False

    def start(self):
        pass

    end = start

    def drop_leash(self):
        self.slipped = True

    def kill(self):
        self.killed = True

    def wait(self, seconds):
        return False

    close = start


def test_a_supervisor_waits_for_no_process_for_ever(tmp_path, monkeypatch, clock):
    spools = spooled(tmp_path)
    reader, decoder = Mute(), Mute()
    watched = Supervisor(spools.config, readers=lambda folder, heard: {"1-left": reader})
    watched._decoder = decoder
    watched._control = SimpleNamespace(event=lambda *_, **__: None, finish=lambda: False)
    monkeypatch.setattr(watched, "_turn", lambda seconds: clock.sleep(seconds) or "")
    watched.stop("Ctrl-C")
    before = clock.monotonic()
    watched.run()
    assert reader.killed
    assert decoder.killed
    assert decoder.slipped
    assert clock.monotonic() - before <= END_S + SILENT_S + 1
    assert "servotap recover" in watched.unfinished


def test_a_name_that_another_recording_takes_meanwhile_gets_the_next_number(tmp_path, monkeypatch):
    """Two that begin at once see the same free names; the one that comes second opens no port and takes the next name."""
    config, begun = spooled(tmp_path).config, []
    next_one = tmp_path / "next.mcap"
    monkeypatch.setattr(Supervisor, "_await_open", lambda self: begun.append(self.config.log) or self.stop("asked"))
    monkeypatch.setattr(Supervisor, "run", lambda self: None)
    monkeypatch.setattr("analyzer.live.supervisor.DecoderChild", lambda folder, heard: Mute())
    monkeypatch.setattr("analyzer.cli.record_report.summarize", lambda supervisor: SimpleNamespace(lost=False))
    display = mock.MagicMock(unprinted=None)
    with pytest.raises(Taken, match="has just begun"):
        record(config, display, readers=lambda folder, heard: {})
    assert record(config, display, readers=lambda folder, heard: {}, names=[Path(config.log), next_one]) == 0
    assert begun == [str(next_one)]


@pytest.mark.parametrize("phase", ["ending", "finishing"])
def test_a_reader_that_dies_at_the_end_is_not_started_again(phase, tmp_path):
    said = []
    watched = Supervisor(
        spooled(tmp_path).config, readers=lambda folder, heard: {"1-left": Mute()}, on_note=lambda *note: said.append(note)
    )
    watched.phase = phase
    watched._hear_exit("1-left", -signal.SIGKILL)
    assert watched._gone == {"1-left"}
    assert said == []


@pytest.mark.parametrize("told", [True, False])
def test_a_reader_that_did_not_tell_its_end_has_lost_what_it_held(told, tmp_path):
    said, noted = [], []
    spools = spooled(tmp_path)
    watched = Supervisor(spools.config, readers=lambda folder, heard: {}, on_note=lambda *note: said.append(note))
    watched._control = SimpleNamespace(event=lambda event, **about: noted.append(event), finish=lambda: True)
    watched._decoded = True
    for event in ["open"] + ["closed"] * told:
        watched._hear_event("1-left", {"event": event})
    watched._end()
    assert watched.tallies["1-left"].lost is not told
    assert noted == ["lost"] * (not told) + ["end"]
    assert said == [("left", "its reader process died and did not tell its end: what it held is lost")] * (not told)


@pytest.mark.parametrize(("status", "whole"), [(0, False), (WHOLE, True)])
def test_a_decoding_process_that_a_library_ends_with_0_has_no_whole_log(status, whole, tmp_path):
    watched = Supervisor(spooled(tmp_path).config, readers=lambda folder, heard: {})
    watched.phase = "finishing"
    watched._hear_exit("decoding", status)
    assert watched._decoded is whole
    assert watched.decoder_restarts == (not whole)


# --- the command ----------------------------------------------------------------------------------------------------------


def test_a_full_disk_and_ctrl_c(tmp_path):
    disk = tmp_path / "disk"
    with (
        small_disk(disk, "256k") as enlarge,
        pty_pair() as (master, path),
        Recorded(disk, f"left=serial:{path},baud=4000000", "--raw-only") as recorded,
    ):
        sent = flood(master, 600_000)
        recorded.wait_note("cannot store: No space left on device")
        recorded.kill(signal.SIGINT)
        unstored = recorded.wait_note("could not be stored", 20)
        assert recorded.end(None) == 1
        dropped = recorded.summary["ports"][0]["dropped"]
        assert str(dropped) in unstored["text"]
        assert "Free some space" in recorded.summary["unfinished"]
        enlarge("8m")
        assert main(["recover", str(recorded.log)]) == 0
        found = raw(recorded.log)["left"]
        assert found == sent[: len(found)]
        assert len(found) + dropped == len(sent)


def begun(recorded):
    """Wait until the decoding process has stored its first checkpoint."""
    return wait_for(lambda: (recorded.folder / "checkpoint.1").exists(), 20.0)


def test_a_folder_of_spools_that_vanishes_costs_nothing(tmp_path):
    with pty_pair() as (master, path), Recorded(tmp_path, f"left=serial:{path},baud=4000000", "--raw-only") as recorded:
        sent = flood(master, 20_000)
        assert begun(recorded)
        shutil.rmtree(recorded.folder)
        recorded.wait_note("was deleted and is made again")
        sent += flood(master, 20_000)
        assert recorded.end() == 0, recorded.lines[-3:]
    assert raw(recorded.log) == {"left": sent}
    assert not recorded.folder.exists()


def test_a_log_that_is_taken_away_while_it_is_recorded_is_written_anew(tmp_path):
    with pty_pair() as (master, path), Recorded(tmp_path, f"left=serial:{path},baud=4000000", "--raw-only") as recorded:
        sent = flood(master, 10_000)
        assert begun(recorded)
        recorded.log.unlink()
        recorded.wait_note("was deleted or moved while it was being recorded")
        sent += flood(master, 10_000)
        recorded.log.rename(tmp_path / "away.mcap")
        recorded.wait_note("was deleted or moved while it was being recorded")
        (tmp_path / "other").write_bytes(b"other")
        (tmp_path / "other").replace(recorded.log)
        recorded.wait_note("was replaced by something else")
        refused = servotap("decode", "captures/mks_rs485.log", "-o", str(recorded.log), "--force")
        assert refused.returncode == 2
        assert "is being recorded" in refused.stderr
        sent += flood(master, 10_000)
        assert recorded.end() == 0, recorded.lines[-3:]
    log = tmp_path / "out-recorded-1.mcap"
    assert recorded.summary["files"] == [str(log)]
    assert raw(log) == {"left": sent}
    assert recorded.log.read_bytes() == b"other"


def test_a_log_that_is_overwritten_in_place_is_not_said_to_be_whole(tmp_path):
    with pty_pair() as (master, path), Recorded(tmp_path, f"left=serial:{path},baud=4000000", "--raw-only") as recorded:
        sent = flood(master, 10_000)
        assert begun(recorded)
        with recorded.log.open("r+b") as stream:
            stream.seek(100)
            stream.write(bytes(100))
        sent += flood(master, 10_000)
        assert recorded.end() == 1
        assert "is not as it was written" in recorded.summary["unfinished"]
    assert main(["recover", str(recorded.log)]) == 0
    assert raw(recorded.log) == {"left": sent}
