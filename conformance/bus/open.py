"""Opens a line by the name of its endpoint. Each kind of line is imported only when it is opened."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from analyzer.catalogue import Dialect
from analyzer.errors import UsageError
from analyzer.live.endpoint import Endpoint
from conformance.bus.line import Line


def open_line(endpoint: Endpoint) -> Line:
    """Open the host's end of a bus.

    Raises UsageError where it cannot be opened, with what to do about it.
    """
    if endpoint.auto:
        raise UsageError(f"{endpoint.text}: the speed is missing, expected baud=N (servotap scan finds it)")
    return _KINDS[endpoint.kind](endpoint)


def at_default_rate(endpoint: Endpoint, dialect: Dialect) -> Endpoint:
    """Return a serial port at the rate that a dialect's drives are delivered with, where it names no rate; its text says so."""
    if endpoint.kind != "serial" or endpoint.speed is not None or endpoint.auto or not dialect.baud_rates:
        return endpoint
    return replace(endpoint, speed=dialect.baud_rates[0], text=f"{endpoint.text},baud={dialect.baud_rates[0]}")


def _serial(endpoint: Endpoint) -> Line:
    from conformance.bus.serial import SerialLine

    return SerialLine(endpoint)


def _tcp(endpoint: Endpoint) -> Line:
    from conformance.bus.tcp import TcpLine

    return TcpLine(endpoint)


def _can(endpoint: Endpoint) -> Line:
    from conformance.bus.can import CanLine

    return CanLine(endpoint)


_KINDS: Mapping[str, Callable[[Endpoint], Line]] = {"serial": _serial, "tcp": _tcp, "can": _can}
