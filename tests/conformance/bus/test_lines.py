"""Lines: bytes out, bytes in, stamped; no echo; what is said when a port cannot be opened or goes away."""

from __future__ import annotations

import errno
import os
import socket
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import can
import pytest

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.encoder import build
from analyzer.errors import UsageError
from analyzer.live.endpoint import parse
from analyzer.records import CanFrame, Chunk
from conformance.bus import open_line, serial, tcp
from conformance.bus.echo import WAIT_NS, EchoFilter, could_be_reply
from conformance.bus.emulated import EmulatedLine
from conformance.bus.line import Line, LineLost
from conformance.bus.python_can import LibraryPort
from conformance.bus.serial import SerialLine
from conformance.drives.can_bus import CanBus
from conformance.drives.serial_bus import SerialBus
from conformance.serve.pty import PtyPort
from conformance.serve.tcp import TcpPort
from tests.conformance.drives.served import drives, on_can, on_port, on_pty

MKS, LK, MODBUS, CAN = (dialects.get(n) for n in ("mks-rs485", "lk-rs485", "mks-modbus", "mks-can"))
READ = build(MKS, "read_speed", 1)
REPLY = build(MKS, "read_speed", 1, {}, Role.REPLY)
OFF = build(LK, "motor_off", 1)
MS = 1_000_000
SECOND_NS = 1_000_000_000


def answer(line: Line, item: bytes | CanFrame, size: int) -> bytes:
    """Send an item and return what comes, until it is `size` bytes or nothing comes for a second."""
    line.write(item)
    data = b""
    while len(data) < size and (got := line.receive(SECOND_NS)) is not None:
        data += got.data
    return data


# --- the echo ---------------------------------------------------------------------------------------------------------


def heard(echo: EchoFilter, *pieces: bytes, at_ns: int = 0) -> bytes:
    return b"".join(c.data for p in pieces for c in echo.heard(Chunk(at_ns, "line", p)))


@pytest.mark.parametrize(
    ("frame", "same"),
    [
        (READ, False), (build(MKS, "stop_speed", 1), False), (OFF, True), (build(LK, "read_state_1", 1), False),
        (build(LK, "set_position", 1, {"position": 5}), True), (build(LK, "move_increment", 1), False),
        (build(MODBUS, "read_speed", 1), False), (build(MODBUS, "set_current", 1, {"current": 100}), True),
        (build(MODBUS, "run_speed", 1, {"speed": 5}), False), (b"\x55\x00\x31", True), (READ[:-1] + b"\x00", True),
    ],
)  # fmt: skip
def test_which_requests_can_be_answered_with_themselves(frame: bytes, same: bool):
    assert could_be_reply(frame) is same


def test_an_adapter_that_echoes():
    echo = EchoFilter()
    echo.sent(READ, 0)
    assert heard(echo, READ + REPLY) == REPLY
    assert echo.echoes
    # In pieces, as an adapter brings it.
    echo.sent(READ, 0)
    assert heard(echo, READ[:2]) == b""
    assert echo.holds
    assert heard(echo, READ[2:] + REPLY[:1], REPLY[1:]) == REPLY
    assert echo.dropped == 2


def test_a_drive_that_echoes_is_heard_on_an_adapter_that_does_not():
    echo = EchoFilter()
    echo.sent(OFF, 0)
    assert heard(echo, OFF) == OFF
    for _ in range(3):
        echo.sent(READ, 0)
        assert heard(echo, REPLY) == REPLY
    assert echo.echoes is False
    echo.sent(OFF, 0)
    assert heard(echo, OFF) == OFF


def test_a_drive_that_echoes_is_heard_once_on_an_adapter_that_does_too():
    for pieces in ((OFF + OFF,), (OFF, OFF), (OFF[:3], OFF[3:] + OFF[:1], OFF[1:])):
        echo = EchoFilter()
        echo.sent(OFF, 0)
        assert heard(echo, *pieces) == OFF
        assert echo.echoes
        echo.sent(OFF, 0)
        assert heard(echo, OFF) == b""
        assert heard(echo, OFF) == OFF


def test_a_drive_that_wrongly_echoes_is_heard_once_the_adapter_is_known():
    echo = EchoFilter()
    for _ in range(3):
        echo.sent(READ, 0)
        assert heard(echo, REPLY) == REPLY
    assert echo.firm
    echo.sent(READ, 0)
    assert heard(echo, READ) == READ


def test_several_sendings_at_once():
    echo = EchoFilter()
    other = build(MKS, "read_position", 1)
    echo.sent(READ, 0)
    echo.sent(other, 0)
    assert heard(echo, READ + other + REPLY) == REPLY


def test_noise_before_an_echo_is_passed_on():
    echo = EchoFilter()
    echo.sent(READ, 0)
    assert heard(echo, b"\x00\x55" + READ + REPLY) == b"\x00\x55" + REPLY


def test_a_reply_that_ends_like_the_request_begins_is_passed_on_at_once():
    echo = EchoFilter()
    move = build(MKS, "move_relative_pulses", 1, {"speed": 1, "pulses": 5})
    echo.sent(move, 0)
    reply = build(MKS, "move_relative_pulses", 1, {"status": 1}, Role.REPLY)
    assert reply[-1:] == move[:1]
    assert heard(echo, reply) == reply


def test_the_beginning_of_an_echo_is_not_held_for_ever():
    echo = EchoFilter()
    echo.sent(READ, 0)
    assert heard(echo, READ[:1]) == b""
    assert echo.late(WAIT_NS - 1) == b""
    assert echo.late(WAIT_NS) == READ[:1]
    assert not echo.holds


def test_a_copy_that_comes_much_later_is_a_drives():
    echo = EchoFilter()
    echo.sent(READ, 0)
    assert heard(echo, READ, at_ns=WAIT_NS + 1) == READ


# --- serial -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def path() -> Iterator[str]:
    with on_pty("mks-rs485@1", "lk-rs485@2,baud=38400") as found:
        yield found


def test_a_serial_line(path: str):
    line = open_line(parse(f"serial:{path},baud=38400"))
    try:
        before_ns = line.now_ns()
        end_ns = line.write(READ)
        assert end_ns >= before_ns + 4 * line.byte_ns
        got = line.receive(SECOND_NS)
        assert got is not None
        assert got.data == REPLY
        assert got.direction is Role.REPLY
        assert got.t_ns is not None
        assert before_ns < got.t_ns <= line.now_ns()
        assert abs(line.anchor_ns + line.now_ns() - time.time_ns()) < SECOND_NS
        assert line.receive(MS) is None
        assert line.wait(5 * MS) == []
        assert not line.is_can
    finally:
        line.close()
        line.close()
    with pytest.raises(LineLost):
        line.write(READ)
    with pytest.raises(LineLost):
        line.receive(0)


def test_the_speed_of_a_serial_line(path: str):
    line = open_line(parse(f"serial:{path},baud=9600"))
    try:
        line.write(READ)
        assert line.receive(50 * MS) is None
        line.set_speed(38400)
        assert line.endpoint.bits_per_second == 38400
        assert answer(line, READ, len(REPLY)) == REPLY
        # One that is no standard rate: the drive does not hear it, and the port takes it all the same.
        line.set_speed(25000)
        line.write(READ)
        assert line.receive(50 * MS) is None
    finally:
        line.close()


def test_a_port_is_taken_by_one(path: str):
    line = open_line(parse(f"serial:{path}"))
    try:
        with pytest.raises(UsageError, match="is in use"):
            open_line(parse(f"serial:{path}"))
    finally:
        line.close()


def test_an_adapter_that_echoes_on_a_port():
    bus = SerialBus(drives("mks-rs485@1", "lk-rs485@2,baud=38400"), echo=True)
    with on_port(bus, PtyPort(speed=38400)) as path:
        line = open_line(parse(f"serial:{path},baud=38400"))
        try:
            for _ in range(3):
                assert answer(line, READ, len(REPLY)) == REPLY
            off = build(LK, "motor_off", 2)
            assert answer(line, off, len(off)) == off
            assert line.receive(30 * MS) is None
        finally:
            line.close()


def test_a_port_that_goes_away():
    port = PtyPort(speed=38400)
    line = open_line(parse(f"serial:{port.path}"))
    port.close()
    try:
        with pytest.raises(LineLost, match="is gone"):
            line.receive(SECOND_NS)
        with pytest.raises(LineLost, match="is gone"):
            line.set_speed(9600)
    finally:
        line.close()


def test_bytes_that_a_port_does_not_take_at_once():
    master, slave = os.openpty()
    line = open_line(parse(f"serial:{os.ttyname(slave)}"))
    sent, taken = os.urandom(200_000), bytearray()

    def take() -> None:
        while len(taken) < len(sent):
            taken.extend(os.read(master, 4096))

    reader = threading.Thread(target=take)
    reader.start()
    try:
        line.write(sent)
        reader.join(10)
        assert bytes(taken) == sent
        with pytest.raises(TypeError):
            line.write(CanFrame(None, "x", 1, b""))
    finally:
        line.close()
        os.close(slave)
        os.close(master)


def test_why_a_port_cannot_be_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(UsageError, match="is not there; serial ports here"):
        open_line(parse(f"serial:{tmp_path}/none"))
    with pytest.raises(UsageError, match="cannot be opened"):
        open_line(parse(f"serial:{tmp_path}"))
    with pytest.raises(UsageError, match="no adapter with serial number A50285BI"):
        open_line(parse("serial:,serial=A50285BI"))
    with pytest.raises(UsageError, match="the speed is missing"):
        open_line(parse("serial:/dev/ttyUSB0,baud=auto"))
    denied = OSError(errno.EACCES, "Permission denied")
    assert "permission denied" in serial.why_not(str(tmp_path), denied)
    (tmp_path / "port").touch()
    monkeypatch.setattr("grp.getgrgid", lambda number: type("Group", (), {"gr_name": "dialout"}))
    monkeypatch.setattr("pwd.getpwuid", lambda number: type("User", (), {"pw_name": "mona"}))
    hint = serial.why_not(str(tmp_path / "port"), denied)
    assert "sudo usermod -aG dialout mona, then log in again" in hint
    busy = serial.why_not(str(tmp_path / "port"), OSError(errno.EBUSY, "Device or resource busy"))
    assert "is in use by another program" in busy


def test_who_has_a_port(tmp_path: Path):
    name = tmp_path / "port"
    name.touch()
    child = os.fork()
    if not child:
        with name.open():
            time.sleep(20)
        os._exit(0)
    try:
        deadline = time.monotonic() + 10
        while not serial.who_has(str(name)) and time.monotonic() < deadline:
            time.sleep(0.01)
        assert f"(process {child})" in serial.who_has(str(name))[0]
    finally:
        os.kill(child, 9)
        os.waitpid(child, 0)


# --- TCP --------------------------------------------------------------------------------------------------------------


def test_a_tcp_line():
    with on_port(SerialBus(drives("mks-rs485@1")), TcpPort("127.0.0.1", 0)) as place:
        line = open_line(parse(f"tcp:{place}"))
        try:
            assert answer(line, READ, len(REPLY)) == REPLY
            assert line.byte_ns == 0
            with pytest.raises(UsageError, match="cannot be set from here"):
                line.set_speed(9600)
        finally:
            line.close()
        line = open_line(parse(f"tcp:{place},baud=9600"))
        assert line.byte_ns == 10 * SECOND_NS // 9600
        line.close()


def test_a_server_that_resets_a_connection_is_tried_again(monkeypatch):
    """One that has no room says so; and for so long only, for what is asked to stop must not wait for ever."""
    now, tried = [0.0], []

    def connect(host, timeout):
        tried.append(now[0])
        if now[0] < there:
            raise ConnectionResetError(errno.ECONNRESET, "Connection reset by peer")
        return ours

    def sleep(seconds):
        now[0] += seconds

    monkeypatch.setattr(tcp.socket, "create_connection", connect)
    monkeypatch.setattr(tcp, "time", SimpleNamespace(monotonic=lambda: now[0], sleep=sleep))
    there, ours = 2.0, socket.socket()
    with ours:
        assert tcp._connection(("127.0.0.1", 5)) is ours
    assert there <= now[0] < there + 1
    there = 1e9
    with pytest.raises(UsageError, match="Connection reset by peer"):
        open_line(parse("tcp:127.0.0.1:5"))
    assert len(tried) < 100
    assert now[0] < 10


def test_a_piece_of_a_tcp_line_is_short_however_much_waits():
    with socket.create_server(("127.0.0.1", 0)) as server:
        line = open_line(parse(f"tcp:127.0.0.1:{server.getsockname()[1]}"))
        other, _ = server.accept()
        with other, closing(line):
            other.sendall(b"\x55" * 60_000)
            left = 60_000
            while left:
                piece = line.receive(SECOND_NS)
                assert isinstance(piece, Chunk)
                assert 0 < len(piece.data) <= 4096
                left -= len(piece.data)


def test_a_tcp_line_that_is_closed_by_the_other_end():
    server = socket.create_server(("127.0.0.1", 0))
    line = open_line(parse(f"tcp:127.0.0.1:{server.getsockname()[1]}"))
    other, _ = server.accept()
    other.close()
    with pytest.raises(LineLost, match="closed the connection"):
        line.receive(SECOND_NS)
    line.close()
    server.close()
    with pytest.raises(UsageError, match="cannot connect"):
        open_line(parse(f"tcp:127.0.0.1:{server.getsockname()[1] if server.fileno() > 0 else 1}"))


# --- CAN --------------------------------------------------------------------------------------------------------------


def can_answers(line: Line, item: CanFrame) -> list[bytes]:
    line.write(item)
    found, wait_ns = [], SECOND_NS
    while (got := line.receive(wait_ns)) is not None:
        assert isinstance(got, CanFrame)
        assert got.direction is Role.REPLY
        found.append(got.data)
        wait_ns = 100 * MS
    return found


def test_a_can_line():
    channel = f"test {uuid.uuid4()}"
    with on_can(CanBus(drives("mks-can@1")), LibraryPort("virtual", channel)):
        line = open_line(parse(f"can:virtual:{channel},bitrate=500000"))
        try:
            assert line.is_can
            read = CanFrame(None, "x", 1, build(CAN, "read_speed", 1))
            before_ns = line.now_ns()
            assert can_answers(line, read) == [build(CAN, "read_speed", 1, {}, Role.REPLY)]
            assert before_ns < line.write(read)
            with pytest.raises(UsageError, match="cannot be set from here"):
                line.set_speed(125_000)
            with pytest.raises(TypeError):
                line.write(b"\x31")
        finally:
            line.close()
            line.close()
        with pytest.raises(LineLost):
            line.receive(0)


def test_frames_that_an_interface_hands_back():
    # A calibration is answered with its very bytes: the host's own frame comes back first, the drive's second.
    channel = f"test {uuid.uuid4()}"
    with can.Bus(channel, "virtual") as drive:
        line = open_line(parse(f"can:virtual:{channel},receive_own_messages=true"))
        try:
            item = CanFrame(None, "x", 1, bytes.fromhex("80 00 81"))
            line.write(item)
            assert line.receive(50 * MS) is None
            message = drive.recv(1)
            assert message is not None
            drive.send(message)
            got = line.receive(SECOND_NS)
            assert got is not None
            assert got.data == item.data
        finally:
            line.close()


def test_why_a_can_bus_cannot_be_opened():
    with pytest.raises(UsageError, match="no CAN interface"):
        open_line(parse("can:nothing:0"))
    with pytest.raises(UsageError, match="cannot open slcan"):
        open_line(parse("can:slcan:/dev/none"))


# --- emulated ---------------------------------------------------------------------------------------------------------


def test_an_emulated_line_has_its_own_time():
    line = EmulatedLine(drives("mks-rs485@1"))
    assert line.emulated
    assert line.now_ns() == 0
    assert line.byte_ns == 10 * SECOND_NS // 38400
    end_ns = line.write(READ)
    assert line.now_ns() == 0
    assert end_ns == pytest.approx(4 * line.byte_ns, abs=10)
    got = line.receive(SECOND_NS)
    assert got is not None
    assert got.data == REPLY
    assert got.t_ns == line.now_ns()
    line.wait(3600 * SECOND_NS)
    assert line.now_ns() > 3600 * SECOND_NS
    line.set_speed(9600)
    line.write(READ)
    assert line.receive(SECOND_NS) is None
    assert line.bus.speed == 9600


def test_an_emulated_can_line_says_when_a_frame_is_over():
    line = EmulatedLine(drives("mks-can@1"), name="arm")
    assert line.is_can
    read = CanFrame(None, "x", 1, build(CAN, "read_speed", 1))
    first_ns = line.write(read)
    second_ns = line.write(read)
    assert 0 < first_ns < second_ns
    got = line.receive(SECOND_NS)
    assert got is not None
    assert got.port == "arm"


def test_an_emulated_line_of_two_kinds_of_bus():
    with pytest.raises(ValueError, match="one kind of bus"):
        EmulatedLine(drives("mks-can@1", "mks-rs485@1"))
    with pytest.raises(ValueError, match="no drive"):
        EmulatedLine([])


def test_a_port_is_taken_for_this_program_alone_and_given_back():
    import fcntl
    import struct

    asked = getattr(__import__("termios"), "TIOCGEXCL", 0x80045440)

    def taken(fd: int) -> bool:
        return struct.unpack("i", fcntl.ioctl(fd, asked, b"\0\0\0\0"))[0] != 0

    with on_pty("mks-rs485@1") as path:
        line = SerialLine(parse(f"serial:{path},baud=38400"))
        assert taken(line.fileno())
        line.close()
        fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
        try:
            assert not taken(fd)
        finally:
            os.close(fd)


@pytest.mark.skipif(os.geteuid() != 0, reason="to be another user")
def test_another_users_program_cannot_open_a_taken_port():
    """The lock alone does not keep it out: it asks for none. The flag does, root aside."""
    with on_pty("mks-rs485@1") as path:
        os.chmod(path, 0o666)

        def opened_by_another() -> int:
            child = os.fork()
            if not child:
                os.setuid(65534)
                try:
                    os.write(os.open(path, os.O_RDWR | os.O_NOCTTY), READ)
                except OSError as error:
                    os._exit(error.errno)
                os._exit(0)
            return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])

        line = SerialLine(parse(f"serial:{path},baud=38400"))
        assert opened_by_another() == errno.EBUSY
        line.close()
        assert opened_by_another() == 0
