"""Drives behind a TCP port, with pyserial's `socket://` as the client."""

from __future__ import annotations

import contextlib
import resource
import select
import socket
import time
from collections.abc import Iterator

import pytest
import serial

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.encoder import build
from analyzer.errors import UsageError
from conformance.drives.serial_bus import SerialBus
from conformance.serve.tcp import CLIENTS, TcpPort, parse_endpoint
from tests.conformance.drives.served import drives, on_port, wait_for

MKS = dialects.get("mks-rs485")
READ = build(MKS, "read_speed", 1)
REPLY = build(MKS, "read_speed", 1, {}, Role.REPLY)


@pytest.fixture
def bus() -> SerialBus:
    return SerialBus(drives("mks-rs485@1"))


@pytest.fixture
def place(bus: SerialBus) -> Iterator[str]:
    with on_port(bus, TcpPort("127.0.0.1", 0)) as name:
        yield name


def ask(place: str) -> bytes:
    with serial.serial_for_url(f"socket://{place}", timeout=1) as port:
        port.write(READ)
        data: bytes = port.read(6)
        return data


def test_pyserial_by_socket_url_again_and_again(place: str) -> None:
    for _ in range(5):
        assert ask(place) == REPLY


def test_clients_reconnect_as_often_as_they_like(place: str) -> None:
    for _ in range(50):
        with socket.create_connection(parse_endpoint(place), timeout=5) as client:
            client.sendall(READ)
            data = b""
            while len(data) < len(REPLY):
                data += client.recv(64)
            assert data == REPLY


def test_a_client_that_leaves_hard_does_not_matter(bus: SerialBus, place: str) -> None:
    host, port = parse_endpoint(place)
    for _ in range(5):
        with socket.create_connection((host, port)) as client:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\0\0\0\0\0\0\0")
            client.sendall(READ)
    # What those who left have asked is answered all the same, and the next one would hear it.
    time.sleep(0.1)
    assert wait_for(lambda: bus.next_ns() is None)
    assert ask(place) == REPLY


def test_little_waits_for_the_line_however_much_a_client_sends():
    port = TcpPort("127.0.0.1", 0)
    with socket.create_connection((port.host, port.port)):
        port.read([port.descriptors()[0]])
        (client,) = port._clients.values()
        # Seconds of a line of 38400 baud, and no hour.
        assert client.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) <= 1 << 15
    port.close()


def test_clients_too_many_are_let_go_and_the_others_go_on(bus: SerialBus) -> None:
    told: list[str] = []
    port = TcpPort("127.0.0.1", 0, told.append)
    with on_port(bus, port) as place, contextlib.ExitStack() as stack:
        clients = [stack.enter_context(socket.create_connection(parse_endpoint(place), timeout=5)) for _ in range(CLIENTS + 40)]
        assert [client.recv(1) for client in clients[CLIENTS:]] == [b""] * 40
        clients[0].sendall(READ)
        for client in clients[:CLIENTS]:
            assert client.recv(6) == REPLY
        assert told == [f"{place}: clients are not taken: {CLIENTS} have the line"]
        # One leaves, and there is room for another.
        clients[1].close()
        assert wait_for(lambda: len(port._clients) < CLIENTS)
        assert ask(place) == REPLY


def test_without_descriptors_clients_wait_and_the_loop_sleeps(bus: SerialBus) -> None:
    told: list[str] = []
    port = TcpPort("127.0.0.1", 0, told.append)
    with contextlib.closing(port), contextlib.ExitStack() as stack:
        first = stack.enter_context(socket.create_connection((port.host, port.port), timeout=5))
        port.read(port.descriptors())
        waiting = stack.enter_context(socket.create_connection((port.host, port.port), timeout=5))
        limits = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (0, limits[1]))
        try:
            port.read(port.descriptors())
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, limits)
        assert told == [f"{port.name}: clients are not taken: the system has no more descriptors for this process; they wait"]
        assert not select.select(port.descriptors(), [], [], 0)[0]
        first.sendall(READ)
        assert select.select(port.descriptors(), [], [], 5)[0] == port.descriptors()
        assert port.read(port.descriptors()) == READ
        port.idle()
        port.read(port.descriptors())
        port.write(REPLY)
        assert waiting.recv(6) == REPLY


def test_two_clients_share_the_line(place: str) -> None:
    with (
        serial.serial_for_url(f"socket://{place}", timeout=1) as one,
        serial.serial_for_url(f"socket://{place}", timeout=1) as two,
    ):
        two.write(READ)
        assert two.read(6) == REPLY
        one.write(READ)
        assert (one.read(12), two.read(6)) == (REPLY * 2, REPLY)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("5000", ("127.0.0.1", 5000)),
        (":5000", ("127.0.0.1", 5000)),
        ("0.0.0.0:0", ("0.0.0.0", 0)),
        ("localhost:5000", ("localhost", 5000)),
        ("[::1]:5000", ("::1", 5000)),
    ],
)
def test_endpoints(text: str, expected: tuple[str, int]) -> None:
    assert parse_endpoint(text) == expected


@pytest.mark.parametrize("text", ["", "host", "host:", "host:70000", "host:x", "a:b:1", "a..b:1"])
def test_what_is_no_endpoint(text: str) -> None:
    with pytest.raises(UsageError, match="expected HOST:PORT"):
        parse_endpoint(text)


def test_a_port_that_is_taken_is_told() -> None:
    port = TcpPort("127.0.0.1", 0)
    with pytest.raises(UsageError, match=r"cannot listen on 127\.0\.0\.1:\d+: "):
        TcpPort("127.0.0.1", port.port)
    port.close()
    with pytest.raises(UsageError, match=r"cannot listen on no\.such\.host\.invalid:1"):
        TcpPort("no.such.host.invalid", 1)
