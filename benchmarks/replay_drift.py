"""How late the requests of a replay leave, whether delays add up, and the cost of the gate.

    python benchmarks/replay_drift.py [--seconds 10] [--rate 200]

Polls at a steady rate are replayed on a pseudo-terminal with an emulated drive behind it, in its own process. Each
request has its own planned time from the start; lateness is the delay against that time. Drift is the lateness of the last
tenth less that of the first. For comparison, a plain sender sleeps for the gap between two requests. The gate is measured on
reads that it has seen, and on new bytes.
"""

from __future__ import annotations

import argparse
import os
import random
import statistics
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from analyzer import dialects  # noqa: E402
from analyzer.catalogue import Role  # noqa: E402
from analyzer.encoder import build  # noqa: E402
from analyzer.live.endpoint import parse  # noqa: E402
from analyzer.pipeline import Pipeline  # noqa: E402
from analyzer.records import Chunk  # noqa: E402
from conformance.bus import open_line  # noqa: E402
from conformance.gate.gate import Allowance, Gate, Judge  # noqa: E402
from conformance.tools.replay import Replay  # noqa: E402
from conformance.tools.replay_plan import make_plan  # noqa: E402

MKS = dialects.get("mks-rs485")
READ = build(MKS, "read_speed", 1)
REPLY = build(MKS, "read_speed", 1, {}, Role.REPLY)


def quantile(values: list[int], share: float) -> float:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))] / 1e6


def report(name: str, late: list[int]) -> None:
    tenth = max(1, len(late) // 10)
    drift = statistics.median(late[-tenth:]) - statistics.median(late[:tenth])
    shares = ", ".join(f"{n} {quantile(late, s):.3f}" for n, s in (("p50", 0.5), ("p99", 0.99), ("max", 1.0)))
    print(f"{name:<24} late by {shares} ms; drift {drift / 1e6:+.3f} ms over {len(late)} requests")


def replayed(path: str, count: int, gap_ns: int) -> None:
    items = []
    for n in range(count):
        items.append(Chunk(n * gap_ns, "bus", READ, Role.REQUEST, True))
        items.append(Chunk(n * gap_ns + 2_000_000, "bus", REPLY, Role.REPLY, True))
    plan = make_plan(items, partial(Pipeline, (MKS,)))
    line = open_line(parse(f"serial:{path},baud=115200"))
    result = Replay(Gate(line, Allowance()), [MKS]).run(plan.steps)
    line.close()
    report("servotap replay", list(result.late_ns))
    print(f"{'':<24} {result.held} waited for a reply; {dict(sorted((m.value, c) for (_, m), c in result.matches.items()))}")


def slept(path: str, count: int, gap_ns: int) -> None:
    """Send, sleep for the gap, send: what most scripts do."""
    line = open_line(parse(f"serial:{path},baud=115200"))
    gate = Gate(line, Allowance())
    start_ns = time.monotonic_ns()
    late = []
    for n in range(count):
        late.append(time.monotonic_ns() - start_ns - n * gap_ns)
        gate.send(READ)
        time.sleep(gap_ns / 1e9)
        gate.receive(0)
    line.close()
    report("sleeping for the gap", late)


def gate_cost() -> None:
    judge = Judge(Allowance())
    rounds = 50_000
    started = time.perf_counter()
    for _ in range(rounds):
        judge.admit(READ)
    known = (time.perf_counter() - started) / rounds
    rng = random.Random(1)
    new = [rng.randbytes(12) for _ in range(2000)]
    started = time.perf_counter()
    for item in new:
        judge.interpret(item)
    unknown = (time.perf_counter() - started) / len(new)
    print(f"the gate: {known * 1e6:.2f} us for a read it has seen, {unknown * 1e6:.0f} us for 12 bytes that are new to it")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rate", type=float, default=200.0, help="requests a second")
    arguments = parser.parse_args()
    gap_ns = int(1e9 / arguments.rate)
    count = int(arguments.seconds * arguments.rate)
    link = f"/tmp/servotap-replay-{os.getpid()}"
    code = "import sys; from analyzer.cli import main; sys.exit(main(['emulate', *sys.argv[1:]]))"
    words = ["mks-rs485@1,baud=115200", "--pty", link]
    process = subprocess.Popen([sys.executable, "-c", code, *words], stdout=subprocess.PIPE, text=True, cwd=ROOT)
    try:
        assert process.stdout is not None
        process.stdout.readline()
        replayed(link, count, gap_ns)
        slept(link, count, gap_ns)
    finally:
        process.terminate()
        process.wait(10)
    gate_cost()


if __name__ == "__main__":
    main()
