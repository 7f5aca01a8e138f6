#!/usr/bin/env python3
"""How much later a byte arrives because `servotap tap` stands between: p50, p99 and the longest, each way.

    python benchmarks/tap_delay.py [--count N] [--rate R] [--size BYTES] [--json]

Two pseudo-terminals: the program's, which the tap offers, and the adapter's, whose other end plays the drive in a process of
its own. The program sends with the time of sending, the drive answers at once with the times of arrival and of answering: two
one-way delays for each exchange, all on one clock. The same is measured over one pseudo-terminal without a tap; what is left is
the added delay. The tap records and decodes meanwhile, as it would for a user. Both ends run before other processes where that
is allowed (root), so that a busy machine does not count as theirs; elsewhere all figures grow with its load, those without
the tap too.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import signal
import statistics
import struct
import subprocess
import sys
import tempfile
import time
import tty
from contextlib import contextmanager, suppress
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
READY_S = 30.0
#: Time of sending (or of arrival), time of answering.
STAMPS = struct.Struct("<QQ")
WARM_UP = 50


def go_first():
    """Run before usual processes, this one and not its children, where that is allowed."""
    with suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(2))


def read_exactly(fd, count, seconds=5.0):
    """Read a whole message."""
    data = b""
    while len(data) < count:
        if not select.select([fd], [], [], seconds)[0]:
            raise TimeoutError(f"{len(data)} of {count} bytes came")
        data += os.read(fd, count - len(data))
    return data


def play_the_drive(fd, size):
    """Answer each message of `size` bytes with when it came and when that was said."""
    go_first()
    fill = bytes(size - STAMPS.size)
    while True:
        read_exactly(fd, size, None)
        came = time.monotonic_ns()
        os.write(fd, STAMPS.pack(came, time.monotonic_ns()) + fill)


@contextmanager
def drive(size):
    """A process that plays the drive; yield the path of its port."""
    master, slave = os.openpty()
    tty.setraw(slave)
    pid = os.fork()
    if not pid:
        try:
            play_the_drive(master, size)
        finally:
            os._exit(0)
    try:
        yield os.ttyname(slave)
    finally:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        os.close(slave)
        os.close(master)


@contextmanager
def tapped(path, size):
    """The tap, and the path that it offers."""
    with tempfile.TemporaryDirectory() as folder:
        port = f"{folder}/port"
        process = subprocess.Popen(
            [sys.executable, "-m", "analyzer", "tap", f"serial:{path},baud=115200", "--link", port,
             "-o", f"{folder}/log.mcap", "--json"],
            cwd=ROOT, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        try:
            line = process.stdout.readline()
            if '"begin"' not in line:
                raise RuntimeError(f"the tap did not begin: {line}")
            yield port
        finally:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=READY_S)


def exchanges(path, count, rate, size):
    """Return the delays there and back, in us."""
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd)
    there, back = [], []
    due = time.monotonic()
    try:
        for n in range(count + WARM_UP):
            time.sleep(max(0.0, due - time.monotonic()))
            due += 1 / rate
            sent = time.monotonic_ns()
            os.write(fd, STAMPS.pack(sent, 0) + bytes(size - STAMPS.size))
            came, said = STAMPS.unpack_from(read_exactly(fd, size))
            got = time.monotonic_ns()
            if n >= WARM_UP:
                there.append((came - sent) / 1000)
                back.append((got - said) / 1000)
    finally:
        os.close(fd)
    return there, back


def figures(delays):
    """Return p50, p99 and the longest."""
    ordered = sorted(delays)
    return {
        "p50": round(statistics.median(ordered), 1),
        "p99": round(ordered[int(0.99 * (len(ordered) - 1))], 1),
        "max": round(ordered[-1], 1),
    }


def measure(count, rate, size):
    """Return the figures of each way, without the tap and with it, and the difference of each."""
    with drive(size) as path:
        direct = exchanges(path, count, rate, size)
    with drive(size) as path, tapped(path, size) as port:
        through = exchanges(port, count, rate, size)
    result = {}
    for name, plain, tap in zip(("program to drive", "drive to program"), direct, through, strict=True):
        without, with_tap = figures(plain), figures(tap)
        added = {key: round(with_tap[key] - without[key], 1) for key in without}
        result[name] = {"without": without, "with": with_tap, "added": added}
    return result


def main():
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=5000, help="exchanges (default 5000)")
    parser.add_argument("--rate", type=float, default=200.0, help="of them a second (default 200)")
    parser.add_argument("--size", type=int, default=20, help="bytes each way, 16 or more (default 20)")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    go_first()
    result = measure(arguments.count, arguments.rate, max(arguments.size, STAMPS.size))
    if arguments.json:
        print(json.dumps(result))
        return 0
    print(f"{arguments.count} exchanges of {arguments.size} bytes each way, {arguments.rate:g} a second; times in us")
    for name, rows in result.items():
        for what, row in rows.items():
            label = "added delay" if what == "added" else f"{what} tap"
            print(f"{name:18} {label:12} p50 {row['p50']:8.1f}   p99 {row['p99']:8.1f}   max {row['max']:9.1f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
