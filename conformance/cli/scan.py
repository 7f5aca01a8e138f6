"""Search a bus for drives, with reads only: over rates, dialects and addresses. Report replies and other bytes.

An endpoint with a rate is searched at that rate alone. Without a rate a serial line is tried at every rate of the manuals.
Ctrl-C or SIGTERM ends the search and shows what was found so far.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import re
import sys
from collections.abc import Iterator, Sequence
from typing import Any

from analyzer import dialects as registry
from analyzer.catalogue import Dialect
from analyzer.cli.signals import ended_by, ended_status
from analyzer.diagnosis.diagnose import lines
from analyzer.errors import UsageError
from analyzer.live import profile
from analyzer.live.endpoint import Endpoint
from analyzer.values import addresses as addresses_of
from analyzer.values import counted, printable, quote
from conformance.cli.endpoint import gate_to, rate_text
from conformance.gate.permissions import Allowance
from conformance.talk.scan import PATIENCE_NS, Found, Progress, Report, Stray, scan

EXAMPLES = """\
exit status: 0 a drive was found, 1 none was, 2 wrong use, 130 Ctrl-C, 143 SIGTERM.

examples:
  servotap scan serial:/dev/ttyUSB0
  servotap scan serial:/dev/ttyUSB0,baud=38400 --addresses 1-255 --dialects mks-rs485,mks-modbus
  servotap scan tcp:192.168.0.7:5000 --addresses 1,2,0x10-0x1F
  servotap scan can:slcan:/dev/ttyACM0 --rates 500000,1000000
  servotap scan can:socketcan:can0 --addresses 1-2047 --json
  servotap scan arm                                the bus of a profile's drive (servotap.toml)
"""
DEFAULT_ADDRESSES = "1-32"
_SHOWN = 24


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "endpoint", metavar="ENDPOINT", help="serial:PORT[,baud=N], tcp:HOST:PORT, can:INTERFACE:CHANNEL or a name"
    )
    add_looking_arguments(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object")


def add_looking_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that say where and how long is looked."""
    parser.add_argument("--addresses", default=DEFAULT_ADDRESSES, metavar="LIST", help="as 1-32 (default) or 1,2,0x10-0x1F")
    parser.add_argument("--rates", metavar="LIST", help="bits per second, as 38400,115200, or all")
    parser.add_argument("--dialects", metavar="LIST", help="as mks-rs485,lk-rs485; default: all of the bus")
    parser.add_argument(
        "--timeout", type=float, default=PATIENCE_NS / 1e6, metavar="MS", help="wait for a reply (default 40 ms)"
    )
    parser.add_argument("--busy", action="store_true", help="scan even if there is other traffic on the bus")


def run(arguments: argparse.Namespace) -> int:
    """Scan; return 0 if a drive was found, 1 if none was, and where a signal has ended the search what it stands for."""
    endpoint = profile.endpoint(arguments.endpoint)
    report = look(endpoint, arguments, quiet=arguments.json)
    if arguments.json:
        print(json.dumps(_object(report)))
    else:
        show(report, endpoint)
        for line in _next_lines(report, endpoint):
            print(line)
    if report.interrupted:
        return ended_status()
    return 0 if report.found else 1


def look(endpoint: Endpoint, arguments: argparse.Namespace, *, quiet: bool = False) -> Report:
    """Return what answers on a bus; without `quiet`, drives are shown as they are found. A signal ends it early."""
    dialects = dialects_on(endpoint, arguments.dialects)
    addresses = addresses_of(arguments.addresses, "--addresses", min(d.addresses[0] for d in dialects))
    rates = rates_of(arguments.rates, endpoint, dialects)
    if not 0 < arguments.timeout <= 60_000:
        raise UsageError(f"--timeout: got {arguments.timeout:g}, expected milliseconds above 0, at most 60000")
    report = Report()

    def tell(found: Found) -> bool:
        """Show a drive as it is found, and go on looking."""
        if not quiet:
            print(_found_line(found, endpoint), flush=True)
        return False

    opened = endpoint.at(rates[0]) if endpoint.auto or endpoint.kind == "serial" else endpoint
    with gate_to(opened, Allowance()) as gate, showing_progress(quiet=quiet) as progress:
        try:
            scan(
                gate, dialects, addresses=addresses, rates=rates, patience_ns=int(arguments.timeout * 1e6),
                busy=arguments.busy, enough=tell, progress=progress, report=report,
            )  # fmt: skip
        except KeyboardInterrupt:
            report.stopped, report.interrupted = f"stopped by {ended_by()}", True
    return report


# --- what is asked for --------------------------------------------------------------------------------------------


def dialects_on(endpoint: Endpoint, text: str | None = None) -> list[Dialect]:
    """Return the dialects of a bus, those that are named. Raises UsageError for one of another kind of bus."""
    every = [d for d in registry.every() if d.bus == endpoint.bus_kind]
    if text is None:
        return every
    chosen = [registry.get(name.strip()) for name in text.split(",")]
    for dialect in chosen:
        endpoint.check_dialect(dialect)
    return chosen


def rates_of(text: str | None, endpoint: Endpoint, dialects: Sequence[Dialect]) -> list[int]:
    """Return the rates to try: those asked for; the endpoint's own; those of the manuals, where a line has its own rate."""
    known = list(dict.fromkeys(r for d in dialects for r in d.baud_rates))
    if text is None:
        settable = endpoint.kind == "serial" and endpoint.speed is None
        return known if settable else [endpoint.bits_per_second]
    if text.strip() == "all":
        return [endpoint.speed, *(r for r in known if r != endpoint.speed)] if endpoint.speed else known
    rates = []
    for word in text.split(","):
        if not word.strip().isdecimal() or not 0 < int(word) <= 100_000_000:
            raise UsageError(f"--rates: got {quote(word)}, expected bits per second, as 38400,115200, or all")
        rates.append(int(word))
    return rates


# --- what is shown ------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def showing_progress(*, quiet: bool) -> Iterator[Progress | None]:
    """Show on a terminal how far a scan has come."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    from analyzer.cli.console import Console

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("listening", total=None)

        def show(done: int, total: int, where: str) -> None:
            bar.update(task, completed=done, total=total, description=where)

        yield show


def show(report: Report, endpoint: Endpoint) -> None:
    """Show what else came, and what to check."""
    if not report.found:
        *others, last = report.rates or [endpoint.bits_per_second]
        rates = ", ".join([*map(str, others), rate_text(endpoint, last)])
        print(f"no drive answered on {endpoint.text}: {report.asked} questions ({', '.join(report.dialects)}; at {rates})")
    for stray in report.strays[:_SHOWN]:
        print(_stray_line(stray))
    if len(report.strays) > _SHOWN:
        print(f"  and {len(report.strays) - _SHOWN} times more")
    if report.others:
        print(_others_line(report))
    if report.stopped:
        print(f"not looked everywhere: {report.stopped}")
    if (diagnosis := report.diagnosis) is not None:
        for line in lines(diagnosis):
            print(printable(line))
    for hint in report.hints:
        print(f"  - {hint}")


def _next_lines(report: Report, endpoint: Endpoint) -> Iterator[str]:
    """Yield commands to copy: one that records the bus, and a test of each drive that was found."""
    if not report.found:
        return
    bare = without_rate(endpoint)
    rates = dict.fromkeys(found.speed for found in report.found)
    places = {rate: f"{bare},{'bitrate' if endpoint.kind == 'can' else 'baud'}={rate}" for rate in rates}
    if endpoint.kind == "tcp":
        places = dict.fromkeys(rates, endpoint.text)
    yield "to go on:"
    yield from (f"  servotap record {place} -o week.mcap" for place in dict.fromkeys(places.values()))
    for found in report.found[:_SHOWN]:
        yield f"  servotap test {found.name} --on {places[found.speed]} --short"


def without_rate(endpoint: Endpoint) -> str:
    """Return an endpoint as it was named, without its name and its rate."""
    named = endpoint.text.removeprefix(f"{endpoint.name}=")
    return re.sub(r",(baud|bitrate)=[^,]*", "", named)


def _found_line(found: Found, endpoint: Endpoint) -> str:
    rate = rate_text(endpoint, found.speed)
    details = f"  {found.identity}" if found.identity else ""
    wrong = f"  ({found.wrong})" if found.wrong else ""
    return f"{found.name:<16} {rate:>14}  {found.latency_ns / 1e6:6.2f} ms{details}{wrong}"


def _stray_line(stray: Stray) -> str:
    data = stray.data[:16].hex(" ").upper() + (" ..." if len(stray.data) > 16 else "")
    when = f"when {stray.asked} was asked" if stray.asked else "before anything was asked"
    return f"heard at {stray.speed} bit/s {when}: {data}  ({stray.kind.value})"


def _others_line(report: Report) -> str:
    """Return who else spoke, those with the most frames first."""
    listed = [f"{who} ({counted(count, 'frame')})" for who, count in report.others.most_common(_SHOWN)]
    more = len(report.others) - len(listed)
    return f"not of this dialect: {', '.join(listed)}" + (f" and {more} more" if more else "")


def _object(report: Report) -> dict[str, Any]:
    def of(found: Found) -> dict[str, Any]:
        shown: dict[str, Any] = {
            "dialect": found.dialect.name,
            "address": found.address,
            "speed": found.speed,
            "latency": found.latency_ns / 1e9,
            "raw": found.reply.hex(" ").upper(),
            "said": dict(found.values),
        }
        return shown | ({"wrong": found.wrong} if found.wrong else {})

    return {
        "found": [of(f) for f in report.found],
        "heard": [
            {"speed": s.speed, "asked": s.asked, "raw": s.data.hex(" ").upper(), "look": s.kind.value} for s in report.strays
        ],
        "others": dict(report.others),
        "asked": report.asked,
        "rates": report.rates,
        "dialects": list(report.dialects),
        "stopped": report.stopped,
        "hints": report.hints,
        "causes": [] if (diagnosis := report.diagnosis) is None else diagnosis.as_objects(),
    }
