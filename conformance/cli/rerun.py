"""Run the claim of a stored failure again, and report whether it is fixed, failing, or flaky.

The file is one that `servotap test --failures FOLDER` wrote. Exit status: 0 fixed, 1 failing or flaky, 10 a fault of the rig.
"""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path
from typing import Any

from analyzer.errors import ServotapError, UnreadableError
from conformance.claim import NotStopped, Outcome, RigFault, Verdict
from conformance.gate.permissions import add_gate_arguments
from conformance.report.log import METADATA
from conformance.safety.signals import as_interrupt
from conformance.suite import engine, target
from conformance.suite import plan as suite
from conformance.suite.options import add_safety_arguments, plan_from

EXAMPLES = """\
examples:
  servotap rerun failures/mks-rs485_1-mks-rs485.shape.read_speed.answered.mcap
  servotap rerun failure.mcap --on serial:/dev/ttyUSB0,baud=38400 --times 10
  servotap rerun failure.mcap --on tcp:192.168.0.7:5000 --allow motion --max-speed 300
"""
FAILING = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("file", metavar="FILE", help="a stored failure")
    parser.add_argument("--drive", metavar="DRIVE", help="another drive than the file's")
    parser.add_argument("--on", metavar="ENDPOINT", help="another place than the file's")
    parser.add_argument("--times", type=int, default=3, metavar="N", help="how often (default 3)")
    add_safety_arguments(parser)
    add_gate_arguments(parser)


def stored(path: Path) -> dict[str, str]:
    """Return what a stored failure says of its claim. Raises UnreadableError for a file that is none."""
    from mcap.reader import make_reader

    try:
        with path.open("rb") as stream:
            found: Any = next((m.metadata for m in make_reader(stream).iter_metadata() if m.name == METADATA), None)
    except OSError as error:
        raise UnreadableError(f"{path}: {error.strerror or error}") from None
    # The library raises whatever a damaged file makes it stumble over.
    except Exception as error:
        raise UnreadableError(f"{path}: expected a stored failure (MCAP), got: {error}") from None
    if found is None:
        raise UnreadableError(f"{path}: expected a log that servotap test --failures wrote: it names no claim")
    return dict(found)


def run(arguments: argparse.Namespace) -> int:
    """Run it again; return the exit status."""
    path = Path(arguments.file)
    about = stored(path)
    place = arguments.on or about.get("on") or target.EMULATED
    found = target.parse(arguments.drive or about["target"], place)
    # A file never brings its own permission: what may be sent to a real drive is said here, or only reads are.
    plan = plan_from(arguments, (found,), claims=(about["claim"],), seed=int(about.get("seed") or 0))
    print(f"{about['claim']} on {found.text} ({place}), {arguments.times} times; it was: {about.get('reason', '')}")
    try:
        with as_interrupt():
            verdicts = _verdicts(plan, found, max(1, arguments.times))
    except (NotStopped, RigFault) as error:
        print(f"servotap rerun: {error}")
        return error.exit_status
    return _judge(verdicts, about)


def _verdicts(plan: suite.Plan, found: target.Target, times: int) -> list[Verdict]:
    (claim,) = plan.selected(found)
    rig = suite.open_rig(plan, found)
    try:
        return [engine.run_claim(claim, rig) for _ in range(times)]
    finally:
        rig.close()


def _judge(verdicts: list[Verdict], about: dict[str, str]) -> int:
    counts = Counter(v.outcome for v in verdicts)
    refuted, times = counts[Outcome.REFUTED], len(verdicts)
    for verdict in verdicts:
        if verdict.outcome is Outcome.REFUTED:
            same = "as before" if verdict.key == about.get("key") else "in another way than before"
            print(f"  refuted {same}: {verdict.reason}")
            for line in verdict.exchange.lines() if verdict.exchange is not None else ():
                print("  " + line)
            break
    if refuted == times:
        print(f"failing: {times} of {times}")
        return FAILING
    if refuted:
        print(f"flaky: {refuted} of {times} failed")
        return FAILING
    if counts[Outcome.INCONCLUSIVE] or counts[Outcome.NOT_RUN]:
        reason = next(v.reason for v in verdicts if v.outcome in (Outcome.INCONCLUSIVE, Outcome.NOT_RUN))
        raise ServotapError(f"no verdict: {reason}")
    print(f"fixed: {times} of {times} hold")
    return 0
