"""`servotap tap` between a user's program and an emulated drive, in processes of their own."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import minimalmodbus
import pytest
import serial

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.cli import main
from analyzer.encoder import build
from conformance.cli import tap as command
from tests.conformance.drives.served import Emulated, on_pty, wait_for
from tests.live.recorded import Recorded
from tests.logs import messages

READ = build(dialects.get("mks-rs485"), "read_speed", 1)
REPLY = build(dialects.get("mks-rs485"), "read_speed", 1, {}, Role.REPLY)


def topics(log: Path) -> list[str]:
    return [topic for topic, _ in messages(log)]


def findings(log: Path) -> list[str]:
    return [value["name"] for topic, value in messages(log) if topic == "/findings"]


@pytest.fixture
def drive() -> Iterator[str]:
    with on_pty("mks-rs485@1", reply_delay_ns=0) as path:
        yield path


class Tap(Recorded):
    """The command. `port`: what the program opens."""

    def __init__(self, folder: Path, adapter: str, *words: str) -> None:
        self.port = str(folder / "port")
        super().__init__(folder, f"left={adapter}", "--link", self.port, *words, command="tap")

    def finish(self, number: int = signal.SIGINT) -> int:
        """End it and return its exit status."""
        self.kill(number)
        return int(self.process.wait(30))


def ask(port: serial.Serial, count: int = 1) -> None:
    for _ in range(count):
        port.write(READ)
        assert port.read(len(REPLY)) == REPLY


@pytest.fixture
def names(tmp_path: Path) -> Iterator[tuple[str, dict[str, str]]]:
    """Return a port and other names of it."""
    master, slave = os.openpty()
    path = os.ttyname(slave)
    os.set_blocking(master, False)
    by_id, by_link = tmp_path / "by-id", tmp_path / "by-link"
    by_id.symlink_to(path)
    by_link.symlink_to(by_id)
    spelled = f"{os.path.dirname(path)}/../pts/./{os.path.basename(path)}"
    yield path, {"itself": path, "spelled": spelled, "link": str(by_id), "two links": str(by_link)}
    os.close(master)
    os.close(slave)


@pytest.mark.parametrize("name", ["itself", "spelled", "link", "two links"])
@pytest.mark.parametrize("swapped", [False, True])
def test_a_link_in_place_of_the_adapter_is_refused_before_anything_is_opened(
    name: str, swapped: bool, names: tuple[str, dict[str, str]], tmp_path: Path,
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    path, others = names
    before = sorted(tmp_path.iterdir())
    port, link = (others[name], path) if swapped else (path, others[name])
    monkeypatch.setattr(os, "openpty", None)
    assert main(["tap", f"serial:{port}", "--link", link, "-o", str(tmp_path / "x.mcap")]) == 2
    assert f"--link {link} is the adapter's port, serial:{port}" in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == before
    assert Path(others["link"]).readlink() == Path(path)


def test_a_link_in_place_of_an_adapter_is_refused_by_its_number_and_before_it_is_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    absent = tmp_path / "absent"
    for endpoint in (f"serial:{absent}", "serial:,serial=A1"):
        monkeypatch.setattr(command, "find_adapter", lambda number: str(absent))
        assert main(["tap", endpoint, "--link", f"{tmp_path}/./absent", "-o", str(tmp_path / "x.mcap")]) == 2
        assert "is the adapter's port" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_modbus_program_and_its_drive_are_recorded_with_their_directions(tmp_path: Path) -> None:
    with Emulated("mks-modbus@1,baud=115200", "--pty") as emulated:
        tap = Tap(tmp_path, f"serial:{emulated.place},baud=38400", "--dialect", "mks-modbus")
        # The drive answers at its own speed alone: the program's has to be followed.
        instrument = minimalmodbus.Instrument(tap.port, 1)
        instrument.serial.baudrate = 115200
        instrument.serial.timeout = 1.0
        for _ in range(10):
            assert len(instrument.read_registers(0x31, 3, functioncode=4)) == 3
        assert tap.wait_bytes(10 * (8 + 11))
        assert tap.finish() == 0
    found = topics(tap.log)
    assert found.count("/left/1/read_position/request") == found.count("/left/1/read_position/reply") == 10
    assert findings(tap.log) == []
    # On a busy machine there are pauses, too.
    raw = [v["_direction"] for t, v in messages(tap.log) if t == "/left/raw" and not v.get("_silence")]
    assert raw[:2] == ["request", "reply"]
    assert set(raw) == {"request", "reply"}
    setups = [v for t, v in messages(tap.log) if t == "/recording" and v["event"] in ("port", "speed")]
    # The library opens its port at 19200 and sets the speed then.
    speeds = [s["speed"] for s in setups]
    assert (speeds[0], speeds[-1], *speeds[1:-1]) in ((38400, 115200), (38400, 115200, 19200))
    assert [s["byte_ns"] for s in setups] == [10 * 10**9 // speed for speed in speeds]
    replies = [v["_latency"] for t, v in messages(tap.log) if t.endswith("/reply")]
    assert all(0 <= latency < 0.5 for latency in replies)
    assert not os.path.lexists(tap.port)
    # And the log decodes again to the same.
    again = tmp_path / "again.mcap"
    assert main(["decode", str(tap.log), "-o", str(again)]) == 0
    frames = [t for t in found if t.endswith(("/request", "/reply"))]
    assert [t for t in topics(again) if t.endswith(("/request", "/reply"))] == frames


@pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll is not installed")
def test_mbpoll(tmp_path: Path) -> None:
    with on_pty("mks-modbus@1") as path:
        tap = Tap(tmp_path, f"serial:{path}")
        words = ["-m", "rtu", "-a", "1", "-b", "38400", "-P", "none", "-t", "3", "-r", "50", "-c", "3", "-1", tap.port]
        done = subprocess.run(["mbpoll", *words], capture_output=True, text=True, timeout=20)
        assert done.returncode == 0, done.stdout + done.stderr
        assert tap.finish() == 0
    assert "/left/1/read_position/reply" in topics(tap.log)


def test_a_tap_that_is_killed_lets_go_of_nothing(tmp_path: Path, drive: str) -> None:
    tap = Tap(tmp_path, f"serial:{drive}", "--dialect", "mks-rs485")
    with serial.Serial(tap.port, 38400, timeout=5) as port:
        ask(port, 5)
        # Bytes are passed on first and stored then: a kill in between would lose the record of those just passed.
        assert tap.wait_bytes(5 * (len(READ) + len(REPLY)))
        os.kill(tap.pid_of("tap.process"), signal.SIGKILL)
        # The port is the same one, and what is written meanwhile waits.
        ask(port, 5)
        tap.wait_note("has taken over")
        ask(port, 5)
        assert tap.wait_bytes(15 * (len(READ) + len(REPLY)))
        # These take 50 ms to send, and are stored then.
        port.write(bytes(200))
        wait_for(lambda: port.out_waiting == 0, 1.0)
        os.kill(tap.pid_of("tap.process"), signal.SIGKILL)
        tap.wait_note("has taken over")
    tap.finish()
    found = topics(tap.log)
    assert found.count("/left/1/read_speed/request") == found.count("/left/1/read_speed/reply") == 15
    # What was passed on and not stored is counted.
    asked = sum(
        len(bytes.fromhex(v["_raw"])) for t, v in messages(tap.log) if t == "/left/raw" and v.get("_direction") == "request"
    )
    dropped = [v for t, v in messages(tap.log) if t == "/recording" and v["event"] == "dropped"]
    assert asked + sum(v["bytes"] for v in dropped) == 15 * len(READ) + 200
    assert all("process died" in v["reason"] for v in dropped)


def test_decoding_that_is_killed_delays_no_byte(tmp_path: Path, drive: str) -> None:
    tap = Tap(tmp_path, f"serial:{drive}", "--dialect", "mks-rs485")
    with serial.Serial(tap.port, 38400, timeout=5) as port:
        ask(port, 3)
        os.kill(tap.pid_of("recorder"), signal.SIGKILL)
        ask(port, 20)
    assert tap.wait_bytes(23 * (len(READ) + len(REPLY)))
    assert tap.finish() == 0
    assert topics(tap.log).count("/left/1/read_speed/reply") == 23


def test_a_supervisor_that_is_killed_leaves_the_program_its_port_and_a_whole_log(tmp_path: Path, drive: str) -> None:
    tap = Tap(tmp_path, f"serial:{drive}", "--dialect", "mks-rs485")
    pid = tap.pid_of("tap.process")
    with serial.Serial(tap.port, 38400, timeout=5) as port:
        ask(port, 3)
        tap.process.kill()
        tap.process.wait(10)
        ask(port, 5)
        # Longer than the decoding process waits for readers that have gone.
        time.sleep(2.5)
        ask(port, 5)
    # With the program gone there is nothing left to do, but for the decoding process to finish the log.
    assert wait_for(lambda: not Path(f"/proc/{pid}").exists(), 10)
    assert not os.path.lexists(tap.port)
    assert wait_for(lambda: not tap.folder.exists(), 10)
    found = topics(tap.log)
    assert found.count("/left/1/read_speed/request") == found.count("/left/1/read_speed/reply") == 13


def test_a_second_program_and_a_later_one(tmp_path: Path, drive: str) -> None:
    tap = Tap(tmp_path, f"serial:{drive}", "--dialect", "mks-rs485")
    for _ in range(3):
        with serial.Serial(tap.port, 38400, timeout=5) as port:
            ask(port)
    assert tap.finish(signal.SIGTERM) == 0
    assert topics(tap.log).count("/left/1/read_speed/reply") == 3


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["can:socketcan:can0", "--link", "p"], "on CAN several can listen"),
        (["serial:/dev/x,direction=reply", "--link", "p"], "knows both directions"),
        (["serial:/dev/none", "--link", "p"], "not there"),
        (["serial:/dev/none", "--link", "taken"], "cannot make the link"),
    ],
)
def test_wrong_use(words: list[str], text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "taken").write_text("a file")
    words = [str(tmp_path / w) if before == "--link" else w for before, w in zip(["", *words], words, strict=False)]
    assert main(["tap", *words, "-o", str(tmp_path / "a.mcap")]) == 2
    assert text in capsys.readouterr().err
    assert os.listdir(tmp_path) == ["taken"]


def test_the_delay_is_measured_as_the_manual_of_the_benchmark_says() -> None:
    done = subprocess.run(
        [sys.executable, "benchmarks/tap_delay.py", "--count", "50"],
        cwd=Path(__file__).parents[3], capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "added delay" in done.stdout
