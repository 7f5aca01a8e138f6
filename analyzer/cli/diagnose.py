"""Say what is wrong on a bus: the cause, the evidence and the next step.

At most three causes, the likeliest first. A capture with nothing wrong says so.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
from typing import Any

from analyzer.cli.reading import add_reading_arguments, open_reading, progress, tell_notes
from analyzer.cli.signals import Interrupt
from analyzer.diagnosis.diagnose import Diagnosis, diagnosis, lines
from analyzer.diagnosis.watch import Watch
from analyzer.errors import UnreadableError
from analyzer.values import printable

EXAMPLES = """\
exit status: 0 nothing wrong, or no cause found; 1 a cause was found; 2 wrong use, or a file that cannot be read.

examples:
  servotap diagnose capture.log
  servotap diagnose monday.log tuesday.log --json
  echo "> FA 01 F6 00 00 02 F9" | servotap diagnose -
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("files", nargs="+", metavar="FILE", help="captures and logs; - reads standard input")
    add_reading_arguments(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object per file")


def run(arguments: argparse.Namespace) -> int:
    """Diagnose each file; return 0, 1 for a cause that was found, 2 for a file that could not be read."""
    status = 0
    for path in arguments.files:
        try:
            names, found, notes = _diagnose(path, arguments)
        except UnreadableError as error:
            if arguments.json:
                print(json.dumps({"file": path, "dialect": None, "verdict": "unreadable", "causes": [], "why": str(error)}))
            else:
                print(f"servotap diagnose: {printable(str(error))}", file=sys.stderr)
            status = 2
            continue
        if arguments.json:
            print(json.dumps(_object(path, names, found) | {"notes": notes}))
        else:
            for line in [*lines(found), *_next(found)]:
                print(printable(line if len(arguments.files) == 1 else f"{path}: {line}"))
            tell_notes(notes)
        status = max(status, 1 if found.causes else 0)
    return status


def _next(found: Diagnosis) -> list[str]:
    """Return what to do where no cause is told, and something is wrong or nothing came."""
    if found.causes or found.verdict == "ok":
        return []
    if found.troubles:
        return ["   next: `servotap show FILE` marks each with !; record more traffic, of a program that talks to the drive"]
    return [
        "   next: Record while a program talks to the drive. If it does, look at the wires (A and B, CAN H and L), the ground "
        "and the rate"
    ]


def _diagnose(path: str, arguments: argparse.Namespace) -> tuple[str, Diagnosis, list[str]]:
    """Return the dialects, what is wrong, and what was concluded of the file or left out of it."""
    reading = open_reading(path, arguments)
    watch = Watch()
    with contextlib.closing(reading.source), Interrupt() as interrupt:
        pipeline = reading.pipeline([watch])
        with progress(reading.source, f"diagnosing {reading.source.name}"):
            for item in interrupt.items(reading):
                watch.take(item)
                pipeline.feed(item)
        pipeline.close()
    watch.uarts = frozenset(reading.source.uarts)
    return ",".join(d.name for d in reading.dialects), diagnosis(watch, reading.dialects), list(reading.source.notes)


def _object(path: str, dialect: str, found: Diagnosis) -> dict[str, Any]:
    return {"file": path, "dialect": dialect, "verdict": found.verdict, "causes": found.as_objects()}
