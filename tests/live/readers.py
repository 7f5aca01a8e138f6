"""One reader process by itself, for tests: what it is told, what it says, what it stores."""

from __future__ import annotations

import json
import os
import queue
import select
import signal
import socket
import subprocess
import sys
import threading

from analyzer.live.config import PortConfig, RecordingConfig
from analyzer.live.endpoint import parse
from analyzer.live.spool import RecordKind, SpoolReader
from tests import ROOT

STEM = "1-a"


def configure(folder, text):
    """Write the configuration of a recording of one endpoint."""
    endpoint = parse(text)
    port = PortConfig(stem=STEM, bus="a", endpoint=text, kind=endpoint.bus_kind, speed=endpoint.speed, byte_ns=endpoint.byte_ns)
    config = RecordingConfig(log=str(folder / "x.mcap"), ports=(port,), anchor_monotonic_ns=0, anchor_utc_ns=0)
    config.save(folder)


class ReaderProcess:
    """`python -m analyzer.live.reader`, with this process as its supervisor."""

    def __init__(self, folder, text, *words, pass_fds=(), wait="open"):
        self.folder = folder
        configure(folder, text)
        self.leash, theirs = socket.socketpair()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "analyzer.live.reader", str(folder), STEM, *words],
            stdin=theirs.fileno(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT, pass_fds=pass_fds,
        )  # fmt: skip
        theirs.close()
        self._queue = queue.SimpleQueue()
        threading.Thread(target=self._read, daemon=True).start()
        try:
            self.opened = self.wait_event(wait) if wait else None
        except BaseException:
            # One that goes on would open the port by its name, which by then is a port of another test.
            self.__exit__()
            raise

    def _read(self):
        for line in self.process.stdout:
            self._queue.put(json.loads(line))
        self._queue.put(None)

    def wait_event(self, name, seconds=15.0):
        while True:
            event = self._queue.get(timeout=seconds)
            assert event is not None, f"ended before {name!r}: {self.process.stderr.read().decode()}"
            if event["event"] == name:
                return event

    def handed_over(self):
        """The descriptor that it has given away."""
        ready, _, _ = select.select([self.leash], [], [], 10)
        assert ready
        return socket.recv_fds(self.leash, 10, 1)[1][0]

    def records(self):
        return list(SpoolReader(self.folder, STEM).read(1 << 30))

    def data(self):
        return b"".join(r.data for r in self.records() if r.kind == RecordKind.DATA)

    def frames(self):
        return [r.can for r in self.records() if r.kind == RecordKind.CAN]

    def events(self, name):
        return [r.event for r in self.records() if r.kind == RecordKind.EVENT and r.event["event"] == name]

    def end(self, number=signal.SIGTERM):
        """End it by a signal, or by letting go of it with `None`; the exit status."""
        if number is None:
            self.leash.close()
        else:
            self.process.send_signal(number)
        return self.process.wait(15)

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.process.kill()
        self.process.wait()
        self.leash.close()
        self.process.stderr.close()


def fill(fd, data):
    """Write all of it to a master whose terminal is being read."""
    os.set_blocking(fd, True)
    view = memoryview(data)
    while view:
        view = view[os.write(fd, view) :]
