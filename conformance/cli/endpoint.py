"""Where a command sends: the option --on, the gate to that place, and lists of addresses there."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Iterable, Iterator

from analyzer.catalogue import Dialect
from analyzer.errors import UsageError
from analyzer.live import endpoint as endpoints
from analyzer.live.endpoint import Endpoint
from analyzer.values import quote
from conformance.bus import at_default_rate, open_line
from conformance.bus.line import LineLost
from conformance.gate.gate import Gate
from conformance.gate.permissions import Allowance

_HIGHEST_ADDRESS = 0x7FF


def add_on_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option --on."""
    parser.add_argument("--on", metavar="ENDPOINT", help="serial:PORT,baud=N, tcp:HOST:PORT or can:INTERFACE:CHANNEL,bitrate=N")


def endpoint_of(arguments: argparse.Namespace) -> Endpoint:
    """Return the endpoint of --on. Raises UsageError where there is none."""
    if arguments.on is None:
        raise UsageError("where? expected --on ENDPOINT, as in --on serial:/dev/ttyUSB0,baud=38400 (or --dry-run)")
    return endpoints.parse(arguments.on)


def at_own_rate(endpoint: Endpoint, dialect: Dialect) -> Endpoint:
    """Return an endpoint at a dialect's default rate where it names none, and say which rate that is."""
    at = at_default_rate(endpoint, dialect)
    say_rate(at, dialect, endpoint.text)
    return at


def say_rate(endpoint: Endpoint, dialect: Dialect, given: str) -> None:
    """Say the rate of an endpoint where it was given without one."""
    if endpoint.text != given:
        print(f"{endpoint.text}: the default rate of {dialect.name}", file=sys.stderr)


@contextlib.contextmanager
def gate_to(endpoint: Endpoint, allowance: Allowance, dialects: Iterable[Dialect] | None = None) -> Iterator[Gate]:
    """Open a port and yield the gate to it; the port is closed in the end, and nothing that was sent is left open.

    Raises UsageError where it cannot be opened.
    """
    with contextlib.closing(open_line(endpoint)) as line:
        gate = Gate(line, allowance, dialects=dialects)
        try:
            yield gate
        finally:
            with contextlib.suppress(LineLost):
                gate.end_stream()


def parse_addresses(text: str, lowest: int = 1) -> list[int]:
    """Return the addresses of `1-32` or `1,2,0x10-0x1F`, each once, in order; none is below `lowest`.

    Raises UsageError for what is none.
    """
    found: dict[int, None] = {}
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        try:
            low = int(first, 0)
            high = int(last, 0) if dash else low
        except ValueError:
            low = high = -1
        if not lowest <= low <= high <= _HIGHEST_ADDRESS:
            raise UsageError(
                f"--addresses: got {quote(part)}, expected addresses from {lowest} to {_HIGHEST_ADDRESS}, as 1-32 or 1,2,7"
            )
        found |= dict.fromkeys(range(low, high + 1))
    return list(found)
