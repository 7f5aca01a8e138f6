"""Where a command sends: the option --on, and the gate to that place."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Callable, Iterable, Iterator

from analyzer.catalogue import Dialect
from analyzer.errors import UsageError
from analyzer.live import profile
from analyzer.live.endpoint import Endpoint
from analyzer.values import printable
from conformance.bus import at_default_rate, open_line
from conformance.bus.line import Line, LineLost
from conformance.gate.gate import Gate
from conformance.gate.permissions import Allowance


def add_on_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option --on."""
    parser.add_argument(
        "--on", metavar="ENDPOINT",
        help="serial:PORT,baud=N, tcp:HOST:PORT, can:INTERFACE:CHANNEL,bitrate=N, or a name of a profile (servotap.toml)",
    )  # fmt: skip


def endpoint_of(arguments: argparse.Namespace) -> Endpoint:
    """Return the endpoint of --on. Raises UsageError where there is none."""
    if arguments.on is None:
        raise UsageError("where? expected --on ENDPOINT, as in --on serial:/dev/ttyUSB0,baud=38400 (or --dry-run)")
    return profile.endpoint(arguments.on)


def at_own_rate(endpoint: Endpoint, dialect: Dialect) -> Endpoint:
    """Return an endpoint at a dialect's default rate where it names none, and say which rate that is."""
    at = at_default_rate(endpoint, dialect)
    say_rate(at, dialect, endpoint.text)
    return at


def rate_text(endpoint: Endpoint, speed: int) -> str:
    """Return a speed in words: a terminal server that was named without one sets its own, and does not report it."""
    return "its own rate" if endpoint.kind == "tcp" and endpoint.speed is None else f"{speed} bit/s"


def say_rate(endpoint: Endpoint, dialect: Dialect, given: str) -> None:
    """Say the rate of an endpoint where it was given without one."""
    if endpoint.text != given:
        print(f"{printable(endpoint.text)}: the default rate of {dialect.name}", file=sys.stderr)


@contextlib.contextmanager
def gate_to(
    endpoint: Endpoint,
    allowance: Allowance,
    dialects: Iterable[Dialect] | None = None,
    *,
    opened: Callable[[Endpoint], Line] = open_line,
) -> Iterator[Gate]:
    """Open a port and yield the gate to it; the port is closed in the end, and nothing that was sent is left open.

    `opened`: opens the port, in place of `open_line`. Raises UsageError where it cannot be opened.
    """
    with contextlib.closing(opened(endpoint)) as line:
        gate = Gate(line, allowance, dialects=dialects)
        try:
            yield gate
        finally:
            with contextlib.suppress(LineLost):
                gate.end_stream()
