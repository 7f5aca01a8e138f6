"""Drives behind a pseudo-terminal, with pyserial as the client."""

from __future__ import annotations

import fcntl
import math
import os
import struct
import termios
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import cast

import pytest
import serial

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.encoder import build
from analyzer.errors import UsageError
from analyzer.live.reader_port import Stop
from conformance.drives.serial_bus import SerialBus
from conformance.serve import serial_server
from conformance.serve.clock import Clock
from conformance.serve.line_speed import line_speed
from conformance.serve.pty import PtyPort
from tests.conformance.drives.plain_drive import PlainDrive
from tests.conformance.drives.served import drives, on_port, on_pty, read_from, wait_for

MKS = dialects.get("mks-rs485")
TIMEOUT = 0.5


def read(address: int = 1) -> bytes:
    return build(MKS, "read_speed", address)


def reply(address: int = 1) -> bytes:
    return build(MKS, "read_speed", address, {}, Role.REPLY)


def ask(port: serial.Serial, request: bytes, size: int) -> bytes:
    port.write(request)
    data: bytes = port.read(size)
    return data


@pytest.mark.parametrize("baud", [9600, 25000, 256000])
def test_a_drive_answers_at_its_own_speed_alone(baud: int) -> None:
    with on_pty(f"mks-rs485@1,baud={baud}") as path:
        with serial.Serial(path, baud, timeout=TIMEOUT) as port:
            assert ask(port, read(), 6) == reply()
        for other in (115200, 38400):
            with serial.Serial(path, other, timeout=0.1) as port:
                assert ask(port, read(), 6) == b""
        with serial.Serial(path, baud, timeout=TIMEOUT) as port:
            assert ask(port, read(), 6) == reply()


def test_the_host_follows_a_change_of_speed() -> None:
    with on_pty("mks-rs485@1") as path, serial.Serial(path, 38400, timeout=TIMEOUT) as port:
        for code, baud in ((3, 25000), (7, 256000), (1, 9600), (4, 38400)):
            done = build(MKS, "set_baud_rate", 1, {"status": 1}, Role.REPLY)
            assert ask(port, build(MKS, "set_baud_rate", 1, {"baud_rate": code}), 5) == done
            port.baudrate = baud
            assert ask(port, read(), 6) == reply()


def test_a_host_at_a_speed_near_by_reads_rubbish() -> None:
    # A drive at 9600 baud makes of a byte at 10600 something else, and answers nothing.
    with on_pty("mks-rs485@1,baud=9600") as path, serial.Serial(path, 10600, timeout=0.1) as port:
        assert ask(port, read(), 6) == b""


def test_a_client_that_sets_no_speed_is_at_the_drives() -> None:
    with on_pty("mks-rs485@1,baud=115200") as path:
        client = os.open(path, os.O_RDWR | os.O_NOCTTY)
        try:
            os.write(client, read())
            assert read_from(client, 6) == reply()
        finally:
            os.close(client)


def test_several_drives_on_one_line() -> None:
    names = ("mks-rs485@1", "mks-rs485@2,model=57D", "lk-rs485@3,baud=38400")
    with on_pty(*names) as path, serial.Serial(path, 38400, timeout=TIMEOUT) as port:
        for _ in range(5):
            assert ask(port, read(1), 6) == reply(1)
            assert ask(port, read(2), 6) == reply(2)
            assert ask(port, bytes.fromhex("3E 93 03 00 D4"), 5) == bytes.fromhex("3E 93 03 00 D4")
            port.timeout = 0.05
            assert ask(port, read(4), 6) == b""
            port.timeout = TIMEOUT


def test_clients_close_and_reopen_as_often_as_they_like() -> None:
    with on_pty("mks-rs485@1") as path:
        for _ in range(50):
            with serial.Serial(path, 38400, timeout=TIMEOUT) as port:
                assert ask(port, read(), 6) == reply()


def test_a_client_that_leaves_in_the_middle() -> None:
    with on_pty("mks-rs485@1") as path:
        for count in (1, 2, 3, 4):
            with serial.Serial(path, 38400, timeout=TIMEOUT) as port:
                port.write(read()[:count])
        time.sleep(0.05)
        with serial.Serial(path, 38400, timeout=TIMEOUT) as port:
            assert ask(port, read(), 6) == reply()


def test_replies_that_nobody_reads_stop_nothing() -> None:
    bus = SerialBus([PlainDrive("mks-rs485", 1)], wire_time=False)
    with on_port(bus, PtyPort()) as path:
        client = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        for _ in range(2000):
            try:
                os.write(client, read() * 20)
            except BlockingIOError:
                time.sleep(0.001)
        os.close(client)
        with serial.Serial(path, 38400, timeout=TIMEOUT) as port:
            assert wait_for(lambda: bus.next_ns() is None)
            # What the drive has said already still comes, in pieces, until the port is quiet.
            port.timeout = 0.3
            while port.read(65536):
                pass
            port.timeout = TIMEOUT
            assert ask(port, read(), 6) == reply()


class Timed:
    """A port and a clock for a server whose waits end to the nanosecond; its client sends at a given time."""

    name, lost = "timed", 0

    def __init__(self, at_ns: int, request: bytes) -> None:
        self._now_ns = 0
        self._at_ns, self._request = at_ns, request
        self.waits = 0
        self.said: list[tuple[int, bytes]] = []

    def now_ns(self) -> int:
        return self._now_ns

    def select(self, reading: list[int], writing: object, failing: object, seconds: float) -> tuple[list[int], None, None]:
        self.waits += 1
        until_ns = self._now_ns + math.ceil(seconds * 1e9)
        if self._request and until_ns >= self._at_ns:
            self._now_ns = self._at_ns
            return [-1], None, None
        self._now_ns = until_ns
        return [], None, None

    def descriptors(self) -> list[int]:
        return [-1]

    def read(self, ready: Sequence[int]) -> bytes:
        request, self._request = self._request, b""
        return request

    def write(self, data: bytes) -> None:
        self.said.append((self._now_ns, data))

    def speed(self) -> None:
        return None

    def idle(self) -> None:
        pass

    def close(self) -> None:
        pass


def test_a_reply_leaves_at_its_time_and_nothing_polls(monkeypatch: pytest.MonkeyPatch) -> None:
    wire_ns = (len(read()) + len(reply())) * 10 * 10**9 // 38400
    timed, stop = Timed(1_234_567_890, read()), Stop()
    monkeypatch.setattr(serial_server, "select", timed)
    bus = SerialBus(drives("mks-rs485@1", reply_delay_ns=1_000_000))
    serial_server.serve(bus, timed, cast(Clock, timed), stop, until_ns=3_000_000_000)
    stop.close()
    assert b"".join(data for _, data in timed.said) == reply()
    assert abs(timed.said[-1][0] - (1_234_567_890 + wire_ns + 1_000_000)) < 100
    # Five a second while nothing is due, and a few for a byte.
    assert timed.waits < 5 * 3 + 4 * (len(read()) + len(reply()))


def test_a_reply_takes_its_time_on_the_wire() -> None:
    wire_ms = (len(read()) + len(reply())) * 10 / 38.4
    with on_pty("mks-rs485@1", reply_delay_ns=1_000_000) as path, serial.Serial(path, 38400, timeout=TIMEOUT) as port:
        taken = []
        for _ in range(50):
            start = time.perf_counter()
            assert ask(port, read(), 6) == reply()
            taken.append((time.perf_counter() - start) * 1e3)
    assert min(taken) >= wire_ms + 1


def test_waiting_costs_nothing() -> None:
    stop, port, bus = Stop(), PtyPort(), SerialBus([PlainDrive("mks-rs485", 1)])
    spent: list[float] = []

    def run() -> None:
        serial_server.serve(bus, port, Clock(), stop, until_ns=400_000_000)
        spent.append(time.thread_time())

    thread = threading.Thread(target=run)
    thread.start()
    thread.join(10)
    port.close()
    stop.close()
    assert spent[0] < 0.04


def test_the_link(tmp_path: Path) -> None:
    link = tmp_path / "servo"
    bus = SerialBus([PlainDrive("mks-rs485", 1)])
    with on_port(bus, PtyPort(str(link))) as path:
        assert path == str(link)
        with serial.Serial(path, 38400, timeout=TIMEOUT) as port:
            assert ask(port, read(), 6) == reply()
        terminal = link.readlink()
        with pytest.raises(UsageError, match="in use: end the program that serves it"):
            PtyPort(str(link))
        assert link.readlink() == terminal
    assert not link.is_symlink()
    link.symlink_to("/dev/pts/9999")
    PtyPort(str(link)).close()
    assert not link.is_symlink()
    link.write_text("mine")
    with pytest.raises(UsageError, match="cannot make the link"):
        PtyPort(str(link))
    assert link.read_text() == "mine"


def test_a_terminal_that_a_client_locked_is_free_for_the_next() -> None:
    port = PtyPort()
    client = os.open(port.path, os.O_RDWR | os.O_NOCTTY)
    fcntl.ioctl(client, termios.TIOCEXCL)
    port.idle()
    locked = struct.unpack("i", fcntl.ioctl(client, 0x80045440, bytes(4)))[0]  # TIOCGEXCL
    os.close(client)
    port.close()
    assert locked == 0


@pytest.mark.parametrize("baud", [1200, 9600, 25000, 38400, 57600, 115200, 256000, 1_000_000])
def test_the_line_speed_of_a_terminal(baud: int) -> None:
    port = PtyPort(speed=19200)
    assert port.speed() == 19200
    with serial.Serial(port.path, baud):
        assert port.speed() == baud
    port.close()
    reader, writer = os.pipe()
    assert line_speed(reader) is None
    os.close(reader)
    os.close(writer)
