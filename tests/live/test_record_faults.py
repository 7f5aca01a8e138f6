"""What a recording loses when something dies, is unplugged or is full: nothing, or what its end says."""

from __future__ import annotations

import os
import resource
import signal
import socket
import subprocess
import threading
import time
from contextlib import contextmanager, suppress

from tests.conformance.drives.served import wait_for
from tests.live.recorded import Recorded, gone, pty_pair, small_disk
from tests.live.test_reader_serial import terminal
from tests.live.test_record import POLL, events, raw, servotap
from tests.plugin_site import make_site

BLOCK = 700


class Talker:
    """Puts numbered bytes on a line for as long as it is entered. `sent`: so far."""

    def __init__(self, fd, pause=0.002):
        self.sent = b""
        self._fd, self._pause = fd, pause
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self):
        os.set_blocking(self._fd, False)
        number = 0
        while not self._stop.wait(self._pause):
            data = number.to_bytes(4, "big") * 5
            # The terminal is full while no process reads it.
            with suppress(BlockingIOError):
                self.sent += data[: os.write(self._fd, data)]
            number += 1

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *exception):
        self._stop.set()
        self._thread.join()


@contextmanager
def talking(tmp_path, *words):
    """A recording of a line that is never quiet."""
    with (
        pty_pair() as (master, path),
        Recorded(tmp_path, f"left=serial:{path},baud=921600", "--raw-only", *words) as recorded,
        Talker(master) as talker,
    ):
        assert recorded.wait_bytes(BLOCK)
        yield recorded, talker


def finish(recorded, talker, status=0):
    talker.__exit__()
    assert recorded.wait_bytes(len(talker.sent))
    assert recorded.end() == status, (recorded.lines[-3:], recorded.errors)


# --- killed ---------------------------------------------------------------------------------------------------------------


def test_a_reader_killed_again_and_again_costs_no_byte(tmp_path):
    with talking(tmp_path) as (recorded, talker):
        for _ in range(3):
            os.kill(recorded.pid_of("live.reader"), signal.SIGKILL)
            recorded.wait_note("another one took over the port")
            seen = recorded.count()
            assert recorded.wait_bytes(seen + BLOCK)
        finish(recorded, talker)
        port = recorded.summary["ports"][0]
        assert port["restarts"] == 3
        assert [gap["kept"] for gap in port["gaps"]] == [True] * 3
        assert not recorded.summary["lost"]
    assert raw(recorded.log) == {"left": talker.sent}
    assert [e["event"] for e in events(recorded.log)].count("restarted") == 3


def test_a_spool_and_its_configuration_deleted_while_its_reader_is_dead_cost_no_more_than_was_in_it(tmp_path):
    with talking(tmp_path) as (recorded, talker):
        # Decoding is killed too, or it would read on in the file that it has open.
        os.kill(recorded.pid_of("live.recorder"), signal.SIGKILL)
        os.kill(recorded.pid_of("live.reader"), signal.SIGKILL)
        for pattern in ("1-left.*.raw", "recording.*"):
            for path in recorded.folder.glob(pattern):
                path.unlink()
        recorded.wait_note("another one took over the port")
        seen = recorded.count()
        # More than stood in the segment that is gone.
        assert recorded.wait_bytes(2 * seen + BLOCK)
        finish(recorded, talker, 1)
    stored = raw(recorded.log)["left"]
    told = sum(e.get("bytes", 0) for e in events(recorded.log) if e["event"] == "missing")
    assert len(stored) + told == len(talker.sent)
    at = next(n for n, (a, b) in enumerate(zip(stored, talker.sent, strict=False)) if a != b)
    assert stored[at:] == talker.sent[at + told :]


def test_the_decoding_process_killed_again_and_again_costs_no_byte(tmp_path):
    with talking(tmp_path) as (recorded, talker):
        for _ in range(3):
            os.kill(recorded.pid_of("live.recorder"), signal.SIGKILL)
            recorded.wait_note("the decoding process ended (killed by SIGKILL)")
            seen = recorded.count()
            assert recorded.wait_bytes(seen + BLOCK)
            assert wait_for(lambda: "live.recorder" in " ".join(_lines(recorded)))
        finish(recorded, talker)
        assert recorded.summary["decoder_restarts"] == 3
        assert not recorded.summary["lost"]
    assert raw(recorded.log) == {"left": talker.sent}


def _lines(recorded):
    from tests.live.recorded import children_of

    return children_of(recorded.process.pid).values()


_MINE = "from dataclasses import replace\nfrom analyzer.dialects import get\nDIALECT = replace(get('mks-can'), name='mine')\n"


def test_a_package_that_breaks_while_a_recording_runs_costs_no_byte(tmp_path, monkeypatch):
    site = tmp_path / "site"
    site.mkdir()
    make_site(site, "breaking", _MINE, "breaking")
    monkeypatch.setenv("PYTHONPATH", str(site))
    with pty_pair() as (master, path), Recorded(tmp_path, f"left=serial:{path},baud=115200") as recorded:
        os.write(master, POLL)
        assert recorded.wait_bytes(len(POLL))
        # The decoding process that is started anew imports it again.
        (site / "breaking.py").write_text("raise SystemExit('broken \\x1b[2J')\n")
        os.kill(recorded.pid_of("live.recorder"), signal.SIGKILL)
        recorded.wait_note("the decoding process ended (killed by SIGKILL)")
        os.write(master, POLL)
        assert recorded.wait_bytes(2 * len(POLL))
        assert recorded.end() == 0, recorded.errors
        assert recorded.summary["decoder_restarts"] == 1
        said = recorded.errors + "".join(line.get("text", "") for line in recorded.lines)
        assert "breaking (breaking:DIALECT) of servotap.dialects failed and is left out: SystemExit" in said
        assert "\x1b" not in said
    assert raw(recorded.log) == {"left": 2 * POLL}


def test_after_the_death_of_the_supervisor_the_others_finish_the_log_and_end(tmp_path):
    with talking(tmp_path) as (recorded, talker):
        pids = recorded.pids
        talker.__exit__()
        assert recorded.wait_bytes(len(talker.sent))
        os.kill(recorded.process.pid, signal.SIGKILL)
        assert gone(*pids), "nothing runs on as an orphan"
        assert wait_for(lambda: not recorded.folder.exists(), 1.0)
    assert raw(recorded.log) == {"left": talker.sent}
    closed = [e["reason"] for e in events(recorded.log) if e["event"] == "closed"]
    assert closed == ["the supervisor has gone"]


def test_after_the_death_of_all_everything_that_was_stored_is_recovered(tmp_path):
    with talking(tmp_path) as (recorded, talker):
        # So that it starts none of them again before its own turn comes.
        recorded.kill(signal.SIGSTOP)
        pids = recorded.pids
        for pid in reversed(pids):
            os.kill(pid, signal.SIGKILL)
        assert gone(*pids)
        talker.__exit__()
        stored = recorded.count()
    assert recorded.folder.exists()
    refused = servotap("record", "serial:/dev/none", "-o", str(recorded.log))
    assert refused.returncode == 2
    assert "servotap recover" in refused.stderr
    done = servotap("recover", str(recorded.log))
    assert done.returncode == 0, done.stderr
    assert not recorded.folder.exists()
    found = raw(recorded.log)["left"]
    assert found == talker.sent[: len(found)]
    assert len(found) == stored >= BLOCK


def test_a_decoding_process_that_cannot_live_leaves_the_raw_bytes_and_says_so(tmp_path):
    with talking(tmp_path) as (recorded, talker):
        for pattern in ("checkpoint.?", "recording.*"):
            for path in recorded.folder.glob(pattern):
                path.write_bytes(b"nonsense")
        os.kill(recorded.pid_of("live.recorder"), signal.SIGKILL)
        recorded.wait_note("the decoding process ended")
        recorded.wait_note("the decoding process ended")
        talker.__exit__()
        assert recorded.wait_bytes(len(talker.sent))
        assert recorded.end() == 1
        assert recorded.summary["unfinished"]
        assert recorded.summary["lost"]
        assert recorded.folder.exists()


# --- unplugged ------------------------------------------------------------------------------------------------------------


def test_a_port_unplugged_and_back_leaves_a_gap_and_the_others_go_on(tmp_path):
    link = tmp_path / "ttyUSB9"
    with pty_pair() as (other, other_path):
        with terminal(link) as master:
            recorded = Recorded(
                tmp_path, f"left=serial:{link},baud=115200", f"right=serial:{other_path},baud=115200", "--raw-only"
            )
            os.write(master, b"before")
            assert wait_for(lambda: recorded.count("1-") == 6)
        with recorded:
            recorded.wait_note("lost: ")
            os.write(other, POLL)
            assert wait_for(lambda: recorded.count("2-") == 14)
            with terminal(link) as master:
                recorded.wait_note("back after")
                os.write(master, b"after")
                assert wait_for(lambda: recorded.count("1-") == 11)
                assert recorded.end() == 1, "something was lost"
    left, right = recorded.summary["ports"]
    assert len(left["gaps"]) == 1
    assert left["gaps"][0]["to_ns"] > left["gaps"][0]["from_ns"]
    assert "gaps" not in right
    assert raw(recorded.log) == {"left": b"beforeafter", "right": POLL}
    named = [e["event"] for e in events(recorded.log) if e.get("bus") == "left"]
    assert [name for name in named if name in ("lost", "back")] == ["lost", "back"]


def test_a_port_that_stays_away_is_told_at_the_end(tmp_path):
    link = tmp_path / "ttyUSB9"
    with terminal(link):
        recorded = Recorded(tmp_path, f"left=serial:{link},baud=115200")
    with recorded:
        recorded.wait_note("lost: ")
        assert recorded.end() == 1
    port = recorded.summary["ports"][0]
    assert "to_ns" not in port["gaps"][0] or port["gaps"][0]["to_ns"] is None


def test_a_tcp_server_gone_and_back(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(15)
        address = server.getsockname()
        recorded = Recorded(tmp_path, f"far=tcp:127.0.0.1:{address[1]}", "--raw-only")
        client, _ = server.accept()
        client.sendall(b"before")
        assert recorded.wait_bytes(6)
        client.close()
    with recorded:
        recorded.wait_note("lost: the server closed the connection")
        with socket.create_server(address) as server:
            server.settimeout(15)
            client, _ = server.accept()
            client.sendall(b"after")
            assert recorded.wait_bytes(11)
            assert recorded.end() == 1
            client.close()
    assert raw(recorded.log) == {"far": b"beforeafter"}


# --- full -----------------------------------------------------------------------------------------------------------------


def flood(fd, count):
    """Bytes that no compression makes smaller."""
    data = os.urandom(count)
    for at in range(0, count, 2000):
        os.write(fd, data[at : at + 2000])
        time.sleep(0.002)
    return data


def test_a_full_disk_costs_nothing_while_memory_lasts(tmp_path):
    disk = tmp_path / "disk"
    with (
        small_disk(disk, "256k") as enlarge,
        pty_pair() as (master, path),
        Recorded(disk, f"left=serial:{path},baud=4000000", "--raw-only") as recorded,
    ):
        sent = flood(master, 600_000)
        recorded.wait_note("cannot store: No space left on device")
        sent += flood(master, 100_000)
        enlarge("8m")
        assert recorded.wait_bytes(len(sent))
        assert recorded.end() == 0, (recorded.lines[-1], recorded.errors)
        assert raw(recorded.log) == {"left": sent}
        assert recorded.summary["ports"][0].get("dropped", 0) == 0


def test_a_limit_of_the_files_size_is_a_full_disk(tmp_path):
    with pty_pair() as (master, path), Recorded(tmp_path, f"left=serial:{path},baud=4000000", "--raw-only") as recorded:
        reader = recorded.pid_of("live.reader")
        resource.prlimit(reader, resource.RLIMIT_FSIZE, (50_000, resource.RLIM_INFINITY))
        sent = flood(master, 150_000)
        recorded.wait_note("cannot store: File too large")
        resource.prlimit(reader, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        assert recorded.wait_bytes(len(sent))
        assert recorded.end() == 0, (recorded.lines[-1], recorded.errors)
    assert raw(recorded.log) == {"left": sent}


def test_no_process_is_left_when_the_command_is_ended_while_it_starts(tmp_path):
    with pty_pair() as (_, path):
        recorded = Recorded(tmp_path, f"left=serial:{path},baud=115200", wait=False)
        with recorded:
            assert wait_for(lambda: recorded.folder.exists())
            pids = recorded.pids
            recorded.kill(signal.SIGTERM)
            with suppress(subprocess.TimeoutExpired):
                recorded.process.wait(20)
            assert recorded.process.poll() is not None
            assert gone(*pids)
    assert not recorded.folder.exists()
