"""A hundred million samples of a logic analyzer: user CPU and memory of `servotap decode`, and what is found.

    python benchmarks/logic_levels.py [--samples 100000000]

Three captures, each in a process of its own: a UART line that is seldom busy, one that is always busy, and a CAN bus. Each
has seven other channels; one of them is a clock. The goal is ten seconds and 500 MiB.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tests.logic.waves import SECOND_NS, can, can_bits, samples, uart  # noqa: E402

RATE = 4_000_000
REQUEST, REPLY = bytes.fromhex("FA 01 30 2B"), bytes.fromhex("FB 01 30 00 00 00 01 20 00 4D")


def piece(name: str, count: int) -> np.ndarray:
    """Return some samples of eight channels, which are then repeated."""
    if name == "CAN, 500 kbit/s, half loaded":
        line = can([(n * 440e3, can_bits(1, bytes((0x31, 0, 0, 0, n & 255, 0x60)))) for n in range(600)], 500_000)[0]
    else:
        gap = 20e6 if "seldom" in name else 0
        baud = 115_200
        bit, at, rows = SECOND_NS / baud, 1e6, []
        for _ in range(150):
            for data in (REQUEST, REPLY):
                rows.append((at, data))
                at += (10 * len(data) + 4) * bit + gap
        line = uart(rows, baud)[0]
    words = samples([line], RATE)[:count]
    # A clock of a hundredth of the rate stands on another channel.
    clock = (np.arange(len(words)) // 50 & 1).astype(np.uint8) << 5
    return words | clock


def write(path: Path, name: str, count: int) -> None:
    """Write a session in the pieces that PulseView writes."""
    words = piece(name, count)
    block = np.tile(words, -(-(4 << 20) // len(words)))
    block = block[: len(block) // len(words) * len(words)]
    probes = "".join(f"probe{n + 1}=D{n}\n" for n in range(8))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("version", "2")
        archive.writestr(
            "metadata",
            f"[device 1]\ncapturefile=logic-1\ntotal probes=8\nsamplerate={RATE // 1_000_000} MHz\n{probes}unitsize=1\n",
        )
        left, number = count, 0
        while left:
            number += 1
            archive.writestr(f"logic-1-{number}", block[:left].tobytes())
            left -= min(left, len(block))


def main() -> None:
    """Measure each capture and print a row for it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=100_000_000)
    parser.add_argument("--write", nargs=2, metavar=("PATH", "NAME"), help="write one of the captures and end")
    arguments = parser.parse_args()
    count = arguments.samples
    if arguments.write:
        write(Path(arguments.write[0]), arguments.write[1], count)
        return
    print(f"{'capture':<32}{'file':>9}{'user CPU':>10}{'memory':>10}  result")
    for name in ("UART 115200, seldom busy", "UART 115200, always busy", "CAN, 500 kbit/s, half loaded"):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "x.sr"
            # In a process of its own: the memory of this one would count for those that it starts.
            subprocess.run([sys.executable, __file__, "--write", str(path), name, "--samples", str(count)], check=True)
            command = [sys.executable, "-m", "analyzer", "decode", str(path), "-o", f"{folder}/x.mcap", "--jobs", "1"]
            process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
            assert process.stdout is not None
            said = process.stdout.read()
            _, status, usage = os.wait4(process.pid, 0)
            lines = [line for line in said.splitlines() if " bytes: " in line or "UART" in line or "CAN at" in line]
            size = path.stat().st_size
        print(
            f"{name:<32}{size / 2**20:>5.1f} MiB{usage.ru_utime:>8.1f} s{usage.ru_maxrss / 1024:>6.0f} MiB  "
            + ("; ".join(line.strip() for line in lines) if status == 0 else f"failed: {status}")
        )


if __name__ == "__main__":
    main()
