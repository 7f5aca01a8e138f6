"""Emulated drives on real ports, for tests: in a thread of this process, or by the `emulate` command in another one."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType

from analyzer.live.reader_port import Stop
from conformance.bus.can_port import CanPort
from conformance.drives import make
from conformance.drives.can_bus import CanBus
from conformance.drives.drive import Drive
from conformance.drives.serial_bus import SerialBus
from conformance.serve import can as can_server
from conformance.serve import serial_server
from conformance.serve.clock import Clock
from conformance.serve.pty import PtyPort
from conformance.serve.serial_server import SerialPort

READY_S = 30.0
_MAIN = (
    "import sys; from analyzer.cli import _run; from conformance.cli import emulate;"
    "sys.exit(_run('emulate', emulate, sys.argv[1:]))"
)


def drives(*texts: str, reply_delay_ns: int | None = None) -> list[Drive]:
    return [make.make(make.parse(text), reply_delay_ns=reply_delay_ns) for text in texts]


@contextmanager
def _threaded(serve: Callable[[Stop], None]) -> Iterator[None]:
    stop = Stop()
    failed: list[BaseException] = []

    def run() -> None:
        try:
            serve(stop)
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        stop.ask("the test is over")
        thread.join(10)
        stop.close()
    assert not thread.is_alive()
    if failed:
        raise failed[0]


@contextmanager
def on_port(bus: SerialBus, port: SerialPort, clock: Clock | None = None) -> Iterator[str]:
    """Serve a bus on a port; yield what clients open. `clock`: one for several ports in turn, as the drives have one time."""
    try:
        with _threaded(lambda stop: serial_server.serve(bus, port, clock or Clock(), stop)):
            yield port.name
    finally:
        port.close()


@contextmanager
def on_pty(*texts: str, reply_delay_ns: int | None = None) -> Iterator[str]:
    """Serve drives on a pseudo-terminal; yield its path."""
    bus = SerialBus(drives(*texts, reply_delay_ns=reply_delay_ns))
    with on_port(bus, PtyPort(speed=bus.stations[0].speed)) as path:
        yield path


class LoggedPty(PtyPort):
    """A pseudo-terminal that keeps every byte that clients write. `bus`: the drives behind it."""

    def __init__(self, bus: SerialBus) -> None:
        super().__init__(speed=bus.stations[0].speed)
        self.bus = bus
        self.heard = b""

    def read(self, ready: Sequence[int]) -> bytes:
        data = super().read(ready)
        self.heard += data
        return data

    def take(self) -> bytes:
        """Return what was written since the last call."""
        data, self.heard = self.heard, b""
        return data

    @property
    def on(self) -> str:
        """What clients open."""
        return f"serial:{self.path},baud={self.bus.stations[0].speed}"


@contextmanager
def on_logged_pty(*texts: str, patient: bool = False) -> Iterator[LoggedPty]:
    """Serve drives on a pseudo-terminal that logs. `patient`: they keep the beginning of a frame for any time."""
    bus = SerialBus(drives(*texts))
    if patient:
        for receiver in bus._receivers:
            receiver.pause_ns = 1 << 62
    with on_port(bus, port := LoggedPty(bus)):
        yield port


@contextmanager
def on_can(bus: CanBus, port: CanPort) -> Iterator[None]:
    """Serve a bus on a python-can interface."""
    try:
        with _threaded(lambda stop: can_server.serve(bus, port, Clock(), stop)):
            yield
    finally:
        port.close()


class Emulated:
    """The `emulate` command in a process of its own. `place`: what it says it listens on."""

    def __init__(self, *arguments: str) -> None:
        root = Path(__file__).parents[3]
        environment = os.environ | {"PYTHONPATH": str(root)}
        self.process = subprocess.Popen(
            [sys.executable, "-c", _MAIN, *arguments],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment,
        )  # fmt: skip
        assert self.process.stdout is not None
        ready, _, _ = select.select([self.process.stdout], [], [], READY_S)
        line = self.process.stdout.readline() if ready else ""
        if not line.startswith("listening on "):
            self.process.kill()
            out, err = self.process.communicate()
            raise AssertionError(f"not ready: {line}{out}{err}")
        self.place = line.removeprefix("listening on ").strip()

    def end(self, number: int = signal.SIGTERM) -> tuple[int, str]:
        """Send a signal; return the exit status and what stands on standard error."""
        self.process.send_signal(number)
        _, err = self.process.communicate(timeout=20)
        return self.process.returncode, err

    def __enter__(self) -> Emulated:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()


class Bridge:
    """Two pseudo-terminals joined like a null-modem cable: what is written to one is read from the other."""

    def __init__(self) -> None:
        self._ends = [PtyPort(), PtyPort()]
        self.paths = [end.path for end in self._ends]
        self._stop = Stop()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        masters = [end.descriptors()[0] for end in self._ends]
        while not self._stop.asked:
            ready, _, _ = select.select([*masters, self._stop.fileno()], [], [])
            for here, there in ((0, 1), (1, 0)):
                if masters[here] in ready:
                    self._ends[there].write(self._ends[here].read(ready))

    def close(self) -> None:
        self._stop.ask("the test is over")
        self._thread.join(5)
        self._stop.close()
        for end in self._ends:
            end.close()


def read_from(fd: int, count: int, seconds: float = 5.0) -> bytes:
    """Read exactly that many bytes, or what came within the time."""
    data = b""
    deadline = time.monotonic() + seconds
    while len(data) < count and select.select([fd], [], [], max(0.0, deadline - time.monotonic()))[0]:
        data += os.read(fd, count - len(data))
    return data


def wait_for(condition: Callable[[], bool], seconds: float = 5.0) -> bool:
    """Wait until something outside this process is so. It never looks for longer than it leaves the processor to others."""
    deadline = time.monotonic() + seconds
    while (begun := time.monotonic()) < deadline:
        if condition():
            return True
        time.sleep(max(0.005, time.monotonic() - begun))
    return condition()
