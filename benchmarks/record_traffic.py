"""What the benchmarks of `servotap record` share: traffic at a full line, sent from processes of their own, and the recording.

    python benchmarks/record_traffic.py serial --fd N --dialect D --rate BYTES --seconds S --times FILE
    python benchmarks/record_traffic.py can --group G --port P --rate FRAMES --seconds S --times FILE

A sender keeps to absolute times and catches up after a delay. `--times` gets two unsigned 64-bit numbers for each write: the
total sent so far, and the time.
"""

from __future__ import annotations

import argparse
import bisect
import json
import os
import queue
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import tty
from contextlib import contextmanager, suppress
from itertools import accumulate
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from analyzer import dialects  # noqa: E402
from analyzer.catalogue import Role  # noqa: E402
from analyzer.encoder import build  # noqa: E402

STAMP = struct.Struct("<QQ")
#: Exchanges before the traffic begins anew.
CYCLE = 5_000
#: One microframe of USB: how often an adapter delivers at most.
TICK_S = 125e-6
#: A terminal of Linux takes so much at once.
MOST = 2048


def frames_of(name):
    """The frames of one cycle, requests and replies by turns, with values that change."""
    dialect = dialects.get(name)
    found = []
    for number in range(CYCLE):
        for command, values in (("read_position", {"position": number * 7}), ("read_speed", {"speed": number % 3000})):
            if name == "lk-rs485" and command == "read_speed":
                command, values = "read_single_turn", {"angle": number % 36000}
            found.append(build(dialect, command, 1, {}, Role.REQUEST))
            found.append(build(dialect, command, 1, values, Role.REPLY))
    return found


class Cycle:
    """Traffic without end, made of a cycle. `size`: of one cycle, in bytes (or frames of CAN)."""

    def __init__(self, name):
        self.frames = frames_of(name)
        self.data = b"".join(self.frames)
        self.size = len(self.data)
        self.ends = list(accumulate(map(len, self.frames)))

    def part(self, start, count):
        """`count` bytes from `start` on."""
        start %= self.size
        found = self.data[start : start + count]
        while len(found) < count:
            found += self.data[: count - len(found)]
        return found

    def whole(self, count):
        """At most `count` bytes that end with an exchange."""
        cycles, rest = divmod(int(count), self.size)
        index = bisect.bisect_right(self.ends, rest) // 2 * 2
        return cycles * self.size + (self.ends[index - 1] if index else 0)

    def frame(self, number):
        return self.frames[number % len(self.frames)]


def send_serial(arguments):
    cycle = Cycle(arguments.dialect)
    fd, rate = arguments.fd, arguments.rate
    os.set_blocking(fd, False)
    total = cycle.whole(rate * arguments.seconds)
    stamps = []
    sent = full = 0
    began = time.monotonic()
    late_most = 0.0
    while sent < total:
        # Whole exchanges, as a host sends them: on a busy machine this process may stand still at any moment, and a pause
        # inside a frame would end it.
        due = min(total, cycle.whole((time.monotonic() - began) * rate))
        if due > sent:
            late_most = max(late_most, (due - sent) / rate)
            try:
                sent += os.write(fd, cycle.part(sent, min(due, cycle.whole(sent + MOST)) - sent))
                stamps.append((sent, time.monotonic_ns()))
                continue
            except BlockingIOError:
                full += 1
        time.sleep(TICK_S)
    return {"sent": sent, "seconds": time.monotonic() - began, "late_most": late_most, "full": full}, stamps


def send_can(arguments):
    import msgpack

    cycle = Cycle("mks-can")
    ready = [
        msgpack.packb({"timestamp": 0.0, "arbitration_id": 1, "is_extended_id": False, "dlc": len(frame), "data": frame})
        for frame in cycle.frames
    ]
    total = int(arguments.rate * arguments.seconds) // 2 * 2
    place = (arguments.group, arguments.port)
    stamps = []
    sent = 0
    late_most = 0.0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 1)
        began = time.monotonic()
        while sent < total:
            due = min(total, int((time.monotonic() - began) * arguments.rate))
            late_most = max(late_most, (due - sent) / arguments.rate)
            while sent < due:
                out.sendto(ready[sent % len(ready)], place)
                sent += 1
                stamps.append((sent, time.monotonic_ns()))
            time.sleep(TICK_S * 4)
    return {"sent": sent, "seconds": time.monotonic() - began, "late_most": late_most, "full": 0}, stamps


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("kind", choices=("serial", "can"))
    parser.add_argument("--fd", type=int)
    parser.add_argument("--dialect", default="mks-rs485")
    parser.add_argument("--group", default="239.74.163.2")
    parser.add_argument("--port", type=int, default=43113)
    parser.add_argument("--rate", type=float, required=True)
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--times")
    arguments = parser.parse_args()
    about, stamps = (send_serial if arguments.kind == "serial" else send_can)(arguments)
    if arguments.times:
        Path(arguments.times).write_bytes(b"".join(STAMP.pack(*s) for s in stamps))
    print(json.dumps(about))


# --- the other side -------------------------------------------------------------------------------------------------------


def go_first(pid):
    """Let a process of a session of its own go before others, where that is allowed: on a machine that is busy otherwise."""
    with suppress(OSError):
        Path(f"/proc/{pid}/autogroup").write_text("-15")
        os.setpriority(os.PRIO_PROCESS, pid, -15)


class Sender:
    """A sender in a process of its own. `result`: what it said at its end."""

    def __init__(self, kind, *words, pass_fds=(), first=False):
        self.process = subprocess.Popen(
            [sys.executable, str(Path(__file__)), kind, *map(str, words)], stdout=subprocess.PIPE, text=True,
            pass_fds=pass_fds, start_new_session=True,
        )  # fmt: skip
        if first:
            go_first(self.process.pid)

    def wait(self, seconds=None):
        out, _ = self.process.communicate(timeout=seconds)
        self.result = json.loads(out)
        return self.result


@contextmanager
def pty_pair():
    master, slave = os.openpty()
    tty.setraw(slave)
    try:
        yield master, os.ttyname(slave)
    finally:
        os.close(slave)
        os.close(master)


def stamps_of(path):
    data = Path(path).read_bytes()
    return [STAMP.unpack_from(data, at) for at in range(0, len(data), STAMP.size)]


def cpu_seconds(pid):
    """Processor time of a process, all its threads: what the scheduler measured, not what the clock's ticks happened to see."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return sum(int((task / "schedstat").read_text().split()[0]) for task in tasks) / 1e9


def memory_bytes(pid):
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


class Recording:
    """`servotap record` with its processes watched; it listens to every bus when this is made.

    `counts`: its lines of counts; `end`: its last line.
    """

    def __init__(self, log, *words, first=False):
        self.log = Path(log)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "analyzer", "record", *words, "-o", str(log), "--json", "--force"],
            stdout=subprocess.PIPE, text=True, cwd=ROOT, start_new_session=True,
        )  # fmt: skip
        self.counts = []
        self.notes = []
        self.end = None
        self._listens = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        self._listens.get(timeout=30)
        self.processes = self._children()
        for pid in self.processes.values() if first else ():
            go_first(pid)
        #: Processor time by process, as last seen; memory, as seen again and again.
        self.cpu = {}
        self.memory = {}

    def _read(self):
        for line in self.process.stdout:
            found = json.loads(line)
            if found["event"] == "counts":
                self.counts.append(found)
                if all(bus["state"] == "listening" for bus in found["buses"]):
                    self._listens.put(found)
            elif found["event"] == "note":
                self.notes.append(found)
            elif found["event"] == "end":
                self.end = found

    def _children(self):
        """Its processes by what they are: supervisor, decoding, and the stem of each reader."""
        found = {"supervisor": self.process.pid}
        for entry in Path("/proc").iterdir():
            if not entry.name.isdigit():
                continue
            with suppress(OSError):
                if int((entry / "stat").read_text().rpartition(")")[2].split()[1]) == self.process.pid:
                    words = (entry / "cmdline").read_bytes().decode().split("\0")
                    reader = "analyzer.live.reader" in words
                    found[words[words.index("analyzer.live.reader") + 2] if reader else "decoding"] = int(entry.name)
        return found

    def look(self):
        """Note what each process has used so far; those that have ended stay as they were."""
        for name, pid in self.processes.items():
            with suppress(OSError, IndexError):
                self.cpu[name] = cpu_seconds(pid)
                # One that has just ended has none.
                self.memory.setdefault(name, []).append(memory_bytes(pid) or self.memory[name][-1])

    def watch(self, until, every=0.2):
        """Look again and again until `until()`; call what is given in between."""
        while not until():
            self.look()
            time.sleep(every)

    def finish(self, seconds=3600):
        """End it; the time that took."""
        began = time.monotonic()
        self.process.send_signal(signal.SIGINT)
        self.watch(lambda: self.process.poll() is not None or time.monotonic() - began > seconds, 0.02)
        self._thread.join(5)
        return time.monotonic() - began


def quantile(values, share):
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))] if ordered else float("nan")


if __name__ == "__main__":
    main()
