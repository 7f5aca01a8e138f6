"""Long CAN captures: `servotap decode` by columns beside its peers on the same frames, in the same run, as CPU seconds.

    python benchmarks/columns.py [--frames 1000000] [--rounds 3]

Two captures are made, each as candump lines, pcap and BLF: polls (four drives, five reads, values that the manual allows) and
plausible sessions (`captures/make.py`: polls, settings, motion). Each work is done by this program and by its peers:

- decode: tshark, which decodes no drive, and the plain script of `decode_peers.py`, which pairs nothing and reports nothing;
  the share of it that zstd takes for the same chunks; to Parquet: the same script, which writes tables through pandas
- reading alone, to frames: python-can's readers
- a filter over a log: a loop over the messages by `mcap` and `json`

CPU seconds count all processes of a command, and its start; Python finds modules compiled, as where they are installed, for all
programs alike. `decode` uses one process. A second table shows the gain of a second core, in seconds of the clock and by turns:
one process on one core, one on two, and two on two. The machine should be idle for it. One process gains by a second core, too,
for a thread of its own packs the log. So two processes are compared with one on one core.
"""

from __future__ import annotations

import argparse
import os
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

import can

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from analyzer import dialects  # noqa: E402
from analyzer.records import CanFrame  # noqa: E402
from analyzer.sources import open_source  # noqa: E402
from benchmarks.parts import unpack  # noqa: E402
from tests.columns.can_traffic import frames  # noqa: E402

POLLS = ("read_encoder_carry", "read_speed", "read_pulses", "read_position", "read_angle_error")
FILTER = 'command == "read_speed" and speed > 2990'
PLAIN = "from pathlib import Path; from benchmarks import decode_peers as peers; peers.{}(Path({!r}), Path({!r}))"
READ = "from benchmarks.parts import read; read({!r})"
READ_PEER = "import can; sum(1 for _ in can.LogReader({!r}))"
SHOW_PEER = "from benchmarks.parts import show; show({!r})"
PACK_PEER = "from benchmarks.parts import pack; pack({!r})"


def write(rows: Sequence[CanFrame], dump: Path, pcap: Path, blf: Path) -> None:
    """Write frames in all formats."""
    with dump.open("w") as text, pcap.open("wb") as records, can.BLFWriter(blf) as objects:
        records.write(struct.pack("<LHHlLLL", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 227))
        for row in rows:
            seconds, us = divmod((row.t_ns or 0) // 1000, 1_000_000)
            text.write(f"({seconds}.{us:06d}) can0 {row.id:03X}#{row.data.hex().upper()}\n")
            records.write(struct.pack("<LLLL", seconds, us, 16, 16) + struct.pack(">LB3x8s", row.id, len(row.data), row.data))
            objects.on_message_received(can.Message(seconds + us / 1e6, row.id, False, data=row.data))


def cpu(command: Sequence[str], cores: int | None = None) -> float:
    """Return the CPU seconds that a command takes. `cores`: how many it may use."""
    before, quiet = resource.getrusage(resource.RUSAGE_CHILDREN), subprocess.DEVNULL
    own = sorted(os.sched_getaffinity(0))[:cores]
    subprocess.run(command, check=True, stdout=quiet, stderr=quiet, cwd=ROOT, preexec_fn=lambda: os.sched_setaffinity(0, own))
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


#: Processes, and the cores that they may use.
RUNS = ((1, 1), (1, 2), (2, 2))


def gained(ours: Sequence[str], rounds: int) -> str:
    """Return a row of the second table: medians by the clock and as CPU of each run, and what the last gains against others."""
    clock: dict[tuple[int, int], list[float]] = {run: [] for run in RUNS}
    spent: dict[tuple[int, int], list[float]] = {run: [] for run in RUNS}
    for _ in range(rounds):
        for jobs, cores in RUNS:
            started = time.perf_counter()
            spent[jobs, cores].append(cpu([*ours, "--jobs", str(jobs)], cores))
            clock[jobs, cores].append(time.perf_counter() - started)
    *others, last = clock.values()
    ratios = [statistics.median(one / two for one, two in zip(other, last, strict=True)) for other in others]
    cells = [statistics.median(times[run]) for run in RUNS for times in (clock, spent)]
    return " | ".join(f"{cell:.2f}" for cell in (*cells, *ratios))


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    print("| capture | work | by | CPU s | times ours |\n| --- | --- | --- | --- | --- |")
    jobs = []
    # Where Python keeps no compiled modules, each start would compile all of them anew.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    with tempfile.TemporaryDirectory() as folder:
        session = Path(folder, "made.log")
        make = [sys.executable, str(ROOT / "captures" / "make.py"), "--frames", str(arguments.frames)]
        subprocess.run([*make, "-o", str(session), "--dialect", "mks-can"], check=True)
        captures = {
            "polls": list(frames(dialects.get("mks-can"), random.Random(5), arguments.frames, 0, 0, polls=POLLS)),
            "session": [item for item in open_source(str(session)) if isinstance(item, CanFrame)],
        }
        for name, rows in captures.items():
            files = [Path(folder, f"{name}.{end}") for end in ("log", "pcap", "blf", "mcap")]
            write(rows, *files[:3])
            commands_of = works(*map(str, files))
            cpu(commands_of["decode"]["servotap, pcap"])
            unpack(str(files[3]), f"{files[3]}.raw")
            for work, commands in commands_of.items():
                spent: dict[str, list[float]] = {by: [] for by in commands}
                # In turn, so that a drift of the machine's speed hits all.
                for _ in range(arguments.rounds):
                    for by, command in commands.items():
                        spent[by].append(cpu(command))
                own = statistics.median(next(iter(spent.values())))
                for by, times in spent.items():
                    taken = statistics.median(times)
                    print(f"| {name} | {work} | {by} | {taken:.2f} | {taken / own:.2f} |", flush=True)
            for by in ("servotap, pcap", "servotap, candump"):
                jobs.append(f"| {name} | {by} | {gained(commands_of['decode'][by], arguments.rounds)} |")
    heads = [f"{jobs} on {cores}{what}" for jobs, cores in RUNS for what in (", s", ", CPU s")]
    gains = [f"2 on 2 against {jobs} on {cores}" for jobs, cores in RUNS[:-1]]
    print("\n" + " | ".join(("| capture | by", *heads, *gains)) + " |\n|" + (2 + len(heads) + len(gains)) * " --- |")
    print(*jobs, sep="\n")


def works(dump: str, pcap: str, blf: str, log: str) -> dict[str, dict[str, list[str]]]:
    """Return the commands of each work, that of this program first."""
    python = [sys.executable, "-c"]
    servotap = [sys.executable, "-m", "analyzer"]
    decode = [*servotap, "decode", "--force", "--dialect", "mks-can", "--jobs", "1", "-o"]
    decoding = {
        "servotap, pcap": [*decode, log, pcap],
        "servotap, candump": [*decode, log, dump],
        "plain script, candump": [*python, PLAIN.format("plain_can", dump, f"{log}.plain")],
        "zstd alone, the same chunks": [*python, PACK_PEER.format(f"{log}.raw")],
    }
    if shutil.which("tshark"):
        shown = ["-e", "frame.time_epoch", "-e", "can.id", "-e", "data.data"]
        decoding["tshark -T json, pcap"] = ["tshark", "-r", pcap, "-T", "json"]
        decoding["tshark -T fields, pcap"] = ["tshark", "-r", pcap, "-T", "fields", *shown]
    return {
        "decode": decoding,
        "to Parquet": {
            "servotap, pcap": [*decode, f"{log}.parquet", "--to", "parquet", pcap],
            "servotap, candump": [*decode, f"{log}.parquet", "--to", "parquet", dump],
            "plain script with pandas, candump": [*python, PLAIN.format("plain_parquet", dump, f"{log}.tables")],
        },
        "read candump": {"servotap": [*python, READ.format(dump)], "python-can": [*python, READ_PEER.format(dump)]},
        "read BLF": {"servotap": [*python, READ.format(blf)], "python-can": [*python, READ_PEER.format(blf)]},
        "filter a log": {
            "servotap show": [*servotap, "show", log, "--filter", FILTER],
            "mcap and json": [*python, SHOW_PEER.format(log)],
        },
    }


if __name__ == "__main__":
    main()
