"""Logs in python-can's own tools: what can_logger writes is a log like any other, and can_player sends it again."""

from __future__ import annotations

import gzip
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import can
import pytest

from analyzer import dialects
from analyzer.cli import main
from analyzer.encoder import build
from analyzer.errors import ServotapError
from analyzer.export.python_can_io import McapReader, McapWriter
from tests import CAPTURES
from tests.conformance.drives.served import Emulated, wait_for
from tests.logs import messages, metadata

MKS = dialects.get("mks-can")
READ = build(MKS, "read_speed", 1)
#: A group of our own for each test, so that tests that run at the same time do not meet.
GROUP = f"239.74.{os.getpid() >> 8 & 0xFF}.{os.getpid() & 0xFF}"
T = 1_772_442_000.123456


def message(n: int = 0, data: str = "3031", **about: object) -> can.Message:
    about = {"arbitration_id": 1, "is_extended_id": False, "channel": "can0", "timestamp": T + n / 1000} | about
    return can.Message(data=bytes.fromhex(data), **about)


KINDS = [
    message(0, is_rx=False),
    message(1, "300000000129EF4A"),
    message(2, "0102", arbitration_id=0x1ABCDE, is_extended_id=True, channel="can1"),
    message(3, "", is_remote_frame=True),
    message(4, "00" * 12, is_fd=True),
    message(5, "00" * 8, arbitration_id=4, is_error_frame=True),
]


def same(a: can.Message, b: can.Message) -> bool:
    return a.equals(b, timestamp_delta=0.0, check_channel=True, check_direction=True)


def topics(path: Path) -> list[str]:
    return [topic for topic, _ in messages(path)]


def test_every_kind_of_frame_comes_back_as_it_was(tmp_path: Path) -> None:
    with can.Logger(tmp_path / "a.mcap") as logger:
        for each in KINDS:
            logger(each)
    with can.LogReader(tmp_path / "a.mcap") as reader:
        got = list(reader)
    assert len(got) == len(KINDS)
    assert all(same(a, b) for a, b in zip(got, KINDS, strict=True))


def test_what_is_logged_is_decoded(tmp_path: Path, cli) -> None:
    path = tmp_path / "a.mcap"
    with can.Logger(path, dialect="mks-can", model="42E", bitrate="500000") as logger:
        logger(KINDS[0])
        logger(KINDS[1])
    assert topics(path)[:2] == ["/can0/1/read_encoder_carry/request", "/can0/1/read_encoder_carry/reply"]
    values = metadata(path)
    assert (values["dialect"], values["model"], values["bit_rate"], values["frames"]) == ("mks-can", "42E", "500000", "2")
    assert "carry=1" in cli("show", path).out


def test_numbers_and_no_names_of_channels(tmp_path: Path) -> None:
    with can.Logger(tmp_path / "a.mcap") as logger:
        for channel in (0, None, "239.74.163.2", "PCAN_USBBUS1"):
            logger(message(channel=channel))
    with can.LogReader(tmp_path / "a.mcap") as reader:
        assert [m.channel for m in reader] == ["can0", "can", "239.74.163.2", "PCAN_USBBUS1"]


def test_a_message_without_a_time_gets_that_of_its_logging(tmp_path: Path) -> None:
    before = time.time()
    with can.Logger(tmp_path / "a.mcap") as logger:
        logger(message(timestamp=0.0))
    with can.LogReader(tmp_path / "a.mcap") as reader:
        assert before - 1e-3 <= next(iter(reader)).timestamp <= time.time()


def test_packed_logs(tmp_path: Path) -> None:
    with can.Logger(tmp_path / "a.mcap.gz") as logger:
        logger(KINDS[0])
    assert gzip.decompress((tmp_path / "a.mcap.gz").read_bytes()).startswith(b"\x89MCAP")
    with can.LogReader(tmp_path / "a.mcap.gz") as reader:
        assert [same(m, KINDS[0]) for m in reader] == [True]


def test_serial_buses_are_passed_over(tmp_path: Path) -> None:
    capture = CAPTURES / "mks_rs485.log"
    assert main(["decode", str(capture), "-o", str(tmp_path / "a.mcap")]) == 0
    with can.LogReader(tmp_path / "a.mcap") as reader:
        assert list(reader) == []


def test_wrong_use(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="cannot be appended to"):
        can.Logger(tmp_path / "a.mcap", append=True)
    with pytest.raises(ServotapError, match="mks-rs485 is a dialect of serial lines"):
        McapWriter(tmp_path / "a.mcap", dialect="mks-rs485")
    with pytest.raises(ServotapError, match="no dialect 'mks-cam'"):
        McapWriter(tmp_path / "a.mcap", dialect="mks-cam")
    assert os.listdir(tmp_path) == []
    with pytest.raises(ServotapError, match="No such file"):
        can.LogReader(tmp_path / "none.mcap")
    with pytest.raises(ValueError, match="by its name"):
        McapReader(7)


def test_a_stopped_writer_takes_no_more_and_stops_twice(tmp_path: Path) -> None:
    threads = threading.active_count()
    logger = can.Logger(tmp_path / "a.mcap")
    logger(KINDS[0])
    logger.stop()
    logger.stop()
    logger(KINDS[1])
    assert threading.active_count() == threads
    assert topics(tmp_path / "a.mcap")[0] == "/can0/1/read_encoder_carry/request"


def test_a_full_disk_is_told_to_whoever_logs(tmp_path: Path) -> None:
    class Full(list):  # type: ignore[type-arg]
        def write(self, data: bytes) -> int:
            if len(self) > 2:
                raise OSError(28, "No space left on device")
            self.append(data)
            return len(data)

        def flush(self) -> None:
            raise OSError(28, "No space left on device")

        def close(self) -> None:
            pass

    logger = McapWriter(Full())

    def log_on() -> bool:
        logger(message())
        return False

    with pytest.raises(OSError, match="No space left"):
        wait_for(log_on)
    with pytest.raises(OSError, match="No space left"):
        logger.stop()


# --- python-can's tools ---------------------------------------------------------------------------------------------


class Tool:
    """One of python-can's tools as a process; what it prints goes to a file."""

    def __init__(self, said: Path, name: str, *words: str) -> None:
        self._said = said
        with said.open("w") as stream:
            command = [sys.executable, "-u", "-m", f"can.{name}", *words]
            self.process = subprocess.Popen(command, stdout=stream, stderr=subprocess.STDOUT)

    def until(self, text: str) -> None:
        """Wait until the tool has printed a text."""
        assert wait_for(lambda: text in self._said.read_text(), 20), self._said.read_text()

    def __enter__(self) -> Tool:
        return self

    def __exit__(self, *exception: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(20)


def ask(host: can.BusABC, count: int) -> None:
    """Ask the drive for its speed, and wait for each reply."""
    for _ in range(count):
        host.send(can.Message(arbitration_id=1, data=READ, is_extended_id=False))
        deadline = time.monotonic() + 5
        while time.monotonic() < deadline:
            got = host.recv(1)
            if got is not None and bytes(got.data) != READ:
                break
        else:
            raise AssertionError("no reply")


def test_can_logger_writes_and_can_player_sends_it_again(tmp_path: Path) -> None:
    log = tmp_path / "x.mcap"
    words = ["-i", "udp_multicast", "-c", GROUP, "-f", str(log), "--dialect=mks-can"]
    with (
        Emulated("mks-can@1", "--can", f"udp_multicast:{GROUP}"),
        can.Bus(GROUP, "udp_multicast") as host,
        Tool(tmp_path / "said", "logger", *words) as logger,
    ):
        # Not before its bus is open; what comes from then on waits for its log.
        logger.until("Can Logger")
        ask(host, 20)
        # Only once it has begun to log does it take Ctrl-C for an end.
        assert wait_for(lambda: log.exists() and log.stat().st_size > 500, 10)
        logger.process.send_signal(signal.SIGINT)
        assert logger.process.wait(20) == 0
    found = topics(log)
    assert found.count("/can/1/read_speed/request") == 20
    assert found.count("/can/1/read_speed/reply") == 20
    replies = [value for topic, value in messages(log) if topic.endswith("/reply")]
    assert all(0 <= reply["_latency"] < 1 for reply in replies)

    other = f"239.75.{GROUP.split('.', 2)[2]}"
    with can.Bus(other, "udp_multicast") as listener:
        with Tool(tmp_path / "said", "player", "-i", "udp_multicast", "-c", other, str(log)) as player:
            assert player.process.wait(20) == 0
        played = []
        while (got := listener.recv(0.2)) is not None:
            played.append((got.arbitration_id, bytes(got.data)))
    with can.LogReader(log) as reader:
        assert played == [(m.arbitration_id, bytes(m.data)) for m in reader]
    assert len(played) == 40


def test_a_killed_can_logger_leaves_all_but_the_last_second(tmp_path: Path) -> None:
    log = tmp_path / "x.mcap"
    group = f"239.76.{GROUP.split('.', 2)[2]}"
    words = ["-i", "udp_multicast", "-c", group, "-f", str(log)]
    with can.Bus(group, "udp_multicast") as host, Tool(tmp_path / "said", "logger", *words) as logger:
        logger.until("Can Logger")
        for _ in range(10):
            host.send(can.Message(arbitration_id=1, data=READ, is_extended_id=False))
        # Nothing more comes; what came is written all the same.
        assert wait_for(lambda: log.exists() and log.stat().st_size > 500, 10)
        logger.process.kill()
    with can.LogReader(log) as reader:
        assert [bytes(m.data) for m in reader] == [READ] * 10
