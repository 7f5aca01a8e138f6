"""Drives for users' tests: emulated on a pseudo-terminal, a CAN bus or a line in virtual time, and the one of the options.

    def test_my_program(servo_port):
        port = servo_port("mks-rs485@1", "mks-rs485@2,fault=late-reply")        "/dev/pts/5", as pyserial opens it

    def test_my_can_program(servo_can_bus):
        bus = servo_can_bus("mks-can@1", "mks-can@2")                           a bus of python-can

    def test_my_protocol(servo_line):
        line = servo_line("mks-can@1")
        line.write(...); line.receive(1_000_000_000)                           only the line's clock moves

    def test_my_axis(servo_drive):
        assert servo_drive.read("read_speed") == 0                             pytest --servo-drive mks-rs485@1 --servo-on ...

The pytest plugin offers all as fixtures. `servo_port` needs a system with pseudo-terminals.
"""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest

from analyzer.errors import ServotapError
from conformance.bus.emulated import EmulatedLine
from conformance.drives import make
from conformance.drives.can_bus import CanBus
from conformance.drives.serial_bus import SerialBus
from conformance.gate.permissions import narrow
from conformance.pytest_plugin.plan import arguments_of, label, note
from conformance.suite import target as targets
from conformance.suite.target import Target

if TYPE_CHECKING:
    import can

    from analyzer.live.reader_port import Stop
    from servotap import Drive

_END_SECONDS = 10
_channels = itertools.count(1)


def line_of(*drives: str) -> EmulatedLine:
    """Return a line in virtual time with drives as `servotap emulate` names them. Raises UsageError."""
    return EmulatedLine([make.make(make.parse(text)) for text in drives])


@contextmanager
def port_of(*drives: str) -> Iterator[str]:
    """Serve drives on a pseudo-terminal in real time and yield its path. Raises UsageError."""
    from conformance.serve import serial_server
    from conformance.serve.clock import Clock
    from conformance.serve.pty import PtyPort

    bus = SerialBus([make.make(make.parse(text)) for text in drives])
    port = PtyPort(speed=bus.stations[0].speed)
    with _served(partial(serial_server.serve, bus, port, Clock()), port.close):
        yield port.name


@contextmanager
def can_bus_of(*drives: str) -> Iterator[can.BusABC]:
    """Serve drives on a virtual bus of python-can in real time and yield another end of it. Raises UsageError."""
    import can as library

    from conformance.bus.python_can import LibraryPort
    from conformance.serve import can
    from conformance.serve.clock import Clock

    channel = f"servotap-{os.getpid()}-{next(_channels)}"
    # Opened first: what is wrong with the drives is told before anything runs.
    bus = CanBus([make.make(make.parse(text)) for text in drives])
    port = LibraryPort("virtual", channel)
    served = _served(partial(can.serve, bus, port, Clock()), port.close)
    with served, library.Bus(interface="virtual", channel=channel) as end:
        yield end


@contextmanager
def _served(serve: Callable[[Stop], None], close: Callable[[], None]) -> Iterator[None]:
    """Run drives in a thread of their own, and always end them."""
    from analyzer.live.reader_port import Stop

    stop = Stop()
    thread = threading.Thread(target=serve, args=(stop,), daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.ask("the test is over")
        thread.join(_END_SECONDS)
        close()
        stop.close()
        if thread.is_alive():
            raise ServotapError("the emulated drives do not end")


@contextmanager
def ports() -> Iterator[Callable[..., str]]:
    """Yield a function that serves drives on a new pseudo-terminal; all are closed at the end."""
    with ExitStack() as stack:
        yield lambda *drives: stack.enter_context(port_of(*drives))


@contextmanager
def can_buses() -> Iterator[Callable[..., can.BusABC]]:
    """Yield a function that serves drives on a new CAN bus; all are closed at the end."""
    with ExitStack() as stack:
        yield lambda *drives: stack.enter_context(can_bus_of(*drives))


def drives_of(config: pytest.Config) -> list[Any]:
    """Return the drives of the options as parameters of tests. Raises pytest's UsageError."""
    arguments = arguments_of(config)
    try:
        found = targets.parse_all(arguments.drive, arguments.on)
    except ServotapError as error:
        raise pytest.UsageError(f"servotap: {error}") from None
    return [pytest.param(target, id=label(target, found)) for target in found]


@contextmanager
def connected(target: Target, config: pytest.Config) -> Iterator[Drive]:
    """Connect to a drive, with what the options allow; stop it at the end. What goes wrong fails the test in one line."""
    import servotap

    given = arguments_of(config)
    narrow(given, [target.named] if target.named is not None else [])
    try:
        drive = servotap.drive(
            target.text,
            target.on,
            allow=[word for each in given.allow for word in each.split(",")],
            max_speed=given.max_speed,
            max_turns=given.max_turns,
            max_acceleration=given.max_acceleration,
            max_current=given.max_current,
            subdivision=given.subdivision,
            alone=given.alone,
            max_run=given.max_run,
            cut_power=given.cut_power,
        )
    except ServotapError as error:
        pytest.fail(f"servotap: {error}", pytrace=False)
    try:
        yield drive
    finally:
        try:
            drive.close()
        except ServotapError as error:
            note(error, config)
            pytest.fail(f"servotap: {error}", pytrace=False)
