"""Emulated drives for users' tests: on a pseudo-terminal for programs, on a line in virtual time for code.

    def test_my_program(servo_port):
        port = servo_port("mks-rs485@1", "mks-rs485@2,fault=late-reply")        "/dev/pts/5", as pyserial opens it

    def test_my_protocol(servo_line):
        line = servo_line("mks-can@1")
        line.write(...); line.receive(1_000_000_000)                           only the line's clock moves

The pytest plugin offers both as fixtures. `servo_port` needs a system with pseudo-terminals.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from analyzer.errors import ServotapError
from conformance.bus.emulated import EmulatedLine
from conformance.drives import make
from conformance.drives.serial_bus import SerialBus

_END_SECONDS = 10


def line_of(*drives: str) -> EmulatedLine:
    """Return a line in virtual time with drives as `servotap emulate` names them. Raises UsageError."""
    return EmulatedLine([make.make(make.parse(text)) for text in drives])


@contextmanager
def port_of(*drives: str) -> Iterator[str]:
    """Serve drives on a pseudo-terminal in real time and yield its path. Raises UsageError."""
    from conformance.serve import serial_server
    from conformance.serve.clock import Clock
    from conformance.serve.pty import PtyPort
    from conformance.serve.stop import Stop

    bus = SerialBus([make.make(make.parse(text)) for text in drives])
    port, stop = PtyPort(speed=bus.stations[0].speed), Stop()
    thread = threading.Thread(target=serial_server.serve, args=(bus, port, Clock(), stop), daemon=True)
    thread.start()
    try:
        yield port.name
    finally:
        stop.set()
        thread.join(_END_SECONDS)
        port.close()
        stop.close()
        if thread.is_alive():
            raise ServotapError("the emulated drives do not end")


@contextmanager
def ports() -> Iterator[Callable[..., str]]:
    """Yield a function that serves drives on a new pseudo-terminal; all are closed at the end."""
    with ExitStack() as stack:
        yield lambda *drives: stack.enter_context(port_of(*drives))
