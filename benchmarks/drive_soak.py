#!/usr/bin/env python3
"""A soak: four emulated drives on one pseudo-terminal, polled as fast as they answer, with a log of it all.

    python benchmarks/drive_soak.py [--seconds 120] [--baud 115200] [--no-log] [--json]

The drives run in a process of their own (`servotap emulate`), with the times of the wire. The client asks each drive
in turn for speed, position, pulses and status. It checks every byte of a reply that does not depend on the time.
Passed (exit 0): no reply lost, late (2 s) or wrong; the memory of the drives' process grows by less than 2 MB from the
first quarter on; the log holds every request and every reply. (A log keeps an index of its chunks, one a second, until it
is finished: some kB a second with many topics.)
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import serial

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.encoder import build

ROOT = Path(__file__).resolve().parents[1]
_EMULATE = (
    "import sys; from analyzer.cli import _run; from conformance.cli import emulate;"
    "sys.exit(_run('emulate', emulate, sys.argv[1:]))"
)
DRIVES = 4
TIMEOUT_S = 2.0
GROWTH_KB = 2048
#: What is asked, and the values of the reply.
QUESTIONS: tuple[tuple[str, dict[str, int]], ...] = (
    ("read_speed", {}),
    ("read_position", {}),
    ("read_pulses", {}),
    ("read_status", {"status": 1}),
)


def memory_kb(process: int) -> int:
    """Return the resident memory of a process in kB."""
    for line in Path(f"/proc/{process}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1])
    return 0


def soak(seconds: float, baud: int, log: Path | None) -> dict[str, Any]:
    names = [f"mks-rs485@{i + 1},baud={baud}" for i in range(DRIVES)]
    process = subprocess.Popen(
        [sys.executable, "-c", _EMULATE, *names, "--pty", "--set", "work_mode=sr_vfoc",
         *(("--log", str(log)) if log else ())],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert process.stdout is not None
    place = process.stdout.readline().removeprefix("listening on ").strip()
    known = dialects.get("mks-rs485")
    pairs = [
        (build(known, name, address + 1), build(known, name, address + 1, values, Role.REPLY))
        for name, values in QUESTIONS
        for address in range(DRIVES)
    ]
    replies = lost = wrong = 0
    memory: list[int] = []
    slowest = 0.0
    with serial.Serial(place, baud, timeout=TIMEOUT_S) as port:
        start = time.monotonic()
        sampled = 0.0
        while (now := time.monotonic() - start) < seconds:
            if now - sampled >= seconds / 40:
                sampled = now
                memory.append(memory_kb(process.pid))
            request, reply = pairs[replies % len(pairs)]
            asked = time.perf_counter()
            port.write(request)
            data = port.read(len(reply))
            slowest = max(slowest, time.perf_counter() - asked)
            replies += 1
            lost += len(data) < len(reply)
            wrong += len(data) == len(reply) and data != reply
        used = sum(float(x) for x in Path(f"/proc/{process.pid}/stat").read_text().split()[13:15])
        took = time.monotonic() - start
    process.send_signal(signal.SIGTERM)
    _, told = process.communicate(timeout=60)
    settled = memory[len(memory) // 4 :] or [0]
    return {
        "seconds": took,
        "baud": baud,
        "replies": replies,
        "rate": replies / took,
        "lost": lost,
        "wrong": wrong,
        "slowest_ms": slowest * 1e3,
        "cpu_share": used / os.sysconf("SC_CLK_TCK") / took,
        "memory_kb": settled[-1],
        "growth_kb": max(settled) - settled[0],
        "logged": logged(log) if log else None,
        "status": process.returncode,
        "told": told.strip(),
    }


def logged(log: Path) -> int:
    """Return how many requests and replies stand in the log."""
    from mcap.reader import make_reader

    with log.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    counts = summary.statistics.channel_message_counts
    return sum(
        counts.get(channel.id, 0) for channel in summary.channels.values() if channel.topic.endswith(("/request", "/reply"))
    )


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=120.0, help="how long (default %(default)s)")
    parser.add_argument("--baud", type=int, default=115200, help="line speed (default %(default)s)")
    parser.add_argument("--no-log", action="store_true", help="without a log, whose index grows with its chunks")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        result = soak(options.seconds, options.baud, None if options.no_log else Path(folder) / "soak.mcap")
    passed = (
        result["lost"] == result["wrong"] == result["status"] == 0
        and result["growth_kb"] < GROWTH_KB
        and result["logged"] in (None, 2 * result["replies"])
    )
    result["passed"] = passed
    if options.json:
        print(json.dumps(result, indent=1))
    else:
        for name, value in result.items():
            print(f"{name:12} {value:.2f}" if isinstance(value, float) else f"{name:12} {value}")
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
