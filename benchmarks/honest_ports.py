"""Honest drives over ports in real time: drawn as in `benchmarks.honest`, served by `servotap emulate`, and tested.

    python -m benchmarks.honest_ports [--drives 8] [--seed 1] [--stored 20] [--full]

Serial drives are on a pseudo-terminal, CAN drives behind an slcan adapter, with the guard of a real motor. Each test is the
short profile (90 s of line time). All is allowed, but for changes of the bit rate of CAN. `--full` runs all claims. The user
tells the settings that the drive cannot. Nothing may be refuted, but for a line that turns bits over, and every drive must be
stopped and put back; the exit status says so.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from analyzer.catalogue import Risk
from benchmarks.honest import STORED, drawn, of_its_line
from benchmarks.run_time import real, told
from conformance.claim import Outcome
from conformance.cli.test import REFUTED
from conformance.suite.plan import every_claim
from tests.conformance.drives.served import Bridge, Emulated

_BITRATE, _BAUD, _LK_BAUD = 500_000, 38_400, 115_200
_HERE = Path(__file__).parents[1]


@contextmanager
def served(drive: str, seed: int) -> Iterator[str]:
    """Serve an emulated drive in a process of its own; yield the endpoint by which it is reached."""
    if not drive.startswith("mks-can"):
        with Emulated(drive, "--pty", "--seed", str(seed)) as server:
            yield f"serial:{server.place},baud={_LK_BAUD if drive.startswith('lk') else _BAUD}"
        return
    bridge, options = Bridge(), f",bitrate={_BITRATE},sleep_after_open=0"
    try:
        with Emulated(drive, "--can", f"slcan:{bridge.paths[1]}{options}", "--seed", str(seed)):
            yield f"can:slcan:{bridge.paths[0]}{options}"
    finally:
        bridge.close()


def run(drive: str, seed: int, *options: str) -> tuple[int, Counter[str], list[str], str]:
    """Test a drive; return the exit status, the verdicts, what was refuted, and what else was said."""
    name, *words = drive.split(",")
    model = [word for word in words if word.startswith("model=")]
    target = ",".join([name, *model])
    held = told(real(target), "".join(f",{word}" for word in words if word not in model))
    with tempfile.TemporaryDirectory() as folder, served(drive, seed) as endpoint:
        settings = Path(folder) / "settings.json"
        settings.write_text(json.dumps(held))
        command = [sys.executable, "-m", "analyzer", "test", target, "--on", endpoint, "--settings", str(settings), "--json"]
        # What the settings of a drive hinder is no fault of the suite.
        command += ["--allow", _risks(drive), "--alone", "--max-inconclusive", "100%", *options]
        environment = os.environ | {"PYTHONPATH": str(_HERE)}
        done = subprocess.run(command, cwd=folder, env=environment, text=True, capture_output=True, check=False)
    rows = [row for row in map(json.loads, done.stdout.splitlines()) if "outcome" in row]
    counts = Counter(row["outcome"] for row in rows)
    claims = {claim.id: claim for claim in every_claim(real(target))}
    every = [row for row in rows if row["outcome"] == Outcome.REFUTED and not of_its_line(drive, claims[row["id"]])]
    refuted = [f"{row['id']}: {row['reason']} ({row['expected']}; {row['got']})" for row in every]
    return done.returncode, counts, refuted, done.stderr.strip()


def _risks(drive: str) -> str:
    """Return all that may be allowed. The other end of an slcan adapter does not follow when the host changes its bit rate."""
    without = {Risk.READ, Risk.LINK} if drive.startswith("mks-can") else {Risk.READ}
    return ",".join(sorted(risk.value for risk in Risk if risk not in without))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drives", type=int, default=8)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--stored", type=int, default=STORED, help="of a hundred settings, how many are not the usual ones")
    parser.add_argument("--full", action="store_true", help="all claims, not the short profile")
    arguments = parser.parse_args()
    guilty = 0
    for number in range(arguments.drives):
        drive, began = drawn(number, arguments.seed, arguments.stored), time.monotonic()
        status, counts, refuted, said = run(drive, arguments.seed + number, *([] if arguments.full else ["--short"]))
        left_alone = not refuted and status in (0, REFUTED)
        guilty += not left_alone
        shown = ", ".join(f"{count} {outcome}" for outcome, count in counts.most_common())
        print(f"{drive}\n    exit {status}; {shown}; {time.monotonic() - began:.0f} s", *refuted, sep="\n    ", flush=True)
        if not left_alone:
            print("    " + said.replace("\n", "\n    "), flush=True)
    print(f"{arguments.drives} honest drives on ports, {guilty} of them not left alone")
    return int(guilty > 0)


if __name__ == "__main__":
    sys.exit(main())
