"""Send the requests of a recording again, at their times, through the gate, and compare the replies with the recorded ones.

A file brings no permission: all of it is judged by --allow before its first byte is sent. Times do not drift: each request
has its own from the start. Ctrl-C stops by a ramp every drive that the replay set in motion. The end of the replay stops a
run that the recording left running. A guard process owns the port: if the replay is killed, the guard stops what moves.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import msgspec

from analyzer.catalogue import Dialect
from analyzer.cli.option_types import number
from analyzer.cli.reading import OpenCapture, add_reading_arguments, meanwhile, open_reading, progress
from analyzer.dialects import drive_name
from analyzer.errors import UsageError
from analyzer.live.endpoint import Endpoint
from analyzer.live.profile import look_up
from analyzer.values import addresses as addresses_of
from analyzer.values import printable
from conformance.bus import open_line
from conformance.claim import NotStopped, worst
from conformance.cli.endpoint import add_on_argument, endpoint_of
from conformance.gate.gate import Allowance, Gate, Judge, add_gate_arguments, allowance_from, shown
from conformance.gate.permissions import narrow
from conformance.safety import messages as say
from conformance.safety.guarded_line import GuardedLine, beginning
from conformance.safety.signals import as_interrupt
from conformance.talk.dialogue import Dialogue
from conformance.talk.drive_state import read_drive_state
from conformance.tools.replay import DEVIATIONS, Match, Rehearsal, Replay, Result, SentStep, meant, rehearse
from conformance.tools.replay_plan import Plan, Step, make_plan

EXAMPLES = """\
exit status: 0 answered as in the recording, 1 otherwise, 2 wrong use or not allowed, 20 something may still move.

examples:
  servotap replay week.mcap --on serial:/dev/ttyUSB0,baud=38400 --dry-run
  servotap replay poll.log --on tcp:127.0.0.1:5000 --speed 2 --loop 10
  servotap replay job.mcap --bus left --on serial:/dev/ttyUSB0 --allow motion,unbounded --max-speed 300 --subdivision 16
  servotap replay can.log --on can:socketcan:can0 --address 1,2 --skip-refused
  servotap replay poll.log --on arm                a drive or a bus of a profile, servotap.toml
"""
_LISTED = 12
#: The interface of python-can that is a bus within one process: no other one can reach it.
_OWN = "virtual"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("file", metavar="FILE", help="a capture or an MCAP log")
    add_on_argument(parser)
    parser.add_argument(
        "--speed",
        type=number("a factor of 1e-6 to 1e6", float, lambda factor: 1e-6 <= factor <= 1e6),
        default=1.0,
        metavar="X",
        help="2 is twice as fast (default 1)",
    )
    parser.add_argument(
        "--loop",
        type=number("a number from 0 on", int, lambda loops: 0 <= loops <= 1_000_000_000),
        default=1,
        metavar="N",
        help="N times over; 0: until Ctrl-C",
    )
    parser.add_argument("--bus", default="", metavar="NAME", help="only this bus, if the file has several")
    parser.add_argument("--address", metavar="LIST", help="only requests to these addresses, as 1,2 or 1-4")
    parser.add_argument("--skip-refused", action="store_true", help="skip requests that are not allowed, and send the rest")
    parser.add_argument("--dry-run", action="store_true", help="list the requests that would be sent or refused; open nothing")
    parser.add_argument("--json", action="store_true", help="the result as one JSON object")
    add_reading_arguments(parser)
    add_gate_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Replay; return 0 if the drives answered as in the recording."""
    named = look_up(arguments.on) if arguments.on else None
    if named is not None:
        narrow(arguments, named.drives)
    endpoint = None if arguments.dry_run else endpoint_of(arguments)
    addresses = None if arguments.address is None else frozenset(addresses_of(arguments.address, "--address"))
    allowance = allowance_from(arguments, addresses=addresses)
    reading = open_reading(arguments.file, arguments)
    with contextlib.closing(reading.source):
        with progress(reading.source, f"reading {reading.source.name}"):
            plan = make_plan(reading, reading.pipeline, bus=arguments.bus, addresses=addresses)
        _check(plan, arguments)
        if endpoint is None:
            rehearsal = _rehearse(Judge(allowance, _known_dialects(reading)).rehearsal(), plan, arguments)
            _show_plan(plan, rehearsal, reading, arguments)
            return 2 if rehearsal.refused and not arguments.skip_refused else 0
        if endpoint.bus_kind != plan.steps[0].dialect.bus:
            raise UsageError(f"{reading.source.name} is of a {plan.steps[0].dialect.bus} bus, {endpoint.text} is another kind")
        with _Port(endpoint, plan, allowance, _known_dialects(reading)) as port:
            gate = port.gate
            _read_drive_states(gate, plan)
            if isinstance(gate.line, GuardedLine):
                gate.line.tell(say.ReadState())
            rehearsal = _rehearse(gate.rehearsal(), plan, arguments)
            if rehearsal.refused and not arguments.skip_refused:
                _refuse(rehearsal, len(plan.steps))
            result = _replay(port, plan, rehearsal, reading, arguments)
            # What ends by itself may go on to its end.
            port.settle(not result.left_moving)
    if arguments.json:
        print(json.dumps(_object(result, plan, rehearsal)))
    else:
        _show(result, plan, rehearsal)
    if result.stopped == "Ctrl-C" and not result.left_moving:
        raise KeyboardInterrupt
    return worst(NotStopped.exit_status * bool(result.left_moving), int(bool(result.deviations or result.stopped)))


class _Port:
    """The port by a guard, which stops what moves if the replay is killed; by another one, where the first is lost."""

    def __init__(self, endpoint: Endpoint, plan: Plan, allowance: Allowance, dialects: Sequence[Dialect]) -> None:
        self._endpoint, self._allowance, self._dialects = endpoint, allowance, dialects
        drives = {(s.dialect.name, address): s.dialect for s in plan.steps for address, *_ in meant(s)}
        begin = beginning(endpoint, [(dialect, address) for (_, address), dialect in drives.items()], allowance)
        # A recording has its own end, so the guard sets none to its runs.
        self._begin = msgspec.structs.replace(begin, longest_run_ns=say.NO_END_NS)
        self.gate = self._open(self._begin)

    def _open(self, begin: say.Begin) -> Gate:
        if self._endpoint.kind == "can" and self._endpoint.interface[0] == _OWN:
            return Gate(open_line(self._endpoint), self._allowance, dialects=self._dialects)
        line = GuardedLine(self._endpoint, begin)
        line.tell(say.DriveFound())
        return Gate(line, self._allowance, dialects=self._dialects)

    def reopen(self) -> Gate:
        """Open the port anew: what was set going may go on."""
        print("servotap replay: the process that owns the port is lost; another one takes over", file=sys.stderr, flush=True)
        self.gate.close()
        self.gate = self._open(msgspec.structs.replace(self._begin, moving=True))
        return self.gate

    def settle(self, settled: bool) -> None:
        """Say whether nothing is left to be stopped."""
        if isinstance(self.gate.line, GuardedLine):
            self.gate.line.settled = settled

    def __enter__(self) -> _Port:
        return self

    def __exit__(self, *_: object) -> None:
        self.gate.close()


def _check(plan: Plan, arguments: argparse.Namespace) -> None:
    """Raise UsageError where there is nothing to send, or several buses to choose from."""
    if len(plan.buses) > 1 and not arguments.bus:
        names = ", ".join(f"{name} ({count} requests)" for name, count in plan.buses.most_common())
        raise UsageError(f"{arguments.file} has several buses: {printable(names)}; choose one with --bus NAME")
    if arguments.bus and arguments.bus not in plan.buses:
        raise UsageError(f"{arguments.file} has no bus {arguments.bus!r}; it has {printable(', '.join(plan.buses)) or 'none'}")
    if not plan.steps:
        left = ", ".join(f"{count} {reason}" for reason, count in plan.left_out.items())
        raise UsageError(f"{arguments.file} has no request to send{f' ({left})' if left else ''}")


def _known_dialects(reading: OpenCapture) -> list[Dialect]:
    """Return all dialects; those of the recording as its model speaks them."""
    from analyzer import dialects as registry

    chosen = {d.name: d for d in reading.possible}
    return [chosen.get(d.name, d) for d in registry.every()]


def _read_drive_states(gate: Gate, plan: Plan) -> None:
    """Read from each drive that is to move what the gate has to know for its bounds."""
    drives = {(s.dialect.name, s.address): s.dialect for s in plan.steps if s.message.command and s.message.command.moves}
    if not drives or not gate.allowance.bounds.given:
        return
    dialogue = Dialogue(gate, list({d.name: d for d in drives.values()}.values()))
    for (_, address), dialect in drives.items():
        read_drive_state(dialogue, dialect, address)


def _rehearse(judge: Judge, plan: Plan, arguments: argparse.Namespace) -> Rehearsal:
    found = rehearse(judge, plan, arguments.speed)
    loops = arguments.loop if judge.allowance.budget.described() else min(arguments.loop, 2)
    for _ in range(1, loops):
        # Again behind itself: the end of one round and the beginning of the next are one stream too.
        more = rehearse(judge, Plan(found.allowed), arguments.speed)
        if more.refused:
            found.refused += more.refused[:1]
            break
    return found


def _refuse(rehearsal: Rehearsal, total: int) -> None:
    rows = [f"  {count} x {name}: {objection}" for name, count, objection in rehearsal.by_command()[:_LISTED]]
    more = len(rehearsal.by_command()) - _LISTED
    rows += [f"  and {more} commands more"] * (more > 0)
    count = len(rehearsal.refused)
    raise UsageError(
        f"nothing was sent: {count} of {total} requests are not allowed (--skip-refused sends the others)\n" + "\n".join(rows)
    )


def _replay(port: _Port, plan: Plan, rehearsal: Rehearsal, reading: OpenCapture, arguments: argparse.Namespace) -> Result:
    kind = port.gate.line.endpoint.bus_kind
    dialects = [d for d in reading.possible if d.bus == kind]
    replay = Replay(port.gate, dialects, speed=arguments.speed, reopen=port.reopen)
    with as_interrupt(), _bar(len(rehearsal.allowed) * arguments.loop, arguments.json) as advance:
        return replay.run(rehearsal.allowed, plan.period_ns, arguments.loop, advance)


@contextlib.contextmanager
def _bar(total: int, quiet: bool) -> Iterator[Callable[[SentStep], None] | None]:
    """Show how far it is, twice a second, from a thread: between two requests there is no time to draw."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    count = [0]

    def show(done: threading.Event) -> None:
        from rich.live import Live
        from rich.text import Text

        from analyzer.cli.console import Console

        of = f" of {total}" if total else ""
        with Live(console=Console(stderr=True), auto_refresh=False, transient=True) as live:
            while not done.wait(0.5):
                live.update(Text(f"{count[0]}{of} requests sent"), refresh=True)

    def advance(sent: SentStep) -> None:
        count[0] += 1

    with meanwhile(show):
        yield advance


# --- what is shown ------------------------------------------------------------------------------------------------


def _show_plan(plan: Plan, rehearsal: Rehearsal, reading: OpenCapture, arguments: argparse.Namespace) -> None:
    refused = {name: (count, objection) for name, count, objection in rehearsal.by_command()}
    counts = _counts(plan.steps)
    print(f"{len(plan.steps)} requests over {plan.duration_ns / arguments.speed / 1e9:.1f} s, times: {reading.time_source}")
    for name, count in counts.most_common():
        text = f"  {count:>7} x {name}"
        if name in refused:
            text += f"   not allowed: {refused[name][1]}"
        print(text)
    for reason, count in plan.left_out.items():
        print(f"  {count:>7} {reason}: left out")


def _counts(steps: Sequence[Step]) -> Counter[str]:
    return Counter(f"{drive_name(s.dialect, s.address)} {s.name}" for s in steps)


def _show(result: Result, plan: Plan, rehearsal: Rehearsal) -> None:
    late = ", ".join(f"{name} {ns / 1e6:.3f}" for name, ns in _lateness(result).items())
    print(f"{result.sent} requests sent, late by {late} ms" + (f"; {result.held} waited for a reply" if result.held else ""))
    if rehearsal.refused:
        print(f"{len(rehearsal.refused)} were left out as not allowed")
    for reason, count in plan.left_out.items():
        print(f"{count} {reason}: left out")
    names = list(dict.fromkeys(name for name, _ in result.matches))
    for name in names:
        matches = ", ".join(f"{n} {match.value}" for match in Match if (n := result.matches[name, match]))
        print(f"  {name:<26} {matches}")
    for (name, match), sent in result.examples.items():
        then = " | ".join(t.data.hex(" ").upper() for t in sent.step.replies) or "nothing"
        now = " | ".join(t.data.hex(" ").upper() for t in sent.replies) or "nothing"
        print(f"  {name} {match.value}: {shown(sent.step.item)}\n    then {then}\n    now  {now}")
    if result.junk or result.others:
        print(f"besides: {result.others} frames that answer nothing, {result.junk} pieces of junk")
    if result.stopped:
        print(f"stopped: {printable(result.stopped)}")
    for drive in result.left_moving:
        print(f"NOT KNOWN TO STAND: {printable(drive)}")


def _lateness(result: Result) -> dict[str, int]:
    return {"p50": result.lateness_ns(0.5), "p99": result.lateness_ns(0.99), "max": result.lateness_ns(1.0)}


def _object(result: Result, plan: Plan, rehearsal: Rehearsal) -> dict[str, Any]:
    matches: dict[str, dict[str, int]] = {}
    for (name, match), count in result.matches.items():
        matches.setdefault(name, {})[match.value] = count
    return {
        "sent": result.sent,
        "held": result.held,
        "refused": len(rehearsal.refused),
        "left_out": dict(plan.left_out),
        "late": {name: ns / 1e9 for name, ns in _lateness(result).items()},
        "matches": matches,
        "deviations": result.deviations,
        "deviating": sorted({match.value for _, match in result.matches if match in DEVIATIONS}),
        "junk": result.junk,
        "others": result.others,
        "stopped": result.stopped,
        "left_moving": result.left_moving,
    }
