"""What runs while a target's command runs: a client of its port, a program at its terminal, keys at its view.

All of it follows from the bytes of the input, so that the file alone repeats a fault.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import struct
import threading
import time
import tty
import zlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

#: Bytes with which the far end of a bus answers a request.
PIECE = 24
#: The longest wait for an answer, and for a port that the command opens.
_ANSWER_S, _OPENED_S = 0.02, 20.0
_GROUP = "239.74.163.31"


@contextlib.contextmanager
def beside(act: Callable[[threading.Event], None]) -> Iterator[None]:
    """Run a client in a thread; `ended` is set when the command is over. What a port that closes raises is no fault."""
    ended = threading.Event()
    with ThreadPoolExecutor(1) as pool:
        client = pool.submit(act, ended)
        try:
            yield
        finally:
            ended.set()
    with contextlib.suppress(OSError):
        client.result()


@contextlib.contextmanager
def far_end(data: bytes) -> Iterator[str]:
    """Serve the far end of a bus, which answers each request with a piece of `data` and then hangs up; yield its endpoint."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve(ended: threading.Event) -> None:
            with server.accept()[0] as connection:
                for at in range(0, len(data), PIECE):
                    connection.sendall(data[at : at + PIECE])
                    if not connection.recv(4096):
                        break

        with beside(serve):
            try:
                yield f"tcp:127.0.0.1:{server.getsockname()[1]}"
            finally:
                server.shutdown(socket.SHUT_RDWR)


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """Return a port that nobody has."""
    with socket.socket(socket.AF_INET, kind) as taken:
        taken.bind(("127.0.0.1", 0))
        return int(taken.getsockname()[1])


def pieces(data: bytes) -> list[bytes]:
    """Return the bytes as a client sends them: cut anywhere."""
    size = 1 + zlib.crc32(data) % 40
    return [data[at : at + size] for at in range(0, len(data), size)]


def _soon(ended: threading.Event, attempt: Callable[[], socket.socket | int]) -> socket.socket | int:
    """Return what can be opened once the command has begun. Raises OSError if it ends before."""
    late = time.monotonic() + _OPENED_S
    while True:
        try:
            return attempt()
        except OSError:
            if ended.wait(0.002) or time.monotonic() > late:
                raise


def tcp_clients(port: int, data: bytes) -> Callable[[threading.Event], None]:
    """Return clients of a port: one that writes and reads, one that resets its connection, one that comes and leaves."""

    def act(ended: threading.Event) -> None:
        first = _soon(ended, lambda: socket.create_connection(("127.0.0.1", port), 0.5))
        assert isinstance(first, socket.socket)
        with first:
            first.settimeout(_ANSWER_S)
            for number, piece in enumerate(pieces(data)):
                first.sendall(piece)
                if number % 8 == 3:
                    with socket.create_connection(("127.0.0.1", port), 0.5) as other:
                        if number % 16 == 3:
                            other.sendall(piece)
                            other.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                with contextlib.suppress(TimeoutError):
                    first.recv(4096)
                if ended.is_set():
                    break

    return act


def program(link: Path, data: bytes) -> Callable[[threading.Event], None]:
    """Return a program that opens a pseudo-terminal as soon as it is there, writes, reads, and now and then opens it anew."""

    def opened() -> int:
        port = os.open(link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(port)
        return port

    def act(ended: threading.Event) -> None:
        port = _soon(ended, opened)
        assert isinstance(port, int)
        try:
            for number, piece in enumerate(pieces(data)):
                with contextlib.suppress(BlockingIOError):
                    os.write(port, piece)
                with contextlib.suppress(BlockingIOError):
                    os.read(port, 4096)
                if number % 8 == 7:
                    os.close(port)
                    port = opened()
                if ended.wait(0.002):
                    break
        finally:
            with contextlib.suppress(OSError):
                os.close(port)

    return act


def can_bus() -> tuple[str, int]:
    """Return a multicast bus of its own, and its port."""
    port = free_port(socket.SOCK_DGRAM)
    return f"udp_multicast:{_GROUP},port={port}", port


def datagrams(port: int, data: bytes) -> Callable[[threading.Event], None]:
    """Return who sends on a multicast bus: frames, and what is none."""
    from can import Message
    from can.interfaces.udp_multicast.utils import pack_message

    def act(ended: threading.Event) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
            # Who listens is not known: all is sent until the command ends.
            while not ended.wait(0.01):
                for piece in pieces(data):
                    sender.sendto(piece, (_GROUP, port))
                    extended = bool(piece[0] & 0x80)
                    message = Message(arbitration_id=piece[0] & 3, is_extended_id=extended, data=piece[1:9])
                    sender.sendto(pack_message(message), (_GROUP, port))

    return act


# --- the view -----------------------------------------------------------------------------------------------------------

_TEXTS = ("address == 1", "speed > 1", "FA 01", "~" * 40, "((", "[/red]", "[bold", "\x1b[31m", "é", "\U0001f600", "'", "0x")
_NAMES = ("up", "down", "left", "right", "shift+right", "pageup", "pagedown", "home", "end", "tab", "enter", "escape",
          "backspace", "ctrl+a", "ctrl+k", "ctrl+c", "delete", "f1", "f12")  # fmt: skip
_SIZES = ((80, 24), (1, 1), (20, 3), (200, 60), (80, 2), (3, 40))


def viewed(path: Path, keys: bytes) -> None:
    """Look at a capture without a terminal, with keys; raises what the view raises."""
    from textual.events import Paste

    from analyzer.view.app import ViewApp
    from analyzer.view.capture import CaptureSource
    from analyzer.view.keys import KEYS
    from tests.view.screen import reading_of

    source = CaptureSource(reading_of(path))
    singles = [*_NAMES, *(name for key in KEYS if key.action != "leave" for name in key.key.split(","))]

    async def go() -> None:
        app = ViewApp(source)
        async with app.run_test(size=_SIZES[keys[0] % len(_SIZES)] if keys else (80, 24)) as pilot:
            for value in keys[:_MOST_KEYS]:
                if value < 2 * len(_TEXTS):
                    await pilot.press(("f", "slash")[value % 2])
                    app.post_message(Paste(_TEXTS[value // 2]))
                    pressed = ["enter"]
                elif value > 0xFF - len(_SIZES):
                    await pilot.resize_terminal(*_SIZES[0xFF - value])
                    pressed = []
                else:
                    pressed = [singles[value % len(singles)]]
                await pilot.press(*pressed)
                app.tick()
                if app._exit:
                    break
            await pilot.pause()

    try:
        asyncio.run(go())
    finally:
        source.close()


_MOST_KEYS = 8
