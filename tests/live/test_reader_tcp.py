"""Reading TCP servers: connected, closed, gone and back; nothing is sent (tests/test_passive.py)."""

from __future__ import annotations

import socket
import time
from contextlib import closing

import pytest

from analyzer.live import reader_tcp
from analyzer.live.endpoint import parse
from analyzer.live.reader_port import Lost, Stop, Unopened
from analyzer.live.reader_tcp import TcpPort
from tests.conformance.drives.served import wait_for
from tests.live.readers import ReaderProcess


def listen(port=0):
    server = socket.create_server(("127.0.0.1", port))
    server.settimeout(15)
    return server, server.getsockname()[1]


def test_what_the_server_says_is_stored(tmp_path):
    server, port = listen()
    with closing(server), ReaderProcess(tmp_path, f"tcp:127.0.0.1:{port}") as reader:
        client, _ = server.accept()
        with client:
            assert client.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 0, "the server's own business"
            client.sendall(b"hello")
            assert wait_for(lambda: reader.data() == b"hello")
            assert reader.end() == 0
    assert reader.events("closed")[0]["bytes"] == 5


def test_a_connection_is_kept_alive_by_the_kernel():
    server, port = listen()
    with closing(server):
        stop = Stop()
        connection = TcpPort(parse(f"tcp:127.0.0.1:{port}"))
        connection.open(stop)
        with socket.socket(fileno=connection.descriptor()) as found:
            assert found.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1
            for name, value in reader_tcp.KEEPALIVE:
                assert found.getsockopt(socket.IPPROTO_TCP, getattr(socket, name)) == value
        stop.close()


def test_a_server_that_is_gone_and_back_leaves_a_gap(tmp_path):
    server, port = listen()
    with ReaderProcess(tmp_path, f"tcp:127.0.0.1:{port}") as reader:
        client, _ = server.accept()
        client.sendall(b"before")
        assert wait_for(lambda: reader.data() == b"before")
        server.close()
        client.close()
        lost = reader.wait_event("lost")
        assert lost["reason"] == "the server closed the connection"
        assert "refused" in reader.wait_event("note")["text"]
        server, _ = listen(port)
        with closing(server):
            client, _ = server.accept()
            back = reader.wait_event("back")
            with client:
                client.sendall(b"after")
                assert wait_for(lambda: reader.data() == b"beforeafter")
                assert reader.end() == 0
    assert back["from_ns"] == lost["t_ns"]
    assert back["gap_ns"] > 0


def test_a_connection_that_is_reset_is_lost(tmp_path):
    server, port = listen()
    with closing(server), ReaderProcess(tmp_path, f"tcp:127.0.0.1:{port}") as reader:
        client, _ = server.accept()
        # Closing at once, without the usual farewell.
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        client.close()
        assert "reset" in reader.wait_event("lost")["reason"]
        server.accept()[0].close()
        reader.wait_event("back")


def test_why_there_is_no_connection():
    server, port = listen()
    server.close()
    stop = Stop()
    with pytest.raises(Unopened, match="refused"):
        TcpPort(parse(f"tcp:127.0.0.1:{port}")).open(stop)
    with pytest.raises(Unopened, match="no such host"):
        TcpPort(parse("tcp:no.such.host.invalid:1")).open(stop)
    stop.close()


def test_a_server_that_does_not_answer_is_given_up_and_the_wish_to_end_ends_the_wait(monkeypatch):
    # The queue of a server that does not accept is full: further clients get no answer.
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen(0)
        endpoint = parse(f"tcp:127.0.0.1:{server.getsockname()[1]}")
        waiting = [TcpPort(endpoint) for _ in range(1)]
        stop = Stop()
        for port in waiting:
            port.open(stop)
        monkeypatch.setattr(reader_tcp, "CONNECT_S", 0.05)
        with pytest.raises(Unopened, match="no answer"):
            TcpPort(endpoint).open(stop)
        monkeypatch.setattr(reader_tcp, "CONNECT_S", 60.0)
        stop.ask("over")
        began = time.monotonic()
        with pytest.raises(Lost):
            TcpPort(endpoint).open(stop)
        assert time.monotonic() - began < 30
        for port in waiting:
            port.close()
        stop.close()
