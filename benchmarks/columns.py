"""Long CAN captures: `servotap decode` by columns beside its peers on the same frames, in the same run, as CPU seconds.

    python benchmarks/columns.py [--frames 1000000] [--rounds 3]

Two captures are made, each as candump lines and as pcap: polls (four drives, five reads, values that the manual allows) and
plausible sessions (`captures/make.py`: polls, settings, motion). The peers: tshark, which decodes no drive, and the plain
script of `decode_peers.py`, which pairs nothing and reports nothing. CPU seconds count all processes of a command. A second
table has what `--jobs` gains: seconds of the clock by turns, for which the machine should have nothing else to do.
"""

from __future__ import annotations

import argparse
import random
import resource
import shutil
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from analyzer import dialects  # noqa: E402
from analyzer.records import CanFrame  # noqa: E402
from analyzer.sources import open_source  # noqa: E402
from tests.columns.can_traffic import frames  # noqa: E402

POLLS = ("read_encoder_carry", "read_speed", "read_pulses", "read_position", "read_angle_error")
SCRIPT = "from pathlib import Path; from benchmarks.decode_peers import plain_can; plain_can(Path({!r}), Path({!r}))"


def write(rows: Sequence[CanFrame], dump: Path, pcap: Path) -> None:
    """Write frames in both formats."""
    with dump.open("w") as text, pcap.open("wb") as records:
        records.write(struct.pack("<LHHlLLL", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 227))
        for row in rows:
            seconds, us = divmod((row.t_ns or 0) // 1000, 1_000_000)
            text.write(f"({seconds}.{us:06d}) can0 {row.id:03X}#{row.data.hex().upper()}\n")
            records.write(struct.pack("<LLLL", seconds, us, 16, 16) + struct.pack(">LB3x8s", row.id, len(row.data), row.data))


def cpu(command: Sequence[str]) -> float:
    """Return the CPU seconds that a command takes."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=ROOT)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def gained(ours: Sequence[str], rounds: int) -> str:
    """Return a row of the second table: medians of one process and of two, by the clock and as CPU, and of their ratios."""
    clock: dict[str, list[float]] = {"1": [], "2": []}
    spent: dict[str, list[float]] = {"1": [], "2": []}
    for _ in range(rounds):
        for jobs in clock:
            started = time.perf_counter()
            spent[jobs].append(cpu([*ours, "--jobs", jobs]))
            clock[jobs].append(time.perf_counter() - started)
    ratio = statistics.median(one / two for one, two in zip(*clock.values(), strict=True))
    cells = [statistics.median(times[jobs]) for jobs in clock for times in (clock, spent)]
    return " | ".join([*(f"{cell:.2f}" for cell in cells), f"{ratio:.2f}"])


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    print("| capture | by | CPU s | times ours |\n| --- | --- | --- | --- |")
    jobs, ends = [], ("candump", "pcap")
    with tempfile.TemporaryDirectory() as folder:
        session = Path(folder, "made.log")
        make = [sys.executable, str(ROOT / "captures" / "make.py"), "--frames", str(arguments.frames)]
        subprocess.run([*make, "-o", str(session), "--dialect", "mks-can"], check=True)
        captures = {
            "polls": list(frames(dialects.get("mks-can"), random.Random(5), arguments.frames, 0, 0, polls=POLLS)),
            "session": [item for item in open_source(str(session)) if isinstance(item, CanFrame)],
        }
        for name, rows in captures.items():
            dump, pcap, log = (Path(folder, f"{name}.{end}") for end in ("log", "pcap", "mcap"))
            write(rows, dump, pcap)
            ours = [sys.executable, "-m", "analyzer", "decode", "-o", str(log), "--force", "--dialect", "mks-can"]
            peers = {
                "servotap decode, candump": [*ours, str(dump)],
                "servotap decode, pcap": [*ours, str(pcap)],
                "servotap decode --to parquet, pcap": [
                    *ours,
                    "--to",
                    "parquet",
                    "-o",
                    str(log.with_suffix(".parquet")),
                    str(pcap),
                ],
                "plain script, candump": [sys.executable, "-c", SCRIPT.format(str(dump), str(log))],
            }
            if shutil.which("tshark"):
                shown = ["-e", "frame.time_epoch", "-e", "can.id", "-e", "data.data"]
                peers["tshark -T json, pcap"] = ["tshark", "-r", str(pcap), "-T", "json"]
                peers["tshark -T fields, pcap"] = ["tshark", "-r", str(pcap), "-T", "fields", *shown]
            spent: dict[str, list[float]] = {peer: [] for peer in peers}
            # In turn, so that a drift of the machine's speed hits all.
            for _ in range(arguments.rounds):
                for peer, command in peers.items():
                    spent[peer].append(cpu(command))
            own = statistics.median(spent["servotap decode, pcap"])
            for peer, times in spent.items():
                taken = statistics.median(times)
                print(f"| {name} | {peer} | {taken:.2f} | {taken / own:.1f} |", flush=True)
            jobs += [f"| {name}, {end} | {gained(peers[f'servotap decode, {end}'], arguments.rounds)} |" for end in ends]
    print("\n| capture | one process, s | its CPU s | two, s | their CPU s | times as fast |\n|" + 6 * " --- |")
    print(*jobs, sep="\n")


if __name__ == "__main__":
    main()
