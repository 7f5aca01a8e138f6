"""`servotap record`: buses in, one log out. Real processes, pseudo-terminals, TCP and CAN."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import can
import pytest
from mcap.reader import make_reader

from analyzer.live.spool import Record, last_record
from analyzer.records import CanFrame, Chunk
from analyzer.sources import open_source
from tests import CAPTURES, ROOT
from tests.conformance.drives.served import Emulated, wait_for
from tests.live.recorded import Recorded, gone, pty_pair

POLL = bytes.fromhex("FA 01 31 2C FB 01 31 00 00 00 00 40 00 6D")


def raw(log):
    """What a log holds of each bus as it came: bytes of a serial line, frames of a CAN bus."""
    found = {}
    source = open_source(str(log), format=None, baud=None)
    for item in source:
        if isinstance(item, Chunk):
            found[item.port] = found.get(item.port, b"") + item.data
        elif isinstance(item, CanFrame):
            found.setdefault(item.port, []).append((item.id, item.data))
    source.close()
    return found


def messages(log, *, leave_out=("/raw", "/stats", "/recording")):
    with open(log, "rb") as stream:
        return [
            (channel.topic, message.log_time, json.loads(message.data))
            for _, channel, message in make_reader(stream).iter_messages()
            if not channel.topic.endswith(leave_out)
        ]


def events(log):
    with open(log, "rb") as stream:
        return [json.loads(m.data) for _, c, m in make_reader(stream).iter_messages() if c.topic == "/recording"]


def servotap(*words, **options):
    return subprocess.run([sys.executable, "-m", "analyzer", *words], cwd=ROOT, capture_output=True, text=True, **options)


def talk(fd, data, size=16, pause=0.001):
    """Put traffic on a line in pieces."""
    for at in range(0, len(data), size):
        os.write(fd, data[at : at + size])
        time.sleep(pause)


# --- one log --------------------------------------------------------------------------------------------------------------


def test_a_serial_line_is_recorded_decoded_and_every_byte_of_it_is_in_the_log(tmp_path):
    data = (CAPTURES / "mks_rs485.bin").read_bytes()
    with pty_pair() as (master, path), Recorded(tmp_path, f"left=serial:{path},baud=115200") as recorded:
        talk(master, data)
        assert recorded.wait_bytes(len(data))
        assert recorded.end() == 0, recorded.errors
        assert not recorded.folder.exists()
        assert raw(recorded.log) == {"left": data}
        summary = recorded.summary
        assert summary["event"] == "end"
        assert summary["ports"][0]["count"] == len(data)
        assert summary["buses"]["left"]["frames"] > 30
        assert summary["files"] == [str(recorded.log)]
        assert not summary["lost"]
        assert summary["reason"] == "Ctrl-C"
        topics = {topic for topic, _, _ in messages(recorded.log)}
        assert "/left/1/read_position/reply" in topics or any(t.startswith("/left/") for t in topics)


def test_the_log_of_a_run_and_of_decode_over_it_hold_the_same(tmp_path):
    data = (CAPTURES / "mks_rs485.bin").read_bytes() * 4
    with pty_pair() as (master, path), Recorded(tmp_path, f"left=serial:{path},baud=115200") as recorded:
        talk(master, data[:400], 7, 0.0005)
        time.sleep(0.12)
        # A frame that is never finished before a pause ends it.
        talk(master, data[400:403])
        time.sleep(0.12)
        talk(master, data[403:900], 33, 0.0)
        assert recorded.wait_bytes(900)
        assert recorded.end() == 0
    again = tmp_path / "again.mcap"
    done = servotap("decode", str(recorded.log), "-o", str(again))
    assert done.returncode == 0, done.stderr
    # But for the time of writing: bytes as they came stand before the frames that they end in.
    assert [(t, body) for t, _, body in messages(again)] == [(t, body) for t, _, body in messages(recorded.log)]


def test_several_ports_a_tapped_pair_and_a_can_bus_in_one_file_on_one_clock(tmp_path):
    pytest.importorskip("msgpack")
    group, port = "239.74.163.91", 43301
    endpoints = (f"can:udp_multicast:{group},port={port}",)
    with (
        pty_pair() as (first, first_path),
        pty_pair() as (ask, ask_path),
        pty_pair() as (answer, answer_path),
        socket.create_server(("127.0.0.1", 0)) as server,
        can.Bus(interface="udp_multicast", channel=group, port=port) as bus,
        Recorded(
            tmp_path,
            f"left=serial:{first_path},baud=38400",
            f"right=serial:{ask_path},baud=115200,direction=request",
            f"right=serial:{answer_path},baud=115200,direction=reply",
            f"far=tcp:127.0.0.1:{server.getsockname()[1]}",
            f"arm={endpoints[0]}",
            "--dialect", "mks-rs485,mks-can",
        ) as recorded,
    ):  # fmt: skip
        client, _ = server.accept()
        for number in range(40):
            os.write(ask, POLL[:4])
            time.sleep(0.004)
            os.write(answer, POLL[4:])
            os.write(first, POLL)
            client.sendall(POLL)
            bus.send(can.Message(arbitration_id=1, data=bytes((0x31, 0x32)), is_extended_id=False))
            time.sleep(0.001 * (number % 3))
        assert recorded.wait_records(40 * (14 + 14 + 14 + 1))
        assert recorded.end() == 0, recorded.errors
        client.close()
    found = raw(recorded.log)
    assert set(found) == {"left", "right", "far", "arm"}
    assert found["left"] == found["far"] == POLL * 40
    assert sorted(found["right"]) == sorted(POLL * 40)
    assert found["arm"] == [(1, bytes((0x31, 0x32)))] * 40
    listed = messages(recorded.log)
    assert [t for _, t, _ in listed] == sorted(t for _, t, _ in listed)
    by_topic = {}
    for topic, _, body in listed:
        by_topic.setdefault(topic, []).append(body)
    for bus_name in ("left", "right", "far"):
        assert len(by_topic[f"/{bus_name}/1/read_position/request"]) == 40
        assert len(by_topic[f"/{bus_name}/1/read_position/reply"]) == 40
    assert {p["bus"] for p in recorded.summary["ports"]} == {"left", "right", "far", "arm"}


def test_emulated_drives_on_a_can_bus(tmp_path):
    pytest.importorskip("msgpack")
    place = "udp_multicast:239.74.163.92"
    with (
        Emulated("mks-can@1", "mks-can@2", "--can", f"{place},port=43302"),
        can.Bus(interface="udp_multicast", channel="239.74.163.92", port=43302) as bus,
        Recorded(tmp_path, f"arm=can:{place},port=43302", "--duration", "60s") as recorded,
    ):
        for number in range(30):
            address = 1 + number % 2
            data = bytes((0x30, (address + 0x30) & 0xFF))
            bus.send(can.Message(arbitration_id=address, data=data, is_extended_id=False))
            while (heard := bus.recv(2.0)) is not None and len(heard.data) == 2:
                pass
            assert heard is not None
        assert recorded.wait_records(60)
        assert recorded.end() == 0, recorded.errors
    assert len(raw(recorded.log)["arm"]) == 60
    replies = [body for topic, _, body in messages(recorded.log) if topic.endswith("/reply")]
    assert len(replies) == 30
    assert recorded.summary["rules"] == {}


def test_raw_only_leaves_decoding_for_later(tmp_path):
    with pty_pair() as (master, path), Recorded(tmp_path, f"left=serial:{path},baud=115200", "--raw-only") as recorded:
        talk(master, POLL * 20)
        assert recorded.wait_bytes(len(POLL) * 20)
        assert recorded.end() == 0
    assert raw(recorded.log) == {"left": POLL * 20}
    assert messages(recorded.log) == []
    done = servotap("decode", str(recorded.log), "-o", str(tmp_path / "later.mcap"), "--json")
    assert json.loads(done.stdout)["frames"] == 40


def test_rotated_parts_hold_everything_once(tmp_path):
    sent = b""
    with (
        pty_pair() as (master, path),
        Recorded(tmp_path, f"left=serial:{path},baud=4000000", "--rotate", "500ms", "--raw-only") as recorded,
    ):
        for _ in range(18):
            block = os.urandom(500)
            talk(master, block, 100)
            sent += block
            time.sleep(0.1)
        assert recorded.wait_bytes(len(sent))
        assert recorded.end() == 0, recorded.errors
    files = [Path(name) for name in recorded.summary["files"]]
    assert len(files) >= 3
    assert files == sorted(tmp_path.glob("out-*.mcap"))
    assert b"".join(raw(file).get("left", b"") for file in files) == sent


# --- the end --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "reason"),
    [(signal.SIGINT, "Ctrl-C"), (signal.SIGTERM, "SIGTERM"), (signal.SIGHUP, "a terminal that closed (SIGHUP)")],
)
def test_each_signal_ends_with_a_complete_file(tmp_path, number, reason):
    with pty_pair() as (master, path), Recorded(tmp_path, f"left=serial:{path},baud=115200") as recorded:
        os.write(master, POLL * 10)
        assert recorded.wait_bytes(140)
        pids = recorded.pids
        assert recorded.end(number) == 0, recorded.errors
        assert gone(*pids)
        assert recorded.summary["reason"] == reason
        assert raw(recorded.log) == {"left": POLL * 10}
        assert events(recorded.log)[-1]["event"] == "end"
        assert events(recorded.log)[-1]["reason"] == reason
        assert "Traceback" not in recorded.errors


def test_ctrl_c_of_a_terminal_reaches_the_supervisor_alone(tmp_path):
    """As a terminal sends it: to every process of the foreground group."""
    with pty_pair() as (master, path), Recorded(tmp_path, f"left=serial:{path},baud=115200") as recorded:
        groups = {os.getpgid(pid) for pid in recorded.pids}
        assert len(groups) == len(recorded.pids)
        os.write(master, POLL)
        assert recorded.wait_bytes(14)
        assert recorded.end(signal.SIGINT) == 0


def test_a_duration_ends_it(tmp_path):
    with pty_pair() as (_, path), Recorded(tmp_path, f"serial:{path},baud=115200", "--duration", "300ms") as recorded:
        assert recorded.end(None) == 0, recorded.errors
        assert recorded.summary["reason"] == "the duration is over"
        assert 0.3 <= recorded.summary["seconds"] < 3


@pytest.mark.skipif(not Path("/dev/full").is_char_device(), reason="no /dev/full on this machine")
@pytest.mark.parametrize("words", [(), ("--json",)])
def test_an_output_that_cannot_be_written_is_told_and_the_log_is_whole(tmp_path, words):
    log = tmp_path / "out.mcap"
    with pty_pair() as (_, path), open("/dev/full", "w") as full:
        asked = ["record", f"left=serial:{path},baud=9600", "-o", str(log), "--duration", "0.3", *words]
        done = subprocess.run(
            [sys.executable, "-m", "analyzer", *asked],
            cwd=ROOT, stdout=full, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert done.returncode == 2
    assert "servotap: cannot write the output: No space left on device" in done.stderr
    assert events(log)[-1]["event"] == "end"


def test_the_second_ctrl_c_says_that_the_log_is_being_finished_and_the_third_leaves_it(tmp_path):
    with pty_pair() as (master, path), Recorded(tmp_path, f"left=serial:{path},baud=115200") as recorded:
        os.write(master, POLL)
        assert recorded.wait_bytes(14)
        decoding = recorded.pid_of("recorder")
        os.kill(decoding, signal.SIGSTOP)
        recorded.kill(signal.SIGINT)
        recorded.wait_line("counts", phase="finishing")
        recorded.kill(signal.SIGINT)
        said = threading.Thread(target=lambda: recorded.process.stderr.readline())
        said.start()
        said.join(5)
        assert not said.is_alive()
        time.sleep(1.1)
        assert recorded.end(signal.SIGINT) == 1
        assert "servotap recover" in recorded.summary["unfinished"]
        assert recorded.folder.exists()
        assert gone(decoding)


def test_a_line_a_second_for_people(tmp_path):
    with pty_pair() as (master, path):
        log = tmp_path / "a.mcap"
        words = ["record", f"left=serial:{path},baud=115200", "-o", str(log), "--duration", "1500ms"]
        process = subprocess.Popen(
            [sys.executable, "-m", "analyzer", *words],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
        )  # fmt: skip
        assert process.stdout.readline().startswith("recording left to ")
        os.write(master, POLL * 5)
        out, err = process.communicate(timeout=30)
        assert process.returncode == 0, err
        lines = out.splitlines()
        assert lines[0].startswith("1 s  left ")
        assert any(line.startswith("recorded 1.5 s") for line in lines)
        assert any(line.startswith("left") and "70 bytes" in line and "nothing" in line for line in lines)
        assert lines[-1].startswith(f"wrote {log}")


# --- what stands in the way -----------------------------------------------------------------------------------------------


def test_a_port_that_is_not_there_ends_it_with_nothing_left_behind(tmp_path):
    with pty_pair() as (_, path):
        done = servotap("record", f"serial:{path},baud=9600", "serial:/dev/none,baud=9600", "-o", str(tmp_path / "a.mcap"))
    assert done.returncode == 2
    assert "/dev/none is not there" in done.stderr
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_log_is_replaced_only_when_asked_for_and_never_while_it_is_written(tmp_path):
    with pty_pair() as (master, path), pty_pair() as (_, other):
        with Recorded(tmp_path, f"left=serial:{path},baud=115200") as recorded:
            done = servotap("record", f"serial:{other},baud=9600", "-o", str(recorded.log), "--force")
            assert (done.returncode, "is running" in done.stderr) == (2, True)
            os.write(master, POLL)
            assert recorded.wait_bytes(14)
            assert recorded.end() == 0
        done = servotap("record", f"serial:{other},baud=9600", "-o", str(recorded.log))
        assert (done.returncode, "--force replaces it" in done.stderr) == (2, True)
        assert raw(recorded.log) == {"left": POLL}
        done = servotap("record", f"right=serial:{other},baud=9600", "-o", str(recorded.log), "--force", "--duration", "100ms")
        assert done.returncode == 0, done.stderr
        assert raw(recorded.log) == {}


@pytest.mark.parametrize("plain", [False, True], ids=["linux", "as elsewhere"])
def test_a_recording_without_the_command_line_and_a_mark_in_it(tmp_path, plain):
    """With the readers of this system, and with those of systems that are no Linux."""
    from analyzer.live.clock import now
    from analyzer.live.config import PortConfig, RecordingConfig
    from analyzer.live.supervisor import Supervisor

    log = tmp_path / "a.mcap"
    with pty_pair() as (master, path):
        anchor = now()
        port = PortConfig(stem="1-a", bus="a", endpoint=f"serial:{path},baud=9600", kind="serial", speed=9600, byte_ns=1041666)
        config = RecordingConfig(
            log=str(log), ports=(port,), anchor_monotonic_ns=anchor.monotonic_ns, anchor_utc_ns=anchor.wall_ns
        )
        supervisor = Supervisor(config, plain=plain)
        supervisor.start()
        thread = threading.Thread(target=supervisor.run)
        thread.start()
        os.write(master, POLL * 3)
        assert wait_for(lambda: (last_record(supervisor.folder, "1-a") or Record(0, 0, 0, b"")).before >= 42)
        supervisor.mark("the axis jerked")
        supervisor.stop("test")
        thread.join(30)
        assert supervisor.phase == "over"
        assert not supervisor.unfinished
        assert ("pyserial" in supervisor.tallies["1-a"].precision) == plain
    assert raw(log) == {"a": POLL * 3}
    names = [event["event"] for event in events(log)]
    assert "begin" in names
    assert names[-1] == "end"
    everything = messages(log, leave_out=("/raw",))
    assert any("the axis jerked" in json.dumps(body) for _, _, body in everything)
