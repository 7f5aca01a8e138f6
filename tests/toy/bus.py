"""The toy drive on a bus: on a line in virtual time, and behind an slcan adapter on a pseudo-terminal in real time."""

from __future__ import annotations

import os
import select
import threading
import time
import tty
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from analyzer.catalogue import Role
from analyzer.live import endpoint as endpoints
from analyzer.records import CanFrame
from conformance.bus.line import Line
from conformance.suite.plan import Plan
from conformance.suite.rig_real import RealRig
from conformance.suite.target import Target
from tests.toy.drive import ToyDrive

_PORT = "can:virtual:toy"


class ToyLine(Line):
    """A line to toy drives in virtual time; no emulated drive of the project is on it."""

    def __init__(self, drives: Sequence[ToyDrive]) -> None:
        self.drives = drives
        self.endpoint = endpoints.parse(_PORT)
        self._now_ns = 0

    def now_ns(self) -> int:
        return self._now_ns

    def write(self, item: bytes | CanFrame) -> int:
        assert isinstance(item, CanFrame)
        for drive in self.drives:
            drive.put(item, self._now_ns)
        return self._now_ns

    def receive(self, timeout_ns: int) -> CanFrame | None:
        until_ns = self._now_ns + timeout_ns
        ready = [(drive.next_ns, n) for n, drive in enumerate(self.drives) if drive.next_ns is not None]
        first_ns, number = min(ready, default=(until_ns + 1, 0))
        self._now_ns = max(self._now_ns, min(first_ns, until_ns))
        if first_ns > until_ns:
            return None
        frame = self.drives[number].take()
        return CanFrame(self._now_ns, self.endpoint.name, frame.id, frame.data, Role.REPLY)

    def set_speed(self, bits_per_second: int) -> None:
        raise AssertionError("no test changes the bit rate of a toy")

    def close(self) -> None:
        pass


class VirtualRig(RealRig):
    """The rig of a real drive, in virtual time."""

    def __init__(self, drive: ToyDrive, plan: Plan, target: Target) -> None:
        self._drive = drive
        super().__init__(plan, target)

    def _open_line(self) -> Line:
        return ToyLine([self._drive])


@contextmanager
def served(drive: ToyDrive) -> Iterator[str]:
    """Serve a toy drive behind an slcan adapter; yield the endpoint that a host opens."""
    master, slave = os.openpty()
    tty.setraw(master)
    tty.setraw(slave)
    ending, end = os.pipe()
    thread = threading.Thread(target=_serve, args=(drive, master, ending))
    thread.start()
    try:
        yield f"can:slcan:{os.ttyname(slave)},bitrate=500000,sleep_after_open=0"
    finally:
        os.write(end, b"x")
        thread.join(10)
        for descriptor in (master, slave, ending, end):
            os.close(descriptor)
        assert not thread.is_alive()


def _serve(drive: ToyDrive, port: int, ending: int) -> None:
    """Answer the data frames of 11 bits that come as lines of slcan, `tIIILDD...`, until the pipe `ending` has a byte."""
    buffer = b""
    while True:
        next_ns = drive.next_ns
        wait_s = None if next_ns is None else max(0.0, (next_ns - time.monotonic_ns()) / 1e9)
        ready, _, _ = select.select([port, ending], [], [], wait_s)
        if ending in ready:
            return
        if port in ready:
            *lines, buffer = (buffer + os.read(port, 4096)).split(b"\r")
            for line in lines:
                if line.startswith(b"t"):
                    frame = CanFrame(None, "toy", int(line[1:4], 16), bytes.fromhex(line[5:].decode()))
                    drive.put(frame, time.monotonic_ns())
        while drive.next_ns is not None and drive.next_ns <= time.monotonic_ns():
            reply = drive.take()
            os.write(port, f"t{reply.id:03X}{len(reply.data)}{reply.data.hex().upper()}\r".encode())
