"""CAN buses that are sockets: frames of others, own frames told apart, what is read of a full bus, and what cannot be."""

from __future__ import annotations

import socket
import struct
import threading
import uuid
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import can
import pytest

from analyzer import dialects, plugins
from analyzer.catalogue import Role
from analyzer.encoder import build
from analyzer.errors import ServotapError, UsageError
from analyzer.live.endpoint import parse
from analyzer.live.spool import CanFlag
from analyzer.records import CanFrame
from conformance.bus import open_can_port, open_line, python_can
from conformance.bus.can_port import Acceptance
from conformance.bus.can_socket import MulticastPort
from conformance.bus.python_can import LibraryPort, SocketCanPort
from conformance.gate.gate import Allowance, Gate
from conformance.safety import stopping
from conformance.talk.dialogue import MS, Dialogue

GROUP = "239.74.163.102"
MKS = dialects.get("mks-can")
SECOND_NS = 1_000_000_000


def frame(can_id: int, data: bytes, **marks: bool) -> CanFrame:
    return CanFrame(None, "test", can_id, data, **marks)


@pytest.fixture
def group() -> int:
    """Return the number of a port of a multicast bus that carries frames here."""
    number = 20000 + uuid.uuid4().int % 30000
    try:
        with closing(MulticastPort(GROUP, port=number)) as one, closing(MulticastPort(GROUP, port=number)) as other:
            one.put(frame(1, b"\0"))
            carried = other.receive(2 * SECOND_NS)
    except (UsageError, ServotapError) as error:
        pytest.skip(f"udp_multicast does not open here: {error}")
    if carried is None:
        pytest.skip("udp_multicast does not carry frames here")
    return number


@pytest.fixture
def pair(group: int) -> Iterator[tuple[MulticastPort, MulticastPort]]:
    with closing(MulticastPort(GROUP, port=group)) as one, closing(MulticastPort(GROUP, port=group, hop_limit=0)) as other:
        yield one, other


# --- udp_multicast ----------------------------------------------------------------------------------------------------


def test_own_frames_do_not_come_back_however_late_they_are_read(pair: tuple[MulticastPort, MulticastPort]):
    one, other = pair
    # Equal frames of both: only the source tells whose they are.
    for _ in range(3):
        one.put(frame(1, b"\x80\0\x81"))
        other.put(frame(1, b"\x80\0\x81"))
    for port in pair:
        got = [port.receive(2 * SECOND_NS) for _ in range(3)]
        assert [(f.id, f.data, f.direction) for f in got if f is not None] == [(1, b"\x80\0\x81", Role.REQUEST)] * 3
        assert port.receive(0) is None


@pytest.mark.parametrize(
    "sent",
    [
        frame(0x7FF, bytes(8)),
        frame(0, b""),
        frame(0x1ABCDEF0, b"\1", extended=True),
        frame(3, b"", remote=True),
        frame(3, b"\1\2", error=True),
        frame(3, bytes(24), fd=True),
    ],
    ids=lambda f: f"{f.id:X}",
)
def test_python_can_understands_what_is_sent_and_is_understood(group: int, sent: CanFrame):
    with closing(MulticastPort(GROUP, port=group)) as port, can.Bus(GROUP, "udp_multicast", port=group) as theirs:
        port.put(sent)
        message = theirs.recv(2)
        assert message is not None
        marks = (message.is_extended_id, message.is_remote_frame, message.is_error_frame, message.is_fd)
        assert (message.arbitration_id, bytes(message.data or b"")) == (sent.id, sent.data)
        assert marks == (sent.extended, sent.remote, sent.error, sent.fd)
        theirs.send(message)
        got = port.receive(2 * SECOND_NS)
        assert got is not None
        assert (got.id, got.data, got.extended, got.remote, got.error, got.fd) == (sent.id, sent.data, *marks)


def test_what_is_no_frame_is_counted_and_ends_nothing(group: int, capsys: pytest.CaptureFixture[str]):
    with closing(MulticastPort(GROUP, port=group)) as port, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        for _ in range(40):
            other.sendto(b"\xc1nonsense", (GROUP, group))
        with closing(MulticastPort(GROUP, port=group)) as sender:
            sender.put(frame(5, b"\1"))
            got = port.receive(2 * SECOND_NS)
        assert got is not None
        assert got.id == 5
        assert port.unread == 40
    assert "said 40 things that cannot be read" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("channel", "options", "told"),
    [
        ("nowhere", {}, "nowhere is not an address"),
        ("10.0.0.1", {}, "is not a multicast address"),
        (GROUP, {"port": "many"}, "cannot open udp_multicast:239"),
        (GROUP, {"port": 1 << 20}, "cannot open udp_multicast:239"),
        (GROUP, {"loop": 1}, "no option loop"),
    ],
)
def test_what_cannot_be_opened_is_told(channel: str, options: dict[str, Any], told: str):
    with pytest.raises(UsageError, match=told):
        open_can_port("udp_multicast", channel, **options)


# --- SocketCAN --------------------------------------------------------------------------------------------------------


class Kernel:
    """An interface of SocketCAN whose kernel is this test: frames come from the other end of a pair of sockets."""

    def __init__(self, *_: Any, **__: Any) -> None:
        self.ours, self.theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.sent: list[can.Message] = []

    def fileno(self) -> int:
        return self.theirs.fileno()

    def send(self, message: can.Message) -> None:
        self.sent.append(message)

    def shutdown(self) -> None:
        self.ours.close()
        self.theirs.close()

    def put(self, word: int, data: bytes) -> None:
        self.ours.send(struct.pack("=IB3x8s", word, len(data), data))


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> Kernel:
    made = Kernel()
    monkeypatch.setattr(can, "Bus", lambda **_: made)
    return made


def test_frames_of_the_kernel(kernel: Kernel):
    port = open_can_port("socketcan", "can9")
    assert isinstance(port, SocketCanPort)
    kernel.put(0x001, b"\1\2")
    kernel.put(0x80000000 | 0x12345, b"")
    kernel.put(0x40000002, b"")
    got = [port.receive(SECOND_NS) for _ in range(3)]
    assert [(f.id, f.data, f.extended, f.remote) for f in got if f is not None] == [
        (1, b"\1\2", False, False), (0x12345, b"", True, False), (2, b"", False, True),
    ]  # fmt: skip
    assert port.receive(0) is None
    port.put(frame(1, b"\5"))
    assert [(m.arbitration_id, bytes(m.data)) for m in kernel.sent] == [(1, b"\5")]
    kernel.ours.close()
    port.close()
    port.close()


def test_own_frames_are_those_that_the_kernel_marks(kernel: Kernel, monkeypatch: pytest.MonkeyPatch):
    """It marks all frames of this machine, too: those of other programs are no own ones."""
    marks = iter((socket.MSG_DONTROUTE, socket.MSG_DONTROUTE | socket.MSG_CONFIRM, 0))

    class Marked(socket.socket):
        def recvmsg(self, *_: int) -> Any:
            mark = next(marks, None)
            if mark is None:
                raise BlockingIOError
            return struct.pack("=IB3x8s", 0x100 + (mark >> 2), 0, b""), [], mark, None

    monkeypatch.setattr(python_can, "socket_of", lambda bus: Marked(socket.AF_UNIX))
    with closing(open_can_port("socketcan", "can9", receive_own_messages=True)) as port:
        got = [port.receive(0) for _ in range(3)]
    assert [f.id for f in got if f is not None] == [0x101, 0x100]


def test_an_interface_that_goes_down_is_told(kernel: Kernel, monkeypatch: pytest.MonkeyPatch):
    class Down(socket.socket):
        def recvmsg(self, *_: int) -> Any:
            raise OSError(100, "Network is down")

    monkeypatch.setattr(python_can, "socket_of", lambda bus: Down(socket.AF_UNIX))
    with (
        closing(open_can_port("socketcan", "can9")) as port,
        pytest.raises(ServotapError, match="can9 is gone: Network is down"),
    ):
        port.receive(SECOND_NS)


# --- a full bus -------------------------------------------------------------------------------------------------------


def test_all_frames_are_read_unless_it_is_said_which():
    acceptance = Acceptance()
    assert all(acceptance.takes(0x300, 0, 8) for _ in range(1000))
    acceptance.only({1, 2})
    assert all(acceptance.takes(1, 0, 8) for _ in range(1000))
    # The first ones tell who else is there; no drive has an identifier of 29 bits.
    assert [acceptance.takes(0x300, 0, 8) for _ in range(100)].count(True) == 32
    assert [acceptance.takes(1, CanFlag.EXTENDED, 8) for _ in range(100)].count(True) == 0
    assert [acceptance.takes(0x301, 0, 8) for _ in range(100)].count(True) == 32
    assert acceptance.passed == 8 * (68 + 100 + 68)


@pytest.mark.parametrize("datagram", [b"", b"\xc1", b"\x91" * 1300, b"\x81\xa1a" * 1300])
def test_a_datagram_that_is_no_frame_ends_nothing(
    pair: tuple[MulticastPort, MulticastPort], capsys: pytest.CaptureFixture[str], datagram: bytes
):
    one, other = pair
    one._sender.send(datagram)
    one.put(frame(1, b"\1"))
    heard = other.receive(2 * SECOND_NS)
    assert heard is not None
    assert heard.data == b"\1"
    assert "said what cannot be read" in capsys.readouterr().err


def test_what_others_send_is_counted_where_it_is_not_read(pair: tuple[MulticastPort, MulticastPort], group: int):
    drive, _ = pair
    line = open_line(parse(f"can:udp_multicast:{GROUP},port={group}"))
    with closing(line):
        talk = Dialogue(Gate(line, Allowance()), [MKS])
        assert line.acceptance is not None
        line.acceptance.only({1})
        for _ in range(200):
            drive.put(frame(0x300, b"\xee" * 8))
        drive.put(frame(1, reply := build(MKS, "read_speed", 1, {}, Role.REPLY)))
        exchange = talk.ask(frame(1, build(MKS, "read_speed", 1)), 2000 * MS)
        assert [a.data for a in exchange.answers] == [reply]
        assert len(exchange.foreign) == 32
        assert exchange.passed == 8 * (200 - 32)
        assert "others send on this bus" in stopping.others_send([exchange], line)[0]


def test_an_interface_of_python_can_passes_over_others_too():
    channel = f"test {uuid.uuid4()}"
    with closing(LibraryPort("virtual", channel)) as port, can.Bus(channel, "virtual") as other:
        port.acceptance.only({1})
        for number in (*[0x300] * 100, 1):
            other.send(can.Message(arbitration_id=number, data=b"\1\2", is_extended_id=False))
        got = [f.id for _ in range(101) if (f := port.receive(0)) is not None]
        assert got == [*[0x300] * 32, 1]
        assert port.acceptance.passed == 2 * 68


class Broken(can.BusABC):
    """A driver that does what no driver should. `does`: what is raised, or given instead of a message."""

    does: Any = None

    def __init__(self, *words: Any, **options: Any) -> None: ...

    def recv(self, timeout: float | None = None) -> Any:
        if isinstance(self.does, BaseException):
            raise self.does
        return self.does

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.recv()

    def shutdown(self) -> None:
        self.recv()

    def fileno(self) -> int:
        self.recv()
        return -1


class Wordless(Exception):
    """An error that fails once more where it is told."""

    def __str__(self) -> str:
        raise self


@pytest.mark.parametrize(
    "does",
    [
        SystemExit(4),
        Wordless(),
        type("Panic", (BaseException,), {})("p"),
        "no message",
        can.Message(arbitration_id=1.5, check=False),  # type: ignore[arg-type]
    ],
    ids=["leaves", "fails twice", "panics", "no message", "no identifier"],
)
def test_a_driver_that_breaks_off_or_gives_no_message_is_a_port_that_is_gone(does, monkeypatch, capsys):
    monkeypatch.setattr(python_can.can, "Bus", Broken)
    monkeypatch.setattr(python_can.time, "sleep", lambda seconds: None)
    monkeypatch.setattr(Broken, "does", does)
    with closing(LibraryPort("virtual", "x")) as port:
        with pytest.raises(ServotapError, match="is gone"):
            list(iter(lambda: port.receive(0), does))
        if isinstance(does, BaseException):
            with pytest.raises(ServotapError, match="does not send"):
                port.put(frame(1, b"1"))
    assert "cannot be read" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("about", "told"),
    [({"arbitration_id": 1 << 40}, "identifier 1099511627776"), ({"data": bytes(65), "dlc": 65}, "a frame has 65 bytes")],
)
def test_what_is_no_frame_is_not_given_on(about, told, monkeypatch, capsys):
    monkeypatch.setattr(python_can.can, "Bus", Broken)
    monkeypatch.setattr(Broken, "does", can.Message(**about, check=False))
    with closing(LibraryPort("virtual", "x")) as port:
        assert port.receive(0) is None
    assert told in capsys.readouterr().err


def test_a_driver_that_fails_as_it_is_opened_is_told(monkeypatch):
    monkeypatch.setattr(Broken, "__init__", Broken.recv)
    monkeypatch.setattr(python_can.can, "Bus", lambda **options: Broken())
    for does, told in ((Wordless(), "Wordless$"), (SystemExit(4), "SystemExit: 4")):
        monkeypatch.setattr(Broken, "does", does)
        with pytest.raises(UsageError, match=f"cannot open virtual:x: {told}"):
            LibraryPort("virtual", "x")


def test_ctrl_c_in_a_driver_is_the_users(monkeypatch):
    monkeypatch.setattr(python_can.can, "Bus", Broken)
    port = LibraryPort("virtual", "x")
    monkeypatch.setattr(Broken, "does", KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        port.receive(0)
    port.close()


def test_a_port_is_closed_also_where_no_thread_is_left(monkeypatch):
    monkeypatch.setattr(python_can.can, "Bus", Broken)
    port, shut = LibraryPort("virtual", "x"), []
    monkeypatch.setattr(port._bus, "shutdown", lambda: shut.append(1))
    monkeypatch.setattr(threading.Thread, "start", no_thread)
    port.close()
    assert shut == [1]


def no_thread(thread: threading.Thread) -> None:
    raise RuntimeError("can't start new thread")


def test_a_driver_that_hangs_while_it_closes_is_left_behind(monkeypatch, capsys):
    monkeypatch.setattr(python_can.can, "Bus", Broken)
    monkeypatch.setattr(plugins, "CLOSE_SECONDS", 0)
    hung = threading.Event()
    port = LibraryPort("virtual", "x")
    monkeypatch.setattr(port._bus, "shutdown", hung.wait)
    port.close()
    hung.set()
    assert capsys.readouterr().err == "servotap: virtual:x is left open, for its driver hangs while it closes\n"
