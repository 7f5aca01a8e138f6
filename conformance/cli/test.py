"""Test drives, real or emulated, against their manual: run every claim that can be tested.

Without a drive, emulated drives of all dialects are tested. On hardware only reads are sent unless --allow opens more.
Exit status, the first that applies: 2 wrong use; 20 not stopped; 1 refuted; 10 a fault of the rig (port lost, setting not
put back, no verdict, too many inconclusive verdicts); 0 none of these.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from analyzer.cli.option_types import number
from analyzer.cli.output import apart
from analyzer.cli.reading import now_text
from analyzer.cli.signals import ended_status
from analyzer.errors import ServotapError, UsageError
from analyzer.live import profile
from analyzer.values import counted
from conformance.claim import NotStopped, Outcome, RigFault, worst
from conformance.cli.endpoint import say_rate
from conformance.gate.permissions import add_gate_arguments
from conformance.report import check_places, write_reports
from conformance.safety.signals import as_interrupt
from conformance.suite import plan as suite
from conformance.suite import target
from conformance.suite.options import add_safety_arguments, add_verdict_arguments, plan_from
from conformance.suite.order import SHORT_SECONDS
from conformance.suite.record import RunRecord, VerdictRecord, doubt_about

if TYPE_CHECKING:
    from conformance.report.baseline import Deviation
    from conformance.suite.plan import Plan

EXAMPLES = """\
examples:
  servotap test                                            all dialects, emulated
  servotap test mks-rs485@1 --on serial:/dev/ttyUSB0,baud=38400            reads only
  servotap test mks-can@1,model=57E --on can:socketcan:can0 --allow setting,motion --max-speed 300 --max-turns 2
  servotap test mks-rs485@1,fault=late-reply --theme timing --theme shape
  servotap test --claim 'mks-rs485/shape/*' --report out.html --log out.mcap
  servotap test lk-rs485@1 --on tcp:192.168.0.7:5000 --dry-run
  servotap test --list --theme motion
  servotap test arm --short                                a drive of a profile, servotap.toml (see servotap init)
"""
#: Exit status of a run in which a drive was refuted.
REFUTED = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "drives", nargs="*", metavar="DRIVE", help="DIALECT@ADDRESS[,model=M] or a name; emulated: quirks, faults"
    )
    parser.add_argument(
        "--on", action="append", default=[], metavar="ENDPOINT",
        help="where: serial:PORT,baud=N, tcp:HOST:PORT, can:INTERFACE:CHANNEL,bitrate=N, or emulated (default)",
    )  # fmt: skip
    add_gate_arguments(parser)
    parser.add_argument("--theme", action="append", default=[], metavar="T", help="only this theme; may be repeated")
    parser.add_argument("--claim", action="append", default=[], metavar="ID", help="only these claims; * and ? are patterns")
    parser.add_argument("--short", action="store_true", help="the most telling claims, as many as fit into 90 s of the line")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of random values (default 0)")
    processes = number("processes from 1 on", int, lambda count: count > 0)
    parser.add_argument(
        "--jobs", type=processes, default=0, metavar="N", help="processes for emulated drives (default: all cores)"
    )
    add_safety_arguments(parser)
    add_verdict_arguments(parser)
    parser.add_argument("--dry-run", action="store_true", help="print all that would be sent, and send nothing")
    parser.add_argument("--list", action="store_true", help="list the claims and what they need")
    parser.add_argument("--mutants", action="store_true", help="run against every named fault: which claim refutes which")
    parser.add_argument("--report", metavar="OUT.html", help="one self-contained page")
    parser.add_argument("--junitxml", metavar="OUT.xml", help="verdicts for CI")
    parser.add_argument("--log", metavar="OUT.mcap", help="all traffic, with a /tests topic")
    parser.add_argument("--failures", metavar="FOLDER", help="a small log of each refuted claim, for servotap rerun")
    parser.add_argument("--baseline", metavar="FILE", help="accept the deviations listed there")
    parser.add_argument("--write-baseline", metavar="FILE", help="write the refuted claims as a baseline")
    parser.add_argument("--force", action="store_true", help="replace a log that exists, or another file in place of a report")
    parser.add_argument("--json", action="store_true", help="one JSON object a verdict, then one of the run")


#: Reasons that are printed for why claims could not be chosen.
_MOST_REASONS = 3


def run(arguments: argparse.Namespace) -> int:
    """Test; return the exit status."""
    check_places(vars(arguments), force=arguments.force)
    apart(arguments, "baseline", "settings", "journal", "log", "report", "junitxml")
    apart(arguments, "settings", "journal", "log", "report", "junitxml", "write_baseline")
    plan = plan_of(arguments)
    if arguments.list:
        return _list(plan)
    if arguments.mutants:
        from conformance.tools.mutants import run_mutants

        return run_mutants(plan, jobs=arguments.jobs or os.cpu_count() or 1, as_json=arguments.json)
    known = None
    if arguments.baseline:
        from conformance.report import baseline

        # Before the run: a file that cannot be read must not cost the time of one.
        known = baseline.load(Path(arguments.baseline))
    if arguments.dry_run:
        from conformance.suite.dry_run import dry_run

        return dry_run(plan)
    return _test(plan, arguments, known)


def plan_of(arguments: argparse.Namespace) -> Plan:
    """Return what the command line asks for. Raises UsageError for what does not fit together."""
    targets = target.parse_all(arguments.drives, arguments.on)
    places = [profile.endpoint(place).text for place in arguments.on if place != target.EMULATED]
    places += [named.endpoint.text for drive in arguments.drives if (named := profile.look_up(drive)) is not None]
    for each in targets:
        if each.endpoint is not None and each.endpoint.text not in places:
            say_rate(each.endpoint, each.dialect, "")
    return plan_from(
        arguments,
        targets,
        claims=arguments.claim,
        themes=arguments.theme,
        seed=arguments.seed,
        dry_run=arguments.dry_run,
        traffic=bool(arguments.log),
        short=arguments.short,
    )


def _list(plan: Plan) -> int:
    for each in plan.targets:
        for claim in plan.selected(each):
            needs = ",".join(sorted(risk.value for risk in claim.risks)) or "read"
            more = " alone" * claim.alone + " by-name" * claim.by_name + " emulated" * claim.emulated
            print(f"{claim.id}\n    {claim.statement}  [{claim.section}, {claim.certainty}]  needs {needs}{more}")
    return 0


def _test(plan: Plan, arguments: argparse.Namespace, known: list[Deviation] | None) -> int:
    started = time.monotonic()
    jobs = arguments.jobs or os.cpu_count() or 1
    records: list[VerdictRecord] = []
    trouble: ServotapError | None = None
    stopped = False
    unprinted: OSError | None = None
    total = sum(len(plan.selected(each)) for each in plan.targets)
    began = now_text()
    # A run that is left is closed at once: what moves is stopped, and what that reports must not get lost.
    with as_interrupt(), _progress(plan) as advance:
        try:
            with closing(suite.run(plan, jobs)) as verdicts:
                for each in verdicts:
                    records.append(each)
                    advance(each)
                    if arguments.json:
                        _print_json(each)
        except KeyboardInterrupt:
            stopped = True
        except BrokenPipeError as error:
            stopped, unprinted = True, error
        except ServotapError as error:
            if not records and not isinstance(error, (NotStopped, RigFault)):
                raise
            trouble = error
            stopped = isinstance(error.__context__, (KeyboardInterrupt, BrokenPipeError))
    done = _run_record(plan, began, time.monotonic() - started, stopped, trouble)
    status = _status(records, arguments, trouble)
    refused = write_reports(records, done, vars(arguments), force=arguments.force)
    try:
        if arguments.json:
            _print_json(done)
        else:
            _show(records, done, max(total, len(records)), over=plan.short and trouble is None and not stopped)
            _show_left_out(plan)
    except OSError as error:
        # What was judged, and whether a motor stands, counts more than that it could not be printed.
        unprinted = error
    if known is not None:
        status = worst(status, _baseline(records, known, arguments.baseline))
    if arguments.write_baseline and "write_baseline" not in refused:
        print(f"{arguments.write_baseline}: {sum(r.refuted for r in records)} deviations", file=sys.stderr)
    for reason in refused.values():
        status = worst(status, UsageError.exit_status)
        print(f"servotap test: {reason}", file=sys.stderr)
    if trouble is not None:
        print(f"servotap test: {trouble}", file=sys.stderr)
    if stopped:
        print(f"servotap test: stopped after {len(records)} of {total} claims", file=sys.stderr)
        if trouble is None and status != REFUTED and unprinted is None:
            return ended_status()
    if unprinted is not None and not status:
        raise unprinted
    return status


def _status(records: Sequence[VerdictRecord], arguments: argparse.Namespace, trouble: ServotapError | None) -> int:
    found = [REFUTED] if any(r.refuted for r in records) and not arguments.baseline else []
    if trouble is not None:
        found.append(trouble.exit_status)
    doubt = doubt_about(records, arguments.max_inconclusive)
    if doubt:
        print(f"servotap test: {doubt}", file=sys.stderr)
        found.append(RigFault.exit_status)
    return worst(*found, 0)


def _baseline(records: Sequence[VerdictRecord], known: list[Deviation], name: str) -> int:
    from conformance.report import baseline

    compared = baseline.compare(records, known)
    for new in compared.new:
        print(f"new: {new.id}: {new.reason}", file=sys.stderr)
    for fixed in compared.fixed:
        print(f"fixed: {fixed.claim} ({fixed.target}) holds now: take it out of {name}", file=sys.stderr)
    for missing in compared.missing:
        print(f"not looked at: {missing.claim} ({missing.target}) has no verdict in this run", file=sys.stderr)
    print(
        f"baseline: {len(compared.known)} known, {len(compared.new)} new, {len(compared.fixed)} fixed, "
        f"{len(compared.missing)} not looked at",
        file=sys.stderr,
    )
    return REFUTED if compared.fails else 0


def _run_record(plan: Plan, began: str, elapsed: float, stopped: bool, trouble: ServotapError | None) -> RunRecord:
    notes = ["stopped by the user"] * stopped + [str(trouble)] * (trouble is not None)
    return plan.run_record(began, elapsed, ["servotap", *sys.argv[1:]], notes)


def _print_json(each: VerdictRecord | RunRecord) -> None:
    import msgspec

    shown = msgspec.to_builtins(each)
    shown.pop("traffic", None)
    print(msgspec.json.encode(shown).decode(), flush=True)


def _show(records: Sequence[VerdictRecord], run_record: RunRecord, total: int, *, over: bool) -> None:
    """Print what was found. `over`: claims without a verdict are those for which a short run had no time."""
    from analyzer.cli.console import Console
    from conformance.report import terminal

    if not records:
        return
    width = None if sys.stdout.isatty() else 160
    terminal.show(records, run_record, Console(width=width))
    ran = sum(record.outcome != Outcome.NOT_RUN for record in records)
    left = f", {total - ran} not run" if ran < total else ""
    if over and len(records) < total:
        left += f", {total - len(records)} of them since the {SHORT_SECONDS:g} s of a short run were over"
    print(f"{ran} of {total} claims ran in {run_record.seconds:.1f} s{left}")


def _show_left_out(plan: Plan) -> None:
    """Print what the user could give so that a short run has more claims to choose from."""
    for each in plan.targets:
        for lacks, count in plan.left_out(each).most_common(_MOST_REASONS):
            print(f"{each.text}: {counted(count, 'claim')} could not be chosen: {lacks}")


class _Advance:
    """What is called for each verdict; does nothing where there is no terminal."""

    def __call__(self, each: VerdictRecord) -> None:
        """Take a verdict."""


def time_left(planned: float, done: float, elapsed: float) -> float:
    """Return how many seconds of a run are left, of those that were planned: as much slower as it was until now."""
    return max(0.0, planned - done) * (elapsed / done if done > 0 else 1.0)


@contextmanager
def _progress(plan: Plan) -> Iterator[_Advance]:
    if not sys.stderr.isatty():
        yield _Advance()
        return
    from rich.progress import BarColumn, Progress, TextColumn

    from analyzer.cli.console import Console

    seconds = {(each.text, name): value for each in plan.targets for name, value in plan.seconds(each).items()}
    planned, began = sum(seconds.values()), time.monotonic()
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[count]}"))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("testing", total=planned, count=f"0/{len(seconds)}")

        class Shown(_Advance):
            count, done = 0, 0.0

            def __call__(self, each: VerdictRecord) -> None:
                self.count += 1
                self.done += seconds.get((each.target, each.id), 0.0)
                left = timedelta(seconds=round(time_left(planned, self.done, time.monotonic() - began)))
                shown = f"{self.count}/{max(self.count, len(seconds))}, {left} left"
                bar.update(task, completed=self.done, count=shown, description=f"{each.dialect} {each.theme}")

        yield Shown()
