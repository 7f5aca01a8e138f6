"""`servotap record` in processes of its own, for tests; and what it is given to listen to."""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
import tty
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from analyzer.live.spool import last_record, spool_folder, stems
from tests import ROOT
from tests.conformance.drives.served import wait_for

READY_S = 20.0


@contextmanager
def pty_pair():
    """A pseudo-terminal: the descriptor of its master, which plays the line, and the path that is recorded."""
    master, slave = os.openpty()
    tty.setraw(slave)
    try:
        yield master, os.ttyname(slave)
    finally:
        os.close(slave)
        with suppress(OSError):
            os.close(master)


@contextmanager
def small_disk(folder, size):
    """A disk of its own; yields what makes it larger. Only root may mount one."""
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)], capture_output=True)
    if mounted.returncode:
        pytest.skip("no small disk can be mounted here")
    try:
        yield lambda larger: subprocess.run(["mount", "-o", f"remount,size={larger}", str(folder)], check=True)
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def children_of(pid):
    """The processes that a process has started, by what stands on their command lines."""
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError, IndexError):
                # The name may hold blanks: what follows it is behind the last bracket.
                if int((entry / "stat").read_text().rpartition(")")[2].split()[1]) == pid:
                    found[int(entry.name)] = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
    return found


class Recorded:
    """The command in a process. `log`: what it writes; `lines`: what it said as JSON, so far."""

    def __init__(self, folder, *words, name="out.mcap", wait=True, command="record"):
        self.log = folder / name
        self.folder = spool_folder(self.log)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "analyzer", command, *words, "-o", str(self.log), "--json"],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
        )  # fmt: skip
        self.lines = []
        self.errors = ""
        self._queue = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        if wait:
            try:
                self.wait_line("begin", READY_S)
            except BaseException:
                self.process.kill()
                raise

    def _read(self):
        try:
            for line in self.process.stdout:
                self._queue.put(json.loads(line))
        finally:
            self._queue.put(None)

    def wait_line(self, event, seconds=10.0, text="", **about):
        """The next line of a kind with these values, and this in its text."""
        until = time.monotonic() + seconds
        while True:
            try:
                line = self._queue.get(timeout=max(0.01, until - time.monotonic()))
            except queue.Empty:
                raise AssertionError(f"no line {event!r} {text} {about}: {self.lines[-20:]}") from None
            if line is None:
                self.errors += self.process.stderr.read()
                raise AssertionError(f"ended without line {event!r} {about}: {self.lines} {self.errors}")
            self.lines.append(line)
            if line["event"] == event and text in line.get("text", "") and about.items() <= line.items():
                return line
            if time.monotonic() > until:
                raise AssertionError(f"no line {event!r} {text} {about}: {self.lines[-20:]}")

    def wait_note(self, text, seconds=10.0):
        """The next note with this in its text."""
        return self.wait_line("note", seconds, text)

    @property
    def pids(self):
        return [self.process.pid, *children_of(self.process.pid)]

    def pid_of(self, word):
        """The process with a word on its command line: the stem of a reader, or `recorder`."""
        return next(pid for pid, line in children_of(self.process.pid).items() if word in line)

    def count(self, stem=None):
        """Bytes and frames that the readers have stored so far."""
        total = 0
        for each in stems(self.folder) if self.folder.exists() else ():
            record = last_record(self.folder, each)
            if record is not None and each != "0-control" and (stem is None or each.startswith(stem)):
                total += record.before + record.units
        return total

    def wait_bytes(self, count, seconds=10.0):
        return wait_for(lambda: self.count() >= count, seconds)

    wait_records = wait_bytes

    def kill(self, number):
        self.process.send_signal(number)

    def end(self, number=signal.SIGINT, seconds=30.0):
        """End it; the exit status. The last line then is the end."""
        if number:
            self.kill(number)
        self._thread.join(seconds)
        status = self.process.wait(seconds)
        while (line := self._queue.get()) is not None:
            self.lines.append(line)
        self.errors += self.process.stderr.read()
        return status

    @property
    def summary(self):
        return self.lines[-1]

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        for pid in self.pids if self.process.poll() is None else ():
            with suppress(OSError):
                os.kill(pid, signal.SIGKILL)
        self.process.wait()
        self._thread.join(5)
        self.process.stdout.close()
        self.process.stderr.close()


def gone(*pids, seconds=10.0):
    """Wait until none of these processes is left."""

    def ended(pid):
        try:
            return (Path("/proc") / str(pid) / "stat").read_text().rpartition(")")[2].split()[0] == "Z"
        except OSError:
            return True

    return wait_for(lambda: all(ended(pid) for pid in pids), seconds)
