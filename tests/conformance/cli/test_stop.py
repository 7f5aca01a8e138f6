"""`servotap stop`: emulated drives that turn, on a port whose every byte is logged."""

from __future__ import annotations

import io
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
import uuid
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from types import SimpleNamespace

import pytest

from analyzer import cli as analyzer_cli
from analyzer import dialects
from analyzer.cli import boundary
from analyzer.encoder import build
from analyzer.errors import ServotapError, UsageError
from analyzer.live import endpoint as endpoints
from analyzer.records import CanFrame
from conformance.bus import lasting
from conformance.bus.can_socket import MulticastPort
from conformance.cli import stop
from conformance.drives.can_bus import CanBus
from conformance.drives.serial_bus import SerialBus
from conformance.safety import stopping
from conformance.serve.pty import PtyPort
from tests.conformance.drives.served import LoggedPty, drives, on_can, on_port, wait_for

MKS, LK, MKS_CAN = (dialects.get(name) for name in ("mks-rs485", "lk-rs485", "mks-can"))
RUNNING = (
    build(MKS, "run_speed", 2, {"speed": 300, "acceleration": 200}),
    build(LK, "motor_on", 3),
    build(LK, "run_speed", 3, {"speed": 18000}),
)


def run(*words: str) -> int:
    return analyzer_cli._run("stop", stop, words)


@pytest.fixture
def port():
    """Two drives that turn, at 38400 baud."""
    bus = SerialBus(drives("mks-rs485@2,work_mode=sr_vfoc", "lk-rs485@3,baud=38400"))
    pty = LoggedPty(bus)
    with on_port(bus, pty) as path:
        line = os.open(path, os.O_RDWR | os.O_NOCTTY)
        for frame in RUNNING:
            os.write(line, frame)
            os.read(line, 64)
        os.close(line)
        pty.heard = b""
        yield f"serial:{path},baud=38400", pty


def test_all_that_turn_are_found_and_stand_afterwards(port, capsys):
    place, pty = port
    assert run(place, "--addresses", "1-4") == 0
    out = capsys.readouterr().out
    assert "mks-rs485@2: stands at" in out
    assert "lk-rs485@3: stands at" in out
    # No motor is disabled, and nothing else moves it.
    assert build(MKS, "enable", 2, {"enabled": 0}) not in pty.heard
    assert build(LK, "motor_off", 3) not in pty.heard
    assert build(MKS, "stop_speed", 2, {"acceleration": 200}) in pty.heard


def test_those_that_are_named_are_asked_to_stop_before_anything_else(port, capsys):
    place, pty = port
    assert run(place, "mks-rs485@2") == 0
    assert "mks-rs485@2: stands at" in capsys.readouterr().out
    assert pty.heard.startswith(build(MKS, "stop_speed", 2, {"acceleration": 200}))
    assert build(LK, "stop", 3) not in pty.heard


def test_a_drive_that_does_not_answer_is_not_stopped(port, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(stopping, "_RAMP_NS", 400_000_000)
    monkeypatch.setattr(stopping, "_AT_ONCE_NS", 400_000_000)
    place, _ = port
    assert run(place, "mks-rs485@9", "--cut-power", f"touch {tmp_path / 'cut'}") == 20
    assert "NOT STOPPED: mks-rs485@9" in capsys.readouterr().err
    assert (tmp_path / "cut").exists()
    assert run(place, "--addresses", "20") == 20
    assert "no drive answered" in capsys.readouterr().err
    assert run(place, "mks-can@1") == 2


def test_a_silent_drive_does_not_keep_one_that_answers_waiting(port, monkeypatch):
    proved = []
    monkeypatch.setattr(stop, "_prove", lambda gate, drive, told_ns: (proved.append(drive.address) or "", True))
    assert run(port[0], "mks-rs485@9", "mks-rs485@2") == 0
    assert proved == [2, 9]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stop_that_is_interrupted_says_that_the_drive_may_turn(number, port, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(stop, "_prove", lambda gate, drive, told_ns: signal.raise_signal(number))
    assert run(port[0], "mks-rs485@2", "--cut-power", f"touch {tmp_path / 'cut'}") == 20
    assert "NOT STOPPED: mks-rs485@2: interrupted" in capsys.readouterr().err
    assert (tmp_path / "cut").exists()


class GoneReader(io.StringIO):
    """The output of a program whose reader has gone."""

    def write(self, text: str) -> int:
        raise BrokenPipeError


def test_a_drive_that_is_not_stopped_is_told_also_where_nothing_can_be_printed(port, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(stopping, "_RAMP_NS", 400_000_000)
    monkeypatch.setattr(stopping, "_AT_ONCE_NS", 400_000_000)
    monkeypatch.setattr("sys.stdout", GoneReader())
    assert run(port[0], "mks-rs485@2", "mks-rs485@9", "--cut-power", f"touch {tmp_path / 'cut'}") == 20
    assert "NOT STOPPED: mks-rs485@9" in capsys.readouterr().err
    assert (tmp_path / "cut").exists()


class Flooded(LoggedPty):
    """A port on which another sender drowns every reply."""

    def write(self, data: bytes) -> None:
        super().write(b"\x99" * 200)


def turns(pty: LoggedPty) -> bool:
    drive = pty.bus.drives[0]
    return bool(drive.motor.speed(drive.now_ns))


@pytest.mark.parametrize("dialect", ["mks-rs485", "mks-modbus"])
def test_on_a_flooded_line_all_are_stopped_although_none_is_found(dialect, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(stop, "_ROUNDS", 1)
    spoken = dialects.get(dialect)
    bus = SerialBus(drives(f"{dialect}@3,work_mode=sr_vfoc"))
    with on_port(bus, pty := Flooded(bus)) as path:
        line = os.open(path, os.O_RDWR | os.O_NOCTTY)
        os.write(line, build(spoken, "enable", 3, {"enabled": 1}))
        assert wait_for(lambda: select.select([line], [], [], 0)[0])
        os.write(line, build(spoken, "run_speed", 3, {"direction": 0, "speed": 300, "acceleration": 200}))
        assert wait_for(lambda: turns(pty))
        os.close(line)
        assert run(f"serial:{path},baud=38400", "--addresses", "1-4", "--cut-power", f"touch {tmp_path / 'cut'}") == 20
        assert wait_for(lambda: not turns(pty))
    told = capsys.readouterr().err
    assert "every stop was sent to every address" in told
    assert "others send on this bus (" in told
    assert (tmp_path / "cut").exists()


def test_all_are_told_to_stop_before_any_is_looked_for(port, capsys):
    place, pty = port
    assert run(place, "--addresses", "1-4") == 0
    asked = pty.heard.index(build(MKS, "read_status", 1))
    assert pty.heard.index(build(MKS, "stop_speed", 0, {"acceleration": 200})) < asked
    assert pty.heard.index(build(LK, "stop", 4)) < asked


_FLOOD = """
import socket, sys, time
from conformance.bus.can_socket import MulticastPort
from analyzer.records import CanFrame
port = MulticastPort(sys.argv[1], port=int(sys.argv[2]))
begun, sent = time.monotonic(), 0
while True:
    due = int((time.monotonic() - begun) * 4000)
    # What a machine that is busy did not send in time is not made up for.
    for _ in range(min(due - sent, 100)):
        port.put(CanFrame(None, "", 0x321, bytes([sent % 251] * 8)))
    sent = due
    time.sleep(0.001)
"""


def test_on_a_flooded_can_bus_the_drive_is_proved_to_stand(capsys):
    """Four thousand frames a second of another node: a bus of 500 kbit/s is full with them."""
    group, number = "239.74.163.103", 20000 + uuid.uuid4().int % 30000
    try:
        port, host = MulticastPort(group, port=number), MulticastPort(group, port=number)
        host.put(CanFrame(None, "", 0x7FF, b"\0"))
        carried = port.receive(2_000_000_000)
    except ServotapError as error:
        pytest.skip(f"udp_multicast does not open here: {error}")
    if carried is None:
        pytest.skip("udp_multicast does not carry frames here")
    bus = CanBus(drives("mks-can@1,work_mode=bus_closed"), wire_time=False)
    drive = bus.drives[0]
    with on_can(bus, port):
        for name, values in (("enable", {"enabled": 1}), ("run_speed", {"direction": 0, "speed": 300, "acceleration": 200})):
            host.put(CanFrame(None, "", 1, build(MKS_CAN, name, 1, values)))
            assert wait_for(lambda: host.receive(10_000_000) is not None)
        assert wait_for(lambda: bool(drive.motor.speed(drive.now_ns)))
        with subprocess.Popen([sys.executable, "-c", _FLOOD, group, str(number)]) as flood:
            try:
                assert wait_for(lambda: (got := host.receive(10_000_000)) is not None and got.id == 0x321, 30)
                assert run(f"can:udp_multicast:{group},port={number}", "mks-can@1") == 0
                assert flood.poll() is None
            finally:
                flood.kill()
        assert drive.motor.speed(drive.now_ns) == 0
    host.close()
    assert "mks-can@1: stands at" in capsys.readouterr().out


class Resetting:
    """A server whose connections are reset: the first at once, the next after so many bytes of the host, the last never."""

    def __init__(self, bus: SerialBus, *after: int | None) -> None:
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.place = f"tcp:127.0.0.1:{self._listening.getsockname()[1]},baud=38400"
        self._after = after
        self.connections = 0
        self._pty = PtyPort(speed=bus.stations[0].speed)
        self._bus = bus

    @contextmanager
    def serving(self) -> Iterator[Resetting]:
        with on_port(self._bus, self._pty) as path, ThreadPoolExecutor(1) as pool:
            line = os.open(path, os.O_RDWR | os.O_NOCTTY)
            done = pool.submit(self._serve, line)
            try:
                yield self
            finally:
                self._listening.shutdown(socket.SHUT_RDWR)
                done.result(10)
                self._listening.close()
                os.close(line)

    def _serve(self, line: int) -> None:
        while True:
            try:
                client = self._listening.accept()[0]
            except OSError:
                return
            left = self._after[min(self.connections, len(self._after) - 1)]
            self.connections += 1
            while left is None or left > 0:
                for ready in select.select([client, line], [], [])[0]:
                    if ready is line:
                        client.sendall(os.read(line, 64))
                        continue
                    data = client.recv(64)
                    os.write(line, data)
                    left = 0 if not data else None if left is None else left - len(data)
            # A close with this is a reset.
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            client.close()


@pytest.mark.parametrize("words", [["mks-rs485@2"], ["--addresses", "1-3"]], ids=["named", "looked for"])
def test_a_connection_that_is_reset_is_made_anew(words, capsys):
    bus = SerialBus(drives("mks-rs485@2,work_mode=sr_vfoc"))
    with Resetting(bus, 0, 3, 20, None).serving() as server:
        assert run(server.place, *words) == 0
    assert server.connections == 4
    assert "mks-rs485@2: stands at" in capsys.readouterr().out


def test_a_connection_that_is_reset_for_good_ends_with_the_deadline(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(stop, "_LOST_NS", 1_000_000_000)
    bus = SerialBus(drives("mks-rs485@2,work_mode=sr_vfoc"))
    with Resetting(bus, 0).serving() as server:
        assert run(server.place, "mks-rs485@2", "--cut-power", f"touch {tmp_path / 'cut'}") == 20
    # At most ten tries a second, for five seconds at the opening, for one until the deadline, and for five at its end.
    assert 2 <= server.connections <= 110
    told = capsys.readouterr().err
    assert told.count("NOT STOPPED") == 1
    assert "127.0.0.1" in told
    assert (tmp_path / "cut").exists()


def test_a_port_that_cannot_be_opened_cuts_the_power(tmp_path, capsys):
    assert run("serial:/dev/nowhere,baud=38400", "mks-rs485@2", "--cut-power", f"touch {tmp_path / 'cut'}") == 20
    assert (tmp_path / "cut").exists()
    assert "NOT STOPPED: /dev/nowhere is not there" in capsys.readouterr().err


def test_a_fault_of_ours_cuts_the_power(port, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(stop, "_stopped", lambda *about: [][0])
    monkeypatch.setenv(boundary.FOLDER, str(tmp_path))
    words = [port[0], "mks-rs485@2", "--cut-power", f"touch {tmp_path / 'cut'}"]
    assert boundary.bounded(lambda words: run(*words), words) == boundary.FAULT
    assert (tmp_path / "cut").exists()
    assert "NOT STOPPED: a fault of servotap: IndexError; " in capsys.readouterr().err


def test_a_port_is_stopped_also_where_no_thread_is_left(monkeypatch):
    def refused(thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    line = SimpleNamespace(endpoint=endpoints.parse("can:virtual:x"), anchor_ns=0, write=len)
    monkeypatch.setattr(lasting, "open_line", lambda endpoint: line)
    monkeypatch.setattr(threading.Thread, "start", refused)
    assert stop._WatchedLine(line.endpoint, lambda: None).write(b"123") == 3


@pytest.mark.parametrize("hanging", ["open", "write"])
def test_a_driver_that_hangs_cuts_the_power_and_ends_the_command(hanging, tmp_path, monkeypatch, capsys):
    """The thread that watches it ends the process; here that lets the driver go on, to fail."""
    freed, ended = threading.Event(), []

    def hang(*_: object) -> None:
        freed.wait()
        raise UsageError("it hung")

    def end(status: int) -> None:
        ended.append(status)
        freed.set()

    monkeypatch.setattr(stop, "_LOOK_SECONDS", 0.0)
    monkeypatch.setattr(stop.own_process, "end", end)
    line = SimpleNamespace(endpoint=endpoints.parse("can:virtual:x"), anchor_ns=0, write=hang, close=lambda: None)
    monkeypatch.setattr(lasting, "open_line", hang if hanging == "open" else lambda endpoint: line)
    cut = tmp_path / "cut"
    with pytest.raises(UsageError, match="it hung"):
        stop._WatchedLine(line.endpoint, lambda: stop._end_hung("can:virtual:x", f"echo >> {cut}")).write(b"")
    assert ended == [20]
    assert cut.read_text() == "\n"
    assert "NOT STOPPED: can:virtual:x: its driver hangs; --cut-power" in capsys.readouterr().err
