"""The page of a long log: CPU seconds and memory of `servotap report`, and how large the page is.

    python benchmarks/report.py [--frames 1000000] [--drives 4]

The log is made once, of polls of drives that move. What is measured is the page alone, made from the log.
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from analyzer import dialects  # noqa: E402
from analyzer.catalogue import Role  # noqa: E402
from analyzer.codec import codec  # noqa: E402


def lines(frames: int, drives: int) -> Iterator[str]:
    """Yield candump lines of drives that are asked for their speed and position in turn, and sent a speed now and then."""
    dialect = dialects.get("mks-can")
    commands = {command.name: command for command in dialect.commands}
    t_us, sent, turn = 1_772_442_000_000_000, 0, 0
    while sent < frames:
        turn, address = turn + 1, 1 + turn % drives
        speed = int(300 * math.sin(t_us / 7e6 + address))
        order = {"direction": int(speed > 0), "speed": abs(speed), "acceleration": 20}
        exchanges = [("read_speed", {}, {"speed": speed}), ("read_encoder_carry", {}, {"carry": turn, "encoder": turn % 16384})]
        for name, asked, told in exchanges + [("run_speed", order, {"status": 1})] * (turn % 50 == 0):
            command = commands[name]
            for role, form, values in (
                (Role.REQUEST, command.request_forms[0], asked),
                (Role.REPLY, command.reply_forms[0], told),
            ):
                t_us += 400
                sent += 1
                data = dialect.link.build(command, form, address, codec(form.layout).encode(values), role)
                place = f"({t_us // 1_000_000}.{t_us % 1_000_000:06d})"
                yield f"{place} can0 {dialect.link.identifier(command, address):03X}#{data.hex().upper()}\n"


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--drives", type=int, default=4)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        capture, log, page = (Path(folder) / f"x.{end}" for end in ("log", "mcap", "html"))
        with capture.open("w") as stream:
            stream.writelines(lines(arguments.frames, arguments.drives))
        servotap = [sys.executable, "-m", "analyzer"]
        subprocess.run([*servotap, "decode", str(capture), "-o", str(log)], check=True, cwd=ROOT, stdout=subprocess.DEVNULL)
        command = [*servotap, "report", str(log), "-o", str(page)]
        process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL)
        _, status, used = os.wait4(process.pid, 0)
        assert status == 0
        print("frames | drives | CPU s | MiB | page MB")
        spent = used.ru_utime + used.ru_stime
        size = page.stat().st_size / 1e6
        print(f"{arguments.frames:,} | {arguments.drives} | {spent:.1f} | {used.ru_maxrss >> 10} | {size:.2f}")


if __name__ == "__main__":
    main()
