"""Run the claim of a stored failure again, and report whether it is fixed, failing, or flaky.

The file is one that `servotap test --failures FOLDER` wrote. Exit status: 20 not stopped, else 1 failing or flaky, else 10 a
fault of the rig (or no verdict), else 0: fixed.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Generator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from analyzer.cli.option_types import positive
from analyzer.errors import UnreadableError
from analyzer.values import quote
from conformance.claim import NotStopped, Outcome, RigFault, Verdict, worst
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
_SEED = re.compile(r"-?\d{1,40}")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("file", metavar="FILE", help="a stored failure")
    parser.add_argument("--drive", metavar="DRIVE", help="another drive than the file's")
    parser.add_argument("--on", metavar="ENDPOINT", help="another place than the file's")
    parser.add_argument("--times", type=positive, default=3, metavar="N", help="how often (default 3)")
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
    # A damaged file can make the library raise any exception.
    except Exception as error:
        raise UnreadableError(f"{path}: expected a stored failure (MCAP), got: {error}") from None
    if found is None:
        raise UnreadableError(f"{path}: expected a log that servotap test --failures wrote: it names no claim")
    missing = next((key for key in ("claim", "target") if not found.get(key)), None)
    if missing or not _SEED.fullmatch(found.get("seed") or "0"):
        told = f"no {missing}" if missing else f"the seed {quote(found['seed'])}"
        raise UnreadableError(f"{path}: expected a stored failure as servotap test --failures writes it, got {told}")
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
    verdicts: list[Verdict] = []
    trouble = 0
    try:
        with as_interrupt(), closing(_verdicts(plan, found, arguments.times)) as coming:
            verdicts += coming
    except (NotStopped, RigFault) as error:
        # What was judged before counts: a motor that turns above all, then a refutation, then the rig.
        print(f"servotap rerun: {error}")
        trouble = error.exit_status
    return worst(trouble, _judge(verdicts, about))


def _verdicts(plan: suite.Plan, found: target.Target, times: int) -> Generator[Verdict]:
    claims = plan.selected(found)
    if len(claims) != 1:
        raise UnreadableError(f"expected the name of one claim in the file, got one of {len(claims)}")
    (claim,) = claims
    rig = suite.open_rig(plan, found)
    try:
        for _ in range(times):
            yield engine.run_claim(claim, rig)
    finally:
        rig.close()


def _judge(verdicts: Sequence[Verdict], about: dict[str, str]) -> int:
    refuted, times = [v for v in verdicts if v.outcome is Outcome.REFUTED], len(verdicts)
    for verdict in refuted[:1]:
        same = "as before" if verdict.key == about.get("key") else "in another way than before"
        print(f"  refuted {same}: {verdict.reason}")
        for line in verdict.exchange.lines() if verdict.exchange is not None else ():
            print("  " + line)
    if refuted:
        print(f"failing: {times} of {times}" if len(refuted) == times else f"flaky: {len(refuted)} of {times} failed")
        return FAILING
    unjudged = [v for v in verdicts if v.outcome in (Outcome.INCONCLUSIVE, Outcome.NOT_RUN)]
    if unjudged or not verdicts:
        print(f"no verdict: {unjudged[0].reason if unjudged else 'none came'}")
        return RigFault.exit_status
    print(f"fixed: {times} of {times} hold")
    return 0
