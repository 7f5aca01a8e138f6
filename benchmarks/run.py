"""Run every benchmark once, with sizes that take some minutes on two cores.

    python benchmarks/run.py [--quick]

Absolute figures depend on the machine; compare the ratios to the peers of the same run.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent

#: Script, its arguments, its arguments with --quick.
RUNS = (
    ("decode_peers.py", ("--frames", "300000"), ("--frames", "30000", "--rounds", "1")),
    ("columns.py", ("--rounds", "1"), ("--frames", "30000", "--rounds", "1")),
    ("serial_columns.py", (), ("--frames", "20000", "--rounds", "1")),
    ("logic_levels.py", (), ("--samples", "4000000")),
    ("framing_noise.py", ("--frames", "100000"), ("--frames", "5000")),
    ("report.py", (), ("--frames", "20000")),
    ("diagnosis.py", (), ("--frames", "20000", "--rounds", "1")),
    ("drive_replies.py", (), ()),
    ("replay_drift.py", (), ("--seconds", "2")),
    ("drive_soak.py", ("--seconds", "120"), ("--seconds", "5")),
    ("record_rate.py", (), ("--seconds", "2")),
    ("record_soak.py", (), ("--seconds", "5")),
    ("tap_delay.py", (), ("--count", "200")),
    ("lake.py", (), ("--frames", "20000", "--files", "2", "--small", "10", "--rows", "300000")),
    ("mutation.py", (), ("--dialect", "mks-modbus", "--quick")),
)


def start_up() -> float:
    """Return the shortest of five times that `servotap --help` takes, in seconds."""
    times = []
    for _ in range(5):
        started = time.perf_counter()
        subprocess.run([sys.executable, "-m", "analyzer", "--help"], cwd=ROOT, check=True, capture_output=True)
        times.append(time.perf_counter() - started)
    return min(times)


def main() -> int:
    """Run the command line; return 1 if a benchmark failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small sizes: only whether everything runs")
    quick = parser.parse_args().quick
    print(f"servotap --help: {start_up():.3f} s\n", flush=True)
    failed = 0
    for name, full, small in RUNS:
        print(f"## {name}\n", flush=True)
        failed |= subprocess.run([sys.executable, str(HERE / name), *(small if quick else full)], cwd=ROOT).returncode
        print(flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
